"""Running a scenario, and the folder that holds a run."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from ..estimator import FilterDiverged, FilterSettings, filter_bank
from ..estimator.recursion import NOT_FINITE
from ..models.errors import InputError
from ..models.files import folder_into_place, load
from ..models.joint import Joint, Mounting
from ..sim import plant, sensors
from ..sim.recording import Recording, write_recording
from . import metrics as measures
from .loop import CONTROL_PERIOD, READINGS, TRUTH, Signals, simulate
from .scenario import Scenario

UNITS = {
    "time": "s", "position": "rad", "velocity": "rad/s", "current": "A", "torque": "N·m", "force": "N",
    "bristle": "rad", "innovation": "N·m", "variance": "(N·m)²",
}  # fmt: skip
_FASTEST = 1e5  # rad/s
STATE_COLUMNS = (
    "torque", "variance", "innovation", "innovation_variance", "unadjusted_innovation_variance",
    "innovation_memory_variance", "alpha", "f_alpha", "robust", "nis",
)  # fmt: skip
"""A torque filter's flat state by name, in the order of `estimator.recursion`."""


@dataclass(frozen=True)
class Run:
    """A scenario that has been run: what was asked, what came out.

    Attributes:
      scenario: resolved.
      joint, known: the plant's joint, and the one that the estimators know.
      settings: of the filters, in order.
      signals: everything that happened at the control instants.
    """

    scenario: Scenario
    joint: Joint
    known: Joint
    settings: tuple[FilterSettings, ...]
    signals: Signals

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.scenario.name

    @property
    def time(self) -> np.ndarray:
        """Control instants [s], shape (n,)."""
        return self.signals.time

    @property
    def filters(self) -> tuple[str, ...]:
        """Names of the filters."""
        return tuple(s.name for s in self.settings)

    @cached_property
    def position_command(self) -> np.ndarray:
        """Commanded link position [rad], shape (n,)."""
        return self.scenario.commands()[0]

    @cached_property
    def external_torque(self) -> np.ndarray:
        """Torque on the link [N·m], shape (n,)."""
        return self.scenario.external_torque()

    @property
    def model_torque(self) -> np.ndarray:
        """Raw compliance model [N·m], shape (n,)."""
        return self.signals.model_torque

    def truth(self, column: str) -> np.ndarray:
        """A true signal, one of `loop.TRUTH`, shape (n,)."""
        return self.signals.truth[:, TRUTH.index(column)]

    def reading(self, column: str) -> np.ndarray:
        """What a sensor gave, one of `loop.READINGS`, shape (n,)."""
        return self.signals.readings[:, READINGS.index(column)]

    def estimate(self, name: str) -> np.ndarray:
        """A filter's estimate of the joint torque [N·m], shape (n,)."""
        return self._filter(name, "torque")

    def innovation(self, name: str) -> np.ndarray:
        """A filter's innovation, Eq. (13) [N·m], shape (n,)."""
        return self._filter(name, "innovation")

    def innovation_variance(self, name: str) -> np.ndarray:
        """A filter's P_Y, Eq. (14) [(N·m)²], shape (n,)."""
        return self._filter(name, "innovation_variance")

    def robust(self, name: str) -> np.ndarray:
        """Whether a filter is in robust mode, Eq. (19), shape (n,) bool."""
        return self._filter(name, "robust") > 0

    def alpha(self, name: str) -> np.ndarray:
        """A filter's redundancy factor, Eq. (23), shape (n,)."""
        return self._filter(name, "alpha")

    def nis(self, name: str) -> np.ndarray:
        """A filter's normalised innovation squared, shape (n,)."""
        return self._filter(name, "nis")

    def _filter(self, name: str, column: str) -> np.ndarray:
        return self.signals.filters[:, self.filters.index(name), STATE_COLUMNS.index(column)]

    @cached_property
    def reference(self) -> measures.Reference:
        """What estimates of the joint torque are measured against."""
        return measures.Reference(
            self.truth("joint_torque"), self.reading("joint_torque"), self.model_torque, self.external_torque,
            CONTROL_PERIOD, self.scenario.transient,
        )  # fmt: skip

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """Measures of every filter, of the raw compliance model and of the torque sensor (`scenarios.metrics`)."""
        truth, reading, evaluate = self.truth("joint_torque"), self.reading("joint_torque"), self.reference.evaluate

        kept = self.time >= self.scenario.transient
        filters = {}
        for name in self.filters:
            filters[name] = {
                **evaluate(self.estimate(name)),
                "robust_share": float(np.mean(self.robust(name)[kept])),
                "mean_nis": float(np.mean(self.nis(name)[kept])),
            }
        error = self.position_command - self.truth("link_position")
        return {
            "scenario": self.name,
            "seed": self.scenario.seed,
            "filters": filters,
            "model": evaluate(self.model_torque),
            "sensor": evaluate(reading),
            "truth": {
                "response_ms": evaluate(truth)["response_ms"],
                "joint_torque_range": [float(truth[kept].min()), float(truth[kept].max())],
            },
            "position_error": {
                "rms": float(np.sqrt(np.mean(error[kept] ** 2))),
                "max": float(np.max(np.abs(error[kept]))),
                "unit": "rad",
            },
        }


@dataclass(frozen=True)
class Experiment:
    """A scenario made ready: everything that does not depend on seed or filters, to run it many times.

    Attributes:
      scenario: what to run.
      joint, known: the plant's joint, and the one that the estimators know.
      mounting: what is bolted to the plant's output.
      record, calibration: parameter records of the plant and of what the estimators know, shape (1,).
      position, velocity, external_torque: commands [rad], [rad/s] and torque on the link [N·m], shape (n,).
    """

    scenario: Scenario
    joint: Joint
    known: Joint
    mounting: Mounting
    record: np.ndarray
    calibration: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    external_torque: np.ndarray

    @classmethod
    def of(cls, scenario: Scenario, folder: Path | None = None, load: float | None = None) -> Experiment:
        """Read the joint and work out the commands.

        Args:
          scenario: what to run.
          folder: of the scenario's file, where a joint that it names by a relative path lies.
          load: gravity moment [N·m] at horizontal of what is bolted on, which the estimators know too, instead of the
            mounting's; the inertia changes in proportion.

        Raises:
          InputError: a joint or mounting that does not exist, or one without a gravity moment to change.
        """
        joint, known = scenario.load_joint(folder)
        mounting, known_mounting = (j.mount(scenario.mounting or None) for j in (joint, known))
        if load is not None:
            mounting, known_mounting = _loaded(mounting, load), _loaded(known_mounting, load)
        position, velocity = scenario.commands()
        return cls(
            scenario, joint, known, mounting, joint.record(mounting), known.record(known_mounting),
            position, velocity, scenario.external_torque(),
        )  # fmt: skip

    def build(self, record: np.ndarray | None = None) -> mujoco.MjModel:
        """The MuJoCo model of the plant, or of another plant, with effects hidden in its record."""
        return plant.build(
            self.joint,
            self.mounting,
            timestep=self.scenario.timestep,
            record=self.record if record is None else record,
            locked_rotor=self.scenario.locked_rotor,
        )

    def run(
        self,
        settings: Sequence[FilterSettings],
        seed: int | None = None,
        record: np.ndarray | None = None,
        model: mujoco.MjModel | None = None,
    ) -> Signals:
        """Run the closed loop; to the bit the same whoever else runs at the time.

        Args:
          settings: the filters.
          seed: of the sensors' noise; the scenario's by default.
          record, model: of another plant than the joint's own, both or none (`build`).

        Raises:
          InputError: torques under which the motion is no longer finite.
          FilterDiverged: a filter's estimate overflowed; names filter and time.
        """
        scenario, record = self.scenario, self.record if record is None else record
        p = record[0]
        signals = simulate(
            self.build(record) if model is None else model,
            record,
            self.calibration,
            self.position,
            self.velocity,
            self.external_torque,
            sensors.sensor_records(self.joint, float(p["link_delay"])),
            sensors.noise(scenario.seed if seed is None else seed, len(self.position)),
            scenario.controller.record(p, CONTROL_PERIOD, scenario.feedback != "none"),
            filter_bank(settings),
            np.array([s.P0 for s in settings]),
            feedback=_feedback(scenario, settings),
        )
        overloaded = _overload(signals)
        if overloaded is not None:
            raise InputError(
                f"scenario {scenario.name}: from {overloaded:.3f} s on the motion is not finite: expected torques and "
                "motions that the joint can bear, got a load beyond the wave generator's compliance, Eq. (5)"
            )
        which, status, tick = signals.failed
        if which >= 0:
            reason = (
                "the estimate is no longer a finite number" if status == NOT_FINITE else "the gain has no finite value"
            )
            raise FilterDiverged(settings[which].name, tick, signals.time[tick], reason)
        return signals


def _loaded(mounting: Mounting, load: float) -> Mounting:
    if mounting.gravity_moment == 0:
        raise InputError("load: expected a mounting with a gravity moment to change, got one without")
    share = load / mounting.gravity_moment
    return mounting.model_copy(update={"gravity_moment": load, "inertia": mounting.inertia * share})


def run_scenario(scenario: Scenario, folder: Path | None = None) -> Run:
    """Run a scenario.

    Args:
      scenario: what to run.
      folder: of the scenario's file, where a joint that it names by a relative path lies.

    Raises:
      InputError: a joint or mounting that does not exist; torques under which the motion is no longer finite.
      FilterDiverged: a filter's estimate overflowed; names filter and time.
    """
    experiment = Experiment.of(scenario, folder)
    settings = tuple(choice.settings() for choice in scenario.filters)
    return Run(scenario, experiment.joint, experiment.known, settings, experiment.run(settings))


def _overload(signals: Signals) -> float | None:
    """When [s] the plant's motion stopped being one: not finite, or faster than anything that turns."""
    theta = signals.truth[: signals.failed[2] + 1, :3]
    broken = ~np.isfinite(signals.truth[: signals.failed[2] + 1]).all(axis=1)
    broken[1:] |= ~(np.abs(np.diff(theta, axis=0)) < _FASTEST * CONTROL_PERIOD).all(axis=1)
    return float(signals.time[np.argmax(broken)]) if np.any(broken) else None


def _feedback(scenario: Scenario, settings: Sequence[FilterSettings]) -> int:
    if scenario.feedback == "none":
        return -1
    if scenario.feedback == "sensor":
        return -2
    return [s.name for s in settings].index(scenario.feedback)


def as_recording(run: Run) -> Recording:
    """What a person would have measured in this run."""
    mounting = run.joint.mount(run.scenario.mounting or None)
    pushed = bool(np.any(run.external_torque))
    return Recording(
        name=run.name,
        time=run.time,
        motor_position=run.reading("motor_position").copy(),
        link_position=run.reading("link_position").copy(),
        motor_current=run.reading("motor_current").copy(),
        joint_torque=run.reading("joint_torque").copy(),
        position_command=run.position_command,
        external_torque=run.external_torque if pushed else None,
        joint=run.joint.name,
        description=run.scenario.description,
        link=mounting,
        external="measured" if pushed else "none",
    )


def signal_columns(run: Run) -> dict[str, np.ndarray]:
    """Every signal of a run by column name: time, commands, readings, `true_…`, the raw compliance model."""
    columns = {
        "time": run.time,
        "position_command": run.position_command,
        "external_torque": run.external_torque,
        "current_command": run.signals.command,
    }
    columns |= {name: run.signals.readings[:, i] for i, name in enumerate(READINGS)}
    columns |= {f"true_{name}": run.signals.truth[:, i] for i, name in enumerate(TRUTH)}
    columns["model_torque"] = run.model_torque
    return columns


def unit_of(column: str) -> str:
    """SI unit of a column, by its name."""
    for word, unit in reversed(UNITS.items()):
        if word in column:
            return unit
    return "1"


def write_table(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Write columns as Parquet with their units in the metadata."""
    fields = [
        pa.field(name, pa.from_numpy_dtype(values.dtype), metadata={"unit": unit_of(name)})
        for name, values in columns.items()
    ]
    arrays = [pa.array(np.ascontiguousarray(values)) for values in columns.values()]
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), path, compression="zstd")


def save_run(run: Run, out: Path, extra: Sequence[Any] = ()) -> Path:
    """Write a run folder; nothing is left behind where that fails.

    Holds `recording.parquet` with its YAML (a measurement), `signals.parquet`, `estimates.parquet`, `metrics.json`,
    `scenario.yaml` (resolved), `joint.yaml`, `run.json` (versions, seed).

    Args:
      run: what to save.
      out: the folder.
      extra: functions of (run, folder) that add views.
    """
    with folder_into_place(out) as folder:
        write_recording(as_recording(run), folder)
        write_table(folder / "signals.parquet", signal_columns(run))
        estimates = {"time": run.time}
        for i, name in enumerate(run.filters):
            for j, column in enumerate(STATE_COLUMNS):
                estimates[f"{column}_{name}"] = run.signals.filters[:, i, j]
        write_table(folder / "estimates.parquet", estimates)
        (folder / "metrics.json").write_text(json.dumps(run.metrics, indent=1, ensure_ascii=False), encoding="utf-8")
        run.joint.write(folder / "joint.yaml")
        run.known.write(folder / "known_joint.yaml")
        data = run.scenario.model_dump(mode="json", exclude_none=True)
        data["joint"], data["known_joint"], data["plant"], data["sensors"] = "joint.yaml", "known_joint.yaml", {}, {}
        text = yaml.safe_dump(data, allow_unicode=True, sort_keys=False, width=120)
        (folder / "scenario.yaml").write_text(text, encoding="utf-8")
        (folder / "run.json").write_text(json.dumps(provenance(run), indent=1), encoding="utf-8")
        for view in extra:
            view(run, folder)
    return out


def provenance(run: Run) -> dict[str, Any]:
    """What a run depends on: seed, timestep, versions."""
    packages = ("flexspline", "mujoco", "numpy", "scipy", "numba")
    return {
        "scenario": run.name,
        "seed": run.scenario.seed,
        "timestep": run.scenario.timestep,
        "control_period": CONTROL_PERIOD,
        "versions": {name: metadata.version(name) for name in packages} | {"python": platform.python_version()},
    }


def _columns(path: Path) -> dict[str, np.ndarray]:
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: cannot read a run's signals: not a Parquet file") from error
    return {name: table[name].to_numpy() for name in table.column_names}


def load_run(folder: Path) -> Run:
    """Read a run folder back; `InputError` where it is none."""
    for name in ("scenario.yaml", "signals.parquet", "estimates.parquet", "joint.yaml"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: expected a run folder, found no {name}")
    scenario = load(folder / "scenario.yaml", Scenario, "a scenario")
    joint, known = scenario.load_joint(folder)
    column, estimates = (_columns(folder / f"{name}.parquet") for name in ("signals", "estimates"))
    names = [choice.name for choice in scenario.filters]
    filters = np.stack([np.stack([estimates[f"{c}_{name}"] for c in STATE_COLUMNS], axis=1) for name in names], axis=1)
    signals = Signals(
        time=column["time"],
        truth=np.stack([column[f"true_{name}"] for name in TRUTH], axis=1),
        readings=np.stack([column[name] for name in READINGS], axis=1),
        command=column["current_command"],
        model_torque=column["model_torque"],
        filters=filters,
        failed=(-1, 0, len(column["time"])),
    )
    return Run(scenario, joint, known, tuple(c.settings() for c in scenario.filters), signals)
