"""The library of causes, one file each: a new file with a subclass of `Cause` is a new cause. Plugins add others."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from typing import TYPE_CHECKING

from .. import plugins
from ..plugins import Offer, Origin
from .base import COMPONENTS, Cause, CauseParameter, Requirements, put_discrepancy, spline_through
from .checks import check

if TYPE_CHECKING:
    from ..joint import Joint


@cache
def _own() -> dict[str, Cause]:
    found: dict[str, Cause] = {}
    for module in pkgutil.iter_modules(__path__):
        if module.name in ("base", "checks"):
            continue
        for value in vars(importlib.import_module(f"{__name__}.{module.name}")).values():
            if isinstance(value, type) and issubclass(value, Cause) and value.__module__.endswith(f".{module.name}"):
                found[value.name] = value()
    return found


def offered() -> dict[str, Offer]:
    """Return the offers of plugins, by name (`models.plugins`)."""
    return plugins.offers("causes", _own())


def names() -> list[str]:
    """Return the names of all known causes, by component. Raises `InputError`: one of a plugin that cannot be loaded or
    is not a cause."""
    every = [*_own(), *offered()]
    return sorted(every, key=lambda name: (COMPONENTS.index(get(name).component), name))


def of(joint: Joint) -> list[str]:
    """Return the names of the causes that are possible for a joint description."""
    return [name for name in names() if get(name).concerns(joint)]


def get(name: str) -> Cause:
    """Return the cause of that name; `KeyError` if there is none."""
    return _own()[name] if name in _own() else plugins.made(offered()[name], Cause, check)


def origin(name: str) -> Origin:
    """Return the origin of the cause of that name; `KeyError` if there is none."""
    return plugins.OWN if name in _own() else offered()[name].origin


__all__ = [
    "COMPONENTS", "Cause", "CauseParameter", "Requirements", "get", "names", "of", "offered", "origin", "put_discrepancy",
    "spline_through",
]  # fmt: skip
