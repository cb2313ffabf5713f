"""Verdict and reasons, residuals before and after, and the joint that is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..estimator.conditioning import Conditioned
from ..models import causes
from ..models.calibration import CUT, ZEROS
from ..models.joint import Joint
from ..models.recording import Measurement
from ..models.signals import CHANNELS
from .answer import BalanceResidual, Diagnosis, Finding, ParameterShift
from .conclusion import ANSWER, Conclusion
from .confidence import explains_nothing, findings_of, out_of_proportion
from .data.mistakes import NO_CHANGE, Mistake
from .data.segments import BALANCES, CURRENT, SETTINGS, UNITS
from .extension import DELAYS, calibrated, extended, parameter_shifts
from .fit import encoder_zero
from .fit.regions import valid_range
from .fit.residual import AT_BOUND, Problem
from .fit.solver import Fit, evaluate_point
from .uncertainty import of_description, stated


def answer_of(conclusion: Conclusion, measurement: Measurement, conditioned: Sequence[Conditioned]) -> Diagnosis:
    """Return the answer of a diagnosis from its intermediate result; `conditioned`: the measurement's recordings."""
    problem, found, shrunk, joint = conclusion.problem, conclusion.found, conclusion.shrunk, conclusion.problem.joint
    final = shrunk.fit
    useless = bool(conclusion.final.model) and explains_nothing(problem, found.base, conclusion.judged)
    if useless:
        conclusion = replace(conclusion, surest=min(conclusion.surest, ANSWER.unsure))
    findings, minor = findings_of(conclusion, measurement, conditioned)
    calibration = parameter_shifts(problem, final)
    other = _not_of_this_joint(problem, findings, calibration)
    if other:  # other causes are then relative to a description that is not of this joint
        findings = [replace(f, confidence=min(f.confidence, ANSWER.unsure)) for f in findings]
    unseen = _without_held_out(conclusion)
    drive = any("motor_current" in r for r in measurement.recordings)
    drive_torque = 0.0 if drive else float(joint.record()[0]["Kt_drive"])
    residual = _balances(problem, found.base, unseen, drive_torque)
    verdict, reasons = _verdict(conclusion, findings, residual, useless)
    reasons += [
        *other,
        *_at_bound(calibration),
        *_why_shrunk(conclusion),
        *_other_joint(conclusion),
    ]
    if conclusion.zeros:
        each = ", ".join(f"{name} {1e3 * x:+.2g}" for name, x in conclusion.zeros.items())
        reasons.append(
            f"the link encoder's zero differs between recordings ({each} mrad): was the encoder re-zeroed? "
            "Diagnose each recording alone"
        )
    if shrunk.share == 0.0:
        extended_joint, unseen_joint = _description(conclusion), None
    else:
        extended_joint = extended(problem, final, joint)
        unseen_joint = None if np.array_equal(unseen.theta, final.theta) else extended(problem, unseen, joint)
        uncertainty = stated(problem, final, extended_joint, shrunk.regions)
        extended_joint = extended_joint.model_copy(update={"valid": valid_range(problem), "uncertainty": uncertainty})
    ripples = [  # with one encoder a ripple of the motor is confounded with one of the gear
        (h.cause.name, name)
        for h in conclusion.final.model
        if h.cause.ripple and not problem.link_measured
        for name in causes.of(joint)
        if causes.get(name).ripple and name != h.cause.name
    ]
    alike = {(min(pair), max(pair)) for pair in (*conclusion.alike, *found.alike(), *ripples)}
    return Diagnosis(
        verdict=verdict,
        reasons=tuple(reasons),
        causes=tuple(findings),
        calibration=calibration,
        confusable=tuple(sorted(alike)),
        undetermined=conclusion.undetermined,
        residual=residual,
        regions=shrunk.regions,
        extended=extended_joint,
        unseen=unseen_joint,
        minor=tuple(minor),
        decisions=found.decisions,
        problem=problem,
        search=found,
        final=final,
        whole=conclusion.final,
        share=shrunk.share,
        before=found.base.point.residual,
        after=final.point.residual,
        held_out=_held_out(problem),
        drive_torque=drive_torque if "motor_torque" in residual else 0.0,
        complete=found.complete,
    )


def _without_held_out(conclusion: Conclusion) -> Fit:
    """The written fit, but without the held-out blocks: with one encoder the written one has seen them."""
    shrunk, judged, final = conclusion.shrunk, conclusion.judged, conclusion.final
    if shrunk.share == 1.0:
        return judged
    if shrunk.share == 0.0 or judged is final:
        return shrunk.fit
    theta = shrunk.fit.theta + shrunk.share * (judged.theta - final.theta)
    return replace(shrunk.fit, theta=theta, point=evaluate_point(conclusion.problem, theta, judged.model))


def _description(conclusion: Conclusion) -> Joint:
    """The description, with the link encoder's zero from the data if they show it, and with its error on these data."""
    problem, joint, theta = conclusion.problem, conclusion.problem.joint, conclusion.problem.start(None, ())
    if conclusion.shrunk.regions and problem.link_measured:
        theta = encoder_zero.zeroed(problem, theta, ())
        joint = calibrated(problem.only_zero(), replace(conclusion.shrunk.fit, theta=theta, model=()), joint)
    return joint.model_copy(update={"uncertainty": of_description(problem, evaluate_point(problem, theta, ()))})


def _at_bound(calibration: dict[str, ParameterShift]) -> list[str]:
    """Numbers at the bound of their tolerances: they may be what is wrong."""
    moved = {name: s for name, s in calibration.items() if abs(s.moved) > AT_BOUND}
    ends = [
        f"{name} ({s.value:.3g} {s.unit})" if s.nominal == 0.0 else f"{name} ({100 * (s.value / s.nominal - 1):+.0f} %)"
        for name, s in moved.items()
        if name not in DELAYS.values()
    ]
    late = [
        f"{sensor.replace('_', ' ')} is read {1e3 * abs(s.value - s.nominal):.1f} ms {'later' if s.moved > 0 else 'earlier'} "
        "than described"
        for sensor, name in DELAYS.items()
        if (s := moved.get(name)) is not None
    ]
    return [f"at the bound of the tolerance: {', '.join(ends)}", *late] if ends else late


def _not_of_this_joint(
    problem: Problem, findings: Sequence[Finding], calibration: dict[str, ParameterShift]
) -> list[str]:
    """Causes whose number is so far from the description that a wrong unit or load is more probable, and many numbers outside
    their tolerances at once: so many faults are less probable than another joint."""
    known = {f.name: {k: p.value for k, p in f.parameters.items()} for f in findings if f.name in causes.names()}
    far = [
        f"{name.replace('_', ' ')} {factor:.2g} times"
        for name, values in known.items()
        if (factor := out_of_proportion(problem, name, values))
    ]
    changed = [name for name in known if causes.get(name).scales or causes.get(name).parameters[0].relative]
    numbers = problem.joint.numbers  # those with a shared tolerance count as one
    moved = {
        (numbers[n].shared or n) if n in numbers else n: n
        for n, s in calibration.items()
        if abs(s.moved) > CUT and n not in (*DELAYS.values(), *ZEROS)
    }
    outside = [name.replace("_", " ") for name in (*changed, *moved.values())]
    why = [f"far from the description ({', '.join(far)})"] if far else []
    why += [f"outside the tolerances at once: {', '.join(outside)}"] if len(outside) >= ANSWER.many else []
    return [f"these data are not of this joint with this load, or a unit is wrong: {', '.join(why)}"] if why else []


def _why_shrunk(conclusion: Conclusion) -> list[str]:
    """Why the extended joint differs from the fit of all numbers; empty if it does not."""
    shrunk = conclusion.shrunk
    if shrunk.share == 1.0:
        return []
    if not shrunk.regions:
        return ["too little motion to hold out a region: joint.yaml is the description"]
    if shrunk.refused:
        why = "the extended joint estimates torque worse than the description"
    elif shrunk.share == 0.0:
        why = "the extended joint is worse than the description on held-out data"
    else:
        why = "the whole fit is worse on held-out data"
    if shrunk.worst is not None and not shrunk.refused:
        why += f" ({shrunk.worst.name}: {shrunk.worst.ratio:.2g} times)"
    if shrunk.share:
        return [f"{why}: joint.yaml has only {100 * shrunk.share:.0f} % of every change"]
    zero = ", with the link encoder's zero found" if conclusion.problem.link_measured else ""
    return [f"{why}: joint.yaml is the description{zero}"]


def _other_joint(conclusion: Conclusion) -> list[str]:
    """The recording with a far larger error than every other, both by the description and by the fit."""
    each = sorted((r for r in conclusion.shrunk.regions if r.recordings), key=lambda r: -r.described)
    if len(each) < 2 or each[0].described < ANSWER.apart * each[1].described:
        return []
    if each[0].extended < ANSWER.explained * each[0].described:
        return []
    return [
        f"by the description {each[0].name} is off by {each[0].described:.2g} N·m RMS, every other by {each[1].described:.2g} "
        "at most: is it of the same joint, with the load and the pushes that its YAML file states?"
    ]


def invalid_data(joint: Joint, mistakes: tuple[Mistake, ...]) -> Diagnosis:
    """Return the answer for data with severe mistakes."""
    named = ", ".join(sorted({m.name for m in mistakes if m.severe}))
    lost = dict.fromkeys(f"{m.column}: {m.unmended}" for m in mistakes if m.lost)
    everything = {n: "mistakes in the data" for n in causes.of(joint)}
    answer = Diagnosis("inconclusive", (), (), {}, (), everything, {}, (), joint, mistakes=mistakes)
    if lost or answer.mendable:
        mended = "`flexspline import --fix` writes a corrected copy"
        return replace(
            answer, reasons=(f"mistakes in the data ({named}) make a diagnosis meaningless", *(lost or (mended,)))
        )
    return replace(answer, reasons=(NO_CHANGE, f"the largest improvement would be: {named}"))


def _held_out(problem: Problem) -> str:
    """How data were held out, and which samples the numbers of `residual` are means of."""
    every, block = SETTINGS.held_out_every, SETTINGS.held_out_block
    if problem.holds_out:
        kept = f"every {every}th block of {block:g} s of each recording was kept from every fit; RMS"
    else:
        kept = f"too short to hold out every {every}th block of {block:g} s: RMS of what was fitted,"
    return (
        f"{kept} in motion, while the measured motion is followed; `regions`: the ends of the range of angle, speed "
        "and load, and whole recordings, each kept from a fit of its own"
    )


def _verdict(
    conclusion: Conclusion, findings: list[Finding], residual: dict[str, BalanceResidual], useless: bool
) -> tuple[str, list[str]]:
    """Return the verdict and its reasons; a residual far above the noise is never consistent.

    Args:
      useless: whether the causes explain no more than calibration alone.
    """
    problem = conclusion.problem
    # The written joint may lack what the fit found: its residual is then more than noise.
    shrunk = conclusion.shrunk.share < 1.0
    rated = problem.joint.numbers["rated_torque"].value
    scale = dict(zip(BALANCES, problem.output_scale, strict=True)) | {"motor_torque": problem.joint.numbers["N"].value}
    times, least = (ANSWER.far, ANSWER.least) if findings or not shrunk else (ANSWER.near, 0.0)
    far = [
        (name, r) for name, r in residual.items()
        if r.after > times * r.noise and r.after * scale[name] > least * rated
    ]  # fmt: skip
    left = _left(far, " by joint.yaml" if shrunk else "")
    late = [] if conclusion.found.complete else ["time was up before every stage: a longer time may find more"]
    if useless and findings:
        return "inconclusive", ["the causes named explain no more than calibration alone", *late, *left]
    if findings and all(f.confidence <= ANSWER.unsure for f in findings):
        return "inconclusive", ["no cause named is more probable than not", *late, *left]
    if findings:
        return "discrepancy", [*late, *_after("in addition to the causes named, ", left)]
    if conclusion.nearly_all:
        return "inconclusive", ["nearly all causes are undetectable with these data", *late, *left]
    if late:
        return "inconclusive", [*late, *left]
    if far:
        return "inconclusive", left if shrunk else ["no known cause explains the residual", *left]
    some = [(name, r) for name, r in residual.items() if r.after > ANSWER.near * r.noise]
    return "consistent", _after("small, but more than noise: ", _left(some))


def _left(far: Sequence[tuple[str, BalanceResidual]], by: str = "") -> list[str]:
    """Residuals of balances in words."""
    return [
        f"{name.replace('_', ' ')}: {r.after:.3g} {r.unit} RMS is left{by}, {r.after / max(r.noise, 1e-12):.0f} times the noise"
        for name, r in far
    ]


def _after(words: str, reasons: list[str]) -> list[str]:
    """Put words before the first of some reasons."""
    return [words + reasons[0], *reasons[1:]] if reasons else []


def _balances(problem: Problem, base: Fit, final: Fit, drive_torque: float) -> dict[str, BalanceResidual]:
    """Return the RMS by balance of held-out samples in motion (at rest friction is anything up to its level), or of all samples.

    Args:
      drive_torque: [N·m/A] if the drive reported a torque and no current: the RMS is then of that torque; else 0.
    """
    found, judged = {}, problem.judged
    for b, name in enumerate(BALANCES):
        kept = [j[:, b] for j in judged]
        use = [k & ~s.at_rest for k, s in zip(kept, problem.segments, strict=True)]
        if not any(u.any() for u in use):
            use = kept
        if not any(u.any() for u in use):
            continue
        before, after, noise = (
            float(np.sqrt(np.mean(np.concatenate([r[u, b] for r, u in zip(rs, use, strict=True)]) ** 2)))
            for rs in (base.point.residual, final.point.residual, final.point.noise)
        )
        if b == CURRENT and drive_torque:
            before, after, noise = (drive_torque * x for x in (before, after, noise))
            found["motor_torque"] = BalanceResidual(before, after, noise, CHANNELS["motor_torque"].unit)
        else:
            found[name] = BalanceResidual(before, after, noise, UNITS[name])
    return found
