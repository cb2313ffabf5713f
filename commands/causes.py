"""`flexspline causes`: causes of differences between a joint and its description."""

from __future__ import annotations

from ._console import Entry, show
from ._options import AsJson, with_plugins

EXAMPLES = ("flexspline causes", "flexspline causes --json --plugin my_cause.py")


@with_plugins
def command(as_json: AsJson = False) -> None:
    """List the causes that a diagnosis can name and a study can hide, with component and parameters.

    Sources are files of `models/causes`, with the law and its reference, installed packages, and files (`--plugin`).
    """
    from ..models import causes

    entries = {}
    for name in causes.names():
        cause = causes.get(name)
        parameters = ", ".join(p.name if p.unit == "1" else f"{p.name} [{p.unit}]" for p in cause.parameters)
        kind = f"{cause.component}; {parameters}"
        entries[name] = Entry(kind, cause.description, causes.origin(name).name)
    show("cause", entries, as_json)
