"""Folders that commands write to: other files stay, and output is complete or absent."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from flexspline.models import output
from flexspline.models.errors import InputError
from flexspline.models.output import MANIFEST, check_output, made_from, manifest, output_folder, recover


def write(path, files, maker="run", **options):
    with output_folder(path, maker, **options) as folder:
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)


def content(path):
    return {
        p.relative_to(path).as_posix(): p.read_text() for p in path.rglob("*") if p.is_file() and p.name != MANIFEST
    }


def test_output_is_complete_or_absent(tmp_path):
    out = tmp_path / "a" / "out"
    write(out, {"one": "1", "sub/two": "2"}, whole=True)
    with pytest.raises(ZeroDivisionError), output_folder(out, "run", whole=True) as folder:
        (folder / "one").write_text("half")
        1 / 0  # noqa: B018
    assert content(out) == {"one": "1", "sub/two": "2"}
    write(out, {"three": "3"}, whole=True)
    assert content(out) == {"three": "3"} and manifest(out) == {"three": "run"}
    assert sorted(p.name for p in out.iterdir()) == [MANIFEST, "three"]


def test_nothing_is_left_of_what_fails(tmp_path):
    with pytest.raises(ZeroDivisionError), output_folder(tmp_path / "a" / "b", "run", whole=True):
        1 / 0  # noqa: B018
    assert not list(tmp_path.iterdir())


def test_a_persons_own_files_stay(tmp_path):
    out = tmp_path / "out"
    write(out, {"one": "1", "sub/two": "2"}, whole=True)
    (out / "notes.md").write_text("mine")
    (out / "sub" / "notes.md").write_text("mine, too")
    write(out, {"one": "new"}, whole=True)
    assert content(out) == {"one": "new", "notes.md": "mine", "sub/notes.md": "mine, too"}
    with pytest.raises(InputError, match=r"notes\.md: expected no file.*your own"):
        write(out, {"one": "newer", "notes.md": "not mine"}, whole=True)
    assert content(out)["one"] == "new"


def test_refused_before_the_work(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "a.csv").write_text("measured")
    cases = {
        "other files": ((tmp_path,), {"whole": True}),
        "a link": ((tmp_path / "link",), {"within": tmp_path / "data"}),
        "a.csv: expected no file": ((tmp_path / "data",), {"writes": ["a.csv"]}),
        "expected a file inside": ((tmp_path / "data",), {"writes": ["../a"]}),
        "got a file": ((tmp_path / "data" / "a.csv",), {"whole": True}),
    }
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").mkdir()
    for words, (arguments, options) in cases.items():
        with pytest.raises(InputError, match=words):
            check_output(*arguments, "run", **options)
    assert content(tmp_path) == {"data/a.csv": "measured"}


def test_inputs_are_never_in_a_folder_that_is_replaced(tmp_path):
    out = tmp_path / "out"
    write(out, {"joint.yaml": "a"}, maker="diagnose", whole=True)
    (out / "data").mkdir()
    for source in (out, out / "data", out / "joint.yaml"):
        with pytest.raises(InputError, match="which is read"):
            check_output(out, "diagnose", inputs=[source], whole=True)
    write(out, {"joint.yaml": "b"}, maker="diagnose", inputs=[tmp_path / "other"], whole=True)
    assert content(out) == {"joint.yaml": "b"}


def test_what_another_command_wrote_is_not_replaced(tmp_path):
    out = tmp_path / "out"
    write(out, {"metrics.json": "a run's"}, whole=True)
    with pytest.raises(InputError, match="expected a folder of this diagnose, got one of run"):
        check_output(out, "diagnose", whole=True)
    with pytest.raises(InputError, match=r"metrics\.json.*one of run"):
        check_output(out, made_from("estimate", "a"), writes=["metrics.json"])
    write(out, {"more.json": "1"}, maker=made_from("estimate", "a"))
    write(out, {"more.json": "2"}, maker=made_from("estimate", "a"))
    with pytest.raises(InputError, match="on something else"):
        write(out, {"more.json": "3"}, maker=made_from("estimate", "b"))
    assert content(out) == {"metrics.json": "a run's", "more.json": "2"}


def test_a_manifest_cannot_name_files_elsewhere(tmp_path):
    (tmp_path / "mine").write_text("mine")
    out = tmp_path / "out"
    write(out, {"one": "1", "sub/two": "2"}, whole=True)
    files = {"one": "run", "sub/two": "run", "../mine": "run", str(tmp_path / "mine"): "run"}
    (out / MANIFEST).write_text(json.dumps({"format": 1, "files": files}))
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "two").write_text("mine")
    shutil.rmtree(out / "sub")
    (out / "sub").symlink_to(tmp_path / "elsewhere")
    write(out, {"three": "3"}, whole=True)
    assert (tmp_path / "mine").read_text() == "mine" and (tmp_path / "elsewhere" / "two").read_text() == "mine"
    with pytest.raises(InputError, match="elsewhere"):
        write(out, {"sub/two": "3"}, whole=True)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"files": 3}', '{"files": ["a"]}', '{"files": {"mine": ""}}', "[" * 100_000]
)
def test_an_invalid_manifest_protects_all_files(tmp_path, text):
    (tmp_path / MANIFEST).write_text(text)
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(InputError, match="other files"):
        check_output(tmp_path, "run", whole=True)


def test_a_manifest_of_another_version_is_refused(tmp_path):
    write(tmp_path / "out", {"one": "1"})
    path = tmp_path / "out" / MANIFEST
    path.write_text(path.read_text().replace('"format": 1', '"format": 2'))
    with pytest.raises(InputError, match=r"flexspline: format: expected 1, got 2: written by another version"):
        write(tmp_path / "out", {"one": "2"})
    assert content(tmp_path / "out") == {"one": "1"}


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE])
def test_an_unreadable_manifest_is_an_error(tmp_path, monkeypatch, number):
    write(tmp_path / "out", {"one": "1"})
    read = Path.read_text

    def failing(self, *arguments, **options):
        if self.name == MANIFEST:
            raise OSError(number, os.strerror(number))
        return read(self, *arguments, **options)

    monkeypatch.setattr(Path, "read_text", failing)
    with pytest.raises(InputError, match=rf"{MANIFEST}: cannot be read: {os.strerror(number)}"):
        write(tmp_path / "out", {"one": "2"})


STEPS = ("rename", "replace", "unlink", "rmdir", "rmtree", "mkdir")


def killed_at(step, out):
    """Rewrite a folder and die just before the step-th change of the file system; return whether it died."""
    program = f"""
import os, shutil, sys
from pathlib import Path
from flexspline.models.output import output_folder
count = 0
def dying(function):
    def call(*arguments, **options):
        global count
        count += 1
        if count > {step}:
            os.kill(os.getpid(), 9)
        return function(*arguments, **options)
    return call
with output_folder(Path(sys.argv[1]), "run", whole=True) as folder:
    (folder / "sub").mkdir()
    (folder / "new").mkdir()
    for name in ("one", "sub/two", "new/three"):
        (folder / name).write_text("new")
    for name in {STEPS!r}:
        for module in (os, shutil):
            if hasattr(module, name):
                setattr(module, name, dying(getattr(module, name)))
"""
    return subprocess.run([sys.executable, "-c", program, str(out)], capture_output=True).returncode == -9


def test_killed_at_every_step_of_the_exchange(tmp_path):
    """All old or all new files; the next start completes the output and writes again."""
    old = {"one": "old", "sub/two": "old", "sub/gone": "old", "sub/mine": "mine"}
    new = {"one": "new", "sub/two": "new", "new/three": "new", "sub/mine": "mine"}
    seen = set()
    for step in range(40):
        out = tmp_path / f"out{step}"
        write(out, {name: text for name, text in old.items() if text == "old"}, whole=True)
        (out / "sub" / "mine").write_text("mine")
        killed = killed_at(step, out)
        recover(out)
        for left in out.glob(f"{MANIFEST}-new-*"):  # goes at the next write
            shutil.rmtree(left)
        found = content(out)
        assert found in (old, new), step
        seen.add(found == new)
        write(out, {"again": "again"}, whole=True)
        assert content(out) == {"again": "again", "sub/mine": "mine"}
        assert not list(out.glob(f"{MANIFEST}-*")), "nothing is left"
        if not killed:
            break
    assert not killed and step > 8 and seen == {True, False}


def test_folders_of_running_processes_are_kept(tmp_path):
    with output_folder(tmp_path / "out", "compare") as one:
        (one / "a").write_text("1")
        with output_folder(tmp_path / "out", "compare") as other:
            (other / "b").write_text("2")
            assert (one / "a").exists()
    assert content(tmp_path / "out") == {"a": "1", "b": "2"}


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EDQUOT])
def test_a_full_disk_is_one_line_and_leaves_what_was_there(tmp_path, number):
    write(tmp_path / "out", {"one": "1"}, whole=True)
    with (
        pytest.raises(InputError, match="cannot be written"),
        output_folder(tmp_path / "out", "run", whole=True) as folder,
    ):
        (folder / "one").write_text("2")
        raise OSError(number, os.strerror(number))
    assert content(tmp_path / "out") == {"one": "1"}


def test_errors_of_the_work_itself_are_unchanged(tmp_path):
    with pytest.raises(FileNotFoundError), output_folder(tmp_path / "out", "run"):
        (tmp_path / "nothing").read_text()


@pytest.mark.parametrize("name", [".", "new/er"])
def test_several_may_begin_at_once_in_one_folder(tmp_path, name):
    """One listed what another removed as it ended: `cannot be written: No such file or directory`."""

    def begin(_: int) -> None:
        for _ in range(60):
            check_output(tmp_path / name, "run")

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(begin, range(4))) == [None] * 4
    assert not list(tmp_path.rglob(f"{MANIFEST}*"))


def test_it_works_without_locks(tmp_path, monkeypatch):
    monkeypatch.setattr(output, "fcntl", None)
    write(tmp_path / "out", {"one": "1"}, whole=True)
    write(tmp_path / "out", {"one": "2"}, whole=True)
    assert content(tmp_path / "out") == {"one": "2"}
