"""Packages: versions agree, and a wheel has every module and data file once and runs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("commands", "diagnosis", "estimator", "models", "scenarios", "sim", "views")
DATA = {".yaml", ".xml", ".j2", ".css"}


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    changes = re.findall(r"^## (\S+) – (\S+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert changes[0] == (citation["version"], str(citation["date-released"]))
    assert project["version"] == citation["version"]
    assert project["license"] == citation["license"]
    assert {a["family-names"] for a in citation["references"][0]["authors"]} == {"Shi", "Liu"}


def test_workflows_run_the_steps_of_ci():
    steps = set(
        re.findall(r"[a-z-]+", " ".join(re.findall(r"^make(.*)$", (ROOT / ".ci/run").read_text("utf-8"), re.MULTILINE)))
    )
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    run = [step.get("run", "") for job in workflow["jobs"].values() for step in job["steps"]]
    assert {line.removeprefix("make ") for line in run if line.startswith("make ")} == steps - {"--jobs"}
    matrix = workflow["jobs"]["test"]["strategy"]["matrix"]
    assert len(matrix["os"]) == 3 and matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """Return a folder with an unpacked wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    shutil.rmtree(ROOT / "build" / "lib", ignore_errors=True)  # files of an earlier build would be packed again
    command = [sys.executable, "-m", "pip", "wheel", str(ROOT), "--no-deps", "--wheel-dir", str(folder)]
    if subprocess.run(command, capture_output=True, cwd=folder).returncode != 0:
        pytest.skip("pip cannot build here: no network, or no setuptools")
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        assert len(names) == len(set(names))
        archive.extractall(folder / "site")
    return folder / "site"


@pytest.mark.slow
def test_a_wheel_holds_every_file_once(installed):
    expected = {"__init__.py", "__main__.py", "py.typed"}
    for room in ROOMS:
        for path in (ROOT / room).rglob("*"):
            if path.suffix in {".py", *DATA} and "__pycache__" not in path.parts:
                expected.add(str(path.relative_to(ROOT)))
    held = {str(p.relative_to(installed / "flexspline")) for p in (installed / "flexspline").rglob("*") if p.is_file()}
    assert held == expected


@pytest.mark.slow
@pytest.mark.long  # as does `make wheel`
def test_a_wheel_runs(installed, tmp_path):
    environment = os.environ | {"PYTHONPATH": str(installed)}
    program = "import flexspline as fs; print(fs.__file__); print(*fs.joints().index, len(fs.estimators()))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, env=environment, check=True
    )
    where, found = done.stdout.splitlines()
    assert Path(where).is_relative_to(installed) and "test-joint" in found
