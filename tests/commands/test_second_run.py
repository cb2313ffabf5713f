"""Compiled once: in a fresh copy of the package the second run of a command compiles nothing and writes nothing to the caches."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flexspline.models.recording import Recording, write_recording

ROOT = Path(__file__).resolve().parents[2]
SHORT = ("--set", "duration=1.5", "--set", "transient=0.5")
COMMANDS = {
    "run": ("run", "link_sweep", "--out", "run", "--no-figures", "--no-recording", *SHORT),
    "run, all estimators": (
        "run", "external_push", "--out", "all", "--no-figures", "--no-recording", *SHORT, "--set", "feedback=RAREKF",
        "--set", "filters=[RAREKF, current, lowpass, kalman, huber, momentum, dynamics_ekf, dynamics_ukf, rts_smoother]",
    ),
    "views": ("run", "link_sweep", "--out", "views", *SHORT),
    "sweep": ("sweep", "study.yaml", "--out", "sweep", "--no-figures"),
    "bound": ("bound", "link_sweep", "--seeds", "1", "--filter", "EKF", *SHORT),
    "tune": (
        "tune", "link_sweep", "--out", "tune", "--train", "1", "--test", "2", "--evaluations", "2", "--filter", "EKF", *SHORT,
    ),
    "estimate": ("estimate", "slow.parquet", "--out", "estimates"),
}  # fmt: skip
STUDY = "{name: s, seeds: {count: 1}, scenarios: [link_sweep], set: {duration: 1.5, transient: 0.5}, metrics: [rms]}"


@pytest.fixture(scope="module")
def fresh(tmp_path_factory) -> Path:
    """A folder with the package as plain files that were never run, and what the commands read."""
    folder = tmp_path_factory.mktemp("fresh")
    shutil.copytree(ROOT / "flexspline", folder / "flexspline", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "study.yaml").write_text(STUDY, encoding="utf-8")
    t = np.arange(3000) * 1e-3
    angle = 0.3 * np.sin(2 * t)
    columns = {"motor_position": 100 * angle, "link_position": angle, "motor_current": 0.3 * np.sign(np.cos(2 * t))}
    write_recording(Recording("slow", t, columns), folder)
    return folder


def test_the_second_run_here_compiles_nothing(tmp_path):
    """Where others compile meanwhile, what this command says of the caches counts."""
    command = [sys.executable, "-m", "flexspline", *COMMANDS["run"]]
    environment = os.environ | {"NUMBA_DEBUG_CACHE": "1"}
    said = [
        subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=True).stdout
        for _ in range(2)
    ]
    assert "data loaded from" in said[1] and "data saved to" not in said[1]


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", COMMANDS)
def test_the_second_run_compiles_nothing(fresh, name):
    environment = os.environ | {
        "NUMBA_DEBUG_CACHE": "1",
        "PYTHONPATH": str(fresh),
        "XDG_CACHE_HOME": str(fresh / "user"),
    }

    def call() -> str:
        if name == "sweep":  # an existing one is only extended
            shutil.rmtree(fresh / "sweep", ignore_errors=True)
        command = [sys.executable, "-m", "flexspline", *COMMANDS[name]]
        done = subprocess.run(command, capture_output=True, text=True, cwd=fresh, env=environment, timeout=900)
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    def compiled() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in fresh.rglob("kernels/**/*") if path.is_file()}

    call()
    before = compiled()
    assert before, "nothing is cached in the copy"
    said = call()
    assert compiled() == before
    assert "data loaded from" in said and "data saved to" not in said
