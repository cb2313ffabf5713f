"""Measured and simulated quantities: values above, residuals below, a tab each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..style import SENSOR, TRUTH
from .recording import layout, recording, send_series, series_view

BEFORE, AFTER = "#E0533D", TRUTH
"""Colours of the simulation and of the improved one, as on the page."""


@dataclass(frozen=True)
class ModelledChannel:
    """A measured quantity with its simulation.

    Attributes:
      name: such as `joint torque`.
      unit: of values and residual.
      time: shape (n,) [s].
      measured, simulated: shape (n,); NaN where it is missing.
      candidates: more simulations by name, shape (n,) each.
      below: parent entity path, with a slash at its end.
    """

    name: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    candidates: Mapping[str, np.ndarray] | None = None
    below: str = "channels/"

    @property
    def path(self) -> str:
        """Entity path."""
        return self.below + self.name.replace(" ", "_").replace("/", "_")


def rerun_measurement(path: Path, name: str, channels: Sequence[ModelledChannel], notes: str = "") -> Path:
    """Write measured and simulated channels as a recording: values above, residuals below, a tab each.

    Args:
      path: of the `.rrd` file.
      name: of the recording in the viewer.
      channels: to show.
      notes: Markdown for a panel of notes, if any.

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


def channel_panel(channel: ModelledChannel) -> rrb.Container:
    """Return the panel of a channel: values above, residuals below."""
    return rrb.Vertical(
        series_view(f"{channel.name} [{channel.unit}]", f"{channel.path}/values"),
        series_view(f"measured − simulated [{channel.unit}]", f"{channel.path}/residual"),
        row_shares=[3, 2],
        name=channel.name,
    )


def send_channel(stream: rr.RecordingStream, channel: ModelledChannel) -> None:
    """Send a channel's series."""
    simulations = {"simulated": channel.simulated, **(channel.candidates or {})}
    # Red without and green with the first candidate, as on the page.
    palette = (BEFORE, AFTER, "#3D8FE0", "#E8A100", "#9A6FCB") if channel.candidates else (TRUTH,)
    colors = dict(zip(simulations, palette * len(simulations), strict=False))
    send_series(stream, f"{channel.path}/values/measured", channel.time, channel.measured, "measured", SENSOR)
    for label, values in simulations.items():
        place = label.replace(" ", "_").replace("/", "_")
        send_series(stream, f"{channel.path}/values/{place}", channel.time, values, label, colors[label])
        residual = channel.measured - values
        send_series(stream, f"{channel.path}/residual/{place}", channel.time, residual, label, colors[label])
