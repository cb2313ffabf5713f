"""Torques from smooth motion, against a motion with currents and torques by the inverse equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_symmetry import JOINT, MOUNTING

from flexspline.estimator import KnownJoint, smoothed
from flexspline.models import dynamics, laws
from flexspline.models.signals import Signals

TIME = np.arange(6000) * 1e-3
PULSATION, WAY = 1.1, 0.9
LINK = -WAY * np.cos(PULSATION * TIME + 0.35)
RATE = WAY * PULSATION * np.sin(PULSATION * TIME + 0.35)
ACCELERATION = WAY * PULSATION**2 * np.cos(PULSATION * TIME + 0.35)
HEAT = 25.0 + 3.0 * TIME
INSIDE = (TIME > 0.3) & (TIME < 2.2)
"""One way, well above Stribeck's velocity."""
EFFECTS = {
    "cable_stiffness": 0.7, "friction_asymmetry": 0.1, "friction_load": 0.06, "friction_temperature": -0.004,
    "current_offset": 0.02, "link_zero": 3e-4, "motor_eccentricity": 2e-3, "motor_eccentricity_phase": 0.4,
    "drift_amplitude": 0.3, "drift_time": 2.0, "backlash": 1e-5, "knee_width": 3e-5,
}  # fmt: skip


def known(**effects: float) -> KnownJoint:
    joint = KnownJoint.of(JOINT, MOUNTING).with_numbers(**effects)
    record = joint.record.copy()
    if effects:
        record[0]["cogging_order"][0], record[0]["cogging_amplitude"][0] = 1.0, 4e-3
        record[0]["link_error_order"][0], record[0]["link_error_amplitude"][0] = 1.0, 5e-4
    # What the drive turns faster and slower by its kinematic error is not in `steady_motion`.
    record[0]["amplitude"] *= 0.02
    return replace(joint, record=record, start=0.0)


def moving(joint: KnownJoint) -> tuple[Signals, np.ndarray]:
    """Readings of a moving joint's sensors, and its joint torque [N·m]."""
    p = joint.p
    steady = np.array([
        dynamics.steady_motion(*state, 0.0, t, heat, p)
        for *state, t, heat in zip(LINK, RATE, ACCELERATION, TIME, HEAT, strict=True)
    ])  # fmt: skip
    columns = {
        "motor_position": np.array([laws.motor_reading(x, p) for x in steady[:, 0]]),
        "link_position": np.array([laws.link_reading(x, p) for x in LINK]),
        "motor_current": steady[:, 1] + p["current_offset"], "temperature": HEAT,
    }  # fmt: skip
    return Signals(TIME, columns), steady[:, 2]


@pytest.mark.parametrize("effects", [{}, EFFECTS], ids=["plain", "effects"])
def test_torque_from_current_from_torsion_and_of_the_link_agree(effects):
    joint = known(**effects)
    signals, torque = moving(joint)
    motion = smoothed.smooth_motion(signals, joint, 40.0)
    np.testing.assert_allclose(motion.link_position[INSIDE], LINK[INSIDE], atol=2e-6)
    np.testing.assert_allclose(motion.link_velocity[INSIDE], RATE[INSIDE], atol=2e-4)
    np.testing.assert_allclose(motion.temperature[INSIDE], HEAT[INSIDE], rtol=1e-9)
    by_current = smoothed.torque_from_current(motion, joint) - joint.p["bl"] * motion.link_velocity
    by_torsion = np.array([laws.flexspline_spring(x, joint.p) for x in smoothed.torsion_of(motion, joint, by_current)])
    own = smoothed.own_torque(motion, joint, by_current)
    for name, found, most in (("current", by_current, 0.06), ("torsion", by_torsion, 0.06), ("own", own, 0.02)):
        off = (found - torque)[INSIDE]
        print(f"{name}: {np.sqrt(np.mean(off**2)):.4f} N·m, most {np.abs(off).max():.4f}")
        assert np.abs(off).max() < most, name
    torsion, loaded = smoothed.torsion_of(motion, joint, by_current), INSIDE & (np.abs(by_torsion) > 0.0)
    np.testing.assert_allclose(smoothed.wound(by_torsion, joint)[loaded], torsion[loaded], atol=1e-9)


def test_a_flexible_link_needs_another_torque():
    """A share on a spring of 14 Hz, far above the motion: the torque of the whole inertia."""
    joint = known().with_numbers(flexible_share=0.3, flexible_frequency=14.0, flexible_damping=0.2)
    signals, torque = moving(joint.with_numbers(flexible_share=0.0))
    motion = smoothed.smooth_motion(signals, joint, 40.0)
    found = smoothed.own_torque(motion, joint, torque)
    late = INSIDE & (TIME > 0.8)
    assert np.abs(found - torque)[late].max() < 0.02 * np.abs(torque[late]).max()


@pytest.mark.parametrize("delay", [6e-3, 6.4e-3, 0.05])
def test_a_delayed_encoder_is_shifted_in_time(delay):
    """Readings are shifted in time; the end of the recording follows the rotor, or stays."""
    joint = known().with_numbers(link_delay=delay)
    time = 2.0 + TIME[:1000]
    link, motor = np.sin(3.0 * time), 100.0 * np.cos(2.0 * time)
    late = Signals(time, {"link_position": np.sin(3.0 * (time - delay)), "motor_position": motor})
    found, in_phase = smoothed.in_time(late, joint)
    assert in_phase.p["link_delay"] == 0.0 and np.array_equal(found["motor_position"], motor)
    last = time[-1] - delay
    come = time <= last
    np.testing.assert_allclose(found["link_position"][come], link[come], atol=2e-6)  # between samples along a chord
    since = np.cos(2.0 * time) - np.cos(2.0 * last)
    np.testing.assert_allclose(found["link_position"][~come], (np.sin(3.0 * last) + since)[~come], atol=2e-6)
    alone, _ = smoothed.in_time(late.without("motor_position"), joint)
    np.testing.assert_allclose(alone["link_position"], np.where(come, link, np.sin(3.0 * last)), atol=2e-6)
    prompt = late, known()
    assert smoothed.in_time(*prompt) == prompt


def test_the_bandwidth_is_the_highest_whose_noise_is_quiet(rng):
    """Noise of the angle, twice differentiated, through the drive's inertia; of the current through Kt; both times the ratio."""
    joint = known()
    p, n = joint.p, len(TIME)
    for amperes, radians in ((1e-3, 1e-5), (0.02, 1e-5), (1e-3, 1e-3), (0.1, 0.02), (3.0, 0.3)):
        columns = {
            "motor_position": 100 * LINK + radians * rng.standard_normal(n),
            "motor_current": amperes * rng.standard_normal(n),
        }
        found = smoothed.bandwidth(Signals(TIME, columns), joint)

        def noise(cutoff: float, amperes: float = amperes, radians: float = radians) -> float:
            turning = (p["Jm"] + p["Jw"]) * (2 * np.pi * cutoff) ** 2 * radians
            return (
                p["N"]
                * np.hypot(turning, p["Kt"] * amperes)
                * np.sqrt(min(1.0, 2 * cutoff * 1e-3))
                / joint.rated_torque
            )

        quiet = [cutoff for cutoff in smoothed.BANDWIDTHS if noise(cutoff) <= smoothed.QUIET]
        clear = min(abs(np.log(noise(cutoff) / smoothed.QUIET)) for cutoff in smoothed.BANDWIDTHS)
        assert clear > 0.05, "near the edge the draw decides"
        assert found == (quiet[0] if quiet else smoothed.BANDWIDTHS[-1])
