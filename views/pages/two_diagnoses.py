"""The page of two diagnoses of one joint, before and after: what is gone, what is new, which numbers moved."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from ...models.errors import InputError
from ...models.files import check_format, read_json
from ...models.joint import Joint, load_joint
from ..glossary import meaning
from ..report import listed, plain
from .provenance import file_digest, now
from .rendering import number, render, squeezed, with_std

MOVED = 3.0
"""Standard deviations of a difference from which on a number has moved."""


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
    def causes(self) -> dict[str, dict[str, Any]]:
        """What was named, by name."""
        return {cause["name"]: cause for cause in self.answer["causes"]}


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
        {cause["name"]: cause["parameters"] for cause in answer["causes"]}
        answer["verdict"], answer["residual"], answer["undetermined"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected what flexspline diagnose writes, got something else") from error
    return Diagnosed(folder, answer, load_joint(str(folder / "joint.yaml")))


def two_html(before: Diagnosed, after: Diagnosed) -> str:
    """The page as text: one file that refers to nothing outside itself.

    Raises:
      InputError: diagnoses of two joints.
    """
    if before.joint.name != after.joint.name:
        raise InputError(
            f"{after.folder}: expected a diagnosis of {before.joint.name}, as {before.folder}, got one of {after.joint.name}"
        )
    return squeezed(render("two_diagnoses.html.j2", _context(before, after)))


def _context(before: Diagnosed, after: Diagnosed) -> dict[str, Any]:
    gone = [name for name in before.causes if name not in after.causes]
    new = [name for name in after.causes if name not in before.causes]
    both = [name for name in before.causes if name in after.causes]
    numbers = sorted(_numbers(before.joint, after.joint), key=lambda change: -abs(change.deviations))
    moved = [change for change in numbers if change.moved]
    blind = [name for name in gone if name in after.answer["undetermined"]]
    unseen = [name for name in new if name in before.answer["undetermined"]]
    parameters = {name: _parameters(before.causes[name], after.causes[name]) for name in both}
    place = shlex.quote(after.folder.as_posix())
    return {
        "joint": before.joint.name,
        "sides": (before, after),
        "sentence": _sentence(gone, new, both, moved, parameters),
        "gone": [(before.causes[name], name in blind) for name in gone],
        "new": [(after.causes[name], name in unseen) for name in new],
        "both": [(before.causes[name], after.causes[name], parameters[name]) for name in both],
        "numbers": numbers,
        "moved": moved,
        "chance": 0.0027 * len(numbers),
        "residuals": _residuals(before, after),
        "errors": _errors(before, after),
        "commands": [
            f"flexspline validate NEW_MEASUREMENT --joint {place}/joint.yaml --out check",
            f"flexspline plan {place}",
        ],
        "written": now(),
        "version": metadata.version("flexspline"),
        "data": [(str(d.folder), file_digest(d.folder / "diagnosis.json")) for d in (before, after)],
    }


def _sentence(
    gone: list[str],
    new: list[str],
    both: list[str],
    moved: list[NumberChange],
    parameters: dict[str, list[NumberChange]],
) -> str:
    """What changed, in one sentence."""
    parts = []
    for names, what in ((gone, "gone"), (new, "new"), (both, "still there")):
        if names:
            parts.append(f"{listed([plain(name) for name in names])} {'is' if len(names) == 1 else 'are'} {what}")
    other = [name for name in both if any(change.moved for change in parameters[name])]
    if other:
        parts.append(f"{listed([plain(name) for name in other])} {'has' if len(other) == 1 else 'have'} changed")
    count = len(moved)
    parts.append(
        f"{count} number{'' if count == 1 else 's'} of the joint moved" if count else "no number of the joint moved"
    )
    text = listed(parts)
    return f"{text[:1].upper()}{text[1:]}."


def _change(name: str, unit: str, told: str, a: tuple[float, float], b: tuple[float, float]) -> NumberChange:
    spread = math.hypot(a[1], b[1])
    difference = b[0] - a[0]
    deviations = (
        difference / spread if spread > 0 else (0.0 if difference == 0 else math.copysign(math.inf, difference))
    )
    return NumberChange(name, unit, told, with_std(*a, unit), with_std(*b, unit), deviations)


def _numbers(before: Joint, after: Joint) -> list[NumberChange]:
    """Numbers of the description that either diagnosis moved, with the standard deviations that their files state."""
    found = []
    for name, a in before.numbers.items():
        b = after.numbers.get(name)
        if b is None or (a.std is None and b.std is None):
            continue
        spreads = [n.std if n.std is not None else math.hypot(n.tolerance * abs(n.value), n.deviation) for n in (a, b)]
        unit = "" if a.unit == "1" else a.unit
        found.append(_change(name, unit, meaning(name), (a.value, spreads[0]), (b.value, spreads[1])))
    return found


def _parameters(a: dict[str, Any], b: dict[str, Any]) -> list[NumberChange]:
    found = []
    for name, p in a["parameters"].items():
        q = b["parameters"].get(name)
        if q is not None:
            found.append(
                _change(plain(name), p["unit"], "", (p["value"], p["std"] or 0.0), (q["value"], q["std"] or 0.0))
            )
    return found


def _residuals(before: Diagnosed, after: Diagnosed) -> list[tuple[str, str, list[str]]]:
    """By channel: simulation error before and after extending the joint, in both measurements."""
    rows = []
    for name, a in before.answer["residual"].items():
        b = after.answer["residual"].get(name)
        if b is not None:
            cells = [number(x[key], 3) for x in (a, b) for key in ("before", "after", "noise")]
            rows.append((plain(name), a["unit"], cells))
    return rows


def _errors(before: Diagnosed, after: Diagnosed) -> list[tuple[str, list[str]]]:
    """By estimator: torque error before and after extending the joint [N·m], in both measurements."""
    found = [(d.answer.get("estimation") or {}).get("estimators", {}) for d in (before, after)]
    return [
        (name, [number(x[key], 3) for x in (a, found[1][name]) for key in ("before", "after")])
        for name, a in found[0].items()
        if name in found[1]
    ]
