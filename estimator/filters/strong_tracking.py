"""Strong tracking filter on the constant-rate torque model (Zhou & Frank, "Strong tracking filtering of nonlinear
time-varying stochastic systems with coloured noise", Int. J. Control 65, 1996).

A fading factor λ ≥ 1 on the propagated covariance keeps the innovations orthogonal when the torque jumps:

    P⁻ = λ F P Fᵀ + W      λ = max(1, tr N / tr M)      M = H F P Fᵀ Hᵀ      N = V₀ − H W Hᵀ − β V
    V₀ = (ρ V₀ + e eᵀ)/(1 + ρ), V₀ = e₁ e₁ᵀ at first
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ...models.kernels import kernel
from ...models.step import Step, step_of
from ..compliance import measure
from ..tuning_parameters import TuningParameter
from .kalman import ACCELERATION, MEMORY, OUT, SETTINGS, TorqueFilter, correct, start, write_out

_NOTHING_YET = -1.0


@kernel
def predict(f, y, V0, h, c):
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
    y = measure(m.torsion, s, p).torque
    f, e, S = m.filter, 0.0, 0.0
    if s.interval == 0.0:
        start(f, y, c)
        m.expected = _NOTHING_YET
    else:
        e, m.expected = predict(f, y, m.expected, s.interval, c)
        S = correct(f, e, c.V)
    return write_out(f, e, S, o)


@dataclass(frozen=True)
class StrongTracking(TorqueFilter):
    """Strong tracking filter."""

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
    compiled: ClassVar[Step] = _step

    def _own(self, V: float) -> tuple[float, float]:
        return self.forget, self.soften


ESTIMATORS = (StrongTracking(),)
