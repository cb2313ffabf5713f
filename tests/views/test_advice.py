"""What a finding means on the machine: every cause has a sentence, an origin, a check and a remedy."""

from __future__ import annotations

import pytest

from flexspline.diagnosis.answer import Finding, ParameterEstimate
from flexspline.models import causes
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Effect, Estimate
from flexspline.views.advice import UNDETERMINED, advice, parameter_text


def finding(name: str, std: float = 1e-6, **values: float) -> Finding:
    parameters = {
        q.name: ParameterEstimate(values.get(q.name, 1.0 if q.integer else 0.5 * sum(q.ordinary[0])), std, q.unit)
        for q in causes.get(name).parameters
    }
    return Finding(name, causes.get(name).component, 0.9, parameters, 0.9, 0.1)


@pytest.mark.parametrize("name", causes.names())
def test_every_cause_has_advice(name):
    found = advice(finding(name), load_joint("test-joint"))
    assert found.typical and found.check and found.do
    assert "{" not in found.sentence and "determine" not in found.sentence
    assert found.sentence[0].islower() or found.sentence[0].isdigit()


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("backlash", {"width": 2.9e-4}, "1 arcmin of backlash"),
        ("stiffness", {"scale": 0.8}, "20 % below the described value"),
        ("encoder_delay", {"seconds": 5e-3}, "late by 5 ms"),
        ("cogging", {"amplitude": 8e-3, "order": 2}, "(5 % of the rated torque), 2 times per turn"),
        ("gravity_direction", {"angle": 0.1}, "differs by 5.7°"),
        ("payload", {"mass": 1.5}, "1.5 kg more"),
    ],
)
def test_values_are_in_everyday_units(name, value, text):
    assert text in advice(finding(name, **value), load_joint("test-joint")).sentence


def test_a_parameter_without_information_is_not_a_number():
    joint, loose = load_joint("test-joint"), finding("cogging", std=36.0)
    assert [parameter_text(name, loose, joint) for name in ("amplitude", "phase")] == [UNDETERMINED] * 2
    assert "these data do not determine" in advice(loose, joint).sentence
    assert parameter_text("phase", finding("cogging", std=0.1, phase=1.0), joint) == "1.00 ± 0.10 rad"


def test_a_number_is_compared_with_the_joint_without_the_finding():
    """The extended joint has the effect in it: an effect of its own size away from that is none."""
    joint = load_joint("test-joint")
    bw = joint.numbers["bw"].value
    found = finding("viscous_friction", std=0.1 * bw, coefficient=5 * bw)
    value = {"coefficient": Estimate(value=5 * bw, unit="N·m·s/rad")}
    extended = joint.model_copy(update={"effects": [Effect(name="viscous_friction", parameters=value)]})
    assert advice(found, extended) == advice(found, joint)
    assert parameter_text("coefficient", found, extended) != UNDETERMINED
