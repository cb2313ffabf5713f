"""The joint as a stochastic state-space model, for the estimators that know its dynamics. Compiled.

State x, shape (SIZE,):

    θm, ωm    rotor                          [rad], [rad/s], motor side
    θw, ωw    wave generator                 [rad], [rad/s], motor side
    z         LuGre bristle                  [rad], motor side
    θl, ωl    link                           [rad], [rad/s]
    φ, φ'     flexible part of the link      [rad], [rad/s], relative to the link
    τext      external torque on the link    [N·m], random walk
    d         error of the mesh friction     [N·m, motor side], Ornstein-Uhlenbeck
    κ, κt     relative errors of stiffness and torque constant [1], constant
    x_h       Dahl state of the flexspline's hysteresis [rad]

An estimator carries the covariance of the *active* states: κ and κt if it calibrates itself, φ and x_h if the record
has a flexible link, or hysteresis.

The model is f (`advance`), h (`read_motor`, `read_link`, both angles; `joint_torque`), and its noise: a record of
`NOISE`, made by `ProcessNoise`. The equations of motion are `models.dynamics.balance_with`. Between samples the
current follows its command with the winding's time constant L/R. One step is Strang's splitting: the stiff bristle
and the Dahl state by their exact solutions at constant velocity for half a substep, the mechanics by the classical
Runge-Kutta method for a whole one, the bristle again. The fastest spring turns by at most 0.8 rad in a substep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..models import dynamics, laws
from ..models.dynamics import UNREAD, State, Transmission
from ..models.kernels import kernel
from ..models.parameters import floats
from .estimator import KnownJoint, TuningParameter

STATES = (
    "motor_position", "motor_velocity", "wave_generator_position", "wave_generator_velocity", "bristle",
    "link_position", "link_velocity", "flexible_position", "flexible_velocity", "external_torque", "mesh_torque", "stiffness",
    "motor_constant", "hysteresis",
)  # fmt: skip
SIZE = len(STATES)
(
    MOTOR, MOTOR_RATE, WAVE, WAVE_RATE, BRISTLE, LINK, LINK_RATE, FLEXIBLE, FLEXIBLE_RATE, EXTERNAL, MESH, STIFFNESS, CONSTANT,
    DAHL,
) = range(SIZE)  # fmt: skip
STEPS = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1e-6, 1e-7, 1e-4, 1e-6, 1e-4, 1e-3, 1e-5, 1e-4, 1e-4, 1e-7])
"""Steps of the finite differences, per state: small against its uncertainty, large against rounding."""
_LONGEST = 0.5e-3  # s: substep
_TURN = 0.8  # rad of the fastest mode per substep
_MOST = 10.0  # substeps per _LONGEST

NOISE = floats(
    "count", ("active", SIZE), ("start", SIZE), ("walk", SIZE), "current_walk", "mesh_surge", "external_surge",
    "motor_variance", "link_variance", "motor_step", "link_step", "mesh_time", "memory", "low", "high",
)  # fmt: skip
"""Noise as a record for compiled code: number and indices of active states; diagonals of P(0) and of the noise per
second; of the rotor's velocity for a current reading, and of d and τext while the encoders contradict; variance of
the encoders [rad²] and their steps [rad]; `mesh_time` [s], `memory`, and both ends of `threshold` of
`ProcessNoise`."""


@dataclass(frozen=True)
class ProcessNoise:
    """Deviation of a joint from its equations. One setting for all scenarios; scaled by the record, SI."""

    # intensity of the random walk of τext [T2/√s]. 0.001·12 N·m is 0.08 N·m in 40 s, the 1 % uncertainty of a link's
    # weight
    external: float = 0.001
    # intensity while the link encoder contradicts the prediction [T2/√s]. 4·12 N·m is the rated torque in 0.1 s
    push: float = 4.0
    mesh: float = 0.017  # standard deviation of d [Fc]; the error of a good friction model
    # intensity of d while the motor encoder contradicts the prediction [Fc/√s]: another level in 1 s
    mesh_push: float = 1.1
    mesh_time: float = 5.0  # correlation time of d [s]
    torque: float = 5.5e-4  # white noise of torque at the mesh [Fc·√s]: ripple, discretisation
    bristle: float = 5.5e-3  # noise of z [Fc/s0 per √s]
    # stiffness, motor_constant: standard deviation of κ, κt [1]; 0 excludes them
    stiffness: float = 0.0
    motor_constant: float = 0.0
    memory: float = 0.8  # share of an encoder's mean NIS that is kept per sample; 0.8 is 5 samples
    # mean NIS at which the noise starts to grow, and at which it is full. 1 is expected; at 5 samples it scatters by
    # 0.5
    threshold: tuple[float, float] = (3.0, 6.0)
    floor: float = 0.05  # least noise of the motor encoder [counts]

    def record(self, joint: KnownJoint, interval: float) -> np.ndarray:
        """Return the noise of a joint whose samples are `interval` [s] apart, shape (1,), a record of `NOISE`."""
        p, noise = joint.p, joint.noise
        found = np.zeros(1, NOISE)
        n = found[0]
        start, walk = n["start"], n["walk"]
        counts = noise.motor_resolution
        start[[MOTOR, WAVE]] = counts**2 + noise.motor_noise**2, (0.1 / (p["Cw"] * p["Kw0"])) ** 2
        start[[MOTOR_RATE, WAVE_RATE, LINK_RATE]] = 1.0, 1.0, p["N"] ** -2.0
        start[LINK] = noise.link_resolution**2 + noise.link_noise**2
        start[BRISTLE] = (p["Fs"] / p["s0"]) ** 2
        start[EXTERNAL], start[MESH] = (0.2 * p["T2"]) ** 2, (self.mesh * p["Fc"]) ** 2
        start[STIFFNESS], start[CONSTANT] = self.stiffness**2, self.motor_constant**2
        start[DAHL] = p["hysteresis_extent"] ** 2
        if p["flexible_share"] > 0.0:
            pulsation = 2 * np.pi * p["flexible_frequency"]
            start[FLEXIBLE] = (0.1 * p["T2"] / (p["flexible_share"] * p["Jl"] * pulsation**2)) ** 2
            start[FLEXIBLE_RATE] = pulsation**2 * start[FLEXIBLE]
        walk[WAVE_RATE] = (self.torque * p["Fc"] / p["Jw"]) ** 2
        walk[BRISTLE] = (self.bristle * p["Fc"] / p["s0"]) ** 2
        walk[EXTERNAL] = (self.external * p["T2"]) ** 2
        walk[MESH] = 2.0 * (self.mesh * p["Fc"]) ** 2 / self.mesh_time
        walk[STIFFNESS], walk[CONSTANT] = 1e-8 * (self.stiffness > 0), 1e-8 * (self.motor_constant > 0)
        walk[DAHL] = (0.01 * p["hysteresis_extent"]) ** 2
        # A reading's noise is a torque, constant between samples.
        n["current_walk"] = (p["Kt"] / p["Jm"]) ** 2 * noise.current_variance(interval) * interval
        n["mesh_surge"], n["external_surge"] = (self.mesh_push * p["Fc"]) ** 2, (self.push * p["T2"]) ** 2
        n["motor_variance"] = noise.motor_noise**2 + noise.motor_error**2 + (self.floor * counts) ** 2
        n["link_variance"] = noise.link_noise**2 + noise.link_error**2
        n["motor_step"], n["link_step"] = counts, noise.link_resolution
        n["mesh_time"], n["memory"], (n["low"], n["high"]) = self.mesh_time, self.memory, self.threshold
        active = [i for i in range(SIZE) if i not in (FLEXIBLE, FLEXIBLE_RATE, STIFFNESS, CONSTANT) or start[i] > 0.0]
        if p["hysteresis_torque"] == 0.0:
            active.remove(DAHL)
        activate(n, active)
        return found


def activate(noise: np.void, active: list[int]) -> None:
    """Make a record of `NOISE` carry the covariance of these states, by index; in place."""
    noise["count"] = len(active)
    noise["active"][: len(active)] = active


TUNING = (
    TuningParameter("process.push", 0.05, 100.0),
    TuningParameter("process.external", 1e-5, 1.0),
    TuningParameter("process.mesh", 1e-4, 0.5),
    TuningParameter("process.mesh_push", 1e-2, 30.0),
)
"""Tuning parameters of `ProcessNoise`, for estimators with one as `process`."""


@kernel
def state_of(x, current, time, temperature):
    """Return a state as `dynamics.State`; κt is a factor of the current."""
    return State(
        x[MOTOR], x[MOTOR_RATE], x[WAVE], x[WAVE_RATE], x[LINK], x[LINK_RATE], x[BRISTLE], x[DAHL],
        (1.0 + x[CONSTANT]) * current, time, temperature,
    )  # fmt: skip


@kernel
def transmission(x, state, p):
    """Return `dynamics.transmission` with the error κ of the stiffness."""
    t = dynamics.transmission(state, p)
    if x[STIFFNESS] == 0.0:
        return t
    more = laws.flexspline_spring((1.0 + x[STIFFNESS]) * t.torsion, p) - laws.flexspline_spring(t.torsion, p)
    return Transmission(
        t.wave_generator_torque, t.flexspline_torque + more, t.load + more, t.torsion, t.torsion_rate, t.ratio
    )


@kernel
def joint_torque(x, time, p):
    """Return the joint torque Ts = Tf − bl·ωl [N·m] at a state."""
    return transmission(x, state_of(x, UNREAD, time, UNREAD), p).flexspline_torque - p.bl * x[LINK_RATE]


@kernel
def read_motor(x, p):
    """Return the motor encoder's reading [rad, motor side] at a state."""
    return laws.motor_reading(x[MOTOR], p)


@kernel
def read_link(x, time, p):
    """Return the reading of a link encoder without delay [rad] at a state."""
    return dynamics.read_link_position(state_of(x, UNREAD, time, UNREAD), 0.0, p)


@kernel
def rates(x, current, time, temperature, p, out):
    """Write the rates of the mechanical states into `out`, shape (SIZE,); the others are zero here."""
    state = state_of(x, current, time, temperature)
    t = transmission(x, state, p)
    b = dynamics.balance_with(state, t, dynamics.sliding_friction(state, t.load, p), p)
    out[MOTOR], out[MOTOR_RATE] = x[MOTOR_RATE], b.on_rotor / p.Jm
    out[WAVE], out[WAVE_RATE] = x[WAVE_RATE], (b.on_wave_generator + x[MESH]) / p.Jw
    out[LINK] = x[LINK_RATE]
    if p.flexible_share > 0.0:
        spring, flexible = laws.flexible_torque(x[FLEXIBLE], x[FLEXIBLE_RATE], p), laws.flexible_inertia(p)
        out[LINK_RATE] = (b.on_link + x[EXTERNAL] + spring) / (p.Jl - flexible)
        out[FLEXIBLE], out[FLEXIBLE_RATE] = x[FLEXIBLE_RATE], -spring / flexible - out[LINK_RATE]
    else:
        out[LINK_RATE] = (b.on_link + x[EXTERNAL]) / p.Jl


@kernel
def _relax(x, h, time, temperature, p):
    """Advance bristle and Dahl state by `h` [s] at constant velocity: exact."""
    state = state_of(x, UNREAD, time, temperature)
    load = 0.0
    if p.friction_load != 0.0 or p.hysteresis_torque != 0.0:
        t = transmission(x, state, p)
        load = t.load
        if p.hysteresis_torque != 0.0:
            x[DAHL] = laws.dahl_step(x[DAHL], t.torsion_rate, h, p)
    x[BRISTLE] = laws.bristle_step(x[BRISTLE], x[WAVE_RATE], dynamics.sliding_friction(state, load, p), h, p)


@kernel
def substeps(x, dt, p):
    """Return the number of substeps in `dt` [s], by the fastest mode of the springs at their present stiffness."""
    Tw = abs(laws.wave_generator_spring(x[MOTOR] - x[WAVE], p))
    stiffness = p.Kw0 * math.exp(min(p.Cw * Tw, 12.0))  # dTw/dδ of Eq. (3)
    fastest = max(
        stiffness * (1.0 / p.Jm + 1.0 / p.Jw),
        p.K3 * (1.0 / (p.Jl - laws.flexible_inertia(p)) + 1.0 / (p.N * p.N * p.Jw)),
    )
    wanted = dt * max(1.0 / _LONGEST, math.sqrt(fastest) / _TURN)
    most = _MOST * max(1.0, dt / _LONGEST)
    if not wanted < most:  # a diverged state
        return int(most)
    return max(1, math.ceil(wanted - 1e-9))


@kernel
def advance(x, current, command, time, dt, steps, temperature, p, work):
    """Advance a state, shape (SIZE,), by `dt` [s] in substeps, in place: the model's f. d stays; its decay comes
    afterwards.

    `current`, `command`: motor current at the start, and the command in force [A]; `temperature`: of the gear [°C];
    `work`: scratch, shape (3, SIZE), zero at first, as the rate of BRISTLE is never written.
    """
    h = dt / steps
    decay = math.exp(-0.5 * h * p.R / p.L) if p.L > 0.0 else 0.0
    y, total, slope = work[0], work[1], work[2]
    for s in range(2 * steps):
        t = time + (s + 1) // 2 * h
        _relax(x, 0.5 * h, t, temperature, p)
        if s % 2 == 1:
            continue
        # One loop over the four stages instead of four calls: the laws are inlined once.
        i, step = current, 0.0
        y[:] = x
        total[:] = 0.0
        for stage in range(4):
            if stage == 1 or stage == 3:
                i = command + (i - command) * decay
            step = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
            rates(y, i, t + step, temperature, p, slope)
            ahead = h if stage == 2 else 0.5 * h
            for j in range(EXTERNAL):
                y[j] = x[j] + ahead * slope[j]
                total[j] += slope[j] if stage == 0 or stage == 3 else 2.0 * slope[j]
        for j in range(EXTERNAL):
            x[j] += h / 6.0 * total[j]
        current = i


@kernel
def next_current(current, command, dt, p):
    """Return the motor current [A] after `dt` [s] under a command."""
    return command + (current - command) * (math.exp(-dt * p.R / p.L) if p.L > 0.0 else 0.0)


@kernel
def start(motor_position, link_position, arm, time, p, x):
    """Write the state at rest at the first encoder readings into `x`, under the link's weight and an arm's torque on
    it [N·m]."""
    x[:] = 0.0
    x[MOTOR] = dynamics.actual_motor_position(motor_position, p)
    x[LINK] = dynamics.actual_link_position(link_position, x[MOTOR], 0.0, time, p)
    load = -dynamics.link_torque(state_of(x, UNREAD, time, UNREAD), 0.0, p) - arm
    x[WAVE] = x[MOTOR] - laws.wave_generator_torsion(load / p.N, p)


@kernel
def torque_variance(x, P, torque, time, p, noise, H):
    """Return the variance of the joint torque [(N·m)²] by P, the covariance of active states. H: scratch, shape
    (SIZE,)."""
    m = int(noise.count)
    for i in range(m):
        s = int(noise.active[i])
        kept = x[s]
        x[s] += STEPS[s]
        H[i] = (joint_torque(x, time, p) - torque) / STEPS[s]
        x[s] = kept
    total = 0.0
    for i in range(m):
        for j in range(m):
            total += H[i] * P[i, j] * H[j]
    return total
