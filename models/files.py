"""Files that users write (YAML, checked by pydantic) and files that the program writes (complete or not at all)."""

from __future__ import annotations

import ast
import csv
import dataclasses
import inspect
import json
import math
import re
import textwrap
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic_core import PydanticCustomError, core_schema

from .errors import LARGEST_TEXT, InputError, first_line, is_there, nearest, read_text, unknown_key
from .output import write_into_place


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


def _strict(schema: Any, model: Any) -> Any:
    """Make numbers and truth values of a pydantic schema strict, except that 1e3 is a whole number. Models inside
    `model` are strict already."""
    if isinstance(schema, (list, tuple)):
        return type(schema)(_strict(part, model) for part in schema)
    if not isinstance(schema, dict) or schema.get("cls", model) is not model:
        return schema
    if schema.get("type") in ("float", "bool"):
        return {**schema, "strict": True}
    if schema.get("type") == "int":
        return core_schema.no_info_before_validator_function(_whole, schema)
    return {key: part if key in ("metadata", "default") else _strict(part, model) for key, part in schema.items()}


def _whole(value: Any) -> Any:
    if isinstance(value, (bool, str)):
        raise PydanticCustomError("whole_number", "a whole number")
    return value


class Strict(BaseModel):
    """Base of all files that users write. Unknown keys are errors, values are frozen, and a number is neither true
    nor '9'."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, json_schema_extra=documented)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        return _strict(handler(source), cls)


M = TypeVar("M", bound=BaseModel)
_NAME = re.compile(r"[^\s./\\:][^/\\:]{0,99}")


_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # in C, if installed: eight times faster
_SafeDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_TAG = "tag:yaml.org,2002:"
_NO_VALUE = (ValueError, TypeError, OverflowError, AttributeError)  # an impossible date, a number of 5000 digits
_DEEPEST, _LARGEST = 40, 1_000_000
"""Largest number of levels and values of a YAML file. Typical files have ten levels and a few hundred values."""


class _Loader(_SafeLoader):
    """Safe YAML without duplicate keys, with numbers as users write them.

    1e-6 is a number (YAML 1.1 asks for a dot). 1:30 and 010 are not. Only `true` and `false` are truth values.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                raise yaml.constructor.ConstructorError(
                    None, None, f"expected a word for a key, got {shown(key)}", key_node.start_mark
                )
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"duplicate key {key!r}", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


_INT, _FLOAT, _BOOL = f"{_TAG}int", f"{_TAG}float", f"{_TAG}bool"
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in known if tag not in (_INT, _FLOAT, _BOOL)]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(_BOOL, re.compile("^(?:true|false)$"), list("tf"))
_Loader.add_implicit_resolver(
    _FLOAT,
    re.compile(
        r"^[-+]?(?:(?:(?:0|[1-9][0-9_]*)(?:\.[0-9_]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|\.(?:inf|Inf|INF))$|^\.(?:nan|NaN|NAN)$"
    ),
    list("-+0123456789."),
)


def _number(loader: _Loader, node: yaml.ScalarNode) -> int | float:
    """Read a number with which arithmetic is possible: neither 1e-320 nor 10⁴⁰⁰."""
    text = node.value.replace("_", "")
    if text.lstrip("+-").lower() in (".inf", ".nan"):
        return float(text.replace(".", ""))
    value = int(text) if text.lstrip("+-").isdigit() and len(text) < _DIGITS else float(text)
    if (value and abs(value) < _SMALLEST) or len(text) > _DIGITS:
        came = f"{text[:20]}…" if len(text) > _DIGITS else text
        problem = f"expected 0 or a number from {_SMALLEST:g} on with at most {_DIGITS} digits, got {came}"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
    return value


_DIGITS, _SMALLEST = 100, 1e-100
_Loader.add_constructor(_FLOAT, _number)


def find(source: str | Path, known: dict[str, Path], what: str, folder: Path = Path()) -> Path:
    """Return the file of a shipped name, or of a path in a folder. Raises `InputError`: neither; one line."""
    path = known.get(str(source), folder / source)
    if not is_there(path):
        hint = nearest(str(source), known)
        raise InputError(f"{what} {str(source)!r}: expected a path or one of {sorted(known)}, found neither{hint}")
    return path


def read_yaml(path: Path, what: str) -> Any:
    """Parse a YAML file. Errors raise `InputError` with file and line."""
    text = read_text(path, what)
    try:
        return _loaded(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        raise InputError(f"{path}{where}: not YAML: {getattr(error, 'problem', None) or first_line(error)}") from error
    except _NO_VALUE as error:
        raise InputError(f"{path}: not YAML: {error}") from error


def read_json(path: Path, what: str, largest: int = LARGEST_TEXT) -> Any:
    """Parse a JSON file with finite numbers, such as commands write (`json_text`). Raises `InputError`: it cannot be
    read, or is not JSON."""
    text = read_text(path, what, largest)
    try:
        return json.loads(text, parse_constant=_finite_number, parse_float=_finite_number, parse_int=_integer)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected {what}, got something else: not JSON") from error


def _finite_number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number, got {text}")
    return value


def _integer(text: str) -> int:
    """Read a whole number that a float can hold; else raise `ValueError`."""
    if len(text) > 300:
        raise ValueError(f"expected a number up to 1e300, got one of {len(text)} characters")
    return int(text)


def _loaded(text: str) -> Any:
    depth = 0
    event: Any
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise yaml.MarkedYAMLError(
                problem=f"expected at most {_DEEPEST} levels, got more", problem_mark=event.start_mark
            )
        if getattr(event, "tag", None) is not None:  # a value that does not fit its tag fails in many ways
            raise yaml.MarkedYAMLError(
                problem=f"expected a value without a tag, got {event.tag.replace(_TAG, '!!')}",
                problem_mark=event.start_mark,
            )
    data = yaml.load(text, Loader=_Loader)
    if _size(data, {}) > _LARGEST:
        raise yaml.YAMLError(f"expected at most {_LARGEST} values, got more by its aliases")
    return data


def _size(data: Any, known: dict[int, float]) -> float:
    """Count values, those behind an alias once per use; infinite if a value contains itself."""
    if not isinstance(data, (dict, list)):
        return 1
    if id(data) not in known:
        known[id(data)] = math.inf
        known[id(data)] = 1 + sum(_size(x, known) for x in (data.values() if isinstance(data, dict) else data))
    return known[id(data)]


def yaml_value(text: str) -> Any:
    """Return the value of YAML text; the text itself if it is not YAML."""
    try:
        return _loaded(text)
    except (yaml.YAMLError, *_NO_VALUE):
        return text


def yaml_text(data: Any, rows: bool = False) -> str:
    """Return data as YAML text: keys in their order, lines of at most 120 characters, or with `rows` a line for every list
    and mapping of plain values."""
    return _dumped(data, None, 10**6) if rows else _dumped(data, False, 120)


def flow_text(data: Any) -> str:
    """Return data as YAML text in one line: `{value: 1.5, unit: N·m}`."""
    return _dumped(data, True, 10**6).removesuffix("...\n").strip()


def _dumped(data: Any, flow: bool | None, width: int) -> str:
    form: dict[str, Any] = {"default_flow_style": flow, "width": width, "allow_unicode": True, "sort_keys": False}
    return str(yaml.dump(data, Dumper=_SafeDumper, **form))


def json_text(data: Any) -> str:
    """Return data as JSON text (`plain`)."""
    return json.dumps(plain(data), indent=1, ensure_ascii=False, allow_nan=False)


def write_json(path: Path, data: Any) -> None:
    """Write data as `json_text`."""
    write_text(path, json_text(data) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file, moved into place when it is complete. Raises `InputError`: it cannot be written."""
    with write_into_place(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def plain(value: Any) -> Any:
    """Return dictionaries, lists, text and numbers: of an object what its `to_json` returns, or else its fields; None for a
    number that is not finite."""
    if isinstance(value, (str, int, type(None))):
        return value
    if hasattr(value, "to_json"):
        return plain(value.to_json())
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if hasattr(value, "tolist"):  # of NumPy
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]], names: Sequence[str] | None = None) -> None:
    """Write rows as CSV, None as an empty cell. `names`: of the columns; by default those of the first row."""
    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names or list(rows[0] if rows else ()))
        writer.writeheader()
        writer.writerows(rows)


def check_format(data: Any, path: Path) -> None:
    """Refuse a file of another version. Raises `InputError`: its `format` is not 1, as of a file without `format`."""
    found = data.get("format", 1) if isinstance(data, dict) else 1
    if found != 1:
        raise InputError(f"{path}: format: expected 1, got {shown(found)}: written by another version")


_WORD = re.compile(r"[\w .·²/+-]{1,60}")  # what a key may look like. Other text is not shown.


def place(path: Path, field: str) -> str:
    """Return a YAML file with the line of a dotted field, or of its innermost part that exists: `joint.yaml:14`."""
    line, found = None, None
    with suppress(InputError, yaml.YAMLError, ValueError):
        found = yaml.compose(read_text(path, "a file"), Loader=_Loader)
    for part in field.split("."):
        inner: list[Any] = []
        if isinstance(found, yaml.MappingNode):
            inner = next(([key, value] for key, value in found.value if key.value == part), [])
        elif isinstance(found, yaml.SequenceNode) and part.isdecimal():
            inner = found.value[int(part) :][:1]
        if inner:
            line, found = inner[0].start_mark.line + 1, inner[-1]
    return f"{path}:{line}" if line else str(path)


def parse(data: Any, model: type[M], where: str | Path) -> M:
    """Check data of a file or a caller against a pydantic model. `where`: prefix of errors; for a path, the error names
    the line of that file. Raises `InputError`: the first error, in one line."""
    if not isinstance(data, dict):
        raise InputError(f"{where}: expected a mapping of keys, got {kind_of(data)}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        text = describe(error, model)
        at = place(where, text.partition(": ")[0]) if isinstance(where, Path) else where
        raise InputError(f"{at}: {text}") from error


def kind_of(data: Any) -> str:
    """Return the kind of a file's content for a message, without the content: it may be confidential."""
    kinds = {str: "text", list: "a list", type(None): "nothing"}
    return kinds.get(type(data), "a value")


def load(path: Path, model: type[M], what: str) -> M:
    """Read a YAML file into a pydantic model."""
    return parse(read_yaml(path, what), model, path)


def describe(error: ValidationError, model: type[BaseModel]) -> str:
    """Return one line for the first error of pydantic: field, expected, got. Misspelt keys come first; missing keys
    are listed together."""
    errors = error.errors()
    first = min(range(len(errors)), key=lambda i: errors[i]["type"] != "extra_forbidden")
    line = descriptions(error, model)[first]
    if errors[first]["type"] != "missing":
        return line
    others = [_field(one) for i, one in enumerate(errors) if one["type"] == "missing" and i != first]
    return f"{line}; so {'is' if len(others) == 1 else 'are'} {', '.join(others)}" if others else line


def descriptions(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """Return a line per error of pydantic: field, expected, got."""
    errors, lines = error.errors(), []
    for one in errors:
        # The errors of the same value, one per kind that it may have.
        same = [e for e in errors if e["loc"][:-1] == one["loc"][:-1] and _is_branch(e["loc"][-1:])]
        lines.append(_described(one, model, same if len(same) > 1 and one in same else []))
    return lines


_BRANCH = re.compile(r"(?:dict|list|tuple|literal|constrained|function)\b.*\[.*\]", re.DOTALL)
_SCALARS = ("float", "int", "str", "bool")


def _is_branch(loc: tuple) -> bool:
    part = loc[-1] if loc else None
    return isinstance(part, str) and (part in _SCALARS or _is_kind(part))


def _is_kind(part: Any) -> bool:
    return isinstance(part, str) and (bool(_BRANCH.fullmatch(part)) or part in _models(Strict))


def _models(base: type[BaseModel]) -> set[str]:
    return {name for sub in base.__subclasses__() for name in (sub.__name__, *_models(sub))}


def _described(one: Any, model: type[BaseModel], alternatives: list[Any]) -> str:
    kind, came = one["type"], shown(one["input"])
    if alternatives:
        wanted = dict.fromkeys(_expected(each, model) for each in alternatives)
        return f"{_field({**one, 'loc': one['loc'][:-1]})}: expected {' or '.join(wanted)}, got {came}"
    field = _field(one)
    if kind == "extra_forbidden":
        return f"{field}: {unknown_key(str(one['loc'][-1]), _siblings(model, one['loc'][:-1]))}"
    if kind == "missing":
        return f"{field}: missing"
    if kind.startswith("union_tag"):  # which of several kinds of mapping it is
        key = one["ctx"]["discriminator"].strip("'")
        if kind == "union_tag_not_found":
            return f"{field}.{key}: missing"
        known = re.findall(r"'([^']*)'", one["ctx"]["expected_tags"])
        tag = one["ctx"]["tag"]
        return f"{field}.{key}: expected one of {', '.join(known)}, got {tag!r}{nearest(tag, known)}"
    if kind == "value_error":  # of the whole, it names its field itself
        message = one["msg"].removeprefix(OWN_ERROR)
        return f"{field}: {message}" if one["loc"] else message
    return f"{field}: expected {_expected(one, model)}, got {came}"


OWN_ERROR = "Value error, "  # prefix that pydantic adds to the message of a validator


def _expected(one: Any, model: type[BaseModel]) -> str:
    kind = one["type"]
    if kind in ("model_type", "model_attributes_type", "dataclass_type"):
        keys = ", ".join(_siblings(model, one["loc"]))
        return f"a mapping of keys{keys and f' ({keys})'}"
    if kind == "dict_type":
        return "a mapping of keys"
    if kind == "bool_type":
        return "true or false"
    if kind == "int_parsing_size":
        return "a smaller integer"
    message = re.sub(
        r"^(?:Input|List|String|Dictionary|Tuple) should (?:be|have) ", "", one["msg"].removeprefix(OWN_ERROR)
    )
    return message.replace("String should match pattern", "text of the pattern").replace(" after validation", "")


def _field(one: Any) -> str:
    parts = [str(part) for part in one["loc"] if not _is_kind(part)]
    if parts and one["type"] == "extra_forbidden" and not _WORD.fullmatch(parts[-1]):
        parts[-1] = "a line that is not a key"  # the file may be of another program
    return ".".join(parts) or "top level"


def _siblings(model: type[BaseModel], path: tuple) -> list[str]:
    current: Any = model
    for part in path:
        if isinstance(part, int):
            continue
        field = getattr(current, "model_fields", {}).get(part)
        if field is None:
            continue  # a tag of a union, or a key of a dict
        current = _model_in(field.annotation)
    return list(getattr(current, "model_fields", {}))


def _model_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = _model_in(argument)
        if found is not None:
            return found
    return None


def shown(value: Any) -> str:
    """Return a value as code, short enough for a message."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def check_name(name: str, where: str) -> str:
    """Return a name that is safe as the name of a file or folder. Raises `InputError`: separators, control characters,
    a dot at the start, or more than 100 characters."""
    if not _NAME.fullmatch(name) or not name.isprintable():
        raise InputError(
            f"{where}: expected a name of at most 100 letters, digits and signs, without slashes and not beginning with a "
            f"dot or a blank, got {shown(name)}"
        )
    return name
