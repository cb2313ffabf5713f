"""A gear's data sheet as a measurement: friction, its effects and hysteresis, fitted to running torque and efficiency.

Every entry is a friction torque at the motor: an efficiency η at the load T is T/N (1/η − 1). The fit compares its
logarithm with the joint's laws; the rules of `datasheet` are its prior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from . import laws
from .characteristics import half_width
from .errors import InputError
from .files import Strict
from .joint import Joint
from .parameters import neutral

RPM = 2 * math.pi / 60
_ARCMIN = math.radians(1 / 60)
_Positive = Annotated[float, Field(gt=0, le=1e6)]
_Temperature = Annotated[float, Field(ge=-100, le=200)]


class Curve(Strict):
    """A curve over the motor's speed at one temperature."""

    speed: Annotated[list[_Positive], Field(min_length=1, max_length=200)]
    """Of the motor, ascending [1/min]."""
    temperature: _Temperature = 20.0
    """[°C]."""

    @model_validator(mode="after")
    def _table(self) -> Curve:
        if any(b <= a for a, b in zip(self.speed, self.speed[1:], strict=False)):
            raise ValueError(f"speed: expected ascending speeds, got {self.speed}")
        name = next(name for name in type(self).model_fields if name in ("torque", "efficiency"))
        values = getattr(self, name)
        if len(values) != len(self.speed):
            raise ValueError(f"{name}: expected a value per speed, {len(self.speed)}, got {len(values)}")
        return self


class RunningTorque(Curve):
    """No-load running torque."""

    torque: list[_Positive]
    """At the motor, one per speed [N·m]."""


class Efficiency(Curve):
    """Efficiency at one load, while the motor drives the load."""

    load: _Positive
    """At the output [N·m]."""
    efficiency: list[float]
    """One per speed, a share."""

    @model_validator(mode="after")
    def _shares(self) -> Efficiency:
        for value in self.efficiency:
            if not 1e-3 < value < 1:
                raise ValueError(f"efficiency: expected a share between 0 and 1 (0.77 for 77 %), got {value:g}")
        return self


class GearSheet(Strict):
    """The friction and hysteresis that a gear's data sheet states. All entries but the source are optional."""

    source: str
    """Name of the data sheet."""
    scatter: Annotated[float, Field(gt=0, lt=1)] = 0.2
    """Relative standard deviation from gear to gear, common to all entries."""
    running_torque: list[RunningTorque] = []
    """No-load running torque."""
    efficiency: list[Efficiency] = []
    """While the motor drives."""
    starting_torque: _Positive | None = None
    """At the motor, without load [N·m]."""
    back_driving_torque: _Positive | None = None
    """Torque at the output that starts to turn the free motor [N·m]."""
    temperature: _Temperature = 20.0
    """Of starting and back-driving torque [°C]."""
    hysteresis_loss: _Positive | None = None
    """Width of the torsion loop at zero torque, after the rated torque in both directions [arc minutes]."""
    ratcheting_torque: _Positive | None = None
    """At the output [N·m]. No law has it; the motor's largest torque is checked against it."""

    @model_validator(mode="after")
    def _something(self) -> GearSheet:
        if not self.entries() and self.hysteresis_loss is None and self.ratcheting_torque is None:
            raise ValueError("expected running_torque, efficiency or another entry of a gear's data sheet, got none")
        return self

    def entries(self) -> list[SheetEntry]:
        """Return the entries with a friction torque."""
        found = [
            SheetEntry(RUNNING, speed * RPM, 0.0, curve.temperature, value)
            for curve in self.running_torque
            for speed, value in zip(curve.speed, curve.torque, strict=True)
        ]
        found += [
            SheetEntry(EFFICIENCY, speed * RPM, curve.load, curve.temperature, value)
            for curve in self.efficiency
            for speed, value in zip(curve.speed, curve.efficiency, strict=True)
        ]
        if self.starting_torque is not None:
            found.append(SheetEntry("starting torque [N·m]", _CREEP, 0.0, self.temperature, self.starting_torque))
        if self.back_driving_torque is not None:
            back = self.back_driving_torque
            found.append(SheetEntry("back-driving torque [N·m]", _CREEP, -back, self.temperature, back))
        return found


RUNNING, EFFICIENCY = "running torque [N·m]", "efficiency"  # kinds of entries that a data sheet states over speed
_CREEP = 1e-9  # rad/s: motion starts


class SheetEntry(NamedTuple):
    """An entry: its kind, motor speed [rad/s], load [N·m] (negative: it drives the motor), temperature [°C], stated
    value [N·m at the motor; back-driving at the output; efficiency as a share]."""

    kind: str
    speed: float
    load: float
    temperature: float
    value: float

    @property
    def at(self) -> str:
        """Speed, load and temperature in words."""
        speed = f"{self.speed / RPM:.5g} rpm, " if self.speed > _CREEP else ""
        load = f"{self.load:.4g} N·m, " if self.load > 0 else ""
        return f"{speed}{load}{self.temperature:.4g} °C"

    def friction(self, N: float) -> float:
        """Return the stated friction at the motor [N·m]."""
        if self.kind == EFFICIENCY:
            return self.load / N * (1 / self.value - 1)
        return self.value / N if self.load < 0 else self.value

    def predicted(self, p: np.void) -> float:
        """Return what the laws of a record predict for `value`; infinite if the gear cannot be driven back."""
        N = float(p["N"])
        if self.load < 0:  # friction is linear in the load: T/N = g(0) + μ T/N
            without = _friction(self._replace(load=-0.0), p)
            slope = _friction(self._replace(load=-1.0), p) - without
            return without / (1 / N - slope) if slope * N < 1 else math.inf
        friction = _friction(self, p)
        return self.load / (self.load + N * friction) if self.kind == EFFICIENCY else friction


def _friction(at: SheetEntry, p: np.void) -> float:
    """Return the friction of the gear alone at an entry's speed, load and temperature [N·m, motor side]."""
    sliding = laws.stribeck_friction(at.speed, 0.0, at.load, 0.0, at.temperature, p)
    return float(sliding + laws.viscous_friction(at.speed, at.temperature, p))


class _Free(NamedTuple):
    """A free parameter of the fit: start, prior standard deviation, bounds, and the share of its prior deviation
    above which it is not determined."""

    start: float
    prior: float
    low: float
    high: float
    limit: float


_FREE = {
    # logarithms of Fs, Fc/Fs (below 1), vs, bw/Fc over their rules
    "Fs": _Free(0.0, math.log(2), -5, 5, 0.9), "Fc": _Free(0.0, 0.3, -3, 0.22, 0.9),
    "vs": _Free(0.0, math.log(1.4), -3, 3, 0.9), "bw": _Free(0.0, math.log(3), -6, 6, 0.9),
    "viscous_exponent": _Free(1.0, 0.4, 0.2, 1.5, 0.75),
    "load": _Free(0.1, 0.2, 0.0, 2.0, 0.5), "back_driven": _Free(0.1, 0.1, 0.0, 0.99, 0.5),
    "temperature": _Free(0.0, 0.02, -0.1, 0.1, 0.5),
}  # fmt: skip
_READING = 0.03  # relative error of reading a number from a data sheet


@dataclass(frozen=True)
class GearFit:
    """A fit to a data sheet."""

    # values and relative standard deviations by symbol (Fs, Fc, vs, bw, viscous_exponent), without the scatter that all
    # have in common
    numbers: Mapping[str, tuple[float, float]]
    effects: list[dict[str, Any]]  # in the form of a description


def fit(sheet: GearSheet, rules: Mapping[str, float], given: Mapping[str, float]) -> GearFit:
    """Return numbers and effects of friction that fit a data sheet. `rules`: values of Fs, Fc, vs, bw, which those keep
    that the sheet does not determine; `given`: known numbers, N among them, which the fit keeps."""
    from scipy.optimize import least_squares

    entries = sheet.entries()
    if not entries:
        return GearFit({}, [])
    N = float(given["N"])
    stated = np.log([one.friction(N) for one in entries])

    def residual(free: list[str], x: np.ndarray) -> np.ndarray:
        p = _record(dict(zip(free, x, strict=True)), rules, given)
        return np.log([_friction(one, p) for one in entries]) - stated

    def solve(free: list[str], spread: float) -> tuple[np.ndarray, np.ndarray]:
        """Return parameters and their covariance."""
        start, prior, low, high, _ = np.array([_FREE[name] for name in free]).T.reshape(5, -1)
        found = least_squares(
            lambda x: np.r_[residual(free, x) / spread, (x - start) / prior], start, bounds=(low, high), x_scale=prior
        )
        return found.x, np.linalg.inv(found.jac.T @ found.jac)

    free = [name for name in _FREE if name not in given]
    spread = _READING
    while free:
        x, covariance = solve(free, spread)
        undetermined = [
            math.sqrt(v) / (_FREE[name].prior * _FREE[name].limit)
            for name, v in zip(free, np.diag(covariance), strict=True)
        ]
        left = residual(free, x)
        found = math.sqrt(float(left @ left) / max(len(entries) - len(free), 1))
        if max(undetermined) > 1:
            free.pop(undetermined.index(max(undetermined)))
        elif found > 1.1 * spread and len(entries) > len(free):
            spread = found
        else:
            break
    if not free:
        return GearFit({}, [])
    # Numbers by rule are as uncertain as their rule, which widens the deviations of the others.
    wide = [name for name in _FREE if name in free or (name in _RULED and name not in given)]
    covariance = solve(wide, spread)[1]
    deviation = dict(zip(wide, np.sqrt(np.diag(covariance)), strict=True))
    p = _record(dict(zip(free, x, strict=True)), rules, given)
    numbers = {}
    for symbol, of in _RULED.items():
        if symbol in free:  # the logarithm is a sum
            along = np.array([float(name in of) for name in wide])
            numbers[symbol] = float(p[symbol]), float(np.expm1(math.sqrt(along @ covariance @ along)))
    if (exponent := "viscous_exponent") in free:
        numbers[exponent] = float(p[exponent]), float(deviation[exponent] / p[exponent])
    return GearFit(numbers, _effects(p, {name: deviation[name] for name in free}, sheet.scatter))


_RULED = {"Fs": ("Fs",), "Fc": ("Fs", "Fc"), "vs": ("vs",), "bw": ("Fs", "Fc", "bw")}
"""Parameters of the fit whose sum is the logarithm of a number over its rule."""


def _record(x: Mapping[str, float], rules: Mapping[str, float], given: Mapping[str, float]) -> np.void:
    """Return the record of the friction laws at parameters of the fit; missing ones are by their rule."""
    record = neutral()
    p = record[0]
    p["N"] = given["N"]
    before = 1.0
    for symbol, ratio in (
        ("Fs", rules["Fs"]), ("Fc", rules["Fc"] / rules["Fs"]), ("bw", rules["bw"] / rules["Fc"]), ("vs", rules["vs"]),
    ):  # fmt: skip
        scale = 1.0 if symbol == "vs" else before
        before = p[symbol] = given.get(symbol, scale * ratio * math.exp(x.get(symbol, 0.0)))
    p["viscous_exponent"] = x.get("viscous_exponent", 1.0)
    load = x.get("load", 0.0)
    p["friction_load"] = max(load, 1e-9)
    p["back_driven_friction"] = x.get("back_driven", load) / p["friction_load"]
    p["friction_temperature"] = x.get("temperature", 0.0)
    return p


def _effects(p: np.void, deviation: Mapping[str, float], scatter: float) -> list[dict[str, Any]]:
    load = float(p["friction_load"])
    value = {
        "load": load, "back_driven": load * float(p["back_driven_friction"]), "temperature": float(p["friction_temperature"]),
    }  # fmt: skip

    def estimate(name: str, unit: str = "1") -> dict[str, Any]:
        std = math.hypot(deviation.get(name, 0.0), scatter * value[name])
        return {"value": float(f"{value[name]:.4g}"), "unit": unit, "std": float(f"{std:.2g}")}

    effects = []
    if "back_driven" in deviation:
        parameters = {"coefficient": estimate("load"), "back_driven": estimate("back_driven")}
        effects.append({"name": "back_driving", "parameters": parameters})
    elif "load" in deviation:
        effects.append({"name": "load_dependent_friction", "parameters": {"coefficient": estimate("load")}})
    if "temperature" in deviation:
        coefficient = estimate("temperature", "1/K")
        effects.append({"name": "friction_temperature", "parameters": {"coefficient": coefficient}})
    return effects


_EXTENT = 85e-6  # rad: middle of the ordinary extents of the cause `hysteresis`


def hysteresis(sheet: GearSheet, record: np.ndarray, rated: float) -> list[dict[str, Any]]:
    """Return the effect `hysteresis` that widens the slow loop of a joint's record to a data sheet's hysteresis loss,
    in a list; an empty one if friction alone makes the loop that wide. Raises `InputError`: a loss that no hysteresis
    torque below the `rated` one explains."""
    from scipy.optimize import brentq

    loss, p = float(sheet.hysteresis_loss or 0.0), record.copy()[0]
    p["hysteresis_extent"] = _EXTENT

    def excess(torque: float) -> float:
        p["hysteresis_torque"] = torque
        return 2 * half_width(p, rated) - loss * _ARCMIN

    if excess(0.0) >= 0:
        return []
    largest = min(20.0, 0.9 * rated)
    if excess(largest) < 0:
        raise InputError(
            f"hysteresis_loss: expected at most the {2 * half_width(p, rated) / _ARCMIN:.2g} arc minutes of a hysteresis of "
            f"{largest:.3g} N·m, got {loss:g}"
        )
    torque = float(f"{brentq(excess, 0.0, largest, rtol=1e-6):.4g}")
    parameters = {
        "torque": {"value": torque, "unit": "N·m", "std": float(f"{sheet.scatter * torque:.2g}")},
        "extent": {"value": _EXTENT, "unit": "rad", "std": 34e-6},
    }
    return [{"name": "hysteresis", "parameters": parameters}]


def comparison(joint: Joint, sheet: GearSheet) -> dict[str, Any]:
    """Return a joint's predictions at a data sheet's entries (`gear_sheet`), the RMS residual of the friction and notes.

    A row's `error` is predicted − stated, in points for an efficiency, else relative [%].
    """
    record, rated = joint.record(), joint.numbers["rated_torque"].value
    p = record[0]
    entries = sheet.entries()
    rows = [(one.kind, one.at, one.value, one.predicted(p)) for one in entries]
    if sheet.hysteresis_loss is not None:
        rows.append(
            ("hysteresis loss [′]", f"{rated:.4g} N·m", sheet.hysteresis_loss, 2 * half_width(p, rated) / _ARCMIN)
        )
    found = []
    for kind, at, stated, predicted in rows:
        error = 100 * (predicted - stated if kind == EFFICIENCY else predicted / stated - 1)
        found.append({"entry": kind, "at": at, "stated": stated, "predicted": predicted, "error": error})
    residual = [math.log(_friction(one, p) / one.friction(float(p["N"]))) for one in entries]
    rms = math.sqrt(sum(x**2 for x in residual) / max(len(residual), 1))
    return {"gear_sheet": found, "residual": rms, "notes": notes(sheet, p, rms)}


_POOR = 0.35  # RMS relative residual that data sheets' scatter does not explain


def notes(sheet: GearSheet, p: np.void, residual: float) -> list[str]:
    """Return a line for each thing of a data sheet that the joint's laws do not carry or fit badly."""
    found = []
    if residual > _POOR:
        found.append(
            f"the joint's friction differs from the data sheet by {100 * residual:.3g} %: check N·m, 1/min and shares"
        )
    if (most := sheet.ratcheting_torque) is not None:
        motor = float(p["N"] * p["Kt"] * p["current_limit"])
        line = f"ratcheting torque {most:g} N·m: no law of the joint has it; the motor gives {motor:.3g} N·m at most"
        found.append(line + (", which can make the gear ratchet" if motor > most else ""))
    if p["friction_temperature"] == 0 and len({one.temperature for one in sheet.entries()}) > 1:
        found.append("temperature: the joint's friction does not depend on it; the data sheet's does")
    if p["hysteresis_torque"] == 0 and sheet.hysteresis_loss is not None:
        found.append("hysteresis loss: no effect added, as mesh friction alone makes the loop that wide")
    return found
