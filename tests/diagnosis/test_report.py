"""What a diagnosis looks like: its page, its recording, and what `flexspline diagnose` writes."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from copy import copy
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

import flexspline as fs
from flexspline.diagnosis.answer import Finding
from flexspline.diagnosis.data.mistakes import Mistake
from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.data.stretches import most_telling
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.improvement import held_out, improvement, with_improvement
from flexspline.diagnosis.planning import Plan, Proposal, Question
from flexspline.diagnosis.search.explore import Decision
from flexspline.models import causes
from flexspline.models.controller import Controller
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Effect, Estimate
from flexspline.models.recording import Measurement, read_measurement, write_recording
from flexspline.views.glossary import meaning
from flexspline.views.pages.diagnosis import html
from flexspline.views.report import Report, confused_with, markdown, verdict_sentence
from flexspline.views.rerun import write_rerun_report
from flexspline.views.residuals import overlays

VOID = {"meta", "br"}


class Checker(HTMLParser):
    """Every tag closed in order; collects what the page refers to, and its text."""

    def __init__(self):
        super().__init__()
        self.open, self.links, self.text = [], [], []

    def handle_starttag(self, tag, attributes):
        self.links += [v for k, v in attributes if k in ("src", "href", "xlink:href", "data", "action")]
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
    """A joint with an asymmetric friction, 15 % more of it than described, measured and written to a folder: 20 s."""
    root = tmp_path_factory.mktemp("measurement")
    joint = load_joint("test-joint")
    friction = {n: joint.numbers[n].model_copy(update={"value": 1.15 * joint.numbers[n].value}) for n in ("Fc", "Fs")}
    joint = joint.model_copy(update={"numbers": {**joint.numbers, **friction}})
    effect = Effect(name="friction_asymmetry", parameters={"ratio": Estimate(value=0.25, unit="1")})
    joint.model_copy(update={"effects": [effect]}).write(root / "hidden.yaml")
    moves = ((0.5, 0.0), (4.0, 1.3), (5.0, 1.3), (11.0, -1.3), (12.0, -1.3), (18.0, 1.0))
    run = fs.simulate(
        "link_sweep", joint=str(root / "hidden.yaml"), filters=["RAREKF"], duration=20,
        trajectory=[{"time": t, "position": q} for t, q in moves],
    )  # fmt: skip
    folder = root / "bench <1>"
    folder.mkdir()
    write_recording(replace(run.as_recording(), name="sweep"), folder)
    return folder, read_measurement(folder)


@pytest.fixture(scope="module")
def report(measured) -> Report:
    joint = load_joint("test-joint")
    found = diagnose(measured[1], joint)
    gained = improvement(measured[1], found)
    plan = Plan(
        (Question(("backlash",), 1.0, 7.0), Question(("cogging", "kinematic_error"), 2.0, 4.5)),
        (Proposal("link_sweep", "slow", 40.0, (9.0, 3.0)),),
    )
    return Report(measured[1], joint, with_improvement(found, gained), gained, plan)


def read(page: str) -> tuple[Checker, str]:
    """A page that has been looked through, and its text in one line."""
    checker = Checker()
    checker.feed(page)
    checker.close()
    return checker, " ".join(" ".join(checker.text).split())


def test_report_is_one_sound_page_that_refers_to_nothing(report):
    page = html(report)
    checker, _ = read(page)
    assert checker.open == []
    assert checker.links == []
    assert "@import" not in page and "url(" not in page and "src=" not in page
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")
    assert len(page.encode()) < 3e6
    assert "bench &lt;1&gt;" in page and "bench <1>" not in page
    assert not {"nan", "inf", "none", "undefined"} & set(
        re.sub(r"<script.*?</script>|<[^>]*>", " ", page.split("<main>")[1], flags=re.DOTALL).lower().split()
    )
    assert "NaN" not in page and "nan" not in "".join(re.findall(r' d="([^"]*)"', page))


def test_page_is_readable_in_the_dark_on_a_phone_and_on_paper(report):
    page = html(report)
    assert '<meta name="viewport" content="width=device-width' in page
    assert "prefers-color-scheme:dark" in page and "@media print" in page and "@media (max-width" in page
    # Every colour of the charts is the style sheet's, which has it twice.
    assert not re.search(r'(fill|stroke|style)="[^"]*#', page)
    style = page.split("<style>")[1].split("</style>")[0]
    light, dark = (dict(re.findall(r"--(\w+):(#\w+)", part)) for part in style.split("@media screen")[:2])
    assert set(re.findall(r"var\(--(\w+)\)", style)) <= set(light)
    assert {name: dark.get(name) for name in light} and set(light) == set(dark)


LOOK = """<script>
const wide = [...document.querySelectorAll("main *")].filter(e => e.getBoundingClientRect().right > innerWidth + 1);
const size = `${innerWidth} ${document.documentElement.scrollWidth}`;
document.title = `${size} ${wide.length} ${wide.slice(0, 3).map(e => e.tagName + "." + e.getAttribute("class"))}`;
</script>"""


@pytest.mark.slow
@pytest.mark.parametrize("width", [500, 800, 1400])
def test_nothing_is_wider_than_the_window(report, width, tmp_path):
    """In a browser; 500 px is the narrowest window that a headless one makes, a frame is narrower."""
    browser = next((b for b in ("chromium", "chromium-browser", "google-chrome") if shutil.which(b)), None)
    if browser is None:
        pytest.skip("no Chromium here")
    page = html(report).replace("<details", "<details open")
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={width},1000", "--dump-dom"]

    def title(name: str, text: str) -> str:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        done = subprocess.run([*command, path.as_uri()], capture_output=True, text=True, timeout=60)
        assert "ERROR:CONSOLE" not in done.stderr
        return re.search(r"<title>(.*?)</title>", done.stdout).group(1)

    inner, whole, count, *which = title("page.html", page.replace("</body>", LOOK + "</body>")).split(" ", 3)
    assert int(whole) <= int(inner) and count == "0", which
    if width == 500:
        (tmp_path / "inner.html").write_text(page.replace("</body>", LOOK + "</body>"), encoding="utf-8")
        frame = '<title>?</title><iframe src="inner.html" style="width:360px;height:900px;border:0"></iframe>'
        look = "<script>onload = () => { document.title = frames[0].document.title }</script>"
        command.insert(1, "--allow-file-access-from-files")
        inner, whole, count, *which = title("frame.html", frame + look).split(" ", 3)
        assert int(inner) == 360 and int(whole) <= 360 and count == "0", which


def test_report_answers_what_a_colleague_asks(report):
    _, text = read(html(report))
    for part in (
        verdict_sentence(report.diagnosis), "Friction asymmetry".lower(), "confidence", "Motor and mesh", "Transmission:",
        "Link:", "link angle", "motor angle in one turn", "motor velocity", "load [N·m]", "direction of motion",
        "time since the start", "order per turn", "noise", "RAREKF", "tolerance", "What this measurement does not show",
        "What to measure next", "Measure next “link sweep”", "held-out", "explains most",
    ):  # fmt: skip
        assert part.lower() in text.lower(), part
    notes = markdown(report)
    assert verdict_sentence(report.diagnosis) in notes and "| estimate, RAREKF |" in notes


def test_page_begins_with_what_was_found_how_sure_and_what_to_do(report):
    _, text = read(html(replace(report, folder=Path("out dir"))))
    places = [text.index(part) for part in ("What was found", "How sure", "What to do now", "Measured and simulated")]
    assert places == sorted(places)
    head = text[: places[-1]]
    assert "joint.yaml" in head and "in place of the description" in head
    assert "flexspline run link_sweep --set joint='out dir'/joint.yaml" in head
    assert "flexspline estimate '" in head and "bench <1>' --joint 'out dir'/joint.yaml --out" in head
    assert "flexspline validate NEW_MEASUREMENT --joint 'out dir'/joint.yaml" in head
    assert "DIR" not in head
    assert "DIR is the folder" in read(html(report))[1]


def test_commands_to_copy_are_what_the_command_line_takes(report, typed):
    mistake = Mistake("unit", "motor_current", "sweep", "milliamperes, logged as amperes", 0.99, factor=1e-3)
    mended = replace(report, diagnosis=replace(report.diagnosis, mistakes=(mistake,)))
    assert report.diagnosis.problem is not None and not report.diagnosis.mistakes
    assert len(typed(html(report))) == 4 and len(typed(html(mended))) == 6


def test_the_command_states_gains_only_if_the_joint_has_none(report):
    joint = report.joint.model_copy(update={"name": "own"})
    stated = joint.model_copy(update={"controller": Controller(kp=5.0)})
    pages = [html(replace(report, joint=one)) for one in (joint, stated)]
    assert ["--set controller.kp=" in page for page in pages] == [True, False]


def test_page_says_one_by_one_what_holds_the_verdict_back(report):
    parts = ("time was up", "link balance: 0.2 N·m RMS is left; that is much", "one recording stands apart")
    found = replace(report.diagnosis, verdict="inconclusive", causes=(), reasons=parts, share=0.0, calibration={})
    page = html(replace(report, diagnosis=found, improvement=None))
    assert re.search(r"<h1>.*This measurement is inconclusive: time was up\.</h1>", page, re.S)
    for part in parts[1:]:
        assert f"<li>{part[0].upper()}{part[1:]}.</li>" in page and f"- {part}" in markdown(
            replace(report, diagnosis=found)
        )
    _, text = read(page)
    assert "Every number keeps its described value, except the link encoder's zero: no" in text
    assert "is the description with another link encoder zero. Nothing else was changed" in text
    sensors = report.joint.sensors  # one whose encoder was logged coarser than described has the same zero
    coarser = sensors.model_copy(update={"motor_encoder": sensors.motor_encoder.model_copy(update={"counts": 512})})
    same = replace(found, extended=report.joint.model_copy(update={"sensors": coarser}))
    _, plain = read(html(replace(report, diagnosis=same, improvement=None)))
    assert "Every number keeps its described value: no" in plain and "is the description. Nothing was changed" in plain
    assert "it was not computed in the time given" in text and "no torque sensor to compare with" not in text


def test_page_says_which_ends_follow_their_motion(report):
    assert "Both ends of the simulated joint follow their measured motion" in read(html(report))[1]
    problem = copy(report.diagnosis.problem)
    problem.segments = [replace(s, link_measured=False) for s in problem.segments]
    _, text = read(html(replace(report, diagnosis=replace(report.diagnosis, problem=problem))))
    assert "The end of the simulated joint that was measured follows its motion" in text and "Both ends" not in text


def test_page_ends_with_where_it_comes_from(report):
    _, text = read(html(report))
    end = text.split("Where this page comes from")[1]
    assert f"flexspline {metadata.version('flexspline')}" in end
    assert re.search(r"Written 20\d\d-\d\d-\d\d", end)
    assert "sweep 20000" in end and re.search(r"\b[0-9a-f]{12}\b", end)


def consistent(report: Report) -> Report:
    """The same measurement as if nothing had been found in it: calibration alone."""
    found = replace(report.diagnosis, verdict="consistent", causes=())
    gained = replace(report.improvement, known_before="the description as it came")
    return replace(report, diagnosis=found, improvement=gained)


def test_consistent_says_what_calibration_moved_and_what_that_gains(report):
    _, text = read(html(consistent(report)))
    head = text.split("Measured and simulated")[0]
    moved = report.diagnosis.calibration
    assert f"Calibration moved {len(moved)} number" in head
    before, after = report.improvement.errors["RAREKF"]
    assert f"goes from {before:.3f} to {after:.3f} N·m" in head and "before, it knew the description as it came" in head
    blind = replace(consistent(report), improvement=None)
    assert "is unknown: it was not computed" in read(html(blind))[1].split("Measured and simulated")[0]


def test_inconclusive_says_what_to_measure_first(report):
    names = tuple(causes.of(report.joint))
    found = replace(
        report.diagnosis,
        verdict="inconclusive",
        causes=(),
        undetermined=dict.fromkeys(names, "it drowns"),
        confusable=(names[:2],),
    )
    head, rest = read(html(replace(report, diagnosis=found)))[1].split("Measured and simulated", 1)
    assert "First measure “link sweep” : " in head and report.plan.sentences()[0] in head
    assert f"Of {len(names)} known causes 0 would have shown at ordinary size; {len(names)} could not" in head
    assert "1 pair of causes are confounded" in head
    assert all(name.replace("_", " ") in rest for name in names)


def test_unknown_effect_is_shown_with_what_it_depends_on(report):
    effect = Finding(
        "unknown", "link", 0.6, {}, 0.4, 0.1, "a torque on the link that depends on θl", ("link_position",)
    )
    found = replace(report.diagnosis, causes=(effect,))
    page = html(replace(report, diagnosis=found))
    assert "no known cause explains a torque" in read(page)[1].lower()
    assert 'depends on <abbr title="link angle">θl</abbr>' in page
    assert "An effect on the link alone does not change a torque estimate" in page


def test_every_symbol_of_the_calibration_tells_its_meaning(report):
    page = unescape(html(report))
    for name in report.diagnosis.calibration:
        assert f'<abbr title="{meaning(name)}">{name.replace("_", " ")}</abbr>' in page, name
        assert f"<td>{meaning(name)}</td>" in page


def test_every_hypothesis_stands_with_its_reason(report):
    text = read(html(report))[1]
    assert "Why each hypothesis was taken or not" in text
    d = report.diagnosis
    assert {x.cause for x in d.decisions} >= {"friction_asymmetry"}
    for name in {x.cause for x in d.decisions}:
        assert name.replace("_", " ") in text.split("Why each hypothesis")[1], name
    order = {"order": 2.0}
    odd = Decision("add", "cogging", order, float("nan"), 0.1, False, "below -3.5")
    some = replace(d, decisions=(*d.decisions, replace(odd, gain=-2.0), odd))
    rows = read(html(replace(report, diagnosis=some)))[1].split("Why each hypothesis")[1]
    assert "cogging (order 2) and 1 weaker one" in rows and "below −3.5" in rows


def test_regions_stand_worst_first_with_a_warning(report):
    d = report.diagnosis
    assert d.regions
    worst = replace(d.regions[0], name="the moon", unseen=9.0, described=1.0, ratio=9.0)
    text = read(html(replace(report, diagnosis=replace(d, regions=(worst, *d.regions)))))[1]
    assert "the worst is the moon" in text and "not to be trusted there" in text
    assert text.index("the moon 1 N·m 9 N·m") < text.index(f"{d.regions[0].name} ", text.index("the moon 1 N·m"))
    assert "Range of validity" in text and "link angle from" in text


def test_minor_effects_are_told_apart_from_causes(report):
    small = replace(report.diagnosis.causes[0], name="hysteresis", parameters={})
    text = read(html(replace(report, diagnosis=replace(report.diagnosis, minor=(small,)))))[1]
    assert "Minor effects, which are part of the extended joint: hysteresis." in text and "Minor effects" in text


def test_mistakes_in_the_data_come_first_and_say_what_mends_them(report):
    wrong = Mistake("unit", "motor_current", "sweep", "it is in milliampere", 0.98, factor=1e-3)
    text = read(html(replace(report, diagnosis=replace(report.diagnosis, mistakes=(wrong,)))))[1]
    head = text.split("What was found")[0]
    assert "Mistakes in the data" in head and "× 0.001" in head
    assert "flexspline check '" in head and "--fix --out MENDED" in head
    kelvin = Mistake("unit", "temperature", "sweep", "it is in kelvin", 0.99, factor=1.0, offset=-273.15)
    text = read(html(replace(report, diagnosis=replace(report.diagnosis, mistakes=(kelvin,)))))[1]
    assert "-273.15 K" in text.replace("−", "-") and "× 1 " not in text


def test_what_makes_physics_meaningless_is_a_mistake_and_no_effect(measured):
    scaled = tuple(
        replace(r, columns={**r.columns, "motor_current": 1e3 * r["motor_current"]}) for r in measured[1].recordings
    )
    found = diagnose(replace(measured[1], recordings=scaled), load_joint("test-joint"))
    assert found.verdict == "inconclusive" and found.minor == () and found.problem is None
    assert [(m.name, m.column) for m in found.mistakes] == [("unit", "motor_current")]
    assert found.to_json()["mistakes"][0]["factor"] == pytest.approx(1e-3)


def test_a_measurement_that_made_no_sense_has_a_page_too(report, tmp_path):
    d = report.diagnosis
    wrong = Mistake("swapped", "", "", "the encoders are swapped", 0.99)
    nothing = replace(
        d, verdict="inconclusive", reasons=("mistakes in the data",), causes=(), minor=(), calibration={}, confusable=(),
        residual={}, regions=(), extended=report.joint, mistakes=(wrong,), decisions=(), problem=None, search=None,
        final=None, before=[], after=[], estimation=None,
    )  # fmt: skip
    blank = Report(report.measurement, report.joint, nothing)
    checker, text = read(html(blank))
    assert checker.open == [] and "Nothing was computed" in text and "the encoders are swapped" in text.lower()
    assert "Correct the data first" in text and "none is ruled out" in text and "No candidate experiment" not in text
    lost = replace(wrong, name="sign", description="its magnitude without its sign", lost=True)
    _, text = read(html(replace(blank, diagnosis=replace(nothing, mistakes=(lost,)))))
    assert "Measure again" in text and "the file cannot be corrected" in text and "Correct the data first" not in text
    assert write_rerun_report(blank, tmp_path / "report.rrd").stat().st_size > 100


def without_sensor(report: Report) -> Report:
    """The same diagnosis as if there had been no torque sensor."""
    d = report.diagnosis
    bare = [
        replace(
            s, torque=np.empty(0), measured=s.measured * [1.0, 0.0], usable=s.usable & [True, False, True],
            held_out=s.held_out & [True, False, True],
        )
        for s in d.problem.segments
    ]  # fmt: skip
    residual = {name: channel for name, channel in d.residual.items() if name != "joint_torque"}
    problem = type(d.problem)(bare, d.problem.replicates, d.problem.joint)
    recordings = tuple(
        replace(r, columns={k: v for k, v in r.columns.items() if k != "joint_torque"})
        for r in report.measurement.recordings
    )
    measurement = replace(report.measurement, recordings=recordings)
    found = replace(d, problem=problem, residual=residual, estimation=None)
    return replace(report, measurement=measurement, diagnosis=found, improvement=None)


def test_no_caption_speaks_of_a_sensor_that_was_not_there(report):
    _, text = read(html(without_sensor(report)))
    body = text.split("What to measure next")[0].lower()
    assert "without joint torque sensor" in body and "there is no joint torque sensor" in body
    for phrase in (
        "as the sensor reads",
        "the torque that the sensor reports",
        "against the torque sensor",
        "sensor's own noise",
        "and torque are smoothed",
    ):
        assert phrase not in text.lower(), phrase


def test_measured_curves_end_where_the_measurement_does(report):
    segments = report.diagnosis.problem.segments
    for o in (o for row in overlays(report) for o in row):
        assert o.time[-1] == segments[-1].at[-1]
        if o.channel == "motor_current":
            assert o.measured[-1] == segments[-1].measured[-1, 0]
        assert np.isfinite(o.measured).sum() == sum(len(s.at) for s in segments)


def test_curves_of_a_long_measurement_are_of_the_recordings_that_are_named(report):
    """Of eleven recordings a diagnosis uses five; their places differ."""
    (one,) = report.measurement.recordings
    same = tuple(replace(one, name=f"same{i}") for i in range(10))
    more = {"joint_torque": one["joint_torque"] + 3.0, "motor_current": one["motor_current"] + 3.0}
    loaded = replace(one, name="loaded", columns={**one.columns, **more})
    long = replace(report.measurement, recordings=(*same, loaded))
    used = most_telling(long)
    problem = Problem(*segments(list(used.recordings), report.joint), report.joint)
    zeros = [np.zeros((len(segment.at), 3)) for segment in problem.segments]
    found = replace(report.diagnosis, problem=problem, before=zeros, after=zeros, used=used)
    (row,) = [row for row in overlays(Report(long, report.joint, found)) if row[0].channel == "joint_torque"]
    assert len(row) < 11 and "loaded" in {o.name for o in row}
    named = {r.name: r for r in long.recordings}
    for o in row:
        there, r = np.isfinite(o.measured), named[o.name]
        expected = np.interp(o.time, r.time - r.time[0], r["joint_torque"])
        assert np.median(np.abs(o.measured - expected)[there]) < 0.1, o.name


def test_views_show_the_noise_that_the_diagnosis_states(report):
    for o in (o for row in overlays(report) for o in row):
        assert o.noise == report.diagnosis.residual[o.channel].noise
        kept = sum(b - a for a, b in o.held_out)
        assert 0.1 < kept / (o.time[-1] - o.time[0]) < 0.2


def test_improvement_is_measured_on_what_no_fit_saw(report):
    recording = report.measurement.recordings[0]
    assert 0.1 < held_out(recording, 0).mean() < 0.2
    answer = report.diagnosis.to_json()["estimation"]
    assert answer["filter"] == "RAREKF" and answer["unit"] == "N·m" and answer["of"] == "joint_torque"
    assert 0 < answer["after"] < 1.05 * answer["before"]
    assert improvement(without_sensor(report).measurement, report.diagnosis) is None


def test_rerun_shows_the_joint_in_motion_beside_its_channels(report, tmp_path):
    path = write_rerun_report(report, tmp_path / "report.rrd")
    paths = set(RrdReader(path).store().schema().entity_paths())
    place = "/recordings/sweep"
    assert {f"{place}/scene/link", f"{place}/scene/torque_measured", f"{place}/scene/torque_extended"} <= paths
    for channel in report.diagnosis.residual:
        assert {f"{place}/{channel}/{x}" for x in ("values/measured", "values/extended", "residual/simulated")} <= paths
    assert "/notes" in paths
    assert path.stat().st_size < 20e6


def test_diagnose_writes_the_answer_as_specified(flexspline, measured, report, tmp_path, monkeypatch):
    # The same measurement was diagnosed for the report already.
    monkeypatch.setattr("flexspline.diagnosis.diagnose.diagnose", lambda *given, **more: report.diagnosis)
    out = tmp_path / "out"
    code, text, error = flexspline("diagnose", measured[0], "--joint", "test-joint", "--out", out)
    assert code == 0, error
    assert "friction asymmetry" in text
    answer = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert set(answer) >= {
        "verdict", "causes", "calibration", "confusable", "undetermined", "residual", "regions", "estimation", "held_out",
        "mistakes", "decisions",
    }  # fmt: skip
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
        (["{folder}", "--out", "{folder}"], "expected a folder that is not in the measurement's"),
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


def test_what_looks_alike_is_said_by_cause():
    """One that looks like many is named once, each pair once."""
    pairs = [("a", "p"), ("b", "p"), ("c", "d"), ("p", "e"), ("a", "b")]
    assert confused_with(pairs) == [("p", ["a", "b", "e"]), ("c", ["d"]), ("a", ["b"])]
    assert confused_with(()) == []
