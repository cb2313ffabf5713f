"""Conditioning of a log: stamps, steps and repeats are found for any motion, and the passband follows the noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from flexspline.estimator.conditioning import as_logged, coarser, condition, news_of, step_of
from flexspline.estimator.stamps import timing_error
from flexspline.models.joint import load_joint
from flexspline.models.motion import CUTOFF, smooth
from flexspline.models.recording import Recording, read_measurement

JOINT = load_joint("test-joint")
N = JOINT.numbers["N"].value
BITS = 2 * np.pi / 2**16


def angle(motion: str, seconds: float, rng: np.random.Generator) -> CubicSpline:
    """A smooth motion of the link [rad] of one kind, at any time."""
    t = np.arange(0.0, seconds, 1e-3)
    size = rng.uniform(0.5, 1.5)
    if motion == "sine":
        x = size * np.sin(2 * np.pi * rng.uniform(0.1, 0.6) * t)
    elif motion == "chirp":
        x = 0.3 * size * np.sin(2 * np.pi * (0.1 + 0.6 * t / seconds) * t)
    elif motion == "stroke":
        x = size * t / seconds
    else:  # from pose to pose, at one speed or along a quintic
        knots = np.cumsum(rng.uniform(1.0, 3.0, 40))
        poses = rng.uniform(-size, size, 41)
        i = np.searchsorted(knots, t)
        begin = np.r_[0.0, knots][i]
        s = np.clip((t - begin) / (0.6 * (knots[i] - begin)), 0.0, 1.0)
        share = s if motion == "trapezoid" else s**3 * (10 - 15 * s + 6 * s**2)
        x = poses[i] + (poses[i + 1] - poses[i]) * share
        window = np.hanning(101) / np.hanning(101).sum()
        x = np.convolve(np.pad(x, 50, mode="edge"), window, "valid")
    return CubicSpline(t, x)


def recording(time, taken, motion, bits, seed=0, inertia=None, current_noise=0.01, **change) -> Recording:
    """A joint that follows a motion, its samples taken at some times and stamped with others."""
    rng = np.random.default_rng(seed)
    step = 2 * np.pi / 2**bits
    x, v, a = (motion(taken, k) for k in range(3))
    p = JOINT.record()[0]
    inertia = (N**2 * (p["Jm"] + p["Jw"]) + p["Jl"]) / (N * p["Kt"])
    current = 2.0 * np.sin(x) + inertia * a + 0.3 * np.tanh(v / 0.01) + 0.2 * v
    columns = {
        "link_position": step * np.round((x + 1e-6 * rng.standard_normal(len(x))) / step),
        "motor_current": current + current_noise * rng.standard_normal(len(x)),
    }
    return Recording("log", time, columns | change)


MOTIONS = ("sine", "trapezoid", "quintic", "chirp", "stroke")


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("rate", [100.0, 1000.0, 5000.0])
def test_wrong_stamps_are_found_at_any_speed_pattern(rate, motion):
    """Jitter of 10 and 30 % of the interval, with one encoder or both; none without jitter."""
    seed = int(rate) + MOTIONS.index(motion)
    print("seed", seed)
    rng = np.random.default_rng(seed)
    taken = 0.05 + np.arange(int(8 * min(rate, 1000.0))) / rate
    follow = angle(motion, 0.1 + max(taken[-1], 9.0), rng)
    for bits in (16, 20, 24):
        step = 2 * np.pi / 2**bits
        x = follow(taken)
        motor, link = (np.round(k / step) * step for k in (N * x, x + 1e-6 * rng.standard_normal(len(x))))
        floors = [step / np.sqrt(12), np.hypot(step / np.sqrt(12), 1e-6)]
        speed = float(np.sqrt(np.mean(follow(taken, 1) ** 2)))
        for jitter in (0.0, 0.1, 0.3):
            late = taken + jitter / rate * rng.uniform(-0.5, 0.5, len(taken))
            error = jitter / rate / np.sqrt(12)
            for seen, floor, noise in (
                ([motor, link], floors, np.sqrt(floors[0] * floors[1] / N)),
                ([motor], floors[:1], floors[0] / N),
                ([link], floors[1:], floors[1]),
            ):
                found = timing_error(late, seen, floor)
                if jitter == 0.0:
                    assert found < 4e-3 / rate, (bits, len(seen))
                elif error * speed > 4 * noise:
                    assert found == pytest.approx(error, rel=0.3), (bits, len(seen), jitter)


def test_arrival_stamps_become_even_samples():
    print("seed", 5)
    rng = np.random.default_rng(5)
    taken = 0.1 + np.arange(6000) / 250.0
    follow = angle("sine", 25.0, rng)
    late = np.sort(taken + 0.8e-3 * np.abs(rng.standard_normal(len(taken))))
    found = condition(recording(late, taken, follow, 20), JOINT)
    assert found.stamps.kind == "arrival" and found.stamps.found > 0.3e-3 and found.stamps.error < 0.05e-3
    even = found.recording.time - found.recording.time[0]
    assert np.std(even - (taken - taken[0])) < 0.05e-3
    assert np.array_equal(found.recording.stamps, late)
    assert any("taken as even" in line for line in found.done)


@pytest.mark.parametrize("tick", [1e-3, 2e-3])
def test_a_coarse_clock_is_named(tick):
    taken = 0.1 + np.arange(4000) / 135.0
    stamps = tick * np.floor(taken / tick)
    found = condition(recording(stamps, taken, angle("quintic", 31.0, np.random.default_rng(6)), 20), JOINT)
    assert found.stamps.kind == "coarse clock" and found.stamps.tick == pytest.approx(tick)
    assert f"a clock of {1e3 * tick:.3g} ms" in " ".join(found.done)


def test_row_numbers_for_time_are_named():
    """A drive that samples every 0.98, 0.98, 0.98, 1.06 ms, its log numbered in milliseconds."""
    taken = 0.1 + np.cumsum(np.tile([0.98e-3, 0.98e-3, 0.98e-3, 1.06e-3], 1500))
    rows = np.arange(len(taken)) * 1e-3
    found = condition(recording(rows, taken, angle("trapezoid", 7.0, np.random.default_rng(7)), 20), JOINT)
    assert found.stamps.kind == "row numbers" and 1e-5 < found.stamps.error < 6e-5


@pytest.mark.parametrize("share", [0.05, 0.3, 0.6])
def test_repeats_are_counted_and_filled_in(share):
    print("seed", 8)
    rng = np.random.default_rng(8)
    taken = 0.1 + np.arange(8000) / 500.0
    follow = angle("quintic", 17.0, rng)
    r = recording(taken, taken, follow, 20)
    old = rng.random(len(taken)) < share
    old[0] = False
    last = np.maximum.accumulate(np.where(old, 0, np.arange(len(taken))))
    stale = replace(r, columns={**r.columns, "link_position": r["link_position"][last]})
    found = condition(stale, JOINT)
    assert found.channels["link_position"].repeated == pytest.approx(share, abs=0.1 * share + 0.02)
    error = [np.std(x["link_position"] - follow(taken)) for x in (stale, found.recording)]
    assert error[1] < 0.1 * error[0]
    assert not condition(r, JOINT).news


def test_rest_and_slow_counts_are_not_repeats():
    taken = np.arange(20_000) * 1e-3
    x = np.clip(0.02 * np.sin(0.5 * taken), -0.01, 0.01)  # rests, and counts that come every few samples
    assert news_of(np.round(x / BITS) * BITS, [slice(0, len(x))])[1] == 0.0
    assert news_of(np.repeat(np.random.default_rng(1).normal(size=2000), 10), [slice(0, 20_000)])[1] == pytest.approx(
        0.9, abs=0.01
    )


@pytest.mark.parametrize("spread", [2.0, 4.0, 8.0])
def test_coarse_readings_that_agree_by_chance_are_no_repeats(spread):
    """Two samples of a noisy current in motion often have the same count."""
    rng = np.random.default_rng(3)
    coarse = np.round(60 * np.sin(np.arange(4000) / 20) + spread * rng.standard_normal(4000))
    whole = [slice(0, len(coarse))]
    assert news_of(coarse, whole)[1] < 0.02
    held = coarse.copy()
    rows = np.flatnonzero(rng.random(len(held)) < 0.2)
    held[rows[rows > 0]] = held[rows[rows > 0] - 1]
    assert news_of(held, whole)[1] > 0.08


# --- the passband -----------------------------------------------------------------------------------------------------


def left(r: Recording, cutoff: float) -> float:
    """RMS [A] that a plain regression leaves of the current in every sixth block of half a second, which it has not seen."""
    s = smooth(r.time, r["link_position"][:, None], r.interval, cutoff)
    x, v, a = (np.interp(r.time, s.time, z[:, 0]) for z in (s.value, s.rate, s.acceleration))
    moving = np.tanh(v / (0.01 * np.sqrt(np.mean(v**2))))
    columns = np.column_stack([np.sin(x), np.cos(x), a, moving, v, np.ones_like(v)])
    held = np.floor(2 * (r.time - r.time[0])).astype(int) % 6 == 5
    found = np.linalg.lstsq(columns[~held], r["motor_current"][~held], rcond=None)[0]
    return float(np.sqrt(np.mean((r["motor_current"] - columns @ found)[held] ** 2)))


@pytest.mark.parametrize(
    ("rate", "bits", "jitter"),
    [(125.0, 15, 0.0), (300.0, 12, 0.0), (1000.0, 14, 0.0), (1000.0, 18, 0.1), (100.0, 18, 0.1)],
)
@pytest.mark.parametrize("motion", ["sine", "quintic"])
def test_a_regression_is_as_good_as_at_the_best_of_fixed_passbands(rate, bits, jitter, motion):
    seed = int(rate) + bits
    print("seed", seed)
    rng = np.random.default_rng(seed)
    taken = 0.1 + np.arange(int(25 * rate)) / rate
    rows = taken + jitter / rate * rng.uniform(-0.5, 0.5, len(taken))
    found = condition(recording(rows, taken, angle(motion, 26.0, rng), bits), JOINT)
    own = left(found.recording, found.passband)
    fixed = {f: left(found.recording, f) for f in (2.0, 5.0, 8.0, 10.0, 15.0, 25.0, 40.0)}
    print(found.passband, own, fixed)
    assert own <= 1.07 * min(fixed.values())  # of which the best is known afterwards


def test_a_good_log_keeps_its_passband(shared):
    for folder in ("exact/00", "toleranced/01", "toleranced/04"):
        data = read_measurement(shared / "data" / "examples" / folder)
        for r in data.recordings:
            assert condition(r, data.load_joint()).passband >= 80.0


@pytest.mark.parametrize(("rate", "most"), [(5.0, 1.25), (25.0, 6.25), (200.0, 50.0), (20_000.0, CUTOFF)])
def test_the_rate_limits_the_passband(rate, most):
    taken = 0.1 + np.arange(int(min(30 * rate, 40_000))) / rate
    found = condition(recording(taken, taken, angle("sine", 31.0, np.random.default_rng(3)), 22), JOINT)
    assert 0.0 < found.passband <= most * 1.001


def test_a_motor_torque_becomes_a_current():
    r = recording(t := np.arange(2000) * 1e-3, t, angle("sine", 3.0, np.random.default_rng(2)), 20)
    torque = r["motor_current"] * JOINT.numbers["Kt"].value
    found = condition(replace(r, columns={"link_position": r["link_position"], "motor_torque": torque}), JOINT)
    np.testing.assert_allclose(found.recording["motor_current"], r["motor_current"])
    assert found.done[0].startswith("motor_current is motor_torque")


# --- steps, and what a description says of them -----------------------------------------------------------------------


@pytest.mark.parametrize("step", [BITS, 1e-3, 0.1])
def test_a_step_is_found(step):
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.normal(0.0, 2 * step, 5000))
    assert step_of(step * np.round(x / step)) == pytest.approx(step, rel=1e-6)
    assert step_of(x) == 0.0
    assert step_of(np.zeros(5000)) == 0.0


def held(r: Recording, column: str, samples: int) -> Recording:
    x = r[column]
    return replace(r, columns={**r.columns, column: x[np.arange(len(x)) // samples * samples]})


def both(seconds: float = 8.0, rate: float = 1000.0) -> Recording:
    """Both encoders and the torque sensor as the description has them."""
    t = np.arange(int(seconds * rate)) / rate
    r = recording(t, t, angle("quintic", seconds, np.random.default_rng(4)), 20)
    step = JOINT.sensors.motor_encoder.resolution
    torque = 9.0 * np.sin(r["link_position"]) + JOINT.sensors.joint_torque.noise * np.random.default_rng(5).normal(
        size=len(t)
    )
    motor = step * np.round(N * r["link_position"] / step)
    return replace(r, columns={**r.columns, "motor_position": motor, "joint_torque": torque})


def test_a_coarser_log_is_reported_and_used():
    r = both()
    assert coarser((r,), JOINT) == () and as_logged(JOINT, (r,)).sensors == JOINT.sensors
    x = np.round(r["link_position"] / BITS) * BITS
    coarse = held(replace(r, columns={**r.columns, "link_position": x}), "joint_torque", 10)
    assert [(one.column, one.what) for one in coarser((coarse,), JOINT)] == [
        ("link_position", "step"), ("joint_torque", "rate"),
    ]  # fmt: skip
    sensors = as_logged(JOINT, (coarse,)).sensors
    assert sensors.link_encoder.resolution == pytest.approx(BITS)
    assert sensors.joint_torque.rate == pytest.approx(100.0, rel=0.02)
    assert sensors.motor_encoder == JOINT.sensors.motor_encoder


@pytest.mark.parametrize("column", ["link_position", "motor_position"])
def test_a_held_encoder_has_its_own_rate(column):
    """On a bus of 125 Hz: one held for eight samples was a delay of 3.5 ms at 0.99, together with a link inertia."""
    (one,) = coarser((held(both(), column, 8),), JOINT)
    assert (one.column, one.what) == (column, "rate") and one.found == pytest.approx(125.0, rel=0.03)
