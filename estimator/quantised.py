"""The Gaussian update with a quantised reading: a reading gives the cell of the measured quantity, not its value.

An encoder at rest repeats its count. A filter that treats rounding as white noise takes a thousand equal readings for
a thousand independent measurements of the cell's middle, and the rounding becomes an offset. This update uses what is
known: h(x) + noise is in [y − q/2, y + q/2]. With a Gaussian prior for h(x) of mean ŷ and variance S (noise included)
the moments of the truncated normal give (Curry, "Estimation and Control with Quantized Measurements", 1970; Duan,
Jilkov & Li, FUSION 2008)

    x⁺ = x + K (E[y | cell] − ŷ)        P⁺ = P − K (S − Var[y | cell]) Kᵀ        K = P Hᵀ/S

For q → 0 this is the Kalman update; for S ≪ q² inside the cell it changes nothing.
"""

from __future__ import annotations

import math

from ..models.kernels import kernel

_FINE = 0.05  # q/√S: below, rounding is white noise of variance q²/12
_FAR = 6.0  # standard deviations: beyond, the tail's asymptotic moments


@kernel
def cell_moments(residual, S, q):
    """Return mean − ŷ and variance of N(ŷ, S) cut to the cell [y − q/2, y + q/2], with residual = y − ŷ."""
    s = math.sqrt(S)
    a, b = (residual - 0.5 * q) / s, (residual + 0.5 * q) / s
    sign = 1.0
    if a + b < 0.0:  # work on the right side, where the complementary error function is accurate
        a, b, sign = -b, -a, -1.0
    if b - a < _FINE:
        return residual, S * (b - a) ** 2 / 12.0
    if a > _FAR:
        # The far tail is exponential with rate a; it has decayed before b unless the cell is narrow.
        decay = math.exp(-min(a * (b - a), 700.0))
        mean = a + 1.0 / a - (b - a) * decay / (1.0 - decay)
        variance = 1.0 / (a * a) - (b - a) ** 2 * decay / (1.0 - decay) ** 2
        return sign * mean * s, max(variance, 1e-9) * S
    Z = 0.5 * (math.erfc(a / math.sqrt(2.0)) - math.erfc(b / math.sqrt(2.0)))
    pa = math.exp(-0.5 * a * a) / math.sqrt(2.0 * math.pi)
    pb = math.exp(-0.5 * b * b) / math.sqrt(2.0 * math.pi)
    mean = (pa - pb) / Z
    variance = 1.0 + (a * pa - b * pb) / Z - mean * mean
    return sign * mean * s, min(max(variance, 1e-9), 1.0) * S


@kernel
def update(x, P, active, H, residual, variance, q, PH):
    """Condition states x and the covariance P of those that are `active`, shape (N,), on one scalar reading, in place;
    the others are unchanged. Return S = H P Hᵀ + variance.

    `H`: derivative of the reading by them, shape (N,); `residual`: reading less its prediction; `variance`: of the
    noise before rounding to steps q, 0 for none; `PH`: scratch, shape (N,).
    """
    n = P.shape[0]
    S = variance
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * H[j]
        PH[i] = total
    for i in range(n):
        S += H[i] * PH[i]
    shift, left = residual, 0.0
    if q > 0.0:
        shift, left = cell_moments(residual, S, q)
    factor = (S - left) / (S * S)
    for i in range(n):
        x[int(active[i])] += PH[i] * shift / S
        for j in range(i + 1):
            P[i, j] -= factor * PH[i] * PH[j]
            P[j, i] = P[i, j]
    return S
