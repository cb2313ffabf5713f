"""Imperfections that every real joint has, each too small to be a cause: `challenge --real` puts them on top of a drawn joint.

Sizes are those of the test joint, scaled to others: torques with the rated torque, currents with what that torque draws,
angles of the transmission with its wind-up under that torque. Errors of encoders do not depend on the joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...models.joint import Joint
from ...models.joint_parts import Ripple, Vibration
from ...models.parameters import N_ORDERS
from .outside import sign

_TEST = (16.0, 100 * 0.0603, 9400.0)
"""Rated torque [N·m], N·Kt [N·m/A] and K2 [N·m/rad] of the test joint, for which the sizes are stated."""
_FRICTION_PER_KELVIN = -0.01
"""Change of friction with temperature by which a warming gear is simulated [1/K]."""


@dataclass(frozen=True)
class Imperfections:
    """One draw of what a real joint has."""

    values: dict[str, float]  # every number drawn, by name
    nominal: Joint  # with its sensors' imperfections, from which recordings are made
    warming: float  # of each recording's gear [K/s]
    jitter: float  # of the time stamps [s rms]

    def apply(self, record: np.ndarray) -> None:
        """Put what sits in the joint itself into a record, shape (1,), in place."""
        p, v = record[0], self.values
        for name in v.keys() & set(p.dtype.names or ()):
            p[name] = v[name]
        p["friction_temperature"] = _FRICTION_PER_KELVIN
        free = [k for k in range(N_ORDERS) if p["amplitude"][k] == 0]
        for slot, name, order in zip(free, ("sixth", "link"), (6.0, 1.0 / float(p["N"])), strict=False):
            p["order"][slot], p["amplitude"][slot] = order, v[f"kinematic_{name}"]
            p["phase"][slot] = v[f"kinematic_{name}_phase"]
        slot = int(np.flatnonzero(p["link_error_amplitude"] == 0)[-1])
        p["link_error_order"][slot], p["link_error_amplitude"][slot] = 2.0, v["link_encoder_second"]
        p["link_error_phase"][slot] = v["link_encoder_second_phase"]

    def whole(self, name: str, values: dict[str, float]) -> dict[str, float]:
        """What a joint has of a hidden effect, parameters by name: of an encoder's errors its own imperfection is part."""
        own = _OWN.get(name)
        if own is None or values.get("order", 2.0) != 2.0:
            return values
        pairs = ((values["amplitude"], values["phase"]), (self.values[own], self.values[f"{own}_phase"]))
        wave = sum(a * np.exp(1j * b) for a, b in pairs)
        return {**values, "amplitude": float(abs(wave)), "phase": float(np.angle(wave))}


_OWN = {"motor_encoder_eccentricity": "motor_eccentricity", "link_encoder_error": "link_encoder_second"}
"""Causes that add to an imperfection of the same kind (of link encoder errors: twice per turn), and what that is called."""


def imperfections(nominal: Joint, rng: np.random.Generator) -> Imperfections:
    """Draw the imperfections of a joint."""
    rated, K2 = nominal.numbers["rated_torque"].value, nominal.numbers["K2"].value
    constant = nominal.numbers["N"].value * nominal.numbers["Kt"].value
    torque = rated / _TEST[0]
    current = torque * _TEST[1] / constant
    angle = torque * _TEST[2] / K2
    u = rng.uniform
    turn = 2 * np.pi
    v = {
        "knee_width": u(0.2, 0.8) * nominal.numbers["T1"].value / nominal.numbers["K1"].value,
        "viscous_exponent": u(0.7, 0.9),
        "flexible_share": u(0.1, 0.3), "flexible_frequency": u(14, 25), "flexible_damping": u(0.01, 0.03),
        "warming": sign(rng) * u(0.0, 0.0015) / abs(_FRICTION_PER_KELVIN),
        "kinematic_sixth": angle * u(2e-6, 20e-6), "kinematic_sixth_phase": u(0, turn),
        "kinematic_link": angle * u(2e-6, 20e-6), "kinematic_link_phase": u(0, turn),
        "motor_eccentricity": u(0.2e-3, 1e-3), "motor_eccentricity_phase": u(0, turn),
        "motor_cyclic": u(0.1, 0.3),
        "link_encoder_second": u(5e-6, 15e-6), "link_encoder_second_phase": u(0, turn),
        "current_bandwidth": u(150, 300),
        "ripple_order": float(rng.integers(12, 25)), "ripple": current * u(2e-3, 6e-3), "ripple_phase": u(0, turn),
        "torque_delay": u(0.5e-3, 2e-3), "torque_flicker": torque * u(0.010, 0.030),
        "vibration_frequency": u(25, 55), "vibration": torque * u(0.005, 0.020),
        "crosstalk": 0.01 * nominal.mount().gravity_moment * sign(rng),
        "jitter": u(0.05e-3, 0.2e-3),
    }  # fmt: skip
    errors: dict[str, dict[str, Any]] = {
        "motor_encoder": {"cyclic_error": v["motor_cyclic"]},
        "motor_current": {
            "bandwidth": v["current_bandwidth"],
            "ripple": Ripple(order=v["ripple_order"], amplitude=v["ripple"], phase=v["ripple_phase"]),
        },
        "joint_torque": {
            "delay": v["torque_delay"], "flicker": v["torque_flicker"], "crosstalk": v["crosstalk"],
            "vibration": Vibration(frequency=v["vibration_frequency"], amplitude=v["vibration"]),
        },
    }  # fmt: skip
    s = nominal.sensors
    with_errors = {name: getattr(s, name).model_copy(update=own) for name, own in errors.items()}
    real = nominal.model_copy(update={"sensors": s.model_copy(update=with_errors)})
    return Imperfections(v, real, v["warming"], v["jitter"])
