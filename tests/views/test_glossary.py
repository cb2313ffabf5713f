"""Every symbol of a page has a meaning, and only symbols are found in texts."""

from __future__ import annotations

import pytest

from flexspline.models import causes
from flexspline.models.calibration import Calibration
from flexspline.models.joint import known_joints, load_joint
from flexspline.views.glossary import meaning, pieces


@pytest.mark.parametrize("name", sorted(known_joints()))
def test_every_number_that_calibration_moves_has_a_meaning(name):
    joint = load_joint(name)
    assert [slot.name for slot in Calibration(joint).slots if not meaning(slot.name)] == []
    assert [symbol for symbol in joint.numbers if not meaning(symbol)] == []


def test_orders_of_the_kinematic_error():
    assert meaning("A2") == "amplitude of the gear's kinematic error, 2 times per turn of the wave generator"
    assert meaning("φ1") == "phase of the gear's kinematic error, once per turn of the wave generator"
    text = "amplitude of the gear's kinematic error, 1.9802 times per turn of the wave generator; a quarter of a period further"
    assert meaning("A1.9802′") == text
    assert meaning("Apple") == "" and meaning("") == ""


def test_symbols_in_a_text_and_nothing_else():
    text = causes.get("stiffness").description
    assert "".join(piece for piece, _ in pieces(text)) == text
    assert [piece for piece, words in pieces(text) if words] == ["K1", "K2", "K3"]
    assert [piece for piece, words in pieces("a cable pulls: −k (θl − θ0), |Tf|/N") if words] == ["θl", "Tf"]
    assert [piece for piece, words in pieces("at the end: A1.9802′, φ2.") if words] == ["A1.9802′", "φ2"]
    assert pieces("A link, N times") == [("A link, N times", "")]
