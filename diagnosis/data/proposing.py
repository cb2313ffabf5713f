"""The mapping of an unknown log, proposed from names and values of its columns.

A name is split into words. Words say what a column may be, on which side of the gear, and whether it is a command; the other
words (a number, a joint's name) identify the joint. Values determine the rest: a unit, whether an angle wraps, which column
is the time.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...models.errors import InputError
from ...models.files import flow_text, yaml_text
from ...models.signals import DRIVING, POSITIONS
from ...models.text_tables import seconds
from .importing import UNITS
from .log import Log
from .logs import open_log
from .messages import Messages

_WORDS: dict[str, str] = {
    word: kind
    for kind, words in {
        "time": """t time times timestamp timestamps stamp clock datetime date zeit ts sec secs seconds millis micros nanos
            uhrzeit""",
        "position": """position positions pos angle angles q qs theta qpos phi encoder enc ang winkel state degree degrees lage
            drehwinkel th""",
        "velocity": "velocity velocities vel speed qd dq qvel omega drehzahl dtheta qdot thetadot w",
        "acceleration": "acceleration acc accel ddq qdd qddot ddtheta",
        "current": "current currents i iq amp amps ampere strom cur curr im ia",
        "torque": "torque torques tau trq effort efforts moment drehmoment tq mom torsion",
        "load": "load pwm duty",
        "temperature": "temperature temperatures temp temps temperatur",
        "episode": "episode",
        "command": """target goal desired des cmd command commands ref reference setpoint setpoints set commanded action input
            ctrl soll d demand con required""",
        "motor": "motor mot rotor m drive inc",
        "link": "link output out l abs flange",
        "other": """error err mode status voltage volts volt bus vbus index frame task id tcp cartesian pose gripper ext external
            std covariance enable enabled seq nanosec collision robot fric friction gravity model stiffness digital analog bits
            seed done reward hat nsecs power safety execution scaling momentum tool accelerometer force forces payload cog
            filtered filt counter""",
    }.items()
    for word in words.split()
}  # fmt: skip
_FILLERS = set(
    "actual present measured meas measurement observation states joint joints j value values feedback fb raw axis axes control "
    "actuator actuators csv txt data est estimate estimated log of in the state arm0 servo header sensor msg read reading read "
    "entries info base dynamixel odrive odrv0 pv ist can side hardware sys".split()
)
_UNIT_WORDS = {
    word: unit
    for unit, words in {
        "deg": "deg degs degree degrees", "rad": "rad rads radian radians", "mrad": "mrad", "rpm": "rpm",
        "rev": "rev revs turn turns",
        "counts": "ticks counts count", "mA": "ma milliamps", "N·m": "nm", "mN·m": "mnm", "°C": "degc celsius",
        "ms": "ms msec millis", "us": "us µs usec micros", "ns": "ns nanos nsec",
    }.items()
    for word in words.split()
}  # fmt: skip
"""Units as words of a name."""
_KNOWN = _WORDS.keys() | _FILLERS | _UNIT_WORDS.keys() | {"s", "a", "n"}
_OF = {"position": "rad", "current": "A", "torque": "N·m", "temperature": "°C", "time": "s", "velocity": "rad/s"}
"""SI unit of a kind."""


@dataclass(frozen=True)
class _Column:
    """A column and what its name says."""

    name: str
    values: np.ndarray  # finite ones, shape (n,)
    kind: str
    side: str
    command: bool
    unit: str | None
    of: tuple[str, ...]  # rest of its name: a joint's number or name
    dated: bool = False


def _split(name: str) -> list[str]:
    """Words and numbers of a name, in small letters."""
    spaced = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    spaced = re.sub(r"([A-Z])([A-Z][a-z])", r"\1 \2", spaced)
    found: list[str] = []
    for word in re.findall(r"[a-zµäöü]+|\d+", spaced.lower()):
        cuts = ((word[:i], word[i:]) for i in range(3, len(word) - 2)) if word not in _KNOWN else ()
        found += next((pair for pair in cuts if _KNOWN.issuperset(pair)), (word,))  # two known ones, as `motorinc`
    return found


def _unit_of(name: str, stated: str | None) -> str | None:
    """A unit in brackets at the end of a name, or of the log's row of units, as mappings have it."""
    found = re.search(r"[\[(]\s*([^\])\d]+?)\s*[\])]\s*$", name)
    text = (found.group(1) if found else stated or "").strip()
    known = {unit.lower(): unit for unit in UNITS if unit not in ("mN·m", "mNm")} | _UNIT_WORDS
    known |= {"sec": "s", "c": "°C", "n*m": "N·m", "n.m": "N·m", "mn*m": "mN·m", "mn·m": "mN·m"}
    return known.get(text.lower())


_STRONG = ("position", "velocity", "acceleration", "current", "torque", "temperature")


def _kind(parts: list[list[str]]) -> str:
    """What a column is, by the words of its name's parts: by the last part that says so, and in it by the last word."""
    for words in reversed(parts):
        kinds = [_WORDS.get(word, "") for word in words]
        strong = [kind for kind in kinds if kind in _STRONG]
        if "temperature" in strong or "iq" in words:
            return "temperature" if "temperature" in strong else "current"
        if strong:
            return strong[-1]
        if found := next((kind for kind in ("episode", "time", "load") if kind in kinds), ""):
            return found
    return ""


def _described(name: str, values: np.ndarray, stated: str | None) -> _Column:
    dated = values.dtype.kind in "mM"
    numbers = seconds(values) if dated else values
    unit = _unit_of(name, stated)
    bare = re.sub(r"[\[(][^\])\d]+[\])]\s*$", "", name)
    parts = [_split(re.sub(r"(?i)\bi_([qd])\b", r"i\1", part)) for part in bare.split("/")]
    words = [word for part in parts for word in part]
    kinds = [_WORDS.get(word, "") for word in words]
    kind = _kind(parts)
    if "other" in kinds and kind not in ("episode", "time"):
        kind = ""
    command = "command" in kinds or parts[0] == ["control", "csv"]
    if not kind and command and "other" not in kinds:  # `action/0`
        kind = "position"
    if unit is None and words:
        ends = [_UNIT_WORDS.get(word) for word in words]
        unit = next((u for u in reversed(ends) if u), None)
        if unit in ("rad", "deg") and (words[-2:] in (["rad", "s"], ["deg", "s"]) or words[-1] in ("rads", "degs")):
            unit = f"{unit}/s"
        last = words[-1]
        unit = "A" if kind == "current" and last == "a" and len(words) > 1 else unit
        unit = "s" if kind == "time" and last == "s" and len(words) > 1 else unit
    if unit is not None:
        of = UNITS[unit][0]
        by_unit = next((k for k, one in _OF.items() if one == of), "")
        if (kind, by_unit) in (("position", "velocity"), ("", "time")) or (not kind and "other" not in kinds):
            kind = by_unit
        elif kind and by_unit and kind != by_unit and kind in _OF:
            unit = None
    inside = [_WORDS.get(word, "") for part in parts if part[-1:] not in (["csv"], ["txt"]) for word in part]
    side = next((k for k in inside if k in ("motor", "link")), "")
    if kind == "position" and words[-2:] == ["pos", "estimate"]:  # of ODrive
        side, unit = "motor", "rev"
    side = side or ("link" if kind == "position" and "load" in inside else "")
    rest = tuple(word for word in words if word not in _KNOWN)
    return _Column(name, numbers[np.isfinite(numbers)], kind, side, command, unit, rest, dated)


def _columns(log: Log) -> Iterator[_Column]:
    """Every column of numbers or dates."""
    try:
        found = log.read(log.names) if len(set(log.names)) == len(log.names) and not isinstance(log, Messages) else {}
    except InputError:
        found = {}
    for name in dict.fromkeys(log.names):
        if name not in found:
            try:
                found |= log.read([name])
            except (InputError, KeyError, ValueError):  # text, or a topic that was not read
                continue
    for name in log.names:
        values = found.get(name)
        if values is not None and len(values) > 1:
            missing = np.isnat(values) if values.dtype.kind in "mM" else ~np.isfinite(values)
            if 2 * np.count_nonzero(missing) < len(values):
                yield _described(name, values, log.units.get(name))


# What values say --------------------------------------------------------------------------------------------------------------


def _increases(column: _Column) -> bool:
    step = np.diff(column.values)
    return len(step) > 0 and bool(np.mean(step >= 0) > 0.95 and np.mean(step > 0) > 0.3)


def _even(column: _Column) -> bool:
    """Whether a column increases evenly, but is no number of rows."""
    step = np.diff(column.values)
    return column.dated or bool(np.std(step) < 0.1 * np.mean(step) and not np.all(step == 1.0))


def _time_unit(column: _Column) -> tuple[str, str]:
    """Unit of a time and why."""
    step = np.diff(column.values)
    dt = float(np.median(step[step > 0]))
    if column.dated:
        return "s", f"dates or clock times, {1 / dt:.4g} Hz"
    likely = [u for u in ("s", "ms", "us", "ns") if 4e-5 <= dt * UNITS[u][1] <= 0.21]
    today = [u for u in likely if 1e9 < UNITS[u][1] * float(np.max(column.values)) < 4e9]
    said = [column.unit] if column.unit in ("s", "ms", "us", "ns") else []
    unit = (said or today or likely or ["s"])[0]
    return unit, f"a step of {dt:.6g} is {1 / (dt * UNITS[unit][1]):.4g} Hz in {unit}"


def _angle(column: _Column, given: str | None = None) -> tuple[dict, str]:
    """Unit of an angle, with counts and `wraps`, and why."""
    values, said = column.values, column.unit if column.unit and UNITS[column.unit][0] == "rad" else given
    largest, span = float(np.max(np.abs(values))), float(np.ptp(values))
    whole = bool(np.all(values == np.round(values))) and span > 20
    found: dict = {
        "unit": said or ("counts" if whole and span > 60 else "rad" if largest < 7 or column.side == "motor" else "deg")
    }
    why = "as its name says" if column.unit == said and said else f"largest {largest:.4g}"
    if found["unit"] == "counts":
        found["counts"] = 2 ** max(12, int(np.ceil(np.log2(max(largest, 1) + 1))))
        why = "whole numbers; counts per turn: CHECK"
    turn = 2 * np.pi / UNITS[found["unit"]][1] * found.get("counts", 1)
    jump = float(np.max(np.abs(np.diff(values))))
    if 0.7 * turn < jump < 1.3 * turn:
        found["wraps"] = True
        why += ", jumps by a turn"
    return found, why


def _quantity(column: _Column) -> tuple[dict, str]:
    """Unit of a current, torque, temperature or duty, and why."""
    largest = float(np.max(np.abs(column.values)))
    whole = bool(np.all(column.values == np.round(column.values)))
    si = _OF.get(column.kind, "1")
    if column.unit and UNITS[column.unit][0] == si:
        return {"unit": column.unit}, "as its name says"
    if column.kind == "current":
        if whole and "present" in _split(column.name):
            return {"unit": "mA", "scale": 2.69}, "a register in units of 2.69 mA (X series; others differ): CHECK"
        return {"unit": "mA" if largest > (100 if whole else 300) else "A"}, f"largest {largest:.4g}"
    if column.kind == "torque":
        words = _split(column.name)
        why = f"largest {largest:.4g}"
        if {"effort", "efforts"} & set(words):
            why += "; an effort is a torque at the output in ROS. If it is a current, name it motor_current, in A"
        return {"unit": "mN·m" if largest > 3000 else "N·m"}, why
    if column.kind == "temperature":
        kelvin = 250 < np.median(column.values) < 420
        return {"unit": "°C", **({"offset": -273.15} if kelvin else {})}, f"largest {largest:.4g}"
    return {"unit": "1", "scale": 0.001}, "a duty or load, no torque: FILL IN its A per unit, and its sign"


def _motor_unit(motor: _Column, link: _Column, unit: str) -> str | None:
    """Unit of a motor's angle by its ratio to the link's, which gears have between 20 and 400."""
    if len(motor.values) != len(link.values) or np.std(link.values) == 0:
        return None
    slope = float(abs(np.polyfit(link.values - link.values[0], motor.values - motor.values[0], 1)[0])) / UNITS[unit][1]
    fitting = [u for u in ("rad", "deg", "rev") if 20 <= slope * UNITS[u][1] <= 400]
    return fitting[0] if fitting else None


# The mapping ------------------------------------------------------------------------------------------------------------------


def _measured(columns: list[_Column], kind: str, of: tuple[str, ...], side: str | None = None) -> _Column | None:
    """Return the first measured column of a kind and joint, or of no joint, or the only one of that kind."""
    fitting = [c for c in columns if c.kind == kind and not c.command and (side is None or c.side == side)]
    return next((c for key in (of, ()) for c in fitting if c.of == key), fitting[0] if len(fitting) == 1 else None)


def _joint(columns: list[_Column]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the key of the joint with angle and current or torque that moves most, and the other keys."""
    moves: dict[tuple[str, ...], float] = {}
    driven = {c.of for c in columns if c.kind in ("current", "torque") and not c.command}
    driven = driven or {c.of for c in columns if c.kind == "load"}
    for c in columns:
        if c.kind == "position" and not c.command and (c.of in driven or () in driven or not driven):
            quantity, _ = _angle(c)
            turn = 2 * np.pi / UNITS[quantity["unit"]][1] * quantity.get("counts", 1)
            values = np.unwrap(c.values, period=turn) if "wraps" in quantity else c.values
            moves[c.of] = max(moves.get(c.of, 0.0), float(np.std(values)))
    chosen = max(moves, key=lambda key: moves[key], default=())
    return chosen, [key for key in moves if key != chosen]


def proposed(path: Path) -> str:
    """Propose the mapping of a log.

    Args:
      path: of the log, in any format that is read.

    Returns:
      A mapping file as text, with the reason of each line. Joint and link are to be filled in.

    Raises:
      InputError: a log that cannot be read.
    """
    log = open_log(path)
    columns = list(_columns(log))
    found: dict[str, tuple[dict, str]] = {}
    used: set[str] = set()

    def propose(target: str, column: _Column, quantity: dict, why: str) -> None:
        used.add(column.name)
        found[target] = ({"column": column.name, **quantity}, why)

    of, others = _joint(columns)
    times = [c for c in columns if c.kind == "time" and _increases(c)]
    times = times or [c for c in columns if not c.kind and _increases(c) and _even(c)]
    link_side = _measured(columns, "position", of, "link") or _measured(columns, "position", of, "")
    topic = link_side.name.rpartition("/position/")[0] if link_side else ""
    times.sort(key=lambda c: (not (topic and c.name == f"{topic}/stamp"), c.of not in ((), of)))
    if times:
        unit, why = _time_unit(times[0])
        zero = {} if times[0].dated or times[0].values[0] == 0 else {"zero": "first"}
        propose("time", times[0], {"unit": unit} | zero, why)
    else:
        found["time"] = ({"rate": 1000}, "FILL IN: no column increases as a time does; this many rows a second")
    motor_side = _measured(columns, "position", of, "motor")
    angle_unit = ""
    if link_side is not None:
        propose("link_position", link_side, *_angle(link_side))
        angle_unit = found["link_position"][0]["unit"]
        commands = [c for c in columns if c.kind == "position" and c.command and c.of == of and c.side != "motor"]
        for command in commands[:1]:
            quantity, _ = _angle(replace(command, side=""), angle_unit)
            propose("position_command", command, quantity | {"optional": True}, "commanded; unit as of the angle")
    if motor_side is not None:
        by_ratio = _motor_unit(motor_side, link_side, angle_unit) if link_side is not None else None
        quantity, why = _angle(motor_side, by_ratio)
        propose("motor_position", motor_side, quantity, why + (", by its ratio to the link's" if by_ratio else ""))
    elif link_side is None and (speed := _measured(columns, "velocity", of)) is not None:
        unit = speed.unit if speed.unit and UNITS[speed.unit][0] == "rad/s" else "rad/s"
        propose("link_position", speed, {"unit": unit, "integrate": True}, "no angle, but a speed")
    for target, kind, side in (
        ("motor_current", "current", None), ("motor_torque", "torque", "motor"), ("joint_torque", "torque", "link"),
        ("joint_torque", "torque", ""), ("temperature", "temperature", None),
    ):  # fmt: skip
        column = _measured(columns, kind, of, side)
        if column is not None and target not in found:
            quantity, why = _quantity(column)
            propose(target, column, quantity | ({"optional": True} if target == "temperature" else {}), why)
    if not found.keys() & {*POSITIONS}:
        found["link_position"] = ({"column": "COLUMN", "unit": "rad"}, "FILL IN: no name says an angle")
    if not found.keys() & {*DRIVING}:
        found["motor_current"] = ({"column": "COLUMN", "unit": "A"}, "FILL IN: no name says a current or torque")
        if (load := _measured(columns, "load", of)) is not None:
            propose("motor_current", load, *_quantity(load))
    episode = next((c.name for c in columns if c.kind == "episode"), None)
    spare = [name for name in dict.fromkeys(log.names) if name not in used and name != episode]
    lines = [
        f"# Proposed for {path.name} by names and values. Check every line; FILL IN what is marked.",
        "format: 1",
        f"name: {re.sub(r'[^A-Za-z0-9_-]+', '-', path.stem).strip('-') or 'mine'}",
        "joint: JOINT  # FILL IN: a shipped joint (`flexspline joints`), or the path of a description",
        "link: {inertia: 1.0, gravity_moment: 0.0}  # FILL IN: kg·m² and N·m at horizontal of the link",
    ]
    if episode is not None:
        lines.append(f"episodes: {yaml_text(episode).splitlines()[0]}  # a recording of each of its values")
    lines.append("columns:")
    order = ("time", *POSITIONS, *DRIVING, "position_command")
    for target in sorted(found, key=lambda name: order.index(name) if name in order else len(order)):
        quantity, why = found[target]
        lines.append(f"  {target}: {flow_text(quantity)}  # {why}")
    if others:
        names = ", ".join(" ".join(key) or "one without a number" for key in others[:12])
        lines.append(f"# This is joint {' '.join(of) or 'without a number'}, which moves most; others: {names}")
    if spare:
        lines.append(f"# Not used: {', '.join(spare[:40])}{', …' if len(spare) > 40 else ''}")
    return "\n".join(lines) + "\n"
