"""`flexspline causes`: what a diagnosis can name."""

from __future__ import annotations

from ._listing import AsJson


def command(as_json: AsJson = False) -> None:
    """List the causes that a diagnosis can name and a study can hide, by component, with their parameters.

    Each is one file of `models/causes`, which has its law and where that comes from.
    """
    from ..models import causes
    from ._listing import Entry, show

    entries = {}
    for name in causes.names():
        cause = causes.get(name)
        parameters = ", ".join(p.name if p.unit == "1" else f"{p.name} [{p.unit}]" for p in cause.parameters)
        entries[name] = Entry(cause.component, cause.description, f"parameters: {parameters}")
    show("cause", entries, as_json)
