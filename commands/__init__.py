"""The command line: one file a command. A file here with a function `command` is a command of that file's name, with
`EXAMPLES` of how it is called, and a folder is a group of commands, described in its `__init__.py`.

What a command needs is imported when it is called, not before: `--help` reads the commands' docstrings from their files.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib
import io
import os
import pkgutil
import re
import signal
import sys
import warnings
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperCommand, TyperGroup

from ..models.errors import InputError, InputWarning

_MARKUP: Any = "markdown"
_CONTEXT: dict[str, Any] = {"help_option_names": ["-h", "--help"]}
_MORE = """`flexspline COMMAND -h` has options and examples; `--install-completion` makes your shell complete them.

**Exit codes**: 0 done; 1 a limit is missed (`verify`); 2 input that cannot be used, said in one line on stderr; 130 Ctrl-C;
141 whoever read the output had enough; 143 asked to end (SIGTERM)."""


class _Commands(TyperGroup):
    """The commands of a folder; each is only described until it is called."""

    folder = ""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(_descriptions(self.folder))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        found = _descriptions(self.folder)
        return TyperCommand(cmd_name, help=found[cmd_name]) if cmd_name in found else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        self.commands = {
            name: self.get_command(ctx, name) for name in _descriptions(self.folder)
        }  # what a misspelt one may have meant
        name, found, rest = super().resolve_command(ctx, args)
        return name, found and _load(args[0], self.folder), rest


app = typer.Typer(
    name="flexspline",
    cls=_Commands,
    no_args_is_help=True,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=_MARKUP,
    context_settings=_CONTEXT,
    epilog=_MORE,
)


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version, and those of what it is made of, and exit.")
    ] = False,
) -> None:
    """A testbed for joint torque estimation with harmonic drives."""
    if version:
        print(versions())
        raise typer.Exit()


def versions() -> str:
    """Versions for a report of a bug: of this package, of Python, of what the package needs, a line each."""
    import platform
    import re
    from importlib import metadata

    lines = [f"flexspline {metadata.version('flexspline')}"]
    lines.append(f"Python {platform.python_version()} on {platform.system()} {platform.release()} {platform.machine()}")
    for needed in metadata.requires("flexspline") or ():
        name, _, condition = needed.partition(";")
        if "extra" not in condition:
            name = re.split(r"[^\w.-]", name.strip())[0]
            lines.append(f"{name} {metadata.version(name)}")
    return "\n".join(lines)


@cache
def _files(folder: str = "") -> dict[str, str]:
    """Module of every command in a folder, by the command's name."""
    path = Path(__file__).parent / folder
    names = sorted(module.name for module in pkgutil.iter_modules([str(path)]) if not module.name.startswith("_"))
    return {name.rstrip("_").replace("_", "-"): name for name in names}


@cache
def _descriptions(folder: str = "") -> dict[str, str]:
    """Docstring of every command's function, or of a group's folder, by the command's name, without importing any."""
    found = {}
    for name, module in _files(folder).items():
        path = Path(__file__).parent / folder / module
        if path.is_dir():
            found[name] = ast.get_docstring(ast.parse((path / "__init__.py").read_text(encoding="utf-8"))) or ""
            continue
        tree = ast.parse(path.with_suffix(".py").read_text(encoding="utf-8"))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name == "command":
                found[name] = ast.get_docstring(node) or ""
    return found


def _load(name: str, folder: str = "") -> Any:
    """The command of that name, ready to be called."""
    module = _files(folder)[name]
    alone = typer.Typer(
        add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=_MARKUP, context_settings=_CONTEXT
    )
    if (Path(__file__).parent / folder / module).is_dir():
        group = type("_Group", (_Commands,), {"folder": module})
        alone.callback(cls=group, help=_descriptions()[name], no_args_is_help=True)(lambda: None)
        return typer.main.get_command(alone)
    loaded = importlib.import_module(".".join(part for part in (__name__, folder, module) if part))
    function = loaded.command

    @functools.wraps(function)
    def command(**options: Any) -> None:
        _need_room()
        function(**{key: _usable(value, key) for key, value in options.items()})

    examples = "\n\n".join(("**Examples**", *(f"    {line}" for line in loaded.EXAMPLES)))
    alone.command(name, epilog=examples, context_settings=_CONTEXT)(command)
    return typer.main.get_command(alone)


_ROOM = 1_200_000_000
"""Bytes of address space that the libraries take: with less their own code aborts, or spins and hears no signal."""


def _need_room() -> None:
    """Refuse to begin in too small an address space.

    Raises:
      InputError: less than `_ROOM`.
    """
    with contextlib.suppress(ImportError):  # not on Windows
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_AS)
        if soft != resource.RLIM_INFINITY and soft < _ROOM:
            raise InputError(
                f"out of memory: expected {_ROOM // 10**6} MB of address space (`ulimit -v`), got {soft // 10**6}"
            )


def _usable(value: Any, key: str) -> Any:
    """A path with its `~` for the home folder, which a shell leaves alone in `--out=~/runs`; any other value as it is, where its
    text can be written and its numbers can be used.

    Raises:
      InputError: a number that is none or next to none, no home folder, text that is not UTF-8, a link that leads to itself.
    """
    if isinstance(value, float) and not (value == 0.0 or 1e-100 < abs(value) < 1e100):
        raise InputError(f"{key.replace('_', '-')}: expected 0 or a number from 1e-100 to 1e100, got {value:g}")
    if isinstance(value, (list, tuple)):
        return [_usable(one, key) for one in value]
    if not isinstance(value, (str, Path)):
        return value
    try:
        str(value).encode()
    except UnicodeEncodeError as error:
        raise InputError(
            f"{str(value).encode(errors='replace').decode()}: expected text in UTF-8, got bytes that are none; "
            "LC_ALL=C.UTF-8 shows names that are"
        ) from error
    if isinstance(value, str):
        return value
    try:
        found = value.expanduser()
    except RuntimeError as error:
        raise InputError(f"{value}: expected a home folder for ~, found none") from error
    try:
        found.resolve()
    except (RuntimeError, OSError) as error:  # of links that lead to each other; Python 3.13 says nothing
        raise InputError(f"{value}: expected a file or folder, got a link that leads to itself") from error
    return found


def main() -> None:
    """Run the command line: exit code 2 and one line for input that cannot be used, no traceback; 141 and nothing where
    the reader of the output closed it.

    Ctrl-C and SIGTERM end it at once (130, 143); what is being written then is not left behind.
    """
    streams = sys.stdout, sys.stderr  # Typer puts others in their place
    try:
        _run()
    except BrokenPipeError:
        _drop_unread(streams)
        sys.exit(_UNREAD)
    except SystemExit as stop:  # Rich and Typer make 1 of a broken pipe; a short output fails in the last flush
        if _drop_unread(streams) or isinstance(stop.__context__, BrokenPipeError):
            sys.exit(_UNREAD)
        raise


_UNREAD = 141
"""Exit code where the reader closed the output: that of shells for SIGPIPE."""


def _drop_unread(streams: Iterable[TextIO]) -> bool:
    """Flush the output; return whether a reader is gone, whose stream then leads nowhere: Python would complain at its end."""
    unread = False
    for stream in streams:
        try:
            stream.flush()
        except BrokenPipeError:
            unread = True
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
        except (OSError, ValueError):  # a full disk, a stream that is closed: for Python to say
            pass
    return unread


def _run() -> NoReturn:
    with contextlib.suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGINT, _end)
        signal.signal(signal.SIGTERM, _end)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that cannot show µ or °
            stream.reconfigure(errors="replace")
    warnings.showwarning = _notice
    try:
        code = app(prog_name="flexspline", standalone_mode=False)
    except InputError as error:
        _refuse(error)
    except _UsageError as error:
        _explain(error)
    except ArithmeticError as error:
        from ..estimator.errors import FilterDiverged

        if not isinstance(error, FilterDiverged):
            raise
        _refuse(error)
    except BrokenPipeError:  # before it is taken for an error of the system
        raise
    except OSError as error:  # of the system: a disk, rights, a network folder
        where = f"{error.filename}: " if error.filename else ""
        reason = os.strerror(error.errno) if error.errno else str(error)
        _refuse(InputError(f"{where}{reason}"))
    except MemoryError:
        _refuse(InputError("out of memory"))
    sys.exit(code if isinstance(code, int) else 0)


def _end(number: int, frame: Any) -> NoReturn:
    """End at once on Ctrl-C or SIGTERM, without waiting for threads or compiled code, and leave nothing half-written.

    Nothing is raised: compiled code and libraries would drop it.
    """
    output = sys.modules.get(f"{__name__.rpartition('.')[0]}.models.output")  # else nothing is being written
    said = output.abandon() if output is not None else ""
    pools = sys.modules.get("multiprocessing.util")
    if pools is not None:
        pools._run_finalizers(0)  # else its tracker complains of semaphores
    if number == signal.SIGINT:
        with contextlib.suppress(OSError):
            cursor = b"\r\x1b[2K\x1b[?25h" if os.isatty(2) else b""  # a progress bar hides it
            os.write(2, cursor + f"{said or 'flexspline: interrupted, nothing is half-written'}\n".encode())
    os._exit(128 + number)


_otherwise = warnings.showwarning


def _notice(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: Any = None,
    line: str | None = None,
) -> None:
    """Print a warning of ours in one line, once; any other as Python does."""
    if issubclass(category, InputWarning):
        _say(message, "yellow")
    else:
        _otherwise(message, category, filename, lineno, file, line)


_UsageError: Any = typer.BadParameter.__base__
"""What Typer raises where a command is not called as it wants to be; its own class has no public name."""


def _explain(error: Any) -> NoReturn:
    """Say in one line what is wrong with a call; help where it was called without anything."""
    if type(error).__name__ == "NoArgsIsHelpError":
        error.show()
        sys.exit(error.exit_code)
    from ..models.files import OWN_ERROR

    first = sys.argv[1:2]
    known = first + [word for word in sys.argv[2:3] if word in _files("joint")] if first == ["joint"] else first
    where = " ".join(word for word in known if first[0] in _files())
    message = error.format_message().strip().removesuffix(".")
    if message.startswith("Invalid value for"):
        name, _, expected = message.removeprefix("Invalid value for ").partition(": ")
        expected = (
            expected.removeprefix(OWN_ERROR).replace("Input should be", "expected", 1).split(", unable to parse")[0]
        )
        expected = re.sub(r"^(\S.*) is not one of (.*)$", r"expected one of \2, got \1", expected)
        given = _given(getattr(error, "param", None))
        message = f"{name.strip(chr(39))}: {expected}"
        message += "" if given is None or repr(given) in message else f", got {given!r}"
    else:
        message = message[:1].lower() + message[1:]
    help_words = " ".join(filter(None, ("flexspline", where, "-h")))
    _refuse(InputError(f"{': '.join(filter(None, (where, message)))}; `{help_words}` has options and examples"))


def _given(parameter: Any) -> str | None:
    """The value of an option as it was written."""
    for name in getattr(parameter, "opts", ()):
        for word, following in zip(sys.argv, [*sys.argv[1:], None], strict=True):
            if word == name or word.startswith(f"{name}="):
                return following if word == name else word.removeprefix(f"{name}=")
    return None


def _refuse(error: Exception) -> NoReturn:
    _say(error, "red")
    sys.exit(2)


def _say(message: object, style: str) -> None:
    from rich.console import Console

    Console(stderr=True, soft_wrap=True, emoji=False).print(
        f"flexspline: {message}", style=style, markup=False, highlight=False
    )
