"""A diagnosis' residuals for views: over time, and as torque balances with the variables that they may depend on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d

from .report import Report

if TYPE_CHECKING:
    from ..diagnosis.data.segments import Segment

CHANNELS = ("motor_current", "joint_torque", "link_balance")  # channels of a residual, in the order of its columns
_LEAST = 200  # samples for a view over a variable


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
        """Return the values of one of `dependence.VARIABLES`, shape (k,)."""
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
