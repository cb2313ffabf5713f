"""The gear catalogue: makers' numbers, trends between and outside them, and the joints of all gears."""

from __future__ import annotations

import itertools

import pytest

from flexspline.models.catalogue import RATIOS, SERIES, SIZES, gear
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.joint_check import check


def test_numbers_that_other_sources_state():
    """LARA8's data sheet (size 25, 101:1), the paper's joint (SHD-17-100, 16 N·m), public quotes of CSG-20-160 and CSG-25-100."""
    lara8 = load_joint("lara8-joint3").numbers
    found = gear("CSG", 25, 100)
    assert found.stiffness == pytest.approx([lara8[k].value for k in ("K1", "K2", "K3")])
    assert found.breakpoints == pytest.approx((lara8["T1"].value, lara8["T2"].value))
    assert (found.rated_torque, found.peak_torque) == pytest.approx((87, 204))
    shd, test = gear("SHD", 17, 100), load_joint("test-joint").numbers
    assert shd.rated_torque == pytest.approx(16)
    assert shd.stiffness == pytest.approx([test[k].value for k in ("K1", "K2", "K3")])
    assert (gear("CSG", 20, 160).rated_torque, gear("CSG", 20, 160).peak_torque) == pytest.approx((52, 120))


@pytest.mark.parametrize("series", SERIES)
def test_numbers_grow_with_size_and_are_ordered(series):
    for ratio in (*RATIOS, 30, 65, 200):
        row = [gear(series, size, ratio) for size in (8, 11, *SIZES, 45, 65)]
        for a, b in itertools.pairwise(row):
            assert a.rated_torque < b.rated_torque and a.inertia < b.inertia and a.breakpoints < b.breakpoints
            assert all(x < y for x, y in zip(a.stiffness, b.stiffness, strict=True))
        for one in row:
            assert one.stiffness[0] <= one.stiffness[1] <= one.stiffness[2]
            assert one.rated_torque < one.peak_torque


def test_tabulated_gears_are_exact():
    assert gear("CSG", 25, 100).exact and not gear("CSG", 25, 101).exact and not gear("CSG", 22, 100).exact
    assert gear("LCSG", 25, 100).like == "CSG" and gear("csg", 25, 100).name == "CSG-25-100"


@pytest.mark.parametrize(
    ("asked", "expected"), [(("CSQ", 25, 100), "did you mean"), (("CSG", 5, 100), "size"), (("CSG", 25, 10), "ratio")]
)
def test_impossible_gears_are_refused(asked, expected):
    with pytest.raises(InputError, match=expected):
        gear(*asked)


@pytest.mark.parametrize("size", SIZES)
def test_every_gear_makes_a_joint_that_is_plausible(tmp_path, size):
    """With a motor as strong as the gear: no filled number is unusual."""
    from flexspline.models.datasheet import write_joint

    for series in ("CSF", "CSG", "CSD"):
        for ratio in RATIOS:
            one = gear(series, size, ratio)
            torque = one.rated_torque / ratio  # 4 A
            numbers = {"Kt": torque / 4, "R": 1.0, "L": 1e-3, "Jm": 2.0 * one.inertia}
            sheet = Datasheet(series, size, ratio, numbers, {"counts": 16384}, {"bits": 20})
            made = new_joint(sheet, tmp_path / "joint.yaml")
            write_joint(made.joint, tmp_path / "joint.yaml")
            checked = check(tmp_path / "joint.yaml")
            odd = [p for p in checked.problems if "time constant" not in p.message]  # the motor is nobody's
            assert not odd, (series, size, ratio, odd)
            assert checked.joint is not None and checked.joint.model_dump() == made.joint.model_dump()


@pytest.mark.parametrize(("tolerances", "common"), [({}, 0.2), ({"Fc": 1.5}, 1.5)])
def test_a_given_coulomb_friction_also_gives_the_static_friction(tolerances, common):
    """A servo's gear with the catalogue's starting torque would take 100 times its sliding friction to break away."""
    numbers = {"Kt": 1.2e-3, "R": 3.4, "L": 5e-4, "Jm": 1e-8, "Fc": 1e-4}
    joint = new_joint(Datasheet("CSG", 14, 100, numbers, {"counts": 4096}, {"bits": 12}, tolerances=tolerances)).joint
    assert joint.numbers["Fs"].value == pytest.approx(1.25e-4)
    assert joint.shared_tolerances["friction"] == common
    assert joint.numbers["Fs"].shared == joint.numbers["Fc"].shared == "friction"
