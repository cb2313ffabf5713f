"""Parts of recordings: the file, series on one timeline, panels with a common time axis, a layout."""

from __future__ import annotations

import uuid
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...models.files import write_into_place
from ..series import envelope

TIMELINE = "time"
POINTS = 8000  # largest number of points of a series; peaks are kept, and all samples of pushes, if there are few
SHARED_TIME = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)  # the time axis that all panels share
_GLOBAL_VIEW = uuid.UUID("5c0dca6a-e63f-9cf7-f657-2602590474cc")
"""`GLOBAL_VIEW_ID` of Rerun's viewer (re_viewer_context)."""
_LOOKS: WeakKeyDictionary[rr.RecordingStream, dict[str, Hashable]] = WeakKeyDictionary()


def is_new(stream: rr.RecordingStream, path: str, looks: Hashable = None) -> bool:
    """Whether an entity of a stream is new or has new looks, so that its static data have to be sent."""
    sent = _LOOKS.setdefault(stream, {})
    new = path not in sent or sent[path] != looks
    sent[path] = looks
    return new


@contextmanager
def recording(path: Path, name: str, blueprint: rrb.Blueprint | None = None) -> Iterator[rr.RecordingStream]:
    """Open a recording named `name`, which is moved to `path` (`.rrd`) at the end of the block, or removed after an
    error. Raises `InputError`: the file cannot be written."""
    with write_into_place(Path(path)) as temporary:
        # The viewer has one layout per application: different recordings need different ones.
        stream = rr.RecordingStream(f"flexspline {name}")
        # Rerun's own writer never returns on a full disk. A recording has only a few megabytes.
        written = rr.binary_stream(stream)
        if blueprint is not None:
            stream.send_blueprint(blueprint)
        stream.send_recording_name(name)
        yield stream
        temporary.write_bytes(written.read() or b"")
        stream.disconnect()


def send_series(
    stream: rr.RecordingStream,
    time: np.ndarray,
    path: str,
    values: np.ndarray,
    name: str,
    color: str,
    width: float = 1.5,
    keep: np.ndarray | None = None,
    points: int = POINTS,
    visible: bool = True,
) -> None:
    """Send a time series [s], shape (n,), as an envelope of about so many points; values that are not finite are gaps.
    `keep`: samples to keep in any case, shape (n,), bool; `visible`: whether it is shown at first."""
    peaks = rr.components.AggregationPolicy.MinMax
    if is_new(stream, path, (name, color, width, visible)):
        line = rr.SeriesLines(
            colors=rgb(color), names=name, widths=width, visible_series=[visible], aggregation_policy=peaks
        )
        stream.log(path, line, static=True, strict=True)
    i = envelope(values, points // 2, keep)
    at = [rr.TimeColumn(TIMELINE, duration=time[i])]
    stream.send_columns(path, at, rr.Scalars.columns(scalars=values[i]), strict=True)


def series_view(
    name: str, origin: str, legend: bool = True, limits: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    """Return a panel of the time series below an entity path, on the common time axis; `limits`: of the values."""
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=SHARED_TIME,
        axis_y=rrb.ScalarAxis(range=limits) if limits else None,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=legend),
    )


def joint_view(name: str, origin: str, reach: float) -> rrb.Spatial3DView:
    """Return a view of the joint in 3D from the front; `reach` of its link [m]."""
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        background=[28, 31, 36],
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=(1.35 * reach, -2.3 * reach, 0.6 * reach),
            look_target=(0.2 * reach, 0.0, 0.0),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )


def layout(root: rrb.Container, end: float, live: bool = False) -> rrb.Blueprint:
    """Return a blueprint that shows the time from 0 to `end` [s]; `live`: the cursor follows the data."""
    # The viewer stores the range of the common time axis with a view of this id; without it, it shows 30 s.
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
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following" if live else None),
        auto_views=False,
        auto_layout=False,
    )


def entity(name: str) -> str:
    """Return a name as a part of an entity path."""
    return "".join(c if c.isalnum() else "_" for c in name)


def rgb(color: str) -> list[int]:
    """Return `#RRGGBB` as bytes."""
    return [int(color[i : i + 2], 16) for i in (1, 3, 5)]
