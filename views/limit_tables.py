"""Tables of what is possible and of tuning, for the terminal and as rows of text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table
from rich.text import Text

from .tables import heading, narrow_table

if TYPE_CHECKING:
    from ..estimator.consistency import Mean
    from ..scenarios.evaluation.limits import Limits
    from ..scenarios.evaluation.tuning import Tuned

LIMIT_HEADS = ("estimator", "RMS [N·m]", "/ bound", "NIS", "95 %", "NEES", "95 %", "inside [%]", "ρ outside [%]")
"""Columns of `limit_rows`."""
TUNED_HEADS = (
    "filter", "training, default [N·m]", "training, tuned [N·m]", "test, default [N·m]", "test, tuned [N·m]",
    "difference [N·m], 95 %", "tuning parameters",
)  # fmt: skip
"""Columns of `tuned_rows`."""


def limit_rows(limits: Limits) -> list[tuple[str, ...]]:
    """A row of text per estimator, `LIMIT_HEADS`; the smallest error first."""
    rows: list[tuple[str, ...]] = []
    for e in sorted(limits.estimators, key=lambda e: np.nan_to_num(e.mean_rms, nan=np.inf)):
        rows.append(
            (
                e.name if e.causal else f"{e.name} (not causal)", number(e.mean_rms, 4), number(limits.ratio(e.name), 2),
                *_mean(e.nis), *_mean(e.nees),
                "–" if e.nees_share is None else f"{100 * e.nees_share:.0f}",
                "–" if e.outside is None else f"{100 * e.outside:.0f}",
            )
        )  # fmt: skip
    return rows


def limits_table(limits: Limits) -> Table:
    """A scenario's estimators beside the bound, for the terminal: NIS and NEES above their intervals."""
    table = narrow_table(
        f"{limits.scenario}: {len(limits.seeds)} seeds, bound {limits.bound_rms:.4f} N·m (external torque a random walk of "
        f"{limits.intensity:.3g} N·m/√s), bound of the paper's model {limits.torsion_bound_rms:.4f} N·m"
        + (
            f", bound for a joint within {limits.tolerance:g} × its tolerances {limits.tolerance_bound_rms:.4f} N·m"
            if limits.tolerance > 0.0
            else ""
        ),
        "bound: of a joint that is known exactly, averaged over the seeds' truths, encoders' counts taken for Gaussian noise: a "
        "single run may come out below; times bound: RMS in units of it; NIS, NEES with 95 % intervals: 1 where a filter knows "
        "its covariance, above: it trusts itself too much; inside: share of time in which NEES over seeds is in its interval; ρ "
        "outside: lags beyond the band of white innovations, 5 % is white",
    )
    heads = [("estimator", ""), ("RMS", "N·m"), ("times bound", ""), ("NIS 95\u00a0%", ""), ("NEES 95\u00a0%", ""),
             ("inside", "%"), ("ρ\u00a0outside", "%")]  # fmt: skip
    for i, (words, unit) in enumerate(heads):
        text = heading(words, unit, "right" if i else "left")
        table.add_column(text, justify="right" if i else "left", no_wrap=i > 0, overflow="fold", vertical="top")
    for name, rms, ratio, nis, nis_interval, nees, nees_interval, inside, outside in limit_rows(limits):
        cells = name.replace(" (", "\n("), rms, ratio, *_stacked(nis, nis_interval), *_stacked(nees, nees_interval)
        table.add_row(*(Text(cell) for cell in (*cells, inside, outside)))
    return table


def _stacked(value: str, interval: str) -> tuple[str]:
    return (value if value == "–" else f"{value}\n{interval}",)


def tuned_rows(found: Sequence[Tuned]) -> list[tuple[str, ...]]:
    """A row of text per filter, `TUNED_HEADS`; the smallest tuned error first."""
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
    """Default above tuned filters on training and test seeds, for the terminal."""
    table = narrow_table(
        title,
        "RMS error, default above tuned; difference: tuned less default on the same test runs, mean and 95 % interval over "
        "seeds; ! at the end of its range",
    )
    heads = [("filter", ""), ("training", "N·m"), ("test", "N·m"), ("difference", "N·m"), ("tuning parameters", "")]
    for i, (words, unit) in enumerate(heads):
        text = heading(words, unit, "right" if 0 < i < 4 else "left")
        table.add_column(text, justify="right" if 0 < i < 4 else "left", no_wrap=0 < i < 4, overflow="fold")
    for name, *errors, difference, values in tuned_rows(found):
        pairs = ("\n".join(errors[:2]), "\n".join(errors[2:]), difference.replace(" [", "\n["))
        table.add_row(*(Text(cell) for cell in (name, *pairs, values.replace(", ", "\n"))))
    return table


def number(value: float, decimals: int) -> str:
    """A number as text; `diverged` where it is none or a filter's error is out of all proportion."""
    return f"{value:.{decimals}f}" if math.isfinite(value) and value < 1e5 else "diverged"


def _mean(mean: Mean | None) -> tuple[str, str]:
    if mean is None:
        return "–", "–"
    return f"{mean.value:.2f}", f"{mean.low:.2f}–{mean.high:.2f}"
