"""Energy: kept when nothing takes it, never gained when nothing gives it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from driving import JOINT, record_of
from energy import energy, energy_of, flexspline_energy, wave_generator_energy
from scipy.integrate import quad

from flexspline.models import laws
from flexspline.sim import plant

BELOW_THE_KNEE = np.array([0.02, 0.01, -2e-4])
PAST_THE_KNEE = np.array([0.03, 0.02, -1e-3])


def energies(record, mounting, start, timestep, seconds, every=7):
    """Total energy [J] along the motion from rest at `start`, and at that start."""
    model = plant.build(JOINT, JOINT.mount(mounting), record=record, timestep=timestep, ideal_current=True)
    data = mujoco.MjData(model)
    plant.start(model, data, start)
    found = []
    for _ in range(round(seconds / timestep) // every):
        mujoco.mj_step(model, data, nstep=every)
        found.append(energy(model, data, record).total)
    return np.array(found), energy_of(record, start, np.zeros(3)).total


def frictionless(mounting):
    record = record_of(mounting, bm=0.0, bw=0.0, bl=0.0, df=0.0, dw=0.0, s1=0.0)
    record[0]["s0"] = 1e-300  # no bristle force; zero would leave the bristle out of the model
    return record


def drift(found, windows=10):
    means = found[: len(found) // windows * windows].reshape(windows, -1).mean(axis=1)
    return float(np.ptp(means) / means[0])


@pytest.mark.fast_every(3)
@pytest.mark.parametrize(
    ("mounting", "start", "timestep", "changes"),
    [
        ("no_load", BELOW_THE_KNEE, plant.TIMESTEP, {}),
        ("link", BELOW_THE_KNEE, plant.TIMESTEP, {}),
        ("link", PAST_THE_KNEE, plant.TIMESTEP, {}),
        ("link", PAST_THE_KNEE, plant.TIMESTEP, {"knee_width": 1.5e-4}),
        ("link", BELOW_THE_KNEE, plant.TIMESTEP, {"flexible_share": 0.3, "flexible_frequency": 20.0}),
        ("link", PAST_THE_KNEE, plant.TIMESTEP, {"flexible_share": 0.2, "flexible_frequency": 12.0}),
        pytest.param("no_load", PAST_THE_KNEE, 2.5e-5, {}, marks=pytest.mark.slow),
    ],
)
def test_no_drift_in_ten_seconds(mounting, start, timestep, changes):
    """Wound springs without friction, damping and motor. Beyond a breakpoint, where the slope jumps, a finer step."""
    record = frictionless(mounting)
    for name, value in changes.items():
        record[0][name] = value
    found, begin = energies(record, mounting, start, timestep, 10.0)
    print(f"{mounting} {timestep}: drift {drift(found):.2e}, ripple {found.std() / begin:.2e}")
    assert drift(found) < 1e-3
    assert found.mean() == pytest.approx(begin, rel=0.03)


@pytest.mark.fast_every(5)
@pytest.mark.parametrize("mounting", ["no_load", "link"])
@pytest.mark.parametrize("effect", ["none", "own bristle", "hysteresis", "backlash", "flexible"])
def test_friction_only_removes_energy(mounting, effect):
    """With friction and damping on and no input, the energy never exceeds what it was, but for the ripple of one step."""
    changes = {
        "none": {},
        "own bristle": {"friction_asymmetry": 0.3},
        "hysteresis": {"hysteresis_torque": 1.0, "hysteresis_extent": 8e-5},
        "backlash": {"backlash": 4e-4},
        "flexible": {"flexible_share": 0.3, "flexible_frequency": 20.0, "flexible_damping": 0.03},
    }[effect]
    found, begin = energies(record_of(mounting, **changes), mounting, PAST_THE_KNEE, plant.TIMESTEP, 2.0, every=1)
    assert np.max(np.maximum.accumulate(found[::-1])[::-1] - found) <= 2e-3 * begin  # later, never more than now
    assert found[0] <= begin * (1 + 1e-3)
    assert found[-1] < 0.2 * begin


@pytest.mark.parametrize("backlash", [0.0, 4e-4])
@pytest.mark.parametrize("width", [0.0, 2e-4])
def test_spring_energies_are_integrals_of_the_laws(backlash, width):
    record = record_of(backlash=backlash, knee_width=width)
    p = record[0]
    breakpoints = [
        0.5 * backlash + x
        for x in (0.0, *(k + s for k in (3.9 / 8400, 3.9 / 8400 + 8.1 / 9400) for s in (-width, width)))
    ]
    for x in (1e-4, 3e-4, 9e-4, 3e-3, -2e-3):
        inside = [k for k in breakpoints if 0 < k < abs(x)]
        area = quad(
            lambda s: laws.flexspline_spring(s, p), 0, abs(x), points=sorted(set(inside)) or None, epsabs=1e-14
        )[0]
        assert flexspline_energy(x, p) == pytest.approx(area, rel=1e-10, abs=1e-15)
    for x in (1e-7, 1e-5, 4e-5, 1e-3, 2e-2, 0.0435, -0.01):
        area = quad(lambda s: laws.wave_generator_spring(s, p), 0, abs(x), epsabs=1e-18, epsrel=1e-11, limit=200)[0]
        assert wave_generator_energy(x, p) == pytest.approx(area, rel=1e-7)
    end = (1 - laws.LOGARITHM_END) / (p["Cw"] * p["Kw0"])
    beyond = wave_generator_energy(end + 1e-3, p) - wave_generator_energy(end, p)
    area = quad(lambda s: laws.wave_generator_spring(s, p), end, end + 1e-3)[0]
    assert beyond == pytest.approx(area, rel=1e-9)


def test_forces_are_the_slopes_of_the_energy():
    """Gravity, cable, stop and cogging: −dE/dθ is the torque of the law."""
    record = record_of(cable_stiffness=1.2, cable_rest=0.4, stop_angle=0.1, stop_stiffness=30.0, gravity_angle=0.2)
    p = record[0]
    p["cogging_amplitude"][0], p["cogging_order"][0], p["cogging_phase"][0] = 8e-3, 5, 0.4
    step = 1e-5

    def slope(field, position, axis):
        parts = []
        for sign in (1, -1):
            moved = np.array(position)
            moved[axis] += sign * step
            parts.append(getattr(energy_of(record, moved, np.zeros(3)), field))
        return (parts[0] - parts[1]) / (2 * step)

    for position in ([0.3, 0.2, 0.05], [0.4, 0.5, 0.5]):
        assert -slope("link", position, 2) == pytest.approx(laws.link_torque(position[2], p), rel=1e-6)
        assert -slope("cogging", position, 0) == pytest.approx(laws.cogging_torque(position[0], p), rel=1e-6)
        assert -slope("gravity", position, 2) == pytest.approx(-9.0 * np.sin(position[2] + 0.2), rel=1e-6)
