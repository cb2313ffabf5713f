"""Observers of a rigid payload missing in the description, from the motor current: causal, and over the whole recording.

Its external torque on the link is α sin θl + β cos θl − J θl'' with moments α, β and inertia J about the joint's
axis. The measurement is the torque of the current at the output, less friction without load and the drive's inertia,

    I = c·T + r        T = own torque − external torque + bl θl'
    c = 1 + μ if the motor drives, 1 − κμ if the load does

with the load-dependent friction μ, its share κ while the load drives, and the friction model's error r, which forgets
in `MEMORY`. An extended Kalman filter estimates the state [α, β, J, κ, r]. It cannot see contact: other external
torques end up in r, or in a false payload.

`payload` is causal. Rotor, link and current pass the same low-pass (two of `sensing.lowpass`), so that its regression
stays in phase. The payload's torque is that at the link's present angle. `payload_smoothed` uses the zero-phase
smoother (`smoothed`). It repeats the filter, linearised about its last result, until that converges (Gauss-Newton for
the most probable payload), and gives that payload's torque everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from ...models import dynamics
from ...models.kernels import kernel
from ...models.motion import CUTOFF, smooth
from ...models.parameters import floats
from ...models.signals import Signals
from ...models.step import NOT_FINITE, OK, Step, step_of
from .. import smoothed
from ..estimator import CausalEstimator, Estimator, KnownJoint, Posterior, TuningParameter
from ..sensing import LOWPASS, arm_torque, lowpass, motor_current, temperature

SIZE = 5
MEMORY = 0.5  # correlation time of the friction model's error [s]
PAYLOAD = 0.7  # prior standard deviation of a payload's moments, in rated torques; its inertia's as for a mass at 1 m
NOISE = 0.003  # least noise of an estimate of torque, as a share of the rated torque
FRICTION_ERROR = 0.05  # least error of a friction model, as a share of the friction
INTERVAL = 4e-3  # time between samples [s] for which the noise of the current counts as independent
_AT_REST = 4.0  # noise of friction at rest, in units of its level
_SLOW = 4.0  # its range of speed, in Stribeck velocities


class Seen(NamedTuple):
    """An observer's inputs at an instant: `models.dynamics.State` of the drive, motor acceleration [rad/s²], link
    acceleration [rad/s²], torque on the rotor without Tw [N·m, motor side], own torque of the link [N·m]."""

    state: dynamics.State
    motor_acceleration: float
    link_acceleration: float
    rotor_torque: float
    own_torque: float


class KnownPayload(NamedTuple):
    """A payload: moments α, β [N·m], inertia J [kg·m²]; and the share κ of the load-dependent friction that acts
    while the load drives."""

    payload_sin: float
    payload_cos: float
    payload_inertia: float
    back_driven_friction: float


def friction_error(joint: KnownJoint) -> float:
    """Return the standard deviation [N·m, output side] of the friction model: by its diagnosis, or else its
    tolerance."""
    return float(max(joint.friction, FRICTION_ERROR) * joint.p["N"] * joint.p["Fc"])


def prior(joint: KnownJoint) -> np.ndarray:
    """Return mean and standard deviation of the state, shape (SIZE, 2)."""
    moment = PAYLOAD * joint.rated_torque
    kappa = (float(joint.p["back_driven_friction"]), joint.back_driven)
    return np.array([(0, moment), (0, moment), (0, moment / 9.81), kappa, (0, friction_error(joint))], dtype=np.float64)


def noise(joint: KnownJoint) -> float:
    """Return the standard deviation of I [N·m] at samples `INTERVAL` apart."""
    p = joint.p
    return float(max(1.2 * p["N"] * p["Kt"] * joint.noise.current_noise, 3 * NOISE * joint.rated_torque))


@kernel
def slow_friction(w, p):
    """Return the standard deviation [N·m, output side] of the friction model near rest: presliding, Stribeck."""
    return _AT_REST * p.N * p.Fc * math.exp(-abs(w) / (_SLOW * p.vs))


@kernel
def external_torque(x, link_position, link_acceleration):
    """Return the payload's torque on the link [N·m]."""
    return x[0] * math.sin(link_position) + x[1] * math.cos(link_position) - x[2] * link_acceleration


@kernel
def update(x, P, seen, at, noise, p):
    """Update state x, shape (SIZE,), and covariance P with the inputs of an instant, `Seen`, in place; the bristle of
    its state is not used. The measurement, with a noise [N·m], is linearised about `at`, [α, β, J, κ]."""
    link, a = seen.state.link_position, seen.link_acceleration
    w, v = seen.state.motor_velocity, seen.state.link_velocity
    T = seen.own_torque - external_torque(at, link, a) + p.bl * v
    on = math.tanh(w)  # sign of the velocity, smooth over 1 rad/s
    g = dynamics.sliding_friction(seen.state, 0.0, p)
    sliding = dynamics.drive_state(
        seen.state.motor_position, w, link, v, g / p.s0 * on, dynamics.UNREAD, seen.state.time, seen.state.temperature
    )
    friction = dynamics.mesh_torque(sliding, T, g, p)
    measured = p.N * (seen.rotor_torque - friction - (p.Jm + p.Jw) * seen.motor_acceleration)
    mu = p.friction_load
    c, slope = 1.0 + mu * abs(on), 0.0
    if T * on <= 0.0:
        c, slope = 1.0 - at[3] * mu * abs(on), -mu * abs(on) * T
    H, PH = np.empty(SIZE), np.zeros(SIZE)
    H[0], H[1], H[2], H[3], H[4] = -c * math.sin(link), -c * math.cos(link), c * a, slope, 1.0
    residual = measured - c * T - x[4]
    for j in range(SIZE - 1):
        residual -= H[j] * (x[j] - at[j])
    S = noise * noise + slow_friction(w, p) ** 2
    for i in range(SIZE):
        for j in range(SIZE):
            PH[i] += P[i, j] * H[j]
        S += H[i] * PH[i]
    for i in range(SIZE):
        x[i] += PH[i] / S * residual
        for j in range(SIZE):
            P[i, j] -= PH[i] * PH[j] / S


@kernel
def forget(x, P, share, variance):
    """Let r forget: keep `share` of it, and return its variance to its prior's."""
    x[4] *= share
    P[4, :] *= share
    P[:, 4] *= share
    P[4, 4] += variance * (1.0 - share * share)


# --- the observers -----------------------------------------------------------------------------------------------------

DECIMATION = 4  # grid steps per sample of the regression
_ITERATIONS = 10
_SECOND = 1.5  # cutoff of the second low-pass over that of the first

MEMORY_RECORD = floats(
    ("x", SIZE), ("P", (SIZE, SIZE)), ("motor", LOWPASS, 2), ("link", LOWPASS, 2), ("drive", LOWPASS, 2)
)
SETTINGS = floats("cutoff", "noise", ("prior", (SIZE, 2)))
OUT = floats(
    "torque", "external_torque", "payload_sin", "payload_cos", "payload_inertia", "back_driven_friction", "friction_error",
)  # fmt: skip


@kernel
def _lowpass_twice(m, u, interval, cutoff):
    lowpass(m[0], u, interval, cutoff)
    lowpass(m[1], m[0].value, interval, _SECOND * cutoff)


@step_of(MEMORY_RECORD, SETTINGS, OUT)
def _step(m, s, p, c, o):
    x, P, h = m.x, m.P, s.interval
    motor = dynamics.actual_motor_position(s.motor_position, p)
    _lowpass_twice(m.motor, motor, h, c.cutoff)
    link = motor / p.N
    if not math.isnan(s.link_position):
        link = dynamics.actual_link_position(s.link_position, motor, m.motor[1].rate, s.time, p)
    _lowpass_twice(m.link, link, h, c.cutoff)
    w, v, a = m.motor[1].rate, m.link[1].rate, m.link[1].acceleration
    heat = temperature(s, p)
    current = motor_current(s, motor, link, w, 0.0, p)
    now = dynamics.drive_state(motor, w, link, v, dynamics.UNREAD, current, s.time, heat)
    _lowpass_twice(m.drive, dynamics.rotor_torque(now, 0.0, 0.0, p), h, c.cutoff)
    if h == 0.0:
        for i in range(SIZE):
            x[i], P[i, i] = c.prior[i, 0], c.prior[i, 1] ** 2
    else:
        forget(x, P, math.exp(-h / MEMORY), c.prior[4, 1] ** 2)
        seen = dynamics.drive_state(m.motor[1].value, w, m.link[1].value, v, dynamics.UNREAD, current, s.time, heat)
        own = p.Jl * a - dynamics.link_torque(seen, 0.0, p) - arm_torque(s)
        update(x, P, Seen(seen, m.motor[1].acceleration, a, m.drive[1].value, own), x.copy(), c.noise, p)
    o.external_torque = external_torque(x, link, a)
    o.torque = p.Jl * a - dynamics.link_torque(now, 0.0, p) - arm_torque(s) - o.external_torque
    o.payload_sin, o.payload_cos, o.payload_inertia = x[0], x[1], x[2]
    o.back_driven_friction, o.friction_error = x[3], x[4]
    return OK if math.isfinite(o.torque) else NOT_FINITE


@dataclass(frozen=True)
class PayloadObserver(CausalEstimator):
    """Observer of a rigid payload, causal."""

    name: str = "payload"
    cutoff: float = 40.0  # of the low-pass [Hz]
    needs: ClassVar[tuple[str, ...]] = ("motor_position", "motor_current")
    tuning: ClassVar[tuple[TuningParameter, ...]] = (TuningParameter("cutoff", 1.0, 300.0),)
    description: ClassVar[str] = "observer of a rigid payload from the motor current; blind to contact"
    compiled: ClassVar[Step] = _step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = np.zeros(1, SETTINGS)
        found["cutoff"], found["prior"] = 2 * math.pi * self.cutoff, prior(joint)
        found["noise"] = noise(joint) * math.sqrt(INTERVAL / interval)
        return found


@dataclass(frozen=True)
class PayloadSmoothed(Estimator):
    """The rigid payload of the whole recording; not causal."""

    name: str = "payload_smoothed"
    # allowed noise of the estimate from current [rated torques], which decides the bandwidth of the motion
    quiet: float = smoothed.QUIET
    causal: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ("motor_position", "motor_current")
    tuning: ClassVar[tuple[TuningParameter, ...]] = (TuningParameter("quiet", 1e-4, 0.1),)
    description: ClassVar[str] = (
        "the rigid payload that the whole recording shows, from the motor current; blind to contact"
    )

    def estimate(self, signals: Signals, joint: KnownJoint) -> Posterior:
        found, x = self._observed(signals, joint)
        return replace(found, columns={name: np.full(len(signals.time), value) for name, value in x._asdict().items()})

    def torques(self, signals: Signals, joint: KnownJoint) -> Posterior:
        return self._observed(signals, joint)[0]

    def _observed(self, signals: Signals, joint: KnownJoint) -> tuple[Posterior, KnownPayload]:
        for name in self.needs:
            signals[name]
        current = slow_current(signals)  # before the motion takes memory
        motion = smoothed.smooth_motion(signals, joint, smoothed.bandwidth(signals, joint, self.quiet))
        own = smoothed.own_torque(motion, joint, smoothed.torque_from_current(motion, joint))
        own -= smoothed.arm_torque(motion, signals)
        x = observe(joint, motion.every(DECIMATION), own[::DECIMATION], current)
        grid, external = motion.time, _external_torques(np.array(x[:4]), motion.link_position, motion.link_acceleration)
        del motion
        own -= external
        torque, external = (np.interp(signals.time, grid, values) for values in (own, external))
        return Posterior(self.name, signals.time, torque, external=external), x


def slow_current(signals: Signals) -> np.ndarray:
    """Return the current [A] for `observe`, shape (n,): smoothed, at every `DECIMATION`-th point of the grid."""
    read = signals["motor_current"][:, None]
    return np.ascontiguousarray(smooth(signals.time, read, smoothed.STEP, CUTOFF, DECIMATION).value[:, 0])


def observe(joint: KnownJoint, motion: smoothed.Motion, own: np.ndarray, current: np.ndarray) -> KnownPayload:
    """Return the payload of a part of a recording, by `smoothed.smooth_motion`, `smoothed.own_torque` [N·m] and
    `slow_current` [A], shape (n,), at every `DECIMATION`-th point of the grid."""
    given = joint.record, prior(joint), noise(joint), math.exp(-smoothed.STEP * DECIMATION / MEMORY)
    own = np.ascontiguousarray(own)
    x = _filter(motion, current, own, *given, np.empty(0))
    # Repeat, linearised about the last result.
    for _ in range(_ITERATIONS):
        about = x[:4].copy()
        x = _filter(motion, current, own, *given, about)
        if np.allclose(x[:4], about, rtol=1e-3, atol=1e-3):
            break
    return KnownPayload(*map(float, x[:4]))


@kernel
def _external_torques(x, link, a):
    return np.array([external_torque(x, link[i], a[i]) for i in range(len(a))])


@kernel
def _filter(m, current, own, record, prior, noise, share, about):
    p = record[0]
    x, P = prior[:, 0].copy(), np.diag(prior[:, 1] ** 2)
    for i in range(len(own)):
        if i > 0:
            forget(x, P, share, prior[4, 1] ** 2)
        at = about if len(about) > 0 else x[:4].copy()
        motor, w, since = m.motor_position[i], m.motor_velocity[i], m.since[i]
        link, v, a = m.link_position[i], m.link_velocity[i], m.link_acceleration[i]
        T = own[i] - external_torque(at, link, a) + p.bl * v
        actual = dynamics.actual_motor_current(current[i], motor, link, w, T, since, p)
        state = dynamics.drive_state(motor, w, link, v, dynamics.UNREAD, actual, since, m.temperature[i])
        seen = Seen(state, m.motor_acceleration[i], a, dynamics.rotor_torque(state, 0.0, T, p), own[i])
        update(x, P, seen, at, noise, p)
    return x


ESTIMATORS = (PayloadObserver(), PayloadSmoothed())
