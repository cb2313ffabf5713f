"""Running several scenarios side by side with a progress bar: what `run` and `compare` share."""

from __future__ import annotations

import importlib
import os
import shlex
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..models.errors import InputError
from ._console import progress
from ._drawing import drawing

if TYPE_CHECKING:
    from rich.console import Console

    from ..scenarios.arms.arm_scenario import ArmScenario
    from ..scenarios.run import Run
    from ..scenarios.scenario import Scenario

_TUNED_FOR = "test-joint"
"""The joint for which the estimators' defaults were tuned."""
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
    _each_once([scenario.name for scenario, _ in loaded])
    return loaded


def _each_once(names: list[str]) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"scenario {name}: expected each scenario once, got it twice")


def run_all(
    names: list[str], out: Path, seed: int | None, changes: list[str] | None, figures: bool, recording: bool
) -> list[tuple[Run, Path]]:
    """Run scenarios on as many threads as there are cores, into folders below `out`; all are read before the first is run."""
    views = [name for name, wanted in (("figures", figures), ("recording", recording)) if wanted]
    with drawing(views, len(names)) as begin:
        from ..scenarios.arms.arm_run import run_arm, save_arm
        from ..scenarios.arms.arm_scenario import ArmScenario, load_any
        from ..scenarios.run import run_scenario
        from ..scenarios.run_folder import check_run_folder, save_run

        loaded = [load_any(name, changes, seed) for name in names]
        _each_once([scenario.name for scenario, _ in loaded])
        # What cannot run is known before the first does.
        for scenario, source in loaded:
            own = out / scenario.name
            places: list[tuple[Scenario, Path]] = (
                [(joint, own / joint.name) for joint in scenario.arm]
                if isinstance(scenario, ArmScenario)
                else [(scenario, own)]
            )
            for joint, place in places:
                for described in joint.load_joint(source.parent):
                    joint.mount(described)
                check_run_folder(joint, source, place, out)
        cores = os.cpu_count() or 1
        at_once = min(cores, len(loaded))
        pool = ThreadPoolExecutor(at_once, thread_name_prefix="run")
        with progress() as bar:
            task = bar.add_task("simulating", total=len(loaded) * 2)

            def one(scenario: Scenario | ArmScenario, source: Path) -> list[tuple[Run, Path]]:
                place, threads = out / scenario.name, max(1, cores // at_once)
                if isinstance(scenario, ArmScenario):
                    runs = run_arm(scenario, source.parent, threads)
                    bar.update(task, advance=1, description=f"{scenario.name}: writing")
                    saved = list(zip(runs.values(), save_arm(scenario, runs, place, begin, out), strict=True))
                else:
                    run = run_scenario(scenario, source.parent, threads)
                    bar.update(task, advance=1, description=f"{scenario.name}: writing")
                    saved = [(run, save_run(run, place, begin, out))]
                bar.update(task, advance=1)
                return saved

            futures = [pool.submit(one, scenario, source) for scenario, source in loaded]
            for module in _LATER:  # a simulation that is under way does not hold the interpreter's lock
                importlib.import_module(module)
            try:
                return [found for future in futures for found in future.result()]
            except Exception:
                pool.shutdown(cancel_futures=True)
                raise
            finally:  # whoever interrupts does not wait for a simulation that is under way
                pool.shutdown(wait=False, cancel_futures=True)


def metrics_of(runs: list[tuple[Run, Path]]) -> dict[str, Any]:
    """For programs: by scenario the folder, what whoever reads the measures should know, and the measures."""
    return {run.name: {"folder": str(folder), "notes": list(run.notes), **run.metrics} for run, folder in runs}


def tell(terminal: Console, runs: list[tuple[Run, Path]]) -> None:
    """Print what whoever reads the runs' measures should know; and how to tune what misjudges itself on a joint of one's own."""
    from ..models import plugins
    from ..views.tables import misjudged

    for run, folder in runs:
        for note in run.notes:
            terminal.print(f"{run.name}: {note}", style="yellow")
        off = misjudged(run.metrics)
        if off and run.joint.name != _TUNED_FOR:
            listed = ", ".join(f"{name} {nis:.2g}" for name, nis in off.items())
            place = shlex.quote((folder / "scenario.yaml").as_posix())
            terminal.print(
                f"{run.name}: mean NIS is not about 1: {listed}. Tune for this joint: "
                f"flexspline tune {place} --filter {next(iter(off))} --out tuned{plugins.options()}"
            )
