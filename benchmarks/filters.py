"""Time per filter update, beside filterpy's."""

from __future__ import annotations

import numpy as np
from flexspline.estimator import FilterSettings, run

from .timing import measure

UPDATES = 100_000
_FEW = 20_000


def _signal(n: int) -> np.ndarray:
    """A torque that moves, with the compliance model's noise [N·m]."""
    rng = np.random.default_rng(1)
    return 6 * np.sin(np.arange(n) * 2e-3) + 0.07 * rng.standard_normal(n)


def main() -> None:
    """Print the time per update of every rule."""
    y = _signal(UPDATES)
    print(f"one filter update (one state, one measurement), {UPDATES} updates, seed 1")
    for rule in ("ekf", "robust", "arekf", "rarekf"):
        timing = measure(lambda rule=rule: run(FilterSettings(rule=rule), y))
        print(f"  {rule:22s} {1e6 * timing.median / UPDATES:8.3f} µs")
    try:
        from filterpy.kalman import KalmanFilter
    except ImportError:
        print("  filterpy: not installed (it comes with the test dependencies)")
    else:
        few = y[:_FEW]

        def other() -> None:
            f = KalmanFilter(dim_x=1, dim_z=1)
            f.F, f.H, f.Q, f.R, f.P = np.eye(1), np.eye(1), 1e-4 * np.eye(1), 1e-2 * np.eye(1), 1e-2 * np.eye(1)
            f.x = np.array([[few[0]]])
            for value in few:
                f.predict()
                f.update(value)

        timing = measure(other, 3)
        print(f"  {'filterpy KalmanFilter':22s} {1e6 * timing.median / len(few):8.3f} µs")
