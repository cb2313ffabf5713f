"""MJCF files of users: nothing in them may refer to a place outside their folder."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath, PureWindowsPath

import mujoco

from .errors import LARGEST_TEXT, InputError, read_text, refusing

STATED: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    (".//joint[@name='rotor']", "damping", ("bm",)),
    (".//joint[@name='link']", "damping", ("bl",)),
    (".//body[@name='rotor']/inertial", "diaginertia", ("Jm", "Jm", "Jm")),
    (".//body[@name='wave_generator']/inertial", "diaginertia", ("Jw", "Jw", "Jw")),
    (".//tendon/fixed[@name='flexspline']", "stiffness", ("K1",)),
    (".//tendon/fixed[@name='flexspline']", "damping", ("df",)),
    (".//tendon/fixed[@name='wave_generator']", "stiffness", ("Kw0",)),
    (".//tendon/fixed[@name='wave_generator']", "damping", ("dw",)),
    (".//dcmotor[@name='motor']", "motorconst", ("Kt", "Kt")),
    (".//dcmotor[@name='motor']", "resistance", ("R",)),
    (".//dcmotor[@name='motor']", "inductance", ("L", "0")),
    (".//dcmotor[@name='motor']", "saturation", ("0", "current_limit", "0")),
    (".//dcmotor[@name='motor']", "controller", ("0", "0", "0", "0", "0", "supply_voltage")),
    (".//dcmotor[@name='mesh_friction']", "lugre", ("s0", "s1", "Fc", "Fs", "vs")),
    (".//dcmotor[@name='mesh_friction']", "damping", ("bw",)),
)
"""Numbers of a description in a joint's MJCF: element, attribute, symbols in the order of its values."""
_DEEPEST = 10  # of includes within includes


def check_mjcf(path: Path) -> None:
    """Check that an MJCF and all its files are in its folder. Raises `InputError`: a file that is not XML, has document
    type declarations or plugins, or names a file elsewhere; one line."""
    for _ in _roots(path, path.resolve().parent, _DEEPEST):
        pass


def inherited(path: Path, hinge: str) -> tuple[bool, bool]:
    """Return what a hinge of an MJCF has from classes and includes: whether its damping or stiffness has higher orders;
    and whether angles are in radians. Raises `InputError`: a file that is no MJCF, or another kind of joint."""
    with refusing(f"{path}: not a readable MJCF"):
        spec = mujoco.MjSpec.from_file(str(path))
    joint = spec.joint(hinge)
    if joint is not None and joint.type != mujoco.mjtJoint.mjJNT_HINGE:
        raise InputError(f"{path}: joint {hinge!r}: expected a hinge, got another kind by its class")
    polynomial = joint is not None and (any(joint.damping[1:]) or any(joint.stiffness[1:]))
    return polynomial, not spec.compiler.degree


def stated_numbers(path: Path) -> dict[str, float]:
    """Return the numbers of a joint's description in its MJCF file itself, by symbol."""
    try:
        root = ElementTree.fromstring(read_text(path, "an MJCF file"))
    except (InputError, ElementTree.ParseError):  # reported where the file is used
        return {}
    found: dict[str, float] = {}
    for element, attribute, symbols in STATED:
        one = root.find(element)
        for symbol, text in zip(symbols, "" if one is None else one.get(attribute, "").split(), strict=False):
            with suppress(ValueError):
                if symbol != "0":
                    found.setdefault(symbol, float(text))
    return found


def mjcf_files(path: Path) -> list[Path]:
    """Return an MJCF and its existing files (includes, meshes, textures); all are in its folder. Raises `InputError`:
    as `check_mjcf`."""
    folder, found = path.resolve().parent, [path]
    for root in _roots(path, folder, _DEEPEST):
        own = (folder / v for c in root.iter("compiler") for k, v in c.attrib.items() if k.endswith("dir"))
        places = [folder, *own]
        for element in root.iter():
            for name, value in element.attrib.items():
                if name.startswith("file") and element.tag != "compiler":
                    found += [one for place in places if (one := place / value).is_file() and one not in found]
    return found


def xml_root(path: Path, text: str, kind: str) -> ElementTree.Element:
    """Return the root element of a file's text, which must not declare entities; `kind`: with its article, for
    messages. Raises `InputError`: a document type declaration, or no XML; one line."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path}: expected {kind} file without document type declarations")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: not a readable {kind.partition(' ')[2]}: {error}") from error


def _roots(path: Path, folder: Path, depth: int) -> Iterator[ElementTree.Element]:
    """Yield the root elements of an MJCF and of its includes, checked."""
    if not path.is_file():
        raise InputError(f"{path}: expected an MJCF file, no such file")
    if path.stat().st_size > LARGEST_TEXT:
        raise InputError(f"{path}: expected an MJCF file of at most {LARGEST_TEXT} bytes, got {path.stat().st_size}")
    root = xml_root(path, read_text(path, "an MJCF file"), "an MJCF")
    for element in root.iter():
        if element.tag in ("plugin", "extension"):
            raise InputError(f"{path}: {element.tag}: expected a model without plugins")
        for name, value in element.attrib.items():
            if name.startswith("file") or (name.endswith("dir") and element.tag == "compiler"):
                _check_inside(path, folder, element.tag, name, value)
    yield root
    for element in root.iter():
        if element.tag in ("include", "model") and element.get("file") is not None:
            if depth == 0:
                raise InputError(f"{path}: include: expected files no more than {_DEEPEST} deep")
            yield from _roots(folder / str(element.get("file")), folder, depth - 1)


def _check_inside(path: Path, folder: Path, tag: str, name: str, value: str) -> None:
    where = f"{path}: {tag}.{name}"
    parts = PurePosixPath(value.replace("\\", "/"))
    outside = parts.is_absolute() or bool(PureWindowsPath(value).drive) or ".." in parts.parts or ":" in value
    if outside or not (folder / parts).resolve().is_relative_to(folder):
        raise InputError(f"{where}: expected a file inside the MJCF's folder, got {value!r}")
