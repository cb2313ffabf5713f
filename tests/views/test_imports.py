"""Views read results: nothing that simulates, fits or runs an experiment is loaded by them."""

from __future__ import annotations

import ast
from pathlib import Path

from flexspline import views

ALLOWED = {"models", "estimator"}
"""Rooms below: what a joint is, and equations to evaluate."""
QUIET = ("sim.native", "sim.shape")
"""MuJoCo's own library: shapes are read without its warnings. It steps nothing."""
ROOT = Path(views.__file__).parent


def loaded(file: Path) -> set[str]:
    """Modules of other rooms that a file imports when it runs, as `room.module`."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    outside = len(file.relative_to(ROOT).parts) + 1  # dots that lead out of views
    return {
        node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level == outside and node.module and id(node) not in typing_only
    }


def test_views_load_no_room_that_computes():
    found = {
        (file.relative_to(ROOT).as_posix(), module)
        for file in ROOT.rglob("*.py")
        for module in loaded(file)
        if module.split(".")[0] not in ALLOWED and module not in QUIET
    }
    assert found == set()
