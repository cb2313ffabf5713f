"""A diagnosis as a recording: a tab per recording of the measurement, with the joint in motion and the channels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...models.recording import Recording
from ...sim.shape import shape
from ..report import Report, markdown, plain
from ..residuals import Overlay, overlays
from ..style import SENSOR, TRUTH
from .recording import TIMELINE, entity, joint_view, layout, recording, send_series, series_view
from .scene import Scene, reach, thin_frames

BEFORE, AFTER = "#E0533D", TRUTH
"""Colours of the simulation and of the extended joint's, as on the page."""


def write_rerun_report(report: Report, path: Path) -> Path:
    """Write a diagnosis as a recording: a tab per recording of the measurement, with verdict and tables. Raises
    `InputError`: the file cannot be written, or an MJCF that cannot be read."""
    shown = overlays(report)
    parts = [(r, [o for row in shown for o in row if o.name == r.name]) for r in report.used.recordings]
    model = shape(report.joint)
    notes = rrb.TextDocumentView(origin="notes", name="Diagnosis")
    tabs = [_panel(r, found, reach(model), notes) for r, found in parts if found]
    end = max((float(o.time[-1]) for _, found in parts for o in found), default=0.0)
    root: rrb.Container = rrb.Tabs(contents=tabs) if tabs else rrb.Vertical(notes)
    with recording(path, f"diagnosis of {report.measurement.name}", layout(root, end)) as stream:
        text = f"{markdown(report)}\n*simulated*: the calibrated joint; *extended*: with the causes in it."
        stream.log("notes", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True, strict=True)
        for r, found in parts:
            if found:
                _send_joint(stream, report, r, found, model)
                for o in found:
                    send_channel(stream, o)
    return Path(path)


def _place(name: str) -> str:
    return f"recordings/{entity(name)}"


def _path(o: Overlay) -> str:
    return f"{_place(o.name)}/{o.channel}"


def send_channel(stream: rr.RecordingStream, o: Overlay) -> None:
    """Send measured and simulated values of a channel, if it is measured, and their differences."""
    if o.measured is not None:
        send_series(stream, o.time, f"{_path(o)}/values/measured", o.measured, "measured", SENSOR)
    for label, left, color in (("simulated", o.before, BEFORE), ("extended", o.after, AFTER)):
        if o.measured is not None:
            send_series(stream, o.time, f"{_path(o)}/values/{label}", o.measured - left, label, color)
        send_series(stream, o.time, f"{_path(o)}/residual/{label}", left, label, color)


def _panel(r: Recording, found: Sequence[Overlay], far: float, notes: rrb.View) -> rrb.Container:
    place = _place(r.name)
    values = [
        series_view(f"{plain(o.channel)} [{o.unit}]", f"{_path(o)}/values") for o in found if o.measured is not None
    ]
    left = [series_view(f"{plain(o.channel)}, measured − simulated [{o.unit}]", f"{_path(o)}/residual") for o in found]
    torques = "Torque measured (grey), simulated, extended"
    sensed = any(o.channel == "joint_torque" for o in found)
    joint = joint_view(torques if sensed else "Measured joint", f"{place}/scene", far)
    columns = [rrb.Vertical(joint, notes, row_shares=[1, 1])]
    columns += [rrb.Vertical(contents=panels) for panels in (values, left) if panels]
    return rrb.Horizontal(contents=columns, column_shares=[1.0, 1.2, 1.2][: len(columns)], name=r.name)


def _send_joint(
    stream: rr.RecordingStream, report: Report, r: Recording, found: Sequence[Overlay], model: mujoco.MjModel
) -> None:
    """Send the joint by its encoders, and measured and simulated torques."""
    time = r.time - r.time[0]
    frames = thin_frames(time)
    at = time[frames]
    ratio = report.joint.numbers["N"].value
    # An end without encoder follows the other one, without torsion.
    if "link_position" in r:
        link = r["link_position"][frames]
        motor = r["motor_position"][frames] if "motor_position" in r else ratio * link
    elif "motor_position" in r:
        motor = r["motor_position"][frames]
        link = motor / ratio
    else:
        return
    columns = [rr.TimeColumn(TIMELINE, duration=at)]
    scene = Scene(stream, f"{_place(r.name)}/scene", model)
    # The wave generator follows the rotor within milliradians, which are not measured.
    scene.send_bodies(columns, np.column_stack([motor, motor, link]), r.link.gravity_moment == 0)
    for o in found:
        if o.channel == "joint_torque" and o.measured is not None:
            curves = {
                "measured": (o.measured, SENSOR),
                "simulated": (o.measured - o.before, BEFORE),
                "extended": (o.measured - o.after, AFTER),
            }
            torques = {name: (_sampled(at, o.time, x), color) for name, (x, color) in curves.items()}
            scene.send_torques(columns, torques)


def _sampled(at: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A curve at other times, shape (f,); zero where it is missing."""
    good = np.isfinite(values)
    if not good.any():
        return np.zeros(len(at))
    near = np.clip(np.searchsorted(time, at), 0, len(time) - 1)
    return np.where(good[near], np.interp(at, time[good], values[good]), 0.0)
