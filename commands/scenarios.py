"""`flexspline scenarios`: scenarios by name."""

from __future__ import annotations

from ._console import Entry, show
from ._options import AsJson

EXAMPLES = ("flexspline scenarios", "flexspline scenarios --json")


def command(as_json: AsJson = False) -> None:
    """List the scenarios of this package; commands take one of these names, or the path of a YAML file."""
    from ..scenarios.arms.arm_scenario import load_arm
    from ..scenarios.scenario import load_scenario, shipped_arms, shipped_scenarios

    entries = {}
    for name in shipped_scenarios():
        s, _ = load_scenario(name)
        mounting = f", mounting {s.mounting}" if s.mounting else ""
        paper = f"; {s.figure} of the paper" if s.figure else ""
        entries[name] = Entry(f"{s.joint}{mounting}, {s.duration:g} s{paper}", s.description, "")
    for name in shipped_arms():
        arm, _ = load_arm(name)
        joints = ", ".join(f"{joint.name} {joint.joint}" for joint in arm.arm)
        entries[name] = Entry(f"an arm: {joints}; {arm.duration:g} s; for `run`", arm.description, "")
    show("scenario", entries, as_json)
