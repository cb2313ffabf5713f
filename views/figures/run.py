"""General figures of a run: overview, error of every filter, innovations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ...models.controller import MODES
from ..posteriors import SHARE_WINDOW, innovations, moving_mean, settled, switching
from ..style import COMMAND, EXTERNAL, MODEL, SENSOR, TRUTH, filter_colors
from .sheet import decades, legend, sheet, styled
from .signals import against, line, main, mode, peak, torques

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


@styled
def error(run: Run) -> Figure:
    """Error of every filter, and its distribution."""
    names = list(run.estimates)
    colors = filter_colors(names)
    truth, kept = run.truth("joint_torque"), settled(run)
    errors = {name: run.estimate(name) - truth for name in names}
    model = run.model_torque - truth
    caption = (
        f"Estimate − truth after {run.scenario.transient:g} s, RMS (largest) in N·m: raw model {_said(run.metrics['model'])}; "
        + "; ".join(f"{name} {_said(run.metrics['filters'][name])}" for name in errors)
        + "."
    )
    count = len(names)
    heights = [*([1.05] * count), 1.6]
    figure, rows = sheet(f"Error  ·  {run.name}", caption, heights, shared=range(count - 1))
    *panels, last = (axes for (axes,) in rows)
    limit = 1.1 * max(peak(e[kept]) for e in errors.values())
    for panel, name in zip(panels, names, strict=True):
        line(panel, run.time, model, MODEL, "raw model", lw=0.5)
        line(panel, run.time, errors[name], colors[name], name, lw=0.8)
        panel.set(ylabel="[N·m]", ylim=(-limit, limit), xlim=(run.time[0], run.time[-1]))
        legend(panel)
    panels[-1].set_xlabel("time [s]")
    shares = 100 * (1 - np.arange(1, 1001) / 1001)
    for name, values in {"raw model": model, **errors}.items():
        size = np.quantile(np.abs(values[kept]), 1 - shares / 100)
        last.plot(np.maximum(size, 1e-6), shares, color=colors.get(name, MODEL), label=name, lw=1.4)
    last.set(xlabel="size of the error [N·m]", ylabel="time above it [%]")
    decades(last.xaxis, last.yaxis)
    last.set_xlim(left=1e-3 * 10 ** np.floor(np.log10(max(limit, 1e-3))))
    legend(last)
    return figure


def _said(measures: Mapping[str, float | None]) -> str:
    return f"{measures['rms']:.3f} ({measures['max']:.3f})"


_DARK = "#30353B"


@styled
def filters(run: Run) -> Figure:
    """Innovations of the filters with ±√P_Y, normalised innovation squared, working mode."""
    found = innovations(run)
    colors = filter_colors(run.estimates)
    kept = settled(run)
    mean = ", ".join(f"{name} {np.mean(one.nis[kept]):.2f}" for name, one in found.items())
    caption = (
        "Innovation of each filter with ±√P_Y (line), P_Y of Eq. (14), the highest peaks cut off; "
        "NIS = innovation² / P_Y, moving mean over "
        f"{SHARE_WINDOW:g} s, is 1 where P_Y is right, below where W and V are conservative. Mean NIS: {mean}."
    )
    figure, rows = sheet(f"Filters  ·  {run.name}", caption, [*([1.0] * len(found)), 1.2, 1.1])
    panels = [axes for (axes,) in rows]
    limit = 1.2 * max(np.quantile(np.abs(one.values[kept]), 0.99) for one in found.values())
    nis, below = panels[-2:]
    for panel, (name, one) in zip(panels, found.items(), strict=False):
        line(panel, run.time, one.values, colors[name], f"{name} innovation", lw=0.6)
        for sign in (1, -1):
            line(panel, run.time, sign * one.deviation, _DARK, "±√P_Y" if sign > 0 else None, lw=0.7)
        panel.set(ylabel="[N·m]", ylim=(-limit, limit))
        legend(panel)
        line(nis, run.time, np.maximum(moving_mean(run, one.nis), 1e-3), colors[name], name)
    nis.axhline(1, color=_DARK, lw=0.8, ls="--")
    nis.set(ylabel="NIS")
    decades(nis.yaxis)
    legend(nis)
    mode(run, below, switching(run))
    legend(below)
    return figure
