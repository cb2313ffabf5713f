"""Scenarios: YAML files that describe an experiment."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr, model_serializer, model_validator

from ..estimator.estimator import Estimator
from ..models.arm import CarriedMass
from ..models.controller import MODES, Controller, Mode
from ..models.errors import InputError, nearest, unknown_key
from ..models.files import M, Strict, find, kind_of, parse, read_yaml, yaml_value
from ..models.joint import Joint, load_joint
from ..models.joint_parts import SYMBOLS, Mounting, Sensors
from ..models.parameters import REFERENCE_TEMPERATURE
from ..models.recording import check_channels
from ..models.signals import SENSED
from ..sim.loop import CONTROL_PERIOD
from ..sim.plant import TIMESTEP
from ..sim.sensors import realistic, stream
from .filters import PAPER, FilterEntry, paper_entries
from .motion import AddedMotion

_LONGEST = 3600.0  # s: four filters over it take 4 GB
_DEEPEST = 20  # dots of a key; the longest useful key has five
LAGGING = Controller().lagging(2e-3)  # default controller with `sensors: realistic`


class Waypoint(Strict):
    """A command at a time: a position, a velocity or a torque. Between waypoints it moves with minimum jerk, or linearly."""

    time: Annotated[float, Field(ge=0, description="s")]
    position: Annotated[float | None, Field(description="of the link, rad; 0 is straight down")] = None
    velocity: Annotated[float | None, Field(description="of the link, rad/s")] = None
    torque: Annotated[float | None, Field(description="of the motor at the output, N·Kt·i, N·m")] = None
    profile: Literal["minimum_jerk", "linear"] = "minimum_jerk"
    """Of the motion that ends here."""

    @model_validator(mode="after")
    def _one_command(self) -> Waypoint:
        given = [mode for mode in MODES if getattr(self, mode) is not None]
        if len(given) != 1:
            raise ValueError(f"expected one of {', '.join(MODES)}, got {' and '.join(given) or 'none'}")
        return self

    @property
    def mode(self) -> Mode:
        """What is commanded."""
        return next(mode for mode in MODES if getattr(self, mode) is not None)

    @property
    def command(self) -> float:
        """The commanded position [rad], velocity [rad/s] or torque [N·m]."""
        return float(getattr(self, self.mode))


class Disturbance(Strict):
    """A force at the link, given by its torque: a push (half sine), a step, a triangle, a sine, or a random walk (new for each
    seed)."""

    kind: Literal["push", "step", "triangle", "sine", "walk"]
    """Shape over time."""
    start: Annotated[float, Field(ge=0, description="s")]
    duration: Annotated[float, Field(gt=0, description="s")]
    torque: float
    """Largest value, N·m; positive pushes forward. Of a walk: standard deviation at its end."""
    lever: Annotated[float, Field(ge=0, description="distance of the force from the axis, m; 0: a pure torque")] = 0.4
    cycles: Annotated[float, Field(gt=0, description="periods of a sine within the duration")] = 1.0

    def acts(self, time: np.ndarray) -> np.ndarray:
        """Return whether it acts at times [s], shape (n,)."""
        u = (time - self.start) / self.duration
        return (u >= 0) & (u < 1)

    def signal(self, time: np.ndarray, seed: int = 0) -> np.ndarray:
        """Return the torque [N·m] at times [s], shape (n,); `seed`: of the scenario, for a walk."""
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
        """A random walk from zero to unit standard deviation."""
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
        """Return the temperature [°C] at times [s], shape (n,)."""
        return self.end + (self.start - self.end) * np.exp(-time / self.time_constant)


class Scenario(Strict):
    """An experiment with a joint: mounting, motion, disturbances, sensors, filters, seed."""

    format: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Name of the run's folder."""
    description: str = ""
    """Purpose."""
    figure: Annotated[str, Field(description="the paper's figure that this reproduces")] = ""
    joint: Annotated[str, Field(description="a shipped joint's name or a path")] = "test-joint"
    known_joint: Annotated[str, Field(description="what the estimators know; the joint itself by default")] = ""
    plant: dict[str, float] = {}
    """Numbers of the plant that the estimators do not know, SI."""
    mounting: Annotated[str, Field(description="of the joint; its default where empty")] = ""
    link: Mounting | None = None
    """Payload of the output, instead of a mounting by its name."""
    duration: Annotated[float, Field(gt=0, description="s; an hour at most: a run is held in memory")]
    timestep: Annotated[float, Field(ge=1e-6, le=CONTROL_PERIOD, description="s")] = TIMESTEP
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Of every random stream."""
    locked_rotor: bool = False
    """Hold the rotor still; only the disturbances turn the output."""
    trajectory: Annotated[list[Waypoint], Field(min_length=1)]
    """Commanded positions of the link, or velocities, or torques: position, velocity or torque control."""
    start: float | None = None
    """Of the link, rad; position control starts at its first waypoint."""
    motions: list[AddedMotion] = []
    """Added to the trajectory."""
    disturbances: list[Disturbance] = []
    """Forces at the link."""
    payloads: list[CarriedMass] = []
    """Masses that the link picks up and puts down, in addition to its mounting."""
    known_payloads: bool = True
    """Whether the estimators and the recording know the payloads."""
    sensors: dict[str, Any] | Literal["realistic"] = {}
    """Changes to the joint's sensors, or `realistic`: realistic sensors, clock and drive; with changes to these:
    `{realistic: true, …}`."""
    current: Literal["command", "sensor"] = "command"
    """Motor current for the paper's filters: the drive's command, as in the paper, or the sensor's reading, as for all other
    estimators."""
    jitter: Annotated[float, Field(ge=0, lt=1e-3, description="of the time stamps, s rms")] = 0.0
    controller: Controller = Controller()
    """Of the drive; keys that it does not state are the joint's, if that has a `controller`."""
    feedback: Annotated[str, Field(description="filter whose estimate is fed back, `sensor`, or `none`")] = "none"
    temperature: Temperature = Temperature(start=REFERENCE_TEMPERATURE, end=REFERENCE_TEMPERATURE)
    """Of the gear, °C."""
    filters: list[FilterEntry] = Field(min_length=1, default_factory=paper_entries)
    """Estimators by name, or with a new name and tuning parameters."""
    record: list[str] = []
    """Sensors in the recording; by default those that the joint states."""
    transient: Annotated[float, Field(ge=0, description="s at the start that metrics leave out")] = 1.0
    _given: dict[str, Joint] = PrivateAttr(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _realistic(cls, given: Any) -> Any:
        """Set clock and drive for `sensors: realistic`, unless they are stated."""
        if isinstance(given, dict) and isinstance(given.get("trajectory"), dict):
            raise ValueError(
                "trajectory: expected a list of waypoints, got a mapping; a motion with `kind` is an entry of `motions`, which "
                "are added to it"
            )
        if not isinstance(given, dict) or not _are_realistic(given.get("sensors")):
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
        self._check_motion()
        if self.start is not None and self.mode == "position":
            raise ValueError("start: expected none in position control, which starts at its first waypoint")
        self._check_filters()
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

    def _check_motion(self) -> None:
        times = [w.time for w in self.trajectory]
        for i, (a, b) in enumerate(itertools.pairwise(times)):
            if b <= a:
                raise ValueError(f"trajectory.{i + 1}.time: expected a time after {a:g} s, got {b:g} s")
        for i, way in enumerate(self.trajectory):
            if way.mode != self.mode:
                raise ValueError(f"trajectory.{i}: expected a {self.mode}, as in the first waypoint, got a {way.mode}")
        for i, motion in enumerate(self.motions):
            fastest, limit = max(motion.frequency or 0.0, motion.end_frequency or 0.0), 0.5 / CONTROL_PERIOD
            if fastest > limit:
                raise ValueError(
                    f"motions.{i}: expected at most {limit:g} Hz, half the controller's rate, got {fastest:g} Hz"
                )
            if motion.start >= self.duration:
                raise ValueError(
                    f"motions.{i}.start: expected a time before the end at {self.duration:g} s, got {motion.start:g} s"
                )

    def _check_filters(self) -> None:
        names = [f.name for f in self.filters]
        for i, name in enumerate(names):
            if name in names[:i] or name in ("none", "sensor"):
                raise ValueError(f"filters.{i}.name: expected another name, got {name!r}")
        if self.feedback not in ("none", "sensor", *names):
            hint = nearest(self.feedback, names)
            raise ValueError(f"feedback: expected none, sensor or one of {names}, got {self.feedback!r}{hint}")
        if self.feedback in names and not self.filters[names.index(self.feedback)].build().causal:
            raise ValueError(
                f"feedback: expected a filter that can run in the loop, got {self.feedback!r}, which looks ahead"
            )
        if self.payloads and self.known_payloads and self.feedback in names:
            raise ValueError(
                f"known_payloads: expected false, as the filter that is fed back, {self.feedback}, does not know them in the loop"
            )

    @property
    def ticks(self) -> int:
        """Number of control ticks."""
        return round(self.duration / CONTROL_PERIOD)

    @property
    def time(self) -> np.ndarray:
        """Control ticks [s], shape (n,)."""
        return np.arange(self.ticks) * CONTROL_PERIOD

    @property
    def mode(self) -> Mode:
        """What the drive is commanded."""
        return self.trajectory[0].mode

    def commands(self, time: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the command of the drive, in the unit of its mode (`controller.MODES`), and its derivative, shape (n,) each, at
        all control ticks, or at increasing times [s]."""
        time = self.time if time is None else time
        command = np.full_like(time, self.trajectory[0].command)
        rate = np.zeros_like(time)
        for a, b in itertools.pairwise(self.trajectory):
            T, A = b.time - a.time, b.command - a.command
            u = np.clip((time - a.time) / T, 0, 1)
            inside = (time >= a.time) & (time < b.time)
            if b.profile == "linear":
                s, ds = u, np.ones_like(u)
            else:
                s, ds = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2
            command = np.where(time >= a.time, a.command + A * s, command)
            rate = np.where(inside, A * ds / T, rate)
        for motion in self.motions:
            further, its_rate = motion.signal(time, self.mode)
            command, rate = command + further, rate + its_rate
        return command, rate

    @property
    def happening(self) -> list[Disturbance]:
        """Disturbances that end before the scenario ends."""
        return [d for d in self.disturbances if d.start + d.duration <= self.duration]

    def external_torque(self) -> np.ndarray:
        """Return the torque of all disturbances on the link [N·m], shape (n,)."""
        time = self.time
        return sum((d.signal(time, self.seed) for d in self.disturbances), np.zeros_like(time))

    def tip_force(self) -> np.ndarray:
        """Return the tangential force of disturbances with a lever [N], shape (n,); positive pushes forward."""
        time = self.time
        forces = [d.signal(time, self.seed) / d.lever for d in self.disturbances if d.lever > 0.0]
        return sum(forces, np.zeros_like(time))

    @property
    def lever(self) -> float | None:
        """Common lever [m] of all forces, if the wrench is recorded to compare with; None otherwise."""
        levers = {d.lever for d in self.disturbances}
        compared = "force_x" in self.record and len(levers) == 1 and not self.payloads
        return levers.pop() or None if compared else None

    def estimators(self) -> dict[str, Estimator]:
        """Return its filters by name."""
        return {entry.name: entry.build() for entry in self.filters}

    @property
    def given_joints(self) -> dict[str, Joint]:
        """`Joint` objects that replace a name or path, by key."""
        return dict(self._given)

    def with_joints(self, joints: Mapping[str, Joint]) -> Self:
        """Return the scenario with `Joint` objects in place of names or paths; keys `joint`, `known_joint`."""
        copy = self.model_copy(update={key: one.name for key, one in joints.items()})
        copy._given = self._given | dict(joints)
        return copy

    def in_folder(self, folder: Path) -> Self:
        """Return the scenario with absolute paths of its motions' files, which were relative to a folder."""
        return self.model_copy(update={"motions": [motion.in_folder(folder) for motion in self.motions]})

    def load_joint(self, folder: Path | None = None) -> tuple[Joint, Joint]:
        """Return the plant's joint and the one that the estimators know, with the scenario's sensors."""

        def described(key: str) -> Joint:
            return self._with_sensors(self._given.get(key) or load_joint(getattr(self, key), folder))

        joint = described("joint")
        known = described("known_joint") if self.known_joint else joint
        if self.plant:
            numbers = dict(joint.numbers)
            for symbol, value in self.plant.items():
                numbers[symbol] = numbers[symbol].model_copy(update={"value": value})
            path, data = joint._path, joint.model_copy(update={"numbers": numbers}).model_dump()
            joint = parse(data, Joint, f"scenario {self.name}: plant")
            joint._path = path
        return joint, known

    def with_gains(self, joint: Joint) -> Self:
        """Return the scenario with the controller of its joint, changed by the keys that the scenario states."""
        if joint.controller is None:
            return self
        own = self.controller
        chosen = joint.controller.model_copy(update={key: getattr(own, key) for key in own.model_fields_set})
        if self.sensors_are_realistic and own == Controller().lagging(own.delay):  # not stated by anyone
            chosen = joint.controller if joint.controller.delay else joint.controller.lagging(own.delay)
        return self.model_copy(update={"controller": chosen})

    def mount(self, joint: Joint) -> Mounting:
        """Return the payload of a joint's output; `InputError` for an unknown mounting."""
        return joint.mount(self.mounting or None) if self.link is None else self.link

    @property
    def sensors_are_realistic(self) -> bool:
        """Whether `sensors` states realistic ones, with or without changes."""
        return _are_realistic(self.sensors)

    def _with_sensors(self, joint: Joint) -> Joint:
        if not self.sensors:
            return joint
        changes = {} if isinstance(self.sensors, str) else dict(self.sensors)
        if self.sensors_are_realistic:
            changes.pop("realistic", None)
            changes = _merge(realistic(joint), changes)
        merged = _merge(joint.sensors.model_dump(), changes)
        # A resolution in bits replaces one in counts, and the other way round.
        for name, change in changes.items():
            if isinstance(change, dict) and isinstance(merged.get(name), dict):
                for given, other in (("bits", "counts"), ("counts", "bits")):
                    if given in change and other not in change:
                        merged[name][other] = None
        sensors = parse(merged, Sensors, f"scenario {self.name}: sensors")
        return joint.model_copy(update={"sensors": sensors})


def _are_realistic(sensors: Any) -> bool:
    return sensors == "realistic" or (isinstance(sensors, dict) and sensors.get("realistic") is True)


def _merge(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(base.get(key), dict):
            merged[key] = _merge(base[key], value)
        else:
            merged[key] = value
    return merged


def shipped_scenarios() -> dict[str, Path]:
    """Return the scenarios that the package ships, by name."""
    return {path.stem: path for path in sorted(Path(__file__).parent.glob("*.yaml"))}


def shipped_arms() -> dict[str, Path]:
    """Return the scenarios of arms that the package ships, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "arms").glob("*.yaml"))}


def load_scenario(
    source: str | Path, changes: list[str] | None = None, seed: int | None = None
) -> tuple[Scenario, Path]:
    """Load a shipped scenario by its name, or a YAML file; return it with the folder of its file. `changes`:
    `key=value` with dotted keys (`filters.2.k=0.1`, `controller.kp=6`); `seed`: replaces the scenario's. Raises
    `InputError`: no such scenario, or one that is wrong."""
    data, path = read_scenario(source, changes, seed)
    if "arm" in data:
        raise InputError(
            f"{path}: arm: expected the scenario of a joint, got that of an arm: `flexspline run` takes one"
        )
    return parse_changed(data, Scenario, path, changes).in_folder(path.parent), path.parent


def parse_changed(data: dict[str, Any], model: type[M], path: Path, changes: list[str] | None) -> M:
    """Check the data of a scenario's file with changes; an error of a change names the change. Raises `InputError`:
    data that are wrong."""
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
        if key is None:  # a change contradicts the file
            raise InputError(f"{path} with --set {', '.join(keys)}: {line}") from error
        raise InputError(f"--set {key}: {rest if key == field else line}") from error


def read_scenario(
    source: str | Path, changes: list[str] | None = None, seed: int | None = None
) -> tuple[dict[str, Any], Path]:
    """Return the data of the file of a joint's or an arm's scenario with changes, unchecked, and its path."""
    path = find(source, shipped_scenarios() | shipped_arms(), "scenario")
    data = read_yaml(path, "a scenario")
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected a mapping of keys, got {kind_of(data)}")
    changes = changes or []
    _make_room(data, [change.partition("=")[0] for change in changes])
    for i, change in enumerate(changes):
        key, sign, text = change.partition("=")
        if not sign or not key:
            raise InputError(
                f"--set {change}: expected key=value, got no '='" if not sign else f"--set {change}: no key"
            )
        lost = next((before for before in changes[:i] if before.startswith(f"{key}.")), None)
        if lost is not None:
            raise InputError(f"--set {change}: it would discard --set {lost}: expected --set {key} first")
        put(data, key, _from_here(key, yaml_value(text)), f"--set {change}")
    if seed is not None:
        data["seed"] = seed
    return data, path


def changed(scenario: Scenario, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the data that a scenario states, with other values of dotted keys; defaults may depend on these. Raises
    `InputError`: an unknown key."""
    data = scenario.model_dump(mode="json", exclude_none=True, exclude_unset=True)
    put_all(data, changes, f"scenario {scenario.name}")
    return data


def stated(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario's data, of its controller only the keys that it states: the others may be the joint's."""
    data = scenario.model_dump(mode="json", exclude_none=True)
    return data | {"controller": scenario.controller.model_dump(exclude_unset=True)}


def put_all(data: dict[str, Any], changes: Mapping[str, Any], where: str) -> None:
    """Set dotted keys in place; `where`: start of messages."""
    _make_room(data, changes)
    for key, value in changes.items():
        put(data, key, _from_here(key, value), f"{where}: {key}")


def _make_room(data: dict[str, Any], keys: Collection[str]) -> None:
    """Remove a mounting whose link is among the changed keys, and the other way round, as a joint has one of them."""
    loads = {(m[1], m[2]) for key in keys if (m := re.fullmatch(r"(?:arm\.(\d+)\.)?(link|mounting)(?:\..*)?", key))}
    for place, name in loads:
        other, joint = {"link": "mounting", "mounting": "link"}[name], data
        if place is not None:
            arm = data.get("arm")
            joint = arm[int(place)] if isinstance(arm, list) and int(place) < len(arm) else {}
        if (place, other) not in loads and isinstance(joint, dict):
            joint.pop(other, None)


def _from_here(key: str, value: Any) -> Any:
    """Return a change's value; a path of a joint or model is relative to the current folder, not to the scenario's."""
    is_path = key == "model" or (key.rpartition(".")[2] in ("joint", "known_joint") and str(value).endswith(".yaml"))
    if is_path and Path(str(value)).is_file():
        return str(Path(str(value)).resolve())
    return str(value) if isinstance(value, Path) else value


def put(data: dict[str, Any], key: str, value: Any, where: str) -> None:
    """Set a dotted key inside a scenario's data, in place (`filters.2.k`, `sensors.link_encoder.noise`)."""
    *path, last = key.split(".")
    if len(path) > _DEEPEST:
        raise InputError(f"{where}: expected a key of at most {_DEEPEST} dots, got {len(path)}")
    if path[:1] == ["filters"] and "filters" not in data:
        data["filters"] = list(PAPER)
    if path[:1] == ["sensors"] and data.get("sensors") == "realistic":
        data["sensors"] = {"realistic": True}
    place: Any = data
    for part in path:
        if isinstance(place, list):
            item = _item(place, part, where)
            if isinstance(item, str):  # a filter that is given by its name
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
