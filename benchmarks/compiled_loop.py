"""Gain of the compiled closed loop: the same ten seconds with the loop in Python around the same compiled parts."""

from __future__ import annotations

import ctypes

import mujoco
import numpy as np

from flexspline.models.joint import load_joint
from flexspline.models.step import SAMPLE
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim import native, plant, sensors
from flexspline.sim.drive import control
from flexspline.sim.loop import CONTROL_PERIOD
from flexspline.sim.plugin import transmission_at

from .convergence import callback
from .timing import measure

SECONDS = 10.0
_STEP = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_ssize_t] * 5)


def _python_loop(experiment: Experiment) -> None:
    scenario, record = experiment.scenario, experiment.record
    p, n = record[0], len(experiment.command)
    model = experiment.build()
    data = mujoco.MjData(model)
    plant.start(model, data)
    kinds = sensors.sensor_records(experiment.joint, 0.0, CONTROL_PERIOD)
    noise = sensors.noise(experiment.joint, scenario.seed, n, CONTROL_PERIOD)
    assert experiment.fed_back is not None
    compiled = experiment.fed_back.step(experiment.known, CONTROL_PERIOD)
    address, memory, known, settings, out = compiled.arrays()
    step, given = _STEP(address), np.full(1, np.nan, SAMPLE)
    addresses = [a.ctypes.data for a in (memory, given, known, settings, out)]
    controller, drive = scenario.controller.record(p, CONTROL_PERIOD, True)[0], np.zeros(3)
    seen, last = np.zeros((2, n)), 0.0
    substeps = round(CONTROL_PERIOD / scenario.timestep)
    for i in range(n):
        seen[0, i], seen[1, i] = data.qpos[0], data.qpos[2]
        sample = given[0]
        sample["time"], sample["interval"] = i * CONTROL_PERIOD, CONTROL_PERIOD if i else 0.0
        sample["current_command"] = last
        for s, name in enumerate(("motor_position", "link_position")):
            sample[name] = sensors.sample(seen[s], i, CONTROL_PERIOD, noise[name], kinds[s])
        step(*addresses)
        position, velocity = experiment.command[i], experiment.rate[i]
        command = control(position, velocity, sample["motor_position"], out[0], drive, CONTROL_PERIOD, controller)
        data.ctrl[0] = p["Kt"] * command
        mujoco.mj_step(model, data, nstep=substeps)
        transmission_at(data.qpos[:3].copy(), data.qvel[:3].copy(), 0.0, p)
        last = command


def _python_callback(steps: int):
    """The shipped MJCF under a passive-force callback in Python that does nothing: what every step then costs at least."""
    model = mujoco.MjModel.from_xml_path(str(load_joint("test-joint").mjcf))

    def run() -> None:
        with callback("mjcb_passive", None):
            mujoco.set_mjcb_passive(lambda m, d: None)
            try:
                mujoco.mj_step(model, mujoco.MjData(model), nstep=steps)
            finally:
                mujoco.set_mjcb_passive(None)

    return run


def main() -> None:
    """Print the times and their ratios."""
    experiment = Experiment.of(*load_scenario("no_load", [f"duration={SECONDS:g}", "feedback=RAREKF"]))
    with native.quiet():
        compiled = measure(experiment.simulate)
        python = measure(lambda: _python_loop(experiment), 3)
    print(f"closed loop, {SECONDS:g} s of no_load, RAREKF fed back")
    print(f"  compiled                 {compiled}")
    print(f"  loop in Python           {python}, without wrench and torque sensor; its parts compiled")
    print(f"  gain                     {python.median / compiled.median:.1f}")
    steps = round(SECONDS / experiment.scenario.timestep)
    callback = measure(_python_callback(steps), 3)
    print(f"  empty Python callback    {callback}: {steps} steps of the shipped MJCF")


if __name__ == "__main__":
    main()
