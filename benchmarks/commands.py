"""Wall and core time of whole commands, the second time, when nothing is left to compile.

In turns with them run their baselines: an interpreter that imports NumPy, Numba and MuJoCo, and bare MuJoCo with the models of
the scenarios. Targets are for an idle machine with two cores.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from .timing import alternately, program, verdict

REPEATS = 3
FLEXSPLINE = [sys.executable, "-m", "flexspline"]
QUICK = ["--no-figures", "--no-recording"]
_BARE = """
import sys
import mujoco
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim import native, plant
with native.quiet():
    for name in sys.argv[1:]:
        experiment = Experiment.of(*load_scenario(name))
        model = experiment.build()
        data = mujoco.MjData(model)
        plant.start(model, data)
        mujoco.mj_step(model, data, nstep=round(experiment.scenario.duration / experiment.scenario.timestep))
"""
PAPER = ("no_load", "link_sweep", "external_push")


def main() -> None:
    """Print times of every command, its ratio to its baseline and whether it meets its target."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)

        def flexspline(*words: str):
            return program([*FLEXSPLINE, *words], cwd=out)

        functions = {
            "python": program([sys.executable, "-c", "pass"], cwd=out),
            "imports": program([sys.executable, "-c", "import numpy, numba, mujoco"], cwd=out),
            "steps of no_load": program([sys.executable, "-c", _BARE, "no_load"], cwd=out),
            "steps of all three": program([sys.executable, "-c", _BARE, *PAPER], cwd=out),
            "--help": flexspline("--help"),
            "scenarios": flexspline("scenarios"),
            "run no_load, quick": flexspline("run", "no_load", "--out", "quick", *QUICK),
            "run no_load": flexspline("run", "no_load", "--out", "whole"),
            "compare": flexspline("compare", "--out", "all"),
        }
        t = alternately(functions, REPEATS)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    print(f"whole commands in a fresh process, compiled before; medians of {REPEATS}, {cores} cores")
    print("  baselines                              wall      cores' time")
    for name, label in (
        ("python", "bare interpreter"), ("imports", "with numpy, numba, mujoco imported"),
        ("steps of no_load", "MuJoCo steps no_load's model, 82 s"), ("steps of all three", "the models of all three, 162 s"),
    ):  # fmt: skip
        print(f"    {label:36s} {t[name].median:6.2f} s  {t[name].core:6.2f} s")
    print("  commands                               wall      cores' time   / baseline (wall)")
    targets = {  # wall time [s] but for --help, whose target is the cores' time
        "--help": ("python", None, 0.5), "scenarios": ("imports", None, None),
        "run no_load, quick": ("steps of no_load", 2.8, None), "run no_load": ("steps of no_load", 4.0, None),
        "compare": ("steps of all three", 8.0, None),
    }  # fmt: skip
    for name, (baseline, wall, core) in targets.items():
        timing = t[name]
        ratio = timing.median / t[baseline].median
        line = f"    flexspline {name:25s} {timing.median:6.2f} s  {timing.core:6.2f} s     {ratio:5.2f} × {baseline}"
        if wall is not None:
            line += f" (target ≤ {wall:g} s: {verdict(timing.median <= wall)})"
        if core is not None:
            line += f" (target ≤ {core:g} s of a core: {verdict(timing.core <= core)})"
        print(line)
