"""The joint of joint.md, with the effects of recording.md's table, written down a second time and solved by SciPy.

Nothing here comes from `flexspline.models.laws`: the record is read as a set of numbers, the equations are the specification's.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp


def derivative(t, x, p, motor_torque, external_torque):
    """Right-hand side: θm, θw, θl, their velocities, bristle, Dahl state. `p` is a dict of the record's numbers."""
    tm, tw, tl, wm, ww, wl, z, zd = x
    N = p["N"]
    error = slope = 0.0
    for A, k, phi in zip(p["amplitude"], p["order"], p["phase"], strict=True):
        error += A * math.sin(k * tw + phi)
        slope += A * k * math.cos(k * tw + phi)
    torsion = tw / N - tl - error
    rate = ww / N - wl - slope * ww
    # Eqs. (2), (7); backlash: k acts on sgn(Δθf)·max(0, |Δθf| − b/2), df throughout
    x1 = max(0.0, abs(torsion) - p["backlash"] / 2)
    knee1 = p["T1"] / p["K1"]
    knee2 = knee1 + (p["T2"] - p["T1"]) / p["K2"]
    k = p["K1"] * min(x1, knee1) + p["K2"] * max(0.0, min(x1, knee2) - knee1) + p["K3"] * max(0.0, x1 - knee2)
    Tf = math.copysign(k, torsion) + p["df"] * rate
    dahl = 0.0
    if p["hysteresis_torque"]:
        dahl = rate - abs(rate) * zd / p["hysteresis_extent"]
        Tf += p["hysteresis_torque"] * zd / p["hysteresis_extent"]
    # Eqs. (3)-(5)
    delta = tm - tw
    Tw = -math.copysign(1.0, delta) / p["Cw"] * math.log(1 - p["Cw"] * p["Kw0"] * abs(delta)) + p["dw"] * (wm - ww)
    # LuGre with the effects on g(w)
    g = p["Fc"] + (p["Fs"] - p["Fc"]) * math.exp(-((ww / p["vs"]) ** 2))
    g *= 1 + math.copysign(p["friction_asymmetry"], ww)
    g *= 1 + p["drift_amplitude"] * math.exp(-t / p["drift_time"])
    g += p["friction_load"] * abs(Tf) / N
    for A, n, phi in zip(p["friction_amplitude"], p["friction_order"], p["friction_phase"], strict=True):
        g += A * math.sin(n * tl + phi)
    dz = ww - p["s0"] * abs(ww) / g * z
    friction = p["s0"] * z + p["s1"] * dz + p["bw"] * ww
    cogging = sum(
        A * math.sin(n * tm + phi)
        for A, n, phi in zip(p["cogging_amplitude"], p["cogging_order"], p["cogging_phase"], strict=True)
    )
    link = external_torque - p["Mg"] * math.sin(tl + p["gravity_angle"]) - p["cable_stiffness"] * (tl - p["cable_rest"])
    link -= p["stop_stiffness"] * max(0.0, tl - p["stop_angle"])
    return [
        wm,
        ww,
        wl,
        (motor_torque - p["bm"] * wm + cogging - Tw) / p["Jm"],
        (Tw - friction - Tf * (1 / N - slope)) / p["Jw"],
        (Tf - p["bl"] * wl + link) / p["Jl"],
        dz,
        dahl,
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


def solve(record, inputs, period=1e-3, start=(0.0, 0.0, 0.0), rtol=1e-8):
    """Solve from rest under inputs that change only now and then.

    Args:
      record: parameters, shape (1,).
      inputs: (duration [s], motor torque [N·m], torque on the link [N·m]) of each piece.
      period: of the samples [s].

    Returns:
      State at the samples, shape (n, 8), and its rate, shape (n, 8).
    """
    p = numbers(record)
    x, t = np.array([*start, 0, 0, 0, 0, 0], dtype=float), 0.0
    states, rates = [], []
    tolerance = np.array([1e-9, 1e-9, 1e-11, 1e-7, 1e-7, 1e-9, 1e-11, 1e-13]) * rtol / 1e-8
    for duration, motor, external in inputs:
        ticks = round(duration / period)
        at = t + period * np.arange(ticks + 1)
        solved = solve_ivp(
            derivative, (at[0], at[-1]), x, "LSODA", t_eval=at, args=(p, motor, external), rtol=rtol, atol=tolerance
        )
        assert solved.success, solved.message
        states.append(solved.y.T[:-1])
        rates.append([derivative(s, y, p, motor, external) for s, y in zip(at[:-1], solved.y.T[:-1], strict=True)])
        x, t = solved.y[:, -1], at[-1]
    return np.concatenate(states), np.concatenate(rates)


def torques(record, states, rates, inputs, period=1e-3):
    """Joint torque Ts [N·m] of solved states, from the link's equation: Jl θl'' less all that acts on it but Ts."""
    p = numbers(record)
    tl = states[:, 2]
    others = np.concatenate([np.full(round(duration / period), external) for duration, _, external in inputs])
    others -= p["Mg"] * np.sin(tl + p["gravity_angle"]) + p["cable_stiffness"] * (tl - p["cable_rest"])
    others -= p["stop_stiffness"] * np.maximum(0.0, tl - p["stop_angle"])
    return p["Jl"] * rates[:, 5] - others
