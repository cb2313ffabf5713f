"""One colour per signal, the same in all views.

The colours (after Okabe and Ito, safe for colour-blind eyes) are legible on white figures and in Rerun's dark viewer.
"""

from __future__ import annotations

from collections.abc import Iterable

TRUTH = "#00A878"
"""Noise-free truth of the plant."""
SENSOR = "#9AA3AD"
"""Torque sensor."""
MODEL = "#C8B68E"
"""Raw compliance model, before any filter."""
EXTERNAL = "#CC6FA8"
"""External torque on the link."""
COMMAND = "#7D8690"
"""Command of the drive."""
FILTERS = {"EKF": "#3D8FE0", "AREKF": "#E8A100", "RAREKF": "#E0533D", "REKF": "#9A6FCB"}
"""Filters by name; others take `SPARE` in their order."""
SPARE = ("#17BECF", "#8C9A2B", "#E377C2", "#8C6D4F")
PARTS = {
    "total": "#9AA3AD", "flexspline": "#3D8FE0", "wave_generator": "#E8A100", "kinematic_error": "#CC6FA8",
}  # fmt: skip
"""Torsion and its parts."""

MAIN = "RAREKF"  # the paper's filter, for views of one filter


def filter_colors(names: Iterable[str]) -> dict[str, str]:
    """Return the colour of each filter; a name has the same colour in all views."""
    names = list(names)
    spare = [name for name in names if name not in FILTERS]
    return {name: FILTERS.get(name) or SPARE[spare.index(name) % len(SPARE)] for name in names}


def main_filter(names: Iterable[str]) -> str:
    """Return the filter for views of one filter: the paper's, or else the last."""
    names = list(names)
    return MAIN if MAIN in names else names[-1]
