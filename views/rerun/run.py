"""A run as a recording: its signals, what the filters thought, and its joint in motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from ..posteriors import innovations, modes, switching
from ..series import share
from ..style import COMMAND, EXTERNAL, MODEL, PARTS, SENSOR, TRUTH, filter_colors
from ..tables import comparison_markdown
from .blueprint import SHARE_WINDOW, run_blueprint
from .recording import POINTS, TIMELINE, recording, rgb, send_series
from .scene import reach, send_scene, shape_of

if TYPE_CHECKING:
    from ...scenarios.run import Run

MODE_WINDOW = 0.02
"""Window [s] of the mode lanes: robust where the filter is for at least half of it."""


def write_rerun(run: Run, path: Path) -> Path:
    """Write a run as a Rerun recording.

    Args:
      run: the run.
      path: of the `.rrd` file.

    Returns:
      The path.

    Raises:
      InputError: the file cannot be written.
    """
    model = shape_of(run.joint)
    with recording(path, run.name, run_blueprint(run, reach(model))) as stream:
        send_scene(stream, run, model)
        _send_torques(stream, run)
        _send_filters(stream, run)
        _send_torsion(stream, run)
        _send_motion(stream, run)
        notes = rr.TextDocument(_notes(run), media_type=rr.MediaType.MARKDOWN)
        stream.log("notes", notes, static=True, strict=True)
    return Path(path)


def _interesting(run: Run) -> np.ndarray:
    """Samples around disturbances' edges, which keep every millisecond as far as the points suffice; shape (n,)."""
    edges = [edge for d in run.scenario.happening for edge in (d.start, d.start + d.duration)]
    near = np.zeros(len(run.time), dtype=bool)
    if edges:
        reach = min(0.2, 0.5 * POINTS * float(run.time[1] - run.time[0]) / (2 * len(edges)))
        for edge in edges:
            near |= np.abs(run.time - edge) <= reach
    return near


def _send_torques(stream: rr.RecordingStream, run: Run) -> None:
    near, truth = _interesting(run), run.truth("joint_torque")
    colors = filter_colors(run.estimates)

    def send(path: str, values: np.ndarray, name: str, color: str, width: float = 1.5, visible: bool = True) -> None:
        send_series(stream, path, run.time, values, name, color, width, near, visible=visible)

    send("torque/sensor", run.reading("joint_torque"), "torque sensor", SENSOR, 1.0)
    send("torque/model", run.model_torque, "raw model", MODEL, visible=False)
    for name, found in run.estimates.items():
        # Series are drawn in the order of their paths: a filter that is always robust would cover the paper's three.
        shown = found.robust is None or not found.robust[1:].all()
        send(f"torque/{name}", run.estimate(name), name, colors[name], 2.5, shown)
        send(f"error/{name}", run.estimate(name) - truth, name, colors[name], 1.5, shown)
    send("torque/truth", truth, "truth", TRUTH, 1.0)
    send("external_torque", run.external_torque, "external torque on the link", EXTERNAL)


def _send_filters(stream: rr.RecordingStream, run: Run) -> None:
    near = _interesting(run)
    period = float(run.time[1] - run.time[0])
    found = innovations(run)
    for name, color in filter_colors(run.estimates).items():
        place = f"innovation/{name}"
        if name in found:
            deviation = found[name].deviation
            send_series(stream, f"{place}/innovation", run.time, found[name].values, "innovation", color, 1.0, near)
            for sign, label in ((1, "+√P_Y"), (-1, "−√P_Y")):
                part = "upper" if sign > 0 else "lower"
                send_series(stream, f"{place}/{part}", run.time, sign * deviation, label, SENSOR, 1.5, near)
        if name in switching(run):
            robust = modes(run, name)
            percent = 100 * share(robust, round(SHARE_WINDOW / period))
            send_series(stream, f"robust_share/{name}", run.time, percent, name, color, points=POINTS // 4)
            _send_mode(stream, f"mode/{name}", run.time, robust, round(MODE_WINDOW / period), color)


def _send_mode(
    stream: rr.RecordingStream, path: str, time: np.ndarray, robust: np.ndarray, window: int, color: str
) -> None:
    """Send the mode as a lane: its changes, of the majority in each window."""
    start = np.arange(0, len(robust), max(window, 1))
    majority = np.add.reduceat(robust.astype(int), start) * 2 >= np.diff(np.append(start, len(robust)))
    changes = np.flatnonzero(np.append(True, majority[1:] != majority[:-1]))
    stream.log(
        path,
        rr.StateConfiguration(values=["optimal", "robust"], labels=[" ", " "], colors=[rgb("#3A4048"), rgb(color)]),
        static=True,
        strict=True,
    )
    states = np.where(majority[changes], "robust", "optimal").tolist()
    at = rr.TimeColumn(TIMELINE, duration=time[start[changes]])
    stream.send_columns(path, [at], rr.StateChange.columns(state=states), strict=True)


def _send_torsion(stream: rr.RecordingStream, run: Run) -> None:
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
        send_series(stream, f"torsion/{part}", run.time, 1e3 * values, name, PARTS[part], width, _interesting(run))


def _send_motion(stream: rr.RecordingStream, run: Run) -> None:
    link = run.truth("link_position")
    send = [
        ("position/command", np.degrees(run.position_command), "command", COMMAND),
        ("position/link", np.degrees(link), "link", TRUTH),
        ("position_error", 1e3 * (run.position_command - link), "command − link", TRUTH),
        ("current/read", run.reading("motor_current"), "read", SENSOR),
        ("current/true", run.truth("motor_current"), "true", TRUTH),
    ]
    for path, values, name, color in send:
        send_series(stream, path, run.time, values, name, color)


def _notes(run: Run) -> str:
    scenario = run.scenario
    mounting = scenario.mounting or run.joint.mounting
    lines = [
        f"# {run.name}",
        scenario.description,
        "",
        f"Joint **{run.joint.name}**, mounting **{mounting}**, {run.time[-1] + run.time[1] - run.time[0]:g} s, "
        f"seed {scenario.seed}, feedback: {scenario.feedback}."
        + (f" Reproduces the paper's {scenario.figure}." if scenario.figure else ""),
        "",
    ]
    lines += [f"* {note}" for note in run.notes]
    if run.metrics.get("filters"):
        table = comparison_markdown({run.name: run.metrics}, keys=("rms", "max", "robust_share"))
        lines += ["Errors against the noise-free joint torque:", "", table]
    return "\n".join(lines)
