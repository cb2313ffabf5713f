"""The interface of estimators: signals and the known joint in, a posterior of the joint torque out.

An estimator is a frozen dataclass of its tuning parameters, with units. It works by its name (`registry`) over the
signals of a run or recording (`estimate`), and in the closed loop (`step`). A smoother cannot be fed back. The
estimate is the *actual* joint torque Ts. `KnownJoint.as_read` converts it to the reading of a torque sensor with
known gain, offset, drift and discrepancy.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np

from ..models import causes
from ..models.chunks import BLOCK, large, parts
from ..models.errors import FilterDiverged, InputError
from ..models.joint import Joint
from ..models.joint_parts import Mounting, Sensors
from ..models.kernels import kernel
from ..models.notebook import html_table, paragraph
from ..models.parameters import N_ORDERS, PARAMETERS
from ..models.pointers import call_estimator
from ..models.signals import SENSED, Signals, at_samples
from ..models.step import OK, SAMPLE, Arrays, CompiledStep, PythonStep, Step
from .sensing import read_joint_torque
from .trust import Watch

Result = TypeVar("Result")
_LASTS = 0.01  # correlation time [s] of errors of the current that are not white noise, such as its ripple
TORQUES = frozenset({"torque", "variance", "external_torque"})  # outputs that are torques or their variance


@dataclass(frozen=True)
class SensorNoise:
    """Resolution (one count), noise (rms) and other errors (rms) of the sensors: [rad, motor side], [rad], [A]."""

    motor_resolution: float = 2 * math.pi / 4096
    motor_noise: float = 0.0
    link_resolution: float = 2 * math.pi / 2**20
    link_noise: float = 1.5e-6
    current_noise: float = 0.01
    # motor_error, link_error, current_error: errors that are not white noise: cyclic errors of encoders; ripple,
    # flicker, vibration and ADC steps of the current
    motor_error: float = 0.0
    link_error: float = 0.0
    current_error: float = 0.0

    @classmethod
    def of(cls, sensors: Sensors) -> SensorNoise:
        """Return the noise of a joint's described sensors."""
        motor, link, current = sensors.motor_encoder, sensors.link_encoder, sensors.motor_current
        ripple = 0.0 if current.ripple is None else current.ripple.amplitude / math.sqrt(2.0)
        vibration = 0.0 if current.vibration is None else current.vibration.amplitude
        return cls(
            motor.resolution, motor.noise, link.resolution, link.noise, current.noise,
            motor.cyclic_error * motor.resolution / math.sqrt(2.0), link.cyclic_error * link.resolution / math.sqrt(2.0),
            math.hypot(ripple, vibration, current.flicker, current.step / math.sqrt(12.0)),
        )  # fmt: skip

    def current_variance(self, interval: float) -> float:
        """Return the variance [A²] of white noise that moves a rotor as far as the current sensor's errors do at an
        interval between samples [s]; 0: the noise only.

        A correlated error has the effect of white noise of the same power density, whose variance is larger by its
        correlation time over the sample interval.
        """
        longer = max(_LASTS / interval, 1.0) if interval > 0.0 else 0.0
        return self.current_noise**2 + longer * self.current_error**2


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the joint's numbers."""

    # stiffness, wave_generator, wave_generator_curve, torque_constant, viscous, gravity, inertia: relative, of K1 to K3
    # in common, Kw0, Cw, Kt, bw, Mg and Jl [1]
    stiffness: float = 0.0
    wave_generator: float = 0.0
    wave_generator_curve: float = 0.0
    torque_constant: float = 0.0
    viscous: float = 0.0
    gravity: float = 0.0
    inertia: float = 0.0
    # shape (N_ORDERS,), of either quadrature of every order of kinematic error [rad]
    kinematic: np.ndarray = field(default_factory=lambda: np.zeros(N_ORDERS))
    current_offset: float = 0.0  # of the current sensor [A]

    @classmethod
    def of(cls, joint: Joint) -> Spread:
        """Return the deviations of a description: those of its diagnosis, or else its tolerances."""
        kinematic = np.zeros(N_ORDERS)
        for i, order in enumerate(joint.kinematic_error):
            amplitude, phase = order.amplitude, order.phase
            # Each of both quadratures has half of both errors.
            kinematic[i] = math.hypot(_deviation(amplitude), amplitude.value * _deviation(phase)) / math.sqrt(2.0)
        return cls(
            stiffness=_relative(joint, "K2"),
            wave_generator=_relative(joint, "Kw0"),
            wave_generator_curve=_relative(joint, "Cw"),
            torque_constant=_relative(joint, "Kt"),
            viscous=_relative(joint, "bw"),
            gravity=_deviation(joint.link_tolerances.get("gravity_moment")),
            inertia=_deviation(joint.link_tolerances.get("inertia")),
            kinematic=kinematic,
            current_offset=_deviation(joint.sensors.motor_current.offset),
        )

    def within(self, share: float) -> Spread:
        """Return deviations `share` times as large."""
        return Spread(**{f.name: share * getattr(self, f.name) for f in fields(self)})


@dataclass(frozen=True)
class KnownJoint:
    """What an estimator knows of a joint."""

    record: np.ndarray  # shape (1,), numbers and known effects (`models.parameters`)
    noise: SensorNoise = field(default_factory=SensorNoise)  # of its sensors
    rated_torque: float = 16.0  # [N·m], the scale of torques
    friction: float = 0.15  # relative standard deviation of the friction model, by its diagnosis or else its tolerance
    link_zero: float = 0.0  # standard deviation of the link encoder's zero against the motor encoder's [rad]
    # variation of that zero with the link's angle [rad]: the deviation of a known eccentricity
    link_wander: float = 0.0
    # standard deviation of the share of load-dependent friction that acts while the load drives
    back_driven: float = 0.0
    load_error: float = 0.0  # known error of the described load [N·m]; 0 if nothing contradicts it
    start: float | None = None  # start of the recording [s], from which drifts count; None: the first sample
    spread: Spread = field(default_factory=Spread)  # standard deviations of its other numbers

    def __post_init__(self) -> None:
        if getattr(self.record, "dtype", None) != PARAMETERS or self.record.shape != (1,):
            got = type(self.record).__name__
            raise InputError(f"estimator: record: expected a parameter record of shape (1,), got {got}")

    @classmethod
    def of(cls, joint: Joint, mounting: Mounting | None = None, record: np.ndarray | None = None) -> KnownJoint:
        """Return the known joint of a description in a mounting; `record`, shape (1,), replaces the description's
        own."""
        s = joint.sensors
        zero, share = s.link_encoder.zero, joint.numbers.get("back_driven_friction")
        on_link = [e.parameters for e in joint.effects if causes.get(e.name).sensor == "link_position"]
        wander = [parameters["amplitude"].std or 0.0 for parameters in on_link if "amplitude" in parameters]
        return cls(
            joint.record(mounting) if record is None else record,
            SensorNoise.of(s),
            joint.numbers["rated_torque"].value, _relative(joint, "Fc"), _deviation(zero), sum(wander), _deviation(share),
            spread=Spread.of(joint),
        )  # fmt: skip

    def within(self, share: float) -> KnownJoint:
        """Return the same numbers with deviations `share` times as large."""
        return replace(
            self, friction=share * self.friction, link_zero=share * self.link_zero, link_wander=share * self.link_wander,
            back_driven=share * self.back_driven, spread=self.spread.within(share),
        )  # fmt: skip

    @property
    def p(self) -> np.void:
        """The parameters by name."""
        return self.record[0]

    def as_read(self, torque: np.ndarray, signals: Signals) -> np.ndarray:
        """Return the torque sensor's reading [N·m] of a joint torque, shape (n,), with its known gain, offset, drift
        and discrepancy. `signals`: n samples with both positions."""
        read = large(len(torque))
        read_joint_torque(
            np.asarray(torque, dtype=np.float64), signals["motor_position"], signals["link_position"],
            self.since(signals.time), self.record, read,
        )  # fmt: skip
        return read

    def with_numbers(self, **values: float) -> KnownJoint:
        """Return the same joint with other numbers in the record, by field."""
        record = self.record.copy()
        for name, value in values.items():
            record[0][name] = value
        return replace(self, record=record)

    def since(self, time: np.ndarray) -> np.ndarray:
        """Return times [s] since the recording began."""
        return time - (time[0] if self.start is None else self.start)


def _relative(joint: Joint, symbol: str) -> float:
    """Return the relative standard deviation of a number: by its diagnosis, or else its tolerance with a shared one."""
    number = joint.numbers[symbol]
    if number.std is not None:
        return number.std / number.value if number.value > 0.0 else 0.0
    return math.hypot(number.tolerance, 0.0 if number.shared is None else joint.shared_tolerances[number.shared])


def _deviation(number: Any) -> float:
    """Return the standard deviation of a number: by its diagnosis, or else its stated deviation; 0 without either."""
    if number is None:
        return 0.0
    if number.std is not None:
        return float(number.std)
    return math.hypot(number.deviation, number.tolerance * number.value)


@dataclass(frozen=True)
class Posterior:
    """A joint torque estimate over n samples.

    Attributes:
      estimator: its name.
      time: shape (n,) [s].
      mean: shape (n,), joint torque Ts [N·m].
      variance: shape (n,), error variance by the estimator itself [(N·m)²]; None if it has none.
      innovation, innovation_covariance: shape (n, m), (n, m, m) in the measurements' units; row 0, the start, may be
        zero.
      robust: shape (n,), bool, whether it is in robust mode (Eq. 19 of the paper); None without modes.
      columns: other outputs, shape (n,) each, by name: states, gains.
      external: shape (n,), its own estimate of the external torque on the link [N·m]; None if it has none.
      untrusted: why the estimate is not to be trusted (`trust`); None if there is no reason.

    Raises:
      InputError: a mean, variance or external torque of another length than time.
    """

    estimator: str
    time: np.ndarray
    mean: np.ndarray
    variance: np.ndarray | None = None
    innovation: np.ndarray | None = None
    innovation_covariance: np.ndarray | None = None
    robust: np.ndarray | None = None
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    external: np.ndarray | None = None
    untrusted: str | None = None

    def __post_init__(self) -> None:
        for name in ("mean", "variance", "external"):
            found = getattr(self, name)
            if found is not None and np.shape(found) != np.shape(self.time):
                raise InputError(
                    f"estimator {self.estimator!r}: {name}: expected shape {np.shape(self.time)}, got {np.shape(found)}"
                )

    def part(self, samples: slice) -> Posterior:
        """Return the estimate at some of the samples."""
        return at_samples(self, samples)

    def _repr_html_(self) -> str:
        rows = [("joint torque", "N·m", float(np.min(self.mean)), float(np.max(self.mean)))]
        if self.external is not None:
            rows.append(("external torque", "N·m", float(np.min(self.external)), float(np.max(self.external))))
        text = f"{len(self.time)} samples"
        if self.variance is not None:
            text += f"; estimated error {math.sqrt(float(np.mean(self.variance))):.3g} N·m RMS"
        if self.robust is not None:
            text += f"; robust in {100 * float(np.mean(self.robust)):.3g} %"
        if self.untrusted is not None:
            text += f"; not to be trusted: {self.untrusted}"
        return paragraph(self.estimator, text) + html_table(("estimate", "unit", "smallest", "largest"), rows)

    @property
    def nis(self) -> np.ndarray | None:
        """Normalised innovation squared, shape (n,); None without innovations. Zero where S is zero (the start)."""
        if self.innovation is None or self.innovation_covariance is None:
            return None
        S, e = self.innovation_covariance, self.innovation
        if e.shape[1] == 1:
            s = S[:, 0, 0]
            return np.divide(e[:, 0] ** 2, s, out=np.zeros(len(e)), where=s > 0)
        good = np.all(np.diagonal(S, axis1=1, axis2=2) > 0, axis=1)
        found = np.zeros(len(e))
        found[good] = np.einsum("ni,ni->n", e[good], np.linalg.solve(S[good], e[good][..., None])[..., 0])
        return found


@dataclass(frozen=True)
class TuningParameter:
    """A tuning parameter."""

    field: str  # its name; dotted inside a dataclass (`process.push`)
    low: float  # lower bound, in the field's unit
    high: float  # upper bound
    scale: Literal["log", "linear"] = "log"  # of the search; `log` needs low > 0

    def to_unit(self, value: float) -> float:
        """Return the value's place between the bounds, 0 to 1."""
        if self.scale == "log":
            place = math.log(max(value, self.low) / self.low) / math.log(self.high / self.low)
        else:
            place = (value - self.low) / (self.high - self.low)
        return min(max(place, 0.0), 1.0)

    def from_unit(self, place: float) -> float:
        """Return the value at a place between the bounds."""
        place = min(max(float(place), 0.0), 1.0)
        if self.scale == "log":
            return self.low * (self.high / self.low) ** place
        return self.low + (self.high - self.low) * place


def value_of(settings: Any, field: str) -> Any:
    """Return the value of a field, which may be dotted."""
    for part in field.split("."):
        settings = getattr(settings, part)
    return settings


def with_values(settings: Any, values: Mapping[str, Any]) -> Any:
    """Return a copy of frozen settings with other values, by field; fields may be dotted."""
    own: dict[str, Any] = {}
    inner: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        head, _, rest = name.partition(".")
        if rest:
            inner.setdefault(head, {})[rest] = value
        else:
            own[head] = value
    own |= {head: with_values(getattr(settings, head), some) for head, some in inner.items()}
    return replace(settings, **own)


class Estimator(ABC):
    """An estimator of the joint torque: a frozen dataclass of its tuning parameters."""

    name: str  # how tables call it; also its key in the registry
    causal: ClassVar[bool] = True  # whether it uses no later samples
    costly: ClassVar[bool] = False  # whether an update takes ten microseconds instead of a tenth of one
    innovation_unit: ClassVar[str] = "N·m"
    needs: ClassVar[tuple[str, ...]] = ("motor_position", "link_position", "motor_current")  # channels it reads
    learns: ClassVar[bool] = False  # whether it also estimates the errors of the joint's constants
    reads_command: ClassVar[bool] = False  # whether it reads the drive's current command, if known
    tuning: ClassVar[tuple[TuningParameter, ...]] = ()  # first the parameter that trades noise for delay
    description: ClassVar[str] = ""  # one line, with its source

    @abstractmethod
    def estimate(self, signals: Signals, joint: KnownJoint) -> Posterior:
        """Estimate the joint torque over signals.

        Args:
          signals: channels of `needs`; `current_command` [A], in force from a sample to the next, if known and
            `reads_command`. The torque sensor's reading is not used.
          joint: the known joint.

        Raises:
          InputError: a missing channel. FilterDiverged: the next estimate would not be finite.
        """

    def torques(self, signals: Signals, joint: KnownJoint) -> Posterior:
        """Return `estimate`, to the bit, with mean, variance and external torque only: for long recordings."""
        return self.estimate(signals, joint)

    def scaled(self, joint: KnownJoint, interval: float) -> Estimator:
        """Return the same estimator for a joint whose samples are `interval` [s] apart.

        Most tuning parameters are relative to the joint's numbers and need no scaling. An estimator with absolute
        ones (the paper's filters) scales them here.
        """
        return self

    def step(self, joint: KnownJoint, interval: float) -> CompiledStep:
        """Return the estimator for the closed loop, whose samples are `interval` [s] apart. Raises `InputError`: a
        smoother."""
        raise InputError(f"estimator {self.name!r}: expected a causal estimator for the loop, got a smoother")


class CausalEstimator(Estimator):
    """An estimator with one compiled step, in the loop and over signals.

    A subclass gives `compiled`, a step of records (`models.step.step_of`), and `settings` if they are not the tuning
    parameters by their names. A plain Python step works everywhere, too, a thousand times slower. Outputs with these
    names go into the posterior: `torque` (the first), `variance`, `innovation…` with its `innovation_variance…`,
    `robust`, `external_torque`. Others become its columns.
    """

    compiled: ClassVar[Step | PythonStep]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.costly = cls.costly or isinstance(vars(cls).get("compiled"), PythonStep)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the step's outputs."""
        return fields_of(self.compiled.records[4])

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        """Return the step's settings, a record of float64 fields, shape (1,): by default the tuning parameters by
        their names, and `interval`, the median time between samples [s]."""
        given = {**{f.name: getattr(self, f.name) for f in fields(self)}, "interval": interval}  # type: ignore[arg-type]
        kind = self.compiled.records[3]
        return np.array([tuple(float(given[name]) for name in fields_of(kind))], kind)

    def reason(self, status: int, out: np.ndarray) -> str:
        """Return why a step with this status gave no estimate, in words. `out`: the last good outputs."""
        error = getattr(self.compiled, "error", None)
        if status < 0 and error is not None:  # of a step in Python
            return f"its step failed: {type(error).__name__}: {error}"
        return "the estimate is no longer a finite number"

    def step(self, joint: KnownJoint, interval: float) -> CompiledStep:
        settings = self.settings(joint, interval).view(np.float64).reshape(-1)
        return CompiledStep(
            self.compiled.address, self.compiled.records[0].itemsize // 8, joint.record, settings, len(self.outputs),
            self.reads_command,
        )  # fmt: skip

    def estimate(self, signals: Signals, joint: KnownJoint) -> Posterior:
        return self._watched(signals, joint, self.outputs)

    def torques(self, signals: Signals, joint: KnownJoint) -> Posterior:
        return self._watched(signals, joint, TORQUES.intersection(self.outputs))

    def _watched(self, signals: Signals, joint: KnownJoint, names: Collection[str]) -> Posterior:
        """Return the posterior over signals with some of the outputs, block by block. All outputs decide whether it
        is trusted."""
        watch = Watch(joint.rated_torque, self.outputs)
        arrays = self.step(joint, interval_of(signals.time)).arrays()
        column = {name: large(len(signals.time)) for name in self.outputs if name in names}
        before = np.zeros(len(self.outputs))
        for part in parts(len(signals.time), BLOCK):
            samples = as_samples(signals, self.needs, joint, self.reads_command, part)
            out = np.zeros((len(samples), len(self.outputs)))
            failed, status = go_on(arrays, samples, out)
            if failed < len(samples):
                reason = self.reason(status, out[failed - 1] if failed else before)
                at = part.start + failed
                raise FilterDiverged(self.name, at, float(signals.time[at]), reason)
            watch.add(signals.time[part], out)
            for i, name in enumerate(self.outputs):
                if name in column:
                    column[name][part] = out[:, i]
            before = out[-1]
        return replace(self.posterior(signals.time, column), untrusted=watch.reason)

    def posterior(self, time: np.ndarray, column: Mapping[str, np.ndarray]) -> Posterior:
        """Return outputs by name, shape (n,) each, as a posterior."""
        variances = [n for n in column if n.startswith("innovation_variance")]
        innovations = [n.replace("innovation_variance", "innovation") for n in variances]
        e = np.column_stack([column[n] for n in innovations]) if innovations else None
        S = None
        if innovations:
            S = np.column_stack([column[n] for n in variances])[:, :, None] * np.eye(len(innovations))
        own = {"torque", "variance", "robust", "external_torque", *innovations, *variances}
        return Posterior(
            self.name, time, column["torque"], column.get("variance"), e, S,
            column["robust"] > 0 if "robust" in column else None,
            {n: v for n, v in column.items() if n not in own}, column.get("external_torque"),
        )  # fmt: skip


def each(
    estimators: Mapping[str, Estimator], estimate: Callable[[Estimator], Result], threads: int = 1
) -> dict[str, Result | FilterDiverged | InputError]:
    """Run estimators, `threads` at a time; return by name the result, or the error of one that has none."""

    def one(estimator: Estimator) -> Result | FilterDiverged | InputError:
        try:
            return estimate(estimator)
        except (FilterDiverged, InputError) as error:
            return error

    with ThreadPoolExecutor(max(min(threads, len(estimators)), 1), thread_name_prefix="estimate") as pool:
        return dict(zip(estimators, pool.map(one, estimators.values()), strict=True))


def fields_of(record: np.dtype) -> tuple[str, ...]:
    """Return the names of a record's fields, in order."""
    return record.names or ()


def interval_of(time: np.ndarray) -> float:
    """Return the median interval of times [s], shape (n,), to the nanosecond, without rounding errors of the times.

    For jittering stamps: the round interval or rate within the median's standard error (1.25 σ/√n). Clocks have round
    periods, and in the closed loop the period is known.
    """
    intervals = np.diff(time)
    median = float(np.median(intervals))
    spread = 1.4826 * float(np.median(np.abs(intervals - median), overwrite_input=True))
    allowed = 3 * 1.25 * spread / np.sqrt(len(intervals))
    if median > 0.0 and allowed > 1e-9:
        for round_one in (float(f"{median:.2g}"), 1 / float(f"{1 / median:.2g}")):
            if abs(round_one - median) < allowed:
                median = round_one
                break
    return round(median, 9)


def as_samples(
    signals: Signals, needs: tuple[str, ...], joint: KnownJoint, reads_command: bool = False, part: slice = slice(None)
) -> np.ndarray:
    """Return a part of signals, by default all, as records of `SAMPLE`, shape (samples,); NaN for missing channels. A
    current command, for estimators with `reads_command`, counts from the next sample; before the first it is 0 A.
    Raises `InputError`: a missing channel of `needs`."""
    for name in needs:
        signals[name]
    time, start = signals.time, part.start or 0
    # The command in force, and the interval, begin at the sample before.
    before = slice(max(start - 1, 0), part.stop)
    found = np.full(len(time[before]), np.nan, SAMPLE)
    found["time"] = time[before] - (time[0] if joint.start is None else joint.start)
    found["interval"] = np.diff(time[before], prepend=time[before.start])
    for name in (*SENSED, "arm_torque"):
        if name in signals and name != "joint_torque":
            found[name] = signals[name][before]
    if reads_command and "current_command" in signals:
        found["current_command"] = np.r_[0.0, signals["current_command"][before][:-1]]
    return found[start - before.start :]


def go_on(arrays: Arrays, samples: np.ndarray, history: np.ndarray) -> tuple[int, int]:
    """Run a step over further samples, records of `SAMPLE`, shape (n,), with `arrays` of `CompiledStep.arrays`, whose
    memory is updated. Its outputs go to `history`, shape (n, outputs). Return the sample at which it failed and its
    status; (n, OK) if it did not."""
    failed, status = _run(*arrays[:4], samples, history)
    return int(failed), int(status)


@kernel
def _run(address, memory, record, settings, samples, history):
    size = samples.itemsize
    width = 8 * history.shape[1]
    at, to = samples.ctypes.data, history.ctypes.data
    for k in range(len(samples)):
        status = call_estimator(
            address, memory.ctypes.data, at + k * size, record.ctypes.data, settings.ctypes.data, to + k * width
        )
        if status != OK:
            return k, status
    return len(samples), OK
