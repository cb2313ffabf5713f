"""A diagnosis' residuals for views: over time, and as torque balances with the variables that they may depend on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d

from .report import Report

if TYPE_CHECKING:
    from ..diagnosis.data.segments import Segment

CHANNELS = ("motor_current", "joint_torque", "link_balance")  # channels of a residual, in the order of its columns
_LEAST = 200  # samples for a view over a variable
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


@dataclass(frozen=True)
class Overlay:
    """One channel of one recording; k samples, NaN between its segments."""

    name: str  # of the recording
    channel: str  # one of `CHANNELS`
    unit: str  # of all values
    time: np.ndarray  # since the recording's start [s], shape (k,)
    measured: np.ndarray | None  # shape (k,), or None if there is only a residual
    # before, after: residuals, shape (k,); NaN where they are not used
    before: np.ndarray
    after: np.ndarray
    noise: float  # RMS of the residual by the sensors' noise
    held_out: tuple[tuple[float, float], ...]  # held-out parts of the time [s]


@dataclass(frozen=True)
class ResidualSeries:
    """A torque balance's residual and the variables that it may depend on, of all recordings; k used samples."""

    channel: str  # one of `CHANNELS`
    unit: str  # of residuals and noise
    before: np.ndarray  # shape (k,)
    after: np.ndarray  # shape (k,)
    noise: float  # rms
    # time, link, motor, velocity, load: [s] since the recording's start, [rad], [rad, motor side], [rad/s, motor side],
    # [N·m]
    time: np.ndarray
    link: np.ndarray
    motor: np.ndarray
    velocity: np.ndarray
    load: np.ndarray
    rising: np.ndarray  # whether the load rises

    def variable(self, key: str) -> np.ndarray:
        """Return the values of one of `VARIABLES`, shape (k,)."""
        return {
            "time": self.time, "link": self.link, "turn": np.mod(self.motor, 2 * np.pi), "velocity": self.velocity,
            "load": self.load, "loading": self.load, "direction": np.sign(self.velocity),
        }[key]  # fmt: skip

    def limits(self, key: str) -> tuple[float, float]:
        """Return the range of a variable without its rarest values."""
        if key == "turn":
            return 0.0, 2 * np.pi
        low, high = np.percentile(self.variable(key), [0.2, 99.8])
        return float(low), max(float(high), float(low) + 1e-9)

    def sides(self, key: str) -> tuple[np.ndarray, np.ndarray]:
        """Return which samples are forward and backward, or rising and falling; shape (k,) each, bool."""
        first = self.rising if key == "loading" else self.velocity > 0
        return first, ~first


def overlays(report: Report) -> list[list[Overlay]]:
    """Return the measured channels, each with its recordings."""
    d, segments = report.diagnosis, _segments(report)
    found = []
    for c, channel in enumerate(CHANNELS):
        if d.logged_as(channel)[0] not in d.residual:
            continue
        row = []
        for index, recording in enumerate(report.used.recordings):
            pieces = [s for s, segment in enumerate(segments) if segment.recording == index]
            if any(_counts(segments[s], c).any() for s in pieces):
                row.append(_overlay(report, c, recording.name, pieces))
        found.append(row)
    return [row for row in found if row]


def _overlay(report: Report, c: int, name: str, pieces: list[int]) -> Overlay:
    d = report.diagnosis
    segments = [_segments(report)[s] for s in pieces]
    sensed = c == 0 or all(segment.has_torque for segment in segments)
    measured, before, after = [], [], []
    for s, segment in zip(pieces, segments, strict=True):
        use = _counts(segment, c)
        if c < 2:  # at rest, friction is not determined
            use &= ~segment.at_rest
        # The measured value of the link's balance is the torque sensor's.
        measured.append(segment.measured[:, min(c, 1)])
        before.append(np.where(use, d.before[s][:, c], np.nan))
        after.append(np.where(use, d.after[s][:, c], np.nan))
    channel, factor = d.logged_as(CHANNELS[c])
    return Overlay(
        name,
        channel,
        d.residual[channel].unit,
        _joined([segment.at for segment in segments], instants=True),
        factor * _joined(measured) if sensed else None,
        factor * _joined(before),
        factor * _joined(after),
        d.residual[channel].noise,
        tuple(part for segment in segments for part in _held_out(segment)),
    )


def balances(report: Report) -> list[ResidualSeries]:
    """Return the measured torque balances with at least 200 used samples."""
    d = report.diagnosis
    found = []
    for c, balance in enumerate(CHANNELS):
        channel, factor = d.logged_as(balance)
        if channel not in d.residual:
            continue
        columns: list[list[np.ndarray]] = [[] for _ in range(8)]
        for segment, before, after in zip(_segments(report), d.before, d.after, strict=True):
            use = _counts(segment, c) & ~segment.at_rest
            theta_m, theta_l, w = segment.state.T[:3]
            rising = np.gradient(uniform_filter1d(segment.load, 3)) > 0
            every = (factor * before[:, c], factor * after[:, c], segment.at, theta_l, theta_m, w, segment.load, rising)
            for column, x in zip(columns, every, strict=True):
                column.append(x[use])
        joined = [np.concatenate(x) for x in columns]
        if len(joined[0]) > _LEAST:
            known = d.residual[channel]
            found.append(ResidualSeries(channel, known.unit, joined[0], joined[1], known.noise, *joined[2:]))
    return found


def _segments(report: Report) -> list[Segment]:
    """Segments of the measurement; empty if nothing was computed."""
    problem = report.diagnosis.problem
    return [] if problem is None else problem.segments


def _counts(segment: Segment, c: int) -> np.ndarray:
    """Which residuals of a channel are used, for the fit or held out; shape (k,), bool."""
    return segment.usable[:, c] | segment.held_out[:, c]


def _joined(pieces: list[np.ndarray], instants: bool = False) -> np.ndarray:
    """Concatenate the segments of a recording with gaps between them."""
    parts = []
    for i, piece in enumerate(pieces):
        if i:
            parts.append(np.array([pieces[i - 1][-1] + 1e-6 if instants else np.nan]))
        parts.append(piece)
    return np.concatenate(parts)


def _held_out(segment: Segment) -> list[tuple[float, float]]:
    """Parts of the time [s] that are held out from every fit."""
    kept, fitted = np.any(segment.held_out, axis=1), np.any(segment.usable, axis=1)
    counted = np.flatnonzero(kept | fitted)
    edges = np.flatnonzero(np.diff(np.r_[False, kept[counted], False]))
    at = segment.at[counted]
    return [(float(at[begin]), float(at[end - 1])) for begin, end in edges.reshape(-1, 2)]


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
