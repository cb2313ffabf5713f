"""Charts of a frequency response: magnitude, phase and coherence over a logarithmic axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .chart import Chart, limits

if TYPE_CHECKING:
    from ...diagnosis.bode import Response

_WIDTH = 540
_TICKS = (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200)  # Hz


def response_context(found: Response | None) -> dict[str, Any] | None:
    """Return charts and resonances for the template; None without a response."""
    if found is None:
        return None
    f = np.log10(found.frequency)
    x = float(f[0]), float(f[-1])
    labels = tuple((float(np.log10(v)), f"{v:g}") for v in _TICKS if x[0] <= np.log10(v) <= x[1])
    curves = {"measured broad": found.measured, "after": found.simulated}
    good = np.where(found.coherent, 1.0, np.nan)
    size = {kind: good * 20 * np.log10(np.abs(values)) for kind, values in curves.items()}
    phase = {kind: good * np.degrees(np.angle(values)) for kind, values in curves.items()}
    y = limits(np.concatenate([*size.values()]), 0.0)
    magnitude = Chart(x, y, "magnitude", "frequency [Hz]", "dB of 1 rad/(s·A)", labels=labels, width=_WIDTH, height=220)
    angle = Chart(x, (-200.0, 200.0), "phase", "frequency [Hz]", "°", labels=labels, width=_WIDTH, height=150)
    coherence = Chart(x, (0.0, 1.05), "coherence", "frequency [Hz]", "1", labels=labels, width=_WIDTH, height=150)
    for chart, of in ((magnitude, size), (angle, phase), (coherence, {"measured broad": found.coherence})):
        chart.lines(f, of)
    peaks, dips = found.resonances()
    return {"charts": [[magnitude], [angle, coherence]], "peaks": peaks, "dips": dips}
