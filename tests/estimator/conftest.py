"""A calibration for the estimators."""

from __future__ import annotations

import numpy as np
import pytest
from flexspline.models.joint import load_joint


@pytest.fixture(scope="session")
def calibration() -> np.ndarray:
    """Parameter record of the test joint, shape (1,)."""
    return load_joint("test-joint").bare_record()
