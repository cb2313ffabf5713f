"""Plan the next measurement: the expected information of possible experiments about open questions.

Every experiment is simulated with the *extended* joint, the drive's controller, and the sensors of the measurement or one more.
Its Fisher information, under the sensors' noise and the learned model discrepancy, is added to that of the measurement:

    I = Σ Jᵀ W J + prior,    I_a = I_aa − I_an I_nn⁻¹ I_na

with a the question's coordinates and n all calibration variables and effects. The strength of an answer is in standard
deviations: of a cause of ordinary size (√ of the mean of I_a's diagonal), of the difference between two causes of ordinary size,
or of the size of an effect or number.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..models import causes, laws
from ..models.controller import Controller
from ..models.errors import InputError
from ..models.joint import Joint
from ..models.joint_parts import LOCKED, Mounting
from ..models.notebook import listing, paragraph
from ..models.parameters import GRAVITY
from ..models.recording import Measurement, Recording
from ..models.signals import POSITIONS
from ..scenarios.scenario import Scenario, Waypoint
from ..sim.plant import TIMESTEP
from .data import coverage
from .data.segments import segments
from .extension import value_and_std
from .fit.coordinates import Hypothesis, hypotheses
from .fit.noise import Noise, sensor_noise, whiten
from .fit.residual import Problem
from .fit.solver import Columns, Fit, evaluate_point, leverage_weight
from .search.identifiability import ALIKE, SHOWS, distance
from .search.screen import Library
from .trials.motions import CONTROLLER, record_motion, waypoints

if TYPE_CHECKING:
    from .answer import Diagnosis

_TIMESTEP = 5e-4  # s, of the plant; accurate enough for planning
_RESOLVED = 0.3  # rad of the resonance in a step: with a lighter link the plant's usual step is taken
_SOFT = 4.0  # turns of a soft drive's command per turn of the rotor that it makes
_THIN = 8e-3  # s between samples that summarise a motion
_ABOUT = 0.25  # of half the range that was visited: motions are about zero where its middle is so near
_FREE = 0.1  # rad beyond what was visited that a motion may go without a question
_NUMBERS = ("Kt", "K1", "K2", "K3", "Fc", "Fs", "bw", "Jm", "Jl", "Mg")
"""Numbers of a joint that experiments may target."""


@dataclass(frozen=True)
class PlanSettings:
    """Weights and limits of experiments; strengths in standard deviations."""

    shows: float = float(np.sqrt(SHOWS))  # at which a cause is detected
    apart: float = float(np.sqrt(ALIKE))  # at which two causes are distinguished
    known: float = 10.0  # at which a size is known
    wide: float = 0.5  # share of its tolerance above which a number is in question
    sharp: float = 100.0  # z-score below which it is
    widest: int = 3  # numbers in question
    sharper: float = 2.0  # least improvement of such a number
    least: float = 0.1  # least progress on some question of a proposed experiment
    variants: int = 6  # hypotheses that represent a cause with many orders or starts
    range: float = 1.3  # largest angle of experiments [rad]
    load: float = 0.7  # their torque over the rated torque
    heaviest: float = 0.9  # largest gravity torque with a payload over the rated torque
    speed: float = 0.5  # largest speed over the motor's no-load speed
    effort: tuple[float, float, float] = (0.1, 0.2, 0.4)  # of a load, a clamp and a further sensor, in questions
    size: float = 0.7  # weight of the size of an effect; the presence of a cause has weight 1
    number: float = 0.3  # weight of a number
    warming: float = 10.0  # of the gear, where its temperature is read [K]

    def weight(self, q: Question) -> float:
        """Return the weight of an answer, in questions."""
        return self.number if q.of_number else self.size if q.parameter else 1.0


SETTINGS = PlanSettings()


@dataclass(frozen=True)
class Question:
    """An open question: whether a cause is present, which of two it is, or how large something is."""

    names: tuple[str, ...]  # one cause, a pair, or a number of the joint
    now: float  # strength of the measurement's answer, in standard deviations
    needed: float  # strength at which it is answered
    parameter: str = ""  # of the cause, if its size is in question; `value` of a number

    @property
    def of_number(self) -> bool:
        """Whether it is about a number of the joint."""
        return self.names[0] in _NUMBERS

    @property
    def subject(self) -> str:
        """Subject as text."""
        plain = " and ".join(n.replace("_", " ") for n in self.names)
        return plain if self.parameter in ("", "value") else f"{plain}'s {self.parameter.replace('_', ' ')}"

    @property
    def text(self) -> str:
        """Question as text."""
        return f"how large {self.subject} is" if self.parameter else self.subject.replace(" and ", " or ")

    def answer(self, expected: float, brief: bool = False) -> str:
        """Return the expected answer as text, without `verb`; `brief`: without the unit."""
        if self.parameter:
            after, now = (f"±{100 / max(z, 1e-9):.2g} %" for z in (expected, self.now))
            return f"{self.subject} to {after} (now {now})"
        link = "apart by" if len(self.names) > 1 else "by"
        unit = "" if brief else " standard deviations"
        return f"{self.subject} {link} {_count(expected)}{unit} (now {_count(self.now)})"

    def progress(self, expected: float) -> float:
        """Return the part of the needed strength that an experiment adds."""
        return (min(expected, self.needed) - self.now) / self.needed

    @property
    def verb(self) -> str:
        """Verb of the expected answer."""
        return "would know" if self.parameter else "would tell" if len(self.names) > 1 else "would show"


def _count(z: float) -> str:
    return "more than 100" if z > 100 else f"{z:.0f}" if z >= 9.95 or z < 0.05 else f"{z:.1f}"


@dataclass(frozen=True)
class Proposal:
    """An experiment and its expected answers together with the measurement."""

    name: str  # of the experiment
    description: str  # instructions
    duration: float  # [s]
    expected: tuple[float, ...]  # standard deviations of the questions
    score: float = 0.0  # weighted progress on the questions, minus the effort


@dataclass(frozen=True)
class Plan:
    """Open questions, and experiments, the best first."""

    questions: tuple[Question, ...] = ()
    proposals: tuple[Proposal, ...] = ()

    def answered(self, proposal: Proposal) -> list[Question]:
        """Questions that a proposal is expected to answer."""
        return [q for q, e in zip(self.questions, proposal.expected, strict=True) if e >= q.needed]

    def sentence(self, proposal: Proposal, most: int = 5) -> str:
        """Return the instructions and the expected answers to at most `most` questions."""
        gains = [(q.progress(e), q, e) for q, e in zip(self.questions, proposal.expected, strict=True)]
        gains = sorted((g for g in gains if g[0] > SETTINGS.least), key=lambda g: -g[0])
        by_verb: dict[str, list[str]] = {}
        for _, q, e in gains[:most]:
            by_verb.setdefault(q.verb, []).append(q.answer(e, bool(by_verb.get(q.verb)) and not q.parameter))
        parts = [f"{verb} {', '.join(answers)}" for verb, answers in by_verb.items()]
        more = f", and {len(gains) - most} more" if len(gains) > most else ""
        return f"{proposal.description} ({proposal.duration:.0f} s): {'; '.join(parts)}{more}."

    def sentences(self) -> list[str]:
        """The proposals, best first."""
        return [self.sentence(p) for p in self.proposals]

    def __repr__(self) -> str:
        names = ", ".join(p.name for p in self.proposals) or "none"
        return f"Plan({len(self.questions)} questions; proposals: {names})"

    def _repr_html_(self) -> str:
        proposals = listing(self.sentences()) or paragraph("", "no experiment adds information")
        return paragraph("What to measure next") + proposals

    def to_json(self) -> list[dict[str, Any]]:
        """Return `next` of `diagnosis.json`."""
        return [
            {
                "experiment": p.name,
                "description": p.description,
                "duration": round(p.duration, 1),
                "sentence": self.sentence(p),
                "answers": [q.text for q in self.answered(p)],
                "expected": [
                    {
                        "about": list(q.names), **({"parameter": q.parameter} if q.parameter else {}),
                        "now": round(q.now, 2), "expected": round(e, 2), "needed": round(q.needed, 2),
                        "unit": "standard deviations",
                    }
                    for q, e in zip(self.questions, p.expected, strict=True)
                ],
            }
            for p in self.proposals
        ]  # fmt: skip


def plan(measurement: Measurement, diagnosis: Diagnosis) -> Plan:
    """Plan experiments for the open questions of a diagnosis.

    Args:
      measurement: that was diagnosed.
      diagnosis: the result; if it stopped at mistakes in the data, the plan is empty.

    Returns:
      Useful experiments, the best first.
    """
    if diagnosis.problem is None or diagnosis.final is None:
        return Plan()
    problem, at = diagnosis.problem, _without_splines(diagnosis.problem, diagnosis.final)
    joint = problem.joint  # with sensors as coarse and as slow as they were logged
    asked = [*_asked(measurement, diagnosis, joint), *_numbers(problem, at)]
    tried = _representatives(joint, at, problem, asked)
    thin = tuple(_thin(r) for r in measurement.recordings)
    missing = coverage.undetermined(replace(measurement, recordings=thin), joint)
    state = _State(problem, at, tried)
    known = state.information(problem, at.noise, at.jacobian, _shown(measurement, tried))
    questions = tuple(q for q in (state.question(one, known, missing) for one in asked) if q.now < q.needed)
    if not questions:
        return Plan()

    def judged(e: PlannedExperiment) -> Proposal | None:
        try:
            recording = perform(e, diagnosis.extended, joint)
        except InputError:
            return None  # unstable motion of the extended joint
        new = Problem(*segments([recording], joint), joint)
        if not new.segments:
            return None
        noise = _expected_noise(new, at, problem)
        together = replace(measurement, recordings=(*thin, _thin(recording)))
        more = state.information(new, noise, new.jacobian(at.theta, at.model), _shown(together, tried))
        lacking = missing.keys() & coverage.undetermined(together, joint).keys()
        expected = tuple(
            q.now if lacking.intersection(q.names) else max(q.now, state.strength(q, known + more, known))
            for q in questions
        )
        progress = [q.progress(z) for q, z in zip(questions, expected, strict=True)]
        if max(progress) < SETTINGS.least:
            return None
        weighted = sum(
            SETTINGS.weight(q) * 0.5 * (part + (z >= q.needed))
            for q, z, part in zip(questions, expected, progress, strict=True)
        )
        score = weighted - SETTINGS.effort[0] * e.duration / 30.0 - e.effort
        return Proposal(e.name, e.description, e.duration, expected, round(score, 3)) if score > 0 else None

    with ThreadPoolExecutor(min(os.cpu_count() or 1, 4)) as pool:
        proposals = [p for p in pool.map(judged, experiments(measurement, joint, diagnosis)) if p is not None]
    return Plan(questions, tuple(sorted(proposals, key=lambda p: -p.score)))


def _thin(recording: Recording) -> Recording:
    """Return a recording with the samples that its range and speed need."""
    every = max(min(int(_THIN / recording.interval), len(recording.time) // 2), 1)
    return recording.at(slice(None, None, every))


# --- the questions ---------------------------------------------------------------------------------------------------


def _asked(measurement: Measurement, diagnosis: Diagnosis, joint: Joint) -> Iterator[Question]:
    """Yield open questions; those without a parameter get their strength later."""
    known = set(causes.of(joint))
    # Errors of missing sensors are not in question.
    read = {column for r in measurement.recordings for column in r.columns}
    absent = {n for n in known if (sensor := causes.get(n).sensor) and sensor not in read}
    open_ = [n for n in diagnosis.undetermined if n in known - absent]
    yield from (Question((n,), 0.0, SETTINGS.shows) for n in open_)
    yield from (Question(pair, 0.0, SETTINGS.apart) for pair in diagnosis.confusable if set(pair) <= known)
    for finding in diagnosis.causes:
        if finding.name not in known:
            continue
        neutral = causes.get(finding.name).present(joint.record()[0])
        for q in causes.get(finding.name).parameters:
            p = finding.parameters[q.name]
            if q.magnitude and p.std > 0 and abs(p.value - neutral[q.name]) < SETTINGS.known * p.std:
                yield Question((finding.name,), abs(p.value - neutral[q.name]) / p.std, SETTINGS.known, q.name)


def _numbers(problem: Problem, at: Fit) -> list[Question]:
    """Return questions on the numbers that the measurement hardly improved, the least known first."""
    c = problem.calibration
    x, prior = at.theta[: c.size], np.eye(c.size)
    found = []
    for slot in c.slots:
        if slot.name not in _NUMBERS or not (slot.number.tolerance or slot.number.shared):
            continue
        value, std = value_and_std(c, slot, x, at.covariance[: c.size, : c.size])
        z = abs(value) / max(std, 1e-300)
        if std > SETTINGS.wide * value_and_std(c, slot, x, prior)[1] and z < SETTINGS.sharp:
            found.append(Question((slot.name,), z, SETTINGS.sharper * z, "value"))
    return sorted(found, key=lambda q: q.now)[: SETTINGS.widest]


def _without_splines(problem: Problem, f: Fit) -> Fit:
    """Return the fit without unknown effects."""
    named = [i for i, h in enumerate(f.model) if isinstance(h, Hypothesis)]
    if len(named) == len(f.model):
        return f
    kept = np.concatenate([np.arange(problem.size), *(_columns(problem, f, i) for i in named)])
    return replace(
        f,
        model=tuple(f.model[i] for i in named),
        theta=f.theta[kept],
        jacobian=[j[..., kept] for j in f.jacobian],
        covariance=f.covariance[np.ix_(kept, kept)],
        noise_jacobian=None,
    )


def _columns(problem: Problem, f: Fit, index: int) -> np.ndarray:
    """Return the unknowns of an effect of a fit's model, as indices."""
    place = problem.place(f.model, index)
    return np.arange(place.start, place.stop)


def _representatives(joint: Joint, at: Fit, problem: Problem, asked: Sequence[Question]) -> list[Hypothesis]:
    """Return hypotheses of the causes in question that are not in the model."""
    there = {h.cause.name for h in at.model}
    present = {effect.name: effect.values for effect in joint.effects}
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    found: list[Hypothesis] = []
    for name in dict.fromkeys(n for q in asked for n in q.names if n not in there and not q.of_number):
        every = hypotheses(causes.get(name), record, present.get(name))
        chosen = np.unique(np.linspace(0, len(every) - 1, min(SETTINGS.variants, len(every))).astype(int))
        found += [every[i] for i in chosen]
    return found


def _shown(measurement: Measurement, tried: Sequence[Hypothesis]) -> set[str]:
    """Return the causes that the channels of a measurement can show."""
    both = any(all(name in r for name in POSITIONS) for r in measurement.recordings)
    return {h.cause.name for h in tried if coverage.can_show(h.cause.name, measurement, both)}


class _State:
    """Linearisation at a fit, extended by hypotheses that are not in its model. Columns of the information: the fit's unknowns,
    then the magnitudes of every hypothesis."""

    def __init__(self, problem: Problem, at: Fit, tried: list[Hypothesis]):
        self.problem, self.at, self.tried = problem, at, tried
        self.size = self.columns = len(at.theta)
        self.precision = 1 / problem.spread(at.model) ** 2
        self.model_blocks = [_columns(problem, at, i) for i in range(len(at.model))]
        self.tried_blocks: list[np.ndarray] = []
        self.blocks: dict[str, list[np.ndarray]] = {}
        for h, block in zip(at.model, self.model_blocks, strict=True):
            self.blocks.setdefault(h.cause.name, []).append(block[h.magnitudes])
        for h in tried:
            self.tried_blocks.append(np.arange(self.columns, self.columns + len(h.magnitudes)))
            self.columns += len(h.magnitudes)
            self.blocks.setdefault(h.cause.name, []).append(self.tried_blocks[-1])

    def information(self, problem: Problem, noise: Noise, jacobian: Columns, shown: set[str]) -> np.ndarray:
        """Return the Fisher information of data, shape (columns, columns); zero for causes that are not `shown`."""
        tried = [i for i, h in enumerate(self.tried) if h.cause.name in shown]
        library = Library.at(problem, self.at, [self.tried[i] for i in tried])
        X = whiten(problem.segments, noise, jacobian, *([library.whole] if tried else [])).rows
        X = X[np.all(np.isfinite(X), axis=1)]
        X = X * np.sqrt(leverage_weight(X[:, : self.problem.size]))[:, None]
        found = np.zeros((self.columns, self.columns))
        where = np.concatenate([np.arange(self.size), *(self.tried_blocks[i] for i in tried)])
        found[np.ix_(where, where)] = X.T @ X
        return found

    def question(self, asked: Question, known: np.ndarray, missing: dict[str, str]) -> Question:
        """Return the question with the strength of the measurement's answer."""
        if asked.parameter:
            return asked
        most = 0.9 * asked.needed if missing.keys() & set(asked.names) else np.inf  # motion or channels cannot show it
        return replace(asked, now=min(self.strength(asked, known, known), most))

    def strength(self, q: Question, information: np.ndarray, before: np.ndarray) -> float:
        """Return the strength of an answer with some information; `before`: of the measurement alone."""
        if q.parameter:
            after, first = (self._deviation(q, np.linalg.inv(self._posterior(one))) for one in (information, before))
            return q.now * float(np.min(first / np.maximum(after, 1e-300)))
        named = [b for b, h in zip(self.model_blocks, self.at.model, strict=True) if h.cause.name in q.names]
        answering = np.setdiff1d(np.arange(self.size), np.concatenate([np.empty(0, int), *named]))
        H = self._posterior(information)[np.ix_(answering, answering)]
        own = [block for name in q.names for block in self.blocks[name]]
        columns = np.concatenate(own)
        cross = information[np.ix_(answering, columns)]
        left = information[np.ix_(columns, columns)] - cross.T @ np.linalg.solve(H, cross)
        ends = np.cumsum([0, *map(len, own)]).tolist()
        places = [slice(begin, end) for begin, end in pairwise(ends)]
        if len(q.names) == 1:
            strengths = [float(np.trace(left[p, p]) / max(p.stop - p.start, 1)) for p in places]
            return float(np.sqrt(max(np.median(strengths), 0.0)))
        count = len(self.blocks[q.names[0]])
        return float(np.sqrt(max(distance(left, places[:count], places[count:]), 0.0)))

    def _posterior(self, information: np.ndarray) -> np.ndarray:
        """Return the precision of the fit's unknowns, shape (n, n)."""
        return information[: self.size, : self.size] + np.diag(self.precision)

    def _deviation(self, q: Question, covariance: np.ndarray) -> np.ndarray:
        """Return the standard deviations of a number, or of an effect's magnitudes, shape (m,)."""
        if q.of_number:
            c = self.problem.calibration
            slot = next(s for s in c.slots if s.name == q.names[0])
            x = self.at.theta[: c.size]
            return np.array([value_and_std(c, slot, x, covariance[: c.size, : c.size])[1]])
        i = next(i for i, h in enumerate(self.at.model) if h.cause.name == q.names[0])
        where = self.model_blocks[i][self.at.model[i].magnitudes]
        return np.sqrt(np.maximum(np.diag(covariance)[where], 0.0))


def _expected_noise(new: Problem, at: Fit, old: Problem) -> Noise:
    """Return the expected noise of a simulated recording: sensor noise and the learned model discrepancy; of a new balance the
    largest of the others, as a torque at the output."""
    point = evaluate_point(new, at.theta, at.model)
    formed = np.any([s.balances for s in old.segments], axis=0)
    scale = old.output_scale[:, None]
    largest = np.max((at.noise.discrepancy * scale)[formed], axis=0, initial=0.0)
    discrepancy = np.where(formed[:, None], at.noise.discrepancy, largest / scale)
    typical = np.maximum(np.median(at.noise.rest, axis=0), new.quantum())
    rest = np.tile(np.where(formed, typical, new.quantum()), (len(new.segments), 1))
    return Noise(sensor_noise(new.segments, point.noise), discrepancy, rest, at.noise.bands)


# --- the experiments -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PlannedExperiment:
    """An experiment."""

    name: str
    description: str  # instructions
    mounting: Mounting  # of the link
    motion: tuple[Waypoint, ...]  # of the link; with a locked output, of the rotor over the gear ratio
    channels: frozenset[str]  # columns that are recorded
    interval: float  # between samples [s]
    effort: float = 0.0  # in addition to time, in questions
    locked: bool = False  # the output is bolted to the bench
    controller: Controller = CONTROLLER  # of the drive
    warming: float = 0.0  # of the gear [K]

    @property
    def duration(self) -> float:
        """[s]."""
        return self.motion[-1].time + 0.3


def perform(e: PlannedExperiment, joint: Joint, described: Joint, seed: int = 1) -> Recording:
    """Simulate an experiment on a joint, with its assumed numbers, sensors and effects; `described`: with the drive's torque
    constant; `seed`: of the sensors' noise."""
    record = joint.record(e.mounting)
    p = record[0]
    slow = np.sqrt((p["K1"] + p["K2"] + p["K3"]) / p["Jl"]) * _TIMESTEP < _RESOLVED
    scenario = Scenario(
        name=e.name, duration=e.duration, trajectory=list(e.motion), controller=e.controller,
        timestep=_TIMESTEP if slow and not e.locked else TIMESTEP,
    )  # fmt: skip
    rate = e.warming / e.duration
    found = record_motion(joint, e.mounting, record, scenario, seed, warming=rate)
    columns = dict(found.columns)
    if e.locked:
        columns["link_position"] = np.full(len(found.time), float(p["link_zero"]))
    if "motor_torque" in e.channels:
        columns["motor_torque"] = described.record(e.mounting)[0]["Kt_drive"] * columns["motor_current"]
    if e.warming:
        columns["temperature"] = float(p["reference_temperature"]) + rate * found.time
    kept = {name: values for name, values in columns.items() if name in e.channels}
    external: Literal["none", "unmeasured"] = "unmeasured" if e.locked else "none"
    whole = replace(found, name=e.name, joint=described.name, columns=kept, external=external)
    every = max(round(e.interval / float(found.time[1] - found.time[0])), 1)
    return whole.at(slice(None, None, every))


def experiments(measurement: Measurement, joint: Joint, diagnosis: Diagnosis) -> list[PlannedExperiment]:
    """Return possible experiments: motions, loads, a locked output, one more sensor."""
    bench = _Bench(measurement, joint, diagnosis)
    return [*_motions(bench), *_loads(bench, measurement), *_with_equipment(bench)]


class _Bench:
    """What an experiment can do with a joint."""

    def __init__(self, measurement: Measurement, joint: Joint, diagnosis: Diagnosis):
        recordings = measurement.recordings
        self.joint, self.rated = joint, joint.numbers["rated_torque"].value  # [N·m]
        self.p = diagnosis.extended.record()[0]  # of the joint that was found
        links = [r.link for r in recordings if not r.link.locked] or [joint.mount()]
        self.link = max(links, key=lambda m: m.gravity_moment)  # the heaviest load of the measurement
        self.channels = frozenset(name for r in recordings for name in r.columns) & {
            "motor_position", "link_position", "motor_current", "motor_torque", "joint_torque", "temperature",
        }  # fmt: skip
        self.interval = float(np.median([r.interval for r in recordings]))  # between samples [s]
        N = float(self.p["N"])
        angles = [r["link_position"] if "link_position" in r else r["motor_position"] / N for r in recordings]
        # Range of the link that the measurement visited, centre and reach of the motions proposed [rad].
        self.low, self.high = min(float(np.min(a)) for a in angles), max(float(np.max(a)) for a in angles)
        half = 0.5 * (self.high - self.low)
        self.centre = 0.0 if abs(self.low + half) < _ABOUT * half else self.low + half
        self.reach = float(np.clip(half, 0.4, SETTINGS.range))

    @property
    def motion(self) -> str:
        """The usual motion, in words."""
        return f"move through {self.span(self.reach)} and back, 6 s each way"

    def experiment(
        self, name: str, text: str, points: Sequence[Waypoint], mounting: Mounting | None = None, **options: Any
    ) -> PlannedExperiment:
        """Return an experiment with a motion about the centre."""
        mounting = mounting or self.link
        if not mounting.locked:
            points = [w.model_copy(update={"position": w.command + self.centre}) for w in points]
            if any(not self.low - _FREE <= w.command <= self.high + _FREE for w in points):
                text += f"; the measurement covers {_angle(self.low)} … {_angle(self.high)} rad: check for collisions beyond"
        options.setdefault("channels", self.channels)
        return PlannedExperiment(name, text, mounting, tuple(points), interval=self.interval, **options)

    def span(self, amplitude: float) -> str:
        """Return the range of a motion, in words."""
        if self.centre == 0.0:
            return f"±{amplitude:.2g} rad"
        return f"{_angle(self.centre - amplitude)} … {_angle(self.centre + amplitude)} rad"

    def sweeps(self, amplitude: float | None = None, seconds: float = 6.0) -> list[Waypoint]:
        """Return waypoints of two strokes, `seconds` each way."""
        a = self.reach if amplitude is None else amplitude
        return waypoints([a, -a, a, 0.0], [0.6 * seconds, seconds, seconds, 0.6 * seconds], [0.4] * 4, 0.4)

    def shortest(self, way: float) -> float:
        """Return the shortest time [s] of a move [rad] that motor and rated torque allow."""
        p, link, N = self.p, self.link, float(self.p["N"])
        angles = np.linspace(self.centre - self.reach, self.centre + self.reach, 50)
        steepest = float(np.max(np.abs(np.sin(angles + link.gravity_angle))))
        speed = SETTINGS.speed * p["supply_voltage"] / (p["Kt"] * N)
        left = max(SETTINGS.load * self.rated - link.gravity_moment * steepest, 0.2 * self.rated)
        motor = 0.4 * p["Kt"] * p["current_limit"] / ((p["Jm"] + p["Jw"]) * N)
        return max(1.875 * way / speed, float(np.sqrt(5.78 * way / min(left / link.inertia, motor))), 0.5)


def _motions(bench: _Bench) -> Iterator[PlannedExperiment]:
    """Yield experiments that only move."""
    reach, span = bench.reach, bench.span
    yield bench.experiment("sweeps", f"Move the link through {span(reach)} and back, 6 s each way", bench.sweeps())
    fast = bench.shortest(2 * reach)
    first = bench.sweeps(reach, fast)
    slower = [w.model_copy(update={"time": w.time + first[-1].time}) for w in bench.sweeps(reach, 1.5 * fast)]
    text = f"Move the link through {span(reach)} and back as fast as {fast:.2g} s each way"
    yield bench.experiment("fast_sweeps", text, [*first, *slower])
    text = f"Turn back and forth by 0.05 rad at 0.04 rad/s, at three angles within {span(0.7 * reach)}"
    yield bench.experiment("slow_reversals", text, _reversals([-0.7 * reach, 0.0, 0.7 * reach], 0.05, 0.04))
    poses = [*np.linspace(-reach, reach, 7), *np.linspace(reach, -reach, 7)[1:], 0.0]
    step, half = max(bench.shortest(reach / 3), 0.8), max(bench.shortest(reach), 2.0)
    points = waypoints(poses, [half, *[step] * (len(poses) - 2), half], [0.7] * len(poses), 0.4)
    text = f"Hold still at seven angles within {span(reach)}, each reached from both sides"
    yield bench.experiment("rest_poses", text, points)
    text = f"Move the link as far as {span(1.4 * reach)} and back, 8 s each way"
    yield bench.experiment("larger_range", text, bench.sweeps(1.4 * reach, 8.0))


def _loads(bench: _Bench, measurement: Measurement) -> Iterator[PlannedExperiment]:
    """Yield experiments with another load."""
    link, arm, effort = bench.link, 0.3, SETTINGS.effort[0]
    extra = min(0.25 * bench.rated, SETTINGS.heaviest * bench.rated - link.gravity_moment)
    if extra > 0.05 * bench.rated:
        mass = float(f"{extra / (GRAVITY * arm):.1g}")
        loaded = Mounting(
            inertia=float(f"{link.inertia + mass * arm**2:.4g}"),
            gravity_moment=float(f"{link.gravity_moment + mass * GRAVITY * arm:.4g}"),
            gravity_angle=link.gravity_angle,
        )
        where = f"link: {{inertia: {loaded.inertia:g}, gravity_moment: {loaded.gravity_moment:g}}}"
        if any(r.arm is not None for r in measurement.recordings):
            where = "in the arm's MJCF, too"
        text = f"Add a known payload, {mass:g} kg at {arm:g} m ({where}), and {bench.motion}"
        yield bench.experiment("second_payload", text, bench.sweeps(), loaded, effort=effort)
    name, lightest = min(bench.joint.mountings.items(), key=lambda pair: (pair[1].locked, pair[1].gravity_moment))
    used = [r.link for r in measurement.recordings if not r.link.locked] or [bench.joint.mount()]
    if lightest.gravity_moment < 0.5 * min(m.gravity_moment for m in used):
        text = f"Take the load off (mounting {name}) and {bench.motion}"
        yield bench.experiment("light_link", text, bench.sweeps(), lightest, effort=effort)


def _with_equipment(bench: _Bench) -> Iterator[PlannedExperiment]:
    """Yield experiments with the output bolted to the bench, and with one more sensor."""
    if "motor_position" in bench.channels:
        torque = SETTINGS.load * bench.rated
        winding, soft = _locked(bench.p, torque)
        yield bench.experiment(
            "locked_output",
            f"Bolt the output to the bench (link: {{inertia: {LOCKED:g}, gravity_moment: 0}}, external_torque: unmeasured, "
            f"link_position constant) and drive the motor back and forth to ±{torque:.3g} N·m",
            winding, Mounting(inertia=LOCKED, gravity_moment=0.0), effort=SETTINGS.effort[1], locked=True, controller=soft,
            channels=bench.channels | {"link_position"},
        )  # fmt: skip
    for column, text in {
        "motor_position": "Add the motor's encoder (column motor_position),",
        "link_position": "Add a second encoder, at the link (column link_position),",
        "joint_torque": "Add a torque sensor at the output (column joint_torque),",
        "temperature": f"Record the gear's temperature (column temperature) from cold until {SETTINGS.warming:g} K warmer,",
    }.items():
        if column not in bench.channels:
            yield bench.experiment(
                f"with_{column}", f"{text} and {bench.motion}", bench.sweeps(), effort=SETTINGS.effort[2],
                channels=bench.channels | {column}, warming=SETTINGS.warming if column == "temperature" else 0.0,
            )  # fmt: skip


def _angle(x: float) -> str:
    return f"{round(x, 1 if abs(x) >= 1 else 2) + 0.0:g}".replace("-", "−")


def _reversals(centres: Sequence[float], width: float, speed: float) -> list[Waypoint]:
    """Return small strokes at constant speed about each centre."""
    points, t = [Waypoint(time=0.4, position=0.0)], 0.4
    for centre in centres:
        t += 2.5
        points.append(Waypoint(time=t, position=centre))
        for part in (0.5, -0.5, 0.5, -0.5, 0.0):
            target = centre + part * width
            t += max(abs(target - points[-1].command) / speed, 0.2)
            points.append(Waypoint(time=t, position=target, profile="linear"))
    return [*points, Waypoint(time=t + 2.5, position=0.0)]


def _locked(p: np.void, torque: float) -> tuple[list[Waypoint], Controller]:
    """Return waypoints of the rotor over the gear ratio, and a soft drive, for a locked output up to ±`torque` [N·m]: the current
    then follows the command, not the rotor's angle."""
    on_rotor = torque / p["N"] + p["Fc"]
    wound = float(laws.flexspline_torsion(torque, p) * p["N"] + laws.wave_generator_torsion(on_rotor, p))
    reach = (1 + _SOFT) * wound / p["N"]
    stiffness = float(on_rotor / p["Kt"] / (_SOFT * wound))
    points, t = [Waypoint(time=0.4, position=0.0)], 0.4
    for amplitude, seconds, turns in ((1.0, 0.25, 6), (1.0, 1.5, 2), (0.4, 0.8, 3), (0.1, 0.6, 3)):
        for _ in range(turns):
            for sign in (1.0, -1.0):
                t += seconds
                points.append(Waypoint(time=t, position=sign * amplitude * reach))
    return [*points, Waypoint(time=t + 0.5, position=0.0)], Controller(kp=stiffness, kd=0.01 * stiffness, ki=0.0)
