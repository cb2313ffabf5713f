"""Folders that commands write to: nobody's files but their own are touched, and what is written appears as a whole.

A folder holds a manifest, `.flexspline`: which of its files were written here, and by what (`run`, `diagnose`, …). Only those
are ever replaced or removed, and only by what wrote them; whatever else lies there is somebody's own.

What is written is put aside first, in a folder `.flexspline-new-…` of the same folder. When all of it is there, that folder
becomes `.flexspline-done-…`, in one step: from then on the output is complete, and its files only have to be moved up. Should
that be interrupted, whoever opens the folder next, to write or to read, does the rest (`recover`). What is left of a process
that ended before goes at the next write.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePosixPath

from .errors import InputError, first_line

try:
    import fcntl
except ImportError:  # no such locks on Windows
    fcntl = None  # type: ignore[assignment]

MANIFEST = ".flexspline"
_NEW, _DONE = f"{MANIFEST}-new-", f"{MANIFEST}-done-"
_JOURNAL, _LISTED = ".journal", ".manifest"
_ENVIRONMENT = {
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM, errno.ENAMETOOLONG,
    errno.ESTALE,
}  # fmt: skip
"""What goes wrong with a disk, not with a program."""


def made_from(maker: str, *sources: str | Path) -> str:
    """Name of what writes, and from which files: the same command on other files is another one."""
    paths = "\n".join(sorted(str(Path(source).resolve()) for source in sources))
    return f"{maker} {hashlib.sha256(paths.encode()).hexdigest()[:12]}"


def check_output(
    path: Path,
    maker: str,
    *,
    inputs: Iterable[str | Path] = (),
    writes: Iterable[str] = (),
    whole: bool = False,
    within: Path | None = None,
) -> None:
    """Refuse, before any work, a folder that cannot be written to; arguments as of `output_folder`."""
    with suppress(_Unused), output_folder(path, maker, inputs=inputs, writes=writes, whole=whole, within=within):
        raise _Unused


class _Unused(Exception):
    """Leaves a folder that was only opened to see whether it can be written to."""


@contextmanager
def output_folder(
    path: Path,
    maker: str,
    *,
    inputs: Iterable[str | Path] = (),
    writes: Iterable[str] = (),
    whole: bool = False,
    within: Path | None = None,
) -> Iterator[Path]:
    """Yield an empty folder to write to; when the block ends well, its files appear in `path`, all of them; when not, none.

    Args:
      path: of the folder, which need not exist.
      maker: what writes: files of the folder by the same maker are replaced, others never.
      inputs: files and folders that are read: none may lie in the folder where it is replaced as a `whole`, nor be replaced.
      writes: names of the files to come, as far as they are known before.
      whole: whether the folder is this output and nothing else's: it must be new, empty, or by the same maker, whose files that
        are not written again are removed. A person's own files beside them stay.
      within: a folder that `path` must not lead out of, by a link.

    Raises:
      InputError: a folder that cannot be written to, or files of somebody else's in the way; one line.
    """
    with ExitStack() as stack:
        try:
            if path.exists() and not path.is_dir():
                raise InputError(f"{path}: expected a folder to write to, got a file")
            if within is not None and not path.resolve().is_relative_to(within.resolve()):
                raise InputError(f"{path}: expected a folder inside {within}, got a link that leads elsewhere")
            staging = stack.enter_context(_staging(path))
            with _locked(path):
                _recover(path)
                _check(path, maker, inputs, writes, whole)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {described(error)}") from error
        try:
            yield staging
            with _locked(path):
                _commit(path, staging, maker, whole)
        except OSError as error:
            if error.errno not in _ENVIRONMENT:
                raise
            raise InputError(f"{path}: cannot be written: {described(error)}") from error


@contextmanager
def _staging(path: Path) -> Iterator[Path]:
    """Yield a new folder inside a folder, which is made where it is not there; what of both is empty or left goes at the end."""
    made = [p for p in (path, *path.parents) if not p.exists()]
    staging = path / f"{_NEW}{secrets.token_hex(4)}"

    def remove() -> None:
        shutil.rmtree(staging, ignore_errors=True)  # there is none once it is complete, and moved into place
        with suppress(OSError):  # not empty
            for folder in made:
                folder.rmdir()

    owner = None
    try:
        path.mkdir(parents=True, exist_ok=True)
        with at_end(remove):
            with _locked(path):  # nobody takes it for a leftover before it is held
                _sweep(path)
                staging.mkdir()
                owner = _own(staging)
            yield staging
    finally:
        remove()
        if owner is not None:
            os.close(owner)


_at_end: list[Callable[[], object]] = []


@contextmanager
def at_end(action: Callable[[], object]) -> Iterator[None]:
    """Have `abandon` do something where the process is asked to end inside the block; what it returns is said then."""
    _at_end.append(action)
    try:
        yield
    finally:
        _at_end.remove(action)


def abandon() -> str:
    """Remove what is being written: for a process that ends without waiting for its threads. What is complete stays.

    Returns:
      What an action has to say of it; empty where none has.
    """
    said = ""
    for action in reversed(list(_at_end)):
        with suppress(Exception):
            said = str(action() or said)
    return said


def recover(path: Path) -> None:
    """Complete what a process that was killed had all but written into a folder; nothing to do in any other.

    Raises:
      InputError: the folder cannot be written to.
    """
    try:
        if not _waiting(path):
            return
        with _locked(path):
            _recover(path)
    except OSError as error:
        raise InputError(
            f"{path}: expected complete output, got some that was interrupted and cannot be completed: {described(error)}"
        ) from error


def manifest(path: Path) -> dict[str, str]:
    """Files of a folder that were written here, as `a/b.txt`, and by what; empty where there is no manifest.

    Raises:
      InputError: there is one that cannot be read at the moment, or that another version wrote.
    """
    file = path / MANIFEST
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError, ValueError, RecursionError):
        return {}
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {described(error)}") from error
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
    """Raise where a file of that name is somebody else's, or would be written elsewhere."""
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
    old = [name for name, by in listed.items() if whole and by == maker and name not in names]
    kept = {name: by for name, by in listed.items() if name not in old}
    journal = {"remove": old, "files": kept | dict.fromkeys(names, maker)}
    (staging / _JOURNAL).write_text(json.dumps(journal, ensure_ascii=False), encoding="utf-8")
    done = path / staging.name.replace(_NEW, _DONE)
    os.rename(staging, done)
    _move_up(path, done)


def _waiting(path: Path) -> list[Path]:
    """Complete output that has not been moved up."""
    if not path.is_dir():
        return []
    return sorted(Path(entry.path) for entry in os.scandir(path) if entry.name.startswith(_DONE))


def _recover(path: Path) -> None:
    for done in _waiting(path):
        _move_up(path, done)


def _move_up(path: Path, done: Path) -> None:
    """Move complete output to where it belongs; every step may be the last, and the whole may be done again."""
    try:
        journal = json.loads((done / _JOURNAL).read_text(encoding="utf-8"))
        files, old = dict(journal["files"]), [str(name) for name in journal["remove"]]
    except (FileNotFoundError, ValueError, TypeError, KeyError, RecursionError):
        if not any(p.is_file() for p in done.rglob("*")):  # all was moved up, and it was about to go
            shutil.rmtree(done)
        return
    # The manifest first: what is not there yet does no harm, what is there and unlisted would be taken for a person's.
    listed = {"format": 1, "files": dict(sorted(files.items()))}
    (done / _LISTED).write_text(json.dumps(listed, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    os.replace(done / _LISTED, path / MANIFEST)
    for source in sorted(p for p in done.rglob("*") if not p.is_dir() and p != done / _JOURNAL):
        target = path / source.relative_to(done)
        if not target.parent.resolve().is_relative_to(path.resolve()):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(source, target)
    for name in old:
        gone = path / name
        if _is_inside(name) and gone.parent.resolve().is_relative_to(path.resolve()):
            gone.unlink(missing_ok=True)
            for parent in gone.relative_to(path).parents:
                with suppress(OSError):  # somebody's own files are in it
                    (path / parent).rmdir() if parent.parts else None
    shutil.rmtree(done)


def _sweep(path: Path) -> None:
    """Remove what processes have left that are no more."""
    for entry in list(os.scandir(path)):
        if entry.name.startswith(_NEW) and entry.is_dir(follow_symlinks=False):
            owner = _own(Path(entry.path))
            if owner is not None:
                shutil.rmtree(entry.path, ignore_errors=True)
                os.close(owner)


def _own(path: Path) -> int | None:
    """Hold a file or folder for as long as this process lives: its descriptor; None where another process holds it."""
    if fcntl is None:
        return None
    held = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(held)
        return None
    return held


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Be alone in opening and completing a folder."""
    if fcntl is None:
        yield
        return
    held = os.open(path, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(held, fcntl.LOCK_EX)
        yield
    finally:
        os.close(held)


@contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path; move it to `path` when the block ends well, remove it when not.

    Its rights are those that the process gives to new files (umask). What killed processes left in the folder goes.

    Raises:
      OSError: it cannot be written.
    """
    if any(part.startswith(_NEW) for part in path.parts):  # of a folder that appears as a whole
        path.parent.mkdir(parents=True, exist_ok=True)
        yield path
        return
    with _staging(path.parent) as folder:
        yield folder / path.name
        os.replace(folder / path.name, path)


def described(error: OSError) -> str:
    """What went wrong, in a few words."""
    if error.errno:
        return os.strerror(error.errno)
    return first_line(error)
