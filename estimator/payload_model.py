"""A rigid payload missing in the description, observed through the motor current: the model of both payload
observers.

Its external torque on the link is α sin θl + β cos θl − J θl'' with moments α, β and inertia J about the joint's
axis. The measurement is the torque of the current at the output, less friction without load and the drive's inertia,

    I = c·T + r        T = own torque − external torque + bl θl'
    c = 1 + μ if the motor drives, 1 − κμ if the load does

with the load-dependent friction μ, its share κ while the load drives, and the friction model's error r, which forgets
in `MEMORY`. An extended Kalman filter estimates the state [α, β, J, κ, r]. It cannot see contact: other external
torques end up in r, or in a false payload.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..models import dynamics
from ..models.kernels import kernel
from .estimator import KnownJoint

SIZE = 5
MEMORY = 0.5  # correlation time of the friction model's error [s]
PAYLOAD = 0.7  # prior standard deviation of a payload's moments, in rated torques; its inertia's as for a mass at 1 m
NOISE = 0.003  # least noise of an estimate of torque, as a share of the rated torque
FRICTION_ERROR = 0.05  # least error of a friction model, as a share of the friction
INTERVAL = 4e-3  # time between samples [s] for which the noise of the current counts as independent
_AT_REST = 4.0  # noise of friction at rest, in units of its level
_SLOW = 4.0  # its range of speed, in Stribeck velocities


class Seen(NamedTuple):
    """An observer's inputs at an instant: `models.dynamics.State` of the drive, motor acceleration [rad/s²], link
    acceleration [rad/s²], torque on the rotor without Tw [N·m, motor side], own torque of the link [N·m]."""

    state: dynamics.State
    motor_acceleration: float
    link_acceleration: float
    rotor_torque: float
    own_torque: float


class KnownPayload(NamedTuple):
    """A payload: moments α, β [N·m], inertia J [kg·m²]; and the share κ of the load-dependent friction that acts
    while the load drives."""

    payload_sin: float
    payload_cos: float
    payload_inertia: float
    back_driven_friction: float


def friction_error(joint: KnownJoint) -> float:
    """Return the standard deviation [N·m, output side] of the friction model: by its diagnosis, or else its
    tolerance."""
    return float(max(joint.friction, FRICTION_ERROR) * joint.p["N"] * joint.p["Fc"])


def prior(joint: KnownJoint) -> np.ndarray:
    """Return mean and standard deviation of the state, shape (SIZE, 2)."""
    moment = PAYLOAD * joint.rated_torque
    kappa = (float(joint.p["back_driven_friction"]), joint.back_driven)
    return np.array([(0, moment), (0, moment), (0, moment / 9.81), kappa, (0, friction_error(joint))], dtype=np.float64)


def noise(joint: KnownJoint) -> float:
    """Return the standard deviation of I [N·m] at samples `INTERVAL` apart."""
    p = joint.p
    return float(max(1.2 * p["N"] * p["Kt"] * joint.noise.current_noise, 3 * NOISE * joint.rated_torque))


@kernel
def slow_friction(w, p):
    """Return the standard deviation [N·m, output side] of the friction model near rest: presliding, Stribeck."""
    return _AT_REST * p.N * p.Fc * math.exp(-abs(w) / (_SLOW * p.vs))


@kernel
def external_torque(x, link_position, link_acceleration):
    """Return the payload's torque on the link [N·m]."""
    return x[0] * math.sin(link_position) + x[1] * math.cos(link_position) - x[2] * link_acceleration


@kernel
def update(x, P, seen, at, noise, p):
    """Update state x, shape (SIZE,), and covariance P with the inputs of an instant, `Seen`, in place; the bristle of
    its state is not used. The measurement, with a noise [N·m], is linearised about `at`, [α, β, J, κ]."""
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
    """Let r forget: keep `share` of it, and return its variance to its prior's."""
    x[4] *= share
    P[4, :] *= share
    P[:, 4] *= share
    P[4, 4] += variance * (1.0 - share * share)
