"""Force at a point of the link: by the six-axis sensor, which sees the force and where it acts, and by external torques, which
mean a force where its lever is known.

With the link's mass m, its centre at a distance r = Mg/(m g) from the axis, and f the tangential force of the joint on it (x of
the sensor's frame), Newton's law along that direction and the balance of moments about the axis are

    m r θ'' = f + F − m g sin(θ + β)                Jl θ'' = Ts + F·ℓ + own torques

so that the sensor's f gives F, and its torque about the axis, −Ts, the lever ℓ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...estimator.estimator import KnownJoint, Posterior
from ...estimator.external import external_torque, lowpassed
from ...models.parameters import GRAVITY
from ...models.signals import Signals
from ...sim.loop import Simulation

WRENCH = "wrench"
"""The six-axis sensor's own."""
_SEEN = 0.5  # share of the largest force from which on its lever is told
_CUTOFF = 20.0  # Hz


@dataclass(frozen=True)
class TipForce:
    """What the force at the link was taken for.

    Attributes:
        truth: Shape (n,) [N].
        forces: by name, shape (n,) [N]: `WRENCH`, and every estimator.
        lever: where the wrench says that it acts [m]: median where the force is half its largest or more; NaN without a force.
    """

    truth: np.ndarray
    forces: Mapping[str, np.ndarray]
    lever: float

    def errors(self, kept: np.ndarray) -> dict[str, float]:
        """RMS error [N] by name, where a condition, shape (n,), holds."""
        return {name: float(np.sqrt(np.mean((f - self.truth)[kept] ** 2))) for name, f in self.forces.items()}


def tip_force(
    simulation: Simulation,
    signals: Signals,
    known: KnownJoint,
    mass: float,
    truth: np.ndarray,
    lever: float,
    estimates: Mapping[str, Posterior],
) -> TipForce:
    """The force by the wrench and by every estimate.

    Args:
        simulation: with the wrench's readings. signals: of it. known: of the joint.
        mass: of the link [kg], as a scale says.
        truth: Shape (n,), the force that acted [N]. lever: of it [m], which the estimators are told.
        estimates: over these signals, by name.
    """
    p, time = known.p, signals.time
    angle = signals["link_position"] - p["link_zero"]
    acceleration = lowpassed(time, angle, _CUTOFF)[:, 2]
    own = mass * GRAVITY * np.sin(angle + p["gravity_angle"]) + p["Mg"] / GRAVITY * acceleration
    forces = {WRENCH: own - lowpassed(time, simulation.readings["force_x"], _CUTOFF)[:, 0]}
    torque = external_torque(signals, -simulation.readings["torque_y"], known, _CUTOFF)
    largest = float(np.abs(truth).max())
    strong = (np.abs(forces[WRENCH]) > _SEEN * largest) & (largest > 0.0)
    at = float(np.median((torque / np.where(strong, forces[WRENCH], 1.0))[strong])) if strong.any() else math.nan
    for name, one in estimates.items():
        external = external_torque(signals, one.mean, known) if one.external is None else one.external
        forces[name] = external / lever
    return TipForce(truth, forces, at)
