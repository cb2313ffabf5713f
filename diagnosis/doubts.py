"""Doubts about a description or a sensor: what no joint within tolerance explains, and no mistake of a column."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from ..estimator import smoothed
from ..estimator.conditioning import Conditioned
from ..estimator.estimator import KnownJoint
from ..models.calibration import CUT
from ..models.joint import Joint
from ..models.motion import CUTOFF
from ..models.recording import Measurement, Recording
from ..models.signals import POSITIONS
from .data.coverage import AGREED, TORSION_RATE, noisy_sensors, torque_over_current
from .data.plausibility import SETTINGS, smallest_step
from .data.segments import DECIMATION
from .data.segments import SETTINGS as SEGMENTS
from .data.stretches import most_telling
from .regression import (
    CLUSTER,
    LEAST,
    LONGEST,
    contradictions,
    contradictions_of_drive,
    covariance,
    least_squares,
    regressions,
)  # fmt: skip


def doubts(
    measurement: Measurement, joint: Joint, conditioned: Sequence[Conditioned] | None = None, lost: Collection[str] = ()
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what a measurement contradicts of the described load, and all other doubts with their place, as sentences.

    The regressions have the passband of the search for mistakes: noise of an acceleration beyond it biases inertias.

    Args:
      measurement, joint, conditioned: as of `regressions`.
      lost: columns with a mistake.
    """
    every = [r for r in regressions(measurement, joint, conditioned, SETTINGS.cutoff) if r.channel not in lost]
    others = [f"{measurement.name}: {text}" for text in contradictions_of_drive(every, joint)]
    for recording in most_telling(measurement, LONGEST).recordings:
        texts = [*noisy_sensors(recording, joint)]
        if "joint_torque" not in lost:
            texts += _stiffness(recording, joint)
        ratio = torque_over_current(recording, joint)
        if ratio is not None:
            texts.append(
                f"motor_torque is {ratio:.3g} times motor_current times the drive's torque constant: one of them is wrong"
            )
        others += [f"{recording.name}: {text}" for text in texts]
    return contradictions(every, joint), tuple(others)


def _stiffness(recording: Recording, joint: Joint) -> Iterator[str]:
    """Yield in words that torsion and torque sensor contradict the described stiffness beyond any joint within tolerance.

    The torsion between both encoders is the flexspline's, which the sensor's torque winds up, and the wave generator's. Both are
    in proportion to the described ones.
    """
    known = KnownJoint.of(joint, recording.link)
    signals = smoothed.in_amperes(recording.signals, known)
    if not {*POSITIONS, "motor_current", "joint_torque"} <= set(signals) or recording.interval * TORSION_RATE > 1.0:
        return
    rigid = known.with_numbers(Kw0=np.inf)
    parts = [np.zeros((5, 0))]
    for part in map(signals.part, recording.segments):
        if len(part.time) >= SEGMENTS.shortest[0]:
            motion = smoothed.smooth_motion(part, known, CUTOFF, DECIMATION)
            torque = np.interp(motion.time, part.time, part["joint_torque"])
            torsion = smoothed.torsion_of(motion, rigid, torque)
            generator = torsion - smoothed.torsion_of(motion, known, torque)
            parts.append(
                np.stack([smoothed.wound(torque, known), generator, np.ones_like(torque), torsion, motion.time])
            )
    *shapes, torsion, time = np.concatenate(parts, axis=1)
    X = np.column_stack(shapes)
    if not len(time) or np.std(recording["joint_torque"]) < LEAST * known.rated_torque:
        return
    found, spread = least_squares(X, torsion), CUT * known.spread.stiffness
    std = math.sqrt(covariance(X, torsion - X @ found, np.floor(time / CLUSTER))[0, 0])
    # Counts of an encoder at rest do not average out.
    steps = [smallest_step(recording[name]) / ratio for name, ratio in zip(POSITIONS, (known.p["N"], 1.0), strict=True)]
    counts = math.hypot(*steps) / math.sqrt(12)
    off = CUT * math.hypot(std, counts / float(np.std(X[:, 0])))
    near = float(np.clip(1.0, found[0] - off, found[0] + off))
    if near <= 0.0 or abs(1.0 / near - 1.0) > max(AGREED, spread):
        yield (
            f"the torsion is {found[0]:.3g} times that of joint_torque and the described stiffness: is an encoder late or "
            "eccentric, or are joint and sensor not as described?"
        )
