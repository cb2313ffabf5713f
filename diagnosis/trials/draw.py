"""Draws of joint, motion and hidden effects, and the measurements that diagnosis sees of them.

A draw is a joint within its tolerances, three motions and an effect (or none, two, one outside the library). The MuJoCo
plant under the drive's quantised controller produces the recordings; diagnosis sees these and the nominal joint, nothing
else. Every draw has its own random stream from seed and index: results do not depend on the number of jobs,
and a draw at another size is the same draw, larger or smaller.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...models import causes
from ...models.calibration import Calibration
from ...models.errors import InputError
from ...models.joint import Joint, load_joint
from ...models.recording import Measurement
from ...models.signals import POSITIONS
from ...scenarios.scenario import Scenario, load_scenario
from ..data.coverage import in_drive_alone, shows_in
from .imperfections import Imperfections, imperfections
from .motions import bare, jittered, motions, record_motion
from .outside import OUTSIDE

Hidden = Literal["one", "two", "outside", "none"]
RECORDED = ("motor_position", "link_position", "motor_current", "joint_torque")
"""Channels of a draw's recordings, with every sensor there."""


@dataclass(frozen=True)
class Challenge:
    """What is drawn."""

    joint: str = "test-joint"  # name of, or path to, the nominal joint
    seed: int = 1  # of every random stream
    hidden: Hidden = "one"  # one effect, two, one outside the library, or none
    exact: bool = False  # the joint has its nominal numbers, and the diagnosed description has no tolerances
    real: bool = False  # with the small imperfections that every real joint has (`imperfections`)
    sensor: bool = True  # with a torque sensor, 1 kHz; without it irregular, about 250 Hz, single samples missing
    without: tuple[str, ...] = ()  # channels that are not recorded
    scenarios: tuple[str, ...] = ()  # names or paths of scenarios to use instead of random motions
    only: tuple[str, ...] = ()  # names of the causes (or effects outside the library) to draw from; all if empty

    def channels(self) -> set[str]:
        """Channels that are recorded, checked: one position at least, and one of current and joint torque."""
        for name in self.without:
            if name not in RECORDED:
                raise InputError(f"--without: expected one of {', '.join(RECORDED)}, got {name!r}")
        left = set(RECORDED).difference(self.without, () if self.sensor else ("joint_torque",))
        if not left.intersection(POSITIONS) or left <= set(POSITIONS):
            raise InputError(
                "--without: expected a position and one of motor_current, joint_torque to be left, "
                f"got {', '.join(c for c in RECORDED if c in left) or 'nothing'}"
            )
        return left

    def pool(self) -> list[str]:
        """Names that may be drawn: of what can show in the channels that are recorded."""
        columns = self.channels()
        if self.hidden == "none":
            return []
        if self.hidden == "outside":
            known = [name for name, e in OUTSIDE.items() if columns >= set(e.needs)]
        else:
            joint, both = load_joint(self.joint), columns >= set(POSITIONS)
            known = [n for n in causes.of(joint) if shows_in(causes.get(n), columns, both)]
            if "motor_current" not in columns:
                known = [n for n in known if not in_drive_alone(causes.get(n), joint, both)]
            if not self.exact:
                drowned = _drowned(self.joint)
                known = [n for n in known if n not in drowned]
                for name in drowned.intersection(self.only):
                    raise InputError(
                        f"--cause {name}: expected an effect beyond the tolerances of {joint.name}, "
                        "got one whose ordinary sizes they express (--exact takes none)"
                    )
        for name in self.only:
            if name not in known:
                raise InputError(f"--cause: expected one of {', '.join(known)}, got {name!r}")
        return list(self.only) or known


@dataclass(frozen=True)
class HiddenEffect:
    """A hidden effect: name (`unknown` outside the library), component, parameters, description, and its change of a record."""

    name: str
    component: str
    values: dict[str, float]
    description: str
    apply: Callable[[np.void], None] = field(repr=False)


@dataclass(frozen=True)
class Draw:
    """A joint, what is hidden in it, and what was measured."""

    effects: tuple[HiddenEffect, ...]
    records: tuple[np.ndarray, ...]  # of the true joint with its effects, one a recording, shape (1,) each
    measurement: Measurement  # what diagnosis sees
    nominal: Joint  # the described joint
    imperfections: Imperfections | None = None  # of the true joint and its sensors


def draw(challenge: Challenge, index: int, size: float = 1.0) -> Draw:
    """Draw number `index` of a challenge: joint, motion, effect of `size` ordinary sizes, and its recordings."""
    nominal = load_joint(challenge.joint)
    if challenge.exact:
        nominal = exactly(nominal)
    streams = [np.random.default_rng([challenge.seed, index, k]) for k in range(4)]
    calibration = Calibration(nominal)
    x, effects = np.zeros(calibration.size), _effects(challenge, index, size, nominal, streams[0])
    if not challenge.exact:
        x, effects = _beyond_tolerance(challenge, index, size, calibration, streams[1])
    scenarios = drawn_scenarios(challenge, index, nominal)
    true, flaws = nominal, None
    if challenge.real:
        flaws = imperfections(nominal, np.random.default_rng([challenge.seed, index, 4]))
        true = flaws.nominal
    records, recordings = [], []
    for k, scenario in enumerate(scenarios):
        mounting = scenario.mount(nominal)
        record = calibration.record(x, mounting)
        if flaws is not None:
            flaws.apply(record)
        for effect in effects:
            effect.apply(record[0])
        seed = int(np.random.default_rng([challenge.seed, index, 10 + k]).integers(2**31))
        warming = flaws.warming if flaws is not None else 0.0
        recording = record_motion(true, mounting, record, scenario, seed, bool(challenge.scenarios), warming)
        if flaws is not None:
            recording = jittered(recording, flaws.jitter, streams[3])
        if not challenge.sensor:
            recording = bare(recording, streams[3])
        records.append(record)
        recordings.append(recording.without(*challenge.without))
    measurement = Measurement(f"draw {index}", Path(), tuple(recordings))
    return Draw(effects, tuple(records), measurement, nominal, flaws)


_REDRAWN = 40
"""Joints drawn for an effect before a new effect is drawn: it may be within tolerance of nearly all."""


def _beyond_tolerance(
    challenge: Challenge, index: int, size: float, calibration: Calibration, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[HiddenEffect, ...]]:
    """A joint within its tolerances, shape (n,), and effects that at ordinary size are beyond them."""
    for again in itertools.count():
        stream = [challenge.seed, index, 0, again] if again else [challenge.seed, index, 0]
        whole, effects = (
            _effects(challenge, index, s, calibration.joint, np.random.default_rng(stream)) for s in (1.0, size)
        )
        for _ in range(_REDRAWN):
            x = calibration.draw(rng)
            if not any(within_tolerance(calibration, x, effect) for effect in whole):
                return x, effects
    raise AssertionError("counting has no end")


@lru_cache
def _drowned(name: str) -> frozenset[str]:
    return drowned(load_joint(name))


def drowned(joint: Joint) -> frozenset[str]:
    """Return the causes whose ordinary sizes are within the joint's tolerances: they are confounded with calibration."""
    calibration, record = Calibration(joint), joint.record()[0]
    x = np.zeros(calibration.size)

    def hidden(cause: causes.Cause) -> bool:
        rng = np.random.default_rng(0)
        effects = (_of_library(cause, cause.draw(record, rng)) for _ in range(_REDRAWN))
        return all(within_tolerance(calibration, x, effect) for effect in effects)

    return frozenset(n for n in causes.of(joint) if hidden(causes.get(n)))


def within_tolerance(calibration: Calibration, x: np.ndarray, effect: HiddenEffect) -> bool:
    """Whether the tolerances can express what an effect makes of the joint at x: nothing would then be hidden."""
    without = calibration.record(x)
    record = without.copy()
    effect.apply(record[0])
    return calibration.expresses(record, without)


def exactly(joint: Joint) -> Joint:
    """The same joint with every number known exactly: its description without tolerances and deviations."""

    def strip(value: Any) -> Any:
        if isinstance(value, list):
            return [strip(x) for x in value]
        if not isinstance(value, dict):
            return value
        kept = {k: strip(x) for k, x in value.items()}
        if {"value", "source", "tolerance"} <= set(kept):
            kept |= {"tolerance": 0.0, "deviation": 0.0, "shared": None}
        return kept

    data = strip(joint.model_dump()) | {"shared_tolerances": {}}
    known = Joint.model_validate(data)
    known._path = joint._path
    return known


def _effects(
    challenge: Challenge, index: int, size: float, nominal: Joint, rng: np.random.Generator
) -> tuple[HiddenEffect, ...]:
    """The hidden effects: every name of the pool once before any comes twice."""
    pool = challenge.pool()
    if not pool:
        return ()
    order = np.random.default_rng([challenge.seed, index // len(pool), 99]).permutation(len(pool))
    names = [pool[order[index % len(pool)]]]
    if challenge.hidden == "two":
        names.append(str(rng.choice([n for n in challenge.pool() if n != names[0]] or names)))
    if challenge.hidden == "outside":
        chosen = OUTSIDE[names[0]]
        values = chosen.draw(rng, size)
        said = f"{names[0]}: {chosen.description}"
        return (HiddenEffect("unknown", chosen.component, values, said, lambda p: chosen.put(p, values)),)
    # Of ordinary size against the nominal joint: that is what diagnosis can know.
    record = nominal.record()[0]
    return tuple(_of_library(c, c.draw(record, rng, size)) for c in map(causes.get, names))


def _of_library(cause: causes.Cause, values: dict[str, float]) -> HiddenEffect:
    return HiddenEffect(cause.name, cause.component, values, cause.description, partial(cause.apply, values=values))


def drawn_scenarios(challenge: Challenge, index: int, nominal: Joint) -> list[Scenario]:
    """The motions of draw number `index`."""
    rng = np.random.default_rng([challenge.seed, index, 2])
    if challenge.scenarios:
        return [load_scenario(name)[0] for name in challenge.scenarios]
    mountings = [name for name, mounting in nominal.mountings.items() if not mounting.locked] or [nominal.mounting]
    lightest = min(mountings, key=lambda name: nominal.mountings[name].gravity_moment)
    return motions(rng, lightest, nominal.mounting, nominal.numbers["rated_torque"].value / 16.0)
