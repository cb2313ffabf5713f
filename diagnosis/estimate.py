"""Joint torque and external torque of a recording, by every estimator: without a torque sensor, offline.

    torque_model      the compliance model, Eq. (7), on the encoders, with the joint's effects taken into account
    torque_EKF, …     the paper's filters on that
    torque_current    motor current less friction and the rotor's inertia
    torque_payload    an observer of a rigid payload, from the current; blind to contact
    torque_payload_smoothed   the same with the payload that the whole stretch shows

and for each the external torque on the link: `Jl θl'' + gravity and other known link torques − joint torque`.

**Zero.** Where both encoders' zeros are not known against each other, the compliance model has an offset of stiffness
times that. A joint states how well it is known (`sensors.link_encoder.zero`: `std`, or else `deviation`); the motor
current knows it up to the friction's uncertainty over the stiffness. Both are combined by their variances; where the
joint has a link encoder eccentricity with a standard deviation, the zero may wander with the link angle by that much
(`track_zero`).

No estimator reads the columns `joint_torque` and `external_torque`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from numba import njit

from ..estimator import FilterSettings, measurement_variance, run
from ..models import laws
from ..models.files import write_into_place
from ..models.joint import Joint
from ..models.parameters import PLACES
from ..sim.recording import Recording
from .motion import smooth

STEP = 1e-3
"""Grid [s] on which motion is differentiated and friction replayed."""
BANDWIDTHS = (80.0, 40.0, 20.0, 10.0, 5.0)
"""Bandwidths [Hz] of the estimate from current, best first; see `bandwidth`."""
QUIET = 0.005
"""Noise that the estimate from current may have, as a share of the rated torque: it decides about the bandwidth."""
NOISE = 0.003
"""The least noise that an estimate of torque is credited with, as a share of the rated torque."""
WALKS = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0)
"""Factors of the filters' W among which the likelihood of the EKF's innovations chooses."""
_DECIMATION = 4  # grid steps per sample of the payload observer
_TRACK = 20  # grid steps per sample of the zero's tracking
_MEMORY = 0.5  # s: correlation time of what friction does beyond its model
_FRICTION_ERROR = 0.05  # the least that a friction model is wrong, as a share of the friction
_ITERATIONS = 10
_AT_REST = 4.0  # at rest, friction is anything up to its level: noise in units of the level
_SLOW = 4.0  # how far from rest that reaches, in Stribeck velocities
_ROBUST = 1.4826

_ROTOR, _MESH, _FLEXSPLINE, _LINK, _LINK_POSITION, _CURRENT = (
    PLACES.index(name) for name in ("rotor", "mesh", "flexspline", "link", "link_position", "motor_current")
)


@dataclass(frozen=True)
class Estimates:
    """Estimates over one recording; arrays of shape (n,), N·m.

    Attributes:
      name: of the recording.
      time: [s].
      torque: joint torque by estimator, as the force/torque sensor would read it.
      external_torque: torque on the link that its own gravity and inertia do not explain, by estimator.
      notes: what was found on the way, one entry a stretch: bandwidth [Hz], zero [rad] with its standard deviation, the
        payload's moments [N·m] and inertia [kg·m²].
    """

    name: str
    time: np.ndarray
    torque: dict[str, np.ndarray]
    external_torque: dict[str, np.ndarray]
    notes: list[dict[str, float]] = field(default_factory=list)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns as written to the table."""
        columns = {"time": self.time}
        columns.update({f"torque_{name}": values for name, values in self.torque.items()})
        columns.update({f"external_torque_{name}": values for name, values in self.external_torque.items()})
        return columns


def estimate(recording: Recording, joint: Joint) -> Estimates:
    """Run every estimator over a recording of a joint.

    Args:
      recording: its `joint_torque` and `external_torque` are not read.
      joint: the description, with the effects that are known of it.
    """
    blind = replace(recording, joint_torque=None, external_torque=None, external="none")
    record = joint.record(blind.link)
    torque: dict[str, list[np.ndarray]] = {}
    external: dict[str, list[np.ndarray]] = {}
    notes = []
    for stretch in blind.stretches:
        if stretch.stop - stretch.start < 10:
            shape = np.full(stretch.stop - stretch.start, np.nan)
            found = {name: (shape, shape) for name in ESTIMATORS}
        else:
            found, note = _stretch(blind, stretch, joint, record)
            notes.append(note)
        for name, (joint_torque, external_torque) in found.items():
            torque.setdefault(name, []).append(joint_torque)
            external.setdefault(name, []).append(external_torque)
    return Estimates(
        blind.name,
        blind.time,
        {name: np.concatenate(parts) for name, parts in torque.items()},
        {name: np.concatenate(parts) for name, parts in external.items()},
        notes,
    )


ESTIMATORS = ("model", "EKF", "AREKF", "RAREKF", "current", "payload", "payload_smoothed")
"""Names of the estimators."""


@dataclass(frozen=True)
class Score:
    """Error of one estimate against what was measured [N·m]: all samples, samples in motion, mean, largest."""

    rms: float
    rms_moving: float
    mean: float
    max: float


def score(recording: Recording, estimates: Estimates, joint: Joint) -> dict[str, dict[str, Score]]:
    """Score estimates where there is something to compare with.

    Returns:
      `joint_torque` (with a sensor) and `external_torque` (where it was measured, or known to be zero): estimator →
      score. Friction at rest is anything up to its level, hence the score in motion (motor faster than 2.5 Stribeck
      velocities).
    """
    speed = np.abs(np.gradient(recording.motor_position, recording.time))
    moving = speed > 2.5 * joint.numbers["vs"].value
    truths: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]] = {}
    if recording.joint_torque is not None:
        truths["joint_torque"] = (recording.joint_torque, estimates.torque)
    if recording.external == "measured":
        truths["external_torque"] = (recording.external_torque, estimates.external_torque)
    elif recording.external == "none":
        truths["external_torque"] = (np.zeros(len(recording.time)), estimates.external_torque)
    return {
        what: {name: _score(values - truth, moving) for name, values in found.items()}
        for what, (truth, found) in truths.items()
    }


def _score(error: np.ndarray, moving: np.ndarray) -> Score:
    good = np.isfinite(error)
    inside = error[good & moving] if np.any(good & moving) else error[good]
    error = error[good]
    return Score(
        rms=float(np.sqrt(np.mean(error**2))),
        rms_moving=float(np.sqrt(np.mean(inside**2))),
        mean=float(np.mean(error)),
        max=float(np.max(np.abs(error))),
    )


def write_estimates(estimates: Estimates, folder: Path) -> Path:
    """Write estimates as `<recording>.parquet`, units in the columns' metadata; return its path."""
    columns = estimates.columns
    fields = [pa.field(name, pa.float64(), metadata={"unit": "s" if name == "time" else "N·m"}) for name in columns]
    path = folder / f"{estimates.name}.parquet"
    with write_into_place(path) as temporary:
        pa.parquet.write_table(
            pa.table(list(columns.values()), schema=pa.schema(fields)), temporary, compression="zstd"
        )
    return path


def _stretch(recording: Recording, stretch: slice, joint: Joint, record: np.ndarray):
    """Estimates over one stretch: name → joint torque and external torque, at the samples; and the notes."""
    record = record.copy()
    p = record[0]
    time = recording.time[stretch]
    since = time - recording.time[0]
    readings = [getattr(recording, c)[stretch] for c in ("motor_position", "link_position", "motor_current")]
    motor, link_read, current_read = readings
    link = _link_position(time, since, motor, link_read, p)
    current = current_read - p["current_offset"]

    cutoff = bandwidth(time, motor, current, record, QUIET * joint.numbers["rated_torque"].value)
    motion = _motion(time, since, motor, link, current, record, cutoff)
    grid, theta_m, w, w_dot, theta_l, v, a, smooth_current, _ = motion
    since_grid = grid - recording.time[0]

    def at_samples(x: np.ndarray) -> np.ndarray:
        return np.interp(time, grid, x)

    # From current: the payload first, as it shows how much of the load-dependent friction acts when the load drives.
    own = np.empty(len(grid))
    _own_torque(record, since_grid, theta_m, theta_l, w, v, a, motion[-1], own)
    observed, smoothed, payload = _payload(joint, record, motion, since_grid, current, time, own)
    p["back_driven_friction"] = payload["back_driven_friction"]
    from_current = np.empty(len(grid))
    _torque_from_current(record, since_grid[0], STEP, theta_m, w, w_dot, theta_l, smooth_current, from_current)

    # Compliance model: torsion on the samples, zero, torque.
    wide = smooth(time, np.column_stack([motor, link, current]), STEP)
    zero, zero_std = _zero(joint, record, wide, from_current, w, v)
    link_zeroed = link - at_samples(zero)
    model, damping = np.empty(len(time)), np.empty(len(time))
    rates = [np.interp(time, wide.time, wide.rate[:, i]) for i in (0, 1)]
    smooth_torsion = _smooth_torsion(record, wide, np.interp(wide.time, grid, zero))
    dahl = np.interp(time, wide.time, _dahl(record, smooth_torsion))
    torsion_rate = np.interp(time, wide.time, np.gradient(smooth_torsion, STEP))
    _model(record, since, motor, link_zeroed, current, dahl, torsion_rate, *rates, model, damping)

    found: dict[str, np.ndarray] = {"model": model}
    measured = model + damping
    for name, settings in filter_settings(joint, record, float(np.median(np.diff(time))), measured).items():
        found[name] = run(settings, measured, time=time).torque
    found["current"] = at_samples(from_current - p["bl"] * v)
    found["payload"], found["payload_smoothed"] = at_samples(own - observed), at_samples(own - smoothed)

    own_samples = at_samples(own)
    sensed = {
        name: (p["torque_gain"] * x + p["torque_offset"] + p["torque_rate"] * since, own_samples - x)
        for name, x in found.items()
    }
    note = {
        "start": float(time[0]),
        "bandwidth": cutoff,
        "zero": float(np.mean(zero)),
        "zero_std": zero_std,
        **{key: float(value) for key, value in payload.items()},
    }
    return sensed, note


def filter_settings(
    joint: Joint, record: np.ndarray, interval: float, measured: np.ndarray | None = None
) -> dict[str, FilterSettings]:
    """The paper's filters for a joint sampled every `interval` [s]; the defaults of `estimator.settings`, scaled.

    V is what the joint's sensors leave; the load from which RAREKF doubts itself and the random walk W scale with the
    rated torque, W with the time between samples. Where there are measurements [N·m], the size of the walk (one of
    `WALKS`) is the one that makes the EKF's innovations most likely: how fast the load changes is a property of the
    motion, not of the joint.
    """
    p, s = record[0], joint.sensors
    V = measurement_variance(
        float(p["K2"]), s.motor_encoder.resolution, s.link_encoder.resolution, s.link_encoder.noise,
        s.motor_encoder.noise, ratio=float(p["N"]), torque_noise=float(p["Kt"]) * s.motor_current.noise,
        wave_generator_stiffness=float(p["Kw0"]),
    )  # fmt: skip
    rated = joint.numbers["rated_torque"].value
    W = (0.01 * rated / 16.0) ** 2 * interval / 1e-3

    def settings(rule: str, walk: float) -> FilterSettings:
        return FilterSettings(rule=rule, name=rule.upper(), V=V, P0=V, W=W * walk, k=(4.0 / rated) ** 2)

    walk = 1.0
    if measured is not None:
        walk = min(WALKS, key=lambda walk: _surprise(run(settings("ekf", walk), measured)))
    return {rule.upper(): settings(rule, walk) for rule in ("ekf", "arekf", "rarekf")}


def _surprise(history) -> float:
    """Minus twice the log likelihood of a filter's innovations, robust: no outlier counts more than 5 deviations."""
    S = history.innovation_covariance[1:, 0, 0]
    return float(np.sum(np.log(S) + np.minimum(history.innovation[1:, 0] ** 2 / S, 25.0)))


# --- motion and torque from current ---------------------------------------------------------------------------------


def _link_position(time, since, motor, reading, p) -> np.ndarray:
    """Link angle [rad] from its reading, without delay and eccentricity; the zero stays in."""
    if p["link_delay"] > 0:
        reading = np.interp(time + p["link_delay"], time, reading)
    rough = reading - p["link_zero"]
    out = np.empty(len(time))
    _without_eccentricity(reading, rough, motor, since, p, out)
    return out


@njit(cache=True)
def _without_eccentricity(reading, rough, motor, since, p, out):
    for i in range(len(reading)):
        out[i] = reading[i] - (laws.link_reading(rough[i], p) - rough[i] - p.link_zero)
        out[i] -= laws.term(_LINK_POSITION, motor[i], rough[i], 0.0, 0.0, since[i], p)


def bandwidth(time, motor, current, record, wanted: float) -> float:
    """The highest of `BANDWIDTHS` [Hz] at which the torque from current has no more noise than `wanted` [N·m].

    Noise of the motor's angle (counts, and jitter of the time stamps times speed) enters through the rotor's
    acceleration, noise of the current directly. Both are taken from the readings, as white.
    """
    p = record[0]
    angle, amperes = white_noise(time, motor), white_noise(time, current)
    interval = float(np.median(np.diff(time)))
    for cutoff in BANDWIDTHS:
        inertia = (p["Jm"] + p["Jw"]) * (2 * np.pi * cutoff) ** 2 * angle
        share = min(1.0, 2 * cutoff * interval)  # of the readings' noise, in power, that passes
        if p["N"] * np.hypot(inertia, p["Kt"] * amperes) * np.sqrt(share) <= wanted:
            return cutoff
    return BANDWIDTHS[-1]


def white_noise(time: np.ndarray, values: np.ndarray) -> float:
    """Standard deviation of white noise on a smooth signal, from third divided differences; robust."""
    t = np.stack([time[i : len(time) - 3 + i] for i in range(4)])
    t = t - t[0]
    scale = t[-1].copy()
    weight = np.array([1 / np.prod([(t[i] - t[j]) / scale for j in range(4) if j != i], axis=0) for i in range(4)])
    y = np.stack([values[i : len(values) - 3 + i] for i in range(4)])
    difference = np.sum(weight * y, axis=0) / np.sqrt(np.sum(weight**2, axis=0))
    return float(_ROBUST * np.median(np.abs(difference)))


def _motion(time, since, motor, link, current, record, cutoff):
    """Grid, θm, θm', θm'', θl, θl', θl'', current, all smoothed alike, and the joint torque Tf from current."""
    s = smooth(time, np.column_stack([motor, link, current]), STEP, cutoff)
    Tf = np.empty(len(s.time))
    start = s.time[0] - time[0] + since[0]
    theta_m, w, w_dot = s.value[:, 0], s.rate[:, 0], s.acceleration[:, 0]
    theta_l, v, a = s.value[:, 1] - record[0]["link_zero"], s.rate[:, 1], s.acceleration[:, 1]
    _torque_from_current(record, start, STEP, theta_m, w, w_dot, theta_l, s.value[:, 2], Tf)
    return s.time, theta_m, w, w_dot, theta_l, v, a, s.value[:, 2], Tf


@njit(cache=True)
def _drive_torque(i, start, h, theta_m, w, w_dot, theta_l, current, load, p):
    """Torque that reaches the mesh [N·m, motor side]: Kt i and cogging, less what turns rotor and wave generator."""
    reading = current[i] - laws.term(_CURRENT, theta_m[i], theta_l[i], w[i], load, start + i * h, p)
    torque = p.Kt * reading + laws.rotor_torque(theta_m[i], p) - (p.Jm + p.Jw) * w_dot[i] - (p.bm + p.bw) * w[i]
    if laws.has_terms(p):
        torque += laws.term(_ROTOR, theta_m[i], theta_l[i], w[i], load, start + i * h, p)
        torque -= laws.term(_MESH, theta_m[i], theta_l[i], w[i], load, start + i * h, p)
    return torque


@njit(cache=True)
def _torque_from_current(record, start, h, theta_m, w, w_dot, theta_l, current, out):
    """Tf [N·m] from the wave generator's balance; the LuGre bristle follows the motor's measured velocity."""
    p = record[0]
    z = 0.0
    T = 0.0
    for i in range(len(w)):
        slope = 1.0 / p.N - laws.kinematic_error_slope(theta_m[i], p)
        step = z
        for _ in range(5):  # friction depends on the load, weakly
            g = laws.friction_level(w[i], theta_l[i], T, start + i * h, p)
            if i == 0:  # has been turning like this for long, or rests without friction
                step = g / p.s0 * _sign(w[i])
            else:
                step = laws.bristle_step(z, w[i], g, h, p)
            drive = _drive_torque(i, start, h, theta_m, w, w_dot, theta_l, current, T, p)
            T = (drive - laws.mesh_friction(step, w[i], g, p)) / slope
        z = step
        out[i] = T


@njit(cache=True)
def _sign(w):
    """Sign of a velocity, smooth over 1 rad/s on the motor side."""
    return np.tanh(w)


@njit(cache=True)
def _own_torque(record, since, theta_m, theta_l, w, v, a, load, out):
    """Joint torque [N·m] that the link's own inertia, gravity and known link torques ask for."""
    p = record[0]
    for i in range(len(out)):
        other = laws.link_torque(theta_l[i], p)
        if laws.has_terms(p):
            other += laws.term(_LINK, theta_m[i], theta_l[i], w[i], load[i], since[i], p)
        out[i] = p.Jl * a[i] - laws.gravity_torque(theta_l[i], p) - other


# --- compliance model -----------------------------------------------------------------------------------------------


@njit(cache=True)
def _torsion(record, motor, link, current, out):
    """Δθf [rad] of Eqs. (1), (5), (6) from readings, the zero of the record taken off."""
    p = record[0]
    for i in range(len(out)):
        Tw = p.Kt * current[i] + laws.rotor_torque(motor[i], p)
        delta = laws.wave_generator_torsion(Tw, p)
        out[i] = motor[i] / p.N - (link[i] - p.link_zero) - delta / p.N - laws.kinematic_error(motor[i] - delta, p)


def _smooth_torsion(record, wide, zero) -> np.ndarray:
    out = np.empty(len(wide.time))
    _torsion(record, wide.value[:, 0], wide.value[:, 1] - zero, wide.value[:, 2], out)
    return out


def _dahl(record, torsion) -> np.ndarray:
    out = np.zeros(len(torsion))
    if record[0]["hysteresis_torque"] != 0:
        _replay_dahl(record, np.ascontiguousarray(torsion), out)
    return out


@njit(cache=True)
def _replay_dahl(record, torsion, out):
    p = record[0]
    z = 0.0
    for i in range(1, len(out)):
        z = laws.dahl_step(z, torsion[i] - torsion[i - 1], 1.0, p)
        out[i] = z


@njit(cache=True)
def _model(record, since, motor, link, current, dahl, torsion_rate, w, v, model, damping):
    """Torque of the compliance model with hysteresis and terms, and what damping adds to it; shape (n,)."""
    p = record[0]
    torsion = np.empty(len(model))
    _torsion(record, motor, link, current, torsion)
    for i in range(len(model)):
        T = laws.flexspline_spring(torsion[i], p) + laws.hysteresis_torque(dahl[i], p)
        if laws.has_terms(p):
            T += laws.term(_FLEXSPLINE, motor[i], link[i] - p.link_zero, w[i], T, since[i], p)
        model[i] = T
        damping[i] = p.df * torsion_rate[i] - p.bl * v[i]


def _friction_error(joint: Joint, p) -> float:
    """Standard deviation [N·m, output side] of the friction model: tolerance, or what diagnosis found."""
    number = joint.numbers["Fc"]
    if number.std is not None:
        relative = number.std / number.value
    else:
        relative = np.hypot(number.tolerance, joint.shared_tolerances.get(number.shared, 0.0) if number.shared else 0.0)
    return float(max(relative, _FRICTION_ERROR) * p["N"] * p["Fc"])


def _slow_friction(p, w: np.ndarray) -> np.ndarray:
    """Standard deviation [N·m, output side] of friction near rest from its model: presliding, Stribeck."""
    return _AT_REST * p["N"] * p["Fc"] * np.exp(-np.abs(w) / (_SLOW * p["vs"]))


def _zero(joint: Joint, record, wide, from_current, w, v) -> tuple[np.ndarray, float]:
    """What the torsion's zero is off from the joint's, on the grid [rad], and its mean standard deviation."""
    p = record[0]
    number = joint.sensors.link_encoder.zero
    spread = 0.0 if number is None else (number.std if number.std is not None else number.deviation)
    wander = 0.0
    for effect in joint.effects:
        if effect.name == "link_encoder_eccentricity":
            wander = effect.parameters["amplitude"].std or 0.0
    if spread == 0 and wander == 0:
        return np.zeros(len(from_current)), 0.0
    torsion = _smooth_torsion(record, wide, np.zeros(len(wide.time)))
    n = min(len(torsion), len(from_current))
    wound = np.empty(n)
    _wind(record, from_current[:n], wound)
    # link_zeroed = link − zero, torsion grows by it: a reading that is too high by δ makes torsion too small by δ.
    seen = wound - torsion[:n]
    slope = 1.0 / np.where(
        np.abs(from_current[:n]) < p["T1"], p["K1"], np.where(np.abs(from_current[:n]) < p["T2"], p["K2"], p["K3"])
    )
    slow = _slow_friction(p, w)
    k = np.arange(0, n, _TRACK)
    z, s = track_zero(
        seen[k], slope[k], np.sign(w[k]), slow[k], np.abs(v[k]) * STEP * _TRACK, spread, wander,
        _friction_error(joint, p), max(0.1 * _friction_error(joint, p), NOISE * joint.numbers["rated_torque"].value),
    )  # fmt: skip
    return np.interp(np.arange(len(from_current)), k, z), float(np.mean(s))


@njit(cache=True)
def _wind(record, torque, out):
    p = record[0]
    for i in range(len(out)):
        out[i] = laws.flexspline_torsion(torque[i], p)


def track_zero(seen, compliance, direction, slow, travel, spread, wander, friction, noise):
    """Kalman smoother of the zero δ [rad] and the friction model's error r [N·m], every `_TRACK` grid steps.

        seen = δ + compliance · direction · r + noise
        δ walks by `wander` rad per √rad of travel, r forgets in `_MEMORY`

    Args:
      seen: measured, shape (n,) [rad]; compliance [rad/(N·m)], direction of motion, slow: further noise near rest
        [N·m],
        travel since the last [rad]: shape (n,).
      spread: prior standard deviation of δ [rad]; wander [rad/√rad]; friction: of r [N·m]; noise [N·m].

    Returns:
      δ and its standard deviation, shape (n,).
    """
    n = len(seen)
    forget = np.exp(-STEP * _TRACK / _MEMORY)
    x, P = np.zeros(2), np.diag([spread**2, friction**2])
    xs, Ps, xp, Pp = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty((n, 2)), np.empty((n, 2, 2))
    F = np.diag([1.0, forget])
    for k in range(n):
        if k:
            x = F @ x
            P = F @ P @ F + np.diag([wander**2 * travel[k], friction**2 * (1 - forget**2)])
        xp[k], Pp[k] = x, P
        H = np.array([1.0, compliance[k] * direction[k]])
        R = (compliance[k] * np.hypot(noise, slow[k])) ** 2
        gain = P @ H / (H @ P @ H + R)
        x = x + gain * (seen[k] - H @ x)
        P = P - np.outer(gain, H @ P)
        xs[k], Ps[k] = x, P
    for k in range(n - 2, -1, -1):
        G = Ps[k] @ F @ np.linalg.pinv(Pp[k + 1])
        xs[k] += G @ (xs[k + 1] - xp[k + 1])
        Ps[k] += G @ (Ps[k + 1] - Pp[k + 1]) @ G.T
    return xs[:, 0], np.sqrt(np.maximum(Ps[:, 0, 0], 0.0))


# --- payload observer -----------------------------------------------------------------------------------------------

PAYLOAD = 0.7
"""Prior standard deviation of a payload's moments, in rated torques; its inertia's as if all of it were 1 m away."""


def _payload(joint, record, motion, since, current, time, own):
    """External torque of a rigid payload on the grid, as it becomes known and as known in the end; the payload."""
    p = record[0]
    grid, theta_m, w, w_dot, theta_l, v, a, _, _ = motion
    rated = joint.numbers["rated_torque"].value
    s = smooth(time, current[:, None], STEP)
    n = min(len(s.time), len(grid))
    k = np.arange(0, n, _DECIMATION)
    noise = max(1.2 * p["N"] * p["Kt"] * joint.sensors.motor_current.noise, 3 * NOISE * rated)
    moment = PAYLOAD * rated
    back_driven = joint.numbers.get("back_driven_friction")
    spread = 0.0 if back_driven is None else (back_driven.std if back_driven.std is not None else back_driven.deviation)
    kappa = [float(p["back_driven_friction"]), spread]
    prior = np.array([[0, moment], [0, moment], [0, moment / 9.81], kappa, [0, _friction_error(joint, p)]])
    out = np.empty((len(k), 6))
    arguments = (
        record, since[k], theta_m[k], theta_l[k], w[k], w_dot[k], v[k], a[k], s.value[k, 0], own[k],
        prior, noise, _slow_friction(p, w[k]), np.exp(-STEP * _DECIMATION / _MEMORY),
    )  # fmt: skip
    _observe(*arguments, np.empty(0), out)
    observed = np.interp(np.arange(len(grid)), k, out[:, 5])
    # The last state knows all of the stretch. Again, linearised about it: Gauss-Newton for the most probable payload.
    for _ in range(_ITERATIONS):
        reference = out[-1, :4].copy()
        _observe(*arguments, reference, out)
        if np.allclose(out[-1, :4], reference, rtol=1e-3, atol=1e-3):
            break
    alpha, beta, inertia = out[-1, :3]
    smoothed = alpha * np.sin(theta_l) + beta * np.cos(theta_l) - inertia * a
    found = {"payload_sin": alpha, "payload_cos": beta, "payload_inertia": inertia, "back_driven_friction": out[-1, 3]}
    return observed, smoothed, found


@njit(cache=True)
def _observe(record, since, theta_m, theta_l, w, w_dot, v, a, current, own, prior, noise, slow, forget, reference, out):
    """Extended Kalman filter of [α, β, J, κ, r]; its external torque is α sin θl + β cos θl − J θl''.

    Measured is the torque of the current at the output, I = c·T + friction at no load + r, with T = own − external
    torque, c = 1 + μ where the motor drives and 1 − κμ where the load does. `out`, shape (n, 6): the state, the
    external torque. Linearised about the prediction, or about `reference` [α, β, J, κ] where it is not empty.
    """
    p = record[0]
    x = prior[:, 0].copy()
    P = np.diag(prior[:, 1] ** 2)
    mu = p.friction_load
    H = np.zeros(5)
    at = x.copy()
    for i in range(len(w)):
        if i > 0:
            x[4] *= forget
            P[4, :] *= forget
            P[:, 4] *= forget
            P[4, 4] += prior[4, 1] ** 2 * (1.0 - forget * forget)
        at[:] = x
        if len(reference) > 0:
            at[:4] = reference
        external = at[0] * np.sin(theta_l[i]) + at[1] * np.cos(theta_l[i]) - at[2] * a[i]
        T = own[i] - external + p.bl * v[i]
        on = _sign(w[i])
        friction = p.N * laws.friction_level(w[i], theta_l[i], 0.0, since[i], p) * on
        measured = p.N * _drive_torque(i, since[0], 0.0, theta_m, w, w_dot, theta_l, current, T, p)
        if T * on > 0:
            c, slope = 1.0 + mu * abs(on), 0.0
        else:
            c, slope = 1.0 - at[3] * mu * abs(on), -mu * abs(on) * T
        H[0] = -c * np.sin(theta_l[i])
        H[1] = -c * np.cos(theta_l[i])
        H[2] = c * a[i]
        H[3] = slope
        H[4] = 1.0
        expected = c * T + friction + at[4]
        for j in range(4):
            expected += H[j] * (x[j] - at[j])
        R = math.hypot(noise, slow[i])
        PH = P @ H
        S = H @ PH + R * R
        gain = PH / S
        x += gain * (measured - expected)
        for j in range(5):
            for m in range(5):
                P[j, m] -= gain[j] * PH[m]
        out[i, :5] = x
        out[i, 5] = x[0] * np.sin(theta_l[i]) + x[1] * np.cos(theta_l[i]) - x[2] * a[i]
