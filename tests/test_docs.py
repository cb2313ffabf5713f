"""README and docs are right: named files, commands and options exist; snippets are parsed and run."""

from __future__ import annotations

import ast
import inspect
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
import yaml

from flexspline import commands
from flexspline.diagnosis.data.importing import Layout
from flexspline.models.files import parse
from flexspline.scenarios.arms.arm_scenario import ArmScenario
from flexspline.scenarios.scenario import Scenario, load_scenario
from flexspline.scenarios.studies.study import Study

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
ROOMS = (
    "commands",
    "diagnosis",
    "estimator",
    "models",
    "scenarios",
    "sim",
    "views",
    "benchmarks",
    "docs",
    "flexspline",
)
MADE = {
    "joint.yaml", "diagnosis/joint.yaml", "known_joint.yaml", "tuned.yaml", "summary.md", "summary.csv",
    "diagnosis.json", "DIR/NAME.yaml", "study.yaml", "cause.py", "models/causes/NAME.py", "my_filter.py",
    "my_cause.py", "arm.yaml", "my_sensor.py", "bench.yaml", "my_motion.yaml", "my_joint.yaml", "worn.yaml", "my_push.yaml",
    "my_study.yaml", "my_arm.yaml", "my_robot.yaml", "my_log.yaml", "my_log.csv", "friction.csv",
}  # fmt: skip
"""Files that commands or people make, and patterns."""
BUILT = re.compile(r"(?:reference/\w+|examples)\.md")
"""Pages that `docs/site_pages.py` makes for the site."""
OWN = re.compile(r"(?:^    (?:\S*/)?|`)flexspline ([a-z]+)(?: ([^`#\n]*))?", re.MULTILINE)


def ids(pages):
    return [page.name for page in pages]


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_named_files_exist(page):
    text = page.read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w./-]+\.(?:py|yaml|xml|md|csv))`", text)) - MADE
    anywhere = {path.name for room in ROOMS for path in (ROOT / room).rglob("*")}
    within = [ROOT, ROOT / "diagnosis", ROOT / "estimator"]
    missing = [
        name
        for name in named
        if not (any((top / name).exists() for top in within) if "/" in name else name in anywhere)
    ]
    missing += [
        link
        for link in re.findall(r"\]\((?!http)([^)#]+)", text)
        if not (page.parent / link).resolve().exists() and not BUILT.fullmatch(link)
    ]
    assert not missing


def test_every_module_has_a_purpose():
    """The page of modules shows the first paragraph of each docstring."""
    rooms = ("commands", "diagnosis", "estimator", "models", "scenarios", "sim", "views")
    modules = [path for room in rooms for path in (ROOT / room).rglob("*.py") if path.name != "__init__.py"]
    assert not [path for path in modules if not ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))]


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_commands_and_options_exist(page):
    wrong = []
    for name, rest in OWN.findall(page.read_text(encoding="utf-8").replace("\\\n", " ")):
        folder = name if (ROOT / "commands" / name).is_dir() else ""
        if folder:
            name, _, rest = rest.partition(" ")
        if folder and not name:
            continue  # the group
        if name not in commands._files(folder):
            wrong.append(f"{folder} {name}")
            continue
        known = options(name, folder)
        wrong += [f"{name} {word}" for word in re.findall(r"(?<![\w-])--[a-z-]+", rest) if word not in known]
    assert not wrong


def options(name: str, folder: str = "") -> set[str]:
    """Return the options of a command."""
    function, _ = commands.find(name, folder)
    found = {"--help"}
    for parameter, hint in get_type_hints(function, include_extras=True).items():
        for info in get_args(hint)[1:]:
            declared = [
                d
                for word in (getattr(info, "default", ""), *(getattr(info, "param_decls", None) or ()))
                for d in str(word).split("/")
                if d.startswith("--")
            ]
            if type(info).__name__ == "OptionInfo":
                plain = "--" + parameter.replace("_", "-")
                found |= set(declared) or {plain, plain.replace("--", "--no-", 1)}
    return found


def snippets(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def test_scenario_and_study_are_read():
    *scenarios, study = (yaml.safe_load(text) for text in snippets(ROOT / "docs" / "scenarios.md", "yaml"))
    assert len(scenarios) == 4
    for scenario in scenarios:
        parse(scenario, Scenario, "the scenario")
    parse(study, Study, "the study")


def test_the_arms_are_read():
    arms = [parse(yaml.safe_load(text), ArmScenario, "the arm") for text in snippets(ROOT / "docs" / "arms.md", "yaml")]
    assert [arm.name for arm in arms] == ["my_arm", "my_robot"]
    assert all([joint.name for joint in arm.arm] == ["shoulder", "elbow"] for arm in arms)


def test_mappings_are_read():
    texts = snippets(ROOT / "docs" / "importing.md", "yaml")
    assert [parse(yaml.safe_load(text), Layout, "the mapping").name for text in texts] == ["my-robot", "my-bag"]


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_programs_are_python(page):
    for text in snippets(page, "python"):
        compile(text, page.name, "exec")


def test_every_key_of_a_diagnosis_is_documented():
    """Keys of the answer, and of a cause, a region and a decision in it."""
    answer = json.loads((ROOT / "tests/frozen/diagnosis/diagnosis.json").read_text(encoding="utf-8"))
    parts = [answer, answer["causes"][0], answer["regions"][0], answer["estimation"], answer["decisions"][0]]
    parts += [next(iter(answer[table].values())) for table in ("calibration", "residual")]
    documented = set(
        re.findall(r"`(\w+)`", (ROOT / "docs/diagnosis.md").read_text(encoding="utf-8").split("## What `diag")[1])
    )
    assert not {key for part in parts for key in part} - documented


def test_every_cause_is_documented():
    from flexspline.models import causes

    table = (ROOT / "docs/diagnosis.md").read_text(encoding="utf-8").split("## The causes")[1]
    assert not {name for name in causes.names() if f"`{name}`" not in table}


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 110


def demo() -> list[list[str]]:
    """Return the commands of `make demo`."""
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").split("\ndemo: ")[1].split("\n\n")[0]
    return [shlex.split(line)[1:] for line in recipe.splitlines()[1:]]


@pytest.mark.slow
def test_the_readme_runs_in_a_fresh_clone(flexspline, tmp_path, monkeypatch):
    """The demo, the README's commands one after the other, and its program, with nothing but the clone."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FLEXSPLINE_SHARED", str(tmp_path / "nothing"))
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    typed = [shlex.split(line, comments=True)[1:] for line in text.splitlines() if line.startswith("    flexspline ")]
    assert len(demo()) == 2 and len(typed) == 5
    for words in demo() + typed:
        if words[0] == "view":
            looked_at(words[1:])
            continue
        code, _, error = flexspline(*words)
        assert code == 0, (words, error)
    (hidden,) = json.loads(Path("runs/hidden/hidden.json").read_text(encoding="utf-8"))
    found = json.loads(Path("diagnosis/diagnosis.json").read_text(encoding="utf-8"))
    assert found["causes"][0]["name"] == hidden["name"]
    assert found["causes"][0]["confidence"] >= 0.9
    (program,) = snippets(ROOT / "README.md", "python")
    exec(program, {})


STEP = re.compile(
    r"^(?P<commands>(?:    flexspline [^\n]*\n(?:        [^\n]*\n)*)+)|^```yaml\n(?P<yaml>.*?)```|^```python\n(?P<python>.*?)```"
    r"|^<!-- output -->\n```text\n(?P<output>.*?)```",
    re.DOTALL | re.MULTILINE,
)
"""Steps of a page: commands, a file to save (`bench.yaml`), a program, output of the last command."""


def assert_shown(shown: str, said: str) -> None:
    """Compare a page's lines with the output, numbers to two per cent or one of their last decimal.

    A page may leave out lines, and their ends.
    """

    def same(a: str, b: str) -> bool:
        last = 1.01 * 10.0 ** -len(a.partition(".")[2]) if "." in a else 0.0
        try:
            return float(a) == pytest.approx(float(b), rel=0.02, abs=max(2e-3, last))
        except ValueError:
            return a.rstrip(".,") == b.rstrip(".,")

    words = said.split()
    for line in shown.splitlines():
        sought = line.split()
        starts = range(len(words) - len(sought) + 1)
        assert any(all(map(same, sought, words[i : i + len(sought)])) for i in starts), (line, said)


@pytest.mark.slow
def test_the_first_hour(flexspline, tmp_path, monkeypatch):
    """Run the page in its order, in an empty folder, and compare the output."""
    monkeypatch.chdir(tmp_path)
    said, steps = "", {"commands": 0, "yaml": 0, "python": 0, "output": 0}
    for step in STEP.finditer((ROOT / "docs" / "first_hour.md").read_text(encoding="utf-8")):
        kind, text = step.lastgroup, step.group(step.lastgroup)
        steps[kind] += 1
        if kind == "yaml":
            Path("bench.yaml").write_text(text, encoding="utf-8")
        elif kind == "python":
            exec(text, {})
        elif kind == "output":
            assert_shown(text, said)
        else:
            for line in filter(None, text.replace("\\\n", " ").splitlines()):
                _, *words = shlex.split(line, comments=True)
                if words[0] != "view":
                    code, said, error = flexspline(*words)
                    assert code == 0, (words, error)
    assert steps == {"commands": 7, "yaml": 1, "python": 1, "output": 2}


SYNOPSIS = re.compile(r"FORMAT FILE…|tcp://")
"""Lines that are not run: a synopsis, and a cluster (`tests/scenarios/studies` has one)."""
SMALLER = {
    "--seeds 10": "--seeds 1",
    "--draws 24": "--draws 1",
    "--draws 10": "--draws 1",
    "1,0.3,0.1": "1",
    "sweep my_study.yaml": "sweep my_study.yaml --seeds 1",
    "values: [1, 3, 10]": "values: [1]",
    "values: [3, 9, 12]": "values: [9]",
    "sizes: [0, 0.5, 1]": "sizes: [1]",
    "NEW_MEASUREMENT": "MEASUREMENT",
    "--out …": "--out other",
}
"""Replacements that shorten a page's commands, or fill in what it leaves open."""
NAMED = re.compile(r"`(\w+\.(?:py|yaml))`[^`\n]*\n\n$")
"""The name of a file that a page shows: in the line before."""


@pytest.fixture(scope="module")
def place(tmp_path_factory, shared):
    """Make a folder with the runs, measurements, diagnoses and files that pages use."""
    import flexspline as fs
    from flexspline.models.joint_parts import Effect, Estimate
    from flexspline.models.recording import write_recording

    top = tmp_path_factory.mktemp("place")
    (top / "shared").symlink_to(shared)
    here = top / "here"
    here.mkdir()
    asymmetry = Effect(name="friction_asymmetry", parameters={"ratio": Estimate(value=0.35)})
    worn = fs.load_joint("test-joint").model_copy(update={"effects": [asymmetry]})
    worn.write(here / "worn.yaml")
    ways = [{"time": t, "position": x} for t, x in ((0.5, 0), (4, 1.2), (5, 1.2), (11, -1.2), (12, -1.2), (15, 0))]
    motion = {"name": "motion", "duration": 16.0, "trajectory": ways, "filters": ["RAREKF", "current"]}
    for name in ("mine.yaml", "my_motion.yaml"):
        (here / name).write_text(yaml.safe_dump(motion), encoding="utf-8")
    run = fs.simulate(here / "mine.yaml", joint=worn, known_joint="test-joint")
    (here / "robot.xml").write_text(
        '<mujoco><worldbody><body><joint name="elbow"/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    (here / "robot.urdf").write_text(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="elbow" type="revolute"><parent link="a"/>'
        '<child link="b"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    for name in ("MEASUREMENT", "measurement"):
        (here / name).mkdir()
        write_recording(run.as_recording(), here / name)
    for name, sought in (("joint3_outbound.csv", "lara8"), ("shoulder_first_half.csv", "ur3e")):
        (here / name).write_bytes((shared / "data" / sought / name).read_bytes())
    lines = (here / "shoulder_first_half.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (here / "first.csv").write_text("".join(lines[:2466]), encoding="utf-8")
    (here / "last.csv").write_text("".join([lines[0], *lines[-1237:]]), encoding="utf-8")
    for words in (
        ["run", "external_push", "no_load", "--set", "duration=3", "--no-figures", "--no-recording"],
        ["run", "two_joints", "--set", "duration=3", "--no-figures", "--no-recording"],
        ["diagnose", "MEASUREMENT", "--out", "before"],
        ["diagnose", "MEASUREMENT", "--joint", "worn.yaml", "--out", "after"],
        ["validate", "MEASUREMENT", "--out", "validation"],
        ["contact", "--hours", "0.05", "--filter", "RAREKF", "--set", "duration=20", "--rate", "400", "--out", "contact"],
        ["joint", "new", "--gear", "CSG-17-80", "--torque-constant", "0.05", "--resistance", "0.3", "--inductance", "3e-4",
         "--rotor-inertia", "8e-5", "--motor-encoder", "4096", "--link-encoder", "20 bit", "--out", "my_joint.yaml"],
    ):  # fmt: skip
        done = subprocess.run([sys.executable, "-m", "flexspline", *words], cwd=here, capture_output=True, text=True)
        assert done.returncode == 0, (words, done.stderr)
    shutil.copytree(here / "before", here / "diagnosis")
    study = {"name": "few", "seeds": {"first": 1, "count": 2}, "scenarios": ["no_load"], "filters": ["RAREKF", "EKF"]}
    (here / "few.yaml").write_text(yaml.safe_dump(study | {"set": {"duration": 3}}), encoding="utf-8")
    done = subprocess.run([sys.executable, "-m", "flexspline", "sweep", "few.yaml", "--out", "sweep"], cwd=here)
    assert done.returncode == 0
    return top


def looked_at(words: list[str]) -> None:
    """Check that `view` finds its file, and that a live run starts."""
    from flexspline.commands.view import find_recording
    from flexspline.scenarios.experiment import Experiment

    if "--live" in words:
        changes = [words[i + 1] for i, word in enumerate(words) if word == "--set"]
        assert Experiment.of(*load_scenario(words[words.index("--live") + 1], changes)).closed_loop().advance(20)
    else:
        assert all(find_recording(Path(word)).is_file() for word in words)


def file_of(before: str) -> str:
    """Return the file name of a snippet, or an empty text."""
    found = NAMED.search(before)
    return found.group(1) if found else ""


TYPED = [
    page
    for page in PAGES
    if page.name not in ("README.md", "first_hour.md") and OWN.search(page.read_text(encoding="utf-8"))
]


@pytest.mark.fast_every(4)
@pytest.mark.parametrize(("words", "code", "text"), [
    (("arms", "--help"), 0, "--seed"), (("updates", "--draws", "3"), 2, "has no options, got --draws 3"),
    (("arms", "--page", "x"), 2, "unrecognized arguments: --page x"), (("nothing", "--help"), 2, "unknown benchmark 'nothing'"),
    (("studies", "model_error", "--jobs", "x"), 2, "argument --jobs: invalid int value: 'x'"),
    (("studies", "nothing"), 2, "unknown study 'nothing'"), (("updates", "nothing"), 2, "has no options, got nothing"),
])  # fmt: skip
def test_a_benchmark_has_its_options(words, code, text):
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", *words], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == code and text in done.stdout + done.stderr


LONG = (
    "diagnosis.md", "accuracy.md", "arms.md", "planning.md", "cluster.md", "estimators.md", "package.md", "ur3e.md", "lara8.md",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [pytest.param(p, marks=pytest.mark.long if p.name in LONG else ()) for p in TYPED], ids=ids(TYPED)
)
def test_every_command_of_a_page_is_run(page, place, flexspline, tmp_path, monkeypatch):
    """In the order of the page, with the files that it shows; README and the first hour have separate tests."""
    shutil.copytree(place, tmp_path / "place", symlinks=True)
    monkeypatch.chdir(tmp_path / "place" / "here")
    if page.name in ("cluster.md", "scenarios.md"):
        shutil.rmtree("sweep")
    if page.name == "joints.md":
        for name in ("my_joint.yaml", "my_joint.xml"):
            Path(name).unlink()
    text, said = page.read_text(encoding="utf-8"), ""
    for long, short in SMALLER.items():
        text = text.replace(long, short)
    steps = [
        (step.lastgroup, step.group(step.lastgroup), file_of(text[: step.start()])) for step in STEP.finditer(text)
    ]
    for kind, found, name in steps:
        if kind in ("yaml", "python") and name:
            Path(name).write_text(found, encoding="utf-8")
    for kind, found, name in steps:
        if kind in ("yaml", "python"):
            if kind == "python" and not name:
                exec(found, {})
            continue
        if kind == "output":
            assert_shown(found, said)
            continue
        for line in filter(None, found.replace("\\\n", " ").splitlines()):
            _, *words = shlex.split(line, comments=True)
            if SYNOPSIS.search(line):
                continue
            if words[0] == "view":
                looked_at(words[1:])
                continue
            code, said, error = flexspline(*words)
            assert code == 0, (words, error)


def test_public_functions_document_arguments_and_results():
    import flexspline as fs

    for name in fs.__all__:
        one = getattr(fs, name)
        if inspect.isfunction(one):
            text = inspect.getdoc(one) or ""
            assert "Returns:" in text, name
            if inspect.signature(one).parameters:
                assert "Args:" in text and "Raises:" in text, name
