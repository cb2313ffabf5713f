"""The entries of a scenario's `filters`: any estimator of the registry, with a name and tuning parameters.

filters:
  - dynamics_ekf                                              # with its defaults
  - {name: mine, rule: rarekf, k: 0.1, W: 2e-4}               # one of the paper's, by its rule
  - {name: quick, estimator: dynamics_ekf, process.push: 8}   # any, with fields of it; dotted or nested
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, model_serializer, model_validator

from ..estimator import registry
from ..estimator.estimator import Estimator, value_of, with_values
from ..models.errors import InputError, nearest, unknown_key
from ..models.files import documented

PAPER = ("EKF", "AREKF", "RAREKF", "REKF")
"""The paper's filters by their names in the registry; those of a scenario that lists none."""
Parameter = float | str


def _as_people_write(schema: dict[str, Any], model: type) -> None:
    """Adapt the JSON Schema: tuning parameters are keys of the entry, and `rule` may name one of the paper's filters."""
    properties = schema["properties"]
    properties["rule"] = {
        "type": "string",
        "description": "Gain rule of one of the paper's filters, instead of `estimator`.",
    }
    del properties["parameters"]
    schema["required"] = ["name"]
    schema["additionalProperties"] = {"description": "A tuning parameter of the estimator, by its name."}
    documented(schema, model)


class FilterEntry(BaseModel):
    """An estimator with a name; parameters that are not given keep their defaults."""

    short: ClassVar[str] = "string"
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, json_schema_extra=_as_people_write)

    name: Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]
    """Name in figures and tables."""
    estimator: str
    """Name of the estimator (`flexspline estimators`)."""
    parameters: dict[str, Parameter] = {}
    """Tuning parameters; in a file they follow the name: `{name: slow, estimator: lowpass, cutoff: 5}`."""

    @model_validator(mode="before")
    @classmethod
    def _as_written(cls, given: Any) -> Any:
        if isinstance(given, FilterEntry):
            return given
        if isinstance(given, str):
            given = {"name": given, "estimator": given}
        if not isinstance(given, dict):
            raise ValueError(f"expected the name of an estimator or a mapping of keys, got {given!r}")
        given = dict(given)
        head = {key: given.pop(key) for key in ("name", "estimator", "rule") if key in given}
        if "rule" in head and "estimator" not in head:
            head["estimator"] = _of_rule(head.pop("rule"))
        elif "rule" in head:
            given["rule"] = head.pop("rule")
        if "estimator" not in head:
            keys = [key for key in given if nearest(key, ("estimator", "rule"))]
            came = f", got {keys[0]!r}{nearest(keys[0], ('estimator', 'rule'))}" if keys else ", got neither"
            raise ValueError(
                f"expected `estimator` (a name of the registry) or `rule` (one of the paper's filters){came}"
            )
        default = _default(head["estimator"])
        return head | {"parameters": {key: _checked(default, key, value) for key, value in _flat(given)}}

    @model_validator(mode="after")
    def _works(self) -> FilterEntry:
        try:
            self.build()
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    @model_serializer
    def _written(self) -> str | dict[str, Parameter]:
        if self.name == self.estimator and not self.parameters:
            return self.name
        return {"name": self.name, "estimator": self.estimator, **self.parameters}

    def build(self) -> Estimator:
        """Build the estimator. Raises `InputError`: a value out of range; names estimator and field."""
        return with_values(registry.get(self.estimator), {"name": self.name, **self.parameters})

    def varied(self, parameter: str, value: Parameter) -> FilterEntry:
        """Return the entry with another value of a parameter; `ValueError` if it is not allowed."""
        parameters = {**self.parameters, parameter: value}
        return FilterEntry.model_validate({"name": self.name, "estimator": self.estimator, **parameters})


def paper_entries() -> list[FilterEntry]:
    """Return the paper's filters with their defaults."""
    return [FilterEntry.model_validate(name) for name in PAPER]


def estimators(names: list[str] | tuple[str, ...] = ()) -> dict[str, Estimator]:
    """Return the named estimators of the registry, in order; all of them without names. Raises `InputError`: an unknown
    name."""
    return {name: registry.get(name) for name in names or registry.names()}


def parameters_of(estimator: Estimator) -> list[str]:
    """Return dotted names of the fields that an entry may set."""
    return [field for field, _ in _values(estimator) if field != "name"]


def _default(name: Any) -> Estimator:
    if name not in registry.names():
        known = registry.names()
        raise ValueError(
            f"estimator: expected one of {list(known)}, got {name!r}{nearest(str(name), known) or registry.OWN}"
        )
    return registry.get(name)


def _of_rule(rule: Any) -> str:
    rules = {getattr(registry.get(name), "rule", None): name for name in PAPER}
    if not isinstance(rule, str) or rule not in rules:
        raise ValueError(f"rule: expected one of {list(rules)}, got {rule!r}{nearest(str(rule), map(str, rules))}")
    return rules[rule]


def _flat(given: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in given.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _values(settings: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted name and value of every field of settings."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from _values(value, f"{prefix}{field.name}.")
        elif field.init:
            yield f"{prefix}{field.name}", value


def _checked(default: Estimator, key: str, value: Any) -> Parameter:
    """Return a value for a field, converted; `ValueError` for an unknown field or another type."""
    known = parameters_of(default)
    if key not in known:
        raise ValueError(f"{key}: {unknown_key(key, known)}")
    if isinstance(value_of(default, key), str):
        if not isinstance(value, str):
            raise ValueError(f"{key}: expected text, got {value!r}")
        return value
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{key}: expected a finite number, got {value!r}")
    return number
