"""The command line: what it does, its exit codes, and that bad input is one line and leaves nothing behind."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from flexspline.models.joint import known_joints

QUICK = ["--no-figures", "--no-recording"]
SCENARIO = """
name: mine
duration: 1.5
trajectory: [{time: 0, position: 0}, {time: 1, position: 0.1}]
"""


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def one_line(err: str) -> str:
    """The message: exactly one line, no traceback, no colour codes in the way."""
    lines = err.splitlines()
    assert len(lines) == 1, err
    assert "Traceback" not in err
    return lines[0]


# --- what it does --------------------------------------------------------------------------------------------------


def test_scenarios_lists_what_is_shipped(flexspline):
    code, out, _ = flexspline("scenarios")
    assert code == 0
    for name in ("no_load", "link_sweep", "external_push", "hysteresis_loop", "torque_feedback"):
        assert name in out


def test_run_writes_a_folder(flexspline, tmp_path):
    code, out, _ = flexspline(
        "run", "external_push", "--set", "duration=2", "--seed", 7, "--out", tmp_path / "runs", *QUICK
    )
    assert code == 0
    folder = tmp_path / "runs" / "external_push"
    assert json.loads((folder / "run.json").read_text())["seed"] == 7
    assert "RAREKF" in out and str(folder) in out.replace("\n", "")
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["external_push"]


def test_a_run_that_memory_does_not_hold_is_refused(flexspline, tmp_path):
    expected = "duration: expected at most 3600 s, as a run is held in memory, got 3600.5 s"
    for words in (("run", "no_load", "--out", tmp_path / "o", *QUICK), ("bound", "no_load")):
        code, _, err = flexspline(*words, "--set", "duration=3600.5")
        assert code == 2 and expected in one_line(err) and not list(tmp_path.iterdir())


def test_run_takes_a_file(flexspline, tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO)
    code, _, _ = flexspline("run", tmp_path / "mine.yaml", "--out", tmp_path / "runs", *QUICK)
    assert code == 0
    assert (tmp_path / "runs" / "mine" / "metrics.json").is_file()


def test_compare_saves_the_table(flexspline, tmp_path):
    code, out, _ = flexspline(
        "compare", "no_load", "link_sweep", "--set", "duration=3", "--out", tmp_path / "runs", *QUICK
    )
    assert code == 0
    metrics = json.loads((tmp_path / "runs" / "comparison.json").read_text())
    assert set(metrics) == {"no_load", "link_sweep"}
    for name in ("EKF", "AREKF", "RAREKF"):
        assert name in out
        values = metrics["no_load"]["filters"][name]
        assert {"rms", "max", "noise", "noise_ratio", "delay_ms", "response_ms", "robust_share", "mean_nis"} <= set(
            values
        )
    assert "RAREKF" in (tmp_path / "runs" / "comparison.md").read_text()


def test_views_are_drawn_beside_the_runs(flexspline, tmp_path):
    """Two scenarios at a time: all views exist, and no temporary file is left."""
    names = ("link_sweep", "external_push")
    code, _, err = flexspline("compare", *names, "--set", "duration=2", "--out", tmp_path / "runs")
    assert code == 0, err
    for name in names:
        folder = tmp_path / "runs" / name
        assert {"overview.png", "filters.png", "error.png"} <= {path.name for path in (folder / "figures").iterdir()}
        assert (folder / "run.rrd").stat().st_size > 10_000 and not (folder / ".run").exists()
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == sorted(
        [*names, ".flexspline", "comparison.json", "comparison.md"]
    )


def test_filters_by_name_and_with_parameters(flexspline, tmp_path):
    """Any estimator of the registry in a scenario from the command line, and fed back."""
    filters = "filters=[RAREKF, dynamics_ekf, {name: quick, estimator: dynamics_ekf, process.push: 8}]"
    changes = ["duration=2", filters, "feedback=quick", "filters.0.k=0.1"]
    words = [word for change in changes for word in ("--set", change)]
    code, out, err = flexspline("run", "torque_feedback", *words, "--out", tmp_path / "runs", *QUICK)
    assert code == 0, err
    for name in ("RAREKF", "dynamics_ekf", "quick"):
        assert name in out
    scenario = yaml.safe_load((tmp_path / "runs" / "torque_feedback" / "scenario.yaml").read_text())
    assert scenario["feedback"] == "quick" and scenario["filters"][1:] == [
        "dynamics_ekf",
        {"name": "quick", "estimator": "dynamics_ekf", "process.push": 8.0},
    ]


@pytest.fixture
def short_reference(shared, tmp_path):
    """The reference files' first seconds."""
    import pyarrow.parquet as pq

    folder = tmp_path / "reference"
    folder.mkdir()
    for path in (shared / "data" / "reference").glob("*.parquet"):
        table = pq.read_table(path)
        # the loop needs its two branches
        pq.write_table(table if path.stem == "locked_rotor" else table.slice(0, 3000), folder / path.name)
    return folder


def test_verify_exits_1_when_a_limit_is_missed(flexspline, short_reference, tmp_path):
    """Against a joint with another stiffness; every line says met or missed."""
    text = known_joints()["test-joint"].read_text(encoding="utf-8").replace("K1: {value: 8400", "K1: {value: 6400")
    (tmp_path / "soft.yaml").write_text(text, encoding="utf-8")
    code, out, _ = flexspline("verify", short_reference, "--joint", tmp_path / "soft.yaml", "--timestep", "5e-4")
    assert code == 1
    assert "missed" in out
    assert out.count("external_push") == 3


@pytest.mark.slow
def test_verify_exits_0(flexspline, shared):
    code, out, _ = flexspline("verify", shared / "data" / "reference")
    assert code == 0
    assert "missed" not in out and out.count("met") == 11


def test_help_says_the_units(flexspline):
    code, out, _ = flexspline("run", "--help")
    assert code == 0
    for unit in ("[s]", "[A/rad]", "N·m/rad"):
        assert unit in out
    code, out, _ = flexspline("--version")
    assert code == 0 and out.strip()


def test_as_a_program(tmp_path):
    """The installed command itself: exit code 2, one line on stderr, nothing on stdout, no traceback."""
    program = [sys.executable, "-c", "from flexspline.commands import main; main()"]
    done = subprocess.run([*program, "run", "no_laod", "--out", tmp_path / "x"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "did you mean 'no_load'?" in one_line(done.stderr)
    assert files(tmp_path) == []


# --- bad input -------------------------------------------------------------------------------------------------------


def joint_with(tmp_path: Path, old: str, new: str) -> Path:
    text = known_joints()["test-joint"].read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "joint.yaml").write_text(text.replace(old, new, 1), encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(SCENARIO + "joint: joint.yaml\n", encoding="utf-8")
    return tmp_path / "mine.yaml"


BAD_JOINTS = {
    "unknown key": ("  bl: {", "  bll: {", "did you mean 'bl'?"),
    "wrong unit": ("unit: kg·m²", "unit: kg·cm²", "numbers.Jm.unit: expected 'kg·m²', got 'kg·cm²'"),
    "wrong type": ("Jm: {value: 1.38e-5", "Jm: {value: heavy", "numbers.Jm.value: expected a valid number"),
    "negative inertia": ("Jm: {value: 1.38e-5", "Jm: {value: -1.38e-5", "numbers.Jm.value: expected a number > 0"),
    "T2 < T1": ("T2: {value: 12.0", "T2: {value: 1.0", "expected T2 ≥ T1 = 3.9 N·m, got 1"),
}


@pytest.mark.parametrize("case", BAD_JOINTS)
def test_bad_joint(flexspline, tmp_path, case):
    old, new, expected = BAD_JOINTS[case]
    path = joint_with(tmp_path, old, new)
    before = files(tmp_path)
    code, out, err = flexspline("run", path, "--out", tmp_path / "runs", *QUICK)
    assert code == 2
    assert out == ""
    assert expected in one_line(err)
    assert files(tmp_path) == before


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("<mujoco><worldbody>", "not a readable MJCF"),
        ("not xml at all", "not a readable MJCF"),
        (
            "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>",
            "expected the joints rotor, wave_generator, link",
        ),
        ("", "not a readable MJCF"),
    ],
)
def test_unreadable_mjcf(flexspline, tmp_path, content, expected):
    path = joint_with(tmp_path, "model: test_joint.xml", "model: mine.xml")
    (tmp_path / "mine.xml").write_text(content)
    before = files(tmp_path)
    code, _, err = flexspline("run", path, "--out", tmp_path / "runs", *QUICK)
    assert code == 2
    assert expected in one_line(err) and "mine.xml" in err
    assert files(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["no_load", "--set", "duration=0"], "duration: expected greater than 0"),
        (["no_load", "--set", "durtion=3"], "did you mean 'duration'?"),
        (["no_load", "--set", "plant.Jm=-1"], "numbers.Jm.value: expected a number > 0"),
        (["no_load", "--set", "plant.T2=1"], "expected T2 ≥ T1"),
        (["no_load", "--set", "mounting=lnik"], "did you mean 'link'?"),
        (["no_load", "--set", "joint=test-jont"], "did you mean 'test-joint'?"),
        (["no_load", "no_load"], "scenarios: expected each once, got 'no_load' twice"),
        (["no_load", "missing.yaml"], "expected a path or one of"),
        (
            ["no_load", "--set", "filters.0.V=0"],
            "filters.0: filter 'EKF': V [(N·m)²]: expected a finite number > 0, got 0",
        ),
        (["no_load", "--set", "filters.0=lowpas"], "did you mean 'lowpass'?"),
        (["no_load", "--set", "filters=[rts_smoother]", "--set", "feedback=rts_smoother"], "which looks ahead"),
    ],
)
def test_bad_scenario(flexspline, tmp_path, arguments, expected):
    code, out, err = flexspline("run", *arguments, "--out", tmp_path / "runs", *QUICK)
    assert code == 2
    assert out == ""
    assert expected in one_line(err)
    assert files(tmp_path) == []


@pytest.mark.parametrize("command", ["run", "compare"])
def test_a_bad_scenario_behind_a_good_one_leaves_nothing_either(flexspline, tmp_path, command):
    """What can be known before the first run is known before it."""
    (tmp_path / "bad.yaml").write_text(SCENARIO + "mounting: lnik\n", encoding="utf-8")
    before = files(tmp_path)
    arguments = ["link_sweep", tmp_path / "bad.yaml", "--set", "duration=1.5"]
    code, _, err = flexspline(command, *arguments, "--out", tmp_path / "runs", *QUICK)
    assert code == 2
    assert "did you mean 'link'?" in one_line(err)
    assert files(tmp_path) == before


@pytest.mark.parametrize("command", ["run", "compare"])
def test_out_that_cannot_be_written(flexspline, tmp_path, command):
    (tmp_path / "file").write_text("in the way")
    for out in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/nothing/here")):
        code, _, err = flexspline(command, "no_load", "--set", "duration=1.5", "--out", out, *QUICK)
        assert code == 2
        assert str(out) in one_line(err)
    assert files(tmp_path) == ["file"]
    assert (tmp_path / "file").read_text() == "in the way"


def test_out_that_is_not_ours(flexspline, tmp_path):
    (tmp_path / "no_load").mkdir()
    (tmp_path / "no_load" / "precious.txt").write_text("keep")
    code, _, err = flexspline("run", "no_load", "--set", "duration=1.5", "--out", tmp_path, *QUICK)
    assert code == 2
    assert "expected an empty or new folder" in one_line(err)
    assert files(tmp_path) == ["no_load", "no_load/precious.txt"]


def test_diverging_filter_is_one_line(flexspline, tmp_path):
    """γ too small for Eq. (18): it is said that there is no estimate, and the others' results stay."""
    code, _, err = flexspline(
        "run", "no_load", "--set", "duration=1.5", "--set", "filters.3.gamma=0.01", "--out", tmp_path / "runs", *QUICK
    )
    assert code == 0
    assert "REKF" in one_line(err)
    metrics = json.loads((tmp_path / "runs" / "no_load" / "metrics.json").read_text())["filters"]
    assert np.isfinite([m["rms"] for name, m in metrics.items() if name != "REKF" and m["rms"] is not None]).all()
    assert len(metrics) > 1


@pytest.mark.parametrize("bad", ["missing", "empty", "no parquet", "a column short"])
def test_bad_reference(flexspline, tmp_path, bad):
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder = tmp_path / "reference"
    if bad != "missing":
        folder.mkdir()
    if bad == "no parquet":
        (folder / "no_load.parquet").write_text("text")
    if bad == "a column short":
        pq.write_table(pa.table({"time": [0.0, 1e-3]}), folder / "no_load.parquet")
    code, out, err = flexspline("verify", folder)
    assert code == 2
    assert out == ""
    message = one_line(err)
    assert "no_load.parquet" in message
    if bad == "a column short":
        assert "expected a column 'position_command'" in message


def test_unknown_command_and_option(flexspline):
    assert flexspline("rnu", "no_load")[0] == 2
    code, _, err = flexspline("run", "no_load", "--sede", "1")
    assert code == 2 and "Traceback" not in err
