"""Estimators, causes and sensors of installed packages (by entry points) and of single files.

A package declares entry points of the groups `flexspline.estimators`, `flexspline.causes` and `flexspline.sensors`.
The name of each is that of its object, an `estimator.estimator.Estimator`, a `causes.Cause` or an
`own_sensors.Sensor`. A file has the same in tuples `ESTIMATORS`, `CAUSES` and `SENSORS` and is known after `load`.
The registries (`estimator.registry`, `causes`, `own_sensors`) check them. `docs/plugins.md` has examples.
"""

from __future__ import annotations

import hashlib
import importlib.util
import shlex
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeVar

from .errors import InputError, one_line, whole

Kind = Literal["estimators", "causes", "sensors"]
_KINDS: tuple[Kind, ...] = ("estimators", "causes", "sensors")
_PACKAGE = __name__.split(".")[0]
T = TypeVar("T")


@dataclass(frozen=True)
class Origin:
    """Origin of an estimator, a cause or a sensor."""

    name: str  # in words: a package with its version, or a file
    state: str = ""  # identifies its version, if results depend on it; empty for this package


OWN = Origin(_PACKAGE)  # origin of this package's own


@dataclass(frozen=True)
class Offer:
    """An estimator, a cause or a sensor of a plugin: its kind, its name, its origin, and a function that returns it."""

    kind: Kind
    name: str
    origin: Origin
    get: Callable[[], Any]

    @property
    def where(self) -> str:
        """Prefix of messages."""
        return f"{self.kind[:-1]} {self.name!r} of {self.origin.name}"


@cache
def made(offer: Offer, base: type[T], check: Callable[[T], None]) -> T:
    """Return an offered object of a subclass of `base`, or one made of the class, if it passes a check. Raises
    `InputError`: its fault, with its name and origin."""
    given = offer.get()
    try:
        found = given() if isinstance(given, type) and issubclass(given, base) else given
        if not isinstance(found, base):
            raise InputError(
                f"expected a subclass of {base.__module__}.{base.__qualname__}, got {type(found).__name__}"
            )
        if (name := getattr(found, "name", None)) != offer.name:
            came = "none" if name is None else repr(name)
            raise InputError(f"name: expected {offer.name!r}, its entry point, got {came}")
        check(found)
    except InputError as error:
        raise InputError(f"{offer.where}: {error}") from error
    except Exception as error:  # foreign code
        raise InputError(f"{offer.where}: {type(error).__name__}: {error}") from error
    return found


_files: dict[Path, tuple[ModuleType, str]] = {}  # imported plugin files: their modules, and a digest of their text
_packages: set[Path] = set()  # files and folders of packages from which something was loaded


def load(path: str | Path) -> tuple[str, ...]:
    """Import a plugin file; its estimators, causes and sensors are then known in this process. Return their names.
    Raises `InputError`: no such file, one that cannot be imported, or one without any."""
    file = Path(path).expanduser().resolve()
    if file not in _files:
        _files[file] = _imported(file, str(path))
        _offers.cache_clear()
    return tuple(_named(one) for kind in _KINDS for one in _tuple(_files[file][0], kind))


def forget(path: str | Path) -> None:
    """Remove a plugin file."""
    _files.pop(Path(path).expanduser().resolve(), None)
    _offers.cache_clear()


def files() -> tuple[Path, ...]:
    """Return the known plugin files, for other processes."""
    return tuple(_files)


def options() -> str:
    """Return the command-line options for the known plugin files; empty without any."""
    return "".join(f" --plugin {shlex.quote(str(file))}" for file in _files)


@contextmanager
def known(paths: Iterable[str | Path]) -> Iterator[tuple[str, ...]]:
    """Load plugin files inside a block, and yield the names; new ones are removed afterwards."""
    before = dict(_files)
    try:
        yield tuple(name for path in paths for name in load(path))
    finally:
        _files.clear()
        _files.update(before)
        _offers.cache_clear()


def offers(kind: Kind, own: Iterable[str]) -> dict[str, Offer]:
    """Return the offers of plugins by name. One of `own` wins over an installed package's of the same name. Raises
    `InputError`: a plugin file's name that exists already."""
    return _offers(kind, frozenset(own))


@cache
def _offers(kind: Kind, taken: frozenset[str]) -> dict[str, Offer]:
    found = {name: offer for name, offer in _installed(kind).items() if name not in taken}
    for file, (module, digest) in _files.items():
        for one in _tuple(module, kind):
            name = _named(one)
            if name in taken or name in found:
                there = _PACKAGE if name in taken else found[name].origin.name
                raise InputError(f"{file}: {kind[:-1]} {name!r}: expected another name, {there} has one of that name")
            found[name] = Offer(kind, name, Origin(str(file), digest), partial(lambda x: x, one))
    return found


def blamed(error: BaseException) -> InputError | None:
    """Return an exception of a plugin as one line with the plugin's own last line; None if no plugin is involved."""
    own = [*_files, *_packages]
    if not own:
        return None
    steps = traceback.format_exception(error)  # also of another process
    for step in reversed("".join(steps).splitlines()):
        where = step.strip()
        if not where.startswith('File "') or '", line ' not in where:
            continue
        file, _, rest = where.removeprefix('File "').partition('", line ')
        if any(Path(file).is_relative_to(one) for one in own):
            return InputError(f"{file}, line {rest.split(',')[0]}: {_reason(error)}")
    return None


def _reason(error: BaseException) -> str:
    return f"{type(error).__name__}: {one_line(whole(error)) or 'no message'}"


def _imported(file: Path, given: str) -> tuple[ModuleType, str]:
    """Return a file as a module with a unique name: compiled code is cached next to it, and classes can be pickled."""
    if not file.is_file():
        raise InputError(f"plugin {given}: expected a Python file, found none")
    name = f"{file.stem}_{hashlib.sha256(str(file).encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise InputError(f"plugin {given}: expected a Python file (.py), got {file.suffix or 'no suffix'!r}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and compiled code look there while it is imported
    try:
        spec.loader.exec_module(module)
        if not any(_tuple(module, kind) for kind in _KINDS):
            raise InputError(f"plugin {given}: expected a tuple ESTIMATORS, CAUSES or SENSORS, found none")
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        if isinstance(error, InputError):
            raise
        line = next(
            (f.lineno for f in reversed(traceback.extract_tb(error.__traceback__)) if f.filename == str(file)), None
        )
        if isinstance(error, SyntaxError):
            line = error.lineno
        raise InputError(f"plugin {given}{f', line {line}' if line else ''}: {_reason(error)}") from error
    return module, hashlib.sha256(file.read_bytes()).hexdigest()


def _tuple(module: ModuleType, kind: Kind) -> tuple[Any, ...]:
    found = getattr(module, kind.upper(), ())
    if not isinstance(found, (tuple, list)):
        raise InputError(f"plugin {module.__file__}: {kind.upper()}: expected a tuple, got {type(found).__name__}")
    return tuple(found)


def _named(one: Any) -> str:
    name = getattr(one, "name", None)
    return name if isinstance(name, str) else repr(one)


@cache
def _installed(kind: Kind) -> dict[str, Offer]:
    found: dict[str, Offer] = {}
    for point in entry_points(group=f"{_PACKAGE}.{kind}"):
        package = f"{point.dist.name} {point.dist.version}" if point.dist else "an installed package"
        found.setdefault(
            point.name, Offer(kind, point.name, Origin(package, package), cache(partial(_load, kind, point)))
        )
    return found


def _load(kind: Kind, point: EntryPoint) -> Any:
    where = f"{kind[:-1]} {point.name!r} of {point.dist.name if point.dist else 'an installed package'}"
    try:
        found = point.load()
    except (Exception, SystemExit) as error:  # foreign code
        raise InputError(f"{where}: cannot be loaded from {point.value!r}: {_reason(error)}") from error
    file = getattr(sys.modules.get(point.module.split(".")[0]), "__file__", None)
    if file:
        _packages.add(Path(file).parent if Path(file).name == "__init__.py" else Path(file))
    return found
