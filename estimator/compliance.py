"""The harmonic-drive compliance model, Eqs. (1)-(7): joint torque from two encoders and the motor torque.

`measure` is the paper's model, Eqs. (1), (5), (6), (7), per sample, inside every estimator based on torsion, with the further
effects of a joint's record:

* **encoders**: zero and orders of the link encoder, eccentricity of the motor encoder, model discrepancies of the
  link encoder;
* **Tw**: the motor torque from the command in force (without a command, from the reading less its offset), plus
  cogging and model discrepancies at the rotor;
* **delay of the link encoder**: it is compared with the rotor's past position. The delayed torsion is extrapolated
  along the line through its last samples (`_AHEAD`);
* **flexspline**: backlash, hysteresis, model discrepancies. A low-passed torsion drives the Dahl state; encoder
  counts would wear it away.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..models import dynamics, laws
from ..models.dynamics import UNREAD, State
from ..models.kernels import kernel
from ..models.parameters import floats
from .estimator import KnownJoint
from .sensing import LOWPASS, RING, VELOCITY, line_in_ring, lowpass, motor_current, place_in_ring

_AHEAD = 2.0  # delays of the link encoder over which the line for the torsion's extrapolation is fitted
_HYSTERESIS = 2.0 * math.pi * 70.0
"""Low-pass [rad/s] of the torsion that drives the hysteresis. A higher one lets counts wear the state away; a lower
one misses vibrations."""

TORSION = floats(
    "torque", "dahl", "count", ("motor", LOWPASS), ("slow", LOWPASS),
    ("time", RING), ("motor_position", RING), ("motor_torque", RING), ("velocity", RING), ("torsion", RING),
)  # fmt: skip
"""Memory of `measure`: last torque [N·m], Dahl state [rad], number of samples, rotor and torsion through low-passes,
and a ring of past samples for a delayed link encoder."""


class Measured(NamedTuple):
    """Result of the compliance model at a sample: torque Tf [N·m]; torsion Δθf [rad]; corrected angles of rotor, wave
    generator [rad, motor side] and link [rad]; motor torque used for Tw [N·m, motor side]."""

    torque: float
    torsion: float
    motor_position: float
    wave_generator_position: float
    link_position: float
    motor_torque: float


@kernel
def measure(m, s, p):
    """Return the compliance model at a sample, `Measured`; `m`: record of `TORSION`, updated."""
    motor = dynamics.actual_motor_position(s.motor_position, p)
    w, beyond = UNREAD, laws.has_discrepancy(p)
    if beyond:
        lowpass(m.motor, motor, s.interval, VELOCITY)
        w = m.motor.rate
    rough = s.link_position - p.link_zero
    current = motor_current(s, motor, rough, w, m.torque, p)
    still = State(motor, 0.0, motor, w, rough, w / p.N, UNREAD, UNREAD, current, s.time, UNREAD)
    motor_torque = dynamics.rotor_torque(still, 0.0, m.torque, p)  # at no velocity: without its damping
    if p.link_delay > 0.0:
        torsion = _late_torsion(m, s, motor, motor_torque, w, p)
        turned, theta_w = dynamics.measured_torsion(motor, 0.0, motor_torque, p)
        link = turned - torsion
    else:
        link = dynamics.actual_link_position(s.link_position, motor, w, s.time, p)
        torsion, theta_w = dynamics.measured_torsion(motor, link, motor_torque, p)
    if p.hysteresis_torque != 0.0:
        lowpass(m.slow, torsion, s.interval, _HYSTERESIS)
        m.dahl = laws.dahl_step(m.dahl, m.slow.rate, s.interval, p)
    torque = laws.flexspline_spring(torsion, p)
    if p.hysteresis_torque != 0.0:
        torque += laws.hysteresis_torque(m.dahl, p)
    if beyond:
        state = State(motor, w, theta_w, w, link, w / p.N, UNREAD, m.dahl, current, s.time, UNREAD)
        torque += dynamics.flexspline_discrepancy(state, torque, p)
    m.torque = torque
    return Measured(torque, torsion, motor, theta_w, link, motor_torque)


@kernel
def _late_torsion(m, s, motor, motor_torque, w, p):
    """Return the torsion now [rad] from a link encoder reading that is `p.link_delay` old."""
    n = int(m.count)
    at = n % RING
    m.time[at], m.motor_position[at], m.motor_torque[at], m.velocity[at] = s.time, motor, motor_torque, w
    m.count = n + 1.0
    then = s.time - p.link_delay
    a, b, share = place_in_ring(m.time, n, then)
    motor_then = m.motor_position[a] + share * (m.motor_position[b] - m.motor_position[a])
    torque_then = m.motor_torque[a] + share * (m.motor_torque[b] - m.motor_torque[a])
    link = dynamics.actual_link_position(s.link_position, motor_then, m.velocity[a], then, p)
    m.torsion[at], _ = dynamics.measured_torsion(motor_then, link, torque_then, p)
    return line_in_ring(m.time, m.torsion, n, _AHEAD * p.link_delay, s.time + p.link_delay)


def torque_variance(joint: KnownJoint) -> float:
    """Return the variance [(N·m)²] of `measure` by the sensors' noise; the current's noise counts for the command,
    too."""
    p, noise = joint.p, joint.noise
    return measurement_variance(
        float(p["K2"]), noise.motor_resolution, noise.link_resolution, noise.link_noise, noise.motor_noise,
        ratio=float(p["N"]), torque_noise=float(p["Kt"]) * noise.current_noise,
        wave_generator_stiffness=float(p["Kw0"]),
    )  # fmt: skip


def measurement_variance(
    stiffness: float,
    motor_resolution: float,
    link_resolution: float,
    link_noise: float = 0.0,
    motor_noise: float = 0.0,
    *,
    ratio: float,
    torque_noise: float = 0.0,
    wave_generator_stiffness: float = math.inf,
) -> float:
    """Return the variance V [(N·m)²] of the compliance model's torque by its sensors' noise.

    Linear propagation through Eqs. (6), (7): `V = K²·(σm²/N² + σl² + (σT/(N·Kw))²)` with the slope K of Eq. (7)
    [N·m/rad], of which K2 is the middle one, and the gear ratio N. Resolution: a count q, of variance q²/12; noise: rms;
    both [rad], the motor encoder's on the motor side. `torque_noise`: of the motor torque used for Tw [N·m rms, motor
    side]: zero for an exact command, Kt·(current noise) for a measured current. `wave_generator_stiffness`: Kw0 [N·m/rad,
    motor side]; under load, Eq. (3), it is higher and the noise smaller.
    """
    motor = (motor_resolution**2 / 12.0 + motor_noise**2) / ratio**2
    link = link_resolution**2 / 12.0 + link_noise**2
    wave_generator = (torque_noise / (ratio * wave_generator_stiffness)) ** 2
    return stiffness**2 * (motor + link + wave_generator)
