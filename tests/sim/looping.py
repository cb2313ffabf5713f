"""The closed loop on the test joint, with a short motion and two pushes."""

from __future__ import annotations

import numpy as np
from driving import JOINT

from flexspline.models.controller import Controller
from flexspline.sim import plant
from flexspline.sim.loop import CONTROL_PERIOD, ClosedLoop, Driven, Simulation
from flexspline.sim.sensors import noise, sensor_records


def simulate_together(model, joints) -> tuple[Simulation, ...]:
    """Run the closed loops of a model's joints, `Driven` each, from the first tick to the last."""
    loop = ClosedLoop(model, joints)
    loop.advance(len(joints[0].command))
    return loop.simulations


def simulate(model, *driven, **options) -> Simulation:
    """Run the closed loop of one joint; further arguments as of `Driven`."""
    return simulate_together(model, (Driven(*driven, **options),))[0]


def motion(seconds=2.0, distance=0.4):
    """Commands there and back [rad], [rad/s] and torque on the link [N·m], shape (n,) each."""
    time = np.arange(round(seconds / CONTROL_PERIOD)) * CONTROL_PERIOD
    pulsation = 2 * np.pi / seconds
    position = 0.5 * distance * (1 - np.cos(pulsation * time))
    external = np.where((time > 0.6) & (time < 0.8), 4.0, 0.0) + np.where((time > 1.3) & (time < 1.6), -3.0, 0.0)
    return position, 0.5 * distance * pulsation * np.sin(pulsation * time), external


def run(
    joint=JOINT, mounting="link", record=None, feedback=None, temperature=None, seed=3, model=None, **motion_of
) -> Simulation:
    """Simulate a joint in the loop; with a given model, or a new one."""
    mounted = joint.mount(mounting)
    record = joint.record(mounted) if record is None else record
    model = plant.build(joint, mounted, record=record) if model is None else model
    position, velocity, external = motion(**motion_of)
    return simulate(
        model,
        record,
        position,
        velocity,
        external,
        sensor_records(joint, float(record[0]["link_delay"]), CONTROL_PERIOD),
        noise(joint, seed, len(position), CONTROL_PERIOD),
        Controller().record(record[0], CONTROL_PERIOD, feedback is not None),
        feedback,
        temperature,
    )
