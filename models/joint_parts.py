"""Parts of a joint description: numbers, mountings, sensors, effects, range of validity, uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, field_validator, model_validator

from . import causes, units
from .errors import check_each_once, nearest, unknown_key
from .files import Strict
from .parameters import N_COEFFICIENTS, PLACES, VARIABLES
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


UNREAD = {
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
    """A number of the joint."""

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
    """Name of a further deviation that several numbers have in common (`shared_tolerances`)."""
    std: Annotated[float, Field(ge=0)] | None = None
    """Standard deviation that a diagnosis found, in the unit."""
    nominal: float | None = None
    """Value before a diagnosis."""


class Order(Strict):
    """One order of the kinematic error."""

    order: Annotated[float, Field(gt=0)]
    """Periods per turn of the wave generator."""
    amplitude: Number
    """[rad, output side]."""
    phase: Number
    """[rad]."""


LOCKED = 1e6  # inertia [kg·m²] from which a mounting is the bench


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
    """An encoder."""

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
    """Amplitude [counts] of the error that repeats with every line of the disc (four counts)."""

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
    """An error that repeats with the motor's angle: amplitude · sin(order · θm + phase)."""

    order: Annotated[float, Field(gt=0)]
    """Periods per turn of the motor."""
    amplitude: Annotated[float, Field(ge=0)]
    """In the sensor's unit."""
    phase: float = 0.0
    """[rad]."""


class Vibration(Strict):
    """A vibration of the structure that the sensor measures."""

    frequency: Annotated[float, Field(gt=0, lt=500)]
    """[Hz]."""
    amplitude: Annotated[float, Field(ge=0)]
    """Rms, in the sensor's unit."""


class AnalogSpec(Strict):
    """An analog sensor and its imperfections, none by default."""

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
    """The six-axis force/torque sensor."""

    force_noise: Annotated[float, Field(ge=0)] = 0.0
    """Of each axis [N rms]."""
    torque_noise: Annotated[float, Field(ge=0)] = 0.0
    """Of each axis [N·m rms]."""
    delay: Annotated[float, Field(ge=0, lt=0.1)] = 0.0
    """[s]."""
    rate: Annotated[float, Field(gt=0, le=10000)] = 1000.0
    """Sample rate [Hz]."""
    crosstalk: Annotated[float, Field(ge=0, lt=0.2)] = 0.0
    """Largest share of an axis' load, relative to its rated load, in each other axis [1]."""
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
    """A parameter of an effect."""

    value: float
    """In its unit."""
    unit: str = ""
    """By default that of the cause."""
    std: Annotated[float, Field(ge=0)] | None = None
    """Standard deviation that a diagnosis found."""


_ROUNDING = 1e-9  # relative rounding of a written bound


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
    """A nonparametric model discrepancy: a cubic B-spline on a uniform grid."""

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
    """The range of the data behind a diagnosed joint: smallest and largest value of each quantity."""

    link_position: Annotated[list[float], Field(min_length=2, max_length=2, description="rad")]
    link_velocity: Annotated[list[float], Field(min_length=2, max_length=2, description="rad/s")]
    joint_torque: Annotated[list[float], Field(min_length=2, max_length=2, description="N·m")]
    loads: list[Literal["driving", "driven"]] = []
    """Combinations of motion and load in the data: `driving` (the motor moves the load), `driven` (the load moves the
    motor)."""

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
        past = self._past(link_position, link_velocity, joint_torque)
        shares = {name: int(np.count_nonzero(x > _SLACK)) / samples for name, x in past.items()}
        found = {name: share for name, share in shares.items() if share > 0}
        sign = np.sign(np.asarray(link_velocity) * joint_torque)
        for name, which in (("driving", 1.0), ("driven", -1.0)):
            share = int(np.count_nonzero(sign == which)) / samples
            if self.loads and name not in self.loads and share > _SLACK:
                found[name] = share
        return found

    def distance(self, link_position: np.ndarray, link_velocity: np.ndarray, joint_torque: np.ndarray) -> np.ndarray:
        """Return the largest distance of samples, shape (n,) each, from the range, in units of the range, shape (n,)."""
        return np.max([*self._past(link_position, link_velocity, joint_torque).values()], axis=0)

    def outside(self, link_position: np.ndarray, link_velocity: np.ndarray, joint_torque: np.ndarray) -> np.ndarray:
        """Return which samples, shape (n,) each, are outside the range with its margin, shape (n,), bool."""
        return self.distance(link_position, link_velocity, joint_torque) > _SLACK

    def _past(self, *samples: np.ndarray) -> dict[str, np.ndarray]:
        """Return the distance of samples from the range of each variable, in units of that range."""
        ends = {name: getattr(self, name) for name in ("link_position", "link_velocity", "joint_torque")}
        return {
            name: np.maximum(np.maximum(low - x, x - high), 0.0) / max(high - low, 1e-9)
            for (name, (low, high)), x in zip(ends.items(), samples, strict=True)
        }


_SLACK = 0.05  # share of a range that is allowed as a margin
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
    """The joint uncertainty of a diagnosis: L Lᵀ is the covariance of `names`, in their units. Other numbers have
    their own `std` or tolerance."""

    names: list[str]
    """Numbers as in `models.calibration` (`Kt`, `A2`, `link_encoder_zero`), parameters of effects
    (`effects.0.ratio`), coefficients of discrepancies (`discrepancies.0.3`)."""
    factor: list[list[float]]
    """Rows of the lower triangular L."""
    discrepancy: dict[Literal["motor_current", "joint_torque", "link_balance"], Annotated[float, Field(ge=0)]] = {}
    """Rms, in the balance's unit, that the description does not explain, by balance."""
    beyond: Annotated[float, Field(ge=1)] = 1.0
    """Factor of `discrepancy` one whole range outside the range of validity."""

    @model_validator(mode="after")
    def _triangular(self) -> Uncertainty:
        check_each_once(self.names, "names")
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


Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class Fault:
    """A fault: severity, field in the file, expected and got."""

    severity: Severity
    field: str
    message: str


_UNITS = {"K2": "N·m/rad", "K3": "N·m/rad", "Fs": "N·m"}


def contradictions(value: Mapping[str, float], fitted: Collection[str]) -> Iterator[Fault]:
    """Yield numbers of a joint that contradict each other: a gear that softens with torque, Coulomb above static
    friction. `fitted`: symbols of numbers that may cross, as each follows the data."""

    def ordered(small: str, large: str, why: str, severity: Severity = "error") -> Iterator[Fault]:
        if small in value and large in value and value[small] > value[large]:
            worst: Severity = "warning" if {small, large} & set(fitted) else severity
            text = f"expected {large} ≥ {small} = {value[small]:g} {_UNITS[large]}, {why}, got {value[large]:g}"
            yield Fault(worst, f"numbers.{large}", text)

    yield from ordered("K1", "K3", "a strain wave gear stiffens with torque")
    yield from ordered("K1", "K2", "a strain wave gear stiffens with torque", "warning")
    yield from ordered("K2", "K3", "a strain wave gear stiffens with torque", "warning")
    yield from ordered("Fc", "Fs", "static friction is no less than Coulomb friction")
