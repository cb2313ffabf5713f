"""A second plant: the equations of a joint with a strain wave gear, written and integrated independently of the package.

Nothing here calls the package's laws. The states are integrated by the classical Runge–Kutta method at 20 µs; encoders, current
sensor, time stamps, controller, motions and pushes are drawn per seed. `imperfect` adds small effects that a description does
not have: a sixth order of kinematic error, ripple of the current sensor, friction that depends on load, direction, angle and
time, hysteresis, a cyclic error of the motor encoder, jitter of the time stamps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

RATE = 1000.0
"""Samples per second."""
SUBSTEPS = 50
"""Integration steps per sample."""
NOMINAL = {
    "N": 100.0, "Jm": 1.38e-5, "Jw": 8.1e-6, "Kt": 0.0603, "bm": 2.0e-6, "K1": 8400.0, "K2": 9400.0, "K3": 13000.0,
    "T1": 3.9, "T2": 12.0, "df": 4.0, "Kw0": 1.14, "Cw": 20.0, "dw": 2.0e-3, "Fc": 0.018, "Fs": 0.022, "vs": 2.0, "s0": 10.0,
    "s1": 0.01, "bw": 6.0e-5, "bl": 0.02, "A2": 1.2e-4, "p2": 0.3, "A4": 2.0e-5, "p4": 1.1, "A6": 0.0, "p6": 0.0,
    "Jl": 0.35, "Mg": 9.0, "load": 0.0, "asymmetry": 0.0, "position": 0.0, "position_phase": 0.0, "warm": 0.0,
    "warm_time": 100.0, "hysteresis": 0.0, "extent": 1e-4, "limit": 3.3,
}  # fmt: skip
_NAMES = tuple(NOMINAL)
_RELATIVE = {
    "Kt": 0.02, "Jm": 0.05, "Jw": 0.1, "bm": 0.3, "bw": 0.3, "bl": 0.3, "dw": 0.3, "df": 0.3, "s0": 0.3, "s1": 0.3, "vs": 0.3,
    "A4": 0.3, "Kw0": 0.15, "Cw": 0.1, "A2": 0.2,
}  # fmt: skip
_Joint = np.dtype([(name, np.float64) for name in _NAMES])


@dataclass(frozen=True)
class Drawn:
    """A measured motion of a drawn joint; n samples.

    Attributes:
      time: stamps, shape (n,) [s].
      columns: motor_position, link_position [rad], motor_current [A], position_command [rad], shape (n,).
      torque: true joint torque, shape (n,) [N·m]; external: on the link, shape (n,) [N·m].
      inertia, gravity: nominal load [kg·m²], [N·m].
    """

    time: np.ndarray
    columns: dict[str, np.ndarray]
    torque: np.ndarray
    external: np.ndarray
    inertia: float
    gravity: float


@dataclass(frozen=True)
class DrawnJoint:
    """A joint drawn within its tolerances, and what its sensors add.

    Attributes:
      numbers: by name, as `NOMINAL`.
      zero: of the link encoder [rad]; offset: of the current sensor [A].
      ripple, ripple_phase: of the current sensor, 14 per turn [A], [rad]; cyclic: of the motor encoder [rad]; jitter [s].
      inertia, gravity: factors on the nominal load.
    """

    numbers: dict[str, float]
    zero: float = 0.0
    offset: float = 0.0
    ripple: float = 0.0
    ripple_phase: float = 0.0
    cyclic: float = 0.0
    jitter: float = 0.0
    inertia: float = 1.0
    gravity: float = 1.0


def draw_joint(
    rng: np.random.Generator, imperfect: bool = False, tolerance: float = 1.0, zeroed: bool = False
) -> DrawnJoint:
    """Draw a joint within `tolerance` times its tolerances; `zeroed`: its link encoder has no offset."""

    def normal(std: float) -> float:
        return float(tolerance * std * np.clip(rng.standard_normal(), -2.5, 2.5))

    numbers = dict(NOMINAL)
    for name, std in _RELATIVE.items():
        numbers[name] *= 1.0 + normal(std)
    common, friction = 1.0 + normal(0.07), 1.0 + normal(0.15)
    for name in ("K1", "K2", "K3"):
        numbers[name] *= common * (1.0 + normal(0.02))
    for name in ("Fc", "Fs"):
        numbers[name] *= friction
    numbers["p2"] += normal(0.2)
    numbers["p4"] += normal(0.2)
    zero, offset = (0.0 if zeroed else normal(1e-3)), normal(0.01)
    inertia, gravity = 1.0 + normal(0.03), 1.0 + normal(0.01)
    if not imperfect:
        return DrawnJoint(numbers, zero, offset, inertia=inertia, gravity=gravity)
    Fc, turn = numbers["Fc"], 2.0 * math.pi
    numbers |= {
        "A6": rng.uniform(0, 5e-6), "p6": rng.uniform(0, turn), "load": rng.uniform(0, 0.06),
        "asymmetry": rng.uniform(-0.08, 0.08), "position": Fc * rng.uniform(0, 0.1), "position_phase": rng.uniform(0, turn),
        "warm": rng.uniform(0, 0.15), "warm_time": rng.uniform(30, 300), "hysteresis": rng.uniform(0, 0.3),
        "extent": rng.uniform(5e-5, 2e-4),
    }  # fmt: skip
    return DrawnJoint(
        numbers, zero, offset, rng.uniform(0, 0.01), rng.uniform(0, turn), rng.uniform(0, 1e-3), rng.uniform(0, 1.5e-4),
        inertia, gravity,
    )  # fmt: skip


def draw_motion(rng: np.random.Generator, joint: DrawnJoint, kind: str, duration: float | None = None) -> Drawn:
    """Let a drawn joint move.

    Args:
      kind: `free` (nothing bolted on), `sweep` (a load that nobody touches) or `push` (one to four pushes).
      duration: [s]; drawn by default.
    """
    seconds = float(rng.uniform(15, 40)) if duration is None else duration
    n = int(seconds * RATE)
    inertia, gravity = 0.004, 0.0
    if kind != "free":
        gravity = float(rng.uniform(2.0, 12.0))
        inertia = gravity * float(rng.uniform(0.025, 0.05))
    command, speed = _course(rng, n)
    external = _pushes(rng, n) if kind == "push" else np.zeros(n)
    p = np.zeros(1, _Joint)
    for name, value in joint.numbers.items():
        p[name] = value
    p["Jl"], p["Mg"] = inertia * joint.inertia, gravity * joint.gravity
    numbers = p[0]
    state, torque, current = np.zeros((n, 9)), np.zeros(n), np.zeros(n)
    count = 2.0 * math.pi / 4096
    gains = np.array([rng.uniform(5, 12), rng.uniform(0.05, 0.12), rng.uniform(0, 30), count, joint.cyclic])
    _simulate(numbers, command, speed, external, gains, state, torque, current)
    if not np.isfinite(
        state
    ).all():  # the controller is unstable, and winds the wave generator beyond what it can be wound
        return draw_motion(rng, joint, kind, duration)
    motor = state[:, 0] + joint.cyclic * np.sin(state[:, 0])
    ripple = joint.ripple * np.sin(14.0 * state[:, 0] + joint.ripple_phase)
    cell = 2.0 * math.pi / 2**20
    columns = {
        "motor_position": count * np.floor(motor / count + 0.5),
        "link_position": cell * np.floor((state[:, 4] + joint.zero + 1.5e-6 * rng.standard_normal(n)) / cell + 0.5),
        "motor_current": np.round(current + ripple + joint.offset + 0.01 * rng.standard_normal(n), 4),
        "position_command": command,
    }
    stamps = np.arange(n) / RATE + np.clip(joint.jitter * rng.standard_normal(n), -4e-4, 4e-4)
    return Drawn(stamps, columns, torque, external, inertia, gravity)


def _smooth(s: np.ndarray) -> np.ndarray:
    """From 0 at 0 to 1 at 1 with minimum jerk."""
    s = np.minimum(s, 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s)


def _course(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Moves of minimum jerk with rests in between, or a sine: position [rad], velocity [rad/s]."""
    time = np.arange(n) / RATE
    if rng.random() < 0.25:
        amplitude, pulsation = rng.uniform(0.2, 1.4), 2 * math.pi * rng.uniform(0.05, 0.4)
        position = amplitude * _smooth(time / rng.uniform(0.5, 3.0)) * np.sin(min(pulsation, 1.6 / amplitude) * time)
        return position, np.gradient(position, time)
    position, at, where = np.zeros(n), 0, 0.0
    fast, rests = rng.uniform(0.15, 1.6), rng.uniform(0.0, 2.5)
    if rng.random() < 0.6:
        at = int(RATE * rng.uniform(0.2, 4.0))
    while at < n:
        to = float(rng.uniform(-1.5, 1.5))
        long = max(int(RATE * 1.875 * abs(to - where) / (fast * rng.uniform(0.5, 1.0))), 100)
        position[at:] = where + (to - where) * _smooth(np.arange(1, n - at + 1) / long)
        at, where = at + long + int(RATE * rng.uniform(0.0, rests)), to
    return position, np.gradient(position, time)


def _pushes(rng: np.random.Generator, n: int) -> np.ndarray:
    """One to four pushes of 1 to 8 N·m, smooth or sudden [N·m]."""
    found, time = np.zeros(n), np.arange(n) / RATE
    for _ in range(rng.integers(1, 5)):
        start, long = rng.uniform(0.3, 0.9 * time[-1]), rng.uniform(0.05, 2.0)
        size = rng.uniform(1.0, 8.0) * rng.choice((-1.0, 1.0))
        s = (time - start) / long
        shape = np.sin(math.pi * np.clip(s, 0.0, 1.0)) ** rng.choice((0.2, 1.0, 2.0))
        found += size * shape
    return found


@numba.njit(error_model="numpy")
def _derivative(y, i, external, time, p, out):
    """Time derivative of θm, ωm, θw, ωw, θl, ωl, z, Dahl's state; returns the joint torque."""
    theta, w = y[2], y[3]
    error, slope = 0.0, 0.0
    for order, amplitude, phase in ((2.0, p.A2, p.p2), (4.0, p.A4, p.p4), (6.0, p.A6, p.p6)):
        error += amplitude * math.sin(order * theta + phase)
        slope += order * amplitude * math.cos(order * theta + phase)
    torsion, rate = theta / p.N - y[4] - error, w / p.N - y[5] - slope * w
    a, b = abs(torsion), p.T1 / p.K1
    c = b + (p.T2 - p.T1) / p.K2
    spring = p.K1 * a if a < b else (p.T1 + p.K2 * (a - b) if a < c else p.T2 + p.K3 * (a - c))
    flex = math.copysign(spring, torsion) + p.df * rate + p.hysteresis * y[7] / p.extent
    twist = y[0] - theta
    wound = math.copysign(math.log(1.0 - p.Cw * p.Kw0 * abs(twist)) / p.Cw, twist) + p.dw * (y[1] - w)
    g = p.Fc + (p.Fs - p.Fc) * math.exp(-((w / p.vs) ** 2))
    g *= (1.0 + math.copysign(p.asymmetry, w)) * (1.0 + p.warm * math.exp(-time / p.warm_time))
    g += p.load * abs(flex) / p.N + p.position * math.sin(y[4] + p.position_phase)
    z = w - p.s0 * abs(w) / g * y[6]
    mesh = p.s0 * y[6] + p.s1 * z + p.bw * w
    torque = flex - p.bl * y[5]
    out[0], out[1] = y[1], (p.Kt * i - p.bm * y[1] - wound) / p.Jm
    out[2], out[3] = w, (wound - mesh - flex * (1.0 / p.N - slope)) / p.Jw
    out[4], out[5] = y[5], (torque - p.Mg * math.sin(y[4]) + external) / p.Jl
    out[6], out[7] = z, rate - abs(rate) / p.extent * y[7]
    return torque


@numba.njit(error_model="numpy")
def _simulate(p, command, speed, external, gains, state, torque, current):
    """Closed loop of a PID on the quantised motor encoder; Runge–Kutta in between."""
    y = np.zeros(9)
    k1, k2, k3, k4, at = np.zeros(9), np.zeros(9), np.zeros(9), np.zeros(9), np.zeros(9)
    kp, kd, ki, count, cyclic = gains
    integral, before = 0.0, 0.0
    h = 1.0 / RATE / SUBSTEPS
    for n in range(len(command)):
        state[n] = y
        reading = count * math.floor((y[0] + cyclic * math.sin(y[0])) / count + 0.5)
        error = p.N * command[n] - reading
        velocity = (reading - before) * RATE if n else 0.0
        before = reading
        i = kp * error + kd * (p.N * speed[n] - velocity) + integral
        if abs(i) < p.limit:
            integral += ki * error / RATE
        i = min(max(i, -p.limit), p.limit)
        current[n] = i
        torque[n] = _derivative(y, i, external[n], n / RATE, p, k1)
        for m in range(SUBSTEPS):
            t = n / RATE + m * h
            _derivative(y, i, external[n], t, p, k1)
            at[:] = y + 0.5 * h * k1
            _derivative(at, i, external[n], t, p, k2)
            at[:] = y + 0.5 * h * k2
            _derivative(at, i, external[n], t, p, k3)
            at[:] = y + h * k3
            _derivative(at, i, external[n], t, p, k4)
            y += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
