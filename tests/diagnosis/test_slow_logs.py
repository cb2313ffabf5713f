"""Logs of one encoder that are slower than the residuals: friction reverses between two samples."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from swing import recording

from flexspline.diagnosis.data.segments import CURRENT, segments
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.fit.noise import SCALES, haar
from flexspline.diagnosis.trials.draw import Challenge, draw
from flexspline.diagnosis.validate import validate
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement, Recording

JOINT = load_joint("test-joint")


def log(encoder: str, rate: float, friction: float = 1.0, seconds: float = 40.0) -> Recording:
    """A swing seen by one encoder; its friction is some times the described one, and reverses at once."""
    one = recording(rate=rate, seconds=seconds)
    p = JOINT.record()[0]
    w = np.gradient(one["motor_position"], one.time)
    more = (friction * np.sign(w) - np.tanh(w / p["vs"])) * p["Fc"] / p["Kt"]
    return replace(one, columns={encoder: one[encoder], "motor_current": one["motor_current"] + more})


@pytest.mark.parametrize("rate", [25.0, 50.0, 95.0])
def test_residuals_are_those_of_the_samples(rate):
    """The smoother of the motion spread a reversal over a quarter of a second at 25 Hz."""
    one = log("link_position", rate, friction=3.0)
    (segment,), _ = segments([one], JOINT)
    use = (segment.usable | segment.held_out)[:, CURRENT]
    away = np.abs(one.time[:, None] - segment.at[use]).min(axis=0)
    assert away.max() <= 0.004 + 1e-9 and use.sum() < 1.05 * len(one.time)
    on = away < 1e-6
    read = np.interp(segment.at[use][on], one.time, one["motor_current"])
    jump = 2 * 3.0 * float(JOINT.record()["Fc"][0] / JOINT.record()["Kt"][0])
    assert np.abs(segment.measured[use][on, CURRENT] - read).max() < 0.12 * jump


@pytest.mark.parametrize("rate", [125.0, 500.0])
def test_a_log_as_fast_as_the_residuals_has_them_all(rate):
    (segment,), _ = segments([log("link_position", rate)], JOINT)
    assert segment.sampled == 1.0


def test_wavelets_of_some_samples_have_the_size_of_those_of_all(rng):
    x = rng.standard_normal((20_000, 1))
    some = np.zeros(len(x), bool)
    some[::5] = True
    energy, number = haar(x, some, 0.2)
    long = np.array(SCALES) > 8
    np.testing.assert_allclose(energy[long, 0], 5 * 2 / np.array(SCALES)[long], rtol=0.35)
    assert number[long].all() and not number[0]


@pytest.mark.slow
@pytest.mark.parametrize(("encoder", "rate"), [("link_position", 25.0), ("motor_position", 50.0)])
def test_a_slow_log_is_predicted_as_well_as_by_its_regression(encoder, rate):
    """By the simulation, with every number within its tolerance and nothing hidden."""
    without = ("joint_torque", *({"link_position", "motor_position"} - {encoder}))
    drawn = draw(Challenge(seed=3, hidden="none", without=without), 0)
    first, last = [], []
    for r in drawn.measurement.recordings:
        rows = np.arange(0, len(r.time), round(1000 / rate))
        end = 0.6 * r.time[-1]
        first.append(r.at(rows[r.time[rows] < end]))
        last.append(r.at(rows[r.time[rows] > end]))
    found = diagnose(Measurement("slow", Path("slow"), tuple(first)), drawn.nominal)
    predicted = validate(Measurement("slow", Path("slow"), tuple(last)), found.extended).recordings
    off = {"diagnosis": [], "regression": []}
    for r, simulated in zip(last, predicted, strict=True):
        speed = np.abs(np.gradient(r[encoder], r.time))
        each = {
            "diagnosis": simulated.simulated["motor_current"],
            "regression": found.regressions[0].predict(r, drawn.nominal),
        }
        both = np.all(np.isfinite([*each.values()]), axis=0) & (speed > 0.05 * np.quantile(speed, 0.98))
        for name, x in each.items():
            off[name].append((r["motor_current"] - x)[both])
    error = {name: float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for name, x in off.items()}
    assert error["diagnosis"] < 1.05 * error["regression"], error
