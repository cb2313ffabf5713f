"""`flexspline diagnose`: why a measurement differs from a joint's description."""

from __future__ import annotations

import math
import shlex
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..models.errors import InputError
from ._listing import AsJson
from ._measurement import load_measurement
from ._options import MeasurementPath, OtherJoint, ResultFolder, with_plugins

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.answer import Diagnosis
    from ..diagnosis.data.mistakes import Mistake
    from ..diagnosis.improvement import Improvement
    from ..views.report import Report

_SEARCHING = 0.7
"""Share of the time for the search; estimation, planning and writing take the rest."""
_PLANNED, _REGIONS = 3, 3
"""Proposals and regions that are shown."""

EXAMPLES = (
    "flexspline diagnose measurement --out diagnosis",
    "flexspline diagnose measurement --joint my_joint.yaml --time 60 --out diagnosis --json",
)


@with_plugins
def command(
    measurement: MeasurementPath,
    out: ResultFolder,
    joint: OtherJoint = None,
    exact: Annotated[
        bool, typer.Option("--exact", help="take the joint's numbers as exactly known: any difference is a cause")
    ] = False,
    seconds: Annotated[
        float | None, typer.Option("--time", min=0.0, metavar="SECONDS", help="answer with what is known by then")
    ] = None,
    report: Annotated[bool, typer.Option(help="write report.html and report.rrd")] = True,
    as_json: AsJson = False,
) -> Any:
    """Diagnose why a measurement differs from a joint's description: causes, how grave they are, and what to do.

    Writes `joint.yaml`, the description with the causes in it, `diagnosis.json`, and a report.
    """
    from ..models.files import json_text
    from ..models.memory import give_back_free_pages, give_back_large_arrays
    from ..models.output import check_output, output_folder
    from ._console import console, stages

    give_back_large_arrays()
    if seconds is not None and not seconds > 0:
        raise InputError(f"--time {seconds:g}: expected more than 0 s")
    data, described = load_measurement(measurement, joint)
    _check_apart(measurement, out)
    check_output(out, "diagnose", inputs=[*data.files, measurement, described.path], whole=True)
    if exact:
        from ..diagnosis.trials.draw import exactly

        described = exactly(described)
    begin = time.monotonic()
    budget = math.inf if seconds is None else seconds

    def in_time() -> bool:
        return time.monotonic() - begin < budget

    with stages(f"diagnosing {data.name}") as stage:
        from ..diagnosis.diagnose import diagnose
        from ..diagnosis.improvement import improvement, with_improvement
        from ..diagnosis.planning import plan

        found = diagnose(
            data, described, progress=lambda name, done: stage(name, 0.7 * done), seconds=_SEARCHING * budget
        )
        gained = None
        if in_time():
            stage("estimating torque before and after", 0.7)
            gained = improvement(found.used or data, found)
            found = with_improvement(found, gained)
        if in_time():
            stage("what to measure next", 0.85)
            found = replace(found, plan=plan(data, found))
        stage("writing", 0.95)
        give_back_free_pages()
        with output_folder(out, "diagnose", whole=True) as folder:
            answer = {"format": 1, **found.to_json()}
            (folder / "diagnosis.json").write_text(json_text(answer) + "\n", encoding="utf-8")
            found.extended.write(folder / "joint.yaml")
            from ..views.report import Report

            shown = Report(data, described, found, gained, found.plan, out)
            if report:
                from ..diagnosis.bode import excited_response
                from ..views.pages import write_report
                from ..views.rerun import write_rerun_report

                response = excited_response(shown.used, found.extended) if found.problem is not None else None
                write_report(replace(shown, response=response), folder / "report.html")
                write_rerun_report(shown, folder / "report.rrd")
    if as_json:
        return answer
    show(console(), shown, report)


def _check_apart(measurement: Path, out: Path) -> None:
    """Refuse output among what is measured: inside a folder of recordings."""
    if measurement.is_dir() and out.resolve().is_relative_to(measurement.resolve()):
        raise InputError(f"--out {out}: expected a folder that is not in the measurement's, {measurement}")


def show(terminal: Console, report: Report, written: bool) -> None:
    """Print the answer in 80 columns: what is wrong, how grave it is, how sure, what to do; then the rest.

    Args:
      report: to print; written: whether it was written, too.
    """
    from ..views.report import confused_with, further_reasons, gravity_sentence, plain, verdict_sentence

    found, gained = report.diagnosis, report.improvement
    page = _Page(terminal)
    page.say(found.verdict, verdict_sentence(found))
    if found.causes:
        page.say("", gravity_sentence(found, gained))
    for reason in further_reasons(found):
        page.item(reason)
    if found.mistakes:
        page.heading("Mistakes in the data")
        for m in found.mistakes:
            page.item(f"{plain(m.name)}: {_where(m)}{m.description} ({100 * m.confidence:.0f} % sure); {m.remedy}")
    _show_causes(page, found)
    _show_errors(page, found, gained)
    if found.problem is not None:
        page.heading("What this measurement does not show")
        for name, others in confused_with(found.confusable):
            page.item(f"confounded: {name} with {', '.join(others)}")
        if found.undetermined:
            page.item(f"could not have shown: {', '.join(plain(n) for n in found.undetermined)}")
        if not found.confusable and not found.undetermined:
            page.item("every known cause would have shown at ordinary size")
    if found.plan is not None and found.plan.proposals:
        page.heading("What to measure next")
        for number, sentence in enumerate(found.plan.sentences()[:_PLANNED], 1):
            page.item(sentence, f"{number}. ")
    page.heading("What to do now")
    for line in _commands(report, written):
        terminal.print(f"  {line}", markup=False, highlight=False, soft_wrap=True)


def _show_causes(page: _Page, found: Diagnosis) -> None:
    from ..views.advice import parameter_text
    from ..views.report import advice_lines, share_line, title

    for heading, findings in (("Causes", found.causes), ("Minor effects", found.minor)):
        if findings:
            page.heading(heading)
        for c in findings:
            page.item(f"{title(c)} ({c.component}): {share_line(c, found)}")
            lines = [c.description] if c.description else []
            lines += [f"{name} = {parameter_text(name, c, found.extended)}" for name in c.parameters]
            for line in (*lines, *(advice_lines(c, found) if heading == "Causes" else ())):
                page.item(line, "    ")


def _show_errors(page: _Page, found: Diagnosis, gained: Improvement | None) -> None:
    from ..views.report import HELD_OUT, held_out_rows

    if found.residual:
        page.heading("RMS error on held-out data")
        rows = held_out_rows(found, gained)
        cells = [(name, f"{a:.3g}", f"{b:.3g}", f"{noise:.2g}" if noise else "–", u) for name, a, b, noise, u in rows]
        page.table(("", *HELD_OUT[1:], ""), cells)
    if found.regions:
        page.heading("RMS error in regions that no fit saw, the worst first")
        regions = [
            (r.name, f"{r.described:.3g}", f"{r.unseen:.3g}", "N·m", "worse than described" if r.worse else "")
            for r in found.regions[:_REGIONS]
        ]
        page.table(("", "described", "extended", "", ""), regions)


def _where(m: Mistake) -> str:
    places = [x for x in (m.recording, m.columns) if x]
    return f"{', '.join(places)}: " if places else ""


def _commands(report: Report, written: bool) -> list[str]:
    from ..models import plugins
    from ..models.command_lines import checking, mending

    found, measurement = report.diagnosis, report.measurement
    measured, folder = shlex.quote(str(measurement.path)), shlex.quote(str(report.folder))
    if any(m.severe for m in found.mistakes):
        return [(mending if found.mendable else checking)(measurement, report.joint)]
    lines = [f"flexspline view {folder}"] if written else []
    if not found.complete:
        lines.append("# the time was up: run it again with more --time, or without, to complete the search")
    if found.problem is not None:
        lines += [
            f"flexspline validate NEW_MEASUREMENT --joint {folder}/joint.yaml --out check{plugins.options()}",
            f"flexspline estimate {measured} --joint {folder}/joint.yaml --out estimates{plugins.options()}",
        ]
    return [*lines, f"flexspline plan {folder}"] if found.plan is not None and found.plan.proposals else lines


class _Page:
    """Text on a terminal, wrapped below its headings."""

    def __init__(self, terminal: Console):
        self.terminal = terminal

    def say(self, word: str, text: str) -> None:
        """Print a paragraph that begins with a bold word."""
        from rich.text import Text

        start = Text(f"{word}: ", style="bold") if word else Text()
        self.terminal.print(start + Text(text), highlight=False)

    def heading(self, text: str) -> None:
        """Print a heading after an empty line."""
        from rich.text import Text

        self.terminal.print(Text(f"\n{text}", style="bold"), highlight=False)

    def item(self, text: str, mark: str = "") -> None:
        """Print a text with its lines aligned below its first word."""
        from rich.table import Table
        from rich.text import Text

        grid = Table.grid()
        grid.add_column(no_wrap=True)
        grid.add_column()
        grid.add_row(Text(f"  {mark}"), Text(text))
        self.terminal.print(grid, highlight=False)

    def table(self, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print rows; the first column and columns without a heading are aligned to the left."""
        from rich.table import Table
        from rich.text import Text

        table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
        for i, heading in enumerate(("", *headings)):
            table.add_column(Text(heading, style="dim"), justify="left" if i < 2 or not heading else "right")
        for row in rows:
            table.add_row("", *(Text(cell) for cell in row))
        self.terminal.print(table, highlight=False)
