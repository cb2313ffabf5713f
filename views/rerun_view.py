"""Recordings for the Rerun viewer: a run with its joint in motion, and measured against simulated channels.

Everything is sent in columns on the timeline `time` [s] and thinned so that the peaks stay; the blueprint is embedded,
so that a recording opens laid out. Entities: `scene/…` the 3D joint, `torque/…`, `error/…`, `innovation/<filter>/…`,
`mode/<filter>`, `robust_share/<filter>`, `torsion/…`, `external_torque`, `position/…`, `position_error`, `current/…`.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..estimator import torsions
from ..models.files import write_into_place
from ..sim import plant
from .report import Report, markdown
from .residuals import overlays
from .series import envelope, share
from .style import (
    COMMAND,
    EXTERNAL,
    MODEL,
    PARTS,
    SENSOR,
    TRUTH,
    filter_colors,
    main_filter,
)
from .tables import comparison_markdown

if TYPE_CHECKING:
    from ..scenarios.run import Run

TIMELINE = "time"
FRAME_RATE = 50.0
"""Poses of the 3D scene per second."""
POINTS = 8000
"""Most points of a series; peaks stay, and pushes keep every sample where that leaves enough for the rest."""
MODE_WINDOW = 0.02
"""Window [s] of the mode lanes: robust where the filter is for at least half of it."""
SHARE_WINDOW = 0.25
"""Window [s] of the share of the time in robust mode."""
DEGREES_PER_TORQUE = 12.0
"""Length of the torque arrows around the axis [°/(N·m)]."""
FORCE_SCALE = 0.012
"""Length of the arrow of the external force at the link's tip [m/N]."""
_SHARED_TIME = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
_GLOBAL_VIEW = uuid.UUID("5c0dca6a-e63f-9cf7-f657-2602590474cc")
"""`GLOBAL_VIEW_ID` of Rerun's viewer (re_viewer_context)."""
_LARGEST_ARC = 300.0
_ARC_POINTS = 25


# Pieces that any recording is made of


@contextmanager
def recording(path: Path, name: str, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Open a recording that is moved to `path` when the block ends well, and removed when not.

    Args:
      path: of the `.rrd` file.
      name: how the viewer calls the recording.
      blueprint: its layout.

    Raises:
      InputError: the file cannot be written.
    """
    with write_into_place(Path(path)) as temporary:
        # The viewer keeps one layout per application: recordings of other content must not share it.
        stream = rr.RecordingStream(f"flexspline {name}")
        stream.save(temporary, default_blueprint=blueprint)
        stream.send_recording_name(name)
        try:
            yield stream
        finally:
            stream.flush()
            stream.disconnect()


def send_series(
    stream: rr.RecordingStream,
    path: str,
    time: np.ndarray,
    values: np.ndarray,
    name: str,
    color: str,
    width: float = 1.5,
    keep: np.ndarray | None = None,
    points: int = POINTS,
    visible: bool = True,
) -> None:
    """Send a time series, thinned; values that are not finite leave a gap.

    Args:
      stream: the recording.
      path: entity path.
      time, values: shape (n,); time in s.
      name: in the legend, with the unit where the view does not say it.
      color: `#RRGGBB`.
      width: of the line [ui points].
      keep: samples that stay whatever they are, shape (n,), bool.
      points: about how many samples stay.
      visible: whether it is shown before one asks for it in the legend.
    """
    peaks = rr.components.AggregationPolicy.MinMax
    line = rr.SeriesLines(colors=rgb(color), names=name, widths=width, visible_series=visible, aggregation_policy=peaks)
    stream.log(path, line, static=True, strict=True)
    finite = np.isfinite(values)
    shown = values if finite.all() else np.where(finite, values, np.mean(values[finite]) if finite.any() else 0.0)
    i = envelope(shown, points // 2, keep)
    stream.send_columns(
        path, [rr.TimeColumn(TIMELINE, duration=time[i])], rr.Scalars.columns(scalars=values[i]), strict=True
    )


def series_view(
    name: str, origin: str, legend: bool = True, limits: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    """A panel of the time series under `origin`, on the time axis that all panels share.

    Args:
      name: of the panel, with the unit.
      origin: entity path.
      legend: whether it has one, in the upper left corner.
      limits: of the values; all of them by default.
    """
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=_SHARED_TIME,
        axis_y=rrb.ScalarAxis(range=limits) if limits else None,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=legend),
    )


def layout(root: rrb.Container, end: float) -> rrb.Blueprint:
    """A blueprint with that content, all of the time from 0 to `end` [s] in view, the panels at the sides folded."""
    # The viewer keeps the range of the shared time axis with a view of this id. Unset, it shows 30 s about the cursor.
    shared = rrb.TimeSeriesView(
        name="shared time axis",
        contents=[],
        visible=False,
        axis_x=rrb.TimeAxis(
            view_range=rr.TimeRange(
                start=rrb.TimeRangeBoundary.absolute(seconds=0.0), end=rrb.TimeRangeBoundary.absolute(seconds=end)
            )
        ),
    )
    shared.id = _GLOBAL_VIEW
    return rrb.Blueprint(
        rrb.Horizontal(root, shared, column_shares=[1, 0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        auto_views=False,
        auto_layout=False,
    )


def rgb(color: str, alpha: int = 255) -> list[int]:
    """`#RRGGBB` as four bytes."""
    return [*(int(color[i : i + 2], 16) for i in (1, 3, 5)), alpha]


# Measured against simulated


@dataclass(frozen=True)
class Channel:
    """A measured quantity beside what a model says it should have been.

    Attributes:
      name: what it is, e.g. `joint torque`.
      unit: of values and residual.
      time: shape (n,) [s].
      measured, simulated: shape (n,); not finite where it is missing.
      candidates: further simulations by name (causes that were tried), each shape (n,).
    """

    name: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    candidates: Mapping[str, np.ndarray] | None = None

    @property
    def path(self) -> str:
        """Entity path under `channels/`."""
        return "channels/" + self.name.replace(" ", "_").replace("/", "_")


def rerun_measurement(path: Path, name: str, channels: Sequence[Channel], notes: str = "") -> Path:
    """Write measured channels against simulated ones as a recording: values above, residuals below, a tab each.

    Args:
      path: of the `.rrd` file.
      name: how the viewer calls the recording.
      channels: what to show.
      notes: Markdown beside the series; none: no such panel.

    Returns:
      The path.

    Raises:
      InputError: the file cannot be written.
    """
    root: rrb.Container = rrb.Tabs(contents=[channel_panel(channel) for channel in channels])
    if notes:
        root = rrb.Horizontal(root, rrb.TextDocumentView(origin="notes", name="Notes"), column_shares=[3, 1])
    end = max((float(channel.time[-1]) for channel in channels if len(channel.time)), default=0.0)
    with recording(path, name, layout(root, end)) as stream:
        for channel in channels:
            send_channel(stream, channel)
        if notes:
            stream.log("notes", rr.TextDocument(notes, media_type=rr.MediaType.MARKDOWN), static=True, strict=True)
    return Path(path)


def channel_panel(channel: Channel) -> rrb.Container:
    """The panel of a channel: values above, residuals below."""
    return rrb.Vertical(
        series_view(f"{channel.name} [{channel.unit}]", f"{channel.path}/values"),
        series_view(f"measured − simulated [{channel.unit}]", f"{channel.path}/residual"),
        row_shares=[3, 2],
        name=channel.name,
    )


def send_channel(stream: rr.RecordingStream, channel: Channel) -> None:
    """Send a channel's series."""
    simulations = {"simulated": channel.simulated, **(channel.candidates or {})}
    # What a candidate improves on is red, and the first candidate green, as in the page.
    palette = ("#E0533D", TRUTH, "#3D8FE0", "#E8A100", "#9A6FCB") if channel.candidates else (TRUTH,)
    colors = dict(zip(simulations, palette * len(simulations), strict=False))
    send_series(stream, f"{channel.path}/values/measured", channel.time, channel.measured, "measured", SENSOR)
    for label, values in simulations.items():
        place = label.replace(" ", "_").replace("/", "_")
        send_series(stream, f"{channel.path}/values/{place}", channel.time, values, label, colors[label])
        residual = channel.measured - values
        send_series(stream, f"{channel.path}/residual/{place}", channel.time, residual, label, colors[label])


def write_rerun_report(report: Report, path: Path) -> Path:
    """Write a diagnosis' channels as a recording, measured against simulated, its verdict and tables beside them.

    Raises:
      InputError: the file cannot be written.
    """
    channels = []
    for o in (o for row in overlays(report) for o in row):
        base = o.measured if o.measured is not None else np.zeros(len(o.time))
        name = f"{o.name} {o.channel.replace('_', ' ')}"
        channels.append(Channel(name, o.unit, o.time, base, base - o.before, {"extended": base - o.after}))
    return rerun_measurement(path, f"diagnosis of {report.measurement.name}", channels, markdown(report))


# A run


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
    mounting = run.joint.mount(run.scenario.mounting or None)
    model = plant.build(run.joint, mounting, locked_rotor=run.scenario.locked_rotor)
    with recording(path, run.name, run_blueprint(run, _reach(model))) as stream:
        send_scene(stream, run, model)
        _send_torques(stream, run)
        _send_filters(stream, run)
        _send_torsion(stream, run)
        _send_motion(stream, run)
        notes = rr.TextDocument(_notes(run), media_type=rr.MediaType.MARKDOWN)
        stream.log("notes", notes, static=True, strict=True)
    return Path(path)


def run_blueprint(run: Run, reach: float = 0.4) -> rrb.Blueprint:
    """The layout of a run: joint and notes on the left, estimates in the middle, what is behind them on the right.

    Args:
      run: the run.
      reach: of the link [m], for the camera.
    """
    names = [s.name for s in run.settings]
    main = main_filter(names)
    joint = rrb.Spatial3DView(
        name="Joint: torque true (green), estimated, external (pink)",
        origin="scene",
        background=[28, 31, 36],
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=(1.35 * reach, -2.3 * reach, 0.6 * reach),
            look_target=(0.2 * reach, 0.0, 0.0),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )
    # The same colours in all panels, so that one legend is enough.
    innovations = [
        series_view(f"Innovation {name} [N·m]" if name == main else name, f"innovation/{name}", legend=False)
        for name in (main, *(name for name in names if name != main))
    ]
    pushed = bool(np.any(run.external_torque))
    behind = [
        rrb.Tabs(contents=innovations, name="Innovation"),
        series_view("Torsion and its parts [mrad]", "torsion"),
        *([series_view("External torque [N·m]", "external_torque", legend=False)] if pushed else []),
        rrb.Tabs(
            series_view("Position error [mrad]", "position_error", legend=False),
            series_view("Position [°]", "position"),
            series_view("Motor current [A]", "current"),
            name="Motion",
        ),
    ]
    estimates = [
        series_view("Joint torque [N·m]", "torque"),
        series_view("Estimate − truth [N·m]", "error", legend=False, limits=_error_limits(run, main)),
        series_view(f"Robust mode [% of {SHARE_WINDOW:g} s]", "robust_share", legend=False, limits=(-5, 105)),
        rrb.StateTimelineView(name="Mode", origin="mode", time_view=_SHARED_TIME),
    ]
    return layout(
        rrb.Horizontal(
            rrb.Vertical(joint, rrb.TextDocumentView(origin="notes", name="Run"), row_shares=[3, 2]),
            rrb.Vertical(contents=estimates, row_shares=[3, 2.4, 1.6, 1.2]),
            rrb.Vertical(contents=behind, row_shares=[2, 2.2, *([1.2] if pushed else []), 1.6]),
            column_shares=[1.05, 1.4, 1.25],
        ),
        float(run.time[-1]),
    )


def _error_limits(run: Run, name: str) -> tuple[float, float]:
    """Of the error panel [N·m]: half as much again as the main filter's largest after the transient."""
    settled = run.time >= run.scenario.transient
    limit = 1.5 * float(np.abs((run.estimate(name) - run.truth("joint_torque"))[settled]).max())
    return -limit, limit


def _switching(run: Run) -> list[str]:
    """Filters that switch between optimal and robust mode; the others are always in one of them."""
    return [s.name for s in run.settings if s.rule in ("arekf", "rarekf")]


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
    colors = filter_colors(s.name for s in run.settings)

    def send(path: str, values: np.ndarray, name: str, color: str, width: float = 1.5, visible: bool = True) -> None:
        send_series(stream, path, run.time, values, name, color, width, near, visible=visible)

    send("torque/sensor", run.reading("joint_torque"), "torque sensor", SENSOR, 1.0)
    send("torque/model", run.signals.model_torque, "raw model", MODEL, visible=False)
    for settings in run.settings:
        # Series are drawn in the order of their paths: the fixed-γ filter would cover the paper's three.
        name, shown = settings.name, settings.rule != "robust"
        send(f"torque/{name}", run.estimate(name), name, colors[name], 2.5, shown)
        send(f"error/{name}", run.estimate(name) - truth, name, colors[name], 1.5, shown)
    send("torque/truth", truth, "truth", TRUTH, 1.0)
    send("external_torque", run.external_torque, "external torque on the link", EXTERNAL)


def _send_filters(stream: rr.RecordingStream, run: Run) -> None:
    near = _interesting(run)
    period = float(run.time[1] - run.time[0])
    for name, color in filter_colors(s.name for s in run.settings).items():
        place = f"innovation/{name}"
        deviation = np.sqrt(run.innovation_variance(name))
        send_series(stream, f"{place}/innovation", run.time, run.innovation(name), "innovation", color, 1.0, near)
        for sign, label in ((1, "+√P_Y"), (-1, "−√P_Y")):
            part = "upper" if sign > 0 else "lower"
            send_series(stream, f"{place}/{part}", run.time, sign * deviation, label, SENSOR, 1.5, near)
        if name in _switching(run):
            robust = run.robust(name)
            percent = 100 * share(robust, round(SHARE_WINDOW / period))
            send_series(stream, f"robust_share/{name}", run.time, percent, name, color, points=POINTS // 4)
            _send_mode(stream, f"mode/{name}", run.time, robust, round(MODE_WINDOW / period), color)


def _send_mode(stream, path: str, time: np.ndarray, robust: np.ndarray, window: int, color: str) -> None:
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
    p = run.joint.record(run.joint.mount(run.scenario.mounting or None))[0]
    rotor, wave, link = (run.truth(f"{name}_position") for name in ("motor", "wave_generator", "link"))
    total = rotor / p["N"] - link
    generator = (rotor - wave) / p["N"]
    # With zero torque the model's torsions() is the kinematic error at the given angle: θw itself.
    kinematic = np.array([torsions(angle, 0.0, 0.0, p)[2] for angle in wave])
    parts = {
        "total": ("Δθ, total", total, 2.5),
        "flexspline": ("Δθf, flexspline", total - generator - kinematic, 1.5),
        "wave_generator": ("Δθw/N, wave generator", generator, 1.5),
        "kinematic_error": ("θerr, kinematic error", kinematic, 1.5),
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
    if run.metrics.get("filters"):
        lines += ["Errors against the noise-free joint torque [N·m]:", "", *_metrics_lines(run)]
    return "\n".join(lines)


def _metrics_lines(run: Run) -> list[str]:
    """The narrow part of the comparison: what fits beside the joint."""
    rows = [
        line.split("|")[2:5] + line.split("|")[8:9] for line in comparison_markdown({run.name: run.metrics}).split("\n")
    ]
    return ["|" + "|".join(cells) + "|" for cells in rows if len(cells) == 4]


# The joint in 3D


def _reach(model: mujoco.MjModel) -> float:
    """Distance of the link's tip from the axis [m]; 0.4 for a model without the site `tip`."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip")
    return max(float(np.linalg.norm(model.site_pos[site][[0, 2]])), 0.2) if site >= 0 else 0.4


def send_scene(stream: rr.RecordingStream, run: Run, model: mujoco.MjModel) -> None:
    """Send the joint's bodies with their motion, and the torques as arrows."""
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, strict=True)
    frames = thin_frames(run.time)
    time = [rr.TimeColumn(TIMELINE, duration=run.time[frames])]
    positions, rotations, tips = _poses(model, run, frames)
    for body in range(1, model.nbody):
        name = model.body(body).name or f"body_{body}"
        # A bare joint has no link: its geoms are drawn as lines, as a pointer.
        pointer = name == "link" and run.joint.mount(run.scenario.mounting or None).gravity_moment == 0
        _send_geoms(stream, model, body, f"scene/{name}", pointer)
        columns = rr.Transform3D.columns(translation=positions[:, body], quaternion=rotations[:, body])
        stream.send_columns(f"scene/{name}", time, columns, strict=True)
    names = [s.name for s in run.settings]
    main = main_filter(names)
    axis = model.jnt_axis[model.joint("link").id]
    radius = 2.2 * model.geom_size[:, 0].max() if model.ngeom else 0.1
    front = _front(model, axis)
    _send_arc(stream, "scene/torque_true", time, run.truth("joint_torque")[frames], radius, front, axis, TRUTH)
    color = filter_colors(names)[main]
    _send_arc(stream, f"scene/torque_{main}", time, run.estimate(main)[frames], 1.16 * radius, front, axis, color)
    if tips is not None and np.any(run.external_torque):
        _send_push(stream, time, run.external_torque[frames], tips, axis)


def _front(model: mujoco.MjModel, axis: np.ndarray) -> float:
    """Place on the axis [m] just before all geoms, where nothing hides an arrow."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    faces = [0.0]
    for geom in range(model.ngeom):
        along = data.geom_xmat[geom].reshape(3, 3).T @ axis
        center, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        faces.append(float(data.geom_xpos[geom] @ axis + along @ center + np.abs(along) @ half))
    return max(faces) + 0.015


def thin_frames(time: np.ndarray) -> np.ndarray:
    """Indices of the samples that the 3D scene shows."""
    step = max(round(1.0 / FRAME_RATE / float(time[1] - time[0])), 1)
    return np.arange(0, len(time), step)


def _poses(model: mujoco.MjModel, run: Run, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Positions (f, bodies, 3) [m], quaternions x y z w (f, bodies, 4), and positions of the site `tip`, if any."""
    data = mujoco.MjData(model)
    state = np.column_stack([run.truth(f"{name}_position")[frames] for name in ("motor", "wave_generator", "link")])
    positions = np.empty((len(frames), model.nbody, 3))
    rotations = np.empty((len(frames), model.nbody, 4))
    has_tip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip") >= 0
    tips = np.empty((len(frames), 3)) if has_tip else None
    for i, angles in enumerate(state):
        data.qpos[:3] = angles
        mujoco.mj_kinematics(model, data)
        positions[i], rotations[i] = data.xpos, data.xquat[:, [1, 2, 3, 0]]
        if has_tip:
            tips[i] = data.site("tip").xpos
    return positions, rotations, tips


def _send_geoms(stream: rr.RecordingStream, model: mujoco.MjModel, body: int, path: str, lines: bool = False) -> None:
    """Send a body's geoms as primitives or meshes in the body's frame; as lines if asked for, or if transparent."""
    kinds = mujoco.mjtGeom
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        kind, size = kinds(int(model.geom_type[geom])), model.geom_size[geom]
        material = model.geom_matid[geom]
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        color = [round(255 * float(c)) for c in rgba]
        position = model.geom_pos[geom]
        rotation = model.geom_quat[geom][[1, 2, 3, 0]]
        # A housing that one can look into is drawn as lines: what moves inside is the point.
        solid = color[3] == 255 and not lines
        fill = rr.components.FillMode.Solid if solid else rr.components.FillMode.DenseWireframe
        common = {"quaternions": [rotation], "colors": [color[:3]], "fill_mode": fill}
        if kind == kinds.mjGEOM_CYLINDER:
            shape = rr.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], centers=[position], **common)
        elif kind == kinds.mjGEOM_CAPSULE:
            matrix = np.empty(9)
            mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
            begin = position - size[1] * matrix.reshape(3, 3)[:, 2]  # Rerun's capsule starts at its first end
            shape = rr.Capsules3D(lengths=[2 * size[1]], radii=[size[0]], translations=[begin], **common)
        elif kind == kinds.mjGEOM_BOX:
            shape = rr.Boxes3D(half_sizes=[size], centers=[position], **common)
        elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
            half = size if kind == kinds.mjGEOM_ELLIPSOID else np.full(3, size[0])
            shape = rr.Ellipsoids3D(half_sizes=[half], centers=[position], **common)
        elif kind == kinds.mjGEOM_MESH:
            shape = _mesh(model, geom, color)
        else:
            continue  # planes and height fields are scenery
        stream.log(f"{path}/{model.geom(geom).name or f'geom_{geom}'}", shape, static=True, strict=True)


def _mesh(model: mujoco.MjModel, geom: int, color: Sequence[int]) -> rr.Mesh3D:
    mesh = model.geom_dataid[geom]
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    points = model.mesh_vert[vertices] @ matrix.reshape(3, 3).T + model.geom_pos[geom]
    return rr.Mesh3D(vertex_positions=points, triangle_indices=model.mesh_face[faces], albedo_factor=list(color))


def _send_arc(
    stream, path: str, time: list, torque: np.ndarray, radius: float, front: float, axis: np.ndarray, color: str
) -> None:
    """Send a torque as a curved arrow around the joint's axis that begins above it.

    Args:
      torque: shape (f,) [N·m].
      radius, front: of the arc, and its place on the axis [m].
      axis: of the joint: positive torque turns about it by the right hand.
      color: `#RRGGBB`.
    """
    up = np.array([0.0, 0.0, 1.0])
    side, front = np.cross(axis, up), front * axis
    swept = np.radians(np.clip(DEGREES_PER_TORQUE * torque, -_LARGEST_ARC, _LARGEST_ARC))
    head = np.sign(swept) * np.minimum(np.abs(swept), 0.22)
    angles = np.linspace(0, 1, _ARC_POINTS) * (swept - head)[:, None]

    def at(angle: np.ndarray) -> np.ndarray:
        return radius * (np.cos(angle)[..., None] * up + np.sin(angle)[..., None] * side) + front

    strips = at(angles).astype(np.float32)
    stream.log(path, rr.LineStrips3D.from_fields(colors=[rgb(color)], radii=[0.003]), static=True, strict=True)
    stream.send_columns(path, time, rr.LineStrips3D.columns(strips=list(strips)), strict=True)
    begin, end = at(swept - head), at(swept)
    point = f"{path}/head"
    stream.log(point, rr.Arrows3D.from_fields(colors=[rgb(color)], radii=[0.007]), static=True, strict=True)
    arrows = rr.Arrows3D.columns(origins=begin.astype(np.float32), vectors=(end - begin).astype(np.float32))
    stream.send_columns(point, time, arrows, strict=True)


def _send_push(stream, time: list, torque: np.ndarray, tips: np.ndarray, axis: np.ndarray) -> None:
    """Send the external torque as the force at the link's tip that makes it."""
    arm = tips - np.outer(tips @ axis, axis)
    length = np.linalg.norm(arm, axis=1, keepdims=True)
    direction = np.cross(axis, arm) / np.maximum(length, 1e-9)
    vectors = FORCE_SCALE * (torque[:, None] / np.maximum(length, 1e-9)) * direction
    stream.log(
        "scene/external", rr.Arrows3D.from_fields(colors=[rgb(EXTERNAL)], radii=[0.007]), static=True, strict=True
    )
    columns = rr.Arrows3D.columns(origins=(tips - vectors).astype(np.float32), vectors=vectors.astype(np.float32))
    stream.send_columns("scene/external", time, columns, strict=True)
