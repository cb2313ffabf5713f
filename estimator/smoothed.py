"""Motion and torques of a whole recording through one zero-phase smoother, for estimates that need not be causal.

Rotor, link and current pass the same linear filter (`motion`), so both sides of a torque balance stay in phase at any
passband. The noise of the readings decides the passband (`bandwidth`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..models import dynamics, laws
from ..models.chunks import kept, large, parts
from ..models.dynamics import UNREAD, State
from ..models.kernels import kernel
from ..models.motion import BLOCK, smooth
from ..models.signals import Signals
from .estimator import KnownJoint

STEP = 1e-3  # grid [s] on which motion is differentiated and friction replayed
BANDWIDTHS = (80.0, 40.0, 20.0, 10.0, 5.0)  # bandwidths [Hz] of the estimate from current, best first; see `bandwidth`
QUIET = 0.005  # allowed noise of the estimate from current, as a share of the rated torque; it decides the bandwidth
_ROBUST = 1.4826
_LOAD_STEPS = 5  # friction depends weakly on the torque


class Motion(NamedTuple):
    """Smooth motion and current on an even grid; n samples, corrected for known sensor errors."""

    time: np.ndarray  # shape (n,) [s]
    since: np.ndarray  # since the recording's start [s]
    motor_position: np.ndarray  # shape (n,), rotor, motor side
    motor_velocity: np.ndarray  # shape (n,), rotor, motor side
    motor_acceleration: np.ndarray  # shape (n,), rotor, motor side
    link_position: np.ndarray  # shape (n,), output side
    link_velocity: np.ndarray  # shape (n,), output side
    link_acceleration: np.ndarray  # shape (n,), output side
    current: np.ndarray  # shape (n,), as read [A]
    temperature: np.ndarray  # shape (n,) [°C]
    cutoff: float  # passband of the smoother [Hz]

    def every(self, steps: int) -> Motion:
        """Return every so many-th point of the grid."""
        return Motion._make([*(kept(values[::steps]) for values in self[:-1]), self.cutoff])

    def at(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return values on the grid at other times [s]."""
        return np.interp(time, self.time, values)


def smooth_motion(signals: Signals, joint: KnownJoint, cutoff: float, every: int = 1) -> Motion:
    """Return the motion of a part of a recording below a `cutoff` [Hz], at `every` so many-th point of the grid.
    Without a link encoder the link moves with the rotor; current and temperature are used if known."""
    time, p = signals.time, joint.p
    s = smooth(time, _rotor_link_current(signals, joint), STEP, cutoff, every, moving=2)
    position, velocity, acceleration = (np.ascontiguousarray(a.T) for a in (s.value, s.rate, s.acceleration))
    heat = np.full(len(s.time), p["reference_temperature"])
    if "temperature" in signals:
        heat = np.interp(s.time, time, signals["temperature"])
    start = joint.since(time[:1])[0]
    since = s.time if start == time[0] == 0.0 else s.time - time[0] + start  # 30 MB less for an hour
    return Motion(
        s.time, since, position[0], velocity[0], acceleration[0], position[1], velocity[1],
        acceleration[1], position[2], kept(heat), cutoff,
    )  # fmt: skip


def _rotor_link_current(signals: Signals, joint: KnownJoint) -> np.ndarray:
    found = large(len(signals.time), 3)
    found[:, 0] = _motor_positions(signals["motor_position"], joint.record)
    found[:, 1] = link_positions(signals, joint) if "link_position" in signals else found[:, 0] / joint.p["N"]
    found[:, 2] = signals.get("motor_current", 0.0)
    return found


def in_amperes(signals: Signals, joint: KnownJoint) -> Signals:
    """Return the signals with the current, if the drive reported the torque."""
    if "motor_current" in signals or "motor_torque" not in signals:
        return signals
    return signals.with_columns(motor_current=signals["motor_torque"] / joint.p["Kt_drive"])


def in_time(signals: Signals, joint: KnownJoint) -> tuple[Signals, KnownJoint]:
    """Return signals without delay of the link encoder, and a joint without it."""
    delay = float(joint.p["link_delay"])
    if delay == 0.0 or "link_position" not in signals:
        return signals, joint
    time = signals.time
    early = np.interp(time + delay, time, signals["link_position"])
    end = time > time[-1] - delay  # not read yet: it moves with the rotor
    if "motor_position" in signals:
        motor = signals["motor_position"] / joint.p["N"]
        early[end] += motor[end] - np.interp(time[-1] - delay, time, motor)
    return signals.with_columns(link_position=early), joint.with_numbers(link_delay=0.0)


def link_positions(signals: Signals, joint: KnownJoint) -> np.ndarray:
    """Return the link's angle [rad], shape (n,): its reading without delay, zero, orders and discrepancy."""
    signals, joint = in_time(signals, joint)
    return _link_positions(signals["link_position"], signals["motor_position"], joint.since(signals.time), joint.record)


@kernel
def _motor_positions(reading, record):
    return np.array([dynamics.actual_motor_position(x, record[0]) for x in reading])


@kernel
def _link_positions(reading, motor, since, record):
    p = record[0]
    return np.array([dynamics.actual_link_position(reading[i], motor[i], 0.0, since[i], p) for i in range(len(since))])


def bandwidth(signals: Signals, joint: KnownJoint, quiet: float = QUIET) -> float:
    """Return the highest of `BANDWIDTHS` [Hz] at which the noise of the torque from current is at most `quiet` [rated
    torques].

    Noise of the motor's angle (counts, and jitter of the time stamps times speed) acts through the rotor's
    acceleration, noise of the current directly. Both are estimated from the readings, as white.
    """
    p, time = joint.p, signals.time
    angle, amperes = white_noise(time, signals["motor_position"]), white_noise(time, signals["motor_current"])
    interval = float(np.median(np.diff(time)))
    for cutoff in BANDWIDTHS:
        inertia = (p["Jm"] + p["Jw"]) * (2 * np.pi * cutoff) ** 2 * angle
        share = min(1.0, 2 * cutoff * interval)  # of the noise power that passes
        if p["N"] * np.hypot(inertia, p["Kt"] * amperes) * np.sqrt(share) <= quiet * joint.rated_torque:
            return cutoff
    return BANDWIDTHS[-1]


def white_noise(time: np.ndarray, values: np.ndarray) -> float:
    """Return the standard deviation of white noise on a smooth signal, from third divided differences, in units of the
    noise of one sample; robust."""
    difference = np.empty(max(len(time) - 3, 0))
    for part in parts(len(difference), BLOCK):
        t, y = (np.stack([x[part.start + i : part.stop + i] for i in range(4)]) for x in (time, values))
        weight = np.array([1 / np.prod([t[i] - t[j] for j in range(4) if j != i], axis=0) for i in range(4)])
        difference[part] = np.sum(weight * y, axis=0) / np.sqrt(np.sum(weight**2, axis=0))
    return float(_ROBUST * np.median(np.abs(difference, out=difference), overwrite_input=True))


def torque_from_current(motion: Motion, joint: KnownJoint) -> np.ndarray:
    """Return the flexspline torque Tf [N·m] on the grid: current less friction (with the LuGre bristle) and the
    drive's inertia."""
    return _torque_from_current(motion, joint.record, large(len(motion.time)))


@kernel
def _torque_from_current(m, record, out):
    p = record[0]
    z, T = 0.0, 0.0
    for i in range(len(out)):
        w, since, heat = m.motor_velocity[i], m.since[i], m.temperature[i]
        motor, link, v = m.motor_position[i], m.link_position[i], m.link_velocity[i]
        step = z
        for _ in range(_LOAD_STEPS):
            actual = dynamics.actual_motor_current(m.current[i], motor, link, w, T, since, p)
            state = dynamics.drive_state(motor, w, link, v, z, actual, since, heat)
            g = dynamics.sliding_friction(state, T, p)
            if i == 0:  # it has turned like this for long, or rests without friction
                step = g / p.s0 * np.tanh(w)
            else:
                step = laws.bristle_step(z, w, g, since - m.since[i - 1], p)
            state = dynamics.drive_state(motor, w, link, v, step, actual, since, heat)
            T = dynamics.transmitted_torque(state, m.motor_acceleration[i], g, T, p)
        z = step
        out[i] = T
    return out


def own_torque(motion: Motion, joint: KnownJoint, load: np.ndarray | None = None) -> np.ndarray:
    """Return the joint torque [N·m] on the grid that the link's inertia, gravity and known link torques need; `load`:
    flexspline torque [N·m], shape (n,), on which a model discrepancy may depend; 0 by default."""
    load = np.zeros(len(motion.time)) if load is None else load
    return _own_torque(motion, load, joint.record, large(len(load)))


@kernel
def _own_torque(m, load, record, out):
    p = record[0]
    angle, rate, a = 0.0, 0.0, m.link_acceleration
    for i in range(len(out)):
        state = dynamics.drive_state(
            m.motor_position[i], m.motor_velocity[i], m.link_position[i], m.link_velocity[i], UNREAD, UNREAD, m.since[i], UNREAD
        )  # fmt: skip
        out[i] = (p.Jl - laws.flexible_inertia(p)) * a[i] - dynamics.link_torque(state, load[i], p)
        if p.flexible_share > 0.0:
            if i > 0:
                angle, rate = laws.flexible_step(angle, rate, a[i - 1], a[i], m.since[i] - m.since[i - 1], p)
            out[i] -= laws.flexible_torque(angle, rate, p)
    return out


def arm_torque(motion: Motion, signals: Signals) -> np.ndarray:
    """Return the torque of an arm's other joints on the link [N·m] on the grid; 0 if unknown."""
    if "arm_torque" not in signals:
        return np.zeros(len(motion.time))
    return np.interp(motion.time, signals.time, signals["arm_torque"])


def torsion_of(motion: Motion, joint: KnownJoint, load: np.ndarray) -> np.ndarray:
    """Return the torsion Δθf [rad] on the grid by Eqs. (1), (5), (6), with the motor torque for Tw."""
    return _torsion(motion, load, joint.record)


@kernel
def _torsion(m, load, record):
    p, out = record[0], np.empty(len(load))
    for i in range(len(out)):
        motor, w, link, since = m.motor_position[i], m.motor_velocity[i], m.link_position[i], m.since[i]
        actual = dynamics.actual_motor_current(m.current[i], motor, link, w, load[i], since, p)
        still = State(motor, 0.0, motor, w, link, UNREAD, UNREAD, UNREAD, actual, since, UNREAD)
        torque = dynamics.rotor_torque(still, 0.0, load[i], p)
        out[i], _ = dynamics.measured_torsion(motor, link, torque, p)
    return out


def wound(torque: np.ndarray, joint: KnownJoint) -> np.ndarray:
    """Return the torsion Δθf [rad] under a flexspline torque [N·m], shape (n,), without hysteresis."""
    return _wound(np.ascontiguousarray(torque), joint.record)


@kernel
def _wound(torque, record):
    return np.array([laws.flexspline_torsion(T, record[0]) for T in torque])
