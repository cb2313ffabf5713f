"""Error of an extended joint outside the data of its fit: parts of a measurement, each held out of a fit of its own.

For each part the parameters are found again without it (in the linear model about the fit, exact to first order). Models are
compared by their error on `FOLDS` successive stretches of time (`unseen_square`). The ends of the range of angle, speed and load,
and whole recordings, show what happens on other motions: there a fit is compared with the description (`held_out_regions`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...models.joint_parts import ValidRange
from ..data.segments import BALANCES
from ..regression import MOVING
from . import encoder_zero
from .noise import learn, whiten
from .residual import Problem
from .solver import Columns, Fit, Point, bounded_step, huber_weight, leverage_weight

FOLDS = 10  # parts of a measurement: stretches of time of a cross-validation
END = 2 / FOLDS  # share of the samples at an end of a range, two parts
FEWEST = 20  # samples in motion that a region must have
WORSE = 1.05  # ratio of errors from which a joint is worse than another
MOST = 2.0  # largest ratio of RMS errors in a region, extended without it over described, of a joint that is written
SHARES = (1.0, 0.7, 0.4, 0.2, 0.0)  # of the way from the description to the fit that are tried


@dataclass(frozen=True)
class Region:
    """One region of a measurement.

    Attributes:
      name: in words; recordings: whether it is a whole recording.
      samples: residuals in motion in it.
      described: RMS of the simulation error with the zeroed description [N·m at the output].
      extended: the same with the extended joint; unseen: with the extended joint fitted without the region.
      ratio: of `unseen` to `described`, with the sensors' noise in both.
    """

    name: str
    recordings: bool
    samples: int
    described: float
    extended: float
    unseen: float
    ratio: float

    @property
    def worse(self) -> bool:
        """Whether the extension fitted without the region is worse there than the description."""
        return self.ratio > WORSE

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "region": self.name, "samples": self.samples, "described": self.described, "extended": self.extended,
            "unseen": self.unseen, "ratio": self.ratio, "worse": self.worse, "unit": "N·m",
        }  # fmt: skip


def region_masks(problem: Problem) -> dict[str, list[np.ndarray]]:
    """Return the residuals of every region by segment: ends of angle, speed, load and time, whole recordings."""
    segments = problem.segments

    def end(values: list[np.ndarray], high: bool) -> list[np.ndarray]:
        moving = np.concatenate([x[s.usable.any(axis=1) & ~s.at_rest] for x, s in zip(values, segments, strict=True)])
        if not len(moving) or np.ptp(moving) < 1e-9:
            return [np.zeros(len(x), bool) for x in values]
        limit = np.quantile(moving, 1 - END if high else END)
        return [x > limit if high else x < limit for x in values]

    angle = [s.link_position for s in segments]
    speed = [np.abs(s.motor_velocity) for s in segments]
    load = [s.load for s in segments]
    time = [s.at for s in segments]
    found = {
        "the smallest angles": end(angle, False),
        "the largest angles": end(angle, True),
        "the highest speeds": end(speed, True),
        "the smallest loads": end(load, False),
        "the largest loads": end(load, True),
        "the earliest samples": end(time, False),
        "the latest samples": end(time, True),
    }
    names = sorted({s.name for s in segments})
    if len(names) > 1:
        for name in names:
            found[f"recording {name}"] = [np.full(len(s.at), s.name == name) for s in segments]
    return found


@dataclass(frozen=True)
class Shrunk:
    """A fit that was shrunk towards the description.

    Attributes:
      share: of the way from the description to the fit.
      fit: there; its covariance includes the rest of the way.
      regions: with it.
      refused: whether a share with a smaller error was not accepted.
      worst: region in which the whole fit is worst, if that is why it was shrunk.
    """

    share: float
    fit: Fit
    regions: tuple[Region, ...]
    refused: bool = False
    worst: Region | None = None


def shrunk(problem: Problem, f: Fit, accepts: Callable[[Fit], bool]) -> Shrunk:
    """Shrink a fit towards the description to the least error on time that it has not seen (`unseen_square`).

    A fit that makes one region `MOST` times worse than the description is not written.

    Args:
      accepts: a further condition; the next best share is tried where it is false.
    """
    system = NormalEquations(problem, f)
    start = problem.start(None, f.model)
    start[problem.zeros] = f.theta[problem.zeros]  # the description does not specify zeros
    before = encoder_zero.described(problem)
    seen = held_out_regions(problem, f, system, described=before, replayed=True)
    worst = next((r for r in seen if r.worse), None)

    def part(share: float) -> tuple[Fit, tuple[Region, ...]]:
        if share == 1.0:
            return f, seen
        theta = start + share * (f.theta - start)
        residual = problem.residuals([theta], [f.model])[0]
        away = f.theta - theta
        # The distance from the data's optimum is uncertainty, and the larger residual is discrepancy.
        covariance = f.covariance + np.outer(away, away)
        at = replace(
            f, theta=theta, point=Point(residual, f.point.noise), covariance=covariance, least_covariance=covariance,
            noise=learn(problem.segments, residual, f.point.noise, problem.quantum(), None, f.noise.bands),
        )  # fmt: skip
        return at, held_out_regions(problem, at, system, share, before, replayed=True)

    shares = SHARES if seen else (0.0,)  # without a held-out region nothing is written
    parts = {share: part(share) for share in shares}
    harmless = [s for s in parts if s == 0.0 or all(r.ratio <= MOST for r in parts[s][1])]
    refused = False
    for share in sorted(harmless, key=lambda s: unseen_square(problem, parts[s][0], system, s)):
        at, found = parts[share]
        if share == 0.0 or accepts(at):
            break
        refused = True
    return Shrunk(share, at, found, refused, worst)


def unseen_square(problem: Problem, f: Fit, system: NormalEquations | None = None, share: float = 1.0) -> float:
    """Return the mean square error in motion [N·m]² on `FOLDS` successive stretches of time, each by a fit without it, summed
    over the balances (blocked cross-validation); `system`, `share`: as of `held_out_regions`."""
    system = NormalEquations(problem, f) if system is None else system
    use, stretches = system.stretches
    unseen = [r.copy() for r in f.point.residual]
    for masks, shift in stretches:
        for r, J, mask in zip(unseen, f.jacobian, masks, strict=True):
            r[mask] += J[mask] @ (share * shift)
    return float(np.nansum(_rms(unseen, use, problem.output_scale) ** 2))


def least_speed(problem: Problem) -> float:
    """Return the speed [rad/s] of the link from which a regression uses samples: below, friction is undefined."""
    return MOVING * float(np.quantile(np.concatenate([np.abs(s.state[:, 3]) for s in problem.segments]), 0.98))


def held_out_regions(
    problem: Problem,
    f: Fit,
    system: NormalEquations | None = None,
    share: float = 1.0,
    described: Columns | None = None,
    replayed: bool = False,
) -> tuple[Region, ...]:
    """Return every region, the one with the largest ratio first.

    Args:
      system: normal equations about the fit of which `f` is a `share` of the way from the description.
      described: residuals of the zeroed description, if they are known.
      replayed: replay regions where the linear model, whose shift may be too large for it, predicts harm.
    """
    system = NormalEquations(problem, f) if system is None else system
    described = encoder_zero.described(problem) if described is None else described
    scale = problem.output_scale
    parts = [(name, where, share * shift) for name, where, shift in system.regions]

    def region(name: str, where: list[np.ndarray], unseen: Columns) -> Region:
        before, seen, after, noise = (
            _rms(x, where, scale) for x in (described, f.point.residual, unseen, f.point.noise)
        )
        formed = np.isfinite(before)
        # The noise in both: where only noise is left, neither is worse.
        floor = np.nansum(noise**2)
        ratio = float(np.sqrt((np.nansum(after**2) + floor) / max(np.nansum(before**2) + floor, 1e-300)))
        shown = [float(np.sqrt(np.mean(x[formed] ** 2))) if formed.any() else 0.0 for x in (before, seen, after)]
        return Region(name, name.startswith("recording "), _count(where), shown[0], shown[1], shown[2], ratio)

    found = [
        region(name, where, [r + J @ shift for r, J in zip(f.point.residual, f.jacobian, strict=True)])
        for name, where, shift in parts
    ]
    doubted = [i for i, one in enumerate(found) if replayed and one.worse]
    thetas = [f.theta + parts[i][2] for i in doubted]
    exact = problem.residuals(thetas, [f.model] * len(thetas)) if thetas else []
    for i, unseen in zip(doubted, exact, strict=True):
        found[i] = region(*parts[i][:2], unseen)
    return tuple(sorted(found, key=lambda r: -r.ratio))


def _count(where: list[np.ndarray]) -> int:
    return int(sum(u.any(axis=1).sum() for u in where))


def _rms(residual: Columns, use: list[np.ndarray], scale: np.ndarray) -> np.ndarray:
    """Root mean square over samples in use by balance [N·m at the output], shape (len(BALANCES),); NaN where there are none."""
    total, count = np.zeros(len(BALANCES)), np.zeros(len(BALANCES))
    for r, u in zip(residual, use, strict=True):
        total += np.sum(np.where(u, r * scale, 0.0) ** 2, axis=0)
        count += np.sum(u, axis=0)
    return np.sqrt(np.divide(total, count, out=np.full(len(BALANCES), np.nan), where=count > 0))


class NormalEquations:
    """Normal equations about a fit, for solutions without some of their rows.

    Attributes:
      stretches: samples in use of a cross-validation, and of each stretch of time its samples and the shift of the unknowns
        without it; none if there is too little motion.
      regions: of each region its name, its residuals in motion, and the shift of the unknowns without it.
    """

    def __init__(self, problem: Problem, f: Fit):
        self.problem, self.f = problem, f
        rows = whiten(problem.segments, f.noise, f.point.residual, f.jacobian).rows
        weight = huber_weight(rows[:, 0]) * leverage_weight(rows[:, 1 : problem.size + 1])
        self.rows = rows * np.sqrt(weight)[:, None]
        self.precision = 1 / problem.spread(f.model) ** 2
        low, high = problem.bounds(f.model)
        self.low, self.high = low - f.theta, high - f.theta
        self.reference = self._solve(np.ones(len(rows), bool))

    def _solve(self, kept: np.ndarray) -> np.ndarray:
        part = self.rows[kept]
        H = part[:, 1:].T @ part[:, 1:] + np.diag(self.precision)
        g = part[:, 1:].T @ part[:, 0] + self.precision * self.f.theta
        return bounded_step(H, g, self.low, self.high)

    def without(self, masks: list[np.ndarray]) -> np.ndarray:
        """Return the shift of the unknowns, shape (n,), if a region is held out."""
        inside = []
        for segment, mask in zip(self.problem.segments, masks, strict=True):
            starts = np.arange(0, len(mask), segment.block)
            blocks = np.maximum.reduceat(mask, starts)
            inside += [blocks] * len(BALANCES)
        kept = ~np.concatenate(inside)
        return self._solve(kept) - self.reference

    @cached_property
    def stretches(self) -> tuple[list[np.ndarray], list[tuple[list[np.ndarray], np.ndarray]]]:
        segments, least = self.problem.segments, least_speed(self.problem)
        use = [(s.usable | s.held_out) & (np.abs(s.state[:, 3]) > least)[:, None] for s in segments]
        moving = [u.any(axis=1) for u in use]
        count = np.cumsum([0, *(m.sum() for m in moving)])
        if count[-1] < FEWEST * FOLDS:
            return [s.usable for s in segments], []
        fold = [FOLDS * (n + np.cumsum(m)) // (count[-1] + 1) for n, m in zip(count, moving, strict=False)]
        each = [[at == k for at in fold] for k in range(FOLDS)]
        return use, [(masks, self.without(masks)) for masks in each]

    @cached_property
    def regions(self) -> list[tuple[str, list[np.ndarray], np.ndarray]]:
        segments, found = self.problem.segments, []
        moving = [(s.usable & ~s.at_rest[:, None]).any(axis=1) for s in segments]
        for name, masks in region_masks(self.problem).items():
            where = [
                (s.usable | s.held_out) & ~s.at_rest[:, None] & mask[:, None]
                for s, mask in zip(segments, masks, strict=True)
            ]
            rest = int(sum((x & ~m).sum() for x, m in zip(moving, masks, strict=True)))
            if _count(where) >= FEWEST and rest >= FEWEST:
                found.append((name, where, self.without(masks)))
        return found


def valid_range(problem: Problem, kept: Sequence[np.ndarray] | None = None) -> ValidRange | None:
    """Return the range of the data (of `kept` residuals by segment, shape (k,)); None without data."""
    angle, speed, load, drives = [], [], [], []
    for i, s in enumerate(problem.segments):
        use = s.usable.any(axis=1) & (True if kept is None else kept[i])
        angle.append(s.link_position[use])
        speed.append(s.state[use, 3])
        load.append(s.load[use])
        moving = use & ~s.at_rest
        drives.append(np.sign(s.load[moving] * s.motor_velocity[moving]))
    if not sum(len(x) for x in angle):
        return None

    def ends(x: list[np.ndarray], share: float = 0.002) -> list[float]:
        return [float(f"{v:.4g}") for v in np.quantile(np.concatenate(x), [share, 1 - share])]

    signs = np.concatenate(drives)
    loads = [name for name, sign in (("driving", 1), ("driven", -1)) if len(signs) and np.mean(signs == sign) > 0.02]
    return ValidRange(link_position=ends(angle), link_velocity=ends(speed), joint_torque=ends(load), loads=loads)
