"""A diagnosis as a recording: its channels measured against simulated, verdict and tables beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..report import Report, markdown, plain
from ..residuals import overlays
from .channels import Channel, rerun_measurement


def write_rerun_report(report: Report, path: Path) -> Path:
    """Write a diagnosis' channels as a recording, measured against simulated, its verdict and tables beside them.

    Raises:
      InputError: the file cannot be written.
    """
    channels = []
    for o in (o for row in overlays(report) for o in row):
        base = o.measured if o.measured is not None else np.zeros(len(o.time))
        name = f"{o.name} {plain(o.channel)}"
        channels.append(Channel(name, o.unit, o.time, base, base - o.before, {"extended": base - o.after}))
    return rerun_measurement(path, f"diagnosis of {report.measurement.name}", channels, markdown(report))
