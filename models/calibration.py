"""Calibration: a joint's tolerances as independent standard normal variables.

Each calibration variable `x_j ~ N(0, 1)` changes one number of the joint (or several with a shared tolerance): `value
= nominal · f(tolerance, x_own) · f(shared tolerance, x_shared) + deviation · x_own`. A draw of `x` is a joint within
its tolerances; a fit finds `x` with the prior of the joint file. A diagnosed number has its standard deviation
instead, and its correlations with other diagnosed numbers (`joint_parts.Uncertainty`): the result of one diagnosis is
the prior of the next. Each correlated number is `value + deviation · (R x)_own`, where R is the symmetric root of the
correlation matrix. A tolerance up to `NARROW` is normal, f = 1 + tolerance · x. A larger one is log-normal, f = (1 +
tolerance)^x: half the value is as likely as double, and the number is never negative.

The same uncertainty as joints: one standard deviation each along independent directions (`directions`). A result that
depends on the joint, a simulated channel or an estimate, then has as uncertainty the root of the sum of squares of its
changes along these directions (to first order, each change over a whole standard deviation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from . import causes
from .joint import Joint, Slot
from .joint_parts import OPTIONAL_SYMBOLS, POSSIBLE, SYMBOLS, Mounting, Number, Order
from .parameters import N_ORDERS, as_floats, short_way

CUT = 2.5  # largest number of standard deviations of a drawn variable
ZEROS = ("link_encoder_zero", "torque_sensor_offset")
"""Zeros of sensors: each power cycle may set them anew, so that a diagnosis says nothing of the next one's."""
_UNCORRELATED = 1e-3  # entry of the correlation's root below which a variable hardly changes a number
WITHIN = 3.0  # standard deviations within which a change is calibration; beyond, it is a cause


class Calibration:
    """The calibration variables of a joint: their `names`, a number's symbol or the name of a shared tolerance, and the
    `slots` of the numbers that they change."""

    def __init__(self, joint: Joint):
        self.joint = joint
        known = [replace(s, number=_known(s.number)) for s in slots(joint)]
        self.slots = [s for s in known if s.number.tolerance or s.number.deviation or s.number.shared]
        own = [s.name for s in self.slots if s.number.tolerance or s.number.deviation]
        shared = [f"shared {name}" for name in joint.shared_tolerances]
        self.names = own + shared
        self._position = {name: i for i, name in enumerate(self.names)}
        self._root = self._correlation_root()
        # Of every slot: value, tolerance and deviation of its number and the index of their variable, shared tolerance and its
        # variable's, least and largest value, index in a record.
        numbers, none = [s.number for s in self.slots], len(self.names)  # a variable that is always zero
        self._value = np.array([n.value for n in numbers])
        self._tolerance = np.array([n.tolerance for n in numbers])
        self._deviation = np.array([n.deviation for n in numbers])
        self._own = np.array([self._position.get(s.name, none) for s in self.slots], int)
        self._shared_tolerance = np.array([joint.shared_tolerances[n.shared] if n.shared else 0.0 for n in numbers])
        self._shared = np.array([self._position.get(f"shared {n.shared}", none) for n in numbers], int)
        self._least, self._most = np.array([_limits(s) for s in self.slots]).reshape(-1, 2).T
        self._place = np.array([s.place for s in self.slots], int)
        self._bare: dict[Mounting, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._last: dict[tuple[Mounting, bool], tuple[np.ndarray, np.ndarray]] = {}

    @property
    def size(self) -> int:
        """Number of variables."""
        return len(self.names)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a joint within tolerance, shape (n,), as of `standard`."""
        return standard(rng, self.size)

    def _correlation_root(self) -> np.ndarray:
        """Symmetric root of the variables' correlation, shape (n + 1, n + 1); the last one is a variable that is always zero."""
        root = np.eye(self.size + 1)
        stated = self.joint.uncertainty
        if stated is None:
            return root
        diagnosed = {s.name for s in slots(self.joint) if s.number.std} - set(ZEROS)
        covariance = stated.matrix @ stated.matrix.T
        rows = [i for i, name in enumerate(stated.names) if name in diagnosed and covariance[i, i] > 0.0]
        at = [self._position[stated.names[i]] for i in rows]
        scale = 1.0 / np.sqrt(np.diag(covariance)[rows])
        values, vectors = np.linalg.eigh(covariance[np.ix_(rows, rows)] * scale[:, None] * scale)
        root[np.ix_(at, at)] = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        return root

    def variables(self, slot: Slot) -> list[int]:
        """Return the indices of the variables that change a slot's number: its own, correlated and shared ones."""
        i = self.slots.index(slot)
        moving = np.flatnonzero(np.abs(self._root[self._own[i]]) > _UNCORRELATED)
        return [int(j) for j in (*moving, self._shared[i]) if j < self.size]

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the numbers of all slots at `x`, shape (len(slots),)."""
        x = np.append(x, 0.0)
        own = (self._root @ x)[self._own]
        value = self._value * factor_of(self._tolerance, own) + self._deviation * own
        return np.clip(value * factor_of(self._shared_tolerance, x[self._shared]), self._least, self._most)

    def value(self, slot: Slot, x: np.ndarray) -> float:
        """Return one number at `x`."""
        return float(self.values(x)[self.slots.index(slot)])

    def deviation(self, slot: Slot) -> float:
        """Return the standard deviation of one number by its own and its shared tolerance, in its unit."""
        number = slot.number
        shared = self.joint.shared_tolerances[number.shared] if number.shared else 0.0
        return float(np.hypot(np.hypot(number.tolerance, shared) * abs(number.value), number.deviation))

    def reach(self, slot: Slot, within: float) -> float:
        """Return the largest increase of one number within `within` standard deviations, in its unit."""
        number = slot.number
        shared = self.joint.shared_tolerances[number.shared] if number.shared else 0.0
        wide = [np.log1p(t) for t in (number.tolerance, shared) if t > NARROW]
        factor = float(np.expm1(within * np.linalg.norm(wide))) if wide else 0.0
        return max(within * self.deviation(slot), factor * abs(number.value))

    def record(self, x: np.ndarray, mounting: Mounting | None = None, effects: bool = True) -> np.ndarray:
        """Return the parameter record, shape (1,), of the joint at `x` in a mounting, with the joint's own effects or
        without."""
        mounting = self.joint.mount() if mounting is None else mounting
        last = self._last.get((mounting, effects))  # calls differ mostly in the effects
        if last is not None and np.array_equal(last[0], x):
            return last[1].copy()
        if mounting not in self._bare:
            # A record is linear in a slot's number.
            scale, offset = np.ones(len(self.slots)), np.zeros(len(self.slots))
            for i, slot in enumerate(self.slots):
                scale[i], offset[i] = slot.line(mounting)
            self._bare[mounting] = self.joint.bare_record(mounting), scale, offset
        bare, scale, offset = self._bare[mounting]
        record = bare.copy()
        as_floats(record)[self._place] = scale * self.values(x) + offset
        if effects:
            self.joint.apply_effects(record)
        self._last[mounting, effects] = np.array(x), record.copy()
        return record

    def expresses(self, record: np.ndarray, without: np.ndarray) -> bool:
        """Return whether all differences between two records, shape (1,) each, are within tolerance (`WITHIN`) of nominal in
        the first.

        A stiffness 25 % up on a joint whose own is 15 % down is an ordinary joint: there is no cause to find.
        """
        now, before, described = (as_floats(r) for r in (record, without, self.record(np.zeros(self.size))))
        limit, period = np.zeros_like(now), np.zeros_like(now)
        for slot in self.slots:
            scale = described[slot.place] if slot.field in ("Jl", "Mg") else 1.0
            limit[slot.place], period[slot.place] = self.reach(slot, WITHIN) * scale, slot.period
        off = short_way(now - described, period)
        return not np.any((now != before) & (np.abs(off) > limit))


def standard(rng: np.random.Generator, count: int) -> np.ndarray:
    """Draw standard normal variables, shape (count,), cut at `CUT`."""
    x = rng.standard_normal(count)
    while np.any(far := np.abs(x) > CUT):
        x[far] = rng.standard_normal(int(far.sum()))
    return x


NARROW = 0.5  # largest relative standard deviation of a normal tolerance; a larger one is log-normal


def _known(number: Number) -> Number:
    """Return a number with its diagnosed standard deviation, if it has one, instead of its tolerance."""
    if number.std is None:
        return number
    return number.model_copy(update={"tolerance": 0.0, "shared": None, "deviation": number.std})


_LEAST = 0.3
_LEAST_SHARE = 1e-3  # of its nominal value, of a number that is not zero


def factor_of(tolerance: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the factors of tolerances on their numbers at x standard deviations, shape of the arguments."""
    change = tolerance * x
    normal = np.where(
        change > _LEAST - 1, 1 + change, _LEAST * np.exp((np.minimum(change, _LEAST - 1) + 1 - _LEAST) / _LEAST)
    )
    return np.where(tolerance > NARROW, (1 + tolerance) ** x, normal)


def _limits(slot: Slot) -> tuple[float, float]:
    """Return the least and largest value of a number: none is impossible, however wide its deviation."""
    if slot.field in ("Jl", "Mg"):
        return _LEAST_SHARE * slot.number.value, np.inf
    if slot.field not in SYMBOLS | OPTIONAL_SYMBOLS:
        return -np.inf, np.inf
    _, zero = (SYMBOLS | OPTIONAL_SYMBOLS)[slot.field]
    least, most = POSSIBLE.get(slot.field, (0.0, np.inf))
    return (0.0 if zero else max(least, _LEAST_SHARE * slot.number.value)), most


UNKNOWN_PHASE = 1.5
"""Standard deviation of a phase [rad] from which it is unknown (half a turn either way, uniform, has 1.8)."""


def in_quadratures(joint: Joint) -> Joint:
    """Return the joint with two quadratures, a quarter of a period apart, for each order of the kinematic error whose phase is
    unknown.

    Any phase is then as likely as another, and zero amplitude is likely. An amplitude with a phase as two variables has
    its likelihood's modes apart from each other, and no amplitude near zero.
    """
    found: list[Order] = []
    for order in joint.kinematic_error:
        amplitude, phase = order.amplitude, order.phase
        if phase.std is not None or phase.deviation < UNKNOWN_PHASE:
            found.append(order)
            continue
        spread = np.sqrt(0.5 * ((1 + amplitude.tolerance**2) * amplitude.value**2 + amplitude.deviation**2))
        size = {"value": 0.0, "deviation": float(spread), "tolerance": 0.0}
        for turn in (0.0, 0.5 * np.pi):
            at = phase.model_copy(update={"value": phase.value + turn, "deviation": 0.0})
            found.append(order.model_copy(update={"amplitude": amplitude.model_copy(update=size), "phase": at}))
    return joint if len(found) > N_ORDERS else joint.model_copy(update={"kinematic_error": found})


def slots(joint: Joint) -> list[Slot]:
    """Return every number of a joint in a record, by its name in a diagnosis."""
    return [*(Slot(symbol, symbol, number) for symbol, number in joint.numbers.items()), *joint.placed()]


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
    return [_sum(vector, changes, {}) for vector in vectors.T[: min(kept, most)]]


def _sum(weights: np.ndarray, changes: Sequence[Change], start: Change) -> Change:
    total = dict(start)
    for weight, change in zip(weights, changes, strict=True):
        for name, x in change.items():
            total[name] = total.get(name, 0.0) + float(weight) * x
    return total


def independent_changes(joint: Joint) -> list[Change]:
    """Return changes of one standard deviation along independent directions of a joint's uncertainty."""
    found, known = _diagnosed(joint)
    # Unmeasured numbers have their tolerances; a shared one changes all unmeasured numbers that share it.
    calibration = Calibration(joint)
    found += [_within(calibration, x, known) for x in np.eye(calibration.size)]
    return [change for change in found if change]


def drawn_changes(joint: Joint, count: int, seed: int) -> list[Change]:
    """Draw changes of a joint, each variable cut at `CUT`: diagnosed quantities to first order, others as their
    tolerances state. A draw with a negative or zero number where the joint's is positive is drawn again."""
    rng, calibration = np.random.default_rng(seed), Calibration(joint)
    diagnosed, known = _diagnosed(joint)
    positive = {s.name: s.number.value for s in slots(joint) if s.name in joint.numbers and s.number.value > 0.0}
    found: list[Change] = []
    while len(found) < count:
        own = _within(calibration, calibration.draw(rng), known)
        total = _sum(standard(rng, len(diagnosed)), diagnosed, own)
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
