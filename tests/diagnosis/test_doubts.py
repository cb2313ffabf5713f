"""Doubts that `check` and `estimate` state: what no joint within tolerance explains, and no mistake of a column."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import flexspline as fs
from flexspline.diagnosis.check import check
from flexspline.models.errors import InputWarning
from flexspline.models.joint import Joint, load_joint
from flexspline.models.recording import Measurement, Recording, write_recording

JOINT = "csg-20-50-ec90"


@pytest.fixture(scope="module")
def sound() -> list[Recording]:
    """Free motion, and motion with measured pushes."""
    points = ((0.3, 0.0), (1.4, 0.9), (2.9, -0.8), (4.1, 0.1), (5.6, -0.9), (7.0, 0.4))
    moves = [{"time": t, "position": q} for t, q in points]
    pushes = [{"kind": "push", "start": t, "duration": 0.5, "torque": size} for t, size in ((2.0, 5.0), (4.8, -5.0))]
    found = []
    for name, disturbances in (("free", []), ("pushed", pushes)):
        run = fs.simulate(
            "no_load", joint=JOINT, seed=4, duration=7, trajectory=moves, mounting="link", filters=["model"],
            disturbances=disturbances,
        )  # fmt: skip
        found.append(replace(run.as_recording(), name=name))
    return found


def said(tmp_path, recordings: list[Recording], joint: Joint) -> str:
    """The warnings of `check`."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        found = check(Measurement("m", tmp_path, tuple(recordings)), joint)
    assert not found.mistakes
    return " ".join(str(w.message) for w in caught if issubclass(w.category, InputWarning))


def scaled(joint: Joint, factor: float, *symbols: str) -> Joint:
    numbers = {s: joint.numbers[s].model_copy(update={"value": factor * joint.numbers[s].value}) for s in symbols}
    return joint.model_copy(update={"numbers": {**joint.numbers, **numbers}})


def test_a_sound_measurement_has_none(sound, tmp_path):
    assert said(tmp_path, sound, load_joint(JOINT)) == ""


@pytest.mark.parametrize(("factor", "named"), [(1.0, False), (1.25, True)])
def test_a_clock_next_to_noise_of_the_encoder(factor, named, tmp_path, rng):
    """Noise of the acceleration made the inertia smaller."""
    joint = load_joint("csg-25-100-tbm2g")
    link = max(joint.mountings.values(), key=lambda mounting: mounting.gravity_moment)
    p, time = joint.record(link)[0], np.arange(0.0, 20.0, 1e-3)
    waves = [(size, rate, np.sin(rate * time)) for size, rate in ((0.35, 0.9), (0.15, 2.3))]
    theta, a = sum(size * wave for size, _, wave in waves), sum(-size * rate**2 * wave for size, rate, wave in waves)
    torque, noise = p["Mg"] * np.sin(theta) + p["Jl"] * a, rng.standard_normal((3, len(time)))
    low = np.clip(torque, -p["T1"], p["T1"])
    motor = torque / p["N"] + p["N"] * (p["Jm"] + p["Jw"]) * a + p["Fc"] * np.sign(np.gradient(theta))
    columns = {
        "motor_position": p["N"] * (theta + low / p["K1"] + (torque - low) / p["K2"]),
        "link_position": theta + 2e-6 * noise[0],
        "motor_current": motor / p["Kt"] + 0.036 * noise[1],
        "joint_torque": torque + 0.17 * noise[2],
    }
    text = said(tmp_path, [Recording("m", factor * time, columns, link=link)], joint)
    assert ("joint_torque: inertia is" in text and "is time in seconds" in text) if named else text == ""


@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_a_rotor_of_another_inertia(sound, factor, tmp_path):
    assert "rotor inertia is" in said(tmp_path, sound, scaled(load_joint(JOINT), factor, "Jm"))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_another_stiffness(sound, factor, tmp_path):
    """The wave generator's torsion, of another size, is part of the motion."""
    text = said(tmp_path, sound, scaled(load_joint(JOINT), factor, "K1", "K2", "K3"))
    assert "the torsion is" in text and "described stiffness" in text


@pytest.mark.parametrize("column", ["motor_current", "joint_torque"])
def test_a_noisy_sensor_is_named_by_check_and_estimate(flexspline, sound, column, tmp_path, rng):
    (r, _) = sound
    noisy = r[column] + 0.3 * r[column].std() * rng.standard_normal(len(r.time))
    path = write_recording(replace(r, columns=r.columns | {column: noisy}), tmp_path / "m")
    for words in (("check", path), ("estimate", path, "--out", tmp_path / "e", "--filter", "model")):
        code, _, err = flexspline(*words)
        assert code == 0 and f"{column} has a noise of" in err, err


def test_estimate_compares_the_drives_torque_with_its_current(flexspline, sound, tmp_path):
    """`check` alone did."""
    (r, _) = sound
    Kt = load_joint(JOINT).numbers["Kt"].value
    columns = r.columns | {"motor_torque": 1.2 * Kt * r["motor_current"]}
    path = write_recording(replace(r, columns=columns), tmp_path / "m")
    code, _, err = flexspline("estimate", path, "--out", tmp_path / "e", "--filter", "model")
    assert code == 0 and "motor_torque is 1.2 times motor_current" in err, err


def test_noise_of_the_current_of_a_joint_that_vibrates_is_its_own(sound, tmp_path, rng):
    (r, _) = sound
    noise = rng.standard_normal(len(r.time))
    shaken = {name: r[name] + 0.3 * r[name].std() * noise for name in ("motor_current",)}
    shaken |= {name: r[name] + size * noise for name, size in (("motor_position", 0.05), ("link_position", 1e-3))}
    assert "motor_current has a noise" not in said(
        tmp_path, [replace(r, columns=r.columns | shaken)], load_joint(JOINT)
    )
