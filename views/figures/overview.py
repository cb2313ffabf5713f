"""Overview of a run: position, position error, current, external torque, joint torque."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ...models.controller import MODES
from ..style import COMMAND, EXTERNAL, SENSOR, TRUTH
from .sheet import legend, sheet, styled
from .signals import against, line, main, peak, settled, torques

if TYPE_CHECKING:
    from ...scenarios.run import Run


@styled
def overview(run: Run) -> Figure:
    """Draw position, position error, current, external torque, joint torque."""
    name, _ = main(run)
    external = bool(np.any(run.external_torque))
    heights = {"position": 1.0, "following": 1.0, "current": 0.9, "external": 0.75, "torque": 1.7}
    if not external:
        del heights["external"]
    link = run.truth("link_position")
    mode = run.scenario.mode
    scale, unit = (1.0, MODES[mode]) if mode == "torque" else (1e3, f"m{MODES[mode]}")
    following = scale * run.command_error
    kept = settled(run)
    caption = (
        f"{run.scenario.description.replace('`', '')} Feedback of the torque: {run.scenario.feedback}. "
        f"{mode.capitalize()} error after {run.scenario.transient:g} s: RMS {scale * run.metrics[f'{mode}_error']['rms']:.3f}, "
        f"largest {peak(following[kept]):.3f} {unit}. "
        f"{name} {against(run, name)}."
    )
    figure, rows = sheet(f"Overview  ·  {run.name}", caption, list(heights.values()))
    at = {part: axes for part, (axes,) in zip(heights, rows, strict=True)}
    line(at["position"], run.time, np.degrees(link), TRUTH, "link")
    if run.position_command is not None:
        line(at["position"], run.time, np.degrees(run.position_command), COMMAND, "command", ls="--")
    at["position"].set_ylabel("position [°]")
    line(at["following"], run.time, following, TRUTH, "command − motor" if mode == "torque" else "command − link")
    at["following"].set_ylabel(f"error [{unit}]")
    line(at["current"], run.time, run.reading("motor_current"), SENSOR, "motor current, read", lw=0.7)
    line(at["current"], run.time, run.truth("motor_current"), TRUTH, "true", lw=0.9)
    at["current"].set_ylabel("current [A]")
    if external:
        line(at["external"], run.time, run.external_torque, EXTERNAL, "external torque on the link")
        at["external"].set_ylabel("torque [N·m]")
    torques(run, at["torque"], [name])
    for axes in at.values():
        legend(axes)
    at["torque"].set_xlabel("time [s]")
    return figure
