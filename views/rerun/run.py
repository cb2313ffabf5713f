"""A run as a recording: signals, innovations, and the joint in motion."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from ...sim.shape import shape
from ..posteriors import SHARE_WINDOW, innovations, modes, switching
from ..series import share
from ..style import COMMAND, EXTERNAL, MODEL, PARTS, SENSOR, TRUTH, filter_colors
from ..tables import comparison_markdown
from .blueprint import run_blueprint
from .recording import POINTS, TIMELINE, is_new, recording, rgb, send_series
from .scene import reach, send_scene

if TYPE_CHECKING:
    import mujoco

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
        self.run, self._stream, self._model = run, stream, shape(run.joint)
        self._colors = filter_colors(run.estimates)
        self._pushed = bool(np.any(run.external_torque))
        self._visible = set(run.estimates) - always_robust(run)
        self._shares = {name: share_of(modes(run, name), run.time) for name in switching(run)}
        samples = window_samples(MODE_WINDOW, run.time)
        self._windows = {name: windows(run.time, modes(run, name), samples) for name in self._shares}
        stream.send_blueprint(run_blueprint(run, reach(self._model), live))
        stream.send_recording_name(run.name)
        send_notes(stream, asked(run))

    def send(self, ticks: slice) -> None:
        """Send the next ticks, two at least."""
        part = self.run.part(ticks)
        points = max(round(POINTS * len(part.time) / len(self.run.time)), 2)
        send_run(self._stream, part, self._model, self._colors, self._pushed, points, self._visible)
        for name, percent in self._shares.items():
            color, (start, robust) = self._colors[name], self._windows[name]
            send_series(
                self._stream, f"robust_share/{name}", part.time, percent[ticks], name, color, points=max(points // 4, 2)
            )
            first, end = np.searchsorted(start, [part.time[0], part.time[-1] + 1e-9])
            send_mode(
                self._stream, name, start[first:end], robust[first:end], color, robust[first - 1] if first else None
            )

    def finish(self) -> None:
        """Send the results."""
        send_notes(self._stream, notes(self.run))


def send_run(
    stream: rr.RecordingStream,
    run: Run,
    model: mujoco.MjModel,
    colors: Mapping[str, str],
    pushed: bool,
    points: int,
    visible: Collection[str],
) -> None:
    """Send a run or a stretch of it: scene, torques, innovations, torsion, motion. `model`: the joint's shape;
    `colors`: of the filters, by name; `pushed`: whether there is an external torque; `visible`: of `_send_estimates`."""
    near = _interesting(run)
    send_scene(stream, run, model, colors, pushed)
    _send_torques(stream, run, near, points)
    _send_estimates(stream, run, colors, points, visible)
    _send_torsion(stream, run, near, points)
    _send_motion(stream, run, points)


def _interesting(run: Run) -> np.ndarray:
    """Samples around disturbances' edges, which are all kept if there are few; shape (n,), bool."""
    edges = [edge for d in run.scenario.happening for edge in (d.start, d.start + d.duration)]
    near = np.zeros(len(run.time), dtype=bool)
    if edges:
        reach = min(0.2, 0.5 * POINTS * float(run.time[1] - run.time[0]) / (2 * len(edges)))
        for edge in edges:
            near |= np.abs(run.time - edge) <= reach
    return near


def _send_torques(stream: rr.RecordingStream, run: Run, near: np.ndarray, points: int) -> None:
    def send(path: str, values: np.ndarray, name: str, color: str, width: float = 1.5, visible: bool = True) -> None:
        send_series(stream, path, run.time, values, name, color, width, near, points, visible)

    send("torque/sensor", run.reading("joint_torque"), "torque sensor", SENSOR, 1.0)
    send("torque/model", run.model_torque, "raw model", MODEL, visible=False)
    send("torque/truth", run.truth("joint_torque"), "truth", TRUTH, 1.0)
    send("external_torque", run.external_torque, "external torque on the link", EXTERNAL)


def _send_estimates(
    stream: rr.RecordingStream, run: Run, colors: Mapping[str, str], points: int, visible: Collection[str]
) -> None:
    """Send the estimates of the filters in `colors`, their errors and innovations; `visible`: filters that are shown at
    first."""
    near, truth = _interesting(run), run.truth("joint_torque")
    found = innovations(run)
    for name, color in colors.items():
        values = run.estimate(name)
        shown = name in visible
        send_series(stream, f"torque/{name}", run.time, values, name, color, 2.5, near, points, shown)
        send_series(stream, f"error/{name}", run.time, values - truth, name, color, 1.5, near, points, shown)
        if name in found:
            place, deviation = f"innovation/{name}", found[name].deviation
            innovation = found[name].values
            send_series(stream, f"{place}/innovation", run.time, innovation, "innovation", color, 1.0, near, points)
            for sign, label in ((1, "+√P_Y"), (-1, "−√P_Y")):
                part = "upper" if sign > 0 else "lower"
                limit = sign * deviation
                send_series(stream, f"{place}/{part}", run.time, limit, label, SENSOR, 1.5, near, points)


def always_robust(run: Run) -> set[str]:
    """Return the filters that are always in robust mode from the second sample on. Series are drawn in the order of
    their paths: such a filter would hide the paper's three."""
    return {name for name, one in run.estimates.items() if one.robust is not None and one.robust[1:].all()}


def share_of(robust: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the moving share of robust mode [%], shape (n,)."""
    return 100 * share(robust, window_samples(SHARE_WINDOW, time))


def window_samples(window: float, time: np.ndarray) -> int:
    """Return the number of samples of a window [s], at least one."""
    return max(round(window / float(time[1] - time[0])), 1)


def windows(time: np.ndarray, robust: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the starts [s] of windows, and whether the majority of each is robust."""
    start = np.arange(0, len(robust), samples)
    return time[start], np.add.reduceat(robust.astype(int), start) * 2 >= np.diff(np.append(start, len(robust)))


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


def _send_torsion(stream: rr.RecordingStream, run: Run, near: np.ndarray, points: int) -> None:
    """Eq. (1) on the true state: Δθ = Δθf + Δθw/N + θerr."""
    N = run.joint.numbers["N"].value
    rotor, wave, link = (run.truth(f"{name}_position") for name in ("motor", "wave_generator", "link"))
    total = rotor / N - link
    generator = (rotor - wave) / N
    parts = {
        "total": ("Δθ, total", total, 2.5),
        "flexspline": ("Δθf, flexspline", total - generator - run.kinematic_error, 1.5),
        "wave_generator": ("Δθw/N, wave generator", generator, 1.5),
        "kinematic_error": ("θerr, kinematic error", run.kinematic_error, 1.5),
    }
    for part, (name, values, width) in parts.items():
        send_series(stream, f"torsion/{part}", run.time, 1e3 * values, name, PARTS[part], width, near, points)


def _send_motion(stream: rr.RecordingStream, run: Run, points: int) -> None:
    link = run.truth("link_position")
    send = [
        ("position/link", np.degrees(link), "link", TRUTH),
        ("current/read", run.reading("motor_current"), "read", SENSOR),
        ("current/true", run.truth("motor_current"), "true", TRUTH),
    ]
    if run.position_command is not None:
        send += [
            ("position/command", np.degrees(run.position_command), "command", COMMAND),
            ("position_error", 1e3 * run.command_error, "command − link", TRUTH),
        ]
    for path, values, name, color in send:
        send_series(stream, path, run.time, values, name, color, points=points)


def send_notes(stream: rr.RecordingStream, text: str) -> None:
    """Send Markdown to the panel of notes."""
    stream.log("notes", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True, strict=True)


def asked(run: Run) -> str:
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


def notes(run: Run) -> str:
    """Return the scenario and the results as Markdown."""
    lines = [asked(run), *(f"* {note}" for note in run.notes)]
    if run.metrics.get("filters"):
        table = comparison_markdown({run.name: run.metrics}, keys=("rms", "max", "robust_share"))
        lines += ["", "Errors against the noise-free joint torque:", "", table]
    return "\n".join(lines)
