"""Friction of a joint over speed, load and temperature: as a table with efficiencies, and as a C function for
feed-forward.

Sliding friction in steady motion [N·m, motor side]: mesh with Stribeck curve, load and direction, viscous parts of
mesh and motor. Friction over the link's angle (zero in the mean) and drift (transient) are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from . import laws
from .joint import Joint
from .kernels import kernel
from .uncertainty import directions

COLUMNS = {
    "speed": "rad/s", "load": "N·m", "temperature": "°C", "friction": "N·m", "friction_std": "N·m", "efficiency": "",
    "back_driving": "",
}  # fmt: skip
"""Units of a map's columns: speed and load at the output, friction at the motor."""
_LEAST = 0.005  # of the no-load speed
_SPEEDS, _LOADS = 12, 9


@dataclass(frozen=True)
class FrictionMap:
    """Friction over a grid; n points."""

    # by the names of `COLUMNS`, shape (n,) each. `efficiency`: of driving if speed and load have one sign, of
    # back-driving (`back_driving` = 1) if they differ; NaN without load, 0 if the gear does not back-drive.
    columns: dict[str, np.ndarray]
    relative: float  # RMS standard deviation of the friction over RMS friction


@kernel
def friction(speed: float, load: float, temperature: float, p: Any) -> float:
    """Return the friction [N·m, motor side] at an output speed [rad/s], a joint torque on the link [N·m], a
    temperature [°C]."""
    w = speed * p.N
    if w == 0.0:
        return 0.0
    g = laws.stribeck_friction(w, 0.0, load, 0.0, temperature, p)
    return (g if w > 0.0 else -g) + laws.viscous_friction(w, temperature, p) + p.bm * w


def steady(record: np.ndarray) -> np.ndarray:
    """Return a record, shape (1,), without friction over angle or time."""
    record = record.copy()
    record[0]["friction_amplitude"], record[0]["drift_amplitude"] = 0.0, 0.0
    return record


def friction_map(joint: Joint) -> FrictionMap:
    """Compute a joint's friction at speeds up to the no-load speed and loads up to twice the rated torque, for either
    sign of the speed; `joint`: its description; the standard deviation is by its tolerances, or by its diagnosis."""
    record = steady(joint.record())
    p = record[0]
    top = float(p["supply_voltage"] / (p["Kt"] * p["N"]))
    positive = np.geomspace(_LEAST * top, top, _SPEEDS)
    temperatures = (
        np.linspace(0.0, 60.0, 7) if p["friction_temperature"] != 0 else np.array([p["reference_temperature"]])
    )
    loads = np.linspace(0.0, 2.0 * joint.numbers["rated_torque"].value, _LOADS)
    speed, load, temperature = (
        x.ravel() for x in np.meshgrid(np.r_[-positive[::-1], positive], loads, temperatures, indexing="ij")
    )

    def of(one: np.ndarray) -> np.ndarray:
        return np.array([friction(*point, one[0]) for point in zip(speed, load, temperature, strict=True)])

    values = of(record)
    std = np.sqrt(sum((of(steady(moved)) - values) ** 2 for moved in directions(joint)))
    back = speed * load < 0
    effective = efficiency(speed, load, values, float(p["N"]))
    columns = dict(zip(COLUMNS, (speed, load, temperature, values, std, effective, back.astype(float)), strict=True))
    return FrictionMap(columns, float(np.sqrt(np.mean(std**2) / np.mean(values**2))))


def efficiency(speed: np.ndarray, load: np.ndarray, friction: np.ndarray, N: float) -> np.ndarray:
    """Return the efficiency [1] at speeds [rad/s] and loads [N·m] of the output with a friction [N·m] at the motor: of
    driving where speed and load have one sign, else of back-driving; NaN without load, 0 where the gear does not
    back-drive. All of shape (n,); N: gear ratio."""
    torque = load / N
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(speed * load < 0, np.maximum((torque + friction) / torque, 0.0), torque / (torque + friction))
    return np.where(load == 0, np.nan, found)


def c_function(joint: Joint, notes: list[str]) -> str:
    """Return the friction as a C function `<joint>_friction` with the joint's numbers; `notes`: first comment."""
    p = steady(joint.record())[0]
    name = "".join(c if c.isalnum() else "_" for c in joint.name)
    name = name if name[:1].isalpha() else f"joint_{name}"
    n = {key: repr(float(p[key])) for key in (
        "N", "Fc", "Fs", "vs", "bw", "bm", "viscous_exponent", "friction_asymmetry", "friction_load", "back_driven_friction",
        "friction_temperature", "reference_temperature",
    )}  # fmt: skip
    comment = "\n * ".join(note.replace("*/", "* /") for note in notes)
    return f"""/* {comment}
 *
 * speed [rad/s] and load [N m] at the output; load: what the joint gives the link; temperature [deg C].
 * Returns the friction [N m] at the motor, to be added to what the motor is asked for. Over the torque constant it is a current.
 * Near zero speed its sign changes evenly over a tenth of the Stribeck velocity.
 */
#include <math.h>

double {name}_friction(double speed, double load, double temperature)
{{
    const double w = speed * {n["N"]}, x = w / {n["vs"]}, s = fmax(-1.0, fmin(1.0, 10.0 * x));
    const double bend = w / ({laws._BENDING!r} * {n["vs"]});
    double g = {n["Fc"]} + ({n["Fs"]} - {n["Fc"]}) * exp(-x * x);
    double viscous = {n["bw"]} * w * pow(1.0 + bend * bend, 0.5 * ({n["viscous_exponent"]} - 1.0));
    const double more = {n["friction_load"]} * fabs(load) / {n["N"]};
    const double warm = fmax(1.0 + {n["friction_temperature"]} * (temperature - {n["reference_temperature"]}), 0.1);
    g *= 1.0 + (w > 0.0 ? {n["friction_asymmetry"]} : -({n["friction_asymmetry"]}));
    g += load * w >= 0.0 ? more : {n["back_driven_friction"]} * more;
    g = fmax(g * warm, {laws._SMALLEST_FRICTION!r});
    return s * g + viscous * warm + {n["bm"]} * w;
}}
"""
