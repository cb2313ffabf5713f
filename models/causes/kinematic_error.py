"""An order of the kinematic error."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .base import PHASE, Cause, CauseParameter, Requirements


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
