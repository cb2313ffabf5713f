"""What a residual consists of when the model is right: sensor noise and model discrepancy; and the filter that makes it white.

The residual of a balance in a segment is the sum of

* *sensor noise*: what the stated noise of encoders, current and torque sensor leaves after smoothing and replay, an
  autoregression fitted to noise replicates (`data.segments`);
* *model discrepancy*: what the description can never hold. Ornstein–Uhlenbeck processes of fixed correlation times, one a
  frequency band, whose variances are learned for each balance beside the parameters. A real joint has some in every band; a
  joint that follows the laws has next to none. What lies within it decides neither between causes nor about parameters;
* at rest, a slow disturbance: the encoder's quantisation, which does not average out without motion, and friction whose bristle
  depends on it.

A Kalman filter of that sum turns residuals, and every column of a Jacobian alike, into innovations of unit variance (Kennedy &
O'Hagan 2001 is the idea of a discrepancy that is learned; the state-space form makes it linear in the number of samples).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numba.np.unsafe import ndarray

from ...models.kernels import kernel
from ..data.segments import BALANCES, DECIMATION, STEP, Segment
from .replay import parallel

INTERVAL = STEP * DECIMATION
"""Time between residuals [s]."""


@dataclass(frozen=True)
class NoiseSettings:
    """How noise is modelled.

    Attributes:
      order: of the autoregression of sensor noise.
      bands: correlation times of the model discrepancy [s]: from one residual to a few seconds, a factor of five apart.
      rest_time: correlation time of the slow disturbance at rest [s].
      scales: lengths of the Haar wavelets by which variances are learned, in residuals (half a wavelet): 8 ms to 4 s.
      floor: least standard deviation of sensor noise, in the balance's unit.
    """

    order: int = 3
    bands: tuple[float, ...] = (0.02, 0.1, 0.5, 2.5)
    rest_time: float = 0.6
    scales: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64, 128, 256)
    floor: float = 1e-6


SETTINGS = NoiseSettings()
EVEN = NoiseSettings(bands=SETTINGS.bands[:1])
"""All model discrepancy in the fastest band: fits are least squares, and nothing slow is taken for discrepancy."""
_ORDER, _BANDS = SETTINGS.order, len(SETTINGS.bands)
"""Largest order of an autoregression and number of bands that are filtered, known to the compiler."""
_fixed: Any = ndarray.to_fixed_tuple
_SLOW = _BANDS + 1
_STATE = _ORDER + _SLOW
_WIDTH = 8
"""Series that are filtered at once."""
_STEADY = 3
"""Samples in a row with the same gain after which a filter's covariance is taken for its steady one."""
_STATIONARY = 0.9999
"""Largest root of an autoregression that counts as stationary."""
_ROBUST = 1.4826  # standard deviation of a normal distribution per median absolute deviation


@dataclass(frozen=True)
class AutoregressiveNoise:
    """Sensor noise of one balance in one segment: autoregressive coefficients, shape (order,), and the standard deviation
    of its innovation."""

    ar: np.ndarray
    white: float


@dataclass(frozen=True)
class Noise:
    """Noise of all residuals.

    Attributes:
      sensors: by segment and balance.
      discrepancy: standard deviation of the model discrepancy by balance and band, shape (len(BALANCES), bands), in the
        balance's unit.
      rest: standard deviation of the slow disturbance at rest by segment and balance, shape (segments, len(BALANCES)).
      settings: of the model.
    """

    sensors: tuple[tuple[AutoregressiveNoise, ...], ...]
    discrepancy: np.ndarray
    rest: np.ndarray
    settings: NoiseSettings = field(default=SETTINGS, repr=False)

    def louder(self, factor: float) -> Noise:
        """All of it so many times as large."""
        sensors = tuple(tuple(replace(one, white=factor * one.white) for one in balances) for balances in self.sensors)
        return replace(self, sensors=sensors, discrepancy=factor * self.discrepancy, rest=factor * self.rest)


@kernel
def _filter(usable, at_rest, ar, white, bands, decay, rest, rest_decay, x, y, z, balance, block, out):
    """Innovations of x, y and z[:, balance] side by side, shape (k, c), over their standard deviation; zero where unusable.
    Returns Σ log S.

    State: the autoregression's last values, the bands, the disturbance at rest; the residual is the sum of the first and all
    others. `ar`, `bands` and `decay` have `_ORDER`, `_BANDS` and as many entries.

    `out`, shape (⌈k/block⌉, c), has sums of `block` of them over the root of how many count: of unit variance again.
    """
    k, c = len(x), out.shape[1]
    values, first_y, first_z = np.zeros(c), x.shape[2], x.shape[2] + y.shape[2]
    p, n = _ORDER, _SLOW
    # Series side by side in groups, each with its state and, behind it, its value: what the compiler makes vectors of.
    groups = (c + _WIDTH - 1) // _WIDTH
    state = np.zeros((groups, (_STATE + 1) * _WIDTH))
    # The state's covariance: of the autoregression, of it with what is slow, and of that, a row as wide as a vector.
    own, cross, slow = np.zeros((p, p)), np.zeros((p, _WIDTH)), np.zeros((n, _WIDTH))
    fading, fresh, work = np.zeros(_WIDTH), np.zeros(_WIDTH), np.zeros(p)
    fading[:_BANDS], fading[_BANDS] = decay, rest_decay
    gain, slow_gain, step, slow_step = np.zeros(p), np.zeros(_WIDTH), np.zeros(p), np.zeros(_WIDTH)
    last = np.zeros(_STATE)
    past, fades = _fixed(ar, _ORDER), _fixed(fading, _SLOW)
    gain_own = nothing = _fixed(step, _ORDER)
    gain_slow = nothing_slow = _fixed(slow_step, _SLOW)
    steady, S, whole, log = 0, 1.0, 1.0, 0.0
    # The stationary covariance of the autoregression: by letting it run; the bands' are their variances.
    for _ in range(200):
        _step_own(own, work, ar, white)
    for j in range(_BANDS):
        slow[j, j] = bands[j] ** 2
        fresh[j] = (1.0 - decay[j] ** 2) * bands[j] ** 2
    total, number_of = 0.0, 0
    for i in range(k):
        row, behind = out[i // block], i % block
        if behind == 0:
            number_of = 0
            row[:] = 0.0
        if i > 0:
            if at_rest[i] != at_rest[i - 1] or not usable[i] or not usable[i - 1]:
                steady = 0
            if steady < _STEADY:
                fresh[_BANDS] = (1.0 - rest_decay**2) * rest * rest if at_rest[i] else 0.0
                _step_slow(cross, slow, ar, fading, fresh)
                _step_own(own, work, ar, white)
        elif at_rest[0]:
            slow[_BANDS, _BANDS] = rest * rest
        norm = 0.0
        if usable[i]:
            if steady < _STEADY:
                S = _gains(own, cross, slow, gain, slow_gain)
                moved = 0.0
                for a in range(p):
                    moved = max(moved, abs(gain[a] - last[a]))
                    last[a] = gain[a]
                    step[a] = gain[a] / S
                for a in range(n):
                    moved = max(moved, abs(slow_gain[a] - last[p + a]))
                    last[p + a] = slow_gain[a]
                    slow_step[a] = slow_gain[a] / S
                steady = steady + 1 if moved < 1e-7 * S else 0
                for a in range(p):
                    for b in range(p):
                        own[a, b] -= step[a] * gain[b]
                    for b in range(_WIDTH):
                        cross[a, b] -= step[a] * slow_gain[b]
                for a in range(n):
                    for b in range(_WIDTH):
                        slow[a, b] -= slow_step[a] * slow_gain[b]
                gain_own, gain_slow = _fixed(step, _ORDER), _fixed(slow_step, _SLOW)
                whole, log = 1.0 / np.sqrt(S), np.log(S)
            norm = whole
            total += log
            number_of += 1
            values[:first_y] = x[i, balance]
            values[first_y:first_z] = y[i, balance]
            values[first_z:] = z[i, balance]
        else:
            values[:] = 0.0  # it may be no number
        for group in range(groups):
            one, first = state[group], group * _WIDTH
            number = min(_WIDTH, c - first)
            for j in range(number):
                one[_STATE * _WIDTH + j] = values[first + j]
            if usable[i]:
                _advance(one, past, fades, gain_own, gain_slow, norm)
            else:
                _advance(one, past, fades, nothing, nothing_slow, norm)
            for j in range(number):
                row[first + j] += one[_STATE * _WIDTH + j]
        if block > 1 and (behind == block - 1 or i == k - 1):
            row *= 1.0 / np.sqrt(max(number_of, 1))
    return total


@kernel(fastmath={"contract", "reassoc"}, forceinline=True)
def _advance(one, a, f, g, s, norm):
    """One step of the filter for a group of series: `one`, shape ((states + 1) · `_WIDTH`,): state predicted by an autoregression
    `a` and decay `f`, updated by `g` and `s`, the gain over the innovation's variance; behind it the value, which becomes the
    innovation times `norm`. Coefficients are tuples: no memory that writing could change."""
    for j in range(_WIDTH):
        new = 0.0
        for l in range(_ORDER):
            new += a[l] * one[l * _WIDTH + j]
        innovation = one[_STATE * _WIDTH + j] - new
        for l in range(_SLOW):
            innovation -= f[l] * one[(_ORDER + l) * _WIDTH + j]
        for l in range(_ORDER - 1, 0, -1):
            one[l * _WIDTH + j] = one[(l - 1) * _WIDTH + j] + g[l] * innovation
        one[j] = new + g[0] * innovation
        for l in range(_SLOW):
            one[(_ORDER + l) * _WIDTH + j] = f[l] * one[(_ORDER + l) * _WIDTH + j] + s[l] * innovation
        one[_STATE * _WIDTH + j] = norm * innovation


@kernel(fastmath={"contract"}, forceinline=True)
def _step_own(own, new, ar, white):
    """Covariance of the autoregression's last values, a step on, in place."""
    p = _ORDER
    newest = white * white
    for b in range(p):
        new[b] = 0.0
        for l in range(p):
            new[b] += ar[l] * own[l, b]
    for b in range(p):
        newest += new[b] * ar[b]
    for a in range(p - 1, 0, -1):
        for b in range(p - 1, 0, -1):
            own[a, b] = own[a - 1, b - 1]
    for b in range(1, p):
        own[0, b] = own[b, 0] = new[b - 1]
    own[0, 0] = newest


@kernel(fastmath={"contract"}, forceinline=True)
def _step_slow(cross, slow, ar, fading, fresh):
    """Covariances of what is slow, with the autoregression's last values and among itself, a step on, in place."""
    p = _ORDER
    for j in range(_WIDTH):
        new = 0.0
        for l in range(p):
            new += ar[l] * cross[l, j]
        for l in range(p - 1, 0, -1):
            cross[l, j] = fading[j] * cross[l - 1, j]
        cross[0, j] = fading[j] * new
    for a in range(_SLOW):
        for j in range(_WIDTH):
            slow[a, j] *= fading[a] * fading[j]
        slow[a, a] += fresh[a]


@kernel(fastmath={"contract"}, forceinline=True)
def _gains(own, cross, slow, gain, slow_gain):
    """Covariance of the state with the residual, which is the sum of the autoregression's first and all that is slow, into `gain`
    and `slow_gain`. Returns the residual's variance."""
    S = 0.0
    for a in range(_ORDER):
        gain[a] = own[a, 0]
        for j in range(_SLOW):
            gain[a] += cross[a, j]
    for j in range(_WIDTH):
        value = cross[0, j]
        for a in range(_SLOW):
            value += slow[a, j]
        slow_gain[j] = value
    for j in range(_SLOW):
        S += slow_gain[j]
    return S + gain[0]


@dataclass(frozen=True)
class White:
    """Whitened series.

    Attributes:
      rows: shape (total, c): segment by segment, balance by balance; zero where a residual does not count.
      log_determinant: Σ log S of all innovations that count: of the noise's covariance.
    """

    rows: np.ndarray
    log_determinant: float


_PARTS = 3
"""Series that are whitened side by side without being put together first."""


def whiten(segments: Sequence[Segment], noise: Noise, *series: Sequence[np.ndarray]) -> White:
    """Whiten up to `_PARTS` series side by side, each of shape (k, len(BALANCES), c) a segment, or without the last for one."""
    s = noise.settings
    decay = np.exp(-INTERVAL / np.array(s.bands))
    rest_decay = float(np.exp(-INTERVAL / s.rest_time))

    decay, no_band = _padded(decay, _BANDS), np.zeros(_BANDS)
    parts = [[x if x.ndim == 3 else x[..., None] for x in one] for one in series]
    parts += [[x[..., :0] for x in parts[0]]] * (_PARTS - len(parts))
    lengths = [len(BALANCES) * len(one.at[:: one.block]) for one in segments]
    rows = np.empty((sum(lengths), sum(part[0].shape[2] for part in parts)))
    places = np.split(rows, np.cumsum(lengths)[:-1])

    def one(index: int) -> float:
        segment = segments[index]
        x, y, z = (np.ascontiguousarray(part[index]) for part in parts)
        out = places[index].reshape(len(BALANCES), -1, rows.shape[1])
        total = 0.0
        for b in range(len(BALANCES)):
            if not segment.usable[:, b].any():
                out[b] = 0.0
                continue
            sensor, bands = noise.sensors[index][b], no_band.copy()
            bands[: len(s.bands)] = noise.discrepancy[b]
            total += _filter(
                segment.usable[:, b], segment.at_rest, _padded(sensor.ar, _ORDER), sensor.white, bands, decay,
                float(noise.rest[index, b]), rest_decay, x, y, z, b, segment.block, out[b],
            )  # fmt: skip
        return total / segment.block

    return White(rows, float(sum(parallel(one, list(range(len(segments)))))))


def _padded(x: np.ndarray, size: int) -> np.ndarray:
    """A vector with zeros behind it, shape (size,): an autoregression of lower order, fewer bands."""
    found = np.zeros(size)
    found[: len(x)] = x
    return found


def rows_of(segments: Sequence[Segment]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segment, balance and time [s] of every row of `whiten`, shape (total,) each."""
    segment, balance, at = [], [], []
    for i, one in enumerate(segments):
        times = one.at[:: one.block]
        for b in range(len(BALANCES)):
            segment.append(np.full(len(times), i))
            balance.append(np.full(len(times), b))
            at.append(times)
    return np.concatenate(segment), np.concatenate(balance), np.concatenate(at)


# --- learning the noise ----------------------------------------------------------------------------------------------


def haar(x: np.ndarray, use: np.ndarray, scales: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares of the Haar wavelets of series x, shape (k, c), over samples that all count; and their numbers.

    A wavelet of scale L: mean of L samples less the mean of the L before. Returns shape (scales, c) and (scales,).
    """
    return _haar(np.where(use[:, None], x, 0.0), use, np.array(scales))


@kernel
def _haar(x, use, scales):
    k, c = x.shape
    total, count = np.zeros((k + 1, c)), np.zeros(k + 1, np.int64)
    for i in range(k):
        count[i + 1] = count[i] + use[i]
        for j in range(c):
            total[i + 1, j] = total[i, j] + x[i, j]
    energy, number = np.zeros((len(scales), c)), np.zeros(len(scales))
    for s in range(len(scales)):
        scale = scales[s]
        whole = 0
        for begin in range(0, k - 2 * scale + 1, scale):
            middle, end = begin + scale, begin + 2 * scale
            if count[end] - count[begin] == 2 * scale:
                whole += 1
                for j in range(c):
                    d = total[end, j] - 2 * total[middle, j] + total[begin, j]
                    energy[s, j] += d * d
        if whole:
            for j in range(c):
                energy[s, j] /= whole * scale * scale
            number[s] = 0.5 * whole  # neighbours overlap by half
    return energy, number


@cache
def haar_of_band(time: float, scales: tuple[int, ...]) -> np.ndarray:
    """Mean squares of the Haar wavelets of an Ornstein–Uhlenbeck process of unit variance, shape (scales,)."""
    rho = np.exp(-INTERVAL / time)
    found = []
    for scale in scales:
        lag = np.arange(-2 * scale + 1, 2 * scale)
        # Autocorrelation of the wavelet: a triangle of height 2 at zero, −1 at ±L, over L.
        weight = 2 * np.maximum(scale - np.abs(lag), 0) - np.maximum(scale - np.abs(np.abs(lag) - scale), 0)
        found.append(float(np.sum(weight * rho ** np.abs(lag))) / scale**2)
    return np.array(found)


Sensors = tuple[tuple[AutoregressiveNoise, ...], ...]


def sensor_noise(
    segments: Sequence[Segment], replicates: Sequence[np.ndarray], settings: NoiseSettings = SETTINGS
) -> Sensors:
    """Sensor noise by segment and balance, from what replicates add to the residuals, shape (k, len(BALANCES)) each."""
    found = []
    for segment, n in zip(segments, replicates, strict=True):
        balances = []
        for b in range(len(BALANCES)):
            moving = segment.balances[b] & ~segment.at_rest
            counted = np.flatnonzero((segment.usable[:, b] | segment.held_out[:, b]) & moving)
            use = np.zeros(len(n), bool)
            use[counted] = True
            if use.sum() < 50:
                use = segment.usable[:, b] | segment.held_out[:, b]
            if use.sum() < 20:
                balances.append(AutoregressiveNoise(np.zeros(settings.order), 1.0))
                continue
            balances.append(_autoregression(n[:, b], use, settings))
        found.append(tuple(balances))
    return tuple(found)


def _autoregression(x: np.ndarray, use: np.ndarray, settings: NoiseSettings) -> AutoregressiveNoise:
    """Yule–Walker from the samples that count; clipped, so that no outlier decides."""
    from scipy.linalg import solve_toeplitz

    limit = 4 * _ROBUST * float(np.median(np.abs(x[use])))
    y = np.where(use, np.clip(x, -limit, limit), 0.0)
    gamma = np.empty(settings.order + 1)
    for lag in range(settings.order + 1):
        both = use[lag:] & use[: len(use) - lag]
        gamma[lag] = np.sum(y[lag:] * y[: len(y) - lag] * both) / max(both.sum(), 1)
    gamma[0] = max(gamma[0], settings.floor**2)
    companion = np.eye(settings.order, k=-1)
    for ridge in (
        1e-9,
        1e-6,
        1e-4,
        1e-2,
        1.0,
    ):  # of few samples, autocovariances need not be those of any stationary process
        companion[0] = ar = solve_toeplitz(np.r_[(1 + ridge) * gamma[0], gamma[1:-1]], gamma[1:])
        if np.max(np.abs(np.linalg.eigvals(companion))) < _STATIONARY:
            break
    variance = gamma[0] - ar @ gamma[1:]
    return AutoregressiveNoise(ar, float(np.sqrt(max(variance, 1e-3 * gamma[0]))))


def learn(
    segments: Sequence[Segment],
    residuals: Sequence[np.ndarray],
    replicates: Sequence[np.ndarray],
    quantum: np.ndarray,
    spread: Sequence[np.ndarray] | None = None,
    settings: NoiseSettings = SETTINGS,
    sensors: Sensors | None = None,
    rest: np.ndarray | None = None,
) -> Noise:
    """Learn noise and model discrepancy from what a model leaves: expectation–maximisation, its last step.

    Args:
      residuals: shape (k, len(BALANCES)) a segment.
      replicates: what another draw of the sensors' noise adds to them, likewise.
      quantum: what the rotor encoder's quantisation rms leaves in each balance at rest, shape (len(BALANCES),).
      spread: columns of what the residual may still be off as the parameters are uncertain, shape (k, len(BALANCES), m):
        Jacobian times a root of the posterior covariance. Without it what the fit has taken away is not counted.
      sensors: `sensor_noise` of the replicates, where it is known already.
      rest: of the disturbance at rest, shape (segments, len(BALANCES)), where it is known already.
    """
    sensors = sensor_noise(segments, replicates, settings) if sensors is None else sensors
    scales = settings.scales
    shapes = np.stack([haar_of_band(t, scales) for t in settings.bands], axis=1)
    discrepancy = np.zeros((len(BALANCES), len(settings.bands)))
    for b in range(len(BALANCES)):
        energy, known, number = np.zeros(len(scales)), np.zeros(len(scales)), np.zeros(len(scales))
        for i, segment in enumerate(segments):
            counted = segment.usable[:, b] | segment.held_out[:, b]
            use = counted & ~segment.at_rest
            if use.sum() < 8:
                use = counted
            r = _clipped(residuals[i][:, b], use)
            e, n = haar(np.column_stack([r, _clipped(replicates[i][:, b], use)]), use, scales)
            energy += n * e[:, 0]
            known += n * e[:, 1]
            number += n
            if spread is not None:
                more, _ = haar(spread[i][:, b], use, scales)
                energy += n * more.sum(axis=1)
        good = number > 0
        if good.any():
            variance = _variances(energy[good] / number[good], known[good] / number[good], number[good], shapes[good])
            discrepancy[b] = np.sqrt(variance)
    rest = _at_rest(segments, residuals, quantum) if rest is None else rest
    return Noise(sensors, discrepancy, rest, settings)


def _at_rest(segments: Sequence[Segment], residuals: Sequence[np.ndarray], quantum: np.ndarray) -> np.ndarray:
    """Standard deviation of the disturbance at rest, shape (segments, len(BALANCES)): what is left beyond what motion leaves."""
    rest = np.tile(np.asarray(quantum, float), (len(segments), 1))
    for i, segment in enumerate(segments):
        for b in range(len(BALANCES)):
            resting = segment.usable[:, b] & segment.at_rest
            if resting.sum() > 50:
                moving = segment.usable[:, b] & ~segment.at_rest
                base = float(np.var(residuals[i][moving, b])) if moving.sum() > 50 else 0.0
                more = np.sqrt(max(np.mean(residuals[i][resting, b] ** 2) - base, 0.0))
                rest[i, b] = max(rest[i, b], more)
    return rest


def _clipped(x: np.ndarray, use: np.ndarray) -> np.ndarray:
    """A series without its outliers: beyond five deviations they count as five."""
    if not use.any():
        return x
    limit = 5 * _ROBUST * float(np.median(np.abs(x[use])))
    return np.clip(x, -limit, limit) if limit > 0 else x


def _variances(energy: np.ndarray, known: np.ndarray, number: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Variances v ≥ 0, shape (bands,), that make mean squares `energy` most likely: known + shapes·v, χ² of `number`.

    Multiplicative steps of the Gamma likelihood (Itakura–Saito): they stay positive and never make it less likely.
    """
    known = np.maximum(known, 1e-18)
    v = np.full(shapes.shape[1], max(float(np.mean(np.maximum(energy - known, 0.0))), 1e-18))
    _likeliest(energy, known, number, np.ascontiguousarray(shapes), v)
    return v


@kernel
def _likeliest(energy, known, number, shapes, v):
    """Let variances v take at most 200 multiplicative steps."""
    n, m = shapes.shape
    up, down = np.zeros(m), np.zeros(m)
    for _ in range(200):
        up[:] = 0.0
        down[:] = 0.0
        for i in range(n):
            model = known[i]
            for j in range(m):
                model += shapes[i, j] * v[j]
            for j in range(m):
                up[j] += shapes[i, j] * number[i] * energy[i] / model**2
                down[j] += shapes[i, j] * number[i] / model
        still = True
        for j in range(m):
            after = v[j] * math.sqrt(up[j] / down[j])
            still = still and abs(after - v[j]) < 1e-4 * (after + 1e-18)
            v[j] = after
        if still:
            break


def normalised_rms(segments: Sequence[Segment], noise: Noise, residuals: Sequence[np.ndarray]) -> float:
    """Root mean square of whitened residuals, outliers clipped: one when the noise is right."""
    r = whiten(segments, noise, residuals).rows[:, 0]
    r = r[r != 0]
    if not len(r):
        return 1.0
    return float(np.sqrt(np.mean(np.minimum(r * r, 1e4 * np.median(r * r)))))
