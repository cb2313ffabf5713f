"""`flexspline report`: one self-contained page of a result, to send to a colleague."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ._listing import AsJson
from ._options import with_plugins

EXAMPLES = (
    "flexspline report runs/external_push",
    "flexspline report runs --out comparison.html",
    "flexspline report before after --out repair.html",
    "flexspline report validation --out validation.html",
    "flexspline report sweep --out study.html",
    "flexspline report contact --out contact.html",
)


@with_plugins
def command(
    folders: Annotated[
        list[Path],
        typer.Argument(
            help="of a run, an arm's run, a comparison, a diagnosis, a validation, a sweep or contact; or two diagnoses of a "
            "joint, before and after",
            metavar="FOLDER [FOLDER]",
        ),
    ],
    out: Annotated[Path, typer.Option(help="the page, an HTML file without references to others")] = Path(
        "report.html"
    ),
    as_json: AsJson = False,
) -> Any:
    """Write one self-contained page of a run, a comparison, a diagnosis, a validation, a sweep or contact; or of two diagnoses.

    It begins with the result, its confidence and what to do, and ends with its sources. Charts zoom, show values and hide lines.
    It is readable in light and dark mode, on a phone and on paper.
    """
    from ._console import console
    from ._pages import write_page

    write_page(folders, out)
    if as_json:
        return {"page": str(out), "of": [str(folder) for folder in folders]}
    console().print(f"{out}")
