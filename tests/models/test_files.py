"""Files appear complete; a file that cannot be written is one line."""

from __future__ import annotations

import itertools
import os
from contextlib import contextmanager
from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import Field, model_validator

from flexspline.models.errors import InputError
from flexspline.models.files import Strict, check_name, load, parse, read_yaml, write_into_place
from flexspline.models.output import output_folder

NOBODY = 65534


def whole_folder(path):
    return output_folder(path, "run", whole=True)


@contextmanager
def without_rights(folder):
    """Deny access to the folder, also to root."""
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
@pytest.mark.parametrize("write", [write_into_place, whole_folder])
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
    with without_rights(tmp_path / "mine"), pytest.raises(InputError), whole_folder(tmp_path / "mine"):
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


def test_rights_follow_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        with write_into_place(tmp_path / "a.txt") as path:
            path.write_text("x")
        with output_folder(tmp_path / "out", "run", whole=True) as folder:
            (folder / "b.txt").write_text("x")
    finally:
        os.umask(before)
    rights = {
        p.name: p.stat().st_mode & 0o777 for p in (tmp_path / "a.txt", tmp_path / "out", tmp_path / "out" / "b.txt")
    }
    assert rights == {"a.txt": 0o640, "out": 0o750, "b.txt": 0o640}


def test_folders_of_ended_processes_are_removed_and_of_running_ones_kept(tmp_path):
    (tmp_path / ".flexspline-new-0123abcd").mkdir()
    (tmp_path / ".flexspline-new-0123abcd" / "a.txt").write_text("left")
    (tmp_path / ".a.txt.notes.txt").write_text("somebody's")
    with write_into_place(tmp_path / "a.txt") as one, write_into_place(tmp_path / "a.txt") as other:
        one.write_text("1")
        assert one.exists()
        other.write_text("2")
    assert sorted(p.name for p in tmp_path.iterdir()) == [".a.txt.notes.txt", "a.txt"]
    assert (tmp_path / "a.txt").read_text() == "1"


LEVEL = "&{0} [*{1}, *{1}, *{1}, *{1}, *{1}, *{1}, *{1}, *{1}, *{1}, *{1}]"
BOMB = "a: &a [1, 1, 1, 1]\n" + "".join(f"{b}: {LEVEL.format(b, a)}\n" for a, b in itertools.pairwise("abcdefghijk"))


@pytest.mark.parametrize(
    "text, expected",
    [
        ("[" * 100_000, "40 levels"), ("- " * 200 + "a", "40 levels"), (BOMB, "1000000 values"),
        ("a: &a [*a]", "1000000 values"), ("? [1]\n: 2", "a word for a key"), ("a: 2024-13-45", "month"),
        ("a: " + "1" * 5000, "digits"), ("a: !!float x", "a value without a tag"), ("\x01", "control characters"),
        ("a: !!python/name:os.system", "a value without a tag"), ("a: [", "not YAML"),
    ],
    ids=["brackets", "dashes", "aliases", "itself", "key", "date", "digits", "float", "control", "python", "open"],
)  # fmt: skip
def test_text_that_is_no_yaml_is_one_line(tmp_path, text, expected):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(InputError, match=expected) as caught:
        read_yaml(tmp_path / "a.yaml", "a file")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_text_in_another_encoding_is_named_by_line(tmp_path):
    (tmp_path / "a.yaml").write_bytes("name: x\nunit: °C\n".encode("latin-1"))
    with pytest.raises(InputError, match=r"a\.yaml:2: .*not UTF-8"):
        read_yaml(tmp_path / "a.yaml", "a file")


@pytest.mark.parametrize("name", ["../a", "/a", "a/b", "a\\b", ".a", "", "a\nb", "c:a", "a" * 101, " a"])
def test_names_with_paths_are_refused(name):
    with pytest.raises(InputError, match="expected a name"):
        check_name(name, "--name")


@pytest.mark.parametrize("name", ["a", "log 1 (Kopie)", "Prüfstand-3.2", "a[bold]b"])
def test_ordinary_names_are_accepted(name):
    assert check_name(name, "--name") == name


def test_messages_are_one_line_without_control_characters():
    assert str(InputError("a\nb\x1b[31mc")) == "a b\\x1b[31mc"


class _Inner(Strict):
    mass: float
    distance: float


class _Outer(Strict):
    name: str
    inner: _Inner


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({}, "it: name: missing; so is inner"),
        ({"name": "a", "inner": {}}, "it: inner.mass: missing; so is inner.distance"),
        ({"name": "a", "inner": {"mas": 1}}, "it: inner.mas: unknown key; did you mean 'mass'?"),
        ({"name": "a", "inner": {"zzz": 1}}, "it: inner.zzz: unknown key; expected one of ['mass', 'distance']"),
        ({"name": "a", "inner": "that"}, "it: inner: expected a mapping of keys (mass, distance), got 'that'"),
    ],
)
def test_the_first_error_is_one_line(data, said):
    """All missing keys, and suggestions for a misspelt one."""
    with pytest.raises(InputError) as caught:
        parse(data, _Outer, "it")
    assert str(caught.value) == said


class _Listed(Strict):
    name: str
    parts: list[_Inner] = []
    first: _Inner | None = None

    @model_validator(mode="after")
    def _ordered(self) -> _Listed:
        if len(self.parts) > 2:
            raise ValueError("parts.2: expected two at most")
        return self


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("name: a\nparts:\n  - {mass: 1, distance: 2}\n  - mass: 1\n    distance: x", 5, "parts.1.distance: expected"),
        ("name: a\nparts:\n  - {mass: 1, distance: 2}\n  - mass: 1", 4, "parts.1.distance: missing"),
        ("parts: []", None, "name: missing"),
        (
            "name: a\nparts: [{mass: 1, distance: 2},\n  {mass: 1, distance: 2},\n  {mass: 1, distance: 2}]",
            4,
            "parts.2: e",
        ),
        ("name: a\nfirst: &a\n  mass: 1\n  distance: 2\nparts:\n - *a\n - {mas: 3}", 7, "parts.1.mas: unknown"),
        ("name: a\n\nnam: b", 3, "nam: unknown key; did you mean 'name'?"),
        ("name: a\nparts: [\n", 3, "not YAML"),
        ("name: a\nname: b", 2, "not YAML: duplicate key 'name'"),
    ],
)
def test_errors_name_the_line(tmp_path, text, line, said):
    """Comments and empty lines above count."""
    above = int(np.random.default_rng(len(text)).integers(0, 5))
    path = tmp_path / "a.yaml"
    path.write_text("# a comment\n" * above + text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load(path, _Listed, "a file")
    assert str(caught.value).startswith(f"{path}{f':{above + line}' if line else ''}: {said}")


class _Numbers(Strict):
    number: float = 0.0
    count: Annotated[int, Field(ge=0)] = 0
    flag: bool = False
    several: list[float] = []
    by_name: dict[str, float] = {}
    perhaps: float | None = None
    either: float | Literal["ideal"] = 0.0


@pytest.mark.parametrize(
    "text", ["true", "'9'", "1:30", "1:30.5", "010", "0b11", "0x1f", "no", "'1e3'", "1 000", "2024-01-01"]
)
@pytest.mark.parametrize(
    "place", ["number: {}", "count: {}", "several: [1, {}]", "by_name: {{a: {}}}", "perhaps: {}", "either: {}"]
)
def test_only_numbers_are_numbers(tmp_path, text, place):
    """YAML reads 1:30 as 90 and 010 as 8, and pydantic reads true as 1 and '9' as 9: these are refused."""
    path = tmp_path / "a.yaml"
    path.write_text(place.format(text))
    with pytest.raises(InputError) as caught:
        load(path, _Numbers, "a file")
    message = str(caught.value)
    assert message.startswith(f"{path}:1: {place.split(':')[0]}") and "number" in message and ", got " in message


@pytest.mark.parametrize(
    "text, expected",
    [
        ("9", 9),
        ("-3", -3),
        ("+3", 3),
        ("1_000", 1000),
        ("1e3", 1000),
        ("1.5E+3", 1500),
        (".5e1", 5),
        ("3.0", 3),
        ("0", 0),
    ],
)
def test_spellings_of_numbers(tmp_path, text, expected):
    path = tmp_path / "a.yaml"
    path.write_text(
        f"number: {text}\nseveral: [{text}]\neither: {text}\n" + (f"count: {text}\n" if expected >= 0 else "")
    )
    found = load(path, _Numbers, "a file")
    assert (found.number, found.several, found.either) == (expected, [expected], expected)
    assert expected < 0 or (found.count == expected and type(found.count) is int)


@pytest.mark.parametrize("text", ["1", "0", "'yes'", "'true'", "1.0"])
def test_only_true_and_false_are_that(tmp_path, text):
    (tmp_path / "a.yaml").write_text(f"flag: {text}")
    with pytest.raises(InputError, match=r"flag: expected .*, got"):
        load(tmp_path / "a.yaml", _Numbers, "a file")


def test_a_missing_or_unknown_kind_is_one_line():
    """Where a key says of which kind something is, as the axes of a study do."""
    from flexspline.scenarios.studies.study import Study

    def study(**axis):
        data = {"name": "s", "seeds": {"first": 1, "count": 2}, "scenarios": ["no_load"], "axes": [axis]}
        with pytest.raises(InputError) as caught:
            parse(data, Study, "the study")
        return str(caught.value)

    values = {"key": "plant.K1", "values": [1.0]}
    assert study(**values) == "the study: axes.0.kind: missing"
    assert study(kind="sett", **values).endswith(
        "axes.0.kind: expected one of set, scale, load, cause, tolerance, got 'sett'; did you mean 'set'?"
    )
