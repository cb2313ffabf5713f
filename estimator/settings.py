"""What a person chooses of a filter, and where the defaults come from.

The paper gives neither W, V, ρ, k nor P(0). The defaults here are for the paper's one-state filter at 1 kHz on a
joint like the test joint; `measurement_variance` makes V from any joint's sensors.

**V** = 0.1² (N·m)². Quantisation of the motor encoder (4096 counts/rev: 4.4e-6 rad at the output), of the link
    encoder (20 bit: 1.7e-6 rad) and its noise (1.5e-6 rad) give 5.0e-6 rad, times K2 = 9400 N·m/rad: 0.047 N·m. The
    torque command that stands for Tw carries the encoder's counts through the velocity feedback: 0.9e-3 N·m rms at
    no load, where the wave generator is softest (1/(N·Kw0)), give another 7.7e-6 rad or 0.06 N·m: the raw model is
    then 0.076 N·m rms off in the shipped no-load scenario. V is 1.6 times that variance: with V matched, P̄_Y
    exceeds P_Y half of the time by chance, and α = 1 would be robust half of the time with nothing to be robust to.
**W** = 0.01² (N·m)² per step of 1 ms: the torque as a random walk. A walk of σ per step covers 10 ms with 3.2 σ:
    0.03 N·m, the change in 10 ms of a load of 9 N·m that swings at 0.35 rad/s. The steady gain is then 0.095, the
    time constant 10 ms. Faster changes are what robust mode is for.
**P0** = V: at the start X̂ = Y(0), so the estimate's error is the measurement's.
**ρ** = 9: P̄_Y forgets with ρ/(ρ+1) = 0.9 per step, a memory of 10 ms. At matched noise P̄_Y/P_Y then scatters by
    √(2/(2ρ+1)) = 0.32 about 1: short enough to catch a push in a few steps, long enough not to answer one sample.
**k** = 1/16 1/(N·m)²: α exceeds 1 above 4 N·m, a quarter of the rated torque (also the first knee), and is 16 at
    rated torque: an innovation must then have four times the standard deviation that P_Y gives it.
**γ** = 0.12 N·m for the fixed-γ rule. For one state P(k|k-1) ≤ max(V, P0) + W = 0.0101 always, and Eq. (18) needs
    γ² > P(k|k-1): 0.0144 leaves Σ = 1.1 P in steady state.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..models.errors import InputError
from .gain import GAIN, RULES
from .knobs import Knob

_RANGES = {
    # field: unit, lowest, may it be the lowest, may it be infinite
    "gamma": ("N·m", 0.0, False, True),
    "k": ("1/(N·m)²", 0.0, True, False),
    "rho": ("1", 0.0, True, False),
    "W": ("(N·m)² per step", 0.0, True, False),
    "V": ("(N·m)²", 0.0, False, False),
    "P0": ("(N·m)²", 0.0, True, False),
    "L": ("1", 0.0, True, False),
}
_CHOICES = {
    "rule": tuple(RULES),
    "alpha": ("max", "printed"),
    "memory": ("source", "printed"),
    "covariance": ("unadjusted", "adjusted"),
}


@dataclass(frozen=True)
class FilterSettings:
    """The choices of one torque filter (F = H = 1 unless a `FilterModel` says otherwise). Defaults: see the module.

    Attributes:
        name: how results call it; the rule by default.
        rule: `ekf`, `robust` (Eq. 18, fixed γ), `arekf` (Eq. 19, α = 1) or `rarekf` (Eq. 19, α of the load).
        gamma: attenuation factor γ of Eq. (18) [N·m]; infinity is the EKF.
        k: of Eq. (23) [1/(N·m)²].
        rho: forgetting factor ρ of Eq. (20) [1].
        W: process noise variance of one step [(N·m)²].
        V: measurement noise variance [(N·m)²].
        P0: variance of the first estimate [(N·m)²].
        L: L = scale·I of Eq. (18) [1].
        alpha: Eq. (23) as `max(1, kω²)`, or as `printed`: `min(kω², 1)`, which at zero load ends in `FilterDiverged`.
        memory: Eq. (20) carries P̄_Y(k-1) forward as its `source` does, or P_Y(k-1) of Eq. (14) as `printed`.
        covariance: P_Y in Eqs. (19), (25) is that of the `unadjusted` prediction, or the `adjusted` one of Eq. (14),
            which contains the Σ it decides: f_α then solves both equations at once.

    Raises:
        InputError: a value of the wrong kind or out of range; names field, unit, what was expected and what came.
    """

    name: str = ""
    rule: Literal["ekf", "robust", "arekf", "rarekf"] = "rarekf"
    gamma: float = 0.12
    k: float = 1.0 / 16.0
    rho: float = 9.0
    W: float = 1.0e-4
    V: float = 1.0e-2
    P0: float = 1.0e-2
    L: float = 1.0
    alpha: Literal["max", "printed"] = "max"
    memory: Literal["source", "printed"] = "source"
    covariance: Literal["unadjusted", "adjusted"] = "unadjusted"

    def __post_init__(self) -> None:
        label = f"filter {self.name!r}" if self.name else "filter"
        for field, known in _CHOICES.items():
            value = getattr(self, field)
            if value not in known:
                close = difflib.get_close_matches(str(value), known, n=1)
                hint = f"; did you mean {close[0]!r}?" if close else ""
                raise InputError(f"{label}: {field}: expected one of {list(known)}, got {value!r}{hint}")
        for field, (unit, lowest, inclusive, infinite) in _RANGES.items():
            value = getattr(self, field)
            try:
                if isinstance(value, (bool, str)):
                    raise TypeError
                number = float(value)
            except (TypeError, ValueError):
                raise InputError(f"{label}: {field} [{unit}]: expected a number, got {value!r}") from None
            good = number >= lowest if inclusive else number > lowest
            if not good or (math.isinf(number) and not infinite):
                wanted = f"a {'' if infinite else 'finite '}number {'≥' if inclusive else '>'} {lowest:g}"
                raise InputError(f"{label}: {field} [{unit}]: expected {wanted}, got {value!r}")
            object.__setattr__(self, field, number)
        if not isinstance(self.name, str):
            raise InputError(f"filter: name: expected text, got {self.name!r}")
        if not self.name:
            object.__setattr__(self, "name", self.rule)

    def gain(self, load_index: int = 0) -> np.ndarray:
        """Return the gain rule as a record for compiled code, shape (1,) of `gain.GAIN`.

        Args:
            load_index: which state is the torque load ω.
        """
        record = np.zeros(1, GAIN)
        record["rule"] = RULES[self.rule]
        record["inverse_gamma_squared"] = self.gamma**-2
        record["k"] = self.k
        record["rho"] = self.rho
        record["printed_alpha"] = self.alpha == "printed"
        record["printed_memory"] = self.memory == "printed"
        record["adjusted_covariance"] = self.covariance == "adjusted"
        record["load_index"] = load_index
        return record


_W, _V = Knob("W", 1e-8, 1.0), Knob("V", 1e-6, 10.0)
_RHO, _K = Knob("rho", 0.05, 200.0), Knob("k", 1e-4, 10.0)
_KNOBS = {
    # W first: it is the knob that trades noise for delay. An EKF's gain depends on W/V alone, so V stays.
    "ekf": (_W,),
    "robust": (_W, _V, Knob("gamma", 1e-2, 10.0)),
    "arekf": (_W, _V, _RHO),
    "rarekf": (_W, _V, _RHO, _K),
}


def knobs_of(settings: FilterSettings) -> tuple[Knob, ...]:
    """What may be tuned of a filter of its rule; P0 goes with V (`scenarios.offline`)."""
    return _KNOBS[settings.rule]


def paper_filters(**changes) -> tuple[FilterSettings, FilterSettings, FilterSettings]:
    """Return EKF, AREKF and RAREKF with the same numbers; `changes` are fields of `FilterSettings`."""
    return tuple(FilterSettings(rule=rule, **changes) for rule in ("ekf", "arekf", "rarekf"))


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
    """Return the variance V [(N·m)²] of the compliance model's torque that its sensors' noise leaves.

    Linear propagation through Eqs. (6), (7): `V = K²·(σm²/N² + σl² + (σT/(N·Kw))²)`. Quantisation of step q is uniform:
    variance q²/12.

    Args:
        stiffness: slope K of Eq. (7) [N·m/rad]; K2 is the middle one.
        motor_resolution: one count of the motor encoder [rad, motor side].
        link_resolution: one count of the link encoder [rad].
        link_noise: its noise [rad rms].
        motor_noise: noise of the motor encoder [rad rms, motor side].
        ratio: gear ratio N.
        torque_noise: noise of what Tw is approximated by [N·m rms, motor side]: zero for an exact command, Kt·(current
            noise) for a measured current.
        wave_generator_stiffness: Kw0 [N·m/rad, motor side]; at load, Eq. (3), it is higher and the noise smaller.

    Raises:
        InputError: a negative or non-finite argument, or a stiffness or ratio of zero.
    """
    arguments = {
        "stiffness [N·m/rad]": stiffness, "motor_resolution [rad]": motor_resolution,
        "link_resolution [rad]": link_resolution, "link_noise [rad]": link_noise,
        "motor_noise [rad]": motor_noise, "ratio [1]": ratio, "torque_noise [N·m]": torque_noise,
    }  # fmt: skip
    for field, value in arguments.items():
        positive = field.startswith(("stiffness", "ratio"))
        if not (math.isfinite(value) and value >= 0.0) or (positive and value == 0.0):
            wanted = "> 0" if positive else "≥ 0"
            raise InputError(f"measurement_variance: {field}: expected a finite number {wanted}, got {value!r}")
    if not wave_generator_stiffness > 0.0:
        raise InputError(
            f"measurement_variance: wave_generator_stiffness [N·m/rad]: expected a number > 0, "
            f"got {wave_generator_stiffness!r}"
        )
    motor = (motor_resolution**2 / 12.0 + motor_noise**2) / ratio**2
    link = link_resolution**2 / 12.0 + link_noise**2
    wave_generator = (torque_noise / (ratio * wave_generator_stiffness)) ** 2
    return stiffness**2 * (motor + link + wave_generator)
