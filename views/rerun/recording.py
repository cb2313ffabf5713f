"""What any recording is made of: the file, series on one timeline, panels that share its axis, a layout."""

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
POINTS = 8000
"""Most points of a series; peaks stay, and pushes keep every sample where that leaves enough for the rest."""
SHARED_TIME = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
"""The time axis that all panels share."""
_GLOBAL_VIEW = uuid.UUID("5c0dca6a-e63f-9cf7-f657-2602590474cc")
"""`GLOBAL_VIEW_ID` of Rerun's viewer (re_viewer_context)."""
_LOOKS: WeakKeyDictionary[rr.RecordingStream, dict[str, Hashable]] = WeakKeyDictionary()


def is_new(stream: rr.RecordingStream, path: str, looks: Hashable = None) -> bool:
    """Whether an entity of a stream has not been asked about yet, or had other looks: its static data are sent once only."""
    told = _LOOKS.setdefault(stream, {})
    new = path not in told or told[path] != looks
    told[path] = looks
    return new


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
        # Written here: Rerun's own writer waits for ever where the disk is full. Series are thin, all of it is some megabytes.
        written = rr.binary_stream(stream)
        stream.send_blueprint(blueprint)
        stream.send_recording_name(name)
        yield stream
        temporary.write_bytes(written.read() or b"")
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
    """Send a time series as an envelope; values that are not finite leave a gap.

    Args:
      stream: the recording.
      path: entity path.
      time, values: shape (n,); time in s.
      name: in the legend, with the unit where the view does not say it.
      color: `#RRGGBB`.
      width: of the line [ui points].
      keep: samples that stay whatever they are, shape (n,), bool.
      points: about how many samples stay at most.
      visible: whether it is shown before one asks for it in the legend.
    """
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
        axis_x=SHARED_TIME,
        axis_y=rrb.ScalarAxis(range=limits) if limits else None,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=legend),
    )


def layout(root: rrb.Container, end: float, live: bool = False) -> rrb.Blueprint:
    """A blueprint with that content, all of the time from 0 to `end` [s] in view, the panels at the sides folded; `live`: the
    cursor follows what comes in."""
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
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following" if live else None),
        auto_views=False,
        auto_layout=False,
    )


def rgb(color: str, alpha: int = 255) -> list[int]:
    """`#RRGGBB` as four bytes."""
    return [*(int(color[i : i + 2], 16) for i in (1, 3, 5)), alpha]
