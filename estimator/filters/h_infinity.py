"""Fixed-γ H∞ filter in Simon's form on the constant-rate torque model ("Optimal State Estimation", 2006, Eq. 11.89).

    K = P (I − θ S̄ P + HᵀV⁻¹H P)⁻¹ HᵀV⁻¹      x⁺ = x + K (y − H x)      P⁺ = P (I − θ S̄ P + HᵀV⁻¹H P)⁻¹

with S̄ = diag(1, 0), which weights the torque, and θ = γ⁻². A solution exists while P⁻¹ − θ S̄ + HᵀV⁻¹H > 0.

The paper's robust EKF, Eq. (18), is Σ = (P⁻¹ − γ⁻² LᵀL)⁻¹ followed by a Kalman update: for S̄ = LᵀL the *same
recursion*, P⁺⁻¹ = Σ⁻¹ + HᵀV⁻¹H. The condition differs: Eq. (18) needs P⁻¹ > γ⁻² LᵀL before the measurement. So does
the model: two states instead of one. A test runs both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models.kernels import kernel
from ...models.step import Step, step_of
from ..tuning_parameters import TuningParameter
from .kalman import ACCELERATION, MEMORY, OUT, SETTINGS, TorqueFilter, innovation, write_out

_NO_SOLUTION = 2


@kernel
def correct(f, e, V, theta):
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


@step_of(MEMORY, SETTINGS, OUT)
def _step(m, s, p, c, o):
    e = innovation(m, s, p, c)
    S = correct(m.filter, e, c.V, c.first) if s.interval != 0.0 else 0.0
    if S < 0.0:
        return _NO_SOLUTION
    return write_out(m.filter, e, S, o)


@dataclass(frozen=True)
class HInfinity(TorqueFilter):
    """Fixed-γ H∞ filter."""

    name: str = "h_infinity"
    # attenuation γ in standard deviations of the measurement [√V]; infinity is the Kalman filter. Near 1 the gain is
    # near 1, too, and the filter returns the measurement.
    gamma: float = 2.0
    tuning: ClassVar[tuple[TuningParameter, ...]] = (ACCELERATION, TuningParameter("gamma", 1.05, 100.0))
    description: ClassVar[str] = "H∞ filter of the compliance model's torque and its rate (Simon 2006)"
    compiled: ClassVar[Step] = _step

    def _own(self, V: float) -> tuple[float, float]:
        return 1.0 / (self.gamma**2 * V), 0.0

    def reason(self, status: int, out: np.ndarray) -> str:
        if status == _NO_SOLUTION:
            return "γ is too small: no H∞ filter attains it"
        return super().reason(status, out)


ESTIMATORS = (HInfinity(),)
