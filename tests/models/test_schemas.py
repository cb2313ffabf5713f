"""Everything in a file of a user is used, or refused in one line; what is used means the same when written again."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flexspline.diagnosis.data.importing import Layout
from flexspline.models.errors import InputError
from flexspline.models.files import parse, read_yaml, yaml_text
from flexspline.models.gear_sheet import GearSheet
from flexspline.models.joint import Joint
from flexspline.models.recording import Sidecar
from flexspline.scenarios.scenario import Scenario
from flexspline.scenarios.studies.study import Study

MODELS = (Joint, GearSheet, Scenario, Study, Layout, Sidecar)

odd: st.SearchStrategy[Any] = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=40),
    st.recursive(
        st.none() | st.integers() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
        max_leaves=6,
    ),
)
words = st.sampled_from(["a", "test-joint", "link", "no_load", "EKF", "rad", "N·m", "s", "N", "K1", "datasheet"])


def of(schema: dict[str, Any], whole: dict[str, Any], depth: int = 0) -> st.SearchStrategy[Any]:
    """Data of a JSON schema, at its bounds and between, with invalid values in places."""
    return st.integers(0, 40).flatmap(lambda n: odd if n == 0 else _right(schema, whole, depth))


def _right(schema: dict[str, Any], whole: dict[str, Any], depth: int) -> st.SearchStrategy[Any]:
    if depth > 7:
        return odd
    if "$ref" in schema:
        return _right(whole["$defs"][schema["$ref"].rsplit("/", 1)[-1]], whole, depth + 1)
    for key in ("anyOf", "oneOf", "allOf"):
        if key in schema:
            return st.sampled_from(schema[key]).flatmap(lambda one: of(one, whole, depth + 1))
    if "const" in schema or "enum" in schema:
        return st.sampled_from(schema.get("enum", [schema.get("const")]))
    kind = schema.get("type")
    if kind == "object":
        known = {name: of(inner, whole, depth + 1) for name, inner in schema.get("properties", {}).items()}
        needed = {name: known[name] for name in schema.get("required", ()) if name in known}
        rest = {name: value for name, value in known.items() if name not in needed}
        found = st.fixed_dictionaries(needed, optional=rest)
        more = schema.get("additionalProperties")
        if not isinstance(more, dict):
            return found
        others = st.dictionaries(words, of(more, whole, depth + 1), max_size=3)
        return st.tuples(found, others).map(lambda two: {**two[1], **two[0]})
    if kind == "array":
        low = schema.get("minItems", 0)
        return st.lists(of(schema.get("items", {}), whole, depth + 1), min_size=low, max_size=low + 2)
    if kind in ("number", "integer"):
        low = schema.get("minimum", schema.get("exclusiveMinimum", -1e6))
        high = schema.get("maximum", schema.get("exclusiveMaximum", 1e6))
        if kind == "integer":
            return st.integers(int(low), int(high))
        return st.floats(float(low), float(high)) | st.sampled_from([low, high, 0.0, 1.0])
    return {"boolean": st.booleans(), "null": st.none(), "string": words | st.text(max_size=20)}.get(str(kind), odd)


def assert_one_line(error: InputError) -> None:
    text = str(error)
    assert text.isprintable() and "\n" not in text and len(text) <= 1000, text


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
@settings(max_examples=40, deadline=None, print_blob=True, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_used_or_refused_in_one_line(model, data):
    schema = model.model_json_schema(mode="validation")
    given_ = data.draw(of(schema, schema))
    try:
        found = parse(given_, model, "file")
    except InputError as error:
        assert_one_line(error)
        return
    again = yaml.safe_load(yaml_text(found.model_dump(mode="json", exclude_unset=True)))
    assert parse(again, model, "file") == found


@settings(max_examples=100, deadline=None, print_blob=True)
@given(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace"))))
def test_bytes_are_yaml_or_refused_in_one_line(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(content)
    try:
        read_yaml(path, "a file")
    except InputError as error:
        assert_one_line(error)
