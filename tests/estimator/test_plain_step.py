"""A step of records, compiled or left in plain Python: the same numbers over signals and in the loop."""

from __future__ import annotations

import numpy as np
import pytest

import flexspline as fs
from flexspline.estimator import FilterDiverged, registry
from flexspline.models import plugins

PLUGIN = """
from dataclasses import dataclass
import numpy as np
from flexspline.estimator import CausalEstimator, step_of

MEMORY = np.dtype([("level", float), ("last", float, 3), ("count", float)])


def _step(m, s, p, c, o):
    m.last[int(m.count) % 3] = p.Kt * p.N * s.motor_current
    m.count += 1.0
    m.level += min(c.corner * c.interval, 1.0) * (m.last.mean() - m.level)
    o.torque, o.spread = m.level, m.last.max() - m.last.min()
    return 0 if np.isfinite(m.level) else 1


@dataclass(frozen=True)
class Compiled(CausalEstimator):
    name: str = "fast"
    corner: float = 20.0
    compiled = step_of(MEMORY, ("corner", "interval"), ("torque", "spread"))(_step)


@dataclass(frozen=True)
class Plain(CausalEstimator):
    name: str = "plain"
    corner: float = 20.0
    compiled = step_of(MEMORY, ("corner", "interval"), ("torque", "spread"), plain=True)(_step)


@dataclass(frozen=True)
class Failing(CausalEstimator):
    name: str = "failing"
    compiled = step_of(MEMORY, plain=True)(lambda m, s, p, c, o: 1 // int(s.time < 0.01) - 1)


ESTIMATORS = (Compiled(), Plain(), Failing())
"""


@pytest.fixture(scope="module", autouse=True)
def plugin(tmp_path_factory):
    path = tmp_path_factory.mktemp("plugin") / "plain_steps.py"
    path.write_text(PLUGIN, encoding="utf-8")
    fs.load_plugin(path)
    yield path
    plugins.forget(path)


def test_the_list_says_that_it_is_slow(flexspline, plugin):
    code, out, error = flexspline("estimators", "--plugin", plugin)
    assert code == 0, error
    found = {
        line.split()[0]: line for line in out.splitlines() if line.split() and line.split()[0] in ("fast", "plain")
    }
    assert "plain Python: slow" in found["plain"] and "slow" not in found["fast"]


def test_plain_python_gives_the_compiled_steps_bits():
    assert registry.get("plain").costly and not registry.get("fast").costly
    filters = ["fast", "plain", {"name": "quick", "estimator": "plain", "corner": 200.0}]
    runs = [
        fs.simulate("external_push", duration=1.5, seed=5, filters=filters, feedback=name) for name in ("fast", "plain")
    ]
    for run in runs:
        fast, plain = run.estimates["fast"], run.estimates["plain"]
        assert np.array_equal(fast.mean, plain.mean) and np.ptp(fast.mean) > 0.01
        assert np.array_equal(fast.columns["spread"], plain.columns["spread"])
        assert not np.array_equal(plain.mean, run.estimates["quick"].mean)
    assert np.array_equal(runs[0].truth("joint_torque"), runs[1].truth("joint_torque"))


@pytest.mark.parametrize("feedback", ["none", "failing"])
def test_a_failure_in_plain_python_is_reported(feedback):
    with pytest.raises(FilterDiverged, match=r"'failing' .*t = 0\.01 s.* its step failed: ZeroDivisionError"):
        fs.simulate("external_push", duration=1.5, filters=["failing"], feedback=feedback)
