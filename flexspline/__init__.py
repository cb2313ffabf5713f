"""Joint torque with harmonic drives: simulate, estimate, compare, diagnose, plan, validate.

    import flexspline as fs

    run = fs.simulate("external_push", duration=20)                     # a scenario in the closed loop
    fs.compare(["link_sweep", "external_push"], ["RAREKF", "dynamics_ekf"])   # estimators on the same signals, a table
    fs.estimate("recording.parquet")                                    # joint torque of a measurement, a table over time
    fs.diagnose("measurement/").causes                                  # why it differs from the description
    fs.plan("measurement/").sentences()                                 # what to measure next
    fs.validate("measurement/", joint="extended.yaml")                  # how well a description predicts it
    fs.check("measurement/"), fs.tune("link_sweep", ["RAREKF"]), fs.contact(), fs.sweep("noise_and_load", "sweep")

SI units; torques [N·m] on the output side. Unusable input raises `InputError`, a `ValueError` with one line. Everything is
imported when it is first used.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.util
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

if sys.version_info < (3, 11):  # noqa: UP036 - the sources may be used without an installation
    raise ImportError("flexspline needs Python 3.11 or newer, got %d.%d" % sys.version_info[:2])  # noqa: UP031

if TYPE_CHECKING:
    import pandas as pd

    from .diagnosis.answer import Diagnosis
    from .diagnosis.check import Check
    from .diagnosis.planning import Plan
    from .diagnosis.validate import Validation
    from .estimator.estimator import Estimator, Posterior
    from .models.errors import FilterDiverged, InputError
    from .models.joint import Joint, load_joint
    from .models.recording import Measurement, Recording
    from .scenarios.arms.arm_scenario import ArmScenario
    from .scenarios.evaluation.contact import ContactStudy
    from .scenarios.evaluation.tuning import Tuning
    from .scenarios.run import Run
    from .scenarios.scenario import Scenario
    from .scenarios.studies.statistics import Swept
    from .sim.attach import Attached, align, attach

Measured: TypeAlias = "str | Path | Recording | Measurement | Run | Sequence[Recording | Run]"
"""A recording, a run, several of them, or the path of a recording or of a folder of several."""

__version__ = "0.1.0"

_ELSEWHERE = {
    "ArmScenario": "scenarios.arms.arm_scenario",
    "Attached": "sim.attach",
    "Check": "diagnosis.check",
    "ContactStudy": "scenarios.evaluation.contact",
    "Diagnosis": "diagnosis.diagnose",
    "Estimator": "estimator.estimator",
    "FilterDiverged": "models.errors",
    "InputError": "models.errors",
    "Joint": "models.joint",
    "Measurement": "models.recording",
    "Plan": "diagnosis.planning",
    "Posterior": "estimator.estimator",
    "Recording": "models.recording",
    "Run": "scenarios.run",
    "Scenario": "scenarios.scenario",
    "Swept": "scenarios.studies.statistics",
    "Tuning": "scenarios.evaluation.tuning",
    "Validation": "diagnosis.validate",
    "align": "sim.attach",
    "attach": "sim.attach",
    "load_joint": "models.joint",
}
__all__ = [
    "ArmScenario", "Attached", "Check", "ContactStudy", "Diagnosis", "Estimator", "FilterDiverged", "InputError", "Joint",
    "Measurement", "Plan", "Posterior", "Recording", "Run", "Scenario", "Swept", "Tuning", "Validation", "__version__", "align",
    "attach", "causes", "check", "compare", "contact", "diagnose", "estimate", "estimators", "import_log", "joints", "load_joint",
    "load_plugin", "load_recording", "plan", "report", "simulate", "simulate_arm", "sweep", "tune", "validate",
]  # fmt: skip
_EXPERIMENTS = ("no_load", "link_sweep", "external_push")


def __getattr__(name: str) -> Any:
    if name not in _ELSEWHERE:
        from .models.errors import nearest

        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{nearest(name, __all__)}")
    found = getattr(importlib.import_module(f"{__name__}.{_ELSEWHERE[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _WithMujoco(importlib.abc.MetaPathFinder):
    """Registers the plugin `flexspline.joint` as soon as MuJoCo is imported, so that models with it compile."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> Any:
        if fullname != "mujoco":
            return None
        sys.meta_path.remove(self)
        spec: Any = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def exec_module(module: Any) -> None:
                execute(module)
                _register()

            spec.loader.exec_module = exec_module
        return spec


def _register() -> None:
    from .sim.plugin import register

    try:
        register()
    except (RuntimeError, OSError) as error:  # a MuJoCo of another layout works without the plugin
        import warnings

        warnings.warn(f"MuJoCo's plugin flexspline.joint is not available: {error}", RuntimeWarning, stacklevel=3)


if "mujoco" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _WithMujoco())


def load_recording(source: str | Path) -> Recording:
    """Load a recording: a table (`.parquet`, `.csv`) with a YAML file of the same name.

    Args:
      source: path of the table or of its YAML file.

    Returns:
      The recording: `time`, shape (n,) [s], and channels by name, shape (n,) each, SI: `recording["motor_position"]` [rad, motor
      side], `["link_position"]` [rad], `["motor_current"]` [A], `["joint_torque"]` [N·m], … (`models.signals.CHANNELS`).

    Raises:
      InputError: a file that is missing or wrong; names file, column and row.
    """
    from .models.recording import read_recording

    return read_recording(source)


def import_log(
    layout: str | Path, log: str | Path, joint: str | Path | None = None, name: str | None = None
) -> Recording:
    """Read another program's log as a recording, by a mapping of its columns (docs/importing.md).

    Args:
      layout: name of a shipped mapping (`lara8`, `ur3e`, `ur3e_rtde`), or path of a mapping file.
      log: path of the log: CSV, Parquet, JSON, npz, mat, HDF5, xlsx, MCAP, a ROS bag, or a folder.
      joint: name or path of the joint's description; by default the one that the mapping names.
      name: of the recording; by default the log's.

    Returns:
      The recording, as of `load_recording`.

    Raises:
      InputError: a mapping or log that is wrong; names file, column and row.
    """
    from dataclasses import replace

    from .diagnosis.data.importing import import_recording, load_layout
    from .models.joint import known_joints

    read = import_recording(load_layout(layout), log, name, None if joint is None else str(joint))
    relative = Path(layout).parent / read.joint
    if joint is None and read.joint.replace("_", "-") not in known_joints() and relative.is_file():
        return replace(read, joint=str(relative.resolve()))
    return read


def simulate(scenario: str | Path | Scenario, seed: int | None = None, **changes: Any) -> Run:
    """Run a scenario: the joint in MuJoCo under its position controller, its sensors, and the scenario's filters.

    Args:
      scenario: name of a shipped scenario (`no_load`, `link_sweep`, `external_push`, …), path of a YAML file, or a `Scenario`.
      seed: of every random stream, instead of the scenario's.
      changes: keys of the scenario with other values, SI: `duration=20` [s], `filters=["RAREKF", "dynamics_ekf"]`,
        `temperature=40` [°C]. Two underscores replace a dot: `controller__kp=6` [A/rad]. `joint` and `known_joint` may be a
        `Joint`.

    Returns:
      The run over n control ticks: `run.truth("joint_torque")` and `run.reading("motor_current")`, shape (n,), SI;
      `run.estimates["RAREKF"]`, a `Posterior`; `run.metrics`; `run.as_recording()`.

    Raises:
      InputError: a scenario, joint or key that is wrong; torques with which the motion is no longer finite.
      FilterDiverged: an estimate that is no longer finite.
    """
    from .scenarios.run import run_scenario

    return run_scenario(*_scenario(scenario, seed, changes), threads=_cores())


def simulate_arm(scenario: str | Path | ArmScenario, seed: int | None = None, **changes: Any) -> dict[str, Run]:
    """Run a scenario of joints in one plant, in series or on an MJCF's or URDF's hinges; each has its own controller, sensors
    and filters.

    Args:
      scenario: name of a shipped scenario (`two_joints`), path of a YAML file, or an `ArmScenario`.
      seed: of every random stream, instead of the scenario's.
      changes: as of `simulate`, joints counted from the base: `arm__0__length=0.5` [m], `arm__1__joint=found.extended`.

    Returns:
      A run of every joint by its name, from the base to the tip, as of `simulate`. Its recording includes the load by the other
      joints' motion.

    Raises:
      InputError, FilterDiverged: as `simulate`.
    """
    from .scenarios.arms.arm_run import run_arm
    from .scenarios.arms.arm_scenario import ArmScenario, changed_arm, load_arm

    dotted, given = _changes(changes)
    if isinstance(scenario, ArmScenario):
        found, folder = changed_arm(scenario, dotted, seed), None
    else:
        found, folder = load_arm(scenario, seed, dotted)
    return run_arm(found.with_joints(given), folder, threads=_cores())


def estimate(
    data: str | Path | Recording | Run, joint: str | Path | Joint | None = None, estimators: Iterable[str] = ()
) -> pd.DataFrame:
    """Estimate the joint torque of a recording without reading its torque sensor.

    Args:
      data: a recording or its path; or a run, whose sensors are read.
      joint: description for the estimators; by default the one that the recording names, or the run's `known_joint`.
      estimators: names; by default all that find their channels in the recording.

    Returns:
      A table, n rows: index `time` [s], a column per estimator, joint torque [N·m] as the joint's torque sensor would read it;
      NaN in parts of less than ten samples between gaps. `attrs["left_out"]` gives the missing estimators with the reason.

    Raises:
      InputError: an unknown estimator, or a named one that lacks a channel; a joint or recording that is wrong; a mistake in the
        data that makes estimates meaningless.
    """
    import pandas as pd

    from .diagnosis.data.mistakes import require_sound
    from .estimator import registry
    from .estimator.offline import estimate_recording
    from .models.errors import InputError

    named = tuple(_names(estimators))
    for name in named:
        registry.get(name)
    measurement, described = _measured(load_recording(data) if isinstance(data, (str, Path)) else data, joint)
    if len(measurement.recordings) != 1:
        raise InputError(f"data: expected one recording or run, got {len(measurement.recordings)}")
    measurement, _ = require_sound(measurement, described)
    found = estimate_recording(measurement.recordings[0], described, named or None)
    for name in named:
        if name in found.left_out:
            raise InputError(f"estimator {name!r}: {found.left_out[name]}")
    table = pd.DataFrame(dict(found.torque), index=pd.Index(found.time, name="time [s]"))
    table.attrs |= {"unit": "N·m", "left_out": found.left_out}
    return table


def compare(
    scenarios: str | Path | Scenario | Sequence[str | Path | Scenario] = _EXPERIMENTS,
    estimators: Iterable[str] = (),
    seed: int | None = None,
    **changes: Any,
) -> pd.DataFrame:
    """Compare estimators on identical signals.

    Args:
      scenarios: one or several; by default the paper's three experiments.
      estimators: names; by default the scenarios' own filters.
      seed, changes: as of `simulate`.

    Returns:
      A table with index (scenario, filter) and the metrics of `scenarios.evaluation.metrics` after the transient: `rms`, `max`
      and `noise` of the error against the true joint torque, `rms_to_sensor` [N·m], `noise_ratio` to the raw compliance
      model's [1], `delay_ms` and `response_ms` [ms], `missed` and `robust_share` [1], `mean_nis` [1]; NaN where one is not
      defined.

    Raises:
      InputError, FilterDiverged: as `simulate`.
    """
    from concurrent.futures import ThreadPoolExecutor

    import pandas as pd

    from .scenarios.run import run_scenario

    named = _names(estimators)
    asked = _several(scenarios, seed, changes | ({"filters": named} if named else {}))
    with ThreadPoolExecutor(_cores()) as pool:
        runs = list(pool.map(lambda one: run_scenario(*one), asked))
    rows = {(run.name, name): values for run in runs for name, values in run.metrics["filters"].items()}
    table = pd.DataFrame.from_dict(rows, orient="index", dtype=float)
    table.index = pd.MultiIndex.from_tuples(rows, names=["scenario", "filter"])
    return table


def tune(
    scenarios: str | Path | Scenario | Sequence[str | Path | Scenario],
    estimators: Iterable[str] = (),
    train: Iterable[int] = range(1, 6),
    test: Iterable[int] = range(101, 111),
    evaluations: int = 300,
    fronts: bool = False,
    **changes: Any,
) -> Tuning:
    """Tune estimators for the RMS error on training seeds, and evaluate them on test seeds.

    Args:
      scenarios: one or several; one tuning serves all of them, by the geometric mean of their errors.
      estimators: names; by default all of them, which takes hours.
      train, test: seeds; start, pace and pushes are drawn with each.
      evaluations: settings to try per estimator; a tenth for estimators that simulate the joint.
      fronts: whether to sweep noise against delay, if a scenario has pushes.
      changes: as of `simulate`.

    Returns:
      `tuned`, by name: parameters, RMS errors on the test seeds, shape (scenarios, seeds) [N·m], before and after. `filters` for
      a scenario. `fronts` of noise [N·m] against delay [ms]. `write("tuned.yaml")`.

    Raises:
      InputError: an unknown scenario or estimator; a seed in both `train` and `test`; a scenario with an estimate fed back.
    """
    from .scenarios.evaluation.tuning import tune_all
    from .scenarios.filters import estimators as registered

    chosen = registered(_names(estimators))
    asked, seeds = _several(scenarios, None, changes), (list(train), list(test))
    return tune_all(chosen, asked, *seeds, evaluations=evaluations, fronts=fronts, threads=_cores())


def contact(
    scenario: str | Path | Scenario = "collision",
    estimators: Iterable[str] = (),
    hours: float = 1.0,
    tolerances: Sequence[float] = (0.0, 1.0),
    rate: float = 10.0,
    **changes: Any,
) -> ContactStudy:
    """Detect collisions by each estimator's external torque: false alarms, delay, smallest push found.

    Args:
      scenario: with the motion; as of `simulate`.
      estimators: names of causal ones; by default a few fast ones. The torque sensor is added.
      hours: time without contact [h]; half of it gives the thresholds, the other half the false alarms.
      tolerances: shares of the joint's tolerances within which joints are drawn; 0: known exactly.
      rate: false alarms per hour at which detectors are compared.
      changes: as of `simulate`.

    Returns:
      `detectors`, a row each: `smallest_push` [N·m], `delay` [s], `threshold` [N·m], `false_alarms_per_hour`, `found_of_large`
      [1], with 95 % intervals; `curves`, the same over the threshold.

    Raises:
      InputError: an estimator that looks ahead; a scenario without room for a push; too few hours for the rate.
    """
    from .scenarios.evaluation.contact import DEFAULT, study
    from .scenarios.filters import estimators as registered

    chosen = registered(_names(estimators) or DEFAULT)
    return study(*_scenario(scenario, None, changes), chosen, hours, tuple(tolerances), rate, _cores())


def sweep(
    study: str | Path | Mapping[str, Any],
    out: str | Path,
    seeds: int | None = None,
    figures: bool = True,
    chunk: int | None = None,
    scheduler: str | None = None,
) -> Swept:
    """Sweep a study into a folder: seeds × parameters × scenarios × filters. An interrupted sweep continues when called again.

    Args:
      study: name of a shipped study, path of a YAML file, or its content.
      out: folder for the rows (partitioned Parquet), `summary.md`, `summary.csv`, the worst runs and figures.
      seeds: number of seeds, instead of the study's.
      figures: whether to draw them.
      chunk: runs per file; the rows do not depend on it.
      scheduler: address of a Dask scheduler, `tcp://…`, to compute on its workers.

    Returns:
      `table()`: means over seeds with 95 % intervals, and differences paired over seeds, in the metrics' units (`compare`);
      `aggregates`; `worst`, the worst run of every scenario.

    Raises:
      InputError: a wrong study; a folder with other content; no such scheduler.
    """
    from .commands.sweep import write_summary
    from .models.output import check_output
    from .scenarios.studies.statistics import open_study, summarise
    from .scenarios.studies.sweep import sweep as compute

    dataset = open_study(study, Path(out), seeds)
    check_output(Path(out), "sweep", writes=("summary.csv", "summary.md"))
    compute(dataset.design, dataset, _cores(), chunk, scheduler)
    found = summarise(dataset)
    write_summary(found, figures)
    return found


def check(measurement: Measured, joint: str | Path | Joint | None = None) -> Check:
    """Check a measurement: contents, mistakes in it, missing channels, and the causes that it can show.

    Args:
      measurement, joint: as of `diagnose`.

    Returns:
      `mistakes` with corrections and confidence; `corrected`, the measurement without them; `recordings`: rates [Hz], gaps [s]
      and ranges of channels, SI; `missing` channels; `can_show` and `undetermined` causes; `regressions`; `to_json()`.

    Raises:
      InputError: a measurement or joint that is wrong; names file, column and row.
    """
    from .diagnosis.check import check as check_measurement

    return check_measurement(*_with_gaps(measurement, joint))


def diagnose(
    measurement: Measured, joint: str | Path | Joint | None = None, seconds: float = float("inf")
) -> Diagnosis:
    """Diagnose why a measurement differs from a joint's description.

    Args:
      measurement: a recording or a folder of several of the same joint, or its path; or one or several runs.
      joint: description; by default the one that the recordings name, or the run's `known_joint`.
      seconds: time after which no further stage begins [s].

    Returns:
      The diagnosis: `verdict`; `causes` with parameters, standard deviations and confidence; `calibration`; `confusable` and
      `undetermined` causes; residuals before and after; `extended`, the joint with the causes in it.

    Raises:
      InputError: a measurement or joint that is wrong; names file, column and row.
    """
    from .diagnosis.diagnose import diagnose as diagnose_measurement

    return diagnose_measurement(*_with_gaps(measurement, joint), seconds=seconds)


def plan(measurement: Measured, joint: str | Path | Joint | None = None, diagnosis: Diagnosis | None = None) -> Plan:
    """Find out what to measure next: candidate experiments are simulated, and their information on open questions computed.

    Args:
      measurement, joint: as of `diagnose`.
      diagnosis: of that measurement with that joint; by default a short one, as of `flexspline plan`.

    Returns:
      The plan: open `questions`; `proposals`, the most informative first, with `duration` [s]; `sentences()` for people.

    Raises:
      InputError: as `diagnose`; a measurement for which nothing can be planned.
    """
    from .diagnosis.planning import plan as plan_measurement
    from .diagnosis.proposals import plan_from

    data, described = _with_gaps(measurement, joint)
    return plan_from(data, described) if diagnosis is None else plan_measurement(data, diagnosis)


def report(folders: str | Path | Sequence[str | Path], out: str | Path = "report.html") -> Path:
    """Write one self-contained HTML page of results that a command or `sweep` wrote.

    Args:
      folders: folder of a run, an arm's run, a comparison, a diagnosis, a validation, a sweep or contact; or the folders of two
        diagnoses of a joint, before and after.
      out: the page; only a page of this program is replaced.

    Returns:
      Path of the page.

    Raises:
      InputError: a folder with other content; another file in place of the page.
    """
    from .commands.report import write_page

    several = [folders] if isinstance(folders, (str, Path)) else folders
    write_page([Path(one) for one in several], Path(out))
    return Path(out)


def validate(measurement: Measured, joint: str | Path | Joint | None = None) -> Validation:
    """Compare a measurement with the prediction of a joint's description; nothing is fitted.

    Args:
      measurement, joint: as of `diagnose`.

    Returns:
      Errors of every channel in its unit: RMS, and the sensor's noise; also by region of angle, speed, load and direction.

    Raises:
      InputError: as `diagnose`.
    """
    from .diagnosis.validate import validate as validate_measurement

    return validate_measurement(*_measured(measurement, joint))


def estimators() -> pd.DataFrame:
    """List the estimators: this package's, and those of installed packages and of files (`load_plugin`).

    Returns:
      A table with index `estimator`: `causal` (whether it can run in the loop), `needs` (channels), `tuning` (parameters),
      `description`, `source` (package or file).

    Raises:
      InputError: an estimator of a plugin that cannot be loaded.
    """
    from .estimator import registry

    rows = {}
    for name in registry.names():
        one = registry.get(name)
        rows[name] = {
            "causal": one.causal,
            "needs": ", ".join(one.needs),
            "tuning": ", ".join(parameter.field for parameter in one.tuning),
            "description": one.description,
            "source": registry.origin(name).name,
        }
    return _table(rows, "estimator")


def causes() -> pd.DataFrame:
    """List the causes that a diagnosis can name: this package's, and those of installed packages and of files.

    Returns:
      A table with index `cause`: `component` (motor, transmission, link, sensor), `parameters` with units, `description`,
      `source` (package or file).

    Raises:
      InputError: a cause of a plugin that cannot be loaded.
    """
    from .models import causes as library

    rows = {}
    for name in library.names():
        one = library.get(name)
        rows[name] = {
            "component": one.component,
            "parameters": ", ".join(f"{p.name} [{p.unit}]" for p in one.parameters),
            "description": one.description,
            "source": library.origin(name).name,
        }
    return _table(rows, "cause")


def load_plugin(path: str | Path) -> tuple[str, ...]:
    """Register a file's estimators and causes, for this process and its child processes.

    Those of installed packages (entry points `flexspline.estimators`, `flexspline.causes`) are registered by themselves.

    Args:
      path: of a Python file with a tuple `ESTIMATORS`, `CAUSES` or both.

    Returns:
      Their names.

    Raises:
      InputError: a file that is missing, cannot be imported or defines neither; a name that exists already.
    """
    from .estimator import registry
    from .models import plugins

    found = plugins.load(path)
    try:
        registry.check(found)
    except Exception:
        plugins.forget(path)
        raise
    return found


def joints() -> pd.DataFrame:
    """List the joints that the package ships.

    Returns:
      A table with index `joint`: `ratio` of the gear [1], `rated_torque` [N·m], `mountings`, `description`, `path` of its file.

    Raises:
      InputError: a shipped description that is wrong.
    """
    from .models.joint import known_joints, load_joint

    rows = {}
    for name, path in known_joints().items():
        one = load_joint(name)
        rows[name] = {
            "ratio": one.numbers["N"].value,
            "rated_torque": one.numbers["rated_torque"].value,
            "mountings": ", ".join(one.mountings),
            "description": " ".join(one.description.split()),
            "path": str(path),
        }
    return _table(rows, "joint")


def _table(rows: dict[str, dict[str, Any]], index: str) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(index)


def _cores() -> int:
    import os

    return os.cpu_count() or 1


def _names(given: Iterable[str]) -> list[str]:
    return [given] if isinstance(given, str) else list(given)


def _several(
    scenarios: str | Path | Scenario | Sequence[str | Path | Scenario], seed: int | None, changes: Mapping[str, Any]
) -> list[tuple[Scenario, Path | None]]:
    """Scenarios with changes, each of another name, with the folders of their files."""
    from .models.errors import check_each_once

    several = [scenarios] if isinstance(scenarios, str) or not isinstance(scenarios, Sequence) else scenarios
    asked = [_scenario(one, seed, changes) for one in several]
    check_each_once([scenario.name for scenario, _ in asked], "scenarios")
    return asked


def _scenario(
    source: str | Path | Scenario, seed: int | None, changes: Mapping[str, Any]
) -> tuple[Scenario, Path | None]:
    """A scenario with changes, and the folder of its file."""
    from .models.files import parse
    from .scenarios.scenario import Scenario, changed, load_scenario

    found, folder = (source, None) if isinstance(source, Scenario) else load_scenario(source)
    dotted, given = _changes(changes)
    if seed is not None:
        dotted["seed"] = seed
    if not dotted:
        return found, folder
    kept = {key: one for key, one in found.given_joints.items() if key not in dotted}
    return parse(changed(found, dotted), Scenario, f"scenario {found.name}").with_joints(kept | given), folder


def _changes(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Joint]]:
    """Changes by dotted key, with names in place of `Joint` objects; and these objects."""
    from .models.joint import Joint

    dotted = {key.replace("__", "."): value for key, value in given.items()}
    joints = {
        key: value
        for key, value in dotted.items()
        if isinstance(value, Joint) and key.rpartition(".")[2] in ("joint", "known_joint")
    }
    return dotted | {key: one.name for key, one in joints.items()}, joints


def _with_gaps(given: Measured, joint: str | Path | Joint | None) -> tuple[Measurement, Joint]:
    """A measurement, split where samples are missing, and its joint; a warning for each split."""
    import warnings

    from .diagnosis.data.samples import parted
    from .models.errors import InputWarning

    data, described = _measured(given, joint)
    data, messages = parted(data, described)
    for text in messages:
        warnings.warn(text, InputWarning, stacklevel=3)
    return data, described


def _measured(given: Measured, joint: str | Path | Joint | None) -> tuple[Measurement, Joint]:
    """A measurement, and the description to compare it with."""
    from .models.errors import InputError
    from .models.joint import Joint
    from .models.recording import Measurement, Recording, read_measurement
    from .scenarios.run import Run

    known = None
    if isinstance(given, Measurement):
        data = given
    elif isinstance(given, (str, Path)):
        data = read_measurement(given)
    else:
        several = [given] if isinstance(given, (Recording, Run)) or not isinstance(given, Iterable) else list(given)
        for one in several:
            if not isinstance(one, (Recording, Run)):
                raise InputError(f"measurement: expected a path, recordings or runs, got {type(one).__name__}")
        if not several:
            raise InputError("measurement: expected recordings or runs, got none")
        known = next((one.known_joint for one in several if isinstance(one, Run)), None)
        recordings = tuple(one.as_recording() if isinstance(one, Run) else one for one in several)
        data = Measurement(recordings[0].name, Path(recordings[0].source or "."), recordings)
    if isinstance(joint, Joint):
        return data, joint
    if joint is None and known is not None:
        return data, known
    if joint is not None and not isinstance(joint, (str, Path)):
        raise InputError(f"joint: expected a joint's name, a path or a Joint, got {type(joint).__name__}")
    return data, data.load_joint(joint)
