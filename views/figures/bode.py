"""Frequency response: magnitude, phase and coherence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ..style import MODEL, TRUTH
from .sheet import sheet, styled

if TYPE_CHECKING:
    from ...diagnosis.bode import Response


@styled
def bode_figure(found: Response, title: str) -> Figure:
    """Draw a response, measured and simulated, with thin lines where current and velocity are not coherent."""
    peaks, dips = found.resonances()
    caption = (
        "From motor current to motor velocity, measured, and simulated on the same motion. "
        f"Peaks at {_list(peaks)}, dips at {_list(dips)}, where the coherence is above 0.5."
    )
    figure, rows = sheet(title, caption, [2.2, 1.5, 0.9], columns=1, shared=(0,))
    magnitude, phase, coherence = (row[0] for row in rows)
    good = np.where(found.coherence > 0.5, 1.0, np.nan)
    for name, values, color in (("measured", found.measured, TRUTH), ("simulated", found.simulated, MODEL)):
        magnitude.loglog(found.frequency, np.abs(values), color=color, lw=0.4, alpha=0.5)
        magnitude.loglog(found.frequency, good * np.abs(values), color=color, lw=1.2, label=name)
        phase.semilogx(found.frequency, good * np.degrees(np.angle(values)), color=color, lw=1.2)
    for f in (*peaks, *dips):
        magnitude.axvline(f, color="0.8", lw=0.6, zorder=0)
    coherence.semilogx(found.frequency, found.coherence, color=TRUTH, lw=0.9)
    magnitude.set_ylabel("velocity over current\n[rad/(s·A)]")
    magnitude.legend()
    phase.set_ylabel("phase [°]")
    coherence.set_ylabel("coherence")
    coherence.set_ylim(0, 1.05)
    coherence.set_xlabel("frequency [Hz]")
    return figure


def _list(values: list[float]) -> str:
    return f"{', '.join(f'{f:.3g}' for f in values)} Hz" if values else "no frequency"
