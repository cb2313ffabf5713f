"""Dependence of a residual on variables: explained share, means, and orders per turn of the motor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .residuals import ResidualSeries

VARIABLES = {
    "time": "time since the start [s]",
    "link": "link angle [rad]",
    "turn": "motor angle in one turn [rad]",
    "velocity": "motor velocity [rad/s]",
    "load": "load [N·m]",
    "loading": "load, rising or falling [N·m]",
    "direction": "direction of motion",
}
"""Variables that a residual may depend on, with units."""
BINS = 36
ORDERS = np.arange(0.5, 14.01, 0.5)  # orders per turn of the motor


def explained(b: ResidualSeries, residual: np.ndarray, key: str) -> float:
    """Return the share of a residual's mean square that its means in bins of a variable explain, 0 … 1, minus chance."""
    bins = _bins(b, key)
    count = np.bincount(bins)
    total = np.bincount(bins, residual)
    used = count > 20
    power = float(np.sum(total[used] ** 2 / count[used])) / max(float(np.sum(residual**2)), 1e-30)
    chance = 8.0 * used.sum() / max(len(residual), 1)  # neighbouring samples are correlated
    return float(np.clip((power - chance) / max(1 - chance, 1e-9), 0.0, 1.0))


def _bins(b: ResidualSeries, key: str) -> np.ndarray:
    """Bin of every sample, shape (k,): of the variable, and for angle and load also of the direction."""
    x = b.variable(key)
    if key == "direction":
        return (x > 0).astype(int)
    low, high = b.limits(key)
    i = np.clip(((x - low) / (high - low) * BINS).astype(int), 0, BINS - 1)
    return 2 * i + b.sides(key)[0] if key in ("link", "load", "loading") else i


def strongest_variable(found: Sequence[ResidualSeries]) -> tuple[ResidualSeries, str, float] | None:
    """Return the balance and variable that explain most above the noise, with the share explained; None if there is none."""
    best, found_best = 0.3, None
    for b in found:
        excess = float(np.mean(b.before**2)) / max(b.noise**2, 1e-30)
        for key in VARIABLES:
            share = explained(b, b.before, key)
            if share * excess > best:
                best, found_best = share * excess, (b, key, share)
    return found_best


def means(x: np.ndarray, r: np.ndarray, limits: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of a variable's bins, and a residual's means; shape (BINS,) each, NaN for less than 9 samples."""
    low, high = limits
    i = np.clip(((x - low) / (high - low) * BINS).astype(int), 0, BINS - 1)
    count = np.bincount(i, minlength=BINS)
    mean = np.bincount(i, r, minlength=BINS) / np.maximum(count, 1)
    return low + (np.arange(BINS) + 0.5) / BINS * (high - low), np.where(count > 8, mean, np.nan)


def orders(motor: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the amplitude of a residual, shape (k,), at each of `ORDERS` of the motor angle [rad], by least squares."""
    angle = motor[:, None] * ORDERS
    X = np.concatenate([np.cos(angle), np.sin(angle), np.ones((len(motor), 1))], axis=1)
    G = X.T @ X
    c = np.linalg.solve(G + 1e-9 * np.trace(G) / len(G) * np.eye(len(G)), X.T @ residual)
    return np.hypot(c[: len(ORDERS)], c[len(ORDERS) : 2 * len(ORDERS)])
