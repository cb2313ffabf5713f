"""The paper's claims (`python -m benchmarks claims`), over one draw of every experiment."""

from __future__ import annotations

import pandas as pd
import pytest

from benchmarks import claims
from benchmarks.estimators import SCENARIOS, drawn
from benchmarks.pages import ROOT


@pytest.mark.slow
def test_claims_are_measured_with_every_setting():
    rows = pd.DataFrame(row for s in SCENARIOS for row in claims.examine(s, drawn(s, 0.0, 101, None)))
    mean = claims.means(rows).sort_index()
    assert len(mean) == len(rows) == len(SCENARIOS) * 4 * 4 * 2 * 2
    page = (
        pd.read_csv(ROOT / "docs" / "paper.csv", dtype=dict.fromkeys(claims.KEY, str))
        .set_index(claims.KEY)
        .sort_index()
    )
    pd.testing.assert_index_equal(mean.index, page.index)
    setting = ("exact", "max", "1e-2", "1e-4")
    assert mean.loc[setting]["rms"].to_numpy() == pytest.approx(page.loc[setting]["rms"].to_numpy(), rel=0.5)
    for table in (claims.claim_table, claims.calibration_table, claims.mode_table, claims.error_table):
        assert len(table(rows).splitlines()) == 2 + 8
