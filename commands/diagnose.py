"""`flexspline diagnose`: a measurement and a joint in, the cause out."""

from __future__ import annotations

import math
import shlex
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..models.errors import InputError
from ._listing import AsJson
from ._measurement import parted_measurement
from ._options import MeasurementPath, OtherJoint, ResultFolder, with_plugins

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.answer import Diagnosis, Finding
    from ..diagnosis.data.mistakes import Mistake
    from ..diagnosis.improvement import Improvement
    from ..models.joint import Joint
    from ..models.recording import Measurement

_SEARCHING = 0.7
"""Share of the time that is left for the search; estimating, planning and writing take the rest."""
_PLANNED = 3
"""Proposals of what to measure next that are shown."""
_REGIONS = 3
"""Regions that no fit saw that are shown."""

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
        bool, typer.Option("--exact", help="take the joint's numbers as exactly known: whatever differs is a cause")
    ] = False,
    seconds: Annotated[
        float | None, typer.Option("--time", min=0.0, metavar="SECONDS", help="answer with what is known by then")
    ] = None,
    report: Annotated[bool, typer.Option(help="write report.html and report.rrd")] = True,
    as_json: AsJson = False,
) -> None:
    """Say what the simulation gets wrong, name the cause, extend the joint, measure what that gains."""
    from ..models.files import json_text
    from ..models.output import check_output, output_folder
    from ._console import console, stages

    if seconds is not None and not seconds > 0:
        raise InputError(f"--time {seconds:g}: expected more than 0 s")
    data, described = parted_measurement(measurement, joint)
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
            gained = improvement(data, found)
            found = with_improvement(found, gained)
        if in_time():
            stage("what to measure next", 0.85)
            found = replace(found, plan=plan(data, found))
        stage("writing", 0.95)
        with output_folder(out, "diagnose", whole=True) as folder:
            answer = json_text({"format": 1, **found.to_json()})
            (folder / "diagnosis.json").write_text(answer + "\n", encoding="utf-8")
            found.extended.write(folder / "joint.yaml")
            if report:
                from ..views.pages import write_report
                from ..views.report import Report
                from ..views.rerun import write_rerun_report

                shown = Report(data, described, found, gained, found.plan, out)
                write_report(shown, folder / "report.html")
                write_rerun_report(shown, folder / "report.rrd")
    if as_json:
        print(answer)
        return
    show(console(), found, gained, data, described, out, report)


def _check_apart(measurement: Path, out: Path) -> None:
    """Refuse output among what is measured: inside a folder of recordings."""
    if measurement.is_dir() and out.resolve().is_relative_to(measurement.resolve()):
        raise InputError(f"--out {out}: expected a folder that is not in the measurement's, {measurement}")


def show(
    terminal: Console,
    found: Diagnosis,
    gained: Improvement | None,
    measurement: Measurement,
    joint: Joint,
    out: Path,
    report: bool,
) -> None:
    """Print the answer: what was found, how sure that is, what it is worth, what to do now; legible in 80 columns."""
    from ..views.report import further_reasons, look_alikes, plain, verdict_sentence

    page = _Page(terminal)
    page.say(found.verdict, verdict_sentence(found))
    for reason in further_reasons(found):
        page.item(reason)
    if found.mistakes:
        page.heading("Mistakes in the data")
        for m in found.mistakes:
            page.item(f"{plain(m.name)}: {_where(m)}{m.description} ({100 * m.confidence:.0f} % sure); {m.remedy}")
    for heading, findings in (("Causes", found.causes), ("There, but no cause of its own", found.minor)):
        if findings:
            page.heading(heading)
            for finding in findings:
                _cause(page, finding)
    if found.residual:
        page.heading("Error on data that no fit saw, RMS")
        rows = [
            (plain(name), f"{r.before:.3g}", f"{r.after:.3g}", f"{r.noise:.2g}", r.unit)
            for name, r in found.residual.items()
        ]
        if gained is not None:
            noise = f"{gained.noise:.2g}" if gained.noise else "–"
            rows += [
                (f"estimate, {plain(name)}", f"{before:.3g}", f"{after:.3g}", noise, "N·m")
                for name, (before, after) in gained.errors.items()
            ]
        page.table(("", "before", "after", "noise", ""), rows)
    if found.regions:
        page.heading("Where the fit has not been, the worst first, RMS")
        regions = [
            (r.name, f"{r.described:.3g}", f"{r.unseen:.3g}", "N·m", "worse than described" if r.worse else "")
            for r in found.regions[:_REGIONS]
        ]
        page.table(("", "described", "extended", "", ""), regions)
    if found.problem is not None:
        page.heading("What this measurement cannot tell")
        for name, others in look_alikes(found.confusable):
            page.item(f"look alike: {plain(name)} and {', '.join(plain(other) for other in others)}")
        if found.undetermined:
            page.item(f"could not have shown: {', '.join(plain(n) for n in found.undetermined)}")
        if not found.confusable and not found.undetermined:
            page.item("nothing: every known cause would have shown at ordinary size")
    if found.plan is not None and found.plan.proposals:
        page.heading("What to measure next")
        for number, sentence in enumerate(found.plan.sentences()[:_PLANNED], 1):
            page.item(sentence, f"{number}. ")
    page.heading("What to do now")
    for line in _commands(found, measurement, joint, out, report):
        terminal.print(f"  {line}", markup=False, highlight=False, soft_wrap=True)


def _cause(page: _Page, c: Finding) -> None:
    from ..views.report import title

    page.item(
        f"{title(c)} ({c.component}): {100 * c.confidence:.0f} % sure, explains {100 * c.explains:.0f} %, "
        f"worth {c.worth:.2g} N·m" + (f" ({c.estimation:.2g} of estimates)" if math.isfinite(c.estimation) else "")
    )
    if c.description:
        page.item(c.description, "    ")
    for name, p in c.parameters.items():
        spread = f" ± {p.std:.2g}" if p.std > 0 else ""
        page.item(f"{name} = {p.value:.4g}{spread} {p.unit}".rstrip(), "    ")


def _where(m: Mistake) -> str:
    places = [x for x in (m.recording, m.columns) if x]
    return f"{', '.join(places)}: " if places else ""


def _commands(found: Diagnosis, measurement: Measurement, joint: Joint, out: Path, report: bool) -> list[str]:
    """Command lines to go on with, to copy."""
    from ..models import plugins
    from ..models.command_lines import checking, mending

    measured, folder = shlex.quote(str(measurement.path)), shlex.quote(str(out))
    if any(m.severe for m in found.mistakes):
        return [(mending if found.mendable else checking)(measurement, joint)]
    lines = [f"flexspline view {folder}"] if report else []
    if not found.complete:
        lines.append("# time was up: the same command with more --time, or without, looks for what is left")
    if found.problem is not None:
        lines += [
            f"flexspline validate NEW_MEASUREMENT --joint {folder}/joint.yaml --out check{plugins.options()}",
            f"flexspline estimate {measured} --joint {folder}/joint.yaml --out estimates{plugins.options()}",
        ]
    return [*lines, f"flexspline plan {folder}"] if found.plan is not None and found.plan.proposals else lines


class _Page:
    """Text on a terminal, wrapped under its headings."""

    def __init__(self, terminal: Console):
        self.terminal = terminal

    def say(self, word: str, text: str) -> None:
        """A paragraph that begins with a word that counts."""
        from rich.text import Text

        start = Text(f"{word}: ", style="bold") if word else Text()
        self.terminal.print(start + Text(text), highlight=False)

    def heading(self, text: str) -> None:
        """A heading after an empty line."""
        from rich.text import Text

        self.terminal.print(Text(f"\n{text}", style="bold"), highlight=False)

    def item(self, text: str, mark: str = "") -> None:
        """Text under a heading; its further lines stand under its first word."""
        from rich.table import Table
        from rich.text import Text

        grid = Table.grid()
        grid.add_column(no_wrap=True)
        grid.add_column()
        grid.add_row(Text(f"  {mark}"), Text(text))
        self.terminal.print(grid, highlight=False)

    def table(self, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Rows under a heading, the first and the columns without a heading to the left."""
        from rich.table import Table
        from rich.text import Text

        table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
        for i, heading in enumerate(("", *headings)):
            table.add_column(Text(heading, style="dim"), justify="left" if i < 2 or not heading else "right")
        for row in rows:
            table.add_row("", *(Text(cell) for cell in row))
        self.terminal.print(table, highlight=False)
