"""The estimators by name: those of `filters/`, and those of plugins (`models.plugins`).

A file in `filters/` with a tuple `ESTIMATORS` is enough. Those of an installed package are imported on request.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from dataclasses import is_dataclass
from functools import cache

from ..models import causes, own_sensors, plugins
from ..models.errors import InputError, nearest
from ..models.plugins import Offer, Origin
from . import filters
from .estimator import Estimator

OWN = "; one of a file of yours is known by --plugin FILE.py"  # hint for an unknown name


def names() -> tuple[str, ...]:
    """Names of all estimators, sorted."""
    return tuple(sorted({*_own(), *_others()}))


def get(name: str) -> Estimator:
    """Return the estimator of that name with its default tuning parameters; `dataclasses.replace` changes them. Raises
    `InputError`: an unknown name; a plugin's estimator that cannot be loaded or is not an estimator."""
    if name in _own():
        return _own()[name]
    others = _others()
    if name in others:
        return plugins.made(others[name], Estimator, _check)
    raise InputError(f"estimator {name!r}: expected one of {list(names())}{nearest(name, names()) or OWN}")


def check(offered: Iterable[str]) -> None:
    """Check the estimators, causes and sensors of a plugin. Raises `InputError`: one that does not follow its
    interface."""
    for name in offered:
        if name in _others():
            get(name)
        if name in causes.offered():
            causes.get(name)
        if name in own_sensors.names():
            own_sensors.get(name)


def origin(name: str) -> Origin:
    """Return the origin of the estimator of that name."""
    return plugins.OWN if name in _own() else _others()[name].origin


@cache
def _own() -> dict[str, Estimator]:
    found: dict[str, Estimator] = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(filters.__path__)):
        for estimator in getattr(importlib.import_module(f"{filters.__name__}.{module}"), "ESTIMATORS", ()):
            if estimator.name in found:
                raise RuntimeError(f"two estimators are called {estimator.name!r}")
            found[estimator.name] = estimator
    return found


def _others() -> dict[str, Offer]:
    return plugins.offers("estimators", _own())


def _check(found: Estimator) -> None:
    if not is_dataclass(found) or not found.__dataclass_params__.frozen:
        raise InputError("expected a frozen dataclass, got another class")
    if not (isinstance(found.description, str) and isinstance(found.needs, tuple) and isinstance(found.tuning, tuple)):
        raise InputError("expected text as description and tuples as needs and tuning, got something else")
