"""The command line: one file a command. A file here with a function `command` is a command of that file's name."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from importlib import metadata
from typing import Annotated

import typer
from rich.console import Console

from ..estimator import FilterDiverged
from ..models.errors import InputError

app = typer.Typer(
    name="flexspline",
    no_args_is_help=True,
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """A testbed for joint torque estimation with harmonic drives."""
    if version:
        print(metadata.version("flexspline"))
        raise typer.Exit()


def _register() -> None:
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda m: m.name):
        if module.name.startswith("_"):
            continue
        function = getattr(importlib.import_module(f"{__name__}.{module.name}"), "command", None)
        if function is not None:
            app.command(module.name.rstrip("_").replace("_", "-"))(function)


def main() -> None:
    """Run the command line: exit code 2 and one line for input that cannot be used, no traceback."""
    _register()
    try:
        app()
    except (InputError, FilterDiverged) as error:
        Console(stderr=True, soft_wrap=True).print(f"flexspline: {error}", style="red", markup=False, highlight=False)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
