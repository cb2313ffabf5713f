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
def test_as_json_with_realistic_sensors(flexspline):
    code, out, err = flexspline("contact", *QUICK, "--tolerance", 0.2, "--set", "sensors=realistic", "--json")
    assert code == 0, err
    rows = {row["estimator"]: row for row in json.loads(out)}
    assert set(rows) == {"torque sensor", "RAREKF"}
    assert rows["RAREKF"]["tolerance"] == 0.2 and rows["RAREKF"]["threshold"] > 0.0


@pytest.mark.slow
def test_too_little_time_for_a_threshold_is_said(flexspline):
    code, out, err = flexspline("contact", *QUICK[:-1], 10, "--tolerance", 0)
    assert code == 0, err
    assert "nan" not in out and "which takes at least 0.2 h" in " ".join(out.split())
    assert "--hours: expected at least 0.2 for thresholds of 10 false alarms an hour, got 0.05" in err  # before it runs


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--filter", "rts_smoother"), "looks at nothing later"),
        (("--set", "feedback=RAREKF"), "feedback"),
        (("--tolerance", "1", "--tolerance", "1"), "--tolerance"),
        (("--set", "duration=6"), "duration"),
    ],
)
def test_mistakes(flexspline, words, said):
    code, _, err = flexspline("contact", "--hours", 0.05, *words)
    assert code == 2 and said in err and err.count("\n") == 1
