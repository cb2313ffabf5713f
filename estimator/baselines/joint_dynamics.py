"""The joint as a stochastic state-space model, for the estimators that know its dynamics. Compiled.

State x, shape (SIZE,):

    θm, ωm    rotor                          [rad], [rad/s], motor side
    θw, ωw    wave generator                 [rad], [rad/s], motor side
    z         LuGre bristle                  [rad], motor side
    θl, ωl    link                           [rad], [rad/s]
    τext      external torque on the link    [N·m], random walk
    d         what mesh friction does beyond the record [N·m, motor side], Ornstein-Uhlenbeck
    κ, κt     relative deviations of stiffness and torque constant from the record [1], constant
    x_h       Dahl state of the flexspline's hysteresis [rad]

An estimator carries the covariance of the *active* ones of these: κ and κt where it is asked to calibrate itself, x_h where
the record has hysteresis.

The laws are those of `models.laws`. Between samples the current follows its command with the winding's time constant
L/R. One step is Strang's splitting: the stiff bristle and the Dahl state by their exact solutions at constant
velocity for half a substep, the mechanics by the classical Runge-Kutta method for a whole one, the bristle again.
Substeps are chosen so that the fastest spring turns by no more than 0.8 rad in each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from ...models import laws
from ...models.errors import InputError
from ...models.parameters import PARAMETERS, PLACES
from ..knobs import Knob
from .base import JointSignals, SensorNoise
from .quantised import update

STATES = (
    "motor_position", "motor_velocity", "wave_generator_position", "wave_generator_velocity", "bristle",
    "link_position", "link_velocity", "external_torque", "mesh_torque", "stiffness", "motor_constant", "hysteresis",
)  # fmt: skip
SIZE = len(STATES)
MOTOR, MOTOR_RATE, WAVE, WAVE_RATE, BRISTLE, LINK, LINK_RATE, EXTERNAL, MESH, STIFFNESS, CONSTANT, DAHL = range(SIZE)
STEPS = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1e-6, 1e-7, 1e-4, 1e-3, 1e-5, 1e-4, 1e-4, 1e-7])
"""Steps of the differences that stand for derivatives, per state: small against its uncertainty, large against rounding."""
_LONGEST = 0.5e-3  # s: substep
_TURN = 0.8  # rad of the fastest mode per substep
_MOST = 10.0  # substeps per _LONGEST
_PLACE_ROTOR, _PLACE_MESH, _PLACE_FLEXSPLINE, _PLACE_LINK, _PLACE_TORQUE, _PLACE_READING = (
    PLACES.index(name) for name in ("rotor", "mesh", "flexspline", "link", "joint_torque", "link_position")
)


@dataclass(frozen=True)
class ProcessNoise:
    """How far a joint departs from its equations. One setting for every scenario; scaled by the record, SI.

    Attributes:
        external: intensity of the random walk of τext [T2/√s]. Quiet: 0.001·12 N·m is 0.08 N·m in 40 s, the 1 % to
            which a link's weight is known.
        push: intensity while the link encoder contradicts the prediction [T2/√s]. Loud: 4·12 N·m is the rated torque in 0.1 s.
        mesh: standard deviation of d [Fc]; what a friction model leaves when it is good.
        mesh_push: intensity of d while the motor encoder contradicts the prediction [Fc/√s]: another level in 1 s.
        mesh_time: correlation time of d [s].
        torque: white noise of torque at the mesh [Fc·√s]: ripple, discretisation.
        bristle: noise of z [Fc/s0 per √s].
        stiffness, motor_constant: standard deviation of κ, κt [1]; 0 leaves them out.
        memory: share of the mean NIS of an encoder that it keeps per sample; 0.8 is 5 samples.
        threshold: mean NIS from which on the noise grows, and where it has grown in full. 1 is expected; at 5 samples
            it scatters by 0.5.
        floor: noise of the motor encoder that is assumed even where none is stated [counts].
    """

    external: float = 0.001
    push: float = 4.0
    mesh: float = 0.017
    mesh_push: float = 1.1
    mesh_time: float = 5.0
    torque: float = 5.5e-4
    bristle: float = 5.5e-3
    stiffness: float = 0.0
    motor_constant: float = 0.0
    memory: float = 0.8
    threshold: tuple[float, float] = (3.0, 6.0)
    floor: float = 0.05

    def matrices(self, signals: JointSignals, p: np.void, noise: SensorNoise) -> Noise:
        """Return the noise for a joint and its sensors as arrays for compiled code."""
        start, walk = np.zeros(SIZE), np.zeros(SIZE)
        counts = noise.motor_resolution
        start[[MOTOR, WAVE]] = counts**2 + noise.motor_noise**2, (0.1 / (p["Cw"] * p["Kw0"])) ** 2
        start[[MOTOR_RATE, WAVE_RATE, LINK_RATE]] = 1.0, 1.0, p["N"] ** -2.0
        start[LINK] = noise.link_resolution**2 + noise.link_noise**2
        start[BRISTLE] = (p["Fs"] / p["s0"]) ** 2
        start[EXTERNAL], start[MESH] = (0.2 * p["T2"]) ** 2, (self.mesh * p["Fc"]) ** 2
        start[STIFFNESS], start[CONSTANT] = self.stiffness**2, self.motor_constant**2
        start[DAHL] = p["hysteresis_extent"] ** 2
        if signals.current_command is None:  # the reading's noise is a torque, held from sample to sample
            walk[MOTOR_RATE] = (p["Kt"] * noise.current_noise / p["Jm"]) ** 2 * np.median(np.diff(signals.time))
        walk[WAVE_RATE] = (self.torque * p["Fc"] / p["Jw"]) ** 2
        walk[BRISTLE] = (self.bristle * p["Fc"] / p["s0"]) ** 2
        walk[EXTERNAL] = (self.external * p["T2"]) ** 2
        walk[MESH] = 2.0 * (self.mesh * p["Fc"]) ** 2 / self.mesh_time
        walk[STIFFNESS], walk[CONSTANT] = 1e-8 * (self.stiffness > 0), 1e-8 * (self.motor_constant > 0)
        walk[DAHL] = (0.01 * p["hysteresis_extent"]) ** 2
        active = [i for i in range(SIZE) if not (i in (STIFFNESS, CONSTANT) and start[i] == 0.0)]
        if p["hysteresis_torque"] == 0.0:
            active.remove(DAHL)
        return Noise(
            np.array(active),
            start,
            walk,
            np.array([(self.mesh_push * p["Fc"]) ** 2, (self.push * p["T2"]) ** 2]),
            np.array([noise.motor_noise**2 + (self.floor * counts) ** 2, noise.link_noise**2]),
            np.array([counts, noise.link_resolution]),
            np.array([self.mesh_time, self.memory, *self.threshold]),
        )


PROCESS_KNOBS = (
    Knob("process.push", 0.05, 100.0),
    Knob("process.external", 1e-5, 1.0),
    Knob("process.mesh", 1e-4, 0.5),
    Knob("process.mesh_push", 1e-2, 30.0),
)
"""What tuning may turn of `ProcessNoise`, for estimators that have one as `process`."""


class Noise(NamedTuple):
    """Arrays for compiled code: active states (m,); start and walk: diagonals of P(0) and of the noise per second, (SIZE,);
    surge: of d and τext per second (2,); variance and step of the encoders (2,), (2,); mesh_time, memory, threshold (4,)."""

    active: np.ndarray
    start: np.ndarray
    walk: np.ndarray
    surge: np.ndarray
    variance: np.ndarray
    step: np.ndarray
    rule: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def flexspline_torque(x, p):
    """Return Tf [N·m] with damping and hysteresis, without nonparametric terms; and 1/N − θerr'(θw)."""
    slope = 1.0 / p.N - laws.kinematic_error_slope(x[WAVE], p)
    torsion = x[WAVE] / p.N - x[LINK] - laws.kinematic_error(x[WAVE], p)
    rate = x[WAVE_RATE] * slope - x[LINK_RATE]
    torque = laws.flexspline_spring((1.0 + x[STIFFNESS]) * torsion, p) + laws.hysteresis_torque(x[DAHL], p)
    return torque + p.df * rate, slope


@njit(cache=True, nogil=True, error_model="numpy")
def joint_torque(x, time, p):
    """Return the joint torque as the force/torque sensor reads it [N·m] at a state: gain and offset of Tf − bl·ωl."""
    torque, _ = flexspline_torque(x, p)
    if laws.has_terms(p):
        torque += laws.term(_PLACE_FLEXSPLINE, x[MOTOR], x[LINK], x[WAVE_RATE], torque, time, p)
        return laws.torque_reading(torque - p.bl * x[LINK_RATE], time, p) + laws.term(
            _PLACE_TORQUE, x[MOTOR], x[LINK], x[WAVE_RATE], torque, time, p
        )
    return laws.torque_reading(torque - p.bl * x[LINK_RATE], time, p)


@njit(cache=True, nogil=True, error_model="numpy")
def link_encoder(x, time, p):
    """Return what the link encoder reads [rad] at a state, its delay to first order."""
    reading = laws.link_reading(x[LINK] - p.link_delay * x[LINK_RATE], p)
    if laws.has_terms(p):
        reading += laws.term(_PLACE_READING, x[MOTOR], x[LINK], x[WAVE_RATE], 0.0, time, p)
    return reading


@njit(cache=True, nogil=True, error_model="numpy")
def rates(x, current, time, p, out):
    """Write the rates of the six mechanical states into `out`, shape (SIZE,); the others' are zero here."""
    Tf, slope = flexspline_torque(x, p)
    w = x[WAVE_RATE]
    Tw = laws.wave_generator_spring(x[MOTOR] - x[WAVE], p) + p.dw * (x[MOTOR_RATE] - w)
    g = laws.friction_level(w, x[LINK], Tf, time, p)
    rotor = p.Kt * (1.0 + x[CONSTANT]) * current - p.bm * x[MOTOR_RATE] + laws.rotor_torque(x[MOTOR], p) - Tw
    mesh = Tw - laws.mesh_friction(x[BRISTLE], w, g, p) - p.bw * w + x[MESH]
    link = laws.gravity_torque(x[LINK], p) + laws.link_torque(x[LINK], p) + x[EXTERNAL] - p.bl * x[LINK_RATE]
    if laws.has_terms(p):
        load = Tf
        Tf += laws.term(_PLACE_FLEXSPLINE, x[MOTOR], x[LINK], w, load, time, p)
        rotor += laws.term(_PLACE_ROTOR, x[MOTOR], x[LINK], w, load, time, p)
        mesh -= laws.term(_PLACE_MESH, x[MOTOR], x[LINK], w, load, time, p)
        link += laws.term(_PLACE_LINK, x[MOTOR], x[LINK], w, load, time, p)
    out[MOTOR], out[MOTOR_RATE] = x[MOTOR_RATE], rotor / p.Jm
    out[WAVE], out[WAVE_RATE] = w, (mesh - Tf * slope) / p.Jw
    out[LINK], out[LINK_RATE] = x[LINK_RATE], (Tf + link) / p.Jl


@njit(cache=True, nogil=True, error_model="numpy")
def _relax(x, h, time, p):
    """Bristle and Dahl state over `h` [s] at constant velocity: exact."""
    Tf, slope = 0.0, 0.0
    if p.friction_load != 0.0 or p.hysteresis_torque != 0.0:
        Tf, slope = flexspline_torque(x, p)
    if p.hysteresis_torque != 0.0:
        x[DAHL] = laws.dahl_step(x[DAHL], x[WAVE_RATE] * slope - x[LINK_RATE], h, p)
    g = laws.friction_level(x[WAVE_RATE], x[LINK], Tf, time, p)
    x[BRISTLE] = laws.bristle_step(x[BRISTLE], x[WAVE_RATE], g, h, p)


@njit(cache=True, nogil=True, error_model="numpy")
def substeps(x, dt, p):
    """Return how many substeps a time `dt` [s] takes: the fastest mode of the springs at their present stiffness."""
    Tw = abs(laws.wave_generator_spring(x[MOTOR] - x[WAVE], p))
    stiffness = p.Kw0 * math.exp(min(p.Cw * Tw, 12.0))  # dTw/dδ of Eq. (3)
    fastest = max(stiffness * (1.0 / p.Jm + 1.0 / p.Jw), p.K3 * (1.0 / p.Jl + 1.0 / (p.N * p.N * p.Jw)))
    wanted = dt * max(1.0 / _LONGEST, math.sqrt(fastest) / _TURN)
    most = _MOST * max(1.0, dt / _LONGEST)
    if not wanted < most:  # a state that has gone astray, or is no number any more
        return int(most)
    return max(1, math.ceil(wanted - 1e-9))


@njit(cache=True, nogil=True, error_model="numpy")
def advance(x, current, command, time, dt, steps, forget, p, work):
    """Advance a state by `dt` [s], in place.

    Args:
        x: Shape (SIZE,).
        current, command: motor current at the start, and the command in force [A].
        time: at the start [s].
        steps: substeps.
        forget: factor by which d decays in `dt`.
        work: Shape (3, SIZE), scratch, zero at first: the rate of BRISTLE is never written.
    """
    h = dt / steps
    decay = math.exp(-0.5 * h * p.R / p.L) if p.L > 0.0 else 0.0
    y, total, slope = work[0], work[1], work[2]
    for s in range(2 * steps):
        t = time + (s + 1) // 2 * h
        _relax(x, 0.5 * h, t, p)
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
            rates(y, i, t + step, p, slope)
            ahead = h if stage == 2 else 0.5 * h
            for j in range(EXTERNAL):
                y[j] = x[j] + ahead * slope[j]
                total[j] += slope[j] if stage == 0 or stage == 3 else 2.0 * slope[j]
        for j in range(EXTERNAL):
            x[j] += h / 6.0 * total[j]
        current = i
    x[MESH] *= forget


@njit(cache=True, nogil=True, error_model="numpy")
def next_current(current, command, dt, p):
    """Return the motor current [A] after `dt` [s] under a command."""
    return command + (current - command) * (math.exp(-dt * p.R / p.L) if p.L > 0.0 else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def start(motor_position, link_position, p, x):
    """Write the state at rest at the first encoder readings, under the link's weight, into `x`."""
    x[:] = 0.0
    x[MOTOR] = motor_position
    x[LINK] = link_position - p.link_zero
    load = -laws.gravity_torque(x[LINK], p) - laws.link_torque(x[LINK], p)
    x[WAVE] = motor_position - laws.wave_generator_torsion(load / p.N, p)


def known(record: np.ndarray) -> np.void:
    """Return the one parameter record of `record`, shape (1,); `InputError` where it is none."""
    if getattr(record, "dtype", None) != PARAMETERS or record.shape != (1,):
        raise InputError(f"estimator: record: expected a parameter record of shape (1,), got {type(record).__name__}")
    return record[0]


def outputs(n: int) -> tuple[np.ndarray, ...]:
    """Return zeros for a filter to fill: states (n, SIZE), torque (n,), variance (n,), innovations (n, 2), variances (n, 2)."""
    return np.zeros((n, SIZE)), np.zeros(n), np.zeros(n), np.zeros((n, 2)), np.zeros((n, 2))


def drive_current(signals: JointSignals, p: np.void) -> np.ndarray:
    """Current in force until each sample, shape (n,) [A]; the first value is where it starts."""
    reading = signals.motor_current - p["current_offset"]
    return reading if signals.current_command is None else np.r_[reading[0], signals.current_command[:-1]]


@njit(cache=True, nogil=True, error_model="numpy")
def propagate(F, P, A):
    """P ← F P Fᵀ in place, shape (m, m), symmetric; A: like F, scratch."""
    m = len(F)
    for i in range(m):
        for j in range(m):
            total = 0.0
            for l in range(m):
                total += F[i, l] * P[l, j]
            A[i, j] = total
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for l in range(m):
                total += A[i, l] * F[j, l]
            P[i, j] = total
            P[j, i] = total


@njit(cache=True, nogil=True, error_model="numpy")
def add_noise(P, dt, ratio, noise):
    """Add the process noise of `dt` [s] to P, shape (m, m); more of it where the encoders' mean NIS `ratio` (2,) is high."""
    low, high = noise.rule[2], noise.rule[3]
    for i in range(len(noise.active)):
        s = noise.active[i]
        P[i, i] += noise.walk[s] * dt
        if s == MESH:
            P[i, i] += noise.surge[0] * dt * min(max((ratio[0] - low) / (high - low), 0.0), 1.0)
        elif s == EXTERNAL:
            P[i, i] += noise.surge[1] * dt * min(max((ratio[1] - low) / (high - low), 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def measure(x, P, motor, link, time, ratio, noise, p, e, S, H, PH):
    """Update with both encoders, one after the other, in place; writes innovations and variances to e, S, shape (2,).

    H, PH: Shape (m,), scratch. The link's innovation is the one given the motor's: they are uncorrelated.
    """
    active, memory = noise.active, noise.rule[1]
    m = len(active)
    H[:] = 0.0
    H[MOTOR] = 1.0
    for sensor in range(2):
        if sensor == 0:
            e[0] = motor - x[MOTOR]
        else:
            predicted = link_encoder(x, time, p)
            x[LINK] += 1e-5
            slope = (link_encoder(x, time, p) - predicted) / 1e-5
            x[LINK] -= 1e-5
            H[MOTOR], H[LINK], H[LINK_RATE] = 0.0, slope, -p.link_delay * slope
            e[1] = link - predicted
        S[sensor] = update(x, P, active, H[:m], e[sensor], noise.variance[sensor], noise.step[sensor], PH)
        S[sensor] += noise.step[sensor] ** 2 / 12.0
        ratio[sensor] = memory * ratio[sensor] + (1.0 - memory) * e[sensor] ** 2 / S[sensor]


@njit(cache=True, nogil=True, error_model="numpy")
def torque_variance(x, P, torque, time, p, active, H):
    """Return the variance of the joint torque [(N·m)²] that P, shape (m, m), means."""
    for i in range(len(active)):
        s = active[i]
        kept = x[s]
        x[s] += STEPS[s]
        H[i] = (joint_torque(x, time, p) - torque) / STEPS[s]
        x[s] = kept
    total = 0.0
    for i in range(len(active)):
        for j in range(len(active)):
            total += H[i] * P[i, j] * H[j]
    return total
