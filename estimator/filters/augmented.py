"""Augmented Kalman filter: joint torque, external torque, and what is not known of the joint, as one state.

A joint's numbers are known within tolerances. The torque that torsion means is fast, and wrong by whatever stiffness, zero,
kinematic error and wave generator's compliance are off; the torque that current and friction mean is right within a few per
cent while the joint slides, and unknown at rest; the link's own weight and inertia say what torque it takes as long as nobody
touches it. Errors of these three have different shapes, so that each of them shows in the two others where, and only where, it
can be told from them. The state carries them with the tolerances as prior (a Schmidt–Kalman filter where nothing is
observable: what does not show keeps its variance, and the variance of the torque says so):

    θl, ωl    link                                       ωl' = (T + τ + (1 + μ)·link torques)/Jl
    T         joint torque Ts                            random walk beside what weight, or in contact the spring, does
    τ         external torque                            random walk, quiet or loud; nothing most of the time
    ε         place within the motor encoder's count     kept while the count stays, new with every count
    κ, ζ      stiffness [1], zero of the link encoder    constant
    β, χ      Kw0, Cw of the wave generator [1]          constant
    μ         weight [1]                                 constant
    f, κt     friction, torque constant [1]              constant
    a_k, b_k  quadratures of kinematic error             constant, of the largest orders

Measurements are scalar, one after the other, with Δθf, Tw and the wave generator's torsion δ as they come from the readings:

    θl        link encoder
    k(Δθf) =  T + bl·ωl − κ·k(Δθf) − K·(ζ + ε − Σ(a_k sin kθw + b_k cos kθw) + (β·δ + χ·(δ − Tw·exp(−Cw|Tw|)/Kw0))/N)
    T_i    =  T − N·(f·friction·sgn ωm − κt·Kt·i)        from the current (`current`), while friction slides one way
    0      =  τ                                          while τ is within its own uncertainty of nothing

Regressors are predictions (κ·T, not κ·k(Δθf)): one that shares its noise with the innovation would be learned from noise
(errors in variables). Constants are learned only in calm, and not from every sample: what the laws leave out is no white noise.
In between they are considered, not estimated (Schmidt 1966).

Times since something happened are sums of intervals, and readings of one count may differ by rounding: both are compared half
a sample or half a count beside where they fall, so that no rounding decides.

Counts are cells, not noise: at rest a count says the same thing again and again, which ε has learned once. Contacts are rare:
τ and T walk loudly only while the innovations of encoder or torsion are larger than their variance (adaptive process noise,
Mehra 1972, as in `dynamics_filter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from ...models import dynamics, laws
from ...models.kernels import kernel
from ...models.pointers import pointer_to, record_at
from ...models.step import Step, sample_at
from ..compliance import TORSION, measure
from ..estimator import CausalEstimator, KnownJoint, fields_of
from ..sensing import LOWPASS, lowpass, temperature
from ..tuning_parameters import TuningParameter
from .current import MEMORY as CURRENT
from .current import SETTINGS as CURRENT_SETTINGS
from .current import torque_of_current

ORDERS = 3
"""Orders of kinematic error whose error is estimated."""
LINK, RATE, TORQUE, EXTERNAL, COUNT, STIFFNESS, ZERO, WAVE, CURVE, WEIGHT, FRICTION, CONSTANT, KINEMATIC = range(13)
SIZE = KINEMATIC + 2 * ORDERS
_FIELDS = (
    "link_variance", "torsion_variance", "ripple", "torque_quiet", "torque_loud", "external_quiet", "external_loud", "free",
    "gate", "current_variance", "sliding", "settled", "memory", "low", "high", "wander", "cutoff", "back", "pause", "every",
    "wait", "least", "drive", "ringing", "half",
)  # fmt: skip
SETTINGS = np.dtype(
    [(name, np.float64) for name in _FIELDS]
    + [("prior", np.float64, SIZE), ("order", np.float64, ORDERS), ("current", CURRENT_SETTINGS)]
)
MEMORY = np.dtype(
    [
        ("torsion", TORSION), ("current", CURRENT), ("motor_torque", LOWPASS), ("drive", LOWPASS),
        ("x", np.float64, SIZE), ("P", np.float64, (SIZE, SIZE)), ("H", np.float64, SIZE), ("PH", np.float64, SIZE),
        *((name, np.float64) for name in (
            "motor_reading", "torsion_ratio", "link_ratio", "calm", "loud", "untouched", "slid", "direction",
        )),
    ]
)  # fmt: skip
"""What `measure` and `torque_of_current` remember; motor torque and drive behind low-passes; state, covariance, scratch; last
reading of the motor encoder; mean NIS of torsion and link encoder; times [s] since either was loud, and of sliding one way."""
OUT = np.dtype([(n, np.float64) for n in (
    "torque", "variance", "innovation", "innovation_variance", "external_torque", "stiffness_error", "zero_error",
    "wave_generator_error", "weight_error", "friction_error", "constant_error",
)])  # fmt: skip
_LATE = 3.0
"""Error [counts of the motor encoder] of a link encoder's late reading that is carried on."""
_memory_at, _settings_at, _out_at = pointer_to(MEMORY), pointer_to(SETTINGS), pointer_to(OUT)


@kernel
def _update(m, e, variance, learn):
    """Update with a scalar innovation along `m.H`; returns its variance S. Without `learn` what is constant is considered and
    not changed (Schmidt 1966)."""
    x, P, H, PH = m.x, m.P, m.H, m.PH
    S = variance
    for i in range(SIZE):
        total = 0.0
        for j in range(SIZE):
            if H[j] != 0.0:
                total += P[i, j] * H[j]
        PH[i] = total
    for i in range(SIZE):
        S += H[i] * PH[i]
    for i in range(SIZE):
        gain = PH[i] / S
        if gain == 0.0:
            continue
        changed = learn or i < STIFFNESS
        if changed:
            x[i] += gain * e
        for j in range(i + 1 if changed else STIFFNESS):
            P[i, j] -= gain * PH[j]
            P[j, i] = P[i, j]
    return S


@kernel
def _share(ratio, c):
    return min(max((ratio - c.low) / (c.high - c.low), 0.0), 1.0)


@kernel
def _start(m, reading, link, p, c):
    """Begin at rest at the first readings."""
    m.x[:] = 0.0
    m.P[:] = 0.0
    m.x[LINK] = link
    for i in range(SIZE):
        m.P[i, i] = c.prior[i] ** 2
    m.motor_reading, m.torsion_ratio, m.link_ratio = reading, 1.0, 1.0


@kernel
def _predict(m, weight, slope, stiffness, driven, h, p, c):
    """Move on by `h` [s], torque first, then velocity, then angle: stable as long as the spring turns less than 2 rad.

    Args:
        weight: link torques [N·m] at x; slope: of them over the link's angle [N·m/rad].
        stiffness: of transmission and wave generator in series [N·m/rad]; driven: velocity of the drive [rad/s, output side].
    """
    x, P = m.x, m.P
    loud, touched = _share(m.torsion_ratio, c), _share(m.link_ratio, c)
    loud = max(loud, touched)
    m.loud = loud if loud > m.loud else m.loud + (1.0 - math.exp(-h / c.ringing)) * (loud - m.loud)
    spring, a = m.loud * h * min(stiffness, p.Jl / (h * h)), h / p.Jl
    creep = (1.0 - m.loud) * h * slope
    x[TORQUE] += spring * (driven - x[RATE]) - creep * x[RATE]
    x[RATE] += a * (x[TORQUE] + x[EXTERNAL] + (1.0 + x[WEIGHT]) * weight)
    x[LINK] += h * x[RATE]
    for j in range(SIZE):  # F P
        P[TORQUE, j] -= (spring + creep) * P[RATE, j]
        P[RATE, j] += a * (P[TORQUE, j] + P[EXTERNAL, j] + slope * P[LINK, j] + weight * P[WEIGHT, j])
        P[LINK, j] += h * P[RATE, j]
    for j in range(SIZE):  # (F P) Fᵀ
        P[j, TORQUE] -= (spring + creep) * P[j, RATE]
        P[j, RATE] += a * (P[j, TORQUE] + P[j, EXTERNAL] + slope * P[j, LINK] + weight * P[j, WEIGHT])
        P[j, LINK] += h * P[j, RATE]
    for i in range(SIZE):
        for j in range(i):
            P[i, j] = P[j, i]
    P[TORQUE, TORQUE] += h * (c.torque_quiet**2 + loud * c.torque_loud**2)
    P[EXTERNAL, EXTERNAL] += h * (c.external_quiet**2 + touched * c.external_loud**2)
    P[ZERO, ZERO] += c.wander**2 * h * abs(x[RATE])


@kernel
def _softness(torque, p):
    """Compliance of the wave generator [rad/(N·m), motor side] at a torque [N·m, motor side]: Eq. (4) inverted."""
    return math.exp(-p.Cw * abs(torque)) / p.Kw0


@kernel
def _new_count(m, c):
    """The motor encoder's count has changed: where within it is anyone's guess."""
    m.x[COUNT] = 0.0
    for j in range(SIZE):
        m.P[COUNT, j] = 0.0
        m.P[j, COUNT] = 0.0
    m.P[COUNT, COUNT] = c.prior[COUNT] ** 2


@Step
def _step(memory, sample, record, settings, out):
    m, s, p = carray(_memory_at(memory), 1)[0], carray(sample_at(sample), 1)[0], carray(record_at(record), 1)[0]
    c, o, h = carray(_settings_at(settings), 1)[0], carray(_out_at(out), 1)[0], s.interval
    x, P, H = m.x, m.P, m.H
    found = measure(m.torsion, s, p)
    by_current = torque_of_current(m.current, s, c.current, p)
    lowpass(m.drive, found.motor_position, h, c.drive)
    lowpass(m.motor_torque, found.motor_torque, h, c.cutoff)
    theta, w = found.wave_generator_position, m.current.motor.rate
    # Calm for a while, and not at every sample: what the laws leave is no white noise.
    calm = m.torsion_ratio < c.low and m.link_ratio < c.low
    m.calm = m.calm + h if calm else 0.0
    learn = m.calm > c.pause - 0.5 * h
    if learn:
        m.calm -= c.every
    if h == 0.0:
        _start(m, s.motor_position, found.link_position, p, c)
        x[TORQUE] = found.torque
    still = dynamics.drive_state(found.motor_position, w, x[LINK], x[RATE], 0.0, 0.0, s.time, temperature(s, p))
    weight = dynamics.link_torque(still, x[TORQUE], p)
    if h > 0.0:
        ahead = dynamics.drive_state(
            found.motor_position, w, x[LINK] + 1e-4, x[RATE], 0.0, 0.0, s.time, temperature(s, p)
        )
        slope = (dynamics.link_torque(ahead, x[TORQUE], p) - weight) / 1e-4
        ratio = 1.0 / p.N - laws.kinematic_error_slope(theta, p)
        yielding = 1.0 / laws.flexspline_stiffness(found.torsion, p) + _softness(m.motor_torque.value, p) / p.N**2
        _predict(m, weight, slope, 1.0 / yielding, m.drive.rate * ratio, h, p, c)
        if not abs(s.motor_position - m.motor_reading) <= c.half:
            _new_count(m, c)
        m.motor_reading = s.motor_position
        # The link encoder.
        H[:] = 0.0
        H[LINK] = 1.0
        e = found.link_position - x[LINK]
        S = _update(m, e, c.link_variance, learn)
        m.link_ratio = c.memory * m.link_ratio + (1.0 - c.memory) * e * e / S
    # Torsion.
    Tw = m.motor_torque.value
    wound, asked = laws.wave_generator_torsion(Tw, p), laws.wave_generator_torsion(found.motor_torque, p)
    torsion = found.torsion + (asked - wound) / p.N
    seen = found.torque + laws.flexspline_spring(torsion, p) - laws.flexspline_spring(found.torsion, p)
    K = laws.flexspline_stiffness(torsion, p)
    soft = _softness(Tw, p)
    H[:] = 0.0
    H[TORQUE], H[RATE], H[STIFFNESS], H[ZERO], H[COUNT] = 1.0, p.bl, -x[TORQUE], -K, -K
    H[WAVE], H[CURVE] = -K * wound / p.N, -K * (wound - Tw * soft) / p.N
    for k in range(ORDERS):
        if c.order[k] != 0.0:
            H[KINEMATIC + 2 * k] = K * math.sin(c.order[k] * theta)
            H[KINEMATIC + 2 * k + 1] = K * math.cos(c.order[k] * theta)
    e = seen
    for i in range(SIZE):
        e -= H[i] * x[i]
    o.innovation = e
    unsteady = found.motor_torque - Tw
    noise = c.torsion_variance * K * K + (K * soft / p.N) ** 2 * (c.ripple**2 + unsteady**2)
    o.innovation_variance = _update(m, e, noise, learn)
    m.torsion_ratio = c.memory * m.torsion_ratio + (1.0 - c.memory) * e * e / o.innovation_variance
    # Current, while friction slides one way.
    direction = 1.0 if w > 0.0 else -1.0
    m.slid = m.slid + h if abs(w) > c.sliding and direction == m.direction else 0.0
    m.direction = direction
    if m.slid > c.settled + 0.5 * h:
        state = dynamics.drive_state(
            found.motor_position, w, x[LINK], x[RATE], m.current.bristle, 0.0, s.time, temperature(s, p)
        )
        friction = p.N * dynamics.sliding_friction(state, x[TORQUE], p)
        H[:] = 0.0
        H[TORQUE], H[FRICTION], H[CONSTANT] = 1.0, direction * friction, -p.N * m.current.drive.value
        e = by_current - x[TORQUE] - H[FRICTION] * x[FRICTION] - H[CONSTANT] * x[CONSTANT]
        _update(m, e, c.current_variance, learn)
    # Nobody touches it.
    m.untouched = m.untouched + h if m.link_ratio < c.low else 0.0
    sure = c.gate * math.sqrt(P[EXTERNAL, EXTERNAL] + c.free**2)
    if m.untouched > c.wait + 0.5 * h and abs(x[EXTERNAL]) < max(sure, c.least):
        H[:] = 0.0
        H[EXTERNAL] = 1.0
        # Beyond what is usual but less than a touch: with the weight that a heavy tail leaves it.
        spread = c.free**2 if abs(x[EXTERNAL]) < sure else c.free**2 + x[EXTERNAL] ** 2
        _update(m, -x[EXTERNAL], spread * c.back / h, learn)
    o.torque, o.variance, o.external_torque = x[TORQUE], P[TORQUE, TORQUE], x[EXTERNAL]
    o.stiffness_error, o.zero_error, o.wave_generator_error = x[STIFFNESS], x[ZERO], x[WAVE]
    o.weight_error, o.friction_error, o.constant_error = x[WEIGHT], x[FRICTION], x[CONSTANT]
    return 0 if math.isfinite(o.torque + o.variance) else 1


@dataclass(frozen=True)
class Augmented(CausalEstimator):
    """Augmented Kalman filter; see the module. Torques are relative to T2, of the joint's own size.

    Attributes:
        torque: intensity of the joint torque's walk [T2/√s]; torque_loud: while innovations contradict.
        external: intensity of the external torque's walk [T2/√s]; push: while the link encoder contradicts.
        free: external torque [T2] that a joint has all the same while nobody touches it; back: over which time [s] that
            counts; wait: after the last contradiction [s].
        gate: standard deviations of the external torque from nothing beyond which somebody touches the joint, if it is more
            than `least` [T2].
        ripple: noise of the motor torque that stands for the wave generator's [Kt·A].
        cutoff: of that motor torque's low-pass [Hz]; drive: of the drive's velocity [Hz], which counts during contacts and for
            `ringing` [s] after.
        current: noise of the torque that the current means, in one sample [T2].
        pause: calm [s] before constants are learned; every: between samples from which they are [s].
        memory: share of the mean NIS that is kept per sample.
        low, high: mean NIS from which on the noise grows, and where it has grown in full.
    """

    name: str = "augmented"
    torque: float = 0.025
    torque_loud: float = 2.0
    external: float = 0.0004
    push: float = 4.0
    free: float = 0.001
    back: float = 0.05
    gate: float = 4.0
    least: float = 0.03
    ripple: float = 0.03
    cutoff: float = 100.0
    drive: float = 150.0
    ringing: float = 0.3
    current: float = 0.1
    pause: float = 0.5
    every: float = 0.02
    wait: float = 0.05
    memory: float = 0.8
    low: float = 3.0
    high: float = 6.0
    innovation_unit: ClassVar[str] = "N·m"
    tuning: ClassVar[tuple[TuningParameter, ...]] = (
        TuningParameter("torque", 1e-3, 1.0), TuningParameter("torque_loud", 0.02, 20.0), TuningParameter("push", 0.05, 100.0),
        TuningParameter("free", 1e-4, 0.1),
    )  # fmt: skip
    description: ClassVar[str] = (
        "Kalman filter of joint torque, contact and the errors of torsion, current and weight; for joints known within tolerance"
    )
    compiled: ClassVar[Step] = _step
    remembers: ClassVar[np.dtype] = MEMORY
    outputs: ClassVar[tuple[str, ...]] = fields_of(OUT)

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        p, noise, spread = joint.p, joint.noise, joint.spread
        scale, count = float(p["T2"]), noise.motor_resolution / p["N"]
        found = np.zeros(1, SETTINGS)
        c = found[0]
        link = noise.link_noise**2 + noise.link_resolution**2 / 6.0
        c["link_variance"] = link
        if p["link_delay"] > 0.0:  # a line's end (`compliance`), and what happens meanwhile
            link += (_LATE * count) ** 2
            c["link_variance"] = link
        c["torsion_variance"] = link + (noise.motor_noise / p["N"]) ** 2 + (0.1 * count) ** 2
        c["ripple"] = p["Kt"] * self.ripple
        c["torque_quiet"], c["torque_loud"] = self.torque * scale, self.torque_loud * scale
        c["external_quiet"], c["external_loud"] = self.external * scale, self.push * scale
        c["free"], c["gate"], c["back"] = self.free * scale, self.gate, self.back
        c["current_variance"] = (self.current * scale) ** 2
        c["sliding"], c["settled"] = 2.5 * p["vs"], 0.05
        c["memory"], c["low"], c["high"] = self.memory, self.low, self.high
        c["least"] = self.least * scale
        c["wander"], c["half"] = joint.link_wander, 0.5 * noise.motor_resolution
        c["cutoff"] = 2 * math.pi * self.cutoff
        c["drive"], c["ringing"] = 2 * math.pi * self.drive, self.ringing
        c["pause"], c["every"], c["wait"] = self.pause, self.every, self.wait
        prior = c["prior"]
        prior[[LINK, RATE, TORQUE]] = math.sqrt(link), 1.0 / p["N"], scale
        prior[EXTERNAL], prior[COUNT] = 0.2 * scale, count / math.sqrt(12.0)
        prior[STIFFNESS], prior[ZERO] = spread.stiffness, joint.link_zero
        prior[WAVE], prior[CURVE] = spread.wave_generator, spread.wave_generator_curve
        prior[WEIGHT], prior[FRICTION], prior[CONSTANT] = spread.gravity, joint.friction, spread.torque_constant
        largest = np.argsort(-spread.kinematic, kind="stable")[:ORDERS]
        for k, i in enumerate(largest):
            if spread.kinematic[i] > 0.0:
                c["order"][k] = p["order"][i]
                prior[KINEMATIC + 2 * k : KINEMATIC + 2 * k + 2] = spread.kinematic[i]
        cutoff = 2 * math.pi * 20.0
        c["current"]["cutoff"], c["current"]["lead"] = cutoff, 0.0
        return found


ESTIMATORS = (Augmented(),)
