"""Metrics of an estimate: error, noise, delay and response time, share of robust mode, NIS."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import find_peaks

from ...estimator.estimator import Posterior
from ...models.kernels import kernel

_WINDOW = 0.2  # s: slower than this is signal, faster is noise
_STEADY_RATE = 0.5  # N·m/s: slower than this is steady
_LEAST_SWING = 0.5  # N·m by which the torque must change for a delay to show
_LONGEST_DELAY = 0.1  # s
_EARLIEST = 5  # samples by which an estimate may be early
_RESPONSE = 0.9
_LEVEL = 0.05  # s before a push that give an estimate's level
_LONGEST_PUSH = 2.0  # s: a longer disturbance is a load


def errors(estimate: np.ndarray, truth: np.ndarray, reading: np.ndarray, kept: np.ndarray) -> dict[str, float]:
    """Return RMS and largest error against the noise-free torque, and RMS against the sensor [N·m]; shape (n,) each."""
    e = (estimate - truth)[kept]
    return {
        "rms": float(np.sqrt(np.mean(e**2))),
        "max": float(np.max(np.abs(e))),
        "rms_to_sensor": float(np.sqrt(np.mean((estimate - reading)[kept] ** 2))),
    }


def steady(truth: np.ndarray, dt: float, kept: np.ndarray) -> np.ndarray:
    """Return where the torque has changed by less than 0.5 N·m/s for 0.2 s, shape (n,)."""
    width = _window(dt)
    rate = np.abs(np.gradient(moving_mean(truth, width), dt))
    fast = (rate > _STEADY_RATE).astype(float)
    return kept & (moving_mean(fast, 2 * width) < 0.5 / (2 * width))


def noise(estimate: np.ndarray, truth: np.ndarray, dt: float, where: np.ndarray) -> float:
    """Return the standard deviation [N·m] of the error's part faster than 0.2 s, in steady state."""
    if np.count_nonzero(where) < 2:
        return float("nan")
    e = estimate - truth
    return float(np.std((e - moving_mean(e, _window(dt)))[where]))


def moving_mean(x: np.ndarray, width: int) -> np.ndarray:
    """Return the centred mean over `width` samples, fewer at the ends; shape (n,)."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    half = width // 2
    low = np.clip(np.arange(len(x)) - half, 0, len(x))
    high = np.clip(np.arange(len(x)) + half + 1, 0, len(x))
    return (total[high] - total[low]) / (high - low)


def delay(estimate: np.ndarray, truth: np.ndarray, dt: float, where: np.ndarray) -> float | None:
    """Return the delay [s] with which the truth explains the estimate best: least squares, with a parabola between samples.

    None if the torque changes too little, or if no delay up to 0.1 s is a minimum.
    """
    if np.count_nonzero(where) < 2 or np.ptp(truth[where]) < _LEAST_SWING:
        return None
    longest = round(_LONGEST_DELAY / dt)
    ends = max(longest, _EARLIEST)
    indices = np.flatnonzero(where[longest : max(len(truth) - ends, longest)]) + longest
    if len(indices) < 2:
        return None
    total = np.zeros(_EARLIEST + longest)
    _shift_costs(np.ascontiguousarray(estimate), np.ascontiguousarray(truth), indices, _EARLIEST, total)
    shifts, cost = np.arange(-_EARLIEST, longest), total[::-1] / len(indices)
    best = int(np.argmin(cost))
    if 0 < best < len(cost) - 1:
        left, middle, right = cost[best - 1 : best + 2]
        curvature = left - 2 * middle + right
        if curvature > 0:
            return float((shifts[best] + 0.5 * (left - right) / curvature) * dt)
    return None


@kernel
def _shift_costs(
    estimate: np.ndarray, truth: np.ndarray, indices: np.ndarray, earliest: int, total: np.ndarray
) -> None:
    """Add squares of estimate[i] − truth[i − s] over `indices`, for shifts s from the latest to −earliest, to `total`."""
    count = len(total)
    for i in indices:
        first = i + earliest - count + 1
        for j in range(count):  # latest shift first: memory is read forwards
            d = estimate[i] - truth[first + j]
            total[j] += d * d


def pushes(external_torque: np.ndarray, dt: float) -> list[tuple[int, int]]:
    """Return first and last tick of every push: a non-zero external torque of at most 2 s."""
    active = np.concatenate([[False], external_torque != 0, [False]])
    edges = np.flatnonzero(active[1:] != active[:-1])
    found = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in found if (b - a) * dt <= _LONGEST_PUSH]


def _window(dt: float) -> int:
    return round(_WINDOW / dt)


def responses(estimate: np.ndarray, truth: np.ndarray, dt: float, events: list[tuple[int, int]]) -> np.ndarray:
    """Return the time [s] from truth to estimate at 90 % of the first swing of the torque in each push, shape
    (pushes,), of pushes that change the torque by 0.2 N·m or more; NaN if the estimate does not reach 90 %.

    The swing ends at the first extremum of the true torque above half its largest change during the push. Truth and
    estimate each start from their level before the push, the mean of 50 ms: a constant error does not count.
    """
    found = [response(estimate, truth, dt, begin, end) for begin, end in events]
    return np.array([time for time in found if time is not None], dtype=np.float64)


def response(estimate: np.ndarray, truth: np.ndarray, dt: float, begin: int, end: int) -> float | None:
    """Return one of `responses` [s]; None for a push that changes the torque too little."""
    change = truth[begin:end] - truth[begin]
    if len(change) < 3 or np.max(np.abs(change)) < 0.2:
        return None
    size = np.abs(change)
    peaks, _ = find_peaks(size, height=0.5 * float(np.max(size)))
    extremum = int(peaks[0]) if len(peaks) else int(np.argmax(size))
    goal = _RESPONSE * change[extremum]
    level = float(np.mean(estimate[max(begin - max(round(_LEVEL / dt), 1), 0) : begin + 1]))
    made = (estimate[begin:end] - level) * np.sign(goal) >= abs(goal)
    itself = int(np.argmax(change * np.sign(goal) >= abs(goal)))
    return (int(np.argmax(made)) - itself) * dt if np.any(made) else np.nan


@dataclass(frozen=True)
class Reference:
    """Reference for metrics of one run; arrays of shape (n,) [N·m]."""

    # truth, reading, raw: the noise-free Ts, the torque sensor, the raw compliance model
    truth: np.ndarray
    reading: np.ndarray
    raw: np.ndarray
    external_torque: np.ndarray  # on the link; it defines the pushes
    dt: float  # sample period [s]
    transient: float  # time at the start to leave out [s]

    @cached_property
    def kept(self) -> np.ndarray:
        """After the transient, shape (n,), bool."""
        return np.arange(len(self.truth)) * self.dt >= self.transient

    @cached_property
    def calm(self) -> np.ndarray:
        """In steady state, shape (n,), bool."""
        return steady(self.truth, self.dt, self.kept)

    @cached_property
    def events(self) -> list[tuple[int, int]]:
        """The pushes after the transient."""
        return [(a, b) for a, b in pushes(self.external_torque, self.dt) if self.kept[a]]

    @cached_property
    def raw_noise(self) -> float:
        """Noise of the raw compliance model [N·m]."""
        return noise(self.raw, self.truth, self.dt, self.calm)

    @cached_property
    def during(self) -> np.ndarray:
        """Samples for the delay, shape (n,), bool: during pushes, or all without pushes."""
        if not self.events:
            return self.kept
        during = np.zeros(len(self.truth), dtype=bool)
        for a, b in self.events:
            during[a : b + _window(self.dt)] = True
        return during

    def evaluate(self, estimate: np.ndarray) -> dict[str, float | None]:
        """Return all metrics of one estimate, shape (n,) [N·m]."""
        times = responses(estimate, self.truth, self.dt, self.events)
        lag = delay(estimate, self.truth, self.dt, self.during)
        own_noise = noise(estimate, self.truth, self.dt, self.calm)
        return {
            **errors(estimate, self.truth, self.reading, self.kept),
            "noise": finite(own_noise),
            "noise_ratio": finite(own_noise / self.raw_noise) if self.raw_noise > 0 else None,
            "delay_ms": None if lag is None else 1e3 * lag,
            "response_ms": 1e3 * float(np.nanmean(times)) if np.isfinite(times).any() else None,
            "missed": float(np.mean(np.isnan(times))) if len(times) else None,
        }

    def evaluate_posterior(self, found: Posterior) -> dict[str, float | None]:
        """Return all metrics of an estimator's result, with its own variance, and 1 if it is not to be trusted."""
        nis = found.nis
        return {
            **self.evaluate(found.mean),
            "robust_share": None if found.robust is None else float(np.mean(found.robust[self.kept])),
            "mean_nis": None if nis is None else float(np.mean(nis[self.kept])),
            "untrusted": float(found.untrusted is not None),
        }


def finite(value: float) -> float | None:
    """Return the value, or None if it is not finite."""
    return float(value) if np.isfinite(value) else None
