"""All faults of a joint description at once, and unusual numbers.

An *error* is impossible for a joint of this kind: a file that commands refuse, or numbers that contradict each other.
A *warning* is outside the range of products: sizes 8 to 65 of strain wave gears, motors of robot joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from . import causes
from .errors import InputError
from .files import descriptions, kind_of, read_yaml
from .joint import Joint, known_joints, load_joint, unlike_mjcf
from .joint_parts import SYMBOLS, Fault, Mounting, Number, contradictions, number_faults
from .mjcf import check_mjcf
from .parameters import GRAVITY

MADE: dict[str, tuple[float, float]] = {
    "N": (30, 320), "Jm": (1e-7, 5e-3), "Jw": (1e-7, 6e-3), "Kt": (3e-3, 3), "R": (0.02, 60), "L": (2e-6, 0.1),
    "supply_voltage": (6, 800), "current_limit": (0.2, 250), "K1": (250, 6e5), "K2": (300, 9e5), "K3": (350, 1e6),
    "T1": (0.1, 250), "T2": (0.3, 900), "rated_torque": (0.5, 1500), "Fc": (1e-3, 2), "Fs": (1e-3, 3), "vs": (0.05, 100),
}  # fmt: skip
"""Smallest and largest value of products, in the numbers' units: catalogues of gears of sizes 8 to 65 and ratios 30
to 320, of motors from 20 W to 2 kW; of friction, starting torques."""


@dataclass(frozen=True)
class Checked:
    """A checked description: its file, the joint if it is valid, and its faults, errors first."""

    path: Path
    joint: Joint | None
    problems: tuple[Fault, ...]

    @property
    def errors(self) -> int:
        """Number of errors."""
        return sum(p.severity == "error" for p in self.problems)


def check(source: str | Path) -> Checked:
    """Return all errors and warnings of a joint's file, or of a shipped joint, in the order of the file if known.
    Raises `InputError`: no such file."""
    path = known_joints().get(str(source).replace("_", "-"), Path(source))
    if not path.is_file():
        load_joint(source)  # raises with the known names
    try:
        data = read_yaml(path, "a joint description")
    except InputError as error:
        return Checked(path, None, (Fault("error", "file", str(error).removeprefix(f"{path}:").strip()),))
    if not isinstance(data, dict):
        return Checked(path, None, (Fault("error", "file", f"expected a mapping of keys, got {kind_of(data)}"),))
    joint, faults = _read(data)
    found = [Fault("error", field, message) for field, _, message in (text.partition(": ") for text in faults)]
    if joint is not None:
        joint._path = path.resolve()
        found += _mjcf(joint)
    numbers = _each(data.get("numbers"), Number) if joint is None else joint.numbers
    mountings = _each(data.get("mountings"), Mounting) if joint is None else joint.mountings
    wrong = {p.field.split(".")[1] for p in found if p.field.startswith("numbers.")}  # these are wrong already
    found += _implausible({symbol: n for symbol, n in numbers.items() if symbol not in wrong}, mountings)
    if joint is not None and not faults:
        found += list(_odd(joint))
    return Checked(path, joint if not faults else None, tuple(sorted(found, key=lambda p: p.severity != "error")))


def _read(data: dict[str, Any]) -> tuple[Joint | None, list[str]]:
    faults: list[str] = []
    try:
        return Joint.model_validate(data, context={"faults": faults}), faults
    except ValidationError as error:
        lines = descriptions(error, Joint)
    # Readable numbers are checked anyway.
    shared = data.get("shared_tolerances")
    known = shared if isinstance(shared, dict) else {}
    whole = data.get("numbers")
    if isinstance(whole, dict):
        named, numbers = {line.split(":")[0] for line in lines}, _each(whole, Number)
        unread = {str(symbol) for symbol in whole} - set(numbers)
        for fault in number_faults(numbers, known):
            field = fault.split(":")[0]
            if field not in named and not (fault.endswith(": missing") and field.removeprefix("numbers.") in unread):
                lines.append(fault)
    chosen, mountings = data.get("mounting"), data.get("mountings")
    if isinstance(mountings, dict) and isinstance(chosen, str) and chosen not in mountings:
        lines.append(f"mounting: expected one of {sorted(map(str, mountings))}, got {chosen!r}")
    return None, lines


def _each(given: Any, model: type[BaseModel]) -> dict[str, Any]:
    found = {}
    for name, one in given.items() if isinstance(given, dict) else ():
        try:
            found[str(name)] = model.model_validate(one)
        except ValidationError:
            continue
    return found


def _mjcf(joint: Joint) -> list[Fault]:
    try:
        mjcf = joint.mjcf
        if not mjcf.is_file():
            return [Fault("error", "model", f"expected an MJCF file, no such file {joint.model!r}")]
        check_mjcf(mjcf)
    except InputError as error:
        return [Fault("error", "model", str(error))]
    return list(unlike_mjcf(joint))


def _implausible(numbers: Mapping[str, Number], mountings: Mapping[str, Mounting]) -> Iterator[Fault]:
    value = {symbol: number.value for symbol, number in numbers.items() if number.value > 0}
    fitted = {symbol for symbol, number in numbers.items() if number.nominal is not None}
    yield from contradictions(value, fitted)
    for symbol, (low, high) in MADE.items():
        if symbol in value and not low <= value[symbol] <= high:
            made = f"{low:g} to {high:g} {SYMBOLS[symbol][0]}".removesuffix(" 1")
            yield _odd_value(f"numbers.{symbol}", f"{made}, as makers have it", value[symbol])
    yield from _proportions(value)
    for name, mounting in mountings.items():
        yield from _mounting(name, mounting, value)


def _odd_value(field: str, expected: str, got: float) -> Fault:
    return Fault("warning", field, f"expected {expected}, got {got:.3g}")


_PROPORTIONS: tuple[tuple[str, Callable[[Mapping[str, float]], float], float, float, str], ...] = (
    ("K2", lambda v: 1e3 * v["rated_torque"] / v["K2"], 0.3, 8, "a torsion of 0.3 to 8 mrad at rated torque (rated_torque/K2)"),
    ("Kw0", lambda v: v["Kw0"] * v["N"] ** 2 / v["K1"], 0.2, math.inf,
     "a wave generator no softer than 0.2 of the flexspline (N² Kw0/K1)"),
    ("Fc", lambda v: 100 * v["Fc"] * v["N"] / v["rated_torque"], 0.5, 60,
     "friction of 0.5 to 60 % of the rated torque (N Fc/rated_torque)"),
    ("s0", lambda v: 1e3 * v["Fc"] / v["s0"], 0.02, 50, "0.02 to 50 mrad of presliding (Fc/s0, motor side)"),
    ("bw", lambda v: v["bw"] * 200 / v["Fc"], 0, 20, "viscous friction at 200 rad/s of at most 20 Fc (200 bw/Fc)"),
    ("L", lambda v: 1e3 * v["L"] / v["R"], 0.02, 50, "an electrical time constant of 0.02 to 50 ms (L/R)"),
    ("Jm", lambda v: 1e3 * v["R"] * v["Jm"] / v["Kt"] ** 2, 0.05, 100,
     "a mechanical time constant of 0.05 to 100 ms (R Jm/Kt²)"),
    ("current_limit", lambda v: v["N"] * v["Kt"] * v["current_limit"] / v["rated_torque"], 0.3, 10,
     "a motor that gives 0.3 to 10 times the gear's rated torque (N Kt current_limit/rated_torque)"),
)  # fmt: skip
"""Number, a ratio, its usual range, and the range in words: a wrong unit shows here if the number alone is possible."""


def _proportions(value: Mapping[str, float]) -> Iterator[Fault]:
    if value.get("T1", 0.0) > value.get("rated_torque", math.inf):
        yield _odd_value("numbers.T1", f"less than the rated torque {value['rated_torque']:g} N·m", value["T1"])
    for symbol, ratio, low, high, expected in _PROPORTIONS:
        with suppress(KeyError):  # a number is missing
            got = ratio(value)
            if not low <= got <= high:
                yield _odd_value(f"numbers.{symbol}", expected, got)


def _mounting(name: str, mounting: Mounting, value: Mapping[str, float]) -> Iterator[Fault]:
    if mounting.locked or not mounting.gravity_moment:
        return
    lever = mounting.inertia * GRAVITY / mounting.gravity_moment
    if not 0.02 <= lever <= 10:
        expected = "an inertia of the mass at a lever of 0.02 to 10 m (inertia g/gravity_moment)"
        yield _odd_value(f"mountings.{name}", expected, lever)
    if "rated_torque" in value and mounting.gravity_moment > 3 * value["rated_torque"]:
        expected = f"a gravity moment of at most three times the rated torque {value['rated_torque']:g} N·m"
        yield _odd_value(f"mountings.{name}", expected, mounting.gravity_moment)


def _odd(joint: Joint) -> Iterator[Fault]:
    p = joint.bare_record()[0]
    slope = sum(abs(float(o.order * o.amplitude.value)) for o in joint.kinematic_error) * float(p["N"])
    if slope >= 1:
        text = f"expected a kinematic error that never turns the motion round (Σ order·A < 1/N), got {slope:.3g}/N"
        yield Fault("warning", "kinematic_error", text)
    sensors = joint.sensors
    seen = math.hypot(sensors.motor_encoder.resolution / float(p["N"]), sensors.link_encoder.resolution)
    rated = joint.numbers["rated_torque"].value
    share = 100 * seen * float(p["K1"]) / rated
    if share > 20:
        expected = "encoders of which a count is at most 20 % of the rated torque in torsion (K1 · count)"
        yield _odd_value("sensors", expected, share)
    for i, effect in enumerate(joint.effects):
        for q in causes.get(effect.name).parameters:
            largest = max((abs(high) for _, high in q.ordinary), default=math.inf)
            if q.magnitude and q.relative is None and abs(effect.values[q.name]) > 20 * largest:
                text = f"at most twenty times what is ordinary, {largest:g} {q.unit}"
                yield _odd_value(f"effects.{i}.parameters.{q.name}", text, effect.values[q.name])
