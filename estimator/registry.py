"""The estimators by name: those of `filters/`, and those that plugins add (`models.plugins`).

A file in `filters/` that holds a tuple `ESTIMATORS` is enough. An installed package's are imported when they are asked for.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from dataclasses import is_dataclass
from functools import cache
from typing import Any

from ..models import causes, own_sensors, plugins
from ..models.errors import InputError, nearest
from ..models.plugins import Offer, Origin
from . import filters
from .estimator import Estimator

OWN = "; one of a file of yours is known by --plugin FILE.py"
"""What a name that nothing resembles may be."""


def names() -> tuple[str, ...]:
    """Names of all estimators, sorted."""
    return tuple(sorted({*_own(), *_others()}))


def get(name: str) -> Estimator:
    """The estimator of that name with its default tuning parameters; `dataclasses.replace` changes them.

    Raises:
      InputError: a name that is none; a plugin's estimator that cannot be loaded or is none.
    """
    if name in _own():
        return _own()[name]
    others = _others()
    if name in others:
        return _checked(others[name])
    raise InputError(f"estimator {name!r}: expected one of {list(names())}{nearest(name, names()) or OWN}")


def check(offered: Iterable[str]) -> None:
    """Look at estimators, causes and sensors that a plugin offers.

    Raises:
      InputError: one that is none, or does not keep what one promises.
    """
    for name in offered:
        if name in _others():
            get(name)
        if name in causes.offered():
            causes.get(name)
        if name in own_sensors.names():
            own_sensors.get(name)


def origin(name: str) -> Origin:
    """Where the estimator of that name comes from."""
    return plugins.OWN if name in _own() else _others()[name].origin


def _estimator(given: Any) -> Any:
    """An object; of a class of estimators one with its default tuning."""
    return given() if isinstance(given, type) and issubclass(given, Estimator) else given


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
    """What plugins offer."""
    return plugins.offers("estimators", _own())


def _checked(offer: Offer) -> Estimator:
    """A plugin's estimator, if it is one.

    Raises:
      InputError: another object, another name than it was offered by, no frozen dataclass.
    """
    where = f"estimator {offer.name!r} of {offer.origin.name}"
    try:
        found = _estimator(offer.get())
    except InputError:
        raise
    except Exception as error:  # whatever foreign code does
        raise InputError(f"{where}: {type(error).__name__}: {error}") from error
    if not isinstance(found, Estimator):
        raise InputError(f"{where}: expected an Estimator, got {type(found).__name__}")
    if found.name != offer.name:
        raise InputError(f"{where}: name: expected {offer.name!r}, as it is offered, got {found.name!r}")
    if not is_dataclass(found) or not found.__dataclass_params__.frozen:
        raise InputError(f"{where}: expected a frozen dataclass, got another class")
    if not (isinstance(found.description, str) and isinstance(found.needs, tuple) and isinstance(found.tuning, tuple)):
        raise InputError(f"{where}: expected text as description and tuples as needs and tuning, got something else")
    return found
