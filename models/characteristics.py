"""Characteristics of a joint description: stiffness, hysteresis, friction, resonances, resolution of its encoders; its
friction as a table with efficiencies, and as a C function for feed-forward.

Each with a standard deviation by the description's tolerances, or by its diagnosis (`calibration.directions`), to
first order. A friction map has the sliding friction in steady motion [N·m, motor side]: mesh with Stribeck curve, load
and direction, viscous parts of mesh and motor. Friction over the link's angle (zero in the mean) and drift (transient)
are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import laws
from .calibration import directions
from .joint import Joint
from .kernels import kernel

_POINTS = 121
_SPEEDS = (0.05, 0.2, 0.6)  # of the no-load speed
_TEST_DRIVE = (1.38e-5 + 8.1e-6) / 0.0603  # A·s²/rad: (Jm + Jw)/Kt of the test joint, with gains 8 and 0.08


@dataclass(frozen=True)
class Resonance:
    """The lowest natural frequency [Hz] of a mounting, undamped, about a torque [N·m], with the rotor free or held."""

    mounting: str
    rotor: str
    torque: float
    frequency: float
    deviation: float


@dataclass(frozen=True)
class Characteristics:
    """Characteristics of a joint."""

    torque: np.ndarray  # of the output, shape (n,) [N·m], from zero to twice the rated one
    torsion: np.ndarray  # of gear and wave generator, shape (n,) [rad], rotor locked, without friction
    torsion_deviation: np.ndarray  # its standard deviation [rad]
    stiffness: np.ndarray  # its slope [N·m/rad]
    loop_torsion: np.ndarray  # a slow loop to the rated torque and back, rotor locked, shape (m,) [rad]
    loop_torque: np.ndarray  # likewise [N·m]
    half_width: float  # half the loop's width at zero torque [rad]
    half_width_deviation: float
    speed: np.ndarray  # of the motor, shape (n,) [rad/s]
    output_speed: np.ndarray  # of the joint [rad/s]
    friction: np.ndarray  # of mesh and bearings at the output [N·m], unloaded, at the reference temperature
    friction_deviation: np.ndarray
    resonances: tuple[Resonance, ...]  # of every mounting except a bench
    counts: tuple[float, float]  # torsion of one count of motor encoder and link encoder [rad]
    noise: float  # rms of the torsion from both [rad]
    torque_resolution: np.ndarray  # the same as torque at the stiffness of `torque` [N·m rms]
    sensor_noise: float  # of the joint torque sensor [N·m rms], zero if not described
    efficiency_speed: np.ndarray  # of the joint, shape (3,) [rad/s]: 5, 20 and 60 % of the no-load speed
    driving: np.ndarray  # efficiency at these speeds over `torque`, shape (3, n)
    driving_deviation: np.ndarray
    back_driving: np.ndarray  # likewise
    back_driving_deviation: np.ndarray
    largest_torque: float  # of the motor at its current limit, without friction [N·m]
    no_load_speed: float  # of the joint [rad/s]


def characteristics(joint: Joint) -> Characteristics:
    """Compute the characteristics of a description with its effects, and their standard deviations."""
    record = joint.record()
    p = record[0]
    moved = directions(joint)
    rated = joint.numbers["rated_torque"].value
    torque = np.linspace(0.0, 2 * rated, _POINTS)

    def known(f: Callable[[np.void], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return a value and its standard deviation."""
        middle = f(p)
        return middle, np.sqrt(sum(((f(r[0]) - middle) ** 2 for r in moved), np.zeros_like(middle)))

    def torsion(q: np.void) -> np.ndarray:
        return np.array(
            [laws.flexspline_torsion(T, q) + laws.wave_generator_torsion(T / q["N"], q) / q["N"] for T in torque]
        )

    no_load = float(p["supply_voltage"] / p["Kt"])
    speed = np.r_[0.0, np.geomspace(0.02 * float(p["vs"]), min(no_load, 1000.0), _POINTS - 1)]
    steps = np.array(_SPEEDS) * no_load / float(p["N"])

    def effective(q: np.void, sign: float) -> np.ndarray:
        at, load = (x.ravel() for x in np.meshgrid(sign * steps, torque[1:], indexing="ij"))
        own = [friction(w, T, q["reference_temperature"], q) for w, T in zip(at, load, strict=True)]
        found = efficiency(at, load, np.array(own), float(q["N"])).reshape(len(steps), -1)
        return np.pad(found, ((0, 0), (1, 0)))

    wound, wound_deviation = known(torsion)
    slope = np.gradient(wound, torque)
    counts = (joint.sensors.motor_encoder.resolution / float(p["N"]), joint.sensors.link_encoder.resolution)
    rounding = sum(c**2 / 12 for c in counts)
    sensed = (joint.sensors.motor_encoder.noise / float(p["N"])) ** 2 + joint.sensors.link_encoder.noise**2
    noise = math.sqrt(rounding + sensed)
    half, half_deviation = known(lambda q: np.array(half_width(q, rated)))
    return Characteristics(
        torque, wound, wound_deviation, 1 / slope, *_loop(p, rated), float(half), float(half_deviation), speed,
        speed / float(p["N"]), *known(lambda q: np.array([_unloaded(w, q) for w in speed])), tuple(_resonances(joint)),
        counts, noise, noise / slope, joint.sensors.joint_torque.noise, steps, *known(lambda q: effective(q, 1.0)),
        *known(lambda q: effective(q, -1.0)), float(p["N"] * p["Kt"] * p["current_limit"]), no_load / float(p["N"]),
    )  # fmt: skip


def drive_gains(joint: Joint) -> tuple[float, float]:
    """Return gains kp [A/rad] and kd [A·s/rad, motor side] of a position controller with the test joint's dynamics.

    In proportion to (Jm + Jw)/Kt, for the same bandwidth, about 24 Hz, and damping.
    """
    n = {symbol: joint.numbers[symbol].value for symbol in ("Jm", "Jw", "Kt")}
    scale = (n["Jm"] + n["Jw"]) / n["Kt"] / _TEST_DRIVE
    return 8.0 * scale, 0.08 * scale


def _unloaded(w: float, p: np.void) -> float:
    """Return the friction of mesh, rotor and output at a steady motor speed, unloaded, at the output [N·m]."""
    temperature = p["reference_temperature"]
    sliding = laws.stribeck_friction(w, 0.0, 0.0, 0.0, temperature, p)
    own = sliding + laws.viscous_friction(w, temperature, p) + p["bm"] * w
    return float(p["N"] * own + p["bl"] * w / p["N"])


def _loop(p: np.void, largest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return torsion [rad] and torque [N·m] of a slow loop of the torque with the rotor locked, shape (m,) each:
    down, and up again.

    In a slow loop friction depends on the travel alone: Tf/N = Tw(δ) − s0 z with δ = −θw, and z(θw) between two
    reversals is an exponential (`laws.bristle_step`); likewise the Dahl state over the flexspline's torsion with
    hysteresis.
    """
    N = float(p["N"])
    g = laws.stribeck_friction(0.0, 0.0, 0.0, 0.0, p["reference_temperature"], p)
    reach = laws.wave_generator_torsion(1.2 * largest / N + g, p)
    winding, load = _branch(reach, lambda x: N * laws.wave_generator_spring(x, p), N * g, g / float(p["s0"]), largest)
    wound, own = _branch(
        laws.flexspline_torsion(1.2 * largest, p), lambda x: laws.flexspline_spring(x, p), float(p["hysteresis_torque"]),
        float(p["hysteresis_extent"]), largest,
    )  # fmt: skip
    torque = np.linspace(largest, -largest, _POINTS)
    down = np.interp(torque, own[::-1], wound[::-1]) + np.interp(torque, load[::-1], winding[::-1]) / N
    return np.r_[down, -down], np.r_[torque, -torque]


def _branch(
    reach: float, spring: Callable[[float], float], friction: float, extent: float, largest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return deflection, decreasing, and torque of a spring with travel-dependent friction, on the way down from the
    largest torque.

    Args:
      reach: a deflection beyond that of the largest torque.
      spring: its torque.
      friction: torque added to the spring's while the deflection grows.
      extent: travel over which friction reverses.
    """
    grid = np.linspace(0.0, reach, _POINTS)
    torque = np.array([spring(x) for x in grid])
    first = torque - friction * np.expm1(-grid / extent)
    turn = float(np.interp(largest, first, grid))
    state = -math.expm1(-turn / extent)
    way = np.r_[0.0, np.geomspace(0.02 * extent, 2 * turn + 20 * extent, _POINTS)]
    deflection = turn - way
    end = (torque[-1] - torque[-2]) / (grid[1] - grid[0])
    size = np.abs(deflection)
    back = np.sign(deflection) * (np.interp(size, grid, torque) + end * np.maximum(size - reach, 0.0))
    return deflection, back + friction * ((state + 1) * np.exp(-way / extent) - 1)


def half_width(p: np.void, rated: float) -> float:
    """Return half the width [rad] of a slow loop to the rated torque [N·m] at zero torque, rotor locked."""
    torsion, torque = _loop(p, rated)
    half = len(torque) // 2
    return float(abs(np.interp(0.0, torque[:half][::-1], torsion[:half][::-1])))


def _resonances(joint: Joint) -> list[Resonance]:
    """Return the lowest natural frequency of every mounting, rotor free and held, at zero and rated torque."""
    rated = joint.numbers["rated_torque"].value
    found = []
    for name, mounting in joint.mountings.items():
        if mounting.locked:
            continue
        records = [joint.record(mounting), *directions(joint, mounting)]
        for held in (True, False):
            for torque in (0.0, rated):
                own, *others = (_frequency(r[0], held, torque) for r in records)
                deviation = math.sqrt(sum((f - own) ** 2 for f in others))
                found.append(Resonance(name, "held" if held else "free", torque, own, deviation))
    return found


def _frequency(p: np.void, held: bool, torque: float) -> float:
    """Return the lowest nonzero natural frequency [Hz] of rotor, wave generator and link about a torque [N·m] without
    damping."""
    N = float(p["N"])
    soft = float(laws.flexspline_stiffness(laws.flexspline_torsion(max(torque, 1e-6), p), p))
    stiff = float(p["Kw0"] * math.exp(p["Cw"] * abs(torque) / N))
    springs = stiff * np.outer([1, -1, 0], [1, -1, 0]) + soft * np.outer([0, 1 / N, -1], [0, 1 / N, -1])
    inertia = np.array([p["Jm"], p["Jw"], p["Jl"]], float)
    if held:
        springs, inertia = springs[1:, 1:], inertia[1:]
    root = np.sqrt(inertia)
    values = np.linalg.eigvalsh(springs / np.outer(root, root))
    moving = values[values > 1e-6 * values[-1]] if not held else values
    return float(math.sqrt(moving[0]) / (2 * math.pi))


COLUMNS = {
    "speed": "rad/s", "load": "N·m", "temperature": "°C", "friction": "N·m", "friction_std": "N·m", "efficiency": "",
    "back_driving": "",
}  # fmt: skip
"""Units of a map's columns: speed and load at the output, friction at the motor."""
_LEAST_SPEED = 0.005  # of the no-load speed
_MAP_SPEEDS, _MAP_LOADS = 12, 9


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


def friction_map(joint: Joint) -> tuple[dict[str, np.ndarray], float]:
    """Compute a joint's friction at speeds up to the no-load speed, of either sign, and loads up to twice the rated torque.

    Returns:
      Columns by the names of `COLUMNS`, shape (n,) each. `efficiency`: of driving if speed and load have one sign, of
        back-driving (`back_driving` = 1) if they differ; NaN without load, 0 if the gear does not back-drive.
      RMS standard deviation of the friction over RMS friction.
    """
    record = steady(joint.record())
    p = record[0]
    top = float(p["supply_voltage"] / (p["Kt"] * p["N"]))
    positive = np.geomspace(_LEAST_SPEED * top, top, _MAP_SPEEDS)
    temperatures = (
        np.linspace(0.0, 60.0, 7) if p["friction_temperature"] != 0 else np.array([p["reference_temperature"]])
    )
    loads = np.linspace(0.0, 2.0 * joint.numbers["rated_torque"].value, _MAP_LOADS)
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
    return columns, float(np.sqrt(np.mean(std**2) / np.mean(values**2)))


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
