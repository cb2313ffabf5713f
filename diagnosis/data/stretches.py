"""Select the most informative parts of a long measurement: they cover angle, speed, direction, load, temperature and reversals.

Time and memory of a diagnosis grow with the number of samples; an hour of the same motion adds little to minutes of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...models.recording import Measurement, Recording
from ...models.signals import DRIVING, POSITIONS

LONGEST = 100.0
"""Seconds of a measurement that a diagnosis uses."""
_PIECE = 5.0  # s
_COARSE = 0.02  # s between the samples that are looked at
_BINS = 10  # of each quantity, over its range


def most_telling(measurement: Measurement, seconds: float = LONGEST) -> Measurement:
    """Return a measurement of at most `seconds`, from pieces of its recordings that add most, chosen greedily. Pieces keep their
    time; recordings without a chosen piece are left out."""
    if sum(r.time[-1] - r.time[0] for r in measurement.recordings) <= seconds:
        return measurement
    pieces = [(index, piece) for index, r in enumerate(measurement.recordings) for piece in _pieces(r)]
    covered = _covered(measurement.recordings, pieces)
    lasts = [(piece.stop - piece.start) * measurement.recordings[index].interval for index, piece in pieces]
    total, chosen, left = np.zeros(covered.shape[1]), [], seconds
    open_ = np.ones(len(pieces), bool)
    while open_.any() and left > 0:
        gain = np.where(open_, np.sum(np.log1p(total + covered) - np.log1p(total), axis=1), -np.inf)
        best = int(np.argmax(gain))
        open_[best] = False
        total += covered[best]
        left -= lasts[best]
        chosen.append(pieces[best])
    kept = []
    for index, recording in enumerate(measurement.recordings):
        taken = [np.arange(piece.start, piece.stop) for i, piece in chosen if i == index]
        if taken:  # with its first samples, from which its time counts
            kept.append(recording.at(np.unique(np.concatenate([[0, 1], *taken]))))
    return replace(measurement, recordings=tuple(kept))


def shortened(recording: Recording, seconds: float) -> Recording:
    """Return the most informative seconds of one recording (`most_telling`)."""
    return most_telling(Measurement(recording.name, Path(), (recording,)), seconds).recordings[0]


def _pieces(recording: Recording) -> Iterator[slice]:
    """Yield pieces of about `_PIECE` seconds of each segment."""
    for part in recording.segments:
        lasting = round((recording.time[part.stop - 1] - recording.time[part.start]) / _PIECE)
        count = min(max(lasting, 1), part.stop - part.start)
        edges = np.linspace(part.start, part.stop, count + 1).astype(int)
        yield from (slice(a, b) for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _covered(recordings: Sequence[Recording], pieces: Sequence[tuple[int, slice]]) -> np.ndarray:
    """Return the seconds of each piece in each bin of each quantity, shape (pieces, bins)."""
    steps = [max(round(_COARSE / r.interval), 1) for r in recordings]
    seen = [_quantities(r, step) for r, step in zip(recordings, steps, strict=True)]
    columns = []
    for k in range(len(seen[0][0])):
        low, high = np.percentile(np.concatenate([values[k] for values, _ in seen]), (0.5, 99.5))
        found = np.zeros((len(pieces), 2 * _BINS))
        for i, (index, piece) in enumerate(pieces):
            values, forward = seen[index]
            inside = slice(-(-piece.start // steps[index]), -(-piece.stop // steps[index]))
            bins = np.clip((values[k][inside] - low) / max(high - low, 1e-300) * _BINS, 0, _BINS - 1).astype(int)
            seconds = steps[index] * recordings[index].interval
            found[i] = seconds * np.bincount(bins + _BINS * forward[inside], minlength=2 * _BINS)
        columns.append(found)
    return np.hstack(columns)


def _quantities(recording: Recording, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return angle, speed, size of the acceleration, torque or current, temperature, age and angle of the last reversal of every
    `step`-th sample, shape (7, n), and whether it moves forward, shape (n,)."""
    time = recording.time[::step]
    x = recording[next(name for name in POSITIONS if name in recording)][::step]
    drive = recording[next(name for name in DRIVING if name in recording)][::step]
    v = np.gradient(x, time)
    a = np.gradient(v, time)
    turned = np.maximum.accumulate(np.where(np.diff(np.sign(v), prepend=0.0) != 0, np.arange(len(v)), 0))
    warm = recording.columns["temperature"][::step] if "temperature" in recording else np.zeros(len(x))
    return np.stack([x, v, np.abs(a), drive, warm, time - recording.time[0], x[turned]]), (v > 0).astype(int)
