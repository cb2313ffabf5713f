"""The comparison as text."""

from __future__ import annotations

import io

from flexspline.views.tables import COLUMNS, RAW_MODEL, comparison_markdown, comparison_rows, comparison_table
from rich.console import Console

METRICS = {
    "push": {
        "filters": {
            "EKF": {"rms": 0.5, "max": 1.25, "noise_ratio": 0.2, "delay_ms": -0.001, "response_ms": None,
                    "robust_share": 0.0, "mean_nis": float("nan"), "rms_to_sensor": 0.51},
            "RAREKF": {"rms": 0.25, "max": 2.0, "noise_ratio": 0.4, "delay_ms": 1.5, "response_ms": 12.34,
                       "robust_share": 0.123, "mean_nis": 1.0, "rms_to_sensor": 0.3},
        },
        "model": {"rms": 1.0, "max": 3.0, "noise_ratio": 1.0, "rms_to_sensor": 1.1},
    },
    "rest": {"filters": {"EKF": {"rms": 0.1}}},
}  # fmt: skip


def test_rows_are_scenario_by_filter_with_units_applied():
    rows = comparison_rows(METRICS)
    assert [row[:2] for row in rows] == [("push", RAW_MODEL), ("push", "EKF"), ("push", "RAREKF"), ("rest", "EKF")]
    assert rows[2] == ("push", "RAREKF", "0.250", "2.000", "0.40", "1.5", "12.3", "12.3", "1.00", "0.300")
    assert rows[1][5:9] == ("0.0", "–", "0.0", "–")  # no minus zero, no None, no NaN


def test_markdown_has_a_row_each_and_explains_its_columns():
    lines = comparison_markdown(METRICS).splitlines()
    assert lines[0].count("|") == lines[1].count("|") == lines[2].count("|") == len(COLUMNS) + 3
    assert "RMS error [N·m]" in lines[0]
    assert sum(line.startswith("| push") or line.startswith("| rest") for line in lines) == 4
    assert all(column.meaning in lines[-1] for column in COLUMNS)


def test_table_prints_every_value_and_marks_the_best():
    table = comparison_table(METRICS)
    out = io.StringIO()
    Console(file=out, width=160).print(table)
    text = out.getvalue()
    for row in comparison_rows(METRICS):
        assert all(cell in text for cell in row)
    rms = {str(cell): str(cell.style) for cell in table.columns[2].cells}
    assert rms == {"1.000": "", "0.500": "", "0.250": "bold", "0.100": ""}  # not where there is nothing to compare
