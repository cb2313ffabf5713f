"""The cache of compiled code: outdated by a change of any of its sources, and only then."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flexspline.models import kernels

ROOT = Path(__file__).resolve().parents[2]

LAW = """
from .kernels import kernel

@kernel
def twice(x):
    return 2.0 * x
"""
USER = """
from .kernels import kernel
from .law import (
    twice,  # a law
)

@kernel
def plus_one(x):
    return twice(x) + 1.0
"""
OTHER = """
from .kernels import kernel

@kernel
def half(x):
    return 0.5 * x
"""
MAIN = """
import sys
from house import user, other, kernels
print(user.plus_one(3.0), other.half(3.0))
print(kernels.digest("house.user"), kernels.digest("house.other"))
print(kernels.cache_folder("house.user"))
print(sum(user.plus_one.stats.cache_misses.values()), sum(other.half.stats.cache_misses.values()))
"""


@pytest.fixture
def house(tmp_path):
    """A package of three modules with a copy of `kernels.py`; returns a function that runs `MAIN` in a new process."""
    package = tmp_path / "house"
    package.mkdir()
    shutil.copy(ROOT / "models" / "kernels.py", package / "kernels.py")
    for name, text in (("__init__", ""), ("law", LAW), ("user", USER), ("other", OTHER)):
        (package / f"{name}.py").write_text(text, encoding="utf-8")

    def run(umask=-1, **environment):
        done = subprocess.run(
            [sys.executable, "-c", MAIN], cwd=tmp_path, env=os.environ | environment, capture_output=True, text=True,
            umask=umask,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        values, digests, folder, misses = done.stdout.strip().splitlines()
        return values, digests.split(), Path(folder), [int(x) for x in misses.split()]

    run.package = package
    return run


def compiled_files(folder: Path) -> dict[str, float]:
    return {str(f): f.stat().st_mtime_ns for f in folder.rglob("*") if f.suffix in (".nbi", ".nbc")}


@pytest.mark.slow
def test_a_changed_law_is_recompiled_wherever_it_is_used(house):
    values, (user, other), folder, misses = house()
    assert values == "7.0 1.5" and misses == [1, 1]
    assert folder.parent == house.package / "__pycache__" / "kernels"
    before = compiled_files(house.package)
    again = house()
    assert again[:3] == (values, [user, other], folder) and again[3] == [0, 0]
    assert compiled_files(house.package) == before
    (house.package / "law.py").write_text(LAW.replace("2.0", "5.0"), encoding="utf-8")
    values, (new_user, new_other), _, misses = house()
    assert values == "16.0 1.5"
    assert new_user != user and new_other == other
    assert misses == [1, 0]
    (house.package / "law.py").write_text(LAW, encoding="utf-8")  # back again: still there
    values, digests, _, misses = house()
    assert (values, digests, misses) == ("7.0 1.5", [user, other], [0, 0])


EDITED = """
import os
from pathlib import Path
from house import law
source = Path(law.__file__)
source.write_text(source.read_text().replace("2.0", "5.0"), encoding="utf-8")
os.utime(source, (2e9, 2e9))  # of one length and one second, Python would take its bytecode for that of the new source
from house import user
print(user.plus_one(3.0))
"""


def test_a_law_edited_during_a_process_is_compiled_for_that_process_only(house):
    """The code in memory is not that of the file, and must not be cached under its name."""
    done = subprocess.run(
        [sys.executable, "-c", EDITED], cwd=house.package.parent, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["7.0"]
    assert house()[0] == "16.0 1.5"


def test_old_caches_are_forgotten(tmp_path):
    """The latest four of a module's earlier states stay, and those of other modules."""
    for i in range(9):
        (tmp_path / f"user-{i:016x}").mkdir()
        os.utime(tmp_path / f"user-{i:016x}", (1e9 + i, 1e9 + i))
    for name in ("user-kept", f"users-{1:016x}", f"another_user-{1:016x}"):
        (tmp_path / name).mkdir()
    kernels._forget_old(tmp_path, "user")
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {f"user-{i:016x}" for i in range(5, 9)} | {"user-kept", f"users-{1:016x}", f"another_user-{1:016x}"}


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_package_keeps_its_cache_with_the_user(house, tmp_path):
    house.package.chmod(0o555)
    try:
        assert tmp_path / "cache" in house(XDG_CACHE_HOME=str(tmp_path / "cache"))[2].parents
    finally:
        house.package.chmod(0o755)


def test_the_digest_knows_every_import_of_this_package():
    """Directly or not: the loop imports the laws, the drive does not."""
    imported = kernels._imported("flexspline.sim.loop")
    assert {"flexspline.models.laws", "flexspline.models.dynamics", "flexspline.sim.sensors"} <= imported
    assert "flexspline.models.laws" not in kernels._imported("flexspline.models.kernels")
    assert not [name for name in imported if not name.startswith("flexspline")]


_FIRST_RUN = """
import sys, threading
import numpy as np
sys.path.insert(0, sys.argv[1])
from flexspline.models.joint import load_joint
from flexspline.sim import plant
from looping import run
joint = load_joint("test-joint")
failed, built = [], []
def build():
    try:
        built.append(plant.build(joint))
    except BaseException as error:
        failed.append(error)
threads = [threading.Thread(target=build) for _ in range(2)]
[t.start() for t in threads]; [t.join() for t in threads]
assert not failed and len(built) == 2, failed
s = run(seconds=0.1)
assert np.isfinite(s.truth["joint_torque"]).all() and s.failed == (100, 0)
print(s.truth.tobytes()[:64].hex())
"""


@pytest.mark.slow
@pytest.mark.long
def test_two_threads_make_the_first_plant_and_a_second_process_compiles_nothing(tmp_path):
    """In a fresh copy of the package: both threads get a plant; the second process reads what the first compiled."""
    package = tmp_path / "package" / "flexspline"
    for room in ("models", "sim"):
        shutil.copytree(ROOT / room, package / room, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "__init__.py").touch()
    script = tmp_path / "first.py"
    script.write_text(_FIRST_RUN, encoding="utf-8")

    def once():
        done = subprocess.run(
            [sys.executable, str(script), str(ROOT / "tests" / "sim")],
            env=os.environ | {"PYTHONPATH": str(tmp_path / "package"), "XDG_CACHE_HOME": str(tmp_path / "cache")},
            capture_output=True, text=True, timeout=900,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-3000:]
        return done.stdout, compiled_files(tmp_path)

    first, files = once()
    second, after = once()
    assert len(files) > 20
    assert after == files  # nothing written, nothing added
    assert first == second


def test_division_by_zero_is_an_infinity():
    @kernels.kernel
    def quotient(a, b):
        return a / b

    assert quotient(1.0, 0.0) == np.inf and np.isnan(quotient(0.0, 0.0))


@pytest.mark.skipif(os.name != "posix", reason="no umask")
def test_only_the_owner_may_write_compiled_code(house, tmp_path):
    """Whatever the umask: it is executed."""
    folder = house(umask=0)[2]
    assert [path.stat().st_mode & 0o077 for path in (folder, folder.parent)] == [0, 0]
