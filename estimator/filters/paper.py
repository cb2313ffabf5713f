"""The paper's filters: EKF, robust EKF (REKF), AREKF and RAREKF on the compliance model's torque (Shi & Liu, Section
IV).

One state, the flexspline torque as a random walk, F = H = 1; the measurement Y is Eq. (7) applied to the encoders
(`compliance`). One recursion (`recursion`), four rules. The paper gives neither W, V, ρ, k nor P(0). The defaults are
for the test joint at 1 kHz; `scaled` converts them to any joint.

**V** = 0.1² (N·m)². Quantisation of the motor encoder (4096 counts/rev: 4.4e-6 rad at the output), of the link
encoder (20 bit: 1.7e-6 rad) and its noise (1.5e-6 rad) give 5.0e-6 rad, times K2 = 9400 N·m/rad: 0.047 N·m. The
torque command used for Tw contains the encoder's counts through the velocity feedback: 0.9e-3 N·m rms at no load,
where the wave generator is softest (1/(N·Kw0)), give another 7.7e-6 rad or 0.06 N·m. The raw model's error is then
0.076 N·m rms in the shipped no-load scenario. V is 1.6 times that variance: with V matched, P̄_Y exceeds P_Y half of
the time by chance, and α = 1 would be robust half of the time without reason.

**W** = 0.01² (N·m)² per step of 1 ms: the torque as a random walk. A walk of σ per step covers 10 ms with 3.2 σ: 0.03
N·m, the change in 10 ms of a load of 9 N·m that swings at 0.35 rad/s. The steady gain is then 0.095, the time
constant 10 ms. Robust mode is for faster changes.

**P0** = V: at the start X̂ = Y(0), so the estimate's error is the measurement's.

**ρ** = 9: P̄_Y forgets with ρ/(ρ+1) = 0.9 per step, a memory of 10 ms. At matched noise P̄_Y/P_Y then scatters by
√(2/(2ρ+1)) = 0.32 about 1: short enough to follow a push in a few steps, long enough to ignore one sample.

**k** = 1/16 1/(N·m)²: α exceeds 1 above 4 N·m, a quarter of the rated torque (also T1), and is 16 at rated torque: an
innovation must then have four times the standard deviation of P_Y.

**γ** = 0.12 N·m for the fixed-γ rule. For one state P(k|k-1) ≤ max(V, P0) + W = 0.0101 always, and Eq. (18) needs γ²
> P(k|k-1): 0.0144 leaves Σ = 1.1 P in steady state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from ...models.errors import InputError, nearest
from ...models.parameters import floats
from ...models.step import Step, step_of
from .. import recursion
from ..compliance import TORSION, measure, measurement_variance, torque_variance
from ..estimator import CausalEstimator, KnownJoint, SensorNoise, TuningParameter
from ..recursion import ALPHAS, RULES, SETTINGS, STATE

_UNITS = {
    "gamma": "N·m", "k": "1/(N·m)²", "rho": "1", "W": "(N·m)² per step", "V": "(N·m)²", "P0": "(N·m)²", "L": "1",
}  # fmt: skip
"""Units of the numbers, which are finite and ≥ 0: gamma and V are positive, gamma may be infinite."""
_CHOICES = {
    "rule": tuple(RULES),
    "alpha": tuple(ALPHAS),
    "memory": ("source", "printed"),
    "covariance": ("unadjusted", "adjusted"),
}

MEMORY = floats(("torsion", TORSION), ("filter", STATE))
OUT = floats(*(STATE.names or ()), "measurement")


@step_of(MEMORY, SETTINGS, OUT)
def _step(m, s, p, c, o):
    y = measure(m.torsion, s, p).torque
    f, status = m.filter, recursion.OK
    if s.interval == 0.0:
        recursion.start(f, y, c)
    else:
        status = recursion.update(f, y, c)
    o.torque, o.variance, o.innovation = f.torque, f.variance, f.innovation
    o.innovation_variance, o.unadjusted_innovation_variance = f.innovation_variance, f.unadjusted_innovation_variance
    o.innovation_memory_variance, o.alpha, o.f_alpha = f.innovation_memory_variance, f.alpha, f.f_alpha
    o.robust, o.nis, o.measurement = f.robust, f.nis, y
    return status


@dataclass(frozen=True)
class PaperFilter(CausalEstimator):
    """One of the paper's filters. Defaults: see the module. Raises `InputError`: a value of the wrong kind or out of
    range, with field and unit."""

    name: str = ""  # in results; the rule by default
    # `ekf`, `robust` (Eq. 18, fixed γ), `arekf` (Eq. 19, α = 1) or `rarekf` (Eq. 19, α of the load)
    rule: Literal["ekf", "robust", "arekf", "rarekf"] = "rarekf"
    gamma: float = 0.12  # attenuation factor γ of Eq. (18) [N·m]; infinity is the EKF
    k: float = 1.0 / 16.0  # of Eq. (23) [1/(N·m)²]
    rho: float = 9.0  # forgetting factor ρ of Eq. (20) [1]
    W: float = 1.0e-4  # process noise variance of one step [(N·m)²]
    V: float = 1.0e-2  # measurement noise variance [(N·m)²]
    P0: float = 1.0e-2  # variance of the first estimate [(N·m)²]
    L: float = 1.0  # L = scale·I of Eq. (18) [1]
    # Eq. (23) as `max(1, kω²)`; as `printed`, `min(kω², 1)`, which ends in `FilterDiverged` at zero load; or `inverse`,
    # `max(1, 1/(kω²))`: never robust without load, and easily under it
    alpha: Literal["max", "printed", "inverse"] = "max"
    # Eq. (20) uses P̄_Y(k-1) as in its `source`, or P_Y(k-1) of Eq. (14) as `printed`
    memory: Literal["source", "printed"] = "source"
    # P_Y in Eqs. (19), (25) is that of the `unadjusted` prediction, or the `adjusted` one of Eq. (14), which contains
    # the Σ that it decides: f_α then solves both equations at once
    covariance: Literal["unadjusted", "adjusted"] = "unadjusted"
    reads_command: ClassVar[bool] = True
    compiled: ClassVar[Step] = _step

    def __post_init__(self) -> None:
        label = f"filter {self.name!r}" if self.name else "filter"
        for field, known in _CHOICES.items():
            value = getattr(self, field)
            if value not in known:
                hint = nearest(str(value), known)
                raise InputError(f"{label}: {field}: expected one of {list(known)}, got {value!r}{hint}")
        for field, unit in _UNITS.items():
            value, positive, infinite = getattr(self, field), field in ("gamma", "V"), field == "gamma"
            try:
                if isinstance(value, (bool, str)):
                    raise TypeError
                number = float(value)
            except (TypeError, ValueError):
                raise InputError(f"{label}: {field} [{unit}]: expected a number, got {value!r}") from None
            if not (number > 0.0 if positive else number >= 0.0) or (math.isinf(number) and not infinite):
                wanted = f"a {'' if infinite else 'finite '}number {'>' if positive else '≥'} 0"
                raise InputError(f"{label}: {field} [{unit}]: expected {wanted}, got {value!r}")
            object.__setattr__(self, field, number)
        if not isinstance(self.name, str):
            raise InputError(f"filter: name: expected text, got {self.name!r}")
        if not self.name:
            object.__setattr__(self, "name", self.rule)

    @property
    def description(self) -> str:  # type: ignore[override]  # its own for every rule
        """Description with its source."""
        return _DESCRIPTIONS[self.rule]

    @property
    def tuning(self) -> tuple[TuningParameter, ...]:  # type: ignore[override]
        """Tuning parameters; P0 follows V."""
        return _TUNING[self.rule]

    def scaled(self, joint: KnownJoint, interval: float) -> PaperFilter:
        """Return the same filter for a joint sampled every `interval` [s]; unchanged, to the bit, for the test joint
        at 1 kHz.

        V and P0 scale with the variance of the compliance model by the joint's sensors, W with the square of the
        rated torque and with the interval, k with the inverse square of the rated torque.
        """
        noise = torque_variance(joint) / _TEST_JOINT
        torque, step = joint.rated_torque / 16.0, round(interval / 1e-3, 6)
        scaled = self.with_noise(self.W * torque**2 * step, self.V * noise)
        return replace(scaled, P0=self.P0 * noise, k=self.k / torque**2)

    def with_noise(self, W: float, V: float) -> PaperFilter:
        """Return the same filter with other noise. γ² grows with V + W, an upper bound of P(k|k-1), so that Eq. (18)
        still holds."""
        return replace(self, W=W, V=V, gamma=self.gamma * math.sqrt((V + W) / (self.V + self.W)))

    def record(self) -> np.ndarray:
        """Return the numbers for compiled code, shape (1,), of `recursion.SETTINGS`."""
        found = np.zeros(1, SETTINGS)
        for field in ("W", "V", "P0", "L", "k", "rho"):
            found[field] = getattr(self, field)
        found["rule"], found["alpha"] = RULES[self.rule], ALPHAS[self.alpha]
        found["inverse_gamma_squared"] = self.gamma**-2
        found["printed_memory"] = self.memory == "printed"
        found["adjusted_covariance"] = self.covariance == "adjusted"
        return found

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        return self.record()

    def reason(self, status: int, out: np.ndarray) -> str:
        return self.failure(status, out[0], self.L**2 * (out[1] + self.W))

    def failure(self, status: int, torque: float, P: float) -> str:
        """Return why an update failed, in words. `torque`: the last estimate [N·m], P: the largest eigenvalue of
        LPLᵀ."""
        if status == recursion.GAMMA_TOO_SMALL:
            return (
                f"P⁻¹ - γ⁻²LᵀL of Eq. (18) is not positive definite: gamma = {self.gamma:g} N·m "
                f"is too small, expected more than {math.sqrt(P):g} N·m here"
            )
        if status == recursion.FACTOR_OVERFLOW and self.alpha == "printed":
            return (
                "f_α of Eq. (25) overflows: α = kω² as printed in Eq. (23) goes to zero with the load (the last estimate is "
                f"{torque:g} N·m), and 1/α to infinity; alpha: 'max' is the reading that works"
            )
        if status == recursion.FACTOR_OVERFLOW:
            return (
                "f_α of Eq. (25) overflows: the innovations are out of all proportion to P_Y; check W, V and the "
                "measurements' unit"
            )
        if status == recursion.NOT_POSITIVE:
            return (
                "P_Y of Eq. (14) is not finite and positive definite: W or F is too large, or P has grown without bound"
            )
        return "the measurement or the estimate is not finite"


_W, _V = TuningParameter("W", 1e-8, 1.0), TuningParameter("V", 1e-6, 10.0)
_RHO, _K = TuningParameter("rho", 0.05, 200.0), TuningParameter("k", 1e-4, 10.0)
_TUNING = {
    # W first: it trades noise for delay. An EKF's gain depends on W/V alone, so V stays.
    "ekf": (_W,),
    "robust": (_W, _V, TuningParameter("gamma", 1e-2, 10.0)),
    "arekf": (_W, _V, _RHO),
    "rarekf": (_W, _V, _RHO, _K),
}
_DESCRIPTIONS = {
    "ekf": "Kalman filter of the compliance model's torque as a random walk (Shi & Liu, Eqs. 10-17)",
    "robust": "robust Kalman filter of the compliance model's torque with a fixed attenuation (Shi & Liu, Eq. 18)",
    "arekf": "adaptive robust Kalman filter: robust while innovations are larger than expected (Shi & Liu, Eqs. 19-22)",
    "rarekf": "redundant adaptive robust Kalman filter: AREKF that is harder to make robust under load (Shi & Liu, Eqs. 19-25)",
}
_NOISE = SensorNoise()
_TEST_JOINT = measurement_variance(
    9400.0, _NOISE.motor_resolution, _NOISE.link_resolution, _NOISE.link_noise, _NOISE.motor_noise, ratio=100.0,
    torque_noise=0.0603 * _NOISE.current_noise, wave_generator_stiffness=1.14,
)  # fmt: skip

ESTIMATORS = (
    PaperFilter("EKF", "ekf"),
    PaperFilter("AREKF", "arekf"),
    PaperFilter("RAREKF", "rarekf"),
    PaperFilter("REKF", "robust"),
)
