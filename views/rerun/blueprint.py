"""The layout of a run: joint and notes on the left, estimates in the middle, innovations and motion on the right."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun.blueprint as rrb

from ..posteriors import SHARE_WINDOW, innovations, settled
from ..style import main_filter
from .recording import SHARED_TIME, layout, series_view

if TYPE_CHECKING:
    from ...scenarios.run import Run


def run_blueprint(run: Run, reach: float = 0.4, live: bool = False) -> rrb.Blueprint:
    """Return the layout of a run; `reach`: of the link [m], for the camera; `live`: the cursor follows the data."""
    names, stated, pushed = list(run.estimates), tuple(innovations(run)), bool(np.any(run.external_torque))
    main = main_filter(names)
    limits = _error_limits(run, main)
    joint = joint_view("Joint: torque true (green), estimated, external (pink)", "scene", reach)
    # All panels have the same colours: one legend is enough.
    innovation_views = [
        series_view(f"Innovation {name} [N·m]" if name == main else name, f"innovation/{name}", legend=False)
        for name in (main, *(name for name in names if name != main))
        if name in stated
    ]
    behind: list[rrb.View | rrb.Container] = [
        *([rrb.Tabs(contents=innovation_views, name="Innovation")] if innovation_views else []),
        series_view("Torsion and its parts [mrad]", "torsion"),
        *([series_view("External torque [N·m]", "external_torque", legend=False)] if pushed else []),
        rrb.Tabs(
            series_view("Position error [mrad]", "position_error", legend=False),
            series_view("Position [°]", "position"),
            series_view("Motor current [A]", "current"),
            name="Motion",
        ),
    ]
    estimates: list[rrb.View] = [
        series_view("Joint torque [N·m]", "torque"),
        series_view("Estimate − truth [N·m]", "error", legend=False, limits=limits),
        series_view(f"Robust mode [% of {SHARE_WINDOW:g} s]", "robust_share", legend=False, limits=(-5, 105)),
        rrb.StateTimelineView(name="Mode", origin="mode", time_view=SHARED_TIME),
    ]
    panels = rrb.Horizontal(
        rrb.Vertical(joint, rrb.TextDocumentView(origin="notes", name="Run"), row_shares=[3, 2]),
        rrb.Vertical(contents=estimates, row_shares=[3, 2.4, 1.6, 1.2]),
        rrb.Vertical(
            contents=behind, row_shares=[*([2] if innovation_views else []), 2.2, *([1.2] if pushed else []), 1.6]
        ),
        column_shares=[1.05, 1.4, 1.25],
    )
    return layout(panels, float(run.time[-1]), live)


def joint_view(name: str, origin: str, reach: float) -> rrb.Spatial3DView:
    """Return a view of the joint in 3D from the front; `reach` of its link [m]."""
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        background=[28, 31, 36],
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=(1.35 * reach, -2.3 * reach, 0.6 * reach),
            look_target=(0.2 * reach, 0.0, 0.0),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )


def _error_limits(run: Run, name: str) -> tuple[float, float]:
    """Limits of the error panel [N·m]: 1.5 times the main filter's largest error after the transient."""
    limit = 1.5 * float(np.abs((run.estimate(name) - run.truth("joint_torque"))[settled(run)]).max())
    return -limit, limit
