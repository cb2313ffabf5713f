"""The interface of estimators: each by its name, in the loop and over signals, with the known joint."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import FrozenInstanceError, dataclass, fields, is_dataclass, replace
from importlib.metadata import EntryPoint
from typing import ClassVar

import numpy as np
import pytest
from known_effects import JOINT, MOUNTING, simulate

from flexspline.estimator import CausalEstimator, FilterDiverged, KnownJoint, registry
from flexspline.estimator.estimator import (
    Posterior,
    SensorNoise,
    TuningParameter,
    as_samples,
    go_on,
    value_of,
    with_values,
)
from flexspline.models import chunks, plugins
from flexspline.models.causes.base import put_discrepancy
from flexspline.models.controller import Controller, control
from flexspline.models.errors import InputError
from flexspline.models.joint import Joint
from flexspline.models.parameters import N_COEFFICIENTS
from flexspline.models.signals import Signals
from flexspline.models.step import SAMPLE, PythonStep, step_of
from flexspline.sim import loop, plant, sensors

NAMES = registry.names()
CAUSAL = [name for name in NAMES if registry.get(name).causal]


def test_names_and_errors(known, signals):
    assert {
        "EKF", "AREKF", "RAREKF", "REKF", "model", "current", "lowpass", "kalman", "h_infinity", "strong_tracking", "huber",
        "momentum", "momentum_torsion", "dynamics_ekf", "augmented", "dynamics_ukf", "rts_smoother",
        "current_smoothed", "payload", "payload_smoothed",
    } <= set(NAMES)  # fmt: skip
    with pytest.raises(InputError, match="did you mean 'kalman'"):
        registry.get("kalmann")
    with pytest.raises(InputError, match="motor_position"):
        registry.get("model").estimate(signals.without("motor_position"), known)
    with pytest.raises(InputError, match="record"):
        KnownJoint(np.zeros(1))
    with pytest.raises(InputError, match="cutoff"):
        replace(registry.get("lowpass"), cutoff=900.0).estimate(signals, known)


@pytest.mark.parametrize("name", NAMES)
def test_every_estimator_is_a_frozen_dataclass_with_a_description(name):
    estimator = registry.get(name)
    assert estimator.name == name and is_dataclass(estimator)
    with pytest.raises(FrozenInstanceError):
        estimator.name = "other"
    assert 20 < len(estimator.description) < 130 and "\n" not in estimator.description
    assert isinstance(estimator, CausalEstimator) == estimator.causal
    for parameter in estimator.tuning:
        assert parameter.low <= value_of(estimator, parameter.field) <= parameter.high
        other = with_values(estimator, {parameter.field: parameter.from_unit(0.61)})
        assert type(other) is type(estimator) and other != estimator


@pytest.mark.parametrize("name", NAMES)
def test_finite_and_causal(name, known, signals):
    """Later samples change no causal estimate."""
    estimator = registry.get(name)
    whole = estimator.estimate(signals, known)
    assert whole.mean.shape == (2000,) and np.isfinite(whole.mean).all()
    short = estimator.estimate(signals.part(slice(0, 1400)), known)
    assert np.array_equal(short.mean, whole.mean[:1400]) == estimator.causal


@pytest.mark.parametrize("name", NAMES)
def test_the_current_is_the_sensors_reading(name, known, signals):
    """The paper's measurement uses the drive's command if known; all others have the reading, to the bit."""
    estimator = registry.get(name)
    reading = estimator.estimate(signals.without("current_command"), known).mean
    assert np.isfinite(reading).all()
    assert np.array_equal(estimator.estimate(signals, known).mean, reading) != estimator.reads_command
    family = {
        "model", "EKF", "AREKF", "RAREKF", "REKF", "kalman", "huber", "h_infinity", "strong_tracking", "lowpass",
        "lowpass_first_order",
    }  # fmt: skip
    assert estimator.reads_command == (name in family)


@pytest.mark.parametrize("name", NAMES)
def test_only_the_channels_that_it_needs_are_needed(name, known, signals):
    estimator = registry.get(name)
    part = Signals(signals.time, {channel: signals[channel] for channel in estimator.needs})
    assert np.isfinite(estimator.estimate(part, known).mean).all()
    assert "joint_torque" not in estimator.needs and "external_torque" not in estimator.needs


@pytest.mark.parametrize("name", NAMES)
def test_no_estimator_reads_a_torque_sensor(name, known, signals):
    estimator = registry.get(name)
    torque = np.random.default_rng(0).standard_normal(len(signals.time))
    with_sensor = signals.with_columns(joint_torque=torque, external_torque=torque)
    assert np.array_equal(estimator.estimate(with_sensor, known).mean, estimator.estimate(signals, known).mean)


@pytest.mark.parametrize("name", NAMES)
def test_a_torque_sensors_gain_does_not_change_estimates(name, known, signals):
    """Estimates are of the actual torque; what a sensor with gain, offset and drift would read is `as_read`."""
    record = known.record.copy()
    record["torque_gain"], record["torque_offset"], record["torque_rate"] = 1.1, 0.3, 0.1
    sensed = replace(known, record=record)
    actual = registry.get(name).estimate(signals, known).mean
    assert np.array_equal(registry.get(name).estimate(signals, sensed).mean, actual)
    since = signals.time - signals.time[0]
    assert np.allclose(sensed.as_read(actual, signals), 1.1 * actual + 0.3 + 0.1 * since)
    late = replace(sensed, start=signals.time[0] - 2.0)
    assert np.allclose(late.as_read(actual, signals) - sensed.as_read(actual, signals), 0.2)


def test_what_a_sensor_would_read_holds_its_discrepancy(known, signals):
    """A spline with collinear coefficients is a line, over the load and over the link's angle."""
    torque, angle = np.linspace(-8.0, 8.0, len(signals.time)), signals["link_position"]
    line = np.linspace(-1.0, 1.0, N_COEFFICIENTS)
    for variable, x in (("load", torque), ("link_position", angle)):
        record = known.record.copy()
        put_discrepancy(record[0], "joint_torque", variable, -10.0, 10.0, 0.5 * line)
        read = replace(known, record=record).as_read(torque, signals)
        # The outermost coefficients lie a knot beyond the range.
        inner = 10.0 * (N_COEFFICIENTS - 1) / (N_COEFFICIENTS - 3)
        assert np.allclose(read - known.as_read(torque, signals), 0.5 * x / inner, atol=1e-6), variable


WITH_EFFECTS = {
    "link_delay": 6e-3, "hysteresis_torque": 0.5, "friction_load": 0.1, "friction_temperature": -0.01, "motor_eccentricity": 2e-3,
    "current_offset": 0.05,
}  # fmt: skip


@pytest.mark.parametrize("effects", [{}, WITH_EFFECTS], ids=["plain", "effects"])
@pytest.mark.parametrize("name", CAUSAL)
def test_estimates_in_the_loop_and_afterwards_are_equal(name, effects):
    """The command that the drive gave in the loop follows, to the bit, from the estimates over the signals of that loop."""
    seed, n, dt = 3, 600, loop.CONTROL_PERIOD
    known = KnownJoint.of(JOINT, MOUNTING).with_numbers(**effects)
    record = known.record
    position, velocity, push = np.full(n, 0.3), np.zeros(n), np.where(np.arange(n) > 300, 3.0, 0.0)
    controller = Controller(torque_feedback=0.4).record(record[0], dt, True)
    run = simulate(
        plant.build(JOINT, MOUNTING, record=record), record, position, velocity, push,
        sensors.sensor_records(JOINT, float(record[0]["link_delay"]), dt),
        sensors.noise(JOINT, seed, n, dt), controller, registry.get(name).step(known, dt),
    )  # fmt: skip
    assert run.failed == (n, 0)
    columns = {c: run.readings[c] for c in ("motor_position", "link_position", "motor_current", "temperature")}
    found = registry.get(name).estimate(Signals(run.time, {**columns, "current_command": run.command}), known)
    state = np.array([controller[0]["gear"] * position[0], 0.0, 0.0])
    command = [
        control(position[k], velocity[k], columns["motor_position"][k], found.mean[k], state, dt, controller[0])
        for k in range(n)
    ]
    assert np.array_equal(command, run.command)
    assert np.std(found.mean) > 0.05


def test_a_smoother_cannot_be_fed_back(known):
    for name in set(NAMES) - set(CAUSAL):
        with pytest.raises(InputError, match="got a smoother"):
            registry.get(name).step(known, 1e-3)


def test_samples(known, signals):
    found = as_samples(signals, ("motor_position",), replace(known, start=-1.0), reads_command=True)
    assert found.dtype == SAMPLE
    assert found["time"][0] == 1.0 and found["interval"][0] == 0.0 and found["interval"][1] == pytest.approx(1e-3)
    assert np.array_equal(found["current_command"], np.r_[0.0, signals["current_command"][:-1]])
    assert np.isnan(found["joint_torque"]).all() and np.isnan(found["temperature"]).all()
    assert np.isnan(as_samples(signals.without("current_command"), (), known, True)["current_command"]).all()
    assert np.isnan(as_samples(signals, (), known)["current_command"]).all()


def stepped(step, samples):
    """A step over records of samples: outputs, shape (n, outputs), the sample at which it failed, and its status."""
    arrays = step.arrays()
    history = np.zeros((len(samples), len(arrays[-1])))
    return history, *go_on(arrays, samples, history)


def test_a_long_recording_is_read_in_blocks_without_a_difference(known, signals, monkeypatch):
    """Records of the whole, the command at every seam, and all outputs of the filters."""
    whole = as_samples(signals, (), known, True)
    parts = [(part, as_samples(signals, (), known, True, part)) for part in chunks.parts(2000, 333)]
    assert [p.start for p, _ in parts] == list(range(0, 2000, 333)) and parts[-1][0].stop == 2000
    assert np.concatenate([samples for _, samples in parts]).tobytes() == whole.tobytes()
    monkeypatch.setattr("flexspline.estimator.estimator.BLOCK", 333)
    for name in ("EKF", "current", "momentum_torsion"):
        one = registry.get(name)
        out, failed, _ = stepped(one.step(known, 1e-3), as_samples(signals, (), known, one.reads_command))
        assert failed == 2000
        found, torques = one.estimate(signals, known), one.torques(signals, known)
        assert np.array_equal(found.mean, out[:, 0]) and np.array_equal(torques.mean, out[:, 0])
        assert not torques.columns and torques.innovation is None
        if found.variance is not None:
            assert np.array_equal(torques.variance, found.variance)
    with pytest.raises(FilterDiverged, match=r"'plain' diverged at step 700, t = 0\.7 s"):
        Plain(fails_at=700).torques(signals, known)


def test_known_joint_says_how_well(known):
    """Noise of the sensors, tolerance of the friction, uncertainty of the encoders' zeros: the description's numbers."""
    assert known.noise == SensorNoise() and known.rated_torque == 16.0
    assert known.friction == pytest.approx(0.15) and known.link_zero == pytest.approx(1e-3)


def test_a_diagnosed_deviation_wins_over_a_tolerance():
    """Relative to the number, however large it is in its unit: Kt is 0.06 N·m/A, K2 9400 N·m/rad."""
    numbers = dict(JOINT.numbers)
    for name in ("Kt", "K2", "bw", "Fc"):
        numbers[name] = numbers[name].model_copy(update={"std": 0.013 * numbers[name].value})
    numbers["Kw0"] = numbers["Kw0"].model_copy(update={"value": 0.0, "std": 3.0})
    found = KnownJoint.of(JOINT.model_copy(update={"numbers": numbers}), record=KnownJoint.of(JOINT).record)
    expected = (found.spread.torque_constant, found.spread.stiffness, found.spread.viscous, found.friction)
    assert expected == pytest.approx((0.013,) * 4)
    assert found.spread.wave_generator == 0.0, "of nothing there is no share"


def described(**sensors: dict) -> Joint:
    """The test joint with other sensors, and with tolerances that all differ."""
    raw = JOINT.model_dump()
    for name, values in sensors.items():
        raw["sensors"][name] |= values
    for k, one in enumerate(raw["numbers"].values()):
        one |= {"tolerance": 0.01 + 1e-3 * k, "deviation": 0.0, "std": None, "shared": None}
    for k, order in enumerate(raw["kinematic_error"]):
        order["amplitude"] |= {"tolerance": 0.0, "deviation": 1e-5 * (1 + k), "std": None}
        order["phase"] |= {"tolerance": 0.0, "deviation": 0.1 * (1 + k), "std": None}
    return Joint.model_validate(raw)


def test_errors_of_sensors_are_those_of_the_description():
    """Mean squares: half of a sine's squared amplitude, a twelfth of a count's square; independent ones add up."""
    imperfect = {
        "flicker": 3e-3, "step": 1.2e-2, "ripple": {"order": 6.0, "amplitude": 8e-3},
        "vibration": {"frequency": 90.0, "amplitude": 5e-3},
    }  # fmt: skip
    encoders = {
        "motor_encoder": {"cyclic_error": 0.6, "noise": 1e-4},
        "link_encoder": {"cyclic_error": 0.3, "noise": 2e-6},
    }
    noise = SensorNoise.of(described(motor_current=imperfect | {"noise": 0.02}, **encoders).sensors)
    counts = noise.motor_resolution, noise.link_resolution
    assert counts == pytest.approx((2 * np.pi / 4096, 2 * np.pi / 2**20))
    assert (noise.motor_noise, noise.link_noise, noise.current_noise) == (1e-4, 2e-6, 0.02)
    turn = 2 * np.pi * np.arange(1000) / 1000
    assert noise.motor_error == pytest.approx(np.std(0.6 * counts[0] * np.sin(turn)))
    assert noise.link_error == pytest.approx(np.std(0.3 * counts[1] * np.sin(turn)))
    expected = np.var(8e-3 * np.sin(turn)) + 5e-3**2 + 3e-3**2 + np.var(1.2e-2 * (np.arange(1000) + 0.5) / 1000)
    assert noise.current_error == pytest.approx(np.sqrt(expected), rel=1e-5)


def test_deviations_are_those_of_the_description():
    """By its tolerances, of either quadrature of the kinematic error half the power of what amplitude and phase leave; and the
    share of that which one asks for."""
    joint = described()
    found, numbers = KnownJoint.of(joint), joint.numbers
    spread = found.spread
    stated = {
        "stiffness": "K2",
        "wave_generator": "Kw0",
        "wave_generator_curve": "Cw",
        "torque_constant": "Kt",
        "viscous": "bw",
    }
    for name, symbol in stated.items():
        assert getattr(spread, name) == pytest.approx(numbers[symbol].tolerance), name
    assert found.friction == pytest.approx(numbers["Fc"].tolerance)
    rng = np.random.default_rng(4)
    for k, order in enumerate(joint.kinematic_error):
        a, b = 1e-3 * rng.standard_normal((2, 200_000))  # so small that a turn is a shift
        amplitude = order.amplitude.value + order.amplitude.deviation * a
        power = 1e6 * np.var(amplitude * np.exp(1j * order.phase.deviation * b))
        assert spread.kinematic[k] == pytest.approx(np.sqrt(0.5 * power), rel=0.01)
    assert not spread.kinematic[len(joint.kinematic_error) :].any()
    with_all = replace(
        found, link_zero=2e-4, link_wander=3e-5, back_driven=0.3, spread=replace(spread, gravity=0.01, inertia=0.02)
    )
    for share in (0.0, 0.4, 3.0):
        less = with_all.within(share)
        for name in ("friction", "link_zero", "link_wander", "back_driven"):
            assert getattr(less, name) == pytest.approx(share * getattr(with_all, name)), name
        for one in fields(spread):
            np.testing.assert_allclose(
                getattr(less.spread, one.name), share * np.asarray(getattr(with_all.spread, one.name))
            )
        assert (
            less.record is with_all.record
            and less.noise == with_all.noise
            and less.rated_torque == with_all.rated_torque
        )


@step_of(
    np.dtype([("count", np.float64)]), ("fails_at",),
    ("torque", "variance", "innovation", "innovation_variance", "count"), plain=True,
)  # fmt: skip
def _plain(m, s, p, c, o):
    if m["count"] == c.fails_at:
        return 1
    o.torque, o.variance, o.innovation, o.innovation_variance, o["count"] = (
        6.03 * s.current_command,
        0.5,
        0.1,
        2.0,
        m["count"],
    )
    m["count"] += 1
    return 0


@dataclass(frozen=True)
class Plain(CausalEstimator):
    """An estimator of a user in Python: torque of the motor, with its own gear ratio."""

    name: str = "plain"
    fails_at: int = -1
    reads_command: ClassVar[bool] = True
    description: ClassVar[str] = "torque of the motor current times the gear ratio"
    compiled: ClassVar = _plain


def test_an_estimator_in_python(known, signals):
    found = Plain().estimate(signals, known)
    assert np.allclose(found.mean[1:], 6.03 * signals["current_command"][:-1])
    assert (found.variance == 0.5).all() and found.innovation_covariance.shape == (2000, 1, 1)
    assert found.nis == pytest.approx(np.full(2000, 0.005))
    assert np.array_equal(found.columns["count"], np.arange(2000))
    with pytest.raises(FilterDiverged, match=r"'plain' diverged at step 7, t = 0\.007 s"):
        Plain(fails_at=7).estimate(signals, known)
    out, failed, status = stepped(Plain(fails_at=7).step(known, 1e-3), as_samples(signals, (), known, True))
    assert (failed, status) == (7, 1) and (out[7:] == 0).all()


class Telling(Plain):
    """Reports its last outputs."""

    def reason(self, status, out):
        return f"status {status}, after {[round(float(x), 6) for x in out]}"


@pytest.mark.parametrize("fails_at", [0, 1, 9, 10, 11, 57, 1999])
def test_a_divergence_is_reported(known, signals, fails_at):
    """Sample, time and last outputs; none at the first sample."""
    estimator = Telling(fails_at=fails_at)
    with pytest.raises(FilterDiverged) as whole:
        estimator.estimate(signals, known)
    expected = f"step {fails_at}, t = {signals.time[fails_at]:g} s"
    before = fails_at - 1
    said = [6.03 * signals["current_command"][before - 1] if before else 0.0, 0.5, 0.1, 2.0, before]
    said = [round(float(x), 6) for x in said] if fails_at else [0.0] * 5
    assert expected in str(whole.value) and str(said) in str(whole.value)


def test_a_failing_python_step_gives_its_reason(known, signals):
    class Failing(Plain):
        compiled = PythonStep(lambda *records: 1 // 0, _plain.records)

    with pytest.raises(
        FilterDiverged, match=r"at step 0, .* its step failed: ZeroDivisionError: integer division or modulo by zero"
    ):
        Failing("failing").estimate(signals, known)


def entry(value: str, name: str = "foreign") -> EntryPoint:
    return EntryPoint(name, value, "flexspline.estimators")


@dataclass(frozen=True)
class Failing(Plain):
    """Cannot be made without an argument."""

    def __init__(self, needed: float):
        raise AssertionError


def test_estimators_of_other_packages(monkeypatch, known, signals):
    """Found by entry points, loaded on request; a broken one gives its fault in a line."""
    points = [
        entry("test_estimator:FOREIGN"),
        entry("test_estimator:Plain", "plain"),
        entry("test_estimator:FOREIGN", "renamed"),
        entry("test_estimator:Failing", "failing"),
        entry("nowhere.at_all:X", "broken"),
        entry("sys:path", "none"),
        entry("x:y", "EKF"),
    ]
    monkeypatch.setattr(plugins, "entry_points", lambda group: points if group.endswith("estimators") else [])
    plugins._installed.cache_clear()
    plugins._offers.cache_clear()
    wrong = (
        ("broken", "ModuleNotFoundError: No module named 'nowhere'"),
        ("none", r"expected a subclass of flexspline.estimator.estimator.Estimator, got list"),
        ("renamed", "name: expected 'renamed', its entry point, got 'foreign'"),
        ("failing", "TypeError: .*needed"),
    )
    try:
        assert {"foreign", "plain", "EKF", *(name for name, _ in wrong)} <= set(registry.names())
        assert registry.get("foreign") is FOREIGN and registry.get("plain") == Plain()
        assert registry.origin("foreign").name == "an installed package"
        assert registry.get("EKF").rule == "ekf" and registry.origin("EKF").name == "flexspline"
        for name, part in wrong:
            with pytest.raises(InputError, match=part) as caught:
                registry.get(name)
            assert name in str(caught.value) and "\n" not in str(caught.value)
    finally:
        plugins._installed.cache_clear()
        plugins._offers.cache_clear()


@pytest.mark.parametrize("field", ["mean", "variance", "external"])
def test_a_posterior_is_as_long_as_its_time(field):
    given = {"mean": np.zeros(3)} | {field: np.zeros(2)}
    with pytest.raises(InputError, match=rf"estimator 'mine': {field}: expected shape \(3,\), got \(2,\)"):
        Posterior("mine", np.arange(3.0), **given)


FOREIGN = Plain("foreign")


def test_the_registry_is_cheap():
    """Names and defaults without the imports of single estimators."""
    program = "import flexspline.estimator.registry as r, sys; r.get('EKF'); print(*sorted(m for m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not loaded & {"scipy.signal", "scipy.stats", "statsmodels", "matplotlib", "pandas"}


def test_no_field_is_called_like_the_contract():
    """A tuning parameter must not hide a method: the paper's `memory` is one of its readings."""
    contract = {
        "estimate",
        "step",
        "scaled",
        "settings",
        "outputs",
        "posterior",
        "compiled",
        "needs",
        "tuning",
    }
    for name in NAMES:
        assert not contract & {f.name for f in fields(registry.get(name))}


def test_normalised_innovations_squared(rng):
    """e² over S, eᵀ S⁻¹ e of two; none at the start. S of angles is far below one."""
    time, size = np.arange(5), 1e-6
    A = size * rng.standard_normal((5, 2, 2))
    S, e = A @ A.transpose(0, 2, 1), size * rng.standard_normal((5, 2))
    S[0], S[1, 1] = 0.0, 0.0
    several = Posterior("any", time, np.zeros(5), innovation=e, innovation_covariance=S).nis
    assert several == pytest.approx([0.0, 0.0, *(e[k] @ np.linalg.solve(S[k], e[k]) for k in (2, 3, 4))])
    one = Posterior("any", time, np.zeros(5), innovation=e[:, :1], innovation_covariance=S[:, :1, :1]).nis
    assert one == pytest.approx([0.0, *(e[1:, 0] ** 2 / S[1:, 0, 0])])
    assert Posterior("any", time, np.zeros(5), innovation=e).nis is None


def test_places_between_bounds():
    """Equal steps are equal factors where the scale is logarithmic, equal differences where it is linear; beyond, the bounds."""
    log, linear = TuningParameter("x", 0.1, 1000.0), TuningParameter("x", 2.0, 10.0, "linear")
    assert [log.from_unit(p) for p in (-1.0, 0.0, 0.25, 0.5, 1.0, 7.0)] == pytest.approx(
        [0.1, 0.1, 1.0, 10.0, 1000.0, 1000.0]
    )
    assert [linear.from_unit(p) for p in (-1.0, 0.0, 0.25, 1.0, 7.0)] == pytest.approx([2.0, 2.0, 4.0, 10.0, 10.0])
    assert [log.to_unit(x) for x in (0.0, 0.1, 10.0, 1e9)] == pytest.approx([0.0, 0.0, 0.5, 1.0])
    assert [linear.to_unit(x) for x in (0.0, 4.0, 10.0, 1e9)] == pytest.approx([0.0, 0.25, 1.0, 1.0])
