"""Commands that list what there is by name: scenarios, studies, joints, estimators, causes, sensors."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ._console import console
from ._options import AsJson, with_plugins

EXAMPLES = {
    "scenarios": ("flexspline scenarios", "flexspline scenarios --json"),
    "studies": ("flexspline studies", "flexspline studies --json"),
    "joints": ("flexspline joints", "flexspline joints --json"),
    "estimators": ("flexspline estimators", "flexspline estimators --plugin my_filter.py --json"),
    "causes": ("flexspline causes", "flexspline causes --json --plugin my_cause.py"),
    "sensors": ("flexspline sensors", "flexspline sensors --plugin my_sensor.py --json"),
}


def scenarios(as_json: AsJson = False) -> Any:
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
    return _show("scenario", entries, as_json)


def studies(as_json: AsJson = False) -> Any:
    """List the studies of this package; `flexspline sweep` takes one of these names, or the path of a YAML file."""
    from ..scenarios.studies.design import Design
    from ..scenarios.studies.study import load_study, shipped_studies

    entries = {}
    for name, path in shipped_studies().items():
        study, folder = load_study(name)
        kind = f"{study.seeds.count} seeds, {Design.of(study, folder).runs} runs"
        entries[name] = Entry(kind, study.description, str(path))
    return _show("study", entries, as_json)


def joints(as_json: AsJson = False) -> Any:
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
    return _show("joint", entries, as_json)


@with_plugins
def estimators(as_json: AsJson = False) -> Any:
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
    return _show("estimator", entries, as_json)


@with_plugins
def causes(as_json: AsJson = False) -> Any:
    """List the causes that a diagnosis can name and a study can hide, with component and parameters.

    Sources are files of `models/causes`, with the law and its reference, installed packages, and files (`--plugin`).
    """
    from ..models import causes as library

    entries = {}
    for name in library.names():
        cause = library.get(name)
        parameters = ", ".join(p.name if p.unit == "1" else f"{p.name} [{p.unit}]" for p in cause.parameters)
        entries[name] = Entry(f"{cause.component}; {parameters}", cause.description, library.origin(name).name)
    return _show("cause", entries, as_json)


@with_plugins
def sensors(as_json: AsJson = False) -> Any:
    """List the channels of sensors: those of every joint, and those of plugins (`--plugin`)."""
    from ..models import own_sensors
    from ..models.signals import CHANNELS

    entries = {c.name: Entry(c.unit, c.description, "flexspline") for c in CHANNELS.values() if c.sensor}
    for name in own_sensors.names():
        sensor = own_sensors.get(name)
        entries[name] = Entry(sensor.unit, sensor.description, own_sensors.origin(name).name)
    return _show("channel", entries, as_json)


@dataclass(frozen=True)
class Entry:
    """An entry of a list: its kind in a few words, a line of description, and its source."""

    kind: str
    description: str
    source: str


def _show(what: str, entries: Mapping[str, Entry], as_json: bool) -> Mapping[str, Entry] | None:
    """Print a list in 80 columns, or return it for JSON; `what`: heading of the names."""
    if as_json:
        return entries
    from rich.table import Table
    from rich.text import Text

    terminal = console()
    table = Table(box=None, show_edge=False, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    longest = max(map(len, entries), default=0)
    table.add_column(what, no_wrap=longest <= terminal.width // 3, overflow="fold", style="bold")
    table.add_column("", overflow="fold")
    for name, entry in entries.items():
        text = Text.assemble((f"{entry.kind}. " if entry.kind else "", "dim"), _first_sentence(entry.description))
        if entry.source and entry.source != __name__.split(".")[0]:
            text.append(f" ({_line(entry.source)})", style="dim")
        table.add_row(Text(name), text)
    terminal.print(table)
    return None


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[\w)]{2}\.) (?=[A-Zθ])", _line(text))[0].rstrip(".")


def _line(text: str) -> str:
    return " ".join(text.split())
