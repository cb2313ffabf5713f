"""The table of numbers in docs/diagnosis.md is that of the program."""

import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "diagnosis.md"
ROWS = re.findall(
    r"^\| `([\w.]+)\.([A-Z_]+)(?:\.(\w+))?` \| ([\d., ]+?)(?: s)? \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE
)


def test_at_most_forty_numbers_decide():
    assert 30 < len(ROWS) <= 40


@pytest.mark.parametrize(("module", "name", "field", "value"), ROWS)
def test_a_number_is_as_documented(module, name, field, value):
    found = getattr(import_module(f"flexspline.diagnosis.{module}"), name)
    found = getattr(found, field) if field else found
    np.testing.assert_array_equal(np.ravel(found), [float(x) for x in value.split(",")])
