"""Plausible wrong inputs: silent nonsense is a wrong number without a warning.

A sound measurement of two recordings is simulated on a drawn joint, free and with pushes. Then one thing is made wrong:
another joint's description, a load, the clock, the direction of time, swapped recordings, a damaged sensor, a number of
the description. `check` answers with a mistake by name, `estimate` with a refusal or a warning. `diagnose`, if there is
time, may find the data inconclusive. An input is made from its seed and number alone.
"""

from __future__ import annotations

import contextlib
import io
import json
import multiprocessing
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import flexspline as fs
from flexspline.diagnosis.data.mistakes import find_mistakes
from flexspline.diagnosis.diagnose import diagnose
from flexspline.models.errors import InputError, InputWarning
from flexspline.models.joint import Joint, load_joint
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Recording, read_measurement, write_recording

JOINTS = ("csg-14-100-ec45", "csg-17-80-ec60", "csg-20-50-ec90", "csg-25-100-tbm2g", "csg-32-160-ilm70", "test-joint")
DAMAGED = ("motor_position", "link_position", "motor_current", "joint_torque")
_FILTERS = ["current", "RAREKF", "momentum"]
Pair = list[Recording]


@dataclass(frozen=True)
class Answered:
    """What became of an input.

    Attributes:
      kind, what: of the input.
      mistakes: named by `check`.
      estimate: how `estimate` answered: refused, warned or silent.
      verdict: of `diagnose`; empty where it was not asked, `unfinished` where its time was up.
      seconds: that it took.
    """

    kind: str
    what: str
    mistakes: tuple[str, ...]
    estimate: str
    verdict: str
    seconds: float

    @property
    def silent(self) -> bool:
        """Whether nothing says that it is wrong."""
        return (
            self.kind != "sound" and not self.mistakes and self.estimate == "silent" and self.verdict != "inconclusive"
        )


def _sound(rng: np.random.Generator, name: str) -> Pair:
    """Two recordings of a joint: free, and with drawn pushes."""
    joint = load_joint(name)
    fast = 1.5 if name == "test-joint" else float(rng.uniform(0.6, 1.2))
    found = []
    for which in ("free", "pushed"):
        times, angle, moves = 0.0, 0.0, [{"time": 0.5, "position": 0.0}]
        while times < 11.0:
            angle = float(rng.uniform(-1.0, 1.0)) if rng.random() > 0.2 else angle
            times = moves[-1]["time"] + float(rng.uniform(0.8, 2.0)) / fast
            moves.append({"time": times, "position": angle})
        size = 0.15 * joint.numbers["rated_torque"].value
        pushes = [
            {"kind": "push", "start": t, "duration": 0.5, "torque": size * float(rng.choice((-1, 1)))}
            for t in (3.0, 7.0)
        ]
        run = fs.simulate(
            "no_load", seed=int(rng.integers(2**31)), joint=name, duration=12.0, trajectory=moves, filters=["model"],
            mounting="link" if "link" in joint.mountings else "",
            disturbances=pushes if which == "pushed" else [],
        )  # fmt: skip
        found.append(replace(run.as_recording(), name=which))
    return found


def _columns(r: Recording, change: Callable[[str, np.ndarray], np.ndarray]) -> Recording:
    return replace(r, columns={name: change(name, values) for name, values in r.columns.items()})


def _loaded(r: Recording, inertia: float, moment: float) -> Recording:
    link: Mounting = r.link
    update = {"inertia": max(inertia * link.inertia, 1e-6), "gravity_moment": moment * link.gravity_moment}
    return replace(r, link=link.model_copy(update=update))


def sound(rng: np.random.Generator, pair: Pair, name: str) -> tuple[str, Pair, Joint]:
    """Nothing wrong: what is answered here is a false alarm."""
    return "as simulated", pair, load_joint(name)


def wrong_joint(rng: np.random.Generator, pair: Pair, name: str) -> tuple[str, Pair, Joint]:
    """Another shipped joint's description."""
    other = str(rng.choice([j for j in JOINTS if j != name]))
    return other, pair, load_joint(other)


def wrong_load(rng: np.random.Generator, pair: Pair, name: str) -> tuple[str, Pair, Joint]:
    """Inertia, gravity moment or both stated 0, 10 or 100 times as large."""
    factor = float(rng.choice((0.0, 10.0, 100.0)))
    which = str(rng.choice(("inertia", "moment", "both")))
    scaled = [_loaded(r, factor if which != "moment" else 1.0, factor if which != "inertia" else 1.0) for r in pair]
    return f"{which} × {factor:g}", scaled, load_joint(name)


def wrong_clock(rng: np.random.Generator, pair: Pair, name: str) -> tuple[str, Pair, Joint]:
    """A clock that runs at half to twice its rate, 5 % off at least."""
    factor = float(np.exp(rng.choice((-1, 1)) * rng.uniform(np.log(1.05), np.log(2.0))))
    return f"× {factor:.2f}", [replace(r, time=factor * r.time) for r in pair], load_joint(name)


def reversed_time(rng: np.random.Generator, pair: Pair, name: str) -> tuple[str, Pair, Joint]:
    """Samples in the reverse order, of one recording or both."""
    count = int(rng.integers(1, 3))
    turned = [_columns(r, lambda _, x: x[::-1].copy()) if i < count else r for i, r in enumerate(pair)]
    return f"{count} of 2", turned, load_joint(name)


def swapped(rng: np.random.Generator, pair: Pair, name: str) -> tuple[str, Pair, Joint]:
    """A channel of the other recording, or another joint's recording in place of the second."""
    if rng.random() < 0.3:
        other = str(rng.choice([j for j in JOINTS if j != name]))
        return f"recording of {other}", [pair[0], replace(_sound(rng, other)[1], joint=name)], load_joint(name)
    column = str(rng.choice([c for c in DAMAGED if c in pair[0].columns]))
    a, b = (r.columns[column] for r in pair)
    return (
        column,
        [replace(r, columns=r.columns | {column: x.copy()}) for r, x in zip(pair, (b, a), strict=True)],
        load_joint(name),
    )


def damaged(rng: np.random.Generator, pair: Pair, name: str) -> tuple[str, Pair, Joint]:
    """A sensor that is frozen, turned, scaled, late, noisy, or counts coarsely."""
    column = str(rng.choice([c for c in DAMAGED if c in pair[0].columns]))
    how = str(rng.choice(("frozen", "turned", "scaled", "late", "noise", "coarse", "zero")))
    factor = float(rng.choice((0.1, 0.5, 2.0, 10.0)))

    def spoil(x: np.ndarray) -> np.ndarray:
        size, n = float(np.std(x)), len(x)
        begin = n // 3
        return {
            "frozen": lambda: np.concatenate([x[:begin], np.full(n - begin, x[begin])]),
            "turned": lambda: -x,
            "scaled": lambda: factor * x,
            "late": lambda: np.concatenate([np.full(150, x[0]), x[:-150]]),
            "noise": lambda: x + 0.3 * size * rng.standard_normal(n),
            "coarse": lambda: np.round(x / (0.3 * size)) * 0.3 * size,
            "zero": lambda: np.zeros(n),
        }[how]()

    spoiled = [replace(r, columns=r.columns | {column: spoil(r.columns[column])}) for r in pair]
    return f"{column} {how}" + (f" × {factor:g}" if how == "scaled" else ""), spoiled, load_joint(name)


def wrong_number(rng: np.random.Generator, pair: Pair, name: str) -> tuple[str, Pair, Joint]:
    """A number of the description ten times as large or a tenth."""
    symbol = str(rng.choice(("N", "Kt", "Jm", "K1", "Fc")))
    factor = float(rng.choice((0.1, 10.0)))
    joint = load_joint(name)
    numbers = dict(joint.numbers)
    numbers[symbol] = numbers[symbol].model_copy(update={"value": factor * numbers[symbol].value})
    return f"{symbol} × {factor:g}", pair, joint.model_copy(update={"numbers": numbers})


KINDS = (sound, wrong_joint, wrong_load, wrong_clock, reversed_time, swapped, damaged, wrong_number)


def one(seed: int, number: int, seconds: float = 0.0) -> Answered:
    """Make an input and look how it is answered; `seconds`: that the search of a diagnosis may take, which is not asked for 0."""
    begin = time.monotonic()
    rng = np.random.default_rng((seed, number))
    name, make = str(rng.choice(JOINTS)), KINDS[number % len(KINDS)]
    what, pair, joint = make(rng, _sound(rng, name), name)
    with tempfile.TemporaryDirectory(prefix="nonsense") as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path, estimate, verdict = Path(folder), "silent", ""
        try:
            for recording in pair:
                write_recording(recording, path / "m")
            joint.write(path / "joint.yaml")
            measurement = read_measurement(path / "m")
            joint = load_joint(path / "joint.yaml")
            mistakes = tuple(sorted({m.name for m in find_mistakes(measurement, joint)}))
            estimate = _estimated(path)
            if not mistakes and estimate == "silent" and seconds > 0:
                found = diagnose(measurement, joint, seconds=seconds)
                verdict = found.verdict if found.complete else "unfinished"
        except InputError as error:
            mistakes, estimate = (f"refused: {error}",), "refused"
    return Answered(make.__name__, f"{name}: {what}", mistakes, estimate, verdict, time.monotonic() - begin)


def _estimated(path: Path) -> str:
    """How `estimate` answers. Where there were pushes external torques are small, and hard for some of any joint: what it says of
    these is said of sound measurements, too, and does not count."""
    from flexspline.commands.estimate import command

    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", InputWarning)
            command(measurement=path / "m", out=path / "e", joint=str(path / "joint.yaml"), filter_=_FILTERS)
    except InputError:
        return "refused"
    found = json.loads((path / "e" / "metrics.json").read_text(encoding="utf-8"))
    marked = {(name, what) for name, one in found.items() for what in one["no_estimates"]}
    return "warned" if said or marked - {("pushed", "external_torque")} else "silent"


def nonsense(count: int, seed: int, processes: int, until: float, seconds: float = 0.0) -> list[Answered]:
    """Answer so many inputs of a seed in separate processes, as many as time allows.

    Args:
      count, seed: of the inputs.
      processes: that share them.
      until: when those that are not answered are given up, as of `time.time`.
      seconds: as of `one`.
    """
    found = []
    with multiprocessing.get_context("spawn").Pool(processes) as pool, suppress(multiprocessing.TimeoutError):
        answers = pool.imap_unordered(partial(one, seed, seconds=seconds), range(count))
        for _ in range(count):
            answered = answers.next(max(until - time.time(), 0.0))
            found.append(answered)
            if answered.silent:
                print(f"  silent: {answered.kind}, {answered.what} {answered.verdict}", file=sys.stderr, flush=True)
    return found
