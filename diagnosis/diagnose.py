"""Recordings in, causes out: what a joint hides, how sure that is, and the joint extended by it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from ..models import causes
from ..models.joint import Effect, Estimate, Joint
from ..models.notebook import html_table, paragraph
from ..models.recording import Measurement
from .data import coverage
from .data.mistakes import Mistake, find_mistakes
from .data.segments import BALANCES, SETTINGS, UNITS, segments
from .fit.coordinates import Hypothesis, hypotheses
from .fit.regions import Region, drawn_back, held_out_regions, mean_ratio, valid_range
from .fit.residual import Problem
from .fit.solver import Fit, Fitter, tamed, with_dispersion
from .search import discrepancy
from .search.described import as_described
from .search.discrepancy import Unknown
from .search.identifiability import limits
from .search.stages import SETTINGS as SEARCH
from .search.stages import (
    Decision,
    Progress,
    Search,
    SearchSettings,
    amount_of,
    quiet_rms,
    search,
    significance,
    size_of,
    without_effect,
)
from .search.worth import mean_squares, output_scale, unexplained, worth
from .uncertainty import stated

if TYPE_CHECKING:
    from .planning import Plan


@dataclass(frozen=True)
class AnswerSettings:
    """How what was found is told.

    Attributes:
      temper: by how much log evidence is divided before it becomes a probability: the laws are not exact and neither is the noise
        model; `inexact` of what other hypotheses still gain is added.
      significant: standard deviations that an effect must be away from absent where the fit ends.
      surest: largest confidence; beside: of a cause beside which an unknown effect was found; unsure: of what does not hold where
        it was not fitted, or could be anything.
      nearly_all: share of the causes that could not have shown, from which on a measurement is inconclusive.
      minor, quiet: part of the ordinary size below which an effect is minor, where the residual is more than `quiet` times the
        sensors' noise even with all of them: a real joint has a little of everything. Minor effects are part of the extended
        joint, and told, but none of the causes.
      inflation: largest factor on standard deviations where more than noise is left; lookalike: part of an effect's ordinary size
        that may then be small imperfections which look like it.
      slight: part of the root mean square of what nothing explains that a cause beside an unknown effect must be worth.
      simpler: ratio of errors on regions that a fit has not seen up to which, where nearly nothing could have shown, numbers
        as described are preferred to numbers that calibration moved.
      far, worth: a residual so many times the sensors' noise, and of so large a share of the rated torque, is never consistent.
    """

    temper: float = 5.0
    inexact: float = 0.02
    significant: float = 3.0
    surest: float = 0.99
    unsure: float = 0.5
    beside: float = 0.7
    nearly_all: float = 2 / 3
    minor: float = 0.12
    quiet: float = 1.6
    inflation: float = 5.0
    lookalike: float = 0.015
    slight: float = 0.25
    far: float = 5.0
    worth: float = 0.02
    simpler: float = 2.0


ANSWER = AnswerSettings()


@dataclass(frozen=True)
class ParameterEstimate:
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
      explains: share of the held-out discrepancy that it removes, in mean squares of output torque.
      worth: root mean square that it alone removes from the simulation's error [N·m at the output].
      description, depends_on: of an unknown effect.
    """

    name: str
    component: str
    confidence: float
    parameters: dict[str, ParameterEstimate]
    explains: float
    worth: float
    description: str = ""
    depends_on: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As it stands in `diagnosis.json`."""
        entry: dict[str, Any] = {
            "name": self.name,
            "component": self.component,
            "confidence": round(self.confidence, 3),
            "parameters": {k: {"value": p.value, "std": p.std, "unit": p.unit} for k, p in self.parameters.items()},
            "explains": round(self.explains, 4),
            "worth": {"value": self.worth, "unit": "N·m"},
        }
        if self.name == "unknown":
            entry["description"] = self.description
            entry["depends_on"] = list(self.depends_on)
        return entry


@dataclass(frozen=True)
class ParameterShift:
    """A number that calibration moved within its tolerance."""

    nominal: float
    value: float
    std: float
    tolerance: float
    unit: str


@dataclass(frozen=True)
class BalanceResidual:
    """RMS of one balance on held-out data: described and calibrated joint, extended joint, what the sensors' noise explains."""

    before: float
    after: float
    noise: float
    unit: str


@dataclass(frozen=True)
class Diagnosis:
    """The answer, with what is needed to show how it came about.

    Attributes:
      verdict: consistent, discrepancy or inconclusive; reason: why, where that is not plain from the causes.
      causes: by how much each is worth; minor: effects that are there, too small to be called causes.
      calibration: numbers that moved.
      confusable: pairs of causes that this measurement cannot tell apart.
      undetermined: causes that it could not have shown at ordinary size, with the reason.
      residual: by balance.
      regions: what the extended joint is worth where a fit has not been, the worst first.
      extended: the joint with calibration and effects in it.
      mistakes: in the data.
      decisions: about every hypothesis that was looked at.
      problem, search: what was computed; None where mistakes in the data made physics meaningless.
      before, after: residuals of every segment, shape (k, len(BALANCES)), for showing.
      estimation: what diagnosis gains for estimation.
      plan: what to measure next (`planning.plan`), where it was asked for.
      held_out: how data were kept from the fits.
      complete: whether there was time for all stages.
      seconds: that it took.
    """

    verdict: str
    reason: str
    causes: tuple[Finding, ...]
    calibration: dict[str, ParameterShift]
    confusable: tuple[tuple[str, str], ...]
    undetermined: dict[str, str]
    residual: dict[str, BalanceResidual]
    regions: tuple[Region, ...]
    extended: Joint
    minor: tuple[Finding, ...] = ()
    mistakes: tuple[Mistake, ...] = ()
    decisions: tuple[Decision, ...] = field(default=(), repr=False)
    problem: Problem | None = field(default=None, repr=False)
    search: Search | None = field(default=None, repr=False)
    final: Fit | None = field(default=None, repr=False)
    before: list[np.ndarray] = field(default_factory=list, repr=False)
    after: list[np.ndarray] = field(default_factory=list, repr=False)
    estimation: dict[str, Any] | None = None
    plan: Plan | None = field(default=None, repr=False)
    held_out: str = ""
    complete: bool = True
    seconds: float = 0.0

    def _repr_html_(self) -> str:
        causes_ = [
            (
                c.name.replace("_", " "), c.component, f"{100 * c.confidence:.0f} %", f"{100 * c.explains:.0f} %", c.worth,
                c.description
                or ", ".join(f"{k} = {p.value:.4g} ± {p.std:.2g} {p.unit}".rstrip() for k, p in c.parameters.items()),
            )
            for c in self.causes
        ]  # fmt: skip
        residual = [(name, r.before, r.after, r.noise, r.unit) for name, r in self.residual.items()]
        return "".join(
            (
                paragraph(self.verdict, self.reason),
                *(paragraph(f"{m.name}:", f"{m.column} {m.description}") for m in self.mistakes),
                html_table(("cause", "component", "sure", "explains", "worth [N·m]", "parameters"), causes_),
                html_table(("residual", "before", "after", "noise", "unit"), residual),
                paragraph("Cannot be told apart:", "; ".join(" and ".join(p) for p in self.confusable))
                if self.confusable
                else "",
                paragraph("Could not have shown:", ", ".join(self.undetermined)) if self.undetermined else "",
                "" if self.plan is None else self.plan._repr_html_(),
            )
        )

    def to_json(self) -> dict[str, Any]:
        """What `diagnosis.json` holds."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "causes": [c.to_json() for c in self.causes],
            "minor": [c.to_json() for c in self.minor],
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
            "regions": [r.to_json() for r in self.regions],
            "estimation": self.estimation,
            "held_out": self.held_out,
            "next": None if self.plan is None else self.plan.to_json(),
            "mistakes": [m.to_json() for m in self.mistakes],
            "decisions": [
                {
                    "stage": d.stage, "cause": d.cause, "parameters": d.fixed, "gain": _finite(d.gain),
                    "worth": _finite(d.worth), "size": round(d.size, 4), "taken": d.taken, "reason": d.reason,
                }
                for d in self.decisions
            ],
            "complete": self.complete,
        }  # fmt: skip


def _finite(x: float) -> float | None:
    return float(f"{x:.4g}") if np.isfinite(x) else None


# Replays use the cores; BLAS's threads would only wait for them, spinning.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    measurement: Measurement,
    joint: Joint,
    settings: SearchSettings = SEARCH,
    progress: Progress = lambda stage, done: None,
    seconds: float = np.inf,
) -> Diagnosis:
    """Diagnose a measurement against a joint's description.

    Args:
      measurement: recordings of the joint.
      joint: its description; effects in it are known already.
      progress: told the stages as they begin, with the share that is done.
      seconds: after which no further stage begins: the answer is the best by then.
    """
    begin = time.monotonic()
    deadline = begin + seconds
    progress("looking for mistakes in the data", 0.0)
    mistakes = find_mistakes(measurement, joint)
    if any(m.severe for m in mistakes):
        return _meaningless(measurement, joint, mistakes, time.monotonic() - begin)
    problem = Problem(*segments(list(measurement.recordings), joint), joint)
    missing = coverage.undetermined(measurement, joint)
    if not problem.segments:
        return _nothing(joint, mistakes, missing, time.monotonic() - begin)
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    available = [n for n in causes.of(joint) if coverage.can_show(n, measurement, problem.link_measured)]
    present = {effect.name: effect.values for effect in joint.effects}
    tried = [h for n in available for h in hypotheses(causes.get(n), record, present.get(n))]
    found = search(problem, tried, settings, progress, deadline)
    fitter = Fitter(problem)
    progress("looking for unknown effects", 0.88)
    unknown = discrepancy.find(problem, fitter, found.base, found.chosen) if time.monotonic() < deadline else None
    progress("numbers and their uncertainty", 0.94)
    final, found = (
        _settled(problem, fitter, found) if unknown is None else (with_dispersion(problem, unknown.fit), found)
    )
    final = _inflated(problem, final)
    progress("regions that a fit has not seen", 0.97)
    share, drawn, regions = drawn_back(problem, final)
    undetermined, alike = _limits(problem, found, final, tried, missing)
    nearly_all = len(undetermined) >= ANSWER.nearly_all * len(causes.of(joint))
    surest = 1.0
    if share == 0.0 or (found.chosen.model and nearly_all and problem.link_measured):
        # What does not hold where it was not fitted is not sure to be there, nor is one of few that could have shown.
        surest = ANSWER.unsure if share == 0.0 else 1.0
        described = problem.as_described()
        other = as_described(described, tried, settings) if time.monotonic() < deadline else None
        if other is not None:
            there = _inflated(described, with_dispersion(described, other.chosen))
            unseen = held_out_regions(described, there)
            if share == 0.0 or mean_ratio(unseen) < ANSWER.simpler * mean_ratio(regions):
                problem, unknown, surest = described, None, ANSWER.beside
                found = replace(other, decisions=(*found.decisions, *other.decisions), complete=found.complete)
                final = drawn = there
                share, regions = 1.0, unseen
                undetermined, alike = _limits(problem, found, final, tried, missing)
    findings, minor = _findings(problem, found, final, unknown)
    findings, minor = ([replace(f, confidence=min(f.confidence, surest)) for f in fs] for fs in (findings, minor))
    final = drawn
    nearly_all = len(undetermined) >= ANSWER.nearly_all * len(causes.of(joint))
    if nearly_all:
        # Something is wrong; where it sits cannot be told from what could not have shown.
        findings = [
            replace(f, confidence=min(f.confidence, ANSWER.unsure)) if f.name == "unknown" else f for f in findings
        ]
    residual = _balances(problem, found.base, final)
    verdict, reason = _verdict(problem, findings, residual, nearly_all)
    if share < 1.0:
        reason = "; ".join([part for part in (reason, _holds_back(share, bool(regions))) if part])
    elif problem.held.any():
        reason = "; ".join([part for part in (reason, _as_described(regions, found.confusable)) if part])
    extended = joint
    if share > 0.0:
        extended = _extended(problem, final, joint, unknown)
        known = {"valid": valid_range(problem, final), "uncertainty": stated(problem, final, extended, regions)}
        extended = extended.model_copy(update=known)
    return Diagnosis(
        verdict=verdict,
        reason=reason,
        causes=tuple(sorted(findings, key=lambda f: -f.worth)),
        calibration=_shifts(problem, final),
        confusable=tuple(sorted({tuple(sorted(pair)) for pair in [*alike, *_close(found), *found.confusable]})),
        undetermined=undetermined,
        residual=residual,
        regions=regions,
        extended=extended,
        minor=tuple(sorted(minor, key=lambda f: -f.worth)),
        mistakes=mistakes,
        decisions=found.decisions,
        problem=problem,
        search=found,
        final=final,
        before=found.base.point.residual,
        after=final.point.residual,
        held_out=_held_out(problem),
        complete=found.complete,
        seconds=time.monotonic() - begin,
    )


def _inflated(problem: Problem, f: Fit) -> Fit:
    """The fit with standard deviations inflated by its residual's normalised RMS, where more than noise is left (Birge's ratio).

    What no description holds is not random: it leans on the parameters the same way all the time. Small imperfections that look
    like an effect (an encoder's eccentricity like a kinematic error) are part of its size, however well that is known.
    """
    ratio = quiet_rms(problem, f)
    if ratio <= ANSWER.quiet:
        return f
    inexact = np.zeros(len(f.theta))
    for i, h in enumerate(f.model):
        if h.free:
            inexact[problem.place(f.model, i)] = ANSWER.lookalike
    return replace(f, covariance=f.covariance * min(ratio, ANSWER.inflation) ** 2 + np.diag(inexact**2))


def _holds_back(share: float, held_out: bool) -> str:
    """Why the extended joint is not what the fit says."""
    if not held_out:
        return "too little motion to keep a region of it from the fit: joint.yaml is the description"
    if share == 0.0:
        return "what was found does worse than the description where a fit has not seen the data: joint.yaml is the description"
    return (
        "what was found does worse than the description in a region that a fit has not seen: the numbers in joint.yaml are drawn "
        f"back to {100 * share:.0f} % of the way"
    )


def _as_described(regions: Sequence[Region], confusable: Sequence[tuple[str, str]]) -> str:
    """What is to be said of causes that hold only with all numbers as described."""
    worse = ", ".join(f"{r.name} ({r.ratio:.1f} times)" for r in regions if r.worse)
    names = " or ".join(name.replace("_", " ") for name in dict.fromkeys(n for pair in confusable for n in pair))
    told = [
        "no numbers within tolerance hold where a fit has not seen the data: they are left as described, and the causes are what "
        "explains most with these",
        f"on regions that were kept from the fit worse than the description in {worse}" if worse else "",
        f"what is left beside may be {names}, which this motion cannot tell apart" if names else "",
    ]
    return "; ".join(part for part in told if part)


def _settled(problem: Problem, fitter: Fitter, found: Search) -> tuple[Fit, Search]:
    """The chosen model at its end, without effects that the data do not tell from nothing there; the noise's share taken out."""
    chosen = found.chosen
    while True:
        final = with_dispersion(problem, fitter.polish(chosen))
        weak = [i for i in range(len(final.model)) if significance(problem, final, i) < ANSWER.significant]
        if not weak:
            return final, found
        i = min(weak, key=lambda i: significance(problem, final, i))
        h = final.model[i]
        reason = f"{significance(problem, final, i):.1f} standard deviations from absent where the fit ends"
        dropped = Decision(
            "settle", h.cause.name, h.fixed, float("nan"), float("nan"), size_of(problem, final, i), True, False, reason
        )
        chosen = without_effect(problem, fitter, final, i)
        rivals = tuple(r for j, r in enumerate(found.rivals) if j != i)
        found = replace(found, chosen=chosen, rivals=rivals, decisions=(*found.decisions, dropped))


def _meaningless(measurement, joint: Joint, mistakes: tuple[Mistake, ...], seconds: float) -> Diagnosis:
    """The answer while mistakes in the data make physics meaningless."""
    named = ", ".join(sorted({m.name for m in mistakes if m.severe}))
    reason = f"mistakes in the data ({named}) make physics meaningless; `flexspline import --fix` writes them mended"
    everything = {n: "mistakes in the data" for n in causes.of(joint)}
    return Diagnosis("inconclusive", reason, (), {}, (), everything, {}, (), joint, mistakes=mistakes, seconds=seconds)


def _nothing(joint: Joint, mistakes: tuple[Mistake, ...], missing: dict[str, str], seconds: float) -> Diagnosis:
    shortest = SETTINGS.shortest
    reason = f"no part of the measurement without gaps has {shortest[0]} samples and {shortest[1]:g} s"
    return Diagnosis("inconclusive", reason, (), {}, (), missing, {}, (), joint, mistakes=mistakes, seconds=seconds)


def _held_out(problem: Problem) -> str:
    """How data were kept from the fits, and over what the numbers of `residual` are means."""
    return (
        f"every {SETTINGS.held_out_every}th block of {SETTINGS.held_out_block:g} s of each recording was kept from every fit; "
        "RMS in motion, while what was measured of the motion is followed; `regions`: the ends of the range of angle, speed and "
        "load, and whole recordings, each kept from a fit of its own"
    )


def _limits(problem: Problem, found: Search, final: Fit, tried: list[Hypothesis], missing: dict[str, str]):
    """Causes that could not have shown, with the reason, and pairs that look alike."""
    weak, alike = limits(problem, found.chosen, found.library)
    named = {h.cause.name for h in final.model}
    undetermined = dict(missing)
    looked = {h.cause.name for h in tried}
    for name in causes.of(problem.joint):
        if name not in looked and name not in undetermined:
            undetermined[name] = "it lives in the torsion, which one encoder does not show"
    for name in weak:
        undetermined.setdefault(name, "at ordinary size it would drown in tolerances and noise")
    return {n: r for n, r in sorted(undetermined.items()) if n not in named}, alike


def _findings(problem: Problem, found: Search, final: Fit, unknown: Unknown | None):
    """The effects of the final model, each with what it is worth: causes, and minor ones."""
    held_before, held_after = (_held_out_squares(problem, f) for f in (found.base, final))
    explained = max(held_before - held_after, 1e-30) / max(held_before, 1e-30)
    real = quiet_rms(problem, final) > ANSWER.quiet
    left = float(np.sqrt(np.sum(unexplained(problem, final.point))))
    findings: list[Finding] = []
    minor: list[Finding] = []
    worths, linear = [], tamed(problem, final)
    for i, h in enumerate(final.model):
        block = problem.place(final.model, i)
        effect = block.start + np.asarray(h.magnitudes)
        others = np.setdiff1d(np.arange(len(final.theta)), np.arange(block.start, block.stop))
        amount = amount_of(problem, final, i)[h.magnitudes]
        worths.append(worth(problem, final, linear.jacobian, effect, others, amount))
    total = max(sum(w.rms**2 for w in worths), 1e-30)
    for i, (h, u) in enumerate(zip(final.model, problem.split(final.theta, final.model), strict=True)):
        w = worths[i]
        share = float(np.clip(explained * w.rms**2 / total, 0.0, 1.0))
        if unknown is not None and i == len(final.model) - 1:
            confidence = float(np.clip(1 - np.exp(-unknown.gain / (8 * ANSWER.temper)), 0.3, 0.95))
            findings.append(
                Finding(
                    "unknown", unknown.spline.component, confidence, {}, share, w.rms, discrepancy.describe(unknown),
                    discrepancy.depends_on(unknown.spline.variable),
                )
            )  # fmt: skip
            continue
        block = problem.place(final.model, i)
        values, std = h.values(u), h.deviation(u, final.covariance[block, block])
        parameters = {
            q.name: ParameterEstimate(values[q.name], float(std.get(q.name, 0.0)), "" if q.unit == "1" else q.unit)
            for q in h.cause.parameters
        }
        confidence = _confidence(found, h.cause.name, i, unknown)
        if h.cause.resonance and not problem.link_measured:
            confidence = min(confidence, ANSWER.beside)
        if _at_bound(h, u):  # an inertia of nothing is no answer, whatever it explains
            confidence = min(confidence, ANSWER.unsure)
        small = real and size_of(problem, final, i) < ANSWER.minor
        if unknown is not None:  # what the unknown effect has left of it
            small = small or w.rms < ANSWER.slight * left or significance(problem, final, i) < ANSWER.significant
        (minor if small else findings).append(
            Finding(h.cause.name, h.cause.component, confidence, parameters, share, w.rms)
        )
    return findings, minor


def _at_bound(h: Hypothesis, u: np.ndarray) -> bool:
    """Whether a size sits at the end of what the cause's parameters can be."""
    low, high = h.limits
    sizes = np.asarray(h.magnitudes)
    return bool(np.any((u[sizes] <= low[sizes] + 1e-6) | (u[sizes] >= high[sizes] - 1e-6)))


def _held_out_squares(problem: Problem, f: Fit) -> float:
    """Mean square of held-out residuals beyond the sensors' noise, over all balances [N·m]²."""
    total = 0.0
    for b in range(len(BALANCES)):
        squares, noise, count = 0.0, 0.0, 0
        for segment, r, n in zip(problem.segments, f.point.residual, f.point.noise, strict=True):
            use = segment.held_out[:, b] & ~segment.at_rest
            squares, noise, count = squares + np.sum(r[use, b] ** 2), noise + np.sum(n[use, b] ** 2), count + use.sum()
        if count:
            total += max(squares - noise, 0.0) / count * output_scale(problem)[b] ** 2
    return float(total)


def _confidence(found: Search, name: str, index: int, unknown: Unknown | None) -> float:
    """Probability of a cause among those that could stand where it does, and of there being one at all."""
    rivals = found.rivals[index] if index < len(found.rivals) else None
    if rivals is None:
        return 0.5
    others = [g for n, g in rivals.others if n != name and _superseded(found, n)]
    best = max([rivals.gain, *others])
    temper = ANSWER.temper + ANSWER.inexact * min(rivals.gain, 500.0)
    weights = [np.exp((g - best) / temper) for g in others]
    own = float(np.exp((rivals.gain - best) / temper))
    none = float(np.exp(-(best - 3.5) / temper))
    p = own / (own + sum(weights) + none)
    return float(min(p, ANSWER.surest if unknown is None else ANSWER.beside))


def _superseded(found: Search, name: str) -> bool:
    """Whether a rival is not itself in the model: one that is was no rival."""
    return all(h.cause.name != name for h in found.chosen.model)


def _close(found: Search) -> list[tuple[str, str]]:
    """Pairs of causes between which the evidence does not decide."""
    pairs = []
    for r in found.rivals:
        for name, gain in r.others:
            if gain > r.gain - 3 * (ANSWER.temper + ANSWER.inexact * min(r.gain, 500.0)) and _superseded(found, name):
                pairs.append((r.cause, name))
    return pairs


def _verdict(problem: Problem, findings: list[Finding], residual: dict[str, BalanceResidual], nearly_all: bool):
    """Verdict and, where it is not plain, its reason: a residual far above the noise is never consistent."""
    rated = problem.joint.numbers["rated_torque"].value
    scale = dict(zip(BALANCES, output_scale(problem), strict=True))
    far = [
        (name, r) for name, r in residual.items()
        if r.after > ANSWER.far * r.noise and r.after * scale[name] > ANSWER.worth * rated
    ]  # fmt: skip
    left = "; ".join(
        f"{name.replace('_', ' ')}: {r.after:.3g} {r.unit} RMS is left, {r.after / max(r.noise, 1e-12):.0f} times the noise"
        for name, r in far
    )
    if findings:
        return "discrepancy", f"beside the causes named, {left}" if far else ""
    if nearly_all:
        return "inconclusive", "nearly all causes could not have shown" + (f"; {left}" if far else "")
    if far:
        return "inconclusive", f"no known cause explains the residual; {left}"
    return "consistent", ""


def _shifts(problem: Problem, at: Fit) -> dict[str, ParameterShift]:
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
            moved[slot.name] = ParameterShift(number.value, value, std, tolerance, unit)
    return moved


def _value(c, slot, x: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Value of a number and its standard deviation."""
    value = c.value(slot, x)
    step = 1e-3
    slope = np.array([(c.value(slot, x + step * e) - value) / step for e in np.eye(c.size)])
    return value, float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


_PLACES = {
    "link_encoder_zero": ("sensors", "link_encoder", "zero"),
    "current_offset": ("sensors", "motor_current", "offset"),
    "torque_sensor_gain": ("sensors", "joint_torque", "gain"),
    "torque_sensor_offset": ("sensors", "joint_torque", "offset"),
    "Jl": ("link_tolerances", "inertia"),
    "Mg": ("link_tolerances", "gravity_moment"),
    "gravity_angle": ("gravity_angle",),
}
"""Where in a joint's description the numbers stand that are not in `numbers`."""


def calibrated(problem: Problem, at: Fit, joint: Joint) -> Joint:
    """The joint with the numbers of a fit, their nominal values and standard deviations kept beside them."""
    c = problem.calibration
    x, covariance = at.theta[: c.size], at.covariance[: c.size, : c.size]
    data = joint.model_dump()
    for slot in c.slots:
        value, std = _value(c, slot, x, covariance)
        if slot.field in ("amplitude", "phase"):
            target = data["kinematic_error"][slot.index][slot.field]
        elif slot.name in _PLACES:
            target = data
            for key in _PLACES[slot.name]:
                target = target[key]
        else:
            target = data["numbers"][slot.name]
        nominal = target["value"] if target.get("nominal") is None else target["nominal"]
        target.update(value=value, std=std, nominal=nominal)
    found = Joint.model_validate(data)
    found._path = joint._path
    return found


def _extended(problem: Problem, at: Fit, joint: Joint, unknown: Unknown | None) -> Joint:
    """The joint with calibrated numbers (their nominal kept beside them) and effects."""
    extended = calibrated(problem, at, joint)
    effects: list[Effect] = []
    for i, (h, u) in enumerate(zip(at.model, problem.split(at.theta, at.model), strict=True)):
        if not h.free:
            continue
        block = problem.place(at.model, i)
        values, std = h.values(u), h.deviation(u, at.covariance[block, block])
        parameters = {
            q.name: Estimate(value=values[q.name], unit=q.unit, std=std.get(q.name)) for q in h.cause.parameters
        }
        effects.append(Effect(name=h.cause.name, parameters=parameters))
    names = {e.name for e in effects}
    kept = [e for e in joint.effects if e.name not in names or causes.get(e.name).adds]
    extended = extended.model_copy(update={"effects": [*kept, *effects]})
    extended._path = joint._path
    return discrepancy.extend(extended, unknown) if unknown is not None else extended


def _balances(problem: Problem, base: Fit, final: Fit) -> dict[str, BalanceResidual]:
    """RMS on held-out samples by balance, in motion: at rest friction may be anything up to its level."""
    found = {}
    for b, name in enumerate(BALANCES):
        use = [s.held_out[:, b] & ~s.at_rest for s in problem.segments]
        if not any(u.any() for u in use):
            use = [s.held_out[:, b] for s in problem.segments]
        if not any(u.any() for u in use):
            continue
        before, after, noise = (
            float(np.sqrt(np.mean(np.concatenate([r[u, b] for r, u in zip(rs, use, strict=True)]) ** 2)))
            for rs in (base.point.residual, final.point.residual, final.point.noise)
        )
        found[name] = BalanceResidual(before, after, noise, UNITS[name])
    return found


__all__ = [
    "BalanceResidual", "Diagnosis", "Finding", "ParameterEstimate", "ParameterShift", "calibrated", "diagnose",
    "mean_squares", "size_of",
]  # fmt: skip
