"""`flexspline plan`: what to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..models.errors import InputError
from ._measurement import load_measurement
from ._options import OtherJoint, with_plugins

_BY = 1.0
"""Time [s] after which the search begins no further stage: the calibration shows the open questions."""

EXAMPLES = (
    "flexspline plan measurement",
    "flexspline plan diagnosis --json",
)


@with_plugins
def command(
    source: Annotated[
        Path, typer.Argument(help="a measurement, or the folder of a diagnosis", metavar="MEASUREMENT|DIAGNOSIS")
    ],
    joint: OtherJoint = None,
    as_json: Annotated[bool, typer.Option("--json", help="print it as JSON")] = False,
) -> None:
    """Find out what to measure next: candidate experiments are simulated, and ranked by their expected information."""
    from ..models.files import json_text
    from ._console import console

    diagnosed = (source / "diagnosis.json").is_file()
    if diagnosed and joint is not None:
        raise InputError(
            f"--joint: expected with a measurement, got it with the diagnosis {source}, which has its own joint"
        )
    proposals = _of_diagnosis(source) if diagnosed else _of_measurement(source, joint)
    if as_json:
        print(json_text(proposals))
        return
    terminal = console()
    if not proposals:
        terminal.print("no candidate experiment adds information")
    for number, one in enumerate(proposals, 1):
        terminal.print(f"{number}. {one['sentence']}")


def _of_diagnosis(folder: Path) -> list[dict[str, Any]]:
    """Read the proposals of a diagnosis.

    Raises:
      InputError: a file that is not a diagnosis.
    """
    from ..models.files import check_format, read_json

    path = folder / "diagnosis.json"
    answer = read_json(path, "a diagnosis")
    check_format(answer, path)
    try:
        proposals = [{**one, "sentence": str(one["sentence"])} for one in answer["next"]]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: next: expected proposals, found none; plan from the measurement instead") from error
    if not proposals and not answer.get("residual"):
        raise InputError(f"{path}: nothing could be planned: {answer.get('reason') or 'nothing was fitted'}")
    return proposals


def _of_measurement(source: Path, option: str | None) -> list[dict[str, Any]]:
    """Compute the proposals for a measurement, after a diagnosis of a few seconds."""
    from ..diagnosis.diagnose import diagnose
    from ..diagnosis.planning import plan
    from ._console import stages

    data, described = load_measurement(source, option)
    with stages(f"diagnosing {data.name}") as stage:
        found = diagnose(data, described, progress=lambda name, done: stage(name, 0.6 * done), seconds=_BY)
        if found.problem is None:
            raise InputError(f"{source}: nothing can be planned: {found.reason}")
        stage("what to measure next", 0.6)
        return plan(data, found).to_json()
