"""Observers of a rigid payload (`payload_model`) from the motor current: causal, and over the whole recording.

`payload` is causal. Rotor, link and current pass the same low-pass (two of `sensing.lowpass`), so that its regression
stays in phase. The payload's torque is that at the link's present angle. `payload_smoothed` uses the zero-phase
smoother (`smoothed`). It repeats the filter, linearised about its last result, until that converges (Gauss-Newton for
the most probable payload), and gives that payload's torque everywhere. Both cannot see contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...models import dynamics
from ...models.kernels import kernel
from ...models.motion import CUTOFF, smooth
from ...models.parameters import floats
from ...models.signals import Signals
from ...models.step import NOT_FINITE, OK, Step, step_of
from .. import smoothed
from ..estimator import CausalEstimator, Estimator, KnownJoint, Posterior
from ..payload_model import INTERVAL, MEMORY, SIZE, KnownPayload, Seen, external_torque, forget, noise, prior, update
from ..sensing import LOWPASS, arm_torque, lowpass, motor_current, temperature
from ..tuning_parameters import TuningParameter

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
