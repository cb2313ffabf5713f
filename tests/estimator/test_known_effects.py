"""What is known of a joint reaches every estimator: with a known effect, it is as good as on the joint without it.

Every known cause at the middle of its ordinary size, what a record can say beyond them, and a model discrepancy at every
place, each in draws of a sweep (start, way, time, noise, and phases or signs of the effect), without and with a smooth push.
RMS error against the true joint torque over three draws, at most `LIMIT` times that without the effect; `augmented`: the
geometric mean of that ratio over thirteen. Where physics does not allow that, `EXCEPTIONS` says why, and what was measured.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from known_effects import CASES, DRAWS, NONE, Case, errors

from flexspline.estimator import registry

LIMIT = 1.3
CAUSAL = tuple(name for name in registry.names() if registry.get(name).causal)
CHEAP = tuple(name for name in CAUSAL if not registry.get(name).costly)
DOUBTFUL = "augmented"
MORE = (*DRAWS, *range(21, 31))
"""Of the filter that takes a torque for a push or for an error of its numbers: rounding may decide which, so that one
draw in three would decide."""
BLIND = {"payload"}
"""Estimators that a push leads astray by construction: they take it for a payload."""
BY_CURRENT = {"current", "momentum"}
"""Estimators from current and friction alone, which is anything up to its level at rest: theirs is `LIMIT` in motion, too."""
SLACK = 1.15
"""Of a measured exception: draws of another machine, by rounding, differ by a few per cent where friction sticks."""

EXCEPTIONS: dict[str, tuple[str, dict[str, tuple[float | None, float | None]]]] = {
    "cogging": (
        "the torque itself ripples: at 0.1 to 0.2 rad/s cogging of order 7 or 8 passes the joint's resonance at 25 "
        "Hz, and what smooths the torque, or reads it from the current through a low-pass, lags behind it; the "
        "bare model has 1.1",
        {
            "AREKF": (2.34, 1.82), "EKF": (6.53, 3.03), "RAREKF": (3.3, 2.11), "REKF": (5.77, 3.63),
            "current": (1.75, 1.52), "dynamics_ukf": (1.32, None), "h_infinity": (2.79, 2.8), "huber": (4.91, 4.87),
            "kalman": (3.6, 3.6), "lowpass": (7.87, 4.42), "lowpass_first_order": (5.98, 3.65), "momentum": (1.8, 1.44),
            "momentum_torsion": (4.55, 2.94), "payload": (2.42, None), "strong_tracking": (2.08, 2.08),
        },
    ),
    "rotor_inertia": (
        "breaking away from rest, the inertia's share of a momentum that is known to a count; in motion 1.2",
        {
            "momentum": (1.67, None),
        },
    ),
    "back_driving": (
        "at rest friction hides behind the counts of the encoder, in proportion to itself; in motion at most 1.0 "
        "(payload: the regression has that error in it)",
        {
            "current": (1.94, 1.81), "momentum": (2.52, 2.17), "payload": (2.14, None),
        },
    ),
    "friction_asymmetry": (
        "as back_driving",
        {
            "momentum": (1.36, None),
        },
    ),
    "friction_drift": (
        "as back_driving",
        {
            "current": (2.75, 2.4), "momentum": (3.17, 2.51), "payload": (3.07, None),
        },
    ),
    "hysteresis": (
        "its state is the torsion's whole way since the last reversal, and counts and noise lengthen that way: "
        "0.05 of 1.05 N·m are left, more than what a filter leaves of the noise; while pushed, the rate that winds "
        "it is as uncertain as the push. With the noise of the current sensor in it the posterior Cramér-Rao bound "
        "(`estimator.bound`, Jm ωm' + Kt·0.01 A of white noise per sample) is 0.0294 N·m with and 0.0172 without it",
        {
            "AREKF": (1.67, 1.78), "EKF": (1.57, None), "RAREKF": (1.57, 1.53), "REKF": (1.9, 1.71), "dynamics_ukf":
            (1.7, 1.88), "h_infinity": (1.99, 2.45), "huber": (2.03, 2.48), "kalman": (2.03, 2.5), "lowpass": (1.54,
            1.36), "lowpass_first_order": (1.84, 1.62), "model": (1.39, 1.69), "momentum_torsion": (1.42, None),
            "strong_tracking": (1.86, 2.29), "dynamics_ekf": (1.7, 3.02), "augmented": (1.83, 1.32),
        },
    ),
    "load_dependent_friction": (
        "as back_driving",
        {
            "current": (1.82, 1.68), "momentum": (2.33, 1.86), "payload": (1.94, None),
        },
    ),
    "mesh_friction": (
        "as back_driving, with twice the friction; the bristle's state is what a filter of the dynamics cannot see "
        "at rest either",
        {
            "current": (2.88, 2.55), "dynamics_ekf": (1.44, None), "dynamics_ukf": (1.61, None), "momentum": (3.61,
            2.85), "payload": (3.12, None),
        },
    ),
    "position_dependent_friction": (
        "as back_driving",
        {
            "current": (1.34, 1.34), "momentum": (1.44, 1.33), "payload": (1.51, None),
        },
    ),
    "hard_stop": (
        "the contact is where the encoder's count says it is",
        {
            "dynamics_ukf": (1.32, None),
        },
    ),
    "link_flexibility": (
        "a payload's inertia that swings is no payload",
        {
            "payload": (1.31, None),
        },
    ),
    "link_inertia": (
        "the torque itself swings more, twice the inertia at the same motion, and a filter of a slow walk lags "
        "behind it",
        {
            "EKF": (1.54, None), "RAREKF": (1.49, None), "lowpass": (1.41, None),
        },
    ),
    "encoder_delay": (
        "7.5 ms of torsion are not known but carried on along a line: noise of the line's end, which no smoothing "
        "after it takes off; under a push, what it does meanwhile",
        {
            "AREKF": (1.48, 1.35), "EKF": (1.38, None), "RAREKF": (1.39, None), "REKF": (1.62, None), "h_infinity":
            (1.84, 1.83), "huber": (1.8, 1.83), "kalman": (1.81, 1.82), "lowpass": (1.51, None), "lowpass_first_order":
            (1.55, None), "model": (1.35, None), "strong_tracking": (1.8, 1.74), "dynamics_ekf": (None, 2.38),
            "augmented": (None, 4.28), "dynamics_ukf": (None, 2.3),
        },
    ),
}  # fmt: skip
"""Case → why, and estimator → RMS error with the effect over that without, measured without and with a push; None: within
`LIMIT`."""
IN_MOTION = {
    "cogging": ("as above", 6.4),
    "hysteresis": ("the torque's own swing is stiffer and faster where it sticks", 1.5),
    "rotor_inertia": ("noise of the rotor's acceleration, by its encoder's counts, is torque by its inertia", 1.9),
    "link_inertia": ("the torque itself swings more", 1.55),
}
"""Case → why, and what the estimators of `BY_CURRENT` may have in motion instead of `LIMIT`."""
READ = ("current_offset", "torque_constant", "cogging", "discrepancy_motor_current", "discrepancy_rotor")
"""Cases that change what a current reading means, where that is all that an estimator has."""


@cache
def without(name: str, push: bool, command: bool = True, draws: tuple[int, ...] = DRAWS) -> tuple[float, float]:
    """RMS errors [N·m] on the joint without effects."""
    return errors(registry.get(name), NONE, push, draws, command=command)


def ratio_over_more(case: Case, push: bool, command: bool) -> float:
    """Geometric mean over `MORE` of the RMS error's ratio to that without the effect."""
    found = registry.get(DOUBTFUL)
    ratios = [
        errors(found, case, push, (seed,), command=command)[0] / without(DOUBTFUL, push, command, (seed,))[0]
        for seed in MORE
    ]
    return float(np.exp(np.mean(np.log(ratios))))


def check(case: Case, push: bool, names: tuple[str, ...], command: bool = True) -> None:
    """Fail with every estimator whose error grows beyond its limit."""
    wrong = []
    for name in names:
        if push and name in BLIND:
            continue
        whole, moving = errors(registry.get(name), case, push, DRAWS, command=command)
        before, before_moving = without(name, push, command)
        ratio = ratio_over_more(case, push, command) if name == DOUBTFUL else whole / before
        limit = LIMIT
        why, measured = EXCEPTIONS.get(case.name, ("", {}))
        known = measured.get(name, (None, None))[push]
        if known is not None:
            limit = max(SLACK * known, LIMIT)
            print(f"{case.name}, {name}: {ratio:.2f}, measured {known:.2f}: {why}")
        if not ratio <= limit:
            wrong.append(f"{name}: {ratio:.2f} times {before:.4f} N·m, expected at most {limit:.2f}")
        _, most = IN_MOTION.get(case.name, ("", LIMIT))
        if name in BY_CURRENT and not moving / before_moving <= most:
            wrong.append(
                f"{name} in motion: {moving / before_moving:.2f} times {before_moving:.4f} N·m, at most {most:.2f}"
            )
    assert not wrong, f"{case.name}: " + "; ".join(wrong)


@pytest.mark.fast_every(48)  # of every 24th case the sweep
@pytest.mark.parametrize("push", [False, True], ids=["sweep", "push"])
@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_known_effect(case, push):
    check(case, push, CHEAP)


PUSHED = pytest.param(True, marks=pytest.mark.long)
FEW = [pytest.param(case, marks=pytest.mark.long) if i % 6 else case for i, case in enumerate(CASES)]


@pytest.mark.slow
@pytest.mark.parametrize("push", [False, PUSHED], ids=["sweep", "push"])
@pytest.mark.parametrize("case", FEW, ids=[case.name for case in CASES])
def test_known_effect_with_the_dynamics(case, push):
    check(case, push, tuple(name for name in CAUSAL if name not in CHEAP))


@pytest.mark.fast_every(5)
@pytest.mark.parametrize("name", READ)
def test_known_effect_with_the_reading_only(name):
    """Without a known command the reading, less its known error, is used."""
    (case,) = (case for case in CASES if case.name == name)
    check(case, False, CHEAP, command=False)


@pytest.mark.parametrize("name, estimator, worse", [
    ("link_encoder_eccentricity", "EKF", 20.0), ("link_encoder_error", "EKF", 10.0), ("link_encoder_zero", "lowpass", 100.0),
    ("motor_encoder_eccentricity", "model", 8.0), ("encoder_delay", "EKF", 100.0), ("encoder_delay", "dynamics_ekf", 100.0),
    ("discrepancy_link_position", "kalman", 10.0), ("backlash", "model", 20.0), ("kinematic_error", "EKF", 10.0),
    ("stiffness", "EKF", 20.0), ("hysteresis", "EKF", 2.0), ("hysteresis", "dynamics_ekf", 6.0),
    ("discrepancy_flexspline", "EKF", 4.0), ("cogging", "model", 1.7), ("torque_constant", "dynamics_ekf", 10.0),
    ("mesh_friction", "current", 5.0), ("viscous_friction", "current", 1.5), ("friction_drift", "momentum", 5.0),
    ("load_dependent_friction", "current", 4.0), ("friction_temperature", "current", 1.5),
    ("discrepancy_mesh", "current", 1.7), ("link_flexibility", "dynamics_ekf", 1.2),
])  # fmt: skip
def test_unknown_effect(name, estimator, worse):
    """The same effects, unknown to the estimator: ordinary effects are not small."""
    (case,) = (case for case in CASES if case.name == name)
    draws = DRAWS[:1]
    informed = errors(registry.get(estimator), case, False, draws)[0]
    ignorant = errors(registry.get(estimator), case, False, draws, known_as=NONE)[0]
    print(name, estimator, informed, ignorant)
    assert ignorant > worse * errors(registry.get(estimator), NONE, False, draws)[0]
    assert ignorant > informed


def test_no_exception_is_idle():
    """Exceptions are of existing cases and estimators, above the limit, and few."""
    names = {case.name for case in CASES}
    assert set(EXCEPTIONS) <= names
    for why, measured in EXCEPTIONS.values():
        assert why and set(measured) <= set(CAUSAL)
        assert all(any(x is not None and x > LIMIT for x in pair) for pair in measured.values())
    count = sum(x is not None for _, measured in EXCEPTIONS.values() for pair in measured.values() for x in pair)
    print(f"{count} exceptions of {2 * len(CASES) * len(CAUSAL)}")
    assert count < 0.1 * 2 * len(CASES) * len(CAUSAL)
