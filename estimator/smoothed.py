"""What a whole recording's motion, seen through one zero-phase smoother, says of the torques: for whatever need not be causal.

Rotor, link and current go through the same linear filter (`motion`), so that both sides of a torque balance stay in step however
low its passband is. How low it must be, the readings' own noise says (`bandwidth`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ..models import dynamics, laws
from ..models.dynamics import UNREAD, State
from ..models.kernels import kernel
from ..models.signals import Signals
from .estimator import KnownJoint
from .motion import BLOCK, smooth

STEP = 1e-3
"""Grid [s] on which motion is differentiated and friction replayed."""
BANDWIDTHS = (80.0, 40.0, 20.0, 10.0, 5.0)
"""Bandwidths [Hz] of the estimate from current, best first; see `bandwidth`."""
QUIET = 0.005
"""Noise that the estimate from current may have, as a share of the rated torque: it decides about the bandwidth."""
_ROBUST = 1.4826
_LOAD_STEPS = 5  # friction depends on the torque that it is part of, weakly


@dataclass(frozen=True)
class Motion:
    """Smooth motion and current on an even grid; n samples, what the sensors read wrong taken off.

    Attributes:
      time: shape (n,) [s]; since: of the recording's start [s].
      motor_position, motor_velocity, motor_acceleration: shape (n,), rotor, motor side.
      link_position, link_velocity, link_acceleration: shape (n,), output side.
      current: shape (n,), as read [A]. temperature: shape (n,) [°C].
      cutoff: passband of the smoother [Hz].
    """

    time: np.ndarray
    since: np.ndarray
    motor_position: np.ndarray
    motor_velocity: np.ndarray
    motor_acceleration: np.ndarray
    link_position: np.ndarray
    link_velocity: np.ndarray
    link_acceleration: np.ndarray
    current: np.ndarray
    temperature: np.ndarray
    cutoff: float

    def every(self, steps: int) -> Motion:
        """The same on every so many-th point of the grid."""
        kept = {f.name: getattr(self, f.name)[::steps].copy() for f in fields(self) if f.name != "cutoff"}
        return replace(self, **kept)

    def at(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values on the grid at other times [s]."""
        return np.interp(time, self.time, values)


def smooth_motion(signals: Signals, joint: KnownJoint, cutoff: float, every: int = 1) -> Motion:
    """Motion of a recording's part.

    Args:
      signals: `motor_position`, and `link_position`, `motor_current`, `temperature` where they are known. Without a link
        encoder the link moves as the rotor does.
      joint: what is known of it.
      cutoff: passband [Hz].
      every: of the grid's points one is evaluated, the first among them.
    """
    time, p = signals.time, joint.p
    s = smooth(time, _rotor_link_current(signals, joint), STEP, cutoff, every, moving=2)
    position, velocity, acceleration = (np.ascontiguousarray(a.T) for a in (s.value, s.rate, s.acceleration))
    heat = np.full(len(s.time), p["reference_temperature"])
    if "temperature" in signals:
        heat = np.interp(s.time, time, signals["temperature"])
    start = joint.since(time[:1])[0]
    since = s.time if start == time[0] == 0.0 else s.time - time[0] + start  # of an hour, 30 MB
    return Motion(
        s.time, since, position[0], velocity[0], acceleration[0], position[1], velocity[1],
        acceleration[1], position[2], heat, cutoff,
    )  # fmt: skip


def _rotor_link_current(signals: Signals, joint: KnownJoint) -> np.ndarray:
    """Rotor and link angle [rad] and current [A] at every sample, shape (n, 3)."""
    link = link_positions(signals, joint) if "link_position" in signals else None
    found = np.zeros((len(signals.time), 3))
    if link is not None:
        found[:, 1] = link
        del link  # of an hour, 30 MB
    motor = np.empty(len(found))
    _motor_positions(signals["motor_position"], joint.record, motor)
    found[:, 0] = motor
    if "link_position" not in signals:
        found[:, 1] = motor / joint.p["N"]
    if "motor_current" in signals:
        found[:, 2] = signals["motor_current"]
    return found


def in_amperes(signals: Signals, joint: KnownJoint) -> Signals:
    """The signals with the current of which a drive told the torque."""
    if "motor_current" in signals or "motor_torque" not in signals:
        return signals
    return signals.with_columns(motor_current=signals["motor_torque"] / joint.p["Kt_drive"])


def in_time(signals: Signals, joint: KnownJoint) -> tuple[Signals, KnownJoint]:
    """Signals in which the link encoder is not late any more, and a joint that knows so: what is over can be read earlier."""
    delay = float(joint.p["link_delay"])
    if delay == 0.0 or "link_position" not in signals:
        return signals, joint
    time = signals.time
    early = np.interp(time + delay, time, signals["link_position"])
    end = time > time[-1] - delay  # not read yet: it moves as the rotor does
    if "motor_position" in signals:
        motor = signals["motor_position"] / joint.p["N"]
        early[end] += motor[end] - np.interp(time[-1] - delay, time, motor)
    return signals.with_columns(link_position=early), joint.told(link_delay=0.0)


def link_positions(signals: Signals, joint: KnownJoint) -> np.ndarray:
    """The link's angle [rad] at every sample: its reading without delay, zero, orders and discrepancy."""
    signals, joint = in_time(signals, joint)
    time, reading = signals.time, signals["link_position"]
    found = np.empty(len(time))
    _link_positions(reading, signals["motor_position"], joint.since(time), joint.record, found)
    return found


@kernel
def _motor_positions(reading, record, out):
    for i in range(len(out)):
        out[i] = dynamics.actual_motor_position(reading[i], record[0])


@kernel
def _link_positions(reading, motor, since, record, out):
    for i in range(len(out)):
        out[i] = dynamics.actual_link_position(reading[i], motor[i], 0.0, since[i], record[0])


def bandwidth(signals: Signals, joint: KnownJoint, quiet: float = QUIET) -> float:
    """The highest of `BANDWIDTHS` [Hz] at which the torque from current has no more noise than `quiet` [rated torques].

    Noise of the motor's angle (counts, and jitter of the time stamps times speed) enters through the rotor's
    acceleration, noise of the current directly. Both are taken from the readings, as white.
    """
    p, time = joint.p, signals.time
    angle, amperes = white_noise(time, signals["motor_position"]), white_noise(time, signals["motor_current"])
    interval = float(np.median(np.diff(time)))
    for cutoff in BANDWIDTHS:
        inertia = (p["Jm"] + p["Jw"]) * (2 * np.pi * cutoff) ** 2 * angle
        share = min(1.0, 2 * cutoff * interval)  # of the readings' noise, in power, that passes
        if p["N"] * np.hypot(inertia, p["Kt"] * amperes) * np.sqrt(share) <= quiet * joint.rated_torque:
            return cutoff
    return BANDWIDTHS[-1]


def white_noise(time: np.ndarray, values: np.ndarray) -> float:
    """Standard deviation of white noise on a smooth signal, from third divided differences; robust."""
    difference = np.empty(max(len(time) - 3, 0))
    for begin in range(0, len(difference), BLOCK):
        part = slice(begin, begin + BLOCK + 3)
        difference[begin : begin + BLOCK] = _third_differences(time[part], values[part])
    return float(_ROBUST * np.median(np.abs(difference)))


def _third_differences(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Third divided differences of n samples in units of the noise of one, shape (n - 3,)."""
    t = np.stack([time[i : len(time) - 3 + i] for i in range(4)])
    weight = np.array([1 / np.prod([t[i] - t[j] for j in range(4) if j != i], axis=0) for i in range(4)])
    y = np.stack([values[i : len(values) - 3 + i] for i in range(4)])
    return np.sum(weight * y, axis=0) / np.sqrt(np.sum(weight**2, axis=0))


def torque_from_current(motion: Motion, joint: KnownJoint) -> np.ndarray:
    """Flexspline torque Tf [N·m] on the grid: current less friction and what turns the drive; the LuGre bristle follows."""
    out = np.empty(len(motion.time))
    m = motion
    _torque_from_current(
        m.since, m.motor_position, m.motor_velocity, m.motor_acceleration, m.link_position, m.link_velocity, m.current,
        m.temperature, joint.record, out,
    )  # fmt: skip
    return out


@kernel
def _torque_from_current(since, motor, w, w_dot, link, v, current, temperature, record, out):
    p = record[0]
    z, T = 0.0, 0.0
    for i in range(len(out)):
        step = z
        for _ in range(_LOAD_STEPS):
            actual = dynamics.actual_motor_current(current[i], motor[i], link[i], w[i], T, since[i], p)
            state = dynamics.drive_state(motor[i], w[i], link[i], v[i], z, actual, since[i], temperature[i])
            g = dynamics.sliding_friction(state, T, p)
            if i == 0:  # has been turning like this for long, or rests without friction
                step = g / p.s0 * np.tanh(w[i])
            else:
                step = laws.bristle_step(z, w[i], g, since[i] - since[i - 1], p)
            state = dynamics.drive_state(motor[i], w[i], link[i], v[i], step, actual, since[i], temperature[i])
            T = dynamics.transmitted_torque(state, w_dot[i], g, T, p)
        z = step
        out[i] = T


def own_torque(motion: Motion, joint: KnownJoint, load: np.ndarray) -> np.ndarray:
    """Joint torque [N·m] on the grid that the link's own inertia, gravity and known link torques ask for.

    Args:
      load: flexspline torque [N·m], shape (n,), on which a model discrepancy may depend.
    """
    out = np.empty(len(motion.time))
    m = motion
    _own_torque(
        m.since,
        m.motor_position,
        m.motor_velocity,
        m.link_position,
        m.link_velocity,
        m.link_acceleration,
        load,
        joint.record,
        out,
    )
    return out


@kernel
def _own_torque(since, motor, w, link, v, a, load, record, out):
    p = record[0]
    angle, rate = 0.0, 0.0
    for i in range(len(out)):
        state = dynamics.drive_state(motor[i], w[i], link[i], v[i], UNREAD, UNREAD, since[i], UNREAD)
        out[i] = (p.Jl - laws.flexible_inertia(p)) * a[i] - dynamics.link_torque(state, load[i], p)
        if p.flexible_share > 0.0:
            if i > 0:
                angle, rate = laws.flexible_step(angle, rate, a[i - 1], a[i], since[i] - since[i - 1], p)
            out[i] -= laws.flexible_torque(angle, rate, p)


def arm_torque(motion: Motion, signals: Signals) -> np.ndarray:
    """What the motion of other joints of an arm puts on the link [N·m] on the grid; nothing where that is not known."""
    if "arm_torque" not in signals:
        return np.zeros(len(motion.time))
    return np.interp(motion.time, signals.time, signals["arm_torque"])


def torsion_of(motion: Motion, joint: KnownJoint, load: np.ndarray) -> np.ndarray:
    """Torsion Δθf [rad] on the grid of Eqs. (1), (5), (6), the motor torque for Tw."""
    out = np.empty(len(motion.time))
    m = motion
    _torsion(m.since, m.motor_position, m.motor_velocity, m.link_position, m.current, load, joint.record, out)
    return out


@kernel
def _torsion(since, motor, w, link, current, load, record, out):
    p = record[0]
    for i in range(len(out)):
        actual = dynamics.actual_motor_current(current[i], motor[i], link[i], w[i], load[i], since[i], p)
        still = State(motor[i], 0.0, motor[i], w[i], link[i], UNREAD, UNREAD, UNREAD, actual, since[i], UNREAD)
        torque = dynamics.rotor_torque(still, 0.0, load[i], p)
        out[i], _ = dynamics.measured_torsion(motor[i], link[i], torque, p)


def wound(torque: np.ndarray, joint: KnownJoint) -> np.ndarray:
    """Torsion Δθf [rad] that a flexspline torque [N·m] winds, shape (n,), without hysteresis."""
    out = np.empty(len(torque))
    _wound(np.ascontiguousarray(torque), joint.record, out)
    return out


@kernel
def _wound(torque, record, out):
    for i in range(len(out)):
        out[i] = laws.flexspline_torsion(torque[i], record[0])
