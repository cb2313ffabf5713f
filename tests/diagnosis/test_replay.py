"""The replay: with the true numbers only the sensors' noise is left; with wrong ones only the right balance breaks."""

from dataclasses import replace

import numpy as np
import pytest
from hidden_joint import measure

from flexspline.diagnosis.data.segments import STEP, _encoder_noise, segments
from flexspline.diagnosis.fit.coordinates import hypotheses
from flexspline.diagnosis.fit.encoder_zero import zeroed
from flexspline.diagnosis.fit.replay import READ_OUT, residual, residuals, transmission
from flexspline.diagnosis.fit.residual import TIMING, Problem
from flexspline.diagnosis.trials.draw import Challenge, draw
from flexspline.diagnosis.trials.motions import motions, record_motion
from flexspline.estimator.offline import estimate_recording
from flexspline.models import causes
from flexspline.models.characteristics import characteristics
from flexspline.models.joint import as_joint, load_joint
from flexspline.models.joint_parts import Effect, Estimate
from flexspline.models.motion import smooth


@pytest.fixture(scope="module")
def joint():
    return load_joint("test-joint")


@pytest.fixture(scope="module")
def replayed(joint):
    """Segments of a joint that has exactly its nominal numbers."""
    measurement, _ = measure(joint, seed=3, exact=True)
    return segments(list(measurement.recordings), joint)[0]


def rms(joint, replayed, change=lambda p: None):
    """RMS of each channel while the rotor moves."""
    left = [[], [], []]
    for segment in replayed:
        record = joint.record(segment.mounting)
        change(record[0])
        r = residual(segment, record)
        for c in range(3):
            left[c].append(r[segment.usable[:, c] & ~segment.at_rest, c])
    return np.array([np.sqrt(np.mean(np.concatenate(x) ** 2)) for x in left])


@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_sensors_that_are_all_as_late_tell_of_the_same_joint(joint, delay):
    """Times count from the motor's encoder: the link was shifted against it by a delay that both have.

    With 2 ms the drive swings.
    """
    data = joint.model_dump()
    for sensor in ("motor_encoder", "link_encoder", "motor_current", "joint_torque"):
        data["sensors"][sensor]["delay"] = delay
    late = as_joint(data, joint._path)
    recording = recorded(late, late)
    found = rms(late, segments([recording], late)[0])
    assert found[0] < 0.01 and np.all(found[1:] < 0.03), found
    reported = estimate_recording(recording, late, ("RAREKF",)).torque["RAREKF"] - recording["joint_torque"]
    assert np.sqrt(np.nanmean(reported[200:-200] ** 2)) < 0.2


def test_a_gear_whose_temperature_nobody_read_has_that_of_its_description(joint):
    data = joint.model_dump()
    data["numbers"]["reference_temperature"] = {"value": 45.0, "unit": "°C", "source": "bench"}
    warm = as_joint(data, joint._path)
    heated = warm.model_copy(update={"effects": [friction_by_temperature()]})
    recording = recorded(heated, heated)
    read = replace(recording, columns={**recording.columns, "temperature": np.full(len(recording.time), 45.0)})
    one, other = (rms(heated, segments([r], heated)[0]) for r in (recording, read))
    np.testing.assert_allclose(one, other, rtol=1e-9)
    assert one[0] < 0.01
    curve, plain = characteristics(heated).friction, characteristics(warm).friction
    np.testing.assert_allclose(curve, plain, rtol=1e-12)


def friction_by_temperature() -> Effect:
    return Effect(name="friction_temperature", parameters={"coefficient": Estimate(value=0.02, unit="1/K")})


def recorded(joint, true):
    """A sweep of a joint that has exactly the numbers of a description."""
    scenario, mounting = motions(np.random.default_rng(0))[2], true.mount("link")
    return record_motion(joint, mounting, true.record(mounting), scenario, 5)


def test_true_numbers_leave_the_sensors_noise(joint, replayed):
    current, torque, link = rms(joint, replayed)
    assert current < 0.01
    assert torque < 0.02
    assert link < 0.02


@pytest.mark.parametrize(
    ("name", "values", "broken"),
    [
        ("torque_constant", {"value": 0.066}, [0]),
        ("current_offset", {"value": 0.1}, [0]),
        ("link_inertia", {"scale": 1.5}, [2]),
        ("gravity_moment", {"scale": 1.1}, [2]),
        ("torque_sensor_gain", {"gain": 1.1}, [1, 2]),
    ],
)
def test_an_effect_breaks_only_the_balances_that_it_touches(joint, replayed, name, values, broken):
    before, after = (rms(joint, replayed, f) for f in (lambda p: None, lambda p: causes.get(name).apply(p, values)))
    assert [c for c in range(3) if after[c] > 1.5 * before[c]] == broken


def test_numbers_that_are_read_out_move_nothing_inside_the_transmission(joint, replayed):
    segment = replayed[0]
    record = joint.record(segment.mounting)
    inner = transmission(segment, record)
    for name in READ_OUT:
        changed = record.copy()
        changed[name] = 1.1 * changed[name] + 1e-3
        assert np.array_equal(transmission(segment, changed), inner), name
        assert np.array_equal(residuals([(segment, record), (segment, changed)])[1], residual(segment, changed)), name
    inside = [name for name in record.dtype.names if name not in READ_OUT]
    moving = [name for name in ("K1", "Kw0", "Fc", "bw", "Jw", "link_zero", "amplitude", "df") if name in inside]
    assert len(moving) == 8
    for name in moving:
        changed = record.copy()
        changed[name] = 1.1 * changed[name] + 1e-6
        assert not np.array_equal(transmission(segment, changed), inner), name


def test_at_the_true_numbers_nothing_is_left_but_noise_at_any_speed(joint):
    """The noise replicates draw the sensors' noise again: as much as that, and no more, is left of torque and link balance."""
    measurement, _ = measure(joint, seed=11, exact=True)
    for segment, replicate in zip(*segments(list(measurement.recordings), joint), strict=True):
        record = joint.record(segment.mounting)
        left = residual(segment, record)
        share = residual(replicate, record) - left
        speed = np.abs(segment.state[:, 2])
        # The fourth order of the gear leaves the smoother's passband at the fastest.
        for slowest, fastest in ((15.0, 40.0), (40.0, 70.0), (70.0, 200.0)):
            for c in (1, 2):
                use = segment.usable[:, c] & (speed > slowest) & (speed < fastest)
                if use.sum() > 200:
                    # Below one where the counts happen to beat with the sampling.
                    assert 0.75 < np.std(left[use, c]) / np.std(share[use, c]) < 1.15, (segment.recording, slowest, c)


@pytest.mark.parametrize("stiffness", [1.0, 10.0, 50.0])
@pytest.mark.parametrize("frequency", [20.0, 60.0])
def test_a_linear_transmission_answers_as_its_equation_does(joint, replayed, frequency, stiffness):
    """No friction: Jw θw'' = Kw (θm − θw) + dw (θm' − θw') − bw θw' − K1 θw/N² − df θw'/N², the rotor shaken and the link held.

    A step h may change the inertia by (Ωh)²/6 and dampings by (Ωh)²/8. Were the angles in the middle of a step not all made in
    one way, the spring would add Kw h²/8 to the inertia: 17 and 80 % of it at 10 and 50 N·m/rad."""
    record = joint.record(replayed[0].mounting)
    p = record[0]
    for name in ("Fc", "Fs", "s0", "s1"):
        p[name] = 1e-12
    p["Kw0"], p["Cw"], p["amplitude"], p["K2"], p["K3"] = stiffness, 1e-9, 0.0, p["K1"], p["K1"]
    time, pulsation = np.arange(0.0, 2.0, STEP), 2 * np.pi * frequency
    shaken = 1e-2 * np.exp(1j * pulsation * time)
    rotor = np.column_stack([(shaken * (1j * pulsation) ** k).imag for k in range(3)])
    segment = replace(
        replayed[0], time=time, rotor=rotor, link=np.zeros((len(time), 3)), external=np.zeros(len(time)),
        arm=np.zeros(len(time)), temperature=np.full(len(time), 20.0),
    )  # fmt: skip
    found = transmission(segment, record)["wave_generator_position"]
    coupled = p["Kw0"] + 1j * pulsation * p["dw"]
    load = p["K1"] / p["N"] ** 2 + 1j * pulsation * (p["df"] / p["N"] ** 2 + p["bw"])
    answer = coupled / (coupled + load - p["Jw"] * pulsation**2)
    late = time > 1.0
    turned = np.column_stack([shaken.imag, shaken.real])[late]
    (real, imaginary), *_ = np.linalg.lstsq(turned, found[late], rcond=None)
    # The torque that is wrong, of that which accelerates the wave generator.
    accelerates = p["Jw"] * pulsation**2
    wrong = abs((real + 1j * imaginary) / answer - 1.0) * abs(coupled + load - accelerates) / accelerates
    damps = pulsation * (p["dw"] + p["bw"] + p["df"] / p["N"] ** 2) / accelerates
    limit = (pulsation * STEP) ** 2 * (1 / 6 + damps / 8)
    print(f"{frequency:g} Hz, {stiffness:g} N·m/rad: {wrong:.4f} of the inertia's torque, limit {limit:.4f}")
    assert wrong < limit


@pytest.mark.parametrize("interval", [1e-3, 4e-3])
def test_noise_replicates_are_as_noisy_as_the_encoder(interval, joint, rng):
    """Counts of a smooth motion, drawn again, leave as much of position, rate and acceleration as the first time."""
    time = np.arange(0, 6, interval) + rng.uniform(0, 0.05 * interval, round(6 / interval))
    true = 60 * (1 - np.cos(0.9 * time)) + 2e-3 * np.sin(40 * time)
    encoder = joint.sensors.motor_encoder
    read = np.round(true / encoder.resolution) * encoder.resolution
    again = _encoder_noise(time, read, encoder, rng)
    s = smooth(time, np.column_stack([read - true, again]), 1e-3)
    inside = slice(500, -500)
    for part in (s.value, s.rate, s.acceleration):
        first, second = np.std(part[inside], axis=0)
        assert 0.8 < second / first < 1.25


@pytest.fixture(scope="module")
def problem(joint):
    measurement, _ = measure(joint, seed=3, exact=True)
    return Problem(*segments(list(measurement.recordings), joint), joint)


def difference(problem, theta, model, j, step=1e-6):
    """Derivative of the residuals by an unknown, from another replay; shape (total, len(BALANCES)).

    The step is as small as rounding lets it be: friction that turns round a sample later makes jumps of a larger one.
    """
    base, ahead = problem.residuals([theta, theta + step * np.eye(len(theta))[j]], [model, model])
    return np.concatenate([(b - a) / step for a, b in zip(base, ahead, strict=True)])


@pytest.mark.parametrize("described", [True, False])
def test_a_torque_sensor_that_is_late_is_late_in_every_balance_that_reads_it(joint, described):
    """By 1.8 ms: the link's balance, which an inertia shakes at 20 Hz, is as good as with a sensor that is not."""
    measurement, _ = measure(joint, seed=3, exact=True)
    late = 1.8e-3
    recordings = [
        replace(r, columns={**r.columns, "joint_torque": np.interp(r.time - late, r.time, r["joint_torque"])})
        for r in measurement.recordings
    ]
    torque = joint.sensors.joint_torque.model_copy(update={"delay": late})
    sensors = joint.sensors.model_copy(update={"joint_torque": torque})
    known = joint.model_copy(update={"sensors": sensors}) if described else joint
    known._path = joint._path

    def left(recordings, joint, x=0.0):
        problem = Problem(*segments(list(recordings), joint), joint)
        theta = np.zeros(problem.size)
        theta[problem.calibration.size + 1] = x
        found = problem.residuals([theta], [()])[0]
        use = [s.usable & ~s.at_rest[:, None] for s in problem.segments]
        return np.array(
            [
                np.sqrt(np.mean(np.concatenate([r[u[:, c], c] for r, u in zip(found, use, strict=True)]) ** 2))
                for c in (1, 2)
            ]
        )

    punctual = left(measurement.recordings, joint)
    unknown = left(recordings, joint)
    mended = left(recordings, known, 0.0 if described else -late / TIMING[1])
    print("torque, link [N·m]: punctual", punctual, "late", unknown, "reported", mended)
    assert np.all(mended < 1.05 * punctual) and np.all(unknown > 1.3 * punctual)


def test_derivatives_of_the_replay_are_those_of_differences(problem):
    """Every number with a tolerance, and the times of the samples."""
    theta = np.random.default_rng(7).normal(0, 0.5, problem.size)
    theta = zeroed(problem, theta, ())
    J = np.concatenate(problem.jacobian(theta, ()))
    for j in range(problem.size):
        numeric = difference(problem, theta, (), j)
        assert np.any(numeric), j
        assert np.linalg.norm(J[..., j] - numeric) < 0.01 * np.linalg.norm(numeric), j


@pytest.mark.parametrize("name", [n for n in causes.names() if n != "friction_temperature"])  # no temperature was read
def test_derivatives_by_an_effect_are_those_of_differences(problem, name):
    """At a quarter of the ordinary size, and where the effect is absent, from the side on which it may be."""
    cause = causes.get(name)
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    h = hypotheses(cause, record)[0]
    absent = h.coordinates(h.cause.centre(record[0], h.fixed))
    for size in (0.25, 0.0):
        theta = np.concatenate([np.zeros(problem.size), absent])
        for j in h.magnitudes:
            theta[problem.size + j] += size
        theta[problem.size :] = h.confine(theta[problem.size :])
        # Coordinates of place say nothing while there is no effect.
        columns = [problem.size + j for j in (range(h.size) if size else h.magnitudes)]
        J = np.concatenate(problem.jacobian(theta, (h,), np.array(columns)))
        for i, j in enumerate(columns):
            # Where there is no effect, differences replace derivatives by an amplitude with a phase, and the like.
            bent = not size and (h.polar or name in ("back_driving", "payload"))
            numeric = difference(problem, theta, (h,), j)
            assert np.linalg.norm(J[..., i] - numeric) <= (0.05 if bent else 0.01) * np.linalg.norm(numeric), (size, j)


def test_where_the_replay_runs_into_the_end_of_a_law_derivatives_stay_bounded(problem):
    """A link encoder that is said to be 5 ms late, and is not: its motion winds the wave generator up to where it is rigid."""
    h = hypotheses(causes.get("encoder_delay"), problem.calibration.record(np.zeros(problem.calibration.size)))[0]
    theta = np.concatenate([np.zeros(problem.size), h.coordinates({"seconds": 5e-3})])
    J = np.concatenate(problem.jacobian(theta, (h,), np.array([problem.size])))[..., 0]
    numeric = difference(problem, theta, (h,), problem.size, 0.03)
    assert np.abs(J).max() < 3 * np.abs(numeric).max()


def test_derivatives_that_no_number_can_have_are_replaced_wherever_they_are(joint):
    """Far from the true joint the replay is driven into the end of a law in more than a tenth of the samples: what is usual
    there is no measure. No unknown moves a residual by a million newton metres in a standard deviation."""
    drawn = draw(Challenge(hidden="two", seed=1003, real=True), 19)
    problem = Problem(*segments(list(drawn.measurement.recordings), drawn.nominal), drawn.nominal)
    theta = np.array([
        1.91585746, -2.6, 0.304241513, -1.97020650, 2.54329793, 1.87808359, 0.768807111, -0.0605921360, -1.53834425,
        0.158965947, 0.721069582, 2.53495870, -2.18471442, -0.81397009, -2.58220756, -0.374373533, 0.701172064, -1.56145577,
        -1.24817227, 1.86750713, -1.58634489, -2.6, 0.0506781551, 0.0, 2.6, 0.130430740, 0.776029677, -0.812461043,
        0.439365220, -1.00097537, -1.17861792,
    ])  # fmt: skip
    for J in problem.jacobian(theta, ()):
        assert np.abs(J).max() < 1e4
