"""Running several scenarios side by side with a progress bar: what `run` and `compare` share."""

from __future__ import annotations

import importlib
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..models.errors import InputError
from ._console import progress
from ._drawing import drawing

if TYPE_CHECKING:
    from rich.console import Console

    from ..scenarios.run import Run
    from ..scenarios.scenario import Scenario

PAPER = ["no_load", "link_sweep", "external_push"]
"""The paper's three experiments."""


_LATER = ("pyarrow.parquet", f"{__name__.partition('.')[0]}.views.tables")
"""What is needed once a scenario has been run."""


def load_all(names: list[str], changes: list[str] | None, seed: int | None = None) -> list[tuple[Scenario, Path]]:
    """Scenarios with the folders of their files.

    Raises:
      InputError: one that is wrong, or that is named twice.
    """
    from ..scenarios.scenario import load_scenario

    loaded = [load_scenario(name, changes, seed) for name in names]
    seen: set[str] = set()
    for scenario, _ in loaded:
        if scenario.name in seen:
            raise InputError(f"scenario {scenario.name}: expected each scenario once, got it twice")
        seen.add(scenario.name)
    return loaded


def run_all(
    names: list[str], out: Path, seed: int | None, changes: list[str] | None, figures: bool, recording: bool
) -> list[tuple[Run, Path]]:
    """Run scenarios on as many threads as there are cores, into folders below `out`; all are read before the first is run."""
    views = [name for name, wanted in (("figures", figures), ("recording", recording)) if wanted]
    with drawing(views, len(names)) as begin:
        from ..scenarios.run import run_scenario
        from ..scenarios.run_folder import check_run_folder, save_run
        from ..scenarios.scenario import source_of

        loaded = load_all(names, changes, seed)
        # What cannot run is known before the first does.
        for name, (scenario, folder) in zip(names, loaded, strict=True):
            for joint in scenario.load_joint(folder):
                joint.mount(scenario.mounting or None)
            check_run_folder(scenario, source_of(name), out / scenario.name, out)
        cores = os.cpu_count() or 1
        at_once = min(cores, len(loaded))
        pool = ThreadPoolExecutor(at_once, thread_name_prefix="run")
        with progress() as bar:
            task = bar.add_task("simulating", total=len(loaded) * 2)

            def one(scenario: Scenario, folder: Path) -> tuple[Run, Path]:
                run = run_scenario(scenario, folder, max(1, cores // at_once))
                bar.update(task, advance=1, description=f"{scenario.name}: writing")
                saved = save_run(run, out / scenario.name, begin, out)
                bar.update(task, advance=1)
                return run, saved

            futures = [pool.submit(one, scenario, folder) for scenario, folder in loaded]
            for module in _LATER:  # a simulation that is under way does not hold the interpreter's lock
                importlib.import_module(module)
            try:
                return [future.result() for future in futures]
            except Exception:
                pool.shutdown(cancel_futures=True)
                raise
            finally:  # whoever interrupts does not wait for a simulation that is under way
                pool.shutdown(wait=False, cancel_futures=True)


def metrics_of(runs: list[tuple[Run, Path]]) -> dict[str, Any]:
    """For programs: by scenario the folder, what whoever reads the measures should know, and the measures."""
    return {run.name: {"folder": str(folder), "notes": list(run.notes), **run.metrics} for run, folder in runs}


def tell(terminal: Console, runs: list[tuple[Run, Path]]) -> None:
    """Print what whoever reads the runs' measures should know."""
    for run, _ in runs:
        for note in run.notes:
            terminal.print(f"{run.name}: {note}", style="yellow")
