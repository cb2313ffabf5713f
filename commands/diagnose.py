"""`flexspline diagnose`: why a measurement differs from a joint's description."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from ..models.errors import InputError
from ..models.output import check_output, output_folder
from ._console import console, stages
from ._measurement import load_measurement
from ._options import AsJson, MeasurementPath, OtherJoint, ResultFolder, option, with_plugins

if TYPE_CHECKING:
    from rich.console import Console

    from ..views.report import Report

_SEARCHING = 0.7  # share of the time for the search; estimation, planning and writing take the rest

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
        bool, option("take the joint's numbers as exactly known: any difference is a cause", "--exact")
    ] = False,
    seconds: Annotated[
        float | None, option("answer with what is known by then", "--time", min=0.0, metavar="SECONDS")
    ] = None,
    report: Annotated[bool, option("write report.html and report.rrd")] = True,
    as_json: AsJson = False,
) -> Any:
    """Diagnose why a measurement differs from a joint's description: causes, how grave they are, and what to do.

    Writes `joint.yaml`, the description with the causes in it, `diagnosis.json`, and a report.
    """
    from ..models.chunks import give_back_free_pages, give_back_large_arrays
    from ..models.files import write_json, write_text

    give_back_large_arrays()
    if seconds is not None and not seconds > 0:
        raise InputError(f"--time {seconds:g}: expected more than 0 s")
    data, described = load_measurement(measurement, joint)
    if measurement.is_dir() and out.resolve().is_relative_to(measurement.resolve()):
        raise InputError(f"--out {out}: expected a folder that is not in the measurement's, {measurement}")
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
            write_json(folder / "diagnosis.json", answer)
            found.extended.write(folder / "joint.yaml")
            from ..views.report import Report

            shown = Report(data, described, found, gained, found.plan, out)
            if report:
                from ..diagnosis.bode import excited_response
                from ..views.pages.diagnosis import html
                from ..views.rerun import write_rerun_report

                response = excited_response(shown.used, found.extended) if found.problem is not None else None
                write_text(folder / "report.html", html(replace(shown, response=response)))
                write_rerun_report(shown, folder / "report.rrd")
    if as_json:
        return answer
    show(console(), shown, report)


def show(terminal: Console, report: Report, written: bool) -> None:
    """Print the answer, and what to do now; `written`: whether the report was written, too."""
    from rich.markdown import Markdown

    from ..views.report import markdown

    terminal.print(Markdown(markdown(report)))
    terminal.print("\nWhat to do now", style="bold")
    for line in _commands(report, written):
        terminal.print(f"  {line}", markup=False, highlight=False, soft_wrap=True)


def _commands(report: Report, written: bool) -> list[str]:
    from ..models.command_lines import checking, command_line, mending

    found, folder = report.diagnosis, report.folder
    if any(m.severe for m in found.mistakes):
        return [(mending if found.mendable else checking)(report.measurement, report.joint)]
    lines = [command_line("view", folder)] if written else []
    if not found.complete:
        lines.append("# the time was up: run it again with more --time, or without, to complete the search")
    if found.problem is not None:
        lines += [report.validating, report.estimating]
    return [*lines, command_line("plan", folder)] if found.plan is not None and found.plan.proposals else lines
