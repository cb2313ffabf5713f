"""Joint torque from the motor current, offline: motion, current and friction through one zero-phase smoother
(`smoothed`).

As `current`, without its lag, with the largest bandwidth that the readings' noise allows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models.signals import Signals
from .. import smoothed
from ..estimator import Estimator, KnownJoint, Posterior
from ..tuning_parameters import TuningParameter


@dataclass(frozen=True)
class CurrentSmoothed(Estimator):
    """Joint torque from motor current, smoothed; not causal."""

    name: str = "current_smoothed"
    quiet: float = smoothed.QUIET  # allowed noise [rated torques], which decides its bandwidth (`smoothed.bandwidth`)
    causal: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ("motor_position", "motor_current")
    tuning: ClassVar[tuple[TuningParameter, ...]] = (TuningParameter("quiet", 1e-4, 0.1),)
    description: ClassVar[str] = "motor current less friction and the drive's inertia, through a zero-phase smoother"

    def estimate(self, signals: Signals, joint: KnownJoint) -> Posterior:
        for name in self.needs:
            signals[name]
        motion = smoothed.smooth_motion(signals, joint, smoothed.bandwidth(signals, joint, self.quiet))
        torque = smoothed.torque_from_current(motion, joint)
        grid, velocity = motion.time, motion.link_velocity.copy()
        del motion  # 350 MB less for an hour
        velocity *= joint.p["bl"]
        torque -= velocity
        return Posterior(self.name, signals.time, np.interp(signals.time, grid, torque))


ESTIMATORS = (CurrentSmoothed(),)
