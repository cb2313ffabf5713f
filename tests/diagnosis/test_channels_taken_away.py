"""Every shipped example with each channel taken away: nothing sure that is not there, and what still shows is found."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from flexspline.diagnosis.diagnose import diagnose
from flexspline.models.recording import read_measurement

CHANNELS = ("motor_position", "link_position", "motor_current", "joint_torque")
EXAMPLES = [(kind, number) for kind, count in (("exact", 6), ("toleranced", 7), ("bare", 3)) for number in range(count)]
ALIKE = {frozenset(("load_dependent_friction", "back_driving")), frozenset(("kinematic_error", "cogging"))}
"""A special case, and what one encoder does not separate: either may replace the other, and that is reported."""
FEW = [("toleranced", 3, "link_position")]
"""Not long. A hysteresis that one encoder does not show was found as a rotor's inertia at 0.97, five numbers at their ends."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "number", "channel"),
    [
        (kind, number, channel) if (kind, number, channel) in FEW
        else pytest.param(kind, number, channel, marks=pytest.mark.long)
        for kind, number in EXAMPLES for channel in CHANNELS
    ],
)  # fmt: skip
def test_without_a_channel(shared, kind, number, channel):
    folder = shared / "data" / "examples" / kind
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))[f"{number:02d}"]
    measurement = read_measurement(folder / f"{number:02d}")
    torques = {"motor_current", "motor_torque", "joint_torque"} - {channel}
    if not any(channel in r and torques.intersection(r.columns) for r in measurement.recordings):
        pytest.skip("not measured, or no torque is left")
    less = replace(measurement, recordings=tuple(r.without(channel) for r in measurement.recordings))
    found = diagnose(less, measurement.load_joint("test-joint"))
    reported = {c.name: c.confidence for c in found.causes}

    def is_there(name: str) -> bool:
        return name in truth or any(frozenset((name, hidden)) in ALIKE for hidden in truth)

    assert not {n: c for n, c in reported.items() if c > 0.5 and not is_there(n)}, (truth, reported)
    shows = [n for n in truth if n != "unknown" and n not in found.undetermined]
    found_or_alike = [n for n in shows if n in reported or any(frozenset((n, o)) in ALIKE for o in reported)]
    assert found_or_alike == shows or "unknown" in reported, (
        shows,
        reported,
    )  # that something is there is said at least
    if not truth:
        assert found.verdict in ("consistent", "inconclusive")
