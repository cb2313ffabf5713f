"""Replay of measured motion: sensor readings that a joint predicts for the motion that it made.

Both ends of the joint, rotor and link, follow their *measured* motion. Only what lies between and is not measured is simulated:
the wave generator, the friction's bristle and the flexspline's Dahl state. The predictions are

    motor current   (Jm θm'' + bm θm' + Tw − cogging)/Kt, as the current sensor would read it,
    joint torque    Tf − bl θl', as the torque sensor would read it,
    link balance    Ts + link torques + τext − Jl θl'', zero for a correct description of the link; with a torque sensor its
                    reading replaces Ts, and the rest is as that sensor would read it.

Nothing drifts, since both ends are tied to the data. An unmeasured push on the link enters the link balance alone, which is then
left out. With one encoder the rotor follows it and the link is simulated. If that encoder is the link's, a torque sensor is
compared with the motion that it read. The current then shows the sum of rotor and link, and a kinematic error passes through the
joint's own resonance. The motion is reconstructed from the encoders' readings with their zero, delay and eccentricity in the
record. It is smoothed, as are current and torque: linear laws are not affected, and orders of motor and gear are attenuated as by
the smoother at that speed.

The equations are those of `models.dynamics`; this module steps them. With pulsation Ω and step h a linear transmission has its
inertia to (Ωh)²/6 and its dampings to (Ωh)²/8, whatever its stiffness.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ...models import dynamics, laws
from ...models.dual import LANES, dual_records, dual_table, value_of
from ...models.dynamics import State
from ...models.kernels import kernel
from ...models.parameters import floats
from ..data.segments import BALANCES, CURRENT, DECIMATION, LINK, STEP, TORQUE, WINDOW, Segment

_RUNAWAY = 1e5  # rad/s: a speed of the wave generator that no joint reaches
_STIFFEST = 2.5
"""Torque of the wave generator's compliance beyond any that a joint carries, in torques of its motor at the limit."""

_UNRESOLVED = 6.0
"""Pulsation of the wave generator against rotor and link, times the step, that a step does not resolve."""

INNER = floats(
    "wave_generator_position", "wave_generator_velocity", "motor_position", "motor_velocity", "motor_acceleration",
    "link_position", "link_velocity", "link_acceleration", "bristle", "dahl", "flexible_position", "flexible_velocity",
    "flexspline_torque", "load", "wave_generator_torque",
)  # fmt: skip
"""State of the joint at every step: corrected motion of both ends, and the simulated part between them."""
MOVING = floats(
    "wave_generator_position", "wave_generator_velocity", "bristle", "dahl", "motor_position", "motor_velocity",
    "link_position", "link_velocity", "link_acceleration", "flexible_position", "flexible_velocity", "stiffness",
)  # fmt: skip
"""State of the transmission between steps."""
SWINGING = floats("position", "velocity", "link_acceleration")
"""The same of a mass on the link behind a spring, where the link's motion is measured."""
_INNER, _MOVING, _SWINGING = (dtype.itemsize // 8 for dtype in (INNER, MOVING, SWINGING))
_BLOCK = 64
"""Steps that are replayed before they are read out: as many as fit into a processor's first cache."""
_LEAD = 100
"""Steps before the first of a joint that begins in motion, in which friction begins to slide and the simulation settles."""
_SLOPE = 40
"""Steps over which the acceleration in these is taken."""
_LEAD_TRAVEL = 0.1
"""Travel of the rotor in these [rad] below which it counts as resting: the sign of friction is not known."""

READ_OUT = (
    "Jm", "Kt", "Kt_drive", "bm", "R", "L", "supply_voltage", "current_limit", "bl", "Jl", "Mg", "gravity_angle",
    "cogging_order", "cogging_amplitude", "cogging_phase", "cable_stiffness", "cable_rest", "stop_angle",
    "stop_stiffness", "link_friction", "link_damping", "arm_scale", "flexible_share", "flexible_frequency",
    "flexible_damping", "current_offset", "torque_gain", "torque_offset", "torque_rate",
)  # fmt: skip
"""Numbers that change sensor readings, but nothing inside a transmission with both ends measured."""
_LINK_NUMBERS = (
    "bl", "Jl", "Mg", "gravity_angle", "cable_stiffness", "cable_rest", "stop_angle", "stop_stiffness", "link_friction",
    "link_damping", "arm_scale", "flexible_share", "flexible_frequency", "flexible_damping",
)  # fmt: skip
"""Those of them that change it where the link's motion is simulated."""


class Inputs(NamedTuple):
    """Measured motion of a segment and settings of its replay.

    `measured`: whether the link's motion is; `weighed`: whether the link's balance uses its encoder's motion. `external`: known
    torque on the link [N·m], and its part from other links of an arm, shape (n, 2). `step` [s]; means are over `every` steps.
    """

    time: np.ndarray
    temperature: np.ndarray
    rotor: np.ndarray
    link: np.ndarray
    torque: np.ndarray
    measured: bool
    weighed: bool
    external: np.ndarray
    stiffness: float
    passband: Any
    step: float
    every: int
    window: np.ndarray


@kernel
def _between(reading, i, shift, h):
    """A reading's value and derivatives `shift` steps after step i: cubic of value and slope; shape (n, 3)."""
    n = len(reading)
    j = min(i + math.floor(shift), n - 2)
    f = min(i + shift - j, 1.0)
    d = reading[j + 1, 0] - reading[j, 0]
    a0 = h * reading[j, 1] - d
    a1 = d - h * reading[j + 1, 1]
    value = (1.0 - f) * reading[j, 0] + f * reading[j + 1, 0] + f * (1.0 - f) * ((1.0 - f) * a0 + f * a1)
    return (
        value,
        (1.0 - f) * reading[j, 1] + f * reading[j + 1, 1],
        (1.0 - f) * reading[j, 2] + f * reading[j + 1, 2],
    )


@kernel
def _before(rotor, h):
    """Rotor's velocity [rad/s] and acceleration [rad/s²] from which it came to the first step; zero where it hardly moves."""
    n = min(_SLOPE, len(rotor) - 1)
    v = rotor[0, 1]
    if abs(v) * _LEAD * h < _LEAD_TRAVEL:
        return 0.0, 0.0
    return v, (rotor[n, 1] - v) / (n * h)


@kernel
def _known_torque(external, i, p):
    """Known torque on the link [N·m] at step i, with the arm's part of it as the joint's record scales it."""
    return external[i, 0] + (p.arm_scale - 1.0) * external[i, 1]


@kernel
def _under_load(m, l, v, a, external, time, temperature, p):
    """Link's angle under its own load and wound-up friction, near an angle l, for the rotor at m."""
    for _ in range(3):
        found, _, _ = dynamics.steady_motion(l, v / p.N, a / p.N, external, time, temperature, p)
        l = l + (m - found) / p.N
    return l


@kernel
def _excess(x, m, l, p):
    """Torque on a wave generator at x beyond that of equilibrium without friction [N·m, motor side]."""
    torsion = x / p.N - l - laws.kinematic_error(x, p)
    ratio = 1.0 / p.N - laws.kinematic_error_slope(x, p)
    return laws.wave_generator_spring(m - x, p) - laws.flexspline_spring(torsion, p) * ratio


@kernel
def _equilibrium(m, l, p):
    """Wave generator's angle at which its torque and the flexspline's balance without friction, at a rotor and a link angle."""
    low = value_of(m - 1.0 / (p.Cw * p.Kw0))
    high = value_of(m + 1.0 / (p.Cw * p.Kw0))
    x = low
    for _ in range(40):
        x = 0.5 * (low + high)
        if _excess(x, m, l, p) > 0.0:
            low = x
        else:
            high = x
    # Steps of Newton's, which dual numbers have their derivatives from; the slope leaves out how the ratio changes.
    for _ in range(2):
        torsion = x / p.N - l - laws.kinematic_error(x, p)
        ratio = 1.0 / p.N - laws.kinematic_error_slope(x, p)
        slope = laws.wave_generator_stiffness(m - x, p) + laws.flexspline_stiffness(torsion, p) * ratio * ratio
        x = x + _excess(x, m, l, p) / slope
    return x


@kernel
def _transmission(p, given, begin, end, moving, inner):
    """Simulate the steps from `begin` to `end` into `inner`, records of `INNER`, from and to `moving`, a record of `MOVING`.
    False: runaway."""
    time, temperature, rotor, link, external = given.time, given.temperature, given.rotor, given.link, given.external
    measured, passband, h = given.measured, given.passband, given.step
    shift = p.link_delay / h
    reach = laws.wave_generator_torsion(_STIFFEST * p.Kt * p.current_limit, p)
    rigid, swing = p.Jl - laws.flexible_inertia(p), laws.flexible_response(h, p)
    z, dahl, w, theta_w = moving.bristle, moving.dahl, moving.wave_generator_velocity, moving.wave_generator_position
    m1, vm1, l1, vl1, al1 = (
        moving.motor_position, moving.motor_velocity, moving.link_position, moving.link_velocity,
        moving.link_acceleration,
    )  # fmt: skip
    phi, phi_rate, stiffness = moving.flexible_position, moving.flexible_velocity, moving.stiffness
    # A midpoint step leaves so fast a pulsation undamped: springs of so light a wave generator act up to h/2 earlier.
    unresolved = max(1.0 - _UNRESOLVED**2 * p.Jw / (h * h * (p.Kw0 + p.K1 / p.N**2)), 0.0)
    more_dw, more_df = 0.5 * h * unresolved * p.Kw0, 0.5 * h * unresolved * p.K1
    v_before, a_before = _before(rotor, h)
    first = -_LEAD if v_before != 0.0 else 0
    for step in range(begin if begin > 0 else first, end):
        m0, vm0, l0, vl0, al0 = m1, vm1, l1, vl1, al1
        i = max(step, 0)
        # Rotor and link as they moved: readings without the encoders' own errors, the link's earlier by its delay.
        way, v, a = 0.0, rotor[i, 1], rotor[i, 2]
        if step < 0:
            ago = step * h
            way, v, a = ago * (v_before + 0.5 * ago * a_before), v_before + ago * a_before, a_before
        m1, vm1, am1 = dynamics.actual_motor_motion(rotor[i, 0] + way, v, a, p, passband)
        if measured:
            reading, vl1, al1 = _between(link, i, shift, h)
            if step < 0:  # as wound up as in the first step
                reading, vl1, al1 = reading + way / p.N, vm1 / p.N, am1 / p.N
            l1 = dynamics.actual_link_position(reading, rotor[i, 0] + way, vm1, time[i], p)
        elif step == first:
            l1 = dynamics.actual_link_position(link[0, 0] + way / p.N, rotor[0, 0] + way, vm1, time[0], p)
            l1 = _under_load(m1, l1, vm1, a_before, _known_torque(external, 0, p), time[0], temperature[0], p)
            vl1, al1 = vm1 / p.N, am1 / p.N
        if step == first:
            # Springs in equilibrium, friction unstressed.
            w = w + vm1
            theta_w = _equilibrium(m1, l1, p)
        else:
            # One linearly implicit midpoint step of the wave generator, and of the link where it is simulated. All angles in the
            # middle are interpolated alike, or springs would see h²/8 of an acceleration: `bent` of the way from the mean of both
            # ends to the cubic; all of it where nothing is stiff, none where it would be unstable.
            vm = 0.5 * (vm0 + vm1)
            if measured:
                bent = max(1.0 - h * h * stiffness / (8.0 * p.Jw), 0.0)
                l = 0.5 * (l0 + l1) + 0.125 * h * bent * (vl0 - vl1)
                vl = 0.5 * (vl0 + vl1)
            else:
                bent = 0.0 * stiffness
                l, vl = l0 + 0.5 * h * vl0, vl0
            m = 0.5 * (m0 + m1) + 0.125 * h * bent * (vm0 - vm1)
            x = theta_w + 0.5 * h * w
            middle = State(m, vm, x, w, l, vl, z, dahl, 0.0, time[i], temperature[i])
            if p.hysteresis_torque != 0.0:
                rate = dynamics.transmission(middle, p, passband).torsion_rate
                middle = State(
                    m, vm, x, w, l, vl, z, laws.dahl_step(dahl, rate, 0.5 * h, p), 0.0, time[i], temperature[i]
                )
            t = dynamics.transmission(middle, p, passband)
            g = dynamics.sliding_friction(middle, t.load, p)
            z_middle = laws.bristle_step(z, w, g, 0.5 * h, p)
            middle = State(m, vm, x, w, l, vl, z_middle, middle.dahl, 0.0, time[i], temperature[i])
            loss = t.torsion_rate * more_df
            force = t.wave_generator_torque + more_dw * (vm - w) - dynamics.mesh_torque(middle, t.load, g, p)
            force -= (t.flexspline_torque + loss) * t.ratio
            sliding = p.s0 * z_middle / g * np.sign(w)
            sticking = max(1.0 - sliding, 0.0)
            kf = p.K1
            # Friction that grows with the load grows with torsion and its rate: an explicit one rings on a light rotor.
            grip = t.ratio
            if p.friction_load != 0.0 and t.load * w >= 0.0:
                kept = math.exp(-0.5 * h * p.s0 * abs(w) / g)  # of the bristle's deflection
                grip = grip + (1.0 - kept + kept * p.s1 * abs(w) / g) * p.friction_load / p.N
            stiffness = laws.wave_generator_stiffness(m - x, p) + kf * t.ratio * grip + p.s0 * sticking
            damping = p.dw + more_dw + p.bw + (p.df * grip + more_df * t.ratio) * t.ratio + p.s1 * sticking
            a11 = p.Jw + h * ((0.25 - 0.125 * bent) * h * stiffness + 0.5 * damping)
            if measured:
                change = h * force / a11
                w_middle = w + 0.5 * change
            else:
                push = t.flexspline_torque + loss - p.bl * vl + dynamics.link_torque(middle, t.load, p)
                push += _known_torque(external, i, p)
                push += laws.flexible_torque(phi, phi_rate, p)
                spring = 0.25 * h * kf + 0.5 * (p.df + more_df)
                a22 = rigid + h * (spring + 0.5 * p.bl)
                a12, a21 = -h * spring * grip, -h * spring * t.ratio
                det = a11 * a22 - a12 * a21
                change = h * (a22 * force - a12 * push) / det
                link_change = h * (a11 * push - a21 * force) / det
                w_middle = w + 0.5 * change
                vl_middle = vl0 + 0.5 * link_change
                l1 = l0 + h * vl_middle
                vl1 = vl0 + link_change
                al1 = link_change / h
                vl = vl_middle
            theta_w += h * w_middle
            # Such a step leaves an alternation of velocity, too: at its end a light wave generator slips as in its middle.
            w += change
            w -= unresolved * (w - vm1 - w_middle + vm)
            if not abs(w) < _RUNAWAY:  # parameters beyond reason: give up on the segment
                return False
            z = laws.bristle_step(z, w_middle, g, h, p)
            if abs(m1 - theta_w) > reach:  # where the compliance is all but rigid
                theta_w = m1 - (reach if m1 > theta_w else -reach)
                w = 0.0 * w + vm1
            if p.hysteresis_torque != 0.0:
                dahl = laws.dahl_step(dahl, w_middle * t.ratio - vl, h, p)
        if p.flexible_share != 0.0 and not measured:
            phi, phi_rate = laws.flexible_motion(phi, phi_rate, al0, al1, swing)
        if step < 0:
            continue
        ends = dynamics.transmission(
            State(m1, vm1, theta_w, w, l1, vl1, z, dahl, 0.0, time[i], temperature[i]), p, passband
        )
        s = inner[i - begin]
        s.wave_generator_position, s.wave_generator_velocity = theta_w, w
        s.motor_position, s.motor_velocity, s.motor_acceleration = m1, vm1, am1
        s.link_position, s.link_velocity, s.link_acceleration = l1, vl1, al1
        s.bristle, s.dahl, s.flexible_position, s.flexible_velocity = z, dahl, phi, phi_rate
        s.flexspline_torque, s.load, s.wave_generator_torque = (
            ends.flexspline_torque,
            ends.load,
            ends.wave_generator_torque,
        )
    moving.bristle, moving.dahl, moving.wave_generator_velocity, moving.wave_generator_position = z, dahl, w, theta_w
    moving.motor_position, moving.motor_velocity, moving.link_position = m1, vm1, l1
    moving.link_velocity, moving.link_acceleration = vl1, al1
    moving.flexible_position, moving.flexible_velocity, moving.stiffness = phi, phi_rate, stiffness
    return True


@kernel
def _state(s, link_position, link_velocity, current, time, temperature):
    """State of the joint from a record of `INNER` and a motion of the link."""
    return State(
        s.motor_position, s.motor_velocity, s.wave_generator_position, s.wave_generator_velocity, link_position,
        link_velocity, s.bristle, s.dahl, current, time, temperature,
    )  # fmt: skip


@kernel
def _readings(p, given, begin, end, inner, swinging, out):
    """Add window-weighted sums of current reading, torque reading and link balance from `begin` to `end` to out, shape
    (k, len(BALANCES)).

    Where the link's motion is measured, a mass behind a spring on the link is simulated here, from and to `swinging`, a record of
    `SWINGING`: it has no effect inside.
    """
    time, temperature, link, torque, external = given.time, given.temperature, given.link, given.torque, given.external
    weighed, h, every, window = given.weighed, given.step, given.every, given.window
    shift = p.link_delay / h
    phi, phi_rate, before = swinging.position, swinging.velocity, swinging.link_acceleration
    has_torque, swing = len(torque) > 0, laws.flexible_response(h, p)
    k = begin // every
    r = begin - k * every
    for i in range(begin, end):
        s = inner[i - begin]
        state = _state(s, s.link_position, s.link_velocity, 0.0, time[i], temperature[i])
        on_rotor = dynamics.rotor_torque(state, s.wave_generator_torque, s.load, p, given.passband)
        current = (p.Jm * s.motor_acceleration - on_rotor) / p.Kt
        state = _state(s, s.link_position, s.link_velocity, current, time[i], temperature[i])
        Ts = s.flexspline_torque - p.bl * s.link_velocity
        acceleration = s.link_acceleration
        if weighed and not given.measured:
            reading, velocity, acceleration = _between(link, i, shift, h)
            position = dynamics.actual_link_position(reading, s.motor_position, s.motor_velocity, time[i], p)
            state = _state(s, position, velocity, current, time[i], temperature[i])
        balance = dynamics.link_torque(state, s.load, p) + _known_torque(external, i, p)
        if not weighed:
            phi, phi_rate = s.flexible_position, s.flexible_velocity
        elif p.flexible_share != 0.0:
            phi, phi_rate = laws.flexible_motion(phi, phi_rate, before, acceleration, swing)
            before = acceleration
        balance += laws.flexible_torque(phi, phi_rate, p)
        balance -= (p.Jl - laws.flexible_inertia(p)) * acceleration
        # As the torque sensor reads it the link's balance has the same noise at all parameters. Without one the noise is the
        # torsion's times the stiffness, and is scaled to the described stiffness.
        if has_torque:
            balance = torque[i] - dynamics.read_joint_torque(0.0, state, s.load, p) + p.torque_gain * balance
        else:
            balance = (Ts + balance) * given.stiffness / (p.K1 + p.K2 + p.K3)
        read_current = dynamics.read_motor_current(state, s.load, p)
        read_torque = dynamics.read_joint_torque(Ts, state, s.load, p)
        u = window[r]
        out[k, CURRENT] += u * read_current
        out[k, TORQUE] += u * read_torque
        out[k, LINK] += u * balance
        if r > 0 and k + 1 < len(out):
            u = window[every - r]
            out[k + 1, CURRENT] += u * read_current
            out[k + 1, TORQUE] += u * read_torque
            out[k + 1, LINK] += u * balance
        r += 1
        if r == every:
            k, r = k + 1, 0
    swinging.position, swinging.velocity, swinging.link_acceleration = phi, phi_rate, before


@kernel
def _replay(p, given, moving, inner, swinging, out):
    """Both of the above through a whole segment, as many steps at a time as there are records in `inner`. False: runaway."""
    begin, n = 0, len(given.time)
    while begin < n:
        end = min(begin + len(inner), n)
        if not _transmission(p, given, begin, end, moving, inner):
            return False
        _readings(p, given, begin, end, inner, swinging, out)
        begin = end
    return True


_readings_table = dual_table(len(BALANCES))


@kernel
def _replay_dual(record, directions, given, out, derivatives):
    """The same for dual numbers: derivatives of `out`, shape (k, len(BALANCES), LANES), in directions of the record."""
    moving, moving_d = np.zeros(1, MOVING), np.zeros((1, _MOVING, LANES))
    swinging, swinging_d = np.zeros(1, SWINGING), np.zeros((1, _SWINGING, LANES))
    inner, inner_d = np.empty(_BLOCK, INNER), np.empty((_BLOCK, _INNER, LANES))
    return _replay(
        dual_records(record, directions)[0], given, dual_records(moving, moving_d)[0], dual_records(inner, inner_d),
        dual_records(swinging, swinging_d)[0], _readings_table(out, derivatives),
    )  # fmt: skip


@cache
def _weights(count: int, n: int) -> np.ndarray:
    """Sums of the window's weights in each of `count` means over n steps, shape (count,)."""
    found = np.zeros(count)
    step, behind = np.divmod(np.arange(n), DECIMATION)
    np.add.at(found, step, WINDOW[behind])
    before = (behind > 0) & (step + 1 < count)
    np.add.at(found, step[before] + 1, WINDOW[DECIMATION - behind[before]])
    return found


def _inputs(segment: Segment, every: int = DECIMATION, window: np.ndarray = WINDOW) -> Inputs:
    return Inputs(
        segment.time, segment.temperature, segment.rotor, segment.link, segment.torque, segment.link_measured,
        segment.weighed, np.column_stack([segment.external, segment.arm]), segment.stiffness, segment.passband, STEP,
        every, window,
    )  # fmt: skip


def transmission(segment: Segment, record: np.ndarray) -> np.ndarray:
    """Simulate the motion between rotor and link, shape (n,), records of `INNER`; NaN for a runaway."""
    n = len(segment.time)
    inner, moving = np.empty(n, INNER), np.zeros(1, MOVING)
    if not _transmission(record[0], _inputs(segment), 0, n, moving[0], inner):
        inner.view(np.float64)[:] = np.nan
    return inner


def replay(segment: Segment, record: np.ndarray, inner: np.ndarray | None = None) -> np.ndarray:
    """Predict current reading [A], joint torque reading [N·m] and link balance [N·m], shape (k, len(BALANCES)).

    Args:
      inner: of `transmission` for a record that differs only in `READ_OUT`.
    """
    n, out, swinging = len(segment.time), np.zeros((len(segment.at), len(BALANCES))), np.zeros(1, SWINGING)
    good = True
    if inner is None:
        moving, block = np.zeros(1, MOVING), np.empty(_BLOCK, INNER)
        good = _replay(record[0], _inputs(segment), moving[0], block, swinging[0], out)
    else:
        _readings(record[0], _inputs(segment), 0, n, inner, swinging[0], out)
    if not good:
        out[:] = np.nan
    return out / _weights(len(out), n)[:, None]


def readings(segment: Segment, record: np.ndarray, inner: np.ndarray | None = None) -> np.ndarray:
    """Predict as `replay` does, but at every step instead of means over them, shape (n, len(BALANCES))."""
    inner = transmission(segment, record) if inner is None else inner
    n, swinging = len(segment.time), np.zeros(1, SWINGING)
    out = np.zeros((n, len(BALANCES)))
    _readings(record[0], _inputs(segment, 1, np.ones(1)), 0, n, inner, swinging[0], out)
    return out


def residual(segment: Segment, record: np.ndarray, inner: np.ndarray | None = None) -> np.ndarray:
    """Measured minus predicted current [A] and torque [N·m], and the link balance [N·m], shape (k, len(BALANCES))."""
    out = replay(segment, record, inner)
    for balance in (CURRENT, TORQUE):
        out[:, balance] = segment.measured[:, balance] - out[:, balance]
    return np.where(segment.balances, out, 0.0)


def residuals(pairs: Sequence[tuple[Segment, np.ndarray]]) -> list[np.ndarray]:
    """`residual` of many pairs in parallel; records that differ only in `READ_OUT` share the simulation."""
    keys = [(id(segment), _inside(segment, record)) for segment, record in pairs]
    times = Counter(keys)
    shared = {key: pair for key, pair in zip(keys, pairs, strict=True) if times[key] > 1}
    inner = dict(zip(shared, parallel(lambda pair: transmission(*pair), list(shared.values())), strict=True))
    tasks = [(*pair, inner.get(key)) for key, pair in zip(keys, pairs, strict=True)]
    return parallel(lambda task: residual(*task), tasks)


def derivatives(trios: Sequence[tuple[Segment, np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """Return exact derivatives of `residual` in directions of the record, in parallel (`models.dual`).

    Args:
      trios: segment, record, and derivatives of the record's numbers, shape (m, SIZE).

    Returns:
      Of each, shape (k, len(BALANCES), m).
    """
    tasks = [
        (segment, record, directions[first : first + LANES])
        for segment, record, directions in trios
        for first in range(0, len(directions), LANES)
    ]
    parts = iter(parallel(lambda task: _derivatives(*task), tasks))
    return [
        np.concatenate([next(parts) for _ in range(0, len(directions), LANES)], axis=-1) for _, _, directions in trios
    ]


def _derivatives(segment: Segment, record: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The same in up to `LANES` directions, shape (k, len(BALANCES), m)."""
    m = len(directions)
    lanes = np.zeros((1, directions.shape[1], LANES))
    lanes[0, :, :m] = directions.T
    out = np.zeros((len(segment.at), len(BALANCES)))
    found = np.zeros((*out.shape, LANES))
    if not _replay_dual(record, lanes, _inputs(segment), out, found):
        found[:] = np.nan
    sign = np.ones(len(BALANCES))
    sign[[CURRENT, TORQUE]] = -1.0
    sign[~segment.balances] = 0.0
    with np.errstate(invalid="ignore", over="ignore"):  # callers check for unbounded derivatives
        return found[..., :m] * (sign / _weights(len(out), len(segment.time))[:, None])[..., None]


def _inside(segment: Segment, record: np.ndarray) -> bytes:
    """The part of a record that the transmission depends on."""
    copy = record.copy()
    for name in READ_OUT:
        if segment.link_measured or name not in _LINK_NUMBERS:
            copy[name] = 0.0
    return copy.tobytes()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(os.cpu_count() or 1, 8))


def parallel(function: Callable[[Any], Any], tasks: list[Any]) -> list[Any]:
    """Apply `function` to the tasks on as many threads as there are cores; the compiled replay holds no lock."""
    return list(_pool().map(function, tasks))
