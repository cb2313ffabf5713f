"""An order of the kinematic error."""

from __future__ import annotations

import numpy as np

from .base import PHASE, Cause, Parameter


class KinematicError(Cause):
    """An order of the kinematic error differs from calibration."""

    name = "kinematic_error"
    component = "transmission"
    description = "an order of the kinematic error differs from calibration"
    adds = True
    parameters = (
        Parameter("order", "1", (0.01, 64), ((1, 4),), integer=True),
        Parameter("amplitude", "rad", (0.0, 0.05), ((0.8e-4, 2e-4),), magnitude=True),
        PHASE,
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        slot = self._slot(p, values["order"])
        p["order"][slot] = values["order"]
        p["amplitude"][slot] = values["amplitude"]
        p["phase"][slot] = values["phase"]

    @staticmethod
    def _slot(p: np.void, order: float) -> int:
        """Where the order stands, or the first free place."""
        same = np.flatnonzero((p["order"] == order) & (p["amplitude"] != 0))
        return int(same[0]) if same.size else int(np.flatnonzero(p["amplitude"] == 0)[0])

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
