"""The joint's equations of motion: the one combination of its laws.

    rotor           Jm θm'' = Kt i + cogging − bm θm' − Tw
    wave generator  Jw θw'' = Tw − Fmesh − Tf (1/N − θerr'(θw))
    link            Jl θl'' = Ts − Mg sin(θl + gravity angle) + link torques + τext        with Ts = Tf − bl θl'

A share s of Jl may be flexible, J_s (φ'' + θl'') = −k φ − d φ' (`laws.flexible_torque`). The rest of the inertia is
then (1 − s) Jl, with the additional torque k φ + d φ'. Its two states are not in a `State`: the plant has a separate
body for it.

(Shi & Liu's joint; symbols in `models.laws`, numbers in `models.parameters`.) A model discrepancy adds to the torque
at its place. The MuJoCo plant, the replay of measured motion, the filters based on the dynamics, the observers and
the planning of experiments all call these functions, with the joint's parameter record p; everything is compiled and
SI.

`balance` is the whole: a state in, torques out. Its parts are for partial knowledge: a replay knows the motion of
both ends and needs the transmission between them, an observer treats rotor and wave generator as one body.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from . import laws
from .kernels import kernel
from .parameters import PLACES

_ROTOR, _MESH, _FLEXSPLINE, _LINK, _JOINT_TORQUE, _LINK_POSITION, _MOTOR_CURRENT = (
    PLACES.index(name)
    for name in ("rotor", "mesh", "flexspline", "link", "joint_torque", "link_position", "motor_current")
)


UNREAD = math.nan  # value of a state on which a torque does not depend; a torque that reads it is NaN


class State(NamedTuple):
    """The state on which the joint's torques depend. Positions [rad] and velocities [rad/s] of rotor and wave
    generator on the motor side, of the link on the output side; bristle [rad, motor side] of the LuGre friction,
    Dahl state [rad] of the flexspline's hysteresis, motor current [A], time since the recording's start [s],
    temperature [°C]."""

    motor_position: float
    motor_velocity: float
    wave_generator_position: float
    wave_generator_velocity: float
    link_position: float
    link_velocity: float
    bristle: float
    dahl: float
    motor_current: float
    time: float
    temperature: float


class Transmission(NamedTuple):
    """The transmission between the bodies: wave generator torque Tw [N·m, motor side] and flexspline torque Tf [N·m],
    with damping; `load`, Tf without model discrepancy, on which friction and discrepancies depend [N·m]; torsion
    Δθf [rad], its rate Δθf' [rad/s]; transmission ratio 1/N − dθerr/dθw [1]."""

    wave_generator_torque: float
    flexspline_torque: float
    load: float
    torsion: float
    torsion_rate: float
    ratio: float


class Torques(NamedTuple):
    """Torques at a state. `on_rotor`, `on_wave_generator` [N·m, motor side], `on_link` [N·m]: sum on each body
    without external torque and flexible part. `sliding_friction` g(w) and `mesh_friction` with its viscous part
    [N·m, motor side]; `joint_torque` Ts; `gravity` (part of `on_link`); the rest as in `Transmission`."""

    on_rotor: float
    on_wave_generator: float
    on_link: float
    wave_generator_torque: float
    flexspline_torque: float
    joint_torque: float
    load: float
    gravity: float
    sliding_friction: float
    mesh_friction: float
    torsion_rate: float
    ratio: float


@kernel(forceinline=True)
def transmission(state, p, passband=0.0):
    """Return the torques between the bodies, `Transmission`.

    `passband` [s/rad]: of a smoother of the motion, in turns per radian of a shaft with one turn per 1/fc; it reduces
    the kinematic error (`laws.magnitude_response`). 0: none.
    """
    x, w = state.wave_generator_position, state.wave_generator_velocity
    if passband == 0.0:
        error, slope = laws.kinematic_error(x, p), laws.kinematic_error_slope(x, p)
    else:
        error, slope = laws.smoothed_kinematic_error(x, abs(w) * passband, p)
    ratio = 1.0 / p.N - slope
    torsion = x / p.N - state.link_position - error
    rate = w * ratio - state.link_velocity
    load = laws.flexspline_spring(torsion, p) + p.df * rate
    if p.hysteresis_torque != 0.0:
        load += laws.hysteresis_torque(state.dahl, p)
    Tf = load
    if laws.has_discrepancy(p):
        Tf += _discrepancy(_FLEXSPLINE, state, load, p)
    Tw = laws.wave_generator_spring(state.motor_position - x, p) + p.dw * (state.motor_velocity - w)
    return Transmission(Tw, Tf, load, torsion, rate, ratio)


@kernel
def _discrepancy(place, state, load, p):
    return laws.discrepancy(
        place, state.motor_position, state.link_position, state.wave_generator_velocity, load, state.time, p
    )


@kernel
def flexspline_discrepancy(state, load, p):
    """Return the model discrepancy of the flexspline torque [N·m] at a state under a load."""
    return _discrepancy(_FLEXSPLINE, state, load, p)


@kernel(forceinline=True)
def sliding_friction(state, load, p):
    """Return the Stribeck curve g(w) at a state under a load [N·m]: `laws.stribeck_friction` [N·m, motor side]."""
    return laws.stribeck_friction(
        state.wave_generator_velocity, state.link_position, load, state.time, state.temperature, p
    )


@kernel(forceinline=True)
def mesh_torque(state, load, g, p):
    """Return the friction torque of the mesh [N·m, motor side] with its viscous part, at a sliding friction g."""
    w = state.wave_generator_velocity
    torque = laws.mesh_friction(state.bristle, w, g, p) + laws.viscous_friction(w, state.temperature, p)
    if laws.has_discrepancy(p):
        torque += _discrepancy(_MESH, state, load, p)
    return torque


@kernel(forceinline=True)
def rotor_torque(state, Tw, load, p, passband=0.0):
    """Return the torque on the rotor [N·m, motor side] under a wave generator torque Tw; `passband` as in
    `transmission`."""
    cogging = laws.cogging_torque(state.motor_position, p, abs(state.motor_velocity) * passband)
    torque = p.Kt * state.motor_current + cogging - p.bm * state.motor_velocity - Tw
    if laws.has_discrepancy(p):
        torque += _discrepancy(_ROTOR, state, load, p)
    return torque


@kernel(forceinline=True)
def link_torque(state, load, p):
    """Return the torque on the link [N·m] without joint torque and external torque: gravity, cable, stop, friction."""
    torque = laws.gravity_torque(state.link_position, p) + laws.link_torque(state.link_position, p)
    if p.link_friction != 0.0 or p.link_damping != 0.0:
        torque += laws.link_friction(state.link_velocity, p)
    if laws.has_discrepancy(p):
        torque += _discrepancy(_LINK, state, load, p)
    return torque


@kernel
def balance(state, p):
    """Return the torques of the joint in a state, `Torques`: the equations of motion."""
    t = transmission(state, p)
    return balance_with(state, t, sliding_friction(state, t.load, p), p)


@kernel
def balance_with(state, t, g, p):
    """Return `balance` for known transmission and sliding friction g."""
    friction = mesh_torque(state, t.load, g, p)
    Ts = t.flexspline_torque - p.bl * state.link_velocity
    gravity = laws.gravity_torque(state.link_position, p)
    on_rotor = rotor_torque(state, t.wave_generator_torque, t.load, p)
    on_wave_generator = t.wave_generator_torque - friction - t.flexspline_torque * t.ratio
    return Torques(
        on_rotor, on_wave_generator, Ts + link_torque(state, t.load, p), t.wave_generator_torque, t.flexspline_torque,
        Ts, t.load, gravity, g, friction, t.torsion_rate, t.ratio,
    )  # fmt: skip


@kernel
def transmitted_torque(state, motor_acceleration, g, load, p):
    """Return the flexspline torque Tf [N·m] by current and motion of the drive, rotor and wave generator as one body.

    The sum of their balances, in which Tw cancels: Tf = (Kt i + cogging − bm ω − Fmesh − (Jm + Jw) ω')/(1/N − θerr').
    `state`: both at the rotor's position and velocity; `motor_acceleration` ω' [rad/s²]; g: sliding friction; load:
    for discrepancies.
    """
    ratio = 1.0 / p.N - laws.kinematic_error_slope(state.wave_generator_position, p)
    drive = rotor_torque(state, 0.0, load, p) - mesh_torque(state, load, g, p)
    return (drive - (p.Jm + p.Jw) * motor_acceleration) / ratio


@kernel
def drive_state(position, velocity, link_position, link_velocity, bristle, current, time, temperature):
    """Return a `State` with rotor and wave generator as one body."""
    return State(
        position, velocity, position, velocity, link_position, link_velocity, bristle, 0.0, current, time, temperature
    )


@kernel
def measured_torsion(motor_position, link_position, motor_torque, p):
    """Return the torsion Δθf [rad] of Eqs. (1), (5), (6) from angles, and the wave generator's angle θw [rad, motor
    side].

    `motor_torque` [N·m, motor side] is used for Tw. The kinematic error is a function of θw = θm − Δθw, which no
    sensor reads.
    """
    wave_generator_position = motor_position - laws.wave_generator_torsion(motor_torque, p)
    error = laws.kinematic_error(wave_generator_position, p)
    return wave_generator_position / p.N - link_position - error, wave_generator_position


@kernel
def wave_generator_position(angle, p):
    """Return the wave generator's angle θw [rad, motor side] for which θw/N − θerr(θw) is an angle [rad]: the link's
    plus the torsion Δθf, Eq. (6)."""
    theta_w = p.N * angle
    for _ in range(4):  # Newton's steps
        excess = theta_w / p.N - laws.kinematic_error(theta_w, p) - angle
        theta_w -= excess / (1.0 / p.N - laws.kinematic_error_slope(theta_w, p))
    return theta_w


@kernel
def steady_motion(link_position, link_velocity, link_acceleration, external_torque, time, temperature, p):
    """Return rotor angle [rad], motor current [A] and joint torque Ts [N·m] for a motion of the link with sliding
    friction.

    The inverse of `balance` with springs in equilibrium and a rigid link: for planning, and for a start. Near rest
    friction changes its sign smoothly over the Stribeck velocity. The drive turns N times as fast as the link,
    without the kinematic error's velocity.
    """
    w, a = p.N * link_velocity, p.N * link_acceleration
    blank = State(0.0, w, 0.0, w, link_position, link_velocity, 0.0, 0.0, 0.0, time, temperature)
    Ts = p.Jl * link_acceleration - link_torque(blank, 0.0, p) - external_torque
    Tf = Ts + p.bl * link_velocity
    theta_w = wave_generator_position(link_position + laws.flexspline_torsion(Tf, p), p)
    ratio = 1.0 / p.N - laws.kinematic_error_slope(theta_w, p)
    friction = sliding_friction(blank, Tf, p) * math.tanh(w / p.vs) + laws.viscous_friction(w, temperature, p)
    Tw = Tf * ratio + friction + p.Jw * a
    theta_m = theta_w + laws.wave_generator_torsion(Tw, p)
    current = (Tw + p.Jm * a + p.bm * w - laws.cogging_torque(theta_m, p)) / p.Kt
    return theta_m, current, Ts


@kernel
def read_motor_position(state, p):
    """Return the motor encoder's reading [rad, motor side] before noise and counts."""
    return laws.motor_reading(state.motor_position, p)


@kernel
def read_link_position(state, load, p):
    """Return the link encoder's reading [rad] before delay, noise and bits."""
    reading = laws.link_reading(state.link_position, p)
    if laws.has_discrepancy(p):
        reading += _discrepancy(_LINK_POSITION, state, load, p)
    return reading


@kernel
def read_motor_current(state, load, p):
    """Return the current sensor's reading [A] before noise."""
    reading = laws.current_reading(state.motor_current, p)
    if laws.has_discrepancy(p):
        reading += _discrepancy(_MOTOR_CURRENT, state, load, p)
    return reading


@kernel
def read_motor_torque(state, load, p):
    """Return the drive's motor torque [N·m, motor side] before noise: measured current times the drive's torque
    constant."""
    return p.Kt_drive * read_motor_current(state, load, p)


@kernel
def read_joint_torque(torque, state, load, p):
    """Return the joint torque sensor's reading [N·m] before noise at a joint torque `torque`."""
    reading = laws.torque_reading(torque, state.time, p)
    if laws.has_discrepancy(p):
        reading += _discrepancy(_JOINT_TORQUE, state, load, p)
    return reading


@kernel
def readings(state, torques, p, out):
    """Fill `out`, a record of `signals.READINGS`, with the readings of the joint's own sensors before noise.

    Without the wrench, which depends on the sensor's place in the plant's MJCF.
    """
    out.motor_position = read_motor_position(state, p)
    out.link_position = read_link_position(state, torques.load, p)
    out.motor_current = read_motor_current(state, torques.load, p)
    out.motor_torque = read_motor_torque(state, torques.load, p)
    out.joint_torque = read_joint_torque(torques.joint_torque, state, torques.load, p)
    out.temperature = state.temperature


@kernel
def actual_link_position(reading, motor_position, motor_velocity, time, p):
    """Return the link angle [rad] of a link encoder's reading, less zero, orders and discrepancy: the inverse of
    `read_link_position`.

    To first order in the error, which is a thousandth of the angle. A delay is not corrected here.
    """
    rough = reading - p.link_zero
    angle = reading - (laws.link_reading(rough, p) - rough)
    if laws.has_discrepancy(p):
        angle -= laws.discrepancy(_LINK_POSITION, motor_position, rough, motor_velocity, 0.0, time, p)
    return angle


@kernel
def actual_motor_position(reading, p):
    """Return the rotor angle [rad] of a motor encoder's reading, less its eccentricity."""
    return reading - (laws.motor_reading(reading, p) - reading)


@kernel
def actual_motor_motion(reading, velocity, acceleration, p, passband=0.0):
    """Return position [rad], velocity and acceleration of the rotor from a smoothed reading of the motor encoder and its
    derivatives, less the encoder's eccentricity.

    An eccentricity A changes the apparent acceleration by A ω². `passband` as in `transmission`: the smoother reduces it.
    """
    size, phase = p.motor_eccentricity, p.motor_eccentricity_phase
    position, rate, change = reading + 0.0 * size, velocity + 0.0 * size, acceleration + 0.0 * size
    if size != 0.0:
        seen = size * laws.magnitude_response(1.0, abs(velocity) * passband)
        position = reading - (seen * math.sin(reading + phase) - size * math.sin(phase))
        slope = 1.0 + seen * math.cos(position + phase)
        rate = velocity / slope
        change = (acceleration + seen * math.sin(position + phase) * rate * rate) / slope
    return position, rate, change


@kernel
def actual_motor_current(reading, motor_position, link_position, motor_velocity, load, time, p):
    """Return the motor current [A] of a reading, less offset and discrepancy."""
    current = reading - p.current_offset
    if laws.has_discrepancy(p):
        current -= laws.discrepancy(_MOTOR_CURRENT, motor_position, link_position, motor_velocity, load, time, p)
    return current
