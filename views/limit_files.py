"""What `flexspline bound` writes: errors and bounds over time (Parquet), a row per estimator (CSV)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..models.files import write_into_place, write_rows
from ..models.tables import write_table

if TYPE_CHECKING:
    from ..scenarios.evaluation.limits import Limits

SUMMARY = (
    "scenario", "estimator", "causal", "seeds", "rms", "rms_std", "bound", "ratio", "bound_paper_model", "tolerance",
    "bound_tolerance", "intensity",
    "nis", "nis_low", "nis_high", "nees", "nees_low", "nees_high", "nees_inside", "outside_white_band", "ljung_box_p",
)  # fmt: skip
"""Columns of the summary; errors and bounds [N·m], intensity [N·m/√s]."""


def write_limits(limits: Limits, path: Path) -> None:
    """Errors, bounds and NEES over time as Parquet, with units in the metadata."""
    columns = {
        "time": ("s", limits.time),
        "bound": ("N·m", limits.bound),
        "bound_paper_model": ("N·m", limits.torsion_bound),
    }
    if limits.tolerance > 0.0:
        columns["bound_tolerance"] = ("N·m", limits.tolerance_bound)
    for e in limits.estimators:
        if e.error.size:
            columns[f"error_{e.name}"] = ("N·m", e.error)
        if e.nees_over_time is not None:
            columns[f"nees_{e.name}"] = ("1", e.nees_over_time)
    with write_into_place(path) as temporary:
        write_table(
            temporary, {name: x for name, (_, x) in columns.items()}, {name: u for name, (u, _) in columns.items()}
        )


def summary_rows(found: Sequence[Limits]) -> Iterator[dict[str, Any]]:
    """A row per scenario and estimator, by `SUMMARY`; none where a measure is not defined."""
    for limits in found:
        for e in limits.estimators:
            spread = float(np.std(e.rms, ddof=1)) if len(e.rms) > 1 else None
            row = [
                limits.scenario, e.name, e.causal, len(limits.seeds), e.mean_rms, spread, limits.bound_rms,
                limits.ratio(e.name), limits.torsion_bound_rms, limits.tolerance,
                limits.tolerance_bound_rms if limits.tolerance > 0.0 else None, limits.intensity,
            ]  # fmt: skip
            for mean in (e.nis, e.nees):
                row += [None, None, None] if mean is None else [mean.value, mean.low, mean.high]
            yield dict(zip(SUMMARY, [*row, e.nees_share, e.outside, e.whiteness], strict=True))


def write_summary(found: Sequence[Limits], path: Path) -> None:
    """`summary_rows` as CSV; empty where a measure is not defined."""
    write_rows(path, list(summary_rows(found)), SUMMARY)
