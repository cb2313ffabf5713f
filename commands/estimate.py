"""`flexspline estimate`: joint torque and external torque of a measurement, by every estimator."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from ..diagnosis.estimate import ESTIMATORS, Score, estimate, score, write_estimates
from ..models.errors import InputError
from ..models.files import write_into_place
from ..sim.recording import read_measurement
from ._console import console


def command(
    measurement: Annotated[Path, typer.Argument(help="a recording, or a folder of several")],
    out: Annotated[Path, typer.Option(help="folder to write to")],
    joint: Annotated[str | None, typer.Option(help="name of, or path to, a joint; the recordings' by default")] = None,
) -> None:
    """Estimate the torques of a measurement without reading its torque sensor; score where there is one."""
    data = read_measurement(measurement)
    described = data.load_joint(joint)
    for recording in data.recordings:
        if recording.source and (out / f"{recording.name}.parquet").resolve() == Path(recording.source).resolve():
            raise InputError(f"{out}: expected another folder than the measurement's, its recordings would be replaced")
    terminal = console()
    report: dict[str, dict] = {}
    for recording in data.recordings:
        estimates = estimate(recording, described)
        path = write_estimates(estimates, out)
        scores = score(recording, estimates, described)
        report[recording.name] = {
            "joint": described.name,
            "notes": estimates.notes,
            **{what: {name: asdict(s) for name, s in found.items()} for what, found in scores.items()},
        }
        terminal.print(f"{path}", highlight=False)
        if scores:
            terminal.print(_table(recording.name, recording.external, scores))
    with write_into_place(out / "metrics.json") as temporary:
        temporary.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    terminal.print(f"{out / 'metrics.json'}", highlight=False)


def _table(name: str, external: str, scores: dict[str, dict[str, Score]]) -> Table:
    table = Table(title=Text(f"{name}: error [N·m], all of the time and in motion"))
    table.add_column("estimator")
    headings = {
        "joint_torque": "joint torque",
        "external_torque": "external torque" + (" (there was none)" if external == "none" else ""),
    }
    for what in scores:
        table.add_column(f"{headings[what]}, RMS", justify="right")
        table.add_column("in motion", justify="right")
    for estimator in ESTIMATORS:
        cells = []
        for found in scores.values():
            cells += [f"{found[estimator].rms:.3f}", f"{found[estimator].rms_moving:.3f}"]
        table.add_row(estimator, *cells)
    return table
