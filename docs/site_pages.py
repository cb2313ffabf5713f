"""Pages of the site that are made when it is built: the reference of commands, of every YAML key and of Python, and the examples.

A hook of MkDocs (`mkdocs.yml`). Nothing of it is kept in the repository, so that it cannot differ from what the code does.
"""

from __future__ import annotations

import ast
import importlib
import json
import re
from pathlib import Path
from typing import Any

from flexspline import __all__ as public
from flexspline import commands
from flexspline.commands.schema import KINDS, schema_of
from flexspline.views.key_reference import key_reference

ROOT = Path(__file__).resolve().parents[1]


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made, and the JSON Schema files."""
    from mkdocs.structure.files import File

    made = {f"reference/{kind}.md": key_reference(title, schema_of(kind)) for kind, (_, _, title) in KINDS.items()}
    made |= {f"schemas/{kind}.schema.json": json.dumps(schema_of(kind), indent=1, ensure_ascii=False) for kind in KINDS}
    made |= {
        "reference/commands.md": commands_page(),
        "reference/python.md": python_page(),
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
    """All commands: what they do, how they are called, their options."""
    parts = ["# Commands", commands._MORE]
    for folder in ("", "joint"):
        for name, module in commands._files(folder).items():
            if (ROOT / "commands" / folder / module).is_dir():
                continue
            words = f"{folder} {name}".strip()
            loaded = importlib.import_module(".".join(p for p in ("flexspline.commands", folder, module) if p))
            parts += [f"## {words}", commands._descriptions(folder)[name]]
            parts.append("```\n" + "\n".join(loaded.EXAMPLES) + "\n```")
            rows = ["| | |", "|---|---|"]
            for option in commands._load(name, folder).params:
                called = ", ".join(f"`{o}`" for o in (*option.opts, *option.secondary_opts) if o != "--help")
                if option.param_type_name == "argument":
                    called = f"`{option.metavar or option.name}`"
                told = getattr(option, "help", None) or ""
                rows.append(f"| {called} | {told} |".replace("\n", " "))
            parts.append("\n".join(row for row in rows if not row.startswith("|  |")))
    return "\n\n".join(parts) + "\n"


def python_page() -> str:
    """The public interface, from its docstrings."""
    parts = ["# Python", "`import flexspline as fs` has all of this; what is heavy is imported when it is first used."]
    lines = (ROOT / "flexspline" / "__init__.py").read_text(encoding="utf-8")
    elsewhere = dict(re.findall(r'^    "(\w+)": "([\w.]+)",$', lines, re.MULTILINE))
    for name in (n for n in public if not n.startswith("_")):
        where = f"flexspline.{elsewhere[name]}.{name}" if name in elsewhere else f"flexspline.{name}"
        parts.append(f"::: {where}")
    return "\n\n".join(parts) + "\n"


def examples_page() -> str:
    """The programs of `examples/`, whole."""
    parts = ["# Programs", "Each runs as it is, in an empty folder; tests run them all."]
    for path in sorted((ROOT / "examples").glob("*.py")):
        text = path.read_text(encoding="utf-8")
        told = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
        parts += [f"## {path.stem}", told, f"```python\n{text}```"]
    return "\n\n".join(parts) + "\n"
