"""Measured and simulated quantities with their residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr

from ..style import SENSOR, TRUTH
from .recording import send_series

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
