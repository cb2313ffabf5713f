"""Estimators over a recording: part by part between its gaps, scored where there is a sensor to compare with.

No estimator reads the columns `joint_torque` and `external_torque`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...estimator.errors import FilterDiverged
from ...estimator.estimator import Estimator, KnownJoint, Posterior
from ...models.files import write_into_place
from ...models.joint import Joint
from ...models.recording import Recording
from ...models.tables import write_table

SHORTEST = 10
"""Samples that a part between gaps must have to be estimated."""
_MOVES = 2.5  # Stribeck velocities of the motor above which it is in motion


@dataclass(frozen=True)
class Recorded:
    """What estimators say of a recording; n samples.

    Attributes:
      name: of the recording. time: shape (n,) [s].
      known: what they knew of the joint.
      posteriors: by estimator; NaN in parts that are too short.
      missing: why there is none, by estimator: a channel that was not recorded, an estimate that diverged.
    """

    name: str
    time: np.ndarray
    known: KnownJoint
    posteriors: dict[str, Posterior]
    missing: dict[str, str]

    def torque(self, name: str) -> np.ndarray:
        """Joint torque by an estimator as the joint's torque sensor would read it [N·m], shape (n,)."""
        return self.known.as_read(self.posteriors[name].mean, self.time)


@dataclass(frozen=True)
class Score:
    """Error of an estimate against what was measured [N·m]: all samples, samples in motion, mean, largest.

    At rest friction is anything up to its level, hence the score in motion.
    """

    rms: float
    rms_moving: float
    mean: float
    max: float


def estimate_recording(recording: Recording, joint: Joint, estimators: Mapping[str, Estimator]) -> Recorded:
    """Run estimators over a recording of a joint, each scaled to the joint and the recording's sample interval.

    Args:
      recording: its `joint_torque` and `external_torque` are not read.
      joint: the description, with the effects that are known of it.
      estimators: by name.
    """
    known = KnownJoint.of(joint, recording.link)
    signals = recording.signals.without("joint_torque", "external_torque")
    posteriors, missing = {}, {}
    for name, given in estimators.items():
        lacking = [channel for channel in given.needs if channel not in signals]
        if lacking:
            missing[name] = f"expected the column {lacking[0]!r}, the recording has none"
            continue
        estimator = given.scaled(known, recording.interval)
        try:
            parts = [
                estimator.estimate(signals.part(part), known) if part.stop - part.start >= SHORTEST else None
                for part in recording.segments
            ]
        except FilterDiverged as error:
            missing[name] = str(error)
            continue
        posteriors[name] = _joined(name, recording, parts)
    return Recorded(recording.name, recording.time, known, posteriors, missing)


def _joined(name: str, recording: Recording, parts: Sequence[Posterior | None]) -> Posterior:
    """Posteriors of a recording's parts as one: NaN where there is none, and without columns that some of them lack."""
    found = [part for part in parts if part is not None]
    if len(found) == len(parts) == 1:
        return replace(found[0], time=recording.time)

    def whole(values: Sequence[np.ndarray | None]) -> np.ndarray | None:
        """Arrays of the parts, in their places; None where one of them has none."""
        if not values or any(v is None for v in values):
            return None
        first = np.asarray(values[0])
        empty = False if first.dtype == bool else np.nan
        joined = np.full((len(recording.time), *first.shape[1:]), empty, dtype=first.dtype)
        given = iter(values)
        for part, segment in zip(parts, recording.segments, strict=True):
            if part is not None:
                joined[segment] = next(given)
        return joined

    columns = {c: whole([part.columns.get(c) for part in found]) for c in (found[0].columns if found else ())}
    mean = whole([part.mean for part in found])
    return Posterior(
        name,
        recording.time,
        np.full(len(recording.time), np.nan) if mean is None else mean,
        whole([part.variance for part in found]),
        whole([part.innovation for part in found]),
        whole([part.innovation_covariance for part in found]),
        whole([part.robust for part in found]),
        {c: values for c, values in columns.items() if values is not None},
        whole([part.external for part in found]),
    )


def score(recording: Recording, found: Recorded, joint: Joint) -> dict[str, dict[str, Score]]:
    """Score estimates where there is something to compare with.

    Returns:
      `joint_torque` (with a sensor) and `external_torque` (where it was measured, or known to be zero): estimator → score.
    """
    n = len(recording.time)
    ratio = joint.numbers["N"].value
    motor = recording["motor_position"] if "motor_position" in recording else ratio * recording["link_position"]
    moving = np.abs(np.gradient(motor, recording.time)) > _MOVES * joint.numbers["vs"].value
    scores: dict[str, dict[str, Score]] = {}
    if "joint_torque" in recording:
        reading = recording["joint_torque"]
        scores["joint_torque"] = {name: _score(found.torque(name) - reading, moving) for name in found.posteriors}
    if recording.external in ("measured", "none"):
        truth = recording["external_torque"] if recording.external == "measured" else np.zeros(n)
        having = {name: p.external for name, p in found.posteriors.items() if p.external is not None}
        if having:
            scores["external_torque"] = {name: _score(values - truth, moving) for name, values in having.items()}
    return scores


def _score(error: np.ndarray, moving: np.ndarray) -> Score:
    good = np.isfinite(error)
    if not good.any():
        return Score(*4 * [float("nan")])
    inside = error[good & moving] if np.any(good & moving) else error[good]
    error = error[good]
    return Score(
        rms=float(np.sqrt(np.mean(error**2))),
        rms_moving=float(np.sqrt(np.mean(inside**2))),
        mean=float(np.mean(error)),
        max=float(np.max(np.abs(error))),
    )


def write_recorded(found: Recorded, folder: Path) -> Path:
    """Write estimates as `<recording>.parquet`, units in the columns' metadata; return its path.

    Columns: `time`; for each estimator `torque_…` as the sensor would read it, `variance_…` and `external_torque_…` where it
    states them.
    """
    columns, units = {"time": found.time}, {"time": "s"}
    for name, posterior in found.posteriors.items():
        stated = {"torque": found.torque(name), "variance": posterior.variance, "external_torque": posterior.external}
        for quantity, values in stated.items():
            if values is not None:
                columns[f"{quantity}_{name}"] = values
                units[f"{quantity}_{name}"] = "(N·m)²" if quantity == "variance" else "N·m"
    path = folder / f"{found.name}.parquet"
    with write_into_place(path) as temporary:
        write_table(temporary, columns, units)
    return path
