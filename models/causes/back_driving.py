"""Friction that differs between driving and being driven."""

from __future__ import annotations

import numpy as np

from .base import Cause, CauseParameter, Requirements

_LESS, _MORE = (0.3, 0.7), (1.5, 2.5)


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
