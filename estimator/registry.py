"""The estimators by name: those of `filters/`, and those that installed packages add.

A file in `filters/` that holds a tuple `ESTIMATORS` is enough. Another package declares an entry point of the group
`flexspline.estimators` whose name is the estimator's and whose object is an `estimator.Estimator`; it is imported when it is
asked for.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from ..models.errors import InputError, nearest
from . import filters
from .estimator import Estimator

GROUP = "flexspline.estimators"


def names() -> tuple[str, ...]:
    """Names of all estimators, sorted."""
    return tuple(sorted({*_own(), *_others()}))


def get(name: str) -> Estimator:
    """The estimator of that name with its default tuning parameters; `dataclasses.replace` changes them.

    Raises:
      InputError: a name that is none; an installed estimator that cannot be loaded.
    """
    if name in _own():
        return _own()[name]
    if name in _others():
        return _load(_others()[name])
    raise InputError(f"estimator {name!r}: expected one of {list(names())}{nearest(name, names())}")


@cache
def _own() -> dict[str, Estimator]:
    found: dict[str, Estimator] = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(filters.__path__)):
        for estimator in getattr(importlib.import_module(f"{filters.__name__}.{module}"), "ESTIMATORS", ()):
            if estimator.name in found:
                raise RuntimeError(f"two estimators are called {estimator.name!r}")
            found[estimator.name] = estimator
    return found


@cache
def _others() -> dict[str, EntryPoint]:
    """What installed packages offer, not loaded; this package's own names win."""
    return {point.name: point for point in entry_points(group=GROUP) if point.name not in _own()}


def _load(point: EntryPoint) -> Estimator:
    where = f"estimator {point.name!r} of {point.dist.name if point.dist else 'an installed package'}"
    try:
        found = point.load()
    except Exception as error:  # whatever a foreign module does when it is imported
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{where}: cannot be loaded from {point.value!r}: {type(error).__name__}: {reason}") from error
    if not isinstance(found, Estimator):
        raise InputError(f"{where}: expected an estimator.Estimator, got {type(found).__name__}")
    return found
