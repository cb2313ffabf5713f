"""A run while it runs: every stretch is sent to an open viewer; the result is the recording of the run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from ...sim.shape import shape
from ..posteriors import SHARE_WINDOW, innovations, modes, settled
from ..style import filter_colors
from .blueprint import run_panels
from .recording import POINTS, layout
from .run import (
    MODE_WINDOW,
    always_robust,
    asked,
    notes,
    send_estimates,
    send_mode,
    send_notes,
    send_run,
    send_share,
    share_of,
    window_samples,
    windows,
)
from .scene import reach

if TYPE_CHECKING:
    from ...scenarios.run import Run


class LiveRecording:
    """Shows the stretches of a run in a viewer."""

    def __init__(self, stream: rr.RecordingStream, start: Run):
        """Show the scenario in a stream to a viewer, a file or memory; `start`: the run before its first tick."""
        self._stream, self._time = stream, start.time
        self._model = shape(start.joint)
        self._colors = filter_colors(f.name for f in start.scenario.filters)
        self._pushed = bool(np.any(start.external_torque))
        self._causal: dict[str, str] = {}
        self._robust_so_far: set[str] = set()
        self._lanes: list[_Lane] = []
        stream.send_recording_name(start.name)
        send_notes(stream, asked(start))

    def send(self, stretch: Run) -> None:
        """Show the next stretch."""
        if not self._causal:
            self._begin(stretch)
        else:
            self._robust_so_far &= always_robust(stretch, self._robust_so_far, 0)
        points = max(round(POINTS * len(stretch.time) / len(self._time)), 2)
        visible = set(self._causal) - self._robust_so_far
        send_run(self._stream, stretch, self._model, self._causal, self._pushed, points, visible)
        for lane in self._lanes:
            lane.send(self._stream, stretch, points)

    def _begin(self, stretch: Run) -> None:
        self._causal = {name: color for name, color in self._colors.items() if name in stretch.estimates}
        self._robust_so_far = always_robust(stretch, self._causal)
        self._lanes = [
            _Lane(name, color, self._time)
            for name, color in self._causal.items()
            if stretch.estimates[name].robust is not None
        ]
        panels = run_panels(list(self._colors), tuple(innovations(stretch)), self._pushed, reach(self._model))
        self._stream.send_blueprint(layout(panels, float(self._time[-1]), live=True))

    def finish(self, run: Run) -> None:
        """Show the filters that look ahead and the metrics of the whole run."""
        for lane in self._lanes:
            lane.finish(self._stream)
        later = {name: color for name, color in self._colors.items() if name not in self._causal}
        send_estimates(self._stream, run, later, POINTS)
        send_notes(self._stream, notes(run))


class _Lane:
    """A filter's modes, shown when it first switches after the transient, as in `posteriors.switching`."""

    def __init__(self, name: str, color: str, time: np.ndarray):
        self._name, self._color, self._time = name, color, time
        self._robust = np.zeros(len(time), dtype=bool)
        self._known = self._shared = self._lined = 0
        self._seen: set[bool] = set()
        self._before: bool | None = None
        self._window = window_samples(MODE_WINDOW, time)
        self._width = min(window_samples(SHARE_WINDOW, time), len(time))

    def send(self, stream: rr.RecordingStream, stretch: Run, points: int) -> None:
        """Add a stretch and show complete windows."""
        robust = modes(stretch, self._name)
        self._robust[self._known : self._known + len(robust)] = robust
        self._known += len(robust)
        self._seen |= set(np.unique(robust[settled(stretch)]).tolist())
        self._show(stream, self._known - (self._width + 1) // 2, self._known // self._window * self._window, points)

    def finish(self, stream: rr.RecordingStream) -> None:
        """Show the rest."""
        self._show(stream, self._known, self._known, POINTS)

    def _show(self, stream: rr.RecordingStream, shared: int, lined: int, points: int) -> None:
        if len(self._seen) < 2:
            return
        if shared > self._shared:
            begin = min(max(self._shared - self._width, 0), max(self._known - self._width, 0))
            percent = share_of(self._robust[begin : self._known], self._time[begin : self._known])
            part = slice(self._shared, shared)
            points = max(points, round(POINTS * (shared - self._shared) / len(self._time)))
            send_share(
                stream,
                self._name,
                self._time[part],
                percent[self._shared - begin : shared - begin],
                self._color,
                points,
            )
            self._shared = shared
        if lined > self._lined:
            part = slice(self._lined, lined)
            start, robust = windows(self._time[part], self._robust[part], self._window)
            send_mode(stream, self._name, start, robust, self._color, self._before)
            self._before, self._lined = bool(robust[-1]), lined
