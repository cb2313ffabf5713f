"""Filters on the compliance model with a constant-rate torque: states torque and its rate.

    x = [T, T']     F = [[1, h], [0, 1]]     W = q·[[h³/3, h²/2], [h²/2, h]]     y = T + v,  v ~ (0, V)

the continuous white-noise-acceleration model (Bar-Shalom, Li & Kirubarajan 2001, section 6.2). They differ in their gain:
`kalman`, `h_infinity`, `huber` and `strong_tracking`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models.kernels import kernel
from ...models.parameters import floats
from ...models.step import NOT_FINITE, OK, Step, step_of
from ..compliance import TORSION, measure, torque_variance
from ..estimator import CausalEstimator, KnownJoint, TuningParameter

STATE = floats("torque", "torque_rate", "P00", "P01", "P11")
"""Torque [N·m], its rate [N·m/s] and their covariance."""
MEMORY = floats(("torsion", TORSION), ("filter", STATE), "expected")
"""`expected`: squared innovation in the memory of a fading filter [(N·m)²]."""
SETTINGS = floats("rule", "q", "V", "rate_variance", "first", "second")
"""Gain rule, q [(N·m)²/s³], V [(N·m)²], variance of the first rate; two tuning parameters of the rule."""
OUT = floats("torque", "variance", "innovation", "innovation_variance", "torque_rate")
KALMAN, H_INFINITY, HUBER, FADING = range(4)
ACCELERATION = TuningParameter("acceleration", 1e-3, 1e3)
_NO_SOLUTION = 2  # status: no H∞ filter attains γ
_TOLERANCE, _MOST = 1e-9, 50  # of Huber's iterations
_NOTHING_YET = -1.0  # squared innovation expected by a fading filter before its first


@kernel
def predict(f, h, q):
    """Predict a record of `STATE` over `h` [s], in place; q [(N·m)²/s³]."""
    f.torque += h * f.torque_rate
    f.P00 += h * (2.0 * f.P01 + h * f.P11) + q * h**3 / 3.0
    f.P01 += h * f.P11 + q * h**2 / 2.0
    f.P11 += q * h


@kernel
def correct(f, e, V):
    """Update with the innovation `e` [N·m] of a measurement with variance V, in place; returns its variance S."""
    S = f.P00 + V
    k0, k1 = f.P00 / S, f.P01 / S
    f.torque += k0 * e
    f.torque_rate += k1 * e
    f.P11 -= k1 * f.P01
    f.P01 *= 1.0 - k0
    f.P00 *= 1.0 - k0
    return S


@kernel
def correct_h_infinity(f, e, V, theta):
    """Update with the innovation `e` [N·m], in place; return V + HΣHᵀ with Σ of Eq. (18), or −1 without a solution."""
    # P (I + c HᵀH P)⁻¹ with c = 1/V − θ, as S̄ = HᵀH: Sherman and Morrison.
    c = 1.0 / V - theta
    bottom = 1.0 + c * f.P00
    if not bottom > 0.0:
        return -1.0
    p00, p01 = f.P00, f.P01
    f.P00 = p00 / bottom
    f.P01 = p01 / bottom
    f.P11 -= c * p01 * p01 / bottom
    f.torque += f.P00 / V * e
    f.torque_rate += f.P01 / V * e
    before = 1.0 - theta * p00
    return V + p00 / before if before > 0.0 else np.inf


@kernel
def correct_huber(f, e, V, k, tolerance, most):
    """Update with the innovation `e` [N·m] of a measurement of variance V, in place; returns its variance, last weights."""
    # A is lower triangular and the measurement depends on the first state only: the regression is one-dimensional in u0, the
    # whitened first state; u1, the second, follows the prediction and keeps its weight 1.
    a00 = math.sqrt(f.P00)
    a10 = f.P01 / a00
    rest = f.P11 - a10 * a10
    u, prior, weight = 0.0, 1.0, 1.0
    for _ in range(most):
        r = (e - a00 * u) / math.sqrt(V)
        weight = k / abs(r) if abs(r) > k else 1.0
        prior = k / abs(u) if abs(u) > k else 1.0
        before = u
        u = weight * a00 * e / (weight * a00 * a00 + prior * V)
        if abs(u - before) < tolerance:
            break
    f.torque += a00 * u
    f.torque_rate += a10 * u
    left = V / (weight * a00 * a00 + prior * V)  # variance of u
    f.P00 = a00 * a00 * left
    f.P01 = a00 * a10 * left
    f.P11 = a10 * a10 * left + rest
    return a00 * a00 / prior + V / weight


@kernel
def predict_fading(f, y, V0, h, c):
    """Predict with the fading factor; returns the innovation [N·m] and V₀."""
    f.torque += h * f.torque_rate
    e = y - f.torque
    rho, beta = c.first, c.second
    V0 = e**2 if V0 == _NOTHING_YET else (rho * V0 + e**2) / (1.0 + rho)
    f.P00 += h * (2.0 * f.P01 + h * f.P11)
    f.P01 += h * f.P11
    fade = max(1.0, (V0 - c.q * h**3 / 3.0 - beta * c.V) / f.P00)
    f.P00 = fade * f.P00 + c.q * h**3 / 3.0
    f.P01 = fade * f.P01 + c.q * h**2 / 2.0
    f.P11 = fade * f.P11 + c.q * h
    return e, V0


@step_of(MEMORY, SETTINGS, OUT)
def _step(m, s, p, c, o):
    f, y, e, S = m.filter, measure(m.torsion, s, p).torque, 0.0, 0.0
    if s.interval == 0.0:  # at rest
        f.torque, f.torque_rate, m.expected = y, 0.0, _NOTHING_YET
        f.P00, f.P01, f.P11 = c.V, 0.0, c.rate_variance
    elif c.rule == FADING:
        e, m.expected = predict_fading(f, y, m.expected, s.interval, c)
        S = correct(f, e, c.V)
    else:
        predict(f, s.interval, c.q)
        e = y - f.torque
        if c.rule == H_INFINITY:
            S = correct_h_infinity(f, e, c.V, c.first)
        elif c.rule == HUBER:
            S = correct_huber(f, e, c.V, c.first, _TOLERANCE, _MOST)
        else:
            S = correct(f, e, c.V)
    if S < 0.0:
        return _NO_SOLUTION
    o.torque, o.variance, o.innovation, o.innovation_variance, o.torque_rate = f.torque, f.P00, e, S, f.torque_rate
    return OK if math.isfinite(f.torque + f.P00) else NOT_FINITE


@dataclass(frozen=True)
class TorqueFilter(CausalEstimator):
    """The standard Kalman filter, and the base of the others."""

    name: str = "kalman"
    # intensity √q of the torque's second derivative [T2/s² per √Hz]. The steady filter's natural frequency is
    # (q/(V·h))^(1/4): with 10·12 N·m and V = 0.05² at 1 kHz, 274 rad/s.
    acceleration: float = 10.0
    rate: float = 1.0  # standard deviation of the first rate [T2/s]
    tuning: ClassVar[tuple[TuningParameter, ...]] = (ACCELERATION,)
    description: ClassVar[str] = "Kalman filter of the compliance model's torque and its rate (Bar-Shalom et al. 2001)"
    reads_command: ClassVar[bool] = True
    rule: ClassVar[int] = KALMAN
    compiled: ClassVar[Step] = _step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        scale, V = float(joint.p["T2"]), torque_variance(joint)
        q, rate_variance = (self.acceleration * scale) ** 2, (self.rate * scale) ** 2
        return np.array([(self.rule, q, V, rate_variance, *self._own(V))], SETTINGS)

    def _own(self, V: float) -> tuple[float, float]:
        return 0.0, 0.0


@dataclass(frozen=True)
class HInfinity(TorqueFilter):
    """Fixed-γ H∞ filter in Simon's form on the constant-rate torque model ("Optimal State Estimation", 2006, Eq. 11.89).

        K = P (I − θ S̄ P + HᵀV⁻¹H P)⁻¹ HᵀV⁻¹      x⁺ = x + K (y − H x)      P⁺ = P (I − θ S̄ P + HᵀV⁻¹H P)⁻¹

    with S̄ = diag(1, 0), which weights the torque, and θ = γ⁻². A solution exists while P⁻¹ − θ S̄ + HᵀV⁻¹H > 0.

    The paper's robust EKF, Eq. (18), is Σ = (P⁻¹ − γ⁻² LᵀL)⁻¹ followed by a Kalman update: for S̄ = LᵀL the *same
    recursion*, P⁺⁻¹ = Σ⁻¹ + HᵀV⁻¹H. The condition differs: Eq. (18) needs P⁻¹ > γ⁻² LᵀL before the measurement. So does
    the model: two states instead of one. A test runs both.
    """

    name: str = "h_infinity"
    # attenuation γ in standard deviations of the measurement [√V]; infinity is the Kalman filter. Near 1 the gain is
    # near 1, too, and the filter returns the measurement.
    gamma: float = 2.0
    tuning: ClassVar[tuple[TuningParameter, ...]] = (ACCELERATION, TuningParameter("gamma", 1.05, 100.0))
    description: ClassVar[str] = "H∞ filter of the compliance model's torque and its rate (Simon 2006)"
    rule: ClassVar[int] = H_INFINITY

    def _own(self, V: float) -> tuple[float, float]:
        return 1.0 / (self.gamma**2 * V), 0.0

    def reason(self, status: int, out: np.ndarray) -> str:
        if status == _NO_SOLUTION:
            return "γ is too small: no H∞ filter attains it"
        return super().reason(status, out)


@dataclass(frozen=True)
class Huber(TorqueFilter):
    """Huber's M-estimator in a Kalman filter on the constant-rate torque model (Karlgaard & Schaub, "Huber-based divided
    difference filtering", J. Guidance, Control and Dynamics 30, 2007).

    Each update is the regression of prediction and measurement, whitened by P⁻ = A Aᵀ and √V, on the state, with Huber's
    loss instead of the square,

        x⁺ = argmin Σ ρ(rᵢ),   r = [A⁻¹ (x − x⁻); (y − H x)/√V],   ρ(r) = r²/2 within ±k, k|r| − k²/2 beyond

    by iterated reweighting: weights ψᵢ = min(1, k/|rᵢ|) divide the variances. It protects from outliers of the
    measurement. A push is an outlier of the prediction: the less the measurement counts, the more slowly the filter
    follows.
    """

    name: str = "huber"
    # residual from which the loss is linear [standard deviations]; 1.345 is 95 % efficient at normal noise
    k: float = 1.345
    tuning: ClassVar[tuple[TuningParameter, ...]] = (ACCELERATION, TuningParameter("k", 0.3, 10.0))
    description: ClassVar[str] = "Kalman filter with Huber's loss instead of the square (Karlgaard & Schaub 2007)"
    rule: ClassVar[int] = HUBER

    def _own(self, V: float) -> tuple[float, float]:
        return self.k, 0.0


@dataclass(frozen=True)
class StrongTracking(TorqueFilter):
    """Strong tracking filter on the constant-rate torque model (Zhou & Frank, "Strong tracking filtering of nonlinear
    time-varying stochastic systems with coloured noise", Int. J. Control 65, 1996).

    A fading factor λ ≥ 1 on the propagated covariance keeps the innovations orthogonal when the torque jumps:

        P⁻ = λ F P Fᵀ + W      λ = max(1, tr N / tr M)      M = H F P Fᵀ Hᵀ      N = V₀ − H W Hᵀ − β V
        V₀ = (ρ V₀ + e eᵀ)/(1 + ρ), V₀ = e₁ e₁ᵀ at first
    """

    name: str = "strong_tracking"
    acceleration: float = 2.0  # as `TorqueFilter`, smaller: fading replaces process noise
    forget: float = 0.95  # ρ [1]: 0.95 as in the source, a memory of two samples
    # β ≥ 1 [1]: ratio of innovations to the expected ones that starts fading. A memory of two samples scatters widely:
    # a smaller ratio would fade at noise.
    soften: float = 7.0
    tuning: ClassVar[tuple[TuningParameter, ...]] = (
        ACCELERATION, TuningParameter("soften", 1.0, 100.0), TuningParameter("forget", 0.1, 50.0),
    )  # fmt: skip
    description: ClassVar[str] = (
        "strong tracking filter: its covariance fades when the torque jumps (Zhou & Frank 1996)"
    )
    rule: ClassVar[int] = FADING

    def _own(self, V: float) -> tuple[float, float]:
        return self.forget, self.soften


ESTIMATORS = (TorqueFilter(), HInfinity(), Huber(), StrongTracking())
