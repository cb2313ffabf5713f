"""What diagnosis gains for estimation: error of estimators before and after they know what was found.

Each estimator runs on the recordings twice: with the calibrated joint (with the description as it came, where no cause was
found), and with the calibrated joint that has the causes in it. It reads no torque sensor; against that sensor, or where there is
none against the external torque that was measured, its error is taken: over the blocks of time that were kept from every fit, and
in the regions of the measurement (`fit.regions`), there with the parameters of a fit that has not seen the region.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ..estimator.conditioning import Conditioned
from ..estimator.offline import Estimates, estimate_recording
from ..models.joint import Joint
from ..models.recording import Measurement, Recording
from .answer import Diagnosis
from .data.segments import ENOUGH, Segment, in_held_out_block
from .data.stretches import most_telling
from .extension import calibrated
from .fit.regions import NormalEquations, region_masks

ESTIMATORS = ("EKF", "AREKF", "RAREKF", "current", "payload_smoothed")
"""By their names in the registry; of the first and of the last kind there is one for every recording that has a current."""
MAIN = ("RAREKF", "current", "payload_smoothed")
"""The first available one of these represents all."""
WORSE = 1.05
"""Ratio of an estimator's errors from which on a joint serves worse than another."""
TRUTHS = {"joint_torque": "the torque sensor", "external_torque": "the external torque that was measured"}
"""What estimates are held against, the first that there is; how it is called."""


@dataclass(frozen=True)
class Trace:
    """One recording, shape (n,) each: time since its start [s]; measured, main estimator before and after [N·m]."""

    name: str
    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class RegionError:
    """RMS error [N·m] of the main estimator in a region, before and after."""

    name: str
    before: float
    after: float


@dataclass(frozen=True)
class Improvement:
    """Error of estimators on data that no fit saw."""

    quantity: str  # what is estimated and was measured too, one of `TRUTHS`
    main: str  # the representative estimator
    errors: dict[str, tuple[float, float]]  # estimator → (before, after), RMS [N·m] over the held-out blocks
    regions: tuple[RegionError, ...]  # of the main estimator, the one where it gains least first
    noise: float  # of the reference [N·m rms], the error of a perfect estimate; 0 if unknown
    known_before: str  # what the estimators knew before, for people
    traces: tuple[Trace, ...] = field(repr=False)  # of the main estimator, by recording

    @property
    def source(self) -> str:
        """What estimates are held against, for people."""
        return TRUTHS[self.quantity]

    def to_json(self) -> dict[str, Any]:
        """What `diagnosis.json` holds as `estimation`."""
        before, after = self.errors[self.main]
        return {
            "filter": self.main, "before": before, "after": after, "unit": "N·m", "of": self.quantity,
            "estimators": {name: {"before": a, "after": b} for name, (a, b) in self.errors.items()},
            "regions": [{"region": r.name, "before": r.before, "after": r.after} for r in self.regions],
        }  # fmt: skip


@threadpool_limits.wrap(limits=1, user_api="blas")
def improvement(measurement: Measurement, diagnosis: Diagnosis) -> Improvement | None:
    """Return the error of estimators before and after, over the parts that a diagnosis uses (`most_telling`); None where nothing
    was measured to compare them with, or nothing was computed."""
    measurement = most_telling(measurement)  # the same recordings and places as in the diagnosis
    quantity, sensed = _sensed(measurement)
    if not sensed or diagnosis.problem is None or diagnosis.search is None:
        return None
    joint = diagnosis.problem.joint
    before = calibrated(diagnosis.problem, diagnosis.search.base, joint) if diagnosis.causes else joint
    with ThreadPoolExecutor(2) as pool:
        tasks = [
            pool.submit(estimate_recording, recording, known, ESTIMATORS)
            for _, recording in sensed
            for known in (before, diagnosis.unseen or diagnosis.extended)
        ]
        done = iter([task.result() for task in tasks])
    pairs = [(index, recording, (next(done), next(done))) for index, recording in sensed]
    names = [name for name in ESTIMATORS if all(name in _of(e, quantity) for *_, both in pairs for e in both)]
    main = next((name for name in MAIN if name in names), None)
    if main is None:
        return None
    kept = [held_out(recording, index) for index, recording in sensed]
    if np.mean(np.concatenate(kept)) <= ENOUGH:  # too short to keep blocks from the fits
        kept = [np.ones(len(recording.time), bool) for _, recording in sensed]
    return Improvement(
        quantity=quantity,
        main=main,
        errors={name: _errors(pairs, quantity, name, kept) for name in names},
        regions=_in_regions(diagnosis, pairs, quantity, main),
        noise=joint.sensors.joint_torque.noise if quantity == "joint_torque" else 0.0,
        known_before="the calibrated joint without the causes" if diagnosis.causes else "the description as it came",
        traces=tuple(
            Trace(r.name, r.time - r.time[0], r[quantity], *(_of(e, quantity)[main] for e in both)) for _, r, both in pairs
        ),
    )  # fmt: skip


def serves(measurement: Measurement, joint: Joint, conditioned: Sequence[Conditioned]) -> Callable[[Joint], bool]:
    """Return a test whether estimators do no worse with another joint than with this one: geometric mean of the ratios of errors
    of `MAIN`. It is always true if no torque was measured. `conditioned`: the measurement's recordings."""
    before = _errors_with(measurement, conditioned, joint)

    def no_worse(other: Joint) -> bool:
        after = _errors_with(measurement, conditioned, other)
        ratios = [max(after.get(name, np.inf), 1e-12) / max(error, 1e-12) for name, error in before.items()]
        return not ratios or float(np.mean(np.log(ratios))) <= np.log(WORSE)

    return no_worse


def removed(
    measurement: Measurement, whole: Joint, without: Sequence[Joint], conditioned: Sequence[Conditioned]
) -> list[float]:
    """Return the mean square of the estimators' error that a joint has less than each of others, [N·m]²: mean over `MAIN`. It is
    empty if no torque was measured. `conditioned`: the measurement's recordings."""
    with ThreadPoolExecutor(2) as pool:
        best, *others = pool.map(partial(_errors_with, measurement, conditioned), (whole, *without))
    if not best:
        return []
    more = [[other.get(name, error) ** 2 - error**2 for name, error in best.items()] for other in others]
    return [max(float(np.mean(squares)), 0.0) for squares in more]


def _errors_with(measurement: Measurement, conditioned: Sequence[Conditioned], known: Joint) -> dict[str, float]:
    """Return the RMS error of the estimators `MAIN` [N·m] with a joint description; empty if no torque was measured."""
    quantity, sensed = _sensed(measurement)
    estimates = [(r, estimate_recording(r, known, MAIN, conditioned=conditioned[i])) for i, r in sensed]
    found: dict[str, float] = {}
    for name in MAIN:
        pairs = [(recording, e) for recording, e in estimates if name in _of(e, quantity)]
        found[name] = _rms(pairs, quantity, name, [slice(None)] * len(pairs))
    return {name: error for name, error in found.items() if np.isfinite(error)}


def _sensed(measurement: Measurement) -> tuple[str, list[tuple[int, Recording]]]:
    """Return the first of `TRUTHS` that was measured, and its recordings, with their places in the measurement."""
    found = {name: [(i, r) for i, r in enumerate(measurement.recordings) if name in r] for name in TRUTHS}
    return next(((name, some) for name, some in found.items() if some), ("", []))


def _of(estimates: Estimates, quantity: str) -> Mapping[str, np.ndarray]:
    return estimates.torque if quantity == "joint_torque" else estimates.external_torque


_Pair = tuple[int, Recording, tuple[Estimates, Estimates]]
"""A recording with its place in the measurement, and its estimates before and after."""


def _errors(pairs: Sequence[_Pair], quantity: str, name: str, use: Sequence[np.ndarray]) -> tuple[float, float]:
    """RMS [N·m] before and after over some samples, one mask a recording."""
    before, after = (_rms([(recording, both[k]) for _, recording, both in pairs], quantity, name, use) for k in (0, 1))
    return before, after


def _rms(
    pairs: Sequence[tuple[Recording, Estimates]], quantity: str, name: str, use: Sequence[np.ndarray | slice]
) -> float:
    """RMS error of an estimator [N·m] over some samples of recordings; NaN where there are none."""
    squares = []
    for (recording, estimates), kept in zip(pairs, use, strict=True):
        estimate = _of(estimates, quantity).get(name)
        if estimate is not None:  # none where the filter diverged
            error = (estimate - recording[quantity])[kept]
            squares.append(error[np.isfinite(error)] ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if any(map(len, squares)) else float("nan")


def _in_regions(diagnosis: Diagnosis, pairs: Sequence[_Pair], quantity: str, name: str) -> tuple[RegionError, ...]:
    """Errors of an estimator in every region: before, and with the extended joint as a fit without the region has it."""
    problem, final, whole = diagnosis.problem, diagnosis.final, diagnosis.whole
    assert problem is not None and final is not None and whole is not None
    reported = {r.name for r in diagnosis.regions}
    masks = {region: m for region, m in region_masks(problem).items() if region in reported}
    system = NormalEquations(problem, whole)
    where = {region: [_samples(problem.segments, m, i, r) for i, r, *_ in pairs] for region, m in masks.items()}

    def unseen(region: str) -> list[Estimates]:
        if diagnosis.share == 0.0:  # nothing of the fit is in the extended joint
            return [after for *_, (_, after) in pairs]
        theta = final.theta + diagnosis.share * system.without(masks[region])
        records = dict(zip((s.recording for s in problem.segments), problem.records(theta, final.model), strict=True))
        return [
            estimate_recording(recording, diagnosis.extended, (name,), record=records[index]) if use.any() else after
            for (index, recording, (_, after)), use in zip(pairs, where[region], strict=True)
        ]

    visited = [region for region in masks if any(use.any() for use in where[region])]
    errors = []
    with ThreadPoolExecutor(2) as pool:
        for region, estimates in zip(visited, pool.map(unseen, visited), strict=True):
            seen = [(i, r, (before, e)) for (i, r, (before, _)), e in zip(pairs, estimates, strict=True)]
            errors.append(RegionError(region, *_errors(seen, quantity, name, where[region])))
    return tuple(sorted(errors, key=lambda e: -e.after / max(e.before, 1e-12)))


def _samples(segments: Sequence[Segment], masks: Sequence[np.ndarray], index: int, recording: Recording) -> np.ndarray:
    """Samples of a recording in motion in a region, shape (n,), bool."""
    found = np.zeros(len(recording.time), bool)
    since = recording.time - recording.time[0]
    for segment, mask in zip(segments, masks, strict=True):
        if segment.recording == index and len(segment.at):
            nearest = np.clip(np.searchsorted(segment.at, since), 0, len(segment.at) - 1)
            inside = (since >= segment.at[0]) & (since <= segment.at[-1])
            found |= inside & (mask & ~segment.at_rest)[nearest]
    return found


def held_out(recording: Recording, index: int) -> np.ndarray:
    """Samples in the blocks of time that no fit saw, shape (n,), bool; `index` of the recording in its measurement."""
    return in_held_out_block(recording.time - recording.time[0], index)


def with_improvement(diagnosis: Diagnosis, gained: Improvement | None) -> Diagnosis:
    """The diagnosis with what it gains for estimation in it."""
    return replace(diagnosis, estimation=None if gained is None else gained.to_json())
