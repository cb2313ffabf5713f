"""Uncertainty of a joint as joints: one standard deviation each along independent directions.

A description has tolerances; a diagnosed one states the joint uncertainty of its numbers, effects and discrepancies
(`joint_parts.Uncertainty`). A result that depends on the joint, a simulated channel or an estimate, then has as uncertainty
the root of the sum of squares of its changes along these directions (to first order, each change over a whole
standard deviation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from . import causes
from .calibration import Calibration, slots, standard
from .joint import Joint
from .joint_parts import Mounting

Change = Mapping[str, float]  # changes of quantities, by the names of `joint_parts.Uncertainty`, in their units


def directions(joint: Joint, mounting: Mounting | None = None) -> list[np.ndarray]:
    """Return parameter records, shape (1,) each, of a joint in a mounting: one standard deviation in each independent
    direction."""
    return [moved(joint, mounting, change) for change in independent_changes(joint)]


def principal(changes: Sequence[Change], responses: np.ndarray, left: float, most: int) -> list[Change]:
    """Return the few independent changes with the largest effect: combinations of `changes` by the singular vectors of
    the responses to each, shape (n, m). `left`: share of the responses' energy that may be left out; at most `most`."""
    if not len(changes):
        return []
    energy, vectors = np.linalg.eigh(responses.T @ responses)
    energy, vectors = np.maximum(energy[::-1], 0.0), vectors[:, ::-1]
    total = float(np.sum(energy))
    kept = int(np.searchsorted(np.cumsum(energy), (1 - left) * total)) + 1 if total > 0 else 0
    found: list[Change] = []
    for vector in vectors.T[: min(kept, most)]:
        change: dict[str, float] = {}
        for weight, one in zip(vector, changes, strict=True):
            for name, x in one.items():
                change[name] = change.get(name, 0.0) + float(weight) * x
        found.append(change)
    return found


def independent_changes(joint: Joint) -> list[Change]:
    """Return changes of one standard deviation along independent directions of a joint's uncertainty."""
    found, known = _diagnosed(joint)
    # Unmeasured numbers have their tolerances; a shared one changes all unmeasured numbers that share it.
    calibration = Calibration(joint)
    found += [_within(calibration, x, known) for x in np.eye(calibration.size)]
    return [change for change in found if change]


def drawn_changes(joint: Joint, count: int, seed: int) -> list[Change]:
    """Draw changes of a joint, each variable cut at `calibration.CUT`: diagnosed quantities to first order, others as their
    tolerances state. A draw with a negative or zero number where the joint's is positive is drawn again."""
    rng, calibration = np.random.default_rng(seed), Calibration(joint)
    diagnosed, known = _diagnosed(joint)
    positive = {s.name: s.number.value for s in slots(joint) if s.name in joint.numbers and s.number.value > 0.0}
    found: list[Change] = []
    while len(found) < count:
        total = dict(_within(calibration, calibration.draw(rng), known))
        for weight, change in zip(standard(rng, len(diagnosed)), diagnosed, strict=True):
            for name, x in change.items():
                total[name] = total.get(name, 0.0) + float(weight) * x
        if all(value + total.get(name, 0.0) > 0.0 for name, value in positive.items()):
            found.append(total)
    return found


def _diagnosed(joint: Joint) -> tuple[list[Change], set[str]]:
    """Return independent changes of one standard deviation of diagnosed quantities, and the names of these quantities."""
    stated = joint.uncertainty
    found: list[Change] = []
    known: set[str] = set()
    if stated is not None:
        known = set(stated.names)
        for column in stated.matrix.T:
            found.append({name: float(x) for name, x in zip(stated.names, column, strict=True) if x})
    for slot in slots(joint):
        if slot.name not in known and slot.number.std:
            found.append({slot.name: slot.number.std})
            known.add(slot.name)
    for i, effect in enumerate(joint.effects):
        for name, estimate in effect.parameters.items():
            if f"effects.{i}.{name}" not in known and estimate.std:
                found.append({f"effects.{i}.{name}": estimate.std})
    return found, known


def _within(calibration: Calibration, x: np.ndarray, known: set[str]) -> Change:
    """Return the changes at calibration variables x, shape (n,), without quantities that are `known` otherwise."""
    off = calibration.values(x) - calibration.values(np.zeros(calibration.size))
    return {s.name: float(one) for s, one in zip(calibration.slots, off, strict=True) if one and s.name not in known}


def moved(joint: Joint, mounting: Mounting | None, changes: Change) -> np.ndarray:
    """Return the joint's record, shape (1,), with some quantities changed."""
    mounting = joint.mount() if mounting is None else mounting
    record = joint.bare_record(mounting)
    for slot in slots(joint):
        if slot.name in changes:
            slot.put(record, slot.number.value + changes[slot.name], mounting)
    effects = []
    for i, effect in enumerate(joint.effects):
        parameters = dict(effect.parameters)
        for q in causes.get(effect.name).parameters:
            change = changes.get(f"effects.{i}.{q.name}", 0.0)
            if change:
                value = float(np.clip(parameters[q.name].value + change, *q.bounds))
                parameters[q.name] = parameters[q.name].model_copy(update={"value": value})
        effects.append(effect.model_copy(update={"parameters": parameters}))
    discrepancies = []
    for i, one in enumerate(joint.discrepancies):
        coefficients = [c + changes.get(f"discrepancies.{i}.{k}", 0.0) for k, c in enumerate(one.coefficients)]
        discrepancies.append(one.model_copy(update={"coefficients": coefficients}))
    joint.model_copy(update={"effects": effects, "discrepancies": discrepancies}).apply_effects(record)
    return record
