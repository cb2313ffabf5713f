"""Several runs on one timeline: a view of each joint, and a colour per run in every panel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import rerun.blueprint as rrb

from ...sim.shape import shape
from ..style import FILTERS, SPARE, TRUTH
from .recording import entity, joint_view, layout, recording, send_series, series_view
from .scene import Scene, reach

if TYPE_CHECKING:
    from ...scenarios.run import Run

COLORS = (*FILTERS.values(), *SPARE)  # colours of the runs, in their order


def write_rerun_overlay(runs: Sequence[tuple[str, Run]], path: Path) -> Path:
    """Write runs, by their names for the viewer, as one `.rrd` file. Raises `InputError`: it cannot be written."""
    models = [shape(run.joint) for _, run in runs]
    end = max(float(run.time[-1]) for _, run in runs)
    with recording(path, "several runs", layout(_panels(runs, max(map(reach, models))), end)) as stream:
        for i, ((name, run), model) in enumerate(zip(runs, models, strict=True)):
            color, place = COLORS[i % len(COLORS)], _place(i)
            series, truth = partial(send_series, stream, run.time, name=name, color=color), run.truth("joint_torque")
            series(f"torque/{place}", truth)
            for label, found in run.estimates.items():
                series(f"error/{entity(label)}/{place}", found.mean - truth)
            if run.position_command is not None:
                series(f"position_error/{place}", -1e3 * run.command_error)
            series(f"current/{place}", run.reading("motor_current"))
            Scene(stream, f"scene/{place}", model).send_run(run, {"true": (truth, TRUTH)})
    return Path(path)


def _panels(runs: Sequence[tuple[str, Run]], far: float) -> rrb.Container:
    joints = [joint_view(name, f"scene/{_place(i)}", far) for i, (name, _) in enumerate(runs)]
    filters = list(dict.fromkeys(label for _, run in runs for label in run.estimates))
    errors = [series_view(f"{label}: estimate − truth [N·m]", f"error/{entity(label)}") for label in filters]
    return rrb.Horizontal(
        rrb.Grid(contents=joints, grid_columns=1 if len(joints) < 4 else 2),
        rrb.Vertical(
            series_view("Joint torque, true [N·m]", "torque"),
            *([rrb.Tabs(contents=errors, name="Errors")] if errors else []),
            series_view("Position error [mrad]", "position_error"),
            series_view("Motor current [A]", "current"),
            row_shares=[3, *([3] if errors else []), 2, 2],
        ),
        column_shares=[1, 2.4],
    )


def _place(index: int) -> str:
    return f"run_{index + 1}"
