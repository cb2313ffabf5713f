"""What an installation holds: every module and every data file once, and it runs from there."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("commands", "diagnosis", "estimator", "models", "scenarios", "sim", "views")
DATA = {".yaml", ".xml", ".j2", ".css"}


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder into which a wheel was unpacked."""
    folder = tmp_path_factory.mktemp("wheel")
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
