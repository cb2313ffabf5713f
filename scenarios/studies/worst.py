"""The worst runs of a study, as scenarios to run again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scenario import Scenario
from .dataset import Dataset


@dataclass(frozen=True)
class WorstRun:
    """The run with the largest value of a metric in a scenario."""

    scenario: str  # its name in the study
    filter: str  # its name
    seed: int  # of the study
    value: float  # of the metric
    again: Scenario | None  # the scenario to run again; None if the plant's parameters were drawn


def worst_runs(dataset: Dataset, metric: str) -> list[WorstRun]:
    """Return for every scenario of a dataset the run with the largest value of a metric."""
    design = dataset.design
    worst: dict[str, tuple[float, int, int, str]] = {}
    for cell in design.cells:
        table = dataset.read(cell.index, ["run", "seed", "filter", metric])
        values = table[metric].to_numpy(zero_copy_only=False).astype(float) if table.num_rows else np.zeros(0)
        if not np.isfinite(values).any():
            continue
        i = int(np.nanargmax(values))
        if values[i] > worst.get(cell.scenario, (-np.inf,))[0]:
            worst[cell.scenario] = (float(values[i]), cell.index, table["seed"][i].as_py(), table["filter"][i].as_py())
    found = []
    for name, (value, index, seed, label) in worst.items():
        cell = design.cells[index]
        experiment, record = design.drawn(cell, seed, design.experiment(cell))
        again = None
        if record is None:
            update = {"name": f"{name}-{seed}", "seed": design.noise_seed(cell, seed), "mounting": ""}
            again = experiment.scenario.model_copy(update=update | {"link": experiment.mounting})
        found.append(WorstRun(name, label, seed, value, again))
    return found
