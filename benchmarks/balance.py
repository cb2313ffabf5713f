"""Fit known causes to a recording with a measured external torque: a quick way for one-way sweeps.

A diagnosis finds *which* causes a measurement shows. If the causes are known, two balances of measured quantities give their
parameters and standard deviations in a second:

    torque from current minus friction and rotor  =  own gravity and inertia − external torque,
    torsion                                       =  wind-up under that torque + once-per-revolution error of the encoder.

Both hold at every instant, so any part of a recording can be held out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexspline.estimator import smoothed
from flexspline.estimator.estimator import KnownJoint
from flexspline.estimator.smoothed import Motion
from flexspline.models import causes
from flexspline.models.causes.base import CauseParameter
from flexspline.models.errors import InputError
from flexspline.models.joint import Joint
from flexspline.models.joint_parts import Effect, Estimate
from flexspline.models.recording import Recording

MOVING = 0.05
"""Output velocity [rad/s] above which samples count: friction at rest is anything up to its level."""
SENSOR_NOISE = 1.05
"""Noise of the external torque [N·m rms]: the flange sensor's vibration, correlated over `SENSOR_MEMORY`."""
SENSOR_MEMORY = 0.1
"""Correlation time of that vibration [s]: neighbouring samples do not count twice."""


@dataclass(frozen=True)
class EffectsFit:
    """Effects fitted to a recording.

    Attributes:
      effects: with standard deviations.
      before, after: RMS of the balance [N·m] over the samples used, without and with them.
      samples: number of samples used.
    """

    effects: tuple[Effect, ...]
    before: float
    after: float
    samples: int


def fit_current(
    recording: Recording, joint: Joint, names: tuple[str, ...], use: np.ndarray | None = None
) -> EffectsFit:
    """Fit causes to the balance of motor current and measured external torque.

    Args:
      recording: of one segment, with external torque.
      joint: without those causes.
      names: causes whose parameters are magnitudes (`models.causes`); each has a Gaussian prior about its absence with
        the largest ordinary size as deviation.
      use: which samples may be used, shape (n,), bool; all by default. Samples at rest are left out.

    Raises:
      InputError: a recording without external torque, or with gaps, or in which nothing moves.
    """
    parameters = [(name, q) for name in names for q in causes.get(name).parameters]
    bare = joint.record(recording.link)
    present = np.array([causes.get(name).present(bare[0])[q.name] for name, q in parameters])
    spread = np.array([_spread(q, bare) for _, q in parameters])
    time, external = recording.time, _external(recording)
    motion = _motion(recording, joint, bare)
    grid = motion.time
    moving = np.abs(motion.link_velocity) > MOVING
    chosen = moving if use is None else moving & (np.interp(grid, time, use.astype(float)) > 0.99)
    if chosen.sum() < 100:
        raise InputError(f"{recording.source or recording.name}: expected motion to fit to, got none")
    load = smoothed.torque_from_current(motion, KnownJoint.of(joint, recording.link, bare))
    # The balance, one number every grid step: of those within the vibration's memory, together one is news.
    sigma = SENSOR_NOISE * np.sqrt(SENSOR_MEMORY / smoothed.STEP)

    def balance(values: np.ndarray) -> np.ndarray:
        record = bare.copy()
        for name in names:
            mine = {q.name: v for (n, q), v in zip(parameters, values, strict=True) if n == name}
            causes.get(name).apply(record[0], mine)
        known = replace(KnownJoint.of(joint, recording.link, record), start=float(time[0]))
        torque = smoothed.torque_from_current(motion, known) - known.p["bl"] * motion.link_velocity
        return (torque - smoothed.own_torque(motion, known, load) + np.interp(grid, time, external))[chosen]

    values = present.copy()
    r = start = balance(values)
    for _ in range(8):
        step = 1e-3 * spread
        J = np.stack([(balance(values + d) - r) / s for d, s in zip(np.diag(step), step, strict=True)], axis=1)
        H = J.T @ J / sigma**2 + np.diag(1 / spread**2)
        change = -np.linalg.solve(H, J.T @ r / sigma**2 + (values - present) / spread**2)
        values = values + change
        r = balance(values)
        if np.all(np.abs(change) < 1e-4 * spread):
            break
    std = np.sqrt(np.diag(np.linalg.inv(H)))
    effects = tuple(
        Effect(
            name=name,
            parameters={
                q.name: Estimate(value=float(f"{v:.4g}"), unit=q.unit, std=float(f"{s:.2g}"))
                for (n, q), v, s in zip(parameters, values, std, strict=True)
                if n == name
            },
        )
        for name in names
    )
    return EffectsFit(effects, _rms(start), _rms(r), int(chosen.sum()))


def fit_eccentricity(recording: Recording, joint: Joint, use: np.ndarray | None = None) -> Effect:
    """Fit `link_encoder_eccentricity` to the torsion, given the joint torque that the external torque asks for.

    A once-per-revolution error and a stiffness that is off look alike in a sweep, as the load goes with the sine of the
    angle: the standard deviation of the amplitude is what the stiffness' tolerance makes of it.
    """
    record = joint.record(recording.link)
    known = replace(KnownJoint.of(joint, recording.link, record), start=float(recording.time[0]))
    motion = _motion(recording, joint, record)
    grid, v, theta_l = motion.time, motion.link_velocity, motion.link_position
    load = smoothed.torque_from_current(motion, known)
    torque = smoothed.own_torque(motion, known, load) - np.interp(grid, recording.time, _external(recording))
    moving = np.abs(v) > MOVING
    chosen = moving if use is None else moving & (np.interp(grid, recording.time, use.astype(float)) > 0.99)
    torsion = smoothed.torsion_of(motion, known, load)
    number = joint.numbers["K1"]
    tolerance = np.hypot(number.tolerance, joint.shared_tolerances.get(number.shared or "", 0.0))

    def amplitude(scale: float) -> complex:
        softer = record.copy()
        for name in ("K1", "K2", "K3"):
            softer[0][name] *= scale
        wound = smoothed.wound(torque, replace(known, record=softer))
        # reading = θl + A (sin(θl + φ) − sin φ): torsion is too small by that. Zero and delay (v) are free.
        A = np.stack([np.sin(theta_l), np.cos(theta_l), np.ones(len(grid)), v], axis=1)[chosen]
        prior = np.diag([1.5e-3, 1.5e-3, 5e-3, 0.3e-3])
        noise = 1.5e-4 * np.sqrt(SENSOR_MEMORY / smoothed.STEP)
        b = np.concatenate([(wound - torsion)[chosen] / noise, np.zeros(4)])
        sine, cosine, _, _ = np.linalg.lstsq(np.vstack([A / noise, np.linalg.inv(prior)]), b, rcond=None)[0]
        return complex(sine, cosine)

    z = amplitude(1.0)
    spread = 0.5 * abs(amplitude(1 + tolerance) - amplitude(1 - tolerance))
    values = {"amplitude": (abs(z), "rad", spread), "phase": (float(np.angle(z)), "rad", spread / abs(z))}
    return Effect(
        name="link_encoder_eccentricity",
        parameters={
            k: Estimate(value=float(f"{x:.4g}"), unit=u, std=float(f"{s:.2g}")) for k, (x, u, s) in values.items()
        },
    )


def extended(joint: Joint, effects: tuple[Effect, ...], name: str, description: str) -> Joint:
    """The joint with effects added, under another name."""
    return joint.model_copy(update={"name": name, "description": description, "effects": [*joint.effects, *effects]})


def _spread(q: CauseParameter, record: np.ndarray) -> float:
    size = max(abs(x - q.neutral) for interval in q.ordinary for x in interval)
    return size * (float(record[0][q.relative]) if q.relative else 1.0)


def _external(recording: Recording) -> np.ndarray:
    where = recording.source or recording.name
    if "external_torque" not in recording:
        raise InputError(f"{where}: expected the column 'external_torque', got none")
    if len(recording.segments) > 1:
        raise InputError(f"{where}: expected a recording without gaps")
    return recording["external_torque"]


def _motion(recording: Recording, joint: Joint, record: np.ndarray) -> Motion:
    known = replace(KnownJoint.of(joint, recording.link, record), start=float(recording.time[0]))
    signals = recording.signals
    return smoothed.smooth_motion(signals, known, smoothed.bandwidth(signals, known))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))
