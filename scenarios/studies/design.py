"""The design of a study: an ordered list of cells (a scenario at a point of the axes), each with every seed.

Every run's random streams derive from study seed, scenario and seed only: results do not depend on the order, and all points of
an axis have the same noise (pairing). Filters that only differ in their parameters share one simulation.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import zlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...estimator import registry
from ...estimator.estimator import Estimator, with_values
from ...models import causes, own_sensors
from ...models.controller import Controller
from ...models.errors import InputError
from ...models.files import parse
from ...sim import sensors
from ..evaluation import draws
from ..experiment import Experiment
from ..filters import FilterEntry
from ..scenario import Scenario, load_scenario, put, stated
from .study import CauseAxis, LoadAxis, ScaleAxis, SettingAxis, Study, ToleranceAxis, Value, points, varies


@dataclass(frozen=True)
class Cell:
    """A scenario at a point of the axes that concern the plant."""

    index: int  # its number
    scenario: str  # its name in the study
    columns: dict[str, Value]  # axis → value


@dataclass(frozen=True)
class Variant:
    """A filter with values of the axes that vary it: name, axis → value, and the estimator, named after both."""

    name: str
    columns: dict[str, Value]
    estimator: Estimator


@dataclass(frozen=True)
class Design:
    """A study with all its files loaded; it can be sent to other processes."""

    study: Study  # the study
    # name in the study → (data of the scenario with the study's changes, folder of its file)
    scenarios: dict[str, tuple[dict[str, Any], str]]
    digest: str  # hash of everything that determines the rows, without the seeds

    @classmethod
    def of(cls, study: Study, folder: Path = Path()) -> Design:
        """Load the scenarios, and check that every cell can run. Raises `InputError`: a wrong scenario, key, joint or
        cause."""
        scenarios = {}
        for choice in study.scenarios:
            local = folder / choice.scenario
            scenario, home = load_scenario(local if local.is_file() else choice.scenario)
            data = stated(scenario)
            feeding = [f for f in scenario.filters if f.name == scenario.feedback and f.name not in study.names]
            data["filters"] = [f.model_dump() for f in [*study.filters, *feeding]]
            for key, value in (study.set | choice.set).items():
                put(data, key, value, f"study {study.name}: set {key}")
            name = choice.name or scenario.name
            if name in scenarios:
                raise InputError(f"study {study.name}: scenarios: expected each name once, got {name!r} twice")
            scenarios[name] = (data, str(home.resolve()))
        design = cls(study, scenarios, "")
        return replace(design, digest=design._check())

    def _check(self) -> str:
        """Build the plant at every value of every axis, with the others at their first; return the digest of everything that
        determines the rows, including plugins."""
        seen: set[str] = set()
        for cell in self.cells:
            if not self._near_first(cell):
                continue
            experiment = self.experiment(cell)
            where = f"study {self.study.name}: scenario {cell.scenario}"
            feedback = experiment.scenario.feedback
            if feedback not in ("none", "sensor") and self.study.filter_axes:
                raise InputError(
                    f"{where}: feedback: expected none or sensor where an axis varies filters, which would act on the plant, "
                    f"got {feedback!r}"
                )
            for axis in self.study.axes:
                for cause in axis.causes if isinstance(axis, CauseAxis) else ():
                    if not causes.get(cause).concerns(experiment.joint):
                        raise InputError(f"{where}: cause {cause}: joint {experiment.joint.name} cannot have it")
                    seen.add(causes.origin(cause).state)
            seen.update(registry.origin(entry.estimator).state for entry in experiment.scenario.filters)
            seen.update(own_sensors.origin(name).state for name in own_sensors.names())
            experiment.build()
            for joint in (experiment.joint, experiment.known_joint):
                seen.add(hashlib.sha256(joint.mjcf.read_bytes()).hexdigest())
                unstated = {"controller"} if joint.controller is None else None
                seen.add(hashlib.sha256(joint.model_dump_json(exclude=unstated).encode()).hexdigest())
                seen.update(causes.origin(effect.name).state for effect in joint.effects)
        asked = self.study.model_dump(mode="json", exclude={"seeds", "description", "reference"})
        gains = Controller().model_dump()
        data = {name: data | {"controller": gains | data["controller"]} for name, (data, _) in self.scenarios.items()}
        text = json.dumps([asked, data, sorted(seen - {""})], sort_keys=True, ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def _near_first(self, cell: Cell) -> bool:
        """Whether a cell differs from the first point in at most one axis, which is not of causes."""
        away = 0
        for axis in self.study.plant_axes:
            off = any(cell.columns[name] != value for name, value in points(axis)[0].items())
            if off and isinstance(axis, CauseAxis):
                return False
            away += off
        return away <= 1

    @cached_property
    def cells(self) -> list[Cell]:
        """All cells in order."""
        axes = [points(axis) for axis in self.study.plant_axes]
        places = [(scenario, at) for scenario in self.scenarios for at in itertools.product(*axes)]
        return [
            Cell(i, scenario, {k: v for point in at for k, v in point.items()})
            for i, (scenario, at) in enumerate(places)
        ]

    @cached_property
    def variants(self) -> list[Variant]:
        """All variants of all filters, in order."""
        found = []
        for entry in self.study.filters:
            axes = [axis for axis in self.study.filter_axes if varies(axis, entry)]
            for values in itertools.product(*(axis.values for axis in axes)):
                columns = {axis.name: value for axis, value in zip(axes, values, strict=True)}
                found.append(Variant(entry.name, columns, _variant(entry, axes, columns)))
        return found

    @property
    def runs(self) -> int:
        """Number of simulations."""
        return len(self.cells) * len(self.study.seed_list)

    def key(self, cell: Cell, seed: int) -> str:
        """Return a unique key of one simulation."""
        return hashlib.sha256(f"{self.digest}/{cell.index}/{seed}".encode()).hexdigest()[:16]

    def experiment(self, cell: Cell) -> Experiment:
        """Return the cell's scenario, prepared for any seed."""
        data, folder = self.scenarios[cell.scenario]
        data, load = copy.deepcopy(data), None
        where = f"study {self.study.name}: scenario {cell.scenario}"
        for axis in self.study.plant_axes:
            value = cell.columns[axis.name]
            if isinstance(axis, LoadAxis):
                load = float(value)
            elif isinstance(axis, ScaleAxis):
                for key, base in axis.keys.items():
                    put(data, key, base * float(value), f"{where}: {axis.name}")
            elif isinstance(axis, SettingAxis):
                put(data, axis.key, value, f"{where}: {axis.name}")
        return Experiment.of(parse(data, Scenario, where), Path(folder), load)

    def noise_seed(self, cell: Cell, seed: int) -> int:
        """Return the seed of the sensors' noise of a run."""
        return _mixed(self.study.seed, zlib.crc32(cell.scenario.encode()), seed)

    def drawn(self, cell: Cell, seed: int, experiment: Experiment) -> tuple[Experiment, np.ndarray | None]:
        """Return a cell's experiment drawn with a seed, and the plant's record, shape (1,), if it was drawn, too.

        A joint within tolerance depends on study and seed only, motion and pushes also on the scenario.
        """
        scenario = draws.of_seed(experiment.scenario, self.noise_seed(cell, seed), self.study.vary)
        experiment = replace(experiment, scenario=scenario)
        if self.study.vary:
            command, rate = scenario.commands()
            experiment = replace(experiment, command=command, rate=rate, external_torque=scenario.external_torque())
        record = None
        for axis in self.study.axes:
            if isinstance(axis, ToleranceAxis):
                tolerance = float(cell.columns[axis.name])
                record = draws.drawn_record(experiment, _mixed(self.study.seed, seed), tolerance, axis.zero_known)
                experiment = replace(experiment, known=draws.known_within(experiment.known, tolerance, axis.zero_known))
        hidden = self.hidden(cell, seed, experiment.record if record is None else record)
        record = record if hidden is None else hidden
        return experiment if record is None else replace(experiment, record=record), record

    def hidden(self, cell: Cell, seed: int, record: np.ndarray) -> np.ndarray | None:
        """Return the plant's record with the cell's cause, shape (1,); None without a cause."""
        cause = str(cell.columns.get("cause", "none"))
        if cause == "none":
            return None
        axis = next(a for a in self.study.axes if isinstance(a, CauseAxis))
        hidden = record.copy()
        rng = sensors.stream(self.noise_seed(cell, seed), f"cause {cause}")
        one = causes.get(cause)
        one.apply(hidden[0], one.draw(hidden[0], rng, float(cell.columns[axis.name])))
        return hidden


def _mixed(*numbers: int) -> int:
    """Return one seed for several numbers."""
    words = np.random.SeedSequence(numbers).generate_state(2)
    return (int(words[0]) << 31) ^ int(words[1])


def _variant(entry: FilterEntry, axes: list[SettingAxis], columns: dict[str, Value]) -> Estimator:
    for axis in axes:
        entry = entry.varied(axis.parameter, columns[axis.name])
    label = "/".join([entry.name, *(f"{k}={v}" for k, v in columns.items())])
    return with_values(entry.build(), {"name": label})
