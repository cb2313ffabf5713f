"""Dual numbers: values as without them, derivatives by the chain rule."""

import math

import numpy as np
import pytest

from flexspline.models import dynamics, laws
from flexspline.models.dual import LANES, dual_records, dual_table, value_of
from flexspline.models.joint import load_joint
from flexspline.models.kernels import kernel
from flexspline.models.parameters import PARAMETERS, as_floats

PAIR = np.dtype([("x", float), ("y", float), ("many", float, 3)])
_one = dual_table(1)


def differentiated(function, x, y, many=(1.0, 2.0, 3.0)):
    """Value and derivatives by x, y and the three others of a compiled function of a record."""
    record = np.array([(x, y, tuple(many))], PAIR)
    directions = np.zeros((1, 5, LANES))
    directions[0, :5, :5] = np.eye(5)
    out, slopes = np.zeros((1, 1)), np.zeros((1, 1, LANES))

    @kernel
    def run(record, directions, out, slopes):
        _one(out, slopes)[0, 0] = function(dual_records(record, directions)[0])

    run(record, directions, out, slopes)
    return out[0, 0], slopes[0, 0, :5]


FUNCTIONS = {
    "arithmetic": (lambda p: (2.0 * p.x - p.y / p.x + 3) * p.y - p.x / 2 + 1 / p.y - (5 - p.x) * -p.y, (0.7, -1.3)),
    "powers": (lambda p: p.x**2 + p.x**p.y + (1.0 + p.y) ** 1.5, (0.7, 1.3)),
    "waves": (lambda p: math.sin(p.x * p.y) + math.cos(p.y) * math.tanh(p.x), (0.7, -1.3)),
    "exponentials": (lambda p: math.exp(p.x) + math.expm1(p.y) * math.log(p.x) + math.sqrt(p.x), (0.7, -1.3)),
    "corners": (lambda p: abs(p.y) * max(p.x, 0.0) + min(p.x, p.y) + np.sign(p.y) * p.x + max(1.0, p.x), (0.7, -1.3)),
    "whole": (lambda p: p.x * math.floor(3.0 * p.x) + p.many[1] * p.many[2], (0.7, -1.3)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_are_those_of_differences(name):
    function, (x, y) = FUNCTIONS[name]
    value, slopes = differentiated(kernel(function), x, y)
    point, step = np.array([x, y, 1.0, 2.0, 3.0]), 1e-6

    def plain(at):
        return function(np.array([(at[0], at[1], tuple(at[2:]))], PAIR).view(np.recarray)[0])

    assert value == pytest.approx(plain(point), abs=1e-15)
    numeric = [(plain(point + step * e) - plain(point - step * e)) / (2 * step) for e in np.eye(5)]
    assert slopes == pytest.approx(numeric, abs=1e-8)


def test_an_absent_effect_with_a_derivative_is_not_skipped():
    @kernel
    def function(p):
        return 3.0 * p.x if p.x != 0.0 else 0.0 * p.y

    value, slopes = differentiated(function, 0.0, 1.0)
    assert value == 0.0
    assert slopes[0] == 3.0


def test_a_value_alone_has_no_derivative():
    @kernel
    def function(p):
        return value_of(p.x) * p.x

    value, slopes = differentiated(function, 3.0, 1.0)
    assert (value, slopes[0]) == (9.0, 3.0)


@kernel
def _torques(p, at):
    """What acts on the wave generator, sliding."""
    state = dynamics.State(at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7], 0.3, 2.0, 30.0)
    return dynamics.balance(state, p).on_wave_generator + laws.bristle_step(at[6], at[3], 0.02, 1e-3, p)


@kernel
def _torques_dual(record, directions, at, out, slopes):
    _one(out, slopes)[0, 0] = _torques(dual_records(record, directions)[0], at)


def test_the_laws_themselves_are_differentiated():
    """Every number of a joint with effects in it, by its derivative of a balance and by differences of it."""
    record = load_joint("test-joint").record()
    p = record[0]
    p["backlash"], p["hysteresis_torque"], p["friction_asymmetry"], p["friction_load"] = 1e-4, 0.5, 0.2, 0.1
    p["cogging_order"][0], p["cogging_amplitude"][0], p["cogging_phase"][0] = 3.0, 5e-3, 0.4
    p["friction_order"][0], p["friction_amplitude"][0] = 1.0, 4e-3
    p["friction_temperature"], p["drift_amplitude"], p["viscous_exponent"], p["knee_width"] = 0.01, 0.3, 0.9, 1e-4
    p["flexible_share"], p["motor_eccentricity"] = 0.2, 1e-3
    at = np.array([30.0, 40.0, 29.93, 40.2, 0.2985, 0.4, 1e-3, 2e-5])
    whole, moved = as_floats(record), 0
    for first in range(0, len(whole), LANES):
        number = min(LANES, len(whole) - first)
        directions = np.zeros((1, len(whole), LANES))
        directions[0, first : first + number, :number] = np.eye(number)
        out, slopes = np.zeros((1, 1)), np.zeros((1, 1, LANES))
        _torques_dual(record, directions, at, out, slopes)
        assert out[0, 0] == _torques(p, at)
        for i in range(number):
            step = 1e-6 * abs(whole[first + i]) or 1e-6
            ends = []
            for sign in (1, -1):
                other = whole.copy()
                other[first + i] += sign * step
                ends.append(_torques(other.view(PARAMETERS)[0], at))
            numeric = (ends[0] - ends[1]) / (2 * step)
            moved += numeric != 0.0
            assert slopes[0, 0, i] == pytest.approx(numeric, rel=1e-5, abs=1e-7), first + i
    assert moved > 30
