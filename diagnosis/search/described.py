"""What the data say of a joint that is just as it is described: for measurements that calibration explains away.

A short measurement knows little, and what is not known of stiffness, inertia and friction then stands in for any effect on
the way, and for nothing beyond it. Here all numbers but zeros and offsets stay as described, nothing slow is taken for model
discrepancy, and a cause is accepted where it explains most of what is left, makes no balance worse, and holds on regions that its
fit has not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.noise import EVEN
from ..fit.regions import held_out_regions
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter
from .calibrate import tared
from .screen import Library, screen
from .stages import (
    SETTINGS,
    Decision,
    Rivals,
    Search,
    SearchSettings,
    finalists_of,
    others_than,
    quiet_rms,
    rivals_of,
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
      most: causes.
    """

    removes: float = 0.5
    worse: float = 1.1
    mean: float = 0.75
    worst: float = 1.5
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
      problem: in which only zeros and offsets may move (`Problem.as_described`).
    """
    fitter = Fitter(problem, noise=EVEN)
    start = tared(problem, problem.start(None, ()), (), settings.calibrate)
    at = first = fitter.fit((), start, iterations=settings.calibrate.iterations)
    library = Library(problem, at, hypotheses, settings.screen.coarse_probe)
    rivals: list[Rivals] = []
    decisions: list[Decision] = []
    while len(at.model) < accept.most:
        screened = screen(problem, at, library, settings.screen)
        fitted = finalists_of(problem, fitter, at, screened, settings.accept)
        gains = {f.name: f.gain for f in reversed(fitted)}
        for f in fitted:
            found = fitter.fit(f.fit.model, f.fit.theta, None, settings.calibrate.iterations)
            reason = _objection(problem, at, found, f.gain, settings, accept)
            h = found.model[-1]
            rms = float(np.sqrt(max(f.removed, 0.0)))
            told = reason or f"takes {rms:.2g} N·m RMS from the simulation's error, also where its fit has not been"
            decisions.append(
                Decision("described", f.name, h.fixed, f.gain, rms, size_of(problem, found), True, not reason, told)
            )
            if not reason:
                rivals.append(rivals_of(f, gains, {}, settings.accept))
                break
        else:
            break
        at = found
        library = Library(problem, at, others_than(hypotheses, at.model), settings.screen.coarse_probe)
    if not at.model:
        return None
    return Search(
        first, at, library, tuple(rivals), tuple(decisions), (quiet_rms(problem, first), quiet_rms(problem, at))
    )


def _objection(
    problem: Problem, base: Fit, f: Fit, gain: float, settings: SearchSettings, accept: DescribedSettings
) -> str:
    """Why a cause is not accepted; empty where it is."""
    before, after = unexplained(problem, base.point), unexplained(problem, f.point)
    if gain < settings.accept.threshold:
        return f"adds {gain:.1f} to the log evidence, needs {settings.accept.threshold:g}"
    if after.sum() > (1 - accept.removes) * before.sum():
        return f"takes {100 * (1 - after.sum() / before.sum()):.0f} % of the mean square, must take {100 * accept.removes:.0f} %"
    if np.any(after > accept.worse * before + 0.01 * before.sum()):
        return "makes another balance worse"
    ratios = [max(r.ratio, 1e-6) for r in held_out_regions(problem, f)]
    if not ratios:
        return "too little motion to keep a region of it from the fit"
    if max(ratios) > accept.worst or np.exp(np.mean(np.log(ratios))) > accept.mean:
        return f"has up to {max(ratios):.1f} times the description's error where its fit has not been"
    return ""
