"""A step by its address, compiled or in Python: the same inputs, memory and outputs."""

from __future__ import annotations

import ctypes
import threading

import numpy as np
import pytest

from flexspline.models.joint import load_joint
from flexspline.models.signals import READINGS, SENSED
from flexspline.models.step import SAMPLE, CompiledStep, step_of

MEMORY, SETTINGS, OUTPUTS = np.dtype([("place", float), ("heat", float)]), ("share",), ("first", "second")


def _step(m, s, p, c, o):
    if s.interval == 0.0:
        m.place = s.motor_position
    if s.motor_current > 90.0:
        return 7
    m.place += c.share * (s.motor_position - m.place)
    m.heat += s.interval * s.temperature
    o.first, o.second = p.Kt * p.N * s.motor_current + m.place, m.heat
    return 0


compiled = step_of(MEMORY, SETTINGS, OUTPUTS)(_step)
plain = step_of(MEMORY, SETTINGS, OUTPUTS, plain=True)(_step)


CALL = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * 5)


def called(step, samples, settings=(0.3,)):
    """Statuses and outputs of a step over samples, called by its address."""
    taken = CompiledStep(step.address, 2, load_joint("test-joint").record(), np.array(settings), 2)
    address, memory, record, known, out = taken.arrays()
    function = CALL(address)
    statuses, outputs = [], []
    for i in range(len(samples)):
        one = samples[i : i + 1]
        arrays = (memory, one, record, known, out)
        statuses.append(function(*(a.ctypes.data for a in arrays)))
        outputs.append(out.copy())
    return statuses, np.array(outputs)


@pytest.fixture
def samples(rng):
    found = np.zeros(200, SAMPLE)
    for name in SAMPLE.names:
        found[name] = rng.standard_normal(200)
    found["interval"] = np.r_[0.0, np.full(199, 1e-3)]
    return found


def test_compiled_and_python_are_the_same_by_address(samples):
    a, b = called(compiled, samples), called(plain, samples)
    assert a[0] == b[0] == [0] * 200
    np.testing.assert_allclose(a[1], b[1], rtol=1e-13, atol=1e-15)
    assert np.ptp(a[1][:, 0]) > 1 and a[1][-1, 1] != 0


def test_a_status_is_handed_on(samples):
    samples["motor_current"][3] = 100.0
    for step in (compiled, plain):
        statuses, outputs = called(step, samples[:6])
        assert statuses == [0, 0, 0, 7, 0, 0]
        np.testing.assert_array_equal(outputs[3], outputs[2])


def test_a_python_step_that_fails_keeps_its_error(samples):
    def failing(*records):
        raise KeyError("no such channel")

    step = step_of(MEMORY, SETTINGS, OUTPUTS, plain=True)(failing)
    assert step.error is None
    statuses, _ = called(step, samples[:2])
    assert statuses == [-1, -1]
    assert isinstance(step.error, KeyError) and "no such channel" in str(step.error)


def test_every_reading_has_its_place_in_a_sample():
    assert SAMPLE.names == ("time", "interval", "current_command", "arm_torque", *SENSED)
    for name in SENSED:
        assert SAMPLE.fields[name][1] == 32 + READINGS.fields[name][1], name


def test_memory_is_fresh_for_each_user():
    taken = CompiledStep(compiled.address, 2, load_joint("test-joint").record())
    first, second = taken.arrays(), taken.arrays()
    first[1][:] = 5.0
    assert not second[1].any() and second[1] is not first[1]
    assert CompiledStep(0, 0, taken.record, outputs=0).arrays()[1].size == 1  # never an array without an address


def test_a_step_is_compiled_once_by_several_threads():
    @step_of(MEMORY)
    def late(m, s, p, c, o):
        o.torque = 3.0
        return 0

    addresses = []
    threads = [threading.Thread(target=lambda: addresses.append(late.address)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(addresses) == 4 and len(set(addresses)) == 1
