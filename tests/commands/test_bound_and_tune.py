"""`flexspline bound` and `flexspline tune`: what they write, and bad input in one line."""

from __future__ import annotations

import csv

import pyarrow.parquet as pq
import pytest
import yaml

SHORT = ("--set", "duration=9")


@pytest.mark.slow
def test_bound(flexspline, tmp_path):
    code, out, _ = flexspline(
        "bound",
        "external_push",
        "--seeds",
        2,
        "--filter",
        "RAREKF",
        "--filter",
        "dynamics_ekf",
        "--out",
        tmp_path,
        *SHORT,
    )
    assert code == 0 and "RAREKF" in out and "dynamics_ekf" in out
    table = pq.read_table(tmp_path / "external_push" / "limits.parquet")
    assert {"time", "bound", "error_RAREKF", "nees_dynamics_ekf"} <= set(table.column_names)
    assert table.schema.field("bound").metadata[b"unit"].decode() == "N·m"
    with (tmp_path / "summary.csv").open() as file:
        rows = {row["estimator"]: row for row in csv.DictReader(file)}
    assert float(rows["RAREKF"]["ratio"]) == pytest.approx(
        float(rows["RAREKF"]["rms"]) / float(rows["RAREKF"]["bound"])
    )
    assert (tmp_path / "external_push" / "limits.png").stat().st_size > 10000


@pytest.mark.slow
def test_bound_on_draws_of_its_own_model(flexspline):
    code, out, _ = flexspline(
        "bound", "link_sweep", "--walk", "--intensity", 0.5, "--seeds", 1, "--filter", "EKF", "--set", "duration=3"
    )
    assert code == 0 and "0.5 N·m/√s" in out and "EKF" in out


def test_tune(flexspline, tmp_path):
    code, out, _ = flexspline(
        "tune", "external_push", "--filter", "EKF", "--filter", "lowpass", "--train", "1-2", "--test", "11-12",
        "--evaluations", 12, "--out", tmp_path, *SHORT,
    )  # fmt: skip
    assert code == 0 and "lowpass" in out
    data = yaml.safe_load((tmp_path / "tuned.yaml").read_text())
    assert [f["name"] for f in data["filters"]] == ["EKF", "lowpass"]
    assert data["test"] == [11, 12] and (tmp_path / "pareto.png").exists() and (tmp_path / "tuned.md").exists()


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("bound", "--filter", "RAREK"), "did you mean 'RAREKF'"),
        (("tune", "no_load", "--filter", "lowpas", "--out", "x"), "did you mean 'lowpass'"),
        (("bound", "no_load", "no_load"), "expected each once"),
        (("bound", "no_load", "--walk"), "expected an --intensity"),
        (("bound", "torque_feedback"), "feedback: expected none or sensor"),
        (("tune", "no_load", "--train", "5-1", "--out", "x"), "expected seeds as A-B with A ≤ B"),
        (("tune", "no_load", "--train", "1-5", "--test", "5-9", "--out", "x"), "got 5 in both"),
        (("tune", "torque_feedback", "--out", "x"), "feedback: expected none or sensor"),
    ],
)
def test_bad_input(flexspline, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    code, _, err = flexspline(*arguments)
    lines = [line for line in err.splitlines() if line.strip()]
    assert code == 2 and len(lines) == 1 and message in lines[0]
    assert list(tmp_path.iterdir()) == []
