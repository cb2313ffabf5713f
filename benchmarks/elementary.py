"""Sine and cosine, and 1 − exp(−x), of `models.elementary` and of the C library, in compiled loops."""

from __future__ import annotations

import math

import numpy as np

from flexspline.models.elementary import decayed, sincos
from flexspline.models.kernels import kernel

from .timing import alternately

COUNT = 200_000


@kernel
def _both_here(angles):
    total = 0.0
    for x in angles:
        s, c = sincos(x)
        total += s + c
    return total


@kernel
def _both_there(angles):
    total = 0.0
    for x in angles:
        total += math.sin(x) + math.cos(x)
    return total


@kernel
def _decayed_here(times):
    total = 0.0
    for x in times:
        total += decayed(x)
    return total


@kernel
def _decayed_there(times):
    total = 0.0
    for x in times:
        total -= math.expm1(-x)
    return total


def main() -> None:
    """Print core times a call and their ratios."""
    angles, times = np.linspace(-2000.0, 2000.0, COUNT), np.linspace(0.0, 40.0, COUNT)
    for what, here, there, x in (
        ("sine and cosine", _both_here, _both_there, angles),
        ("1 − exp(−x)", _decayed_here, _decayed_there, times),
    ):
        timed = alternately({"here": lambda f=here, x=x: f(x), "C library": lambda f=there, x=x: f(x)})
        print(f"{what}, {COUNT} calls in a loop:")
        for name, timing in timed.items():
            print(f"  {name:10s} {1e9 * timing.core / COUNT:.1f} ns")
        print(f"  here over C library: {timed['here'].core / timed['C library'].core:.2f}")


if __name__ == "__main__":
    main()
