"""Recordings in, causes out: what a joint hides, how sure that is, and the joint extended by it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..models import causes
from ..models.joint import Effect, Estimate, Joint
from . import identify, unknown
from .calibrate import Fit, Problem, robust_loss, with_dispersion
from .coordinates import hypotheses
from .evidence import THRESHOLD, Library, Round, Search, level, search
from .noise import louder
from .replay import CHANNELS, DECIMATION, HELD_OUT_BLOCK, HELD_OUT_EVERY, STEP, drives

UNITS = {"motor_current": "A", "joint_torque": "N·m", "link": "N·m"}
LOUD = 1.6
"""A residual this many times the noise, after every known cause was tried, is an unknown effect."""
LEFT, LEFT_SHARE = 40.0, 0.01
"""Log evidence left after a cause, and its share of the cause's own, from which on it may stand in for an unknown effect."""
UNKNOWN_EXPLAINS = 0.05
"""Share of the held-out discrepancy that an unknown effect must explain."""
_NEARLY_ALL = 2 / 3
"""Share of the causes that could not have shown, from which on a measurement is inconclusive."""
TEMPER, INEXACT = 5.0, 0.05
"""The laws are not exact and neither is the noise model: log evidence counts `TEMPER` times less, and less still where
the last round found something too small to be a cause: `INEXACT` times its log evidence is added."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a cause: value, standard deviation, unit."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Finding:
    """A cause that was found.

    Attributes:
      name, component: as in the library, or `unknown`.
      confidence: probability that this, and no other cause, is there.
      parameters: of the extended model.
      explains: share of the held-out discrepancy that it removes.
      description, depends_on: of an unknown effect.
    """

    name: str
    component: str
    confidence: float
    parameters: dict[str, Parameter]
    explains: float
    description: str = ""
    depends_on: tuple[str, ...] = ()


@dataclass(frozen=True)
class Moved:
    """A number that calibration moved within its tolerance."""

    nominal: float
    value: float
    std: float
    tolerance: float
    unit: str


@dataclass(frozen=True)
class Channel:
    """RMS of one channel on held-out data: calibrated joint, extended joint, and what the sensors' noise explains."""

    before: float
    after: float
    noise: float
    unit: str


@dataclass(frozen=True)
class Diagnosis:
    """The answer, with what is needed to show how it came about.

    Attributes:
      verdict: consistent, discrepancy or inconclusive.
      causes: by how much each explains.
      calibration: numbers that moved.
      confusable: pairs of causes that this measurement cannot tell apart.
      undetermined: causes that it could not have shown at ordinary size.
      residual: by channel.
      extended: the joint with calibration and effects in it.
      rounds: the search's rounds: loudness, hypotheses tried and what they gained.
      at, before, after: time [s] and residuals of every stretch, shapes (k,) and (k, 3), for showing.
    """

    verdict: str
    causes: tuple[Finding, ...]
    calibration: dict[str, Moved]
    confusable: tuple[tuple[str, str], ...]
    undetermined: tuple[str, ...]
    residual: dict[str, Channel]
    extended: Joint
    rounds: tuple[Round, ...] = field(repr=False)
    problem: Problem = field(repr=False)
    before: list[np.ndarray] = field(repr=False)
    after: list[np.ndarray] = field(repr=False)
    estimation: dict[str, Any] | None = None
    held_out: str = ""

    def extended_joint(self) -> Joint:
        """The joint's description with calibration, effects and terms in it."""
        return self.extended

    def to_json(self) -> dict[str, Any]:
        """What `diagnosis.json` holds."""
        found = []
        for c in self.causes:
            entry: dict[str, Any] = {
                "name": c.name,
                "component": c.component,
                "confidence": round(c.confidence, 3),
                "parameters": {k: {"value": p.value, "std": p.std, "unit": p.unit} for k, p in c.parameters.items()},
                "explains": round(c.explains, 4),
            }
            if c.name == "unknown":
                entry["description"] = c.description
                entry["depends_on"] = list(c.depends_on)
            found.append(entry)
        return {
            "verdict": self.verdict,
            "causes": found,
            "calibration": {
                k: {"nominal": m.nominal, "value": m.value, "std": m.std, "tolerance": m.tolerance, "unit": m.unit}
                for k, m in self.calibration.items()
            },
            "confusable": [list(pair) for pair in self.confusable],
            "undetermined": list(self.undetermined),
            "residual": {
                k: {"before": r.before, "after": r.after, "noise": r.noise, "unit": r.unit}
                for k, r in self.residual.items()
            },
            "estimation": self.estimation,
            "held_out": self.held_out,
        }


def diagnose(measurement, joint: Joint, most: int = 3) -> Diagnosis:
    """Diagnose a measurement (`sim.recording.Measurement`) against a joint's description.

    Args:
      most: largest number of causes at once.
    """
    problem = Problem(*drives(list(measurement.recordings), joint), joint)
    available = [n for n in causes.of(joint) if problem.has_torque or "joint_torque" not in causes.get(n).needs]
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    present = {effect.name: effect.values for effect in joint.effects}
    tried = [h for name in available for h in hypotheses(causes.get(name), record, present.get(name))]
    found = search(problem, tried, _quantum(joint), most)
    first, chosen = found.rounds[0], found.chosen
    chosen = with_dispersion(problem, found.noise, chosen)
    term = _unknown(problem, found)
    after = chosen
    if term is not None:
        after = term.fit
    final_joint = _extended(problem, after, joint)
    after_residuals = after.state[0]
    if term is not None:
        final_joint = unknown.extend(final_joint, term.candidate)
    findings = _findings(problem, found, after, term, after_residuals)
    if term is not None and findings[-1].explains < UNKNOWN_EXPLAINS:  # it did not hold on data that it had not seen
        term, after, after_residuals = None, chosen, chosen.state[0]
        final_joint = _extended(problem, after, joint)
        findings = _findings(problem, found, after, None, after_residuals)
    library = Library(
        problem, chosen, [h for h in tried if h.cause.name not in {c.cause.name for c in chosen.model}], 0.1
    )
    undetermined, alike = identify.limits(problem, found.noise, chosen, library, THRESHOLD)
    missing = [n for n in causes.of(joint) if n not in available]
    undetermined = sorted({*undetermined, *missing} - {c.name for c in findings})
    if len(undetermined) >= _NEARLY_ALL * len(causes.of(joint)):
        # Something is wrong; where it sits cannot be told from what could not have shown.
        findings = [replace(f, confidence=min(f.confidence, 0.5)) if f.name == "unknown" else f for f in findings]
    confusable = sorted({tuple(sorted(pair)) for pair in [*alike, *_close(found)]})
    verdict = "discrepancy" if findings else "consistent"
    if not findings and len(undetermined) >= _NEARLY_ALL * len(causes.of(joint)):
        verdict = "inconclusive"
    return Diagnosis(
        verdict=verdict,
        causes=tuple(sorted(findings, key=lambda f: -f.explains)),
        calibration=_moved(problem, after),
        confusable=tuple(confusable),
        undetermined=tuple(undetermined),
        residual=_channels(problem, after, first.base.state[0], after_residuals),
        extended=final_joint,
        rounds=found.rounds,
        problem=problem,
        before=first.base.state[0],
        after=after_residuals,
        held_out=_held_out(problem),
    )


def _held_out(problem: Problem) -> str:
    """How data were kept from the fits, and over what the numbers of `residual` are means."""
    blocks = {d.block for d in problem.drives}
    means = " to ".join(f"{1e3 * STEP * DECIMATION * b:.0f}" for b in sorted({min(blocks), max(blocks)}))
    return (
        f"every {HELD_OUT_EVERY}th block of {HELD_OUT_BLOCK:g} s of each recording was kept from every fit; "
        f"RMS over means of {means} ms, in motion, while rotor and link follow their measured motion"
    )


def _quantum(joint: Joint) -> np.ndarray:
    """What the rotor encoder's quantisation (rms) leaves in each channel where it does not average out, shape (3,)."""
    rms = joint.sensors.motor_encoder.resolution / np.sqrt(12)
    value = {name: number.value for name, number in joint.numbers.items()}
    return np.array([value["Kw0"] * rms / value["Kt"], value["K1"] * rms / value["N"], 0.0])


@dataclass(frozen=True)
class _Unknown:
    """A term: its candidate, the fit beside it, whether it stands in for all causes, and the evidence for it."""

    candidate: unknown.Candidate
    fit: Fit
    alone: bool
    gain: float


def _unknown(problem: Problem, found: Search) -> _Unknown | None:
    """The nonparametric term, where the library needs several causes for what one explains or leaves something."""
    count = len(found.chosen.model)
    left = max(found.rounds[-1].gains, default=0.0) if problem.has_torque else 0.0
    doubtful = count == 1 and left > max(LEFT, LEFT_SHARE * max(found.rounds[0].gains))
    if found.loudness < LOUD and count < 2 and not doubtful:
        return None
    noise, first = found.rounds_noise, found.rounds[0]
    # Against the joint without causes: does a term alone do better than the library's whole answer?
    term = _with_term(problem, found, first.base, first.loudness)
    if term is not None:
        common = louder(noise, min(level(problem, noise, term.fit), found.loudness))
        reference = unknown.score(problem, common, found.chosen if count else first.base)
        gain = term.score(problem, common, TEMPER) - reference
        if gain > (TEMPER if count else 2.0) * unknown.PENALTY:
            return _Unknown(term.candidate, term.fit, True, gain)
    if not count or found.loudness < LOUD:
        return None
    term = _with_term(problem, found, found.chosen, found.loudness)
    if term is not None and term.gain > 2 * unknown.PENALTY:
        return _Unknown(term.candidate, term.fit, False, term.gain)
    return None


def _with_term(problem: Problem, found: Search, at: Fit, loudness: float, count: int = 3) -> unknown.Refined | None:
    """The best term on top of a fit: the few that look best, fitted together with calibration and effects."""
    noise = found.rounds_noise
    tried = [c for c in unknown.candidates(problem, louder(noise, loudness), at) if c.gain > unknown.PENALTY]
    refined = [unknown.refine(problem, noise, at, c, level) for c in tried[:count]]
    if not refined:
        return None
    common = louder(noise, min(level(problem, noise, r.fit) for r in refined))
    best = max(refined, key=lambda r: r.score(problem, common, TEMPER))
    narrow = unknown.narrowed(best)
    if narrow is not None:
        again = unknown.refine(problem, noise, at, narrow, level)
        common = louder(noise, min(level(problem, noise, r.fit) for r in (best, again)))
        best = max((best, again), key=lambda r: r.score(problem, common, TEMPER))
    return best


def _held_out_loss(problem: Problem, noise, residuals: list[np.ndarray]) -> tuple[float, int]:
    """Robust sum of squares on held-out samples, in units of the noise, and their number."""
    total, count = 0.0, 0
    for drive, r, channels in zip(problem.drives, residuals, noise, strict=True):
        for c in range(3):
            use = drive.held_out[:, c] & ~drive.at_rest
            if not use.any():
                continue
            ar = channels[c].ar
            e = r[:, c].copy()
            for m, a in enumerate(ar):
                e[m + 1 :] -= a * r[: -m - 1, c]
            loss, _ = robust_loss(e[use] / channels[c].white, 50.0)
            total, count = total + loss, count + int(use.sum())
    return total, count


def _findings(problem: Problem, found: Search, after: Fit, term: _Unknown | None, last) -> list[Finding]:
    """The causes of the chosen model, each with what it explains of held-out data."""
    chain = [r.base for r in found.rounds if len(r.base.model) <= len(after.model)]
    if after is not chain[-1] and len(after.model) > len(chain[-1].model):
        chain.append(after)
    losses = [_held_out_loss(problem, found.noise, f.state[0])[0] for f in chain]
    if term is not None:
        losses.append(_held_out_loss(problem, found.noise, last)[0])
    floor = min(losses[-1], float(_held_out_loss(problem, found.noise, last)[1]))
    whole = max(losses[0] - floor, 1e-9)
    findings = []
    for i, (h, u) in enumerate(zip(after.model, problem.split(after.theta, after.model), strict=True)):
        start = problem.size + sum(g.size for g in after.model[:i])
        block = slice(start, start + h.size)
        values, std = h.values(u), h.deviation(u, after.covariance[block, block])
        parameters = {
            q.name: Parameter(values[q.name], float(std.get(q.name, 0.0)), "" if q.unit == "1" else q.unit)
            for q in h.cause.parameters
        }
        share = float(np.clip((losses[i] - losses[i + 1]) / whole, 0.0, 1.0))
        findings.append(Finding(h.cause.name, h.cause.component, _confidence(found, i, term), parameters, share))
    if term is not None:
        share = float(np.clip((losses[-2] - losses[-1]) / whole, 0.0, 1.0))
        variables = unknown.depends_on(term.candidate.term.variable)
        confidence = float(np.clip(1 - np.exp(-term.gain / (4 * TEMPER)), 0.3, 0.95))
        if level(problem, found.rounds_noise, term.fit) > LOUD:  # the term is a part of it at most
            confidence = min(confidence, 0.6)
        findings.append(
            Finding(
                "unknown", term.candidate.component, confidence, {}, share, unknown.describe(term.candidate), variables
            )
        )
    return findings


def _confidence(found: Search, i: int, term: _Unknown | None) -> float:
    """Probability of the i-th cause among those tried in its round, and of there being one at all."""
    names, gains = zip(*found.rounds[i].named, strict=True)
    gains = np.array(gains)
    chosen = found.rounds[i + 1].base.model[i].cause.name if i + 1 < len(found.rounds) else names[0]
    temper = _temper(found)
    weight = np.exp((gains - gains.max()) / temper)
    same = np.array([n == chosen for n in names])
    none = np.exp(-(gains.max() - 0.5 * THRESHOLD) / temper)
    p = float(weight[same].sum() / (weight.sum() + none))
    if found.loudness > LOUD and term is None:  # whatever it is, this is not all of it
        return min(p, 0.5)
    return min(p, 0.99 if term is None else 0.7)


def _temper(found: Search) -> float:
    """By how much log evidence is to be divided, from what was left that no cause may explain."""
    last = found.rounds[-1]
    left = max(last.gains, default=0.0) if len(last.base.model) == len(found.chosen.model) else 0.0
    return TEMPER + INEXACT * max(left, 0.0)


def _close(found: Search) -> list[tuple[str, str]]:
    """Pairs of finalists between which the evidence does not decide."""
    pairs = []
    for r, after in zip(found.rounds, found.rounds[1:], strict=False):
        chosen = after.base.model[-1].cause.name
        best = max(gain for _, gain in r.named)
        for name, gain in r.named:
            if name != chosen and gain > best - _temper(found):
                pairs.append((chosen, name))
    return pairs


def _moved(problem: Problem, at: Fit) -> dict[str, Moved]:
    """Numbers that differ from nominal by more than the data's own uncertainty."""
    c = problem.calibration
    x = at.theta[: c.size]
    covariance = at.covariance[: c.size, : c.size]
    moved = {}
    for slot in c.slots:
        value, std = _value(c, slot, x, covariance)
        number = slot.number
        shared = problem.joint.shared_tolerances[number.shared] if number.shared else 0.0
        tolerance = float(np.hypot(np.hypot(number.tolerance, shared), number.deviation))
        prior = float(np.hypot(np.hypot(number.tolerance, shared) * abs(number.value), number.deviation))
        if std < 0.8 * prior and abs(value - number.value) > max(2 * std, 0.1 * prior):
            unit = "" if number.unit == "1" else number.unit
            moved[slot.name] = Moved(number.value, value, std, tolerance, unit)
    return moved


def _value(c, slot, x: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Value of a number and its standard deviation."""
    value = c.value(slot, x)
    step = 1e-3
    slope = np.array([(c.value(slot, x + step * e) - value) / step for e in np.eye(c.size)])
    return value, float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


def _extended(problem: Problem, at: Fit, joint: Joint) -> Joint:
    """The joint with calibrated numbers (their nominal kept beside them) and effects."""
    c = problem.calibration
    x, covariance = at.theta[: c.size], at.covariance[: c.size, : c.size]
    data = joint.model_dump()
    places = {
        "link_encoder_zero": ("sensors", "link_encoder", "zero"),
        "current_offset": ("sensors", "motor_current", "offset"),
        "torque_sensor_gain": ("sensors", "joint_torque", "gain"),
        "torque_sensor_offset": ("sensors", "joint_torque", "offset"),
        "Jl": ("link_tolerances", "inertia"),
        "Mg": ("link_tolerances", "gravity_moment"),
        "gravity_angle": ("gravity_angle",),
    }
    for slot in c.slots:
        value, std = _value(c, slot, x, covariance)
        if slot.field in ("amplitude", "phase"):
            target = data["kinematic_error"][slot.index][slot.field]
        elif slot.name in places:
            target = data
            for key in places[slot.name]:
                target = target[key]
        else:
            target = data["numbers"][slot.name]
        nominal = target["value"] if target.get("nominal") is None else target["nominal"]
        target.update(value=value, std=std, nominal=nominal)
    extended = Joint.model_validate(data)
    effects = {}
    for i, (h, u) in enumerate(zip(at.model, problem.split(at.theta, at.model), strict=True)):
        start = problem.size + sum(g.size for g in at.model[:i])
        std = h.deviation(u, at.covariance[start : start + h.size, start : start + h.size])
        effects[h.cause.name] = Effect(
            name=h.cause.name,
            parameters={
                q.name: Estimate(value=h.values(u)[q.name], unit=q.unit, std=std.get(q.name))
                for q in h.cause.parameters
            },
        )
    kept = [e for e in joint.effects if e.name not in effects or _adds(e.name)]
    extended = extended.model_copy(update={"effects": [*kept, *effects.values()]})
    extended._path = joint._path
    return extended


def _adds(name: str) -> bool:
    """Whether a second effect of that name adds to the first, instead of replacing it."""
    return any(q.integer or q.name == "scale" for q in causes.get(name).parameters)


def _means(r: np.ndarray, use: np.ndarray, block: int) -> np.ndarray:
    """Means of a residual over the blocks that count as one (`Drive.block`), of those samples that are used."""
    starts = np.arange(0, len(r), block)
    count = np.add.reduceat(use.astype(float), starts)
    total = np.add.reduceat(np.where(use, r, 0.0), starts)
    return (total[count > 0.5 * block] / count[count > 0.5 * block]) if np.any(count > 0.5 * block) else r[use]


def _channels(problem: Problem, at: Fit, before: list[np.ndarray], after: list[np.ndarray]) -> dict[str, Channel]:
    """RMS on held-out samples by channel, in motion: at rest friction may be anything up to its level."""
    names = {"motor_current": "motor_current", "joint_torque": "joint_torque", "link": "link_balance"}
    once, twice = (problem.residuals([at.theta], [at.model], twin=t)[0] for t in (False, True))
    noise = [b - a for a, b in zip(once, twice, strict=True)]
    found = {}
    for c, channel in enumerate(CHANNELS):
        use = [d.held_out[:, c] & ~d.at_rest for d in problem.drives]
        if not any(u.any() for u in use):
            use = [d.held_out[:, c] for d in problem.drives]
        if not any(u.any() for u in use):
            continue
        rms = [
            float(np.sqrt(np.mean(np.concatenate([_means(r[:, c], u, d.block) for r, u, d in stretches]) ** 2)))
            for stretches in (list(zip(rs, use, problem.drives, strict=True)) for rs in (before, after, noise))
        ]
        found[names[channel]] = Channel(*rms, UNITS[channel])
    return found
