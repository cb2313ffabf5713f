"""The folder of a run: measurement, signals, estimates, metrics, and everything to run it again."""

from __future__ import annotations

import platform
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from ..estimator.estimator import KnownJoint, Posterior
from ..models import own_sensors
from ..models.errors import InputError
from ..models.files import load, write_json, yaml_text
from ..models.output import check_output, output_folder, recover
from ..models.recording import write_recording
from ..models.signals import READINGS, SENSED
from ..models.tables import read_table, write_table
from ..sim.loop import CONTROL_PERIOD, TRUTH, Simulation
from ..sim.sensors import time_stamps
from .experiment import with_known_payloads
from .run import Run
from .scenario import Scenario

View = Callable[[Run, Path], object]  # adds files to a run's folder: a function of run and folder
_UNITS = {
    "position": "rad", "velocity": "rad/s", "acceleration": "rad/s²", "current": "A", "torque": "N·m", "force": "N",
    "torque_rate": "N·m/s", "bristle": "rad", "dahl": "rad", "hysteresis": "rad", "torsion": "rad", "measurement": "N·m",
    "variance": "(N·m)²", "payload": "N·m", "payload_inertia": "kg·m²", "friction_error": "N·m",
}  # fmt: skip
"""Unit of a column by a part of its name; the longest part counts."""
_MAKER = "run"
_NEEDED = ("scenario.yaml", "signals.parquet", "estimates.parquet", "joint.yaml", "known_joint.yaml")


def save_run(run: Run, out: Path, views: Sequence[View] = (), within: Path | None = None) -> Path:
    """Write a run folder, as a whole or not at all; `views`: functions that add files; `within`: folder that must
    contain it.

    It has `<name>.parquet` with its YAML (a measurement), `signals.parquet`, `estimates.parquet`, `metrics.json`,
    `scenario.yaml` (resolved), `joint.yaml`, `known_joint.yaml`, `run.json` (versions, seed). Raises `InputError`: it
    cannot be written, or has files of something else.
    """
    with output_folder(out, _MAKER, whole=True, within=within) as folder:
        write_recording(run.as_recording(), folder)
        signals = signal_columns(run)
        write_table(folder / "signals.parquet", signals, {name: _unit_of(name) for name in signals})
        write_table(folder / "estimates.parquet", *_estimate_columns(run))
        write_json(folder / "metrics.json", run.metrics)
        run.joint.write(folder / "joint.yaml")
        run.known_joint.write(folder / "known_joint.yaml")
        data = run.scenario.model_dump(mode="json", exclude_none=True)
        data |= {"joint": "joint.yaml", "known_joint": "known_joint.yaml", "plant": {}, "sensors": {}}
        (folder / "scenario.yaml").write_text(yaml_text(data), encoding="utf-8")
        write_json(folder / "run.json", _provenance(run))
        for view in views:
            view(run, folder)
    return out


def check_run_folder(scenario: Scenario, source: Path, out: Path, within: Path) -> None:
    """Check before a run that its folder can be written. Raises `InputError`: it cannot, or has files of something else
    or files that are read."""
    joints = scenario.load_joint(source.parent)
    read = [source, *(path for joint in joints for path in (joint.path, joint.mjcf))]
    check_output(out, _MAKER, inputs=read, whole=True, within=within)


def load_run(folder: Path) -> Run:
    """Read a run folder; `InputError` for another folder."""
    recover(folder)
    for name in _NEEDED:
        if not (folder / name).is_file():
            raise InputError(f"{folder}: expected a run folder, found no {name}")
    scenario = load(folder / "scenario.yaml", Scenario, "a scenario")
    joint, known_joint = scenario.load_joint(folder)
    known = KnownJoint.of(known_joint, scenario.mount(known_joint))
    columns, _ = _read_numbers(folder / "signals.parquet")
    time = _column(columns, "time", folder)
    truth, readings = np.zeros(len(time), TRUTH), np.zeros(len(time), READINGS)
    for name in TRUTH.names or ():
        truth[name] = _column(columns, f"true_{name}", folder)
    for name in SENSED:
        readings[name] = _column(columns, name, folder)
    simulation = Simulation(
        time, truth, readings, _column(columns, "current_command", folder), (len(time), 0),
        time_stamps(time, scenario.jitter, scenario.seed), scenario.current == "command",
        {name: columns[name] for name in own_sensors.names() if name in columns},
    )  # fmt: skip
    simulation = with_known_payloads(simulation, scenario, scenario.mount(known_joint))
    command, external = (_column(columns, name, folder) for name in (f"{scenario.mode}_command", "external_torque"))
    return Run(
        scenario, joint, known_joint, known, simulation, _read_estimates(folder, scenario, time), command, external,
        raw=_column(columns, "model_torque", folder),
    )  # fmt: skip


def signal_columns(run: Run) -> dict[str, np.ndarray]:
    """Return every signal of a run by column name, shape (n,) each: time, commands, readings, `true_…`, raw model."""
    truth, readings = run.simulation.truth, run.simulation.readings
    return {
        "time": run.time,
        f"{run.scenario.mode}_command": run.command,
        "external_torque": run.external_torque,
        "current_command": run.simulation.command,
        **{name: readings[name] for name in SENSED},
        **{f"true_{name}": truth[name] for name in truth.dtype.names or ()},
        "model_torque": run.model_torque,
        **run.simulation.further,
    }


def _provenance(run: Run) -> dict[str, Any]:
    return {
        "format": 1,
        "scenario": run.name,
        "seed": run.scenario.seed,
        "timestep": run.scenario.timestep,
        "control_period": CONTROL_PERIOD,
        "versions": versions() | {"python": platform.python_version()},
    }


@cache
def versions() -> dict[str, str]:
    """Return the versions of the packages that determine the bits of a result."""
    return {name: metadata.version(name) for name in ("flexspline", "mujoco", "numpy", "scipy", "numba")}


def _unit_of(column: str) -> str:
    """Return the SI unit of a column by its name."""
    known = own_sensors.channel(column)
    if known is not None:
        return known.unit
    words = [word for word in _UNITS if word in column]
    return _UNITS[max(words, key=len)] if words else "1"


def _estimate_columns(run: Run) -> tuple[dict[str, np.ndarray], dict[str, str], dict[str, dict[str, str]]]:
    """Return columns `quantity_filter`, their units, and the filter and quantity of each."""
    columns, units, of = {"time": run.time}, {"time": "s"}, {}
    estimators = run.scenario.estimators()
    for name, found in run.estimates.items():
        own = estimators[name].innovation_unit
        for quantity, values in _quantities(found).items():
            column = f"{quantity}_{name}"
            columns[column], units[column] = values, _unit_of(quantity)
            if "innovation" in quantity:
                units[column] = own if "variance" not in quantity else f"({own})²" if "·" in own else f"{own}²"
            of[column] = {"filter": name, "quantity": quantity}
        if found.untrusted is not None:
            of[f"torque_{name}"]["untrusted"] = found.untrusted
        if found.nis is not None and "nis" not in found.columns:  # computed from the others
            columns[f"nis_{name}"], units[f"nis_{name}"] = found.nis, "1"
    return columns, units, of


def _quantities(found: Posterior) -> dict[str, np.ndarray]:
    """Return a posterior as columns, shape (n,) each."""
    columns = {"torque": found.mean}
    if found.variance is not None:
        columns["variance"] = found.variance
    if found.external is not None:
        columns["external_torque"] = found.external
    if found.robust is not None:
        columns["robust"] = found.robust.astype(np.float64)
    if found.innovation is not None and found.innovation_covariance is not None:
        m = found.innovation.shape[1]
        for i in range(m):
            columns[_numbered("innovation", m, i)] = found.innovation[:, i]
            for j in range(i + 1):
                columns[_numbered("innovation_variance", m, i, j)] = found.innovation_covariance[:, i, j]
    return {**columns, **found.columns}


def _numbered(quantity: str, m: int, *places: int) -> str:
    """Return the name of one of m components: without number if m is 1, else counted from 1."""
    return quantity if m == 1 else f"{quantity}_{'_'.join(str(i + 1) for i in sorted(set(places)))}"


def _read_numbers(path: Path) -> tuple[dict[str, np.ndarray], dict[str, dict[str, str]]]:
    columns, notes = read_table(path)
    for name, values in columns.items():
        if values.dtype.kind not in "fiub":
            raise InputError(f"{path}: column {name!r}: expected numbers, got something else")
    return columns, notes


def _read_estimates(folder: Path, scenario: Scenario, time: np.ndarray) -> dict[str, Posterior]:
    path = folder / "estimates.parquet"
    columns, notes = _read_numbers(path)
    if not np.array_equal(_column(columns, "time", folder), time):
        raise InputError(f"{path}: column 'time': expected that of signals.parquet, got another")
    by_filter: dict[str, dict[str, np.ndarray]] = {entry.name: {} for entry in scenario.filters}
    untrusted: dict[str, str] = {}
    for column, note in notes.items():
        if note.get("filter") in by_filter and "quantity" in note:
            by_filter[note["filter"]][note["quantity"]] = columns[column]
            if "untrusted" in note:
                untrusted[note["filter"]] = note["untrusted"]
    read = {name: _posterior(name, time, found, path) for name, found in by_filter.items()}
    return {name: replace(found, untrusted=untrusted.get(name)) for name, found in read.items()}


def _posterior(name: str, time: np.ndarray, found: dict[str, np.ndarray], path: Path) -> Posterior:
    m = sum(re.fullmatch(r"innovation(_\d+)?", quantity) is not None for quantity in found)
    innovations = [_numbered("innovation", m, i) for i in range(m)]
    pairs = {_numbered("innovation_variance", m, i, j): (i, j) for i in range(m) for j in range(i + 1)}
    for quantity in ("torque", *innovations, *pairs):
        if quantity not in found:
            raise InputError(f"{path}: column '{quantity}_{name}': missing")
    covariance, own = (
        np.zeros((len(time), m, m)),
        {"torque", "variance", "external_torque", "robust", *innovations, *pairs},
    )
    for column, (i, j) in pairs.items():
        covariance[:, i, j] = covariance[:, j, i] = found[column]
    return Posterior(
        name, time, found["torque"], found.get("variance"),
        np.column_stack([found[column] for column in innovations]) if m else None, covariance if m else None,
        found["robust"] > 0 if "robust" in found else None,
        {n: values for n, values in found.items() if n not in own}, found.get("external_torque"),
    )  # fmt: skip


def _column(columns: dict[str, np.ndarray], name: str, folder: Path) -> np.ndarray:
    if name not in columns:
        raise InputError(f"{folder}: column {name!r}: missing in its tables")
    return columns[name]
