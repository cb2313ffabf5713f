"""Mapping files: other programs' logs as recordings."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from flexspline.diagnosis.importing import import_recording, known_layouts, load_layout

from flexspline.models.errors import InputError

LAYOUT = {
    "format": 1,
    "name": "mine",
    "joint": "test-joint",
    "link": {"inertia": 0.35, "gravity_moment": 9.0},
    "separator": ";",
    "columns": {
        "time": {"column": "t", "unit": "ms", "zero": "first"},
        "motor_position": {"column": "m", "unit": "counts", "counts": 4096, "sign": -1, "offset": 0.5},
        "link_position": {"column": "l", "unit": "deg", "zero": {"column": "angle", "unit": "rad"}},
        "motor_current": {"column": "i", "unit": "mA"},
        "joint_torque": {"sum": [{"column": "fx", "unit": "N", "scale": 0.5}, {"column": "my", "unit": "N·m"}]},
    },
}
LOG = "t;m;l;i;fx;my;angle;junk\n5000;0;10;100;2;1;0.1;x\n5001;1024;11;200;4;1;0.1;y\n"


def layout(tmp_path, **changes):
    data = {**LAYOUT, **changes}
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data, allow_unicode=True))
    return load_layout(path)


def columns(**changes):
    return {"columns": {**LAYOUT["columns"], **changes}}


def log(tmp_path, text=LOG):
    path = tmp_path / "log.csv"
    path.write_text(text)
    return path


def test_units_signs_zeros_and_sums(tmp_path):
    r = import_recording(layout(tmp_path), log(tmp_path))
    np.testing.assert_allclose(r.time, [0, 1e-3])
    np.testing.assert_allclose(r.motor_position, [0.5, 0.5 - np.pi / 2])
    np.testing.assert_allclose(np.diff(r.link_position), np.deg2rad(1))
    assert np.mean(r.link_position) == pytest.approx(0.1)
    np.testing.assert_allclose(r.motor_current, [0.1, 0.2])
    np.testing.assert_allclose(r.joint_torque, [2.0, 3.0])
    assert r.external_torque is None and r.external == "none" and r.joint == "test-joint"


def test_an_encoder_that_wraps_is_unwrapped(tmp_path):
    wraps = {"column": "m", "unit": "counts", "counts": 4096, "wraps": True}
    text = "t;m;l;i;fx;my;angle\n" + "".join(f"{k};{(k * 1000) % 4096};0;0;0;0;0\n" for k in range(20))
    r = import_recording(layout(tmp_path, **columns(motor_position=wraps)), log(tmp_path, text))
    np.testing.assert_allclose(np.diff(r.motor_position), 2 * np.pi * 1000 / 4096)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"columns": {"time": {"column": "t", "unit": "s"}}}, ["columns.motor_position: missing"]),
        (columns(motor_curent={"column": "i", "unit": "A"}), ["motor_curent", "did you mean 'motor_current'"]),
        (columns(motor_current={"column": "i", "unit": "amp"}), ["unit", "'amp'"]),
        (columns(motor_current={"column": "i", "unit": "rad"}), ["columns.motor_current.unit", "'A'"]),
        (columns(motor_position={"column": "m", "unit": "counts"}), ["counts"]),
        (columns(motor_current={"column": "i", "unit": "A", "sum": []}), ["either column or sum"]),
        (columns(external_torque={"column": "my", "unit": "N·m"}), ["external_torque", "'measured'"]),
    ],
)
def test_a_bad_mapping_is_named(tmp_path, changes, words):
    with pytest.raises(InputError) as error:
        layout(tmp_path, **changes)
    message = str(error.value)
    assert "mine.yaml" in message and "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    "text, words",
    [
        (LOG.replace(";angle", ";winkel"), ["'angle'", "missing", "link_position"]),
        (LOG.replace("5001", "4999"), ["'time'", "row 2"]),
        (LOG.replace(";200;", ";;"), ["'i'", "row 2"]),
        (LOG.replace(";200;", ";inf;"), ["'i'", "row 2"]),
        (LOG.splitlines()[0] + "\n", ["header alone"]),
        ("", ["empty"]),
    ],
)
def test_a_bad_log_is_named(tmp_path, text, words):
    with pytest.raises(InputError) as error:
        import_recording(layout(tmp_path), log(tmp_path, text))
    for word in ["log.csv", *words]:
        assert word in str(error.value)


def test_the_shipped_layouts_are_valid():
    assert "lara8" in known_layouts()
    for name in known_layouts():
        assert load_layout(name).name == name
    with pytest.raises(InputError, match="did you mean 'lara8'"):
        load_layout("lara9")
