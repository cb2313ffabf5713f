"""Time of a run's figures and its Rerun recording: 80 s at 1 kHz with four filters."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario

from .timing import measure, verdict

REPEATS = 3
FIGURES = 1.0
"""Target: wall time of all figures [s] once matplotlib is loaded, at most."""
RECORDING = 0.5
"""Target: wall time of the recording [s] once Rerun is loaded, at most."""


def main() -> None:
    """Print the wall times, and the time to load matplotlib and Rerun."""
    begin = time.perf_counter()
    import matplotlib.figure  # noqa: F401

    loaded = time.perf_counter()
    from flexspline.views.figures import save_figures

    plots = time.perf_counter()
    from flexspline.views.rerun import write_rerun

    recordings = time.perf_counter()
    print(f"loading matplotlib {loaded - begin:.2f} s, Rerun {recordings - plots:.2f} s")
    for name in ("no_load", "external_push"):
        run = run_scenario(*load_scenario(name, ["duration=80"]))
        assert run.metrics  # the captions' numbers are the run's work, not the figures'
        with tempfile.TemporaryDirectory() as folder:
            count = len(save_figures(run, Path(folder)))
            drawn = measure(lambda run=run, folder=folder: save_figures(run, Path(folder)), REPEATS)
            recorded = measure(lambda run=run, folder=folder: write_rerun(run, Path(folder) / "run.rrd"), REPEATS)
            size = (Path(folder) / "run.rrd").stat().st_size
        print(f"{name}, {run.time[-1] - run.time[0]:.0f} s")
        print(f"  {count} figures  {drawn} (target ≤ {FIGURES:g} s: {verdict(drawn.median <= FIGURES)})")
        print(
            f"  recording  {recorded}, {size / 1e6:.1f} MB (target ≤ {RECORDING:g} s: {verdict(recorded.median <= RECORDING)})"
        )
