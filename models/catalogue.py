"""Catalogue numbers of strain wave gears by series, size and ratio.

Series of Harmonic Drive component sets: CSF and CSG (cup; CSG has higher torque) and CSD (flat cup; SHD is the same
gear as a unit). Torques and stiffnesses on the output side, friction and inertia on the motor side. Between and
outside the tables' sizes, the numbers are powers of the size, as in the tables: torques and stiffnesses with its
cube, inertia with its fifth power.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .errors import InputError, nearest

SIZES = (14, 17, 20, 25, 32, 40)  # sizes of the tables: pitch diameter of the flexspline in tenths of an inch
RATIOS = (50, 80, 100, 120, 160)  # ratios of the tables
SERIES: dict[str, str] = {
    "CSF": "cup", "CSG": "cup", "HFUC": "cup", "SHF": "cup", "SHG": "cup", "LCS": "cup", "LCSG": "cup", "LHS": "cup",
    "LHSG": "cup", "CSD": "flat", "SHD": "flat", "LCD": "flat", "LHD": "flat",
}  # fmt: skip
"""Known series, and the shape of their flexspline, which selects the table: those of Harmonic Drive, and
Leaderdrive's (L…), which have the same dimensions."""
_STRONG = ("CSG", "SHG", "LCSG", "LHSG")

# By size: T1, T2 [N·m]; then by ratio 50, and 80 and more: K1, K2, K3 [1e4 N·m/rad].
_BREAKPOINTS = {14: (2.0, 6.9), 17: (3.9, 12), 20: (7.0, 25), 25: (14, 48), 32: (29, 108), 40: (54, 196)}
_STIFFNESS: Mapping[str, Mapping[int, tuple[tuple[float, float, float], tuple[float, float, float]]]] = {
    "cup": {
        14: ((0.34, 0.47, 0.57), (0.47, 0.61, 0.71)), 17: ((0.81, 1.1, 1.3), (1.0, 1.4, 1.6)),
        20: ((1.3, 1.8, 2.3), (1.6, 2.5, 2.9)), 25: ((2.5, 3.4, 4.4), (3.1, 5.0, 5.7)),
        32: ((5.4, 7.8, 9.8), (6.7, 11, 12)), 40: ((10, 14, 18), (13, 20, 23)),
    },
    "flat": {
        14: ((0.29, 0.37, 0.47), (0.40, 0.44, 0.61)), 17: ((0.67, 0.88, 1.2), (0.84, 0.94, 1.3)),
        20: ((1.1, 1.3, 2.0), (1.3, 1.7, 2.5)), 25: ((2.0, 2.7, 3.7), (2.7, 3.7, 4.7)),
        32: ((4.7, 6.1, 8.4), (6.1, 7.8, 11)), 40: ((8.8, 11, 15), (11, 14, 20)),
    },
}  # fmt: skip
# By size, for ratios 50, 80, 100, 120, 160: rated torque at 2000 rpm and limit for repeated peaks [N·m]; missing if there is
# no such gear.
_RATED: Mapping[str, Mapping[int, tuple[float, ...]]] = {
    "standard": {
        14: (5.4, 7.8, 7.8), 17: (16, 22, 24, 24), 20: (25, 34, 40, 40, 40), 25: (39, 63, 67, 67, 67),
        32: (76, 118, 137, 137, 137), 40: (137, 206, 265, 294, 294),
    },
    "strong": {
        14: (7.0, 10, 10), 17: (21, 29, 31, 31), 20: (33, 44, 52, 52, 52), 25: (51, 82, 87, 87, 87),
        32: (99, 153, 178, 178, 178), 40: (178, 268, 345, 382, 382),
    },
    "flat": {14: (3.7, 5.4, 5.4), 17: (11, 14, 16), 20: (17, 24, 28, 28, 28), 25: (27, 44, 47, 47, 47),
             32: (53, 83, 96, 96, 96), 40: (96, 144, 185, 205, 206)},
}  # fmt: skip
_PEAK = {
    14: (23, 30, 36), 17: (44, 56, 70, 70), 20: (73, 96, 107, 113, 120), 25: (127, 178, 204, 217, 229),
    32: (281, 395, 433, 459, 484), 40: (523, 675, 738, 802, 841),
}  # fmt: skip
_PEAK_SHARE = {"strong": 1.0, "standard": 0.77, "flat": 0.53}
"""Limit for repeated peaks over that of the strong series, on average over the catalogues' tables."""
_STARTING = {
    14: (3.3, 2.4, 2.1), 17: (5.1, 3.3, 2.9, 2.7), 20: (6.6, 4.1, 3.7, 3.3, 2.9), 25: (12, 7.7, 6.9, 6.3, 5.5),
    32: (26, 16, 15, 13, 12), 40: (46, 29, 27, 24, 22),
}  # fmt: skip
"""Starting torque at the wave generator [cN·m], without seals and bearings of a unit."""
_INERTIA = {14: 0.033e-4, 17: 0.079e-4, 20: 0.193e-4, 25: 0.413e-4, 32: 1.69e-4, 40: 4.50e-4}
"""Of the wave generator [kg·m²]."""
_ACCURACY = {14: 1.5, 17: 1.5, 20: 1.0, 25: 1.0, 32: 1.0, 40: 1.0}
"""Angular transmission accuracy, peak to peak [arc minutes]."""


@dataclass(frozen=True)
class Gear:
    """A gear of a catalogue."""

    series: str
    size: float
    ratio: float
    rated_torque: float  # at 2000 rpm [N·m]
    peak_torque: float  # repeated [N·m]
    breakpoints: tuple[float, float]  # T1, T2 [N·m]
    stiffness: tuple[float, float, float]  # K1, K2, K3 [N·m/rad]
    starting_torque: float  # at the wave generator [N·m]
    inertia: float  # of the wave generator [kg·m²]
    accuracy: float  # angular transmission accuracy, peak to peak [rad]
    exact: bool  # whether size and ratio are in the tables; other numbers are interpolated

    @property
    def like(self) -> str:
        """The series of Harmonic Drive whose tables were used."""
        return "CSD" if SERIES[self.series] == "flat" else "CSG" if self.series in _STRONG else "CSF"

    @property
    def name(self) -> str:
        """As in catalogues: `CSG-25-100`."""
        return f"{self.series}-{self.size:g}-{self.ratio:g}"


def gear(series: str, size: float, ratio: float) -> Gear:
    """Return the catalogue's gear: a series in any case, a size from 8 to 65, a ratio from 30 to 320. Outside the
    tables' 14 to 40 and 50 to 160 their trend continues. Raises `InputError`: a series, size or ratio that no gear has.
    """
    kind = series.upper()
    if kind not in SERIES:
        raise InputError(f"gear: expected one of {', '.join(SERIES)}, got {series!r}{nearest(kind, SERIES)}")
    if not 8 <= size <= 65:
        raise InputError(f"size: expected 8 to 65, got {size:g}")
    if not 30 <= ratio <= 320:
        raise InputError(f"ratio: expected 30 to 320, got {ratio:g}")
    shape = SERIES[kind]
    rating = "flat" if shape == "flat" else "strong" if kind in _STRONG else "standard"
    share = min(max((ratio - 50) / 30, 0.0), 1.0)  # of the column for 80 and more
    few = min(ratio / 50, 1.0)

    def stiffness(k: int) -> float:
        table = {s: (1 - share) * low[k] + share * high[k] for s, (low, high) in _STIFFNESS[shape].items()}
        return 1e4 * few**1.15 * _at_size(table, size, 3)

    rated, peak, starting = (
        few**power
        * _at_size({s: float(np.interp(ratio, RATIOS[: len(row)], row)) for s, row in table.items()}, size, growth)
        for table, power, growth in ((_RATED[rating], 0.55, 3), (_PEAK, 0.55, 3), (_STARTING, -0.5, 2.5))
    )
    T1, T2 = (_at_size({s: breakpoints[k] for s, breakpoints in _BREAKPOINTS.items()}, size, 3) for k in (0, 1))
    return Gear(
        series=kind, size=size, ratio=ratio, rated_torque=rated, peak_torque=_PEAK_SHARE[rating] * peak,
        breakpoints=(T1, T2), stiffness=(stiffness(0), stiffness(1), stiffness(2)), starting_torque=1e-2 * starting,
        inertia=_at_size(_INERTIA, size, 5),
        accuracy=math.radians(_at_size(_ACCURACY, size, 0) / 60),
        exact=size in SIZES and ratio in RATIOS[: len(_PEAK[int(size)])],
    )  # fmt: skip


def _at_size(table: Mapping[int, float], size: float, power: float) -> float:
    """Interpolate a column by size: a power law between two sizes, and one of that power outside."""
    edge = min(max(size, SIZES[0]), SIZES[-1])
    inside = np.exp(np.interp(math.log(edge), np.log(SIZES), np.log([table[s] for s in SIZES])))
    return float(inside * (size / edge) ** power)
