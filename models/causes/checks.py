"""Checks of a plugin's cause, with errors in one line."""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError, nearest
from ..parameters import PARAMETERS, as_floats, neutral
from ..signals import CHANNELS
from .base import COMPONENTS, Cause, CauseParameter, Requirements

_DRAWS = 8


def check(cause: Cause) -> None:
    """Check a plugin's cause. Raises `InputError`: its fault."""
    for field in ("component", "description", "parameters"):
        if not hasattr(cause, field):
            raise InputError(f"{field}: missing")
    if cause.component not in COMPONENTS:
        raise InputError(f"component: expected one of {list(COMPONENTS)}, got {cause.component!r}")
    parameters = {q.name: q for q in cause.parameters if isinstance(q, CauseParameter)}
    if not parameters or len(parameters) != len(cause.parameters):
        raise InputError("parameters: expected a tuple of CauseParameter, each with its own name")
    for q in cause.parameters:
        _check_parameter(q)
    if not any(q.magnitude for q in cause.parameters):
        raise InputError("parameters: expected one at least that grows with the effect (magnitude=True), got none")
    for key in cause.sets:
        if key not in parameters:
            raise InputError(f"sets: expected a parameter of the cause, got {key!r}{nearest(key, parameters)}")
    for field in (*cause.sets.values(), *cause.scales):
        if field not in _SCALARS:
            raise InputError(
                f"expected a field of the parameter record with one number, got {field!r}{nearest(field, _SCALARS)}"
            )
    for column in cause.needs:
        if column not in CHANNELS:
            raise InputError(f"needs: expected a channel, got {column!r}{nearest(column, CHANNELS)}")
    if cause.sensor is not None and cause.sensor not in CHANNELS:
        raise InputError(f"sensor: expected a channel, got {cause.sensor!r}{nearest(str(cause.sensor), CHANNELS)}")
    if not isinstance(cause.requires, Requirements):
        raise InputError(f"requires: expected Requirements, got {type(cause.requires).__name__}")
    _check_effect(cause)


_SCALARS = [name for name in PARAMETERS.names or () if PARAMETERS[name].shape == ()]


def _check_parameter(q: CauseParameter) -> None:
    low, high = q.bounds
    if not low < high:
        raise InputError(f"parameters.{q.name}.bounds: expected the smaller number first, got {q.bounds}")
    for least, most in q.ordinary:
        if not least <= most:
            raise InputError(f"parameters.{q.name}.ordinary: expected the smaller number first, got {(least, most)}")
        if not q.relative and not low <= least <= most <= high:
            raise InputError(
                f"parameters.{q.name}.ordinary: expected it within the bounds {q.bounds}, got {(least, most)}"
            )
    if not q.ordinary:
        raise InputError(f"parameters.{q.name}.ordinary: expected one interval at least, got none")
    if q.relative is not None and q.relative not in _SCALARS:
        raise InputError(
            f"parameters.{q.name}.relative: expected a field of the parameter record with one number, got {q.relative!r}"
            f"{nearest(q.relative, _SCALARS)}"
        )


def _check_effect(cause: Cause) -> None:
    """Check that it changes the record at ordinary size and leaves it finite, and changes nothing that acts if
    absent."""
    rng = np.random.default_rng(1)
    for _ in range(_DRAWS):
        plain, record = _record(), _record()
        values = cause.draw(record[0], rng)
        cause.apply(record[0], values)
        if np.array_equal(as_floats(record), as_floats(plain)):
            raise InputError(
                f"apply: expected a change of the parameter record at ordinary size, got none at {_listed(values)}"
            )
        if not np.isfinite(as_floats(record)).all():
            raise InputError(f"apply: expected finite numbers in the parameter record, got others at {_listed(values)}")
        absent = cause.present(plain[0])
        if set(absent) != {q.name for q in cause.parameters}:
            raise InputError(f"present: expected a value of every parameter, got {sorted(absent)}")
        record = _record()
        cause.apply(record[0], absent)
        changed = [f for f in _ACTING if not np.array_equal(record[0][f], plain[0][f])]
        if changed:
            raise InputError(
                f"apply: expected no change of {changed[0]} where the effect is absent ({_listed(absent)}); check `neutral`"
            )


# Fields that an absent effect may set: an order, a phase, a spline of zeros.
_PASSIVE = (
    "order", "phase", "discrepancy_place", "discrepancy_variable", "discrepancy_low", "discrepancy_high", "discrepancy_count",
)  # fmt: skip
_ACTING = [name for name in PARAMETERS.names or () if not name.endswith(_PASSIVE)]


def _record() -> np.ndarray:
    """Return a record of no particular joint: every number is one, and there is no effect."""
    record, nominal = neutral(), PARAMETERS.names or ()
    for name in (*nominal[: nominal.index("order")], "bl", "Jl", "Mg"):
        record[0][name] = 1.0
    return record


def _listed(values: dict[str, float]) -> str:
    return ", ".join(
        f"{name} {value:.4g}" if math.isfinite(value) else f"{name} {value}" for name, value in values.items()
    )
