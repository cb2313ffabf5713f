"""The programs of `examples/`: short, and they run as they are."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "examples"
NAMES = sorted(path.stem for path in FOLDER.glob("*.py"))


def run(name: str, folder: Path) -> str:
    """What an example prints, run in an empty folder."""
    done = subprocess.run([sys.executable, str(FOLDER / f"{name}.py")], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_they_are_all_there():
    assert NAMES == ["compare_filters", "diagnose_your_log", "own_cause", "own_filter", "plan_an_experiment", "sweep"]


@pytest.mark.parametrize("name", NAMES)
def test_examples_are_short_and_say_what_they_do(name):
    text = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert len(ast.get_docstring(ast.parse(text)) or "") > 60


def test_own_filter(tmp_path):
    """Where the stiffness is not what is known, both together are better than either."""
    lines = run("own_filter", tmp_path).splitlines()
    errors = {line.split(":")[0]: float(line.split(": ")[1].split()[0]) for line in lines}
    assert errors["corner 0.2 Hz"] < 0.9 * min(errors["lowpass alone"], errors["current alone"])


@pytest.mark.parametrize("name", NAMES)
def test_what_an_example_imports_exists(name):
    for node in ast.walk(ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            module = importlib.import_module(node.module)
            for alias in node.names:
                assert hasattr(module, alias.name), f"{node.module} has no {alias.name}"


@pytest.mark.slow
def test_compare_filters(tmp_path):
    text = run("compare_filters", tmp_path)
    assert "external_push: dynamics_ekf is closest" in text and "quick:" in text


@pytest.mark.slow
def test_diagnose_your_log(tmp_path):
    text = run("diagnose_your_log", tmp_path)
    assert text.startswith("discrepancy\nfriction_asymmetry: 99 % sure, ratio 0.3")
    assert (tmp_path / "extended.yaml").is_file()


@pytest.mark.slow
def test_own_cause(tmp_path):
    text = run("own_cause", tmp_path)
    assert text.startswith("pinched_hose: 99 % sure, torque 1.6")


@pytest.mark.slow
@pytest.mark.long
def test_plan_an_experiment(tmp_path):
    text = run("plan_an_experiment", tmp_path)
    assert "could backlash have shown? no" in text
    found = re.search(r"backlash: width (\S+) ± (\S+) rad", text.splitlines()[-1])
    assert found is not None, text
    width, std = float(found[1]), float(found[2])
    assert abs(width - 4e-4) < 2 * std and std < 0.06 * width, text


@pytest.mark.slow
def test_sweep(tmp_path):
    text = run("sweep", tmp_path)
    assert text.count("N·m RMS") == 6 and (tmp_path / "sweep.png").stat().st_size > 1000
    again = run("sweep", tmp_path)  # everything is there already
    assert "more of" not in again and again.splitlines() == [
        line for line in text.splitlines() if "more of" not in line
    ]
