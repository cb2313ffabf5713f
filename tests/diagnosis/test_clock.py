"""A clock that is wrong by less than a third is a mistake in the data, and a joint with other inertias has a right one."""

from dataclasses import replace

import pytest

from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.trials.draw import Challenge, draw


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scale", "without"), [(0.85, ("joint_torque",)), pytest.param(1.12, (), marks=pytest.mark.long)]
)
def test_a_wrong_clock_is_a_mistake_and_no_cause(scale, without):
    sound = draw(Challenge(hidden="none", seed=4801, without=without), 0)
    recordings = tuple(replace(r, time=scale * r.time) for r in sound.measurement.recordings)
    found = diagnose(replace(sound.measurement, recordings=recordings), sound.nominal)
    assert found.verdict == "inconclusive" and not found.causes, found
    (clock,) = found.mistakes
    assert (clock.name, clock.column, clock.severe) == ("unit", "time", True) and clock.confidence > 0.9
    assert clock.factor == pytest.approx(1 / scale, rel=0.03)
    assert "× 0." in clock.change or "× 1." in clock.change
    assert "Check the rate" in found.reason and "import --fix" not in found.reason


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["rotor_inertia", pytest.param("link_inertia", marks=pytest.mark.long)])
def test_another_inertia_is_no_wrong_clock(cause):
    hidden = draw(Challenge(only=(cause,), seed=4802), 0)
    found = diagnose(hidden.measurement, hidden.nominal)
    assert [c.name for c in found.causes] == [cause] and not found.mistakes, found
