"""`flexspline contact`: table, curves, figure, JSON; mistakes in one line."""

from __future__ import annotations

import csv
import json

import pytest

QUICK = ("--hours", 0.05, "--filter", "RAREKF", "--set", "duration=20", "--rate", 400)


@pytest.mark.slow
def test_tables_curves_and_figure(flexspline, tmp_path):
    out = tmp_path / "contact"
    code, text, err = flexspline("contact", *QUICK, "--tolerance", 0, "--out", out)
    assert code == 0, err
    assert "RAREKF" in text and "torque" in text
    with (out / "contact.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    own = [r for r in rows if r["estimator"] == "RAREKF"]
    thresholds = [float(r["threshold"]) for r in own]
    alarms = [float(r["false_alarms_per_hour"]) for r in own]
    assert len(own) > 5 and thresholds == sorted(thresholds) and alarms == sorted(alarms, reverse=True)
    assert (out / "contact.png").stat().st_size > 10_000
    assert (out / "contact.md").read_text(encoding="utf-8").count("| RAREKF |") == 1


@pytest.mark.slow
def test_terminal_page_and_json_have_the_same_numbers(flexspline, tmp_path):
    """With another joint, sensors and rate; the page proposes the same command for longer, into another folder."""
    words = (*QUICK, "--tolerance", 0.2, "--set", "sensors=realistic", "--set", "joint=csg-14-100-ec45")
    out = tmp_path / "found"
    code, text, err = flexspline("contact", *words, "--out", out)
    assert code == 0, err
    answer = json.loads((out / "contact.json").read_text(encoding="utf-8"))
    rows = {row["estimator"]: row for row in answer["detectors"]}
    assert set(rows) == {"torque sensor", "RAREKF"} and answer["joint"] == "csg-14-100-ec45"
    assert rows["RAREKF"]["tolerance"] == 0.2 and rows["RAREKF"]["threshold"] > 0.0
    assert flexspline("report", out, "--out", tmp_path / "page.html")[0] == 0
    page, note = ((tmp_path / name).read_text(encoding="utf-8") for name in ("page.html", "found/contact.md"))
    for row in rows.values():
        shown = f"{row['threshold']:.3f}"
        assert shown in text and shown in page and shown in note
        assert f"{row['smallest_push']:.2f}" in text and f"{row['smallest_push']:.2f}" in page
    assert "csg-14-100-ec45" in text and "csg-14-100-ec45 within 0.2 times" in page
    assert f"--set sensors=realistic --set joint=csg-14-100-ec45 --hours 0.2 --out {out}-0.2h" in page
    assert "--rate 400" in page


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--filter", "rts_smoother"), "expected a causal estimator"),
        (("--set", "feedback=RAREKF"), "feedback"),
        (("--tolerance", "1", "--tolerance", "1"), "tolerance: expected shares from 0 to 100, each once"),
        (("--set", "duration=6"), "duration"),
        ((), "hours: expected at least 0.2 for thresholds of 10 false alarms per hour, got 0.05"),
    ],
)
def test_mistakes(flexspline, words, said):
    code, _, err = flexspline("contact", "--hours", 0.05, *words)
    assert code == 2 and said in err and err.count("\n") == 1
