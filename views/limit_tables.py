"""Tables of what is possible and of tuning, for the terminal and as rows of text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from ..estimator.consistency import Mean
    from ..scenarios.limits import Limits
    from ..scenarios.tuning import Tuned

LIMIT_HEADS = ("estimator", "RMS [N·m]", "/ bound", "NIS", "95 %", "NEES", "95 %", "inside [%]", "ρ outside [%]")
"""Columns of `limit_rows`."""
TUNED_HEADS = ("filter", "train", "tuned", "test", "tuned", "difference, 95 %", "knobs")
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
    """A scenario's estimators beside the bound, for the terminal."""
    table = Table(
        title=f"{limits.scenario}: {len(limits.seeds)} seeds, bound {limits.bound_rms:.4f} N·m (external torque a random walk of "
        f"{limits.intensity:.3g} N·m/√s), bound of the paper's model {limits.torsion_bound_rms:.4f} N·m",
        caption="NIS, NEES: 1 where a filter knows its covariance, above: it trusts itself too much; inside: share of time in "
        "which NEES over seeds is in its 95 % interval; ρ outside: lags beyond the band of white innovations, 5 % is white",
    )
    for i, head in enumerate(LIMIT_HEADS):
        table.add_column(head, justify="left" if i == 0 else "right", no_wrap=True)
    for row in limit_rows(limits):
        table.add_row(*(Text(cell) for cell in row))
    return table


def tuned_rows(found: Sequence[Tuned]) -> list[tuple[str, ...]]:
    """A row of text per filter, `TUNED_HEADS`; the smallest tuned error first."""
    rows = []
    for one in sorted(found, key=lambda one: _overall(one.test_tuned)):
        gain = one.gain
        interval = f" [{gain.low:+.4f}, {gain.high:+.4f}]" if math.isfinite(gain.low) else ""
        knobs = ", ".join(
            f"{k.split('.')[-1]} {v:.3g}" + ("!" if k in one.at_bound else "") for k, v in one.values.items()
        )
        errors = (*one.train, _overall(one.test_default), _overall(one.test_tuned))
        rows.append((one.name, *(number(e, 4) for e in errors), f"{gain.mean:+.4f}{interval}", knobs or "–"))
    return rows


def tuned_table(found: Sequence[Tuned], title: str) -> Table:
    """Default and tuned filters on training and test seeds, for the terminal."""
    table = Table(
        title=title,
        caption="RMS error [N·m]; difference: tuned less default on the same test runs, mean and 95 % interval over seeds; "
        "! at the end of its range",
    )
    for i, head in enumerate(TUNED_HEADS):
        last = i == len(TUNED_HEADS) - 1
        table.add_column(head, justify="left" if i == 0 or last else "right", no_wrap=not last)
    for row in tuned_rows(found):
        table.add_row(*(Text(cell) for cell in row))
    return table


def _overall(rms: np.ndarray) -> float:
    """One number of RMS errors (scenarios, seeds): root mean square over seeds, geometric mean of these, as tuning has it."""
    return float(np.exp(np.mean(np.log(np.sqrt(np.mean(rms**2, axis=1))))))


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first column to the left, the others to the right."""
    lines = [f"| {' | '.join(heads)} |", "|---|" + "---:|" * (len(heads) - 1)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def number(value: float, decimals: int) -> str:
    """A number as text; `diverged` where it is none or a filter's error is out of all proportion."""
    return f"{value:.{decimals}f}" if math.isfinite(value) and value < 1e5 else "diverged"


def _mean(mean: Mean | None) -> tuple[str, str]:
    if mean is None:
        return "–", "–"
    return f"{mean.value:.2f}", f"{mean.low:.2f}–{mean.high:.2f}"
