"""Metrics as tables: in a terminal of 80 columns, and in Markdown."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from rich import box
from rich.table import Table
from rich.text import Text

from .style import filter_colors

_SHORT, _NAME, _NUMBER = 7, 15, 6  # characters of a line of a heading, of a name, and of a number
UNTRUSTED = " †"  # mark of an estimator that is not to be trusted (`estimator.trust`)
RIGHT_NIS = (0.7, 1.4)  # range of the mean NIS of an estimator with about the right variance
RAW_MODEL = "raw model"  # name of the compliance model without a filter in tables


@dataclass(frozen=True)
class Column:
    """A column of the comparison: key in the metrics, heading, unit, factor, decimals, explanation."""

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
        """Return the value as text of at most six characters; `–` without a value."""
        value = metrics.get(self.key)
        if value is None or not math.isfinite(value):
            return "–"
        value *= self.scale
        fixed = (f"{round(value, d) + 0.0:.{d}f}" for d in range(self.decimals, -1, -1))
        return next((text for text in fixed if len(text) <= _NUMBER), f"{value:.0e}")


COLUMNS = (
    Column("rms", "RMS error", "N·m", 1, 3, "against the true joint torque, after the transient"),
    Column("max", "max error", "N·m", 1, 3, "largest, likewise"),
    Column("noise_ratio", "noise ratio", "", 1, 2, "noise in steady state relative to the raw model's"),
    Column("delay_ms", "delay", "ms", 1, 1, "shift of the truth that explains the estimate best around the pushes"),
    Column("response_ms", "response", "ms", 1, 1, "time of the estimate after the truth at 90 % of a push"),
    Column(
        "missed", "missed", "%", 100, 0, "share of the pushes that the estimate does not follow; they have no response"
    ),
    Column("robust_share", "robust", "%", 100, 1, "share of the time in robust mode"),
    Column("mean_nis", "mean NIS", "", 1, 2, "normalised innovation squared; 1 if P_Y is right"),
    Column("rms_to_sensor", "RMS to sensor", "N·m", 1, 3, "against the noisy torque sensor"),
)
"""Columns of `run.metrics["filters"][name]` and `run.metrics["model"]`."""
IN_TERMINAL = tuple(column for column in COLUMNS if column.key != "rms_to_sensor")
"""Columns for a terminal of 80 columns."""


def comparison_rows(metrics: Mapping[str, Mapping]) -> list[tuple[str, ...]]:
    """Return the cells of the comparison as text: scenario, filter, then `COLUMNS`; by scenario, a run's metrics
    `{"filters": {name: {…}}, "model": {…}}`."""
    rows = []
    for scenario, run in metrics.items():
        entries = {RAW_MODEL: run["model"]} if run.get("model") else {}
        for name, values in (entries | dict(run.get("filters", {}))).items():
            rows.append((scenario, name, *(column.text(values) for column in COLUMNS)))
    return rows


def marked(name: str, run: Mapping) -> str:
    """Return the name of a filter, with `UNTRUSTED` if it is not to be trusted."""
    return name + UNTRUSTED if name in run.get("untrusted", {}) else name


def misjudged(run: Mapping) -> dict[str, float]:
    """Return the mean NIS of filters with a wrong variance (`RIGHT_NIS`), the worst first."""
    nis = {name: measures.get("mean_nis") for name, measures in run["filters"].items()}
    off = {name: value for name, value in nis.items() if value and not RIGHT_NIS[0] <= value <= RIGHT_NIS[1]}
    return dict(sorted(off.items(), key=lambda one: -abs(math.log(one[1]))))


def doubts(metrics: Mapping[str, Mapping]) -> list[str]:
    """Return why estimates are not to be trusted, a line each, after `UNTRUSTED`."""
    return [
        f"{UNTRUSTED.strip()} {scenario}: {name} is not to be trusted: {why}"
        for scenario, run in metrics.items()
        for name, why in run.get("untrusted", {}).items()
    ]


def comparison_table(metrics: Mapping[str, Mapping]) -> Table:
    """Return the comparison for the terminal: a row per filter below its scenario, the best of each scenario in bold."""
    table = narrow_table(
        "Joint torque estimates",
        "Errors against the plant's noise-free joint torque; response: after the truth, 90 % of a push; – not defined"
        + (f";{UNTRUSTED} not to be trusted" if doubts(metrics) else ""),
    )
    table.add_column("filter", overflow="fold")
    for column in IN_TERMINAL:
        table.add_column(heading(column.heading, column.unit), justify="right", no_wrap=True, vertical="bottom")
    rows = comparison_rows(metrics)
    colors = filter_colors(dict.fromkeys(name for _, name, *_ in rows if name != RAW_MODEL))
    for i, (scenario, name, *cells) in enumerate(rows):
        if i == 0 or rows[i - 1][0] != scenario:
            table.add_row(Text(_folded(scenario, ""), style="bold"))
        last = i + 1 == len(rows) or rows[i + 1][0] != scenario
        doubted = (RAW_MODEL, *metrics[scenario].get("untrusted", {}))
        best = _smallest([row for row in rows if row[0] == scenario and row[1] not in doubted])
        shown = [
            Text(cell, style="bold" if (name, k) in best else "")
            for k, cell in enumerate(cells)
            if COLUMNS[k] in IN_TERMINAL
        ]
        text = marked(name, metrics[scenario]).replace(UNTRUSTED, UNTRUSTED.strip())  # on the name's line
        shown_name = Text(_folded(text), style=colors.get(name, "dim"))
        table.add_row(shown_name, *shown, end_section=last)
    return table


def _folded(name: str, indent: str = " ") -> str:
    """Return a name in short lines, broken after underscores."""
    width = _NAME - 2 * len(indent)
    lines = textwrap.wrap(name.replace("_", "_ "), width) if len(name) > width else [name]
    return "\n".join(indent + line.replace("_ ", "_") for line in lines)


def narrow_table(title: str, caption: str) -> Table:
    """Return an empty table with narrow columns and no edges."""
    return Table(
        title=Text(title),
        caption=Text(caption),
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )


def text_table(
    title: str, caption: str, heads: Iterable[str | Text], rows: Iterable[Iterable[str]], left: Collection[int] = (0,)
) -> Table:
    """Return a narrow table; columns at `left` are aligned to the left and folded, the others are not wrapped."""
    table = narrow_table(title, caption)
    for i, head in enumerate(heads):
        table.add_column(head, justify="left" if i in left else "right", no_wrap=i not in left, overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    return table


def heading(words: str, unit: str = "", justify: Literal["left", "right"] = "right") -> Text:
    """Return a heading in short lines, the last with the unit; as `Text`, since `[ms]` would be markup."""
    lines = textwrap.wrap(words, _SHORT, break_long_words=False)
    return Text("\n".join([*lines, f"[{unit}]"] if unit else lines), justify=justify)


def comparison_markdown(metrics: Mapping[str, Mapping], keys: Sequence[str] = ()) -> str:
    """Return the comparison as a Markdown table, with the meaning of the columns below it; `keys`: of the columns,
    without the scenario, all by default."""
    chosen = [k for k, column in enumerate(COLUMNS) if not keys or column.key in keys]
    first = ("filter",) if keys else ("scenario", "filter")
    heads = (*first, *(COLUMNS[k].title for k in chosen))
    rows = [
        (*(row[0], marked(row[1], metrics[row[0]]))[2 - len(first) :], *(row[2 + k] for k in chosen))
        for row in comparison_rows(metrics)
    ]
    lines = [
        markdown_table(heads, rows, len(first)),
        "",
        *(f"{line}.\n" for line in doubts(metrics)),
        "; ".join(f"*{COLUMNS[k].heading}*: {COLUMNS[k].meaning}" for k in chosen) + ".",
    ]
    return "\n".join(lines) + "\n"


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """Return a Markdown table; `left`: columns that are aligned to the left, from the first one."""
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * left + "---:|" * (len(heads) - left)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


_COMPARED = ("rms", "max", "noise_ratio", "delay_ms", "response_ms")
_MISSED = next(k for k, column in enumerate(COLUMNS) if column.key == "missed")


def _smallest(rows: list[tuple[str, ...]]) -> set[tuple[str, int]]:
    """Return (filter, column) of the best values, if rows differ."""
    best = set()
    for k, column in enumerate(COLUMNS):
        values = {row[1]: float(row[2 + k]) for row in rows if row[2 + k] != "–"}
        if column.key == "response_ms":  # comparable only between filters that follow most pushes
            missed = (row[2 + _MISSED] for row in rows)
            fewest = min(missed, key=lambda cell: math.inf if cell == "–" else float(cell), default="")
            values = {row[1]: values[row[1]] for row in rows if row[1] in values and row[2 + _MISSED] == fewest}
        if column.key in _COMPARED and len(set(values.values())) > 1:
            smallest = min(values.values())
            best |= {(name, k) for name, value in values.items() if value == smallest}
    return best
