"""Files are moved into place when they are complete; what cannot be written is one line."""

from __future__ import annotations

import os
from contextlib import contextmanager

import pytest

from flexspline.models.errors import InputError
from flexspline.models.files import folder_into_place, write_into_place

NOBODY = 65534


@contextmanager
def without_rights(folder):
    """Nobody may enter the folder: neither its owner nor, where the tests run as root, root."""
    root = os.geteuid() == 0
    folder.chmod(0)
    try:
        if root:
            os.seteuid(NOBODY)
        yield
    finally:
        if root:
            os.seteuid(0)
        folder.chmod(0o755)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="needs POSIX rights")
@pytest.mark.parametrize("write", [write_into_place, folder_into_place])
@pytest.mark.parametrize("below", ["x", "x/y"])
def test_a_folder_without_rights_is_one_line(tmp_path, write, below):
    closed = tmp_path / "closed"
    closed.mkdir()
    with without_rights(closed), pytest.raises(InputError) as caught, write(closed / below):
        raise AssertionError("not reached")
    assert "Permission denied" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(closed.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="needs POSIX rights")
def test_a_folder_that_cannot_be_listed_is_one_line(tmp_path):
    (tmp_path / "mine").mkdir()
    with without_rights(tmp_path / "mine"), pytest.raises(InputError), folder_into_place(tmp_path / "mine"):
        raise AssertionError("not reached")


def test_written_when_complete(tmp_path):
    with write_into_place(tmp_path / "a" / "b.txt") as path:
        path.write_text("new")
        assert not (tmp_path / "a" / "b.txt").exists()
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b.txt"]
    with pytest.raises(ZeroDivisionError), write_into_place(tmp_path / "a" / "b.txt") as path:
        path.write_text("half")
        1 / 0  # noqa: B018
    assert (tmp_path / "a" / "b.txt").read_text() == "new"
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b.txt"]


def test_folder_is_replaced_as_a_whole_or_not_at_all(tmp_path):
    with folder_into_place(tmp_path / "run") as folder:
        (folder / "one").touch()
    with pytest.raises(ZeroDivisionError), folder_into_place(tmp_path / "run") as folder:
        (folder / "two").touch()
        1 / 0  # noqa: B018
    assert {p.name for p in (tmp_path / "run").iterdir()} == {"one", ".flexspline"}
    with folder_into_place(tmp_path / "run") as folder:
        (folder / "three").touch()
    assert {p.name for p in (tmp_path / "run").iterdir()} == {"three", ".flexspline"}
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
