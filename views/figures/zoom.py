"""The paper's Fig. 9: details of one push in each direction, with every filter."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ..posteriors import modes
from ..style import EXTERNAL, SENSOR, TRUTH, filter_colors
from .sheet import legend, sheet, styled
from .signals import peak, response

if TYPE_CHECKING:
    from ...scenarios.run import Run
    from ...scenarios.scenario import Disturbance


@styled
def push_zoom(run: Run) -> Figure:
    """Fig. 9: details of one push in each direction, with every filter."""
    names = list(run.estimates)
    colors = filter_colors(names)
    pushes = zoomed(run)
    truth = run.truth("joint_torque")
    errors = {name: [peak((run.estimate(name) - truth)[window(run, push)]) for push in pushes] for name in names}
    caption = (
        "Paper: details of Fig. 8; robust mode responds quickly to the load, optimal mode slowly, with less noise; "
        "no numbers. Ours, largest error within the view: "
        + "; ".join(f"{name} {' and '.join(f'{e:.2f}' for e in values)} N·m" for name, values in errors.items())
        + response(run)
        + ". AREKF and RAREKF coincide while α = 1."
    )
    heights = [2.7, 1.9, 0.33 * len(names) + 0.2]
    figure, rows = sheet(f"Fig. 9  Pushes from near  ·  {run.name}", caption, heights, columns=len(pushes))
    for top, middle, bottom, push in zip(*rows, pushes, strict=True):
        inside = window(run, push)
        time = run.time[inside]
        top.plot(time, run.reading("joint_torque")[inside], color=SENSOR, lw=0.7, label="sensor")
        top.plot(time, truth[inside], color=TRUTH, lw=2.4, alpha=0.75, label="truth")
        for row, name in enumerate(names):
            estimate = run.estimate(name)[inside]
            top.plot(time, estimate, color=colors[name], label=name)
            middle.plot(time, estimate - truth[inside], color=colors[name], lw=1.0)
            robust = modes(run, name)[inside]
            bottom.fill_between(time, row - 0.35, row + 0.35, where=robust, step="post", color=colors[name], lw=0)
        middle.axhline(0, color=TRUTH, lw=0.8)
        bottom.set(ylim=(len(names) - 0.5, -0.5), yticks=range(len(names)), yticklabels=names, xlabel="time [s]")
        bottom.tick_params(axis="y", length=0, labelsize=8)
        bottom.grid(axis="y", visible=False)
        top.set_title(f"{push.kind} of {push.torque:+g} N·m, {1e3 * push.duration:g} ms".replace("-", "−"))
        for axes in (top, middle, bottom):
            axes.axvspan(push.start, push.start + push.duration, color=EXTERNAL, alpha=0.07, lw=0)
            axes.set_xlim(time[0], time[-1])
    for (first, *_), label in zip(rows, ("joint torque [N·m]", "estimate − truth [N·m]", "robust mode"), strict=True):
        first.set_ylabel(label)
    legend(rows[0][-1], above=0.2)
    return figure


def zoomed(run: Run) -> list[Disturbance]:
    """Return the shortest disturbance in each direction after the transient, forward first."""
    after = [d for d in run.scenario.happening if d.start >= run.scenario.transient and d.kind in ("push", "step")]
    chosen = []
    for sign in (1, -1):
        same = [d for d in after if d.torque * sign > 0]
        if same:
            chosen.append(min(same, key=lambda d: (d.kind != "push", d.duration, d.start)))
    return chosen


def window(run: Run, push: Disturbance) -> np.ndarray:
    """Return the samples of a push, with some before and more after it, shape (n,), bool."""
    margin = 0.15 + 0.4 * push.duration
    return (run.time >= push.start - 0.5 * margin) & (run.time <= push.start + push.duration + 1.5 * margin)
