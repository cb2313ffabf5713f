"""`flexspline estimators`: estimators by name."""

from __future__ import annotations

from ._listing import AsJson


def command(as_json: AsJson = False) -> None:
    """List the estimators: this package's, and those that installed packages add.

    Scenarios, studies and `estimate` take them by these names; causal ones can also feed torque back in the loop.
    """
    from ..estimator import registry
    from ._listing import Entry, show

    entries = {}
    for name in registry.names():
        one = registry.get(name)
        kind = f"{'causal' if one.causal else 'not causal'}; reads {', '.join(one.needs)}"
        package = type(one).__module__.split(".")[0]
        entries[name] = Entry(kind, one.description, "" if package == __name__.split(".")[0] else f"of {package}")
    show("estimator", entries, as_json)
