"""Findings whose parameters state nothing are not listed."""

from __future__ import annotations

import pytest

from flexspline.diagnosis.answer import Finding, ParameterEstimate


@pytest.mark.parametrize(
    ("parameters", "determined"),
    [
        ({"amplitude": (1e-3, 1e-5), "phase": (0.4, 0.02), "order": (2.0, 0.0)}, True),
        ({"amplitude": (1e-3, 1e-5), "phase": (0.4, 36.0), "order": (2.0, 0.0)}, False),
        ({"amplitude": (1e-6, 3e-5), "phase": (0.4, 0.1), "order": (2.0, 0.0)}, False),
        ({"scale": (1.4, 0.1)}, True),
        ({"gap": (-2e-4, 1e-4)}, True),
        ({"gap": (0.0, 1e-4)}, False),
        ({"level": (1e-6, 3e-5), "rate": (3.0, 0.2)}, True),
        ({}, True),
    ],
)
def test_a_finding_is_determined_where_its_parameters_state_something(parameters, determined):
    estimates = {name: ParameterEstimate(value, std, "") for name, (value, std) in parameters.items()}
    assert Finding("cogging", "motor", 0.9, estimates, 0.5, 0.1).determined is determined
