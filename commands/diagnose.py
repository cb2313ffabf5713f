"""`flexspline diagnose`: a measurement and a joint in, the cause out."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..models.output import check_output, output_folder

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.diagnose import Diagnosis
    from ..diagnosis.improvement import Improvement


def command(
    measurement: Annotated[Path, typer.Argument(help="a recording, or a folder of several taken on the same joint")],
    out: Annotated[Path, typer.Option(help="folder to write to")],
    joint: Annotated[str | None, typer.Option(help="name of, or path to, a joint; the recordings' by default")] = None,
    exact: Annotated[
        bool, typer.Option("--exact", help="take the joint's numbers as exactly known: whatever differs is a cause")
    ] = False,
    report: Annotated[bool, typer.Option(help="write report.html and report.rrd")] = True,
) -> None:
    """Say what the simulation gets wrong, name the cause, extend the joint, measure what that gains."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from ..models.recording import read_measurement
    from ._console import console

    data = read_measurement(measurement)
    described = data.load_joint(joint)
    check_output(out, "diagnose", inputs=[*data.files, measurement, described.path], whole=True)
    bars = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*bars, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("loading")
        from ..diagnosis.diagnose import diagnose
        from ..diagnosis.improvement import improvement, with_improvement

        if exact:
            from ..diagnosis.trials.draw import exactly

            described = exactly(described)
        seconds = sum(r.time[-1] - r.time[0] for r in data.recordings)
        progress.update(
            task, description=f"{data.name}: diagnosing {seconds:.0f} s in {len(data.recordings)} recording(s)"
        )
        found = diagnose(data, described)
        progress.update(task, description=f"{data.name}: estimating torque before and after")
        gained = improvement(data, described, found)
        found = with_improvement(found, gained)
        with output_folder(out, "diagnose", whole=True) as folder:
            answer = json.dumps(finite(found.to_json()), indent=1, ensure_ascii=False, allow_nan=False)
            (folder / "diagnosis.json").write_text(answer + "\n", encoding="utf-8")
            found.extended.write(folder / "joint.yaml")
            if report:
                from ..views.pages import write_report
                from ..views.report import Report
                from ..views.rerun import write_rerun_report

                progress.update(task, description=f"{data.name}: writing the report")
                shown = Report(data, described, found, gained, None, out)
                write_report(shown, folder / "report.html")
                write_rerun_report(shown, folder / "report.rrd")
    _show(console(), found, gained)
    names = ["diagnosis.json", "joint.yaml", *(["report.html", "report.rrd"] if report else [])]
    console().print(f"{out}: {', '.join(names)}", highlight=False)


def finite(value: Any) -> Any:
    """The same data with null for numbers that are not finite, which JSON does not have."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _show(terminal: Console, found: Diagnosis, gained: Improvement | None) -> None:
    from rich.table import Table

    from ..views.report import verdict_sentence

    terminal.print(f"[bold]{found.verdict}[/]: {verdict_sentence(found)}", highlight=False)
    if found.causes:
        table = Table(title="causes")
        for heading in ("cause", "component", "confidence", "explains", "parameters"):
            table.add_column(heading)
        for c in found.causes:
            text = "; ".join(f"{k} {p.value:.4g} ± {p.std:.2g} {p.unit}".strip() for k, p in c.parameters.items())
            if c.name == "unknown":
                text = c.description
            table.add_row(c.name, c.component, f"{c.confidence:.2f}", f"{100 * c.explains:.0f} %", text)
        terminal.print(table)
    table = Table(title="error on data that no fit saw (RMS)")
    table.add_column("")
    for heading in ("before", "after", "noise", "unit"):
        table.add_column(heading, justify="right" if heading != "unit" else "left")
    for name, r in found.residual.items():
        table.add_row(name.replace("_", " "), f"{r.before:.4g}", f"{r.after:.4g}", f"{r.noise:.4g}", r.unit)
    if gained is not None:
        for name, (before, after) in gained.errors.items():
            table.add_row(f"torque estimate, {name}", f"{before:.4g}", f"{after:.4g}", f"{gained.noise:.4g}", "N·m")
    terminal.print(table)
    if found.calibration:
        terminal.print(f"calibration moved {len(found.calibration)} numbers within their tolerance", highlight=False)
    for pair in found.confusable:
        terminal.print(f"cannot be told apart: {' and '.join(pair)}", highlight=False)
    if found.undetermined:
        terminal.print(f"could not have shown: {', '.join(found.undetermined)}", highlight=False)
