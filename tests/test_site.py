"""The site is built without a warning, and has the generated pages."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
@pytest.mark.long  # `make docs` builds it, too
def test_the_site_is_built_and_has_the_reference(tmp_path):
    pytest.importorskip("mkdocs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    site = tmp_path / "site"
    pages = {path.parent.relative_to(site).as_posix() for path in site.rglob("index.html")}
    assert {
        "first_hour",
        "theory",
        "planning",
        "cluster",
        "examples",
        "reference/modules",
        "reference/python",
        "reference/scenario",
    } <= pages
    commands = (site / "reference" / "commands" / "index.html").read_text(encoding="utf-8")
    assert "flexspline report before after" in commands and "--json" in commands
    python = (site / "reference" / "python" / "index.html").read_text(encoding="utf-8")
    assert "Compare estimators on identical signals." in python
    schema = json.loads((site / "schemas" / "scenario.schema.json").read_text(encoding="utf-8"))
    assert "trajectory" in schema["properties"]
    assert not list(site.glob("*.py")) and not list(site.glob("*.csv"))
