"""Motions next to waypoints: sine, chirp, multisine, a file of commanded positions."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import yaml

import flexspline as fs
from flexspline.models.errors import InputError
from flexspline.models.files import parse
from flexspline.scenarios.motion import AddedMotion
from flexspline.scenarios.scenario import Scenario, load_scenario

KINDS = [
    {"kind": "sine", "frequency": 1.3, "amplitude": 0.2},
    {"kind": "chirp", "frequency": 0.3, "end_frequency": 12.0, "amplitude": 0.1},
    {"kind": "multisine", "frequency": 0.5, "end_frequency": 15.0, "lines": 40, "amplitude": 0.05},
]


def scenario(**motion):
    return parse(
        {"name": "moved", "duration": 9, "trajectory": [{"time": 1, "position": 0.3}],
         "motions": [{"start": 1.5, "duration": 6.0} | motion]}, Scenario, "here",
    )  # fmt: skip


@pytest.mark.parametrize("motion", KINDS, ids=lambda m: m["kind"])
def test_velocity_is_the_rate_of_position(motion):
    time = np.arange(0, 9, 1e-4)
    position, velocity = scenario(**motion).commands(time)
    np.testing.assert_allclose(np.gradient(position, time), velocity, atol=2e-3 * np.abs(velocity).max())
    outside = (time < 1.5) | (time > 7.5)
    assert (position[outside] == 0.3).all() and (velocity[outside] == 0).all()
    assert np.abs(position - 0.3).max() < 3.5 * motion["amplitude"]


@pytest.mark.parametrize("motion", KINDS[1:], ids=lambda m: m["kind"])
def test_power_is_in_the_band(motion):
    position, _ = scenario(**motion).commands()
    power = np.abs(np.fft.rfft(position - 0.3)) ** 2
    f = np.fft.rfftfreq(len(position), 1e-3)
    inside = (f > 0.2 * motion["frequency"]) & (f < 1.2 * motion["end_frequency"])
    assert power[inside].sum() > 0.98 * power.sum()


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_file_of_positions(tmp_path, ending):
    """Relative to the scenario's file; run, recorded, and run again from the run's own scenario."""
    time = 5.0 + np.arange(0, 3, 0.01)
    table = pd.DataFrame({"time": time, "position": 0.2 * np.sin(2 * (time - 5.0)) ** 2})
    table.to_csv(tmp_path / "way.csv", index=False) if ending == ".csv" else table.to_parquet(tmp_path / "way.parquet")
    (tmp_path / "mine.yaml").write_text(
        yaml.safe_dump({"name": "mine", "duration": 4, "trajectory": [{"time": 0, "position": 0.1}],
                        "motions": [{"kind": "file", "file": f"way{ending}", "start": 0.5}]})
    )  # fmt: skip
    run = fs.simulate(str(tmp_path / "mine.yaml"), filters=["RAREKF"])
    np.testing.assert_allclose(run.position_command[500:3490:10], 0.1 + table["position"][:299], atol=1e-9)
    assert np.abs(run.truth("link_position") - run.position_command).max() < 0.02
    again, _ = load_scenario(tmp_path / "mine.yaml")
    assert again.motions[0].file == str(tmp_path / f"way{ending}")


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ({"kind": "sine", "duration": 1}, "frequency: missing, as a sine needs one"),
        ({"kind": "chirp", "duration": 1, "frequency": 3, "end_frequency": 2}, "expected more than 3 Hz, got 2 Hz"),
        ({"kind": "sine", "duration": 1, "frequency": 3, "file": "a.csv"}, "file: a sine has none"),
        ({"kind": "file"}, "file: missing"),
        ({"kind": "square"}, "kind"),
    ],
)
def test_what_a_motion_lacks_is_one_line(motion, message):
    with pytest.raises(InputError, match=message) as error:
        parse(motion, AddedMotion, "here")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"trajectory": {"kind": "sine"}}, "trajectory: expected a list of waypoints, got a mapping; .* `motions`"),
        (
            {"motions": [{"kind": "sine", "duration": 1, "frequency": 600}]},
            "motions.0: expected at most 500 Hz, .* got 600 Hz",
        ),
        (
            {"motions": [{"kind": "sine", "duration": 1, "frequency": 6, "start": 3}]},
            "motions.0.start: expected a time before",
        ),
    ],
)
def test_a_motion_that_cannot_be_commanded_is_one_line(tmp_path, flexspline, change, message):
    base = {"name": "mine", "duration": 3, "trajectory": [{"time": 0, "position": 0}]}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(base | change))
    code, _, err = flexspline("run", tmp_path / "mine.yaml", "--out", tmp_path / "out")
    assert code == 2 and re.search(message, err) and len(err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,angle\n0,1\n1,2\n", "expected a column 'position', got time, angle"),
        ("time,position\n0,1\n0,2\n", "expected increasing times, got 0 s in row 2"),
        ("time,position\n0,x\n1,2\n", "column 'position': expected two or more finite numbers"),
        (None, "cannot be read as a motion"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_line(tmp_path, text, message):
    path = tmp_path / "way.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message):
        AddedMotion(kind="file", file=str(path)).signal(np.arange(3.0))


@pytest.mark.parametrize("arm", [False, True])
def test_a_file_is_relative_to_its_scenario_in_the_command(tmp_path, flexspline, arm):
    """`run` once looked for it in the current folder."""
    (tmp_path / "way.csv").write_text("time,position\n0,0\n0.5,0.1\n1,0.2\n", encoding="utf-8")
    joint = {
        "trajectory": [{"time": 0, "position": 0}],
        "motions": [{"kind": "file", "file": "way.csv"}],
        "filters": ["model"],
    }
    data = {
        "name": "mine",
        "duration": 1.0,
        **({"arm": [joint | {"name": "a"}]} if arm else joint | {"transient": 0.2}),
    }
    if arm:
        data["arm"][0]["transient"] = 0.2
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    code, _, error = flexspline(
        "run", tmp_path / "mine.yaml", "--out", tmp_path / "out", "--no-figures", "--no-recording"
    )
    assert code == 0, error
