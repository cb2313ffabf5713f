"""The paper's experiments over time: Fig. 5 without load, Fig. 7 with the link, Fig. 8 with pushes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..posteriors import robust_share, settled, switching
from ..series import envelope
from ..style import COMMAND, EXTERNAL, SENSOR
from .sheet import PIXELS, legend, sheet, styled
from .signals import against, line, main, mode, peak, response, rms, torques
from .zoom import window, zoomed

if TYPE_CHECKING:
    from ...scenarios.run import Run

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
