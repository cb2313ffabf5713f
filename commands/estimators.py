"""`flexspline estimators`: estimators by name."""

from __future__ import annotations

from ._console import Entry, show
from ._options import AsJson, with_plugins

EXAMPLES = ("flexspline estimators", "flexspline estimators --plugin my_filter.py --json")


@with_plugins
def command(as_json: AsJson = False) -> None:
    """List the estimators of this package, of installed packages and of files (`--plugin`).

    Scenarios, studies and `estimate` use these names. Causal estimators can also feed torque back in the loop.
    """
    from ..estimator import registry
    from ..models.step import PythonStep

    entries = {}
    for name in registry.names():
        one = registry.get(name)
        slow = ", in plain Python: slow" if isinstance(getattr(one, "compiled", None), PythonStep) else ""
        kind = f"{'causal' if one.causal else 'not causal'}{slow}; reads {', '.join(one.needs)}"
        entries[name] = Entry(kind, one.description, registry.origin(name).name)
    show("estimator", entries, as_json)
