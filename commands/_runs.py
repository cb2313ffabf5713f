"""Running several scenarios at the same time: what `run` and `compare` share."""

from __future__ import annotations

import importlib
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..models.errors import check_each_once
from ._console import progress

if TYPE_CHECKING:
    from rich.console import Console

    from ..scenarios.arms.arm_scenario import ArmScenario
    from ..scenarios.run import Run
    from ..scenarios.scenario import Scenario

_TUNED_FOR = "test-joint"  # the joint for which the estimators' defaults were tuned
PAPER = ["no_load", "link_sweep", "external_push"]  # the paper's three experiments


def load_all(names: list[str], changes: list[str] | None) -> list[tuple[Scenario, Path]]:
    """Load scenarios, with the folders of their files. Raises `InputError`: a scenario that is wrong, or named twice."""
    from ..scenarios.scenario import load_scenario

    loaded = [load_scenario(name, changes) for name in names]
    check_each_once([scenario.name for scenario, _ in loaded], "scenarios")
    return loaded


def run_all(
    names: list[str], out: Path, seed: int | None, changes: list[str] | None, figures: bool, recording: bool
) -> list[tuple[Run, Path]]:
    """Run scenarios, one per core, into folders below `out`. All are read and checked before the first one runs."""
    from ..scenarios.arms.arm_run import run_arm, save_arm
    from ..scenarios.arms.arm_scenario import ArmScenario, load_any
    from ..scenarios.run import run_scenario
    from ..scenarios.run_folder import save_run

    loaded = [load_any(name, changes, seed) for name in names]
    check_each_once([scenario.name for scenario, _ in loaded], "scenarios")
    for scenario, source in loaded:
        _check(scenario, source, out)
    views = [view for view, wanted in ((_draw_figures, figures), (_write_recording, recording)) if wanted]
    threading.Thread(target=_import, args=(figures, recording), daemon=True).start()
    cores = os.cpu_count() or 1
    at_once = min(cores, len(loaded))
    with progress() as bar:
        task = bar.add_task("simulating", total=len(loaded) * 2)

        def one(scenario: Scenario | ArmScenario, source: Path) -> list[tuple[Run, Path]]:
            place, threads = out / scenario.name, max(1, cores // at_once)
            if isinstance(scenario, ArmScenario):
                runs = run_arm(scenario, source.parent, threads)
                bar.update(task, advance=1, description=f"{scenario.name}: writing")
                saved = list(zip(runs.values(), save_arm(scenario, runs, place, views, out), strict=True))
            else:
                run = run_scenario(scenario, source.parent, threads)
                bar.update(task, advance=1, description=f"{scenario.name}: writing")
                saved = [(run, save_run(run, place, views, out))]
            bar.update(task, advance=1)
            return saved

        pool = ThreadPoolExecutor(at_once, thread_name_prefix="run")
        futures = [pool.submit(one, scenario, source) for scenario, source in loaded]
        try:
            return [found for future in futures for found in future.result()]
        except Exception:
            pool.shutdown(cancel_futures=True)
            raise


def _import(figures: bool, recording: bool) -> None:
    """Import the libraries for drawing while scenarios run: simulations do not hold the interpreter's lock."""
    package = __name__.partition(".")[0]
    for name, wanted in (("figures.paper", figures), ("figures.run", figures), ("rerun", recording)):
        if wanted:
            importlib.import_module(f"{package}.views.{name}")


_drawing = threading.Lock()  # held while figures are drawn: matplotlib's settings are those of the whole process


def _draw_figures(run: Run, folder: Path) -> None:
    from ..views.figures import save_figures

    with _drawing:
        save_figures(run, folder / "figures")


def _write_recording(run: Run, folder: Path) -> None:
    from ..views.rerun import write_rerun

    write_rerun(run, folder / "run.rrd")


def _check(scenario: Scenario | ArmScenario, source: Path, out: Path) -> None:
    """Refuse a scenario that cannot run or be written, before any scenario runs."""
    from ..scenarios.arms.arm_scenario import ArmScenario
    from ..scenarios.run_folder import check_run_folder

    place, arm = out / scenario.name, isinstance(scenario, ArmScenario)
    if isinstance(scenario, ArmScenario) and scenario.model is not None:
        scenario.masses(source.parent)
    for joint in scenario.arm if isinstance(scenario, ArmScenario) else [scenario]:
        folder = place / joint.name if arm else place
        for described in joint.load_joint(source.parent):
            joint.mount(described)
        check_run_folder(joint, source, folder, out)


def metrics_of(runs: list[tuple[Run, Path]]) -> dict[str, Any]:
    """Return by scenario the folder, the notes and the metrics, for `--json`."""
    return {run.name: {"folder": str(folder), "notes": list(run.notes), **run.metrics} for run, folder in runs}


def print_notes(terminal: Console, runs: list[tuple[Run, Path]]) -> None:
    """Print notes on the metrics; and how to tune filters whose variance is wrong for this joint."""
    from ..models.command_lines import command_line
    from ..views.tables import misjudged

    for run, folder in runs:
        for note in run.notes:
            terminal.print(f"{run.name}: {note}", style="yellow")
        off = misjudged(run.metrics)
        if off and run.joint.name != _TUNED_FOR:
            listed = ", ".join(f"{name} {nis:.2g}" for name, nis in off.items())
            tune = command_line("tune", folder / "scenario.yaml", "--filter", next(iter(off)), "--out", "tuned")
            terminal.print(f"{run.name}: mean NIS is not about 1: {listed}. Tune for this joint: {tune}")
