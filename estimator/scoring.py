"""Errors of estimates over a recording against what was measured, and which of them are no estimates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..models.joint import Joint
from ..models.recording import Recording
from .offline import MOVING, Estimates

_USELESS = 0.5  # error as a share of a torque's own RMS from which an estimate is none
_LEAST = 0.1  # share of the rated torque: of a smaller joint torque, half is no large error of an external torque


@dataclass(frozen=True)
class Score:
    """Error of an estimate against the measurement [N·m]: all samples, samples in motion (NaN if there are none),
    mean, largest."""

    rms: float
    rms_moving: float
    mean: float
    max: float

    @classmethod
    def of(cls, error: np.ndarray, moving: np.ndarray) -> Score:
        """Summarise an error, shape (n,), NaN without an estimate."""
        good = np.isfinite(error)
        if not good.any():
            return cls(*[float("nan")] * 4)
        inside, error = error[good & moving], error[good]
        return cls(
            rms=_rms(error),
            rms_moving=_rms(inside) if len(inside) else float("nan"),
            mean=float(np.mean(error)),
            max=float(np.max(np.abs(error))),
        )


Scores = Mapping[str, Mapping[str, Score]]  # by measured quantity and estimator


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def score(recording: Recording, estimates: Estimates, joint: Joint) -> dict[str, dict[str, Score]]:
    """Score estimates, by estimator, against `joint_torque` (with a sensor) and `external_torque` (if measured, or
    known to be zero). Friction at rest is unknown up to its level, hence the score in motion (motor faster than 2.5
    Stribeck velocities)."""
    N = joint.numbers["N"].value
    motor = recording["motor_position"] if "motor_position" in recording else N * recording["link_position"]
    moving = np.abs(np.gradient(motor, recording.time)) > MOVING * joint.numbers["vs"].value
    truths: dict[str, tuple[np.ndarray, Mapping[str, np.ndarray]]] = {}
    if "joint_torque" in recording:
        truths["joint_torque"] = (recording["joint_torque"], estimates.torque)
    if recording.external == "measured":
        truths["external_torque"] = (recording["external_torque"], estimates.external_torque)
    elif recording.external == "none":
        truths["external_torque"] = (np.zeros(len(recording.time)), estimates.external_torque)
    return {
        what: {name: Score.of(values - truth, moving) for name, values in found.items()}
        for what, (truth, found) in truths.items()
    }


def no_estimates(
    recording: Recording, estimates: Estimates, joint: Joint, scores: Scores
) -> dict[str, tuple[str, dict[str, float]]]:
    """Return by quantity a sentence with a torque's own RMS, and the RMS errors [N·m] of estimators for which they are
    more than half of it: that of the measured one, or, where no external torque is, of the joint torque or 10 % of the
    rated torque."""
    found = {}
    for what, by_name in scores.items():
        if what == "joint_torque" or recording.external == "measured":
            own = least = _rms(recording[what])
            text = f"{what.replace('_', ' ')} is {own:.3g} N·m (RMS)"
        elif estimates.torque:
            torques = [recording["joint_torque"]] if "joint_torque" in recording else list(estimates.torque.values())
            own = float(np.median([np.sqrt(np.nanmean(np.square(torque))) for torque in torques]))
            least = max(own, _LEAST * joint.numbers["rated_torque"].value)
            text = f"there was no external torque, and the joint torque is {own:.3g} N·m (RMS)"
        else:
            continue
        worse = {name: s.rms for name, s in by_name.items() if s.rms > _USELESS * least}
        if worse:
            found[what] = text, worse
    return found
