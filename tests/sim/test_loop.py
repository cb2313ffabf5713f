"""The closed loop: every channel by name is what its law says of the truth; estimators in it and after it are the same."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from driving import JOINT, record_of
from looping import motion, run

from flexspline.models.controller import Controller
from flexspline.models.joint_parts import AnalogSpec, EncoderSpec
from flexspline.models.signals import READINGS, SENSED, WRENCH, Signals
from flexspline.models.step import SAMPLE, CompiledStep, step_of
from flexspline.sim import plant
from flexspline.sim.loop import CONTROL_PERIOD, Change, ClosedLoop, Driven
from flexspline.sim.sensors import noise, sensor_records

QUIET = {"motor_encoder": EncoderSpec(bits=38), "link_encoder": EncoderSpec(bits=38)} | {
    name: AnalogSpec() for name in ("motor_current", "motor_torque", "joint_torque", "temperature")
}


def sensing(**specs):
    """The test joint with ideal sensors but for those given."""
    sensors = JOINT.sensors.model_copy(update=QUIET | {"wrench": JOINT.sensors.wrench.model_copy(
        update={"force_noise": 0.0, "torque_noise": 0.0})} | specs)  # fmt: skip
    return JOINT.model_copy(update={"sensors": sensors})


def test_ideal_sensors_read_the_truth():
    s = run(sensing())
    for name in ("motor_position", "link_position", "motor_current", "joint_torque"):
        np.testing.assert_allclose(s.readings[name], s.truth[name], rtol=1e-12, atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(s.readings["temperature"], 25.0)


def test_every_channel_reads_its_law():
    """Zero, orders, offsets, gains and drift as the specification's table states them, of the true state."""
    record = record_of(
        motor_eccentricity=8e-3, motor_eccentricity_phase=0.4, link_zero=1e-3, current_offset=0.1, torque_gain=1.1,
        torque_offset=0.3, torque_rate=-0.02, Kt_drive=0.05,
    )  # fmt: skip
    p = record[0]
    p["link_error_order"][:2], p["link_error_amplitude"][:2], p["link_error_phase"][:2] = [1, 2], [4e-4, 2e-4], [0.6, 2]
    s = run(sensing(), record=record)
    motor, link, current, torque = (
        s.truth[name] for name in ("motor_position", "link_position", "motor_current", "joint_torque")
    )
    np.testing.assert_allclose(
        s.readings["motor_position"], motor + 8e-3 * (np.sin(motor + 0.4) - np.sin(0.4)), atol=1e-9
    )
    expected = link + 1e-3 + 4e-4 * (np.sin(link + 0.6) - np.sin(0.6)) + 2e-4 * (np.sin(2 * link + 2) - np.sin(2))
    np.testing.assert_allclose(s.readings["link_position"], expected, atol=1e-9)
    np.testing.assert_allclose(s.readings["motor_current"], current + 0.1, atol=1e-12)
    np.testing.assert_allclose(s.readings["motor_torque"], 0.05 * (current + 0.1), atol=1e-12)
    np.testing.assert_allclose(s.readings["joint_torque"], 1.1 * torque + 0.3 - 0.02 * s.time, atol=1e-9)


def test_a_torque_constant_that_the_drive_does_not_know():
    """Where the motor's own differs from the drive's, the torque it reports is current times the one it believes in."""
    s = run(sensing(), record=record_of(Kt=0.07))
    np.testing.assert_allclose(s.readings["motor_torque"], 0.0603 * s.readings["motor_current"], rtol=1e-12)


def test_the_whole_wrench_by_name():
    """The link's weight and inertia on the sensor: force and torque in its frame, from the motion alone.

    The link is a mass at a lever in the plane of motion: m a − m g, turned into the link's frame. About the joint's axis,
    y, it is −Ts; across it nothing, as the mass moves in the sensor's plane.
    """
    s = run(sensing())
    theta, omega = s.truth["link_position"], s.truth["link_velocity"]
    alpha = np.gradient(omega, s.time)
    g, lever = 9.80665, 0.6 * 0.35 / (9.0 / 9.80665)
    lever = min(0.25, lever)
    mass = 9.0 / g / lever
    # Along the link's axis (−z at rest) and across it (x), in the link's frame.
    push = np.where(motion()[2] != 0, np.nan, 1.0)  # where nothing pushes
    still = np.convolve(np.isnan(push), np.ones(9), mode="same") == 0
    still[:20] = False
    across = mass * (lever * alpha + g * np.sin(theta))
    along = mass * (lever * omega**2 + g * np.cos(theta))
    for name, expected in (("force_x", across), ("force_z", along)):
        error = (s.readings[name] - expected)[still]
        assert np.sqrt(np.mean(error**2)) < 0.01 * np.ptp(expected) + 1e-3, name
    np.testing.assert_allclose(-s.readings["torque_y"], s.truth["joint_torque"], atol=0.02)
    for name in ("force_y", "torque_x", "torque_z"):
        np.testing.assert_allclose(s.readings[name], 0.0, atol=1e-9, err_msg=name)
    assert set(WRENCH) <= set(READINGS.names)


def through(x, bandwidth):
    """Samples every millisecond through a first-order low-pass [Hz], straight between them: its differential equation solved."""
    step = 2 * np.pi * bandwidth * 1e-3
    share = 1 - np.exp(-step)
    found = [x[0]]
    for before, now in pairwise(x):
        found.append(np.exp(-step) * found[-1] + (1 - share / step) * now + (share / step - 1 + share) * before)
    return np.array(found)


def test_a_low_pass_and_a_ripple_in_the_loop():
    """The current through 200 Hz with a ripple over the motor's angle, against both applied to the truth afterwards."""
    spec = AnalogSpec(bandwidth=200.0, ripple={"order": 18, "amplitude": 5e-3, "phase": 0.3})
    s = run(sensing(motor_current=spec))
    motor, current = s.truth["motor_position"], s.truth["motor_current"]
    expected = through(current + 5e-3 * np.sin(18 * motor + 0.3), 200.0)
    np.testing.assert_allclose(s.readings["motor_current"], expected, atol=1e-9)
    assert np.std(s.readings["motor_current"] - current) > 3e-3


def test_a_late_torque_sensor_with_crosstalk():
    s = run(sensing(joint_torque=AnalogSpec(delay=0.0015, crosstalk=0.16)))
    seen = s.truth["joint_torque"] + 0.16 * np.cos(s.truth["link_position"])
    late = np.interp(s.time - 0.0015, s.time, seen)
    np.testing.assert_allclose(s.readings["joint_torque"], late, atol=1e-9)


def test_temperature_goes_through_the_loop():
    """Friction falls as the gear warms, the sensor reads the temperature, and without a coefficient nothing changes."""
    n = len(motion()[0])
    warm = np.linspace(25.0, 45.0, n)
    plain, heated = run(sensing()), run(sensing(), temperature=warm)
    np.testing.assert_array_equal(heated.readings["temperature"], warm)
    np.testing.assert_array_equal(heated.truth["motor_current"], plain.truth["motor_current"])
    record = record_of(friction_temperature=-0.02)
    less = run(sensing(), record=record, temperature=warm)
    constant = run(sensing(), record=record)
    own = run(sensing(), record=record_of(friction_asymmetry=1e-12))  # the callback's bristle, as with a temperature
    np.testing.assert_allclose(constant.truth["motor_current"], own.truth["motor_current"], atol=1e-6)
    moving = np.abs(less.truth["wave_generator_velocity"]) > 10
    w = less.truth["wave_generator_velocity"][moving]
    # Steady sliding: friction is what rotor and wave generator do not need for load and inertia.
    friction = _mesh_friction(less)[moving]
    expected = np.sign(w) * (0.018 + 6e-5 * np.abs(w)) * (1 - 0.02 * (warm[moving] - 25.0))
    assert np.sqrt(np.mean((friction - expected) ** 2)) < 0.02 * np.std(expected)


def _mesh_friction(s):
    """Mesh friction [N·m] of the truth, from the wave generator's balance: Tw − Tf (1/N − θerr') − Jw w'."""
    p = JOINT.record()[0]
    x, w = s.truth["wave_generator_position"], s.truth["wave_generator_velocity"]
    slope = sum(k * a * np.cos(k * x + f) for k, a, f in zip(p["order"], p["amplitude"], p["phase"], strict=True))
    torque = s.truth["wave_generator_torque"] - s.truth["flexspline_torque"] * (1 / p["N"] - slope)
    return torque - p["Jw"] * np.gradient(w, s.time)


# --- estimators in the loop and after it -------------------------------------------------------------------------


def recording_step(kept):
    """A step that keeps what it was given and answers with its own torque."""

    def step(m, s, p, c, o):
        kept.append(s.item())
        m.total += s.motor_current
        o.torque = 0.5 * m.total + p.Jl
        return 0

    return step_of(np.dtype([("total", float)]), plain=True)(step)


@pytest.mark.parametrize("reads_command", [False, True])
def test_an_estimator_is_given_in_the_loop_what_it_reads_afterwards(reads_command):
    kept = []
    step = recording_step(kept)
    s = run(feedback=CompiledStep(step.address, 1, JOINT.record(), reads_command=reads_command))
    assert step.error is None and s.failed == (len(s.time), 0)
    given = np.array(kept, SAMPLE)
    np.testing.assert_array_equal(given["time"], s.time)
    np.testing.assert_array_equal(given["interval"], np.diff(s.time, prepend=0.0))
    known = np.r_[0.0, s.command[:-1]] if reads_command else np.full(len(s.time), np.nan)
    np.testing.assert_array_equal(given["current_command"], known)
    later = {"joint_torque", *WRENCH}  # known only once the plant has stepped
    for name in SENSED:
        if name in later:
            assert np.isnan(given[name]).all(), name
        else:
            np.testing.assert_array_equal(given[name], s.readings[name], err_msg=name)


def test_a_step_that_fails_ends_the_loop_and_keeps_its_error():
    @step_of(np.dtype([("nothing", float)]), plain=True)
    def failing(m, s, p, c, o):
        if s.time > 0.05:
            raise ZeroDivisionError("no torque")
        return 0

    s = run(feedback=CompiledStep(failing.address, 1, JOINT.record()))
    assert s.failed == (51, -1)
    assert isinstance(failing.error, ZeroDivisionError)


def test_feedback_of_the_sensor_itself():
    """The torque sensor's reading of the tick before, as a step that cannot know it would have to be given."""
    s, without = run(feedback="sensor"), run()
    pushed = motion()[2] != 0
    error, plain = (np.abs(motion()[0] - x.truth["link_position"])[pushed].mean() for x in (s, without))
    assert error < 0.7 * plain


def test_same_seed_same_bits_and_other_noise_elsewhere():
    a, b, c = run(), run(), run(seed=4)
    assert a.readings.tobytes() == b.readings.tobytes() and a.truth.tobytes() == b.truth.tobytes()
    assert a.truth.tobytes() == c.truth.tobytes()  # the motor encoder has counts and no noise
    assert (a.readings["link_position"] != c.readings["link_position"]).mean() > 0.2


def test_a_model_serves_many_threads_and_is_unchanged():
    """Temperatures and switches that the loop sets on its way are its own."""
    model = plant.build(JOINT, JOINT.mount("link"))
    flags = model.opt.disableflags
    warm = 30.0 + np.arange(2000) * 5e-3
    alone = [run(temperature=given) for given in (None, warm)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda i: run(temperature=(None, warm)[i % 2], model=model), range(8)))
    for i, found in enumerate(together):
        np.testing.assert_array_equal(found.readings, alone[i % 2].readings)
        np.testing.assert_array_equal(found.truth, alone[i % 2].truth)
    assert model.opt.disableflags == flags


def test_readings_are_signals_by_name():
    s = run()
    signals = Signals(s.time, {name: s.readings[name] for name in SENSED})
    np.testing.assert_array_equal(signals["torque_y"], s.readings["torque_y"])


# --- what a new sensor costs -------------------------------------------------------------------------------------

_NEW_CHANNEL = '    Channel("spring_force", "N", "a load cell on the cable", "load_cell"),\n'
_NEW_LAW = "    out.spring_force = 2.0 * state.link_position + 1.0\n"
_USE = """
import numpy as np, sys
from itertools import pairwise
from pathlib import Path
from flexspline.models.joint import load_joint, as_joint
from flexspline.models.recording import Recording, read_recording, write_recording
from flexspline.models.signals import CHANNELS
from flexspline.models.step import SAMPLE
sys.path.insert(0, sys.argv[1])
from looping import run
data = load_joint("test-joint").model_dump()
data["sensors"] = data["sensors"] | {"load_cell": {"noise": 0.01, "step": 0.5}}
joint = as_joint(data, Path(load_joint("test-joint").mjcf))
s = run(joint, seconds=0.2, distance=0.5)
got = s.readings["spring_force"]
expected = 2.0 * s.truth["link_position"] + 1.0
assert np.abs(got - expected).max() < 0.3 and np.ptp(expected) > 0.5
assert np.allclose(got / 0.5, np.round(got / 0.5))
names = ("motor_position", "motor_current", "spring_force")
r = Recording("a", s.time, {name: s.readings[name] for name in names})
again = read_recording(write_recording(r, sys.argv[2]))
assert np.array_equal(again["spring_force"], got) and again.signals["spring_force"] is not None
assert "spring_force" in SAMPLE.names
print("done")
"""


@pytest.mark.slow
@pytest.mark.long
def test_a_new_sensor_is_one_channel_and_its_law(tmp_path):
    """One entry in `signals.CHANNELS` and one line in `dynamics.readings`: simulated, noisy, recorded, given to estimators."""
    root, package = Path(__file__).resolve().parents[2], tmp_path / "package" / "flexspline"
    for room in ("models", "sim"):
        shutil.copytree(root / room, package / room, ignore=shutil.ignore_patterns("__pycache__"))
    for file, place, line in (
        ("signals.py", '    *(Channel(f"force_{a}"', _NEW_CHANNEL),
        ("dynamics.py", "    out.temperature = state.temperature\n", _NEW_LAW),
    ):
        path = package / "models" / file
        text = path.read_text(encoding="utf-8")
        assert text.count(place) == 1
        path.write_text(text.replace(place, line + place), encoding="utf-8")
    (package / "__init__.py").touch()
    script = tmp_path / "use.py"
    script.write_text(_USE, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "package")}
    done = subprocess.run(
        [sys.executable, str(script), str(Path(__file__).parent), str(tmp_path / "out")],
        env=environment, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.stdout.strip() == "done", done.stderr[-2000:]


def test_a_flexible_payload_shows_in_the_sensor():
    """The wrench about the axis stays the joint's torque where part of the link's inertia swings on its own."""
    record = record_of(flexible_share=0.3, flexible_frequency=18.0, flexible_damping=0.02)
    s = run(sensing(), record=record)
    np.testing.assert_allclose(-s.readings["torque_y"], s.truth["joint_torque"], atol=0.03)
    rigid = run(sensing())
    assert np.std(s.truth["joint_torque"] - rigid.truth["joint_torque"]) > 0.05


def test_imperfections_of_every_sensor_at_once():
    """Encoders once and twice per turn and within counts, a late torque sensor with 1/f noise, vibration and crosstalk."""
    specs = {
        "motor_encoder": EncoderSpec(counts=4096, cyclic_error=0.2),
        "joint_torque": AnalogSpec(
            delay=0.001, flicker=0.02, vibration={"frequency": 40.0, "amplitude": 0.012}, crosstalk=0.16
        ),
        "motor_current": AnalogSpec(bandwidth=150.0, ripple={"order": 24, "amplitude": 6e-3, "phase": 1.0}, noise=0.01),
    }
    joint = sensing(**specs)
    record = record_of(motor_eccentricity=6e-4, motor_eccentricity_phase=-0.7)
    p = record[0]
    p["link_error_order"][0], p["link_error_amplitude"][0], p["link_error_phase"][0] = 2.0, 1.2e-5, 0.9
    s = run(joint, record=record)
    added = noise(joint, 3, len(s.time), 1e-3)
    motor, link = s.truth["motor_position"], s.truth["link_position"]
    count = 2 * np.pi / 4096
    seen = motor + 6e-4 * (np.sin(motor - 0.7) - np.sin(-0.7))
    seen += 0.2 * count * np.sin(2 * np.pi * seen / (4 * count))
    assert np.abs(s.readings["motor_position"] - seen).max() <= 0.5 * count * (1 + 1e-6)
    np.testing.assert_allclose(
        s.readings["link_position"], link + 1.2e-5 * (np.sin(2 * link + 0.9) - np.sin(0.9)), atol=1e-10
    )
    torque = s.truth["joint_torque"] + 0.16 * np.cos(link)
    np.testing.assert_allclose(s.readings["joint_torque"][1:], torque[:-1] + added["joint_torque"][1:], atol=1e-9)
    assert added["joint_torque"].std() == pytest.approx(np.hypot(0.02, 0.012), rel=0.05)
    current = through(s.truth["motor_current"] + 6e-3 * np.sin(24 * motor + 1.0), 150.0)
    np.testing.assert_allclose(s.readings["motor_current"], current + added["motor_current"], atol=1e-9)


def test_a_change_to_the_same_numbers_changes_nothing():
    """Another model of the same numbers in the middle of the motion: the same to the bit."""
    position, velocity, external = motion()
    record = JOINT.record(JOINT.mount("link"))
    driven = Driven(
        record, position, velocity, external, sensor_records(JOINT, 0.0, CONTROL_PERIOD),
        noise(JOINT, 3, len(position), CONTROL_PERIOD), Controller().record(record[0], CONTROL_PERIOD, False),
    )  # fmt: skip
    models = [plant.build(JOINT, JOINT.mount("link")) for _ in range(2)]
    found = []
    for changes in ((), (Change(700, models[1], record),)):
        loop = ClosedLoop(models[0], (driven,), changes)
        loop.advance(len(position))
        found.append(loop.simulation)
    assert found[0].truth.tobytes() == found[1].truth.tobytes()
    assert found[0].readings.tobytes() == found[1].readings.tobytes()
