"""Schemas: every shipped file is valid, wrong files are not, and every key has a description."""

from __future__ import annotations

import json
from pathlib import Path
from runpy import run_path

import pytest
import yaml

from flexspline.commands.schema import KINDS, schema_of
from flexspline.models.files import read_yaml

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = [
    *(("joint", path) for path in sorted((ROOT / "models").glob("*.yaml"))),
    *(("scenario", path) for path in sorted((ROOT / "scenarios").glob("*.yaml"))),
    *(("study", path) for path in sorted((ROOT / "scenarios" / "studies").glob("*.yaml"))),
    *(("arm", path) for path in sorted((ROOT / "scenarios" / "arms").glob("*.yaml"))),
    *(("mapping", path) for path in sorted((ROOT / "diagnosis" / "data" / "layouts").glob("*.yaml"))),
]


def errors(kind: str, data: object) -> list[str]:
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(json.dumps(schema_of(kind)).replace("Infinity", "null"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return [e.message for e in jsonschema.Draft202012Validator(schema).iter_errors(data)]


@pytest.mark.parametrize(("kind", "path"), SHIPPED, ids=[f"{kind} {path.stem}" for kind, path in SHIPPED])
def test_shipped_files_follow_their_schema(kind, path):
    assert not errors(kind, read_yaml(path, kind))


def test_what_is_wrong_does_not():
    scenario = yaml.safe_load((ROOT / "scenarios" / "link_sweep.yaml").read_text(encoding="utf-8"))
    for change in ({"duratoin": 3}, {"duration": -1}, {"duration": "long"}, {"filters": [3]}, {"trajectory": []}):
        assert errors("scenario", scenario | change), change
    for fine in ({"temperature": 30}, {"filters": ["RAREKF", {"name": "slow", "rule": "ekf", "k": 0.1}]}):
        assert not errors("scenario", scenario | fine), fine


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_says_what_it_is(kind):
    schema = schema_of(kind)
    silent = []
    for name, one in {kind: schema, **schema.get("$defs", {})}.items():
        whole = next((part for part in one.get("anyOf", ()) if "properties" in part), one)
        for key, field in whole.get("properties", {}).items():
            if "const" not in field and "description" not in field:
                silent.append(f"{name}.{key}")
        assert one["description"]
    assert not silent
    page = run_path(str(ROOT / "docs" / "site_pages.py"))["key_reference"](KINDS[kind][2], schema)
    assert all(f"| `{key}` |" in page for key in schema["properties"])
    assert all(f"\n## {name}\n" in page for name in schema.get("$defs", {}))


def test_the_command_prints_and_writes(flexspline, tmp_path):
    code, out, _ = flexspline("schema", "study")
    assert code == 0 and json.loads(out)["title"] == "A study"
    code, out, _ = flexspline("schema", "--out", tmp_path / "schemas")
    assert code == 0 and {path.name for path in (tmp_path / "schemas").glob("*.json")} == {
        f"{kind}.schema.json" for kind in KINDS
    }
    for words in (("schema", "scenaro"), ("schema",)):
        code, _, err = flexspline(*words)
        assert code == 2 and "scenario" in err and err.count("\n") == 1
