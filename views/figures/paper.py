"""Figures of the paper: Fig. 3 hysteresis, Fig. 5 without load, Fig. 7 with the link, Figs. 8 and 9 with pushes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ...models.laws import flexspline_torsion, kinematic_error, wave_generator_torsion
from ..posteriors import modes, robust_share, settled, switching
from ..series import envelope
from ..style import COMMAND, EXTERNAL, MODEL, SENSOR, TRUTH, filter_colors
from .sheet import PIXELS, legend, sheet, styled
from .signals import against, line, main, mode, peak, response, rms, torques

if TYPE_CHECKING:
    from ...scenarios.run import Run
    from ...scenarios.scenario import Disturbance

POINTS = 6000  # largest number of points of the loop, which cannot be drawn as an envelope


@styled
def stiffness(run: Run) -> Figure:
    """Fig. 3: torsion over torque of the locked rotor, with its hysteresis, and the nominal compliance curve."""
    p = run.joint.record(run.scenario.mount(run.joint))[0]
    torque = run.truth("joint_torque")
    total = run.truth("motor_position") / p["N"] - run.truth("link_position")
    # The kinematic error of a locked rotor depends on its position only.
    total = 1e3 * (total - kinematic_error(run.truth("motor_position")[0], p))
    loop = settled(run)
    reach = 1.05 * np.abs(torque[loop]).max()
    grid = np.linspace(-reach, reach, 401)
    flexspline = 1e3 * np.array([flexspline_torsion(T, p) for T in grid])
    both = flexspline + 1e3 * np.array([wave_generator_torsion(T / p["N"], p) for T in grid]) / p["N"]
    half = half_width(torque[loop], total[loop])
    caption = (
        "Paper: a typical curve; stiffness increases with torsion (K1, K2, K3, changes at T1, T2), with hysteresis, so "
        "that the torsion at zero torque lies between ±Ψ/2; no numbers. "
        f"Ours, rotor locked: ±{peak(total[loop]):.2f} mrad at ±{peak(torque[loop]):.1f} N·m, Ψ/2 = {half:.3f} mrad; "
        f"K1, K2, K3 = {p['K1']:.0f}, {p['K2']:.0f}, {p['K3']:.0f} N·m/rad, T1, T2 = {p['T1']:.1f}, {p['T2']:.1f} N·m. "
        "The loop lies about the nominal curve of Eqs. (2) + (5): mesh friction takes a part of the torque before "
        "it reaches the wave generator."
    )
    figure, ((axes,),) = sheet(f"Fig. 3  Stiffness and hysteresis  ·  {run.name}", caption, [4.2])
    some = slice(None, None, -(-len(torque) // POINTS))
    axes.plot(total[some], torque[some], color=TRUTH, lw=1.8, label="joint, hysteresis loop")
    axes.plot(flexspline, grid, color=COMMAND, ls="--", label="flexspline alone, Eq. (2)")
    axes.plot(both, grid, color=MODEL, ls="-", lw=1.6, label="with wave generator, Eqs. (2) + (5)")
    for corner, name in ((p["T1"], "T1"), (p["T2"], "T2")):
        for sign in (1, -1):
            if corner < reach:
                x = 1e3 * flexspline_torsion(sign * corner, p)
                axes.plot(x, sign * corner, "o", ms=4, color=COMMAND)
                axes.annotate(
                    name if sign > 0 else f"−{name}", (x, sign * corner), xytext=(-6 * sign, 4 * sign),
                    textcoords="offset points", ha="right" if sign > 0 else "left", va="center", color=COMMAND,
                )  # fmt: skip
    axes.axhline(0, color="#B9BEC5", lw=0.8)
    axes.axvline(0, color="#B9BEC5", lw=0.8)
    axes.plot([-half, half], [0, 0], color=EXTERNAL, lw=2.5, solid_capstyle="butt", label=f"Ψ = {2 * half:.3f} mrad")
    axes.set(xlabel="torsion Δθ − θerr [mrad]", ylabel="joint torque [N·m]")
    axes.legend(loc="upper left")
    return figure


def half_width(torque: np.ndarray, torsion: np.ndarray) -> float:
    """Return half the difference of torsion at rising and falling zero crossings of the torque, shape (n,) each."""
    # Crossings between excursions beyond half the largest torque, not those of a joint that settles around zero.
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


PAPER_LIMIT = 0.1  # the paper's limit of the difference between estimate and sensor without load [N·m]


@styled
def no_load(run: Run) -> Figure:
    """Fig. 5: sensor and estimate without load; below, their difference with the paper's ±0.1 N·m."""
    name, colors = main(run)
    kept = settled(run)
    to_sensor = run.estimate(name) - run.reading("joint_torque")
    to_truth = run.estimate(name) - run.truth("joint_torque")
    within = 100 * np.mean(np.abs(to_truth[kept]) < PAPER_LIMIT)
    within_sensor = 100 * np.mean(np.abs(to_sensor[kept]) < PAPER_LIMIT)
    caption = (
        f"Paper: after a transient the difference between estimate and sensor is below {PAPER_LIMIT:g} N·m, in optimal "
        f"mode. Ours, {name} after {run.scenario.transient:g} s: against the truth RMS {rms(to_truth[kept]):.3f}, "
        f"largest {peak(to_truth[kept]):.3f} N·m, below the limit {within:.2f} % of the time; against the sensor "
        f"(noise {run.joint.sensors.joint_torque.noise:g} N·m rms) RMS {rms(to_sensor[kept]):.3f}, largest "
        f"{peak(to_sensor[kept]):.3f} N·m, below it {within_sensor:.2f} %. "
        f"Robust mode {robust_share(run, name, kept):.0f} % of the time."
    )
    figure, ((top,), (bottom,), (below,)) = sheet(f"Fig. 5  Without load  ·  {run.name}", caption, [2.2, 2.2, 0.8])
    torques(run, top, [name], truth_on_top=True)
    legend(top)
    limit = 1.15 * max(peak(to_sensor[kept]), PAPER_LIMIT)
    bottom.axhspan(-PAPER_LIMIT, PAPER_LIMIT, color="#EAF5F0", lw=0, label=f"paper: ±{PAPER_LIMIT:g} N·m")
    line(bottom, run.time, to_sensor, SENSOR, f"{name} − sensor", lw=0.7)
    line(bottom, run.time, to_truth, colors[name], f"{name} − truth", lw=0.9)
    bottom.set(ylabel="difference [N·m]", ylim=(-limit, limit))
    legend(bottom)
    mode(run, below, [name], fill=name)
    legend(below)
    return figure


@styled
def link_sweep(run: Run) -> Figure:
    """Fig. 7: torque with link, difference between estimate and sensor, working mode."""
    name, _ = main(run)
    quarters = np.array_split(np.flatnonzero(settled(run)), 4)
    robust = [robust_share(run, name, part) for part in quarters]
    caption = (
        "Paper: RAREKF starts in optimal mode and changes gradually to robust mode with growing load; the difference is "
        "relatively high while it switches, acceptable overall; no numbers. "
        f"Ours: {name} {against(run, name)}; in robust mode {', '.join(f'{r:.0f}' for r in robust)} % of the time in "
        f"the four quarters of the run, while the torque goes to {run.truth('joint_torque')[-1]:.1f} N·m"
    )
    alpha = run.estimates[name].columns.get("alpha")
    caption += "." if alpha is None else f" and α to {alpha[-1]:.1f}: a larger α tolerates more before it switches."
    return _sweep(run, "Fig. 7  Link from vertical to horizontal", caption)


@styled
def external_push(run: Run) -> Figure:
    """Fig. 8: the sweep with pushes in both directions."""
    name, _ = main(run)
    caption = (
        "Paper: manual pushes in both directions during the link sweep, to show the response to sudden changes; no numbers. "
        f"Ours: {name} {against(run, name)}" + response(run) + ". Shaded: the pushes; framed: those of Fig. 9."
    )
    return _sweep(run, "Fig. 8  Link with external pushes", caption)


def _sweep(run: Run, title: str, caption: str) -> Figure:
    """Torque, difference to sensor and truth, working mode; pushes shaded, those of Fig. 9 framed."""
    name, colors = main(run)
    figure, ((top,), (bottom,), (below,)) = sheet(f"{title}  ·  {run.name}", caption, [2.1, 2.1, 1.4], right=0.56)
    torques(run, top, [name])
    legend(top)
    to_sensor = run.estimate(name) - run.reading("joint_torque")
    line(bottom, run.time, to_sensor, SENSOR, f"{name} − sensor", lw=0.7)
    line(bottom, run.time, run.estimate(name) - run.truth("joint_torque"), colors[name], f"{name} − truth", lw=0.9)
    limit = 1.1 * peak(to_sensor[settled(run)])
    bottom.set(ylabel="difference [N·m]", ylim=(-limit, limit))
    legend(bottom)
    mode(run, below, [*(n for n in switching(run) if n != name), name], fill=name)
    load = below.twinx()
    alpha = run.estimates[name].columns.get("alpha")
    if alpha is not None:
        i = envelope(alpha, PIXELS)
        load.plot(run.time[i], alpha[i], color=COMMAND, label=f"α of {name} (right)", ls="--")
    load.set(ylabel="α", ylim=(0, None))
    load.margins(x=0.01)
    load.grid(visible=False)
    load.spines["right"].set_visible(True)
    legend(below, load)
    near = zoomed(run)
    for d in run.scenario.happening:
        for axes in (top, bottom, below):
            axes.axvspan(d.start, d.start + d.duration, color=EXTERNAL, alpha=0.14, lw=0)
        if d in near:
            inside = window(run, d)
            low, high = run.time[inside][[0, -1]]
            y = run.reading("joint_torque")[inside]
            corner, width, height = (low, y.min() - 0.4), high - low, np.ptp(y) + 0.8
            top.add_patch(Rectangle(corner, width, height, fill=False, color=EXTERNAL, lw=1.2, zorder=5))
    return figure


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
