"""The answer: verdict and reason, what is left, and the joint that is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..models import causes
from ..models.joint import Joint
from ..models.recording import Measurement
from ..models.signals import CHANNELS
from .answer import BalanceResidual, Diagnosis, Finding, ParameterShift
from .conclusion import ANSWER, Conclusion
from .data.mistakes import NO_CHANGE, Mistake
from .data.segments import BALANCES, CURRENT, SETTINGS, UNITS
from .extension import DELAYS, calibrated, extended, parameter_shifts
from .findings import explains_nothing, findings_of, out_of_proportion
from .fit import tare
from .fit.regions import valid_range
from .fit.residual import Problem
from .fit.solver import Fit, evaluate_point
from .uncertainty import of_description, stated

_LATE = "time was up before every stage was done: with more, more may be found"
_NOT_SURE = "the causes named are no more probable than not"


def answer_of(conclusion: Conclusion, measurement: Measurement) -> Diagnosis:
    """What a diagnosis came to, as the answer."""
    problem, found, final, joint = conclusion.problem, conclusion.found, conclusion.drawn.fit, conclusion.problem.joint
    useless = bool(conclusion.final.model) and explains_nothing(problem, found.base, conclusion.judged)
    if useless:
        conclusion = replace(conclusion, surest=min(conclusion.surest, ANSWER.unsure))
    findings, minor = findings_of(conclusion, measurement)
    unseen = _without_held_out(conclusion)
    drive = any("motor_current" in r for r in measurement.recordings)
    drive_torque = 0.0 if drive else float(joint.record()[0]["Kt_drive"])
    residual = _balances(problem, found.base, unseen, drive_torque)
    calibration = parameter_shifts(problem, final)
    verdict, reasons = _verdict(conclusion, findings, residual, useless)
    reasons += [
        *_out_of_proportion(problem, findings),
        *_at_the_end(calibration),
        *_holds_back(conclusion),
        *_stands_apart(conclusion),
        *_rezeroed(conclusion),
    ]
    if conclusion.drawn.share == 0.0:
        extended_joint, unseen_joint = _tared(conclusion), None
    else:
        extended_joint = extended(problem, final, joint, conclusion.unknown)
        same = np.array_equal(unseen.theta, final.theta)
        unseen_joint = None if same else extended(problem, unseen, joint, conclusion.unknown)
        known = {
            "valid": valid_range(problem),
            "uncertainty": stated(problem, final, extended_joint, conclusion.drawn.regions),
        }
        extended_joint = extended_joint.model_copy(update=known)
    ripples = [
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
        regions=conclusion.drawn.regions,
        extended=extended_joint,
        unseen=unseen_joint,
        minor=tuple(minor),
        decisions=found.decisions,
        problem=problem,
        search=found,
        final=final,
        whole=conclusion.final,
        share=conclusion.drawn.share,
        before=found.base.point.residual,
        after=final.point.residual,
        held_out=_held_out(problem),
        drive_torque=drive_torque if "motor_torque" in residual else 0.0,
        complete=found.complete,
    )


def _without_held_out(conclusion: Conclusion) -> Fit:
    """What is written, as a fit has it that has not seen the held-out blocks: with one encoder the one that is written has."""
    drawn, judged, final = conclusion.drawn, conclusion.judged, conclusion.final
    if drawn.share == 1.0:
        return judged
    if drawn.share == 0.0 or judged is final:
        return drawn.fit
    theta = drawn.fit.theta + drawn.share * (judged.theta - final.theta)
    return replace(drawn.fit, theta=theta, point=evaluate_point(conclusion.problem, theta, judged.model))


def _tared(conclusion: Conclusion) -> Joint:
    """The description, where nothing of what was found is in the joint that is written: with the link encoder's zero tared, as
    nobody works without that, where the data say where it is, and with what it leaves of the data."""
    problem, found, theta = conclusion.problem, conclusion.problem.joint, conclusion.problem.start(None, ())
    if conclusion.drawn.regions and problem.link_measured:
        theta = tare.tared(problem, theta, ())
        found = calibrated(problem.tared(), replace(conclusion.drawn.fit, theta=theta, model=()), found)
    told = of_description(problem, evaluate_point(problem, theta, ()))
    return found.model_copy(update={"uncertainty": told})


def _moved_to_the_end(calibration: dict[str, ParameterShift]) -> dict[str, ParameterShift]:
    return {name: s for name, s in calibration.items() if abs(s.moved) > ANSWER.end}


def _at_the_end(calibration: dict[str, ParameterShift]) -> list[str]:
    """Numbers that calibration moved to the end of their tolerances: they may be what is wrong."""
    moved = _moved_to_the_end(calibration)
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
    return [f"at the end of what the description allows: {', '.join(ends)}", *late] if ends else late


def _out_of_proportion(problem: Problem, findings: Sequence[Finding]) -> list[str]:
    """Where a number is so far from its description that something else is likelier."""
    far = {
        f.name: factor
        for f in findings
        if f.name in causes.names()
        and (factor := out_of_proportion(problem, f.name, {k: p.value for k, p in f.parameters.items()}))
    }
    if not far:
        return []
    each = ", ".join(f"{name.replace('_', ' ')} {factor:.2g} times" for name, factor in far.items())
    return [f"far from the description ({each}): is it this joint with this load, and every column in its unit?"]


def _holds_back(conclusion: Conclusion) -> list[str]:
    """Why the extended joint is not what a fit of all numbers says; nothing where it is."""
    drawn = conclusion.drawn
    if drawn.share < 1.0 and not drawn.regions:
        return ["too little motion to keep a region of it from the fit: joint.yaml is the description"]
    if drawn.share < 1.0:
        if drawn.refused:
            why = "with what was found estimates of torque are worse than with the description"
        elif drawn.share == 0.0:
            why = "what was found does worse than the description where a fit has not seen the data"
        else:
            why = "what was found does worse than the description in a region that a fit has not seen"
        if drawn.worst is not None and not drawn.refused:
            why += f" ({drawn.worst.name}: {drawn.worst.ratio:.2g} times)"
        left = f"the numbers in joint.yaml are drawn back to {100 * drawn.share:.0f} % of the way"
        zero = ", its link encoder's zero tared" if conclusion.problem.link_measured else ""
        return [f"{why}: {left if drawn.share else f'joint.yaml is the description{zero}'}"]
    return []


def _stands_apart(conclusion: Conclusion) -> list[str]:
    """The recording that the description fits far worse than every other, and what was found hardly better."""
    each = sorted((r for r in conclusion.drawn.regions if r.recordings), key=lambda r: -r.described)
    if len(each) < 2 or each[0].described < ANSWER.apart * each[1].described:
        return []
    if each[0].extended < ANSWER.explained * each[0].described:
        return []
    return [
        f"by the description {each[0].name} is off by {each[0].described:.2g} N·m RMS, every other by {each[1].described:.2g} "
        "at most: is it of the same joint, with the load and the pushes that its YAML file states?"
    ]


def _rezeroed(conclusion: Conclusion) -> list[str]:
    """Where the link encoder's zero differs between recordings."""
    if not conclusion.zeros:
        return []
    each = ", ".join(f"{name} {1e3 * x:+.2g}" for name, x in conclusion.zeros.items())
    return [
        f"each recording alone has another zero of the link encoder ({each} mrad): was one set in between? Diagnose each alone"
    ]


def meaningless(joint: Joint, mistakes: tuple[Mistake, ...], seconds: float) -> Diagnosis:
    """The answer while mistakes in the data make physics meaningless."""
    named = ", ".join(sorted({m.name for m in mistakes if m.severe}))
    lost = dict.fromkeys(f"{m.column}: {m.unmended}" for m in mistakes if m.lost)
    everything = {n: "mistakes in the data" for n in causes.of(joint)}
    told = Diagnosis("inconclusive", (), (), {}, (), everything, {}, (), joint, mistakes=mistakes, seconds=seconds)
    if lost or told.mendable:
        mended = "`flexspline import --fix` writes them mended"
        return replace(told, reasons=(f"mistakes in the data ({named}) make physics meaningless", *(lost or (mended,))))
    return replace(told, reasons=(NO_CHANGE, f"what would mend most: {named}"))


def nothing_usable(
    why: str | None, joint: Joint, mistakes: tuple[Mistake, ...], missing: dict[str, str], seconds: float
) -> Diagnosis:
    """The answer where no sample counts; `why` (`coverage.too_little`), where that is for want of length or motion."""
    reasons = (
        why
        or "in no part without gaps does the rotor go as far as it takes for its friction's beginning not to matter",
    )
    return Diagnosis("inconclusive", reasons, (), {}, (), missing, {}, (), joint, mistakes=mistakes, seconds=seconds)


def _held_out(problem: Problem) -> str:
    """How data were kept from the fits, and over what the numbers of `residual` are means."""
    every, block = SETTINGS.held_out_every, SETTINGS.held_out_block
    if problem.holds_out:
        kept = f"every {every}th block of {block:g} s of each recording was kept from every fit; RMS"
    else:
        kept = f"too short to keep every {every}th block of {block:g} s from the fits: RMS of what was fitted,"
    return (
        f"{kept} in motion, while what was measured of the motion is followed; `regions`: the ends of the range of angle, speed "
        "and load, and whole recordings, each kept from a fit of its own"
    )


def _verdict(
    conclusion: Conclusion, findings: list[Finding], residual: dict[str, BalanceResidual], useless: bool
) -> tuple[str, list[str]]:
    """Verdict and, where it is not plain, its reasons: a residual far above the noise is never consistent.

    Args:
      useless: whether the causes leave no less unexplained than calibration alone.
    """
    problem = conclusion.problem
    # Not all that the fit found is in the joint of which `residual` is: what that leaves is no noise.
    taken_back = conclusion.drawn.share < 1.0
    rated = problem.joint.numbers["rated_torque"].value
    scale = dict(zip(BALANCES, problem.output_scale, strict=True)) | {"motor_torque": problem.joint.numbers["N"].value}
    times, worth = (ANSWER.far, ANSWER.worth) if findings or not taken_back else (ANSWER.near, 0.0)
    far = [
        (name, r) for name, r in residual.items()
        if r.after > times * r.noise and r.after * scale[name] > worth * rated
    ]  # fmt: skip
    left = _left(far, " by joint.yaml" if taken_back else "")
    late = [] if conclusion.found.complete else [_LATE]
    if useless and findings:
        return "inconclusive", ["the causes named leave no less unexplained than calibration alone", *late, *left]
    if findings and all(f.confidence <= ANSWER.unsure for f in findings):
        return "inconclusive", [_NOT_SURE, *late, *left]
    if findings:
        return "discrepancy", [*late, *_after("beside the causes named, ", left)]
    if conclusion.nearly_all:
        return "inconclusive", ["nearly all causes could not have shown", *late, *left]
    if late:
        return "inconclusive", [*late, *left]
    if far:
        return "inconclusive", left if taken_back else ["no known cause explains the residual", *left]
    some = [(name, r) for name, r in residual.items() if r.after > ANSWER.near * r.noise]
    return "consistent", _after("small, but more than noise: ", _left(some))


def _left(far: Sequence[tuple[str, BalanceResidual]], by: str = "") -> list[str]:
    """What balances leave beyond the sensors' noise."""
    return [
        f"{name.replace('_', ' ')}: {r.after:.3g} {r.unit} RMS is left{by}, {r.after / max(r.noise, 1e-12):.0f} times the noise"
        for name, r in far
    ]


def _after(words: str, reasons: list[str]) -> list[str]:
    """The same reasons, the first of them after some words."""
    return [words + reasons[0], *reasons[1:]] if reasons else []


def _balances(problem: Problem, base: Fit, final: Fit, drive_torque: float) -> dict[str, BalanceResidual]:
    """RMS on held-out samples by balance, in motion: at rest friction may be anything up to its level; of all where none is held
    out.

    Args:
      drive_torque: [N·m/A], where the drive reported a torque and no current: the RMS is then that torque's; else 0.
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
