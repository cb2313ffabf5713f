"""A plugin's sensor: a channel in runs, recordings and studies, that its estimator reads; nothing else changes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import flexspline as fs
from flexspline.models import own_sensors, plugins
from flexspline.models.errors import InputError
from flexspline.models.recording import read_recording, write_recording
from flexspline.scenarios.run_folder import load_run, save_run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "plugins.md"


@pytest.fixture
def strain(tmp_path) -> Path:
    """The sensor and estimator of docs/plugins.md."""
    (text,) = [
        t for t in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL) if "SENSORS" in t
    ]
    path = tmp_path / "my_sensor.py"
    path.write_text(text, encoding="utf-8")
    return path


def test_it_is_read_recorded_and_estimated_with(strain, tmp_path):
    alone = fs.simulate("link_sweep", duration=6, filters=["RAREKF"])
    with plugins.known([strain]):
        run = fs.simulate("link_sweep", duration=6, filters=["strain_corrected", "RAREKF"])
        reading = run.simulation.further["strain"]
        off = reading - run.truth("joint_torque") - run.time / 60.0
        assert np.std(off) == pytest.approx(0.02, rel=0.05)
        assert run.metrics["filters"]["strain_corrected"]["rms"] < 0.1
        np.testing.assert_array_equal(run.estimate("RAREKF"), alone.estimate("RAREKF"))
        again = load_run(save_run(run, tmp_path / "run"))
        np.testing.assert_array_equal(again.simulation.further["strain"], reading)
        path = write_recording(run.as_recording(), tmp_path)
        recording = read_recording(path)
        np.testing.assert_array_equal(recording["strain"], reading)
        estimated = fs.estimate(recording, estimators=["strain_corrected"])
        assert np.isfinite(estimated["strain_corrected"]).all()
    assert own_sensors.names() == () and own_sensors.channel("strain") is None
    with pytest.raises(InputError, match="'strain': unknown column"):
        read_recording(path)


def test_it_is_listed(flexspline, strain):
    code, out, err = flexspline("sensors", "--plugin", strain)
    assert code == 0 and "strain gauges on the flexspline" in out and "motor_position" in out, err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("truth[\"joint_torque\"] +", "truth[\"joint_torque\"][:-1] +"), "operands could not be broadcast"),
        (("return truth[\"joint_torque\"] +", "return np.nan * truth[\"joint_torque\"] +"), "expected finite readings"),
        (("name = \"strain\"", "name = \"joint_torque\""), "expected another name"),
        (("(Sensor):", ":"), "expected a subclass of flexspline.models.own_sensors.Sensor"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line(flexspline, strain, tmp_path, change, said):
    text = strain.read_text(encoding="utf-8")
    assert text.count(change[0]) == 1
    strain.write_text(text.replace(*change), encoding="utf-8")
    code, _, err = flexspline(
        "run",
        "no_load",
        "--set",
        "duration=3",
        "--plugin",
        strain,
        "--out",
        tmp_path / "o",
        "--no-figures",
        "--no-recording",
    )
    assert code == 2 and err.strip().count("\n") == 0 and said in err, err
