"""The page of two diagnoses of one joint: causes that are gone or new, and numbers that moved."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...models import causes
from ...models.calibration import slots
from ...models.command_lines import command_line
from ...models.errors import InputError
from ...models.joint import Joint, load_joint
from ...models.joint_parts import Number
from ...models.parameters import short_way
from ..glossary import meaning
from ..numbers import with_std
from ..report import listed, plain
from .rendering import file_digest, output_of, render

_DELAYS = ("current_delay", "torque_sensor_delay")
"""Delays of sensors that a diagnosis finds, by their names in its answer."""
FoundCause = dict[str, Any]  # of a diagnosis' answer
MOVED = 3.0  # A number has moved if it differs by more than so many standard deviations


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis from its folder."""

    folder: Path  # of the diagnosis
    answer: dict[str, Any]  # `diagnosis.json`
    joint: Joint  # `joint.yaml`, the extended joint

    @property
    def causes(self) -> dict[tuple[str | float, ...], FoundCause]:
        """Causes with `title`, by name, whole numbers, and variables of an unknown effect."""
        return {
            (cause["name"], *_orders(cause).values(), *cause.get("depends_on", ())): {**cause, "title": _title(cause)}
            for cause in self.answer["causes"]
        }

    @property
    def estimators(self) -> dict[str, dict[str, Any]]:
        """Torque errors [N·m] by estimator, before and after the extension of the joint; empty if there are none."""
        return (self.answer.get("estimation") or {}).get("estimators", {})


@dataclass(frozen=True)
class NumberChange:
    """A number in both diagnoses as text, and the difference in its standard deviations."""

    name: str
    unit: str
    meaning: str
    before: str
    after: str
    deviations: float

    @property
    def moved(self) -> bool:
        """Whether the difference is more than chance."""
        return abs(self.deviations) > MOVED


def read_diagnosis(folder: Path) -> Diagnosed:
    """Read a diagnosis from its folder. Raises `InputError`: a folder without a diagnosis."""
    with output_of(folder / "diagnosis.json", "diagnose") as answer:
        _check(answer)
    return Diagnosed(folder, answer, load_joint(str(folder / "joint.yaml")))


def _check(answer: dict[str, Any]) -> None:
    """Raise an error of Python if the page needs something that the answer does not have."""
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
    """Parameters of a cause in the library, by name; empty for an unknown cause."""
    return {p.name: p for p in causes.get(name).parameters} if name in causes.names() else {}


def _orders(cause: FoundCause) -> dict[str, float]:
    """Whole numbers of a cause by name."""
    known = _library(cause["name"])
    return {name: p["value"] for name, p in cause["parameters"].items() if name in known and known[name].integer}


def _title(cause: FoundCause) -> str:
    """`cogging of order 2`, `backlash`, `unknown effect of motor position`."""
    unknown = cause["name"] == "unknown"
    parts = [f"{plain(name)} {value:g}" for name, value in _orders(cause).items()]
    parts = [plain(variable) for variable in cause.get("depends_on", ())] if unknown else parts
    name = "unknown effect" if unknown else plain(cause["name"])
    return f"{name} of {listed(parts)}" if parts else name


def two_html(before: Diagnosed, after: Diagnosed) -> str:
    """Return the page as text: one file without references to others. Raises `InputError`: diagnoses of two joints."""
    if before.joint.name != after.joint.name:
        raise InputError(
            f"{after.folder}: expected a diagnosis of {before.joint.name}, as {before.folder}, got one of {after.joint.name}"
        )
    earlier, later = before.causes, after.causes
    gone = [cause for key, cause in earlier.items() if key not in later]
    new = [cause for key, cause in later.items() if key not in earlier]
    both = [(cause, later[key], [*_parameters(cause, later[key])]) for key, cause in earlier.items() if key in later]
    numbers = [*_numbers(before.joint, after.joint), *_delays(before, after)]
    numbers = sorted(numbers, key=lambda change: -abs(change.deviations))
    moved = [change for change in numbers if change.moved]
    context = {
        "joint": before.joint.name,
        "sides": (before, after),
        "sentence": _sentence(gone, new, both, moved),
        "gone": [(cause, cause["name"] in after.answer["undetermined"]) for cause in gone],
        "new": [(cause, cause["name"] in before.answer["undetermined"]) for cause in new],
        "both": both,
        "numbers": numbers,
        "moved": moved,
        "chance": 0.0027 * len(numbers),
        "residuals": _both(before.answer["residual"], after.answer["residual"]),
        "errors": _both(before.estimators, after.estimators),
        "commands": [
            command_line("validate", "NEW_MEASUREMENT", "--joint", after.folder / "joint.yaml", "--out", "check"),
            command_line("plan", after.folder),
        ],
        "data": [(str(d.folder), file_digest(d.folder / "diagnosis.json")) for d in (before, after)],
    }
    return render("two_diagnoses.html.j2", context)


def _sentence(
    gone: list[FoundCause],
    new: list[FoundCause],
    both: list[tuple[FoundCause, FoundCause, list[NumberChange]]],
    moved: list[NumberChange],
) -> str:
    parts = []
    for found, what in ((gone, "gone"), (new, "new"), ([cause for cause, _, _ in both], "still present")):
        if found:
            parts.append(f"{listed([cause['title'] for cause in found])} {'is' if len(found) == 1 else 'are'} {what}")
    other = [cause["title"] for cause, _, changes in both if any(change.moved for change in changes)]
    if other:
        parts.append(f"{listed(other)} {'has' if len(other) == 1 else 'have'} changed")
    parts.append(f"{len(moved) or 'no'} number{'s' if len(moved) > 1 else ''} of the joint moved")
    text = listed(parts)
    return f"{text[:1].upper()}{text[1:]}."


def _change(
    name: str, unit: str, meaning: str, a: tuple[float, float], b: tuple[float, float], period: float = 0.0
) -> NumberChange:
    spread = math.hypot(a[1], b[1])
    difference = float(short_way(b[0] - a[0], period))
    certain = 0.0 if difference == 0 else math.copysign(math.inf, difference)
    deviations = difference / spread if spread > 0 else certain
    return NumberChange(name, unit, meaning, with_std(*a, unit), with_std(*b, unit), deviations)


def _numbers(before: Joint, after: Joint) -> Iterator[NumberChange]:
    """Numbers of the description that either diagnosis moved."""
    later = {slot.name: slot.number for slot in slots(after)}
    for slot in slots(before):
        a, b = slot.number, later.get(slot.name)
        if b is not None and not (a.std is None and b.std is None):
            unit = "" if a.unit == "1" else a.unit
            yield _change(slot.name, unit, meaning(slot.name), _known(a), _known(b), slot.period)


def _known(number: Number) -> tuple[float, float]:
    """Value and standard deviation of a number, by a diagnosis or else by its tolerance."""
    spread = math.hypot(number.tolerance * abs(number.value), number.deviation)
    return number.value, spread if number.std is None else number.std


def _delays(before: Diagnosed, after: Diagnosed) -> Iterator[NumberChange]:
    """Delays of sensors that either diagnosis found; a description has no standard deviation of them."""
    sides = [d.answer.get("calibration", {}) for d in (before, after)]
    for name in _DELAYS:
        one = sides[0].get(name) or sides[1].get(name)
        if one is not None:
            described = {"value": one["nominal"], "std": one["tolerance"]}
            x, y = (side.get(name, described) for side in sides)
            yield _change(name, one["unit"], meaning(name), (x["value"], x["std"]), (y["value"], y["std"]))


def _parameters(a: FoundCause, b: FoundCause) -> Iterator[NumberChange]:
    """Parameters of a cause in both diagnoses, without its orders."""
    known = _library(a["name"])
    for name, p in a["parameters"].items():
        q = b["parameters"].get(name)
        if q is not None and name not in _orders(a):
            period = known[name].period if name in known else 0.0
            values = (p["value"], p["std"] or 0.0), (q["value"], q["std"] or 0.0)
            yield _change(plain(name), p["unit"], "", *values, period)


def _both(before: dict[str, Any], after: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    """Name and both errors of what both diagnoses have."""
    return [(name, error, after[name]) for name, error in before.items() if name in after]
