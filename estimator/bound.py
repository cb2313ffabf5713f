"""How small the mean square error of any estimator can be: the posterior Cramér-Rao bound.

For x(k+1) = f(x(k)) + w, y(k) = h(x(k)) + v with Gaussian w ~ (0, Q), v ~ (0, R), every estimator's error covariance is at
least the inverse of the information J (Tichavský, Muravchik & Nehorai, IEEE Trans. Signal Processing 46, 1998, Eq. 21)

    J(k+1) = D22 − D21 (J(k) + D11)⁻¹ D12        D11 = E[FᵀQ⁻¹F]   D12 = D21ᵀ = −E[Fᵀ]Q⁻¹   D22 = Q⁻¹ + E[HᵀR⁻¹H]

with F, H the Jacobians at the true states. `posterior_information` is that, with the expectation over trajectories.

A joint's Q is singular: only the external torque is random. Along one trajectory the matrix inversion lemma gives the same
recursion without Q⁻¹, J(k+1) = (Q + F J(k)⁻¹ Fᵀ)⁻¹ + HᵀR⁻¹H, which `joint_bound` runs as covariances. Over trajectories its
*variance* is averaged: the expectation within the recursion would count how much the Jacobians differ between
trajectories as information, infinitely much of it about states that have no noise. The average is never below it (J⁻¹ is
convex); it is what an estimator attains that linearises at the truth.

**The stated model.** Dynamics, friction, elasticity and drive current are exactly the record's (`joint_model`); the external
torque is a random walk of a stated intensity, a priori (0.2·T2)² at the start. Both encoders: Gaussian
noise of variance σ² + q²/12, step q. Of all noise of that variance the Gaussian one tells least: a filter that uses
where the counts change may come out below such a bound. So may one that adapts, on a scenario that rests most of the time:
the bound holds for the mean over random walks. It is the bound for filtering; a smoother has a lower one, which is not computed.

**Numbers that nobody knows exactly** are further states, constant, with the tolerances as prior (Van Trees' bound with random
parameters): J starts with their unit information, and their columns of F and H are secants of one standard deviation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..models.errors import InputError
from ..models.kernels import kernel
from . import joint_model as model
from .dynamics_filter import propagate
from .estimator import KnownJoint, SensorNoise
from .joint_model import DAHL, LINK, LINK_RATE, MESH, MOTOR, SIZE, ProcessNoise
from .quantised import update as condition

QUIET = ProcessNoise()
"""Prior of the joint's states; and, by its `external`, the lowest intensity of an external torque that is worth stating."""
BANDWIDTH = 20.0
"""Up to which frequency [Hz] a random walk stands for an external torque: that of the momentum observers' default."""
_FINE = 1e-2  # of the estimators' difference steps


def posterior_information(F: ArrayLike, Q: ArrayLike, H: ArrayLike, R: ArrayLike, J0: ArrayLike) -> np.ndarray:
    """Return the information J, shape (T, n, n), of the recursion in the module; J⁻¹ bounds the error covariance.

    Args:
        F: Shape (T − 1, n, n), Jacobians from step k to k + 1; or (M, T − 1, n, n), of M equally likely trajectories.
        Q: Shape (n, n), positive definite; J is a difference of numbers as large as its inverse, exact to 1e-16 of them.
            R: Shape (m, m), positive definite.
        H: Shape (T, m, n) or (M, T, m, n), Jacobians of the measurements; that of step 0 is not used.
        J0: Shape (n, n), information about the first state; it contains the first measurement, if there is one.

    Raises:
        InputError: shapes that do not fit, Q or R not positive definite.
    """
    F, H = (np.asarray(a, dtype=np.float64) for a in (F, H))
    F, H = F if F.ndim == 4 else F[None], H if H.ndim == 4 else H[None]
    Q, R, J0 = (np.asarray(a, dtype=np.float64) for a in (Q, R, J0))
    n, m, T = Q.shape[0], R.shape[0], H.shape[1]
    if F.shape[1:] != (T - 1, n, n) or H.shape[1:] != (T, m, n) or J0.shape != (n, n) or len(F) != len(H):
        raise InputError(
            f"bound: expected F (M, T − 1, n, n), H (M, T, m, n), J0 (n, n), got {F.shape}, {H.shape}, {J0.shape} with "
            f"n = {n}, m = {m}"
        )
    for name, matrix in (("Q", Q), ("R", R)):
        if not np.linalg.eigvalsh(matrix)[0] > 0.0:
            raise InputError(f"bound: {name}: expected a positive definite matrix")
    Qi, Ri = np.linalg.inv(Q), np.linalg.inv(R)
    J = np.empty((T, n, n))
    J[0] = J0
    for k in range(T - 1):
        D11 = np.einsum("mji,jk,mkl->il", F[:, k], Qi, F[:, k]) / len(F)
        D12 = -F[:, k].mean(axis=0).T @ Qi
        D22 = Qi + np.einsum("mji,jk,mkl->il", H[:, k + 1], Ri, H[:, k + 1]) / len(H)
        J[k + 1] = D22 - D12.T @ np.linalg.solve(J[k] + D11, D12)
        J[k + 1] = 0.5 * (J[k + 1] + J[k + 1].T)
    return J


def walk_intensity(torque: np.ndarray, time: np.ndarray, bandwidth: float = BANDWIDTH) -> float:
    """Return the intensity q [N·m/√s] of the random walk that changes as much as a torque does, up to a bandwidth.

    q² = mean of (τ(t + h) − τ(t))²/h over the record, held at both ends, with h = 1/(2·bandwidth). A walk's changes grow with
    the time between them, q²·h, and any h gives its q. A smooth torque's grow with h², so that increments of single samples
    would say the less, the faster it is sampled.

    Args:
        torque: Shape (n,) [N·m]. time: Shape (n,), evenly spaced [s].
        bandwidth: [Hz]; half the sample rate at most.
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

    Args:
        time: Shape (n,) [s].
        states: Shape (n, SIZE), the true states, columns `joint_model.STATES`.
        current: Shape (n,), true motor current [A]. command: in force from a sample to the next [A].
        record: Shape (1,), the joint's parameters.
        noise: of the encoders.
        intensity: of the external torque's random walk [N·m/√s]; ≥ 0.
        temperature: Shape (n,), of the gear [°C]; by default the one that the joint's friction is stated for.
        others: Shape (k,), the record with one number of k each a standard deviation off: not known better than that, and
            independent of one another. By default everything is known exactly.

    Raises:
        InputError: an intensity that is none, or shapes that do not fit.
    """
    joint = KnownJoint(record, noise)
    if not (np.isfinite(intensity) and intensity >= 0.0):
        raise InputError(f"bound: intensity [N·m/√s]: expected a finite number ≥ 0, got {intensity!r}")
    if states.shape != (len(time), SIZE):
        raise InputError(f"bound: states: expected shape ({len(time)}, {SIZE}), got {states.shape}")
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
    unmoved, every = np.zeros(n), np.arange(n)  # the bound is one of covariances alone
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
            x[LINK] += 1e-5
            slope = (model.read_link(x, time[k], p) - reading) / 1e-5
            x[LINK] -= 1e-5
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
    """Write the Jacobian of a step at a true state into F, shape (m, m + k): central differences of the states, secants of the k
    other records.

    Their steps are a hundredth of what an estimator takes: near rest a longer one would reach across the kink of
    friction's |w| and show an instability that is not there.
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


def random_walk_bound(W, V, P0: float) -> np.ndarray:
    """Return the bound, shape (T,), for a random walk seen directly: x(k+1) = x(k) + w, y = x + v, variances W and V(k).

    This is the limit of the paper's model, F = H = 1, which knows no dynamics. For constant W, V it settles at
    `steady_variance`.

    Args:
        W: variance per step. V: Shape (T,), positive. P0: variance at step 0.
    """
    V = np.ascontiguousarray(V, dtype=np.float64)
    if not (np.all(V > 0.0) and W >= 0.0 and P0 >= 0.0):
        raise InputError("bound: expected W ≥ 0, P0 ≥ 0 and V > 0 everywhere")
    out = np.empty(len(V))
    _random_walk(float(W), V, float(P0), out)
    return out


@kernel
def _random_walk(W, V, P, out):
    out[0] = P
    for k in range(1, len(V)):
        P += W
        P *= V[k] / (P + V[k])
        out[k] = P


def steady_variance(W: float, V: float) -> float:
    """Return the steady filtered variance of a random walk: the positive root of P² + W P − W V = 0."""
    return 0.5 * (-W + np.sqrt(W * W + 4.0 * W * V))
