"""How the sources hang together: imports point one way, every folder is packaged once, the folder `flexspline` shows them all."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = {
    "models": set(),
    "sim": {"models"},
    "estimator": {"models"},
    "scenarios": {"sim", "estimator", "models"},
    "diagnosis": {"scenarios", "sim", "estimator", "models"},
    "views": {"diagnosis", "scenarios", "sim", "estimator", "models"},
    "commands": {"views", "diagnosis", "scenarios", "sim", "estimator", "models"},
}
"""What each room may import, besides itself: commands → views, diagnosis, scenarios → estimator, sim → models."""
LIGHT = ("numba", "numpy", "mujoco", "scipy", "pyarrow", "matplotlib", "pandas", "rerun", "rich", "pydantic", "yaml")
"""What `import flexspline` and the command line's help do not load, but for rich, which prints the help."""


def modules(room: str) -> Iterator[tuple[str, Path, bool]]:
    """Name, file, and whether it is a package, of every module of a room."""
    for path in sorted((ROOT / room).rglob("*.py")):
        parts = ["flexspline", *path.relative_to(ROOT).with_suffix("").parts]
        package = parts[-1] == "__init__"
        yield ".".join(parts[:-1] if package else parts), path, package


def imported(name: str, path: Path, package: bool) -> Iterator[tuple[int, str]]:
    """Line and absolute name of everything of this package that a module imports, wherever it stands, also for types only."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = name.split(".")
            base = base[: len(base) - node.level + package] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{source}.{alias.name}") for alias in node.names)


@pytest.mark.parametrize("room", ROOMS)
def test_imports_point_one_way(room):
    wrong = []
    for name, path, package in modules(room):
        for line, target in imported(name, path, package):
            parts = target.split(".")
            if parts[0] != "flexspline" or len(parts) < 2 or parts[1] == room:
                continue
            if parts[1] not in ROOMS[room]:
                wrong.append(f"{path.relative_to(ROOT)}:{line}: {room} imports {target}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("room", ROOMS)
def test_nothing_is_loaded_that_could_execute(room):
    """Formats that run code as they are read: a file in a folder that others share would be theirs to write."""
    executing = {"pickle", "_pickle", "cPickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
    found = [
        f"{path.relative_to(ROOT)}:{line}: {target}"
        for name, path, package in modules(room)
        for line, target in imported(name, path, package)
        if target.split(".")[0] in executing
    ]
    assert not found, "\n".join(found)
    assert not [path for path in (ROOT / room).rglob("*.py") if "allow_pickle=True" in path.read_text(encoding="utf-8")]


def test_every_package_is_listed_once():
    """`pyproject.toml` names all folders with an `__init__.py`, and no others."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    packages = {
        ".".join(["flexspline", *path.parent.relative_to(ROOT).parts])
        for room in ROOMS
        for path in (ROOT / room).rglob("__init__.py")
    }
    assert set(listed["packages"]) == {"flexspline", *packages}
    assert len(listed["packages"]) == len(set(listed["packages"]))
    assert listed["package-dir"] == {"flexspline": "flexspline"} | {f"flexspline.{room}": room for room in ROOMS}


def test_the_package_shows_every_room_by_a_relative_link():
    for room in ROOMS:
        link = ROOT / "flexspline" / room
        assert link.is_symlink() and link.readlink() == Path("..") / room and link.resolve() == ROOT / room
    own = {path.name for path in (ROOT / "flexspline").iterdir() if not path.is_symlink()} - {"__pycache__"}
    assert own == {"__init__.py", "__main__.py", "py.typed"}


def loaded(program: str, cwd: Path) -> set[str]:
    """Top-level modules that a program leaves loaded."""
    program += "\nimport sys; print('|', *{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=cwd, check=True)
    return set(done.stdout.rpartition("|")[2].split())


@pytest.mark.parametrize("cwd", [ROOT, Path("/")], ids=["root", "elsewhere"])
def test_the_package_imports_nothing_heavy(cwd):
    assert not loaded("import flexspline; assert flexspline.__version__", cwd) & set(LIGHT)


def test_help_imports_nothing_heavy():
    program = (
        "import sys, contextlib\nsys.argv = ['flexspline', '--help']\nfrom flexspline.commands import main\n"
        "with contextlib.suppress(SystemExit): main()"
    )
    assert loaded(program, Path("/")) & set(LIGHT) == {"rich"}


def test_from_the_root_and_from_elsewhere_it_is_the_same_code():
    """Same files, so that compiled code is cached once."""
    program = "import flexspline.models.laws as m, flexspline.models.kernels as k; print(m.__file__, k.cache_folder(m.__name__))"
    found = {
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=cwd, check=True).stdout
        for cwd in (ROOT, Path("/"))
    }
    assert len(found) == 1


def test_one_name_is_one_thing():
    named = [
        node.name
        for room in ROOMS
        for _, path, _ in modules(room)
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]
    assert not {name for name in named if named.count(name) > 1}
