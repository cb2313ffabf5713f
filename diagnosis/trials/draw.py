"""Hidden effects to be found: draws of joint, motion and effect, what diagnosis makes of them, and how often it is right.

A draw is a joint within its tolerances, three motions and an effect (or none, two, one outside the library). The MuJoCo
plant under the drive's quantised controller produces the recordings; diagnosis sees these and the nominal joint, nothing
else. Every draw has a random stream of its own, made from seed and index: results do not depend on the number of jobs,
and a draw at another size is the same draw, larger or smaller.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.stats import binomtest

from ..estimator import FilterSettings, filter_bank
from ..models import causes
from ..models.calibration import Calibration
from ..models.errors import InputError
from ..models.joint import Joint, Mounting, load_joint
from ..models.parameters import N_COEFFICIENTS, PLACES, VARIABLES
from ..scenarios.loop import CONTROL_PERIOD, READINGS, simulate
from ..scenarios.scenario import Disturbance, Scenario, Waypoint, load_scenario
from ..sim import plant, sensors
from ..sim.drive import Controller
from ..sim.recording import Measurement, Recording
from .calibrate import Fit, Problem
from .coordinates import Hypothesis, hypotheses
from .diagnose import Diagnosis, diagnose
from .noise import estimate as estimate_noise
from .noise import whiten

Hidden = Literal["one", "two", "outside", "none"]
DETECTED = 3.33
"""Standard deviations at which an effect is found 9 times in 10 while 2 % of the alarms are false (Gaussian)."""
CONTROLLER = Controller(kp=8.0, kd=0.08, ki=20.0)


@dataclass(frozen=True)
class Challenge:
    """What is drawn.

    Attributes:
      joint: name of, or path to, the nominal joint.
      seed: of every random stream.
      hidden: one effect, two, one outside the library, or none.
      exact: the joint has exactly its nominal numbers, and diagnosis is told a description without tolerances.
      sensor: with the joint torque sensor, at 1 kHz; without it irregularly at about 250 Hz, single samples missing.
      scenarios: names or paths of scenarios to use instead of motions drawn anew.
      only: names of the causes (or effects outside the library) to draw from, all where empty.
    """

    joint: str = "test-joint"
    seed: int = 1
    hidden: Hidden = "one"
    exact: bool = False
    sensor: bool = True
    scenarios: tuple[str, ...] = ()
    only: tuple[str, ...] = ()

    def pool(self) -> list[str]:
        """Names that may be drawn."""
        if self.hidden == "none":
            return []
        if self.hidden == "outside":
            known = [name for name, e in OUTSIDE.items() if self.sensor or not e.needs_sensor]
        else:
            joint = load_joint(self.joint)
            known = [n for n in causes.of(joint) if self.sensor or "joint_torque" not in causes.get(n).needs]
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
class Effect:
    """A hidden effect: name (`unknown` outside the library), component, parameters, what it is, how to put it in a record."""

    name: str
    component: str
    values: dict[str, float]
    description: str
    apply: Callable[[np.void], None] = field(repr=False)


@dataclass(frozen=True)
class Draw:
    """A joint, what is hidden in it, and what was measured.

    Attributes:
      effects: hidden.
      records: of the true joint with its effects, one a recording, shape (1,) each.
      measurement: what diagnosis sees.
      nominal: the joint that it is told.
    """

    effects: tuple[Effect, ...]
    records: tuple[np.ndarray, ...]
    measurement: Measurement
    nominal: Joint


# --- effects outside the library -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outside:
    """An effect that no cause of the library describes: where it sits, and how it is drawn at a size."""

    component: str
    make: Callable[[np.random.Generator, float], tuple[dict[str, float], Callable[[np.void], None], str]]
    needs_sensor: bool = False


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _put_term(
    p: np.void, place: str, variable: str, low: float, high: float, shape: Callable[[np.ndarray], np.ndarray]
):
    """Put a function into a free nonparametric term of a record, as the spline through it."""
    slot = int(np.flatnonzero(p["term_place"] == 0)[0])
    n = N_COEFFICIENTS
    knots = low + (np.arange(n) - 1) / (n - 3) * (high - low)
    # Values at the knots are (c₋ + 4c + c₊)/6: solve for the coefficients, ends continued as they are.
    A = (np.diag(np.full(n, 4.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)) / 6.0
    A[0, 0] = A[-1, -1] = 5.0 / 6.0
    p["term_place"][slot], p["term_variable"][slot] = PLACES.index(place), VARIABLES.index(variable)
    p["term_low"][slot], p["term_high"][slot], p["term_count"][slot] = low, high, n
    p["term_coefficient"][slot] = np.linalg.solve(A, shape(knots))


def _link_bump(rng, size):
    amplitude, angle, width = size * _sign(rng) * rng.uniform(2, 4), rng.uniform(-0.6, 0.6), rng.uniform(0.08, 0.14)

    def apply(p):
        _put_term(
            p, "link", "link_position", angle - 1, angle + 1,
            lambda x: amplitude * np.exp(-0.5 * ((x - angle) / width) ** 2),
        )  # fmt: skip

    return {"amplitude": amplitude, "angle": angle, "width": width}, apply, "a torque on the link near one angle"


def _quadratic_friction(rng, size):
    torque = size * rng.uniform(0.02, 0.04)

    def apply(p):
        _put_term(p, "mesh", "motor_velocity", -150.0, 150.0, lambda w: torque * (w / 80.0) * np.abs(w / 80.0))

    return {"torque": torque}, apply, "mesh friction that grows with the square of velocity"


def _stepped_friction(rng, size):
    torque, angle = size * rng.uniform(0.008, 0.015), rng.uniform(-0.6, 0.6)

    def apply(p):
        _put_term(
            p, "mesh", "direction_link_position", angle - 1, angle + 1,
            lambda x: 0.5 * torque * (1 + np.tanh((x - angle) / 0.1)),
        )  # fmt: skip

    return {"torque": torque, "angle": angle}, apply, "mesh friction that is higher beyond an angle of the link"


def _half_order(rng, size):
    amplitude, phase = size * rng.uniform(0.8e-4, 2e-4), rng.uniform(0, 2 * np.pi)

    def apply(p):
        slot = int(np.flatnonzero(p["amplitude"] == 0)[0])
        p["order"][slot], p["amplitude"][slot], p["phase"][slot] = 0.5, amplitude, phase

    return (
        {"order": 0.5, "amplitude": amplitude, "phase": phase},
        apply,
        "kinematic error once in two turns of the motor",
    )


def _rotor_pulse(rng, size):
    torque, angle = size * _sign(rng) * rng.uniform(0.015, 0.03), rng.uniform(0, 2 * np.pi)

    def apply(p):
        _put_term(
            p, "rotor", "motor_position", 0.0, 2 * np.pi,
            lambda x: torque * np.exp(-0.5 * (((x - angle + np.pi) % (2 * np.pi) - np.pi) / 0.35) ** 2),
        )  # fmt: skip

    return {"torque": torque, "angle": angle}, apply, "a torque pulse on the rotor, once a turn"


def _current_drift(rng, size):
    current, seconds = size * _sign(rng) * rng.uniform(0.08, 0.2), rng.uniform(5, 12)

    def apply(p):
        _put_term(p, "motor_current", "time", 0.0, 60.0, lambda t: current * (1 - np.exp(-np.maximum(t, 0) / seconds)))

    return {"current": current, "time_constant": seconds}, apply, "a current reading that drifts as it warms up"


def _sensor_bend(rng, size):
    torque = size * _sign(rng) * rng.uniform(0.4, 0.9)

    def apply(p):
        _put_term(p, "joint_torque", "load", -16.0, 16.0, lambda T: torque * (T / 9.0) ** 2)

    return {"torque": torque}, apply, "a torque sensor that is not linear"


OUTSIDE: dict[str, Outside] = {
    "link_bump": Outside("link", _link_bump),
    "quadratic_friction": Outside("transmission", _quadratic_friction),
    "stepped_friction": Outside("transmission", _stepped_friction),
    "half_order": Outside("transmission", _half_order),
    "rotor_pulse": Outside("motor", _rotor_pulse),
    "current_drift": Outside("sensor", _current_drift),
    "sensor_bend": Outside("sensor", _sensor_bend, needs_sensor=True),
}
"""Effects outside the library."""


# --- draws -----------------------------------------------------------------------------------------------------------


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
    scenarios = _scenarios(challenge, nominal, streams[2])
    records, recordings = [], []
    for k, scenario in enumerate(scenarios):
        mounting = nominal.mount(scenario.mounting or None)
        record = calibration.record(x, mounting)
        for effect in effects:
            effect.apply(record[0])
        seed = int(np.random.default_rng([challenge.seed, index, 10 + k]).integers(2**31))
        known = bool(challenge.scenarios)
        recording = record_motion(nominal, mounting, record, scenario, seed, known)
        if not challenge.sensor:
            recording = bare(recording, streams[3])
        records.append(record)
        recordings.append(recording)
    measurement = Measurement(f"draw {index}", Path(), tuple(recordings))
    return Draw(effects, tuple(records), measurement, nominal)


_REDRAWN = 40
"""Joints drawn for an effect before the effect is drawn anew too: it may be within tolerance of nearly all of them."""


def _beyond_tolerance(
    challenge: Challenge, index: int, size: float, calibration: Calibration, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[Effect, ...]]:
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


@lru_cache
def _drowned(name: str) -> frozenset[str]:
    """Causes whose ordinary sizes the tolerances of that joint express, whatever they are."""
    joint = load_joint(name)
    calibration, record = Calibration(joint), joint.record()[0]
    x = np.zeros(calibration.size)

    def hidden(cause: causes.Cause) -> bool:
        rng = np.random.default_rng(0)
        drawn = (cause.draw(record, rng) for _ in range(_REDRAWN))
        effects = (Effect(cause.name, cause.component, v, "", lambda p, v=v: cause.apply(p, v)) for v in drawn)
        return all(within_tolerance(calibration, x, effect) for effect in effects)

    return frozenset(n for n in causes.of(joint) if hidden(causes.get(n)))


def within_tolerance(calibration: Calibration, x: np.ndarray, effect: Effect) -> bool:
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


def _effects(challenge: Challenge, index: int, size: float, nominal: Joint, rng) -> tuple[Effect, ...]:
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
        values, apply, description = chosen.make(rng, size)
        return (Effect("unknown", chosen.component, values, f"{names[0]}: {description}", apply),)
    # Of ordinary size against the nominal joint: that is what diagnosis can know.
    record = nominal.record()
    found = []
    for name in names:
        cause = causes.get(name)
        values = cause.draw(record[0], rng, size)
        found.append(
            Effect(name, cause.component, values, cause.description, lambda p, c=cause, v=values: c.apply(p, v))
        )
    return tuple(found)


def _scenarios(challenge: Challenge, nominal: Joint, rng: np.random.Generator) -> list[Scenario]:
    if challenge.scenarios:
        return [load_scenario(name)[0] for name in challenge.scenarios]
    mountings = list(nominal.mountings)
    lightest = min(mountings, key=lambda name: nominal.mountings[name].gravity_moment)
    return motions(rng, lightest, nominal.mounting, nominal.numbers["rated_torque"].value / 16.0)


def motions(
    rng: np.random.Generator, free: str = "no_load", link: str = "link", strength: float = 1.0
) -> list[Scenario]:
    """Three motions drawn anew, about 85 s: bare joint to both sides; link to both sides; link held and pushed.

    Args:
      free, link: mountings.
      strength: of the pushes, 1 for a joint of 16 N·m.
    """
    u = rng.uniform
    sweeps = [u(1.2, 1.45), -u(1.1, 1.45), u(1.2, 1.45), -u(0.9, 1.45), 0.0]
    bare_, loaded = [u(1.4, 1.65), -u(1.4, 1.7), 0.0], [u(1.2, 1.4), 0.0]
    hold = u(10.0, 13.0)
    pushed = _waypoints(loaded, [u(4.5, 7.0), u(4.0, 5.5)], [hold, 1.0], u(0.8, 1.2))
    pushes, at = [], u(1.2, 2.2)
    sign = _sign(rng)
    for _ in range(6):
        duration = u(0.15, 0.7)
        pushes.append(Disturbance(kind="push", start=at, duration=duration, torque=sign * strength * u(3.0, 7.0)))
        at += duration + u(1.5, 4.5)
        sign = -sign
    pushes = [d for d in pushes if d.start < pushed[-1].time - 1.5]
    return [
        _scenario("free", free, _waypoints(bare_, [u(2.5, 3.5), u(9, 12), u(2.5, 4)], [u(0.5, 1), u(0.5, 1.5), 0.5], u(0.5, 1))),
        _scenario("push", link, pushed, pushes),
        _scenario(
            "sweep", link,
            _waypoints(sweeps, [u(3.0, 4.0), u(6, 8), u(9, 12), u(4, 5.5), u(4, 5.5)], [*u(0.5, 2.0, 4), 0.5], u(0.5, 1)),
        ),
    ]  # fmt: skip


def _waypoints(positions, durations, holds, start) -> list[Waypoint]:
    points, t = [Waypoint(time=float(start), position=0.0)], float(start)
    for position, duration, hold in zip(positions, durations, holds, strict=True):
        points.append(Waypoint(time=t + duration, position=float(position)))
        t += float(duration + hold)
        points.append(Waypoint(time=t, position=float(position)))
    return points


def _scenario(name: str, mounting: str, points: list[Waypoint], pushes=()) -> Scenario:
    return Scenario(
        name=name, mounting=mounting, duration=points[-1].time + 0.3, trajectory=points, disturbances=list(pushes),
        controller=CONTROLLER,
    )  # fmt: skip


def record_motion(
    nominal: Joint, mounting: Mounting, record: np.ndarray, scenario: Scenario, seed: int, known: bool = False
) -> Recording:
    """What the sensors read when the joint of a record follows a scenario under the drive's controller.

    Args:
      nominal: sensors, structure, and what the recording says of the link.
      record: the true joint, shape (1,).
      known: whether the torque on the link is measured; else the recording says that pushes may have happened.
    """
    position, velocity = scenario.commands()
    external = scenario.external_torque()
    settings = (FilterSettings(name="EKF", rule="ekf"),)
    signals = simulate(
        plant.build(nominal, mounting, timestep=scenario.timestep, record=record, locked_rotor=scenario.locked_rotor),
        record,
        nominal.record(mounting),
        position,
        velocity,
        external,
        sensors.sensor_records(nominal, float(record[0]["link_delay"])),
        sensors.noise(seed, len(position)),
        scenario.controller.record(record[0], CONTROL_PERIOD, False),
        filter_bank(settings),
        np.array([settings[0].P0]),
    )
    column = {name: signals.readings[:, i].copy() for i, name in enumerate(READINGS)}
    pushed = bool(np.any(external))
    return Recording(
        name=scenario.name,
        time=signals.time,
        motor_position=column["motor_position"],
        link_position=column["link_position"],
        motor_current=column["motor_current"],
        joint_torque=column["joint_torque"],
        position_command=position,
        external_torque=external if pushed and known else None,
        joint=nominal.name,
        description=scenario.description or scenario.name,
        link=mounting,
        external="none" if not pushed else "measured" if known else "unmeasured",
    )


def bare(recording: Recording, rng: np.random.Generator) -> Recording:
    """The same without torque sensor, logged every 3 to 5 ms with single samples missing (9 ms)."""
    steps = rng.choice((3, 4, 5, 9), p=(0.17, 0.5, 0.17, 0.16), size=len(recording.time))
    keep = np.cumsum(steps)
    keep = keep[keep < len(recording.time)]
    columns = {name: values[keep] for name, values in recording.columns.items() if name != "joint_torque"}
    return Recording(
        name=recording.name,
        **columns,
        joint=recording.joint,
        description=recording.description,
        link=recording.link,
        external=recording.external,
    )


# --- one draw, diagnosed ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What diagnosis made of a draw.

    Attributes:
      index, size: of the draw.
      hidden: name → parameters; component: of the first; description of it.
      verdict, causes: as in `diagnosis.json`.
      deviations: of every parameter of every cause that was named rightly: "cause.parameter" → error in standard deviations,
        and as a share of the true value (of the ordinary range for an angle or a place).
      smallest: size, in units of this draw's own at size 1, that the Fisher information allows to find 9 times in 10.
      seconds: that diagnosis took.
      failure: message of an exception, empty without one.
    """

    index: int
    size: float
    hidden: dict[str, dict[str, float]]
    component: str
    description: str
    verdict: str
    causes: list[dict[str, Any]]
    deviations: dict[str, tuple[float, float]]
    smallest: float | None
    seconds: float
    failure: str = ""

    @property
    def named(self) -> list[str]:
        """Names of the causes found, first the one that explains most."""
        return [c["name"] for c in self.causes]

    @property
    def first_right(self) -> bool:
        """Whether the first cause is one of the hidden ones (or, where nothing is hidden, that there is none)."""
        return (self.named[0] in self.hidden) if self.named else not self.hidden

    @property
    def component_right(self) -> bool:
        """Whether the first cause's component is that of a hidden effect."""
        if not self.causes or not self.hidden:
            return not self.causes and not self.hidden
        components = {self.component} if "unknown" in self.hidden else {causes.get(n).component for n in self.hidden}
        return self.causes[0]["component"] in components

    @property
    def all_named(self) -> bool:
        """Whether all hidden effects are named."""
        return set(self.hidden) <= set(self.named)

    def row(self) -> dict[str, Any]:
        """As plain data, for JSON and Parquet."""
        return {
            "index": self.index, "size": self.size, "hidden": self.hidden, "component": self.component,
            "description": self.description, "verdict": self.verdict, "causes": self.causes,
            "first_right": self.first_right, "component_right": self.component_right, "all_named": self.all_named,
            "deviations": {k: list(v) for k, v in self.deviations.items()}, "smallest": self.smallest,
            "seconds": self.seconds, "failure": self.failure,
        }  # fmt: skip


def attempt(challenge: Challenge, index: int, size: float = 1.0) -> Outcome:
    """Draw, diagnose, compare."""
    drawn = draw(challenge, index, size)
    hidden = {e.name: e.values for e in drawn.effects}
    head = {
        "index": index, "size": size, "hidden": hidden, "component": drawn.effects[0].component if hidden else "",
        "description": "; ".join(e.description for e in drawn.effects),
    }  # fmt: skip
    begin = time.perf_counter()
    try:
        found = diagnose(drawn.measurement, drawn.nominal)
    except Exception as error:  # a draw that breaks diagnosis is a result, not the end of the challenge
        seconds = time.perf_counter() - begin
        return Outcome(
            **head, verdict="failed", causes=[], deviations={}, smallest=None, seconds=seconds,
            failure=f"{type(error).__name__}: {error}",
        )  # fmt: skip
    seconds = time.perf_counter() - begin
    smallest = None
    if challenge.hidden in ("one", "two"):
        smallest = smallest_size(found, drawn.nominal, drawn.effects[0]) * size
    return Outcome(
        **head, verdict=found.verdict, causes=found.to_json()["causes"], deviations=deviations(drawn.effects, found),
        smallest=smallest, seconds=seconds,
    )  # fmt: skip


def deviations(effects: tuple[Effect, ...], found: Diagnosis) -> dict[str, tuple[float, float]]:
    """Errors of the parameters of causes that were named rightly: in standard deviations, and relative."""
    errors = {}
    for effect in effects:
        for cause in found.causes:
            if cause.name != effect.name or cause.name == "unknown":
                continue
            for q in causes.get(cause.name).parameters:
                if q.integer:
                    continue
                p, true = cause.parameters[q.name], effect.values[q.name]
                error = p.value - true
                scale = abs(true)
                if q.period:
                    error = (error + 0.5 * q.period) % q.period - 0.5 * q.period
                    scale = 1.0
                elif not q.magnitude:
                    scale = max(scale, q.ordinary[-1][1] - q.ordinary[0][0])
                errors[f"{cause.name}.{q.name}"] = (
                    float(abs(error) / p.std) if p.std > 0 else float(np.inf if error else 0.0),
                    float(abs(error) / scale) if scale else float(np.inf),
                )
    return errors


def smallest_size(found: Diagnosis, nominal: Joint, effect: Effect) -> float:
    """Size of an effect, in units of its own, that is `DETECTED` standard deviations: Fisher information's limit.

    The information about the size is what is left after every calibration variable, within its tolerance, has answered.
    """
    problem, base = found.problem, found.rounds[0].base
    h = matching(nominal, effect)
    u = coordinates(h, effect.values)
    if not np.linalg.norm(u[h.magnitudes]) > 0:
        return np.inf
    step = 0.05 * u / np.linalg.norm(u[h.magnitudes])
    for i in range(h.size):
        if i not in h.magnitudes:
            step[i] = u[i]
    moved = problem.residuals([np.concatenate([base.theta, step])], [(h,)])[0]
    scale = 0.05 / float(np.linalg.norm(u[h.magnitudes]))
    column = [(m - r) / scale for m, r in zip(moved, base.state[0], strict=True)]
    information = information_left(problem, base, found.after, column)
    return float(DETECTED / np.sqrt(max(information, 1e-12)))


def information_left(problem: Problem, base: Fit, clean: list[np.ndarray], column: list[np.ndarray]) -> float:
    """Fisher information about the factor of a column of residuals, shape (k, 3) a stretch, all calibration variables free."""
    noise = estimate_noise(problem.drives, clean, np.zeros(3))
    n = problem.size
    X = whiten(
        problem.drives, noise,
        [np.concatenate([j[..., :n], c[..., None]], -1) for j, c in zip(base.jacobian, column, strict=True)],
    )  # fmt: skip
    G = X.T @ X
    H = G[:n, :n] + np.eye(n)
    return float(G[n, n] - G[n, :n] @ np.linalg.solve(H, G[:n, n]))


def matching(nominal: Joint, effect: Effect) -> Hypothesis:
    """The hypothesis that an effect of the library is an instance of."""
    whole = {q.name: effect.values[q.name] for q in causes.get(effect.name).parameters if q.integer}
    for h in hypotheses(causes.get(effect.name), nominal.record()):
        if all(h.fixed.get(k) == v for k, v in whole.items()):
            return h
    raise InputError(f"{effect.name}: no hypothesis with {whole}")


def coordinates(h: Hypothesis, values: dict[str, float]) -> np.ndarray:
    """Coordinates of parameter values in a hypothesis, shape (size,): the inverse of `Hypothesis.values`."""
    if h.polar:
        amplitude, phase = (q.name for q in h.free)
        z = values[amplitude] * np.exp(1j * values[phase])
        z = (z - h.centre[amplitude] * np.exp(1j * h.centre[phase])) / h.scale[amplitude]
        return np.array([z.real, z.imag])
    u = np.zeros(h.size)
    for i, q in enumerate(h.free):
        if q.magnitude:
            u[i] = (values[q.name] - h.centre[q.name]) / h.scale[q.name]
        elif q.ordinary[0][0] > 0:
            u[i] = np.log(values[q.name] / h.start[q.name]) / h.scale[q.name]
        else:
            u[i] = (values[q.name] - h.start[q.name]) / h.scale[q.name]
    return u


# --- many draws ------------------------------------------------------------------------------------------------------


def run(challenge: Challenge, count: int, sizes: tuple[float, ...] = (1.0,), jobs: int = 1) -> Iterator[Outcome]:
    """Outcomes of draws 0 … count − 1 at every size, as they come, on `jobs` processes.

    Raises:
      InputError: a joint, scenario or cause that does not exist; before anything is drawn.
    """
    nominal = load_joint(challenge.joint)
    challenge.pool()
    for name in challenge.scenarios:
        nominal.mount(load_scenario(name)[0].mounting or None)
    tasks = [(challenge, i, size) for i in range(count) for size in sizes]
    if jobs <= 1:
        for task in tasks:
            yield attempt(*task)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        pending = [pool.submit(attempt, *task) for task in tasks]
        try:
            for future in as_completed(pending):
                yield future.result()
        finally:
            for future in pending:
                future.cancel()


@dataclass(frozen=True)
class Rate:
    """A share of right answers with its 95 % interval (Wilson)."""

    right: int
    of: int

    @property
    def share(self) -> float:
        """Share, NaN of none."""
        return self.right / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 95 % interval."""
        if not self.of:
            return 0.0, 1.0
        ci = binomtest(self.right, self.of).proportion_ci(0.95, "wilson")
        return float(ci.low), float(ci.high)

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"{100 * self.share:.0f} % ({self.right}/{self.of}; {100 * low:.0f}–{100 * high:.0f})" if self.of else "–"
        )


def rate(outcomes: list[Outcome], what: Callable[[Outcome], bool]) -> Rate:
    """Share of outcomes of which `what` is true."""
    return Rate(sum(bool(what(o)) for o in outcomes), len(outcomes))


def summary(outcomes: list[Outcome]) -> dict[str, Rate | float]:
    """The rates of one size; times and parameter errors as medians."""
    hidden = [o for o in outcomes if o.hidden]
    quiet = [o for o in outcomes if not o.hidden]
    found: dict[str, Rate | float] = {}
    if quiet:
        found["false alarms"] = rate(quiet, lambda o: bool(o.causes))
    if hidden:
        found["first cause right"] = rate(hidden, lambda o: o.first_right)
        found["component right"] = rate(hidden, lambda o: o.component_right)
        found["nothing found"] = rate(hidden, lambda o: not o.causes)
        found["more named than hidden"] = rate(hidden, lambda o: bool(set(o.named) - set(o.hidden)))
    if any(len(o.hidden) > 1 for o in hidden):
        found["all named"] = rate(hidden, lambda o: o.all_named)
    errors = [v for o in hidden for v in o.deviations.values()]
    if errors:
        found["parameters within 3 std or 15 %"] = Rate(sum(s <= 3 or r <= 0.15 for s, r in errors), len(errors))
        found["parameters within 3 std"] = Rate(sum(s <= 3 for s, _ in errors), len(errors))
        found["median parameter error [std]"] = float(np.median([s for s, _ in errors]))
        found["median parameter error [%]"] = float(100 * np.median([r for _, r in errors]))
    if any(o.failure for o in outcomes):
        found["failed"] = rate(outcomes, lambda o: bool(o.failure))
    found["median time [s]"] = float(np.median([o.seconds for o in outcomes]))
    return found


def confusion(outcomes: list[Outcome]) -> dict[str, Counter]:
    """What was hidden → what was named first, counted; `nothing` where there was none."""
    table: dict[str, Counter] = {}
    for o in sorted(outcomes, key=lambda o: o.index):
        truth = " + ".join(o.hidden) or "nothing"
        if "unknown" in o.hidden:
            truth = o.description.split(":")[0]
        table.setdefault(truth, Counter())[o.named[0] if o.named else o.verdict] += 1
    return table


CONFIDENCES = (0.0, 0.5, 0.7, 0.9, 0.97, 1.0)


def reliability(outcomes: list[Outcome]) -> list[tuple[float, float, float, Rate]]:
    """Calibration of confidence, over all named causes: from, to, mean confidence, share that is right."""
    named = [(c["confidence"], c["name"] in o.hidden) for o in outcomes for c in o.causes]
    rows = []
    for low, high in itertools.pairwise(CONFIDENCES):
        inside = [(c, right) for c, right in named if low <= c < high or (high == 1.0 and c == 1.0)]
        if inside:
            rows.append(
                (low, high, float(np.mean([c for c, _ in inside])), Rate(sum(r for _, r in inside), len(inside)))
            )
    return rows


def found_nine_in_ten(outcomes: list[Outcome]) -> float | None:
    """Smallest size at which, and above which, nine in ten first causes are right; between sizes on the log scale.

    None where not even the largest size reaches that.
    """
    shares = [
        (size, rate([o for o in outcomes if o.size == size], lambda o: o.first_right).share)
        for size in sorted({o.size for o in outcomes}, reverse=True)
    ]
    best = None
    for i, (size, share) in enumerate(shares):
        if share >= 0.9:
            best = size
            continue
        if best is not None and i:
            above = shares[i - 1][1]
            weight = (above - 0.9) / max(above - share, 1e-9)
            best = float(np.exp((1 - weight) * np.log(best) + weight * np.log(size)))
        break
    return best
