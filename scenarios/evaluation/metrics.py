"""What an estimate is worth: error, noise, delay and response time, share of robust mode, NIS."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...estimator.estimator import Posterior
from ...models.kernels import kernel

_WINDOW = 0.2  # s: slower than this is signal, faster is noise
_STEADY_RATE = 0.5  # N·m/s: slower than this is steady
_LEAST_SWING = 0.5  # N·m by which the torque must change for a delay to show
_LONGEST_DELAY = 0.1  # s
_EARLIEST = 5  # samples by which an estimate may be early
_RESPONSE = 0.9
_LEVEL = 0.05  # s before a push, over which an estimate's level is taken
_LONGEST_PUSH = 2.0  # s: a disturbance that lasts longer is a load, not a push


def errors(estimate: np.ndarray, truth: np.ndarray, reading: np.ndarray, kept: np.ndarray) -> dict[str, float]:
    """RMS and largest error against the noise-free torque, and RMS against the noisy sensor [N·m]; shape (n,) each."""
    e = (estimate - truth)[kept]
    return {
        "rms": float(np.sqrt(np.mean(e**2))),
        "max": float(np.max(np.abs(e))),
        "rms_to_sensor": float(np.sqrt(np.mean((estimate - reading)[kept] ** 2))),
    }


def steady(truth: np.ndarray, dt: float, kept: np.ndarray) -> np.ndarray:
    """Where the torque has been changing by less than 0.5 N·m/s for 0.2 s, shape (n,)."""
    width = _window(dt)
    rate = np.abs(np.gradient(moving_mean(truth, width), dt))
    fast = (rate > _STEADY_RATE).astype(float)
    return kept & (moving_mean(fast, 2 * width) < 0.5 / (2 * width))


def noise(estimate: np.ndarray, truth: np.ndarray, dt: float, where: np.ndarray) -> float:
    """Standard deviation [N·m] of the error's part that is faster than 0.2 s, in steady state."""
    if np.count_nonzero(where) < 2:
        return float("nan")
    e = estimate - truth
    return float(np.std((e - moving_mean(e, _window(dt)))[where]))


def moving_mean(x: np.ndarray, width: int) -> np.ndarray:
    """Centred mean over `width` samples, shorter at the ends; shape (n,)."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    half = width // 2
    low = np.clip(np.arange(len(x)) - half, 0, len(x))
    high = np.clip(np.arange(len(x)) + half + 1, 0, len(x))
    return (total[high] - total[low]) / (high - low)


def delay(estimate: np.ndarray, truth: np.ndarray, dt: float, where: np.ndarray) -> float | None:
    """Delay [s] at which the truth explains the estimate best: least squares over whole samples, parabola between.

    None where the torque does not change enough for a delay to show, or none up to 0.1 s explains the estimate.
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
    """Add squares of estimate[i] − truth[i − s] over `indices`, for shifts s from the latest to −earliest, to `total`.

    Compiled and without the interpreter's lock: many runs are measured side by side.
    """
    count = len(total)
    for i in indices:
        first = i + earliest - count + 1
        for j in range(count):  # of the latest shift first, so that memory is read forwards
            d = estimate[i] - truth[first + j]
            total[j] += d * d


def pushes(external_torque: np.ndarray, dt: float) -> list[tuple[int, int]]:
    """First and last tick of every push: where the external torque departs from rest for no longer than 2 s."""
    active = np.concatenate([[False], external_torque != 0, [False]])
    edges = np.flatnonzero(active[1:] != active[:-1])
    found = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in found if (b - a) * dt <= _LONGEST_PUSH]


def _window(dt: float) -> int:
    """Samples of the window between signal and noise."""
    return round(_WINDOW / dt)


def response_time(estimate: np.ndarray, truth: np.ndarray, dt: float, events: list[tuple[int, int]]) -> float | None:
    """Mean of `responses` [s] over the pushes that the estimate follows; None where there is none."""
    times = responses(estimate, truth, dt, events)
    return float(np.nanmean(times)) if np.isfinite(times).any() else None


def missed(estimate: np.ndarray, truth: np.ndarray, dt: float, events: list[tuple[int, int]]) -> float | None:
    """Share of the pushes that the estimate never follows (`responses`); None where there is none to follow."""
    times = responses(estimate, truth, dt, events)
    return float(np.mean(np.isnan(times))) if len(times) else None


def responses(estimate: np.ndarray, truth: np.ndarray, dt: float, events: list[tuple[int, int]]) -> np.ndarray:
    """Time [s] after the truth at which the estimate has made 90 % of the first swing that each push gives the torque.

    The swing ends at the first extremum of the true torque that exceeds half the largest change during the push; the time
    counts from where the true torque itself has made 90 % of it. Both count from their own level before the push, the mean of
    50 ms: an estimate that is off by a constant is neither early nor late.

    Returns:
      Shape (pushes,), of those that change the torque by 0.2 N·m or more; NaN where the estimate never gets there during one.
    """
    found = [response(estimate, truth, dt, begin, end) for begin, end in events]
    return np.array([time for time in found if time is not None], dtype=np.float64)


def response(estimate: np.ndarray, truth: np.ndarray, dt: float, begin: int, end: int) -> float | None:
    """One of `responses` [s]; None of a push that changes too little."""
    change = truth[begin:end] - truth[begin]
    if len(change) < 3 or np.max(np.abs(change)) < 0.2:
        return None
    extremum = _first_peak(np.abs(change), 0.5 * float(np.max(np.abs(change))))
    goal = _RESPONSE * change[extremum]
    level = float(np.mean(estimate[max(begin - _before(dt), 0) : begin + 1]))
    made = (estimate[begin:end] - level) * np.sign(goal) >= abs(goal)
    itself = int(np.argmax(change * np.sign(goal) >= abs(goal)))
    return (int(np.argmax(made)) - itself) * dt if np.any(made) else np.nan


def _before(dt: float) -> int:
    """Samples before a push over which an estimate's level is taken."""
    return max(round(_LEVEL / dt), 1)


def _first_peak(x: np.ndarray, height: float) -> int:
    """Index of the first local maximum of x, shape (n,), that is as high as `height`; the middle of a flat one.

    The ends are no maxima; where there is none, the index of the largest value.
    """
    begins = np.r_[0, np.flatnonzero(np.diff(x)) + 1]  # of runs of equal values
    values = x[begins]
    ends = np.r_[begins[1:], len(x)] - 1
    inner = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] > values[2:]) & (values[1:-1] >= height)) + 1
    return int((begins[inner[0]] + ends[inner[0]]) // 2) if len(inner) else int(np.argmax(x))


@dataclass(frozen=True)
class Reference:
    """What estimates of one run are measured against; arrays of shape (n,) [N·m].

    Attributes:
      truth, reading, raw: the noise-free Ts, the torque sensor, the raw compliance model.
      external_torque: on the link, which gives the pushes.
      dt: sample period [s].
      transient: time at the start that is left out [s].
    """

    truth: np.ndarray
    reading: np.ndarray
    raw: np.ndarray
    external_torque: np.ndarray
    dt: float
    transient: float

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
        """Where the delay is measured: during pushes where there are any, shape (n,), bool."""
        if not self.events:
            return self.kept
        during = np.zeros(len(self.truth), dtype=bool)
        for a, b in self.events:
            during[a : b + _window(self.dt)] = True
        return during

    def response_ms(self, estimate: np.ndarray) -> float | None:
        """Mean time after the truth to 90 % of a push [ms] of an estimate, shape (n,) [N·m] (`response_time`)."""
        response = response_time(estimate, self.truth, self.dt, self.events)
        return None if response is None else 1e3 * response

    def evaluate(self, estimate: np.ndarray) -> dict[str, float | None]:
        """All measures of one estimate, shape (n,) [N·m]."""
        lag = delay(estimate, self.truth, self.dt, self.during)
        own_noise = noise(estimate, self.truth, self.dt, self.calm)
        return {
            **errors(estimate, self.truth, self.reading, self.kept),
            "noise": finite(own_noise),
            "noise_ratio": finite(own_noise / self.raw_noise) if self.raw_noise > 0 else None,
            "delay_ms": None if lag is None else 1e3 * lag,
            "response_ms": self.response_ms(estimate),
            "missed": missed(estimate, self.truth, self.dt, self.events),
        }

    def evaluate_posterior(self, found: Posterior) -> dict[str, float | None]:
        """All measures of what an estimator says: of its estimate, of what it believes of itself, and 1 where it is not to be
        trusted."""
        nis = found.nis
        return {
            **self.evaluate(found.mean),
            "robust_share": None if found.robust is None else float(np.mean(found.robust[self.kept])),
            "mean_nis": None if nis is None else float(np.mean(nis[self.kept])),
            "untrusted": float(found.untrusted is not None),
        }


def finite(value: float) -> float | None:
    """The value; None where it is not finite."""
    return float(value) if np.isfinite(value) else None
