"""Measurements of a joint that hides something: a closed loop over the joint's laws, independent of the MuJoCo plant.

A fine fixed step, a PID controller on the quantised motor encoder, three recordings: free, pushed, swept.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit

from flexspline.models import causes, laws
from flexspline.models.calibration import Calibration
from flexspline.models.joint import Joint
from flexspline.models.recording import Measurement, Recording

SUBSTEPS = 20
COUNT = 2 * math.pi / 4096
LINK_COUNT = 2 * math.pi / 2**20
WARM_UP = {"free": 22.0, "push": 25.0, "sweep": 29.0}
"""Temperature [°C] at which each recording starts; it rises by 3 K."""
_COLUMNS = ("motor_position", "link_position", "motor_current", "joint_torque")


@njit(cache=True)
def _simulate(p, command, push, bump, gains, noise, temperature):
    """Readings at 1 kHz, shape (n, 4): motor encoder, link encoder, current, joint torque.

    `bump` is (height [N·m], angle [rad], width [rad]) of a torque on the link that no known cause explains.
    """
    n = len(command)
    h = 1e-3 / SUBSTEPS
    out = np.empty((n, 4))
    thm = thw = thl = vm = w = vl = z = dahl = swing = swing_rate = 0.0
    integral = last = derivative = 0.0
    past = np.zeros(int(0.1 / h) + 2)
    head = 0
    for k in range(n):
        time = k * 1e-3
        encoder = round(laws.motor_reading(thm, p) / COUNT) * COUNT
        error = p.N * command[k] - encoder
        derivative += ((error - last) / 1e-3 * (k > 0) - derivative) * gains[3]
        last = error
        integral = min(max(integral + gains[2] * error * 1e-3, -1.0), 1.0)
        current = min(max(gains[0] * error + gains[1] * derivative + integral, -p.current_limit), p.current_limit)
        for s in range(SUBSTEPS):
            slope = 1.0 / p.N - laws.kinematic_error_slope(thw, p)
            torsion = thw / p.N - thl - laws.kinematic_error(thw, p)
            rate = w * slope - vl
            dahl = laws.dahl_step(dahl, rate, h, p)
            Tf = laws.flexspline_spring(torsion, p) + p.df * rate + laws.hysteresis_torque(dahl, p)
            Ts = Tf - p.bl * vl
            if s == 0:
                late = round(p.link_delay / h)
                seen = past[(head - 1 - late) % len(past)] if late > 0 and k > 0 else thl
                out[k, 0] = encoder
                reading = laws.link_reading(seen, p) + 1.5e-6 * noise[k, 0]
                out[k, 1] = round(reading / LINK_COUNT) * LINK_COUNT
                out[k, 2] = laws.current_reading(current, p) + 0.01 * noise[k, 1]
                out[k, 3] = laws.torque_reading(Ts, time, p) + 0.03 * noise[k, 2]
            g = laws.stribeck_friction(w, thl, Tf, time + s * h, temperature[k], p)
            z = laws.bristle_step(z, w, g, h, p)
            friction = laws.mesh_friction(z, w, g, p) + laws.viscous_friction(w, temperature[k], p)
            Tw = laws.wave_generator_spring(thm - thw, p) + p.dw * (vm - w)
            on_link = Ts + laws.gravity_torque(thl, p) + laws.link_torque(thl, p) + push[k]
            on_link += bump[0] * math.exp(-0.5 * ((thl - bump[1]) / bump[2]) ** 2)
            vm += h * (p.Kt * current - p.bm * vm - Tw + laws.cogging_torque(thm, p)) / p.Jm
            w += h * (Tw - friction - Tf * slope) / p.Jw
            al = (on_link + laws.flexible_torque(swing, swing_rate, p)) / (p.Jl - laws.flexible_inertia(p))
            natural = 2.0 * math.pi * p.flexible_frequency
            swing_rate -= h * (al + natural * (natural * swing + 2.0 * p.flexible_damping * swing_rate))
            swing += h * swing_rate
            vl += h * al
            thm += h * vm
            thw += h * w
            thl += h * vl
            past[head] = thl
            head = (head + 1) % len(past)
    return out


def _path(points, durations, dwells) -> np.ndarray:
    """Minimum-jerk moves between points [rad] with dwells [s], sampled at 1 kHz."""
    parts, at = [np.zeros(int(dwells[0] * 1000))], 0.0
    for point, duration, dwell in zip(points, durations, dwells[1:], strict=True):
        s = np.linspace(0, 1, int(duration * 1000))
        parts += [at + (point - at) * s**3 * (10 - 15 * s + 6 * s**2), np.full(int(dwell * 1000), point)]
        at = point
    return np.concatenate(parts)


def _motions(rng: np.random.Generator) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Command and push of each recording."""
    U = rng.uniform
    free = _path([U(1.4, 1.7), -U(1.4, 1.7), 0.0], [U(2.5, 5), U(8, 13), U(2.5, 5)], [0.5, 0.7, 0.7, 0.5])
    sweep = _path(
        [U(1.25, 1.45), -U(1.25, 1.45), U(1.25, 1.45), -U(1.1, 1.4), 0.0],
        [U(2.5, 4), U(4, 6), U(11, 14), U(4, 6), U(3, 5)],
        [0.3, 1.0, 1.0, 1.0, 0.8, 0.3],
    )
    held = _path([U(1.2, 1.4), 0.0], [U(4.5, 7), U(4.5, 7)], [0.5, U(9, 12), 0.5])
    push = np.zeros(len(held))
    for start in rng.integers(1500, len(held) - 2500, 6):
        length = int(U(100, 300))
        push[start : start + length] += U(-7, 7) * np.sin(np.pi * np.arange(length) / length)
    return {"free": (free, 0 * free), "push": (held, push), "sweep": (sweep, 0 * sweep)}


def measure(
    joint: Joint,
    seed: int,
    hidden: tuple[str, ...] = (),
    *,
    exact: bool = False,
    size: float = 1.0,
    bump: tuple[float, float, float] = (0.0, 0.0, 1.0),
    bare: bool = False,
) -> tuple[Measurement, dict[str, dict[str, float]]]:
    """Draw a joint within its tolerances, hide causes in it, and measure it.

    Args:
      exact: the joint has exactly its nominal numbers.
      size: of the effects, in ordinary sizes.
      bare: no torque sensor, logged at an irregular 250 Hz.

    Returns:
      The measurement, and the hidden parameters by cause.
    """
    rng = np.random.default_rng(seed)
    calibration = Calibration(joint)
    x = np.zeros(calibration.size) if exact else calibration.draw(rng)
    base = calibration.record(x, joint.mount("link"))
    truth = {name: causes.get(name).draw(base[0], rng, size) for name in hidden}
    gains = np.array([rng.uniform(5, 10), rng.uniform(0.05, 0.1), rng.uniform(5, 30), rng.uniform(0.1, 0.4)])
    recordings = []
    for name, (command, push) in _motions(rng).items():
        mounting = joint.mount("no_load" if name == "free" else "link")
        record = calibration.record(x, mounting)
        for cause, values in truth.items():
            causes.get(cause).apply(record[0], values)
        noise = rng.standard_normal((len(command), 3))
        temperature = WARM_UP[name] + np.linspace(0.0, 3.0, len(command))
        read = _simulate(record[0], command, push, np.array(bump), gains, noise, temperature)
        kept = np.arange(len(command))
        if bare:
            kept = np.cumsum(4 + rng.integers(-1, 2, len(command) // 4) + 4 * (rng.random(len(command) // 4) < 0.02))
            kept = kept[kept < len(command)]
        recordings.append(
            Recording(
                name=name,
                time=1e-3 * kept,
                columns={
                    name: read[kept, i] for i, name in enumerate(_COLUMNS) if not (bare and name == "joint_torque")
                }
                | ({"temperature": temperature[kept]} if "friction_temperature" in hidden else {}),
                link=mounting,
                external="unmeasured" if name == "push" else "none",
            )
        )
    return Measurement(f"seed {seed}", Path(), tuple(recordings)), truth
