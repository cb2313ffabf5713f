"""README and docs are true: files that they name are there, commands and options exist, snippets are read and run."""

from __future__ import annotations

import importlib
import inspect
import re
import shlex
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
import yaml

from flexspline import commands
from flexspline.diagnosis.data.importing import Layout
from flexspline.models.files import parse
from flexspline.scenarios.arms.arm_scenario import ArmScenario
from flexspline.scenarios.scenario import Scenario
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
    "my_cause.py", "arm.yaml", "my_sensor.py", "bench.yaml", "my_motion.yaml", "my_joint.yaml", "worn.yaml",
}  # fmt: skip
"""Files that commands or people make, and patterns."""
BUILT = re.compile(r"(?:reference/\w+|examples)\.md")
"""Pages that `docs/site_pages.py` makes when the site is built."""
OWN = re.compile(r"(?:^    (?:\S*/)?|`)flexspline ([a-z]+)(?: ([^`#\n]*))?", re.MULTILINE)


def ids(pages):
    return [page.name for page in pages]


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_files_that_are_named_are_there(page):
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


@pytest.mark.parametrize("room", ["models", "sim", "estimator", "scenarios", "diagnosis"])
def test_every_file_of_a_room_has_its_place(room):
    """docs/architecture.md says what each is for."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    files = {path.name for path in (ROOT / room).glob("*.py")} - {"__init__.py"}
    assert not [name for name in sorted(files) if f"`{name}`" not in text]


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_commands_and_their_options_are_there(page):
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
    """Options of a command as they are typed."""
    module = ".".join(part for part in ("flexspline.commands", folder, commands._files(folder)[name]) if part)
    function = importlib.import_module(module).command
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
    scenario, study = (yaml.safe_load(text) for text in snippets(ROOT / "docs" / "scenarios.md", "yaml"))
    parse(scenario, Scenario, "the scenario")
    parse(study, Study, "the study")


def test_the_arm_is_read():
    (text,) = snippets(ROOT / "docs" / "arms.md", "yaml")
    assert [joint.name for joint in parse(yaml.safe_load(text), ArmScenario, "the arm").arm] == ["shoulder", "elbow"]


def test_mappings_are_read():
    texts = snippets(ROOT / "docs" / "importing.md", "yaml")
    assert [parse(yaml.safe_load(text), Layout, "the mapping").name for text in texts] == ["my-robot", "my-bag"]


@pytest.mark.parametrize("page", PAGES, ids=ids(PAGES))
def test_programs_are_python(page):
    for text in snippets(page, "python"):
        compile(text, page.name, "exec")


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.slow
def test_the_first_five_minutes(flexspline, shared, tmp_path, monkeypatch):
    """The commands of the README, one after the other, and its program."""
    (tmp_path / "here").mkdir()
    (tmp_path / "shared").symlink_to(shared)
    monkeypatch.chdir(tmp_path / "here")
    text = (ROOT / "README.md").read_text(encoding="utf-8").split("## Five minutes")[1].split("## ")[0]
    typed = [shlex.split(line, comments=True) for line in text.splitlines() if line.startswith("    flexspline ")]
    assert len(typed) >= 5
    for _, *words in typed:
        if words[0] != "view":
            code, _, error = flexspline(*words)
            assert code == 0, (words, error)
    assert (tmp_path / "here" / "diagnosis" / "report.html").is_file()
    (program,) = snippets(ROOT / "README.md", "python")
    exec(program, {})


STEP = re.compile(
    r"^(?P<commands>(?:    flexspline [^\n]*\n(?:        [^\n]*\n)*)+)|^```yaml\n(?P<yaml>.*?)```|^```python\n(?P<python>.*?)```"
    r"|^<!-- output -->\n```text\n(?P<output>.*?)```",
    re.DOTALL | re.MULTILINE,
)
"""What a page to follow step by step has: commands, a file to save (`bench.yaml`), a program, what the last command said."""


def assert_shown(shown: str, said: str) -> None:
    """Every line that a page shows is what was said, numbers to two per cent; a page may leave out lines and their ends."""

    def same(a: str, b: str) -> bool:
        try:
            return float(a) == pytest.approx(float(b), rel=0.02, abs=2e-3)
        except ValueError:
            return a.rstrip(".,") == b.rstrip(".,")

    words = said.split()
    for line in shown.splitlines():
        sought = line.split()
        starts = range(len(words) - len(sought) + 1)
        assert any(all(map(same, sought, words[i : i + len(sought)])) for i in starts), (line, said)


@pytest.mark.slow
def test_the_first_hour(flexspline, tmp_path, monkeypatch):
    """Everything on the page, in its order, in an empty folder; what it shows is what comes."""
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
    assert steps == {"commands": 6, "yaml": 1, "python": 1, "output": 2}


def test_public_functions_say_what_they_take_and_give():
    import flexspline as fs

    for name in fs.__all__:
        one = getattr(fs, name)
        if inspect.isfunction(one):
            text = inspect.getdoc(one) or ""
            assert "Returns:" in text, name
            if inspect.signature(one).parameters:
                assert "Args:" in text and "Raises:" in text, name
