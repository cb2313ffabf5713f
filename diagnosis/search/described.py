"""What the data say of a joint that is just as it is described: for measurements that calibration explains away.

A short measurement knows little, and what is not known of stiffness, inertia and friction then stands in for any effect on
the way, and for nothing beyond it. Here all numbers but the zeros of encoder and torque sensor stay as described, nothing slow is
taken for model discrepancy, and a cause is accepted where it explains most of what is left, makes no balance worse, holds on
regions that its fit has not seen, and no other cause does so as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.noise import EVEN
from ..fit.regions import Region, held_out_regions, mean_ratio
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter, with_dispersion
from ..fit.tare import described, tared
from .screen import Library, screen
from .stages import (
    SETTINGS,
    Decision,
    Finalist,
    Rivals,
    Search,
    SearchSettings,
    finalists_of,
    others_than,
    quiet_rms,
    rivals_of,
    significance,
    size_of,
)
from .worth import unexplained


@dataclass(frozen=True)
class DescribedSettings:
    """When a cause is accepted.

    Attributes:
      removes: part of the mean square that is not explained that it must take away.
      worse: ratio of the mean square of one balance from which on it is worse there.
      mean, worst: geometric mean over regions, and largest, of the ratio of errors (`regions.Region.ratio`) up to which it holds
        where its fit has not been.
      alike: ratio of these means up to which another cause that holds is as good: then neither is accepted.
      most: causes.
    """

    removes: float = 0.5
    worse: float = 1.1
    mean: float = 0.75
    worst: float = 1.5
    alike: float = 1.5
    most: int = 3


DESCRIBED = DescribedSettings()


def as_described(
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings = SETTINGS,
    accept: DescribedSettings = DESCRIBED,
) -> Search | None:
    """Causes that hold with all numbers as described; None where there are none.

    Args:
      problem: in which only zeros may move (`Problem.as_described`).
    """
    fitter = Fitter(problem, noise=EVEN)
    start = tared(problem, problem.start(None, ()), ())
    before = described(problem)
    at = first = fitter.fit((), start, iterations=settings.calibrate.iterations)
    library = Library(problem, at, hypotheses, settings.screen.coarse_probe)
    rivals: list[Rivals] = []
    decisions: list[Decision] = []
    confusable: tuple[tuple[str, str], ...] = ()
    while len(at.model) < accept.most:
        screened = screen(problem, at, library, settings.screen)
        fitted = finalists_of(problem, fitter, at, screened, settings.accept)
        good: list[tuple[float, Finalist, Fit]] = []
        for f in fitted:
            found = fitter.fit(f.fit.model, f.fit.theta, None, settings.calibrate.iterations)
            regions = held_out_regions(problem, found, described=before)
            reason = _objection(problem, at, found, f.gain, regions, settings, accept)
            if not reason:
                good.append((mean_ratio(regions), f, found))
            decisions.append(_decision(problem, f, found, reason or "holds also where its fit has not been"))
        if not good:
            break
        mean, chosen, found = min(good, key=lambda one: one[0])
        alike = [f for other, f, _ in good if f.name != chosen.name and other < accept.alike * mean]
        if alike:
            # Each would say something else of motion that nobody has seen.
            names = ", ".join(f.name.replace("_", " ") for f in alike)
            decisions.append(_decision(problem, chosen, found, f"cannot be told from {names}"))
            confusable = tuple((chosen.name, f.name) for f in alike)
            break
        away = significance(problem, with_dispersion(problem, found))
        if away < settings.accept.significant:
            told = f"{away:.1f} standard deviations from absent, must be {settings.accept.significant:g}"
            decisions.append(_decision(problem, chosen, found, told))
            break
        rivals.append(rivals_of(chosen, {f.name: f.gain for _, f, _ in good}, {}, settings.accept))
        rms = float(np.sqrt(max(chosen.removed, 0.0)))
        told = f"takes {rms:.2g} N·m RMS from the simulation's error, also where its fit has not been"
        decisions.append(_decision(problem, chosen, found, told, True))
        at = found
        library = Library(problem, at, others_than(hypotheses, at.model), settings.screen.coarse_probe)
    if not at.model:
        return None
    quiet = (quiet_rms(problem, first), quiet_rms(problem, at))
    return Search(first, at, library, tuple(rivals), tuple(decisions), quiet, confusable=confusable)


def _decision(problem: Problem, f: Finalist, found: Fit, reason: str, taken: bool = False) -> Decision:
    rms = float(np.sqrt(max(f.removed, 0.0)))
    return Decision(
        "described", f.name, found.model[-1].fixed, f.gain, rms, size_of(problem, found), True, taken, reason
    )


def _objection(
    problem: Problem,
    base: Fit,
    f: Fit,
    gain: float,
    regions: Sequence[Region],
    settings: SearchSettings,
    accept: DescribedSettings,
) -> str:
    """Why a cause is not accepted; empty where it is."""
    before, after = unexplained(problem, base.point), unexplained(problem, f.point)
    if gain < settings.accept.threshold:
        return f"adds {gain:.1f} to the log evidence, needs {settings.accept.threshold:g}"
    if after.sum() > (1 - accept.removes) * before.sum():
        return f"takes {100 * (1 - after.sum() / before.sum()):.0f} % of the mean square, must take {100 * accept.removes:.0f} %"
    if np.any(after > accept.worse * before + 0.01 * before.sum()):
        return "makes another balance worse"
    if not regions:
        return "too little motion to keep a region of it from the fit"
    worst = max(r.ratio for r in regions)
    if worst > accept.worst or mean_ratio(regions) > accept.mean:
        return f"has up to {worst:.1f} times the description's error where its fit has not been"
    return ""
