"""Pages of the site that are made when it is built: the reference of commands, of every YAML key and of Python, and the examples.

A hook of MkDocs (`mkdocs.yml`). Nothing of it is kept in the repository, so that it cannot differ from what the code does.
"""

from __future__ import annotations

import ast
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer.cli

from flexspline import _ELSEWHERE, commands
from flexspline import __all__ as public
from flexspline.commands.schema import KINDS, schema_of

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("models", "sim", "estimator", "scenarios", "diagnosis", "views", "commands")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made, and the JSON Schema files."""
    from mkdocs.structure.files import File

    made = {f"reference/{kind}.md": key_reference(title, schema_of(kind)) for kind, (_, _, title) in KINDS.items()}
    made |= {f"schemas/{kind}.schema.json": json.dumps(schema_of(kind), indent=1, ensure_ascii=False) for kind in KINDS}
    made |= {
        "reference/commands.md": commands_page(),
        "reference/python.md": python_page(),
        "reference/modules.md": modules_page(),
        "examples.md": examples_page(),
    }
    for path, text in made.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to the repository's own files lead to the page that shows them here."""
    markdown = re.sub(r"\]\(\.\./examples/(\w+)\.py\)", r"](examples.md#\1)", markdown)
    return re.sub(r"\[([^\]]*)\]\([\w.]+\.(?:csv|json)\)", r"\1", markdown)


def commands_page() -> str:
    """Write all commands: what they do, how they are called, their options."""
    command: Any = typer.main.get_command(commands.app)
    context = command.context_class(command, info_name="flexspline")
    return typer.cli.get_docs_for_click(obj=command, ctx=context, name="flexspline", title="Commands")


def python_page() -> str:
    """The public interface, from its docstrings."""
    parts = ["# Python", "`import flexspline as fs` has all of this; what is heavy is imported when it is first used."]
    for name in (n for n in public if not n.startswith("_")):
        where = f"flexspline.{_ELSEWHERE[name]}.{name}" if name in _ELSEWHERE else f"flexspline.{name}"
        parts.append(f"::: {where}")
    return "\n\n".join(parts) + "\n"


def modules_page() -> str:
    """Every module of the package with the first paragraph of its docstring."""
    parts = ["# Modules", "[Architecture](../architecture.md) says how the folders depend on each other."]
    for room in ROOMS:
        for folder in sorted({path.parent for path in (ROOT / room).rglob("*.py")}):
            parts.append(f"## {folder.relative_to(ROOT).as_posix()}/")
            rows = ["| module | purpose |", "|---|---|"]
            for path in sorted(folder.glob("*.py")):
                text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
                first = " ".join(text.partition("\n\n")[0].split()).replace("|", "\\|")
                if path.name != "__init__.py" or first:
                    rows.append(f"| `{path.name}` | {first} |")
            parts.append("\n".join(rows))
    return "\n\n".join(parts) + "\n"


def examples_page() -> str:
    """The programs of `examples/`, whole."""
    parts = ["# Programs", "Each runs in an empty folder; tests run them all."]
    for path in sorted((ROOT / "examples").glob("*.py")):
        text = path.read_text(encoding="utf-8")
        first = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
        parts += [f"## {path.stem}", first, f"```python\n{text}```"]
    return "\n\n".join(parts) + "\n"


def key_reference(title: str, schema: dict[str, Any]) -> str:
    """Write the page of a file's keys by its JSON Schema: a section for the file and for each of its parts."""
    known = schema.get("$defs", {})
    parts = [f"# {title}", *_section(schema, known)]
    for name, part in known.items():
        parts += [f"## {name}", *_section(part, known)]
    return "\n\n".join(parts) + "\n"


def _section(schema: dict[str, Any], known: dict[str, Any]) -> Iterator[str]:
    """Describe it, its alternatives, and its keys in a table."""
    yield schema.get("description", "").partition("\n\nAttributes:")[0]
    for other in schema.get("anyOf", ()):
        if "properties" not in other:
            yield f"A {other['type']} may be used instead."
    whole = next((one for one in schema.get("anyOf", ()) if "properties" in one), schema)
    required = whole.get("required", ())
    rows = ["| key | | default | |", "|---|---|---|---|"]
    for name, field in whole.get("properties", {}).items():
        default = "**needed**" if name in required else _default(field.get("default"))
        cells = (f"`{name}`", _type(field, known), default, _told(field))
        rows.append("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |")
    more = whole.get("additionalProperties")
    if isinstance(more, dict):
        rows.append(f"| … | {_type(more, known)} | | {more.get('description', 'Any other by its name.')} |")
    yield "\n".join(rows)


def _told(field: dict[str, Any]) -> str:
    """What a key says, a unit alone in brackets."""
    text = field.get("description", "")
    alone = re.fullmatch(r"[\w·/²³°√⁻]{1,12}", text)
    return f"[{text}]" if alone else text


def _default(value: Any) -> str:
    empty = value in (None, "", [], {}) or (isinstance(value, float) and not math.isfinite(value))
    return "" if empty else f"`{json.dumps(value, ensure_ascii=False)}`"


def _type(field: dict[str, Any], known: dict[str, Any]) -> str:
    """What a value may be, in words."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in field:
        return f"`{json.dumps(field['const'], ensure_ascii=False)}`"
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    choices = field.get("anyOf") or field.get("oneOf")
    if choices:
        return " or ".join(dict.fromkeys(_type(one, known) for one in choices if one.get("type") != "null"))
    kind = field.get("type", "anything")
    if kind == "array":
        return f"list of {_type(field.get('items', {}), known)}"
    if kind == "object":
        inside = field.get("additionalProperties")
        return f"by name: {_type(inside, known)}" if isinstance(inside, dict) else "keys and values"
    return {"string": "text", "boolean": "true, false"}.get(kind, kind) + _range(field)


def _range(field: dict[str, Any]) -> str:
    marks = (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
    ends = [f"{sign} {field[key]:g}" for key, sign in marks if key in field]
    return f" {', '.join(ends)}" if ends else ""
