"""A joint from its datasheets: rules of scale, with wide tolerances, fill the missing numbers.

The number's `source` states the rule. Rules of the gear are its catalogue's (`catalogue.gear`). Those of friction,
damping and sensors are the test joint's proportions, which the measured joints (LARA8, UR3e) share within their
tolerances.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .arm import link_mass
from .catalogue import Gear, gear
from .characteristics import drive_gains
from .controller import Controller
from .errors import InputError, nearest
from .files import check_name, write_text, yaml_text
from .gear_sheet import GearFit, GearSheet, fit, hysteresis
from .joint import Joint, as_joint, shipped
from .joint_parts import OPTIONAL_SYMBOLS, SYMBOLS, value_fault
from .mjcf import STATED
from .parameters import GRAVITY
from .units import plain

_RULE = "rule: "
_TYPICAL = 0.4  # relative deviation of a rule of proportion
_FACTOR_2, _FACTOR_3 = 1.0, 2.0  # tolerances: a standard deviation is a factor of 2, of 3
_DRIVEN = ("N", "Kt", "R", "L", "Jm")

_SCALES: dict[str, dict[str, float]] = {
    "kg·m^2": {"kg·m^2": 1.0, "kg·cm^2": 1e-4, "g·cm^2": 1e-7, "kg·mm^2": 1e-6},
    "N·m/A": {"N·m/A": 1.0, "mN·m/A": 1e-3, "N·cm/A": 1e-2},
    "H": {"H": 1.0, "mH": 1e-3, "µH": 1e-6},
    "ohm": {"ohm": 1.0, "mohm": 1e-3},
    "N·m": {"N·m": 1.0, "mN·m": 1e-3},
    "N·m/rad": {"N·m/rad": 1.0, "N·m/arcmin": 60 * 180 / math.pi, "kN·m/rad": 1e3},
    "A": {"A": 1.0, "mA": 1e-3},
    "V": {"V": 1.0},
}
"""Units in datasheets, by the unit of a description, with their factor."""
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)")
_THOUSANDS = re.compile(r"(?<![\d.,])[1-9]\d{0,2}(?:,\d{3})+(?!\d)")
_GEAR = re.compile(r"\s*([A-Za-z]+)[-\s]*(\d+)[-\s]+(\d+)(?![\d.])")
_ENCODER = re.compile(r"\s*(\d+)\s*-?\s*(bits?|counts?)?\s*")


def quantity(text: str, symbol: str, where: str) -> float:
    """Return a number of a datasheet (`181 gcm²`, `0.6 mH`) in the unit of a description's `symbol`; SI without a unit.
    Raises `InputError`: not a number, or a wrong unit."""
    unit = (SYMBOLS | OPTIONAL_SYMBOLS)[symbol][0]
    scales = _SCALES.get(plain(unit), {plain(unit): 1.0})
    known = {_bare(name): scale for name, scale in scales.items()}
    if (either := _THOUSANDS.search(text)) is not None:
        one, other = either[0].replace(",", "."), either[0].replace(",", "")
        raise InputError(f"{where}: expected {one} or {other}, got {text!r}, which may be either")
    found = _QUANTITY.fullmatch(text.replace(",", "."))  # a decimal comma
    if found is None:
        raise InputError(f"{where}: expected a number, with or without unit ({', '.join(scales)}), got {text!r}")
    number, given = float(found[1]), found[2].strip()
    if not given:
        return number
    if _bare(given) not in known:
        raise InputError(f"{where}: expected one of the units {', '.join(scales)}, got {given!r}")
    return number * known[_bare(given)]


def _bare(unit: str) -> str:
    """Return a unit without dots, blanks and signs of powers."""
    text = plain(unit).replace("u", "µ") if unit[:1] == "u" else plain(unit)
    return text.replace("·", "").replace("^", "").replace("Ohm", "ohm")


def encoder(text: str, where: str) -> dict[str, int]:
    """Return an encoder's resolution, `4096` counts per revolution (after quadrature) or `20 bit`, as in
    `joint_parts.EncoderSpec`. Raises `InputError`: neither."""
    found = _ENCODER.fullmatch(text)
    if found is None or int(found[1]) < 2 or len(found[1]) > 12:
        raise InputError(f"{where}: expected counts per revolution (4096) or bits (20 bit), got {text!r}")
    return {"bits" if (found[2] or "").startswith("bit") else "counts": int(found[1])}


def gear_name(text: str, where: str) -> tuple[str, float, float]:
    """Return series, size and ratio of a gear's name, `CSG-25-100`, without the maker's suffix. Raises `InputError`:
    another form, or a gear that no catalogue has."""
    found = _GEAR.match(text)
    if found is None:
        raise InputError(f"{where}: expected series-size-ratio (CSG-25-100), got {text!r}")
    try:
        gear(found[1], float(found[2]), float(found[3]))
    except InputError as error:
        raise InputError(f"{where}: {str(error).removeprefix('gear: ')}") from error
    return found[1], float(found[2]), float(found[3])


@dataclass(frozen=True)
class Datasheet:
    """Numbers of the datasheets of gear, motor and encoders, SI."""

    series: str  # of the gear: CSG
    size: float  # 25
    ratio: float  # 100
    # given numbers of a description by symbol: Kt [N·m/A], R [ohm], L [H], Jm [kg·m²], and others
    numbers: Mapping[str, float]
    motor_encoder: Mapping[str, int]  # resolutions, as of `encoder`
    link_encoder: Mapping[str, int]  # resolutions, as of `encoder`
    name: str = ""  # of the joint; empty: from the gear
    motor: str = ""  # its name, for sources
    # of given numbers by symbol, if not the motor's or gear's datasheet
    sources: Mapping[str, str] = field(default_factory=dict)
    # relative standard deviations of given numbers, if not those of a datasheet
    tolerances: Mapping[str, float] = field(default_factory=dict)
    # inertia, gravity_moment: of the load [kg·m²], [N·m] at horizontal; None: by the gear's size
    inertia: float | None = None
    gravity_moment: float | None = None
    description: str = ""  # in words; empty: gear and motor
    gear: GearSheet | None = None  # the gear's data sheet; friction and hysteresis are fitted to it


@dataclass(frozen=True)
class Filled:
    """A number filled by a rule: name and value with unit, relative tolerance (0: exact), the rule."""

    name: str
    value: float
    unit: str
    tolerance: float
    rule: str


@dataclass(frozen=True)
class NewJoint:
    """A description from datasheets."""

    joint: Joint  # the description
    filled: tuple[Filled, ...]  # numbers filled by rules, in order
    gear: Gear  # of the catalogue
    path: Path  # of its file


def new_joint(sheet: Datasheet, path: Path | None = None) -> NewJoint:
    """Return the complete description of a joint by its known numbers, with the rules that filled it. `path`: of its
    file, which names the MJCF; by default the joint's name. Raises `InputError`: an impossible gear or number, or a
    missing number."""
    catalogued = gear(sheet.series, sheet.size, sheet.ratio)
    for symbol, value in sheet.numbers.items():
        if symbol not in SYMBOLS:
            raise InputError(f"{symbol}: unknown number{nearest(symbol, SYMBOLS)}")
        if (fault := value_fault(symbol, value)) is not None:
            raise InputError(fault)
    if sheet.inertia is not None and not sheet.inertia > 0:
        raise InputError(f"inertia: expected a number > 0 kg·m², got {sheet.inertia:g}")
    given = {"N": float(sheet.ratio)} | dict(sheet.numbers)  # a different mounting adds 1 to the ratio
    missing = [symbol for symbol in _DRIVEN if symbol not in given]
    if missing:
        raise InputError(f"datasheet: expected {', '.join(missing)}, got none")
    name = check_name(sheet.name or catalogued.name.lower(), "name")
    path = path or Path(f"{name.replace('-', '_')}.yaml")
    fitted, scatter, source = GearFit({}, []), 0.0, ""
    if sheet.gear is not None:
        before = _Rules(catalogued, given)
        fitted = fit(sheet.gear, {symbol: before[symbol] for symbol in ("Fs", "Fc", "vs", "bw")}, given)
        given |= {symbol: float(f"{value:.4g}") for symbol, (value, _) in fitted.numbers.items()}
        scatter, source = sheet.gear.scatter, f"fitted to {sheet.gear.source}"
    rules = _Rules(catalogued, given)
    numbers: dict[str, dict[str, Any]] = {}
    for symbol, (unit, _) in (SYMBOLS | OPTIONAL_SYMBOLS).items():
        if symbol in fitted.numbers:
            tolerance = sheet.tolerances.get(symbol, float(f"{fitted.numbers[symbol][1]:.2g}"))
            numbers[symbol] = _row(given[symbol], unit, tolerance, source)
            if symbol == "bw":
                numbers[symbol]["shared"] = "friction"
        elif symbol in given:
            numbers[symbol] = _row(given[symbol], unit, *_given(symbol, sheet, catalogued))
        elif symbol in SYMBOLS:
            value, tolerance, rule = rules.of(symbol)
            numbers[symbol] = _row(value, unit, sheet.tolerances.get(symbol, tolerance), _RULE + rule)
        if symbol in _SHARED:
            numbers[symbol]["shared"] = _SHARED[symbol]
    values = {symbol: float(row["value"]) for symbol, row in numbers.items()}
    data: dict[str, Any] = {
        "format": 1,
        "name": name,
        "description": sheet.description
        or f"Strain wave gear {catalogued.name}{f' with {sheet.motor}' if sheet.motor else ''}. Numbers whose source is a rule "
        "are typical of the size and not from a datasheet; the others are as their sources say.",
        "model": f"{path.stem}.xml",
        "mounting": "link",
        "shared_tolerances": {
            "stiffness": 0.1 if "K1" in sheet.numbers else 0.15 if catalogued.exact else 0.2,
            "friction": scatter if "Fs" in fitted.numbers else _friction_tolerance(sheet),
        },
        "numbers": numbers,
        "kinematic_error": rules.kinematic_error(),
        "link_tolerances": {
            "inertia": _row(1, "1", 0.15, "rule: as well as people know the inertia of a load"),
            "gravity_moment": _row(1, "1", 0.05, "rule: as well as people know the weight of a load"),
        },
        "mountings": _mountings(sheet, catalogued, values),
        "sensors": _sensors(sheet, values),
        "effects": fitted.effects,
    }
    joint = as_joint(data, path)
    if sheet.gear is not None and sheet.gear.hysteresis_loss is not None:
        effect = hysteresis(sheet.gear, joint.record(), values["rated_torque"])
        joint = as_joint(data | {"effects": [*fitted.effects, *effect]}, path)
    kp, kd = (float(f"{gain:.3g}") for gain in drive_gains(joint))
    joint = joint.model_copy(update={"controller": Controller(kp=kp, kd=kd)})
    return NewJoint(joint, tuple(_filled(data, sheet)), catalogued, path)


_SHARED = {"K1": "stiffness", "K2": "stiffness", "K3": "stiffness", "Fc": "friction", "Fs": "friction"}
_OF_MOTOR = ("Kt", "R", "L", "Jm", "current_limit", "supply_voltage", "bm")
_SHEET = {"N": 0.0, "R": 0.0, "L": 0.0, "supply_voltage": 0.0, "current_limit": 0.0, "T1": 0.0, "T2": 0.0,
          "rated_torque": 0.0, "Kt": 0.05, "Jm": 0.05, "K1": 0.02, "K2": 0.02, "K3": 0.02, "Fc": 0.0, "Fs": 0.1}  # fmt: skip
"""Relative standard deviation of a number in a datasheet; 0.1 for others."""


def _friction_tolerance(sheet: Datasheet) -> float:
    """Relative standard deviation that Fc and Fs have in common; all of Fc's where Fs is filled from it."""
    if "Fc" not in sheet.numbers:
        return _FACTOR_2
    return 0.2 if "Fs" in sheet.numbers else sheet.tolerances.get("Fc", 0.2)


def _given(symbol: str, sheet: Datasheet, catalogued: Gear) -> tuple[float, str]:
    what = catalogued.name if symbol not in _OF_MOTOR else sheet.motor or "motor"
    source = sheet.sources.get(symbol, f"datasheet of {what}")
    if symbol == "Fc" and "Fs" not in sheet.numbers:  # in `_friction_tolerance`
        return 0.0, source
    return sheet.tolerances.get(symbol, _SHEET.get(symbol, 0.1)), source


def write_joint(joint: Joint, path: Path) -> tuple[Path, Path]:
    """Write a description with a line per number, and its MJCF (`joint.model`) next to it; return both paths. Raises
    `InputError`: they cannot be written."""
    mjcf = path.parent / joint.model
    for target, text in ((mjcf, mjcf_text(joint)), (path, _text(joint))):
        write_text(target, text)
    return path, mjcf


_SECTIONS = {
    "numbers": "source: where it is from; a rule is what `flexspline joint new` filled, typical of the size.\n"
    "# tolerance: relative, deviation: absolute standard deviation that datasheet and calibration leave open.",
    "mountings": "inertia in kg·m² about the joint axis, gravity_moment in N·m at horizontal",
    "controller": "as fast as the test joint's: gains in proportion to (Jm + Jw)/Kt; kp in A/rad, kd in A·s/rad, motor side",
    "sensors": "noise rms in the sensor's unit, delay in s, rate in Hz",
}


def _text(joint: Joint) -> str:
    text = yaml_text(joint.model_dump(mode="json", exclude_none=True, exclude_defaults=True), rows=True)
    for key, comment in _SECTIONS.items():
        text = re.sub(rf"^{key}:", f"# {comment}\n{key}:", text, flags=re.MULTILINE)
    return text


_MJCF_COMMENT = """ {name}: one robot joint with a harmonic drive; rotor, wave generator, flange and link on one axis.

       Opens in any MuJoCo viewer. Alone, the two torsion tendons are linear springs (K1, Kw0). The testbed sets every
       number from the joint's YAML and replaces the linear springs by what MJCF cannot say: the stiffening flexspline
       Eq. (7), the wave generator's logarithmic law Eqs. (3)-(5), and the kinematic error. Angle zero: the link points
       straight down. SI units; rotor and wave generator turn on the motor side, {N:g} times the output. """


def mjcf_text(joint: Joint) -> str:
    """Return the MJCF of a description with its default mounting, as text.

    Inertias, springs and dampings (K1, df, Kw0, dw, bm, bl), motor and mesh friction are the description's; shapes
    and colours the test joint's.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(shipped("test_joint.xml").read_text(encoding="utf-8"), parser=parser)
    p = joint.bare_record()[0]
    n = {symbol: f"{number.value:.8g}" for symbol, number in joint.numbers.items()}
    root.set("model", joint.name)
    comment = next(child for child in root if child.tag is ElementTree.Comment)
    comment.text = _MJCF_COMMENT.format(name=joint.name, N=p["N"])

    def put(path: str, **attributes: str) -> None:
        element = root.find(path)
        assert element is not None, path
        for name, value in attributes.items():
            element.set(name, value)

    for path, attribute, symbols in STATED:
        put(path, **{attribute: " ".join(n.get(symbol, symbol) for symbol in symbols)})
    put(".//body[@name='link']/inertial", **_inertial(float(p["Jl"]), float(p["Mg"])))
    put(".//tendon/fixed[@name='flexspline']/joint[@joint='wave_generator']", coef=f"{1 / p['N']:.12g}")
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _inertial(inertia: float, moment: float) -> dict[str, str]:
    """Return mass, place and shape of a link by its inertia about the axis [kg·m²] and gravity moment [N·m]."""
    mass, lever = link_mass(inertia, moment)
    own = inertia - mass * lever**2
    return {
        "mass": f"{mass:.8g}",
        "pos": f"0 0 {-lever:.8g}",
        "diaginertia": f"{own:.8g} {own:.8g} {min(own, 0.01):.8g}",
    }


class _Rules:
    """The rules of scale by symbol: value, relative tolerance, the rule in words."""

    def __init__(self, catalogued: Gear, given: Mapping[str, float]):
        self.gear = catalogued
        self.known = dict(given)
        self.rules = _RULES | {"Fs": _FS_FROM_FC} if "Fc" in given else _RULES
        self.where = f"Harmonic Drive's catalogue, {catalogued.like}-{catalogued.size:g}-{catalogued.ratio:g}"
        if not catalogued.exact:
            self.where += ", interpolated"

    def of(self, symbol: str) -> tuple[float, float, str]:
        function, tolerance, rule = self.rules[symbol]
        value = self.known[symbol] = float(f"{function(self.gear, self):.3g}")
        rule = rule.replace("CATALOGUE", self.where).replace("PEAK", f"{self.gear.peak_torque:.3g}")
        return value, tolerance, rule

    def __getitem__(self, symbol: str) -> float:
        return self.known[symbol] if symbol in self.known else self.of(symbol)[0]

    def kinematic_error(self) -> list[dict[str, Any]]:
        """Return orders 2 and 4: a share of the catalogue's transmission accuracy, of unknown phase."""
        amplitude = float(f"{0.28 * self.gear.accuracy:.2g}")
        orders = []
        for order, share, words in ((2, 1.0, "0.28 of"), (4, 1 / 6, "0.28/6 of")):
            rule = f"{_RULE}{words} the transmission accuracy, {math.degrees(self.gear.accuracy) * 60:.2g}′"
            orders.append(
                {
                    "order": order,
                    "amplitude": _row(float(f"{amplitude * share:.2g}"), "rad", _TYPICAL, rule),
                    "phase": {"value": 0, "unit": "rad", "deviation": 1.8, "source": f"{_RULE}not known: a whole turn"},
                }
            )
        return orders


_Rule = tuple[Callable[[Gear, _Rules], float], float, str]
_RULES: dict[str, _Rule] = {
    "Jw": (lambda g, v: g.inertia, _FACTOR_2, "CATALOGUE, its wave generator's inertia"),
    "bm": (lambda g, v: 0.03 * v["bw"], _FACTOR_2, "3 % of bw: the mesh holds nearly all viscous friction"),
    "supply_voltage": (lambda g, v: 48.0, 0.0, "48 V, usual for robot joints"),
    "current_limit": (
        lambda g, v: (g.peak_torque / v["N"] + v["Fs"]) / v["Kt"], 0.0, "the gear's limit for repeated peaks, PEAK N·m",
    ),
    "K1": (lambda g, v: g.stiffness[0], 0.05, "CATALOGUE"),
    "K2": (lambda g, v: g.stiffness[1], 0.05, "CATALOGUE"),
    "K3": (lambda g, v: g.stiffness[2], 0.05, "CATALOGUE"),
    "T1": (lambda g, v: g.breakpoints[0], 0.0, "CATALOGUE"),
    "T2": (lambda g, v: g.breakpoints[1], 0.0, "CATALOGUE"),
    "rated_torque": (lambda g, v: g.rated_torque, 0.0, "CATALOGUE, at 2000 rpm"),
    "df": (lambda g, v: 0.48e-3 * v["K1"], _TYPICAL, "K1 · 0.48 ms, the test joint's proportion"),
    "Kw0": (
        lambda g, v: 20 * v["K1"] / v["N"] ** 2, _TYPICAL, "20 K1/N²: the catalogue's K1 to K3 are of the whole gear",
    ),
    "Cw": (lambda g, v: 0.03 * v["N"] / v["rated_torque"], _TYPICAL, "3 % stiffer at rated torque"),
    "dw": (
        lambda g, v: 0.8 * math.sqrt(v["Kw0"] * v["Jm"] * v["Jw"] / (v["Jm"] + v["Jw"])), _TYPICAL,
        "damping ratio 0.4 of rotor against wave generator",
    ),
    "Fs": (lambda g, v: g.starting_torque, 0.1, "CATALOGUE, starting torque of the component set, without seals"),
    "Fc": (lambda g, v: 0.8 * v["Fs"], 0.0, "0.8 Fs, the test joint's proportion"),
    "vs": (lambda g, v: 2.0, _TYPICAL, "the test joint's"),
    "s0": (lambda g, v: v["Fc"] / 1.8e-3, _TYPICAL, "Fc / 1.8 mrad, the test joint's presliding"),
    "s1": (lambda g, v: 1e-3 * v["s0"], _TYPICAL, "s0 · 1 ms, the test joint's proportion"),
    "bw": (lambda g, v: v["Fc"] / 200, _FACTOR_3, "as much as Fc at 200 rad/s: 115 to 400 on measured joints"),
    "bl": (lambda g, v: 0.02 * (g.size / 17) ** 3, _FACTOR_2, "output bearing: the test joint's, by the cube of the size"),
}  # fmt: skip
"""Value, relative tolerance and rule by symbol, from the gear and the numbers known so far."""
_FS_FROM_FC: _Rule = (lambda g, v: v["Fc"] / 0.8, 0.1, "Fc / 0.8, the test joint's proportion")
"""The rule of Fs where Fc is given: the catalogue's starting torque need not be of this gear."""


def _mountings(sheet: Datasheet, catalogued: Gear, value: Mapping[str, float]) -> dict[str, Any]:
    scale = catalogued.size / 17
    moment = sheet.gravity_moment
    if moment is None:
        motor = value["N"] * (value["Kt"] * value["current_limit"] - value["Fs"])
        moment = max(min(0.5 * value["rated_torque"], 0.4 * motor), 0.0)
    bare = 0.004 * scale**5
    inertia = (moment / GRAVITY * 0.38 * scale or bare) if sheet.inertia is None else sheet.inertia
    return {
        "no_load": {"inertia": float(f"{bare:.3g}"), "gravity_moment": 0},
        "link": {"inertia": float(f"{inertia:.4g}"), "gravity_moment": float(f"{moment:.4g}")},
    }


def _sensors(sheet: Datasheet, value: Mapping[str, float]) -> dict[str, Any]:
    link = dict(sheet.link_encoder)
    step = 2 * math.pi / (2 ** link["bits"] if "bits" in link else link["counts"])
    current, torque = (
        float(f"{share * value[of]:.2g}") for share, of in ((3e-3, "current_limit"), (2e-3, "rated_torque"))
    )
    offset = float(f"{3e-3 * value['rated_torque']:.2g}")

    def zero(unit: str, deviation: float, rule: str) -> dict[str, Any]:
        return {"value": 0, "unit": unit, "deviation": deviation, "source": f"{_RULE}{rule}"}

    counts = {"noise": float(f"{0.25 * step:.2g}"), "zero": zero("rad", 1e-3, "1 mrad, mounting of the encoders")}
    return {
        "motor_encoder": dict(sheet.motor_encoder),
        "link_encoder": link | counts,
        "motor_current": {"noise": current, "offset": zero("A", current, "0.3 % of the current limit")},
        "joint_torque": {
            "noise": torque,
            "gain": _row(1, "1", 0.01, f"{_RULE}1 %"),
            "offset": zero("N·m", offset, "0.3 % of the rated torque"),
        },
        "wrench": {"force_noise": 0.1, "torque_noise": torque},
    }


def _row(value: float, unit: str, tolerance: float, source: str) -> dict[str, Any]:
    row: dict[str, Any] = {"value": float(f"{value:.12g}"), "unit": unit}
    if tolerance:
        row["tolerance"] = tolerance
    return row | {"source": source}


def _filled(data: Mapping[str, Any], sheet: Datasheet) -> list[Filled]:
    found = []
    rows = dict(data["numbers"])
    for order in data["kinematic_error"]:
        rows |= {f"A{order['order']}": order["amplitude"], f"φ{order['order']}": order["phase"]}
    for name, row in rows.items():
        if row["source"].startswith(_RULE):
            shared = data["shared_tolerances"].get(row.get("shared", ""), 0.0)
            tolerance = math.hypot(row.get("tolerance", 0.0), shared)
            found.append(Filled(name, row["value"], row["unit"], tolerance, row["source"].removeprefix(_RULE)))
    bare, link = (data["mountings"][name] for name in ("no_load", "link"))
    found.append(
        Filled("inertia of no_load", bare["inertia"], "kg·m²", 0.15, "a bare flange, with the fifth power of the size")
    )
    if sheet.gravity_moment is None:
        rule = "half the rated torque, or what the motor holds at 40 % of its current"
        found.append(Filled("gravity of link", link["gravity_moment"], "N·m", 0.05, rule))
    if sheet.inertia is None:
        rule = "its mass on a lever that grows with the size, 0.38 m of size 17"
        found.append(Filled("inertia of link", link["inertia"], "kg·m²", 0.15, rule))
    return found
