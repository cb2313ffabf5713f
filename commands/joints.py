"""`flexspline joints`: joints by name."""

from __future__ import annotations

from ._console import Entry, show
from ._options import AsJson

EXAMPLES = ("flexspline joints", "flexspline joints --json")


def command(as_json: AsJson = False) -> None:
    """List the joints of this package.

    A command that needs a joint takes one of these names, or the path of a YAML file.
    """
    from ..models.joint import known_joints, load_joint

    entries = {}
    for name, path in known_joints().items():
        joint = load_joint(name)
        ratio, rated = (joint.numbers[symbol].value for symbol in ("N", "rated_torque"))
        kind = f"ratio {ratio:g}, rated {rated:g} N·m, mountings {', '.join(joint.mountings)}"
        entries[name] = Entry(kind, joint.description, str(path))
    show("joint", entries, as_json)
