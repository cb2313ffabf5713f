"""Random motions of a trial, and the sensors' readings while a joint follows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...models.controller import Controller
from ...models.joint import Joint
from ...models.joint_parts import Mounting
from ...models.recording import Recording
from ...scenarios.scenario import Disturbance, Scenario, Waypoint
from ...sim import plant, sensors
from ...sim.loop import CONTROL_PERIOD, ClosedLoop, Driven
from .outside import sign

CONTROLLER = Controller(kp=8.0, kd=0.08, ki=20.0)
"""Of trials and planned experiments, unless the joint has its own."""


def motions(
    rng: np.random.Generator, free: str = "no_load", link: str = "link", strength: float = 1.0
) -> list[Scenario]:
    """Draw three motions, about 85 s: bare joint to both sides; link to both sides; link held and pushed. `free`, `link`:
    mountings; `strength`: of the pushes, 1 for a joint of 16 N·m."""
    u = rng.uniform
    sweeps = [u(1.2, 1.45), -u(1.1, 1.45), u(1.2, 1.45), -u(0.9, 1.45), 0.0]
    bare_, loaded = [u(1.4, 1.65), -u(1.4, 1.7), 0.0], [u(1.2, 1.4), 0.0]
    hold = u(10.0, 13.0)
    pushed = waypoints(loaded, [u(4.5, 7.0), u(4.0, 5.5)], [hold, 1.0], u(0.8, 1.2))
    pushes, at = [], u(1.2, 2.2)
    direction = sign(rng)
    for _ in range(6):
        duration = u(0.15, 0.7)
        pushes.append(Disturbance(kind="push", start=at, duration=duration, torque=direction * strength * u(3.0, 7.0)))
        at += duration + u(1.5, 4.5)
        direction = -direction
    pushes = [d for d in pushes if d.start < pushed[-1].time - 1.5]
    return [
        _scenario("free", free, waypoints(bare_, [u(2.5, 3.5), u(9, 12), u(2.5, 4)], [u(0.5, 1), u(0.5, 1.5), 0.5], u(0.5, 1))),
        _scenario("push", link, pushed, pushes),
        _scenario(
            "sweep", link,
            waypoints(sweeps, [u(3.0, 4.0), u(6, 8), u(9, 12), u(4, 5.5), u(4, 5.5)], [*u(0.5, 2.0, 4), 0.5], u(0.5, 1)),
        ),
    ]  # fmt: skip


def waypoints(
    positions: Sequence[float], durations: Sequence[float], holds: Sequence[float], start: float
) -> list[Waypoint]:
    """Positions [rad] reached in durations [s] and held [s], beginning at zero at a time [s]."""
    points, t = [Waypoint(time=float(start), position=0.0)], float(start)
    for position, duration, hold in zip(positions, durations, holds, strict=True):
        points.append(Waypoint(time=t + duration, position=float(position)))
        t += float(duration + hold)
        points.append(Waypoint(time=t, position=float(position)))
    return points


def _scenario(name: str, mounting: str, points: list[Waypoint], pushes: Sequence[Disturbance] = ()) -> Scenario:
    return Scenario(
        name=name, mounting=mounting, duration=points[-1].time + 0.3, trajectory=points, disturbances=list(pushes),
        controller=CONTROLLER,
    )  # fmt: skip


def record_motion(
    nominal: Joint,
    mounting: Mounting,
    record: np.ndarray,
    scenario: Scenario,
    seed: int,
    known: bool = False,
    warming: float = 0.0,
) -> Recording:
    """What the sensors read when the joint of a record follows a scenario under the drive's controller.

    Args:
      nominal: sensors, structure, and what the recording says of the link.
      record: the true joint, shape (1,).
      known: whether the torque on the link is measured; else the recording says that pushes may have happened.
      warming: by how much the gear warms up in a second [K/s]; nothing measures it.
    """
    position, velocity = scenario.commands()
    external = scenario.external_torque()
    n = len(position)
    controller = (nominal.controller if scenario.controller == CONTROLLER else None) or scenario.controller
    driven = Driven(
        record,
        position,
        velocity,
        external,
        sensors.sensor_records(nominal, float(record[0]["link_delay"]), CONTROL_PERIOD),
        sensors.noise(nominal, seed, n, CONTROL_PERIOD),
        controller.record(record[0], CONTROL_PERIOD, False),
        temperature=float(record[0]["reference_temperature"]) + warming * CONTROL_PERIOD * np.arange(n),
    )
    model = plant.build(nominal, mounting, scenario.timestep, record=record, locked_rotor=scenario.locked_rotor)
    loop = ClosedLoop(model, (driven,))
    loop.advance(n)
    found = loop.simulation
    pushed = bool(np.any(external))
    kept = ("motor_position", "link_position", "motor_current", "joint_torque")
    columns = {name: found.readings[name].copy() for name in kept}
    columns["position_command"] = position
    if pushed and known:
        columns["external_torque"] = external
    return Recording(
        name=scenario.name,
        time=found.time,
        columns=columns,
        joint=nominal.name,
        description=scenario.description or scenario.name,
        link=mounting,
        external="none" if not pushed else "measured" if known else "unmeasured",
    )


def bare(recording: Recording, rng: np.random.Generator) -> Recording:
    """The same without torque sensor, logged every 3 to 5 ms with single samples missing (9 ms)."""
    steps = rng.choice((3, 4, 5, 9), p=(0.17, 0.5, 0.17, 0.16), size=len(recording.time))
    keep = np.cumsum(steps)
    keep = keep[keep < len(recording.time)]
    return recording.without("joint_torque").at(keep)


def jittered(recording: Recording, rms: float, rng: np.random.Generator) -> Recording:
    """The same with time stamps that are wrong by `rms` [s]; they still increase."""
    return recording.at(slice(None), sensors.jittered(recording.time, rms, rng))
