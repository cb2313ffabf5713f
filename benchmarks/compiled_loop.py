"""What compiling the closed loop buys: the same ten seconds with the loop in Python, around the same compiled parts."""

from __future__ import annotations

import ctypes

import mujoco
import numpy as np
from flexspline.estimator import FilterSettings, compliance_torque, filter_bank, start_bank, update_bank, workspace
from flexspline.models.joint import load_joint
from flexspline.scenarios.loop import CONTROL_PERIOD
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim import native, plant, sensors
from flexspline.sim.callbacks import transmission
from flexspline.sim.drive import control

from .timing import measure

SECONDS = 10.0


def _python_loop(scenario, folder) -> None:
    joint, known = scenario.load_joint(folder)
    mounting = joint.mount(scenario.mounting)
    record, calibration = joint.record(mounting), known.record(mounting)
    p, k = record[0], calibration[0]
    model = plant.build(joint, mounting, timestep=scenario.timestep, record=record)
    data = mujoco.MjData(model)
    plant.start(model, data)
    position, velocity = scenario.commands()
    kinds = sensors.sensor_records(joint, 0.0)
    n = len(position)
    noise = sensors.noise(scenario.seed, n)
    settings = [choice.settings() if hasattr(choice, "settings") else FilterSettings() for choice in scenario.filters]
    bank = filter_bank(settings)
    states = start_bank(bank, np.zeros((len(settings), 1)), np.array([[[s.P0]] for s in settings]))
    work = workspace(1, 1)
    controller, drive = scenario.controller.record(p, CONTROL_PERIOD, False)[0], np.zeros(3)
    seen, y, last = np.zeros((2, n)), np.zeros((len(settings), 1)), 0.0
    substeps = round(CONTROL_PERIOD / scenario.timestep)
    for i in range(n):
        seen[0, i], seen[1, i] = data.qpos[0], data.qpos[2]
        motor, link = (sensors.sample(seen[s], i, CONTROL_PERIOD, noise[s], kinds[s]) for s in range(2))
        y[:] = compliance_torque(motor, link, k["Kt"] * last, k)
        update_bank(states, y, bank, work)
        command = control(position[i], velocity[i], motor, 0.0, drive, CONTROL_PERIOD, controller)
        data.ctrl[0] = p["Kt"] * command
        mujoco.mj_step(model, data, nstep=substeps)
        transmission(data.qpos, data.qvel, 0.0, p)
        last = command


def _python_callback(steps: int):
    """The shipped MJCF under a passive-force callback in Python that does nothing: what every step then costs at least."""
    model = mujoco.MjModel.from_xml_path(str(load_joint("test-joint").mjcf))

    def run() -> None:
        ours = ctypes.c_void_p.in_dll(native.library(), "mjcb_passive").value
        mujoco.set_mjcb_passive(lambda m, d: None)
        try:
            mujoco.mj_step(model, mujoco.MjData(model), nstep=steps)
        finally:
            mujoco.set_mjcb_passive(None)
            native.install("mjcb_passive", ours)

    return run


def main() -> None:
    """Print the times and their ratios."""
    scenario, folder = load_scenario("no_load", [f"duration={SECONDS:g}"])
    compiled = measure(lambda: run_scenario(scenario, folder))
    python = measure(lambda: _python_loop(scenario, folder), 3)
    print(f"closed loop, {SECONDS:g} s of no_load")
    print(f"  compiled                 {compiled}")
    print(f"  loop in Python           {python}, without wrench and torque sensor; its parts compiled")
    print(f"  gain                     {python.median / compiled.median:.1f}")
    steps = round(SECONDS / scenario.timestep)
    callback = measure(_python_callback(steps), 3)
    print(f"  empty Python callback    {callback}: {steps} steps of the shipped MJCF")
