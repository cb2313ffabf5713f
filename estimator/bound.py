"""Lower bound of the mean square error of any estimator: the posterior Cramér-Rao bound.

For x(k+1) = f(x(k)) + w, y(k) = h(x(k)) + v with Gaussian w ~ (0, Q), v ~ (0, R), every estimator's error covariance
is at least the inverse of the information J (Tichavský, Muravchik & Nehorai, IEEE Trans. Signal Processing 46, 1998,
Eq. 21). F, H are the Jacobians at the true states. Only the external torque of a joint is random, so its Q is
singular. Along one trajectory the matrix inversion lemma gives the recursion without Q⁻¹, which `joint_bound`
computes as covariances:

    J(k+1) = (Q + F J(k)⁻¹ Fᵀ)⁻¹ + HᵀR⁻¹H

Over trajectories the *variance* is averaged. The expectation inside the recursion would count differences of the
Jacobians as information, and infinitely much for states without noise. The average is never below it (J⁻¹ is convex).
A filter that linearises at the truth attains it.

**The model.** Dynamics, friction, elasticity and drive current are exactly the record's (`joint_model`). The external
torque is a random walk of a stated intensity, with variance (0.2·T2)² at the start. Both encoders have Gaussian noise
of variance σ² + q²/12, step q. Gaussian noise is the least informative of that variance: a filter that uses the
instants of count changes may be below the bound. So may an adaptive filter on a scenario that is mostly at rest: the
bound is for the mean over random walks. It is for filtering; a smoother has a lower one, which is not computed.

**Uncertain numbers** are further constant states with the tolerances as prior (Van Trees' bound with random
parameters). Their columns of F and H are secants of one standard deviation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..models.errors import InputError
from ..models.kernels import kernel
from . import joint_model as model
from .dynamics_filter import propagate, slope_of_link
from .estimator import KnownJoint, SensorNoise
from .joint_model import DAHL, LINK, LINK_RATE, MESH, MOTOR, SIZE, ProcessNoise
from .quantised import update as condition

QUIET = ProcessNoise()  # prior of the joint's states. Its `external` is the lowest intensity of an external torque.
BANDWIDTH = 20.0
"""Frequency [Hz] up to which a random walk represents an external torque: the bandwidth of the momentum observers."""
_FINE = 1e-2  # of the estimators' difference steps


def walk_intensity(torque: np.ndarray, time: np.ndarray, bandwidth: float = BANDWIDTH) -> float:
    """Return the intensity q [N·m/√s] of the random walk with the same changes as a torque [N·m], shape (n,), at even
    times [s], up to a bandwidth [Hz] of half the sample rate at most.

    q² = mean of (τ(t + h) − τ(t))²/h over the record, held at both ends, with h = 1/(2·bandwidth). The changes of a
    walk grow with h, so that any h gives its q. Those of a smooth torque grow with h²: single samples would give a q
    that depends on the sample rate.
    """
    step = float(time[-1] - time[0]) / (len(time) - 1)
    lag = max(round(0.5 / (bandwidth * step)), 1)
    held = np.concatenate([np.full(lag - 1, torque[0]), torque, np.full(lag - 1, torque[-1])])
    return float(np.sqrt(np.sum((held[lag:] - held[:-lag]) ** 2) / (lag * (time[-1] - time[0]))))


def joint_bound(
    time: np.ndarray,
    states: np.ndarray,
    current: np.ndarray,
    command: np.ndarray,
    record: np.ndarray,
    noise: SensorNoise,
    intensity: float,
    temperature: np.ndarray | None = None,
    others: np.ndarray | None = None,
) -> np.ndarray:
    """Return the bound of the joint torque's error variance [(N·m)²], shape (n,), along a true trajectory.

    `states`: columns `joint_model.STATES`, shape (n, SIZE); `current`: of the motor, and `command`, in force from a sample
    to the next [A], shape (n,); `intensity`: of the external torque's random walk [N·m/√s], ≥ 0, else `InputError`;
    `temperature`: of the gear [°C], shape (n,), by default the reference; `others`: records with one uncertain number
    each a standard deviation off, independent, shape (k,), by default none.
    """
    joint = KnownJoint(record, noise)
    if not (np.isfinite(intensity) and intensity >= 0.0):
        raise InputError(f"bound: intensity [N·m/√s]: expected a finite number ≥ 0, got {intensity!r}")
    process = replace(
        QUIET, external=intensity / float(joint.p["T2"]), push=0.0, mesh_push=0.0, torque=0.0, bristle=0.0
    )
    random = process.record(joint, 0.0)
    r = random[0]
    r["walk"][[MESH, DAHL]] = 0.0
    r["motor_variance"] = noise.motor_noise**2 + noise.motor_resolution**2 / 12.0
    r["link_variance"] = noise.link_noise**2 + noise.link_resolution**2 / 12.0
    model.activate(r, [i for i in r["active"][: int(r["count"])].astype(int) if i != MESH])
    if temperature is None:
        temperature = np.full(len(time), joint.p["reference_temperature"])
    out = np.empty(len(time))
    others = np.zeros(0, record.dtype) if others is None else np.ascontiguousarray(others)
    _along(time, np.ascontiguousarray(states), current, command, temperature, record, others, random, out)
    return out


@kernel
def _along(time, states, current, command, temperature, record, others, random, out):
    p, noise = record[0], random[0]
    m = int(noise.count)
    n = m + len(others)
    x, y, ahead, work = np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE), np.zeros((3, SIZE))
    P, F, A = np.eye(n), np.zeros((m, n)), np.zeros((m, n))
    H, PH = np.zeros(n), np.zeros(n)
    unmoved, every = np.zeros(n), np.arange(n)  # the bound needs covariances only
    for i in range(m):
        P[i, i] = noise.start[int(noise.active[i])]
    for k in range(len(time)):
        x[:] = states[k]
        if k > 0:
            dt = time[k] - time[k - 1]
            _jacobian(
                states[k - 1], current[k - 1], command[k - 1], time[k - 1], dt, temperature[k - 1], p, others, noise, F, y,
                ahead, work,
            )  # fmt: skip
            propagate(F, P, A, m, n)
            for i in range(m):
                P[i, i] += noise.walk[int(noise.active[i])] * dt
            H[:] = 0.0
            H[MOTOR] = 1.0
            motor = model.read_motor(x, p)
            for j in range(len(others)):
                H[m + j] = model.read_motor(x, others[j]) - motor
            condition(unmoved, P, every, H, 0.0, noise.motor_variance, 0.0, PH)
            reading = model.read_link(x, time[k], p)
            slope = slope_of_link(x, reading, time[k], p)
            H[MOTOR], H[LINK], H[LINK_RATE] = 0.0, slope, -p.link_delay * slope
            for j in range(len(others)):
                H[m + j] = model.read_link(x, time[k], others[j]) - reading
            condition(unmoved, P, every, H, 0.0, noise.link_variance, 0.0, PH)
        torque = model.joint_torque(x, time[k], p)
        H[:] = 0.0
        for i in range(m):
            state = int(noise.active[i])
            kept = x[state]
            x[state] += model.STEPS[state]
            H[i] = (model.joint_torque(x, time[k], p) - torque) / model.STEPS[state]
            x[state] = kept
        for j in range(len(others)):
            H[m + j] = model.joint_torque(x, time[k], others[j]) - torque
        variance = 0.0
        for i in range(n):
            for j in range(n):
                variance += H[i] * P[i, j] * H[j]
        out[k] = max(variance, 0.0)


@kernel
def _jacobian(at, current, command, time, dt, temperature, p, others, noise, F, low, high, work):
    """Write the Jacobian of a step at a true state into F, shape (m, m + k): central differences of the states,
    secants of the k other records.

    The steps are a hundredth of an estimator's. Near rest a longer step would cross the kink of friction's |w| and
    show an instability that does not exist.
    """
    low[:] = at
    steps = model.substeps(low, dt, p)
    m = int(noise.count)
    for j in range(m):
        a = int(noise.active[j])
        width = _FINE * model.STEPS[a]
        low[:] = at
        high[:] = at
        low[a] -= width
        high[a] += width
        model.advance(low, current, command, time, dt, steps, temperature, p, work)
        model.advance(high, current, command, time, dt, steps, temperature, p, work)
        for i in range(m):
            b = int(noise.active[i])
            F[i, j] = (high[b] - low[b]) / (2.0 * width)
    if len(others) == 0:
        return
    low[:] = at
    model.advance(low, current, command, time, dt, steps, temperature, p, work)
    for j in range(len(others)):
        high[:] = at
        model.advance(high, current, command, time, dt, steps, temperature, others[j], work)
        for i in range(m):
            state = int(noise.active[i])
            F[i, m + j] = high[state] - low[state]


@kernel
def random_walk_bound(W, V, P0):
    """Return the bound, shape (T,), for a random walk seen directly: x(k+1) = x(k) + w, y = x + v, variances W per step
    and V(k), shape (T,); `P0`: variance at step 0.

    This is the limit of the paper's model, F = H = 1. For constant W, V it settles at the positive root of P² + W P − W
    V = 0.
    """
    out = np.full(len(V), P0)
    for k in range(1, len(V)):
        P = out[k - 1] + W
        out[k] = P * (V[k] / (P + V[k]))
    return out
