"""Calibrate, then estimate (`python -m benchmarks calibrated`): on short motions, and one whole draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import calibrated
from flexspline.diagnosis.trials.draw import Challenge, Draw, draw

SHORT = """
format: 1
name: {mounting}
description: a short motion
joint: test-joint
mounting: {mounting}
duration: 2
trajectory:
  - {{time: 0.2, position: 0}}
  - {{time: 1.8, position: 0.3}}
"""


@pytest.fixture(scope="module", params=[False, True], ids=["ideal", "real"])
def one(request, tmp_path_factory) -> Draw:
    """A joint within its tolerances, without imperfections and with them, recorded for two short motions."""
    folder = tmp_path_factory.mktemp("scenarios")
    paths = []
    for mounting in ("no_load", "link"):
        paths.append(folder / f"{mounting}.yaml")
        paths[-1].write_text(SHORT.format(mounting=mounting), encoding="utf-8")
    return draw(Challenge(seed=calibrated.SEED, hidden="none", real=request.param, scenarios=tuple(map(str, paths))), 0)


def test_a_known_joint_has_smaller_errors(one: Draw, tmp_path: Path):
    names = ("momentum_torsion", "RAREKF")
    rows = calibrated.errors(one, one.nominal, names, ("none", False, 0, "", "consistent"), duration=8.0)
    assert len(rows) == len(names) * len(calibrated.SCENARIOS)
    for row in rows:
        assert row.exact_rms < row.before_rms, row
        # An unknown encoder offset makes it worse.
        assert row.estimator != "RAREKF" or row.before_rms < row.after_rms, row
    calibrated.write(tmp_path / "kept.csv", rows)
    assert repr(calibrated.read(tmp_path / "kept.csv")) == repr(rows)  # some never rest within 8 s: NaN
    results = calibrated.Results(rows)
    expected = np.exp(np.mean([np.log(r.exact_rms) for r in rows if r.estimator == "RAREKF"]))
    assert results.values("none", False, "RAREKF", "exact") == pytest.approx(expected)
    assert "1 joint with nothing hidden" in calibrated.tables(results, names)["calibrated about"]
    assert "`RAREKF`" in calibrated.kind_table(results, False, names)


def test_exact_knowledge_has_no_uncertainty(one: Draw):
    from flexspline.scenarios.experiment import Experiment
    from flexspline.scenarios.scenario import load_scenario

    experiment = Experiment.of(*load_scenario("link_sweep"))
    told = calibrated.known(one, one.nominal, experiment, one.records[1])
    assert told["exact"].friction == told["exact"].link_zero == told["exact"].spread.stiffness == 0.0
    assert told["exact"].p["K1"] == one.records[1][0]["K1"]
    assert told["before"].p["link_zero"] == one.records[1][0]["link_zero"]
    assert told["before"].spread.stiffness > 0.0 and told["after"].link_zero > 0.0


@pytest.mark.long
@pytest.mark.slow
def test_a_diagnosed_joint_is_nearly_exact():
    rows = calibrated.assessed("none", False, 0, ("RAREKF", "dynamics_ekf"))
    results = calibrated.Results(rows)
    for name in ("RAREKF", "dynamics_ekf"):
        before, after, exact = (results.values("none", False, name, k)[0] for k in calibrated.KNOWLEDGE)
        assert after < 0.3 * before and after < 2.0 * exact, (name, before, after, exact)
