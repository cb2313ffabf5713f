"""`flexspline diagnose` and `challenge` as a user meets them: files, report, exit codes, and how bad input ends."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from flexspline.diagnosis.challenge import Challenge
from flexspline.diagnosis.gain import estimation, held_out, with_gain
from flexspline.sim.recording import Measurement, write_recording

from flexspline.diagnosis import challenge as challenges
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.planning import Plan, Proposal, Question
from flexspline.models import causes
from flexspline.models.joint import load_joint
from flexspline.views import diagnosis_figures as figures
from flexspline.views.report import Report, html, markdown, verdict_sentence, write_rerun_report

VOID = {"meta", "br", "path", "rect", "circle"}


class Checker(HTMLParser):
    """Every tag closed in order; collects what the page refers to, and its text."""

    def __init__(self):
        super().__init__()
        self.open, self.links, self.text = [], [], []

    def handle_starttag(self, tag, attributes):
        self.links += [v for k, v in attributes if k in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.links += [v for k, v in attributes if k in ("src", "href")]

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> tuple[Path, Measurement]:
    """A joint with an asymmetric friction, measured and written to a folder: 20 s of the sweep of a draw."""
    drawn = challenges.draw(Challenge(seed=2, only=("friction_asymmetry",)), 0)
    folder = tmp_path_factory.mktemp("measurement") / "bench <1>"
    folder.mkdir()
    (sweep,) = (r for r in drawn.measurement.recordings if r.name == "sweep")
    kept = [replace(sweep, **{name: values[:20000] for name, values in sweep.columns.items()})]
    for recording in kept:
        write_recording(recording, folder)
    return folder, Measurement(folder.name, folder, tuple(kept))


@pytest.fixture(scope="module")
def report(measured) -> Report:
    joint = load_joint("test-joint")
    found = diagnose(measured[1], joint)
    gain = estimation(measured[1], joint, found)
    plan = Plan(
        (Question(("backlash",), 1.0, 7.0), Question(("cogging", "kinematic_error"), 2.0, 4.5)),
        (Proposal("link_sweep", "slow", True, 40.0, (9.0, 3.0)),),
        ("torque_sensor_gain",),
    )
    return Report(measured[1], joint, with_gain(found, gain), gain, plan, 9.0)


def test_report_is_one_sound_page_that_refers_to_nothing(report):
    page = html(report)
    checker = Checker()
    checker.feed(page)
    checker.close()
    # html needs no closing tag for li and p; everything that is opened here is closed.
    assert checker.open in ([], ["html"])
    assert checker.links == []
    assert "@import" not in page and "url(http" not in page and "<script" not in page
    assert len(page.encode()) < 3e6
    assert "bench &lt;1&gt;" in page and "bench <1>" not in page
    assert "nan" not in re.sub(r"<[^>]*>", " ", page.split("<main>")[1]).lower().split()
    # Clip paths are of one panel each.
    names = re.findall(r'<clipPath id="(\w+)"', page)
    assert len(names) == len(set(names)) > 20


def test_report_answers_what_a_colleague_asks(report):
    checker = Checker()
    checker.feed(html(report))
    text = " ".join(checker.text)
    for part in (
        verdict_sentence(report.diagnosis), "Friction asymmetry".lower(), "confidence", "Motor and mesh", "Transmission:",
        "Link:", "link angle", "motor angle in one turn", "motor velocity", "load [N·m]", "direction of motion",
        "time since the start", "order per turn", "noise", "RAREKF", "tolerance", "What this measurement cannot tell",
        "What to measure next", "Measure “link_sweep”", "held-out", "it away", "Only a joint torque sensor shows",
    ):  # fmt: skip
        assert part.lower() in text.lower(), part
    notes = markdown(report)
    assert verdict_sentence(report.diagnosis) in notes and "| RAREKF |" in notes


def test_variable_that_gives_the_cause_away(rng):
    k = 4000
    velocity = rng.uniform(-60, 60, k)
    link = rng.uniform(-1, 1, k)
    other = {name: rng.uniform(0, 9, k) for name in ("time", "motor", "load")}
    noise = 0.01 * rng.standard_normal(k)

    def balance(before):
        return figures.Balance(
            "Motor: x", "A", before, noise, 0.01, link=link, velocity=velocity, rising=rng.random(k) < 0.5, **other
        )

    b, key, share = figures.telling([balance(noise), balance(noise + 0.1 * np.sign(velocity))])
    assert key in ("direction", "velocity") and share > 0.9
    assert b.before is not noise
    _, key, _ = figures.telling([balance(noise + 0.1 * (link > 0.5))])
    assert key == "link"
    assert figures.telling([balance(noise)]) is None


def test_orders_are_found_by_least_squares():
    motor = np.linspace(-300, 400, 20000)
    amplitude = figures.orders(motor, 0.3 * np.sin(2 * motor + 1) + 0.1 * np.cos(0.5 * motor) + 0.05)
    expected = np.where(figures.ORDERS == 2, 0.3, np.where(figures.ORDERS == 0.5, 0.1, 0.0))
    np.testing.assert_allclose(amplitude, expected, atol=5e-3)


def test_gain_is_measured_on_what_no_fit_saw(report):
    recording = report.measurement.recordings[0]
    share = held_out(recording, 0).mean()
    assert 0.1 < share < 0.2
    answer = report.diagnosis.to_json()["estimation"]
    assert answer["filter"] == "RAREKF" and answer["unit"] == "N·m"
    assert set(answer) == {"filter", "before", "after", "unit"}
    assert 0 < answer["after"] < 1.05 * answer["before"]
    blind = Measurement(
        "b", Path(), tuple(challenges.bare(r, np.random.default_rng(1)) for r in report.measurement.recordings)
    )
    assert estimation(blind, report.joint, report.diagnosis) is None


def test_rerun_recording_is_written(report, tmp_path):
    path = write_rerun_report(report, tmp_path / "report.rrd")
    assert path.read_bytes()[:3] == b"RRF"
    assert path.stat().st_size < 20e6


def test_diagnose_writes_the_answer_as_specified(flexspline, measured, report, tmp_path, monkeypatch):
    # The same measurement was diagnosed for the report already.
    monkeypatch.setattr("flexspline.diagnosis.diagnose.diagnose", lambda data, joint: report.diagnosis)
    out = tmp_path / "out"
    code, text, error = flexspline("diagnose", measured[0], "--joint", "test-joint", "--out", out)
    assert code == 0, error
    assert "friction asymmetry" in text
    answer = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert list(answer) == [
        "verdict", "causes", "calibration", "confusable", "undetermined", "residual", "estimation", "held_out",
    ]  # fmt: skip
    assert answer["verdict"] == "discrepancy"
    (cause,) = answer["causes"]
    assert cause["name"] == "friction_asymmetry" and cause["component"] == "transmission"
    assert set(cause["parameters"]["ratio"]) == {"value", "std", "unit"}
    for number in answer["calibration"].values():
        assert set(number) == {"nominal", "value", "std", "tolerance", "unit"}
    for channel in answer["residual"].values():
        assert set(channel) == {"before", "after", "noise", "unit"}
    assert set(answer["undetermined"]) <= set(causes.names())
    extended = load_joint(out / "joint.yaml")
    assert [e.name for e in extended.effects] == ["friction_asymmetry"]
    assert "friction asymmetry" in (out / "report.html").read_text(encoding="utf-8")
    assert (out / "report.rrd").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere", "--out", "out"], "nowhere: expected a recording"),
        (["{folder}", "--joint", "gremlin", "--out", "out"], "joint 'gremlin': expected a path or one of"),
        (["{folder}", "--out", "{folder}"], "expected another folder than the measurement's"),
        (["{folder}", "--out", "full"], "expected an empty or new folder"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(flexspline, measured, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    before = sorted(p.name for p in measured[0].iterdir())
    code, _, error = flexspline("diagnose", *(str(a).replace("{folder}", str(measured[0])) for a in arguments))
    assert code == 2
    assert message in error and error.strip().count("\n") == 0
    assert "Traceback" not in error
    assert sorted(p.name for p in measured[0].iterdir()) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["full"]
    assert [p.name for p in (tmp_path / "full").iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--joint", "gremlin"], "joint 'gremlin'"),
        (["--two", "--none"], "expected at most one"),
        (["--sizes", "1,x"], "--sizes 1,x: expected numbers"),
        (["--cause", "gremlin"], "--cause: expected one of"),
        (["--scenario", "gremlin"], "scenario 'gremlin'"),
        (["--out", "table.xlsx"], "expected a file .json or .parquet"),
    ],
)
def test_bad_challenge_is_one_line(flexspline, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    code, _, error = flexspline("challenge", "--n", 1, "--jobs", 1, *arguments)
    assert code == 2
    assert message in error and error.strip().count("\n") == 0
    assert list(tmp_path.iterdir()) == []


def test_challenge_with_a_scenario_of_the_users(flexspline, tmp_path):
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(
        "name: mine\nmounting: link\nduration: 9\n"
        "trajectory: [{time: 0.5, position: 0}, {time: 3, position: 1.2}, {time: 7, position: -0.8}, {time: 8.5, position: 0}]\n"
    )
    out = tmp_path / "draws.json"
    code, text, error = flexspline(
        "challenge", "--n", 1, "--seed", 4, "--exact", "--jobs", 1, "--scenario", scenario, "--cause", "cable_spring",
        "--out", out,
    )  # fmt: skip
    assert code == 0, error
    (row,) = json.loads(out.read_text(encoding="utf-8"))
    assert row["first_right"], row
    assert 0 < row["smallest"] < 1
    for part in ("first cause right", "confusion", "Fisher allows", "confidence"):
        assert part in text
