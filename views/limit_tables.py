"""Tables and files of `flexspline bound` and `flexspline tune`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from ..models.files import write_into_place
from ..models.tables import write_table
from .tables import heading, text_table

if TYPE_CHECKING:
    from ..scenarios.evaluation.limits import Limits
    from ..scenarios.evaluation.tuning import Tuned

SUMMARY = (
    "scenario", "estimator", "causal", "seeds", "rms", "rms_std", "bound", "ratio", "bound_paper_model", "tolerance",
    "bound_tolerance", "intensity",
    "nis", "nis_low", "nis_high", "nees", "nees_low", "nees_high", "nees_inside", "outside_white_band", "ljung_box_p",
)  # fmt: skip
"""Columns of the summary; errors and bounds [N·m], intensity [N·m/√s]."""
TUNED_HEADS = (
    "filter", "training, default [N·m]", "training, tuned [N·m]", "test, default [N·m]", "test, tuned [N·m]",
    "difference [N·m], 95 %", "tuning parameters",
)  # fmt: skip
"""Columns of `tuned_rows`."""


def summary_rows(found: Sequence[Limits]) -> Iterator[dict[str, Any]]:
    """Yield a row per scenario and estimator, by `SUMMARY`; None where a metric is not defined."""
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


def write_limits(limits: Limits, path: Path) -> None:
    """Write errors, bounds and NEES over time as Parquet, with units in the metadata."""
    columns = {"time": limits.time, "bound": limits.bound, "bound_paper_model": limits.torsion_bound}
    if limits.tolerance > 0.0:
        columns["bound_tolerance"] = limits.tolerance_bound
    for e in limits.estimators:
        if e.error.size:
            columns[f"error_{e.name}"] = e.error
        if e.nees_over_time is not None:
            columns[f"nees_{e.name}"] = e.nees_over_time
    units = {name: "s" if name == "time" else "1" if name.startswith("nees_") else "N·m" for name in columns}
    with write_into_place(path) as temporary:
        write_table(temporary, columns, units)


def limits_table(limits: Limits) -> Table:
    """Return a scenario's estimators and the bound for the terminal, the smallest error first."""
    tolerant = ""
    if limits.tolerance > 0.0:
        tolerant = f", for a joint within {limits.tolerance:g} × its tolerances {limits.tolerance_bound_rms:.4f} N·m"
    title = (
        f"{limits.scenario}: {len(limits.seeds)} seeds, bound {limits.bound_rms:.4f} N·m (external torque a random walk of "
        f"{limits.intensity:.3g} N·m/√s), of the paper's model {limits.torsion_bound_rms:.4f} N·m{tolerant}"
    )
    caption = (
        "bound: for an exactly known joint, mean over the seeds' truths, encoder counts as Gaussian noise: a single run may be "
        "below it; times bound: RMS relative to it; NIS, NEES with 95 % intervals: 1 if a filter's variance is right, above 1 "
        "if it is too small; inside: share of time in which NEES over seeds is in its interval; ρ outside: lags beyond the band "
        "of white innovations, 5 % is white"
    )
    heads = [heading("estimator", justify="left"), heading("RMS", "N·m"), *map(heading, ("times bound", "NIS 95\u00a0%")),
             heading("NEES 95\u00a0%"), heading("inside", "%"), heading("ρ\u00a0outside", "%")]  # fmt: skip
    rows = []
    for row in sorted(summary_rows([limits]), key=lambda row: np.nan_to_num(row["rms"], nan=np.inf)):
        name = row["estimator"] + ("" if row["causal"] else "\n(not causal)")
        cells = (name, number(row["rms"], 4), number(row["ratio"], 2), _stacked(row, "nis"), _stacked(row, "nees"))
        shares = ("–" if row[key] is None else f"{100 * row[key]:.0f}" for key in ("nees_inside", "outside_white_band"))
        rows.append((*cells, *shares))
    return text_table(title, caption, heads, rows)


def _stacked(row: Mapping[str, Any], key: str) -> str:
    if row[key] is None:
        return "–"
    return f"{row[key]:.2f}\n{row[f'{key}_low']:.2f}–{row[f'{key}_high']:.2f}"


def tuned_rows(found: Sequence[Tuned]) -> list[tuple[str, ...]]:
    """Return a row of text per filter, `TUNED_HEADS`; the smallest tuned error first."""
    rows = []
    for one in sorted(found, key=lambda one: one.tuned_score):
        change = one.difference
        interval = f" [{change.low:+.4f}, {change.high:+.4f}]" if math.isfinite(change.low) else ""
        values = ", ".join(
            f"{k.split('.')[-1]} {v:.3g}" + ("!" if k in one.at_bound else "") for k, v in one.values.items()
        )
        errors = (*one.train, one.default_score, one.tuned_score)
        rows.append((one.name, *(number(e, 4) for e in errors), f"{change.mean:+.4f}{interval}", values or "–"))
    return rows


def tuned_table(found: Sequence[Tuned], title: str) -> Table:
    """Return default and tuned filters on training and test seeds for the terminal."""
    caption = (
        "RMS error, default above tuned; difference: tuned minus default on the same test runs, mean and 95 % interval over "
        "seeds; ! at the end of its range"
    )
    numbers = (heading(words, "N·m") for words in ("training", "test", "difference"))
    heads = (heading("filter", justify="left"), *numbers, heading("tuning parameters", justify="left"))
    rows = [
        (name, f"{a}\n{b}", f"{c}\n{d}", difference.replace(" [", "\n["), values.replace(", ", "\n"))
        for name, a, b, c, d, difference, values in tuned_rows(found)
    ]
    return text_table(title, caption, heads, rows, (0, 4))


def number(value: float, decimals: int) -> str:
    """Return a number as text; `diverged` if it is not finite or impossibly large."""
    return f"{value:.{decimals}f}" if math.isfinite(value) and value < 1e5 else "diverged"
