"""A run as a recording: signals, innovations, and the joint in motion."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...sim.shape import shape
from ..posteriors import SHARE_WINDOW, innovations, modes, robust_shares, settled, switching
from ..style import COMMAND, EXTERNAL, MODEL, PARTS, SENSOR, TRUTH, filter_colors, main_filter
from ..tables import comparison_markdown
from .recording import (
    POINTS,
    SHARED_TIME,
    TIMELINE,
    is_new,
    joint_view,
    layout,
    recording,
    rgb,
    send_series,
    series_view,
)  # fmt: skip
from .scene import Scene, reach

if TYPE_CHECKING:
    from ...scenarios.run import Run

MODE_WINDOW = 0.02  # window [s] of the mode lanes: robust if the filter is in robust mode for at least half of it


def write_rerun(run: Run, path: Path) -> Path:
    """Write a run as a Rerun recording (`.rrd`); return the path. Raises `InputError`: the file cannot be written."""
    with recording(path, run.name) as stream:
        shown = RunRecording(stream, run)
        shown.send(slice(0, len(run.time)))
        shown.finish()
    return Path(path)


class RunRecording:
    """Sends a run to a file or a viewer, as a whole or stretch by stretch."""

    def __init__(self, stream: rr.RecordingStream, run: Run, live: bool = False):
        """Send the scenario, and the layout; `live`: whose cursor follows the data."""
        model = shape(run.joint)
        self.run, self._stream, self._scene = run, stream, Scene(stream, "scene", model)
        self._colors = filter_colors(run.estimates)
        self._pushed = bool(np.any(run.external_torque))
        # Series are drawn in the order of their paths: a filter that is always robust would hide the paper's three.
        self._hidden = {n for n, one in run.estimates.items() if one.robust is not None and one.robust[1:].all()}
        self._shares = {name: robust_shares(run, name) for name in switching(run)}
        self._windows = {name: windows(run, name) for name in self._shares}
        stream.send_blueprint(_blueprint(run, reach(model), live))
        stream.send_recording_name(run.name)
        self._send_notes(_asked(run))

    def send(self, ticks: slice) -> None:
        """Send the next ticks, two at least: joint, torques, innovations, torsion, motion, modes."""
        run = self.run.part(ticks)
        points = max(round(POINTS * len(run.time) / len(self.run.time)), 2)
        main = main_filter(self._colors)
        torques = {"true": (run.truth("joint_torque"), TRUTH), main: (run.estimate(main), self._colors[main])}
        self._scene.send_run(run, torques, self._pushed)
        plain = partial(send_series, self._stream, run.time, points=points)
        series = partial(plain, keep=_interesting(run))
        self._send_torques(run, series)
        _send_torsion(run, series)
        _send_motion(run, plain)
        for name, percent in self._shares.items():
            color, (start, robust) = self._colors[name], self._windows[name]
            plain(f"robust_share/{name}", percent[ticks], name, color, points=max(points // 4, 2))
            first, end = np.searchsorted(start, [run.time[0], run.time[-1] + 1e-9])
            before = robust[first - 1] if first else None
            send_mode(self._stream, name, start[first:end], robust[first:end], color, before)

    def finish(self) -> None:
        """Send the results."""
        self._send_notes(_notes(self.run))

    def _send_notes(self, text: str) -> None:
        notes = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._stream.log("notes", notes, static=True, strict=True)

    def _send_torques(self, run: Run, series: Callable[..., None]) -> None:
        """Send torques, and the filters' estimates, errors and innovations."""
        truth, found = run.truth("joint_torque"), innovations(run)
        series("torque/sensor", run.reading("joint_torque"), "torque sensor", SENSOR, 1.0)
        series("torque/model", run.model_torque, "raw model", MODEL, visible=False)
        series("torque/truth", truth, "truth", TRUTH, 1.0)
        series("external_torque", run.external_torque, "external torque on the link", EXTERNAL)
        for name, color in self._colors.items():
            estimate, visible = run.estimate(name), name not in self._hidden
            series(f"torque/{name}", estimate, name, color, 2.5, visible=visible)
            series(f"error/{name}", estimate - truth, name, color, visible=visible)
            if name in found:
                place, deviation = f"innovation/{name}", found[name].deviation
                series(f"{place}/innovation", found[name].values, "innovation", color, 1.0)
                series(f"{place}/upper", deviation, "+√P_Y", SENSOR)
                series(f"{place}/lower", -deviation, "−√P_Y", SENSOR)


def _blueprint(run: Run, far: float, live: bool) -> rrb.Blueprint:
    """Return the layout of a run; `far`: reach of the link [m], for the camera; `live`: the cursor follows the data."""
    names, stated, pushed = list(run.estimates), tuple(innovations(run)), bool(np.any(run.external_torque))
    main = main_filter(names)
    # 1.5 times the main filter's largest error after the transient [N·m]
    limit = 1.5 * float(np.abs((run.estimate(main) - run.truth("joint_torque"))[settled(run)]).max())
    joint = joint_view("Joint: torque true (green), estimated, external (pink)", "scene", far)
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
        series_view("Estimate − truth [N·m]", "error", legend=False, limits=(-limit, limit)),
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


def _interesting(run: Run) -> np.ndarray:
    """Samples around disturbances' edges, which are all kept if there are few; shape (n,), bool."""
    edges = [edge for d in run.scenario.happening for edge in (d.start, d.start + d.duration)]
    near = np.zeros(len(run.time), dtype=bool)
    if edges:
        reach = min(0.2, 0.5 * POINTS * float(run.time[1] - run.time[0]) / (2 * len(edges)))
        for edge in edges:
            near |= np.abs(run.time - edge) <= reach
    return near


def windows(run: Run, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the starts [s] of windows of `MODE_WINDOW`, and whether a filter is robust in the majority of each."""
    robust, period = modes(run, name), float(run.time[1] - run.time[0])
    start = np.arange(0, len(robust), max(round(MODE_WINDOW / period), 1))
    return run.time[start], np.add.reduceat(robust.astype(int), start) * 2 >= np.diff(np.append(start, len(robust)))


def send_mode(
    stream: rr.RecordingStream, name: str, start: np.ndarray, robust: np.ndarray, color: str, before: bool | None = None
) -> None:
    """Send a filter's mode, of `windows`, as a lane: its changes. `before`: whether the window before them was robust."""
    previous = np.append(~robust[:1] if before is None else before, robust[:-1])
    changes = np.flatnonzero(robust != previous)  # none without a window
    if not len(changes):
        return
    path = f"mode/{name}"
    if is_new(stream, path):
        looks = rr.StateConfiguration(
            values=["optimal", "robust"], labels=[" ", " "], colors=[rgb("#3A4048"), rgb(color)]
        )
        stream.log(path, looks, static=True, strict=True)
    states = np.where(robust[changes], "robust", "optimal").tolist()
    at = rr.TimeColumn(TIMELINE, duration=start[changes])
    stream.send_columns(path, [at], rr.StateChange.columns(state=states), strict=True)


def _send_torsion(run: Run, series: Callable[..., None]) -> None:
    """Eq. (1) on the true state: Δθ = Δθf + Δθw/N + θerr."""
    N = run.joint.numbers["N"].value
    rotor, wave, link = (run.truth(f"{name}_position") for name in ("motor", "wave_generator", "link"))
    total = rotor / N - link
    generator = (rotor - wave) / N
    flexspline = total - generator - run.kinematic_error
    series("torsion/total", 1e3 * total, "Δθ, total", PARTS["total"], 2.5)
    series("torsion/flexspline", 1e3 * flexspline, "Δθf, flexspline", PARTS["flexspline"])
    series("torsion/wave_generator", 1e3 * generator, "Δθw/N, wave generator", PARTS["wave_generator"])
    series("torsion/kinematic_error", 1e3 * run.kinematic_error, "θerr, kinematic error", PARTS["kinematic_error"])


def _send_motion(run: Run, series: Callable[..., None]) -> None:
    series("position/link", np.degrees(run.truth("link_position")), "link", TRUTH)
    series("current/read", run.reading("motor_current"), "read", SENSOR)
    series("current/true", run.truth("motor_current"), "true", TRUTH)
    if run.position_command is not None:
        series("position/command", np.degrees(run.position_command), "command", COMMAND)
        series("position_error", 1e3 * run.command_error, "command − link", TRUTH)


def _asked(run: Run) -> str:
    """Return the scenario as Markdown."""
    scenario = run.scenario
    mounting = scenario.mounting or run.joint.mounting
    lines = [
        f"# {run.name}",
        scenario.description,
        "",
        f"Joint **{run.joint.name}**, mounting **{mounting}**, {scenario.duration:g} s, "
        f"seed {scenario.seed}, feedback: {scenario.feedback}."
        + (f" Reproduces the paper's {scenario.figure}." if scenario.figure else ""),
        "",
    ]
    return "\n".join(lines)


def _notes(run: Run) -> str:
    """Return the scenario and the results as Markdown."""
    lines = [_asked(run), *(f"* {note}" for note in run.notes)]
    if run.metrics.get("filters"):
        table = comparison_markdown({run.name: run.metrics}, keys=("rms", "max", "robust_share"))
        lines += ["", "Errors against the noise-free joint torque:", "", table]
    return "\n".join(lines)
