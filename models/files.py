"""Files that people write (YAML, checked by pydantic) and files that we write (moved into place when complete)."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from .errors import InputError, nearest, read_text


class Strict(BaseModel):
    """Base of everything that a person writes: unknown keys are errors, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


M = TypeVar("M", bound=BaseModel)


_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # in C where there is one: eight times as fast
_SafeDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_LIST = "tag:yaml.org,2002:seq"


class _Loader(_SafeLoader):
    """Safe YAML that reads 1e-6 as a number (YAML 1.1 asks for a dot) and refuses duplicate keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} stands twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.yaml_implicit_resolvers = {k: list(v) for k, v in yaml.SafeLoader.yaml_implicit_resolvers.items()}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9][0-9_]*\.?[0-9_]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+0123456789."),
)


def find(source: str | Path, known: dict[str, Path], what: str) -> Path:
    """The file that a shipped name, or a path, stands for.

    Raises:
      InputError: neither; one line.
    """
    path = known.get(str(source), Path(source))
    if not path.exists():
        hint = nearest(str(source), known)
        raise InputError(f"{what} {str(source)!r}: expected a path or one of {sorted(known)}, found neither{hint}")
    return path


def read_yaml(path: Path, what: str) -> Any:
    """Parse a YAML file; anything wrong with it raises `InputError` naming file and line."""
    try:
        return yaml.load(read_text(path, what), Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        raise InputError(f"{path}{where}: not YAML: {getattr(error, 'problem', None) or error}") from error


def yaml_value(text: str) -> Any:
    """A value as a YAML file would hold it; text that is not YAML is text."""
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError:
        return text


class Line(list):
    """A list that YAML text has in one line, however long."""


class _Dumper(_SafeDumper):
    """The dumper that knows a `Line`."""


_Dumper.add_representer(Line, lambda dumper, data: dumper.represent_sequence(_LIST, data, flow_style=True))


def yaml_text(data: Any) -> str:
    """Data as YAML text: keys in their order, lines up to 120 characters."""
    text: str = yaml.dump(data, Dumper=_Dumper, allow_unicode=True, sort_keys=False, width=120)
    return text


def parse(data: Any, model: type[M], where: str) -> M:
    """Check `data` against a pydantic model; the first thing wrong raises `InputError` in one line."""
    if not isinstance(data, dict):
        raise InputError(f"{where}: expected a mapping of keys, got {_shown(data)}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{where}: {describe(error, model, data)}") from error


def load(path: Path, model: type[M], what: str) -> M:
    """Read a YAML file into a pydantic model."""
    return parse(read_yaml(path, what), model, str(path))


def describe(error: ValidationError, model: type[BaseModel], data: Any) -> str:
    """One line for the first error that pydantic found, a misspelt key before what is missing: field, expected, came."""
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    field = ".".join(str(part) for part in first["loc"]) or "top level"
    kind, came = first["type"], _shown(first["input"])
    if kind == "extra_forbidden":
        return f"{field}: unknown key{nearest(str(first['loc'][-1]), _siblings(model, first['loc'][:-1]))}"
    if kind == "missing":
        return f"{field}: missing"
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return f"{field}: expected {message}, got {came}" if kind != "value_error" else f"{field}: {message}"


def _siblings(model: type[BaseModel], path: tuple) -> list[str]:
    """The keys that pydantic knows at a path inside a model."""
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


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


@contextmanager
def write_into_place(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; move it into place when the block ends well, remove it when not."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def folder_into_place(path: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `path`; move it into place when the block ends well, remove it when not.

    An older folder of the same name is replaced only when it is empty or was made by this function.
    """
    marker = ".flexspline"
    try:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: expected a folder to write to, got a file")
        if path.is_dir() and any(path.iterdir()) and not (path / marker).exists():
            raise InputError(f"{path}: expected an empty or new folder, got one with other files in it")
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    try:
        yield temporary
        (temporary / marker).touch()
        os.chmod(temporary, 0o755)
        if path.exists():
            shutil.rmtree(path)
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
