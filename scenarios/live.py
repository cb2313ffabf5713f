"""A scenario while it runs: closed loop and filters advance in stretches; the result is a normal run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..estimator import registry
from ..estimator.estimator import CausalEstimator
from ..estimator.online import OnlineEstimate, OnlineSamples
from ..models import own_sensors
from ..models.errors import InputError
from ..sim.loop import CONTROL_PERIOD, Simulation
from .experiment import Experiment, estimate, readable, signals_of
from .run import Run, run_of
from .scenario import Scenario


class LiveRun:
    """A scenario while it runs. Filters of `names` run in stretches; those that look ahead or read a plugin's sensor
    run at the end."""

    def __init__(self, scenario: Scenario, folder: Path | None = None):
        """Prepare; arguments and errors as of `run_scenario`. Raises `InputError`: no filter that can run in stretches."""
        if scenario.payloads and scenario.known_payloads:
            raise InputError(
                f"scenario {scenario.name}: known_payloads: expected false while it runs, as estimators need the whole "
                "motion for their torque"
            )
        self.scenario = scenario
        self._experiment = Experiment.of(scenario, folder)
        self._loop = self._experiment.closed_loop()
        self._filters = scenario.estimators()
        simulation = self._loop.simulation
        stamps = simulation.time if simulation.stamps is None else simulation.stamps
        self._samples = OnlineSamples(stamps, readable(simulation), self._experiment.known)
        further = own_sensors.names()
        along = {
            name: one
            for name, one in self._filters.items()
            if isinstance(one, CausalEstimator) and not set(one.needs) & set(further)
        }
        self.names = tuple(along)
        if not along:
            raise InputError(f"scenario {scenario.name}: filters: expected a causal one, got {list(self._filters)}")
        self._along = {name: OnlineEstimate(one, self._samples) for name, one in along.items()}
        model = registry.get("model")
        assert isinstance(model, CausalEstimator)
        self._model = OnlineEstimate(model, self._samples)
        self._whole = run_of(self._experiment, simulation, {})

    @property
    def start(self) -> Run:
        """The run before the first tick."""
        return self._whole

    @property
    def over(self) -> bool:
        """Whether all ticks are simulated."""
        return self._loop.done >= len(self._whole.time)

    @property
    def done(self) -> float:
        """Simulated time [s]."""
        return self._loop.done * CONTROL_PERIOD

    def advance(self, seconds: float) -> Run:
        """Simulate the next stretch of about so many seconds, at least two ticks; return it as a run that begins later.
        Raises `InputError`, `FilterDiverged`: as `run_scenario`."""
        begin, left = self._loop.done, len(self._whole.time) - self._loop.done
        ticks = max(round(seconds / CONTROL_PERIOD), 2)
        part = self._loop.advance(ticks if left - ticks > 1 else left)  # a single tick has no period
        self._experiment.check(self._loop, begin)
        self._samples.fill(part)
        model = self._model.advance(part).mean
        estimates = {name: one.advance(part) for name, one in self._along.items()}
        return replace(
            self._whole,
            simulation=_part(self._whole.simulation, part),
            estimates=estimates,
            command=self._whole.command[part],
            external_torque=self._whole.external_torque[part],
            raw=model,
        )

    def finish(self, threads: int = 1) -> Run:
        """Return the whole run after the last stretch, with the remaining filters. Raises `InputError` or
        `FilterDiverged`: as `run_scenario`."""
        simulation = self._experiment.completed(self._loop.simulation)
        others = {name: one for name, one in self._filters.items() if name not in self._along}
        found = estimate(others, signals_of(simulation), self._experiment.known, threads)
        whole = slice(0, len(simulation.time))
        found |= {name: one.so_far(whole) for name, one in self._along.items()}
        return replace(self._whole, simulation=simulation, estimates={name: found[name] for name in self._filters})


def _part(simulation: Simulation, part: slice) -> Simulation:
    return replace(
        simulation,
        time=simulation.time[part],
        truth=simulation.truth[part],
        readings=simulation.readings[part],
        command=simulation.command[part],
        failed=(part.stop - part.start, 0),
        stamps=None if simulation.stamps is None else simulation.stamps[part],
    )
