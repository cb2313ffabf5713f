"""Estimators over the signals of a run that is over: the paper's filters and the baselines behind one interface.

A scenario without torque feedback moves the same whatever the filters are, so its signals are made once and every filter,
with any settings, is run over them: to the bit what it would have said in the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..estimator import FilterSettings, baselines
from ..estimator import run as run_filter
from ..estimator.baselines import Estimator, JointSignals, SensorNoise, TorqueEstimate
from ..estimator.baselines.joint_dynamics import SIZE
from ..estimator.baselines.joint_dynamics import STATES as JOINT_STATES
from ..estimator.knobs import Knob, turned, value_of
from ..estimator.settings import knobs_of
from ..models.errors import InputError, nearest
from ..models.joint import Joint
from .run import Run, run_scenario
from .scenario import PAPER_FILTERS, Scenario


def joint_signals(run: Run) -> JointSignals:
    """What an estimator may read of a run: encoders, current, and the current command."""
    readings = (run.reading(name) for name in ("motor_position", "link_position", "motor_current"))
    return JointSignals(run.time, *readings, run.signals.command)


def sensor_noise(joint: Joint) -> SensorNoise:
    """Resolution and noise of a joint's sensors."""
    s = joint.sensors
    return SensorNoise(
        s.motor_encoder.resolution, s.motor_encoder.noise, s.link_encoder.resolution, s.link_encoder.noise,
        s.motor_current.noise,
    )  # fmt: skip


def known_record(run: Run) -> np.ndarray:
    """The parameter record that estimators know, shape (1,)."""
    return run.known.record(run.known.mount(run.scenario.mounting or None))


def true_states(run: Run) -> np.ndarray:
    """The true states of a run, shape (n, SIZE), columns `joint_dynamics.STATES`; hysteresis of the flexspline is not in it."""
    states = np.zeros((len(run.time), SIZE))
    for column in ("motor_position", "wave_generator_position", "link_position", "motor_velocity", "link_velocity",
                   "wave_generator_velocity", "bristle"):  # fmt: skip
        states[:, JOINT_STATES.index(column)] = run.truth(column)
    states[:, JOINT_STATES.index("external_torque")] = run.external_torque
    return states


@dataclass(frozen=True)
class Contender:
    """An estimator with settings, one of the paper's filters or a baseline, that runs over a run's signals.

    Attributes:
        name: how tables call it.
        settings: `FilterSettings` or `Estimator`.
        knobs: what may be tuned.
    """

    name: str
    settings: FilterSettings | Estimator
    knobs: tuple[Knob, ...]

    @property
    def is_paper(self) -> bool:
        """Whether it is one of the paper's filters."""
        return isinstance(self.settings, FilterSettings)

    @property
    def causal(self) -> bool:
        """Whether an estimate uses nothing later."""
        return self.is_paper or self.settings.causal

    @property
    def costly(self) -> bool:
        """Whether it simulates the joint: an update then takes a hundred times as long."""
        return not self.is_paper and self.settings.costly

    def value(self, knob: Knob) -> float:
        """Where a knob stands."""
        return float(value_of(self.settings, knob.field))

    def turned(self, values: dict[str, float]) -> Contender:
        """The same with other values of fields. A paper's filter starts with P0 = V: X̂(0) is the measurement."""
        if self.is_paper and "V" in values:
            values = {"P0": values["V"], **values}
        return Contender(self.name, turned(self.settings, values), self.knobs)

    def estimate(self, run: Run) -> TorqueEstimate:
        """The estimate over a run.

        Raises:
            FilterDiverged: as the filter says.
        """
        if not self.is_paper:
            return self.settings.estimate(joint_signals(run), known_record(run), sensor_noise(run.known))
        h = run_filter(self.settings, run.model_torque, time=run.time)
        return TorqueEstimate(
            self.name, h.torque, h.P[:, 0, 0], h.x, ("torque",), h.innovation, h.innovation_covariance
        )


def contenders(names: Sequence[str] = ()) -> tuple[Contender, ...]:
    """The named contenders; without names the paper's filters, then all baselines.

    Raises:
        InputError: a name that is none.
    """
    known = {}
    for choice in PAPER_FILTERS:
        settings = choice.settings()
        known[choice.name] = Contender(choice.name, settings, knobs_of(settings))
    for name in baselines.names():
        known[name] = Contender(name, baselines.get(name), baselines.get(name).knobs)
    for name in names:
        if name not in known:
            raise InputError(f"filter {name!r}: expected one of {list(known)}{nearest(name, known)}")
    return tuple(known[name] for name in names or known)


def run_alone(scenario: Scenario, folder: Path | None, seed: int) -> Run:
    """Run a scenario with a seed and one filter only: the signals are those of any filters, a run keeps half as much.

    Raises:
        InputError: an estimate fed back: the signals would depend on the filter.
    """
    if scenario.feedback not in ("none", "sensor"):
        raise InputError(
            f"scenario {scenario.name}: feedback: expected none or sensor, got {scenario.feedback!r}: the signals would "
            "depend on the filter"
        )
    return run_scenario(scenario.model_copy(update={"seed": int(seed), "filters": PAPER_FILTERS[:1]}), folder)


def rms_error(torque: np.ndarray, run: Run) -> float:
    """RMS error [N·m] of an estimate, shape (n,), against the noise-free joint torque, after the transient."""
    kept = run.time >= run.scenario.transient
    return float(np.sqrt(np.mean((torque - run.truth("joint_torque"))[kept] ** 2)))
