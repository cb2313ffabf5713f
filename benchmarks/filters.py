"""Time per filter update, beside filterpy's, and beside the same code without compilation."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
from flexspline.estimator import FilterSettings, run

from .timing import measure

UPDATES = 100_000
_FEW = 2_000


def _signal(n: int) -> np.ndarray:
    """A torque that moves, with the compliance model's noise [N·m]."""
    print_seed = 1
    rng = np.random.default_rng(print_seed)
    return 6 * np.sin(np.arange(n) * 2e-3) + 0.07 * rng.standard_normal(n)


def interpreted() -> None:
    """Print the time per update [µs] without compilation (run with NUMBA_DISABLE_JIT=1)."""
    y = _signal(_FEW)
    for rule in ("ekf", "rarekf"):
        begin = time.perf_counter()
        run(FilterSettings(rule=rule), y)
        print(rule, 1e6 * (time.perf_counter() - begin) / _FEW)


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
        few = y[: 10 * _FEW]

        def other() -> None:
            f = KalmanFilter(dim_x=1, dim_z=1)
            f.F, f.H, f.Q, f.R, f.P = np.eye(1), np.eye(1), 1e-4 * np.eye(1), 1e-2 * np.eye(1), 1e-2 * np.eye(1)
            f.x = np.array([[few[0]]])
            for value in few:
                f.predict()
                f.update(value)

        timing = measure(other, 3)
        print(f"  {'filterpy KalmanFilter':22s} {1e6 * timing.median / len(few):8.3f} µs")
    program = "from benchmarks.filters import interpreted; interpreted()"
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, capture_output=True, text=True
    )
    for line in done.stdout.splitlines():
        rule, microseconds = line.split()
        print(f"  {rule + ', not compiled':22s} {float(microseconds):8.3f} µs")
    if done.returncode:
        print(f"  not compiled: {done.stderr.strip().splitlines()[-1]}")
