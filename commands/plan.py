"""`flexspline plan`: what to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ..models.errors import InputError
from ._console import console, stages
from ._measurement import load_measurement
from ._options import AsJson, OtherJoint, argument, with_plugins

EXAMPLES = ("flexspline plan measurement", "flexspline plan diagnosis --json")


@with_plugins
def command(
    source: Annotated[Path, argument("a measurement, or the folder of a diagnosis", metavar="MEASUREMENT|DIAGNOSIS")],
    joint: OtherJoint = None,
    as_json: AsJson = False,
) -> Any:
    """Find out what to measure next: candidate experiments are simulated, and ranked by their expected information."""
    from ..diagnosis.proposals import plan_from, read_proposals

    diagnosed = (source / "diagnosis.json").is_file()
    if diagnosed and joint is not None:
        raise InputError(
            f"--joint: expected with a measurement, got it with the diagnosis {source}, which has its own joint"
        )
    if diagnosed:
        proposals = read_proposals(source)
    else:
        data, described = load_measurement(source, joint)
        with stages(f"diagnosing {data.name}") as stage:
            proposals = plan_from(data, described, stage).to_json()
    if as_json:
        return proposals
    terminal = console()
    if not proposals:
        terminal.print("no candidate experiment adds information")
    for number, one in enumerate(proposals, 1):
        terminal.print(f"{number}. {one['sentence']}")
