"""Options that several commands share."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..models.errors import FilterDiverged, InputError

_SET_HELP = (
    "Override `KEY=VALUE` in the scenario, SI units, with dotted keys. Examples: `duration=20` [s], "
    "`controller.kp=6` [A/rad], `filters.2.k=0.1`, `plant.K1=9000` [N·m/rad], `temperature=40` [°C]. Repeatable."
)


def option(help: str, *names: str, **more: Any) -> Any:
    """Return what Typer needs of an option: its help, its names if not the parameter's, and more as of `typer.Option`."""
    return typer.Option(*names, help=help, **more)


def argument(help: str, **more: Any) -> Any:
    """Return what Typer needs of an argument."""
    return typer.Argument(help=help, **more)


def shipped(room: str) -> Callable[[str], list[str]]:
    """Return a function that completes names of the YAML files in a folder of the package."""

    def names(incomplete: str) -> list[str]:
        found = (path.stem for path in (Path(__file__).resolve().parents[1] / room).glob("*.yaml"))
        return sorted(name for name in found if name.startswith(incomplete))

    return names


AsJson = Annotated[bool, option("Print JSON instead of a table.", "--json")]
MeasurementPath = Annotated[Path, argument("a recording, or a folder of several of the same joint")]
ResultFolder = Annotated[Path, option("folder to write to")]
OtherJoint = Annotated[str | None, option("name or path of a joint; by default the recordings' joint")]
Scenarios = Annotated[
    list[str], argument("Names of shipped scenarios, or paths of YAML files.", autocompletion=shipped("scenarios"))
]
SomeScenarios = Annotated[
    list[str] | None,
    argument("Names or paths; the paper's three experiments by default.", autocompletion=shipped("scenarios")),
]
Out = Annotated[Path, option("Folder to write to; one folder per scenario inside.")]
Seed = Annotated[int | None, option("Seed of every random stream, instead of the scenario's.", min=0)]
Estimators = Annotated[list[str] | None, option("An estimator by its name; repeatable. All by default.", "--filter")]
Vary = Annotated[
    bool,
    option(
        "Draw start, pace and pushes per seed. Without it, all seeds have the same motion, and intervals over them are "
        "wrong."
    ),
]
Jobs = Annotated[
    int | None, option("How many at a time; all cores by default. The result does not depend on it.", min=1)
]
Changes = Annotated[list[str] | None, option(_SET_HELP, "--set", metavar="KEY=VALUE")]
Plugins = Annotated[
    list[Path] | None,
    option(
        "A file with your own estimators or causes; repeatable. See docs/plugins.md.", "--plugin", metavar="FILE.py"
    ),
]


def with_plugins(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option `--plugin` to a command; an error in a plugin is reported in one line."""

    @functools.wraps(command)
    def run(*, plugin: list[Path] | None = None, **options: Any) -> Any:
        from ..models import plugins

        with plugins.known(plugin or ()) as names:
            if names:
                from ..estimator import registry

                registry.check(names)
            try:
                return command(**options)
            except (InputError, FilterDiverged):
                raise
            except Exception as error:
                blamed = plugins.blamed(error)
                if blamed is None:
                    raise
                raise blamed from error

    given = inspect.signature(command, eval_str=True)
    option = inspect.Parameter("plugin", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Plugins)
    run.__signature__ = given.replace(parameters=[*given.parameters.values(), option])  # type: ignore[attr-defined]
    run.__annotations__ = {**command.__annotations__, "plugin": Plugins}
    return run
