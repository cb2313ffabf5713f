"""`flexspline schema`: JSON Schemas of YAML files, for editors."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated, Any

from ..models.errors import InputError, nearest
from ..models.output import output_folder
from ._options import argument, option, with_plugins

EXAMPLES = ("flexspline schema scenario", "flexspline schema --out schemas")
KINDS = {
    "joint": ("models.joint", "Joint", "A joint's description"),
    "gear": ("models.gear_sheet", "GearSheet", "A gear's data sheet"),
    "scenario": ("scenarios.scenario", "Scenario", "A scenario"),
    "arm": (
        "scenarios.arms.arm_scenario",
        "ArmScenario",
        "A scenario of an arm: joints in series or on hinges of a model",
    ),
    "study": ("scenarios.studies.study", "Study", "A study"),
    "recording": ("models.recording", "Sidecar", "The YAML file of a recording"),
    "mapping": ("diagnosis.data.importing", "Layout", "A mapping from another program's log"),
}
"""Kind of file: module and class that read it, and its title."""


@with_plugins
def command(
    kind: Annotated[str, argument(f"of file: {', '.join(KINDS)}", autocompletion=lambda: list(KINDS))] = "",
    out: Annotated[Path | None, option("folder to write a file of each kind to")] = None,
) -> Any:
    """Print the JSON Schema of a kind of YAML file, for completion and checks in editors.

    The first line `# yaml-language-server: $schema=scenario.schema.json` assigns it to a file.
    """
    from ..models.files import write_json

    if kind not in ("", *KINDS):
        raise InputError(f"kind {kind!r}: expected one of {', '.join(KINDS)}{nearest(kind, KINDS)}")
    if out is None:
        if not kind:
            raise InputError(f"kind: expected one of {', '.join(KINDS)}, or --out for all, got none")
        return schema_of(kind)

    names = {f"{one}.schema.json": one for one in ([kind] if kind else KINDS)}
    with output_folder(out, "schema", writes=list(names)) as folder:
        for name, one in names.items():
            write_json(folder / name, schema_of(one))
    for name in names:
        print(out / name)


def schema_of(kind: str) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a kind of file, of `KINDS`."""
    module, name, title = KINDS[kind]
    package = __name__.partition(".")[0]
    model = getattr(importlib.import_module(f"{package}.{module}"), name)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema(), "title": title}
