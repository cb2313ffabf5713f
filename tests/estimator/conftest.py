"""A calibration, a known joint, and signals for estimators."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.estimator import KnownJoint
from flexspline.models.joint import load_joint
from flexspline.models.signals import Signals


@pytest.fixture(scope="session")
def calibration() -> np.ndarray:
    """Parameter record of the test joint, shape (1,)."""
    return load_joint("test-joint").bare_record()


@pytest.fixture(scope="session")
def known() -> KnownJoint:
    """The test joint with a link, as estimators know it."""
    joint = load_joint("test-joint")
    return KnownJoint.of(joint, joint.mount("link"))


@pytest.fixture(scope="session")
def signals(known) -> Signals:
    """Two seconds of motion, loading and rest, quantised and noisy; of a joint's size, not of a joint's equations."""
    rng = np.random.default_rng(5)
    time = np.arange(2000) * 1e-3
    motor = 4.0 * np.sin(2.0 * np.minimum(time, 1.2))
    link = motor / 100 - 4e-4 * np.sin(5 * time) - 3e-4 * (time > 1.5)
    current = 0.5 * np.sin(5 * time) + 0.3
    columns = {
        "motor_position": np.round(motor / known.noise.motor_resolution) * known.noise.motor_resolution,
        "link_position": link + 2e-6 * rng.standard_normal(2000),
        "motor_current": current + 0.01 * rng.standard_normal(2000),
        "current_command": current,
    }
    return Signals(time, columns)
