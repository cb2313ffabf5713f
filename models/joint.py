"""Joint descriptions: YAML files with the numbers of a joint, each with unit, source and tolerance."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from . import causes, units
from .controller import Controller
from .errors import InputError, InputWarning, nearest
from .files import Strict, find, load, parse, place, write_into_place, write_text, yaml_text
from .joint_parts import (
    UNREAD,
    Discrepancy,
    Effect,
    Fault,
    Mounting,
    Number,
    Order,
    Sensors,
    Uncertainty,
    ValidRange,
    contradictions,
    number_faults,
    shared_fault,
)  # fmt: skip
from .mjcf import mjcf_files, stated_numbers
from .notebook import html_table, paragraph
from .parameters import N_DISCREPANCIES, N_ORDERS, PARAMETERS, as_floats, neutral


@dataclass(frozen=True)
class Slot:
    """A number of the record, `record[field]` or `record[field][index]`, by its name in a diagnosis; with its place in the
    file and its unit there, if it is not one of `numbers`."""

    name: str
    field: str
    number: Number
    where: str = ""
    unit: str = ""
    index: int = -1

    def line(self, mounting: Mounting) -> tuple[float, float]:
        """Return factor and summand of the number in a record, in a mounting."""
        if self.field == "Jl":
            return mounting.inertia, 0.0
        if self.field == "Mg":
            return mounting.gravity_moment, 0.0
        return 1.0, mounting.gravity_angle if self.field == "gravity_angle" else 0.0

    @property
    def period(self) -> float:
        """Of an angle with the period of a turn [rad], 0 for others."""
        return 2 * np.pi if self.field in ("phase", "gravity_angle") else 0.0

    @property
    def place(self) -> int:
        """Its index in the record's floats."""
        fields = PARAMETERS.fields
        assert fields is not None
        return fields[self.field][1] // np.dtype(np.float64).itemsize + max(self.index, 0)

    def put(self, record: np.ndarray, value: float, mounting: Mounting) -> None:
        """Write a value of the number into a record, shape (1,), in a mounting."""
        factor, summand = self.line(mounting)
        as_floats(record)[self.place] = factor * value + summand


class Joint(Strict):
    """A joint: its numbers, sensors, mountings, and the effects found in it."""

    format: Literal[1]
    name: str
    """In commands and reports."""
    description: str
    """A sentence about the joint."""
    model: str
    """MJCF file, next to the joint file or shipped with the package."""
    mounting: str
    """Default mounting."""
    numbers: dict[str, Number]
    """By symbol; `flexspline joint new` writes all of them."""
    shared_tolerances: dict[str, Annotated[float, Field(ge=0, lt=10)]] = {}
    """Relative standard deviations that several numbers have in common, by name."""
    kinematic_error: Annotated[list[Order], Field(max_length=N_ORDERS)]
    """Orders of the gear's kinematic error."""
    link_tolerances: dict[Literal["inertia", "gravity_moment", "arm"], Number] = {}
    """Relative uncertainty of every mounting's inertia and gravity moment, and of the torque that an arm's other links put on
    the joint: a scale of 1 with a tolerance."""
    gravity_angle: Number | None = None
    """Angle [rad] of the link from straight down at θl = 0, for every mounting; 0 by default."""
    mountings: dict[str, Mounting]
    """Loads on the output, by name."""
    sensors: Sensors
    """Their properties."""
    controller: Controller | None = None
    """Position controller with stable gains for this joint; a scenario's own gains take precedence."""
    effects: Annotated[list[Effect], Field(max_length=32)] = []
    """Applied in their order: a factor multiplies the result of the effects before it."""
    discrepancies: Annotated[list[Discrepancy], Field(max_length=N_DISCREPANCIES)] = []
    """Discrepancies from the laws, found by a diagnosis."""
    valid: ValidRange | None = None
    """Range of the data of the diagnosis that wrote this description."""
    uncertainty: Uncertainty | None = None
    """Uncertainty of the diagnosis that wrote this description."""
    _path: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _physical(self, info: ValidationInfo) -> Joint:
        """Refuse what fields alone do not show. If the caller gives a list for faults, append all of them instead."""
        found = (info.context or {}).get("faults")
        for fault in self._faults():
            if found is None:
                raise ValueError(fault)
            found.append(fault)
        return self

    def _faults(self) -> Iterator[str]:
        plain = True
        for fault in number_faults(self.numbers, self.shared_tolerances):
            plain = False
            yield fault
        for one in self.placed():
            if not units.same(one.number.unit, one.unit):
                yield f"{one.where}.unit: expected {one.unit!r}, got {one.number.unit!r}"
            if (unknown := shared_fault(one.where, one.number, self.shared_tolerances)) is not None:
                yield unknown
        for key, number in self.link_tolerances.items():
            if number.value <= 0:
                yield f"link_tolerances.{key}.value: expected a scale > 0, got {number.value:g}"
        gain = self.sensors.joint_torque.gain
        if gain is not None and gain.value == 0:  # below zero, the sensor is reversed
            yield "sensors.joint_torque.gain.value: expected a factor other than 0, got 0"
        for i, effect in enumerate(self.effects):
            if not causes.get(effect.name).adds and effect.name in [e.name for e in self.effects[:i]]:
                yield f"effects.{i}: {effect.name} is there twice; the second would replace the first"
        yield from self._unread()
        yield from self._unknown()
        if self.mounting not in self.mountings:
            yield self._no_mounting(self.mounting)
        elif plain:
            try:
                record = self.record()  # raises if there are too many orders
            except InputError as error:
                yield str(error)
            else:
                if not np.isfinite(as_floats(record)).all():
                    yield "effects: expected effects that leave the joint's numbers finite, got some that do not"

    def _unread(self) -> Iterator[str]:
        """Yield fields of sensors that have no meaning in a joint's description."""
        for (sensor, field), instead in UNREAD.items():
            if getattr(getattr(self.sensors, sensor), field) is not None:
                yield f"sensors.{sensor}.{field}: expected none, got one: {instead}"
        motor, link = self.sensors.motor_encoder.delay, self.sensors.link_encoder.delay
        if motor > link:
            yield (
                f"sensors.motor_encoder.delay: expected at most the link encoder's, {link:g} s, as a torsion is made of both "
                f"readings once the later one is there, got {motor:g}"
            )

    def _unknown(self) -> Iterator[str]:
        """Yield names in `uncertainty` that the joint does not have: a user may have removed an effect."""
        if self.uncertainty is None:
            return
        known = [*self.numbers, *(one.name for one in self.placed())]
        known += [f"effects.{i}.{name}" for i, effect in enumerate(self.effects) for name in effect.parameters]
        known += [
            f"discrepancies.{i}.{k}" for i, one in enumerate(self.discrepancies) for k in range(len(one.coefficients))
        ]
        for i, name in enumerate(self.uncertainty.names):
            if name not in known:
                expected = (
                    "a number of the joint (Kt, A2, link_encoder_zero), a parameter of an effect (effects.0.ratio) or a "
                    "coefficient of a discrepancy (discrepancies.0.3)"
                )
                yield f"uncertainty.names.{i}: expected {expected}, got {name!r}{nearest(name, known)}"

    def placed(self) -> Iterator[Slot]:
        """Yield the numbers outside `numbers` that calibration changes."""
        for i, order in enumerate(self.kinematic_error):
            # An order of unknown phase is there twice, a quarter of a period apart.
            name = f"{order.order:g}" + "′" * sum(other.order == order.order for other in self.kinematic_error[:i])
            yield Slot(f"A{name}", "amplitude", order.amplitude, f"kinematic_error.{i}.amplitude", "rad", i)
            yield Slot(f"φ{name}", "phase", order.phase, f"kinematic_error.{i}.phase", "rad", i)
        link, s = self.link_tolerances, self.sensors
        for name, field, number, where, unit in (
            ("Jl", "Jl", link.get("inertia"), "link_tolerances.inertia", "1"),
            ("Mg", "Mg", link.get("gravity_moment"), "link_tolerances.gravity_moment", "1"),
            ("arm_load", "arm_scale", link.get("arm"), "link_tolerances.arm", "1"),
            ("gravity_angle", "gravity_angle", self.gravity_angle, "gravity_angle", "rad"),
            ("link_encoder_zero", "link_zero", s.link_encoder.zero, "sensors.link_encoder.zero", "rad"),
            ("current_offset", "current_offset", s.motor_current.offset, "sensors.motor_current.offset", "A"),
            ("torque_sensor_gain", "torque_gain", s.joint_torque.gain, "sensors.joint_torque.gain", "1"),
            ("torque_sensor_offset", "torque_offset", s.joint_torque.offset, "sensors.joint_torque.offset", "N·m"),
        ):
            if number is not None:
                yield Slot(name, field, number, where, unit)

    @field_validator("model")
    @classmethod
    def _inside(cls, model: str) -> str:
        path = PurePosixPath(model.replace("\\", "/"))
        if path.is_absolute() or ".." in path.parts or ":" in model or path.suffix != ".xml":
            raise ValueError(f"expected an MJCF file (.xml) in the joint file's folder, got {model!r}")
        return model

    @property
    def path(self) -> Path:
        """File that it was read from; an empty path if there is none."""
        return self._path

    @property
    def mjcf(self) -> Path:
        """Path of the MJCF file: in the folder of the joint's file, or else shipped.

        Raises:
          InputError: a link that leads out of the folder.
        """
        folder = self._path.parent
        beside = folder / self.model
        if not beside.is_file():
            return shipped(self.model)
        if not beside.resolve().is_relative_to(folder.resolve()):
            raise InputError(
                f"{self._path}: model: expected an MJCF file in the joint file's folder, got {self.model!r}"
            )
        return beside

    def mount(self, name: str | None = None) -> Mounting:
        """Return a mounting by name; `InputError` names the known ones."""
        wanted = self.mounting if name is None else name
        if wanted not in self.mountings:
            raise InputError(f"joint {self.name}: {self._no_mounting(wanted)}")
        return self.mountings[wanted]

    def _no_mounting(self, name: str) -> str:
        known = sorted(self.mountings)
        return f"mounting: expected one of {known}, got {name!r}{nearest(name, self.mountings)}"

    def record(self, mounting: Mounting | None = None) -> np.ndarray:
        """Return the parameter record of the joint in a mounting, shape (1,)."""
        record = self.bare_record(mounting)
        self.apply_effects(record)
        return record

    def bare_record(self, mounting: Mounting | None = None) -> np.ndarray:
        """Return the record without effects and discrepancies, shape (1,)."""
        mounting = self.mount() if mounting is None else mounting
        record = neutral()
        p = record[0]
        for symbol, number in self.numbers.items():
            if symbol in (PARAMETERS.names or ()):
                p[symbol] = number.value
        # The drive keeps the datasheet constant when calibration changes the motor's.
        Kt = self.numbers["Kt"]
        p["Kt_drive"] = Kt.value if Kt.nominal is None else Kt.nominal
        for i, order in enumerate(self.kinematic_error):
            p["order"][i] = order.order
        p["Jl"], p["Mg"], p["gravity_angle"] = mounting.inertia, mounting.gravity_moment, mounting.gravity_angle
        p["link_delay"] = self.sensors.link_encoder.delay - self.sensors.motor_encoder.delay
        for one in self.placed():
            one.put(record, one.number.value, mounting)
        return record

    def apply_effects(self, record: np.ndarray) -> None:
        """Apply the joint's effects and discrepancies to a record, in place."""
        p = record[0]
        for effect in self.effects:
            causes.get(effect.name).apply(p, effect.values)
        for one in self.discrepancies:
            causes.put_discrepancy(p, one.place, one.variable, one.low, one.high, one.coefficients)

    def _repr_html_(self) -> str:
        rows = [
            (symbol, n.value, n.unit, f"± {100 * n.tolerance:.3g} %" if n.tolerance else "", n.source)
            for symbol, n in self.numbers.items()
        ]
        effects = [
            (e.name.replace("_", " "), f"{name} = {p.value:.4g} {p.unit}".strip())
            for e in self.effects
            for name, p in e.parameters.items()
        ]
        return (
            paragraph(self.name, " ".join(self.description.split()))
            + html_table(("effect", "parameter"), effects)
            + html_table(("number", "value", "unit", "tolerance", "source"), rows)
        )

    def write(self, path: str | Path) -> None:
        """Write the description as YAML for `load_joint`, with its MJCF unless that is shipped.

        Raises:
          InputError: it cannot be written, or another MJCF of that name exists.
        """
        path = Path(path)
        self._copy_mjcf(path.parent)
        data = self.model_dump(exclude_none=True, exclude_defaults=False, mode="json")
        write_text(path, yaml_text(data, rows=True))

    def _copy_mjcf(self, folder: Path) -> None:
        mjcf = self.mjcf
        if mjcf.parent.resolve() == shipped().resolve() or not mjcf.is_file():
            return
        for file in mjcf_files(mjcf):
            target = folder / file.resolve().relative_to(mjcf.parent.resolve())
            content = file.read_bytes()
            if target.is_file() and target.read_bytes() == content:
                continue
            if target.exists():
                raise InputError(f"{target}: expected the file that joint {self.name} names, got another of that name")
            with write_into_place(target) as temporary:
                temporary.write_bytes(content)


def shipped(name: str = "") -> Path:
    """Return the path of a file shipped in `models/`."""
    return Path(str(resources.files(__package__).joinpath(name)))


def known_joints() -> dict[str, Path]:
    """Return the paths of the shipped joints by name (with dashes)."""
    return {path.stem.replace("_", "-"): path for path in sorted(shipped().glob("*.yaml"))}


def load_joint(source: str | Path, beside: Path | None = None) -> Joint:
    """Load a joint by the name of a shipped one, or from a YAML file.

    Args:
      source: a shipped joint's name (`test-joint`) or a path.
      beside: folder to which the path is relative.

    Returns:
      The joint.

    Raises:
      InputError: no such joint, or a wrong description; one line.

    Warns:
      InputWarning: numbers that contradict each other or the MJCF (`faults`), a line each.
    """
    known = known_joints()
    name = str(source).replace("_", "-")
    path = find(name if name in known else source, known, "joint", beside or Path())
    joint = load(path, Joint, "a joint description")
    joint._path = path.resolve()
    if not joint.mjcf.is_file():
        raise InputError(f"{path}: model: expected an MJCF file, no such file {joint.model!r}")
    if name not in known:
        value = {symbol: number.value for symbol, number in joint.numbers.items()}
        fitted = {symbol for symbol, number in joint.numbers.items() if number.nominal is not None}
        wrong = [problem for problem in contradictions(value, fitted) if problem.severity == "error"]
        for problem in (*wrong, *unlike_mjcf(joint)):
            at = place(path, problem.field)
            warnings.warn(f"{at}: {problem.field}: {problem.message}", InputWarning, stacklevel=2)
    return joint


def unlike_mjcf(joint: Joint) -> Iterator[Fault]:
    """Yield a fault if numbers of a joint's MJCF differ from its description by more than any tolerance. The
    description counts."""
    other = []
    # A shipped MJCF is for looks.
    stated = {} if joint.mjcf.parent == shipped() else stated_numbers(joint.mjcf)
    for symbol, got in stated.items():
        if symbol not in joint.numbers:  # missing: reported elsewhere
            continue
        n = joint.numbers[symbol]
        shared = joint.shared_tolerances.get(n.shared or "", 0.0)
        left_open = math.hypot(n.tolerance * n.value, n.deviation, shared * n.value)
        near = max(4 * left_open, 1e-3 * abs(n.value))
        if min(abs(got - known) for known in (n.value, n.nominal) if known is not None) > near:
            other.append(f"{symbol} = {got:.6g} for {n.value:.6g} {n.unit}")
    if other:
        yield Fault("warning", "model", f"{', '.join(other)} in the MJCF; the description's numbers count")


def as_joint(data: dict[str, Any], path: Path) -> Joint:
    """Build a joint from plain data as if it were in the file at `path`."""
    joint = parse(data, Joint, str(path))
    joint._path = path.resolve()
    return joint
