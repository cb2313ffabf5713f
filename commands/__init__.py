"""The command line: one file a command. A file here with a function `command` is a command of that file's name.

What a command needs is imported when it is called, not before: `--help` reads the commands' docstrings from their files.
"""

from __future__ import annotations

import ast
import importlib
import pkgutil
import sys
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from ..models.errors import InputError

_MARKUP: Any = "markdown"


class _Commands(TyperGroup):
    """The commands; each is only described until it is called."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(_descriptions())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in _descriptions():
            return None
        return TyperCommand(cmd_name, help=_descriptions()[cmd_name])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        self.commands = {
            name: self.get_command(ctx, name) for name in _descriptions()
        }  # what a misspelt one may have meant
        name, found, rest = super().resolve_command(ctx, args)
        return name, found and _load(args[0]), rest


app = typer.Typer(
    name="flexspline",
    cls=_Commands,
    no_args_is_help=True,
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=_MARKUP,
)


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """A testbed for joint torque estimation with harmonic drives."""
    if version:
        from importlib import metadata

        print(metadata.version("flexspline"))
        raise typer.Exit()


@cache
def _files() -> dict[str, str]:
    """Module of every command, by the command's name."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))
    return {name.rstrip("_").replace("_", "-"): name for name in names}


@cache
def _descriptions() -> dict[str, str]:
    """Docstring of every command's function, by the command's name, without importing any."""
    found = {}
    for name, module in _files().items():
        tree = ast.parse((Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8"))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name == "command":
                found[name] = ast.get_docstring(node) or ""
    return found


def _load(name: str) -> Any:
    """The command of that name, ready to be called."""
    module = importlib.import_module(f"{__name__}.{_files()[name]}")
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=_MARKUP)
    alone.command(name)(module.command)
    return typer.main.get_command(alone)


def main() -> None:
    """Run the command line: exit code 2 and one line for input that cannot be used, no traceback."""
    try:
        app()
    except InputError as error:
        _refuse(error)
    except ArithmeticError as error:
        from ..estimator.errors import FilterDiverged

        if not isinstance(error, FilterDiverged):
            raise
        _refuse(error)
    except KeyboardInterrupt:
        sys.exit(130)


def _refuse(error: Exception) -> NoReturn:
    from rich.console import Console

    Console(stderr=True, soft_wrap=True).print(f"flexspline: {error}", style="red", markup=False, highlight=False)
    sys.exit(2)
