"""Mistakes hidden in sound measurements, and how many are found; what is claimed of sound ones.

`python -m benchmarks.mistakes`: every kind of mistake, in several sizes, in every example of the shared data (`--folder`); and
sound measurements: the examples, the same with channels taken away or cut short, and joints drawn anew, with the imperfections of
real ones.
`python -m benchmarks mistakes` takes every fifth example.
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

from flexspline.diagnosis.data.mistakes import Mistake, find_mistakes
from flexspline.models.joint import Joint
from flexspline.models.recording import Measurement, Recording, read_measurement

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
        from flexspline.estimator.motion import smooth

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
    """Sound measurements of joints drawn anew, with imperfections, one effect or none, with and without a sensor, one encoder."""
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
    arguments = parser.parse_args(words)
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
