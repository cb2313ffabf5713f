"""Signals by name: the container, and the table of channels."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Sensors
from flexspline.models.signals import CHANNELS, DRIVING, POSITIONS, READINGS, SENSED, WRENCH, Signals


@pytest.fixture
def signals() -> Signals:
    t = np.array([0.5, 0.6, 0.8, 0.81])
    return Signals(t, {"motor_position": np.arange(4), "motor_current": -np.arange(4.0)})


def test_channels_by_name(signals):
    assert list(signals) == ["motor_position", "motor_current"] and len(signals) == 2
    assert "motor_current" in signals and "link_position" not in signals
    assert signals["motor_position"].dtype == np.float64
    np.testing.assert_array_equal(signals["motor_current"], [0, -1, -2, -3])
    with pytest.raises(InputError, match=r"expected a channel 'motor_curent'.*did you mean 'motor_current'\?"):
        signals["motor_curent"]
    assert signals.get("joint_torque") is None


def test_other_signals_are_made_not_changed(signals):
    part = signals.part(slice(1, 3))
    np.testing.assert_array_equal(part.time, [0.6, 0.8])
    np.testing.assert_array_equal(part["motor_position"], [1, 2])
    picked = signals.part(np.array([True, False, True, True]))
    np.testing.assert_array_equal(picked.time, [0.5, 0.8, 0.81])
    assert list(signals.without("motor_position", "never")) == ["motor_current"]
    more = signals.with_columns(current_command=np.ones(4), motor_current=np.zeros(4))
    assert list(more) == ["motor_position", "motor_current", "current_command"]
    assert more["motor_current"].sum() == 0.0
    assert list(signals) == ["motor_position", "motor_current"] and signals["motor_current"].sum() == -6.0


@pytest.mark.parametrize(
    ("time", "columns", "words"),
    [
        ([0.0, 0.0], {}, "time: expected two or more increasing times"),
        ([0.0], {}, "time"),
        ([[0.0, 1.0]], {}, "time"),
        ([0.0, np.nan], {}, "time"),
        ([0.0, 1.0], {"motor_current": [1.0]}, r"motor_current: expected finite numbers, shape \(2,\), got \(1,\)"),
        ([0.0, 1.0], {"motor_current": [1.0, np.inf]}, "motor_current: expected finite"),
    ],
)
def test_invalid_signals_are_named(time, columns, words):
    with pytest.raises(InputError, match=words):
        Signals(np.array(time), {name: np.array(values) for name, values in columns.items()})


def test_the_table_of_channels():
    """Every channel that a sensor reads has its specification in a joint; readings have all of them and no more."""
    sensors = load_joint("test-joint").sensors
    for name in SENSED:
        assert CHANNELS[name].sensor in Sensors.model_fields, name
        assert sensors.of(CHANNELS[name]) is getattr(sensors, CHANNELS[name].sensor)
    assert READINGS.names == SENSED
    assert set(POSITIONS) | set(DRIVING) | set(WRENCH) <= set(SENSED)
    assert {name for name, c in CHANNELS.items() if not c.sensor} == {"time", "position_command", "external_torque"}
    for name, channel in CHANNELS.items():
        assert channel.name == name and channel.unit and channel.description


def test_channels_and_units_are_those_of_the_specification(shared):
    text = (shared / "spec" / "recording.md").read_text(encoding="utf-8").split("```yaml")[0]
    found = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0].startswith("`"):
            names = [part.strip(" `") for part in cells[0].split(",")]
            units = [part.split(" on ")[0].strip() for part in cells[1].split(",")]
            for name in names:
                found[name] = units[1] if name.startswith("torque_") else units[0]
    assert len(found) == 15
    assert found == {name: channel.unit for name, channel in CHANNELS.items()}
