"""Calibrate, then estimate (`python -m benchmarks calibrated`): on short motions, and one whole draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks import calibrated, kept
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
    rows = pd.DataFrame(calibrated.errors(one, one.nominal, names, duration=8.0))
    assert len(rows) == len(names) * len(calibrated.SCENARIOS)
    assert (rows.exact_rms < rows.before_rms).all()
    filtered = rows[rows.estimator == "RAREKF"]
    assert (filtered.before_rms < filtered.after_rms).all(), "an unknown encoder offset makes it worse"
    rows = rows.assign(hidden="none", real=False, draw=0, cause="", named="consistent")
    expected = np.exp(np.mean(np.log(filtered.exact_rms)))
    assert calibrated.values(rows, "none", False, "RAREKF", "exact") == pytest.approx(expected)
    assert "1 joint with nothing hidden" in calibrated.tables(rows, names)["calibrated about"]
    assert "`RAREKF`" in calibrated.kind_table(rows, False, names)


def cubes(kind: str, size: int) -> kept.Rows:
    """Rows of a draw."""
    return [{"kind": kind, "size": size, "power": p, "value": size**p if p else np.nan} for p in (3, 0)]


@pytest.mark.slow
def test_draws_that_are_kept_are_not_computed_again(tmp_path: Path):
    wanted, order = [("b", 2), ("", 1)], {"kind": ("b", ""), "size": None, "power": None}
    path = tmp_path / "kept.csv"
    first = kept.completed(path, cubes, wanted[:1], ("kind", "size"), order)
    assert first.power.tolist() == [0, 3] and first.value.tolist()[1] == 8.0
    path.write_text(path.read_text().replace("8.0", "9.0"))
    both = kept.completed(path, cubes, wanted, ("kind", "size"), order)
    assert both.kind.tolist() == ["b", "b", "", ""] and both.value.tolist()[1] == 9.0
    again = kept.completed(path, cubes, wanted, ("kind", "size"), order)
    pd.testing.assert_frame_equal(again, both.reset_index(drop=True))


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
    rows = pd.DataFrame(calibrated.assessed("none", False, 0, ("RAREKF", "dynamics_ekf")))
    for name in ("RAREKF", "dynamics_ekf"):
        before, after, exact = (calibrated.values(rows, "none", False, name, k)[0] for k in calibrated.KNOWLEDGE)
        assert after < 0.3 * before and after < 2.0 * exact, (name, before, after, exact)
