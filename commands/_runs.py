"""Running several scenarios with a progress bar: what `run` and `compare` share."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ..models.errors import InputError
from ..scenarios.run import Run, run_scenario, save_run
from ..scenarios.scenario import load_scenario


def run_all(
    names: list[str], out: Path, seed: int | None, changes: list[str] | None, figures: bool, recording: bool
) -> list[tuple[Run, Path]]:
    """Run scenarios one after the other into folders below `out`; all are read before the first is run."""
    loaded = [load_scenario(name, changes, seed) for name in names]
    seen: set[str] = set()
    for scenario, _ in loaded:
        if scenario.name in seen:
            raise InputError(f"scenario {scenario.name}: named twice; each writes to a folder of its name")
        seen.add(scenario.name)
    for scenario, folder in loaded:  # what cannot run is known before the first one does
        for joint in scenario.load_joint(folder):
            joint.mount(scenario.mounting or None)
    views = []
    if figures:
        from ..views.figures import save_figures

        views.append(lambda run, folder: save_figures(run, folder / "figures"))
    if recording:
        from ..views.rerun import write_rerun

        views.append(lambda run, folder: write_rerun(run, folder / "run.rrd"))
    finished = []
    with Progress(
        TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=Console(stderr=True), transient=True
    ) as progress:
        task = progress.add_task("", total=len(loaded) * 2)
        for scenario, folder in loaded:
            progress.update(task, description=f"{scenario.name}: simulating {scenario.duration:g} s")
            run = run_scenario(scenario, folder)
            progress.update(task, advance=1, description=f"{scenario.name}: writing")
            finished.append((run, save_run(run, out / scenario.name, views)))
            progress.update(task, advance=1)
    return finished
