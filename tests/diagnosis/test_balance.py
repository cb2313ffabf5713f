"""Known causes fitted to one sweep with a known external torque: what was put into a simulated joint comes out."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import flexspline as fs
from benchmarks.lara8 import SENSOR_MEMORY, SENSOR_NOISE, fit_current, fit_eccentricity, with_effects
from flexspline.estimator.smoothed import STEP
from flexspline.models.joint import Joint, load_joint
from flexspline.models.joint_parts import Effect, Estimate
from flexspline.models.recording import Recording

HIDDEN = {
    "load_dependent_friction": {"coefficient": (0.12, "1")}, "gravity_direction": {"angle": (0.15, "rad")},
    "link_encoder_eccentricity": {"amplitude": (5e-4, "rad"), "phase": (0.7, "rad")},
}  # fmt: skip
CURRENT = ("load_dependent_friction", "gravity_direction")


def nominal() -> Joint:
    return load_joint("test-joint")


def effects(*names: str) -> list[Effect]:
    return [Effect(name=n, parameters={k: Estimate(value=v, unit=u) for k, (v, u) in HIDDEN[n].items()}) for n in names]


@cache
def sweep() -> Recording:
    """A sweep from hanging to horizontal, pushed now and then, of a joint with all three effects."""
    joint = with_effects(nominal(), effects(*HIDDEN))
    return fs.simulate("external_push", joint=joint, known_joint="test-joint", filters=["model"]).as_recording()


@pytest.mark.parametrize("part", [1.0, 0.5])
def test_two_causes_are_found_in_the_current(part):
    """Of the whole sweep and of its first half, each within two of its standard deviations."""
    recording = sweep()
    use = recording.time < part * recording.time[-1]
    found = fit_current(recording, nominal(), CURRENT, use)
    assert [e.name for e in found] == list(CURRENT)
    for effect in found:
        for name, estimate in effect.parameters.items():
            true, unit = HIDDEN[effect.name][name]
            print(effect.name, name, estimate.value, "±", estimate.std, unit)
            assert estimate.unit == unit and abs(estimate.value - true) < 2 * estimate.std < 0.9 * true


def test_a_cause_that_is_not_there_is_found_to_be_small():
    recording = fs.simulate("external_push", filters=["model"]).as_recording()
    found = fit_current(recording, nominal(), CURRENT)
    for effect in found:
        for estimate in effect.parameters.values():
            assert abs(estimate.value) < estimate.std


def test_what_this_balance_does_not_tell_of_stays_as_open_as_it_was():
    """The torque sensor is not in it: no gain of it but one is found, and up to its largest ordinary error may be there."""
    found = fit_current(sweep(), nominal(), ("torque_sensor_gain",))
    gain = found[0].parameters["gain"]
    assert gain.value == 1.0 and gain.std == pytest.approx(0.2)


def test_the_deviation_is_what_the_sensors_vibration_allows():
    """T = (torque of the current) − μ|T| changes by |T|/(1 + μ) with μ; the noise is one number every correlation time."""
    recording = sweep()
    known = with_effects(nominal(), effects("gravity_direction"))
    found = fit_current(recording, known, ("load_dependent_friction",))
    moving = np.abs(np.gradient(recording["link_position"], recording.time)) > 0.05
    T = recording["joint_torque"][moving]
    seconds = moving.sum() * float(np.median(np.diff(recording.time)))
    coefficient = found[0].parameters["coefficient"]
    expected = (1 + coefficient.value) * SENSOR_NOISE / np.sqrt(np.mean(T**2) * seconds / SENSOR_MEMORY)
    assert coefficient.std == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("seconds", [0.15, 0.3, 2.0])
def test_little_data_leave_a_part_of_what_was_thought_before(seconds):
    """Of a Gaussian prior about nothing with deviation s₀ a posterior of deviation s leaves the share s²/s₀² of the truth: the
    more, the less there is to see. Here the largest ordinary angle is s₀, 0.2 rad."""
    recording = sweep()
    known = with_effects(nominal(), effects("load_dependent_friction"))
    use = (recording.time > 8.0) & (recording.time < 8.0 + seconds)
    found = fit_current(recording, known, ("gravity_direction",), use)
    angle, (true, _) = found[0].parameters["angle"], HIDDEN["gravity_direction"]["angle"]
    print(f"{angle.value} ± {angle.std} rad")
    assert angle.value == pytest.approx(true * (1.0 - angle.std**2 / 0.2**2), rel=0.03)


def test_eccentricity_is_found_in_the_torsion():
    """Given the load; its deviation is what the stiffness' tolerance makes of it, as both go with the angle's sine."""
    joint, recording = nominal(), sweep()
    known = with_effects(joint, effects(*CURRENT))
    effect = fit_eccentricity(recording, known)
    (amplitude, _), (phase, _) = HIDDEN["link_encoder_eccentricity"].values()
    a, phi = effect.parameters["amplitude"], effect.parameters["phase"]
    print(f"{a.value} ± {a.std} rad, {phi.value} ± {phi.std}")
    assert (a.unit, phi.unit) == ("rad", "rad")
    assert a.value == pytest.approx(amplitude, rel=0.03) and phi.value == pytest.approx(phase, abs=0.03)
    number = joint.numbers["K1"]
    tolerance = np.hypot(number.tolerance, joint.shared_tolerances[number.shared])
    windup = joint.mount("link").gravity_moment / number.value
    assert a.std == pytest.approx(tolerance * windup, rel=0.2)
    assert phi.std == pytest.approx(a.std / a.value, rel=0.02)
    own = joint.model_copy(update={"numbers": joint.numbers | {"K1": number.model_copy(update={"shared": None})}})
    alone = fit_eccentricity(recording, with_effects(own, effects(*CURRENT)))
    assert alone.parameters["amplitude"].std == pytest.approx(number.tolerance * windup, rel=0.2)
    half = fit_eccentricity(recording, known, recording["link_position"] > 0.5)
    assert half.parameters["amplitude"].value == pytest.approx(amplitude, rel=0.2)


@pytest.mark.parametrize("seconds", [2.0, 6.0])
def test_an_eccentricity_seen_on_a_short_way_is_the_most_probable_one(seconds):
    """Of a short way neither zero nor delay of the encoder is told from a once-per-turn error: what most probably was among all
    that could have been, by their priors (1.5 mrad of either quadrature, 5 mrad, 0.3 ms) and the noise of torsion, 0.15 mrad."""
    recording = sweep()
    known = with_effects(nominal(), effects(*CURRENT))
    time, angle = recording.time, recording["link_position"]
    velocity = np.gradient(angle, time)
    use = (time > 8.0) & (time < 8.0 + seconds) & (np.abs(velocity) > 0.05)
    found = fit_eccentricity(recording, known, use).parameters
    (amplitude, _), (phase, _) = HIDDEN["link_encoder_eccentricity"].values()
    columns = np.column_stack([np.sin(angle), np.cos(angle), np.ones(len(angle)), velocity])[use]
    true = amplitude * np.array([np.cos(phase), np.sin(phase), -np.sin(phase), 0.0])
    information = columns.T @ columns / (1.5e-4**2 * SENSOR_MEMORY / STEP)
    prior = np.diag(np.array([1.5e-3, 1.5e-3, 5e-3, 0.3e-3]) ** -2.0)
    sine, cosine, _, _ = np.linalg.solve(information + prior, information @ true)
    z = found["amplitude"].value * np.exp(1j * found["phase"].value)
    print(f"{z:.3g}, most probable {sine + 1j * cosine:.3g}")
    assert abs(z - (sine + 1j * cosine)) < 0.05 * abs(z) and abs(z) < 0.7 * amplitude
