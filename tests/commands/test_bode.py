"""`flexspline bode`: frequency responses, measured and simulated."""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd
import pytest
import yaml

import flexspline as fs
from flexspline.models import laws
from flexspline.models.recording import write_recording

SCENARIO = {
    "name": "shaken", "duration": 18, "mounting": "link", "trajectory": [{"time": 0, "position": 0}],
    "motions": [
        {"kind": "multisine", "start": 1, "duration": 16, "amplitude": 0.012, "frequency": 1, "end_frequency": 70, "lines": 120},
        {"kind": "sine", "start": 1, "duration": 16, "amplitude": 0.5, "frequency": 0.12},
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A scenario's file, and the measurement that it gives."""
    folder = tmp_path_factory.mktemp("bode")
    (folder / "shaken.yaml").write_text(yaml.safe_dump(SCENARIO))
    run = fs.simulate(str(folder / "shaken.yaml"), filters=["RAREKF"])
    write_recording(run.as_recording(), folder / "measurement")
    return folder


def bode(flexspline, *arguments):
    code, out, err = flexspline("bode", *arguments, "--json")
    assert code == 0, err
    return json.loads(out)


@pytest.fixture
def response(flexspline, measured):
    """What `bode` says of the measurement, asked once, with its files in the folder `out`."""
    said = measured / "said.json"
    if not said.exists():
        said.write_text(json.dumps(bode(flexspline, measured / "measurement", "--out", measured / "out")))
    return json.loads(said.read_text())


@pytest.mark.slow
def test_the_link_against_the_drive(response, measured):
    """The dip is where the link swings against a held rotor; below it, the drive and the link are one inertia."""
    p = fs.load_joint("test-joint").record()[0]
    soft, stiff = ((1 / (1 / K + 1 / (p["N"] ** 2 * Kw))) for K, Kw in (
        (p["K1"], p["Kw0"]), (p["K3"], laws.wave_generator_stiffness(laws.wave_generator_torsion(0.15, p), p))))  # fmt: skip
    lowest, highest = (np.sqrt(K / p["Jl"]) / (2 * np.pi) for K in (soft, stiff))
    for kind in ("measured", "simulated"):
        dips = response[kind]["antiresonances"]
        assert len(dips) == 1 and lowest < dips[0] < highest
        assert any(dips[0] < f < 4 * dips[0] for f in response[kind]["resonances"])
    table = pd.read_csv(measured / "out/bode.csv")
    f, size, coherence = (table[c].to_numpy() for c in ("frequency [Hz]", "measured [rad/(s·A)]", "coherence [1]"))
    low = (f > 7) & (f < 12) & (coherence > 0.8)
    assert low.sum() >= 4
    inertia = p["Jm"] + p["Jw"] + p["Jl"] / p["N"] ** 2
    rigid = p["Kt"] / (2 * np.pi * f[low] * inertia)
    assert np.all((size[low] > 0.7 * rigid) & (size[low] < 1.5 * rigid))
    assert (measured / "out/bode.png").stat().st_size > 10_000


def test_a_wrong_description_shows(flexspline, measured, response, tmp_path):
    described = fs.load_joint("test-joint")
    heavy = described.numbers["Jm"].model_copy(update={"value": 2.5 * described.numbers["Jm"].value})
    described.model_copy(update={"numbers": described.numbers | {"Jm": heavy}}).write(tmp_path / "heavy.yaml")
    other = bode(flexspline, measured / "measurement", "--joint", tmp_path / "heavy.yaml", "--out", tmp_path / "b")
    assert response["rms_log_ratio"] < 0.35
    assert other["rms_log_ratio"] > 1.3 * response["rms_log_ratio"]


def test_a_scenario_is_run(flexspline, measured, response, tmp_path):
    """The same as of its recording."""
    run = bode(flexspline, measured / "shaken.yaml", "--out", tmp_path)
    assert run["measured"] == response["measured"] and run["reference"] == "position_command"


def test_the_report_of_an_excited_run_has_its_response(flexspline, measured, response, tmp_path):
    """With the resonances of `bode`; a run without excitation has no such section."""
    pages = []
    for scenario, *options in ((measured / "shaken.yaml",), ("no_load", "--set", "duration=2")):
        out = tmp_path / f"run{len(pages)}"
        assert flexspline("run", scenario, "--out", out, "--set", "filters=[RAREKF]", *options)[0] == 0
        assert flexspline("report", out, "--out", tmp_path / "page.html")[0] == 0
        pages.append((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert "Frequency response of shaken" in pages[0]
    for kind, name in (("peaks", "resonances"), ("dips", "antiresonances")):
        stated = re.search(f"{kind} at ([^H]*) Hz", pages[0]).group(1).split(", ")
        np.testing.assert_allclose([float(x) for x in stated], response["measured"][name], rtol=5e-3)
    assert pages[0].count('class="title"') == pages[1].count('class="title"') + 3
    assert "Frequency response" not in pages[1]


def test_without_a_current_it_is_refused(flexspline, measured, tmp_path):
    recording = fs.load_recording(measured / "measurement" / "shaken.parquet")
    for name in ("motor_current", "motor_torque"):
        if name in recording.columns:
            recording = recording.without(name)
    write_recording(recording, tmp_path / "measurement")
    code, _, err = flexspline("bode", tmp_path / "measurement", "--out", tmp_path / "out")
    assert code == 2 and "expected two seconds of motor_position and motor_current" in err
    assert not (tmp_path / "out" / "bode.csv").exists()
