"""Figures of a run: the paper's, ours beside what it states, and general ones.

The paper prints Figs. 3, 5, 7, 8 and 9 without their data, so every caption gives what its text states and what this
run measured. Figures are matplotlib `Figure` objects without global state; errors are against the plant's noise-free
joint torque unless a label says otherwise.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..estimator import torsions
from ..models.files import write_into_place
from ..models.laws import flexspline_torsion, wave_generator_torsion
from .series import envelope, share
from .style import COMMAND, EXTERNAL, MODEL, SENSOR, TRUTH, filter_colors, main_filter

if TYPE_CHECKING:
    from ..scenarios.run import Run
    from ..scenarios.scenario import Disturbance

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8A9099",
    "axes.labelcolor": "#22262B",
    "xtick.color": "#444A52",
    "ytick.color": "#444A52",
    "grid.color": "#E4E7EB",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.1,
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "savefig.facecolor": "white",
    "path.simplify_threshold": 0.3,
}
"""One style for all figures."""

WIDTH = 8.6
"""Width of a figure [in]."""
POINTS = 6000
"""Most points of a line; peaks stay."""
PAPER_LIMIT = 0.1
"""What the paper states for the difference between estimate and sensor without load [N·m]."""
SHARE_WINDOW = 0.25
"""Window [s] over which the working mode is shown as a share of the time."""


def figures_of(run: Run) -> dict[str, Figure]:
    """The figures that fit a run, by file name: those of the paper that its scenario names, and the general ones."""
    return {name: make(run) for name, make in _chosen(run).items()}


def save_figures(run: Run, folder: Path) -> list[Path]:
    """Write a run's figures as PNG.

    Args:
      run: the run.
      folder: where to; made if need be.

    Raises:
      InputError: the folder cannot be written.
    """
    paths = []
    with matplotlib.rc_context(STYLE):
        for name, make in _chosen(run).items():
            path = Path(folder) / f"{name}.png"
            figure = make(run)
            with write_into_place(path) as temporary:
                figure.savefig(temporary)
            paths.append(path)
    return paths


def _chosen(run: Run) -> dict[str, Callable[[Run], Figure]]:
    of_paper = {
        "3": ("fig3_stiffness", stiffness),
        "5": ("fig5_no_load", no_load),
        "7": ("fig7_link_sweep", link_sweep),
        "8": ("fig8_external_push", external_push),
        "9": ("fig9_zoom", push_zoom),
    }
    chosen = dict(of_paper[number] for number in re.findall(r"\d+", run.scenario.figure) if number in of_paper)
    if "fig9_zoom" in chosen and not zoomed(run):
        del chosen["fig9_zoom"]
    return chosen | {"overview": overview, "filters": filters, "error": error}


def styled(make: Callable[[Run], Figure]) -> Callable[[Run], Figure]:
    """Draw in this module's style, whatever matplotlib's settings are."""

    def wrapped(run: Run) -> Figure:
        with matplotlib.rc_context(STYLE):
            return make(run)

    wrapped.__doc__, wrapped.__name__ = make.__doc__, make.__name__
    return wrapped


# The paper's figures


@styled
def stiffness(run: Run) -> Figure:
    """Fig. 3: torsion against torque, the hysteresis loop of the locked rotor, beside the nominal compliance curve."""
    p = run.joint.record(run.joint.mount(run.scenario.mounting or None))[0]
    torque = run.truth("joint_torque")
    total = run.truth("motor_position") / p["N"] - run.truth("link_position")
    # The kinematic error of a rotor that stands still is a constant of the position, not of the load.
    constant = float(torsions(run.truth("motor_position")[0], run.truth("link_position")[0], 0.0, p)[2])
    total = 1e3 * (total - constant)
    loop = run.time >= run.scenario.transient
    reach = 1.05 * np.abs(torque[loop]).max()
    grid = np.linspace(-reach, reach, 401)
    flexspline = 1e3 * np.array([flexspline_torsion(T, p) for T in grid])
    both = flexspline + 1e3 * np.array([wave_generator_torsion(T / p["N"], p) for T in grid]) / p["N"]
    half = _half_width(torque[loop], total[loop])
    caption = (
        "Paper: a typical curve; stiffness increases with torsion (K1, K2, K3, knees at T1, T2), with hysteresis, so "
        "that the torsion at zero torque lies between ±Ψ/2; no numbers. "
        f"Ours, rotor locked: ±{_peak(total[loop]):.2f} mrad at ±{_peak(torque[loop]):.1f} N·m, Ψ/2 = {half:.3f} mrad; "
        f"K1, K2, K3 = {p['K1']:.0f}, {p['K2']:.0f}, {p['K3']:.0f} N·m/rad, T1, T2 = {p['T1']:.1f}, {p['T2']:.1f} N·m. "
        "The loop lies about the nominal curve of Eqs. (2) + (5): mesh friction takes its share of the torque before "
        "it winds the wave generator."
    )
    figure, (axes,) = _figure(run, "Fig. 3  Stiffness and hysteresis", caption, heights=[1], height=5.2)
    i = envelope(torque, POINTS // 2)
    axes.plot(total[i], torque[i], color=TRUTH, lw=1.8, label="joint, hysteresis loop")
    axes.plot(flexspline, grid, color=COMMAND, ls="--", label="flexspline alone, Eq. (2)")
    axes.plot(both, grid, color=MODEL, ls="-", lw=1.6, label="with wave generator, Eqs. (2) + (5)")
    for knee, name in ((p["T1"], "T1"), (p["T2"], "T2")):
        for sign in (1, -1):
            if knee < reach:
                x = 1e3 * flexspline_torsion(sign * knee, p)
                axes.plot(x, sign * knee, "o", ms=4, color=COMMAND)
                axes.annotate(
                    name if sign > 0 else f"−{name}", (x, sign * knee), xytext=(-6 * sign, 4 * sign),
                    textcoords="offset points", ha="right" if sign > 0 else "left", va="center", color=COMMAND,
                )  # fmt: skip
    axes.axhline(0, color="#B9BEC5", lw=0.8)
    axes.axvline(0, color="#B9BEC5", lw=0.8)
    axes.plot([-half, half], [0, 0], color=EXTERNAL, lw=2.5, solid_capstyle="butt", label=f"Ψ = {2 * half:.3f} mrad")
    axes.set(xlabel="torsion Δθ − θerr [mrad]", ylabel="joint torque [N·m]")
    axes.legend(loc="upper left")
    return figure


@styled
def no_load(run: Run) -> Figure:
    """Fig. 5: sensor and estimate without load; below, their difference with the paper's ±0.1 N·m."""
    name, colors = _main(run)
    settled = _settled(run)
    to_sensor = run.estimate(name) - run.reading("joint_torque")
    to_truth = run.estimate(name) - run.truth("joint_torque")
    within = 100 * np.mean(np.abs(to_truth[settled]) < PAPER_LIMIT)
    within_sensor = 100 * np.mean(np.abs(to_sensor[settled]) < PAPER_LIMIT)
    caption = (
        f"Paper: after a transient the difference between estimate and sensor is below {PAPER_LIMIT:g} N·m, in optimal "
        f"mode. Ours, {name} after {run.scenario.transient:g} s: against the truth RMS {_rms(to_truth[settled]):.3f}, "
        f"largest {_peak(to_truth[settled]):.3f} N·m, below the limit {within:.2f} % of the time; against the sensor "
        f"(noise {run.joint.sensors.joint_torque.noise:g} N·m rms) RMS {_rms(to_sensor[settled]):.3f}, largest "
        f"{_peak(to_sensor[settled]):.3f} N·m, below it {within_sensor:.2f} %. "
        f"Robust mode {_robust_share(run, name):.0f} % of the time."
    )
    figure, (top, bottom, mode) = _figure(run, "Fig. 5  Without load", caption, heights=[3, 3, 1], height=6.6)
    _torques(run, top, [name], truth_on_top=True)
    axes_limit = 1.15 * max(_peak(to_sensor[settled]), PAPER_LIMIT)
    bottom.axhspan(-PAPER_LIMIT, PAPER_LIMIT, color="#EAF5F0", lw=0, label=f"paper: ±{PAPER_LIMIT:g} N·m")
    _line(bottom, run.time, to_sensor, SENSOR, f"{name} − sensor", lw=0.7)
    _line(bottom, run.time, to_truth, colors[name], f"{name} − truth", lw=0.9)
    bottom.set(ylabel="difference [N·m]", ylim=(-axes_limit, axes_limit))
    _legend(bottom)
    _mode(run, mode, [name], fill=name)
    return figure


@styled
def link_sweep(run: Run) -> Figure:
    """Fig. 7: torque with link, difference between estimate and sensor, working mode."""
    name, _ = _main(run)
    quarters = np.array_split(np.flatnonzero(_settled(run)), 4)
    robust = [100 * np.mean(run.robust(name)[part]) for part in quarters]
    caption = (
        "Paper: RAREKF is in optimal mode at first and goes gradually to robust mode as the load grows; the difference "
        "is relatively high while it switches, acceptable overall; no numbers. "
        f"Ours: {name} {_against(run, name)}; in robust mode {', '.join(f'{r:.0f}' for r in robust)} % of the time in "
        f"the four quarters of the run, while the torque goes to {run.truth('joint_torque')[-1]:.1f} N·m and α to "
        f"{run.alpha(name)[-1]:.1f}: a larger α tolerates more before it switches."
    )
    return _sweep(run, "Fig. 7  Link from vertical to horizontal", caption)


@styled
def external_push(run: Run) -> Figure:
    """Fig. 8: the sweep with pushes in both directions."""
    name, _ = _main(run)
    caption = (
        "Paper: external torque by hand in both directions on the link sweep, to see the response to sudden changes; "
        "no numbers. "
        f"Ours: {name} {_against(run, name)}" + _response(run) + ". Shaded: the pushes; framed: those of Fig. 9."
    )
    return _sweep(run, "Fig. 8  Link with external pushes", caption)


@styled
def push_zoom(run: Run) -> Figure:
    """Fig. 9: one push in each direction from near, with every filter."""
    names = [s.name for s in run.settings]
    colors = filter_colors(names)
    pushes = zoomed(run)
    errors = {
        name: [_peak((run.estimate(name) - run.truth("joint_torque"))[_window(run, push)]) for push in pushes]
        for name in names
    }
    caption = (
        "Paper: the details of Fig. 8, where robust mode responds quickly to the load and optimal mode slowly, with "
        "less noise; no numbers. Ours, largest error within the view: "
        + "; ".join(f"{name} {' and '.join(f'{e:.2f}' for e in values)} N·m" for name, values in errors.items())
        + _response(run)
        + ". AREKF and RAREKF coincide while α = 1."
    )
    figure, grid = _figure(
        run, "Fig. 9  Pushes from near", caption, heights=[3, 2.2, 0.35 * len(names) + 0.3], height=7.4,
        columns=len(pushes), sharex="col",
    )  # fmt: skip
    grid = np.asarray(grid).reshape(3, len(pushes))
    for (top, middle, bottom), push in zip(grid.T, pushes, strict=True):
        inside = _window(run, push)
        time = run.time[inside]
        top.plot(time, run.reading("joint_torque")[inside], color=SENSOR, lw=0.7, label="sensor")
        top.plot(time, run.truth("joint_torque")[inside], color=TRUTH, lw=2.4, alpha=0.75, label="truth")
        for row, name in enumerate(names):
            estimate = run.estimate(name)[inside]
            top.plot(time, estimate, color=colors[name], label=name)
            middle.plot(time, estimate - run.truth("joint_torque")[inside], color=colors[name], lw=1.0)
            robust = run.robust(name)[inside]
            bottom.fill_between(time, row - 0.35, row + 0.35, where=robust, step="post", color=colors[name], lw=0)
        middle.axhline(0, color=TRUTH, lw=0.8)
        bottom.set(ylim=(len(names) - 0.5, -0.5), yticks=range(len(names)), yticklabels=names, xlabel="time [s]")
        bottom.grid(axis="y", visible=False)
        top.set_title(f"{push.kind} of {push.torque:+g} N·m, {1e3 * push.duration:g} ms".replace("-", "−"))
        for axes in (top, middle, bottom):
            axes.axvspan(push.start, push.start + push.duration, color=EXTERNAL, alpha=0.07, lw=0)
            axes.set_xlim(time[0], time[-1])
    grid[0, 0].set_ylabel("joint torque [N·m]")
    grid[1, 0].set_ylabel("estimate − truth [N·m]")
    grid[2, 0].set_ylabel("robust mode")
    grid[0, -1].legend(loc="best", ncols=2)
    return figure


# General figures


@styled
def overview(run: Run) -> Figure:
    """What happened: position and how well it was followed, current, external torque, joint torque."""
    name, _ = _main(run)
    external = np.any(run.external_torque)
    parts = ["position", "following", "current", *(["external"] if external else []), "torque"]
    link = run.truth("link_position")
    following = 1e3 * (run.position_command - link)
    settled = _settled(run)
    caption = (
        f"{run.scenario.description.replace('`', '')} Feedback of the torque: {run.scenario.feedback}. Position error "
        f"after {run.scenario.transient:g} s: RMS {_rms(following[settled]):.3f}, "
        f"largest {_peak(following[settled]):.3f} mrad. "
        f"{name} {_against(run, name)}."
    )
    heights = {"position": 1.6, "following": 1.6, "current": 1.4, "external": 1.2, "torque": 2.6}
    figure, axes = _figure(run, "Overview", caption, heights=[heights[part] for part in parts], height=7.6)
    at = dict(zip(parts, axes, strict=True))
    _line(at["position"], run.time, np.degrees(run.position_command), COMMAND, "command", ls="--")
    _line(at["position"], run.time, np.degrees(link), TRUTH, "link")
    at["position"].set_ylabel("position [°]")
    _line(at["following"], run.time, following, TRUTH, "command − link")
    at["following"].set_ylabel("error [mrad]")
    _line(at["current"], run.time, run.reading("motor_current"), SENSOR, "motor current, read", lw=0.7)
    _line(at["current"], run.time, run.truth("motor_current"), TRUTH, "true", lw=0.9)
    at["current"].set_ylabel("current [A]")
    if external:
        _line(at["external"], run.time, run.external_torque, EXTERNAL, "external torque on the link")
        at["external"].set_ylabel("torque [N·m]")
    _torques(run, at["torque"], [name])
    for part in parts:
        _legend(at[part])
    axes[-1].set_xlabel("time [s]")
    return figure


@styled
def filters(run: Run) -> Figure:
    """What the filters thought: innovation with ±√P_Y, normalised innovation squared, working mode."""
    names = [s.name for s in run.settings]
    colors = filter_colors(names)
    settled = _settled(run)
    mean = ", ".join(f"{name} {np.mean(run.nis(name)[settled]):.2f}" for name in names)
    caption = (
        "Innovation of each filter with ±√P_Y (line), P_Y of Eq. (14), the highest peaks cut off; "
        "NIS = innovation² / P_Y, moving mean over "
        f"{SHARE_WINDOW:g} s, is 1 where P_Y is right, below where W and V are cautious. Mean NIS: {mean}."
    )
    heights = [1.5] * len(names) + [1.8, 1.6]
    figure, axes = _figure(run, "Filters", caption, heights=heights, height=1.5 * len(names) + 4.0)
    limit = 1.2 * max(np.quantile(np.abs(run.innovation(name)[settled]), 0.99) for name in names)
    nis, mode = axes[-2:]
    window = round(SHARE_WINDOW / _period(run))
    for panel, name in zip(axes, names, strict=False):
        deviation = np.sqrt(run.innovation_variance(name))
        _line(panel, run.time, run.innovation(name), colors[name], f"{name} innovation", lw=0.6)
        for sign in (1, -1):
            _line(panel, run.time, sign * deviation, "#30353B", "±√P_Y" if sign > 0 else None, lw=0.7)
        panel.set(ylabel="[N·m]", ylim=(-limit, limit))
        _legend(panel)
        smooth = np.maximum(share(run.nis(name), window), 1e-3)
        _line(nis, run.time, smooth, colors[name], name)
    nis.axhline(1, color="#30353B", lw=0.8, ls="--")
    nis.set(yscale="log", ylabel="NIS")
    _legend(nis)
    _mode(run, mode, _switching(run))
    return figure


@styled
def error(run: Run) -> Figure:
    """Error of every filter against the truth, and how it is distributed."""
    names = [s.name for s in run.settings]
    colors = filter_colors(names)
    truth, settled = run.truth("joint_torque"), _settled(run)
    errors = {name: run.estimate(name) - truth for name in names}
    model = run.signals.model_torque - truth
    caption = (
        f"Estimate − truth after {run.scenario.transient:g} s, RMS (largest) in N·m: raw model "
        f"{_rms(model[settled]):.3f} ({_peak(model[settled]):.3f}); "
        + "; ".join(f"{n} {_rms(e[settled]):.3f} ({_peak(e[settled]):.3f})" for n, e in errors.items())
        + "."
    )
    heights = [1.5] * len(names) + [2.2]
    figure, axes = _figure(run, "Error", caption, heights=heights, height=1.5 * len(names) + 3.2, sharex=False)
    limit = 1.1 * max(_peak(e[settled]) for e in errors.values())
    for panel, name in zip(axes, names, strict=False):
        _line(panel, run.time, model, MODEL, "raw model", lw=0.5)
        _line(panel, run.time, errors[name], colors[name], name, lw=0.8)
        panel.set(ylabel="[N·m]", ylim=(-limit, limit), xlim=(run.time[0], run.time[-1]))
        panel.tick_params(labelbottom=panel is axes[len(names) - 1])
        _legend(panel)
    axes[len(names) - 1].set_xlabel("time [s]")
    shares = 100 * (1 - np.arange(1, 1001) / 1001)
    for name, values in {"raw model": model, **errors}.items():
        size = np.quantile(np.abs(values[settled]), 1 - shares / 100)
        axes[-1].plot(np.maximum(size, 1e-6), shares, color=colors.get(name, MODEL), label=name, lw=1.4)
    axes[-1].set(xscale="log", yscale="log", xlabel="size of the error [N·m]", ylabel="time above it [%]")
    axes[-1].set_xlim(left=1e-3 * 10 ** np.floor(np.log10(max(limit, 1e-3))))
    _legend(axes[-1])
    return figure


# Pieces


def zoomed(run: Run) -> list[Disturbance]:
    """One disturbance in each direction, forward first, to look at from near: the sharpest after the transient."""
    after = [d for d in run.scenario.happening if d.start >= run.scenario.transient and d.kind in ("push", "step")]
    chosen = []
    for sign in (1, -1):
        same = [d for d in after if d.torque * sign > 0]
        if same:
            chosen.append(min(same, key=lambda d: (d.kind != "push", d.duration, d.start)))
    return chosen


def _sweep(run: Run, title: str, caption: str) -> Figure:
    """Torque, difference to sensor and truth, working mode; pushes shaded, those of Fig. 9 framed."""
    name, colors = _main(run)
    figure, (top, bottom, mode) = _figure(run, title, caption, heights=[3, 3, 2], height=7.2)
    _torques(run, top, [name])
    to_sensor = run.estimate(name) - run.reading("joint_torque")
    to_truth = run.estimate(name) - run.truth("joint_torque")
    _line(bottom, run.time, to_sensor, SENSOR, f"{name} − sensor", lw=0.7)
    _line(bottom, run.time, to_truth, colors[name], f"{name} − truth", lw=0.9)
    limit = 1.1 * _peak(to_sensor[_settled(run)])
    bottom.set(ylabel="difference [N·m]", ylim=(-limit, limit))
    _legend(bottom)
    _mode(run, mode, [*(n for n in _switching(run) if n != name), name], fill=name)
    load = mode.twinx()
    _line(load, run.time, run.alpha(name), COMMAND, f"α of {name} (right)", ls="--")
    load.set(ylabel="α", ylim=(0, None))
    load.margins(x=0.01)
    load.grid(visible=False)
    load.spines["right"].set_visible(True)
    handles = [*mode.get_legend_handles_labels()[0], *load.get_legend_handles_labels()[0]]
    mode.get_legend().remove()
    mode.legend(handles=handles, ncols=len(handles), loc="lower right", bbox_to_anchor=(1, 0.98), borderaxespad=0)
    near = zoomed(run)
    for d in run.scenario.happening:
        for axes in (top, bottom, mode):
            axes.axvspan(d.start, d.start + d.duration, color=EXTERNAL, alpha=0.14, lw=0)
        if d in near:
            inside = _window(run, d)
            low, high = run.time[inside][[0, -1]]
            y = run.reading("joint_torque")[inside]
            top.add_patch(
                Rectangle(
                    (low, y.min() - 0.4), high - low, np.ptp(y) + 0.8, fill=False, color=EXTERNAL, lw=1.2, zorder=5
                )
            )
    return figure


def _torques(run: Run, axes: Axes, names: Sequence[str], truth_on_top: bool = False) -> None:
    """Sensor, truth and estimates: the truth as a broad band below them, or, where noise would cover it, on top."""
    colors = filter_colors(s.name for s in run.settings)
    _line(axes, run.time, run.reading("joint_torque"), SENSOR, "torque sensor", lw=0.7)
    style = {"lw": 1.0, "zorder": 4} if truth_on_top else {"lw": 2.4, "alpha": 0.75}
    _line(axes, run.time, run.truth("joint_torque"), TRUTH, "truth", **style)
    for name in names:
        _line(axes, run.time, run.estimate(name), colors[name], name, lw=0.8)
    axes.set_ylabel("joint torque [N·m]")
    _legend(axes)


def _switching(run: Run) -> list[str]:
    """The filters that switch between optimal and robust mode; the others are always in one of them."""
    return [s.name for s in run.settings if s.rule in ("arekf", "rarekf")]


def _mode(run: Run, axes: Axes, names: Sequence[str], fill: str = "") -> None:
    """Share of the time in robust mode."""
    colors = filter_colors(s.name for s in run.settings)
    window = round(SHARE_WINDOW / _period(run))
    for name in names:
        values = 100 * share(run.robust(name), window)
        i = envelope(values, POINTS // 8)
        if name == fill:
            axes.fill_between(run.time[i], values[i], color=colors[name], alpha=0.35, lw=0)
        axes.plot(run.time[i], values[i], color=colors[name], lw=0.9, label=name)
    axes.set(ylabel="robust mode\n[% of the time]", xlabel="time [s]", ylim=(0, 105), yticks=[0, 50, 100])
    _legend(axes)


def _line(axes: Axes, time: np.ndarray, values: np.ndarray, color: str, label: str | None, **style) -> None:
    i = envelope(values, POINTS // 2)
    axes.plot(time[i], values[i], color=color, label=label, **style)


def _legend(axes: Axes) -> None:
    """In one row above the axes on the right, where it covers nothing; the title stands on the left."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        legend = axes.legend(
            handles, labels, ncols=len(handles), loc="lower right", bbox_to_anchor=(1, 0.98), borderaxespad=0,
            handlelength=1.6, columnspacing=1.4,
        )  # fmt: skip
        for line in legend.get_lines():
            line.set_linewidth(2)


def _figure(
    run: Run, title: str, caption: str, heights: Sequence[float], height: float, columns: int = 1, sharex=True
) -> tuple[Figure, np.ndarray]:
    """A figure with a title, axes of the given relative heights below each other, and the caption at the bottom."""
    lines = textwrap.wrap(" ".join(caption.split()).replace(" -", " −"), 140)
    below = 0.165 * len(lines) + 0.16  # in
    total = height + below
    figure = Figure(figsize=(WIDTH, total), layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(rect=(0.0, below / total, 1.0, 1.0 - below / total), h_pad=0.05, w_pad=0.08)
    figure.suptitle(f"{title}  ·  {run.name}", x=0.012, ha="left", fontsize=11, fontweight="bold", color="#22262B")
    figure.text(
        0.012, 0.1 / total, "\n".join(lines), fontsize=8.2, color="#444A52", va="bottom", ha="left", linespacing=1.4
    )
    axes = figure.subplots(len(heights), columns, sharex=sharex, height_ratios=heights, squeeze=False)
    if columns == 1:
        for panel in axes[:, 0]:
            panel.margins(x=0.01)
    return figure, axes.ravel()


def _main(run: Run) -> tuple[str, dict[str, str]]:
    names = [s.name for s in run.settings]
    return main_filter(names), filter_colors(names)


def _settled(run: Run) -> np.ndarray:
    return run.time >= run.scenario.transient


def _period(run: Run) -> float:
    return float(run.time[1] - run.time[0])


def _window(run: Run, push: Disturbance) -> np.ndarray:
    """The push with some time before it and more after it."""
    margin = 0.15 + 0.4 * push.duration
    return (run.time >= push.start - 0.5 * margin) & (run.time <= push.start + push.duration + 1.5 * margin)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _peak(values: np.ndarray) -> float:
    return float(np.abs(values).max())


def _robust_share(run: Run, name: str) -> float:
    """Share of the time after the transient [%]."""
    return 100 * float(np.mean(run.robust(name)[_settled(run)]))


def _against(run: Run, name: str) -> str:
    """`against the truth RMS …, largest … N·m; against the sensor …`."""
    settled = _settled(run)
    truth = (run.estimate(name) - run.truth("joint_torque"))[settled]
    sensor = (run.estimate(name) - run.reading("joint_torque"))[settled]
    return (
        f"after {run.scenario.transient:g} s against the truth RMS {_rms(truth):.3f}, largest {_peak(truth):.3f} N·m; "
        f"against the sensor RMS {_rms(sensor):.3f}, largest {_peak(sensor):.3f} N·m"
    )


def _response(run: Run) -> str:
    """What the metrics say of the response to pushes; empty where they say nothing."""
    values = {name: (m.get("response_ms"), m.get("noise_ratio")) for name, m in run.metrics.get("filters", {}).items()}
    parts = [
        f"{name} {time:.0f} ms" + (f" (noise {noise:.2f})" if noise is not None else "")
        for name, (time, noise) in values.items()
        if time is not None
    ]
    if not parts:
        return ""
    itself = run.metrics.get("truth", {}).get("response_ms")
    parts += [f"the torque itself {itself:.0f} ms"] if itself is not None else []
    return "; 90 % response (noise relative to the raw model): " + ", ".join(parts)


def _half_width(torque: np.ndarray, torsion: np.ndarray) -> float:
    """Half the distance of the torsions at which the torque crosses zero up and down, in the torsion's unit."""
    # Crossings between two excursions beyond half the largest torque: not those while the joint settles around zero.
    far = np.flatnonzero(np.abs(torque) > 0.5 * np.abs(torque).max())
    turns = np.flatnonzero(np.signbit(torque[far[1:]]) != np.signbit(torque[far[:-1]]))
    if not turns.size:
        return 0.0
    cross = np.array(
        [
            i + int(np.flatnonzero(np.diff(np.signbit(torque[i : j + 1])))[0])
            for i, j in zip(far[turns], far[turns + 1], strict=True)
        ]
    )
    u = -torque[cross] / (torque[cross + 1] - torque[cross])
    at = torsion[cross] + u * (torsion[cross + 1] - torsion[cross])
    rising = torque[cross + 1] > torque[cross]
    if rising.all() or not rising.any():
        return float(np.abs(at).max())
    return float(abs(np.mean(at[rising]) - np.mean(at[~rising])) / 2)
