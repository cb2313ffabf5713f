"""Joints drawn from what is not known of one."""

from __future__ import annotations

import numpy as np

import flexspline as fs
from flexspline.models.calibration import drawn_changes, moved
from flexspline.models.joint_parts import Uncertainty


def test_draws_of_wide_tolerances_are_joints():
    """A factor of three is log-normal: no draw is negative or next to zero, and half of them are below the nominal value."""
    joint = fs.load_joint("csg-14-100-ec45")
    numbers = joint.numbers
    changes = drawn_changes(joint, 400, 1)
    for name in ("Jw", "Fc", "bw", "bm"):
        factor = np.array([1 + change[name] / numbers[name].value for change in changes])
        assert factor.min() > 1 / 4**2.5 / 2, name  # 2.5 standard deviations, and those of a shared tolerance
        assert 0.4 < np.mean(factor < 1) < 0.6, name
    record = moved(joint, None, changes[0])[0]
    assert record["bw"] == numbers["bw"].value + changes[0]["bw"]


def test_draws_have_the_covariance_of_a_diagnosis():
    joint = fs.load_joint("test-joint")
    names, std = ["Fc", "Fs", "Kt"], np.array([1e-3, 1e-3, 1e-3])
    correlation = np.array([[1.0, 0.9, -0.5], [0.9, 1.0, -0.3], [-0.5, -0.3, 1.0]])
    root = np.linalg.cholesky(correlation) * std[:, None]
    measured = {n: joint.numbers[n].model_copy(update={"std": s}) for n, s in zip(names, std, strict=True)}
    joint = joint.model_copy(
        update={
            "numbers": joint.numbers | measured,
            "uncertainty": Uncertainty(names=names, factor=[list(row[: i + 1]) for i, row in enumerate(root)]),
        }
    )
    drawn = np.array([[change[n] for n in names] for change in drawn_changes(joint, 4000, 2)])
    np.testing.assert_allclose(np.corrcoef(drawn.T), correlation, atol=0.05)
    np.testing.assert_allclose(drawn.std(0), std, rtol=0.1)  # 0.95: cut at 2.5 standard deviations
