"""Estimators to compare the paper's filters with: same signals in, a joint torque out. One file each.

Adding one is adding a file to this folder that holds `ESTIMATORS`, a tuple of `base.Estimator`.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from ...models.errors import InputError, nearest
from .base import Estimator, JointSignals, SensorNoise, TorqueEstimate

__all__ = ["Estimator", "JointSignals", "SensorNoise", "TorqueEstimate", "get", "names"]


@cache
def _registry() -> dict[str, Estimator]:
    found: dict[str, Estimator] = {}
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda module: module.name):
        for estimator in getattr(importlib.import_module(f"{__name__}.{module.name}"), "ESTIMATORS", ()):
            if estimator.name in found:
                raise RuntimeError(f"two estimators are called {estimator.name!r}")
            found[estimator.name] = estimator
    return found


def names() -> tuple[str, ...]:
    """Return the names of all estimators, sorted."""
    return tuple(sorted(_registry()))


def get(name: str) -> Estimator:
    """Return an estimator with its default knobs; `dataclasses.replace` changes them."""
    if name not in _registry():
        raise InputError(f"estimator {name!r}: expected one of {list(names())}{nearest(name, names())}")
    return _registry()[name]
