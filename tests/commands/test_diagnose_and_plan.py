"""diagnose and plan as a user calls them: refusals before the work, stages, an answer that fits a terminal, Ctrl-C."""

from __future__ import annotations

import io
import json
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from flexspline.commands import _console
from flexspline.commands.diagnose import show
from flexspline.diagnosis.answer import BalanceResidual, Diagnosis, Finding, ParameterEstimate, ParameterShift
from flexspline.diagnosis.data.mistakes import Mistake
from flexspline.diagnosis.fit.regions import Region
from flexspline.diagnosis.improvement import Improvement
from flexspline.diagnosis.planning import Plan, Proposal, Question
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement, Recording, write_recording
from flexspline.views.report import Report

PLAN = Plan(
    (Question(("friction_temperature",), 0.0, 3.74), Question(("torque_constant", "torque_sensor_gain"), 1.1, 3.0)),
    (Proposal("with_temperature", "Record the gear's temperature until 10 K warmer", 22.0, (41.0, 1.2), 0.6),),
)


def answered(**changes) -> Diagnosis:
    """An answer with something of everything in it, longest names first."""
    names = {"position_dependent_friction": "amplitude", "load_dependent_friction": "coefficient"}
    causes = tuple(
        Finding(name, "transmission", 0.987, {key: ParameterEstimate(0.00812345, 0.000123, "N·m")}, 0.9, 0.412)
        for name, key in names.items()
    )
    residual = {
        "motor_current": BalanceResidual(0.0512, 0.0104, 0.01, "A"),
        "link_balance": BalanceResidual(2.0, 1.0, 0.5, "N·m"),
    }
    regions = tuple(Region(f"recording sweep_{i}", True, 400, 1.4 + i, 1.0, 1.5, 1.5 / (1.4 + i)) for i in range(5))
    base = Diagnosis(
        verdict="discrepancy", reasons=(), causes=causes, minor=causes[:1],
        calibration={"K1": ParameterShift(8400, 8790, 60, 0.07, "N·m/rad")},
        confusable=(("torque_constant", "torque_sensor_gain"),), undetermined={"friction_temperature": "no column"},
        residual=residual, regions=regions, extended=load_joint("test-joint"), plan=PLAN, problem=object(),  # type: ignore[arg-type]
    )  # fmt: skip
    return replace(base, **changes)


@pytest.fixture
def measurement(tmp_path) -> Path:
    t = 1e-3 * np.arange(3000)
    theta = np.sin(2 * t)
    columns = {"motor_position": 100 * theta, "link_position": theta, "motor_current": 0.1 * np.cos(2 * t)}
    write_recording(Recording("swing", t, columns), tmp_path / "bench")
    return tmp_path / "bench"


@pytest.fixture
def quick(monkeypatch):
    """Diagnosis answers at once; gives what it was asked."""
    asked = {}

    def diagnose(data, joint, progress, seconds):
        asked.update(seconds=seconds, joint=joint, data=data)
        progress("calibrating the joint", 0.1)
        progress("screening the library of causes", 0.3)
        progress("screening the library of causes", 0.4)
        return answered(problem=None, plan=None)

    monkeypatch.setattr("flexspline.diagnosis.diagnose.diagnose", diagnose)
    monkeypatch.setattr("flexspline.diagnosis.improvement.improvement", lambda *given: None)
    monkeypatch.setattr("flexspline.diagnosis.planning.plan", lambda *given: PLAN)
    return asked


def printed(found: Diagnosis, gained: Improvement | None = None, width: int = 80) -> str:
    file = io.StringIO()
    measured = Measurement(
        "bench",
        Path("bench"),
        (Recording("swing", np.arange(2.0), {n: np.zeros(2) for n in ("link_position", "motor_current")}),),
    )
    report = Report(measured, load_joint("test-joint"), found, gained, found.plan, Path("out"))
    show(Console(file=file, width=width), report, True)
    return file.getvalue()


def one_line(err: str) -> str:
    lines = [line for line in err.splitlines() if line.strip()]
    assert len(lines) == 1, err
    return lines[0]


def test_the_answer_is_legible_in_80_columns():
    gained = Improvement("joint_torque", "RAREKF", {"payload_smoothed": (1.23, 0.109)}, (), 0.03, "the description", ())
    mistake = Mistake("unit", "motor_position", "sweep", "degrees, logged as radians", 0.99, factor=0.0174533)
    found = answered(mistakes=(replace(mistake, severe=False),))
    text = printed(found, gained)
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    flat = " ".join(text.split())
    for part in (
        "discrepancy:",
        "unit: sweep, motor_position: degrees, logged as radians (99 % sure); corrected by: × 0.0174533",
        "position dependent friction (transmission): 99 % sure, explains 90 %, 0.41 N·m RMS (2.6 % of the rated torque)",
        "amplitude = 0.00812 ± 0.00012 N·m", "motor current 0.0512 0.0104 0.01 A",
        "estimate, payload smoothed 1.23 0.109 0.03 N·m",
        "recording sweep_0 1.4 1.5 N·m worse than described",
        "confounded: torque constant with torque sensor gain", "could not have shown: friction temperature",
        "1 Record the gear's temperature until 10 K warmer (22 s): would show friction temperature by 41 standard deviations",
        "flexspline estimate bench --joint out/joint.yaml --out estimates",
    ):  # fmt: skip
        assert part in flat, part


def test_mistakes_that_make_physics_meaningless_are_mended_first():
    mistake = Mistake("swapped", "", "", "motor and link column exchanged", 0.99)
    found = answered(
        verdict="inconclusive", reasons=("mistakes",), causes=(), mistakes=(mistake,), problem=None, plan=None
    )
    text = printed(found)
    assert text.rstrip().endswith("flexspline import bench --fix --out MENDED")
    assert "--joint out/joint.yaml" not in text


def test_diagnose_writes_its_files_and_shows_stages(flexspline, measurement, quick, tmp_path):
    out = tmp_path / "o"
    code, text, err = flexspline("diagnose", measurement, "--out", out, "--no-report", "--time", 60)
    assert code == 0, err
    assert sorted(p.name for p in out.iterdir()) == [".flexspline", "diagnosis.json", "joint.yaml"]
    assert json.loads((out / "diagnosis.json").read_text())["next"] == PLAN.to_json()
    assert 0 < quick["seconds"] < 60
    lines = err.splitlines()
    assert [line.split("%  ")[1] for line in lines] == [
        "calibrating the joint", "screening the library of causes", "estimating torque before and after",
        "what to measure next", "writing",
    ]  # fmt: skip
    assert "friction temperature" in text
    code, text, _ = flexspline("plan", out)
    assert code == 0 and text.startswith("1. Record the gear's temperature")
    code, text, _ = flexspline("plan", out, "--json")
    assert json.loads(text) == PLAN.to_json()


def test_what_is_not_finite_is_null_in_json(flexspline, measurement, monkeypatch):
    (proposal,) = PLAN.proposals
    endless = replace(PLAN, proposals=(replace(proposal, expected=(float("inf"), 1.2)),))
    monkeypatch.setattr("flexspline.diagnosis.diagnose.diagnose", lambda *given, **named: answered())
    monkeypatch.setattr("flexspline.diagnosis.planning.plan", lambda *given: endless)
    code, text, err = flexspline("plan", measurement, "--json")
    assert code == 0, err
    assert "Infinity" not in text and json.loads(text)[0]["expected"][0]["expected"] is None


def test_without_time_left_the_answer_comes_without_the_rest(flexspline, measurement, quick, monkeypatch, tmp_path):
    def fail(*given):
        raise AssertionError

    monkeypatch.setattr("flexspline.diagnosis.improvement.improvement", fail)
    monkeypatch.setattr("flexspline.diagnosis.planning.plan", fail)
    code, _, err = flexspline("diagnose", measurement, "--out", tmp_path / "o", "--no-report", "--time", 1e-6)
    assert code == 0, err
    code, _, err = flexspline("plan", tmp_path / "o")
    assert code == 2 and "plan from the measurement" in one_line(err)


@pytest.mark.parametrize("out", ["bench", "bench/inside", ".", "bench/swing.yaml", "mine"])
def test_diagnose_refuses_before_the_work(flexspline, measurement, tmp_path, monkeypatch, out):
    def fail(*given, **more):
        raise AssertionError("computed")

    monkeypatch.setattr("flexspline.diagnosis.diagnose.diagnose", fail)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    code, _, err = flexspline("diagnose", measurement, "--out", tmp_path / out)
    assert code == 2
    assert "expected" in one_line(err)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_an_own_file_beside_the_answer_stays(flexspline, measurement, quick, tmp_path):
    out = tmp_path / "o"
    assert flexspline("diagnose", measurement, "--out", out, "--no-report")[0] == 0
    (out / "notes.txt").write_text("mine")
    assert flexspline("diagnose", measurement, "--out", out, "--no-report")[0] == 0
    assert (out / "notes.txt").read_text() == "mine"


def test_interrupted_it_says_so_in_a_line_and_writes_nothing(flexspline, measurement, quick, monkeypatch, tmp_path):
    out = tmp_path / "o"
    assert flexspline("diagnose", measurement, "--out", out, "--no-report")[0] == 0
    before = {p.name: p.read_bytes() for p in out.iterdir()}

    def stop(*given, **more):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("os._exit", sys.exit)
    for where in ("diagnosis.diagnose.diagnose", "diagnosis.planning.plan", "models.joint.Joint.write"):
        with monkeypatch.context() as patched:
            patched.setattr(f"flexspline.{where}", stop)
            code, text, err = flexspline("diagnose", measurement, "--out", out, "--no-report")
        assert code == 130 and text == ""
        assert err.splitlines()[-1] == "flexspline: interrupted, nothing is half-written"
        assert "Traceback" not in err
        assert {p.name: p.read_bytes() for p in out.iterdir()} == before


def test_plan_of_a_folder_that_is_no_diagnosis(flexspline, tmp_path):
    (tmp_path / "diagnosis.json").write_text("{}")
    code, _, err = flexspline("plan", tmp_path)
    assert code == 2 and "diagnosis.json: next" in one_line(err)
    code, _, err = flexspline("plan", tmp_path / "nowhere")
    assert code == 2 and "expected a recording" in one_line(err)
    code, _, err = flexspline("plan", tmp_path, "--joint", "test-joint")
    assert code == 2 and "--joint: expected with a measurement" in one_line(err)


def test_nothing_is_said_to_be_planned_where_nothing_was_looked_at(flexspline, tmp_path):
    """Data with mistakes get no proposals."""
    answer = {"format": 1, "verdict": "inconclusive", "reason": "mistakes in the data", "residual": {}, "next": []}
    (tmp_path / "diagnosis.json").write_text(json.dumps(answer))
    code, out, err = flexspline("plan", tmp_path)
    assert code == 2 and not out and "nothing could be planned: mistakes in the data" in one_line(err)
    t = 2e-3 * np.arange(5000)
    link = 0.8 * np.sin(2 * t)
    columns = {"motor_position": 180 / np.pi * 100 * link, "link_position": link, "motor_current": 1.3 * np.sin(link)}
    write_recording(Recording("degrees", t, columns), tmp_path / "bench")
    code, out, err = flexspline("plan", tmp_path / "bench")
    assert code == 2 and not out and "nothing can be planned: mistakes in the data" in err.splitlines()[-1]


def test_stages_are_a_bar_on_a_terminal(monkeypatch):
    file = io.StringIO()
    terminal = Console(file=file, force_terminal=True, width=80)
    monkeypatch.setattr("rich.console.Console", lambda **given: terminal)
    with _console.stages("diagnosing bench") as stage:
        stage("calibrating the joint", 0.25)
        time.sleep(0.15)
    assert "calibrating the joint" in file.getvalue() and "25%" in file.getvalue()


def test_what_begins_once_more_does_not_take_the_share_back(capsys):
    with _console.stages("diagnosing bench") as stage:
        for name, done in (("screening", 0.2), ("settling", 0.6), ("screening", 0.2), ("writing", 0.95)):
            stage(name, done)
    shares = [int(line.split()[2]) for line in capsys.readouterr().err.splitlines()]
    assert shares == [20, 60, 60, 95]


@pytest.mark.slow
@pytest.mark.long
def test_an_example_from_end_to_end(flexspline, shared, tmp_path):
    source = shared / "data" / "examples" / "toleranced" / "02"
    code, text, err = flexspline("diagnose", source, "--joint", "test-joint", "--out", tmp_path / "o")
    assert code == 0, err
    truth = json.loads((source.parent / "truth.json").read_text()) if (source.parent / "truth.json").is_file() else {}
    answer = json.loads((tmp_path / "o" / "diagnosis.json").read_text())
    assert answer["verdict"] == "discrepancy", (answer["causes"], truth.get("02"))
    assert answer["next"] and answer["next"][0]["sentence"].split(" (")[0] in " ".join(text.split())
    assert (tmp_path / "o" / "report.html").is_file() and (tmp_path / "o" / "report.rrd").is_file()
