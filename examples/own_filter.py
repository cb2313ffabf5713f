"""An own filter: torque from torsion at high frequencies, from current at low ones, compared with the others.

An estimator is a frozen dataclass with a name and a method `estimate`: signals and what is known of the joint in, a posterior
out. By its name it is known everywhere, from scenarios too: `flexspline compare --plugin examples/own_filter.py --set
"filters=[RAREKF, complementary]"`. docs/plugins.md says how a package offers it, and how a filter is compiled for the loop.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import flexspline as fs
from flexspline.estimator import registry
from flexspline.estimator.estimator import KnownJoint
from flexspline.models.signals import Signals


@dataclass(frozen=True)
class Complementary(fs.Estimator):
    """Both estimates through one pair of complementary first-order filters.

    Attributes:
      corner: frequency [Hz] above which the torsion counts, below which the current does.
    """

    name: str = "complementary"
    corner: float = 0.2
    description: ClassVar[str] = "torsion above a corner frequency, motor current below it"

    def estimate(self, signals: Signals, joint: KnownJoint) -> fs.Posterior:
        """Joint torque [N·m] from torsion and current."""
        torsion = registry.get("lowpass").estimate(signals, joint).mean
        current = registry.get("current").estimate(signals, joint).mean
        share = 1 - np.exp(-2 * np.pi * self.corner * np.diff(signals.time, prepend=signals.time[0]))
        mean, slow = np.empty_like(torsion), current[0] - torsion[0]
        for i, difference in enumerate(current - torsion):
            slow += share[i] * (difference - slow)
            mean[i] = torsion[i] + slow
        return fs.Posterior(self.name, signals.time, mean)


ESTIMATORS = (Complementary(),)

if __name__ == "__main__":
    # The estimators know 5 % less stiffness than the joint has: the current does not mind.
    run = fs.simulate(
        "external_push", seed=1, duration=20, filters=["lowpass", "current"], plant={"K1": 8820, "K2": 9870}
    )
    truth, kept = run.truth("joint_torque"), run.time > 1.0
    for corner in (0.05, 0.2, 1.0):
        found = Complementary(corner=corner).estimate(run.signals, run.known)
        print(f"corner {corner:g} Hz: {np.sqrt(np.mean((found.mean - truth)[kept] ** 2)):.3f} N·m RMS")
    for name in run.estimates:
        print(f"{name} alone: {np.sqrt(np.mean((run.estimate(name) - truth)[kept] ** 2)):.3f} N·m RMS")
