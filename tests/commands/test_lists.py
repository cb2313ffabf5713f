"""Lists of what there is: every name with a line, readable in a narrow terminal, the same for programs."""

from __future__ import annotations

import json

import pytest

import flexspline as fs
from flexspline.scenarios.scenario import shipped_arms, shipped_scenarios
from flexspline.scenarios.studies.study import shipped_studies

KNOWN = {
    "joints": lambda: fs.joints().index,
    "causes": lambda: fs.causes().index,
    "estimators": lambda: fs.estimators().index,
    "scenarios": lambda: shipped_scenarios() | shipped_arms(),
    "studies": shipped_studies,
}


@pytest.mark.parametrize("what", KNOWN)
def test_every_name_stands_there_with_a_line(what, flexspline, capfd, monkeypatch):
    code, text, error = flexspline(what, "--json")
    assert code == 0, error
    entries = json.loads(text)
    assert set(entries) == set(KNOWN[what]())
    assert all(set(e) == {"kind", "description", "source"} and e["description"] for e in entries.values())
    monkeypatch.setattr("flexspline.commands._console._WIDTH", 80)
    monkeypatch.setenv("COLUMNS", "80")
    from flexspline import commands

    monkeypatch.setattr("sys.argv", ["flexspline", what])
    with pytest.raises(SystemExit):
        commands.main()
    shown = capfd.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    for name in entries:
        assert any(line.startswith(name) for line in shown.splitlines()), name
