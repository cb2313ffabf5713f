"""What no estimator may depend on: the unit of torque, the gear's units, which way round the joint is mounted.

A joint twice as strong, twice as heavy and twice as stiff moves as before, and all its torques are twice as large: an estimator
that says otherwise has a torque hidden in it that is not the joint's own, or has mistaken a product for a quotient. The same
holds of an angle on the motor's side that is counted in another unit, and of a joint turned round.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from known_effects import Case, signals_of

from flexspline.estimator import KnownJoint, registry
from flexspline.models.causes.base import put_discrepancy
from flexspline.models.joint import load_joint
from flexspline.models.parameters import PLACES
from flexspline.models.signals import Signals

NAMES = registry.names()
JOINT = load_joint("test-joint")
MOUNTING = JOINT.mount("link")
SEED = 31
PLAIN = Case("none")
RICH = Case("rich", (
    ("hysteresis_torque", 0.3), ("hysteresis_extent", 2e-4), ("friction_load", 0.08), ("flexible_share", 0.2),
    ("flexible_frequency", 14.0), ("flexible_damping", 0.05), ("cable_stiffness", 0.7), ("friction_asymmetry", 0.1),
    ("cogging_order", (12.0, *[0.0] * 7)), ("cogging_amplitude", (4e-3, *[0.0] * 7)), ("current_offset", 0.02),
    ("friction_temperature", -0.004), ("link_zero", 2e-4), ("knee_width", 2e-5),
))  # fmt: skip
LATE = Case("late", (("link_delay", 4e-3),))
CASES = {"plain": PLAIN, "rich": RICH, "late": LATE}
BEYOND = (
    ("rotor", "load", 20.0, 4e-3), ("motor_current", "load", 20.0, 0.04), ("link", "load", 20.0, 0.3),
    ("mesh", "load", 20.0, 4e-3),
)  # fmt: skip
"""Model discrepancies of the rich joint by the load, without symmetry: place, range [N·m], size."""
SPREAD = {
    "stiffness": 0.07,
    "wave_generator": 0.1,
    "wave_generator_curve": 0.1,
    "torque_constant": 0.02,
    "gravity": 0.01,
}


@cache
def seen(case: str) -> tuple[Signals, KnownJoint]:
    """Two and a half seconds of a pushed sweep; what is known of the joint, with everything in it known within tolerances."""
    signals, _ = signals_of(CASES[case], SEED, push=True)
    known = KnownJoint.of(JOINT, MOUNTING, CASES[case].record(SEED))
    kinematic = np.where(known.p["amplitude"] != 0.0, 2e-5, 0.0)
    known = replace(known, link_zero=1e-4, link_wander=1e-5, back_driven=0.3, friction=0.15)
    return signals.part(slice(500, 3000)), replace(known, spread=replace(known.spread, **SPREAD, kinematic=kinematic))


def and_beyond(known: KnownJoint) -> KnownJoint:
    """The joint with model discrepancies."""
    known, rng = replace(known, record=known.record.copy()), np.random.default_rng(SEED)
    for place, variable, end, size in BEYOND:
        put_discrepancy(known.p, place, variable, -end, end, size * rng.uniform(-1.0, 1.0, 9))
    return known


TORQUES = {
    1.0: """Jm Jw Jl Kt Kt_drive bm bw bl dw df Kw0 K1 K2 K3 T1 T2 Fc Fs s0 s1 Mg cogging_amplitude hysteresis_torque
        cable_stiffness stop_stiffness""",
    -1.0: "Cw",
}  # fmt: skip
"""Numbers by how they grow with torques."""
MOTOR_ANGLES = {
    1.0: "N vs Cw", -1.0: "Kt Kt_drive Fc Fs order cogging_order cogging_amplitude", -2.0: "Jm Jw bm bw dw Kw0 s0 s1",
}  # fmt: skip
"""Numbers by how they grow with angles on the motor's side."""
TURNED = (
    "phase gravity_angle friction_asymmetry cogging_phase cable_rest current_offset link_zero torque_offset torque_rate"
)


def in_units(known: KnownJoint, powers: dict[float, str], unit: float) -> KnownJoint:
    record = known.record.copy()
    for power, names in powers.items():
        for name in names.split():
            record[0][name] *= unit**power
    if powers is TORQUES:
        for k, place in enumerate(record[0]["discrepancy_place"]):
            if place:  # all of them in torques, by torques
                record[0]["discrepancy_coefficient"][k] *= 1.0 if PLACES[int(place)] == "motor_current" else unit
                record[0]["discrepancy_low"][k] *= unit
                record[0]["discrepancy_high"][k] *= unit
    return replace(known, record=record)


def estimated(name: str, signals: Signals, known: KnownJoint):
    """Joint torque, its variance, external torque."""
    found = registry.get(name).scaled(known, 1e-3).estimate(signals, known)
    return found.mean, found.variance, found.external


BY_DIFFERENCES = ("dynamics_ekf", "rts_smoother")
"""Linearised by differences whose widths are fixed; and, with a link encoder that is late, from few samples far ahead."""
GATED = 1e-3
"""Share of the largest torque, as RMS, that the augmented filter may be off: its gates decide by differences this way or that."""


def off(ours, other, unit: float = 1.0, sign: float = 1.0) -> tuple[float, float]:
    """By how much torques are not `unit` times as large, as shares of the largest: the most, and of the joint torque as RMS;
    variances are its square times as large."""
    found = []
    for a, b, factor in zip(ours, other, (sign * unit, unit**2, sign * unit), strict=True):
        assert (a is None) == (b is None)
        if a is not None:
            found.append(np.abs(factor * a - b) / np.abs(b).max())
    return max(float(x.max()) for x in found), float(np.sqrt(np.mean(found[0] ** 2)))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", NAMES)
def test_torques_scale_with_the_joint(name, case):
    """Four times as strong, heavy and stiff: to the bit, wherever no logarithm or difference comes in."""
    signals, known = seen(case)
    known = and_beyond(known) if case == "rich" else known
    strong = replace(in_units(known, TORQUES, 4.0), rated_torque=4.0 * known.rated_torque)
    most, rms = off(estimated(name, signals, known), estimated(name, signals, strong), 4.0)
    print(f"{name}, {case}: {most:.1e}, RMS {rms:.1e}")
    if name in BY_DIFFERENCES:
        assert rms < (0.01 if case == "late" else 2e-4)
    else:
        assert most <= 1e-6


@pytest.mark.fast_every(3)
@pytest.mark.parametrize("name", [name for name in NAMES if not name.startswith("payload") and name != "augmented"])
def test_the_motor_sides_unit_of_angle_has_no_effect(name):
    """But for those that state a velocity of the motor: to learn a payload from, or as what a recording may begin with."""
    signals, known = seen("plain")
    noise = known.noise
    finer = replace(
        in_units(known, MOTOR_ANGLES, 4.0),
        noise=replace(noise, motor_resolution=4.0 * noise.motor_resolution, motor_noise=4.0 * noise.motor_noise),
    )
    turned = signals.with_columns(motor_position=4.0 * signals["motor_position"])
    most, rms = off(estimated(name, signals, known), estimated(name, turned, finer))
    print(f"{name}: {most:.1e}, RMS {rms:.1e}")
    assert rms < 5e-4 if registry.get(name).costly else most == 0.0


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", NAMES)
def test_a_reversed_joint_has_the_reversed_torques(name, case):
    """Angles, currents, phases and offsets of the other sign: to the bit, but for those that take differences forwards; where a
    place on a discrepancy's grid is counted from its other end, to rounding."""
    signals, known = seen(case)
    known = and_beyond(known) if case == "rich" else known
    record = known.record.copy()
    for field in TURNED.split():
        record[0][field] *= -1.0
    for k, count in enumerate(
        record[0]["discrepancy_count"].astype(int)
    ):  # of what changes its sign, and change theirs
        record[0]["discrepancy_coefficient"][k, :count] = -record[0]["discrepancy_coefficient"][k, :count][::-1]
    columns = {name: values if name == "temperature" else -values for name, values in signals.columns.items()}
    other = estimated(name, Signals(signals.time, columns), replace(known, record=record))
    most, rms = off(estimated(name, signals, known), other, sign=-1.0)
    print(f"{name}, {case}: {most:.1e}, RMS {rms:.1e}")
    if name == "augmented":
        assert rms < GATED
    elif registry.get(name).costly:
        assert rms < (0.01 if case == "late" else 2e-3)
    else:
        assert most <= (1e-9 if case == "rich" else 0.0)
