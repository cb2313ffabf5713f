"""Force at a point of the link: by the six-axis sensor, which measures the force and its lever, and by external torques with a
known lever.

With the link's mass m, its centre at a distance r = Mg/(m g) from the axis, and f the tangential force of the joint on it (x of
the sensor's frame), Newton's law along that direction and the balance of moments about the axis are

    m r θ'' = f + F − m g sin(θ + β)                Jl θ'' = Ts + F·ℓ + own torques

so that the sensor's f gives F, and its torque about the axis, −Ts, gives the lever ℓ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...estimator.external import external_torque, lowpassed
from ...models.parameters import GRAVITY
from ...sim.plant import link_mass

if TYPE_CHECKING:
    from ..run import Run

WRENCH = "wrench"  # name of the six-axis sensor's force
_SEEN = 0.5  # share of the largest force above which its lever is computed
_CUTOFF = 20.0  # Hz


@dataclass(frozen=True)
class TipForce:
    """Estimates of the force at the link."""

    truth: np.ndarray  # shape (n,) [N]
    forces: Mapping[str, np.ndarray]  # by name, shape (n,) [N]: `WRENCH`, and every estimator
    lever: float  # of the force by the wrench [m]: median at half of the largest force and more; NaN without a force

    def errors(self, kept: np.ndarray) -> dict[str, float]:
        """Return the RMS error [N] by name, at some samples, shape (n,), bool."""
        return {name: float(np.sqrt(np.mean((f - self.truth)[kept] ** 2))) for name, f in self.forces.items()}


def tip_force(run: Run) -> TipForce | None:
    """Estimate the force of a run by the wrench and by every filter; None without a recorded wrench or a common lever of
    all forces."""
    lever = run.scenario.lever
    if lever is None:
        return None
    p, signals, truth = run.known.p, run.signals, run.scenario.tip_force()
    mass, _ = link_mass(run.joint.record(run.scenario.mount(run.joint))[0])
    time = signals.time
    angle = signals["link_position"] - p["link_zero"]
    acceleration = lowpassed(time, angle, _CUTOFF)[:, 2]
    own = mass * GRAVITY * np.sin(angle + p["gravity_angle"]) + p["Mg"] / GRAVITY * acceleration
    forces = {WRENCH: own - lowpassed(time, run.reading("force_x"), _CUTOFF)[:, 0]}
    torque = external_torque(signals, -run.reading("torque_y"), run.known, _CUTOFF)
    largest = float(np.abs(truth).max())
    strong = (np.abs(forces[WRENCH]) > _SEEN * largest) & (largest > 0.0)
    at = float(np.median((torque / np.where(strong, forces[WRENCH], 1.0))[strong])) if strong.any() else math.nan
    for name, one in run.estimates.items():
        external = external_torque(signals, one.mean, run.known) if one.external is None else one.external
        forces[name] = external / lever
    return TipForce(truth, forces, at)
