"""The 80 s no-load scenario with the paper's filters, beside MuJoCo alone stepping the same model for as long."""

from __future__ import annotations

import mujoco

from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim import native, plant

from .timing import measure, verdict

SECONDS = 80.0
REAL_TIME = 40.0
"""Target: times real time, at least."""
RATIO = 4.0
"""Target: times bare MuJoCo, at most."""


def main() -> None:
    """Print wall time, × real time and the ratio to bare MuJoCo."""
    scenario, folder = load_scenario("no_load", [f"duration={SECONDS:g}"])
    joint, _ = scenario.load_joint(folder)
    steps = round(SECONDS / scenario.timestep)

    def bare(model: mujoco.MjModel, prepare=lambda data: None):
        def run() -> None:
            data = mujoco.MjData(model)
            prepare(data)
            mujoco.mj_step(model, data, nstep=steps)

        return run

    ours = plant.build(joint, joint.mount(scenario.mounting), timestep=scenario.timestep)
    shipped = mujoco.MjModel.from_xml_path(str(joint.mjcf))
    shipped.opt.timestep = scenario.timestep
    with native.quiet():
        loop = measure(lambda: run_scenario(scenario, folder))
        same = measure(bare(ours, lambda data: plant.start(ours, data)))
        plain = measure(bare(shipped))
    speed, ratio = SECONDS / loop.median, loop.median / same.median
    names = ", ".join(f.name for f in scenario.filters)
    print(f"no_load, {SECONDS:g} s, {names} over its signals, {steps} steps of {scenario.timestep * 1e3:g} ms")
    print(f"  closed loop              {loop}")
    print(f"  MuJoCo, the same model   {same}: mj_step(m, d, {steps}), the joint's laws as its callback")
    print(f"  MuJoCo, the shipped MJCF {plain}: linear springs, no callback")
    print(f"  × real time              {speed:.0f} (target ≥ {REAL_TIME:g}: {verdict(speed >= REAL_TIME)})", end="")
    print(f"; {SECONDS / loop.core:.0f} by the core's time")
    print(f"  ratio to bare MuJoCo     {ratio:.2f} (target ≤ {RATIO:g}: {verdict(ratio <= RATIO)})", end="")
    print(f"; to the shipped MJCF {loop.median / plain.median:.2f}")
