"""Own estimators, causes and sensors: the files of docs/plugins.md, given and installed; what is wrong is one line."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import flexspline as fs
from flexspline.estimator import registry
from flexspline.models import laws, plugins
from flexspline.models.joint_parts import Effect
from flexspline.models.parameters import PLACES
from flexspline.models.recording import write_recording

ROOT = Path(__file__).resolve().parents[2]
FILTER, CAUSE = (ROOT / "examples" / f"own_{what}.py" for what in ("filter", "cause"))
PAGE = (ROOT / "docs" / "plugins.md").read_text(encoding="utf-8")
STUDY = {
    "name": "mine", "seeds": {"count": 2}, "scenarios": ["link_sweep"], "set": {"duration": 1.5, "transient": 0.5},
    "axes": [
        {"kind": "cause", "causes": ["soft_bearing"], "sizes": [1]},
        {"kind": "set", "name": "window", "key": "filters.moving_average.window", "values": [0.004, 0.1]},
    ],
    "filters": ["moving_average", "lowpass"], "metrics": ["rms", "noise"],
}  # fmt: skip


@pytest.fixture
def files(tmp_path) -> tuple[Path, Path, Path]:
    """The three files of the page."""
    made = tmp_path / "own"
    made.mkdir()
    programs = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names = ("my_filter.py", "my_cause.py", "my_sensor.py")
    for name, text in zip(names, programs, strict=True):
        (made / name).write_text(text, encoding="utf-8")
    return made / names[0], made / names[1], made / names[2]


def install(files: tuple[Path, Path, Path], site: Path) -> None:
    """The page's package as an installer leaves it in a folder."""
    site.mkdir()
    for file in files:
        (site / file.name).write_text(file.read_text(encoding="utf-8"), encoding="utf-8")
    info = site / "my_joint-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-joint\nVersion: 1.0\n", encoding="utf-8")
    (project,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    points = re.findall(r'\[project\.entry-points\."([\w.]+)"\]\n((?:\w+ = .*\n)+)', project)
    assert len(points) == 3
    text = "".join(f"[{group}]\n{lines}\n" for group, lines in points).replace('"', "")
    (info / "entry_points.txt").write_text(text, encoding="utf-8")


@pytest.fixture
def installed(files, tmp_path, monkeypatch) -> Path:
    """The page's package in a folder where this process finds packages."""
    site = tmp_path / "site"
    install(files, site)
    monkeypatch.syspath_prepend(site)
    forget()
    yield site
    monkeypatch.undo()
    forget()
    for name in ("my_filter", "my_cause", "my_sensor"):
        sys.modules.pop(name, None)


def forget() -> None:
    plugins._installed.cache_clear()
    plugins._offers.cache_clear()


def one_line(found: tuple[int, str, str]) -> str:
    code, _, err = found
    lines = err.splitlines()
    assert code == 2 and len(lines) == 1, err
    return lines[0]


def test_an_installed_package_is_simply_there(flexspline, installed, tmp_path):
    """Lists say where it comes from; a study hides the cause, a check says whether it could show."""
    own = {"estimators": {"moving_average", "strain_corrected"}, "causes": {"soft_bearing"}, "sensors": {"strain"}}
    for what, names in own.items():
        code, text, error = flexspline(what, "--json")
        assert code == 0, error
        listed = json.loads(text)
        assert {name for name, entry in listed.items() if entry["source"] == "my-joint 1.0"} == names
        assert {entry["source"] for other, entry in listed.items() if other not in names} == {"flexspline"}
        assert "(my-joint 1.0)" in flexspline(what)[1]
    assert (
        fs.estimators().loc["moving_average", "source"] == fs.causes().loc["soft_bearing", "source"] == "my-joint 1.0"
    )

    study = tmp_path / "mine.yaml"
    study.write_text(yaml.safe_dump(STUDY | {"axes": STUDY["axes"][:1], "filters": ["lowpass"]}), encoding="utf-8")
    code, text, error = flexspline("sweep", study, "--out", tmp_path / "sweep", "--no-figures")
    assert code == 0, error
    assert set(pd.read_csv(tmp_path / "sweep" / "summary.csv")["cause"]) == {"soft_bearing"}

    run = fs.simulate("link_sweep", duration=1.5, transient=0.5, filters=["lowpass"])
    code, text, error = flexspline("check", write_recording(run.as_recording(), tmp_path), "--json")
    assert code == 0, error
    report = json.loads(text)
    assert "soft_bearing" in [*report["can_show"], *report["undetermined"]]


def test_an_installed_sensor_is_read(flexspline, installed, tmp_path):
    """By a run, whose recording has it with its unit, by its own estimator there and over the recording, and in a sweep."""
    out = tmp_path / "runs"
    words = ["--set", "duration=2", "--set", "transient=0.5", "--set", "filters=[strain_corrected]"]
    code, _, error = flexspline("run", "link_sweep", *words, "--no-figures", "--no-recording", "--out", out)
    assert code == 0, error
    recording = fs.load_recording(out / "link_sweep" / "link_sweep.yaml")
    run = fs.simulate("link_sweep", duration=2, transient=0.5, filters=["strain_corrected"])
    np.testing.assert_array_equal(recording["strain"], run.simulation.further["strain"])
    found = fs.estimate(recording, estimators="strain_corrected")
    assert np.isfinite(found["strain_corrected"]).all() and len(found) == len(run.time)

    study = tmp_path / "mine.yaml"
    study.write_text(yaml.safe_dump(STUDY | {"axes": [], "filters": ["strain_corrected"]}), encoding="utf-8")
    code, _, error = flexspline("sweep", study, "--out", tmp_path / "sweep", "--no-figures")
    assert code == 0, error
    assert set(pd.read_csv(tmp_path / "sweep" / "summary.csv")["filter"]) == {"strain_corrected"}


@pytest.mark.slow
def test_a_compiled_filter_runs_in_the_loop_and_is_swept(flexspline, installed, tmp_path):
    out = tmp_path / "runs"
    words = ["--set", "duration=1.5", "--set", "filters=[moving_average]", "--set", "feedback=moving_average"]
    code, _, error = flexspline("run", "link_sweep", *words, "--no-figures", "--no-recording", "--out", out)
    assert code == 0, error
    assert "moving_average" in json.loads((out / "link_sweep" / "metrics.json").read_text())["filters"]

    study = tmp_path / "mine.yaml"
    study.write_text(yaml.safe_dump(STUDY), encoding="utf-8")
    code, _, error = flexspline("sweep", study, "--out", tmp_path / "sweep", "--no-figures")
    assert code == 0, error
    rows = pd.read_csv(tmp_path / "sweep" / "summary.csv")
    assert set(rows["cause"]) == {"soft_bearing"} and set(rows["filter"]) == {"moving_average", "lowpass"}
    assert set(rows.loc[rows["filter"] == "moving_average", "window"]) == {0.004, 0.1}

    run = fs.simulate("link_sweep", duration=1.5, transient=0.5, seed=2, filters=["moving_average"])
    # It gets the sensor's reading of the current; `model` gets the command.
    model = registry.get("model").estimate(run.signals.without("current_command"), run.known).mean
    expected = [np.mean(model[max(0, k - 9) : k + 1]) for k in range(len(model))]
    np.testing.assert_allclose(run.estimate("moving_average"), expected, rtol=0, atol=1e-9)


def test_files_are_known_while_a_command_runs(flexspline, files, tmp_path):
    words = ["compare", "link_sweep", "--set", "duration=1.5", "--set", "filters=[complementary]"]
    words += ["--no-figures", "--no-recording", "--out", tmp_path / "runs"]
    code, text, error = flexspline(*words, "--plugin", FILTER)
    assert code == 0, error
    assert "complementary" in text
    listed = json.loads(flexspline("causes", "--json", "--plugin", files[1], "--plugin", CAUSE)[1])
    assert listed["soft_bearing"]["source"] == str(files[1]) and listed["pinched_hose"]["source"] == str(CAUSE)
    assert "soft_bearing" not in json.loads(flexspline("causes", "--json")[1])
    assert "expected one of" in one_line(flexspline(*words)) and plugins.files() == ()


def test_files_are_known_to_a_program(tmp_path):
    try:
        assert fs.load_plugin(FILTER) == fs.load_plugin(str(FILTER)) == ("complementary",)
        assert fs.load_plugin(CAUSE) == ("pinched_hose",)
        table = fs.compare("link_sweep", ["complementary"], duration=1.5, transient=0.5)
        assert table.loc[("link_sweep", "complementary"), "rms"] > 0
        worn = hidden("pinched_hose", {"torque": 1.6, "angle": 0.4, "width": 0.25})
        worn.write(tmp_path / "worn.yaml")
        p = fs.load_joint(tmp_path / "worn.yaml").record()[0]
        found = [dynamics_torque(angle, p) for angle in (0.4, 0.65, 0.15, 2.0)]
        np.testing.assert_allclose(found, [-1.6, -1.6 / np.e, -1.6 / np.e, 0.0], atol=2e-3)
    finally:
        plugins.forget(FILTER)
        plugins.forget(CAUSE)
    with pytest.raises(fs.InputError, match=r"a plugin's with --plugin\), got 'pinched_hose'"):
        fs.load_joint(tmp_path / "worn.yaml")


def dynamics_torque(angle: float, p: np.void) -> float:
    return laws.discrepancy(PLACES.index("link"), 0.0, angle, 0.0, 0.0, 0.0, p)


def hidden(name: str, values: dict[str, float]) -> fs.Joint:
    """The test joint with an effect."""
    effect = Effect.model_validate({"name": name, "parameters": {key: {"value": x} for key, x in values.items()}})
    return fs.load_joint("test-joint").model_copy(update={"effects": [effect]})


@pytest.mark.slow
def test_figures_are_drawn_in_processes_that_know_it(flexspline, tmp_path):
    words = ["--set", "duration=1.5", "--set", "filters=[complementary]", "--plugin", FILTER]
    code, _, error = flexspline("run", "link_sweep", *words, "--out", tmp_path / "runs")
    assert code == 0, error
    assert (tmp_path / "runs" / "link_sweep" / "run.rrd").is_file()


@pytest.mark.slow
@pytest.mark.long
def test_trials_hide_an_own_cause(flexspline, files, tmp_path):
    words = ["--draws", 1, "--cause", "soft_bearing", "--jobs", 2, "--exact", "--plugin", files[1]]
    code, text, error = flexspline("challenge", *words, "--out", tmp_path / "draws.json")
    assert code == 0, error
    assert "soft_bearing" in text


def test_export_takes_a_plugin_as_all_that_read_measurements_do(flexspline, tmp_path):
    pytest.importorskip("mcap_ros2")
    recording = fs.simulate("no_load", filters=["model"], duration=2).as_recording()
    path = write_recording(recording, tmp_path / "m")
    code, out, err = flexspline("export", path, "--out", tmp_path / "e", "--plugin", FILTER)
    assert code == 0 and f"{recording.name}.mcap" in out, err
    assert plugins.files() == ()


def test_a_dataset_knows_the_plugins_it_was_made_with(flexspline, tmp_path):
    own = tmp_path / "own.py"
    own.write_text(FILTER.read_text(encoding="utf-8"), encoding="utf-8")
    study = tmp_path / "mine.yaml"
    study.write_text(yaml.safe_dump(STUDY | {"axes": [], "filters": ["complementary"]}), encoding="utf-8")
    words = ["sweep", study, "--out", tmp_path / "sweep", "--no-figures", "--plugin", own]
    assert flexspline(*words)[0] == flexspline(*words)[0] == 0
    own.write_text(own.read_text(encoding="utf-8") + "# another\n", encoding="utf-8")
    assert "sweep" in one_line(flexspline(*words))


BROKEN = {
    "nothing = 1": "plugin {file}: expected a tuple ESTIMATORS, CAUSES or SENSORS, found none",
    "ESTIMATORS = 3": "plugin {file}: ESTIMATORS: expected a tuple, got int",
    "import nowhere_at_all": "plugin {file}, line 1: ModuleNotFoundError: No module named 'nowhere_at_all'",
    "a = 1\nb = (": "plugin {file}, line 2: SyntaxError",
    "a = 1\n1 / 0": "plugin {file}, line 2: ZeroDivisionError: division by zero",
    "a = 1\nraise SystemExit(0)": "plugin {file}, line 2: SystemExit: 0",
    "import sys\nsys.exit('bye')": "plugin {file}, line 2: SystemExit: bye",
    "ESTIMATORS = (3,)": "estimator '3' of {file}: expected a subclass of flexspline.estimator.estimator.Estimator, got int",
    "CAUSES = (3,)": "cause '3' of {file}: expected a subclass of flexspline.models.causes.base.Cause, got int",
}


@pytest.mark.parametrize("text", BROKEN)
def test_a_broken_file_is_one_line(flexspline, tmp_path, text):
    file = tmp_path / "broken.py"
    file.write_text(text + "\n", encoding="utf-8")
    line = one_line(flexspline("estimators", "--plugin", file))
    assert BROKEN[text].format(file=file) in line
    with pytest.raises(fs.InputError) as caught:
        fs.load_plugin(file)
    assert BROKEN[text].format(file=file) in str(caught.value) and plugins.files() == ()


def test_what_is_no_plugin_is_one_line(flexspline, files, tmp_path):
    assert "expected a Python file, found none" in one_line(flexspline("causes", "--plugin", tmp_path / "none.py"))
    (tmp_path / "table.csv").write_text("a\n")
    assert "expected a Python file (.py), got '.csv'" in one_line(
        flexspline("causes", "--plugin", tmp_path / "table.csv")
    )
    taken = tmp_path / "taken.py"
    taken.write_text(files[0].read_text(encoding="utf-8").replace('"moving_average"', '"RAREKF"'), encoding="utf-8")
    line = one_line(flexspline("estimators", "--plugin", taken))
    assert f"{taken}: estimator 'RAREKF': expected another name, flexspline has one of that name" in line
    twice = tmp_path / "twice.py"
    twice.write_text(files[0].read_text(encoding="utf-8"), encoding="utf-8")
    assert "expected another name" in one_line(flexspline("estimators", "--plugin", files[0], "--plugin", twice))


FAILING = """
from dataclasses import dataclass
import numpy as np
from flexspline import Estimator, Posterior
@dataclass(frozen=True)
class Failing(Estimator):
    name: str = "failing"
    description = "fails"
    def estimate(self, signals, joint):
        {body}
ESTIMATORS = (Failing,)
"""


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return signals.nothing", "line 10: AttributeError: 'Signals' object has no attribute 'nothing'"),
        ("return Posterior(self.name, signals.time, np.zeros(3))", "mean: expected shape (1500,), got (3,)"),
        ("raise ValueError('two\\n  lines')", "line 10: ValueError: two lines"),
    ],
)
def test_what_fails_while_it_runs_is_one_line(flexspline, tmp_path, body, message):
    file = tmp_path / "failing.py"
    file.write_text(FAILING.format(body=body), encoding="utf-8")
    words = [
        "--set",
        "duration=1.5",
        "--set",
        "filters=[failing]",
        "--no-figures",
        "--no-recording",
        "--out",
        tmp_path / "r",
    ]
    assert message in one_line(flexspline("run", "link_sweep", *words, "--plugin", file))


def test_a_step_that_cannot_be_compiled_is_one_line(flexspline, files, tmp_path):
    text = files[0].read_text(encoding="utf-8").replace("int(m.count) % n", "int(m.cuont) % n")
    files[0].write_text(text, encoding="utf-8")
    words = ["--set", "duration=1.5", "--set", "filters=[moving_average]", "--no-figures", "--no-recording"]
    line = one_line(flexspline("run", "link_sweep", *words, "--out", tmp_path / "r", "--plugin", files[0]))
    assert f"{files[0]}, line 13: _step: expected a step that can be compiled" in line and "cuont" in line


@pytest.mark.slow
@pytest.mark.long
def test_in_a_new_process_it_is_simply_there(files, tmp_path):
    """Installed into another folder: it runs, sweeps, and is named by a diagnosis."""
    target = tmp_path / "target"
    install(files, target)
    environment = os.environ | {"PYTHONPATH": f"{target}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}

    def flexspline(*words: object) -> str:
        command = [sys.executable, "-m", "flexspline", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert json.loads(flexspline("estimators", "--json"))["moving_average"]["source"] == "my-joint 1.0"
    flexspline("run", "link_sweep", "--set", "duration=2", "--set", "filters=[moving_average]", "--out", "runs")
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(STUDY), encoding="utf-8")
    flexspline("sweep", "mine.yaml", "--out", "sweep", "--no-figures")
    program = """
import dataclasses, flexspline as fs
from flexspline.models.joint_parts import Effect
from flexspline.models.recording import write_recording
joint = fs.load_joint("test-joint")
effect = Effect.model_validate({"name": "soft_bearing", "parameters": {"scale": {"value": 0.4}}})
joint.model_copy(update={"effects": [effect]}).write(__import__("pathlib").Path("worn.yaml"))
moves = [{"time": t, "position": x} for t, x in ((0.5, 0), (3, 1.2), (8, -1.2), (11, 0))]
gains = {"kp": 8.0, "kd": 0.08, "ki": 20.0}
path = str(__import__("pathlib").Path("worn.yaml").resolve())
run = fs.simulate("link_sweep", joint=path, duration=12, controller=gains, trajectory=moves)
write_recording(dataclasses.replace(run.as_recording(), name="log", joint="test-joint"), "log")
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path, env=environment)
    text = flexspline("diagnose", "log", "--out", "diagnosis", "--no-report")
    assert "soft bearing (transmission)" in text
    answer = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text())
    (found,) = answer["causes"]
    assert found["name"] == "soft_bearing" and found["parameters"]["scale"]["value"] == pytest.approx(0.4, rel=0.05)
