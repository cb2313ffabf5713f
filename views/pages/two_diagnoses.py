"""The page of two diagnoses of one joint, before and after: what is gone, what is new, which numbers moved."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...models import causes, plugins
from ...models.calibration import slots
from ...models.errors import InputError
from ...models.files import check_format, read_json
from ...models.joint import Joint, Number, load_joint
from ...models.parameters import short_way
from ..glossary import meaning
from ..numbers import number, with_std
from ..report import listed, plain
from .provenance import file_digest
from .rendering import render

_DELAYS = ("current_delay", "torque_sensor_delay")
"""Delays of sensors that a diagnosis finds, by the names that it reports."""
MOVED = 3.0
"""Standard deviations of a difference from which on a number has moved."""


_Identity = tuple[str | float, ...]
"""Name of a cause, its whole numbers, and what an unknown one depends on."""


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis as its folder holds it.

    Attributes:
      folder: where it lies.
      answer: `diagnosis.json`.
      joint: `joint.yaml`, the extended joint.
    """

    folder: Path
    answer: dict[str, Any]
    joint: Joint

    @property
    def causes(self) -> dict[_Identity, dict[str, Any]]:
        """What was named, each with its `title`, by what tells it from others: orders of one cause are causes of their own."""
        return {_identity(cause): {**cause, "title": _title(cause)} for cause in self.answer["causes"]}


@dataclass(frozen=True)
class NumberChange:
    """A number in both diagnoses: as text, the difference in its own standard deviations, and what that means."""

    name: str
    unit: str
    meaning: str
    before: str
    after: str
    deviations: float

    @property
    def moved(self) -> bool:
        """Whether chance does not explain it."""
        return abs(self.deviations) > MOVED


def read_diagnosis(folder: Path) -> Diagnosed:
    """A diagnosis from its folder.

    Raises:
      InputError: a folder without one.
    """
    path = folder / "diagnosis.json"
    answer = read_json(path, "a diagnosis")
    check_format(answer, path)
    try:
        _check(answer)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: expected what flexspline diagnose writes, got something else") from error
    return Diagnosed(folder, answer, load_joint(str(folder / "joint.yaml")))


def _check(answer: dict[str, Any]) -> None:
    """Ask for all that the page shows of a diagnosis: an error of Python's where it is not there."""
    parameters = [p for cause in answer["causes"] for p in cause["parameters"].values()]
    delays = [delay for name, delay in answer.get("calibration", {}).items() if name in _DELAYS]
    errors = [*answer["residual"].values(), *(answer.get("estimation") or {}).get("estimators", {}).values()]
    numbers = [
        *(cause["confidence"] for cause in answer["causes"]),
        *(p["value"] for p in parameters),
        *(p["std"] for p in parameters if p["std"] is not None),
        *(delay[key] for delay in delays for key in ("nominal", "value", "std", "tolerance")),
        *(error["noise"] for error in answer["residual"].values()),
        *(error[key] for error in errors for key in ("before", "after") if error[key] is not None),
    ]
    texts = [
        answer["verdict"],
        *(cause[key] for cause in answer["causes"] for key in ("name", "component")),
        *(entry["unit"] for entry in (*parameters, *delays, *answer["residual"].values())),
        *(variable for cause in answer["causes"] for variable in cause.get("depends_on", ())),
    ]
    whole = isinstance(answer["undetermined"], list) and all(isinstance(text, str) for text in texts)
    if not whole or not all(math.isfinite(number) for number in numbers):
        raise TypeError


def _library(name: str) -> dict[str, causes.CauseParameter]:
    """Parameters of a cause as the library has it; none of one that it does not have, an unknown effect."""
    return {p.name: p for p in causes.get(name).parameters} if name in causes.names() else {}


def _whole(cause: dict[str, Any]) -> dict[str, float]:
    """A cause's whole numbers by name: its order."""
    known = _library(cause["name"])
    return {name: p["value"] for name, p in cause["parameters"].items() if name in known and known[name].integer}


def _identity(cause: dict[str, Any]) -> _Identity:
    return (cause["name"], *_whole(cause).values(), *cause.get("depends_on", ()))


def _title(cause: dict[str, Any]) -> str:
    """`cogging of order 2`, `backlash`, `unknown effect of motor position`."""
    if cause["name"] == "unknown":
        parts = [plain(variable) for variable in cause.get("depends_on", ())]
    else:
        parts = [f"{plain(name)} {value:g}" for name, value in _whole(cause).items()]
    name = "unknown effect" if cause["name"] == "unknown" else plain(cause["name"])
    return f"{name} of {listed(parts)}" if parts else name


def two_html(before: Diagnosed, after: Diagnosed) -> str:
    """Return the page as text: one file without references to others.

    Raises:
      InputError: diagnoses of two joints.
    """
    if before.joint.name != after.joint.name:
        raise InputError(
            f"{after.folder}: expected a diagnosis of {before.joint.name}, as {before.folder}, got one of {after.joint.name}"
        )
    return render("two_diagnoses.html.j2", _context(before, after))


def _context(before: Diagnosed, after: Diagnosed) -> dict[str, Any]:
    earlier, later = before.causes, after.causes
    gone = [cause for key, cause in earlier.items() if key not in later]
    new = [cause for key, cause in later.items() if key not in earlier]
    both = [(cause, later[key], _parameters(cause, later[key])) for key, cause in earlier.items() if key in later]
    numbers = [*_numbers(before.joint, after.joint), *_delays(before, after)]
    numbers = sorted(numbers, key=lambda change: -abs(change.deviations))
    moved = [change for change in numbers if change.moved]
    place = shlex.quote(after.folder.as_posix())
    return {
        "joint": before.joint.name,
        "sides": (before, after),
        "sentence": _sentence(gone, new, both, moved),
        "gone": [(cause, cause["name"] in after.answer["undetermined"]) for cause in gone],
        "new": [(cause, cause["name"] in before.answer["undetermined"]) for cause in new],
        "both": both,
        "numbers": numbers,
        "moved": moved,
        "chance": 0.0027 * len(numbers),
        "residuals": _residuals(before, after),
        "errors": _errors(before, after),
        "commands": [
            f"flexspline validate NEW_MEASUREMENT --joint {place}/joint.yaml --out check{plugins.options()}",
            f"flexspline plan {place}",
        ],
        "data": [(str(d.folder), file_digest(d.folder / "diagnosis.json")) for d in (before, after)],
    }


def _sentence(
    gone: list[dict[str, Any]],
    new: list[dict[str, Any]],
    both: list[tuple[dict[str, Any], dict[str, Any], list[NumberChange]]],
    moved: list[NumberChange],
) -> str:
    """What changed, in one sentence."""
    parts = []
    for found, what in ((gone, "gone"), (new, "new"), ([cause for cause, _, _ in both], "still there")):
        if found:
            parts.append(f"{listed([cause['title'] for cause in found])} {'is' if len(found) == 1 else 'are'} {what}")
    other = [cause["title"] for cause, _, changes in both if any(change.moved for change in changes)]
    if other:
        parts.append(f"{listed(other)} {'has' if len(other) == 1 else 'have'} changed")
    count = len(moved)
    parts.append(
        f"{count} number{'' if count == 1 else 's'} of the joint moved" if count else "no number of the joint moved"
    )
    text = listed(parts)
    return f"{text[:1].upper()}{text[1:]}."


def _change(
    name: str, unit: str, told: str, a: tuple[float, float], b: tuple[float, float], period: float = 0.0
) -> NumberChange:
    spread = math.hypot(a[1], b[1])
    difference = float(short_way(b[0] - a[0], period))
    deviations = (
        difference / spread if spread > 0 else (0.0 if difference == 0 else math.copysign(math.inf, difference))
    )
    return NumberChange(name, unit, told, with_std(*a, unit), with_std(*b, unit), deviations)


def _numbers(before: Joint, after: Joint) -> list[NumberChange]:
    """Numbers of the description that either diagnosis moved, with the standard deviations that their files state."""
    found, later = [], {slot.name: slot.number for slot in slots(after)}
    for slot in slots(before):
        a, b = slot.number, later.get(slot.name)
        if b is None or (a.std is None and b.std is None):
            continue
        unit = "" if a.unit == "1" else a.unit
        found.append(_change(slot.name, unit, meaning(slot.name), _known(a), _known(b), slot.period))
    return found


def _known(number: Number) -> tuple[float, float]:
    """Value of a number and how well it is known: what a diagnosis found, or else its tolerance."""
    spread = math.hypot(number.tolerance * abs(number.value), number.deviation)
    return number.value, spread if number.std is None else number.std


def _delays(before: Diagnosed, after: Diagnosed) -> list[NumberChange]:
    """Delays of sensors that either diagnosis found: in a description they have no standard deviation."""
    found = []
    a, b = (d.answer.get("calibration", {}) for d in (before, after))
    for name in _DELAYS:
        told = a.get(name) or b.get(name)
        if told is not None:
            # One that did not find it knows it as well as it was described.
            described = {"value": told["nominal"], "std": told["tolerance"]}
            x, y = (entry.get(name, described) for entry in (a, b))
            found.append(_change(name, told["unit"], meaning(name), (x["value"], x["std"]), (y["value"], y["std"])))
    return found


def _parameters(a: dict[str, Any], b: dict[str, Any]) -> list[NumberChange]:
    """Parameters of one cause in both, but for those that make it that cause."""
    found, known = [], _library(a["name"])
    for name, p in a["parameters"].items():
        q = b["parameters"].get(name)
        if q is not None and name not in _whole(a):
            period = known[name].period if name in known else 0.0
            values = (p["value"], p["std"] or 0.0), (q["value"], q["std"] or 0.0)
            found.append(_change(plain(name), p["unit"], "", *values, period))
    return found


def _cell(value: float | None) -> str:
    """An error for people; it is none where an estimator gave nothing finite."""
    return "–" if value is None else number(value, 3)


def _residuals(before: Diagnosed, after: Diagnosed) -> list[tuple[str, str, list[str]]]:
    """By channel: simulation error before and after extending the joint, in both measurements."""
    rows = []
    for name, a in before.answer["residual"].items():
        b = after.answer["residual"].get(name)
        if b is not None:
            cells = [_cell(x[key]) for x in (a, b) for key in ("before", "after", "noise")]
            rows.append((plain(name), a["unit"], cells))
    return rows


def _errors(before: Diagnosed, after: Diagnosed) -> list[tuple[str, list[str]]]:
    """By estimator: torque error before and after extending the joint [N·m], in both measurements."""
    found = [(d.answer.get("estimation") or {}).get("estimators", {}) for d in (before, after)]
    return [
        (name, [_cell(x[key]) for x in (a, found[1][name]) for key in ("before", "after")])
        for name, a in found[0].items()
        if name in found[1]
    ]
