"""The library of causes: one file each. A new file with a subclass of `Cause` is a new cause."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from typing import TYPE_CHECKING

from .base import COMPONENTS, Cause, CauseParameter, Requirements

if TYPE_CHECKING:
    from ..joint import Joint


@cache
def _library() -> dict[str, Cause]:
    found: dict[str, Cause] = {}
    for module in pkgutil.iter_modules(__path__):
        if module.name == "base":
            continue
        for value in vars(importlib.import_module(f"{__name__}.{module.name}")).values():
            if isinstance(value, type) and issubclass(value, Cause) and value.__module__.endswith(f".{module.name}"):
                found[value.name] = value()
    return found


def names() -> list[str]:
    """Names of all known causes, by component."""
    return sorted(_library(), key=lambda name: (COMPONENTS.index(_library()[name].component), name))


def of(joint: Joint) -> list[str]:
    """Names of the causes that a joint description leaves room for."""
    return [name for name in names() if get(name).concerns(joint)]


def get(name: str) -> Cause:
    """The cause of that name; `KeyError` when there is none."""
    return _library()[name]


__all__ = ["COMPONENTS", "Cause", "CauseParameter", "Requirements", "get", "names", "of"]
