"""The paper's filters as estimators: refused settings, source of the defaults, scaling to other joints."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from flexspline.estimator import FilterDiverged, KnownJoint, PaperFilter, get, measurement_variance
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint


@pytest.mark.parametrize(
    ("field", "value", "parts"),
    [
        ("V", 0.0, ("V [(N·m)²]", "> 0", "got 0.0")),
        ("V", -1.0, ("V [(N·m)²]", "-1.0")),
        ("V", np.nan, ("V", "nan")),
        ("V", np.inf, ("V", "finite", "inf")),
        ("W", -1e-4, ("W [(N·m)² per step]", "≥ 0")),
        ("P0", "small", ("P0", "expected a number", "'small'")),
        ("k", -1.0, ("k [1/(N·m)²]", "-1.0")),
        ("rho", -0.5, ("rho [1]", "-0.5")),
        ("gamma", 0.0, ("gamma [N·m]", "> 0")),
        ("L", None, ("L [1]", "None")),
        ("W", True, ("W", "True")),
        ("rule", "rarkf", ("rule", "'rarkf'", "did you mean 'rarekf'")),
        ("alpha", "print", ("alpha", "'max', 'printed'")),
        ("memory", "paper", ("memory", "'source', 'printed'")),
        ("covariance", 3, ("covariance", "'unadjusted'")),
        ("name", 3, ("name", "3")),
    ],
)
def test_bad_setting(field, value, parts):
    with pytest.raises(InputError) as caught:
        PaperFilter(**{"name": "mine", field: value})
    message = str(caught.value)
    assert "\n" not in message
    for part in (field, *parts):
        assert part in message


def test_settings_are_frozen_and_named():
    settings = PaperFilter(rule="arekf")
    assert settings.name == "arekf"
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.V = 1.0
    error = FilterDiverged("ekf", 3, 0.003, "why")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_defaults_follow_from_the_sensors():
    """V as the module says: encoders 0.047 N·m, with the torque command 0.078 N·m, 1.6 times its variance; γ clears its bound."""
    sensors = dict(
        stiffness=9400, motor_resolution=2 * np.pi / 4096, link_resolution=2 * np.pi / 2**20, link_noise=1.5e-6,
        ratio=100,
    )  # fmt: skip
    assert measurement_variance(**sensors) == pytest.approx(0.0469**2, rel=0.01)
    V = measurement_variance(**sensors | {"stiffness": 8400}, torque_noise=0.9e-3, wave_generator_stiffness=1.14)
    settings = PaperFilter()
    assert settings.V == pytest.approx(1.6 * V, rel=0.05)
    assert settings.gamma**2 > max(settings.V, settings.P0) + settings.W
    assert settings.k * 4.0**2 == 1.0


def test_measurement_variance_of_each_sensor():
    """A count of width w has the variance w²/12; the motor's side counts by the ratio, all by the stiffness."""
    quiet = dict(stiffness=10.0, motor_resolution=0.0, link_resolution=0.0, link_noise=0.0, ratio=2.0)
    assert measurement_variance(**quiet | {"link_resolution": 0.6}) == pytest.approx(100 * 0.36 / 12)
    assert measurement_variance(**quiet | {"motor_resolution": 0.6}) == pytest.approx(25 * 0.36 / 12)
    assert measurement_variance(**quiet | {"link_noise": 0.3}) == pytest.approx(9.0)
    assert measurement_variance(**quiet, motor_noise=0.3) == pytest.approx(2.25)
    of_torque = measurement_variance(**quiet, torque_noise=0.3, wave_generator_stiffness=5.0)
    assert of_torque == pytest.approx((10 * 0.3 / (2 * 5)) ** 2)


def test_scaled_to_a_joint():
    """The test joint at 1 kHz has the defaults, to the bit; others scale with sensors, rated torque and interval."""
    joint = load_joint("test-joint")
    known = KnownJoint.of(joint)
    for filter in (*map(get, ("EKF", "AREKF", "RAREKF", "REKF")), PaperFilter(W=3e-4, V=0.02, gamma=0.3)):
        assert filter.scaled(known, 1e-3) == filter
        assert filter.scaled(known, float(np.median(np.diff(np.arange(5000) * 1e-3)))) == filter
    coarse = dataclasses.replace(
        known, rated_torque=32.0, noise=dataclasses.replace(known.noise, motor_resolution=4e-3)
    )
    ours = PaperFilter().scaled(coarse, 2e-3)
    assert ours.W == pytest.approx(8 * PaperFilter().W)
    assert ours.k == pytest.approx(PaperFilter().k / 4)
    assert ours.V == ours.P0 > PaperFilter().V
    assert ours.gamma**2 / (ours.V + ours.W) == pytest.approx(0.12**2 / (0.01 + 1e-4))
