"""Table of the mistakes a measurement may have. Each entry is a `Mistake`.

Every mistake has a price in log likelihood, as mistakes are rare. If an entry has a number (a gear ratio, a zero, a clock), it
is fitted to the channels. `undone` removes a mistake from the columns of a file, and from smoothed channels with derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from ...models.joint import Joint
from ...models.signals import DRIVING, POSITIONS
from .plausibility import Plausibility, RelationFit, SmoothedChannels


@dataclass(frozen=True)
class ChangeSettings:
    """What a change costs in log likelihood, and which numbers are looked at. Set on `benchmarks/mistakes.py`."""

    price: float = 9.0  # of a mistake
    free: float = 5.0  # of a number that is free, more
    unusual: float = 3.0  # of a unit that hardly anybody logs in, more
    # added price of counts of another encoder, and of counts read at four times or a quarter of the described resolution
    other_counts: tuple[float, float] = (8.0, 4.0)
    # added price of another unit if every value is a whole number, and of counts if not every value is
    not_counts: float = 6.0
    slope: float = 0.004  # by how much the encoders' ratio may be off at the least to be another gear ratio, relative
    ratio: float = 10.0  # how many times as large or small another gear ratio may be
    whole: float = 1.5e-3  # by how much it may be off a whole number to be that, relative
    smallest_offset: float = 0.015  # between the encoders [rad]
    # of all angles together [rad]: gravity's direction, a payload or a stop may explain less
    smallest_turn: float = 0.3
    turns: float = 0.03  # of the motor, by which a counter's whole number of turns may be off
    # smallest and largest ratio of a clock's unit to a second; the description's inertia explains smaller ratios
    clock: tuple[float, float] = (1.3, 2.7)
    least_factor: float = 2.0  # of a unit, or what it makes of a torque, that a wrong description does not
    folded: float = 40.0  # what a torque that is folded at zero says for a sign that is lost, in log likelihood
    none: float = 0.2  # gravity in a torque over the described one, of a torque without it


SETTINGS = ChangeSettings()
_DEGREE, _RPM = math.pi / 180, 2 * math.pi / 60
UNSURE = 0.5
"""Largest confidence of a change with which the channels do not fit the joint."""
GRAVITY = "gravity_angle"
"""Column of a mistake in gravity's direction: the mounting's angle in the recording's YAML."""
NO_CHANGE = "the channels do not fit this joint with any change of unit, sign or column"
_FIXED = {
    "swapped": "columns exchanged", "wrapped": "unwrapped", "glitch": "bridged", "stuck": "left out", "clipped": "left out",
}  # fmt: skip
_LOST = {
    "no_gravity": "log the whole torque, or state gravity_moment 0",
    "load": "correct it in the recording's YAML file",
}
_SI = {
    "motor_position": "rad", "link_position": "rad", "position_command": "rad", "motor_current": "A",
    "motor_torque": "N·m of the motor", "joint_torque": "N·m", "external_torque": "N·m",
}  # fmt: skip


@dataclass(frozen=True)
class Mistake:
    """A mistake in the data."""

    # `unit`, `sign`, `gear_ratio`, `swapped`, `late`, `wrapped`, `velocity`, `angle_zero`, `no_gravity`, `load`, `stuck`,
    # `glitch`, `clipped`
    name: str
    column: str  # with the mistake; empty if it concerns several
    recording: str  # with the mistake; empty if all have it
    description: str  # for people
    confidence: float  # probability of it
    # that corrects the column (of `gear_ratio`: N); of `wrapped` a turn or a register's range, in the column's unit
    factor: float | None = None
    seconds: float | None = None  # by which the column is late
    offset: float | None = None  # that corrects it, added; of the motor position on the motor side
    rows: tuple[int, ...] | None = None  # of the table that have it, from 0
    also: tuple[str, ...] = ()  # further columns that the same change corrects
    becomes: str = ""  # name of the column that it should have
    severe: bool = True  # whether it invalidates a diagnosis
    lost: bool = False  # whether the file does not contain the correct values
    price: float = SETTINGS.price  # in log likelihood
    counts: bool | None = None  # for counts logged as an angle, whether they are the described encoder's

    @property
    def columns(self) -> str:
        """Columns with the mistake, as text."""
        return ", ".join(x for x in (self.column, *self.also) if x)

    @property
    def where(self) -> str:
        """Recording and columns with the mistake, as text; empty if all have it."""
        return ": ".join(x for x in (self.recording, self.columns) if x)

    @property
    def sure(self) -> bool:
        """Whether the change makes the channels fit the joint."""
        return self.confidence > UNSURE and not self.lost

    @property
    def unmended(self) -> str:
        """Text for a mistake that is not sure."""
        if self.lost:
            return f"{self.description}; {self.remedy}"
        return f"{NO_CHANGE}; the best change would be: {self.description}, {self.change}"

    @property
    def remedy(self) -> str:
        """The correction, as a sentence."""
        if self.lost:
            if self.name == "load":
                return self.change
            return "the file cannot be corrected" if self.factor is None else f"correct it in the log: {self.change}"
        certain = "corrected by" if self.sure else "no change makes the channels fit the joint; the best is"
        return f"{certain}: {self.change}"

    @property
    def change(self) -> str:
        """The correction, in a few words."""
        times = "" if self.factor in (None, 1.0) else f"× {self.factor:.6g}"
        if self.lost and not times:
            return _LOST.get(self.name, "log it again")
        if self.becomes:
            return ", ".join([f"the column is {self.becomes}", *([times] if self.becomes != "motor_current" else [])])
        if self.name == "sign":
            return {"time": "rows in reverse order", GRAVITY: "gravity_angle + π"}.get(self.column, "× −1")
        if self.name == "angle_zero" or (self.name == "wrapped" and self.offset is not None):
            return f"{self.offset:+.5g} rad" + (", motor side by the gear ratio" if self.also else "")
        if self.name in _FIXED:
            return _FIXED[self.name]
        if self.name == "late":
            return f"{1e3 * (self.seconds or 0.0):.4g} ms earlier"
        words = {"velocity": ["integrated", times], "gear_ratio": [f"N {times}"]}.get(self.name, [times])
        return ", ".join(filter(None, [*words, "" if self.offset is None else f"{self.offset:+.6g} K"]))

    def to_json(self) -> dict[str, Any]:
        """Return the mistake as in `diagnosis.json`."""
        data: dict[str, Any] = {"name": self.name}
        data |= {key: getattr(self, key) for key in ("column", "recording", "becomes") if getattr(self, key)}
        for key in ("factor", "seconds", "offset"):
            if getattr(self, key) is not None:
                data[key] = float(f"{getattr(self, key):.6g}")
        data |= {key: list(getattr(self, key)) for key in ("also", "rows") if getattr(self, key)}
        return data | {
            "description": self.description, "confidence": round(self.confidence, 3), "severe": self.severe,
            "sure": self.sure, "lost": self.lost, "change": self.change,
        }  # fmt: skip


Columns = Mapping[str, np.ndarray]
"""Channels by name: values of shape (n,), or with two derivatives in time of shape (n, 3)."""


def undone(
    m: Mistake, time: np.ndarray, columns: Columns, N: float, p: np.void
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return time [s], shape (n,), and channels without a mistake of whole columns; N: gear ratio, p: the joint's record."""
    found = dict(columns)
    if m.column == "time":
        if m.name == "sign":
            return (time[-1] - time)[::-1], {n: _in_time(x[::-1], -1.0) for n, x in found.items()}
        assert m.factor is not None
        return m.factor * (time - time[0]), {n: _in_time(x, m.factor) for n, x in found.items()}
    if m.name == "swapped":
        given = {name: found.pop(name) for name in POSITIONS if name in found}
        return time, found | {POSITIONS[1 - POSITIONS.index(name)]: x for name, x in given.items()}
    if m.column == GRAVITY:  # equivalent to a half turn of all angles
        angles = [n for n in (*POSITIONS, "position_command") if n in found]
        return time, found | {n: _plus(found[n], math.pi * side(n, "link_position", N)) for n in angles}
    if m.becomes and m.column in found:
        found[m.becomes] = (1.0 if m.becomes == "motor_current" else m.factor or 1.0) * found.pop(m.column)
        return time, found
    for column in (m.column, *m.also):
        if column not in found:
            continue
        x, factor = found[column], 1.0 if m.factor is None else m.factor
        if m.name == "no_gravity":
            position = next(n for n in reversed(POSITIONS) if n in found)
            angle = (found[position] if found[position].ndim == 1 else found[position][:, 0]) * side("", position, N)
            weight = p["Mg"] * np.sin(angle + p["gravity_angle"])
            weight = weight / (1.0 if column == "joint_torque" else N * (p["Kt"] if column == "motor_current" else 1.0))
            found[column] = x + weight if x.ndim == 1 else x + weight[:, None] * np.array([1.0, 0.0, 0.0])
        elif m.name == "late":
            found[column] = np.interp(time + (m.seconds or 0.0), time, x)
        elif m.name == "velocity":
            v = factor * x.reshape(len(x), -1)
            angle = cumulative_trapezoid(v[:, 0], time, initial=0.0)
            found[column] = np.column_stack([angle, *v[:, :2].T]) if x.ndim > 1 else angle
            guide = next((n for n in (*POSITIONS, "position_command") if n in found and n != column), None)
            if guide is not None:
                off = side(column, guide, N) * found[guide] - found[column]
                found[column] = _plus(found[column], float(np.median(off if x.ndim == 1 else off[:, 0])))
        elif m.name == "sign":
            found[column] = -x
        else:
            factor = 1 / factor if m.name == "gear_ratio" and column == "motor_position" else factor
            offset = (m.offset or 0.0) * (side(column, m.column, N) if m.also else 1.0)
            found[column] = _plus((1.0 if m.name == "wrapped" else factor) * x, offset)
    return time, found


def probability(gain: float) -> float:
    """Return the probability of a hypothesis over another one, by the gain in score."""
    return 1 / (1 + math.exp(-min(max(gain, -50.0), 50.0) / 3))


def expected_sign(channels: Columns, N: float, p: np.void) -> np.ndarray:
    """Return the sign of the drive's torque according to the joint's record, shape (n,); channels: shape (n, 3) each."""
    position = next(n for n in reversed(POSITIONS) if n in channels)
    theta, v, a = (channels[position] * side("", position, N)).T
    inertia = p["Jl"] + N * N * (p["Jm"] + p["Jw"])
    return np.sign(p["Mg"] * np.sin(theta + p["gravity_angle"]) + inertia * a + N * p["Fc"] * np.tanh(N * v / p["vs"]))


def side(column: str, other: str, N: float) -> float:
    """Angle of a column's shaft over that of another's."""
    return (N if column == "motor_position" else 1.0) / (N if other == "motor_position" else 1.0)


def _plus(x: np.ndarray, offset: float) -> np.ndarray:
    return x + offset if x.ndim == 1 else x + np.array([offset, 0.0, 0.0])


def _in_time(x: np.ndarray, factor: float) -> np.ndarray:
    """Rescale derivatives for a unit of time of `factor` seconds."""
    return x if x.ndim == 1 else x / np.array([1.0, factor, factor**2])


@dataclass(frozen=True)
class Table:
    """The mistakes that a measurement may have."""

    joint: Joint  # the description
    plausible: Sequence[Plausibility]  # the description for each recording
    whole: frozenset[str]  # positions of which all values are whole numbers
    unsigned: frozenset[str]  # torques of which only the magnitude was logged
    still_arm: bool  # whether the other joints of an arm are at rest

    def entries(self, motions: Sequence[SmoothedChannels | None]) -> Iterator[Mistake]:
        """Yield all entries for smoothed channels."""
        there = {name for motion in motions if motion is not None for name in motion.channels}
        yield from self._scales(there)
        yield from self._places(there)
        yield from self._fitted(there, [(p, m) for p, m in zip(self.plausible, motions, strict=True) if m is not None])

    def _scales(self, there: set[str]) -> Iterator[Mistake]:
        """Units and signs."""
        N, Kt = self.joint.numbers["N"].value, self.joint.numbers["Kt"].value
        price, free = SETTINGS.price, SETTINGS.free
        angles: list[str] = [name for name in ("link_position", "motor_position", "position_command") if name in there]
        for column in angles:
            yield _sign(column)
            more = SETTINGS.not_counts if column in self.whole else 0.0
            for unit in _angles(column, price + more):
                yield unit
                turned = f"{unit.description}, and reversed"
                yield replace(unit, description=turned, factor=-(unit.factor or 1.0), price=unit.price + price - 1)
            yield from self._counts(column)
        for count in range(2, len(angles) + 1):  # their ratio does not show it
            yield from (replace(one, also=tuple(angles[1:count])) for one in _angles(angles[0], price))
        if {"link_position", "motor_position"} <= there:
            yield replace(_sign("link_position"), also=("motor_position",))
        if "position_command" in there:
            yield _unit("position_command", "rad on the motor side", 1 / N)
        for column in (*DRIVING, "external_torque"):
            if column in there - self.unsigned:  # with one encoder a reversed angle looks the same, but is rarer
                yield replace(_sign(column), price=price - 2)
            if column in there & self.unsigned:  # a magnitude has no sign that could be reversed
                text = "its magnitude without its sign: it touches zero as often as a signed torque would cross it"
                yield replace(_sign(column), description=text, lost=True, price=-SETTINGS.folded)
        units = [
            ("motor_current", "mA", 1e-3), ("motor_current", "N·m of the motor", 1 / Kt),
            ("motor_current", "N·m at the output", 1 / (N * Kt)), ("motor_torque", "mN·m", 1e-3),
            ("motor_torque", "N·m at the output", 1 / N), ("motor_torque", "A", Kt), ("joint_torque", "mN·m", 1e-3),
            ("external_torque", "mN·m", 1e-3),
        ]  # fmt: skip
        for column, said, factor in units:
            if column in there and abs(math.log(factor)) > math.log(SETTINGS.least_factor):
                yield _unit(column, said, factor)
        if "joint_torque" in there and not there & {"motor_current", "motor_torque"}:
            effort = Mistake("unit", "joint_torque", "", "", 0.99, price=price + free)
            if abs(math.log(N * Kt)) > math.log(SETTINGS.least_factor):
                said = "a motor current in A, logged as a torque in N·m"
                yield replace(effort, description=said, factor=N * Kt, becomes="motor_current")
            said = "the drive's torque at the output, with friction, logged as a sensor's torque"
            yield replace(effort, description=said, factor=1 / N, becomes="motor_torque", price=price + 2 * free)

    def _counts(self, column: str) -> Iterator[Mistake]:
        """Yield counts of the described encoder and, if every value is a whole number, of other encoders."""
        if column not in POSITIONS:
            return
        sensors = self.joint.sensors
        encoder = sensors.motor_encoder if column == "motor_position" else sensors.link_encoder
        lines = 2 * math.pi / encoder.resolution
        another, read_otherwise = SETTINGS.other_counts
        tried = [(lines, 0.0), (4 * lines, read_otherwise), (0.25 * lines, read_otherwise)]
        if column in self.whole:
            near = [math.log2(times * lines) for times in (0.25, 1.0, 4.0)]
            tried += [(2.0**bits, another) for bits in range(8, 33) if min(abs(bits - x) for x in near) > 0.1]
        for turn, more in tried:
            price = SETTINGS.price + more + (0.0 if column in self.whole else SETTINGS.not_counts)
            unit = _unit(column, f"counts ({turn:.10g} a turn)", 2 * math.pi / turn, price)
            yield replace(unit, counts=turn == lines)

    def _places(self, there: set[str]) -> Iterator[Mistake]:
        """Yield columns with another quantity: the other position or a velocity; also reversed time."""
        N = self.joint.numbers["N"].value
        positions = [name for name in POSITIONS if name in there]
        if len(positions) == 2:
            yield _entry("swapped", "", "motor and link position are exchanged")
        else:
            missing = "link" if positions[0] == "motor_position" else "motor"
            yield _entry("swapped", positions[0], f"this is the {missing} position")
        for column in positions:
            other = 1 / N if column == "link_position" else N
            units: dict[str, float | None] = {
                "rad/s": None,
                "deg/s": _DEGREE,
                "rpm": _RPM,
                "rad/s of the other side": other,
            }
            for said, factor in units.items():
                price = SETTINGS.price + (0.0 if factor is None else SETTINGS.unusual)
                yield _entry("velocity", column, f"a velocity ({said}), logged as a position", price, factor=factor)
        if self.still_arm:
            text = "time runs backwards: friction would drive the joint"
            yield _entry("sign", "time", text, SETTINGS.price + 2)

    def _fitted(self, there: set[str], motions: list[tuple[Plausibility, SmoothedChannels]]) -> Iterator[Mistake]:
        """Yield entries with a fitted number: gear ratio, zeros, clock."""
        N = self.joint.numbers["N"].value
        free = SETTINGS.price + SETTINGS.free
        positions = [name for name in POSITIONS if name in there]
        both = [m for _, m in motions if all(name in m for name in POSITIONS)]
        slope = _slope(both, N)
        if abs(slope - 1) > SETTINGS.slope and 1 / SETTINGS.ratio < slope < SETTINGS.ratio:
            near, more = round(slope * N), SETTINGS.free
            if near and abs(slope * N / near - 1) < SETTINGS.whole:  # N ± 1: circular spline and flexspline exchanged
                slope, more = near / N, 0.0 if abs(near - round(N)) == 1 else SETTINGS.free
            text = f"the motor makes {slope * N:.5g} turns for one of the link, not {N:.5g}: is it this joint?"
            yield _entry("gear_ratio", "motor_position", text, SETTINGS.price + more, factor=slope)
            text = f"the link's angle is {1 / slope:.5g} times what motor and gear ratio say"
            yield _entry("gear_ratio", "link_position", text, free + 3, factor=slope)
        between = _median(both, "motor_position", "link_position", N)
        if abs(between) > SETTINGS.smallest_offset:
            yield _zero(("link_position",), between, free)
            turns = N * between / (2 * math.pi)
            if round(turns) and abs(turns - round(turns)) < SETTINGS.turns:
                text = f"{abs(round(turns))} whole turns off the link position, as after a power cycle"
                offset = -2 * math.pi * round(turns)
                yield _entry("wrapped", "motor_position", text, free - 4, factor=2 * math.pi, offset=offset)
            yield _zero(("motor_position",), -N * between, free)
        command = _median([m for _, m in motions], "position_command", positions[-1], N)
        if abs(command) > 0.1:
            yield _zero(_link_first(positions), command * side(_link_first(positions)[0], "link_position", N))
            yield _zero(("position_command",), -command, free)
        yield from self._of_loads(there, motions)

    def _of_loads(self, there: set[str], motions: list[tuple[Plausibility, SmoothedChannels]]) -> Iterator[Mistake]:
        """Yield what the best gravity and inertia show: an effort without gravity, another zero of all angles, or a wrong clock,
        which scales inertia by the square of its error, and leaves gravity unchanged."""
        columns = [name for name in DRIVING if name in there]
        fits = {n: [(p, p.torque(m, n, True).coefficients) for p, m in motions if n in m] for n in columns}
        every = [fit for found in fits.values() for fit in found]

        def weightless(p: Plausibility, c: np.ndarray) -> bool:
            # A torque that is too small as a whole does not lack gravity.
            return p.heavy and math.hypot(c[1], c[2]) < SETTINGS.none * min(max(float(c[0]), 0.0), 1.0) * p.p["Mg"]

        lacking = [name for name, found in fits.items() if all(weightless(p, c) for p, c in found)]
        for column in lacking:
            text = (
                f"lacks gravity: {max(p.p['Mg'] for p, _ in fits[column]):.3g} N·m · sin(angle) is missing. Does the drive "
                "subtract gravity (compensated or external torque), is the joint's axis vertical, or the load far lighter?"
            )
            yield _entry("no_gravity", column, text, lost=True)
        # A zero of the angle cannot explain missing gravity, and only a weight has a direction.
        if not lacking and any(p.heavy for p in self.plausible):
            yield from self._turned(there, every)
        if not every or not self.still_arm:
            return
        ratio = float(np.sqrt(max(np.median([c[0] for _, c in every]), 1e-6)))
        if SETTINGS.clock[0] < max(ratio, 1 / ratio) < SETTINGS.clock[1]:
            text = f"a second of the log is {1 / ratio:.3g} s, or inertia {ratio**2:.3g} times the description"
            yield _entry("unit", "time", text, SETTINGS.price + 2 * SETTINGS.free, factor=1 / ratio)

    def _turned(self, there: set[str], fits: list[tuple[Plausibility, np.ndarray]]) -> Iterator[Mistake]:
        """Yield offsets of all angles: quarter turns, and the one at which gravity has its described direction."""
        across, along = (sum(float(c[k]) for p, c in fits if p.p["Mg"] > 0) for k in (2, 1))
        positions = [name for name in POSITIONS if name in there]
        for angle in (math.pi, math.pi / 2, -math.pi / 2, math.atan2(across, along)):
            if angle == math.pi and any(abs(p.p["gravity_angle"]) > 0.3 for p in self.plausible):
                text = "gravity acts in the opposite direction: gravity_angle or all angles are off by half a turn"
                yield replace(_sign(GRAVITY), description=text, offset=math.pi)
            for columns in (positions, [*positions, "position_command"]):
                if there.issuperset(columns) and abs(angle) > SETTINGS.smallest_turn:
                    first = _link_first(columns)
                    yield _zero(first, angle * side(first[0], "link_position", self.joint.numbers["N"].value))


def _entry(name: str, column: str, description: str, price: float = SETTINGS.price, **numbers: Any) -> Mistake:
    return Mistake(name, column, "", description, 0.99, price=price, **numbers)


def _sign(column: str) -> Mistake:
    return _entry("sign", column, "reversed", SETTINGS.price - 1)


def _unit(column: str, said: str, factor: float, price: float = SETTINGS.price) -> Mistake:
    return _entry("unit", column, f"{said}, logged as {_SI[column]}", price, factor=factor)


def _angles(column: str, price: float) -> Iterator[Mistake]:
    for said, factor in (("degrees", _DEGREE), ("turns", 2 * math.pi), ("mrad", 1e-3)):
        yield _unit(column, said, factor, price)


def _link_first(columns: Sequence[str]) -> tuple[str, ...]:
    return tuple(sorted(columns, key=lambda name: name != "link_position"))


def _zero(columns: Sequence[str], offset: float, price: float | None = None) -> Mistake:
    """Return an offset of some angles, in the unit of the first; quarter turns have a lower price."""
    if price is None:
        price = SETTINGS.price + (0.0 if abs(abs(offset) % (0.5 * math.pi)) < 1e-9 else 1.0)
    return _entry("angle_zero", columns[0], "another zero", price, offset=offset, also=tuple(columns[1:]))


def _slope(both: Sequence[SmoothedChannels], N: float) -> float:
    """Return the measured gear ratio over N, of all recordings; 1 if the link hardly moves."""
    found, weights = [], []
    for motion in both:
        m, l = (motion.channels[name][:, 0] for name in POSITIONS)
        if np.ptp(l) > 0.02:
            l, m = l - l.mean(), m / N - m.mean() / N
            found.append(float(l @ m / (l @ l)))
            weights.append(float(l @ l))
    return float(np.average(found, weights=weights)) if found else 1.0


def _median(motions: Sequence[SmoothedChannels], a: str, b: str, N: float) -> float:
    """Return the median difference of two positions on the output side [rad], of all recordings with both; 0 without."""
    pairs = [[m.channels[name][:, 0] / side(name, "", N) for name in (a, b)] for m in motions if a in m and b in m]
    return float(np.median(np.concatenate([x - y for x, y in pairs]))) if pairs else 0.0


def shrinkage(m: Mistake, new: Mapping[str, RelationFit], old: Mapping[str, RelationFit], effective: float) -> float:
    """Return the cost of a change that makes torques or angles smaller, as small signals fit any description; for angles at most
    the gain of the relations between angles."""
    if m.becomes:
        return -effective * max(math.log(m.factor or 1.0), 0.0)
    cost = -effective * math.log(abs(m.factor)) if m.name == "unit" and m.factor and m.column != "time" else 0.0
    if cost > 0.0 and m.column in (*DRIVING, "external_torque"):
        return cost
    if cost > 0.0:
        columns = {m.column, *m.also}
        last_of = {"encoders": "motor_position", "command": "position_command"}
        alone = [n for n, last in last_of.items() if n in new and n in old and last in columns and len(columns) > 1]
        return min(0.5 * cost, sum(max(new[n].agreement - old[n].agreement, 0.0) for n in alone))
    if m.column not in DRIVING or m.column not in new or m.column not in old:
        return 0.0
    # The residual of a larger torque may be larger by the same factor.
    return -min(-cost, max(old[m.column].sharpness - new[m.column].sharpness, 0.0))
