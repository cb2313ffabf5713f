"""JSON Schema of the files that users write, for editors and the reference."""

from __future__ import annotations

import ast
import inspect
import textwrap
from functools import cache
from typing import Any


def documented(schema: dict[str, Any], model: type) -> None:
    """Complete the JSON Schema of a model alone in place (`json_schema_extra` of pydantic): descriptions from the
    docstrings below fields, and a short form of the model (`model.short`, a JSON type)."""
    texts = {name: text for one in reversed(model.__mro__) for name, text in _docstrings(one).items()}
    for name, field in schema.get("properties", {}).items():
        field.pop("title", None)
        if name in texts:
            field.setdefault("description", texts[name])
    schema["description"] = inspect.cleandoc(model.__doc__ or "")
    short = getattr(model, "short", None)
    if short:
        whole = dict(schema)
        schema.clear()
        schema |= {"description": whole["description"], "anyOf": [{"type": short}, whole]}


def json_schema(model: Any) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a file that a pydantic model reads."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema()}


@cache
def _docstrings(model: type) -> dict[str, str]:
    if not model.__module__.startswith(__name__.partition(".")[0]):
        return {}
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    found, field = {}, ""
    for node in getattr(tree, "body", ()):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            field = node.target.id
            continue
        if field and isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            found[field] = inspect.cleandoc(str(node.value.value))
        field = ""
    return found
