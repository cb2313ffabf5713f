"""Elementary functions faster than the C library's, exact to the last digit or two.

A replay spends a third of its time in sines and exponentials.
"""

from __future__ import annotations

import math

from numba.extending import overload

from .dual import chained, dual, value_of
from .kernels import kernel

# π/2 in three parts, two of 33 bits: whole multiples up to 2²⁰ are exact (Cody & Waite; numbers of Sun's fdlibm).
_QUARTER = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_FAR = 1e6  # rad: beyond, the C library
_SMALL = 0.5


def sincos(x):
    """Return sine and cosine of an angle [rad], within 2e-16 of the exact ones (likewise for a dual number)."""
    return _sincos(x)


@kernel(forceinline=True)
def _sincos(x):
    """Reduce to ±π/4 about a multiple of π/2, then use fdlibm's polynomials (k_sin, k_cos)."""
    if not abs(x) < _FAR:
        return math.sin(x), math.cos(x)
    n = math.floor(x * (2.0 / math.pi) + 0.5)
    r = ((x - n * _QUARTER[0]) - n * _QUARTER[1]) - n * _QUARTER[2]
    z = r * r
    zz = z * z
    s = -1.98412698295895385996e-4 + z * 2.75573136213857245213e-6
    s += zz * (-2.50507477628578072866e-8 + z * 1.58962301576546568060e-10)
    s = r + r * z * (-1.66666666666666307295e-1 + z * 8.33333333332211858878e-3 + zz * s)
    c = 2.48015872888517045348e-5 - z * 2.75573141792967388112e-7
    c += zz * (2.08757008419747316778e-9 - z * 1.13585365213876817300e-11)
    c = 1.0 - 0.5 * z + zz * (4.16666666666665929218e-2 - z * 1.38888888888730564116e-3 + zz * c)
    # Without branches, which turning angles make hard to predict.
    sine, cosine = (s, c) if n & 1 == 0 else (c, s)
    return sine * (1.0 - (n & 2)), cosine * (1.0 - (n + 1 & 2))


@overload(sincos)
def _sincos_of(x):
    if x != dual:
        return lambda x: _sincos(x)

    def both(x):
        s, c = _sincos(value_of(x))
        return chained(x, s, c), chained(x, c, -s)

    return both


@overload(math.sin)
def _sin_of(x):
    return (lambda x: sincos(x)[0]) if x == dual else None


@overload(math.cos)
def _cos_of(x):
    return (lambda x: sincos(x)[1]) if x == dual else None


@kernel(forceinline=True)
def decayed(x):
    """Return 1 − exp(−x) for x ≥ 0, exact near zero; `expm1` takes several times as long as `exp`."""
    return 1.0 - math.exp(-x) if value_of(x) > _SMALL else -math.expm1(-x)
