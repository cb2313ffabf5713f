"""Compiled code: one decorator, and a cache on disk that recompiles changed code.

`kernel` is `numba.njit` with this package's settings: no interpreter lock, IEEE arithmetic (a division by zero is an
infinity, which callers check; an exception inside MuJoCo's callbacks could only be printed), cached on disk.

Numba's own cache checks a function's own file only, and keeps code compiled with an older version of an imported law.
Here the name of the cache folder contains a digest of the function's module, of every module of this package that it
imports, directly or not, and of the versions of Numba, NumPy and MuJoCo. A changed law is recompiled wherever it is
used, and nothing else is. A file that was edited after this process started may differ from the code in memory: it is
compiled for this process only.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
from numba.core import config as numba_config

_PACKAGE = __name__.split(".")[0]
_DUAL = f"{_PACKAGE}.models.dual"  # any kernel may be compiled for dual numbers, too
_BEGAN = time.time()
_IMPORT = re.compile(r"^\s*from\s+(\.*[\w.]*)\s+import\s+(\([^)]*\)|[^\n#]*)", re.MULTILINE)
_KEPT = 4  # caches of earlier states that are kept per folder, for switching back and forth


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function when it is first called; `@kernel`, or `@kernel(forceinline=True)` with options of `numba.njit`."""
    if function is None:
        return lambda f: kernel(f, **options)
    with _cached_beside(function):
        return numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)


def c_function(signature: Any, function: Callable[..., Any]) -> Any:
    """Compile a C callback of a signature now; its address is `.address`."""
    with _cached_beside(function):
        return numba.cfunc(signature, cache=True, error_model="numpy")(function)


_setting = threading.Lock()
_config: Any = numba_config  # Numba fills the module as it is imported


@contextmanager
def _cached_beside(function: Callable[..., Any]) -> Iterator[None]:
    """Set Numba's cache to the folder for a function's module; Numba reads that setting when it decorates."""
    folder = cache_folder(function.__module__)
    with _setting:
        before, _config.CACHE_DIR = _config.CACHE_DIR, str(folder)
        try:
            yield
        finally:
            _config.CACHE_DIR = before


@cache
def cache_folder(module: str) -> Path:
    """Return the folder of a module's compiled code: inside `__pycache__`, or the user's if that is not writable.

    No other user may write to it, whatever the umask: its code is executed.
    """
    own = _file(module)
    top = own.parent / "__pycache__" / "kernels" if own is not None else _users()
    try:
        top.mkdir(0o700, parents=True, exist_ok=True)
        writable = os.access(top, os.W_OK)
    except OSError:
        writable = False
    if not writable:
        top = _users()
        top.mkdir(0o700, parents=True, exist_ok=True)
    name = module.rsplit(".", 1)[-1]
    folder = top / f"{name}-{digest(module)}"
    if not folder.exists():
        _forget_old(top, name)
        folder.mkdir(0o700, exist_ok=True)
    return folder


def _users() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / _PACKAGE / "kernels"


def _forget_old(top: Path, name: str) -> None:
    earlier = [
        f for f in top.glob(f"{name}-*") if f.is_dir() and re.fullmatch(re.escape(name) + r"-[0-9a-f]{16}", f.name)
    ]
    for folder in sorted(earlier, key=lambda f: f.stat().st_mtime)[: -_KEPT or None]:
        shutil.rmtree(folder, ignore_errors=True)


@cache
def digest(module: str) -> str:
    """Return sixteen hexadecimal digits of a module's source, of all sources of this package that it imports, and of
    the compiler."""
    versions = (metadata.version(name) for name in ("numba", "llvmlite", "numpy", "mujoco"))
    whole = hashlib.blake2b(" ".join([*versions, sys.version]).encode(), digest_size=8)
    for name in sorted(_imported(module) | _imported(_DUAL)):
        path = _file(name)
        assert path is not None
        whole.update(path.read_bytes())
        if path.stat().st_mtime > _BEGAN:
            whole.update(os.urandom(8))
    return whole.hexdigest()


@cache
def _imported(module: str) -> frozenset[str]:
    """Return a module and every module of this package that it imports, directly or not."""
    found, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        if name not in found and _file(name) is not None:
            found.add(name)
            waiting += _imports(name)
    return frozenset(found)


@cache
def _imports(module: str) -> tuple[str, ...]:
    """Return the modules of this package in a module's `from … import`."""
    path, found = _file(module), []
    assert path is not None
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for source, names in _IMPORT.findall(path.read_text(encoding="utf-8")):
        dots = len(source) - len(source.lstrip("."))
        if dots:
            base = package.split(".")[: len(package.split(".")) - dots + 1]
            target = ".".join([*base, *source.lstrip(".").split(".")]).rstrip(".")
        else:
            target = source
        if target.split(".")[0] != _PACKAGE:
            continue
        inner = [f"{target}.{n.split()[0]}" for n in names.strip("()").replace("\n", " ").split(",") if n.strip()]
        found += [target, *(name for name in inner if _file(name) is not None)]
    return tuple(found)


@cache
def _file(module: str) -> Path | None:
    """Return the file of a module without importing it; None if there is none."""
    loaded = sys.modules.get(module)
    if loaded is not None:
        file = getattr(loaded, "__file__", None)
        return Path(file).resolve() if file else None
    parent, _, name = module.rpartition(".")
    folder = _file(parent) if parent else None
    if folder is None or folder.name != "__init__.py":
        return None
    for candidate in (folder.parent / name / "__init__.py", folder.parent / f"{name}.py"):
        if candidate.is_file():
            return candidate.resolve()
    return None
