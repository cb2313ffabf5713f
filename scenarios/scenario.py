"""Scenarios: YAML files in which a person states an experiment."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr, model_serializer, model_validator

from ..estimator.estimator import Estimator
from ..models.errors import InputError, nearest, unknown_key
from ..models.files import M, Strict, find, kind_of, parse, read_yaml, yaml_value
from ..models.joint import SYMBOLS, Joint, Mounting, Sensors, load_joint
from ..models.parameters import REFERENCE_TEMPERATURE
from ..models.recording import check_channels
from ..models.signals import SENSED
from ..sim.drive import Controller
from ..sim.loop import CONTROL_PERIOD
from ..sim.plant import TIMESTEP
from ..sim.sensors import realistic, stream
from .filters import PAPER, FilterEntry, paper_entries
from .motion import AddedMotion

_LONGEST = 3600.0  # s: four filters over it take 4 GB
_DEEPEST = 20  # dots of a key; the longest has five
LAGGING = Controller().lagging(2e-3)
"""The drive where `sensors: realistic` and none is stated."""


class Waypoint(Strict):
    """A position of the link at a time; between waypoints the command moves with minimum jerk, or linearly."""

    time: Annotated[float, Field(ge=0, description="s")]
    position: Annotated[float, Field(description="rad, output side; 0 hangs straight down")]
    profile: Annotated[Literal["minimum_jerk", "linear"], Field(description="of the motion that ends here")] = (
        "minimum_jerk"
    )


class Disturbance(Strict):
    """A force at the link, by its torque: a push (half sine), a step (held for the duration), a ramp up and down (triangle), a
    sine, or a random walk, another one for each seed."""

    kind: Literal["push", "step", "triangle", "sine", "walk"]
    """Its course over time."""
    start: Annotated[float, Field(ge=0, description="s")]
    duration: Annotated[float, Field(gt=0, description="s")]
    torque: Annotated[
        float,
        Field(description="N·m at its largest; positive pushes forward. Of a walk: standard deviation at its end"),
    ]
    lever: Annotated[
        float,
        Field(ge=0, description="m from the axis, where a force at the link makes that torque; 0: a torque alone"),
    ] = 0.4
    cycles: Annotated[float, Field(gt=0, description="periods of a sine within the duration")] = 1.0

    def acts(self, time: np.ndarray) -> np.ndarray:
        """Whether it acts at the times [s], shape (n,)."""
        u = (time - self.start) / self.duration
        return (u >= 0) & (u < 1)

    def signal(self, time: np.ndarray, seed: int = 0) -> np.ndarray:
        """Torque [N·m] at the times [s]; for a walk, `seed` is that of the scenario."""
        u = (time - self.start) / self.duration
        inside = self.acts(time)
        shape = {
            "push": lambda: np.sin(np.pi * u),
            "step": lambda: np.ones_like(u),
            "triangle": lambda: 1 - np.abs(2 * u - 1),
            "sine": lambda: np.sin(2 * np.pi * self.cycles * u),
            "walk": lambda: self._walk(inside, seed),
        }[self.kind]()
        return np.where(inside, self.torque * shape, 0.0)

    def _walk(self, inside: np.ndarray, seed: int) -> np.ndarray:
        """A random walk that is zero where it begins and has unit standard deviation where it ends."""
        steps = stream(seed, f"walk at {self.start:g} s").standard_normal(len(inside)) * inside
        if np.any(inside):
            steps[np.argmax(inside)] = 0.0
        return np.cumsum(steps) / math.sqrt(max(int(np.count_nonzero(inside)), 1))


class Temperature(Strict):
    """Temperature of the gear [°C]: one number, or `end + (start − end)·exp(−t/time_constant)`."""

    short: ClassVar[str] = "number"

    start: Annotated[float, Field(ge=-273.15, le=1000, description="°C")]
    end: Annotated[float, Field(ge=-273.15, le=1000, description="°C")]
    time_constant: Annotated[float, Field(gt=0, description="s")] = math.inf

    @model_validator(mode="before")
    @classmethod
    def _constant(cls, given: Any) -> Any:
        return {"start": given, "end": given} if not isinstance(given, dict) else given

    @model_validator(mode="after")
    def _complete(self) -> Temperature:
        if self.start != self.end and math.isinf(self.time_constant):
            raise ValueError("time_constant: missing")
        return self

    @model_serializer
    def _written(self) -> float | dict[str, float]:
        if self.start == self.end:
            return self.start
        return {"start": self.start, "end": self.end, "time_constant": self.time_constant}

    def signal(self, time: np.ndarray) -> np.ndarray:
        """Temperature [°C] at times [s], shape (n,)."""
        return self.end + (self.start - self.end) * np.exp(-time / self.time_constant)


class Scenario(Strict):
    """An experiment with a joint: mounting, motion, disturbances, sensors, filters, seed."""

    format: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Of the run's folder."""
    description: str = ""
    """What it is for."""
    figure: Annotated[str, Field(description="the paper's figure that this reproduces")] = ""
    joint: Annotated[str, Field(description="a shipped joint's name or a path")] = "test-joint"
    known_joint: Annotated[str, Field(description="what the estimators know; the joint itself by default")] = ""
    plant: Annotated[
        dict[str, float], Field(description="numbers of the plant that the estimators do not know, SI")
    ] = {}
    mounting: Annotated[str, Field(description="of the joint; its default where empty")] = ""
    link: Annotated[
        Mounting | None, Field(description="what hangs on the output, instead of a mounting by its name")
    ] = None
    duration: Annotated[float, Field(gt=0, description="s; an hour at most: a run is held in memory")]
    timestep: Annotated[float, Field(ge=1e-6, le=CONTROL_PERIOD, description="s")] = TIMESTEP
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Of every random stream."""
    locked_rotor: bool = False
    """Hold the rotor still: the output is turned by the disturbances alone."""
    trajectory: Annotated[list[Waypoint], Field(min_length=1)]
    """Where the link is commanded to be."""
    motions: list[AddedMotion] = []
    """Added to the trajectory."""
    disturbances: list[Disturbance] = []
    """Forces at the link."""
    sensors: Annotated[
        dict[str, Any] | Literal["realistic"],
        Field(description="changes to the joint's sensors, or `realistic`: sensors, clock and drive as they are"),
    ] = {}
    current: Annotated[
        Literal["command", "sensor"],
        Field(
            description="what the paper's filters take for the motor current: the drive's command, as the paper does, or the "
            "sensor's reading, as all others do"
        ),
    ] = "command"
    jitter: Annotated[float, Field(ge=0, lt=1e-3, description="of the time stamps, s rms")] = 0.0
    controller: Controller = Controller()
    """Of the position."""
    feedback: Annotated[str, Field(description="filter whose estimate is fed back, `sensor`, or `none`")] = "none"
    temperature: Annotated[Temperature, Field(description="of the gear, °C")] = Temperature(
        start=REFERENCE_TEMPERATURE, end=REFERENCE_TEMPERATURE
    )
    filters: list[FilterEntry] = Field(min_length=1, default_factory=paper_entries)
    """Estimators by name, or with tuning parameters under names of their own."""
    record: Annotated[
        list[str], Field(description="what its recording holds of the sensors; where empty, what the joint states")
    ] = []
    transient: Annotated[float, Field(ge=0, description="s at the start that metrics leave out")] = 1.0
    _at_hand: dict[str, Joint] = PrivateAttr(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _as_they_are(cls, given: Any) -> Any:
        """`sensors: realistic` says what the clock and the drive are, too, where they are not stated."""
        if not isinstance(given, dict) or given.get("sensors") != "realistic":
            return given
        return {"current": "sensor", "jitter": 1e-4, "controller": LAGGING} | given

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        if self.mounting and self.link is not None:
            raise ValueError("expected either mounting or link, got both")
        if round(self.duration / CONTROL_PERIOD) < 2:
            raise ValueError(
                f"duration: expected at least two control periods of {CONTROL_PERIOD:g} s, got {self.duration:g} s"
            )
        if self.duration > _LONGEST:
            raise ValueError(
                f"duration: expected at most {_LONGEST:g} s, as a run is held in memory, got {self.duration:g} s"
            )
        substeps = CONTROL_PERIOD / self.timestep
        if abs(substeps - round(substeps)) > 1e-6:
            raise ValueError(f"timestep: expected a whole fraction of {CONTROL_PERIOD:g} s, got {self.timestep:g} s")
        times = [w.time for w in self.trajectory]
        for i, (a, b) in enumerate(itertools.pairwise(times)):
            if b <= a:
                raise ValueError(f"trajectory.{i + 1}.time: expected a time after {a:g} s, got {b:g} s")
        names = [f.name for f in self.filters]
        for i, name in enumerate(names):
            if name in names[:i] or name in ("none", "sensor"):
                raise ValueError(f"filters.{i}.name: expected a name of its own, got {name!r}")
        if self.feedback not in ("none", "sensor", *names):
            hint = nearest(self.feedback, names)
            raise ValueError(f"feedback: expected none, sensor or one of {names}, got {self.feedback!r}{hint}")
        if self.feedback in names and not self.filters[names.index(self.feedback)].build().causal:
            raise ValueError(
                f"feedback: expected a filter that can run in the loop, got {self.feedback!r}, which looks ahead"
            )
        for i, channel in enumerate(self.record):
            if channel not in SENSED or channel in self.record[:i]:
                raise ValueError(
                    f"record.{i}: expected one of {list(SENSED)}, each once, got {channel!r}{nearest(channel, SENSED)}"
                )
        if self.record:
            check_channels("record", self.record)
        for symbol in self.plant:
            if symbol not in SYMBOLS:
                raise ValueError(f"plant.{symbol}: {unknown_key(symbol, SYMBOLS)}")
        if self.transient > self.duration - 1.999 * CONTROL_PERIOD:
            raise ValueError(
                f"transient: expected less than the duration {self.duration:g} s by two control periods of {CONTROL_PERIOD:g} s, "
                f"got {self.transient:g} s"
            )
        return self

    @property
    def ticks(self) -> int:
        """How many control instants there are."""
        return round(self.duration / CONTROL_PERIOD)

    @property
    def time(self) -> np.ndarray:
        """Control instants [s], shape (n,)."""
        return np.arange(self.ticks) * CONTROL_PERIOD

    def commands(self, time: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Commanded link position [rad] and velocity [rad/s] at all control instants, or at times [s], increasing, shape (n,):
        held before and after the waypoints, with the motions."""
        time = self.time if time is None else time
        position = np.full_like(time, self.trajectory[0].position)
        velocity = np.zeros_like(time)
        for a, b in itertools.pairwise(self.trajectory):
            T, A = b.time - a.time, b.position - a.position
            u = np.clip((time - a.time) / T, 0, 1)
            inside = (time >= a.time) & (time < b.time)
            if b.profile == "linear":
                s, ds = u, np.ones_like(u)
            else:
                s, ds = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2
            position = np.where(time >= a.time, a.position + A * s, position)
            velocity = np.where(inside, A * ds / T, velocity)
        for motion in self.motions:
            further, rate = motion.signal(time)
            position, velocity = position + further, velocity + rate
        return position, velocity

    @property
    def happening(self) -> list[Disturbance]:
        """The disturbances that end before the scenario does."""
        return [d for d in self.disturbances if d.start + d.duration <= self.duration]

    def external_torque(self) -> np.ndarray:
        """Torque on the link [N·m], shape (n,): the sum of the disturbances."""
        time = self.time
        return sum((d.signal(time, self.seed) for d in self.disturbances), np.zeros_like(time))

    def tip_force(self) -> np.ndarray:
        """Tangential force on the link [N], shape (n,), of the disturbances that have a lever; positive pushes forward."""
        time = self.time
        forces = [d.signal(time, self.seed) / d.lever for d in self.disturbances if d.lever > 0.0]
        return sum(forces, np.zeros_like(time))

    @property
    def lever(self) -> float | None:
        """Lever [m] of the force at the link where the wrench is recorded and all forces have that one, so that both can be
        compared; None otherwise."""
        levers = {d.lever for d in self.disturbances}
        return levers.pop() or None if "force_x" in self.record and len(levers) == 1 else None

    def estimators(self) -> dict[str, Estimator]:
        """Its filters by name."""
        return {entry.name: entry.build() for entry in self.filters}

    @property
    def joints_at_hand(self) -> dict[str, Joint]:
        """Descriptions that were given as such and stand in no file, by the key that they stand for."""
        return dict(self._at_hand)

    def with_joints(self, joints: Mapping[str, Joint]) -> Self:
        """The same with descriptions at hand, where its file has a name or a path: `joint`, `known_joint`."""
        copy = self.model_copy(update={key: one.name for key, one in joints.items()})
        copy._at_hand = self._at_hand | dict(joints)
        return copy

    def load_joint(self, folder: Path | None = None) -> tuple[Joint, Joint]:
        """The plant's joint and the one that the estimators know, with the scenario's sensors."""

        def described(key: str) -> Joint:
            return self._with_sensors(self._at_hand.get(key) or load_joint(getattr(self, key), folder))

        joint = described("joint")
        known = described("known_joint") if self.known_joint else joint
        if self.plant:
            numbers = dict(joint.numbers)
            for symbol, value in self.plant.items():
                numbers[symbol] = numbers[symbol].model_copy(update={"value": value})
            joint = _revalidated(joint, {"numbers": numbers}, f"scenario {self.name}: plant")
        return joint, known

    def mount(self, joint: Joint) -> Mounting:
        """What hangs on a joint's output; `InputError` where it has no mounting of that name."""
        return joint.mount(self.mounting or None) if self.link is None else self.link

    def _with_sensors(self, joint: Joint) -> Joint:
        if not self.sensors:
            return joint
        changes = realistic(joint) if isinstance(self.sensors, str) else self.sensors
        merged = _merge(joint.sensors.model_dump(), changes)
        # A resolution given one way replaces the other.
        for name, change in changes.items():
            if isinstance(change, dict) and isinstance(merged.get(name), dict):
                for given, other in (("bits", "counts"), ("counts", "bits")):
                    if given in change and other not in change:
                        merged[name][other] = None
        sensors = parse(merged, Sensors, f"scenario {self.name}: sensors")
        return joint.model_copy(update={"sensors": sensors})


def _revalidated(joint: Joint, update: dict[str, Any], where: str) -> Joint:
    data = joint.model_copy(update=update).model_dump()
    copy = parse(data, Joint, where)
    copy._path = joint._path
    return copy


def _merge(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(base.get(key), dict):
            merged[key] = _merge(base[key], value)
        else:
            merged[key] = value
    return merged


def shipped_scenarios() -> dict[str, Path]:
    """The scenarios that the package ships, by name."""
    folder = Path(str(resources.files(str(__package__))))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def shipped_arms() -> dict[str, Path]:
    """The scenarios of arms that the package ships, by name."""
    folder = Path(str(resources.files(str(__package__)))) / "arms"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_scenario(
    source: str | Path, changes: list[str] | None = None, seed: int | None = None
) -> tuple[Scenario, Path]:
    """Load a scenario by the name of a shipped one, or from a YAML file.

    Args:
      source: name or path.
      changes: `key=value` overrides; dotted keys reach inside (`filters.2.k=0.1`, `controller.kp=6`).
      seed: replaces the scenario's.

    Returns:
      The scenario and the folder of its file.

    Raises:
      InputError: no such scenario, or one that is wrong; one line.
    """
    data, path = read_scenario(source, changes, seed, shipped_arms())
    if "arm" in data:
        raise InputError(
            f"{path}: arm: expected the scenario of a joint, got that of an arm: `flexspline run` takes one"
        )
    found = parse_changed(data, Scenario, path, changes)
    return found.model_copy(update={"motions": [m.beside(path.parent) for m in found.motions]}), path.parent


def parse_changed(data: dict[str, Any], model: type[M], path: Path, changes: list[str] | None) -> M:
    """Check the data of a scenario's file with changes; what is wrong with a change is not blamed on the file.

    Raises:
      InputError: what is wrong, in one line.
    """
    try:
        return parse(data, model, str(path) if changes else path)
    except InputError as error:
        if not changes:
            raise
        line = str(error).removeprefix(f"{path}: ")
        field, _, rest = line.partition(": ")
        keys = [change.partition("=")[0] for change in changes]
        key = next(
            (k for k in reversed(keys) if f"{k}.".startswith(f"{field}.") or f"{field}.".startswith(f"{k}.")), None
        )
        if key is None:  # it does not fit what the file says
            raise InputError(f"{path} with --set {', '.join(keys)}: {line}") from error
        raise InputError(f"--set {key}: {rest if key == field else line}") from error


def read_scenario(
    source: str | Path,
    changes: list[str] | None = None,
    seed: int | None = None,
    further: Mapping[str, Path] | None = None,
) -> tuple[dict[str, Any], Path]:
    """The data of a scenario's file with changes, unchecked, and its path; `further`: names beside those of shipped scenarios."""
    path = find(source, shipped_scenarios() | dict(further or {}), "scenario")
    data = read_yaml(path, "a scenario")
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected a mapping of keys, got {kind_of(data)}")
    changes = changes or []
    for i, change in enumerate(changes):
        key = change.partition("=")[0]
        lost = next((before for before in changes[:i] if before.startswith(f"{key}.")), None)
        if lost is not None:
            raise InputError(
                f"--set {change}: it replaces --set {lost}, which is inside it: expected the wider key first"
            )
        _override(data, change)
    if seed is not None:
        data["seed"] = seed
    return data, path


def changed(scenario: Scenario, changes: Mapping[str, Any]) -> dict[str, Any]:
    """A scenario's data with other values of dotted keys.

    Raises:
      InputError: a key that leads nowhere.
    """
    data = scenario.model_dump(mode="json", exclude_none=True)
    put_all(data, changes, f"scenario {scenario.name}")
    return data


def put_all(data: dict[str, Any], changes: Mapping[str, Any], where: str) -> None:
    """Give dotted keys other values, in place; `where`: what messages begin with."""
    for key, value in changes.items():
        put(data, key, from_here(key, value), f"{where}: {key}")


def from_here(key: str, value: Any) -> Any:
    """A change's value; a joint's file is looked for where one stands, not in the scenario's folder."""
    if (
        key.rpartition(".")[2] in ("joint", "known_joint")
        and str(value).endswith(".yaml")
        and Path(str(value)).is_file()
    ):
        return str(Path(str(value)).resolve())
    return str(value) if isinstance(value, Path) else value


def _override(data: dict[str, Any], change: str) -> None:
    key, sign, text = change.partition("=")
    if not sign or not key:
        raise InputError(f"--set {change}: expected key=value, got no '='" if not sign else f"--set {change}: no key")
    put(data, key, from_here(key, yaml_value(text)), f"--set {change}")


def put(data: dict[str, Any], key: str, value: Any, where: str) -> None:
    """Set a dotted key inside a scenario's data, in place (`filters.2.k`, `sensors.link_encoder.noise`)."""
    *path, last = key.split(".")
    if len(path) > _DEEPEST:
        raise InputError(f"{where}: expected a key of at most {_DEEPEST} dots, got {len(path)}")
    if path[:1] == ["filters"] and "filters" not in data:
        data["filters"] = list(PAPER)
    place: Any = data
    for part in path:
        if isinstance(place, list):
            item = _item(place, part, where)
            if isinstance(item, str):  # a filter that stands there by its name alone
                item = place[int(part)] = {"name": item, "estimator": item}
            place = item
        else:
            place = place.setdefault(part, {})
        if not isinstance(place, (dict, list)):
            raise InputError(f"{where}: {part} is a value, expected something with keys")
    if isinstance(place, list):
        _item(place, last, where)
        place[int(last)] = value
    else:
        place[last] = value


def _item(items: list, part: str, where: str) -> Any:
    if not re.fullmatch("[0-9]{1,6}", part) or int(part) >= len(items):
        raise InputError(f"{where}: expected a number from 0 to {len(items) - 1}, got {part!r}")
    return items[int(part)]
