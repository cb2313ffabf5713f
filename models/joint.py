"""Joint descriptions: YAML files with the numbers of a joint, each with unit, source and tolerance."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from . import causes, units
from .errors import InputError, InputWarning, is_there, nearest, unknown_key
from .faults import contradictions, unlike_mjcf
from .files import Line, Strict, load, parse, place, write_into_place, yaml_text
from .mjcf import mjcf_files, stated_numbers
from .notebook import html_table, paragraph
from .parameters import N_COEFFICIENTS, N_DISCREPANCIES, N_ORDERS, PARAMETERS, PLACES, VARIABLES, as_floats, neutral
from .signals import CHANNELS, Channel

# Symbol: unit, may it be zero? All are non-negative.
SYMBOLS: dict[str, tuple[str, bool]] = {
    "N": ("1", False), "Jm": ("kg·m²", False), "Jw": ("kg·m²", False), "Kt": ("N·m/A", False),
    "bm": ("N·m·s/rad", True), "R": ("ohm", False), "L": ("H", True),
    "supply_voltage": ("V", False), "current_limit": ("A", False),
    "K1": ("N·m/rad", False), "K2": ("N·m/rad", False), "K3": ("N·m/rad", False),
    "T1": ("N·m", False), "T2": ("N·m", False), "df": ("N·m·s/rad", True),
    "Kw0": ("N·m/rad", False), "Cw": ("1/(N·m)", False), "dw": ("N·m·s/rad", True),
    "Fc": ("N·m", False), "Fs": ("N·m", False), "vs": ("rad/s", False),
    "s0": ("N·m/rad", False), "s1": ("N·m·s/rad", True), "bw": ("N·m·s/rad", True),
    "bl": ("N·m·s/rad", True),
    "rated_torque": ("N·m", False),
}  # fmt: skip

OPTIONAL_SYMBOLS: dict[str, tuple[str, bool]] = {
    "back_driven_friction": ("1", True), "knee_width": ("rad", True), "viscous_exponent": ("1", False),
    "reference_temperature": ("°C", True),
}  # fmt: skip
"""Optional numbers. `back_driven_friction`: share of the load-dependent friction that acts while the load drives the
motor (default 1). `knee_width`: half the torsion over which the stiffness changes from one slope to the next (0).
`viscous_exponent`: exponent of speed in viscous friction at high speed (1). `reference_temperature`: temperature
at which friction is stated (25 °C)."""


def may_be_zero(symbol: str) -> bool:
    """Return whether a number of a joint may be zero. None may be negative."""
    return (SYMBOLS | OPTIONAL_SYMBOLS)[symbol][1]


_UNREAD = {
    ("motor_encoder", "zero"): "angles count from its zero, and link_encoder.zero is the other's against it",
    ("motor_current", "gain"): "a torque that the current means at another scale is another Kt",
    ("motor_torque", "gain"): "what a drive believes of its motor is numbers.Kt_drive",
    ("motor_torque", "offset"): "it is the current's, motor_current.offset",
    ("temperature", "gain"): "nothing reads it",
    ("temperature", "offset"): "nothing reads it",
}
"""Fields of sensors that have no meaning, and the field to use instead."""
POSSIBLE: dict[str, tuple[float, float]] = {
    "N": (2, 1e4), "Jm": (1e-9, 0.3), "Jw": (1e-9, 0.3), "Kt": (1e-5, 1e2), "R": (1e-6, 1e4), "L": (1e-9, 10),
    "supply_voltage": (0.1, 1e4), "current_limit": (1e-3, 1e5), "K1": (1, 1e8), "K2": (1, 1e8), "K3": (1, 1e8),
    "T1": (1e-4, 1e5), "T2": (1e-4, 1e5), "Kw0": (1e-4, 1e7), "Fc": (1e-7, 1e2), "Fs": (1e-7, 1e2),
    "rated_torque": (1e-2, 1e6),
}  # fmt: skip
"""Smallest and largest possible value of numbers, in their units. Values outside are wrong units or keys and are
refused. `joint_check` has the usual ranges."""


class Number(Strict):
    """A number of the joint.

    `tolerance` is the relative, `deviation` the absolute standard deviation that datasheet and calibration leave
    open. A tolerance above 0.5 is log-normal: one standard deviation is a factor of 1 + tolerance. `shared` names a
    further deviation that several numbers have in common (`Joint.shared_tolerances`). `std` is the standard deviation
    that a diagnosis found, `nominal` the value before it.
    """

    value: float
    """In its unit."""
    unit: str
    """`N·m` and `Nm`, `kg·m²` and `kgm2` are the same."""
    source: str
    """Datasheet, measurement or rule that it is from."""
    tolerance: Annotated[float, Field(ge=0, lt=10)] = 0.0
    """Relative standard deviation that is left open. Above 0.5, one standard deviation is a factor of 1 + tolerance."""
    deviation: Annotated[float, Field(ge=0)] = 0.0
    """Absolute standard deviation that is left open, in the unit."""
    shared: str | None = None
    """Name of a further deviation that several numbers have in common."""
    std: Annotated[float, Field(ge=0)] | None = None
    """Standard deviation that a diagnosis found, in the unit."""
    nominal: float | None = None
    """Value before a diagnosis."""


class Order(Strict):
    """One order of the kinematic error: amplitude [rad, output side], phase [rad], both with tolerances."""

    order: Annotated[float, Field(gt=0)]
    """Periods per turn of the wave generator."""
    amplitude: Number
    """[rad, output side]."""
    phase: Number
    """[rad]."""


LOCKED = 1e6
"""Inertia [kg·m²] from which a mounting is the bench."""


class Placed(NamedTuple):
    """A number outside `numbers`: its name in a diagnosis, field and index in the record (−1: no array), place and
    unit in the file."""

    name: str
    field: str
    at: int
    number: Number
    where: str
    unit: str


class Mounting(Strict):
    """The load on the output: inertia about the joint axis and gravity moment at horizontal."""

    inertia: Annotated[float, Field(gt=0, description="kg·m²")]
    gravity_moment: Annotated[float, Field(ge=0, description="N·m")]
    gravity_angle: Annotated[float, Field(description="rad")] = 0.0
    """Angle of its centre of mass from the link's axis. The axis points straight down at θl + gravity angles = 0."""

    @property
    def locked(self) -> bool:
        """Whether the output is bolted to the bench, which the joint cannot move."""
        return self.inertia >= LOCKED


class EncoderSpec(Strict):
    """An encoder: `counts` per revolution or `bits`, noise [rad rms], delay [s], zero, sample rate [Hz].

    `cyclic_error`: amplitude [counts] of the error that repeats with every line of the disc (four counts).
    """

    counts: Annotated[int, Field(gt=1, le=2**40)] | None = None
    """Per revolution; alternative to `bits`."""
    bits: Annotated[int, Field(gt=1, lt=40)] | None = None
    """Per revolution; alternative to `counts`."""
    noise: Annotated[float, Field(ge=0)] = 0.0
    """[rad rms]."""
    delay: Annotated[float, Field(ge=0, lt=0.1)] = 0.0
    """[s]."""
    rate: Annotated[float, Field(gt=0, le=10000)] = 1000.0
    """Sample rate [Hz]."""
    zero: Number | None = None
    """Reading [rad] at angle zero."""
    cyclic_error: Annotated[float, Field(ge=0, lt=2)] = 0.0
    """Amplitude [counts] of the error that repeats with every line of the disc."""

    @model_validator(mode="after")
    def _one_resolution(self) -> EncoderSpec:
        if (self.counts is None) == (self.bits is None):
            raise ValueError("expected either counts (per revolution) or bits, got both or none")
        return self

    @property
    def resolution(self) -> float:
        """Angle of one count [rad]."""
        lines = self.counts if self.bits is None else 2**self.bits
        return 2 * np.pi / float(lines or np.nan)


class Ripple(Strict):
    """An error that repeats with the motor's angle: amplitude · sin(order · θm + phase), in the sensor's unit."""

    order: Annotated[float, Field(gt=0)]
    """Periods per turn of the motor."""
    amplitude: Annotated[float, Field(ge=0)]
    """In the sensor's unit."""
    phase: float = 0.0
    """[rad]."""


class Vibration(Strict):
    """A vibration of the structure that the sensor measures: amplitude (rms, in its unit), frequency [Hz]."""

    frequency: Annotated[float, Field(gt=0, lt=500)]
    """[Hz]."""
    amplitude: Annotated[float, Field(ge=0)]
    """Rms, in the sensor's unit."""


class AnalogSpec(Strict):
    """An analog sensor: noise (rms), quantisation step, delay [s], sample rate [Hz], gain, offset, and imperfections.

    `bandwidth` of a first-order low-pass [Hz], `flicker` (rms of 1/f noise), `ripple` over the motor's angle,
    `vibration`, `crosstalk` (amplitude over the cosine of the link's angle); all in the sensor's unit, none by
    default.
    """

    noise: Annotated[float, Field(ge=0)] = 0.0
    """Rms, in the sensor's unit."""
    step: Annotated[float, Field(ge=0)] = 0.0
    """Quantisation step, in its unit."""
    delay: Annotated[float, Field(ge=0, lt=0.1)] = 0.0
    """[s]."""
    rate: Annotated[float, Field(gt=0, le=10000)] = 1000.0
    """Sample rate [Hz]."""
    gain: Number | None = None
    """Factor on its reading."""
    offset: Number | None = None
    """Added to its reading, in its unit."""
    bandwidth: Annotated[float, Field(gt=0)] | None = None
    """Of a first-order low-pass [Hz]."""
    flicker: Annotated[float, Field(ge=0)] = 0.0
    """Rms of 1/f noise, in its unit."""
    ripple: Ripple | None = None
    """Error that repeats with the motor's angle."""
    vibration: Vibration | None = None
    """Of the structure."""
    crosstalk: float = 0.0
    """Amplitude over the cosine of the link's angle, in its unit."""


class WrenchSpec(Strict):
    """The six-axis force/torque sensor: noise per axis [N rms], [N·m rms], delay [s], sample rate [Hz].

    `crosstalk`: share of an axis' load, relative to its rated load [N], [N·m], that may appear in each other axis
    [1].
    """

    force_noise: Annotated[float, Field(ge=0)] = 0.0
    """Of each axis [N rms]."""
    torque_noise: Annotated[float, Field(ge=0)] = 0.0
    """Of each axis [N·m rms]."""
    delay: Annotated[float, Field(ge=0, lt=0.1)] = 0.0
    """[s]."""
    rate: Annotated[float, Field(gt=0, le=10000)] = 1000.0
    """Sample rate [Hz]."""
    crosstalk: Annotated[float, Field(ge=0, lt=0.2)] = 0.0
    """Share of an axis' load, relative to its rated load, that may appear in each other axis."""
    rated_force: Annotated[float, Field(gt=0)] = 300.0
    """[N]."""
    rated_torque: Annotated[float, Field(gt=0)] = 30.0
    """[N·m]."""


class Sensors(Strict):
    """The joint's sensors: the standard ones by name, and any other that a channel names (`signals.CHANNELS`)."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, AnalogSpec]

    motor_encoder: EncoderSpec
    """Angle of the motor."""
    link_encoder: EncoderSpec
    """Angle of the output."""
    motor_current: AnalogSpec
    """[A]."""
    motor_torque: AnalogSpec = AnalogSpec()
    """[N·m, motor side], if the drive reports it."""
    joint_torque: AnalogSpec = AnalogSpec()
    """[N·m]."""
    temperature: AnalogSpec = AnalogSpec()
    """Of the gear [°C]."""
    wrench: WrenchSpec = WrenchSpec()
    """The six-axis force/torque sensor at the output."""

    @model_validator(mode="after")
    def _known(self) -> Sensors:
        known = [*type(self).model_fields, *(c.sensor for c in CHANNELS.values() if c.sensor)]
        for name in self.__pydantic_extra__:
            if name not in known:
                raise ValueError(f"{name}: {unknown_key(name, known)}")
        return self

    def of(self, channel: Channel) -> EncoderSpec | AnalogSpec | WrenchSpec:
        """Return the sensor of a channel; one without noise if the description has none."""
        spec = getattr(self, channel.sensor, None)
        return AnalogSpec() if spec is None else spec


class Estimate(Strict):
    """A parameter of an effect: value, unit (by default that of the cause), standard deviation if a diagnosis found
    one."""

    value: float
    """In its unit."""
    unit: str = ""
    """By default that of the cause."""
    std: Annotated[float, Field(ge=0)] | None = None
    """Standard deviation that a diagnosis found."""


_ROUNDING = 1e-9  # of a bound: what writing a number and reading it again may cost


class Effect(Strict):
    """An effect beyond the nominal equations, by the name of a known cause (`models.causes`)."""

    name: str
    """Of a known cause (`flexspline causes`)."""
    parameters: dict[str, Estimate]
    """The cause's parameters by name."""

    @model_validator(mode="after")
    def _known(self) -> Effect:
        known = causes.names()
        if self.name not in known:
            raise ValueError(
                f"expected the name of a known cause (a plugin's with --plugin), got {self.name!r}{nearest(self.name, known)}"
            )
        expected = {p.name: p for p in causes.get(self.name).parameters}
        for name in self.parameters:
            if name not in expected:
                raise ValueError(f"parameters.{name}: {unknown_key(name, expected)}")
        for name, parameter in expected.items():
            if name not in self.parameters:
                raise ValueError(f"parameters.{name}: missing")
            given, (low, high) = self.parameters[name], parameter.bounds
            if given.unit and not units.same(given.unit, parameter.unit):
                raise ValueError(f"parameters.{name}.unit: expected {parameter.unit!r}, got {given.unit!r}")
            slack = _ROUNDING * max(abs(low), abs(high))
            if not low - slack <= given.value <= high + slack:
                raise ValueError(f"parameters.{name}.value: expected {low:g} to {high:g}, got {given.value:g}")
        return self

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name."""
        return {name: estimate.value for name, estimate in self.parameters.items()}


class Discrepancy(Strict):
    """A nonparametric model discrepancy at `place`: a cubic B-spline of `variable`, with coefficients on a uniform
    grid."""

    place: Literal[PLACES[1:]]  # type: ignore[valid-type]
    """Where it acts, or the reading to which it is added."""
    variable: Literal[VARIABLES]  # type: ignore[valid-type]
    """Its variable."""
    low: float
    """Lower end of the spline's grid, in the variable's unit."""
    high: float
    """Upper end."""
    unit: str
    """Of the coefficients."""
    coefficients: Annotated[list[float], Field(min_length=4, max_length=N_COEFFICIENTS)]
    """Of a cubic B-spline on a uniform grid."""

    @model_validator(mode="after")
    def _ordered(self) -> Discrepancy:
        if not self.high > self.low:
            raise ValueError(f"expected high > low, got low={self.low}, high={self.high}")
        return self


class ValidRange(Strict):
    """The range of the data behind a diagnosed joint: smallest and largest value of each quantity.

    `loads`: the combinations of motion and load in the data, `driving` (the motor moves the load), `driven` (the load
    moves the motor).
    """

    link_position: Annotated[list[float], Field(min_length=2, max_length=2, description="rad")]
    link_velocity: Annotated[list[float], Field(min_length=2, max_length=2, description="rad/s")]
    joint_torque: Annotated[list[float], Field(min_length=2, max_length=2, description="N·m")]
    loads: list[Literal["driving", "driven"]] = []
    """Combinations of motion and load in the data."""

    @field_validator("link_position", "link_velocity", "joint_torque")
    @classmethod
    def _upward(cls, ends: list[float]) -> list[float]:
        low, high = ends
        if low > high:
            raise ValueError(f"expected low ≤ high, got {ends}")
        return ends

    def beyond(
        self, link_position: np.ndarray, link_velocity: np.ndarray, joint_torque: np.ndarray
    ) -> dict[str, float]:
        """Return the shares of samples, shape (n,) each, outside the range, by variable and by unseen combination of
        motion and load; empty if there are none. A margin of a twentieth of the range is allowed."""
        samples = max(len(link_position), 1)
        found: dict[str, float] = {}
        for name, x in (
            ("link_position", link_position), ("link_velocity", link_velocity), ("joint_torque", joint_torque),
        ):  # fmt: skip
            share = int(np.count_nonzero(self._past(name, x) > _SLACK)) / samples
            if share > 0:
                found[name] = share
        sign = np.sign(np.asarray(link_velocity) * joint_torque)
        for name, which in (("driving", 1.0), ("driven", -1.0)):
            share = int(np.count_nonzero(sign == which)) / samples
            if self.loads and name not in self.loads and share > _SLACK:
                found[name] = share
        return found

    def distance(self, link_position: np.ndarray, link_velocity: np.ndarray, joint_torque: np.ndarray) -> np.ndarray:
        """Return the largest distance of samples, shape (n,) each, from the range, in units of the range, shape (n,)."""
        past = [
            self._past("link_position", link_position), self._past("link_velocity", link_velocity),
            self._past("joint_torque", joint_torque),
        ]  # fmt: skip
        return np.max(past, axis=0)

    def outside(self, link_position: np.ndarray, link_velocity: np.ndarray, joint_torque: np.ndarray) -> np.ndarray:
        """Return which samples, shape (n,) each, are outside the range with its margin, shape (n,), bool."""
        return self.distance(link_position, link_velocity, joint_torque) > _SLACK

    def _past(self, name: str, x: np.ndarray) -> np.ndarray:
        low, high = getattr(self, name)
        return np.maximum(np.maximum(low - x, x - high), 0.0) / max(high - low, 1e-9)


_SLACK = 0.05
"""Share of a range that is allowed as a margin."""
_BEYOND = {
    "link_position": "link angle", "link_velocity": "link speed", "joint_torque": "load",
    "driving": "motion that the motor drives", "driven": "motion that the load drives",
}  # fmt: skip


def beyond_sentence(beyond: Mapping[str, float]) -> str:
    """Return a sentence about the motion outside a joint's range of validity (`ValidRange.beyond`); empty if there is
    none."""
    if not beyond:
        return ""
    parts = [f"{_BEYOND.get(name, name)} {100 * share:.2g} %" for name, share in beyond.items()]
    return (
        f"beyond the range of the data behind the joint's description (share of the samples in motion): {', '.join(parts)}; what "
        "is said there is extrapolated"
    )


class Uncertainty(Strict):
    """The joint uncertainty of a diagnosis.

    `factor` has the rows of a lower triangular L; L Lᵀ is the covariance of `names`, in their units. Names: numbers
    as in `models.calibration` (`Kt`, `A2`, `link_encoder_zero`), parameters of effects (`effects.0.ratio`),
    coefficients of discrepancies (`discrepancies.0.3`). Other numbers have their own `std` or tolerance.
    `discrepancy` is the rms, in the balance's unit, of the data that the description does not explain; `beyond`, its
    factor one whole range outside the range of validity.
    """

    names: list[str]
    """Of the quantities in the covariance."""
    factor: list[list[float]]
    """Rows of the covariance's lower triangular factor."""
    discrepancy: dict[Literal["motor_current", "joint_torque", "link_balance"], Annotated[float, Field(ge=0)]] = {}
    """Rms that the description does not explain, by balance."""
    beyond: Annotated[float, Field(ge=1)] = 1.0
    """Factor of `discrepancy` one whole range outside the range of validity."""

    @model_validator(mode="after")
    def _triangular(self) -> Uncertainty:
        for name, times in Counter(self.names).items():
            if times > 1:
                raise ValueError(
                    f"names: expected each once, got {name!r} {'twice' if times == 2 else f'{times} times'}"
                )
        if [len(row) for row in self.factor] != list(range(1, len(self.names) + 1)):
            raise ValueError(f"factor: expected the {len(self.names)} rows of a lower triangle, a row a name")
        return self

    @property
    def matrix(self) -> np.ndarray:
        """L, shape (n, n)."""
        found = np.zeros((len(self.names), len(self.names)))
        for i, row in enumerate(self.factor):
            found[i, : i + 1] = row
        return found


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
        if gain is not None and gain.value == 0:  # one below zero is a sensor that reads the other way round
            yield "sensors.joint_torque.gain.value: expected a factor other than 0, got 0"
        for i, effect in enumerate(self.effects):
            if not causes.get(effect.name).adds and effect.name in [e.name for e in self.effects[:i]]:
                yield f"effects.{i}: {effect.name} is there twice; the second would replace the first"
        yield from self._unread()
        yield from self._unknown()
        if self.mounting not in self.mountings:
            yield (
                f"mounting: expected one of {sorted(self.mountings)}, got {self.mounting!r}"
                f"{nearest(self.mounting, self.mountings)}"
            )
        elif plain:
            try:
                record = self.record()  # more orders than there is room for is said here
            except InputError as error:
                yield str(error)
            else:
                if not np.isfinite(as_floats(record)).all():
                    yield "effects: expected effects that leave the joint's numbers finite, got some that do not"

    def _unread(self) -> Iterator[str]:
        """Yield fields of sensors that have no meaning in a joint's description."""
        for (sensor, field), instead in _UNREAD.items():
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

    def placed(self) -> Iterator[Placed]:
        """Yield the numbers outside `numbers` that calibration changes."""
        for i, order in enumerate(self.kinematic_error):
            # An order whose phase nobody knows is there twice, a quarter of a period apart.
            name = f"{order.order:g}" + "′" * sum(other.order == order.order for other in self.kinematic_error[:i])
            yield Placed(f"A{name}", "amplitude", i, order.amplitude, f"kinematic_error.{i}.amplitude", "rad")
            yield Placed(f"φ{name}", "phase", i, order.phase, f"kinematic_error.{i}.phase", "rad")
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
                yield Placed(name, field, -1, number, where, unit)

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

    def stated_by_mjcf(self) -> dict[str, float]:
        """Return numbers of the description that its own MJCF also has, by symbol; none of a shipped one, which is
        for looks."""
        return {} if self.mjcf.parent == shipped() else stated_numbers(self.mjcf)

    def mount(self, name: str | None = None) -> Mounting:
        """Return a mounting by name; `InputError` names the known ones."""
        wanted = self.mounting if name is None else name
        if wanted not in self.mountings:
            raise InputError(
                f"joint {self.name}: mounting: expected one of {sorted(self.mountings)}, got {wanted!r}"
                f"{nearest(wanted, self.mountings)}"
            )
        return self.mountings[wanted]

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
            if symbol in PARAMETERS_NAMES:
                p[symbol] = number.value
        # What the drive believes: a datasheet's constant stays in it whatever calibration makes of the motor's own.
        Kt = self.numbers["Kt"]
        p["Kt_drive"] = Kt.value if Kt.nominal is None else Kt.nominal
        for i, order in enumerate(self.kinematic_error):
            p["order"][i] = order.order
            p["amplitude"][i] = order.amplitude.value
            p["phase"][i] = order.phase.value
        scale = {key: number.value for key, number in self.link_tolerances.items()}
        p["Jl"] = mounting.inertia * scale.get("inertia", 1.0)
        p["Mg"] = mounting.gravity_moment * scale.get("gravity_moment", 1.0)
        p["arm_scale"] = scale.get("arm", 1.0)
        p["gravity_angle"] = mounting.gravity_angle + (self.gravity_angle.value if self.gravity_angle else 0.0)
        s = self.sensors
        p["link_delay"] = s.link_encoder.delay - s.motor_encoder.delay
        if s.link_encoder.zero is not None:
            p["link_zero"] = s.link_encoder.zero.value
        if s.motor_current.offset is not None:
            p["current_offset"] = s.motor_current.offset.value
        if s.joint_torque.gain is not None:
            p["torque_gain"] = s.joint_torque.gain.value
        if s.joint_torque.offset is not None:
            p["torque_offset"] = s.joint_torque.offset.value
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
        if self.uncertainty is not None:
            data["uncertainty"]["names"] = Line(self.uncertainty.names)
            data["uncertainty"]["factor"] = [Line(row) for row in self.uncertainty.factor]
        with write_into_place(path) as temporary:
            temporary.write_text(yaml_text(data), encoding="utf-8")

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


def number_faults(numbers: Mapping[str, Number], shared: Mapping[str, float]) -> Iterator[str]:
    """Yield the faults of a description's numbers: field, expected, got."""
    for symbol in numbers:
        if symbol not in SYMBOLS and symbol not in OPTIONAL_SYMBOLS:
            yield f"numbers.{symbol}: {unknown_key(symbol, SYMBOLS)}"
    for symbol, (unit, _) in (SYMBOLS | OPTIONAL_SYMBOLS).items():
        number = numbers.get(symbol)
        if number is None:
            if symbol in SYMBOLS:
                yield f"numbers.{symbol}: missing"
            continue
        if not units.same(number.unit, unit):
            yield f"numbers.{symbol}.unit: expected {unit!r}, got {number.unit!r}"
        if (fault := value_fault(symbol, number.value)) is not None:
            yield fault
        if (fault := shared_fault(f"numbers.{symbol}", number, shared)) is not None:
            yield fault
    T1, T2 = numbers.get("T1"), numbers.get("T2")
    if T1 is not None and T2 is not None and T2.value < T1.value:
        yield f"numbers.T2.value: expected T2 ≥ T1 = {T1.value:g} N·m, got {T2.value:g}"


def shared_fault(field: str, number: Number, shared: Mapping[str, float]) -> str | None:
    """Return the fault of the shared tolerance of a number; None if there is none."""
    if number.shared is None or number.shared in shared:
        return None
    known = f"one of {sorted(shared)}" if shared else "none, as there are no shared_tolerances"
    return f"{field}.shared: expected {known}, got {number.shared!r}"


def value_fault(symbol: str, value: float) -> str | None:
    """Return the fault of a value in its own unit; None if there is none."""
    unit, zero = (SYMBOLS | OPTIONAL_SYMBOLS)[symbol]
    low, high = POSSIBLE.get(symbol, (0.0, np.inf))
    if value < 0 or (value == 0 and not zero):
        return f"numbers.{symbol}.value: expected a number {'≥' if zero else '>'} 0, got {value:g}"
    if value and not low <= value <= high:
        possible = f"{low:g} to {high:g} {unit}".removesuffix(" 1")
        return f"numbers.{symbol}.value: expected {possible}, beyond which no joint is, got {value:g}"
    return None


PARAMETERS_NAMES = frozenset(PARAMETERS.names or ())


def shipped(name: str = "") -> Path:
    """Return the path of a file shipped in `models/`."""
    return Path(str(resources.files(__package__).joinpath(name)))


def known_joints() -> dict[str, Path]:
    """Return the paths of the shipped joints by name (with dashes)."""
    found: dict[str, Path] = {}
    for path in sorted(shipped().glob("*.yaml")):
        found[path.stem.replace("_", "-")] = path
    return found


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
    if name in known:
        path = known[name]
    else:
        path = Path(source) if beside is None else beside / source
        if not is_there(path):
            raise InputError(
                f"joint {str(source)!r}: expected a path or one of {sorted(known)}, found neither{nearest(name, known)}"
            )
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


def as_joint(data: dict[str, Any], path: Path) -> Joint:
    """Build a joint from plain data as if it were in the file at `path`."""
    joint = parse(data, Joint, str(path))
    joint._path = path.resolve()
    return joint
