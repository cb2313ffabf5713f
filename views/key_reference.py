"""Every key of a file that people write, as Markdown tables, from the JSON Schema of its model."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from typing import Any


def key_reference(title: str, schema: dict[str, Any]) -> str:
    """The page of a file's keys: a section for the file and for everything that it is made of, in the order of mention.

    Args:
      title: of the page.
      schema: JSON Schema of the file (`models.schema.json_schema`).
    """
    known = schema.get("$defs", {})
    parts = [f"# {title}", *_section(schema, known)]
    for name in _mentioned(schema, known):
        parts += [f"## {name}", *_section(known[name], known)]
    return "\n\n".join(parts) + "\n"


def _mentioned(schema: dict[str, Any], known: dict[str, Any]) -> list[str]:
    """Names of definitions in the order in which they are first mentioned, those inside others after them."""
    found: list[str] = []
    waiting: list[Any] = [{key: value for key, value in schema.items() if key != "$defs"}]
    while waiting:
        for name in re.findall(r'"#/\$defs/(\w+)"', json.dumps(waiting.pop(0))):
            if name not in found:
                found.append(name)
                waiting.append(known[name])
    return found


def _section(schema: dict[str, Any], known: dict[str, Any]) -> Iterator[str]:
    """What it is, what may stand in its place, and a table of its keys."""
    yield schema.get("description", "").partition("\n\nAttributes:")[0]
    for other in schema.get("anyOf", ()):
        if "properties" not in other:
            yield f"A {other['type']} may stand in its place."
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
