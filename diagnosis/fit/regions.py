"""What an extended joint is worth where its fit has not been: regions of a measurement, each kept from a fit of its own.

Interleaved blocks of time are held out of every fit, but they lie between blocks that were seen. The ends of the range of angle,
speed and load, and whole recordings, are the rehearsal for motions that nobody measured: for each, the parameters are found
again without it (in the linear model about the fit, exact to first order) and judged on it, beside the description as it came.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...models.joint_parts import ValidRange
from ..data.segments import BALANCES
from . import tare
from .noise import learn, whiten
from .residual import Problem
from .solver import SETTINGS as SOLVER
from .solver import Columns, Fit, Point, bounded_step, huber_weight, leverage_weight


@dataclass(frozen=True)
class RegionSettings:
    """Which regions are held out.

    Attributes:
      end: share of the samples that lie at an end of a range.
      fewest: samples in motion that a region must have.
      worse: ratio of RMS errors, extended without the region over described, from which on the extension is worse there.
      most: such a ratio beyond which an extension is not written, whatever it gains elsewhere.
      shares: of the way from the description to the fit that are tried.
    """

    end: float = 0.2
    fewest: int = 20
    worse: float = 1.05
    most: float = 2.0
    shares: tuple[float, ...] = (1.0, 0.7, 0.4, 0.2, 0.0)


SETTINGS = RegionSettings()


@dataclass(frozen=True)
class Region:
    """One region of a measurement.

    Attributes:
      name: for people. recordings: whether it is a whole recording.
      samples: residuals in motion in it.
      described: RMS of the simulation's error there with the description as it came, the link encoder's zero tared [N·m at the
        output].
      extended: with the extended joint, whose fit has seen the region.
      unseen: with the extended joint fitted without the region.
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
        """Whether the extension does worse there than the description, had it not seen the region."""
        return self.ratio > SETTINGS.worse

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "region": self.name, "samples": self.samples, "described": self.described, "extended": self.extended,
            "unseen": self.unseen, "ratio": self.ratio, "worse": self.worse, "unit": "N·m",
        }  # fmt: skip


def region_masks(problem: Problem, settings: RegionSettings = SETTINGS) -> dict[str, list[np.ndarray]]:
    """Residuals of every region by segment: ends of angle, speed, load and time, whole recordings.

    Not the directions of motion: either both were seen, and no motion lies beyond them, or one alone.
    """
    segments = problem.segments

    def end(values: list[np.ndarray], high: bool) -> list[np.ndarray]:
        moving = np.concatenate([x[s.usable.any(axis=1) & ~s.at_rest] for x, s in zip(values, segments, strict=True)])
        if not len(moving) or np.ptp(moving) < 1e-9:
            return [np.zeros(len(x), bool) for x in values]
        limit = np.quantile(moving, 1 - settings.end if high else settings.end)
        return [x > limit if high else x < limit for x in values]

    angle = [s.link_position for s in segments]
    speed = [np.abs(s.motor_velocity) for s in segments]
    load = [s.load for s in segments]
    found = {
        "the smallest angles": end(angle, False),
        "the largest angles": end(angle, True),
        "the highest speeds": end(speed, True),
        "the smallest loads": end(load, False),
        "the largest loads": end(load, True),
    }
    time = [s.at for s in segments]
    found |= {"the earliest samples": end(time, False), "the latest samples": end(time, True)}
    names = sorted({s.name for s in segments})
    if len(names) > 1:
        for name in names:
            found[f"recording {name}"] = [np.full(len(s.at), s.name == name) for s in segments]
    return found


@dataclass(frozen=True)
class DrawnBack:
    """A fit drawn back towards the description.

    Attributes:
      share: of the way to the fit that is left.
      fit: there; what is not known of it is wider by the way back.
      regions: with it.
      refused: whether a larger share, with which no region is worse, does not serve.
      worst: region in which the whole fit does worst, where that is why it is drawn back.
    """

    share: float
    fit: Fit
    regions: tuple[Region, ...]
    refused: bool = False
    worst: Region | None = None


def drawn_back(
    problem: Problem,
    f: Fit,
    settings: RegionSettings = SETTINGS,
    serves: Callable[[Fit], bool] = lambda f: True,
) -> DrawnBack:
    """The fit drawn back towards the description as far as leaves least of regions that it has not seen, and serves.

    What is left is the sum of the regions' mean squares [N·m]²; a fit that makes one of them `most` times worse than the
    description is not written, whatever it gains elsewhere.
    """
    system = NormalEquations(problem, f)
    start = problem.start(None, f.model)
    start[problem.zeros] = f.theta[problem.zeros]  # of two encoders against each other nothing is described
    before = tare.described(problem)
    seen = held_out_regions(problem, f, settings, system, described=before)
    worst = next((r for r in seen if r.worse), None)

    def part(share: float) -> tuple[Fit, tuple[Region, ...]]:
        if share == 1.0:
            return f, seen
        theta = start + share * (f.theta - start)
        residual = problem.residuals([theta], [f.model])[0]
        away = f.theta - theta
        # By how much it is not what the data say is not known of it, and what it leaves is what it cannot hold.
        covariance = f.covariance + np.outer(away, away)
        at = replace(
            f, theta=theta, point=Point(residual, f.point.noise), covariance=covariance, least=covariance,
            noise=learn(problem.segments, residual, f.point.noise, problem.quantum(), None, f.noise.settings),
        )  # fmt: skip
        return at, held_out_regions(problem, at, settings, system, share, before)

    shares = list(settings.shares) if seen else [0.0]  # what nothing can be held against is not written
    if worst is not None:
        regions = {share: part(share)[1] for share in shares}
        harmless = [s for s in shares if s == 0.0 or all(r.ratio <= settings.most for r in regions[s])]
        shares = sorted(harmless, key=lambda s: sum(r.unseen**2 for r in regions[s]))
    refused = False
    for share in shares:
        at, found = part(share)
        if share == 0.0 or serves(at):
            break
        refused = True
    return DrawnBack(share, at, found, refused, worst)


def held_out_regions(
    problem: Problem,
    f: Fit,
    settings: RegionSettings = SETTINGS,
    system: NormalEquations | None = None,
    share: float = 1.0,
    described: Columns | None = None,
) -> tuple[Region, ...]:
    """Every region, the one where the extension is worth least first.

    Args:
      system: normal equations about the fit of which `f` is a `share` of the way from the description.
      described: residuals of the joint as it is described, where they are known already.
    """
    system = NormalEquations(problem, f) if system is None else system
    described = tare.described(problem) if described is None else described
    scale = problem.output_scale
    found = []
    for name, masks in region_masks(problem, settings).items():
        use = [
            (s.usable | s.held_out) & ~s.at_rest[:, None] & mask[:, None]
            for s, mask in zip(problem.segments, masks, strict=True)
        ]
        samples = int(sum(u.any(axis=1).sum() for u in use))
        rest = int(
            sum(
                ((s.usable & ~s.at_rest[:, None]).any(axis=1) & ~m).sum()
                for s, m in zip(problem.segments, masks, strict=True)
            )
        )
        if samples < settings.fewest or rest < settings.fewest:
            continue
        shift = system.without(masks)
        unseen = [r + share * (J @ shift) for r, J in zip(f.point.residual, f.jacobian, strict=True)]
        before, seen, after, noise = (_rms(x, use, scale) for x in (described, f.point.residual, unseen, f.point.noise))
        formed = np.isfinite(before)
        # Where both are noise, neither is worse.
        floor = np.nansum(noise**2)
        ratio = float(np.sqrt((np.nansum(after**2) + floor) / max(np.nansum(before**2) + floor, 1e-300)))
        described_rms, extended_rms, unseen_rms = (
            float(np.sqrt(np.mean(x[formed] ** 2))) if formed.any() else 0.0 for x in (before, seen, after)
        )
        found.append(
            Region(name, name.startswith("recording "), samples, described_rms, extended_rms, unseen_rms, ratio)
        )
    return tuple(sorted(found, key=lambda r: -r.ratio))


def _rms(residual: Columns, use: list[np.ndarray], scale: np.ndarray) -> np.ndarray:
    """Root mean square over samples in use by balance [N·m at the output], shape (len(BALANCES),); NaN where there are none."""
    total, count = np.zeros(len(BALANCES)), np.zeros(len(BALANCES))
    for r, u in zip(residual, use, strict=True):
        total += np.sum(np.where(u, r * scale, 0.0) ** 2, axis=0)
        count += np.sum(u, axis=0)
    return np.sqrt(np.divide(total, count, out=np.full(len(BALANCES), np.nan), where=count > 0))


class NormalEquations:
    """The normal equations about a fit, from which rows may be taken."""

    def __init__(self, problem: Problem, f: Fit):
        self.problem, self.f = problem, f
        rows = whiten(problem.segments, f.noise, f.point.residual, f.jacobian).rows
        weight = huber_weight(rows[:, 0], SOLVER.huber) * leverage_weight(
            rows[:, 1 : problem.size + 1], SOLVER.leverage
        )
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
        """By how much the unknowns move, shape (n,), where the residuals of a region are not seen."""
        inside = []
        for segment, mask in zip(self.problem.segments, masks, strict=True):
            starts = np.arange(0, len(mask), segment.block)
            blocks = np.maximum.reduceat(mask, starts)
            inside += [blocks] * len(BALANCES)
        kept = ~np.concatenate(inside)
        return self._solve(kept) - self.reference


def valid_range(problem: Problem, kept: Sequence[np.ndarray] | None = None) -> ValidRange | None:
    """Where the data that count have been (of `kept`, residuals by segment, shape (k,), alone); None where nothing moved."""
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
