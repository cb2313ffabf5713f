"""Time of a replay's derivatives in all of a joint's numbers: by dual numbers, and by one replay each."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import flexspline as fs
from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.fit.residual import Problem
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement

from .timing import alternately

SECONDS = 30.0
STEP = 0.05
"""Of the differences, in standard deviations."""


def main() -> None:
    """Print core times and their ratio, and by how much the two differ."""
    joint = load_joint("test-joint")
    recording = fs.simulate("link_sweep", filters=["RAREKF"], duration=SECONDS).as_recording()
    problem = Problem(*segments([*Measurement("sweep", Path(), (recording,)).recordings], joint), joint)
    theta, columns = np.zeros(problem.size), np.arange(problem.calibration.size)

    def differences() -> list[np.ndarray]:
        points = [theta, *(theta + STEP * np.eye(len(theta))[j] for j in columns)]
        base, *moved = problem.residuals(points, [()] * len(points))
        return [np.stack([(m[s] - base[s]) / STEP for m in moved], axis=-1) for s in range(len(base))]

    def exact() -> list[np.ndarray]:
        return problem.jacobian(theta, (), columns)

    times = alternately({"differences": differences, "dual numbers": exact})
    print(f"derivatives of {SECONDS:.0f} s of link_sweep by {len(columns)} numbers:")
    for name, timing in times.items():
        print(f"  {name:13s} {timing.core:.3f} s of a core")
    print(f"  dual numbers over differences: {times['dual numbers'].core / times['differences'].core:.2f}")
    a, b = (np.concatenate(x) for x in (exact(), differences()))
    apart = np.linalg.norm(a - b, axis=(0, 1)) / np.maximum(np.linalg.norm(a, axis=(0, 1)), 1e-300)
    worst = problem.calibration.names[int(np.argmax(apart))]
    print(
        f"  they differ by {100 * np.median(apart):.2g} % of their norm in the median, {100 * apart.max():.2g} % in {worst}"
    )


if __name__ == "__main__":
    main()
