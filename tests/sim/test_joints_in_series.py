"""Joints in series against equations written down here, against a joint alone, and against their own energy."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from driving import JOINT, record_of, relative
from energy import flexspline_energy, wave_generator_energy
from looping import motion, simulate, simulate_together

from flexspline.models import dynamics, laws
from flexspline.models.arm import ArmSpec
from flexspline.models.arm_dynamics import Arm
from flexspline.models.controller import Controller
from flexspline.models.joint_parts import EncoderSpec, Mounting
from flexspline.sim import arm, plant, plugin
from flexspline.sim.arm import ArmJoint
from flexspline.sim.loop import CONTROL_PERIOD, ClosedLoop, Driven
from flexspline.sim.sensors import noise, sensor_records

FINE = JOINT.model_copy(update={"sensors": JOINT.sensors.model_copy(update={"motor_encoder": EncoderSpec(bits=38)})})
"""Its motor encoder has no counts, of which rounding may take one for the other."""
G = 9.80665
LENGTH = 0.35


def two(shoulder=None, elbow=None, **changes):
    """The test joint twice: a link of 0.35 kg·m² and 9 N·m, and a lighter one on it; records with changes."""
    first = record_of() if shoulder is None else shoulder
    second = record_of(Jl=0.12, Mg=4.0) if elbow is None else elbow
    for record in (first, second):
        for name, value in changes.items():
            record[0][name] = value
    return [ArmJoint("shoulder", JOINT, first, LENGTH), ArmJoint("elbow", JOINT, second, 0.3)]


def masses(record):
    """Mass [kg], distance of its centre from the axis [m] and inertia about the axis [kg·m²] of a link: the stated rule."""
    p = record[0]
    lever = min(0.25, 0.6 * p["Jl"] / (p["Mg"] / G))
    return p["Mg"] / G / lever, lever, p["Jl"]


def double_pendulum(joints, q, v):
    """Mass matrix, and torque of velocities and weight, of two rods on parallel axes: the textbook's formula."""
    (m1, a1, J1), (m2, a2, J2) = (masses(one.record) for one in joints)
    l1, c, s = joints[0].length, np.cos(q[1]), np.sin(q[1])
    off = J2 + m2 * l1 * a2 * c
    M = np.array([[J1 + J2 + m2 * (l1**2 + 2 * l1 * a2 * c), off], [off, J2]])
    h = m2 * l1 * a2 * s
    weight2 = G * m2 * a2 * np.sin(q[0] + q[1])
    bias = np.array(
        [-h * (2 * v[0] * v[1] + v[1] ** 2) + G * (m1 * a1 + m2 * l1) * np.sin(q[0]) + weight2, h * v[0] ** 2 + weight2]
    )
    return M, bias


def rate(x):
    """Its rate of change, exact for polynomials of fourth degree."""
    found = np.gradient(x, CONTROL_PERIOD)
    found[2:-2] = (x[:-4] - 8 * x[1:-3] + 8 * x[3:-1] - x[4:]) / (12 * CONTROL_PERIOD)
    return found


def driven(one, position, velocity, external=None, seed=3, joint=FINE):
    n = len(position)
    return Driven(
        one.record, position, velocity, np.zeros(n) if external is None else external,
        sensor_records(joint, float(one.record[0]["link_delay"]), CONTROL_PERIOD), noise(joint, seed, n, CONTROL_PERIOD),
        Controller().record(one.record[0], CONTROL_PERIOD, False), prefix=one.prefix,
    )  # fmt: skip


def swings(seconds=2.0):
    """Commands of shoulder and elbow: there and back, the elbow twice as often and farther, as (position, velocity)."""
    time = np.arange(round(seconds / CONTROL_PERIOD)) * CONTROL_PERIOD
    pulsation = 2 * np.pi / seconds
    a, b = 0.2 * (1 - np.cos(pulsation * time)), -0.4 * (1 - np.cos(2 * pulsation * time))
    return (a, 0.2 * pulsation * np.sin(pulsation * time)), (b, -0.8 * pulsation * np.sin(2 * pulsation * time))


def run(joints, model=None, **of):
    model = arm.build(joints) if model is None else model
    return simulate_together(model, [driven(one, *swing, **of) for one, swing in zip(joints, swings(), strict=True)])


def test_accelerations_in_any_state(rng):
    """All six, from a mass matrix and torques put together here: rotors and wave generators turn with their carrier."""
    joints = two()
    model = arm.build(joints, timestep=1e-6, ideal_current=True)  # the scheme's corrections vanish with the step
    data = mujoco.MjData(model)
    for _ in range(3):
        angles = rng.uniform(-2, 2, 2)
        data.qpos[:] = np.outer(angles, [100, 100, 1]).ravel() + rng.normal(0, np.tile([0.02, 0, 2e-4], 2))
        data.qvel[:] = rng.normal(0, 1, 6) * [50, 50, 1, 50, 50, 1]
        data.act[:], data.ctrl[:] = 0.0, 0.0
        force = np.zeros(6)
        M = np.zeros((6, 6))
        for k, one in enumerate(joints):
            p, at = one.record[0], slice(3 * k, 3 * k + 3)
            plant.memory(model, data, one.prefix)[plugin.MEMORY : plugin.MEMORY + 3] = data.qvel[at]
            theta, velocity = data.qpos[at].copy(), data.qvel[at].copy()
            state, t, g = plugin.at_positions(theta, velocity, velocity, 0.0, 0.0, 0.0, 1e-6, 25.0, p)
            b = dynamics.balance_with(state, t, g, p)
            force[at] = b.on_rotor, b.on_wave_generator, b.on_link - b.gravity
            for inertia, own in ((p["Jm"], 0), (p["Jw"], 1)):  # ½ J (own rate + the carrier's rate)²
                turns = np.zeros(6)
                turns[3 * k + own] = 1.0
                turns[2 : 3 * k : 3] = 1.0
                M += inertia * np.outer(turns, turns)
        links = [2, 5]
        mass, bias = double_pendulum(joints, data.qpos[links], data.qvel[links])
        M[np.ix_(links, links)] += mass
        force[links] -= bias
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(M @ data.qacc, force, atol=2e-6 * np.abs(force).max())


def test_the_load_is_that_of_the_others_motion():
    """In the closed loop the joint torques are the textbook's double pendulum's for the motion that comes about.

    Without the kinematic error, whose ripple at 160 Hz a difference over milliseconds does not resolve.
    """
    joints = two(amplitude=0.0)
    runs = run(joints)
    q = np.stack([s.truth["link_position"] for s in runs])
    v = np.stack([s.truth["link_velocity"] for s in runs])
    a = np.stack([rate(x) for x in v])
    inside = slice(50, -50)
    expected = np.empty_like(q)
    for k in range(q.shape[1]):
        M, bias = double_pendulum(joints, q[:, k], v[:, k])
        expected[:, k] = M @ a[:, k] + bias
    elbow = joints[1].record[0]
    rotors = sum(
        elbow[J] * (rate(runs[1].truth[f"{name}_velocity"]) + a[0])
        for J, name in (("Jm", "motor"), ("Jw", "wave_generator"))
    )
    expected[0] += rotors
    alone = masses(joints[0].record)
    without = alone[2] * a[0] + joints[0].record[0]["Mg"] * np.sin(q[0])
    for k, s in enumerate(runs):
        error = relative(s.truth["joint_torque"][inside], expected[k][inside])
        read = np.std(-s.readings["torque_y"][inside] - expected[k][inside])
        print(f"{joints[k].name}: joint torque {error:.1e}, wrench {read:.1e} N·m")
        assert error < 2e-3 and read < 0.032  # the wrench's noise is 0.03 N·m
    assert relative(without[inside], expected[0][inside]) > 0.5


def turned_pendulum(joints, q, v):
    """The same of two rods of which the second's axis is turned about the first: from velocities of their masses."""
    (m1, a1, J1), (m2, a2, J2) = (masses(one.record) for one in joints)
    turn, mass, lever = joints[1].turn, np.array([m1, m2]), (a1, a2)
    about_mass = np.array([J1, J2]) - mass * np.array([a1, a2]) ** 2

    def jacobians(q):
        R, origin, axes, origins, found = np.eye(3), np.zeros(3), [], [], []
        for k, angle in enumerate(q):
            if k:
                R = R @ np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
            axes.append(-R[:, 1])
            origins.append(origin)
            c, s = np.cos(angle), np.sin(angle)
            R = R @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
            at = origin - lever[k] * R[:, 2]
            linear, angular = np.zeros((3, 2)), np.zeros((3, 2))
            for j in range(k + 1):
                linear[:, j], angular[:, j] = np.cross(axes[j], at - origins[j]), axes[j]
            found.append((linear, angular))
            origin = origin - joints[0].length * R[:, 2]
        return found

    def matrix(q):
        return sum(
            m * lin.T @ lin + J * ang.T @ ang for m, J, (lin, ang) in zip(mass, about_mass, jacobians(q), strict=True)
        )

    h = 1e-5
    slope = np.stack([(matrix(q + d) - matrix(q - d)) / (2 * h) for d in h * np.eye(2)])  # ∂M/∂q_k, k first
    bias = np.einsum("kij,j,k->i", slope, v, v) - 0.5 * np.einsum("ijk,j,k->i", slope, v, v)
    bias += sum(G * m * lin[2] for m, (lin, _) in zip(mass, jacobians(q), strict=True))
    return matrix(q), bias


@pytest.mark.fast_every(3)
@pytest.mark.parametrize("turn", [0.0, 1.1, -0.5 * np.pi])
def test_axes_that_are_not_parallel(turn):
    """In the closed loop the joint torques are those of two rods whose axes are at an angle; parallel ones are the textbook's."""
    shoulder, elbow = two(amplitude=0.0)
    joints = [shoulder, dataclasses.replace(elbow, turn=turn)]
    if turn == 0.0:
        state = np.array([0.7, -1.1]), np.array([0.4, 0.9])
        for ours, theirs in zip(turned_pendulum(joints, *state), double_pendulum(joints, *state), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-8)
    runs = run(joints)
    q = np.stack([s.truth["link_position"] for s in runs])
    v = np.stack([s.truth["link_velocity"] for s in runs])
    a = np.stack([rate(x) for x in v])
    expected = np.stack(
        [M @ a[:, k] + b for k, (M, b) in enumerate(map(turned_pendulum, [joints] * q.shape[1], q.T, v.T))], 1
    )
    for J, name in (("Jm", "motor"), ("Jw", "wave_generator")):  # they spin about the turned axis, and are carried
        expected[0] += elbow.record[0][J] * (np.cos(turn) * rate(runs[1].truth[f"{name}_velocity"]) + a[0])
    inside = slice(50, -50)
    for k, s in enumerate(runs):
        error = relative(s.truth["joint_torque"][inside], expected[k][inside])
        print(f"{joints[k].name}, turned by {turn:.2f}: {error:.1e}")
        assert error < 2e-3


def locked(model, prefix, inertia=1e9):
    for name in ("rotor", "wave_generator", "link"):
        model.dof_armature[model.joint(prefix + name).dofadr[0]] = inertia
    return model


def alone(one, mounting, swing):
    model = plant.build(JOINT, mounting, record=one.record)
    d = driven(one, *swing)
    return simulate(
        model, d.record, d.command, d.rate, d.external_torque, d.sensors, d.noise, d.controller
    )  # fmt: skip


def test_with_the_elbow_locked_the_shoulder_is_a_joint_alone():
    """Inertia and weight then are those of the arm in that pose, with the elbow's rotor and wave generator as a part of it."""
    joints = two()
    p = joints[1].record[0]
    model = locked(arm.build(joints), "elbow_")
    (shoulder, _), stay = swings(), np.zeros(2000)
    ours = simulate_together(model, [driven(joints[0], *shoulder), driven(joints[1], stay, stay)])[0]
    mounting = Arm(ArmSpec(model="arm.xml", joint="shoulder"), arm.rigid(joints)).mounting()
    M, bias = double_pendulum(joints, np.array([0.5 * np.pi, 0.0]), np.zeros(2))
    assert mounting.inertia == pytest.approx(M[0, 0], rel=1e-12)
    assert mounting.gravity_moment == pytest.approx(bias[0], rel=1e-12)
    summed = record_of(Jl=M[0, 0] + p["Jm"] + p["Jw"], Mg=bias[0])
    theirs = alone(ArmJoint("", JOINT, summed, 0.0), None, shoulder)
    for name in ("motor_position", "link_position", "joint_torque", "motor_current"):
        error = relative(ours.truth[name], theirs.truth[name])
        print(f"{name}: {error:.1e}")
        assert error < 1e-6, name


_FLEXIBLE = {"flexible_share": 0.2, "flexible_damping": 0.05}
_HYSTERESIS = {"hysteresis_torque": 1.0, "hysteresis_extent": 8e-5}
EFFECTS: dict[str, tuple[dict, dict]] = {
    "none": ({}, {}),
    "own states": (_FLEXIBLE, _HYSTERESIS | {"friction_load": 0.2}),
    "states of the other": (_HYSTERESIS | {"friction_asymmetry": 0.3}, _FLEXIBLE),
}


@pytest.mark.parametrize("effects", EFFECTS)
def test_with_the_shoulder_locked_the_elbow_is_a_joint_alone(effects):
    """Whatever further states either of them has: every joint finds its own."""
    of_shoulder, of_elbow = EFFECTS[effects]
    joints = two(record_of(**of_shoulder), record_of(Jl=0.12, Mg=4.0, **of_elbow))
    model = locked(arm.build(joints), "shoulder_")
    elbow, stay = swings()[1], np.zeros(2000)
    ours = simulate_together(model, [driven(joints[0], stay, stay), driven(joints[1], *elbow)])[1]
    theirs = alone(joints[1], Mounting(inertia=0.12, gravity_moment=4.0), elbow)
    for name in ("motor_position", "link_position", "joint_torque", "motor_current", "bristle"):
        assert relative(ours.truth[name], theirs.truth[name]) < 1e-6, name
    np.testing.assert_array_equal(ours.readings["temperature"], theirs.readings["temperature"])


def test_an_arm_of_one_is_a_joint():
    one = two()[0]
    position, velocity, external = motion()
    ours = simulate_together(arm.build([one]), [driven(one, position, velocity, external)])[0]
    theirs = driven(one, position, velocity, external)
    theirs = simulate(
        plant.build(JOINT, record=one.record), theirs.record, position, velocity, external, theirs.sensors, theirs.noise,
        theirs.controller,
    )  # fmt: skip
    for name in theirs.readings.dtype.names:
        np.testing.assert_allclose(ours.readings[name], theirs.readings[name], rtol=1e-7, atol=1e-7, err_msg=name)


def test_left_is_right():
    """Commands of the other sign give torques of the other sign, where the gears have no kinematic error."""
    joints = two(amplitude=0.0)
    model = arm.build(joints)
    there, back = (
        simulate_together(
            model, [driven(one, sign * p, sign * v) for one, (p, v) in zip(joints, swings(), strict=True)]
        )
        for sign in (1, -1)
    )
    for a, b in zip(there, back, strict=True):
        assert relative(-b.truth["joint_torque"], a.truth["joint_torque"]) < 1e-6


def test_energy_is_kept():
    """Links lifted and let go, friction, damping and motors off: nothing is lost or won while both swing through.

    At a quarter of the default step: undamped, the gears' kinematic error shakes springs at 2 kHz.
    """
    free = {"bm": 0.0, "bw": 0.0, "bl": 0.0, "df": 0.0, "dw": 0.0, "s1": 0.0, "s0": 1e-300}
    joints = two(record_of(**free), record_of(Jl=0.12, Mg=4.0, **free))
    model = arm.build(joints, timestep=5e-5, ideal_current=True)
    data = mujoco.MjData(model)
    plant.start(model, data, np.array([[50.03, 50.02, 0.5 - 2e-4], [-30.02, -30.01, -0.3 + 1e-4]]))
    (m1, a1, _), (m2, a2, _) = (masses(one.record) for one in joints)
    links, whole, kinetic = [2, 5], [], []
    for _ in range(2000):
        mujoco.mj_step(model, data, nstep=16)
        theta, before = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(model, data)
        v, q = 0.5 * (before + data.qvel), theta[links]
        moving = 0.5 * v[links] @ double_pendulum(joints, q, v[links])[0] @ v[links]
        held = G * ((m1 * a1 + m2 * LENGTH) * (1 - np.cos(q[0])) + m2 * a2 * (1 - np.cos(q[0] + q[1])))
        for j, one in enumerate(joints):
            p, (m, w, link), own = one.record[0], theta[3 * j : 3 * j + 3], v[3 * j : 3 * j + 3]
            carrier = v[2] if j else 0.0
            moving += 0.5 * p["Jm"] * (own[0] + carrier) ** 2 + 0.5 * p["Jw"] * (own[1] + carrier) ** 2
            held += flexspline_energy(float(w / p["N"] - link - laws.kinematic_error(w, p)), p)
            held += wave_generator_energy(float(m - w), p)
        whole.append(moving + held)
        kinetic.append(moving)
    means = np.reshape(whole, (10, -1)).mean(axis=1)
    print(f"{means[0]:.4f} J, drift {np.ptp(means) / means[0]:.1e}, in motion up to {max(kinetic):.3f} J")
    assert np.ptp(means) < 2e-4 * means[0]
    assert max(kinetic) > 0.5 * means[0]


def test_parts_of_a_run_are_equal_to_the_whole():
    joints = two()
    model, whole = arm.build(joints), run(joints)
    loop = ClosedLoop(model, [driven(one, *swing) for one, swing in zip(joints, swings(), strict=True)])
    for ticks in (1, 700, 2, 3000):
        loop.advance(ticks)
    assert loop.done == 2000
    for a, b in zip(loop.simulations, whole, strict=True):
        assert a.readings.tobytes() == b.readings.tobytes() and a.truth.tobytes() == b.truth.tobytes()
