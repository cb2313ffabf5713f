"""The one exception that a user is meant to read."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


class InputError(ValueError):
    """Input that cannot be used: a file, a field, a command-line value.

    The message is one line: where it is (file, field), what was expected and what came. Commands print it
    and exit with code 2; libraries may catch it.
    """


def nearest(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` for the closest of `known`, or an empty string."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else ""


def read_text(path: Path, what: str) -> str:
    """Read a text file; an unreadable one raises `InputError` that names it and says what it should be."""
    if path.exists() and not path.is_file():  # a folder; or a pipe, which may never end
        raise InputError(f"{path}: cannot read {what}: not a file")
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise InputError(f"{path}: cannot read {what}: {reason}") from error
