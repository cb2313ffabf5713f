"""Units are compared, not their spellings."""

from __future__ import annotations

import pytest

from flexspline.models import units


@pytest.mark.parametrize(
    ("unit", "spellings"),
    [
        ("N·m", ["Nm", "N*m", "N.m", "N m".replace(" ", "·"), "N⋅m", " N·m "]),
        ("N·m/rad", ["Nm/rad", "N*m/rad"]),
        ("N·m·s/rad", ["Nms/rad", "Nm·s/rad", "Nm*s/rad", "N*m*s/rad"]),
        ("N·m/A", ["Nm/A"]),
        ("N·m/s", ["Nm/s"]),
        ("kg·m²", ["kgm²", "kg*m^2", "kg.m²", "kgm^2", "kgm2", "kg·m2", "kg m2"]),
        ("mN·m", ["mNm", "mN*m"]),
        ("rad/s²", ["rad/s^2", "rad/s2"]),
        ("1/(N·m)", ["1/(Nm)", "1/(N*m)"]),
        ("1/K", ["1/(K)"]),
        ("1", ["", " "]),
        ("ohm", ["Ω", "\u2126"]),
        ("°C", ["°C"]),
    ],
)
def test_the_same_unit(unit, spellings):
    for spelling in spellings:
        assert units.same(unit, spelling) and units.same(spelling, unit), spelling


@pytest.mark.parametrize(
    ("a", "b"),
    [("N·m", "N·mm"), ("N·m", "Nmm"), ("rad", "deg"), ("A", "mA"), ("N·m", "mNm"), ("s", "ms"), ("N·m", "N/m"),
     ("kg·m²", "g·cm²"), ("kg·m²", "kg·m³"), ("kg·m²", "kgm"), ("N·m", "kNm"), ("mN·m", "Nmm"),
     ("N·m/rad", "N·m·rad"), ("1", "%")],
)  # fmt: skip
def test_another_unit(a, b):
    assert not units.same(a, b)
