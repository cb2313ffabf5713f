"""The command line. A file here with a function `command` is the command of that name; a folder is a group of commands;
`lists` has the commands without a file of their own.

A command's file imports what it needs when it is called: `--help` loads all of these files. With `--json`, `command` returns
what is printed as JSON.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import io
import os
import pkgutil
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperGroup

from ..models.errors import FilterDiverged, InputError, InputWarning

GROUPS = {
    "Simulate": ("run", "compare", "sweep", "tune", "bound", "contact", "verify"),
    "Measure": ("import", "check", "estimate", "bode"),
    "Diagnose": ("diagnose", "plan", "validate", "challenge"),
    "Joints and robots": ("joint", "export", "export-estimator", "schema"),
    "Look": ("view", "report", "scenarios", "studies", "joints", "estimators", "causes", "sensors"),
}
"""Commands by what they are for, in the order of the help."""
_MORE = """`flexspline COMMAND -h` has options and examples; `--install-completion` makes your shell complete them.

**Exit codes**: 0 done; 1 a limit is missed (`verify`); 2 unusable input, explained in one line on stderr; 130 Ctrl-C;
141 the reader closed the output; 143 SIGTERM."""
_STYLE: dict[str, Any] = {
    "pretty_exceptions_enable": False,
    "rich_markup_mode": "markdown",
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


@cache
def _files(folder: str = "") -> dict[str, str]:
    """Module of every command in a folder, by the command's name, in the order of the help."""
    found = sorted(m.name for m in pkgutil.iter_modules([str(Path(__file__).parent / folder)]) if m.name[0] != "_")
    names = {module.rstrip("_").replace("_", "-"): module for module in found}
    return names if folder else {name: names.get(name, "lists") for group in GROUPS.values() for name in group}


class _Commands(TyperGroup):
    """The commands of a folder, each loaded when it is asked for."""

    folder = ""

    def __init__(self, **attributes: Any):
        super().__init__(**attributes)
        self.commands: Any = dict.fromkeys(_files(self.folder))

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.commands)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return _load(cmd_name, self.folder) if cmd_name in self.commands else None


app = typer.Typer(
    name="flexspline", cls=_Commands, no_args_is_help=True, invoke_without_command=True, epilog=_MORE, **_STYLE
)


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the versions of this package and of its dependencies, and exit.")
    ] = False,
) -> None:
    """A testbed for joint torque estimation with harmonic drives."""
    if version:
        print(versions())
        raise typer.Exit()


def versions() -> str:
    """Return a line each for this package, Python and the dependencies: for a bug report."""
    import platform
    from importlib import metadata

    lines = [f"flexspline {metadata.version('flexspline')}"]
    lines.append(f"Python {platform.python_version()} on {platform.system()} {platform.release()} {platform.machine()}")
    for needed in metadata.requires("flexspline") or ():
        name, _, condition = needed.partition(";")
        if "extra" not in condition:
            name = re.split(r"[^\w.-]", name.strip())[0]
            lines.append(f"{name} {metadata.version(name)}")
    return "\n".join(lines)


def find(name: str, folder: str = "") -> tuple[Callable[..., Any], tuple[str, ...]]:
    """Return a command's function, and command lines that show how it is used."""
    loaded = _module(name, folder)
    if hasattr(loaded, "command"):
        return loaded.command, loaded.EXAMPLES
    return getattr(loaded, name), loaded.EXAMPLES[name]


def _module(name: str, folder: str) -> Any:
    return importlib.import_module(".".join(part for part in (__name__, folder, _files(folder)[name]) if part))


def _load(name: str, folder: str = "") -> Any:
    loaded = _module(name, folder)
    single = typer.Typer(add_completion=False, **_STYLE)
    if hasattr(loaded, "__path__"):
        group = type("_Group", (_Commands,), {"folder": name})
        single.callback(cls=group, help=loaded.__doc__, no_args_is_help=True)(lambda: None)
    else:
        run, examples = find(name, folder)

        @functools.wraps(run)
        def command(**options: Any) -> None:
            _check_address_space()
            answer = run(**{key: _usable(value, key) for key, value in options.items()})
            if answer is not None:
                from ..models.files import json_text

                print(json_text(answer))

        epilog = "\n\n".join(("**Examples**", *(f"    {line}" for line in examples)))
        context = _STYLE["context_settings"]
        single.command(name, help=inspect.getdoc(run), epilog=epilog, context_settings=context)(command)
    built: Any = typer.main.get_command(single)
    built.name, built.short_help = name, built.help.partition("\n\n")[0]
    built.rich_help_panel = next((title for title, names in GROUPS.items() if not folder and name in names), None)
    return built


_ADDRESS_SPACE = 1_200_000_000
"""Bytes that the libraries need: with less, their own code aborts, or runs for ever and ignores signals."""


def _check_address_space() -> None:
    with contextlib.suppress(ImportError):  # not on Windows
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_AS)
        if soft != resource.RLIM_INFINITY and soft < _ADDRESS_SPACE:
            raise InputError(
                f"out of memory: expected {_ADDRESS_SPACE // 10**6} MB of address space (`ulimit -v`), "
                f"got {soft // 10**6}"
            )


def _usable(value: Any, key: str) -> Any:
    """Return an option's value, of a path with `~` replaced by the home folder. Raises `InputError`: a number that is
    infinite or tiny, no home folder, text that is not UTF-8, a link to itself."""
    if isinstance(value, float) and not (value == 0.0 or 1e-100 < abs(value) < 1e100):
        raise InputError(f"{key.replace('_', '-')}: expected 0 or a number from 1e-100 to 1e100, got {value:g}")
    if isinstance(value, (list, tuple)):
        return [_usable(one, key) for one in value]
    if not isinstance(value, (str, Path)):
        return value
    try:
        str(value).encode()
    except UnicodeEncodeError as error:
        shown = str(value).encode(errors="replace").decode()
        raise InputError(
            f"{shown}: expected text in UTF-8, got other bytes; LC_ALL=C.UTF-8 shows such names"
        ) from error
    if isinstance(value, str):
        return value
    try:
        found = value.expanduser()
    except RuntimeError as error:
        raise InputError(f"{value}: expected a home folder for ~, found none") from error
    try:
        found.resolve()
    except (RuntimeError, OSError) as error:  # links to each other; Python 3.13 accepts them
        raise InputError(f"{value}: expected a file or folder, got a link that leads to itself") from error
    return found


def main() -> None:
    """Run the command line, and exit with the code that its help lists.

    Ctrl-C and SIGTERM end it at once; unfinished output is removed.
    """
    streams = sys.stdout, sys.stderr  # Typer replaces them
    try:
        _run()
    except BrokenPipeError:
        _drop_unread(streams)
        sys.exit(_UNREAD)
    except SystemExit as stop:  # Rich and Typer turn a broken pipe into 1; a short output fails in the last flush
        if _drop_unread(streams) or isinstance(stop.__context__, BrokenPipeError):
            sys.exit(_UNREAD)
        raise


_UNREAD = 141  # exit code where the reader closed the output: that of shells for SIGPIPE


def _drop_unread(streams: Iterable[TextIO]) -> bool:
    """Flush the output; return whether a reader is gone. Its stream is then redirected: Python would complain at exit."""
    unread = False
    for stream in streams:
        try:
            stream.flush()
        except BrokenPipeError:
            unread = True
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
        except (OSError, ValueError):  # a full disk, a closed stream: Python reports it
            pass
    return unread


def _run() -> NoReturn:
    with contextlib.suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGINT, _end)
        signal.signal(signal.SIGTERM, _end)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without µ or °
            stream.reconfigure(errors="replace")
    warnings.showwarning = _show_warning
    try:
        code = app(prog_name="flexspline", standalone_mode=False)
    except (InputError, FilterDiverged) as error:
        _refuse(error)
    except _UsageError as error:
        _explain(error)
    except BrokenPipeError:  # an OSError, which `main` handles
        raise
    except OSError as error:  # a disk, permissions, a network folder
        where = f"{error.filename}: " if error.filename else ""
        _refuse(f"{where}{os.strerror(error.errno) if error.errno else error}")
    except MemoryError:
        _refuse("out of memory")
    sys.exit(code if isinstance(code, int) else 0)


def _end(number: int, frame: Any) -> NoReturn:
    """End at once on Ctrl-C or SIGTERM, without waiting for threads or compiled code, and remove unfinished output.

    It raises nothing: compiled code and libraries would drop the exception.
    """
    output = sys.modules.get(f"{__name__.rpartition('.')[0]}.models.output")
    abandon = getattr(output, "abandon", str)  # before it is loaded, nothing is being written
    message = abandon()
    pools = sys.modules.get("multiprocessing.util")
    if pools is not None:
        pools._run_finalizers(0)  # else its resource tracker reports semaphores
    if number == signal.SIGINT:
        with contextlib.suppress(OSError):
            cursor = b"\r\x1b[2K\x1b[?25h" if os.isatty(2) else b""  # a progress bar hides it
            os.write(2, cursor + f"{message or 'flexspline: interrupted, nothing is half-written'}\n".encode())
    os._exit(128 + number)


_default_show_warning = warnings.showwarning


def _show_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    """Print a warning of this package in one line; any other as Python does."""
    if issubclass(category, InputWarning):
        _print(message, "yellow")
    else:
        _default_show_warning(message, category, *where, **more)


_UsageError: Any = typer.BadParameter.__base__  # what Typer raises for a wrong call; its own class has no public name


def _explain(error: Any) -> NoReturn:
    """Print in one line what is wrong with a call; the help where there were no words."""
    if type(error).__name__ == "NoArgsIsHelpError":
        error.show()
        sys.exit(error.exit_code)
    from ..models.files import OWN_ERROR

    words, where = sys.argv[1:3], ""
    if words and words[0] in _files():
        where = " ".join(words[:2] if words[0] == "joint" and words[-1] in _files("joint") else words[:1])
    message = error.format_message().strip().removesuffix(".")
    if message.startswith("Invalid value for"):
        name, _, expected = message.removeprefix("Invalid value for ").partition(": ")
        expected = expected.removeprefix(OWN_ERROR).replace("Input should be", "expected", 1)
        expected = expected.split(", unable to parse")[0]
        expected = re.sub(r"^(\S.*) is not one of (.*)$", r"expected one of \2, got \1", expected)
        expected = re.sub(r"^\S+ is not in the range ", "expected ", expected)  # older versions of Typer
        given = _given(getattr(error, "param", None))
        message = f"{name.strip(chr(39))}: {expected}"
        message += "" if given is None or repr(given) in message else f", got {given!r}"
    else:
        message = message[:1].lower() + message[1:]
    call = " ".join(filter(None, ("flexspline", where, "-h")))
    _refuse(f"{': '.join(filter(None, (where, message)))}; `{call}` has options and examples")


def _given(parameter: Any) -> str | None:
    """The value of an option as it was written."""
    for name in getattr(parameter, "opts", ()):
        for word, following in zip(sys.argv, [*sys.argv[1:], None], strict=True):
            if word == name or word.startswith(f"{name}="):
                return following if word == name else word.removeprefix(f"{name}=")
    return None


def _refuse(error: Exception | str) -> NoReturn:
    _print(InputError(str(error)), "red")
    sys.exit(2)


def _print(message: object, style: str) -> None:
    from rich.console import Console

    terminal = Console(stderr=True, soft_wrap=True, emoji=False)
    try:
        terminal.print(f"flexspline: {message}", style=style, markup=False, highlight=False)
    except BrokenPipeError:
        raise
    except OSError:  # a full disk: the exit code says it
        pass
