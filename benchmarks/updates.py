"""Time per update of every estimator over a run's signals, and of filterpy's Kalman filter of one state."""

from __future__ import annotations

import numpy as np

from flexspline.scenarios.experiment import Experiment, signals_of
from flexspline.scenarios.filters import estimators
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim import native

from .timing import measure

SECONDS = 20.0
_FEW = 20_000


def main() -> None:
    """Print the time per update, sensors' readings in, posterior out; the quickest first."""
    experiment = Experiment.of(*load_scenario("external_push", [f"duration={SECONDS:g}"]))
    with native.quiet():
        signals = signals_of(experiment.simulate())
    n = len(signals.time)
    print(f"one update, {n} of external_push: readings in, torque with its variance and all else out")
    found = {}
    for name, one in estimators().items():
        timing = measure(lambda one=one: one.estimate(signals, experiment.known), 3 if one.costly else 5)
        found[name] = 1e6 * timing.core / n
    for name in sorted(found, key=lambda name: found[name]):
        print(f"  {name:26s} {found[name]:8.3f} µs")
    try:
        from filterpy.kalman import KalmanFilter
    except ImportError:
        print("  filterpy: not installed (it comes with the test dependencies)")
        return
    y = np.random.default_rng(1).standard_normal(_FEW)

    def other() -> None:
        f = KalmanFilter(dim_x=1, dim_z=1)
        f.F, f.H, f.Q, f.R, f.P = np.eye(1), np.eye(1), 1e-4 * np.eye(1), 1e-2 * np.eye(1), 1e-2 * np.eye(1)
        f.x = np.array([[y[0]]])
        for value in y:
            f.predict()
            f.update(value)

    print(
        f"  {'filterpy KalmanFilter':26s} {1e6 * measure(other, 3).core / _FEW:8.3f} µs, of a measurement that is given"
    )
