"""The comparison as text."""

from __future__ import annotations

from terminal import rendered

from flexspline.views.sweep_tables import metric_column
from flexspline.views.tables import (
    COLUMNS,
    IN_TERMINAL,
    RAW_MODEL,
    comparison_markdown,
    comparison_rows,
    comparison_table,
    heading,
)

METRICS = {
    "push": {
        "filters": {
            "EKF": {"rms": 0.5, "max": 1.25, "noise_ratio": 0.2, "delay_ms": -0.001, "response_ms": None, "missed": 1.0,
                    "robust_share": 0.0, "mean_nis": float("nan"), "rms_to_sensor": 0.51},
            "RAREKF": {"rms": 0.25, "max": 2.0, "noise_ratio": 0.4, "delay_ms": 1.5, "response_ms": 12.34, "missed": 1 / 7,
                       "robust_share": 0.123, "mean_nis": 1.0, "rms_to_sensor": 0.3},
        },
        "model": {"rms": 1.0, "max": 3.0, "noise_ratio": 1.0, "rms_to_sensor": 1.1},
    },
    "rest": {"filters": {"EKF": {"rms": 0.1}}},
}  # fmt: skip


def test_rows_are_scenario_by_filter_with_units_applied():
    rows = comparison_rows(METRICS)
    assert [row[:2] for row in rows] == [("push", RAW_MODEL), ("push", "EKF"), ("push", "RAREKF"), ("rest", "EKF")]
    assert rows[2] == ("push", "RAREKF", "0.250", "2.000", "0.40", "1.5", "12.3", "14", "12.3", "1.00", "0.300")
    assert rows[1][5:10] == ("0.0", "–", "100", "0.0", "–")  # no minus zero, no None, no NaN


def test_markdown_has_a_row_each_and_explains_its_columns():
    lines = comparison_markdown(METRICS).splitlines()
    assert lines[0].count("|") == lines[1].count("|") == lines[2].count("|") == len(COLUMNS) + 3
    assert "RMS error [N·m]" in lines[0]
    assert sum(line.startswith("| push") or line.startswith("| rest") for line in lines) == 4
    assert all(column.meaning in lines[-1] for column in COLUMNS)


def test_response_is_one_quantity_everywhere():
    (column,) = (c for c in COLUMNS if c.heading == "response")
    assert "after the truth" in column.meaning and column.unit == "ms"
    assert metric_column("response_ms") is column


def test_markdown_of_some_columns():
    lines = comparison_markdown({"push": METRICS["push"]}, keys=("rms", "robust_share")).splitlines()
    assert lines[0] == "| filter | RMS error [N·m] | robust [%] |" and lines[4] == "| RAREKF | 0.250 | 12.3 |"


def test_comparison_is_whole_at_80_columns():
    names = ("hysteresis_loop", "external_push")
    loud = {
        "rms": 12.345,
        "max": 123.456,
        "rms_to_sensor": 12.3,
        "robust_share": 1.0,
        "response_ms": 104.2,
        "missed": 1.0,
        "mean_nis": 10.0,
    }
    found = {name: {**METRICS["push"], "filters": {**METRICS["push"]["filters"], "AREKF": loud}} for name in names}
    text = rendered(comparison_table(found))
    head = text.split("─")[0]
    for column in IN_TERMINAL:
        assert all(word in head.split() for word in column.heading.split()), column.heading
        assert head.count(f"[{column.unit}]") >= (1 if column.unit else 0), column.unit
    assert head.count("[ms]") == 2 and head.count("[N·m]") == 2 and head.count("[%]") == 2
    for scenario, name, *every in comparison_rows(found):
        cells = [cell for cell, column in zip(every, COLUMNS, strict=True) if column in IN_TERMINAL]
        assert scenario in text
        assert any(line.split() == [*name.split(), *cells] for line in text.splitlines()), (scenario, name)


def test_what_is_not_to_be_trusted_is_marked_and_never_the_best():
    run = METRICS["push"] | {"untrusted": {"RAREKF": "torque of 120 N·m"}}
    table = comparison_table({"push": run})
    assert [str(cell).split() for cell in table.columns[0].cells][1:] == [["raw", "model"], ["EKF"], ["RAREKF†"]]
    assert not any(str(cell) == "0.250" and "bold" in str(cell.style) for cell in table.columns[1].cells)
    assert "† not to be trusted" in str(table.caption)
    markdown = comparison_markdown({"push": run})
    assert "| push | RAREKF † | 0.250 |" in markdown
    assert "† push: RAREKF is not to be trusted: torque of 120 N·m." in markdown
    assert "†" not in comparison_markdown(METRICS) + str(comparison_table(METRICS).caption)


def test_headings_are_text_not_markup():
    assert heading("delay", "ms").plain == "delay\n[ms]"
    assert heading("noise ratio").plain == "noise\nratio"


def test_the_best_of_a_scenario_is_marked():
    table = comparison_table(METRICS)
    cells = {str(cell): str(cell.style) for cell in table.columns[1].cells if str(cell)}
    assert cells == {"1.000": "", "0.500": "", "0.250": "bold", "0.100": ""}  # not where there is nothing to compare


def test_large_numbers_and_long_names_keep_the_table_whole():
    """Numbers have at most six characters; names are broken after underscores only."""
    names = ("dynamics_ekf", "lowpass_first_order", "an_estimator_of_somebody_with_a_long_name")
    for size in (0.0, 9.9996, 999.9996, 17084.2, 123089.21, 4.5e7, 1.7e300, -4.2e4):
        values = {column.key: size for column in COLUMNS}
        assert all(len(column.text(values)) <= 6 for column in COLUMNS), size
        run = {"filters": dict.fromkeys(names, values), "model": values, "untrusted": dict.fromkeys(names, "large")}
        text = rendered(comparison_table({"hysteresis_loop": run}))
        assert "dynamics_ekf† " in text and "first_order† " in text and "long_name† " in text
        assert "dynamics_ekf" in text and "lowpass_" in text and "first_order" in text
        assert all(
            word in names[2] for line in text.splitlines() for word in line.split()[:1] if word.startswith("an_")
        )
    assert COLUMNS[0].text({"rms": 1234.5678}) == "1234.6" and COLUMNS[0].text({"rms": 123089.21}) == "123089"
