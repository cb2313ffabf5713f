"""A rigid payload that the description does not have, seen through the motor current: the model of both payload observers.

Its external torque on the link is α sin θl + β cos θl − J θl'' with moments α, β and inertia J about the joint's axis.
Measured is the torque of the current at the output, friction without load and the drive's inertia taken off,

    I = c·T + r        T = own torque − external torque + bl θl'
    c = 1 + μ where the motor drives, 1 − κμ where the load does

where μ is the load-dependent friction, κ the share of it that acts while the load drives, and r what friction does beyond its
model, which forgets in `MEMORY`. The state [α, β, J, κ, r] is estimated by an extended Kalman filter. It is blind to
contact: what is no payload ends up in r, or in a payload that is not there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..models import dynamics
from ..models.kernels import kernel
from .estimator import KnownJoint

SIZE = 5
MEMORY = 0.5
"""Correlation time of what friction does beyond its model [s]."""
PAYLOAD = 0.7
"""Prior standard deviation of a payload's moments, in rated torques; its inertia's as if all of it were 1 m away."""
NOISE = 0.003
"""The least noise that an estimate of torque is credited with, as a share of the rated torque."""
FRICTION_ERROR = 0.05
"""The least that a friction model is wrong, as a share of the friction."""
INTERVAL = 4e-3
"""Time between samples [s] for which the noise of the current counts as independent."""
_AT_REST = 4.0  # at rest, friction is anything up to its level: noise in units of the level
_SLOW = 4.0  # how far from rest that reaches, in Stribeck velocities


class Seen(NamedTuple):
    """What an observer sees at an instant: `models.dynamics.State` of the drive, motor acceleration [rad/s²], link acceleration
    [rad/s²], torque that acts on the rotor without Tw [N·m, motor side], own torque of the link [N·m]."""

    state: dynamics.State
    motor_acceleration: float
    link_acceleration: float
    rotor_torque: float
    own_torque: float


class KnownPayload(NamedTuple):
    """What is known of a payload: moments α, β [N·m], inertia J [kg·m²]; and the share κ of the load-dependent friction that acts
    while the load drives."""

    payload_sin: float
    payload_cos: float
    payload_inertia: float
    back_driven_friction: float


def friction_error(joint: KnownJoint) -> float:
    """Standard deviation [N·m, output side] of the friction model: its tolerance, or what a diagnosis found."""
    return float(max(joint.friction, FRICTION_ERROR) * joint.p["N"] * joint.p["Fc"])


def prior(joint: KnownJoint) -> np.ndarray:
    """Mean and standard deviation of the state, shape (SIZE, 2)."""
    moment = PAYLOAD * joint.rated_torque
    kappa = (float(joint.p["back_driven_friction"]), joint.back_driven)
    return np.array([(0, moment), (0, moment), (0, moment / 9.81), kappa, (0, friction_error(joint))], dtype=np.float64)


def noise(joint: KnownJoint) -> float:
    """Standard deviation of I [N·m] at samples `INTERVAL` apart."""
    p = joint.p
    return float(max(1.2 * p["N"] * p["Kt"] * joint.noise.current_noise, 3 * NOISE * joint.rated_torque))


@kernel
def slow_friction(w, p):
    """Standard deviation [N·m, output side] of friction near rest from its model: presliding, Stribeck."""
    return _AT_REST * p.N * p.Fc * math.exp(-abs(w) / (_SLOW * p.vs))


@kernel
def external_torque(x, link_position, link_acceleration):
    """The payload's torque on the link [N·m]."""
    return x[0] * math.sin(link_position) + x[1] * math.cos(link_position) - x[2] * link_acceleration


@kernel
def update(x, P, seen, at, noise, p):
    """Update state x, shape (SIZE,), and covariance P with what is seen at an instant, in place.

    Args:
      seen: `Seen`; the bristle of its state is not looked at.
      at: Shape (SIZE − 1,), [α, β, J, κ] about which the measurement is linearised.
      noise: of the measurement [N·m].
    """
    link, a = seen.state.link_position, seen.link_acceleration
    w, v = seen.state.motor_velocity, seen.state.link_velocity
    T = seen.own_torque - external_torque(at, link, a) + p.bl * v
    on = math.tanh(w)  # sign of the velocity, smooth over 1 rad/s
    g = dynamics.sliding_friction(seen.state, 0.0, p)
    sliding = dynamics.drive_state(
        seen.state.motor_position, w, link, v, g / p.s0 * on, dynamics.UNREAD, seen.state.time, seen.state.temperature
    )
    friction = dynamics.mesh_torque(sliding, T, g, p)
    measured = p.N * (seen.rotor_torque - friction - (p.Jm + p.Jw) * seen.motor_acceleration)
    mu = p.friction_load
    c, slope = 1.0 + mu * abs(on), 0.0
    if T * on <= 0.0:
        c, slope = 1.0 - at[3] * mu * abs(on), -mu * abs(on) * T
    H, PH = np.empty(SIZE), np.zeros(SIZE)
    H[0], H[1], H[2], H[3], H[4] = -c * math.sin(link), -c * math.cos(link), c * a, slope, 1.0
    residual = measured - c * T - x[4]
    for j in range(SIZE - 1):
        residual -= H[j] * (x[j] - at[j])
    S = noise * noise + slow_friction(w, p) ** 2
    for i in range(SIZE):
        for j in range(SIZE):
            PH[i] += P[i, j] * H[j]
        S += H[i] * PH[i]
    for i in range(SIZE):
        x[i] += PH[i] / S * residual
        for j in range(SIZE):
            P[i, j] -= PH[i] * PH[j] / S


@kernel
def forget(x, P, share, variance):
    """Let r forget: `share` of it stays, and its variance returns to its prior's."""
    x[4] *= share
    P[4, :] *= share
    P[:, 4] *= share
    P[4, 4] += variance * (1.0 - share * share)
