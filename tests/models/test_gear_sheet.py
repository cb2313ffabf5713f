"""A joint whose friction is fitted to its gear's data sheet."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import yaml

import flexspline as fs
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.gear_sheet import GearSheet, comparison

N, Fs, Fc, vs, bw, exponent = 100.0, 0.09, 0.07, 3.0, 9e-4, 0.6
load_friction, back_driven, per_kelvin = 0.2, 0.35, -0.008
SPEEDS = [5.0, 15.0, 30.0, 60.0, 200.0, 500.0, 1000.0, 2000.0, 3500.0]  # 1/min
NAME = "Schaeffler TPI 275, RT1-H-CS"
PUBLIC = {  # size: rated torque, efficiency, running torque at 2000 rpm, starting torque, back-driving torque; ratio 100, 20 °C
    14: (10.0, 0.67, 0.035, 0.021, 2.21), 17: (31.0, 0.77, 0.051, 0.029, 3.06),
    20: (52.0, 0.77, 0.105, 0.037, 3.89), 25: (87.0, 0.77, 0.195, 0.069, 7.26),
}  # fmt: skip


def made(sheet: GearSheet | None, size: float = 25.0, **numbers: float):
    drive = {"Kt": 0.1754, "R": 0.651, "L": 1e-3, "Jm": 5e-5}
    bits = {"bits": 20}
    return new_joint(Datasheet("CSG", size, N, drive | numbers, bits, bits, gear=sheet)).joint


def friction(rpm: float, load: float, temperature: float) -> float:
    """The laws, written a second time [N·m, motor side]."""
    w = rpm * math.pi / 30
    sliding = Fc + (Fs - Fc) * math.exp(-((w / vs) ** 2)) + load_friction * load / N
    viscous = bw * w * (1 + (w / (20 * vs)) ** 2) ** ((exponent - 1) / 2)
    return (1 + per_kelvin * (temperature - 25)) * (sliding + viscous)


def table(rng: np.random.Generator | None = None, scatter: float = 0.0) -> GearSheet:
    """A data sheet of these laws, with a log-normal scatter of every friction torque."""

    def read(value: float) -> float:
        return value if rng is None else value * math.exp(scatter * rng.standard_normal())

    def efficiency(rpm: float, load: float) -> float:
        return load / (load + N * read(friction(rpm, load, 20.0)))

    warm = 1 + per_kelvin * (20 - 25)
    return GearSheet.model_validate(
        {
            "source": "a table", "scatter": 0.2, "starting_torque": read(warm * Fs),
            "running_torque": [
                {"temperature": t, "speed": SPEEDS, "torque": [read(friction(s, 0, t)) for s in SPEEDS]}
                for t in (0.0, 20.0, 40.0)
            ],
            "efficiency": [
                {"load": load, "speed": SPEEDS[5:], "efficiency": [efficiency(s, load) for s in SPEEDS[5:]]}
                for load in (40.0, 87.0)
            ],
            "back_driving_torque": N * read(warm * Fs) / (1 - warm * back_driven),
        }
    )  # fmt: skip


def test_the_fit_recovers_the_laws_of_a_table():
    joint = made(table())
    n = joint.numbers
    for symbol, value in {"Fs": Fs, "Fc": Fc, "vs": vs, "bw": bw, "viscous_exponent": exponent}.items():
        assert n[symbol].value == pytest.approx(value, rel=0.05), symbol
        assert n[symbol].source == "fitted to a table" and 0 < n[symbol].tolerance < 0.2, symbol
    effects = {effect.name: effect.values for effect in joint.effects}
    assert set(effects) == {"back_driving", "friction_temperature"}
    assert effects["back_driving"]["coefficient"] == pytest.approx(load_friction, rel=0.05)
    assert effects["back_driving"]["back_driven"] == pytest.approx(back_driven, rel=0.1)
    assert effects["friction_temperature"]["coefficient"] == pytest.approx(per_kelvin, rel=0.05)
    found = comparison(joint, table())
    assert found["residual"] < 0.01 and len(found["gear_sheet"]) == len(table().entries())


def test_a_table_with_scatter_gives_tolerances_of_that_scatter():
    truth = {"Fs": Fs, "Fc": Fc, "bw": bw}
    clean = made(table())
    errors = []
    for seed in range(6):
        joint = made(table(np.random.default_rng(seed), 0.2))
        assert joint.shared_tolerances["friction"] == 0.2
        for symbol, value in truth.items():
            one = joint.numbers[symbol]
            if one.source.startswith("fitted"):
                assert one.tolerance > 2 * clean.numbers[symbol].tolerance, symbol
                errors.append(math.log(one.value / value) / math.log1p(one.tolerance))
    assert len(errors) > 12
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.8 and np.abs(errors).max() < 3.5


def test_what_a_data_sheet_does_not_determine_keeps_its_rule():
    ruled, joint = made(None), made(GearSheet(source="a sheet", starting_torque=0.1, scatter=0.3))
    assert joint.numbers["Fs"].value == pytest.approx(0.1, rel=0.01)
    assert joint.shared_tolerances["friction"] == 0.3 and not joint.effects
    assert joint.numbers["Fc"].value == pytest.approx(0.08, rel=0.01)  # 0.8 Fs
    for symbol, number in joint.numbers.items():
        assert number.source.startswith("fitted") == (symbol == "Fs"), symbol
        if symbol not in ("Fs", "Fc", "s0", "s1", "bw", "bm", "current_limit"):
            assert number == ruled.numbers[symbol], symbol
    kept = made(GearSheet(source="a sheet", starting_torque=0.1), Fs=0.05)
    assert kept.numbers["Fs"].value == 0.05 and not kept.numbers["Fs"].source.startswith("fitted")


def test_hysteresis_widens_the_slow_loop_to_the_loss():
    sheet = GearSheet(source="a sheet", hysteresis_loss=1.0)
    joint = made(sheet)
    (row,) = comparison(joint, sheet)["gear_sheet"]
    assert row["predicted"] == pytest.approx(1.0, rel=0.01)
    assert [effect.name for effect in joint.effects] == ["hysteresis"]
    narrow = GearSheet(source="a sheet", hysteresis_loss=0.05)
    assert not made(narrow).effects and "no effect added" in comparison(made(narrow), narrow)["notes"][0]


def test_a_wrong_unit_is_a_note():
    sheet = GearSheet.model_validate(GOOD | {"running_torque": [{"speed": [500, 2000], "torque": [130, 0.195]}]})
    (note,) = comparison(made(sheet), sheet)["notes"]
    assert "check N·m" in note


def public(size: int, efficiency: bool) -> GearSheet:
    load, share, running, starting, back = PUBLIC[size]
    curves = [{"speed": [2000.0], "load": load, "efficiency": [share]}]
    return GearSheet.model_validate(
        {
            "source": NAME, "running_torque": [{"speed": [2000.0], "torque": [running]}], "starting_torque": starting,
            "back_driving_torque": back, "efficiency": curves if efficiency else [],
        }
    )  # fmt: skip


def test_public_data_sheets_are_predicted_within_three_points_of_efficiency():
    """The efficiency of each size is predicted from its no-load torques and the load-dependent friction of other sizes."""
    coefficient = {}
    for size in PUBLIC:
        joint = made(public(size, efficiency=True), size)
        for row in comparison(joint, public(size, efficiency=True))["gear_sheet"]:
            assert abs(row["error"]) < (0.5 if row["entry"] == "efficiency" else 3), row
        (effect,) = joint.effects
        coefficient[size] = effect.values["coefficient"]
    for size, (load, share, *_) in PUBLIC.items():
        joint = made(public(size, efficiency=False), size)
        others = np.mean([value for other, value in coefficient.items() if other != size])
        before = comparison(joint, public(size, efficiency=True))["gear_sheet"]
        (without,) = (row["predicted"] for row in before if row["entry"] == "efficiency")
        predicted = 1 / (1 / without + others)
        assert abs(100 * (predicted - share)) < 3, (size, load)


GOOD = {"source": "a sheet", "running_torque": [{"speed": [500, 1000], "torque": [0.1, 0.12]}]}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"efficiency": [{"speed": [500], "load": 80, "efficiency": [-0.1]}]}, "expected a share between 0 and 1"),
        ({"efficiency": [{"speed": [500], "load": 80, "efficiency": [77]}]}, "(0.77 for 77 %), got 77"),
        (
            {"efficiency": [{"speed": [500], "load": 0, "efficiency": [0.7]}]},
            "efficiency.0.load: expected greater than 0",
        ),
        ({"running_torque": [{"speed": [1000, 500], "torque": [0.1, 0.1]}]}, "expected ascending speeds, got"),
        ({"running_torque": [{"speed": [500, 1000], "torque": [0.1]}]}, "torque: expected a value per speed, 2, got 1"),
        (
            {"running_torque": [{"speed": [500], "torque": [-0.1]}]},
            "running_torque.0.torque.0: expected greater than 0",
        ),
        ({"scatter": 20}, "scatter: expected less than 1, got 20"),
        ({"runing_torque": []}, "did you mean 'running_torque'?"),
        ({"running_torque": []}, "expected running_torque, efficiency or another entry"),
        ({"hysteresis_loss": 400}, "hysteresis_loss: expected at most"),
    ],
)
def test_a_wrong_data_sheet_is_one_line(flexspline, tmp_path, changes, expected):
    path = tmp_path / "gear.yaml"
    path.write_text(yaml.safe_dump(GOOD | changes))
    out = tmp_path / "joint.yaml"
    code, text, error = flexspline("joint", "new", *OPTIONS, "--gear-sheet", str(path), "--out", str(out))
    assert code == 2 and text == "" and error.count("\n") == 1
    assert expected in error
    assert not out.exists()


OPTIONS = (
    "--gear", "CSG-25-100", "--torque-constant", "0.1754", "--resistance", "0.651", "--inductance", "1 mH",
    "--rotor-inertia", "5e-5", "--motor-encoder", "16 bit", "--link-encoder", "20 bit",
)  # fmt: skip


def test_new_and_show_compare_the_joint_with_the_data_sheet(flexspline, tmp_path):
    path, out, image = tmp_path / "gear.yaml", tmp_path / "joint.yaml", tmp_path / "joint.png"
    path.write_text(yaml.safe_dump(GOOD | {"source": "a sheet", "ratcheting_torque": 150}))
    code, text, error = flexspline("joint", "new", *OPTIONS, "--gear-sheet", str(path), "--out", str(out))
    assert code == 0, error
    assert "Predictions and a sheet" in text and "can make the gear ratchet" in " ".join(text.split())
    code, text, error = flexspline("joint", "show", str(out), "--gear-sheet", str(path), "--json")
    assert code == 0, error
    rows = json.loads(text)["gear_sheet"]
    assert [row["stated"] for row in rows] == [0.1, 0.12] and all(abs(row["error"]) < 5 for row in rows)
    code, text, error = flexspline("joint", "show", str(out), "--gear-sheet", str(path), "--out", str(image))
    assert code == 0, error
    assert "running torque [N·m]" in text and max(map(len, text.splitlines()[:-1])) <= 80
    assert image.read_bytes().startswith(b"\x89PNG")


def test_the_figure_has_the_joints_curve_through_each_curve_of_the_data_sheet():
    """Running torque at each temperature, efficiency at each speed: points of the sheet, and the joint's own curve."""
    from flexspline.models.characteristics import characteristics
    from flexspline.views.figures.joint import joint_figure

    joint = fs.load_joint("csg-25-100-tbm2g")
    sheet = GearSheet.model_validate(
        {
            "source": "a sheet",
            "running_torque": [{"speed": [500, 2000], "torque": [0.06, 0.08], "temperature": t} for t in (20, 0)],
            "efficiency": [{"speed": [500, 2000], "load": load, "efficiency": [0.7, 0.65]} for load in (20, 51)],
        }
    )
    axes = {
        a.get_title(loc="left"): a
        for a in joint_figure(joint, characteristics(joint), {w: ["cogging"] for w in "abc"}, sheet).axes
    }
    for title, points in (("Friction", 2), ("Efficiency of driving", 2)):
        lines = axes[title].lines
        dots = [line for line in lines if line.get_marker() == "o"]
        curves = [line for line in lines if line.get_linestyle() == "--"]
        assert [len(line.get_xdata()) for line in dots] == [points, points] and len(curves) == 2
    row = next(r for r in comparison(joint, sheet)["gear_sheet"] if r["at"].startswith("2000 rpm, 51 N·m"))
    curve = [line for line in axes["Efficiency of driving"].lines if line.get_linestyle() == "--"][1]
    assert np.interp(51, curve.get_xdata(), curve.get_ydata()) == pytest.approx(100 * row["predicted"], abs=0.2)
