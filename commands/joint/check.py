"""`flexspline joint check`: all errors of a description."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...models.errors import one_line
from .._options import AsJson, argument, with_plugins

if TYPE_CHECKING:
    from ...models.joint_check import Fault

EXAMPLES = ("flexspline joint check my_joint.yaml", "flexspline joint check my_joint.yaml --json")


@with_plugins
def command(
    joint: Annotated[str, argument("A joint description, or the name of a shipped one.", metavar="FILE")],
    as_json: AsJson = False,
) -> None:
    """Check a joint description: print all errors, and warnings of implausible values, a line each.

    Exit code 2 if there are errors: commands refuse the file, or its numbers contradict each other.
    """
    from ...models.files import json_text
    from ...models.joint_check import check

    checked = check(joint)
    warnings = len(checked.problems) - checked.errors
    if as_json:
        found = {
            "file": str(checked.path),
            "errors": checked.errors,
            "warnings": warnings,
            "problems": checked.problems,
        }
        print(json_text(found))
    else:
        for problem in checked.problems:
            print(line(checked.path, problem))
        print(f"{checked.path}: {_count(checked.errors, 'error')}, {_count(warnings, 'warning')}")
    if checked.errors:
        raise typer.Exit(2)


def line(path: Path, problem: Fault) -> str:
    """Return a problem as a line, with the meaning of its symbol."""
    from ...models.files import place
    from ...models.joint_parts import SYMBOLS
    from ...views.glossary import meaning

    text = f"{place(path, problem.field)}: {problem.severity}: {problem.field}: {problem.message}"
    symbol = problem.field.removeprefix("numbers.").split(".")[0]
    if problem.field.startswith("numbers.") and meaning(symbol):
        unit = SYMBOLS[symbol][0] if symbol in SYMBOLS else ""
        text += (
            f" ({meaning(symbol)}{f', in {unit}' if unit not in ('', '1') and problem.message == 'missing' else ''})"
        )
    return one_line(text)


def _count(number: int, what: str) -> str:
    return f"{number or 'no'} {what}{'' if number == 1 else 's'}"
