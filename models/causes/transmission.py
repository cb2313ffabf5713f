"""Causes in the transmission: gear, friction of the mesh, wave generator."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .base import PHASE, Cause, CauseParameter, Requirements

_LESS, _MORE = (0.3, 0.7), (1.5, 2.5)  # ordinary friction where the load drives, over that where the motor does


class BackDriving(Cause):
    """Friction that grows with the load is not the same when the load drives: μ |Tf|/N where Tf·w > 0, μ_b where Tf·w < 0.

    Ordinary: load-dependent friction of ordinary size, a third to two thirds of it, or half as much again to two and a half
    times, when the load drives (strain wave gears start to be driven at 1.2 to 2 times the torque that efficiency says).
    """

    name = "back_driving"
    component = "transmission"
    description = "friction grows with the load, and differs where the load drives: μ |Tf|/N or μ_b |Tf|/N"
    includes = "load_dependent_friction"
    requires = Requirements(sliding=0.5, reversal=True, load_span=0.2)
    parameters = (
        CauseParameter("coefficient", "1", (0.0, 2.0), ((0.12, 0.3),), magnitude=True),
        CauseParameter("back_driven", "1", (0.0, 4.0), ((0.036, 0.75),), magnitude=True),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        driven = values["back_driven"]
        # The record holds μ and the ratio μ_b/μ; a μ of zero must keep μ_b.
        p["friction_load"] = max(values["coefficient"], 1e-9 if driven > 0.0 else 0.0)
        if p["friction_load"] > 0.0:
            p["back_driven_friction"] = driven / p["friction_load"]

    def present(self, p: np.void) -> dict[str, float]:
        """The record's own values, which the cause replaces."""
        mu = float(p["friction_load"])
        return {"coefficient": mu, "back_driven": mu * float(p["back_driven_friction"])}

    def draw(self, p: np.void, rng: np.random.Generator, size: float = 1.0) -> dict[str, float]:
        """Draw μ, and μ_b as a multiple of it."""
        values = super().draw(p, rng, size)
        low, high = (_LESS, _MORE)[rng.integers(2)]
        return values | {"back_driven": values["coefficient"] * float(rng.uniform(low, high))}


class Backlash(Cause):
    name = "backlash"
    component = "transmission"
    description = "the flexspline's spring has a dead zone"
    parameters = (CauseParameter("width", "rad", (0.0, 0.01), ((0.2e-3, 0.6e-3),), magnitude=True),)
    sets = {"width": "backlash"}
    # Without load the joint rattles in it, which a resonance's damping looks like.
    requires = Requirements(sliding=0.5, reversal=True, load_span=0.2)
    torsion = True


class FrictionAsymmetry(Cause):
    name = "friction_asymmetry"
    component = "transmission"
    description = "mesh friction is g(w)·(1 + a) forward and g(w)·(1 − a) backward"
    parameters = (CauseParameter("ratio", "1", (-0.95, 0.95), ((-0.45, -0.2), (0.2, 0.45)), magnitude=True),)
    sets = {"ratio": "friction_asymmetry"}
    requires = Requirements(sliding=0.5, reversal=True)


class FrictionDrift(Cause):
    name = "friction_drift"
    component = "transmission"
    description = "mesh friction warms up: g(w)·(1 + A exp(−t/T)) from the recording's start"
    parameters = (
        CauseParameter("amplitude", "1", (-0.9, 10.0), ((0.8, 1.6),), magnitude=True),
        CauseParameter("time_constant", "s", (0.5, 300.0), ((6.0, 15.0),)),
    )
    sets = {"amplitude": "drift_amplitude", "time_constant": "drift_time"}
    requires = Requirements(sliding=0.5, duration=5.0)


class FrictionTemperature(Cause):
    """Mesh friction and its viscous part change with the temperature: g(w) and bw × (1 + c (ϑ − ϑ0)).

    Ordinary: a lubricant loses half of its friction over some 25 to 60 K; a gear that gains preload as it warms, the reverse.
    """

    name = "friction_temperature"
    component = "transmission"
    description = "mesh friction and its viscous part change with the temperature: g(w) and bw × (1 + c (ϑ − ϑ0))"
    parameters = (CauseParameter("coefficient", "1/K", (-0.1, 0.1), ((-0.02, -0.008), (0.008, 0.02)), magnitude=True),)
    sets = {"coefficient": "friction_temperature"}
    needs = ("temperature",)
    requires = Requirements(sliding=0.5, temperature_span=5.0)


class Hysteresis(Cause):
    name = "hysteresis"
    component = "transmission"
    description = "Dahl friction acts across the flexspline: Tf + F z/x, z' = v − |v| z/x with v = Δθf'"
    parameters = (
        CauseParameter("torque", "N·m", (0.0, 20.0), ((0.6, 1.5),), magnitude=True),
        CauseParameter("extent", "rad", (5e-6, 2e-3), ((50e-6, 120e-6),)),
    )
    sets = {"torque": "hysteresis_torque", "extent": "hysteresis_extent"}
    requires = Requirements(sliding=0.5, reversal=True)
    torsion = True


class KinematicError(Cause):
    """An order of the kinematic error differs from calibration; a second one with another order adds to the first."""

    name = "kinematic_error"
    component = "transmission"
    imperfection = True
    description = "an order of the kinematic error differs from calibration"
    adds = True
    ripple = True
    behind_link_encoder = (
        "its effect on the current depends on the rotor's response, which the link's encoder does not show"
    )
    series = ("link_position", "motor_position")
    requires = Requirements(sliding=0.5, motor_turn=1.0)
    parameters = (
        CauseParameter("order", "1", (1e-3, 64), ((1, 4),), integer=True, searched=(1, 6)),
        CauseParameter("amplitude", "rad", (0.0, 0.05), ((0.8e-4, 2e-4),), magnitude=True),
        PHASE,
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        slot = self._slot(p, values["order"])
        p["amplitude"][p["order"] == values["order"]] = 0.0  # all parts of the order
        p["order"][slot] = values["order"]
        p["amplitude"][slot] = values["amplitude"]
        p["phase"][slot] = values["phase"]

    @staticmethod
    def _slot(p: np.void, order: float) -> int:
        same = np.flatnonzero((p["order"] == order) & (p["amplitude"] != 0))
        free = np.flatnonzero(p["amplitude"] == 0)
        if not (same.size or free.size):
            raise InputError(f"expected at most {len(p['order'])} orders of the kinematic error, got one more")
        return int(same[0] if same.size else free[0])

    def centre(self, p: np.void, fixed: dict[str, float]) -> dict[str, float]:
        """What the order has already: amplitude and phase."""
        same = (p["order"] == fixed["order"]) & (p["amplitude"] != 0)
        before = np.sum(p["amplitude"][same] * np.exp(1j * p["phase"][same]))
        return {"order": fixed["order"], "amplitude": float(abs(before)), "phase": float(np.angle(before))}

    def draw(self, p: np.void, rng: np.random.Generator, size: float = 1.0) -> dict[str, float]:
        """Add a vector of ordinary length, in any direction, to what the order has; the new whole is the answer."""
        more = super().draw(p, rng, size)
        before = self.centre(p, more)
        whole = before["amplitude"] * np.exp(1j * before["phase"]) + more["amplitude"] * np.exp(1j * more["phase"])
        return {"order": more["order"], "amplitude": float(abs(whole)), "phase": float(np.angle(whole))}


class LoadDependentFriction(Cause):
    name = "load_dependent_friction"
    component = "transmission"
    description = "mesh friction grows with the load: g(w) + μ|Tf|/N"
    parameters = (CauseParameter("coefficient", "1", (0.0, 2.0), ((0.12, 0.3),), magnitude=True),)
    sets = {"coefficient": "friction_load"}
    requires = Requirements(sliding=0.5, load_span=0.2)


class MeshFriction(Cause):
    name = "mesh_friction"
    component = "transmission"
    description = "Coulomb and static mesh friction (Fc, Fs) are scaled"
    parameters = (CauseParameter("scale", "1", (1e-3, 10.0), ((1.7, 2.5),), neutral=1.0, magnitude=True),)
    scales = ("Fc", "Fs")
    adds = True
    # Friction drifts as the gear warms: by 0.15 % a second it is a few per cent another in every recording.
    inexact = 0.05
    requires = Requirements(sliding=0.5)


class PositionDependentFriction(Cause):
    name = "position_dependent_friction"
    component = "transmission"
    description = "mesh friction is periodic in the link angle: g(w) + A sin(n θl + φ)"
    order_of = "friction"
    adds = True
    series = ("mesh", "direction_link_position")
    requires = Requirements(sliding=0.5, link_travel=0.5)
    parameters = (
        CauseParameter("order", "1", (1, 32), ((1, 3),), integer=True),
        CauseParameter("amplitude", "N·m", (0.0, 1.0), ((6e-3, 12e-3),), magnitude=True),
        PHASE,
    )


class Stiffness(Cause):
    name = "stiffness"
    component = "transmission"
    description = "the flexspline's stiffness (K1, K2, K3) is scaled"
    parameters = (CauseParameter("scale", "1", (0.2, 5.0), ((0.65, 0.85), (1.2, 1.5)), neutral=1.0, magnitude=True),)
    scales = ("K1", "K2", "K3")
    adds = True
    multiple = 3.0
    requires = Requirements(sliding=0.5, load_span=0.2)
    torsion = True


class ViscousFriction(Cause):
    name = "viscous_friction"
    component = "transmission"
    description = "the mesh's viscous friction bw differs"
    parameters = (
        CauseParameter(
            "coefficient", "N·m·s/rad", (0.0, 0.1), ((3.0, 7.0),), relative="bw", neutral=1.0, magnitude=True
        ),
    )
    sets = {"coefficient": "bw"}
    # Real friction grows less than linearly: as speed to the power 0.7 to 0.9 it is 10 to 30 % less at speed.
    inexact = 0.1
    requires = Requirements(sliding=0.5, speed=10.0)
