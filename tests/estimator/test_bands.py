"""Error bands: each part, with an estimator of known response to one error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from flexspline.estimator import get
from flexspline.estimator.bands import deviations, disagreement, motion_and_load, reference_torque
from flexspline.estimator.estimator import KnownJoint
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Uncertainty, ValidRange
from flexspline.models.signals import Signals

JOINT = load_joint("test-joint")
MOUNTING = JOINT.mount("link")
KNOWN = KnownJoint.of(JOINT, MOUNTING)
P = KNOWN.p
SCALE = float(P["N"] * P["Kt"])
SILENT = replace(KNOWN, noise=type(KNOWN.noise)(*[0.0] * 5))
TIME = np.arange(20_000) / 500.0


def signals(link: np.ndarray, current: np.ndarray | float = 0.5) -> Signals:
    """A joint that is wound up by 1 mrad; 40 s at 500 Hz."""
    motor = P["N"] * (link + 1e-3)
    return Signals(
        TIME, {"motor_position": motor, "link_position": link, "motor_current": np.broadcast_to(current, TIME.shape)}
    )


def stating(discrepancy: dict[str, float], names: tuple[str, ...] = (), factor: tuple = (), **more: float):
    uncertainty = Uncertainty(names=list(names), factor=[list(row) for row in factor], discrepancy=discrepancy, **more)
    return JOINT.model_copy(update={"uncertainty": uncertainty})


def found(run, signals: Signals, joint=JOINT, known=SILENT) -> dict[str, np.ndarray]:
    return deviations(run(signals, known), signals, known, joint, MOUNTING, run)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


RAMP = 0.5 * TIME


def test_noise_is_the_sensors_with_their_counts():
    noise = replace(SILENT.noise, motor_noise=3e-3, motor_resolution=4e-3 * np.sqrt(12), current_noise=0.2)

    def run(s: Signals, _):
        return {"motor": s["motor_position"], "current": s["motor_current"]}

    band = found(run, signals(RAMP), known=replace(KNOWN, noise=noise))
    assert rms(band["motor"]) == pytest.approx(5e-3, rel=0.03)
    assert rms(band["current"]) == pytest.approx(0.2, rel=0.03)
    # It is a mean over half a second, 250 samples: its variance has a deviation of √(2/250) of itself.
    assert np.std(band["current"] ** 2) / 0.04 == pytest.approx(np.sqrt(2 / 250), rel=0.35)


def test_a_drives_torque_has_the_uncertainty_of_its_current():
    """The unexplained part of the current was zero if the drive reported the torque."""
    per_ampere = float(P["Kt_drive"])

    def run(s: Signals, _):
        return {"torque": SCALE * (s["motor_current"] if "motor_current" in s else s["motor_torque"] / per_ampere)}

    read = signals(RAMP)
    columns = {name: read[name] for name in ("motor_position", "link_position")}
    reported = Signals(TIME, columns | {"motor_torque": per_ampere * read["motor_current"]})
    joint = stating({"motor_current": 0.3})
    one, other = (found(run, s, joint)["torque"] for s in (read, reported))
    np.testing.assert_allclose(other, one, rtol=1e-9)


def test_errors_of_current_are_scaled_by_the_estimators_response():
    """A first-order low-pass of time constant τ passes T/(T + τ) of the variance of an error that forgets in T = 0.3 s."""

    def run(s: Signals, _):
        keep = np.exp(-(s.time[1] - s.time[0]) / 0.3)
        torque = SCALE * s["motor_current"]
        slow, _ = lfilter([1 - keep], [1, -keep], torque, zi=[keep * torque[0]])
        return {"current": torque, "slow": slow, "none": np.zeros(len(torque))}

    band = found(run, signals(RAMP), stating({"motor_current": 0.02}))
    assert rms(band["current"]) == pytest.approx(SCALE * 0.02, rel=0.2)
    assert rms(band["slow"]) / rms(band["current"]) == pytest.approx(np.sqrt(0.5), rel=0.1)
    assert not band["none"].any()


@pytest.mark.fast_every(3)
@pytest.mark.parametrize("stated, hysteresis, expected", [
    ({"joint_torque": 3.0, "link_balance": 4.0}, 3.0, 5.0), ({"joint_torque": 0.4, "link_balance": 0.3}, 0.0, 0.4),
    ({"joint_torque": 0.4}, 0.0, 0.4), ({"link_balance": 0.4}, 0.0, 0.4), ({}, 0.4, 0.4), ({}, 0.0, 0.0),
])  # fmt: skip
def test_errors_of_torsion_are_the_larger_balances_and_the_hysteresis(stated, hysteresis, expected):
    joint, known = stating(stated), SILENT.with_numbers(hysteresis_torque=hysteresis * np.sqrt(3.0))

    def run(s: Signals, _):
        return {"torsion": P["K1"] * (s["motor_position"] / P["N"] - s["link_position"])}

    assert rms(found(run, signals(RAMP), joint, known)["torsion"]) == pytest.approx(expected, rel=0.2)


@pytest.mark.fast_every(3)
@pytest.mark.parametrize("read", [
    ("motor_position", "link_position", "motor_current"), ("motor_position", "motor_current"), ("motor_position", "motor_torque"),
    ("motor_position", "link_position"), ("link_position", "motor_current"), ("link_position",),
], ids="+".join)  # fmt: skip
def test_each_sensor_has_its_own_errors(read):
    """A torque from one angle, from both or from the current has errors of torsion or current, where these are read."""
    s = signals(RAMP).with_columns(motor_torque=np.full(len(TIME), P["Kt_drive"] * 0.5))
    s = Signals(TIME, {name: s[name] for name in read})
    both = {"motor_position", "link_position"} <= set(read)
    joint = stating({"motor_current": 0.02, "link_balance": 4.0})

    def run(s: Signals, _):
        turned = s["motor_position"] / P["N"] if "motor_position" in s else 0.0
        angle = s["link_position"] if "link_position" in s else 0.0
        torque = s["motor_torque"] if "motor_torque" in s else np.zeros(len(s.time))
        current = s["motor_current"] if "motor_current" in s else torque / P["Kt_drive"]
        return {"angles": P["K1"] * (turned - angle) + 0.0 * s.time, "current": SCALE * current}

    band = found(run, s, joint)
    assert rms(band["angles"]) == (pytest.approx(4.0, rel=0.2) if both else 0.0)
    driven = {"motor_current", "motor_torque"} & set(read)
    assert rms(band["current"]) == (pytest.approx(SCALE * 0.02, rel=0.2) if driven else 0.0)


def test_errors_grow_beyond_the_range():
    """By `beyond` at a whole range beyond it; here the ramp ends half a range beyond."""
    valid = ValidRange(link_position=[0.0, RAMP[-1] / 1.5], link_velocity=[-100, 100], joint_torque=[-1e4, 1e4])
    joint = stating({"motor_current": 0.02}, beyond=5.0).model_copy(update={"valid": valid})
    band = found(lambda s, k: {"current": SCALE * s["motor_current"]}, signals(RAMP), joint)["current"]
    assert band[TIME < 20].std() < 0.01 * band[0]
    assert band[-100] / band[0] == pytest.approx(3.0, rel=0.03)


def test_friction_at_rest_is_unknown_up_to_its_level():
    def run(s: Signals, known: KnownJoint):
        return {"friction": np.full(len(s.time), known.p["N"] * known.p["Fc"])}

    joint = stating({}, ("Fc",), ((0.0,),))  # else its tolerance is in the band too
    rest = found(run, signals(np.zeros(len(TIME))), joint)["friction"]
    slow = found(run, signals(P["vs"] / P["N"] * TIME), joint)["friction"]
    moving = found(run, signals(RAMP), joint)["friction"]
    level = P["N"] * P["Fs"] / np.sqrt(3)
    assert rms(rest) == pytest.approx(level, rel=1e-3)
    np.testing.assert_allclose(slow[1000:-1000], level / np.e, rtol=1e-2)
    assert rms(moving[1000:-1000]) < 1e-3 * level


def test_tolerances_widen_the_band():
    joint = stating({}, ("Kt",), ((0.1 * P["Kt"],),))
    current = 0.5 + 0.3 * np.sin(TIME)

    def run(s: Signals, known: KnownJoint):
        return {"current": known.p["N"] * known.p["Kt"] * s["motor_current"]}

    np.testing.assert_allclose(found(run, signals(RAMP, current), joint)["current"], 0.1 * SCALE * current, rtol=0.05)


def test_disagreement_is_a_mean_over_half_a_second():
    step = np.where(TIME < 20.0, 0.0, 2.0)
    apart = disagreement(TIME, step, np.zeros(len(TIME)))
    assert apart[0] == 0.0 and apart[-1] == 2.0
    assert np.interp(20.0, TIME, apart) == pytest.approx(2.0 * np.sqrt(0.5), rel=0.01)
    assert np.interp(20.2, TIME, apart) == pytest.approx(2.0 * np.sqrt(0.9), rel=0.01)
    assert TIME[np.flatnonzero(apart > 0)[0]] == pytest.approx(19.75, abs=0.01)


def test_the_torque_without_lag_is_of_torsion_or_else_of_current():
    s = signals(RAMP)
    np.testing.assert_array_equal(reference_torque(s, SILENT), get("model").estimate(s, SILENT).mean)
    only = Signals(TIME, {name: s[name] for name in ("motor_position", "motor_current")})
    np.testing.assert_array_equal(reference_torque(only, SILENT), get("current_smoothed").estimate(only, SILENT).mean)
    assert not reference_torque(Signals(TIME, {"link_position": RAMP}), SILENT).any()


def test_a_drives_torque_is_converted_to_current():
    s = signals(RAMP, 0.5 + 0.3 * np.sin(TIME))
    other = Signals(TIME, {name: s[name] for name in ("motor_position", "link_position")})
    _, one = motion_and_load(s, SILENT)
    _, same = motion_and_load(other.with_columns(motor_torque=P["Kt_drive"] * s["motor_current"]), SILENT)
    np.testing.assert_allclose(same, one, rtol=1e-9, atol=1e-9)
