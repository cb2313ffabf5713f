"""Several runs on one timeline: a view of each joint, and a colour per run in every panel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...sim.shape import shape
from ..style import FILTERS, SPARE, TRUTH
from .blueprint import joint_view
from .recording import TIMELINE, entity, layout, recording, send_series, series_view
from .scene import reach, send_bodies, send_torques, thin_frames

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
            time, truth = run.time, run.truth("joint_torque")
            send_series(stream, f"torque/{place}", time, truth, name, color)
            for label, found in run.estimates.items():
                send_series(stream, f"error/{entity(label)}/{place}", time, found.mean - truth, name, color)
            if run.position_command is not None:
                send_series(stream, f"position_error/{place}", time, -1e3 * run.command_error, name, color)
            send_series(stream, f"current/{place}", time, run.reading("motor_current"), name, color)
            frames = thin_frames(time)
            columns = [rr.TimeColumn(TIMELINE, duration=time[frames])]
            angles = ("motor_position", "wave_generator_position", "link_position")
            motion = np.column_stack([run.truth(angle)[frames] for angle in angles])
            bare = run.scenario.mount(run.joint).gravity_moment == 0
            send_bodies(stream, f"scene/{place}", columns, motion, model, bare)
            send_torques(stream, f"scene/{place}", columns, {"true": (truth[frames], TRUTH)}, model)
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
