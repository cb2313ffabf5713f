"""Calibration: a joint's tolerances as independent standard normal variables.

Each calibration variable `x_j ~ N(0, 1)` changes one number of the joint (or several with a shared tolerance): `value
= nominal · f(tolerance, x_own) · f(shared tolerance, x_shared) + deviation · x_own`. A draw of `x` is a joint within
its tolerances; a fit finds `x` with the prior of the joint file. A diagnosed number has its standard deviation
instead, and its correlations with other diagnosed numbers (`joint_parts.Uncertainty`): the result of one diagnosis is
the prior of the next. Each correlated number is `value + deviation · (R x)_own`, where R is the symmetric root of the
correlation matrix. A tolerance up to `NARROW` is normal, f = 1 + tolerance · x. A larger one is log-normal, f = (1 +
tolerance)^x: half the value is as likely as double, and the number is never negative.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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
