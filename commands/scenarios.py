"""`flexspline scenarios`: what can be run."""

from __future__ import annotations


def command() -> None:
    """List the scenarios that come with the testbed."""
    from rich.table import Table

    from ..scenarios.scenario import load_scenario, shipped_scenarios
    from ._console import console

    table = Table("scenario", "joint", "mounting", "duration", "paper", "what happens")
    for name in shipped_scenarios():
        s, _ = load_scenario(name)
        table.add_row(name, s.joint, s.mounting, f"{s.duration:g} s", s.figure, s.description.strip())
    console().print(table)
