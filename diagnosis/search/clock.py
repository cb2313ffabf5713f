"""A log's clock that is wrong by less than a third, against the causes of a diagnosis.

If a second of the log is 1/s seconds, speeds are divided by s and accelerations by s². Weight, Coulomb friction and orders of an
angle stay. Inertias seem s² times the described ones, viscosities s times. A load explains the link's inertia, but not the
rotor's with it. Coarser clocks are found before (`data.changes`): no description explains them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...models.causes import Cause, CauseParameter
from ..data.mistakes import Mistake
from ..fit.coordinates import hypotheses
from .explore import Explored, Explorer

_SUREST = 0.99  # largest confidence
_LEAST = 0.04  # relative error of a clock, from both inertias, from which on it is looked at
_POWERS = {
    "Jm": 2, "Jw": 2, "Jl": 2, "bm": 1, "bw": 1, "bl": 1, "df": 1, "dw": 1, "s1": 1, "link_damping": 1, "vs": -1,
}  # fmt: skip


class ClockScale(Cause):
    """Scale of the clock. It is not of the joint, and so not in the library of causes."""

    name = "clock"
    component = "sensor"
    description = "the clock of the log is wrong"
    parameters = (CauseParameter("scale", "1", (0.5, 2.0), ((0.75, 0.95), (1.05, 1.35)), neutral=1.0, magnitude=True),)

    def apply(self, p: np.void, values: Mapping[str, float]) -> None:
        for field, power in _POWERS.items():
            p[field] *= values["scale"] ** power


_CLOCK = ClockScale()


def wrong_clock(explorer: Explorer, found: Explored) -> Mistake | None:
    """Return a wrong clock as a mistake, if it is more probable than the causes found; else None.

    It is looked for if the fit has both inertias off in the same direction, and the channels separate them.
    """
    problem = explorer.problem
    if not (problem.link_measured or problem.has_torque):
        return None
    nominal = problem.calibration.record(np.zeros(problem.calibration.size))
    fitted = problem.calibration.record(found.best.theta[: problem.calibration.size])
    for h, u in zip(found.best.model, problem.split(found.best.theta, found.best.model), strict=True):
        if h.free:
            h.cause.apply(fitted[0], h.values(u))
    before, after = ((p["Jm"][0] + p["Jw"][0], p["Jl"][0]) for p in (nominal, fitted))
    rotor, link = np.log(after) - np.log(before)
    if rotor * link <= 0.0 or min(abs(rotor), abs(link)) < 2 * _LEAST:
        return None
    (clock,) = hypotheses(_CLOCK, nominal)
    # Along a ridge of inertias within tolerance a fit does not come from a right clock to a wrong one.
    start = clock.coordinates({"scale": float(np.exp(0.25 * (rotor + link)))})
    one = explorer.fitter.fit((clock,), np.concatenate([problem.start(None, ()), start]))
    other = explorer.with_unknown(found, one)
    if other is None:
        return None
    sure = other.probabilities(clock.key)[0]
    scale = clock.values(other.best.theta[-1:])["scale"]
    text = (
        f"a second of the log is {1 / scale:.3g} s: rotor and link inertia are both {scale**2:.3g} times the description, "
        "the weight is not. Check the rate of the log"
    )
    return Mistake("unit", "time", "", text, min(sure, _SUREST), factor=1 / scale, lost=True)
