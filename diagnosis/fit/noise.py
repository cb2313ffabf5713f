"""Noise of residuals when the model is right (sensor noise and model discrepancy), and the filter that whitens it.

The residual of a balance in a segment is the sum of

* *sensor noise*: the stated noise of encoders, current and torque sensor after smoothing and replay; an autoregression fitted to
  noise replicates (`data.segments`);
* *model discrepancy*: errors of the laws. Ornstein–Uhlenbeck processes of fixed correlation times, one a frequency band, with
  variances that are learned by balance together with the parameters. A real joint has some in every band;
* at rest, a slow disturbance: encoder quantisation, which does not average out without motion, and friction, whose bristle
  depends on it.

A Kalman filter of that sum turns residuals, and every column of a Jacobian, into innovations of unit variance. The idea of a
discrepancy that is learned is Kennedy & O'Hagan's (2001); the state-space form makes it linear in the number of samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numba.np.unsafe import ndarray
from scipy.linalg import solve_toeplitz

from ...models.kernels import kernel
from ..data.segments import BALANCES, DECIMATION, STEP, Segment
from .replay import parallel

INTERVAL = STEP * DECIMATION
"""Time between residuals [s]."""


BANDS = (0.02, 0.1, 0.5, 2.5)
"""Correlation times of the model discrepancy [s]: from one residual to a few seconds, a factor of five apart."""
EVEN = BANDS[:1]
"""All model discrepancy in the fastest band: fits are least squares, and slow errors do not count as discrepancy."""
REST_TIME = 0.6  # correlation time of the slow disturbance at rest [s]
SCALES = (1, 2, 4, 8, 16, 32, 64, 128, 256)
"""Lengths of the Haar wavelets by which variances are learned, in residuals (half a wavelet): 8 ms to 4 s."""
FLOOR = 1e-6  # least standard deviation of sensor noise, in the balance's unit
_ORDER, _BANDS = 3, len(BANDS)
"""Largest order of an autoregression and number of bands that are filtered, known to the compiler."""
_fixed: Any = ndarray.to_fixed_tuple
_SLOW = _BANDS + 1
_STATE = _ORDER + _SLOW
_WIDTH = 8
"""Series that are filtered at once."""
_STEADY = 3
"""Samples in a row with the same gain after which a filter's covariance counts as steady."""
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
      discrepancy: standard deviation of the model discrepancy, shape (len(BALANCES), bands), in the balance's unit.
      rest: standard deviation of the slow disturbance at rest, shape (segments, len(BALANCES)).
      bands: correlation times of the discrepancy [s].
    """

    sensors: tuple[tuple[AutoregressiveNoise, ...], ...]
    discrepancy: np.ndarray
    rest: np.ndarray
    bands: tuple[float, ...] = BANDS

    def louder(self, factor: float) -> Noise:
        """Return all of it times a factor."""
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
    decay = _padded(np.exp(-INTERVAL / np.array(noise.bands)), _BANDS)
    rest_decay = float(np.exp(-INTERVAL / REST_TIME))
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
            sensor = noise.sensors[index][b]
            total += _filter(
                segment.usable[:, b], segment.at_rest, _padded(sensor.ar, _ORDER), sensor.white,
                _padded(noise.discrepancy[b], _BANDS), decay,
                float(noise.rest[index, b]), rest_decay, x, y, z, b, segment.block, out[b],
            )  # fmt: skip
        return total / segment.block

    return White(rows, float(sum(parallel(one, list(range(len(segments)))))))


def _padded(x: np.ndarray, size: int) -> np.ndarray:
    """Pad a vector with zeros to shape (size,)."""
    found = np.zeros(size)
    found[: len(x)] = x
    return found


def rows_of(segments: Sequence[Segment]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return segment, balance and time [s] of every row of `whiten`, shape (total,) each."""
    segment, balance, at = [], [], []
    for i, one in enumerate(segments):
        times = one.at[:: one.block]
        for b in range(len(BALANCES)):
            segment.append(np.full(len(times), i))
            balance.append(np.full(len(times), b))
            at.append(times)
    return np.concatenate(segment), np.concatenate(balance), np.concatenate(at)


# --- learning the noise ----------------------------------------------------------------------------------------------


def haar(x: np.ndarray, use: np.ndarray, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares of the Haar wavelets of series x, shape (k, c), over samples in use; and their numbers.

    A wavelet of scale L: mean of L samples less the mean of the L before, with at least a share of them in use. Returns shape
    (len(SCALES), c) and (len(SCALES),).
    """
    least = np.maximum((share * np.array(SCALES)).astype(int), 1)
    return _haar(np.where(use[:, None], x, 0.0), use, np.array(SCALES), least)


@kernel
def _haar(x, use, scales, least):
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
            before, after = count[middle] - count[begin], count[end] - count[middle]
            if min(before, after) >= least[s]:
                whole += 1
                for j in range(c):
                    d = (total[end, j] - total[middle, j]) / after - (total[middle, j] - total[begin, j]) / before
                    energy[s, j] += d * d
        if whole:
            for j in range(c):
                energy[s, j] /= whole
            number[s] = 0.5 * whole  # neighbours overlap by half
    return energy, number


@cache
def haar_of_band(time: float) -> np.ndarray:
    """Mean squares of the Haar wavelets of an Ornstein–Uhlenbeck process of unit variance, shape (len(SCALES),)."""
    rho = np.exp(-INTERVAL / time)
    found = []
    for scale in SCALES:
        lag = np.arange(-2 * scale + 1, 2 * scale)
        # Autocorrelation of the wavelet: a triangle of height 2 at zero, −1 at ±L, over L.
        weight = 2 * np.maximum(scale - np.abs(lag), 0) - np.maximum(scale - np.abs(np.abs(lag) - scale), 0)
        found.append(float(np.sum(weight * rho ** np.abs(lag))) / scale**2)
    return np.array(found)


Sensors = tuple[tuple[AutoregressiveNoise, ...], ...]


def sensor_noise(segments: Sequence[Segment], replicates: Sequence[np.ndarray]) -> Sensors:
    """Fit sensor noise by segment and balance to the replicates' part of the residuals, shape (k, len(BALANCES)) each."""
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
                balances.append(AutoregressiveNoise(np.zeros(_ORDER), 1.0))
                continue
            balances.append(_autoregression(n[:, b], use))
        found.append(tuple(balances))
    return tuple(found)


def _autoregression(x: np.ndarray, use: np.ndarray) -> AutoregressiveNoise:
    """Yule–Walker from the samples in use, outliers clipped."""
    limit = 4 * _ROBUST * float(np.median(np.abs(x[use])))
    y = np.where(use, np.clip(x, -limit, limit), 0.0)
    gamma = np.empty(_ORDER + 1)
    for lag in range(_ORDER + 1):
        both = use[lag:] & use[: len(use) - lag]
        gamma[lag] = np.sum(y[lag:] * y[: len(y) - lag] * both) / max(both.sum(), 1)
    gamma[0] = max(gamma[0], FLOOR**2)
    companion = np.eye(_ORDER, k=-1)
    for ridge in (1e-9, 1e-6, 1e-4, 1e-2, 1.0):  # few samples may have autocovariances of no stationary process
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
    bands: tuple[float, ...] = BANDS,
    sensors: Sensors | None = None,
    rest: np.ndarray | None = None,
) -> Noise:
    """Learn noise and model discrepancy from a model's residuals: the last step of expectation–maximisation.

    Args:
      residuals: shape (k, len(BALANCES)) a segment.
      replicates: another noise draw's part of them, likewise.
      quantum: rms of the rotor encoder's quantisation in each balance at rest, shape (len(BALANCES),).
      spread: uncertainty of the residual from that of the parameters, shape (k, len(BALANCES), m) a segment: Jacobian times a
        root of the posterior covariance; none by default.
      bands: correlation times of the discrepancy [s].
      sensors: `sensor_noise` of the replicates, if known.
      rest: disturbance at rest, shape (segments, len(BALANCES)), if known.
    """
    sensors = sensor_noise(segments, replicates) if sensors is None else sensors
    shapes = np.stack([haar_of_band(t) for t in bands], axis=1)
    discrepancy = np.zeros((len(BALANCES), len(bands)))
    for b in range(len(BALANCES)):
        energy, known, number = np.zeros((3, len(SCALES)))
        for i, segment in enumerate(segments):
            counted = segment.usable[:, b] | segment.held_out[:, b]
            use = counted & ~segment.at_rest
            if use.sum() < 8:
                use = counted
            r = _clipped(residuals[i][:, b], use)
            e, n = haar(np.column_stack([r, _clipped(replicates[i][:, b], use)]), use, segment.sampled)
            energy += n * e[:, 0]
            known += n * e[:, 1]
            number += n
            if spread is not None:
                more, _ = haar(spread[i][:, b], use, segment.sampled)
                energy += n * more.sum(axis=1)
        good = number > 0
        if good.any():
            variance = _variances(energy[good] / number[good], known[good] / number[good], number[good], shapes[good])
            discrepancy[b] = np.sqrt(variance)
    rest = _at_rest(segments, residuals, quantum) if rest is None else rest
    return Noise(sensors, discrepancy, rest, bands)


def _at_rest(segments: Sequence[Segment], residuals: Sequence[np.ndarray], quantum: np.ndarray) -> np.ndarray:
    """Standard deviation of the disturbance at rest, shape (segments, len(BALANCES)): residual at rest beyond that in motion."""
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
    """Clip a series at five robust standard deviations."""
    if not use.any():
        return x
    limit = 5 * _ROBUST * float(np.median(np.abs(x[use])))
    return np.clip(x, -limit, limit) if limit > 0 else x


def _variances(energy: np.ndarray, known: np.ndarray, number: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Return variances v ≥ 0, shape (bands,), with the largest likelihood of mean squares known + shapes·v, χ² of `number`.

    Multiplicative steps of the Gamma likelihood (Itakura–Saito) stay positive and never lower it.
    """
    known = np.maximum(known, 1e-18)
    v = np.full(shapes.shape[1], max(float(np.mean(np.maximum(energy - known, 0.0))), 1e-18))
    _likeliest(energy, known, number, np.ascontiguousarray(shapes), v)
    return v


@kernel
def _likeliest(energy, known, number, shapes, v):
    """Take at most 200 multiplicative steps of variances v, in place."""
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
    """RMS of whitened residuals, outliers clipped: one when the noise is right."""
    r = whiten(segments, noise, residuals).rows[:, 0]
    r = r[r != 0]
    if not len(r):
        return 1.0
    return float(np.sqrt(np.mean(np.minimum(r * r, 1e4 * np.median(r * r)))))
