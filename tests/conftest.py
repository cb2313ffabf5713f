"""What all tests share: where the shared material lies, and random numbers whose seed a failure shows."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections import Counter
from collections.abc import Iterator
from html import unescape
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
SEED = 20130506


def pytest_addoption(parser: pytest.Parser) -> None:
    help_ = "of the tests of a file every N-th alone"
    parser.addoption("--every", type=int, default=1, metavar="N", help=help_)


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    for item, index in numbered(items):
        fast = item.get_closest_marker("fast_every")
        if fast is not None and index % fast.args[0]:
            item.add_marker(pytest.mark.slow)
            item.add_marker(pytest.mark.long)
    yield
    every = config.getoption("--every")  # of those that are run
    kept, left_out = [], []
    seen = Counter[Path]()
    for item in items:
        (left_out if seen[item.path] % every else kept).append(item)
        seen[item.path] += 1
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = kept


def numbered(items: list[pytest.Item]) -> Iterator[tuple[pytest.Item, int]]:
    """Tests with the number of each among those of its function."""
    seen = Counter[str]()
    for item in items:
        function = item.nodeid.partition("[")[0]
        yield item, seen[function]
        seen[function] += 1


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of the shared material: FLEXSPLINE_SHARED, or `../shared` beside the repository."""
    folder = Path(os.environ.get("FLEXSPLINE_SHARED", ROOT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"no shared material at {folder}; set FLEXSPLINE_SHARED")
    return folder


@pytest.fixture(scope="session")
def reference(shared):
    """Return a function: name of a reference file → its columns as arrays."""
    pq = pytest.importorskip("pyarrow.parquet")

    def read(name: str) -> dict[str, np.ndarray]:
        path = shared / "data" / "reference" / f"{name}.parquet"
        if not path.is_file():
            pytest.skip(f"no reference data at {path}")
        table = pq.read_table(path)
        return {column: table[column].to_numpy() for column in table.column_names}

    return read


@pytest.fixture(scope="session")
def measured(shared):
    """Return a function: names of folder and file → path of a measured log."""

    def find(*names: str) -> Path:
        path = shared.joinpath("data", *names)
        if not path.is_file():
            pytest.skip(f"no measured motion at {path}")
        return path

    return find


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded generator; pytest shows the seed of a test that fails. FLEXSPLINE_SEED sets another."""
    seed = int(os.environ.get("FLEXSPLINE_SEED", SEED))
    print(f"seed {seed}: repeat with FLEXSPLINE_SEED={seed}")
    return np.random.default_rng(seed)


@pytest.fixture(scope="session")
def typed():
    """Return a function: an HTML page → the command lines to copy from it, each of which the command line's own parser takes."""
    from flexspline import commands

    def read(page: str) -> list[str]:
        code = re.findall(r"<code>(flexspline .*?)</code>", page, flags=re.DOTALL)
        lines = [line for text in code for line in unescape(re.sub(r"<[^>]*>", "", text)).splitlines() if line.strip()]
        for line in lines:
            program, name, *rest = shlex.split(line)
            assert program == "flexspline", line
            commands._load(name).make_context(name, rest)  # parses, and calls nothing
        return lines

    return read


@pytest.fixture
def flexspline(capfd, monkeypatch):
    """Return a function: arguments → exit code, stdout, stderr; in this process, which has the compiled code already."""
    from flexspline import commands

    def call(*arguments: object, columns: int = 200) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["flexspline", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", str(columns))
        code = 0
        capfd.readouterr()
        try:
            commands.main()
        except SystemExit as stop:
            code = stop.code or 0
        out, err = capfd.readouterr()
        return code, out, err

    return call
