"""The one exception for users."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

LARGEST_TEXT = 10_000_000  # most bytes of a text file of a user; ten times the largest that we write

_FEW = 40  # most keys in a message


class InputError(ValueError):
    """Input that cannot be used: a file, a field, a command-line value.

    The message is one line: place (file, field), expected, got. Commands print it and exit with code 2; libraries may
    catch it.
    """

    def __init__(self, message: str):
        text = one_line(message)
        super().__init__(text if len(text) <= 1000 else f"{text[:600]} … {text[-300:]}")


class FilterDiverged(ArithmeticError):
    """The next estimate would not be a finite number with a positive definite covariance.

    The message is one line: filter, step, time [s], reason.

    Attributes:
      filter: name of the estimator.
      step: index of the measurement.
      time: its time [s].
      reason: the reason.
    """

    def __init__(self, filter: str, step: int, time: float, reason: str):
        self.filter, self.step, self.time, self.reason = filter, step, time, reason
        super().__init__(f"filter {filter!r} diverged at step {step}, t = {time:g} s: {reason}")

    def __reduce__(self) -> tuple[type[FilterDiverged], tuple[str, int, float, str]]:
        return type(self), (self.filter, self.step, self.time, self.reason)


class InputWarning(UserWarning):
    """Unusual input that is used; the message is one line, as that of an `InputError`."""


def one_line(text: str) -> str:
    """Return text as one line without control characters for a terminal."""
    return "".join(c if c.isprintable() else " " if c in "\n\t" else f"\\x{ord(c):02x}" for c in text)


def whole(error: BaseException) -> str:
    """Return an error's message as one line."""
    return " ".join(str(error).split())


@contextmanager
def refusing(what: str) -> Iterator[None]:
    """Turn a `ValueError` of MuJoCo into an `InputError`: `what`, and the message in a line."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"{what}: {whole(error)}") from error


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message; its type if it has none."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def nearest(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` for the closest of `known`, or an empty string."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else ""


def unknown_key(name: str, known: Iterable[str]) -> str:
    """Return `unknown key` with the closest of `known`; if none is close and they are few, with all of them."""
    names = list(dict.fromkeys(known))
    few = f"; expected one of {names}" if 0 < len(names) <= _FEW else ""
    return f"unknown key{nearest(name, names) or few}"


def is_there(path: Path) -> bool:
    """Return whether a file or folder exists; False for an impossible name."""
    try:
        return path.exists()
    except (OSError, ValueError):  # too long, or with a null byte
        return False


def read_text(path: Path, what: str, largest: int = LARGEST_TEXT) -> str:
    """Read a text file of at most `largest` bytes; an unreadable one raises `InputError`. `what`: its content, for
    messages."""
    try:
        if is_there(path) and not path.is_file():  # a folder; or a pipe, which may never end
            raise InputError(f"{path}: cannot read {what}: not a file")
        if is_there(path) and path.stat().st_size > largest:
            raise InputError(f"{path}: cannot read {what}: expected at most {largest} bytes")
        return path.read_text(encoding="utf-8-sig")
    except InputError:
        raise
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}:{line}: cannot read {what}: not UTF-8 text") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot read {what}: {getattr(error, 'strerror', None) or error}") from error


def check_each_once(names: Sequence[str], what: str) -> None:
    """Refuse names of which one is given more than once. Raises `InputError`: `what` they are, and the first such name."""
    for name in names:
        if (count := names.count(name)) > 1:
            times = "twice" if count == 2 else f"{count} times"
            raise InputError(f"{what}: expected each once, got {name!r} {times}")
