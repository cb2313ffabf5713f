"""Settings of the filters have the dimensions of what they are: in the joint's torques, and in the motor side's angles.

Nothing is compiled here. A number of the joint that comes in upside down, or with another exponent, shows as another power; one
that is added to a different quantity shows none.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from test_symmetry import MOTOR_ANGLES, RICH, TORQUES, in_units

from flexspline.estimator import KnownJoint, SensorNoise, joint_model, registry
from flexspline.estimator.filters import augmented
from flexspline.models import laws
from flexspline.models.joint import load_joint

JOINT = load_joint("test-joint")
NOISE = SensorNoise(2e-3, 3e-4, 3e-6, 1.5e-6, 0.01, 2e-4, 1e-6, 0.02)
UNIT = 4.0
STATES = {name: i for i, name in enumerate(joint_model.STATES)}

AUGMENTED = {
    "link_variance": (0, 0), "torsion_variance": (0, 0), "rotor_walk": (-2, 4), "torque_variance": (2, -2), "mesh_walk": (0, 2),
    "bristle_walk": (0, 2), "presliding": (0, 1), "spring_walk": (2, 0), "loose": (2, 0), "external_quiet": (1, 0),
    "external_loud": (1, 0), "level": (1, -1), "level_time": (0, 0), "level_loud": (1, -1), "free": (1, 0), "gate": (0, 0),
    "memory": (0, 0), "low": (0, 0), "high": (0, 0), "wander": (0, 0), "interval": (0, 0), "back": (0, 0), "pause": (0, 0),
    "every": (0, 0), "wait": (0, 0), "least": (1, 0), "half": (0, 1), "sliding": (0, 1), "settled": (0, 0), "coarse": (2, 0),
    "stiffest": (0, 0), "link_half": (0, 0), "link_count": (0, 0),
}  # fmt: skip
"""Powers of torque and of the motor side's angle by setting."""
PRIOR = {"wound": (1, -1), "bristle": (0, 1), "spring": (1, 0), "external": (1, 0), "mesh": (1, -1)}
START = {
    "motor_position": (0, 2), "wave_generator_position": (0, 2), "bristle": (0, 2), "external_torque": (2, 0),
    "mesh_torque": (2, -2),
}  # fmt: skip
WALK = {"wave_generator_velocity": (0, 2), "bristle": (0, 2), "external_torque": (2, 0), "mesh_torque": (2, -2)}
RANDOM = {
    "current_walk": (0, 2), "mesh_surge": (2, -2), "external_surge": (2, 0), "motor_variance": (0, 2), "link_variance": (0, 0),
    "motor_step": (0, 1), "link_step": (0, 0), "mesh_time": (0, 0), "count": (0, 0),
    "memory": (0, 0), "low": (0, 0), "high": (0, 0),
}  # fmt: skip


def known(torque: float = 1.0, angle: float = 1.0, **numbers: float) -> KnownJoint:
    """The test joint in other units, with effects and spread."""
    joint = KnownJoint.of(JOINT, JOINT.mount("link"), RICH.record(3)).with_numbers(**numbers)
    noise = replace(NOISE, **{n: angle * getattr(NOISE, n) for n in ("motor_resolution", "motor_noise", "motor_error")})
    spread = replace(joint.spread, stiffness=0.07, kinematic=np.where(joint.p["amplitude"] != 0.0, 2e-5, 0.0))
    joint = replace(
        joint, noise=noise, rated_torque=torque * joint.rated_torque, link_zero=1e-4, link_wander=1e-5, spread=spread
    )
    return in_units(in_units(joint, TORQUES, torque), MOTOR_ANGLES, angle)


def powers(of) -> dict[str, tuple[float, float]]:
    """Powers of torque and angle of numbers, by name; `of`: joint → numbers by name."""
    base, torque, angle = of(known()), of(known(torque=UNIT)), of(known(angle=UNIT))
    return {
        name: tuple(np.round(np.log(other[name] / value) / np.log(UNIT), 6) for other in (torque, angle))
        for name, value in base.items()
        if value
    }


def test_of_the_augmented_filter():
    def of(joint: KnownJoint) -> dict[str, float]:
        c = registry.get("augmented").settings(joint, 1e-3)[0]
        found = {name: float(c[name]) for name in AUGMENTED}
        return found | {f"prior {name}": float(c["prior"][getattr(augmented, name.upper())]) for name in PRIOR}

    assert powers(of) == AUGMENTED | {f"prior {name}": value for name, value in PRIOR.items()}


def test_of_the_dynamics_filters():
    def of(joint: KnownJoint) -> dict[str, float]:
        n = registry.get("dynamics_ekf").process.record(joint, 1e-3)[0]
        found = {name: float(n[name]) for name in RANDOM}
        found |= {f"start {name}": float(n["start"][STATES[name]]) for name in START}
        return found | {f"walk {name}": float(n["walk"][STATES[name]]) for name in WALK}

    expected = RANDOM | {f"start {name}": value for name, value in START.items()}
    assert powers(of) == expected | {f"walk {name}": value for name, value in WALK.items()}


@pytest.mark.parametrize(
    "name", ["kalman", "h_infinity", "huber", "strong_tracking", "momentum", "momentum_torsion", "payload"]
)
def test_of_the_others_power_by_power(name):
    """A setting is one power of torque and one of angle, never a sum of different ones."""
    estimator = registry.get(name)

    def of(joint: KnownJoint) -> dict[str, float]:
        given = estimator.settings(joint, 1e-3)
        values = np.ascontiguousarray(given).view(np.float64).reshape(-1)
        return {f"{k}": float(value) for k, value in enumerate(values)}

    for k, found in powers(of).items():
        assert all(abs(2.0 * p - round(2.0 * p)) < 1e-4 for p in found), (k, found)


def augmented_settings(joint: KnownJoint) -> np.void:
    return registry.get("augmented").settings(joint, 1e-3)[0]


def process_noise(joint: KnownJoint) -> np.void:
    return joint_model.ProcessNoise().record(joint, 1e-3)[0]


VARIANCES = {
    "augmented": lambda j: augmented_settings(j)[["link_variance", "torsion_variance", "torque_variance"]],
    "dynamics": lambda j: process_noise(j)[["motor_variance", "link_variance", "current_walk"]],
    "start": lambda j: (process_noise(j)["start"][joint_model.LINK],),
}


@pytest.mark.parametrize("name", VARIANCES)
@pytest.mark.parametrize("delay", [0.0, 5e-3])
def test_independent_errors_of_sensors_add_up_in_power(name, delay):
    """All together they are the sum of each alone, less what there is without any; twice as much of each is four times that."""

    def variances(**noise: float) -> np.ndarray:
        silent = SensorNoise(*[0.0] * 8)
        joint = replace(known(link_delay=delay), noise=replace(silent, **noise))
        return np.array(list(VARIANCES[name](joint)), dtype=float)

    whole = {f.name: getattr(NOISE, f.name) for f in fields(NOISE)}
    none = variances()
    each = [variances(**{key: value}) - none for key, value in whole.items()]
    together = variances(**whole)
    np.testing.assert_allclose(together - none, np.sum(each, axis=0), rtol=1e-9)
    assert np.all(np.array(each) >= 0.0) and np.all(together > 0.0)
    twice = variances(**{key: 2.0 * value for key, value in whole.items()})
    np.testing.assert_allclose(twice - none, 4.0 * (together - none), rtol=1e-9)


def test_deviations_are_priors():
    """Deviations of the description's numbers are the constants' own; of kinematic error the largest orders'."""
    joint = known()
    kinematic = np.zeros(8)
    kinematic[[1, 4, 6, 7]] = 1e-5, 4e-5, 2e-5, 3e-5
    record = joint.record.copy()
    record[0]["order"] = np.arange(1, 9)
    spread = replace(
        joint.spread, stiffness=0.05, wave_generator=0.11, wave_generator_curve=0.12, torque_constant=0.02, gravity=0.013,
        kinematic=kinematic,
    )  # fmt: skip
    joint = replace(joint, record=record, spread=spread, friction=0.17, link_zero=3e-4, link_wander=2e-5)
    c = registry.get("augmented").settings(joint, 1e-3)[0]
    stated = {
        "STIFFNESS": 0.05, "ZERO": 3e-4, "WAVE": 0.11, "CURVE": 0.12, "WEIGHT": 0.013, "FRICTION": 0.17, "CONSTANT": 0.02,
    }  # fmt: skip
    for name, deviation in stated.items():
        assert c["prior"][getattr(augmented, name)] == pytest.approx(deviation), name
    assert list(c["order"]) == [5.0, 8.0, 7.0] and c["wander"] == 2e-5
    assert list(c["prior"][augmented.KINEMATIC :]) == pytest.approx([4e-5, 4e-5, 3e-5, 3e-5, 2e-5, 2e-5])
    fewer = replace(joint, spread=replace(spread, kinematic=np.where(kinematic == 4e-5, kinematic, 0.0)))
    c = registry.get("augmented").settings(fewer, 1e-3)[0]
    assert list(c["order"]) == [5.0, 0.0, 0.0] and not c["prior"][augmented.KINEMATIC + 2 :].any()
    assert c["prior"][augmented.COUNT] == pytest.approx(NOISE.motor_resolution / joint.p["N"] / np.sqrt(12.0))


def test_absent_states_are_not_carried():
    process = joint_model.ProcessNoise()

    def active(process: joint_model.ProcessNoise = process, **numbers: float) -> set[str]:
        n = process.record(known(**numbers), 1e-3)[0]
        return {joint_model.STATES[int(i)] for i in n["active"][: int(n["count"])]}

    plain = {"flexible_share": 0.0, "hysteresis_torque": 0.0}
    always = set(joint_model.STATES) - {
        "flexible_position",
        "flexible_velocity",
        "stiffness",
        "motor_constant",
        "hysteresis",
    }
    assert active(**plain) == always
    assert active(**plain | {"flexible_share": 0.2}) == always | {"flexible_position", "flexible_velocity"}
    assert active(**plain | {"hysteresis_torque": 0.2}) == always | {"hysteresis"}
    calibrating = replace(process, stiffness=0.05, motor_constant=0.02)
    assert active(calibrating, **plain) == always | {"stiffness", "motor_constant"}
    n = calibrating.record(known(), 1e-3)[0]
    assert n["start"][joint_model.STIFFNESS] == pytest.approx(0.05**2)
    assert n["start"][joint_model.CONSTANT] == pytest.approx(0.02**2)
    assert n["walk"][joint_model.STIFFNESS] > 0.0 == process.record(known(), 1e-3)[0]["walk"][joint_model.STIFFNESS]


def uniform(width: float) -> float:
    """Variance of a uniform distribution of a width."""
    return width**2 / 12.0


def test_sizes_of_the_augmented_filter():
    """In the joint's own terms: torques in T2 and Fc, bristles in how far friction bends them, readings in counts."""
    joint, a = known(), registry.get("augmented")
    p, c = joint.p, registry.get("augmented").settings(joint, 1e-3)[0]
    fc, t2, count = float(p["Fc"]), float(p["T2"]), NOISE.motor_resolution / float(p["N"])
    white = NOISE.link_noise**2 + NOISE.link_error**2 + 2.0 * uniform(NOISE.link_resolution)
    motor = (NOISE.motor_noise**2 + NOISE.motor_error**2) / p["N"] ** 2
    friction = 2.0 * joint.friction  # every relative error of its model counts twice
    bent = fc / p["s0"]
    expected = {
        "link_variance": white, "torsion_variance": white + motor + (count / 10) ** 2, "rotor_walk": p["Jm"] ** -2.0,
        "torque_variance": p["Kt"] ** 2 * NOISE.current_variance(1e-3), "mesh_walk": (1.5e-3 * fc / p["Jw"]) ** 2,
        "bristle_walk": (5.5e-3 * bent) ** 2, "presliding": 2.0 * bent * (2.0 * joint.friction) ** 2,
        "spring_walk": (0.007 * t2) ** 2, "loose": (2.0 * t2) ** 2, "external_quiet": 4e-4 * t2, "external_loud": 8.0 * t2,
        "level": np.sqrt(0.017**2 + friction**2) * fc, "level_loud": 1.1 * fc, "level_time": 5.0, "free": 5e-4 * t2, "gate": 4.0,
        "back": 0.05, "least": 0.03 * t2, "wait": 0.2, "memory": 0.8, "low": 5.0, "high": 12.0, "wander": 1e-5, "interval": 1e-3,
        "half": NOISE.motor_resolution / 2, "sliding": 2.5 * p["vs"], "settled": 0.1, "pause": 0.5, "every": 0.05,
        "link_half": NOISE.link_resolution / 2, "link_count": 2.0 * uniform(NOISE.link_resolution),
        "coarse": (0.01 * t2) ** 2, "stiffest": 1.25 * p["Cw"] * joint.rated_torque / p["N"],
    }  # fmt: skip
    for name, value in expected.items():
        assert c[name] == pytest.approx(value, rel=1e-9), name
    assert set(expected) == set(augmented.SETTINGS.names) - {"prior", "learned", "order"} and a.unsure == 2.0
    prior = {
        "LINK": np.sqrt(white), "LINK_RATE": 1.0 / p["N"], "ROTOR": 1.0, "WAVE_RATE": 1.0, "WOUND": 0.1 / p["Cw"],
        "BRISTLE": p["Fs"] / p["s0"], "SPRING": t2, "EXTERNAL": 0.2 * t2, "MESH": c["level"], "COUNT": np.sqrt(uniform(count)),
    }  # fmt: skip
    for name, value in prior.items():
        assert c["prior"][getattr(augmented, name)] == pytest.approx(value, rel=1e-9), name
    other = a.settings(replace(joint, load_error=7.0), 1e-3)[0]
    assert other["wait"] == np.inf and other["external_quiet"] == pytest.approx(3.5) and other["external_loud"] == 0.0
    assert other["prior"][augmented.EXTERNAL] == pytest.approx(math.hypot(0.2 * t2, 7.0))
    late = a.settings(known(link_delay=3e-3), 1e-3)[0]
    assert late["link_variance"] - white == pytest.approx((3.0 * count) ** 2)
    assert late["torsion_variance"] - c["torsion_variance"] == pytest.approx((3.0 * count) ** 2)
    steep = a.settings(known(Cw=1e9), 1e-3)[0]["stiffest"]
    assert steep == pytest.approx(-np.log(laws.LOGARITHM_END)), "no stiffer than the law itself gets"


def test_sizes_of_the_dynamics_filters():
    """Likewise; of what forgets, noise that keeps it at its level."""
    joint = known()
    p, n = joint.p, process_noise(joint)
    fc, t2, count = float(p["Fc"]), float(p["T2"]), NOISE.motor_resolution
    walk = {
        "wave_generator_velocity": (5.5e-4 * fc / p["Jw"]) ** 2, "bristle": (5.5e-3 * fc / p["s0"]) ** 2,
        "external_torque": (1e-3 * t2) ** 2, "mesh_torque": 2.0 * (0.017 * fc) ** 2 / 5.0,
        "hysteresis": (0.01 * p["hysteresis_extent"]) ** 2,
    }  # fmt: skip
    start = {
        "motor_position": count**2 + NOISE.motor_noise**2, "wave_generator_position": (0.1 / (p["Cw"] * p["Kw0"])) ** 2,
        "motor_velocity": 1.0, "wave_generator_velocity": 1.0, "link_velocity": p["N"] ** -2.0,
        "link_position": NOISE.link_resolution**2 + NOISE.link_noise**2, "bristle": (p["Fs"] / p["s0"]) ** 2,
        "external_torque": (0.2 * t2) ** 2, "mesh_torque": (0.017 * fc) ** 2, "hysteresis": p["hysteresis_extent"] ** 2,
    }  # fmt: skip
    for found, expected in ((n["walk"], walk), (n["start"], start)):
        for name, value in expected.items():
            assert found[STATES[name]] == pytest.approx(value, rel=1e-9), name
    single = {
        "current_walk": 1e-3 * NOISE.current_variance(1e-3) * (p["Kt"] / p["Jm"]) ** 2, "mesh_surge": (1.1 * fc) ** 2,
        "external_surge": (4.0 * t2) ** 2, "motor_variance": NOISE.motor_noise**2 + NOISE.motor_error**2 + (count / 20) ** 2,
        "link_variance": NOISE.link_noise**2 + NOISE.link_error**2, "motor_step": count, "link_step": NOISE.link_resolution,
        "mesh_time": 5.0, "memory": 0.8, "low": 3.0, "high": 6.0,
    }  # fmt: skip
    for name, value in single.items():
        assert n[name] == pytest.approx(value, rel=1e-9), name


def test_a_correlated_error_of_the_current_has_a_larger_variance():
    """10 ms: of samples that are 1 ms apart ten go the same way and move a rotor as far as ten times the variance; none is of
    less than a sample; without an interval noise is all that is known."""
    quiet = replace(NOISE, current_noise=0.0)
    for interval, longer in ((1e-3, 10.0), (5e-3, 2.0), (0.02, 1.0), (0.0, 0.0)):
        assert quiet.current_variance(interval) == pytest.approx(longer * NOISE.current_error**2)
        assert NOISE.current_variance(interval) == pytest.approx(
            longer * NOISE.current_error**2 + NOISE.current_noise**2
        )
