"""The joint of joint.md, with the effects of recording.md's table, written down a second time and solved by SciPy.

Nothing here comes from `flexspline.models.laws` or `dynamics`: the record is read as a set of numbers (and of codes, for
discrepancies), the equations are the specification's.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline

from flexspline.models.parameters import PLACES, VARIABLES


def spring(torsion, p):
    """Flexspline torque [N·m], Eqs. (2), (7); backlash: k acts on sgn(Δθf)·max(0, |Δθf| − b/2).

    Smooth breakpoints: the slope goes straight from one stiffness to the next over `knee_width` to either side; its integral.
    """
    x = max(0.0, abs(torsion) - p["backlash"] / 2)
    knee1 = p["T1"] / p["K1"]
    knee2 = knee1 + (p["T2"] - p["T1"]) / p["K2"]
    if p["knee_width"] == 0:
        k = p["K1"] * min(x, knee1) + p["K2"] * max(0.0, min(x, knee2) - knee1) + p["K3"] * max(0.0, x - knee2)
    else:
        w = p["knee_width"]
        at = [0.0, knee1 - w, knee1 + w, knee2 - w, knee2 + w, 10 * knee2 + 1.0]
        slopes = [p["K1"], p["K1"], p["K2"], p["K2"], p["K3"], p["K3"]]
        points = [0.0, *(a for a in at[1:] if a < x), x]
        k = np.trapezoid(np.interp(points, at, slopes), points)
    return math.copysign(k, torsion)


def viscous(w, p):
    """Viscous friction [N·m, motor side]: bw w, at high speed as |w| to the stated power, from 20 Stribeck velocities on."""
    return p["bw"] * w * (1 + (w / (20 * p["vs"])) ** 2) ** ((p["viscous_exponent"] - 1) / 2)


def discrepancy(place, p, tm, tl, w, load, t):
    """Sum of the nonparametric discrepancies at a place: SciPy's cubic B-splines on a uniform grid, clamped."""
    total = 0.0
    for k, where in enumerate(p["discrepancy_place"]):
        if where and PLACES[int(where)] == place:
            name = VARIABLES[int(p["discrepancy_variable"][k])]
            x = {"link_position": tl, "direction_link_position": tl, "motor_position": tm % (2 * math.pi),
                 "motor_position_two_turns": tm % (4 * math.pi), "motor_velocity": w, "load": load, "time": t}[name]  # fmt: skip
            low, high, n = (p[f"discrepancy_{what}"][k] for what in ("low", "high", "count"))
            n, spacing = int(n), (high - low) / (n - 3)
            curve = BSpline(low + spacing * np.arange(-3, n + 1), p["discrepancy_coefficient"][k][:n], 3)
            value = float(curve(min(max(x, low), high - 1e-12 * (high - low))))
            total += value * (math.tanh(w) if name == "direction_link_position" else 1.0)
    return total


def derivative(t, x, p, motor_torque, external_torque, temperature=25.0):
    """Right-hand side: θm, θw, θl, their velocities, bristle, Dahl state, angle and rate of the flexible part of the link.

    `p` is a dict of the record's numbers; `temperature` [°C] a number or a function of time.
    """
    tm, tw, tl, wm, ww, wl, z, zd, phi, dphi = x
    theta = temperature(t) if callable(temperature) else temperature
    N = p["N"]
    error = slope = 0.0
    for A, k, phase in zip(p["amplitude"], p["order"], p["phase"], strict=True):
        error += A * math.sin(k * tw + phase)
        slope += A * k * math.cos(k * tw + phase)
    torsion = tw / N - tl - error
    rate = ww / N - wl - slope * ww
    load = spring(torsion, p) + p["df"] * rate
    dahl = 0.0
    if p["hysteresis_torque"]:
        dahl = rate - abs(rate) * zd / p["hysteresis_extent"]
        load += p["hysteresis_torque"] * zd / p["hysteresis_extent"]
    where = (p, tm, tl, ww, load, t)
    Tf = load + discrepancy("flexspline", *where)
    # Eqs. (3)-(5)
    delta = tm - tw
    Tw = -math.copysign(1.0, delta) / p["Cw"] * math.log(1 - p["Cw"] * p["Kw0"] * abs(delta)) + p["dw"] * (wm - ww)
    # LuGre with the effects on g(w)
    g = p["Fc"] + (p["Fs"] - p["Fc"]) * math.exp(-((ww / p["vs"]) ** 2))
    g *= 1 + p["friction_asymmetry"] * math.copysign(1.0, ww)
    g *= 1 + p["drift_amplitude"] * math.exp(-t / p["drift_time"])
    g += p["friction_load"] * abs(load) / N * (1.0 if load * ww >= 0 else p["back_driven_friction"])
    for A, n, phase in zip(p["friction_amplitude"], p["friction_order"], p["friction_phase"], strict=True):
        g += A * math.sin(n * tl + phase)
    warm = 1 + p["friction_temperature"] * (theta - p["reference_temperature"])
    g *= warm
    dz = ww - p["s0"] * abs(ww) / g * z
    friction = p["s0"] * z + p["s1"] * dz + warm * viscous(ww, p) + discrepancy("mesh", *where)
    cogging = sum(
        A * math.sin(n * tm + phase)
        for A, n, phase in zip(p["cogging_amplitude"], p["cogging_order"], p["cogging_phase"], strict=True)
    )
    link = external_torque - p["Mg"] * math.sin(tl + p["gravity_angle"]) - p["cable_stiffness"] * (tl - p["cable_rest"])
    link -= p["link_friction"] * math.tanh(wl / 0.01) + p["link_damping"] * wl
    link -= p["stop_stiffness"] * max(0.0, tl - p["stop_angle"])
    link += discrepancy("link", *where)
    # A share of the link's inertia on a spring: J_s (φ'' + θl'') = −k φ − d φ', resonant at the stated frequency where
    # the link is held.
    share, pulsation = p["flexible_share"], 2 * math.pi * p["flexible_frequency"]
    pull = pulsation**2 * phi + 2 * p["flexible_damping"] * pulsation * dphi  # per inertia
    al = (Tf - p["bl"] * wl + link + share * p["Jl"] * pull) / ((1 - share) * p["Jl"])
    return [
        wm,
        ww,
        wl,
        (motor_torque - p["bm"] * wm + cogging - Tw + discrepancy("rotor", *where)) / p["Jm"],
        (Tw - friction - Tf * (1 / N - slope)) / p["Jw"],
        al,
        dz,
        dahl,
        dphi,
        -al - pull if share else 0.0,
    ]


def numbers(record: np.ndarray) -> dict:
    """The record as plain numbers; only the orders that are there."""
    p = {}
    for name in record.dtype.names:
        value = record[0][name]
        p[name] = value.tolist() if isinstance(value, np.ndarray) else float(value)
    for group, prefix in (("", ""), ("cogging_", "cogging_"), ("friction_", "friction_")):
        there = [i for i, a in enumerate(p[f"{prefix}amplitude"]) if a != 0]
        for name in ("order", "amplitude", "phase"):
            p[f"{group}{name}"] = [p[f"{prefix}{name}"][i] for i in there]
    return p


def solve(record, inputs, period=1e-3, start=(0.0, 0.0, 0.0), rtol=1e-8, temperature=25.0):
    """Solve from rest under inputs that change only now and then.

    Args:
      record: parameters, shape (1,).
      inputs: (duration [s], motor torque [N·m], torque on the link [N·m]) of each piece.
      period: of the samples [s]; temperature: [°C], a number or a function of time.

    Returns:
      State at the samples, shape (n, 10), and its rate, shape (n, 10); see `derivative`.
    """
    p = numbers(record)
    x, t = np.array([*start, 0, 0, 0, 0, 0, 0, 0], dtype=float), 0.0
    states, rates = [], []
    tolerance = np.array([1e-9, 1e-9, 1e-11, 1e-7, 1e-7, 1e-9, 1e-11, 1e-13, 1e-11, 1e-9]) * rtol / 1e-8
    for duration, motor, external in inputs:
        ticks = round(duration / period)
        at = t + period * np.arange(ticks + 1)
        solved = solve_ivp(
            derivative,
            (at[0], at[-1]),
            x,
            "LSODA",
            t_eval=at,
            args=(p, motor, external, temperature),
            rtol=rtol,
            atol=tolerance,
        )
        assert solved.success, solved.message
        states.append(solved.y.T[:-1])
        rates.append(
            [derivative(s, y, p, motor, external, temperature) for s, y in zip(at[:-1], solved.y.T[:-1], strict=True)]
        )
        x, t = solved.y[:, -1], at[-1]
    return np.concatenate(states), np.concatenate(rates)


def torques(record, states, rates, inputs, period=1e-3):
    """Joint torque Ts [N·m] of solved states, from the link's equation: Jl θl'' less all that acts on it but Ts."""
    p = numbers(record)
    tl = states[:, 2]
    others = np.concatenate([np.full(round(duration / period), external) for duration, _, external in inputs])
    others -= p["Mg"] * np.sin(tl + p["gravity_angle"]) + p["cable_stiffness"] * (tl - p["cable_rest"])
    others -= p["stop_stiffness"] * np.maximum(0.0, tl - p["stop_angle"])
    others -= p["link_friction"] * np.tanh(states[:, 5] / 0.01) + p["link_damping"] * states[:, 5]
    flexible = p["flexible_share"] * p["Jl"] * rates[:, 9]
    return p["Jl"] * rates[:, 5] + flexible - others
