"""Augmented Kalman filter: the joint's motion, joint torque, external torque, and the unknown errors of the joint, as
one state.

The joint's numbers are known within tolerances. Three torques are available. The torque from torsion is fast, and
wrong by errors of stiffness, zero, kinematic error and wave generator. The torque from current, friction and the
drive's motion is right within a few per cent while the joint slides, and unknown at rest. The torque from the link's
weight and inertia is right unless the link is touched. Errors of the three have different shapes, so each shows in
the other two where it is identifiable. The state carries them with the tolerances as prior (a Schmidt–Kalman filter
where nothing is observable: the variance of an unobserved error stays, and counts in the torque's variance):

    θl, ωl    link                                       (1 + ι) Jl ωl' = T + df·(r·ωw − ωl) − bl·ωl + τ + (1 + μ)·link torques
    ωm, ωw    rotor, wave generator                      by the joint's equations, driven by the current
    Tw, z     wave generator's torque, bristle           Tw' = Kw(Tw)·(ωm − ωw); z by the LuGre law
    T         the spring's torque                        T' = (1 + κ)·K·(r·ωw − ωl), and a small walk
    φ, φ'     flexible part of the link                  by its equations (`laws.flexible_torque`); none on a rigid link
    τ         external torque                            random walk, small or large; zero most of the time
    d         error of the friction model                Ornstein–Uhlenbeck
    ε         position within the motor encoder's count  constant within a count, new with every count
    f, κt     friction, torque constant [1]              constant
    λ         share of the last current in this interval's constant: a reading is in force before it or after it
    μ, ι      weight, inertia of the link [1]            constant
    κ, ζ      stiffness [1], zero of the link encoder    constant
    β, χ      Kw0, Cw of the wave generator [1]          constant
    a_k, b_k  quadratures of kinematic error             constant, of the largest orders

with r = 1/N − θerr'. The joint torque is T + df·(r·ωw − ωl) − bl·ωl. Measurements are scalar, one after the other,
with the torsion Δθf from the readings:

    θl        link encoder
    k(Δθf) =  T − κ·T − K·(ζ + ε − Σ(a_k sin kθw + b_k cos kθw) + r·(β·δ + χ·(δ − Tw·exp(−Cw|Tw|)/Kw0)))
    0      =  τ                                          while τ is within its own uncertainty of zero

δ, the wave generator's torsion, is that of Tw. K is the stiffness at the torsion Δθf + ζ, with the estimated zero: a
zero error larger than the torsion between two breakpoints would select the wrong stiffness. Regressors are
predictions (κ·T, not κ·k(Δθf)): a regressor that shares its noise with the innovation would learn from noise (errors
in variables). docs/estimators.md says when constants are learned, and how far stamps are trusted.

Durations are sums of intervals, and equal counts may differ by rounding. Both are compared half a sample or half a
count off their value, so that rounding never decides. Counts are cells, not noise: at rest, ε learns a count once. If
both encoders keep their counts, the n-th reading of the link encoder has n times its variance.

Contacts are rare: τ has a large walk only while the innovations of the link encoder exceed their variance, d while
those of torsion do (adaptive process noise, Mehra 1972, as in `dynamics_filter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models import dynamics, laws
from ...models.kernels import kernel
from ...models.parameters import floats
from ...models.step import NOT_FINITE, OK, Step, step_of
from ..compliance import TORSION, measure
from ..dynamics_filter import propagate, share
from ..estimator import CausalEstimator, KnownJoint, TuningParameter
from ..sensing import arm_torque, temperature

ORDERS = 3  # number of kinematic error orders whose error is estimated
(
    LINK, LINK_RATE, ROTOR, WAVE_RATE, WOUND, BRISTLE, SPRING, SWING, SWING_RATE, EXTERNAL, MESH, COUNT,
    FRICTION, CONSTANT, LATE, WEIGHT, INERTIA, STIFFNESS, ZERO, WAVE, CURVE, KINEMATIC,
) = range(22)  # fmt: skip
SIZE = KINEMATIC + 2 * ORDERS
MOVING, INPUTS, FIXED = MESH + 1, LATE + 1, FRICTION
"""First state after the moving ones; first after those that act within a substep; first of the constant ones."""
_TURN = 0.7  # largest angle [rad] of the fastest spring in a substep
_MOST = 200  # most substeps of a sample
_BEYOND = 1.25  # torque [rated torque] beyond which the wave generator gets no stiffer, to limit a wrong stiffness
SETTINGS = floats(
    "link_variance", "torsion_variance", "rotor_walk", "torque_variance", "mesh_walk", "bristle_walk", "presliding",
    "spring_walk", "loose", "external_quiet", "external_loud", "level", "level_time", "level_loud", "free", "gate", "memory",
    "low", "high", "wander", "interval", "back", "pause", "every", "wait", "least", "half", "sliding", "settled", "coarse",
    "stiffest", "link_half", "link_count", ("prior", SIZE), ("learned", SIZE), ("order", ORDERS),
)  # fmt: skip
MEMORY = floats(
    ("torsion", TORSION), ("x", SIZE), ("P", (SIZE, SIZE)), ("H", SIZE), ("PH", SIZE), ("F", (MOVING, SIZE)),
    ("A", (MOVING, SIZE)), "motor_reading", "torsion_ratio", "link_ratio", "calm", "slid", "untouched", "free", "belief",
    "evidence", "motor_torque", "ripple", "period", "beats", "phase", "link_reading", "held", "jitter", "last", "touched",
    "late", "seen",
)  # fmt: skip
"""Memory of `measure`; state, covariance, scratch; last reading of the motor encoder; mean NIS of torsion and link
encoder; durations [s] of calm, of sliding in it, and since large innovations of the link encoder; whether the
joint was free of contact at the last sample; trust in time stamps, and its evidence; motor torque of the last
sample [N·m, motor side], mean square of its changes; mean interval [s], and number of intervals; delay [s] of the
last stamp against the grid of samples; last reading of the link encoder, number of samples in which both encoders
kept their counts; mean square time error of samples [s²], last innovation of the link encoder [rad]; duration of a
contact [s]; mean square time error of a sample over its interval's from the period, and the weight that it has."""
OUT = floats(
    "torque", "variance", "innovation", "innovation_variance", "external_torque", "stiffness_error", "zero_error",
    "wave_generator_error", "friction_error",
)  # fmt: skip
_LEVEL_TIME = 5.0  # correlation time [s] of the friction model's error
_DOUBT = 2.0  # mean NIS that is more than scatter, 0.5 about 1
_FIRST_BEATS, _BEATS = 100.0, 1e4  # weight of the nominal interval, and number of intervals in the mean
_FOLLOW = 0.02  # share of a stamp's deviation by which the grid of samples follows it
_STAMPS = 30.0  # prior evidence [variances of the link encoder] that time stamps are right
_CLOCK, _SHAKES = 1e-4, 200.0  # time error of a sample [s] with a weight of one; samples over which it is learned
_STRANGE = 3.0  # error of the friction model [its standard deviation] beyond which the drive is not understood
_LATENESS = 1e4  # weight of the prior that uneven intervals are right
_TOUCH = 1.5  # time [s] after which a constant contact may be an error of the constants
_START = 1.0  # largest initial velocity [rad/s]
_STIFFENS = 2e-3  # time [s] in which the wave generator may stiffen by a factor e
_TRIES = 8  # most iterations for the zero about which torsion is linearised
_HELD, _RIPPLE = 1e-3, 0.1
"""Shortest time [s] for which a drive holds its current; time over which the mean square of its changes is taken."""
_UNSEEN = 0.5
"""Time [s] after which unobserved motion between readings has changed the spring's torque as a walk of `_LOOSE`."""
_LOOSE = 2.0  # intensity of the spring's torque inside a dead zone, and while torsion contradicts [T2/√s]
_LATE = 3.0  # error [counts of the motor encoder] of a delayed link encoder's reading
_CARRIED = 0.5  # intensity of an unknown load's torque [its size/√s]
_SAMPLES = 0.5  # share of a sample by which the current may have been in force after its reading
_CONSIDERED = (CONSTANT, WEIGHT, INERTIA)
"""Constants that are not learned: their priors are narrow, and persistent model errors look like them."""


@kernel
def _gain(m, i):
    """Covariance of a state with what `m.H` measures."""
    total = 0.0
    for j in range(SIZE):
        if m.H[j] != 0.0:
            total += m.P[i, j] * m.H[j]
    return total


@kernel
def _variance(m):
    """Variance of what `m.H` measures."""
    total = 0.0
    for i in range(SIZE):
        if m.H[i] != 0.0:
            total += m.H[i] * _gain(m, i)
    return total


@kernel
def _update(m, e, variance, least, c):
    """Update with a scalar innovation along `m.H`; return its variance S. If S is below `least`, constants are
    considered and not changed (Schmidt 1966); those of `_CONSIDERED` never change."""
    x, P, H, PH = m.x, m.P, m.H, m.PH
    S = variance
    for i in range(SIZE):
        PH[i] = _gain(m, i)
    for i in range(SIZE):
        S += H[i] * PH[i]
    learn = S >= least
    for i in range(SIZE):
        gain = PH[i] / S
        if gain == 0.0:
            continue
        changed = i < FIXED or (learn and c.learned[i] != 0.0)
        if changed:
            x[i] += gain * e
        for j in range(i + 1 if changed or learn else FIXED):
            if changed or j < FIXED or c.learned[j] != 0.0:
                P[i, j] -= gain * PH[j]
                P[j, i] = P[i, j]
    return S


@kernel
def _torsion_row(m, found, torsion, zero, wound, soft, ratio, p, c):
    """Return the innovation [N·m] of a torsion [rad] about a zero of the link encoder [rad], and its stiffness
    [N·m/rad]; write its row into `m.H`."""
    x, H, theta = m.x, m.H, found.wave_generator_position
    K = laws.flexspline_stiffness(torsion + zero, p)
    if not K > 0.0:  # inside a dead zone its flanks may be near
        K = p.K1
    H[:] = 0.0
    H[SPRING], H[STIFFNESS], H[ZERO], H[COUNT] = 1.0, -x[SPRING], -K, -K
    H[WAVE], H[CURVE] = -K * wound * ratio, -K * (wound - x[WOUND] * soft) * ratio
    for k in range(ORDERS):
        if c.order[k] != 0.0:
            H[KINEMATIC + 2 * k] = K * math.sin(c.order[k] * theta)
            H[KINEMATIC + 2 * k + 1] = K * math.cos(c.order[k] * theta)
    e = found.torque + laws.flexspline_spring(torsion + zero, p) - laws.flexspline_spring(found.torsion, p)
    for i in range(SIZE):
        e -= H[i] * x[i]
    e -= K * zero
    H[WOUND] = K * soft * ratio
    return e, K


@kernel
def _start(m, reading, link, torque, motor_torque, p, c):
    """Start at the first readings in equilibrium: elastic torque [N·m], motor torque [N·m, motor side]; the whole
    joint at rest or in motion."""
    x, P = m.x, m.P
    x[:] = 0.0
    P[:] = 0.0
    x[LINK], x[SPRING], x[WOUND] = link, torque, motor_torque
    x[BRISTLE] = min(max((motor_torque - torque / p.N) / p.s0, -p.Fs / p.s0), p.Fs / p.s0)
    for i in range(SIZE):
        P[i, i] = c.prior[i] ** 2
    for i in (LINK_RATE, ROTOR, WAVE_RATE):
        for j in (LINK_RATE, ROTOR, WAVE_RATE):
            P[i, j] += (1.0 if i == LINK_RATE else p.N) * (1.0 if j == LINK_RATE else p.N) * _START**2
    m.motor_reading, m.torsion_ratio, m.link_ratio = reading, 1.0, 1.0
    m.belief, m.evidence = 1.0, _STAMPS


@kernel
def _predict(m, s, found, change, h, p, c):
    """Predict over `h` [s] by the joint's own equations.

    In semi-implicit substeps: springs and bristle by the velocities, velocities by the torques, the link's angle;
    stable while no spring turns by 2 rad in one. Every part is linearised at its own state, and the Jacobian is the
    product.
    """
    x, F = m.x, m.F
    theta, warm = found.wave_generator_position - 0.5 * h * x[WAVE_RATE], temperature(s, p)  # halfway there
    ratio = 1.0 / p.N - laws.kinematic_error_slope(theta, p)
    K = (1.0 + x[STIFFNESS]) * laws.flexspline_stiffness(found.torsion + x[ZERO], p)
    F[:] = 0.0
    for i in range(MOVING):
        F[i, i] = 1.0
    for k in range(ORDERS):
        n = c.order[k]
        if n != 0.0:
            at, sine, cosine = KINEMATIC + 2 * k, math.sin(n * theta), math.cos(n * theta)
            ratio -= n * (x[at] * cosine - x[at + 1] * sine)
            F[SPRING, at], F[SPRING, at + 1] = -h * K * n * cosine * x[WAVE_RATE], h * K * n * sine * x[WAVE_RATE]
    still = _state(x, found, s.time, warm)
    weight = dynamics.link_torque(still, x[SPRING], p)
    x[LINK] += 1e-4
    slope = (dynamics.link_torque(_state(x, found, s.time, warm), x[SPRING], p) - weight) / 1e-4
    x[LINK] -= 1e-4
    weight -= slope * x[LINK]
    arm = arm_torque(s)
    F[SPRING, STIFFNESS] = h * K * (ratio * x[WAVE_RATE] - x[LINK_RATE])
    flexible = laws.flexible_inertia(p)
    rigid, before = (1.0 + x[INERTIA]) * p.Jl - flexible, x[LINK_RATE]
    F[LINK_RATE, WEIGHT] = h / rigid * (weight + slope * x[LINK])
    given = found.motor_torque - x[LATE] * change
    drive, damped = (1.0 + x[CONSTANT]) * given, ratio * p.df
    # The wave generator stiffens on the way: the longer the interval, the more.
    most = min(p.Cw * abs(x[WOUND]) + max(h - _HELD, 0.0) / _STIFFENS, c.stiffest)
    fastest = max(
        p.Kw0 * math.exp(most) * (1.0 / p.Jm + 1.0 / p.Jw),
        max(K * (1.0 / rigid + 1.0 / (p.N * p.N * p.Jw)), p.s0 / p.Jw),
    )
    steps = min(max(math.ceil(h * math.sqrt(fastest) / _TURN), 1), _MOST)
    d, bent = h / steps, x[BRISTLE]
    for _ in range(steps):
        w = x[WAVE_RATE]
        rate = ratio * w - x[LINK_RATE]
        spring = K
        if p.hysteresis_torque != 0.0:
            state = m.torsion.dahl / p.hysteresis_extent
            spring += p.hysteresis_torque / p.hysteresis_extent * max(1.0 - math.copysign(state, state * rate), 0.0)
        x[SPRING] += d * spring * rate
        stiff = p.Kw0 * math.exp(min(p.Cw * abs(x[WOUND]), c.stiffest))
        x[WOUND] += d * stiff * (x[ROTOR] - w)
        g = (1.0 + x[FRICTION]) * dynamics.sliding_friction(_state(x, found, s.time, warm), x[SPRING], p)
        if h > 1.5 * _HELD:  # too long for a bristle that an update bent beyond sliding friction
            x[BRISTLE] = min(max(x[BRISTLE], -g / p.s0), g / p.s0)
        sign = np.sign(w)
        slack = max(1.0 - sign * p.s0 * x[BRISTLE] / g, 0.0)
        decay = math.exp(-min(p.s0 * abs(w) / g * d, 40.0))
        x[BRISTLE] = laws.bristle_step(x[BRISTLE], w, g, d, p)
        friction = dynamics.mesh_torque(_state(x, found, s.time, warm), x[SPRING], g, p)
        for j in range(INPUTS):
            F[SPRING, j] += d * spring * (ratio * F[WAVE_RATE, j] - F[LINK_RATE, j])
            F[WOUND, j] += d * stiff * (F[ROTOR, j] - F[WAVE_RATE, j])
            F[BRISTLE, j] = decay * (F[BRISTLE, j] + d * slack * F[WAVE_RATE, j])
        F[BRISTLE, FRICTION] += sign * g / p.s0 * (1.0 - decay)
        x[ROTOR] += d / p.Jm * (drive - p.bm * x[ROTOR] - x[WOUND] - p.dw * (x[ROTOR] - x[WAVE_RATE]))
        for j in range(INPUTS):
            F[ROTOR, j] += d / p.Jm * (p.dw * F[WAVE_RATE, j] - (p.dw + p.bm) * F[ROTOR, j] - F[WOUND, j])
        F[ROTOR, CONSTANT] += d / p.Jm * given
        F[ROTOR, LATE] -= d / p.Jm * change
        load = x[SPRING] + p.df * (ratio * x[WAVE_RATE] - x[LINK_RATE])
        turning = x[WOUND] + p.dw * (x[ROTOR] - x[WAVE_RATE]) - friction + x[MESH]
        against = p.dw + p.s1 * slack + p.bw + damped * ratio
        brake = against * d / p.Jw  # exact in its own damping: the bristle's is stiff
        turn = -math.expm1(-brake) / brake * d / p.Jw if brake > 1e-6 else d / p.Jw
        x[WAVE_RATE] += turn * (turning - ratio * load)
        for j in range(INPUTS):
            F[WAVE_RATE, j] += turn * (
                F[WOUND, j] + p.dw * F[ROTOR, j] - against * F[WAVE_RATE, j] - p.s0 * F[BRISTLE, j] + F[MESH, j]
                - ratio * F[SPRING, j] + damped * F[LINK_RATE, j]
            )  # fmt: skip
        load = x[SPRING] + p.df * (ratio * x[WAVE_RATE] - x[LINK_RATE])
        own = (1.0 + x[WEIGHT]) * (weight + slope * x[LINK]) + arm
        kick = d / rigid * (load - p.bl * x[LINK_RATE] + own + x[EXTERNAL])
        if flexible > 0.0:
            pull = laws.flexible_torque(x[SWING], x[SWING_RATE], p)
            kick += d / rigid * pull
            x[SWING_RATE] -= d / flexible * pull + kick
            x[SWING] += d * x[SWING_RATE]
        x[LINK_RATE] += kick
        x[LINK] += d * x[LINK_RATE]
        for j in range(INPUTS):
            kick = d / rigid * (
                F[SPRING, j] + damped * F[WAVE_RATE, j] - (p.df + p.bl) * F[LINK_RATE, j] + slope * F[LINK, j]
                + F[EXTERNAL, j]
            )  # fmt: skip
            if flexible > 0.0:
                pull = laws.flexible_torque(F[SWING, j], F[SWING_RATE, j], p)
                kick += d / rigid * pull
                F[SWING_RATE, j] -= d / flexible * pull + kick
                F[SWING, j] += d * F[SWING_RATE, j]
            F[LINK_RATE, j] += kick
            F[LINK, j] += d * F[LINK_RATE, j]
    F[LINK_RATE, INERTIA] = -p.Jl / rigid * (x[LINK_RATE] - before)
    if flexible > 0.0:
        F[SWING_RATE, WEIGHT], F[SWING_RATE, INERTIA] = -F[LINK_RATE, WEIGHT], -F[LINK_RATE, INERTIA]
    forget = math.exp(-h / c.level_time)
    x[MESH] *= forget
    F[MESH, MESH] = forget
    propagate(F, m.P, m.A, MOVING, SIZE)
    m.P[BRISTLE, BRISTLE] += c.presliding * abs(x[BRISTLE] - bent)  # its stiffness is not known
    if K == 0.0:  # the position in the dead zone is known only by the torsion
        m.P[SPRING, SPRING] += c.loose * h
    _add_noise(m, h, forget, c)


@kernel
def _state(x, found, time, warm):
    """Return the drive's state as `dynamics.State`; friction is the wave generator's."""
    return dynamics.drive_state(
        found.motor_position, x[WAVE_RATE], x[LINK], x[LINK_RATE], x[BRISTLE], dynamics.UNREAD, time, warm
    )


@kernel
def _add_noise(m, h, forget, c):
    P, loud = m.P, share(m.torsion_ratio, c)
    touched = max(loud, share(m.link_ratio, c))
    # Between distant readings the drive gave other currents, too.
    beyond = max(h - _HELD, 0.0)
    P[ROTOR, ROTOR] += c.rotor_walk * (c.torque_variance * h * h + m.ripple * beyond * beyond)
    P[WAVE_RATE, WAVE_RATE] += c.mesh_walk * h
    P[BRISTLE, BRISTLE] += c.bristle_walk * h
    P[SPRING, SPRING] += (c.spring_walk + loud * c.loose) * h + c.loose * beyond * beyond / _UNSEEN
    P[EXTERNAL, EXTERNAL] += h * (c.external_quiet**2 + touched * c.external_loud**2)
    P[MESH, MESH] += c.level**2 * (1.0 - forget * forget) + h * loud * c.level_loud**2
    P[ZERO, ZERO] += c.wander**2 * h * abs(m.x[LINK_RATE])


@kernel
def _off_beat(m, interval, c):
    """Return the deviation of an interval [s] from an even grid that follows the stamps. Samples may be missing on
    it.

    The grid, not the last stamp: the interval of two jittering stamps may be off by most of a period.
    """
    if interval == 0.0:
        m.period, m.beats, m.phase = c.interval, _FIRST_BEATS, 0.0
        return 0.0
    m.phase += interval - m.period
    missing = max(math.floor(m.phase / m.period + 0.5), 0.0)
    off = interval - (1.0 + missing) * m.period
    m.phase = (1.0 - _FOLLOW) * (m.phase - missing * m.period)
    m.beats = min(m.beats + 1.0, _BEATS)
    m.period += off / ((1.0 + missing) * m.beats)
    return off


@kernel
def _believe(m, e, moved, c):
    """Learn the trust in the stamps of even samples: regression of the link encoder's innovation e [rad] on the
    link's motion [rad] in a stamp's deviation from the period. A jittering clock shows nothing there, uneven
    samples show all of it."""
    if moved != 0.0:
        seen = min(max(m.belief + e / moved, -1.0), 2.0)
        m.evidence += (moved * moved) / c.link_variance
        m.belief += (seen - m.belief) * moved * moved / (c.link_variance * m.evidence)
        m.belief = min(max(m.belief, 0.0), 1.0)


@kernel
def _reset_constants(m, c):
    """Treat an external torque as an error of the constants, if their priors allow it: reset them to the description,
    along the torsion's row in `m.H`."""
    x, P, H = m.x, m.P, m.H
    could = 0.0
    for i in range(FIXED, SIZE):
        could += (H[i] * c.prior[i]) ** 2
    if x[EXTERNAL] ** 2 > _DOUBT**2 * could:
        return
    x[SPRING] += x[EXTERNAL]
    x[EXTERNAL] = 0.0
    for i in range(FIXED, SIZE):
        x[i] = 0.0
        for j in range(SIZE):
            P[i, j] = 0.0
            P[j, i] = 0.0
        P[i, i] = c.prior[i] ** 2
    P[SPRING, SPRING] += could
    P[EXTERNAL, EXTERNAL] += could


@kernel
def _jitters(m, e, x, apart, c):
    """Learn the mean square time error of samples [s²] from changes of the link encoder's innovations e [rad], and
    its growth with the square `apart` [s²] of an interval's deviation from the period.

    Changes, because an unknown torque moves the link the same way for many samples.
    """
    change, rate = e - m.last, x[LINK_RATE]
    m.last = e
    weight = rate * rate / c.link_variance * _CLOCK**2
    seen = 0.5 * min(change * change, 9.0 * (m.jitter * rate * rate + c.link_variance)) - c.link_variance
    if weight > 0.0:
        m.jitter += (seen / (rate * rate) - m.jitter) * weight / (1.0 + weight) / _SHAKES
        m.jitter = max(m.jitter, 0.0)
        square = rate * rate
        if apart > 0.0:
            weight = (square * apart / c.link_variance) ** 2
            m.seen += weight
            beyond = (min(e * e, square * apart) - c.link_variance) / square - m.jitter
            m.late = max(m.late + (beyond / apart - m.late) * weight / (m.seen + _LATENESS), 0.0)


@step_of(MEMORY, SETTINGS, OUT)
def _step(m, s, p, c, o):
    h = s.interval
    off = _off_beat(m, h, c)
    h -= (1.0 - m.belief) * off
    x, P, H = m.x, m.P, m.H
    found = measure(m.torsion, s, p)
    theta = found.wave_generator_position
    # In calm without contact, and not at every sample: model errors are not white noise.
    calm = m.torsion_ratio < c.high and m.link_ratio < c.high and m.free > 0.0
    m.calm = m.calm + h if calm else 0.0
    m.slid = m.slid + h if calm and abs(x[WAVE_RATE]) > c.sliding else 0.0
    due = m.calm > c.pause - 0.5 * h
    if due:
        m.calm -= c.every
    # At rest model errors are constant.
    learn = 0.0 if due and m.slid > c.settled - 0.5 * h else math.inf
    learn_torsion = min(learn, c.coarse if due else math.inf)
    change = found.motor_torque - m.motor_torque  # it has no effect at the first sample
    m.motor_torque = found.motor_torque
    m.ripple += (0.5 * change * change - m.ripple) * -math.expm1(-s.interval / _RIPPLE)
    if s.interval == 0.0:
        _start(m, s.motor_position, found.link_position, found.torque, found.motor_torque, p, c)
    else:
        _predict(m, s, found, change, h, p, c)
        m.held += 1.0
        if not abs(s.link_position - m.link_reading) <= c.link_half:
            m.held = 0.0
        if not abs(s.motor_position - m.motor_reading) <= c.half:
            x[COUNT] = 0.0  # the position within a new count is not known
            for j in range(SIZE):
                P[COUNT, j] = 0.0
                P[j, COUNT] = 0.0
            P[COUNT, COUNT] = c.prior[COUNT] ** 2
            m.held = 0.0
        m.motor_reading = s.motor_position
        # The link encoder.
        H[:] = 0.0
        H[LINK] = 1.0
        e = found.link_position - x[LINK]
        # The stamp is right, or the grid.
        apart = (s.interval - m.period) ** 2
        shaken = (m.jitter + m.belief * (1.0 - m.belief) * off * off + m.late * apart) * x[LINK_RATE] * x[LINK_RATE]
        _jitters(m, e, x, apart, c)
        S = _update(m, e, c.link_variance + shaken + c.link_count * m.held, learn, c)
        _believe(m, e, off * x[LINK_RATE], c)
        m.link_ratio = c.memory * m.link_ratio + (1.0 - c.memory) * e * e / S
    m.link_reading = s.link_position
    # Torsion.
    ratio = 1.0 / p.N - laws.kinematic_error_slope(theta, p)
    wound, asked = laws.wave_generator_torsion(x[WOUND], p), laws.wave_generator_torsion(found.motor_torque, p)
    soft = math.exp(-p.Cw * abs(x[WOUND])) / p.Kw0  # compliance of the wave generator: Eq. (4) inverted
    torsion, zero = found.torsion + (asked - wound) * ratio, x[ZERO]
    e, K = _torsion_row(m, found, torsion, zero, wound, soft, ratio, p, c)
    # If constants are learned: about the resulting zero (an iterated update, Bell and Cathey 1993).
    for _ in range(_TRIES if learn_torsion < math.inf else 0):
        S = c.torsion_variance * K * K + _variance(m)
        likelier = x[ZERO] + _gain(m, ZERO) * e / S
        if S < learn_torsion or abs(likelier - zero) <= math.sqrt(c.torsion_variance):
            break
        zero = likelier
        e, K = _torsion_row(m, found, torsion, zero, wound, soft, ratio, p, c)
    o.innovation = e
    o.innovation_variance = _update(m, e, (c.torsion_variance + c.link_count * m.held) * K * K, learn_torsion, c)
    m.torsion_ratio = c.memory * m.torsion_ratio + (1.0 - c.memory) * e * e / o.innovation_variance
    # Without contact.
    m.untouched = m.untouched + h if m.link_ratio < c.low and m.torsion_ratio < c.high else 0.0
    sure = c.gate * math.sqrt(P[EXTERNAL, EXTERNAL] + c.free**2)
    m.free = 0.0
    if m.untouched > c.wait + 0.5 * h and abs(x[EXTERNAL]) < max(sure, c.least):
        m.free = 1.0
        H[:] = 0.0
        H[EXTERNAL] = 1.0
        # Unusual, but less than a contact: with the weight of a heavy tail.
        spread = c.free**2 if abs(x[EXTERNAL]) < sure else c.free**2 + x[EXTERNAL] ** 2
        _update(m, -x[EXTERNAL], spread * c.back / h, learn, c)
    # A persistent contact that may be an error of the learned constants: reset them.
    m.touched = m.touched + h if m.untouched > c.wait + 0.5 * h and m.free == 0.0 else 0.0
    if m.touched > _TOUCH:
        m.touched = 0.0
        _torsion_row(m, found, torsion, x[ZERO], wound, soft, ratio, p, c)
        _reset_constants(m, c)
    H[:] = 0.0
    H[SPRING], H[WAVE_RATE], H[LINK_RATE] = 1.0, p.df * ratio, -p.df - p.bl
    variance = 0.0
    for i in range(MOVING):
        for j in range(MOVING):
            variance += H[i] * P[i, j] * H[j]
    o.torque = x[SPRING] + p.df * (ratio * x[WAVE_RATE] - x[LINK_RATE]) - p.bl * x[LINK_RATE]
    # While innovations contradict (the start of a contact), the variance grows with them.
    doubt = max(m.torsion_ratio, m.link_ratio)
    o.variance, o.external_torque = variance * (doubt if doubt > _DOUBT else 1.0), x[EXTERNAL]
    # More than its uncertainty, less than a contact: it may be a persistent push, or nothing.
    if m.free > 0.0 and abs(x[EXTERNAL]) > sure:
        o.variance += x[EXTERNAL] ** 2
    # Friction far beyond its model: the drive does what the equations do not have.
    o.variance += (p.N * max(abs(x[MESH]) - _STRANGE * c.level, 0.0)) ** 2
    o.stiffness_error, o.zero_error, o.wave_generator_error = x[STIFFNESS], x[ZERO], x[WAVE]
    o.friction_error = x[FRICTION]
    return OK if math.isfinite(o.torque + o.variance) else NOT_FINITE


@dataclass(frozen=True)
class Augmented(CausalEstimator):
    """Augmented Kalman filter; see the module. Torques are relative to the joint's T2 or Fc."""

    name: str = "augmented"
    torque: float = 0.007  # intensity of the spring torque's own walk [T2/√s]
    external: float = 0.0004  # intensity of the external torque's walk [T2/√s]
    push: float = 8.0  # the same while the link encoder contradicts [T2/√s]
    mesh: float = 1.5e-3  # white noise of torque at the mesh [Fc·√s]
    bristle: float = 5.5e-3  # noise of the friction's bristle [Fc/s0 per √s]
    presliding: float = 2.0  # relative error of the bristle's stiffness [relative error of the friction model]
    level: float = 0.017  # standard deviation of the friction model's error [Fc]
    unsure: float = 2.0  # the same, per relative error of that model [Fc]
    surge: float = 1.1  # intensity of that error while torsion contradicts [Fc/√s]
    free: float = 0.0005  # external torque [T2] without contact
    back: float = 0.05  # its time constant [s]
    # standard deviations of the external torque from zero that count as a contact, if it exceeds `least` [T2]
    gate: float = 4.0
    least: float = 0.03
    coarse: float = 0.01  # deviation of the torsion's innovation [T2] from which constants are learned at rest, too
    settled: float = 0.1  # motion [s] in `pause`
    pause: float = 0.5  # calm [s] before constants are learned
    every: float = 0.05  # between samples from which they are learned [s]
    wait: float = 0.2  # time after the last contradiction [s]
    memory: float = 0.8  # share of the mean NIS that is kept per sample
    # low, high: mean NIS at which the noise starts to grow, and at which it is full
    low: float = 5.0
    high: float = 12.0
    learns: ClassVar[bool] = True
    innovation_unit: ClassVar[str] = "N·m"
    tuning: ClassVar[tuple[TuningParameter, ...]] = (
        TuningParameter("torque", 1e-4, 1.0), TuningParameter("push", 0.05, 100.0), TuningParameter("free", 1e-4, 0.1),
        TuningParameter("mesh", 1e-5, 1e-2), TuningParameter("level", 1e-4, 0.5),
    )  # fmt: skip
    description: ClassVar[str] = (
        "Kalman filter of joint torque, contact and the errors of torsion, current and weight; for joints known within tolerance"
    )
    compiled: ClassVar[Step] = _step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        p, noise, spread = joint.p, joint.noise, joint.spread
        scale, count = float(p["T2"]), noise.motor_resolution / p["N"]
        found = np.zeros(1, SETTINGS)
        c = found[0]
        c["link_half"], c["link_count"] = 0.5 * noise.link_resolution, noise.link_resolution**2 / 6.0
        link = noise.link_noise**2 + noise.link_error**2 + c["link_count"]
        c["link_variance"] = link
        if p["link_delay"] > 0.0:  # the error of the extrapolation (`compliance`)
            link += (_LATE * count) ** 2
            c["link_variance"] = link
        c["torsion_variance"] = link + (noise.motor_noise**2 + noise.motor_error**2) / p["N"] ** 2 + (0.1 * count) ** 2
        Fc = float(p["Fc"])
        c["rotor_walk"], c["torque_variance"] = float(p["Jm"]) ** -2, p["Kt"] ** 2 * noise.current_variance(interval)
        c["mesh_walk"] = (self.mesh * Fc / p["Jw"]) ** 2
        c["bristle_walk"] = (self.bristle * Fc / p["s0"]) ** 2
        c["presliding"] = (self.presliding * joint.friction) ** 2 * 2.0 * Fc / p["s0"]
        c["spring_walk"] = (self.torque * scale) ** 2
        c["loose"] = (_LOOSE * scale) ** 2
        c["external_quiet"], c["external_loud"] = self.external * scale, self.push * scale
        c["level"], c["level_loud"] = math.hypot(self.level, self.unsure * joint.friction) * Fc, self.surge * Fc
        c["level_time"], c["free"], c["least"] = _LEVEL_TIME, self.free * scale, self.least * scale
        for name in ("gate", "back", "memory", "low", "high", "settled", "pause", "every", "wait"):
            c[name] = getattr(self, name)
        c["wander"], c["half"] = joint.link_wander, 0.5 * noise.motor_resolution
        c["stiffest"] = min(_BEYOND * p["Cw"] * joint.rated_torque / p["N"], -math.log(laws.LOGARITHM_END))
        c["sliding"] = 2.5 * p["vs"]
        c["coarse"], c["interval"] = (self.coarse * scale) ** 2, interval
        if joint.load_error > 0.0:  # an unknown load is a persistent contact that includes pushes
            c["external_quiet"], c["external_loud"], c["wait"] = _CARRIED * joint.load_error, 0.0, math.inf
        prior = c["prior"]
        prior[[LINK, LINK_RATE, ROTOR, WAVE_RATE]] = math.sqrt(link), 1.0 / p["N"], 1.0, 1.0
        prior[[WOUND, BRISTLE, SPRING, MESH]] = 0.1 / p["Cw"], p["Fs"] / p["s0"], scale, c["level"]
        if p["flexible_share"] > 0.0:
            pulsation = 2.0 * math.pi * p["flexible_frequency"]
            prior[SWING] = 0.1 * scale / (p["flexible_share"] * p["Jl"] * pulsation**2)
            prior[SWING_RATE] = pulsation * prior[SWING]
        prior[EXTERNAL], prior[COUNT] = math.hypot(0.2 * scale, joint.load_error), count / math.sqrt(12.0)
        prior[LATE] = _SAMPLES
        prior[STIFFNESS], prior[ZERO] = spread.stiffness, joint.link_zero
        prior[WAVE], prior[CURVE] = spread.wave_generator, spread.wave_generator_curve
        prior[WEIGHT], prior[INERTIA] = spread.gravity, spread.inertia
        prior[FRICTION], prior[CONSTANT] = joint.friction, spread.torque_constant
        c["learned"] = 1.0
        c["learned"][list(_CONSIDERED)] = 0.0
        largest = np.argsort(-spread.kinematic, kind="stable")[:ORDERS]
        for k, i in enumerate(largest):
            if spread.kinematic[i] > 0.0:
                c["order"][k] = p["order"][i]
                prior[KINEMATIC + 2 * k : KINEMATIC + 2 * k + 2] = spread.kinematic[i]
        return found


ESTIMATORS = (Augmented(),)
