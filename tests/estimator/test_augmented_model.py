"""The augmented filter's model against the joint's equations: predictions, errors and learning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from known_effects import signals_of
from test_symmetry import PLAIN, SEED, seen

from flexspline.estimator import KnownJoint, joint_model, registry
from flexspline.estimator.estimator import as_samples, go_on
from flexspline.estimator.filters import augmented
from flexspline.estimator.filters.augmented import MEMORY, SETTINGS, SIZE
from flexspline.models import dynamics, laws
from flexspline.models.signals import Signals

NAMES = (
    "link", "link_rate", "rotor", "wave_rate", "wound", "bristle", "spring", "swing", "swing_rate", "external", "mesh", "count",
    "friction", "constant", "late", "weight", "inertia", "stiffness", "zero", "wave", "curve",
)  # fmt: skip
AT = {name: i for i, name in enumerate(NAMES)}
assert augmented.KINEMATIC == len(NAMES) and [getattr(augmented, n.upper()) for n in NAMES] == list(range(21))
FIXED, MOVING = AT["friction"], AT["count"]
UNITS = np.r_[
    1e-6,
    1e-4,
    1e-2,
    1e-2,
    1e-4,
    1e-6,
    1e-2,
    1e-6,
    1e-4,
    1e-2,
    1e-4,
    1e-7,
    np.full(6, 1e-3),
    1e-6,
    1e-3,
    1e-3,
    np.full(6, 1e-6),
]
"""A size of every state that is small for it."""


@dataclass
class Midway:
    """The filter after a part of a recording, ready for its next sample from any state and covariance.

    Attributes:
      joint: the known joint. memory, settings: its records. sample: the next one.
    """

    joint: KnownJoint
    memory: np.void
    settings: np.void
    sample: np.void
    _arrays: tuple

    @classmethod
    def of(cls, case: str, samples: int = 900, interval: float | None = None, **changes: float) -> Midway:
        """Of a case of `test_symmetry`; `interval` [s] to the next sample, by default the recording's; changes: of its record."""
        signals, known = seen(case)
        known = known.with_numbers(**changes)
        estimator = registry.get("augmented")
        step = estimator.step(known, 1e-3)
        given = as_samples(signals, (), known)[: samples + 1].copy()
        arrays = step.arrays()
        go_on(arrays, given[:samples], np.zeros((samples, step.outputs)))
        if interval is not None:
            given[samples]["interval"] = interval
        arrays = (arrays[0], arrays[1].copy(), arrays[2], arrays[3].copy(), arrays[4])
        found = cls(known, arrays[1].view(MEMORY)[0], arrays[3].view(SETTINGS)[0], given[samples], arrays)
        found.memory["belief"] = 1.0
        return found

    def blind(self) -> Midway:
        """Let no measurement count."""
        self.settings["link_variance"] = self.settings["torsion_variance"] = 1e30
        self.settings["wait"] = 1e30
        return self

    def after(self, x=None, P=None, **memory: float):
        """State, covariance and outputs after the sample, from a state and covariance; and what is remembered."""
        arrays = (self._arrays[0], self._arrays[1].copy(), *self._arrays[2:])
        m = arrays[1].view(MEMORY)[0]
        m["x"] = self.memory["x"] if x is None else x
        m["P"] = 0.0 if P is None else P
        for name, value in memory.items():
            m[name] = value
        out = np.zeros((1, len(augmented.OUT.names)))
        assert go_on(arrays, np.array([self.sample]), out) == (1, 0)
        return m["x"].copy(), m["P"].copy(), out.view(augmented.OUT)[0, 0], m

    def moved(self, i: int, by: float) -> np.ndarray:
        x = self.memory["x"].copy()
        x[i] += by
        return x

    def jacobian(self) -> np.ndarray:
        """Of the state after the sample by the state before, by central differences."""
        return np.column_stack([
            (self.after(self.moved(i, UNITS[i]))[0] - self.after(self.moved(i, -UNITS[i]))[0]) / (2.0 * UNITS[i])
            for i in range(SIZE)
        ])  # fmt: skip

    def rates(self, x: np.ndarray) -> np.ndarray:
        """The joint's equations as the module states them, at a state; geometry as the sample's readings have it."""
        p, s, c = self.joint.p, self.sample, self.settings
        state = dict(zip(NAMES, x, strict=False))
        motor_torque = p["Kt"] * (s["motor_current"] - p["current_offset"])
        motor_torque += laws.cogging_torque(s["motor_position"], p)
        link = s["link_position"] - p["link_zero"]
        torsion, theta = dynamics.measured_torsion(s["motor_position"], link, motor_torque, p)
        slope = laws.kinematic_error_slope(theta, p)
        for k in range(augmented.ORDERS):
            n, (a, b) = c["order"][k], x[len(NAMES) + 2 * k :][:2]
            slope += n * (a * np.cos(n * theta) - b * np.sin(n * theta))
        r, out = 1.0 / p["N"] - slope, np.zeros(SIZE)
        joint_state = dynamics.drive_state(
            s["motor_position"], state["wave_rate"], state["link"], state["link_rate"], state["bristle"], 0.0, s["time"],
            s["temperature"],
        )  # fmt: skip
        g = (1.0 + state["friction"]) * dynamics.sliding_friction(joint_state, state["spring"], p)
        torsion_rate = r * state["wave_rate"] - state["link_rate"]
        spring = (1.0 + state["stiffness"]) * laws.flexspline_stiffness(torsion, p)
        if p["hysteresis_torque"]:
            z, extent = self.after(x)[3]["torsion"]["dahl"], p["hysteresis_extent"]
            spring += p["hysteresis_torque"] / extent * (1.0 - np.sign(torsion_rate) * z / extent)
        load = state["spring"] + p["df"] * torsion_rate
        pull = laws.flexible_torque(state["swing"], state["swing_rate"], p)
        own = (1.0 + state["weight"]) * dynamics.link_torque(joint_state, state["spring"], p)
        on_link = load - p["bl"] * state["link_rate"] + own + state["external"] + pull
        damping = p["dw"] * (state["rotor"] - state["wave_rate"])
        friction = dynamics.mesh_torque(joint_state, state["spring"], g, p)
        given = motor_torque - state["late"] * (motor_torque - self.memory["motor_torque"])
        out[AT["link"]] = state["link_rate"]
        out[AT["link_rate"]] = on_link / (p["Jl"] * (1.0 + state["inertia"] - p["flexible_share"]))
        out[AT["rotor"]] = (1.0 + state["constant"]) * given - p["bm"] * state["rotor"] - state["wound"] - damping
        out[AT["rotor"]] /= p["Jm"]
        out[AT["wave_rate"]] = (state["wound"] + damping - friction + state["mesh"] - r * load) / p["Jw"]
        out[AT["wound"]] = p["Kw0"] * np.exp(p["Cw"] * abs(state["wound"])) * (state["rotor"] - state["wave_rate"])
        out[AT["bristle"]] = laws.bristle_rate(state["bristle"], state["wave_rate"], g, p)
        out[AT["spring"]] = spring * torsion_rate
        if p["flexible_share"]:
            out[AT["swing"]] = state["swing_rate"]
            out[AT["swing_rate"]] = -pull / (p["flexible_share"] * p["Jl"]) - out[AT["link_rate"]]
        out[AT["mesh"]] = -state["mesh"] / c["level_time"]
        return out


def disturbed(midway: Midway, **values: float) -> Midway:
    """The same, not in equilibrium: pushed, swinging, wound; with an unknown kinematic error."""
    x, p = midway.memory["x"], midway.joint.p
    given = {"external": 1.5, "mesh": 2e-3, "rotor": x[AT["rotor"]] + 0.3, **values}
    if p["flexible_share"]:
        given |= {"swing": 1e-4, "swing_rate": 2e-3}
    for name, value in given.items():
        x[AT[name]] = value
    x[len(NAMES) :] = 1e-6 * np.arange(1, 7) * np.repeat(midway.settings["order"] > 0.0, 2)
    return midway.blind()


ERRORS = {"friction": 0.1, "constant": -0.02, "weight": 0.03, "inertia": 0.02, "late": 0.3, "stiffness": -0.05}
MOMENT = 1e-7
"""An interval [s] so short that rates are all there is."""


@pytest.mark.parametrize("case", ["plain", "rich"])
def test_it_moves_by_the_joints_equations(case):
    midway = disturbed(Midway.of(case, interval=MOMENT), **ERRORS)
    x = midway.memory["x"]
    expected, found = midway.rates(x), (midway.after()[0] - x) / MOMENT
    for name, i in AT.items():
        if name != "count":  # a new one
            assert found[i] == pytest.approx(expected[i], rel=1e-3, abs=1e-6), name
    moved = [n for n in NAMES[:MOVING] if n != "external" and (case == "rich" or not n.startswith("swing"))]
    assert all(expected[AT[name]] for name in moved)


@pytest.mark.parametrize("slow", [0.4, -0.4])
def test_more_friction_bends_the_bristle_the_way_it_turns(slow):
    """At any speed: at ±0.4 rad/s the bristle's rate by friction's error has the sign of the motion."""
    midway = disturbed(Midway.of("plain", interval=MOMENT), wave_rate=slow, bristle=0.5e-3 * np.sign(slow))
    P = np.zeros((SIZE, SIZE))
    i, j = AT["bristle"], FIXED
    P[j, j] = UNITS[j] ** 2
    found = (midway.after(P=P)[1] - midway.after()[1])[i, j] / P[j, j] / MOMENT
    # of a bristle that has bent as far as it goes, which F takes it for
    assert found == pytest.approx(slow, rel=0.05)


@pytest.mark.parametrize("changes", [{}, {"flexible_share": 0.2, "flexible_damping": 0.05, "cable_stiffness": 0.7}])
def test_errors_grow_by_the_equations_linearised(changes):
    """F from the covariance of one error at a time, against differences of the equations. Left out: the Stribeck curve's slope,
    what a bristle's deflection does to its damping, how the wave generator stiffens, how a weight shakes a flexible part,
    all of kinematic error but the spring's."""
    midway = disturbed(Midway.of("plain", interval=MOMENT, **changes), stiffness=0.0)
    noise = midway.after()[1]
    linear = {"Fs": midway.joint.p["Fc"], "friction_load": 0.0}
    others = Midway(midway.joint.with_numbers(**linear), midway.memory, midway.settings, midway.sample, midway._arrays)
    undamped = Midway(others.joint.with_numbers(s1=0.0), midway.memory, midway.settings, midway.sample, midway._arrays)
    for j in range(SIZE):
        P = np.zeros((SIZE, SIZE))
        P[j, j] = UNITS[j] ** 2
        column = (midway.after(P=P)[1] - noise)[:, j] / P[j, j]
        column[j] = 0.5 * (column[j] - 1.0)
        by = undamped if j in (AT["bristle"], FIXED) else others
        expected = (by.rates(midway.moved(j, UNITS[j])) - by.rates(midway.moved(j, -UNITS[j]))) / (2.0 * UNITS[j])
        for i in range(MOVING):
            left_out = (i, j) in ((AT["wound"], AT["wound"]), (AT["swing_rate"], AT["weight"])) or (
                j >= len(NAMES) and i != AT["spring"]
            )
            second_order = 0.02 if i != AT["wave_rate"] else 2.0
            if not left_out:
                assert column[i] / MOMENT == pytest.approx(expected[i], rel=0.02, abs=second_order), (NAMES[i], j)


@pytest.mark.parametrize("case", ["plain", "rich"])
@pytest.mark.parametrize("interval", [1e-3, 4e-3])
def test_errors_grow_as_states_part(case, interval):
    """Over an interval of many substeps: F P Fᵀ of small errors against the difference of propagated states."""
    midway = disturbed(Midway.of(case, interval=interval, friction_load=0.0, hysteresis_torque=0.0))
    rng = np.random.default_rng(8)
    L = rng.standard_normal((SIZE, SIZE)) * UNITS[:, None]
    L[AT["count"]] = 0.0  # which is new
    L[len(NAMES) :] = 0.0
    noise = midway.after()[1]
    found = midway.after(P=L @ L.T)[1] - noise
    parted = np.column_stack([
        (midway.after(midway.memory["x"] + 0.1 * e)[0] - midway.after(midway.memory["x"] - 0.1 * e)[0]) / 0.2 for e in L.T
    ])  # fmt: skip
    expected = parted @ parted.T
    moved = np.flatnonzero(np.sqrt(np.diag(expected)) > 1e-3 * UNITS)
    spread = np.sqrt(np.diag(expected)[moved])
    apart = np.abs(found - expected)[np.ix_(moved, moved)] / np.outer(spread, spread)
    print("seed 8: largest difference of", len(moved), "states, in their own deviations:", apart.max())
    assert len(moved) == 20 and apart.max() < (0.1 if interval == 1e-3 else 0.2)


def seeing(case: str, deviation: float = 0.02) -> Midway:
    """Midway, the torsion alone read, so that its torque has a standard deviation [N·m]; nothing but rates in between."""
    midway = disturbed(Midway.of(case, interval=MOMENT), friction=0.0, constant=0.0, weight=0.0, stiffness=0.0)
    midway.memory["x"][AT["zero"] :] = 0.0
    midway.settings["torsion_variance"] = (deviation / midway.joint.p["K1"]) ** 2
    midway.settings["presliding"] = 0.0  # a bristle that is beyond its end comes back at once
    return midway


def test_sensitivity_of_torsion_to_the_joints_numbers():
    """An error of a number in the state changes torsion's torque as a change of the record does."""
    midway = seeing("plain")
    p = midway.joint.p

    def innovation(x=None, **changes):
        other = midway.joint.with_numbers(**changes)
        arrays = (*midway._arrays[:2], other.record, *midway._arrays[3:])
        return Midway(other, midway.memory, midway.settings, midway.sample, arrays).after(x)[2]["innovation"]

    before = innovation()
    small = 1e-4
    changes = {
        "zero": (1e-7, {"link_zero": p["link_zero"] + 1e-7}),
        "wave": (small, {"Kw0": p["Kw0"] * (1 + small)}), "curve": (small, {"Cw": p["Cw"] * (1 + small)}),
    }  # fmt: skip
    for k, quadrature in ((0, 0), (0, 1), (1, 0), (1, 1)):
        i = int(np.flatnonzero(p["order"] == midway.settings["order"][k])[0])
        a, b = p["amplitude"][i] * np.cos(p["phase"][i]), p["amplitude"][i] * np.sin(p["phase"][i])
        a, b = (a + 1e-9, b) if quadrature == 0 else (a, b + 1e-9)
        amplitude, phase = p["amplitude"].copy(), p["phase"].copy()
        amplitude[i], phase[i] = np.hypot(a, b), np.arctan2(b, a)
        changes[len(NAMES) + 2 * k + quadrature] = 1e-9, {"amplitude": amplitude, "phase": phase}
    for name, (size, numbers) in changes.items():
        by_state = innovation(midway.moved(AT.get(name, name), size)) - before
        by_record = innovation(**numbers) - before
        assert by_state == pytest.approx(by_record, rel=0.03), name
        assert abs(by_record) > 1e-7
    stiffer = innovation(midway.moved(AT["stiffness"], small)) - before
    assert stiffer == pytest.approx(small * midway.memory["x"][AT["spring"]], rel=1e-6), (
        "less torque is seen than there is"
    )
    assert innovation(midway.moved(AT["spring"], 0.1)) - before == pytest.approx(-0.1, rel=1e-6)


@pytest.mark.parametrize("learn", [True, False])
@pytest.mark.parametrize("case", ["plain", "rich"])
def test_it_is_a_kalman_filter_that_may_consider(case, learn):
    """The textbook's update along the innovation's derivative; constants change only if learning is due (Schmidt),
    and weight, inertia and torque constant never."""
    midway = seeing(case)
    rng = np.random.default_rng(9)
    L = rng.standard_normal((SIZE, SIZE)) * UNITS[:, None]
    L[AT["count"]] = 0.0
    for k in np.flatnonzero(midway.settings["order"] == 0.0):
        L[len(NAMES) + 2 * k :][:2] = 0.0
    calm = {"calm": 1e3, "slid": 1e3 * learn, "free": 1.0, "torsion_ratio": 1.0, "link_ratio": 1.0}
    midway.settings["coarse"] = np.inf
    assert [AT[n] for n in ("constant", "weight", "inertia")] == list(np.flatnonzero(midway.settings["learned"] == 0.0))
    x, P, o, _ = midway.after(P=L @ L.T, **calm)
    H = -np.array([
        (midway.after(midway.moved(j, UNITS[j]))[2]["innovation"] - midway.after(midway.moved(j, -UNITS[j]))[2]["innovation"])
        / (2.0 * UNITS[j])
        for j in range(SIZE)
    ])  # fmt: skip
    fresh = np.zeros((SIZE, SIZE))
    fresh[AT["count"], AT["count"]] = midway.settings["prior"][AT["count"]] ** 2
    H[AT["count"]] = H[AT["zero"]]
    before = L @ L.T + fresh
    S = o["innovation_variance"]
    assert S == pytest.approx(H @ before @ H + S0(midway), rel=1e-3)
    gain = before @ H / S
    changed = (np.arange(SIZE) < FIXED) | (midway.settings["learned"] != 0.0 if learn else False)
    expected = np.where(changed, gain * o["innovation"], 0.0)
    moved = x - np.where(np.arange(SIZE) == AT["count"], 0.0, midway.memory["x"])
    assert np.allclose(moved / UNITS, expected / UNITS, rtol=5e-3, atol=5e-3 * np.abs(expected / UNITS).max())
    less = np.outer(gain, gain) * S * ~np.outer(~changed, ~changed)
    apart = (P - (before - less)) / np.sqrt(np.outer(np.diag(before), np.diag(before)) + 1e-300)
    assert np.abs(apart).max() < 0.02
    assert np.abs(less / np.sqrt(np.outer(np.diag(before), np.diag(before)) + 1e-300)).max() > 0.1


def test_constants_are_learned_after_a_tenth_of_a_second_of_sliding():
    """From the sample that completes it, for any rounding of the sum of intervals."""
    midway = seeing("plain")
    midway.sample["interval"], midway.settings["sliding"] = 1e-3, 0.0
    midway.settings["settled"], midway.settings["coarse"] = 0.1, np.inf
    P = np.diag(UNITS**2)
    calm = {"calm": 1e3, "free": 1.0, "torsion_ratio": 1.0, "link_ratio": 1.0}
    before = midway.memory["x"][FIXED:]
    for slid, learned in ((0.0981, False), (0.0989, True), (0.0991, True), (5.0, True)):
        after = midway.after(P=P, slid=slid, **calm)[0][FIXED:]
        assert np.any(after != before) == learned, slid


def test_calm_needs_small_innovations_and_no_contact():
    """Any contradiction ends calm and the sliding time. Learning is due after half a second, then repeatedly."""
    midway = seeing("plain")
    midway.sample["interval"], h = 1e-3, 1e-3
    c, still = midway.settings, 0.9 * midway.settings["sliding"]
    loud = float(c["high"])
    quiet = {"torsion_ratio": 1.0, "link_ratio": 1.0, "free": 1.0, "calm": 0.1, "slid": 0.05}
    for speed in (0.9, 1.1, -0.9, -1.1):
        turning = midway.memory["x"].copy()
        turning[AT["wave_rate"]] = speed * c["sliding"]
        m = midway.after(turning, **quiet)[3]
        assert m["calm"] == pytest.approx(0.1 + h)
        assert m["slid"] == pytest.approx(0.05 + h if abs(speed) > 1.0 else 0.0)
        for name, value in (("torsion_ratio", 1.01 * loud), ("link_ratio", 1.01 * loud), ("free", 0.0)):
            m = midway.after(turning, **quiet | {name: value})[3]
            assert m["calm"] == m["slid"] == 0.0, name
        m = midway.after(turning, **quiet | {"torsion_ratio": 0.99 * loud, "link_ratio": 0.99 * loud})[3]
        assert m["calm"] == pytest.approx(0.1 + h)
    for calm, due in ((0.498, False), (0.4984, False), (0.4989, True), (0.52, True)):
        m = midway.after(**quiet | {"calm": calm})[3]
        assert m["calm"] == pytest.approx(calm + h - c["every"] * due)
    assert still > 0.0


@pytest.mark.parametrize("by", ["motion", "rest"])
def test_at_rest_constants_are_learned_from_large_torsion_innovations_only(by):
    """In motion from any innovation; at rest from torsion's only, if its deviation is above a hundredth of T2."""
    midway = seeing("plain")
    midway.sample["interval"] = 1e-3
    c, before = midway.settings, midway.memory["x"][FIXED:].copy()
    ready = {"torsion_ratio": 1.0, "link_ratio": 1.0, "free": 1.0, "calm": 5.0, "slid": 5.0}
    x = midway.memory["x"].copy()
    if by == "rest":
        x[AT["wave_rate"]] = 0.5 * c["sliding"]
    else:
        x[AT["wave_rate"]] = 2.0 * c["sliding"]
    assert c["coarse"] == pytest.approx((0.01 * midway.joint.p["T2"]) ** 2)
    L = UNITS * np.random.default_rng(11).uniform(0.5, 1.5, SIZE) * np.random.default_rng(12).choice([-1.0, 1.0], SIZE)
    midway.settings["torsion_variance"], midway.settings["link_variance"] = 1e-30, 1e30  # the link's own say nothing
    P = np.outer(L, L)
    none, some = (float(midway.after(x, share * P, **ready)[2]["innovation_variance"]) for share in (0.0, 1.0))
    for share, learned in ((0.8, by == "motion"), (1.25, True)):
        scale = (share * c["coarse"] - none) / (some - none)
        after = midway.after(x, scale * P, **ready)
        assert after[2]["innovation_variance"] == pytest.approx(share * c["coarse"], rel=1e-6)
        assert np.any(after[0][FIXED:] != before) == learned, share


def S0(midway: Midway) -> float:
    """Variance of torsion's torque [(N·m)²] that its readings alone leave: S with exact knowledge."""
    midway.settings["prior"][AT["count"]], kept = 0.0, midway.settings["prior"][AT["count"]]
    found = midway.after()[2]["innovation_variance"]
    midway.settings["prior"][AT["count"]] = kept
    return float(found)


def test_noise_grows_with_time_and_contradiction():
    """White noise is proportional to the interval, constant torque to its square, a forgetting state settles."""
    midway = disturbed(Midway.of("plain"))
    c, p = midway.settings, midway.joint.p

    def noise(interval: float, **memory: float) -> np.ndarray:
        midway.sample["interval"] = interval
        return np.diag(midway.after(**{"torsion_ratio": 1.0, "link_ratio": 1.0, "ripple": 0.0} | memory)[1])

    one, two = noise(5e-4), noise(1e-3)
    doubled = {"wave_rate": 2.0, "spring": 2.0, "external": 2.0, "rotor": 4.0, "mesh": 2.0, "zero": 2.0}
    for name, factor in doubled.items():
        assert two[AT[name]] == pytest.approx(factor * one[AT[name]], rel=2e-3), name
    current = p["Kt"] ** 2 * midway.joint.noise.current_variance(1e-3)
    assert two[AT["rotor"]] == pytest.approx(current * (1e-3 / p["Jm"]) ** 2), (
        "a current that is off moves the rotor for as long"
    )
    c["level_time"], kept = 0.01, float(c["level_time"])
    assert noise(0.1)[AT["mesh"]] == pytest.approx(c["level"] ** 2), "in the end friction is off by its level"
    c["level_time"] = kept
    assert noise(1e-3)[AT["count"]] == pytest.approx(midway.joint.noise.motor_resolution**2 / p["N"] ** 2 / 12.0)
    middle = 0.5 * (c["low"] + c["high"])
    for ratio, share in ((c["low"], 0.0), (middle, 0.5), (c["high"], 1.0), (9.0 * c["high"], 1.0)):
        by_link, by_torsion = noise(1e-3, link_ratio=ratio), noise(1e-3, torsion_ratio=ratio)
        for found in (by_link, by_torsion):
            assert found[AT["external"]] - two[AT["external"]] == pytest.approx(share * 1e-3 * c["external_loud"] ** 2)
        assert by_torsion[AT["mesh"]] - two[AT["mesh"]] == pytest.approx(share * 1e-3 * c["level_loud"] ** 2)
        assert by_torsion[AT["spring"]] - two[AT["spring"]] == pytest.approx(share * 1e-3 * c["loose"])
        assert by_link[AT["mesh"]] == two[AT["mesh"]] and by_link[AT["spring"]] == two[AT["spring"]]
    # Between readings that are 5 ms apart the drive gave other currents for 4 of them.
    long = noise(5e-3, ripple=1e-6)[AT["rotor"]] - noise(5e-3)[AT["rotor"]]
    assert (
        long == pytest.approx(1e-6 * np.exp(-5e-3 / 0.1) * (4e-3 / p["Jm"]) ** 2)
        and noise(1e-3, ripple=1e-6)[AT["rotor"]] == two[AT["rotor"]]
    )
    # What readings do not show between them moves the spring as its square; after half a second as far as a walk does.
    for h in (5e-3, 0.02):
        unseen = noise(h)[AT["spring"]] - h / 1e-3 * two[AT["spring"]]
        assert unseen == pytest.approx(0.5 * c["loose"] * ((h - 1e-3) / 0.5) ** 2)


def test_a_repeated_count_has_a_growing_variance():
    """The n-th repeat has n times a count's variance, for the link encoder and torsion; a new count of either resets
    it."""
    midway = disturbed(Midway.of("plain"))
    midway.settings["link_variance"], midway.settings["torsion_variance"] = 1e-11, 2e-11
    midway.settings["prior"][AT["count"]] = 0.0
    c, s = midway.settings, midway.sample
    half, count = midway.joint.noise.link_resolution / 2, midway.joint.noise.link_resolution**2 / 6.0
    motor_half = midway.joint.noise.motor_resolution / 2
    for held, link, motor, expected in (
        (0.0, 0.0, 0.0, 1.0), (6.0, 0.0, 0.0, 7.0), (6.0, 0.9 * half, -0.9 * motor_half, 7.0), (6.0, 1.1 * half, 0.0, 0.0),
        (6.0, -1.1 * half, 0.0, 0.0), (6.0, 0.0, 1.1 * motor_half, 0.0), (6.0, 0.0, -1.1 * motor_half, 0.0),
    ):  # fmt: skip
        before = {
            "link_reading": s["link_position"] + link,
            "motor_reading": s["motor_position"] + motor,
            "jitter": 0.0,
            "belief": 1.0,
        }
        _, _, o, m = midway.after(**before, held=held, link_ratio=1.0, torsion_ratio=1.0)
        assert m["held"] == expected
        none = midway.after(
            **before | {"link_reading": s["link_position"] + 9.0}, held=0.0, link_ratio=1.0, torsion_ratio=1.0
        )
        share = (none[3]["link_ratio"] - c["memory"]) / (
            m["link_ratio"] - c["memory"]
        )  # of the variances: one innovation
        assert share == pytest.approx((c["link_variance"] + expected * count) / c["link_variance"], rel=0.02)
        assert o["innovation_variance"] / none[2]["innovation_variance"] == pytest.approx(
            (c["torsion_variance"] + expected * count) / c["torsion_variance"], rel=0.02
        )
    assert count > 0.02 * c["torsion_variance"]


def test_external_torque_decays_without_contact():
    """Without contact for a while, an external torque within its uncertainty decays, over a time `back`."""
    midway = disturbed(Midway.of("plain"), external=0.02)
    midway.settings["wait"] = 0.2
    c, h, i = midway.settings, 1e-3, AT["external"]
    P = np.zeros((SIZE, SIZE))
    P[i, i] = 0.02**2
    for untouched, free in ((0.1985, False), (0.1991, False), (0.1996, True), (5.0, True)):
        x, after, o, m = midway.after(P=P, untouched=untouched, link_ratio=1.0)
        assert m["free"] == free and m["untouched"] == pytest.approx(untouched + h)
        before = P[i, i] + h * c["external_quiet"] ** 2
        variance = c["free"] ** 2 * c["back"] / h
        expected = before * variance / (before + variance) if free else before
        assert after[i, i] == pytest.approx(expected, rel=1e-6)
        assert x[i] == pytest.approx(0.02 * expected / before, rel=1e-4) and o["external_torque"] == x[i]
    for name, end in (("link_ratio", "low"), ("torsion_ratio", "high")):
        contradicted = midway.after(P=P, untouched=5.0, **{"link_ratio": 1.0, name: 2.0 * c[end]})[3]
        assert contradicted["untouched"] == 0.0, name
    # A push is none of that, and what lies between counts for less, and for doubt.
    P[i, i] = 0.07**2
    before = P[i, i] + h * c["external_quiet"] ** 2
    for external, free in ((2.0 * c["least"], False), (0.9 * c["least"], True)):
        x, after, o, m = midway.after(midway.moved(i, external - 0.02), P=P, untouched=5.0, link_ratio=1.0)
        assert m["free"] == free and (x[i] < external) == free
        if free:
            assert external > c["gate"] * np.hypot(0.07, c["free"])
            variance = (c["free"] ** 2 + external**2) * c["back"] / h
            assert x[i] == pytest.approx(external * variance / (before + variance), rel=1e-4)
            assert o["variance"] == pytest.approx(x[i] ** 2, rel=1e-2)
            assert after[i, i] == pytest.approx(before * variance / (before + variance), rel=1e-4)


def test_the_torque_is_the_joints():
    """Ts = T + df·(r·ωw − ωl) − bl·ωl with the variance by P, larger while innovations contradict."""
    midway = disturbed(Midway.of("plain"))
    rng = np.random.default_rng(10)
    L = rng.standard_normal((SIZE, SIZE)) * UNITS[:, None]
    x, P, o, _ = midway.after(P=L @ L.T, torsion_ratio=1.0, link_ratio=1.0)
    p = midway.joint.p
    s = midway.sample
    _, theta = dynamics.measured_torsion(s["motor_position"], 0.0, p["Kt"] * s["motor_current"], p)
    ratio = 1.0 / p["N"] - laws.kinematic_error_slope(theta, p)
    by = {"spring": 1.0, "wave_rate": p["df"] * ratio, "link_rate": -p["df"] - p["bl"]}
    H = np.zeros(SIZE)
    for name, value in by.items():
        H[AT[name]] = value
    assert o["torque"] == pytest.approx(H @ x, rel=1e-9) and o["variance"] == pytest.approx(H @ P @ H, rel=1e-6)
    doubted = midway.after(P=L @ L.T, torsion_ratio=1.0, link_ratio=7.0)
    H_P = H @ doubted[1] @ H
    assert doubted[2]["variance"] == pytest.approx(doubted[3]["link_ratio"] * H_P, rel=1e-6)
    assert doubted[3]["link_ratio"] > 5.0


def test_constants_are_learned_in_calm_motion_at_intervals():
    """After half a second of calm and a tenth of sliding, then every 50 ms; after a push again."""
    known = seen("plain")[1]
    calm, pushed = (signals_of(PLAIN, SEED, push)[0].part(slice(0, 6000)) for push in (False, True))
    sliding = np.abs(np.gradient(calm["motor_position"], calm.time)) > 2.5 * known.p["vs"]
    learned = {}
    for name, signals in (("calm", calm), ("pushed", pushed)):
        errors = registry.get("augmented").estimate(signals, known).columns["stiffness_error"]
        learned[name] = np.flatnonzero(np.diff(errors) != 0.0) + 1
    print(
        {
            name: (len(found), found[:5], np.unique(np.diff(found), return_counts=True))
            for name, found in learned.items()
        }
    )
    assert learned["calm"][0] >= 500
    in_motion = learned["calm"][sliding[learned["calm"]]]
    assert len(in_motion) > 50 and np.median(np.diff(in_motion)) == 50
    assert np.diff(learned["calm"]).min() == np.diff(learned["pushed"]).min() == 50
    assert len(learned["pushed"]) < 0.7 * len(learned["calm"])


@pytest.mark.parametrize("current", [0.0, 0.3, -0.3])
def test_it_starts_in_equilibrium_with_an_unknown_velocity(current):
    """At the first readings: torques by torsion and current, friction takes the difference up to its level; a
    velocity of up to 1 rad/s of the whole joint."""
    _, known = seen("plain")
    p, step = known.p, registry.get("augmented").step(known, 1e-3)
    columns = {
        n: np.full(2, v) for n, v in (("motor_position", 30.0), ("link_position", 0.3001), ("motor_current", current))
    }
    signals = Signals(1e-3 * np.arange(2), columns)
    arrays = step.arrays()
    arrays[3].view(SETTINGS)[0]["torsion_variance"] = 1e30
    assert go_on(arrays, as_samples(signals, (), known)[:1], np.zeros((1, step.outputs))) == (1, 0)
    m, prior = arrays[1].view(MEMORY)[0], arrays[3].view(SETTINGS)[0]["prior"]
    x, P = m["x"], m["P"]
    torsion, _ = dynamics.measured_torsion(30.0, 0.3001 - p["link_zero"], p["Kt"] * current, p)
    torque = laws.flexspline_spring(torsion, p)
    assert x[AT["link"]] == pytest.approx(0.3001 - p["link_zero"]) and x[AT["spring"]] == pytest.approx(torque)
    assert x[AT["wound"]] == pytest.approx(p["Kt"] * current)
    friction = np.clip(p["Kt"] * current - torque / p["N"], -p["Fs"], p["Fs"])
    assert p["s0"] * x[AT["bristle"]] == pytest.approx(friction)
    velocities = [AT["link_rate"], AT["rotor"], AT["wave_rate"]]
    together = np.r_[1.0, p["N"], p["N"]]
    expected = np.diag(prior**2)
    expected[np.ix_(velocities, velocities)] += np.outer(together, together)
    np.testing.assert_allclose(P, expected, rtol=1e-9, atol=1e-30)
    assert (m["torsion_ratio"], m["link_ratio"], m["belief"]) == (pytest.approx(0.8, abs=0.01), 1.0, 1.0)


def test_prior_of_the_flexible_part():
    """Its angle as under a tenth of the joint's torque, its velocity with as much energy, in both filters."""
    _, known = seen("rich")
    p = known.p
    prior = registry.get("augmented").settings(known, 1e-3)[0]["prior"]
    dynamic = registry.get("dynamics_ekf").process.record(known, 1e-3)[0]["start"]
    pairs = [
        (prior[AT["swing"]], prior[AT["swing_rate"]]),
        (np.sqrt(dynamic[joint_model.FLEXIBLE]), np.sqrt(dynamic[joint_model.FLEXIBLE_RATE])),
    ]
    for angle, rate in pairs:
        bending = laws.flexible_torque(angle, 0.0, p)
        assert bending == pytest.approx(0.1 * p["T2"])
        assert 0.5 * p["flexible_share"] * p["Jl"] * rate**2 == pytest.approx(0.5 * bending * angle)


def test_the_grid_of_samples_follows_the_stamps():
    """A stamp's error moves the grid by a fiftieth, the period by its share so far; missing samples move neither."""
    midway = disturbed(Midway.of("plain"))
    off = 4e-5
    for interval, steps in ((1e-3, 1), (1e-3 + off, 1), (1e-3 - off, 1), (3e-3, 3), (3e-3 + off, 3)):
        midway.sample["interval"] = interval
        m = midway.after(period=1e-3, beats=200.0, phase=0.0)[3]
        late = interval - steps * 1e-3
        assert m["phase"] == pytest.approx(0.98 * late, abs=1e-15) and m["beats"] == 201.0
        assert m["period"] == pytest.approx(1e-3 + late / (201.0 * steps), rel=1e-12)
    midway.sample["interval"] = 1e-3
    settled = midway.after(period=1e-3, beats=1e4, phase=5e-5)[3]
    assert settled["beats"] == 1e4 and settled["phase"] == pytest.approx(0.98 * 5e-5)
    late = midway.after(period=1e-3, beats=200.0, phase=6e-4)[3]
    assert late["phase"] == pytest.approx(-0.98 * 4e-4), "by more than half a period it is the next sample's"


def test_the_interval_follows_the_trust_in_stamps():
    """The interval is between stamp and grid; the trust is a regression on the link's motion."""
    midway = disturbed(Midway.of("plain"))
    off, quarter = 8e-5, 0.25
    midway.sample["interval"] = 1e-3 + off
    partly = midway.after(period=1e-3, beats=200.0, phase=0.0, belief=quarter)[0]
    midway.sample["interval"] = 1e-3 + quarter * off
    wholly = midway.after(period=1e-3, beats=200.0, phase=0.0, belief=1.0)[0]
    np.testing.assert_allclose(partly, wholly, rtol=1e-9, atol=1e-15)
    midway.sample["interval"] = 1e-3 + off
    V = midway.settings["link_variance"] = 2e-11
    P = 1e-20 * np.eye(SIZE)
    x, beliefs = midway.moved(AT["link_rate"], 0.3), {}
    for wrong in (0.0, 0.2, -0.1, 40.0, -40.0):
        midway.sample["link_position"] = 0.0
        start = {"period": 1e-3, "beats": 200.0, "phase": 0.0, "belief": 0.5, "evidence": 30.0}
        x_after = midway.blind().after(x, P, **start)[0]
        moved = off * x_after[AT["link_rate"]]
        midway.settings["link_variance"] = V
        midway.sample["link_position"] = x_after[AT["link"]] + wrong * moved + midway.joint.p["link_zero"]
        after = midway.after(x, P, **start)[3]
        evidence = 30.0 + moved**2 / V
        assert after["evidence"] == pytest.approx(evidence, rel=0.03)
        beliefs[wrong] = float(after["belief"])
    assert 30.0 < moved**2 / V < 1e5
    share = moved**2 / V / (30.0 + moved**2 / V)
    assert abs(beliefs[0.0] - 0.5) < 0.1, "what it moved otherwise"
    for wrong in (0.2, -0.1):
        assert beliefs[wrong] - beliefs[0.0] == pytest.approx(wrong * share, rel=0.05)
    assert beliefs[40.0] == 1.0 and beliefs[-40.0] == 0.0
    # One innovation counts as a belief of −1 to 2 at most: a contact is not a clock error.
    evidence_before = 100.0 * moved**2 / V
    changes = {}
    for wrong in (0.0, 40.0, -40.0):
        midway.sample["link_position"] = x_after[AT["link"]] + wrong * moved + midway.joint.p["link_zero"]
        given = {"period": 1e-3, "beats": 200.0, "phase": 0.0, "belief": 0.5, "evidence": evidence_before}
        changes[wrong] = float(midway.after(x, P, **given)[3]["belief"])
    weight = moved**2 / V / (evidence_before + moved**2 / V)
    assert changes[40.0] == pytest.approx(0.5 + 1.5 * weight, rel=1e-3)
    assert changes[-40.0] == pytest.approx(0.5 - 1.5 * weight, rel=1e-3)
    assert changes[-40.0] < changes[0.0] < changes[40.0]


def test_time_errors_of_samples_are_learned():
    """Even stamps, readings 0.2 ms off: the error is found to a third, and no jitter without one."""
    signals, known = signals_of(PLAIN, SEED, False)[0].part(slice(0, 4000)), seen("plain")[1]
    step = registry.get("augmented").step(known, 1e-3)
    off = np.clip(2e-4 * np.random.default_rng(4).standard_normal(len(signals.time)), -5e-4, 5e-4)
    names = ("motor_position", "link_position", "motor_current")
    late = {name: np.interp(signals.time + off, signals.time, signals[name]) for name in names}
    found = {}
    for name, some in (("even", signals), ("late", Signals(signals.time, late))):
        arrays = step.arrays()
        go_on(arrays, as_samples(some, (), known), np.zeros((len(some.time), step.outputs)))
        found[name] = arrays[1].view(MEMORY)[0]["jitter"] ** 0.5
    print(f"seed 4: {1e3 * found['late']:.3f} ms, of even samples {1e3 * found['even']:.3f} ms")
    assert found["late"] == pytest.approx(2e-4, rel=0.35) and found["even"] < 5e-5


def test_a_stiff_bristle_damping_is_stable():
    """A bristle of three times the damping that reverses at rest: errors of the state do not grow."""
    midway = Midway.of("plain", s1=0.03).blind()
    x = midway.memory["x"].copy()
    x[AT["wave_rate"]], x[AT["bristle"]] = -1e-3, float(midway.joint.p["Fc"] / midway.joint.p["s0"])
    P = np.zeros((SIZE, SIZE))
    P[AT["wave_rate"], AT["wave_rate"]], midway.settings["mesh_walk"] = 1.0, 0.0
    assert midway.after(x, P)[1][AT["wave_rate"], AT["wave_rate"]] < 1.0


def test_a_contact_within_the_constants_priors_resets_them():
    """An external torque of two seconds resets the constants; one beyond their priors stays."""
    midway = disturbed(Midway.of("plain"), external=0.1)
    c, i = midway.settings, AT["external"]
    c["wait"], c["least"] = 0.2, 1e-3
    x = midway.memory["x"].copy()
    for size, stays in ((0.1, False), (30.0, True)):
        x[i], x[AT["stiffness"]] = size, 0.01
        P = np.diag(np.r_[np.full(FIXED, 1e-12), np.full(SIZE - FIXED, 1e-10)])
        found, after, _, m = midway.after(x, P, untouched=5.0, touched=2.0, link_ratio=1.0)
        assert m["touched"] == m["free"] == 0.0
        assert (found[i] == 0.0 and found[AT["stiffness"]] == 0.0) != stays
        assert (after[AT["stiffness"], AT["stiffness"]] == c["prior"][AT["stiffness"]] ** 2) != stays
