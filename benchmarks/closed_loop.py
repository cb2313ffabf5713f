"""The 80 s no-load scenario with the paper's filters, and MuJoCo alone with the same model for as long, in turns."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

import mujoco

from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim import native, plant

from .timing import alternately, verdict

SECONDS = 80.0
REAL_TIME = 40.0
"""Target: times real time, at least."""
RATIO = 1.2
"""Target: times bare MuJoCo, at most."""


def main() -> None:
    """Print wall and core time, × real time and ratios to bare MuJoCo, with the clock that it asks and without."""
    scenario, folder = load_scenario("no_load", [f"duration={SECONDS:g}"])
    joint, _ = scenario.load_joint(folder)
    steps = round(SECONDS / scenario.timestep)

    def bare(model: mujoco.MjModel, ours: bool, clock: bool = True) -> Callable[[], None]:
        def run() -> None:
            data = mujoco.MjData(model)
            if ours:
                plant.start(model, data)
            with nullcontext() if clock else native.untimed():
                mujoco.mj_step(model, data, nstep=steps)

        return run

    same = plant.build(joint, joint.mount(scenario.mounting), timestep=scenario.timestep)
    shipped = mujoco.MjModel.from_xml_path(str(joint.mjcf))
    shipped.opt.timestep = scenario.timestep
    with native.quiet():
        t = alternately(
            {
                "closed loop": lambda: run_scenario(scenario, folder),
                "MuJoCo, the same model": bare(same, True),
                "the same without its clock": bare(same, True, clock=False),
                "MuJoCo, the shipped MJCF": bare(shipped, False),
            }
        )
    loop = t["closed loop"]
    speed, ratio = SECONDS / loop.median, loop.core / t["MuJoCo, the same model"].core
    names = ", ".join(f.name for f in scenario.filters)
    print(f"no_load, {SECONDS:g} s, {names} over its signals, {steps} steps of {scenario.timestep * 1e3:g} ms")
    notes = {
        "MuJoCo, the same model": f": mj_step(m, d, {steps}), the joint's laws as its plugin",
        "the same without its clock": ": `mjcb_time` is constant, as in the closed loop",
        "MuJoCo, the shipped MJCF": ": linear springs, no plugin",
    }
    for name, timing in t.items():
        print(f"  {name:27s} {timing}{notes.get(name, '')}")
    print(f"  × real time                 {speed:.0f} (target ≥ {REAL_TIME:g}: {verdict(speed >= REAL_TIME)})", end="")
    print(f"; {SECONDS / loop.core:.0f} by the core's time")
    print(
        f"  ratio to bare MuJoCo        {ratio:.2f} by the core's time (target ≤ {RATIO:g}: {verdict(ratio <= RATIO)})"
    )
    for name in list(t)[2:]:
        print(f"  to {name:24s} {loop.core / t[name].core:.2f}")
