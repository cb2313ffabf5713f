"""Gaussian filter on the joint's state-space model (`joint_model`), extended or unscented: one loop, two predictions.

Three things are not in the textbook:

* **Counts are cells, not noise** (`quantised`): while the joint rests, equal counts contain no new information. The
  position within the count then follows from the model alone, and drifts with the model's errors. After a tenth of a
  second at one count the torque is known only to the count (`_within_count`).
* **Contacts are rare**: the noise of τext is small, and large only while the link encoder's innovations exceed their
  variance (a window of 5 samples); likewise d with the motor encoder (adaptive process noise, Mehra 1972).
* **A delayed link encoder** delays the whole filter: it uses motor readings and commands of the instant of the link
  reading. The state is then advanced to now by the model, through the commands and the motor encoder's readings since,
  with the external torque along a line (`_catch_up`).
"""

from __future__ import annotations

import math

from ..models.dynamics import UNREAD
from ..models.kernels import kernel
from ..models.parameters import floats
from ..models.step import NOT_FINITE, OK, SAMPLE
from . import joint_model as model
from .joint_model import EXTERNAL, LINK, MESH, MOTOR, MOTOR_RATE, NOISE, SIZE, STATES, STEPS, WAVE
from .quantised import update
from .sensing import RING, arm_torque, line_in_ring, motor_current, temperature

_AHEAD = 6.0  # delays of the link encoder over which the line of the external torque is fitted
POINTS = 2 * SIZE + 1
_DIFFERENCE = 1e-5  # rad
_STILL = 0.1  # time [s] at one count after which the position within it is unknown

FILTER = floats(
    ("x", SIZE), ("P", (SIZE, SIZE)), "current", "time", "motor_ratio", "link_ratio", "reading", "still",
    ("predicted", SIZE), ("predicted_P", (SIZE, SIZE)), ("F", (SIZE, SIZE)), "count", "done", ("ring", SAMPLE, RING),
    ("times", RING), ("external", RING), ("now", SIZE), ("now_P", (SIZE, SIZE)), ("e", 2), ("S", 2),
    ("points", (POINTS, SIZE)), ("A", (SIZE, SIZE)), ("work", (3, SIZE)), ("H", SIZE), ("PH", SIZE),
)  # fmt: skip
"""Memory of the filter: state and covariance of the active states, motor current [A], time of the last sample [s];
mean NIS of both encoders; the motor encoder's last reading [rad] and for how long it has been the same [s]; the
prediction with its covariance and Jacobian, for a smoother; for a delayed link encoder the number of samples, of
processed ones, a ring of them and of the external torque [N·m]; state and covariance now; innovations [rad] and
their variances [rad²]; the rest is scratch."""
SETTINGS = floats(("noise", NOISE), "kappa")  # noise; κ, the spread of sigma points, NaN to predict by a Jacobian
OUT = floats(
    "torque", "variance", "innovation_motor_position", "innovation_link_position",
    "innovation_variance_motor_position", "innovation_variance_link_position", *STATES,
)  # fmt: skip


@kernel
def filter_step(m, s, c, p, o):
    """Update the filter, a record of `FILTER`, with a sample; write the outputs, a record of `OUT`. Return the status."""
    x = m.now
    if p.link_delay > 0.0:
        _late_step(m, s, c, p)
    else:
        _step(m, s, s.link_position, s.interval, c, p)
        x[:] = m.x
        m.now_P[:] = m.P
    o.torque = model.joint_torque(x, s.time, p)
    variance = model.torque_variance(x, m.now_P, o.torque, s.time, p, c.noise, m.H)
    o.variance = max(variance, _within_count(m, s, c.noise, p))
    o.innovation_motor_position, o.innovation_link_position = m.e[0], m.e[1]
    o.innovation_variance_motor_position, o.innovation_variance_link_position = m.S[0], m.S[1]
    o.motor_position, o.motor_velocity, o.wave_generator_position, o.wave_generator_velocity = x[0], x[1], x[2], x[3]
    o.bristle, o.link_position, o.link_velocity, o.flexible_position, o.flexible_velocity = x[4], x[5], x[6], x[7], x[8]
    o.external_torque, o.mesh_torque, o.stiffness, o.motor_constant, o.hysteresis = x[9], x[10], x[11], x[12], x[13]
    return OK if math.isfinite(o.torque + o.variance) else NOT_FINITE


@kernel
def _within_count(m, s, noise, p):
    """Return the variance of the joint torque [(N·m)²] within one count of the motor encoder, in equilibrium: wave
    generator and flexspline in series."""
    same = s.interval > 0.0 and abs(s.motor_position - m.reading) < 0.5 * noise.motor_step
    m.still = m.still + s.interval if same else 0.0
    m.reading = s.motor_position
    if m.still == 0.0:
        return 0.0
    x, kept = m.now, m.now[WAVE]
    here = model.transmission(x, model.state_of(x, UNREAD, s.time, UNREAD), p)
    x[WAVE] += noise.motor_step
    there = model.transmission(x, model.state_of(x, UNREAD, s.time, UNREAD), p)
    x[WAVE] = kept
    change = there.flexspline_torque - here.flexspline_torque
    share = here.wave_generator_torque - there.wave_generator_torque
    if share <= 0.0:
        return 0.0
    change /= 1.0 + change * here.ratio / share
    return min(m.still / _STILL, 1.0) * change * change / 12.0


@kernel
def _step(m, s, link_position, dt, c, p):
    """Predict over `dt` [s] to a sample (0: start) and update with its readings, the link's [rad] at that instant."""
    x, P, noise = m.x, m.P, c.noise
    if dt == 0.0:
        model.start(s.motor_position, link_position, arm_torque(s), s.time, p, x)
        for i in range(int(noise.count)):
            P[i, i] = noise.start[int(noise.active[i])]
        m.motor_ratio, m.link_ratio = 1.0, 1.0
        m.current = motor_current(s, x[MOTOR], x[LINK], 0.0, 0.0, p)
    else:
        command, heat = motor_current(s, x[MOTOR], x[LINK], x[MOTOR_RATE], 0.0, p), temperature(s, p)
        x[EXTERNAL] += arm_torque(s)
        if not math.isnan(c.kappa):
            predict_unscented(m, command, dt, heat, noise, c.kappa, p)
        else:
            linearise(m, command, dt, heat, noise, p)
            x[:] = m.points[0]
            propagate(m.F, P, m.A, int(noise.count), int(noise.count))
        x[EXTERNAL] -= arm_torque(s)
        add_noise(m, P, dt, noise)
        m.current = model.next_current(m.current, command, dt, p)
        m.predicted[:] = x
        m.predicted_P[:] = P
        measure(m, s.motor_position, link_position, s.time, noise, p)
    m.time = s.time


@kernel
def _late_step(m, s, c, p):
    """Step a filter with the link encoder's delay, and advance to now."""
    n = int(m.count)
    m.ring[n % RING] = s
    m.count = n + 1.0
    # Every sample whose link reading is available now, between the last two.
    k = int(m.done)
    while k <= n and (k == 0 or m.ring[k % RING].time + p.link_delay <= s.time or n - k >= RING - 2):
        then = m.ring[k % RING]
        late = s.time - then.time - p.link_delay
        link = s.link_position
        if n > 0 and k > 0:
            before = m.ring[(n - 1) % RING].link_position
            link -= min(max(late / s.interval, 0.0), 1.0) * (link - before)
        dt = then.time - m.time if k > 0 else 0.0
        _step(m, then, link, dt, c, p)
        m.times[k % RING], m.external[k % RING] = then.time, m.x[EXTERNAL]
        k += 1
        m.done = k
    _catch_up(m, k, n, c, p)


@kernel
def _catch_up(m, k, n, c, p):
    """Write state and covariance now, from the filter's last ones through the commands and motor readings of samples
    k to n.

    The covariance uses the Jacobian of the filter's last step: another one per sample would cost eight times as much.
    """
    x, P, noise, current, time = m.now, m.now_P, c.noise, m.current, m.time
    active = int(noise.count)
    x[:] = m.x
    P[:] = m.P
    # The external torque follows the line: by its walk it could be anything, and motor readings would change it.
    external = 0
    while int(noise.active[external]) != EXTERNAL:
        external += 1
    P[external, :] = 0.0
    P[:, external] = 0.0
    if k <= n and (not math.isnan(c.kappa) or k == 1):  # not linearised yet
        s = m.ring[k % RING]
        linearise(
            m, motor_current(s, x[MOTOR], x[LINK], x[MOTOR_RATE], 0.0, p), s.time - time, temperature(s, p), noise, p
        )
    while k <= n:
        s = m.ring[k % RING]
        dt, command = s.time - time, motor_current(s, x[MOTOR], x[LINK], x[MOTOR_RATE], 0.0, p)
        line = line_in_ring(m.times, m.external, int(m.done) - 1, _AHEAD * p.link_delay, time + 0.5 * dt)
        x[EXTERNAL] = line + arm_torque(s)
        _advance(x, current, command, time, dt, model.substeps(x, dt, p), temperature(s, p), noise, p, m.work)
        propagate(m.F, P, m.A, active, active)
        add_noise(m, P, dt, noise)
        P[external, external] = 0.0
        by_motor(m, x, P, s.motor_position, noise, p)
        x[EXTERNAL] = line
        current, time = model.next_current(current, command, dt, p), s.time
        k += 1


@kernel
def _advance(x, current, command, time, dt, steps, heat, noise, p, work):
    """Advance a state by `joint_model.advance`, with the decay of d over `dt` [s]."""
    model.advance(x, current, command, time, dt, steps, heat, p, work)
    x[MESH] *= math.exp(-dt / noise.mesh_time)


@kernel
def linearise(m, command, dt, heat, noise, p):
    """Write the state after `dt` [s] into `m.points[0]`, and the Jacobian into `m.F`.

    By forward differences through the compiled step, which include friction's sticking and sliding, breakpoints of
    the stiffness and every known effect.
    """
    x, F, base, y = m.x, m.F, m.points[0], m.points[1]
    n = int(noise.count)
    steps = model.substeps(x, dt, p)
    base[:] = x
    _advance(base, m.current, command, m.time, dt, steps, heat, noise, p, m.work)
    for j in range(n):
        a = int(noise.active[j])
        y[:] = x
        y[a] += STEPS[a]
        _advance(y, m.current, command, m.time, dt, steps, heat, noise, p, m.work)
        for i in range(n):
            b = int(noise.active[i])
            F[i, j] = (y[b] - base[b]) / STEPS[a]


@kernel
def predict_unscented(m, command, dt, heat, noise, kappa, p):
    """Predict state and covariance over `dt` [s] by sigma points x, x ± √((n + κ) P) columns, weights κ/(n + κ),
    1/(2(n + κ)) (Julier & Uhlmann 1997), each through the compiled step."""
    x, P, C, points = m.x, m.P, m.A, m.points
    n = int(noise.count)
    steps = model.substeps(x, dt, p)
    cholesky(P, C, n)
    spread, first, other = math.sqrt(n + kappa), kappa / (n + kappa), 0.5 / (n + kappa)
    for j in range(2 * n + 1):
        points[j] = x
        if j > 0:
            column, sign = (j - 1, spread) if j <= n else (j - 1 - n, -spread)
            for i in range(column, n):
                points[j, int(noise.active[i])] += sign * C[i, column]
        _advance(points[j], m.current, command, m.time, dt, steps, heat, noise, p, m.work)
    # Means as differences from the first point: the angles are large, their spread is small.
    x[:] = points[0]
    for i in range(n):
        a = int(noise.active[i])
        total = 0.0
        for j in range(1, 2 * n + 1):
            total += points[j, a] - points[0, a]
        x[a] += other * total
    for i in range(n):
        for l in range(i + 1):
            a, b = int(noise.active[i]), int(noise.active[l])
            total = first * (points[0, a] - x[a]) * (points[0, b] - x[b])
            for j in range(1, 2 * n + 1):
                total += other * (points[j, a] - x[a]) * (points[j, b] - x[b])
            P[i, l] = total
            P[l, i] = total


@kernel
def cholesky(P, C, n):
    """Write the lower factor of P[:n, :n] into C; a direction without variance gets a column of zeros."""
    for j in range(n):
        for i in range(j, n):
            total = P[i, j]
            for l in range(j):
                total -= C[i, l] * C[j, l]
            if i == j:
                C[j, j] = math.sqrt(total) if total > 1e-14 * P[j, j] else 0.0
            else:
                C[i, j] = total / C[j, j] if C[j, j] > 0.0 else 0.0


@kernel
def propagate(F, P, A, m, n):
    """P ← G P Gᵀ in place with G = [F; 0 1], symmetric. F: of the first m states, shape (≥ m, ≥ n); the other n − m
    are constants. A: scratch, as F."""
    for i in range(m):
        for j in range(n):
            A[i, j] = 0.0
        for l in range(n):
            f = F[i, l]
            if f != 0.0:
                for j in range(n):
                    A[i, j] += f * P[l, j]
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for l in range(n):
                total += A[i, l] * F[j, l]
            P[i, j] = total
            P[j, i] = total
        for j in range(m, n):
            P[i, j] = A[i, j]
            P[j, i] = A[i, j]


@kernel
def add_noise(m, P, dt, noise):
    """Add the process noise of `dt` [s] to P: more where the encoders' mean NIS is high; the rotor's is the
    current's."""
    for i in range(int(noise.count)):
        s = int(noise.active[i])
        P[i, i] += noise.walk[s] * dt
        if s == MESH:
            P[i, i] += noise.mesh_surge * dt * share(m.motor_ratio, noise)
        elif s == EXTERNAL:
            P[i, i] += noise.external_surge * dt * share(m.link_ratio, noise)
        elif s == MOTOR_RATE:
            P[i, i] += noise.current_walk * dt


@kernel
def share(ratio, noise):
    """Return how far a mean NIS is between the ends `low` and `high` of settings, 0 to 1."""
    return min(max((ratio - noise.low) / (noise.high - noise.low), 0.0), 1.0)


@kernel
def measure(m, motor_position, link_position, time, noise, p):
    """Update with both encoders in turn. The link's innovation is given the motor's, and uncorrelated to it."""
    x, H, n = m.x, m.H, int(noise.count)
    P, active = m.P[:n, :n], noise.active
    m.e[0], m.S[0] = by_motor(m, x, m.P, motor_position, noise, p)
    m.motor_ratio = noise.memory * m.motor_ratio + (1.0 - noise.memory) * m.e[0] ** 2 / m.S[0]
    predicted = model.read_link(x, time, p)
    H[MOTOR], H[LINK] = 0.0, slope_of_link(x, predicted, time, p)
    m.e[1] = link_position - predicted
    m.S[1] = update(x, P, active, H[:n], m.e[1], noise.link_variance, noise.link_step, m.PH)
    m.S[1] += noise.link_step**2 / 12.0
    m.link_ratio = noise.memory * m.link_ratio + (1.0 - noise.memory) * m.e[1] ** 2 / m.S[1]


@kernel
def by_motor(m, x, P, reading, noise, p):
    """Update x and P with a reading of the motor encoder [rad]; return the innovation [rad] and its variance [rad²]."""
    H, n = m.H, int(noise.count)
    H[:] = 0.0
    predicted = model.read_motor(x, p)
    H[MOTOR] = _slope_of_motor(x, predicted, p)
    e = reading - predicted
    S = update(x, P[:n, :n], noise.active, H[:n], e, noise.motor_variance, noise.motor_step, m.PH)
    return e, S + noise.motor_step**2 / 12.0


@kernel
def _slope_of_motor(x, reading, p):
    x[MOTOR] += _DIFFERENCE
    slope = (model.read_motor(x, p) - reading) / _DIFFERENCE
    x[MOTOR] -= _DIFFERENCE
    return slope


@kernel
def slope_of_link(x, reading, time, p):
    """Return the derivative of the link encoder's reading [rad] at a state by the link's angle."""
    x[LINK] += _DIFFERENCE
    slope = (model.read_link(x, time, p) - reading) / _DIFFERENCE
    x[LINK] -= _DIFFERENCE
    return slope
