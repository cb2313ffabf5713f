"""Mistakes hidden in sound measurements: how many are found, and what is claimed of sound ones.

`python -m benchmarks.mistakes` hides every kind of mistake, in several sizes, in every example (`--folder`). Sound
measurements are the examples, the same with fewer channels or cut short, and drawn joints with imperfections. `python -m
benchmarks mistakes` uses every fifth example.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from flexspline.diagnosis.data.mistakes import Mistake, find_mistakes
from flexspline.diagnosis.data.plausibility import motion_of
from flexspline.models.joint import Joint, load_joint
from flexspline.models.recording import Measurement, Recording, read_measurement
from flexspline.models.signals import DRIVING, POSITIONS

EXAMPLES = Path(__file__).resolve().parents[2] / "shared" / "data" / "examples"
_EXACT = 0.03
Spoil = Callable[[Recording, Joint, np.random.Generator], Recording]


@dataclass(frozen=True)
class Hidden:
    """A mistake to hide: name, columns of which one must be named, what makes it; the factor or offset that mends it."""

    name: str
    columns: tuple[str, ...]
    spoil: Spoil
    label: str
    factor: float | None = None
    seconds: float | None = None
    offset: float | None = None

    def there(self, measurement: Measurement) -> bool:
        """Whether a measurement has the column."""
        return self.columns in (("",), ("time",)) or any(c in r for c in self.columns for r in measurement.recordings)

    def found(self, mistakes: tuple[Mistake, ...]) -> bool:
        """Whether it is among those found, with the right column, and the right number within 3 %."""
        return any(self._is(m) for m in mistakes)

    def alone(self, mistakes: tuple[Mistake, ...]) -> bool:
        """Whether nothing else is."""
        return all(self._is(m) for m in mistakes)

    def everywhere(self, mistakes: tuple[Mistake, ...], measurement: Measurement) -> bool:
        """Whether it is named of every recording that has the column."""
        named = {m.recording for m in mistakes if self._is(m)}
        every = self.columns in (("",), ("time",))
        having = {r.name for r in measurement.recordings if every or set(self.columns) & set(r.columns)}
        return "" in named or having <= named

    def _is(self, m: Mistake) -> bool:
        if m.name != self.name or (m.column not in self.columns and self.columns != ("",)):
            return False
        if self.factor is not None and (m.factor is None or abs(m.factor / self.factor - 1) > _EXACT):
            return False
        if self.seconds is not None and (m.seconds is None or abs(m.seconds - self.seconds) > 0.3 * self.seconds):
            return False
        if self.offset is not None:
            off = (
                0.0 if m.offset is None else (m.offset - self.offset) / (100.0 if m.column == "motor_position" else 1.0)
            )
            return abs(math.remainder(off, 2 * math.pi)) < 0.1
        return True


def _with(recording: Recording, **columns: np.ndarray) -> Recording:
    return replace(recording, columns={**recording.columns, **{n: x for n, x in columns.items() if n in recording}})


def _scaled(column: str, factor: float, whole: bool = False) -> Spoil:
    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        if column not in r:
            return r
        x = r[column] * factor
        return _with(r, **{column: np.round(x) if whole else x})

    return spoil


def _all(*several: Spoil) -> Spoil:
    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        for one in several:
            r = one(r, joint, rng)
        return r

    return spoil


def _speed(column: str, factor: float) -> Spoil:
    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        from flexspline.models.motion import smooth

        if column not in r:
            return r
        out = np.zeros(len(r.time))
        for part in r.segments:
            if part.stop - part.start > 10:
                s = smooth(r.time[part], r[column][part, None], 2e-3, 25.0)
                out[part] = np.interp(r.time[part], s.time, s.rate[:, 0])
        return _with(r, **{column: factor * out})

    return spoil


def _shifted(offset: float, columns: tuple[str, ...]) -> Spoil:
    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        N = joint.numbers["N"].value
        return _with(r, **{c: r[c] + offset * (N if c == "motor_position" else 1.0) for c in columns if c in r})

    return spoil


def _late(column: str, seconds: float) -> Spoil:
    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        if column not in r:
            return r
        n = max(round(seconds / r.interval), 1)
        if np.ptp(np.diff(r.time)) > 0.5 * r.interval:  # irregular: late in time
            return _with(r, **{column: np.interp(r.time - seconds, r.time, r[column])})
        return _with(r, **{column: np.concatenate([np.full(n, r[column][0]), r[column][:-n]])})

    return spoil


def _wrapped(column: str, low: float, scale: float = 1.0) -> Spoil:
    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        return _with(r, **{column: scale * ((r[column] - low) % (2 * math.pi) + low)}) if column in r else r

    return spoil


def _exchanged(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
    return _with(r, motor_position=r["link_position"], link_position=r["motor_position"])


def _ratio(factor: float) -> Spoil:
    return _scaled("motor_position", factor)


def _stuck(column: str, share: float, to_the_end: bool = False) -> Spoil:
    """Stuck for a share of the way that the link makes; all of it where 1."""

    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        if column not in r:
            return r
        x, n = r[column].copy(), len(r.time)
        if share >= 1:
            x[:] = x[n // 3]
        else:
            position = r["link_position"] if "link_position" in r else r["motor_position"]
            way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(position)))])
            begin = int(np.searchsorted(way, rng.uniform(0.05, 0.9 - share) * way[-1]))
            end = len(x) if to_the_end else int(np.searchsorted(way, way[begin] + share * way[-1]))
            x[begin:end] = x[begin]
        return _with(r, **{column: x})

    return spoil


def _glitch(column: str, size: float, count: int) -> Spoil:
    """Single samples off by `size`, in N·m and A times the column's own range."""

    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        if column not in r:
            return r
        x = r[column].copy()
        rows = rng.choice(np.arange(20, len(x) - 20), count, replace=False)
        by = size if column.endswith("position") else size * np.ptp(x)
        x[rows] += by * rng.choice((-1.0, 1.0), count)
        return _with(r, **{column: x})

    return spoil


def _clipped(column: str, share: float) -> Spoil:
    def spoil(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
        if column not in r:
            return r
        end = share * float(np.quantile(np.abs(r[column]), 0.999))
        return _with(r, **{column: np.clip(r[column], -end, end)})

    return spoil


def _time(factor: float) -> Spoil:
    return lambda r, joint, rng: replace(r, time=r.time * factor)


def _gravity(r: Recording, joint: Joint, rng: np.random.Generator) -> Recording:
    return replace(r, link=r.link.model_copy(update={"gravity_angle": math.pi}))


def hidden_mistakes() -> Iterator[Hidden]:
    """All that are hidden, each in several sizes; those of the test joint."""
    deg, turn, N, Kt = math.pi / 180, 2 * math.pi, 100.0, 0.0603
    motor, link, current, torque = "motor_position", "link_position", "motor_current", "joint_torque"
    for column, lines in ((motor, 4096), (link, 2**20)):
        for said, factor in (("degrees", deg), ("turns", turn), ("counts", turn / lines)):
            yield Hidden(
                "unit", (column,), _scaled(column, 1 / factor, said == "counts"), f"unit {column} {said}", factor
            )
    yield Hidden(
        "unit", (motor,), _scaled(motor, 2**16 / turn, True), "unit motor_position counts of 16 bit", turn / 2**16
    )
    yield Hidden("unit", (current,), _scaled(current, 1e3), "unit motor_current mA", 1e-3)
    yield Hidden("unit", (current,), _scaled(current, Kt), "unit motor_current N·m", 1 / Kt)
    yield Hidden("unit", (current,), _scaled(current, N * Kt), "unit motor_current N·m output", 1 / (N * Kt))
    yield Hidden("unit", (torque,), _scaled(torque, 1e3), "unit joint_torque mN·m", 1e-3)
    yield Hidden(
        "unit", ("position_command",), _scaled("position_command", 1 / deg), "unit position_command degrees", deg
    )
    for angles in ((link, motor), (link, motor, "position_command")):  # which agree with each other
        for said, factor in (("degrees", deg), ("turns", turn)):
            label = f"unit {' '.join(angles)} {said}"
            yield Hidden("unit", (link,), _all(*(_scaled(name, 1 / factor) for name in angles)), label, factor)
    yield Hidden("unit", ("time",), _time(1e3), "unit time ms", 1e-3)
    yield Hidden("unit", ("time",), _time(1e6), "unit time µs", 1e-6)
    for column in (motor, link, current, torque, "position_command"):
        yield Hidden("sign", (column,), _scaled(column, -1.0), f"sign {column}")
    yield Hidden("sign", ("",), _gravity, "sign of gravity")
    for factor in (1.01, 1 / 1.01, 0.5, 1.6):
        yield Hidden("gear_ratio", (motor, link, ""), _ratio(factor), f"gear_ratio {factor:.3g}", factor)
    yield Hidden("swapped", ("",), _exchanged, "swapped")
    for seconds in (0.01, 0.02, 0.05, 0.1):
        for column in (motor, link, current, torque):
            if seconds < 0.015 and column == link:  # an ordinary delay
                continue
            yield Hidden(
                "late", (column,), _late(column, seconds), f"late {column} {1e3 * seconds:g} ms", seconds=seconds
            )
    for low in (-math.pi, 0.0):
        yield Hidden("wrapped", (motor,), _wrapped(motor, low), f"wrapped motor_position {low:.1f}")
    yield Hidden("wrapped", (link,), _wrapped(link, 0.0), "wrapped link_position")
    yield Hidden("wrapped", (motor,), _wrapped(motor, 0.0, 1 / deg), "wrapped motor_position 360 degrees")
    yield Hidden("velocity", (motor,), _speed(motor, 1.0), "velocity motor_position")
    yield Hidden("velocity", (link,), _speed(link, 1.0), "velocity link_position")
    yield Hidden("velocity", (motor,), _speed(motor, 60 / turn), "velocity motor_position rpm", turn / 60)
    angles = (motor, link)
    for offset in (turn / 4, -turn / 4, turn / 2, 0.5, -0.4):
        yield Hidden("angle_zero", angles, _shifted(offset, angles), f"angle_zero {offset:.2f}", offset=-offset)
        together = (*angles, "position_command")
        yield Hidden(
            "angle_zero", together, _shifted(offset, together), f"angle_zero, command too {offset:.2f}", offset=-offset
        )
    yield Hidden("angle_zero", angles, _shifted(0.5, (link,)), "angle_zero of link_position 0.5", offset=-0.5)
    for share in (0.1, 0.3, 1.0):
        for column in (motor, link, current, torque):
            yield Hidden("stuck", (column,), _stuck(column, share), f"stuck {column} {share:g}")
    for column in (motor, link, current, torque):
        yield Hidden("stuck", (column,), _stuck(column, 0.2, True), f"stuck {column} from 0.2 to the end")
    for column, size in ((motor, turn), (motor, 20.0), (link, 0.3), (current, 1.0), (torque, 1.0)):
        for count in (1, 5):
            yield Hidden("glitch", (column,), _glitch(column, size, count), f"glitch {column} {size:.2g} × {count}")
    for share in (0.6, 0.8):
        for column in (motor, link, current, torque):
            yield Hidden("clipped", (column,), _clipped(column, share), f"clipped {column} {share:g}")


def hide(
    mistake: Hidden, measurement: Measurement, joint: Joint, rng: np.random.Generator, only: int | None = None
) -> Measurement:
    """The measurement with a mistake in all recordings, or in one."""
    chosen = range(len(measurement.recordings)) if only is None else (only,)
    recordings = tuple(mistake.spoil(r, joint, rng) if i in chosen else r for i, r in enumerate(measurement.recordings))
    return replace(measurement, recordings=recordings)


def examples(folder: Path = EXAMPLES) -> Iterator[Measurement]:
    """The shared examples."""
    for path in sorted(folder.glob("*/*")):
        if path.is_dir():
            measurement = read_measurement(path)
            yield replace(measurement, name=f"{path.parent.name}/{path.name}")


def without_channels(measurement: Measurement) -> Iterator[Measurement]:
    """The measurement with one channel taken away after the other, as far as a recording can do without."""
    names = ("motor_position", "link_position", "motor_current", "joint_torque", "position_command")
    sensor = all("joint_torque" in r for r in measurement.recordings)
    for name in names:
        if all(name in r for r in measurement.recordings) and (name != "motor_current" or sensor):
            recordings = tuple(r.without(name) for r in measurement.recordings)
            yield replace(measurement, name=f"{measurement.name} without {name}", recordings=recordings)


def drawn(count: int, seed: int) -> Iterator[tuple[Measurement, Joint]]:
    """Sound measurements of drawn joints, with imperfections, one effect or none, with and without a sensor, one encoder."""
    from flexspline.diagnosis.trials.draw import Challenge, draw

    joints = ("test-joint", "lara8-joint3")
    for i in range(count):
        challenge = Challenge(
            joint=joints[i % 4 == 3], seed=seed + i, hidden="none" if i % 3 == 0 else "one", real=i % 2 == 0,
            sensor=i % 4 < 2, scenarios=(),
        )  # fmt: skip
        found = draw(challenge, 0)
        names = "+".join(e.name for e in found.effects) or "nothing"
        yield (
            replace(found.measurement, name=f"draw {i} {challenge.joint} {names} real={challenge.real}"),
            found.nominal,
        )
        one = tuple(r.without("motor_position" if i % 2 else "link_position") for r in found.measurement.recordings)
        yield (
            replace(found.measurement, name=f"draw {i} {challenge.joint} {names}, one encoder", recordings=one),
            found.nominal,
        )


JOINTS = ("test-joint", "csg-14-100-ec45", "csg-20-50-ec90", "csg-25-100-tbm2g", "ur3e-shoulder", "lara8-joint3")


def _moves(rng: np.random.Generator, t: np.ndarray, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """A link's angle [rad] and its command, shape (n,) each: `sweep`, `moves` from pose to pose, `strokes`, `slips`."""
    range_, theta, now = rng.uniform(0.5, 1.2), np.zeros(len(t)), 0.0
    if kind == "sweep":
        slow, fast = rng.uniform(0.08, 0.3), rng.uniform(0.3, 1.2)
        part = rng.uniform(0.05, 0.4)
        theta = range_ * ((1 - part) * np.sin(2 * np.pi * slow * t) + part * np.sin(2 * np.pi * fast * t))
        return theta, theta
    command, begin, goal, sign = np.zeros(len(t)), 0.3, 0.0, 1.0
    while begin < t[-1]:
        if kind == "slips":  # the command creeps, friction holds, the link jumps after it
            held, long = rng.uniform(0.3, 1.2), rng.uniform(0.05, 0.15)
            sign = -sign if abs(now + sign * 0.15) > range_ else sign
            goal = now + sign * rng.uniform(0.02, 0.15)
            creep = (t >= begin) & (t < begin + held)
            command[creep] = now + (goal - now) * (t[creep] - begin) / held
        else:
            speed = rng.uniform(0.15, 0.3) if kind == "strokes" else rng.uniform(0.4, 1.6)
            goal = (range_ if goal <= 0 else -range_) if kind == "strokes" else rng.uniform(-range_, range_)
            held, long = rng.uniform(0.2, 1.5), max(1.9 * abs(goal - now) / speed, 0.15)
        move = t >= begin + held
        s = np.clip((t[move] - begin - held) / long, 0.0, 1.0)
        shape = s * s * s * (10 - 15 * s + 6 * s * s) if begin % 0.2 < 0.1 or kind == "slips" else s * s * (3 - 2 * s)
        theta[move] = now + (goal - now) * shape
        if kind == "slips":
            command[t >= begin + held] = goal
        now, begin = goal, begin + held + long
    return theta, command if kind == "slips" else theta


def wide(seed: int, compensated: bool = False) -> tuple[Measurement, Joint]:
    """A sound log as people have them, by a joint's equations without the dynamics of its springs.

    25 to 1000 Hz, even or not; sweeps, moves from pose to pose, strokes, stick-slip; one encoder or two, coarse or fine; current,
    drive's torque or a sensor; friction 0.3 to 6 times, inertia and load up to 2 times what is described, or as described.

    Args:
      compensated: whether the drive takes gravity off what it logs.
    """
    rng = np.random.default_rng([48, seed])
    joint = load_joint(JOINTS[rng.integers(len(JOINTS))])
    kind = ("sweep", "moves", "strokes", "slips")[rng.choice(4, p=[0.35, 0.35, 0.15, 0.15])]
    rate, seconds = float(np.exp(rng.uniform(np.log(25), np.log(1000)))), rng.uniform(8.0, 40.0)
    mounting = max(joint.mountings.values(), key=lambda m: m.gravity_moment)
    p = joint.record(mounting)[0]
    N = float(p["N"])
    fine = np.arange(0.0, seconds, 1e-3)
    theta, command = _moves(rng, fine, kind)
    theta = uniform_filter1d(uniform_filter1d(theta, 15, mode="nearest"), 15, mode="nearest")
    centre = rng.uniform(-0.5, 0.5) - float(p["gravity_angle"]) * (abs(p["gravity_angle"]) > 1)
    theta, command = theta + centre, command + centre
    v = np.gradient(theta, 1e-3)
    a = np.gradient(v, 1e-3)

    def off(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high)))) if rng.random() < 0.6 else rng.uniform(0.95, 1.05)

    load, inertia, friction, rotor, viscous = off(0.5, 2), off(0.5, 2), off(0.3, 6), off(0.5, 2), off(0.3, 6)
    torque = load * p["Mg"] * np.sin(theta + p["gravity_angle"]) + inertia * p["Jl"] * a + p["bl"] * v
    w, level = N * v, friction * float(p["Fc"])
    moving = np.abs(w) > 0.5
    last = np.maximum.accumulate(np.where(moving, np.arange(len(w)), 0))
    rests = np.exp(-(np.arange(len(w)) - last) * 1e-3 / rng.uniform(0.5, 5.0))
    sense = np.tanh(w[last] / p["vs"]) * np.where(moving, 1.0, rests)
    if kind == "slips":  # what the current builds up while friction holds
        sense = np.clip((command - theta) / 0.1 + np.where(moving, np.sign(w), 0.0), -1.2, 1.2)
    mesh = level * sense + viscous * (p["bw"] + p["bm"]) * w
    mesh = (
        mesh * (1 + 0.15 * rng.random() * np.sin(2 * N * theta + 1.0))
        + rng.uniform(0.0, 0.15) * np.abs(torque) / N * sense
    )
    motor = N * (theta + torque / p["K2"] + 1e-4 * np.sin(2 * N * theta)) + 0.03 * rng.standard_normal()
    held = load * p["Mg"] * np.sin(theta + p["gravity_angle"]) if compensated else 0.0
    drive = (torque - held) / N + mesh + rotor * (p["Jm"] + p["Jw"]) * N * a
    drive = uniform_filter1d(drive, rng.integers(1, 4))
    stamps = np.arange(0.0, seconds - 0.01, 1 / rate)
    if rng.random() < 0.3:
        stamps = stamps + rng.uniform(0.0, 0.3 / rate, len(stamps))
    Kt, noise = float(p["Kt"]) * off(0.8, 1.25), 10 ** rng.uniform(-3, -1.7)

    def read(x: np.ndarray, noisy: float = 0.0, count: float = 0.0) -> np.ndarray:
        y = np.interp(stamps, fine, x) + noisy * rng.standard_normal(len(stamps))
        return count * np.round(y / count) if count else y

    spread = float(np.quantile(np.abs(drive), 0.98))
    counts = (6e-6, 1e-4, 1.5e-3, 2.9e-3)[rng.integers(4)]
    columns = {
        "motor_position": read(motor, count=2 * np.pi / 4096),
        "link_position": read(theta, count=counts),
        "motor_current": read(drive / Kt, noise * spread / Kt, (0.0, 0.003 * spread / Kt)[rng.integers(2)]),
        "motor_torque": read(drive, noise * spread, (0.0, 0.01 * spread)[rng.integers(2)]),
        "joint_torque": read(torque, 0.005 * np.ptp(torque)),
        "position_command": np.interp(stamps, fine, command),
    }
    angles = (POSITIONS, ("link_position",), ("link_position",), ("motor_position",))[rng.integers(4)]
    drives = (("motor_current",), ("motor_current",), ("motor_torque",), ("motor_current", "joint_torque"))[
        rng.integers(4)
    ]
    kept = (*angles, *drives, *(("position_command",) if rng.random() < 0.4 else ()))
    single = rng.random() < 0.3
    chosen = {n: np.float64(np.float32(x)) if single else x for n, x in columns.items() if n in kept}
    name = f"wide {seed}: {joint.name} {kind} {rate:.0f} Hz, {' '.join(kept)}"
    name += f", load {load:.2g}, inertia {inertia:.2g}, friction {friction:.2g}"
    return Measurement(name, Path(), (Recording("log", stamps, chosen, joint.name, str(seed), link=mounting),)), joint


def unseen_load(measurement: Measurement, joint: Joint, rng: np.random.Generator) -> Measurement:
    """The measurement with a load that nothing measures, as a second joint beyond the link: three waves of 0.1 to 1 Hz, up to 1.5
    times the drive's torque in all."""
    (r,) = measurement.recordings
    drive = next(n for n in ("motor_current", "motor_torque") if n in r)
    waves = [np.sin(2 * np.pi * (rng.uniform(0.1, 1.0) * r.time + rng.random())) for _ in range(3)]
    load = rng.uniform(0.3, 1.5) * float(np.std(r[drive])) * np.sum(waves, axis=0)
    columns = {drive: r[drive] + load}
    if "joint_torque" in r:
        N, Kt = joint.numbers["N"].value, joint.numbers["Kt"].value
        columns["joint_torque"] = r["joint_torque"] + N * (Kt if drive == "motor_current" else 1.0) * load
    return replace(measurement, recordings=(_with(r, **columns),))


def _column_of(*names: str) -> Callable[[Recording], str | None]:
    return lambda r: next((n for n in names if n in r), None)


def wide_mistakes() -> Iterator[
    tuple[str, str, Callable[[Recording, Joint, np.random.Generator], tuple[Recording, str] | None]]
]:
    """Mistakes to hide in wide logs: label, name, and what makes it of a log and gives the column; None where it cannot be."""
    drive, angle = _column_of("motor_current", "motor_torque"), _column_of("link_position", "motor_position")

    def scaled(pick, factor):
        def spoil(r, joint, rng):
            column = pick(r)
            if column is None:
                return None
            by = factor(joint) if callable(factor) else factor
            return (_with(r, **{column: by * r[column]}), column) if by is not None else None

        return spoil

    def moved(spoil, pick):
        def made(r, joint, rng):
            column = pick(r)
            return None if column is None else (spoil(column)(r, joint, rng), column)

        return made

    current, sensor = _column_of("motor_current"), _column_of("joint_torque")
    deg = 180 / math.pi
    yield "degrees", "unit", scaled(angle, deg)
    yield "turns", "unit", scaled(angle, 1 / (2 * math.pi))
    yield "mA", "unit", scaled(current, 1e3)
    yield "mN·m", "unit", scaled(sensor, 1e3)
    yield "A as N·m output", "unit", scaled(current, lambda j: _far(j.numbers["N"].value * j.numbers["Kt"].value, 4))
    yield "drive turned round", "sign", scaled(drive, -1.0)
    yield "sensor turned round", "sign", scaled(sensor, -1.0)
    yield "half a turn", "angle_zero", lambda r, j, g: _turned_by(r, j, math.pi)
    yield "quarter of a turn", "angle_zero", lambda r, j, g: _turned_by(r, j, math.pi / 2)
    yield "swapped", "swapped", lambda r, j, g: (_exchanged(r, j, g), "") if all(n in r for n in POSITIONS) else None
    yield (
        "gear ratio 101",
        "gear_ratio",
        lambda r, j, g: (_ratio(1.01)(r, j, g), "motor_position") if all(n in r for n in POSITIONS) else None,
    )
    yield (
        "velocity",
        "velocity",
        moved(lambda c: _speed(c, 1.0), lambda r: angle(r) if all(n in r for n in POSITIONS) else None),
    )
    yield "no gravity", "no_gravity", _no_gravity
    yield "effort is a current", "unit", _effort_is_current
    yield "angle of 16 bits", "wrapped", lambda r, j, g: _register(r, angle(r), 2 * math.pi / 4096, 16)
    yield "angle of 32 bits", "wrapped", lambda r, j, g: _register(r, angle(r), 2 * math.pi / 2**18, 32)
    yield (
        "drive of 16 bits",
        "wrapped",
        lambda r, j, g: _register(r, drive(r), float(np.ptp(r[drive(r)])) / 700 if drive(r) else 0, 16),
    )
    yield "whole turns", "wrapped", _whole_turns
    yield (
        "without sign",
        "sign",
        lambda r, j, g: (
            (_with(r, **{drive(r): np.abs(r[drive(r)])}), drive(r)) if drive(r) and _both_signs(r[drive(r)]) else None
        ),
    )
    yield "clock × 0.5", "unit", lambda r, j, g: _clock(r, 0.5, j)
    yield "clock × 2", "unit", lambda r, j, g: _clock(r, 2.0, j)
    yield "time reversed", "sign", _backwards
    yield "glitch", "glitch", lambda r, j, g: _wide_glitch(r, drive(r), g)
    yield "glitch of the angle", "glitch", lambda r, j, g: _wide_glitch(r, angle(r), g)
    yield "clipped", "clipped", moved(lambda c: _clipped(c, 0.6), drive)
    yield "stuck drive", "stuck", moved(lambda c: _stuck(c, 0.3), drive)
    yield (
        "stuck angle",
        "stuck",
        moved(lambda c: _stuck(c, 0.3), lambda r: angle(r) if all(n in r for n in POSITIONS) else None),
    )
    yield "late drive 60 ms", "late", lambda r, j, g: _late_of(r, j, g, drive(r), 0.06)
    yield "late angle 60 ms", "late", lambda r, j, g: _late_of(r, j, g, "motor_position", 0.06)


def _far(factor: float, by: float) -> float | None:
    """A factor that no description is off by."""
    return factor if max(factor, 1 / factor) > by else None


def _turned_by(r: Recording, joint: Joint, offset: float) -> tuple[Recording, str]:
    return _shifted(offset, (*POSITIONS, "position_command"))(_ratioed(r), joint, np.random.default_rng(0)), ""


def _ratioed(r: Recording) -> Recording:
    return r


def _both_signs(x: np.ndarray) -> bool:
    return min(float(np.mean(x > 0.05 * np.abs(x).max())), float(np.mean(x < -0.05 * np.abs(x).max()))) > 0.1


def _no_gravity(r: Recording, joint: Joint, rng: np.random.Generator) -> tuple[Recording, str] | None:
    column = next((n for n in ("motor_current", "motor_torque") if n in r), None)
    if column is None or "joint_torque" in r:
        return None
    without = wide(int(r.description), compensated=True)[0].recordings[0]
    return _with(r, **{column: without[column]}), column


def _effort_is_current(r: Recording, joint: Joint, rng: np.random.Generator) -> tuple[Recording, str] | None:
    N, Kt = joint.numbers["N"].value, joint.numbers["Kt"].value
    if "motor_current" not in r or "joint_torque" in r or _far(N * Kt, 4) is None:
        return None
    columns = {("joint_torque" if n == "motor_current" else n): x for n, x in r.columns.items()}
    return replace(r, columns=columns), "joint_torque"


def _register(r: Recording, column: str | None, count: float, bits: int) -> tuple[Recording, str] | None:
    if column is None or not r[column].min() < 0 < r[column].max():
        return None
    counts = np.round(r[column] / count)
    return _with(r, **{column: count * (counts % 2.0**bits)}), column


def _whole_turns(r: Recording, joint: Joint, rng: np.random.Generator) -> tuple[Recording, str] | None:
    if not all(n in r for n in POSITIONS):
        return None
    n = len(r.time) // 2
    off = np.where(np.arange(len(r.time)) < n, 0.0, 2 * math.pi * rng.integers(2, 30))
    return replace(_with(r, motor_position=r["motor_position"] + off), time=r.time + 2.0 * (off > 0)), "motor_position"


def _clock(r: Recording, factor: float, joint: Joint) -> tuple[Recording, str] | None:
    """Where inertia is much of the torque, as the log has it; else no clock shows."""
    p, name = joint.record(r.link)[0], next(n for n in reversed(POSITIONS) if n in r)
    motion = motion_of(replace(r, time=r.time * factor))
    if motion is None:
        return None
    a = motion.channels[name][:, 2] / (p["N"] if name == "motor_position" else 1.0)
    inertia = p["Jl"] + (0.0 if "joint_torque" in r else p["N"] ** 2 * (p["Jm"] + p["Jw"]))
    if float(np.std(inertia * a)) < 0.1 * joint.numbers["rated_torque"].value:
        return None
    return replace(r, time=r.time * factor), "time"


def _backwards(r: Recording, joint: Joint, rng: np.random.Generator) -> tuple[Recording, str]:
    return replace(r, time=(r.time[-1] - r.time)[::-1], columns={n: x[::-1] for n, x in r.columns.items()}), "time"


def _wide_glitch(r: Recording, column: str | None, rng: np.random.Generator) -> tuple[Recording, str] | None:
    if column is None:
        return None
    x = r[column].copy()
    rows = rng.choice(np.arange(20, len(x) - 20), 2, replace=False)
    x[rows] += (1.5 if column in DRIVING else 1.0) * np.ptp(x) * rng.choice((-1.0, 1.0), 2)
    return _with(r, **{column: x}), column


def _late_of(r: Recording, joint: Joint, rng: np.random.Generator, column: str | None, seconds: float):
    if column is None or not all(n in r for n in POSITIONS):
        return None
    return _late(column, seconds)(r, joint, rng), column


def wide_rates(count: int, seed: int, only: str = "", every: bool = True) -> None:
    """Print claims in sound wide logs, and of each kind hidden in them how many are named."""
    logs = [wide(seed + i) for i in range(count)]
    rng = np.random.default_rng(seed)
    if only in ("", "sound"):
        for said, tried in (
            ("sound wide logs", logs),
            ("with an unmeasured load", [(unseen_load(m, joint, rng), joint) for m, joint in logs]),
        ):
            claimed = 0
            for measurement, joint in tried:
                found = [m for m in find_mistakes(measurement, joint) if m.confidence > 0.5]
                claimed += bool(found)
                if found:
                    print(f"  claimed of {measurement.name}: {', '.join(map(_short, found))}", flush=True)
            print(f"{said}: claims in {claimed} of {count}", flush=True)
    for label, name, spoil in wide_mistakes():
        if only not in label:
            continue
        hits, tried, missed = 0, 0, []
        for measurement, joint in logs[:: 1 if every else 4]:
            made = spoil(measurement.recordings[0], joint, rng)
            if made is None:
                continue
            found = find_mistakes(replace(measurement, recordings=(made[0],)), joint)
            named = any(
                m.name == name and (not made[1] or made[1] in (m.column, *m.also)) for m in found if m.confidence > 0.5
            )
            hits, tried = hits + named, tried + 1
            if not named:
                missed.append(
                    f"{measurement.name}: " + (", ".join(f"{_short(m)} {m.confidence:.2f}" for m in found) or "nothing")
                )
        print(f"  {label:22s} {hits}/{tried}", flush=True)
        for line in missed[:4]:
            print(f"      {line}")


def main(words: Sequence[str] = ("--every", "5", "--draws", "10")) -> None:
    """Print the rates, as the words of a command line ask."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mistakes")
    parser.add_argument("--folder", type=Path, default=EXAMPLES)
    parser.add_argument("--only", default="", help="part of the labels of mistakes to hide")
    parser.add_argument("--every", type=int, default=1, help="of so many examples one")
    parser.add_argument("--one", action="store_true", help="hide in one recording, the last, not in all")
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--cuts", type=int, default=240, help="sound measurements cut short")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wide", type=int, default=0, help="wide logs alone, so many")
    arguments = parser.parse_args(words)
    if arguments.wide:
        wide_rates(arguments.wide, arguments.seed, arguments.only)
        return
    rng = np.random.default_rng(arguments.seed)
    print(f"mistakes hidden in the examples, seed {arguments.seed}")
    sound = [(m, m.load_joint(None)) for m in examples(arguments.folder)][:: arguments.every]
    kinds: dict[str, list[int]] = {}
    begin, looks = time.process_time(), 0
    for mistake in hidden_mistakes():
        if arguments.only not in mistake.label:
            continue
        hits, alone, whole, missed = 0, 0, 0, []
        tried = [(m, j) for m, j in sound if mistake.there(m)]
        for measurement, joint in tried:
            only = len(measurement.recordings) - 1 if arguments.one else None
            found = find_mistakes(hide(mistake, measurement, joint, rng, only), joint)
            looks += 1
            hits += mistake.found(found)
            alone += mistake.found(found) and mistake.alone(found)
            whole += mistake.everywhere(found, measurement)
            if not (mistake.found(found) and mistake.alone(found)):
                missed.append(f"{measurement.name}: " + (", ".join(map(_short, found)) or "nothing"))
        counts = kinds.setdefault(mistake.name, [0, 0, 0, 0])
        kinds[mistake.name] = [a + b for a, b in zip(counts, (hits, alone, whole, len(tried)), strict=True)]
        print(f"  {mistake.label:45s} {hits}/{len(tried)}, alone {alone}, of every recording {whole}", flush=True)
        for line in missed[:4]:
            print(f"      {line}")
    kinds["all"] = [sum(counts) for counts in zip(*kinds.values(), strict=True)] or [0, 0, 0, 0]
    for name, (*counts, tried) in kinds.items():
        hits, alone, whole = (f"{100 * count / max(tried, 1):5.1f} %" for count in counts)
        print(f"  {name:12s} {hits} of {tried}, alone {alone}, of every recording {whole}")
    print(f"  {(time.process_time() - begin) / max(looks, 1):.2f} s each")
    if arguments.only not in ("", "sound"):
        return
    whole, recordings = _claims(_sound(sound, arguments.draws, arguments.seed))
    print(f"sound: {whole} claims in {recordings} recordings")
    cut, _ = _claims(cuts(sound, arguments.cuts, arguments.seed))
    print(f"sound, cut out: {cut} claims in {arguments.cuts} measurements")


def _claims(measurements: Iterable[tuple[Measurement, Joint]]) -> tuple[int, int]:
    """Of how many sound measurements something is claimed, which is printed, and how many recordings they have."""
    claimed, recordings = 0, 0
    for measurement, joint in measurements:
        recordings += len(measurement.recordings)
        if found := find_mistakes(measurement, joint):
            claimed += 1
            print(f"  claimed of {measurement.name}: {', '.join(map(_short, found))}", flush=True)
    return claimed, recordings


def _sound(known: list[tuple[Measurement, Joint]], draws: int, seed: int) -> Iterator[tuple[Measurement, Joint]]:
    yield from known
    for measurement, joint in known:
        for fewer in without_channels(measurement):
            yield fewer, joint
    yield from drawn(draws, seed)


def cuts(known: Sequence[tuple[Measurement, Joint]], count: int, seed: int) -> Iterator[tuple[Measurement, Joint]]:
    """Sound measurements cut short: 1 to 12 s out of all recordings, each elsewhere, or 4 to 22 s out of one."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        measurement, joint = known[rng.integers(len(known))]
        length = rng.uniform(*((1, 6), (6, 12), (4, 22))[i % 3])
        chosen = measurement.recordings
        if i % 3 == 2:
            chosen = (chosen[rng.integers(len(chosen))],)
        parts = []
        for r in chosen:
            begin = r.time[0] + rng.uniform(0.0, max(r.time[-1] - r.time[0] - length, 0.0))
            first, last = np.searchsorted(r.time, (begin, begin + length))
            parts.append(r.at(slice(int(first), int(last))))
        yield replace(measurement, name=f"{measurement.name} cut {i}", recordings=tuple(parts)), joint


def _short(m: Mistake) -> str:
    number = next((f" {x:.4g}" for x in (m.seconds, m.offset, m.factor) if x is not None), "")
    return f"{m.name} {m.column}{number}{' in ' + m.recording if m.recording else ''}"


if __name__ == "__main__":
    main(sys.argv[1:])
