"""Properties of estimates for any recording: units and the clock's zero have no effect, variances are positive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matrix_filter import FilterModel, run

from flexspline.diagnosis.data.importing import UNITS, Layout, import_recording
from flexspline.estimator import PaperFilter, get, names
from flexspline.estimator.estimator import KnownJoint
from flexspline.estimator.offline import estimate_recording
from flexspline.models.errors import FilterDiverged
from flexspline.models.joint import load_joint
from flexspline.models.recording import Recording
from flexspline.models.signals import CHANNELS, Signals

FEW = settings(max_examples=8, deadline=None, print_blob=True)
CHEAP = tuple(name for name in names() if not get(name).costly)
JOINT = load_joint("test-joint")


def recording(seed, seconds=2.0) -> Recording:
    """A joint in equilibrium with a slow motion, and the sensors' noise."""
    time = np.arange(round(seconds * 512)) / 512
    link = 0.5 * np.sin(1.7 * time)
    torque = 9.0 * np.sin(link) - 0.5 * np.sin(1.7 * time)
    noise = np.random.default_rng(seed).standard_normal((3, len(time)))
    return Recording(
        "m",
        time,
        {
            "motor_position": 100 * (link + torque / 8400) + 1e-3 * noise[0],
            "link_position": link + 2e-6 * noise[1],
            "motor_current": torque / 6 + 0.2 * np.sign(np.cos(1.7 * time)) + 0.01 * noise[2],
        },
    )


def assert_alike(a, b, tolerance):
    """Alike to a tolerance [N·m]; the augmented filter, which learns constants from gated sums, as RMS."""
    assert set(a.torque) == set(b.torque)
    for name in a.torque:
        for one, other in ((a.torque, b.torque), (a.external_torque, b.external_torque)):
            apart = np.abs(one[name] - other[name])
            if name == "augmented":
                assert np.sqrt(np.mean(apart**2)) < 0.01
            else:
                assert apart.max() <= tolerance, (name, int(apart.argmax()))


@FEW
@given(st.integers(0, 100), st.integers(-(2**20), 2**20))
@example(8, 128)
@example(52, 32768)
def test_the_clocks_zero_has_no_effect(seed, later):
    """Stamps and shift are binary fractions, so that not even the clock's resolution differs."""
    one = recording(seed)
    other = replace(one, time=one.time + later)
    assert np.array_equal(np.diff(one.time), np.diff(other.time))
    assert_alike(estimate_recording(one, JOINT, CHEAP), estimate_recording(other, JOINT, CHEAP), 1e-6)


def units_of(channel):
    unit = "s" if channel == "time" else CHANNELS[channel].unit
    return st.sampled_from([name for name, (si, _) in UNITS.items() if si == unit and name != "counts"])


@FEW
@given(
    st.integers(0, 100),
    st.fixed_dictionaries({c: units_of(c) for c in ("time", "motor_position", "link_position", "motor_current")}),
    st.sampled_from([1, -1]),
)
def test_units_and_signs_of_a_log_have_no_effect(tmp_path_factory, seed, units, sign):
    one = recording(seed)
    log = tmp_path_factory.mktemp("log") / "log.csv"
    columns = {
        name: values / UNITS[units[name]][1] * (1 if name == "time" else sign)
        for name, values in {"time": one.time, **one.columns}.items()
    }
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    log.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]))
    read = {
        name: {"column": name, "unit": unit} | ({} if name == "time" else {"sign": sign})
        for name, unit in units.items()
    }
    layout = Layout.model_validate(
        {"format": 1, "name": "any", "joint": "test-joint", "link": one.link.model_dump(), "columns": read}
    )
    other = import_recording(layout, log)
    assert_alike(estimate_recording(one, JOINT, CHEAP), estimate_recording(other, JOINT, CHEAP), 1e-6)


finite = st.floats(-1e3, 1e3)


@settings(max_examples=60, deadline=None, print_blob=True)
@given(
    st.sampled_from(["ekf", "robust", "arekf", "rarekf"]),
    arrays(np.float64, st.integers(2, 40), elements=finite),
    st.floats(1e-8, 1.0),
    st.floats(1e-8, 1.0),
    st.floats(0.0, 10.0),
)
def test_variances_of_the_torque_filter_are_positive(rule, y, W, V, P0):
    """For any measurement P and P_Y are positive, and the estimate is between prediction and measurement."""
    try:
        found = run(PaperFilter(rule=rule, W=W, V=V, P0=P0), y)
    except FilterDiverged:
        return
    P, P_Y = found.P[1:, 0, 0], found.innovation_covariance[1:, 0, 0]
    assert np.all(P > 0) and np.all(P_Y > 0)
    assert np.all(P <= V * (1 + 1e-9)), "a measurement leaves no more than its own variance"
    before, after = found.torque[:-1], found.torque[1:]
    low, high = np.minimum(before, y[1:]), np.maximum(before, y[1:])
    slack = 1e-9 * (1 + np.abs(y).max())
    assert np.all((after >= low - slack) & (after <= high + slack))


def squared(size):
    """Covariances, also singular ones and those of very different scales."""
    return arrays(np.float64, (size, size), elements=st.floats(-1.0, 1.0)).map(lambda A: A @ A.T)


@settings(max_examples=40, deadline=None, print_blob=True)
@given(st.data(), st.integers(1, 3), st.integers(1, 2), st.sampled_from(["ekf", "arekf", "rarekf"]))
def test_covariances_of_any_model_are_covariances(data, n, m, rule):
    F = data.draw(arrays(np.float64, (n, n), elements=st.floats(-1.0, 1.0)))
    assume(np.abs(np.linalg.eigvals(F)).max() <= 1.0)
    H = data.draw(arrays(np.float64, (m, n), elements=st.floats(-2.0, 2.0)))
    model = FilterModel(F, H, data.draw(squared(n)), data.draw(squared(m)) + 1e-3 * np.eye(m), data.draw(squared(n)))
    y = data.draw(arrays(np.float64, (15, m), elements=st.floats(-10.0, 10.0)))
    try:
        assert_covariances(run(PaperFilter(rule=rule), y, model=model, initial_state=np.zeros(n)))
    except FilterDiverged:
        return


@pytest.mark.parametrize("rule", ["ekf", "arekf", "rarekf"])
def test_states_that_are_known_exactly_stay_so_under_a_fading_factor(rule):
    """P of rank one and no process noise: its rounding error is multiplied by f_α in every step."""
    F = np.array([[1.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    model = FilterModel(
        F, np.ones((1, 3)), np.zeros((3, 3)), np.full((1, 1), 0.00390625 + 1e-3), np.diag([0.25, 0.0, 0.0])
    )
    found = run(PaperFilter(rule=rule), np.full((40, 1), 0.5), model=model, initial_state=np.zeros(3))
    assert_covariances(found)


def assert_covariances(found):
    for P in (found.P, found.innovation_covariance):
        np.testing.assert_array_equal(P, np.swapaxes(P, 1, 2)) if P is found.P else None
        lowest = np.linalg.eigvalsh(P)[:, 0]
        assert np.all(lowest >= -1e-9 * np.trace(P, axis1=1, axis2=2))


@FEW
@pytest.mark.parametrize("name", [name for name in CHEAP if get(name).needs])
@given(st.integers(0, 2**31), st.floats(0.0, 3.0), st.floats(0.1, 10.0))
def test_variances_of_estimators_are_positive(name, seed, amplitude, pulsation):
    time = np.arange(300) * 1e-3
    noise = np.random.default_rng(seed).standard_normal((3, 300))
    motor = 100 * amplitude * np.sin(pulsation * time) + 1e-3 * noise[0]
    signals = Signals(
        time,
        {
            "motor_position": motor,
            "link_position": motor / 100 - 5e-4 * np.cos(pulsation * time) + 2e-6 * noise[1],
            "motor_current": np.cos(pulsation * time) + 0.01 * noise[2],
            "current_command": np.cos(pulsation * time),
        },
    )
    estimator = get(name)
    assume(set(estimator.needs) <= set(signals))
    try:
        found = estimator.estimate(signals, KnownJoint.of(JOINT))
    except FilterDiverged:
        return
    assert np.isfinite(found.mean).all()
    if found.variance is not None:
        assert np.all(found.variance >= 0)
    if found.innovation_covariance is not None:
        assert np.all(np.linalg.eigvalsh(found.innovation_covariance[1:])[:, 0] > 0)  # the first is a start
