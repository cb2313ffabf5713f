"""Output folders: a command replaces only its own files, and its output appears complete or not at all.

The manifest `.flexspline` of a folder lists the files written here and their maker (`run`, `diagnose`, …). Only the same
maker replaces or removes them. All other files belong to the user.

A command writes to the folder `.flexspline-new-…` first. When it is complete, with its manifest, one rename makes it
`.flexspline-done-…`. From then on its files only have to be moved up, and those removed that are in the folder's manifest and
not in the new one. After an interruption, the next process that opens the folder continues (`recover`). The next write
removes unfinished folders of processes that have ended.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

from .errors import InputError, first_line

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

MANIFEST = ".flexspline"
_NEW, _DONE = f"{MANIFEST}-new-", f"{MANIFEST}-done-"
_TRIES = 100  # to enter a folder that other processes make and remove
_ENVIRONMENT = {
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM, errno.ENAMETOOLONG,
    errno.ESTALE,
}  # fmt: skip
"""Errors of the disk, not of the program."""


def made_from(maker: str, *sources: str | Path) -> str:
    """Return the name of a maker with its input files: the same command on other files is another maker."""
    paths = "\n".join(sorted(str(Path(source).resolve()) for source in sources))
    return f"{maker} {hashlib.sha256(paths.encode()).hexdigest()[:12]}"


def check_output(path: Path, maker: str, **options: Any) -> None:
    """Refuse a folder that cannot be written to, before any work. Arguments: see `output_folder`."""
    with output_folder(path, maker, **options, commit=False):
        pass


@contextmanager
def output_folder(
    path: Path,
    maker: str,
    *,
    inputs: Iterable[str | Path] = (),
    writes: Iterable[str] = (),
    whole: bool = False,
    within: Path | None = None,
    commit: bool = True,
) -> Iterator[Path]:
    """Yield an empty folder to write to. Its files appear in `path` together, if the block ends without an exception.

    Args:
      path: the folder; it need not exist.
      maker: name of the writer. Files of the same maker are replaced, others never.
      inputs: files and folders that are read. None may be replaced, or be in a folder that is replaced as a `whole`.
      writes: names of the output files, where they are known in advance.
      whole: whether the folder holds this output only. It must be new, empty, or of the same maker, whose other files are
        removed. The user's files stay.
      within: a folder that `path` must not leave through a link.
      commit: whether the files appear at all (`check_output`).

    Raises:
      InputError: the folder cannot be written to, or files of another maker exist there; one line.
    """
    entered = False
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            if not stat.S_ISDIR(path.stat().st_mode):
                raise InputError(f"{path}: expected a folder to write to, got a file")
        if within is not None and not path.resolve().is_relative_to(within.resolve()):
            raise InputError(f"{path}: expected a folder inside {within}, got a link that leads elsewhere")
        with _staging(path) as staging:
            with _locked(path):
                _recover(path)
                _check(path, maker, inputs, writes, whole)
            entered = True
            yield staging
            if commit:
                with _locked(path):
                    _commit(path, staging, maker, whole)
    except OSError as error:
        if entered and error.errno not in _ENVIRONMENT:
            raise
        raise InputError(f"{path}: cannot be written: {_described(error)}") from error


@contextmanager
def _staging(path: Path) -> Iterator[Path]:
    """Yield a new folder inside `path`. At the end, remove it and the folders that were made and are still empty."""
    made = [p for p in (path, *path.parents) if not p.exists()]
    staging = path / f"{_NEW}{secrets.token_hex(4)}"

    def remove() -> None:
        shutil.rmtree(staging, ignore_errors=True)
        with suppress(OSError):  # not empty
            for folder in made:
                folder.rmdir()

    owner = None
    try:
        with at_end(remove):
            owner = _entered(path, staging)
            yield staging
    finally:
        remove()
        if owner is not None:
            os.close(owner)


def _entered(path: Path, staging: Path) -> int | None:
    """Make a folder and one inside it, and lock that; another process may remove a folder that it made and left empty."""
    for _ in range(_TRIES):
        with suppress(FileNotFoundError):
            path.mkdir(parents=True, exist_ok=True)
            with _locked(path):  # until the inner one is locked, another process would remove it
                _sweep(path)
                staging.mkdir()
                return _own(staging)
    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))


_at_end: list[Callable[[], object]] = []


@contextmanager
def at_end(action: Callable[[], object]) -> Iterator[None]:
    """Let `abandon` call an action if the process is asked to end inside the block; its result is a message."""
    _at_end.append(action)
    try:
        yield
    finally:
        _at_end.remove(action)


def abandon() -> str:
    """Remove unfinished output when a process ends without waiting for its threads; return the message of an action, if
    one has any."""
    message = ""
    for action in reversed(list(_at_end)):
        with suppress(Exception):
            message = str(action() or message)
    return message


def recover(path: Path) -> None:
    """Complete output that an ended process had written into a folder but not moved up. Raises `InputError`: the folder
    cannot be written to."""
    try:
        if _waiting(path):
            with _locked(path):
                _recover(path)
    except OSError as error:
        raise InputError(
            f"{path}: expected complete output, got some that was interrupted and cannot be completed: {_described(error)}"
        ) from error


def manifest(path: Path) -> dict[str, str]:
    """Return the files of a folder that were written here (`a/b.txt`) with their makers; empty without a manifest.
    Raises `InputError`: the manifest cannot be read now, or another version wrote it."""
    file = path / MANIFEST
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError, ValueError, RecursionError):
        return {}
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {_described(error)}") from error
    if not isinstance(found, dict) or not isinstance(found.get("files"), dict):
        return {}
    if found.get("format", 1) != 1:
        raise InputError(f"{file}: format: expected 1, got {found['format']!r}: written by another version")
    known = {str(name): str(maker) for name, maker in found["files"].items()}
    return {name: maker for name, maker in known.items() if _is_inside(name) and maker.strip()}


def _is_inside(name: str) -> bool:
    parts = PurePosixPath(name)
    return bool(parts.parts) and not parts.is_absolute() and ".." not in parts.parts and name != MANIFEST


def _check(path: Path, maker: str, inputs: Iterable[str | Path], writes: Iterable[str], whole: bool) -> None:
    listed = manifest(path)
    inside = path.resolve()
    read = {Path(source).resolve() for source in inputs}
    if whole:
        for source in read:
            if source.is_relative_to(inside):
                raise InputError(f"{path}: expected another folder than that of {source.name}, which is read")
        other = sorted({by.split()[0] for by in listed.values() if by != maker})
        if other:
            raise InputError(f"{path}: expected a folder of this {maker.split()[0]}, got one of {', '.join(other)}")
        if not listed and any(not entry.name.startswith(MANIFEST) for entry in os.scandir(path)):
            raise InputError(f"{path}: expected an empty or new folder, got one with other files in it")
    for name in writes:
        _check_target(path, name, listed, maker)
        if (inside / name).resolve() in read:
            raise InputError(f"{path / name}: expected another folder, the file is read")


def _check_target(path: Path, name: str, listed: Mapping[str, str], maker: str) -> None:
    """Raise if the file belongs to another maker or the user, or would be written outside the folder."""
    target = path / name
    if not _is_inside(name) or not target.parent.resolve().is_relative_to(path.resolve()):
        raise InputError(f"{target}: expected a file inside {path}, got one elsewhere")
    by = listed.get(name)
    if by != maker and (target.exists() or target.is_symlink()):
        whose = "one of your own" if by is None else f"one of {by.split()[0]} on something else"
        raise InputError(f"{target}: expected no file, or one that may be replaced, got {whose}; choose another folder")


def _commit(path: Path, staging: Path, maker: str, whole: bool) -> None:
    _recover(path)
    listed = manifest(path)
    names = sorted(p.relative_to(staging).as_posix() for p in staging.rglob("*") if not p.is_dir())
    for name in names:
        _check_target(path, name, listed, maker)
    kept = {name: by for name, by in listed.items() if not whole or by != maker}
    files = {"format": 1, "files": dict(sorted((kept | dict.fromkeys(names, maker)).items()))}
    (staging / MANIFEST).write_text(json.dumps(files, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    done = path / staging.name.replace(_NEW, _DONE)
    os.rename(staging, done)
    _move_up(path, done)


def _waiting(path: Path) -> list[Path]:
    if not path.is_dir():
        return []
    return sorted(Path(entry.path) for entry in os.scandir(path) if entry.name.startswith(_DONE))


def _recover(path: Path) -> None:
    for done in _waiting(path):
        _move_up(path, done)


def _move_up(path: Path, done: Path) -> None:
    """Move complete output to its place, its manifest last. It may be interrupted at every step, and repeated."""
    new, files = manifest(done), [p for p in done.rglob("*") if not p.is_dir()]
    if not new and files:  # not as it was written
        return
    inside = path.resolve()
    for source in sorted(p for p in files if p != done / MANIFEST):
        target = path / source.relative_to(done)
        if target.parent.resolve().is_relative_to(inside):
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(source, target)
    for gone in (path / name for name in manifest(path) if files and name not in new):
        if gone.parent.resolve().is_relative_to(inside):
            gone.unlink(missing_ok=True)
            with suppress(OSError):  # the folder has other files
                for parent in gone.relative_to(path).parents[:-1]:
                    (path / parent).rmdir()
    if files:
        os.replace(done / MANIFEST, path / MANIFEST)
    shutil.rmtree(done)


def _sweep(path: Path) -> None:
    for entry in list(os.scandir(path)):
        if entry.name.startswith(_NEW) and entry.is_dir(follow_symlinks=False):
            with suppress(FileNotFoundError):  # its own process has removed it
                owner = _own(Path(entry.path))
                if owner is not None:
                    shutil.rmtree(entry.path, ignore_errors=True)
                    os.close(owner)


def _own(path: Path, wait: bool = False) -> int | None:
    """Lock a file or folder until this process ends. Return its descriptor; None if another process holds it, or the file
    system has no locks."""
    if fcntl is None:
        return None
    held = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(held)
        return None
    try:
        there = os.path.samestat(os.fstat(held), path.stat())
    except OSError:  # the lock must not outlive this
        there = False
    if not there:  # removed in the meantime
        os.close(held)
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    return held


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    held = _own(path, wait=True)
    try:
        yield
    finally:
        if held is not None:
            os.close(held)


@contextmanager
def write_into_place(path: Path) -> Iterator[Path]:
    """Yield a temporary path. Move it to `path` if the block ends without an exception, else remove it. Raises `InputError`: it
    cannot be written (no permission, a full disk); one line."""
    try:
        if any(part.startswith(_NEW) for part in path.parts):  # inside a folder that appears complete
            path.parent.mkdir(parents=True, exist_ok=True)
            yield path
        else:
            with _staging(path.parent) as folder:
                yield folder / path.name
                os.replace(folder / path.name, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {_described(error)}") from error


def _described(error: OSError) -> str:
    """Return the cause of an error in a few words."""
    return os.strerror(error.errno) if error.errno else first_line(error)
