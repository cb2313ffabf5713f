"""Metrics as tables: in the terminal (rich) and in Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rich.table import Table
from rich.text import Text

from .style import filter_colors

RAW_MODEL = "raw model"
"""How the compliance model without any filter is called in a table."""


@dataclass(frozen=True)
class Column:
    """A column of the comparison: key in the metrics, heading, unit, what to multiply by, decimals, explanation."""

    key: str
    heading: str
    unit: str
    scale: float
    decimals: int
    meaning: str

    @property
    def title(self) -> str:
        """Heading with unit."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading

    def text(self, metrics: Mapping) -> str:
        """The value as text; `–` where there is none."""
        value = metrics.get(self.key)
        if value is None or not math.isfinite(value):
            return "–"
        return f"{round(value * self.scale, self.decimals) + 0.0:.{self.decimals}f}"


COLUMNS = (
    Column("rms", "RMS error", "N·m", 1, 3, "against the true joint torque, after the transient"),
    Column("max", "max error", "N·m", 1, 3, "largest, likewise"),
    Column("noise_ratio", "noise / model", "", 1, 2, "noise in steady state relative to the raw model's"),
    Column("delay_ms", "delay", "ms", 1, 1, "to a push"),
    Column("response_ms", "90 % response", "ms", 1, 1, "to a push"),
    Column("robust_share", "robust", "%", 100, 1, "share of the time in robust mode"),
    Column("mean_nis", "mean NIS", "", 1, 2, "normalised innovation squared; 1 where P_Y is right"),
    Column("rms_to_sensor", "RMS to sensor", "N·m", 1, 3, "against the noisy torque sensor"),
)
"""Columns of `run.metrics["filters"][name]` and `run.metrics["model"]`."""


def comparison_rows(metrics: Mapping[str, Mapping]) -> list[tuple[str, ...]]:
    """Cells of the comparison as text: scenario, filter, then `COLUMNS`.

    Args:
      metrics: a run's metrics by scenario name: `{"filters": {name: {…}}, "model": {…}}`.
    """
    rows = []
    for scenario, run in metrics.items():
        entries = {RAW_MODEL: run["model"]} if run.get("model") else {}
        for name, values in (entries | dict(run.get("filters", {}))).items():
            rows.append((scenario, name, *(column.text(values) for column in COLUMNS)))
    return rows


def comparison_table(metrics: Mapping[str, Mapping], title: str = "Joint torque estimates") -> Table:
    """The comparison for the terminal: a row per scenario and filter, the best of each scenario in bold.

    Args:
      metrics: a run's metrics by scenario name.
      title: above the table.
    """
    table = Table(title=title, caption="errors against the plant's noise-free joint torque; – not defined here")
    table.add_column("scenario", no_wrap=True)
    table.add_column("filter", no_wrap=True)
    for column in COLUMNS:
        table.add_column(column.heading + (f"\n[{column.unit}]" if column.unit else ""), justify="right")
    rows = comparison_rows(metrics)
    colors = filter_colors(dict.fromkeys(name for _, name, *_ in rows if name != RAW_MODEL))
    for i, (scenario, name, *cells) in enumerate(rows):
        first = i == 0 or rows[i - 1][0] != scenario
        last = i + 1 == len(rows) or rows[i + 1][0] != scenario
        best = _smallest([row for row in rows if row[0] == scenario and row[1] != RAW_MODEL])
        shown = [Text(cell, style="bold" if (name, k) in best else "") for k, cell in enumerate(cells)]
        label = Text(name, style=colors.get(name, "dim"))
        table.add_row(Text(scenario if first else ""), label, *shown, end_section=last)
    return table


def comparison_markdown(metrics: Mapping[str, Mapping]) -> str:
    """The comparison as a Markdown table, with the meaning of the columns below it."""
    heads = ("scenario", "filter", *(column.title for column in COLUMNS))
    lines = [
        "| " + " | ".join(heads) + " |",
        "|---|---|" + "---:|" * len(COLUMNS),
        *("| " + " | ".join(row) + " |" for row in comparison_rows(metrics)),
        "",
        "; ".join(f"*{column.heading}*: {column.meaning}" for column in COLUMNS) + ".",
    ]
    return "\n".join(lines) + "\n"


_COMPARED = ("rms", "max", "noise_ratio", "delay_ms", "response_ms")


def _smallest(rows: list[tuple[str, ...]]) -> set[tuple[str, int]]:
    """(filter, column) of the smallest value of each column in which smaller is better, if rows differ."""
    best = set()
    for k, column in enumerate(COLUMNS):
        values = {row[1]: float(row[2 + k]) for row in rows if row[2 + k] != "–"}
        if column.key in _COMPARED and len(set(values.values())) > 1:
            smallest = min(values.values())
            best |= {(name, k) for name, value in values.items() if value == smallest}
    return best
