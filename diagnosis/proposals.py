"""What to measure next: from a measurement, or as a diagnosis wrote it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..models.errors import InputError
from ..models.files import check_format, read_json
from ..models.joint import Joint
from ..models.recording import Measurement
from . import diagnose, planning

_BY = 1.0
"""Time [s] after which the search begins no further stage: the calibration shows the open questions."""


def plan_from(
    measurement: Measurement, joint: Joint, progress: Callable[[str, float], None] = lambda stage, done: None
) -> planning.Plan:
    """Plan what to measure next, after a diagnosis of a few seconds.

    Args:
      measurement: the measurement. joint: its description.
      progress: called with the name of each stage and the share that is done.

    Raises:
      InputError: a measurement for which nothing can be planned.
    """
    found = diagnose.diagnose(measurement, joint, progress=lambda name, done: progress(name, 0.6 * done), seconds=_BY)
    if found.problem is None:
        raise InputError(f"{measurement.name}: nothing can be planned: {found.reason}")
    progress("what to measure next", 0.6)
    return planning.plan(measurement, found)


def read_proposals(folder: Path) -> list[dict[str, Any]]:
    """Read the proposals of a diagnosis.

    Raises:
      InputError: a file that is not a diagnosis.
    """
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
