"""Files of a collapsed joint for other simulators: MJCF, URDF, mjlab, Isaac Lab; and changes to a user's file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from xml.parsers import expat

from ..models.errors import InputError
from ..models.parameters import GRAVITY
from .pages.rendering import environment

if TYPE_CHECKING:
    from ..diagnosis.collapse import Collapse

_FILES = {"mjcf": "joint.xml.j2", "urdf": "joint.urdf.j2", "mjlab": "mjlab.py.j2", "isaac": "isaac.py.j2"}
TARGETS = tuple(_FILES)
PLAIN = re.compile(r"[\w ./:+-]+")  # A joint's name that can be written to every target as it is


def heading(found: Collapse, joint: str, motion: str) -> list[str]:
    """Return the first lines of the file: the error of the simpler structure, the motion, and where the error is largest."""
    lines = [f"{joint} as {found.structure.replace('_', ' ')}, fitted to its behaviour on {motion}."]
    if found.worse_than_nominal:
        lines.insert(
            0,
            f"WORSE THAN NOMINAL: the description before identification has {_g(found.nominal)} A on the same motion.",
        )
    lines.append(
        f"RMS current error on held-out motion ({found.samples} samples): {_g(found.full)} A with all laws, "
        f"{_g(found.written)} A as written here ({_g(found.written * found.parameters['torque_constant'])} N·m at the output)."
    )
    if found.nominal is not None and not found.worse_than_nominal:
        lines.append(f"The description before identification, in the same structure: {_g(found.nominal)} A.")
    if found.worst is not None:
        w = found.worst
        lines.append(f"Worst: {w.by} from {_g(w.low)} to {_g(w.high)} {w.unit}, {_g(w.rms)} A.")
    speed, load = found.visited
    lines.append(f"Visited: speed to {_g(speed)} rad/s, load to {_g(load)} N·m. Beyond it nothing was fitted.")
    if found.structure == "two_bodies":
        lines.append(
            "Errors are the drive's, with the torque on it by all laws. The spring has no kinematic error and no hysteresis."
        )
        lines.append(
            "Friction: s0 is the joint's, s1 is small enough for this timestep. Neither has an effect in motion."
        )
    return lines


def written(found: Collapse, target: str, hinge: str, notes: list[str], link: Mapping[str, float]) -> str:
    """Return the whole file of a target with a collapsed joint. `hinge`: its name there; `notes`: of `heading`; `link`:
    `inertia` [kg·m²], `mass` [kg], and `lever` [m] and `angle` [rad] of the centre of mass of the payload."""
    context = {
        "structure": found.structure, "p": found.parameters, "hinge": hinge, "notes": notes, "mass": link["mass"],
        "inertia": link["inertia"] - link["mass"] * link["lever"] ** 2, "gravity": GRAVITY,
        "centre": [link["lever"] * math.sin(link["angle"]), 0.0, -link["lever"] * math.cos(link["angle"])],
    }  # fmt: skip
    templates = environment(keep_trailing_newline=True)
    templates.filters |= {"n": _n, "comment": _comment}
    return templates.get_template(_FILES[target]).render(context)


def _g(x: float | None) -> str:
    return f"{x:.4g}"


def _n(x: Any) -> str:
    return " ".join(f"{one:.9g}" for one in (x if isinstance(x, (list, tuple)) else [x]))


def _comment(notes: list[str], indent: str = "  ") -> str:
    text = f"\n{indent}     ".join(note.replace("--", "- -") for note in notes)
    return f"{indent}<!-- {text} -->"


def users_joint(text: str, hinge: str, file: str, target: str) -> list[_Element]:
    """Return the element of the joint `hinge` in the text of a user's MJCF or URDF, and the elements in it; `file`: for
    messages. Raises `InputError`: no XML, a file of another kind, no such joint, or it is not a hinge."""
    elements = _elements(text, file)
    root, kinds = ("mujoco", ("hinge",)) if target == "mjcf" else ("robot", ("revolute", "continuous"))
    if elements[0].tags[0] != root:
        raise InputError(f"{file}: expected a file with root {root} for --to {target}, got {elements[0].tags[0]}")
    # Actuators, equalities and transmissions name joints, too.
    places = [one for one in elements if "body" in one.tags or one.tags[:-1] == ("robot",)]
    joints = [one for one in places if one.tags[-1] == "joint" and "name" in one.attributes]
    found = [one for one in joints if one.attributes["name"] == hinge]
    if len(found) != 1:
        known = ", ".join(dict.fromkeys(one.attributes["name"] for one in joints)) or "none"
        files = ", ".join(one.attributes.get("file", "") for one in elements if one.tags[-1] == "include")
        more = f"; --into takes the file that has the joint itself (it includes {files})" if files else ""
        raise InputError(f"{file}: expected one joint {hinge!r}, got {len(found)}; its joints are {known}{more}")
    joint = found[0]
    kind = joint.attributes.get("type", kinds[0])
    if kind not in kinds:
        raise InputError(f"{file}: joint {hinge!r}: expected type {' or '.join(kinds)}, got {kind}")
    parts = [one for one in elements if joint.inside <= one.begin < joint.end]
    if target == "urdf" and not {"parent", "child"} <= {one.tags[-1] for one in parts}:
        raise InputError(f"{file}: joint {hinge!r}: expected an element with parent and child, got one without")
    return [joint, *parts]


def put_into(
    text: str, joint: list[_Element], found: Collapse, notes: list[str], polynomial: bool, radian: bool
) -> str:
    """Return a user's MJCF or URDF with the numbers of one joint, of `users_joint`, changed, and everything else
    unchanged; `notes`: of `heading`; `polynomial`, `radian`: as of `models.mjcf.inherited`."""
    p = found.parameters
    limit, changes = _n(p["torque_limit"]), list[tuple[int, int, str]]()

    def put(one: _Element, values: Mapping[str, str]) -> None:
        changes.append((one.begin, one.inside, _with_attributes(text[one.begin : one.inside], values)))

    if "body" in joint[0].tags:
        more = " 0 0" if polynomial else ""
        values = {name: _n(p[name]) for name in ("armature", "damping", "frictionloss", "stiffness")}
        values |= {name: values[name] + more for name in ("damping", "stiffness")}
        if p["stiffness"]:
            values["springref"] = _n(p["springref"] * (1.0 if radian else 180.0 / math.pi))
        put(joint[0], values | {"actuatorfrcrange": f"-{limit} {limit}", "actuatorfrclimited": "true"})
    else:
        end = joint[0].end
        space = text[len(text[:end].rstrip(" \t")) : end]
        for name, values in (
            ("limit", {"effort": limit, "velocity": _n(p["speed_limit"])}),
            ("dynamics", {"damping": _n(p["damping"]), "friction": _n(p["frictionloss"])}),
        ):
            there = [one for one in joint if one.tags[-1] == name]
            for one in there:
                put(one, values)
            if not there:
                element = "<" + name + "".join(f' {key}="{value}"' for key, value in values.items()) + "/>"
                changes.append((end, end, f"  {element}\n{space}"))
    for begin, end, new in sorted(changes, reverse=True):
        text = text[:begin] + new + text[end:]
    declaration = re.match(r"\ufeff?(\s*<\?xml.*?\?>\s*\n)?", text)
    at = declaration.end() if declaration else 0
    return text[:at] + _comment(notes, "") + "\n" + text[at:]


@dataclass
class _Element:
    """An element of an XML text: tags from the root, places in the text of its beginning, content and end tag."""

    tags: tuple[str, ...]
    attributes: dict[str, str]
    begin: int
    inside: int
    end: int


def _elements(text: str, file: str) -> list[_Element]:
    """Return the elements of an XML text, in its order. Raises `InputError`."""
    data, found, opened = text.encode(), list[_Element](), list[int]()
    at, place = 0, 0  # in bytes, in characters
    parser = expat.ParserCreate("utf-8")

    def here() -> int:
        nonlocal at, place
        place += len(data[at : parser.CurrentByteIndex].decode())
        at = parser.CurrentByteIndex
        return place

    def start(tag: str, attributes: dict[str, str]) -> None:
        begin = here()
        end = re.compile(r"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>").match(text, begin)
        assert end is not None
        tags = (*(found[opened[-1]].tags if opened else ()), tag)
        opened.append(len(found))
        found.append(_Element(tags, attributes, begin, end.end(), end.end()))

    def close(_: str) -> None:
        found[opened.pop()].end = here()

    parser.StartElementHandler, parser.EndElementHandler = start, close
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(f"{file}: not readable XML: {error}") from error
    return found


def _with_attributes(tag: str, values: Mapping[str, str]) -> str:
    """Return an opening tag with attributes set; other attributes and white space are unchanged."""
    for name, value in values.items():
        there = re.search(rf"""(\s{name}\s*=\s*)(["'])(.*?)\2""", tag)
        if there is not None:
            tag = tag[: there.start()] + there.group(1) + there.group(2) + value + there.group(2) + tag[there.end() :]
        else:
            end = re.search(r"\s*/?>$", tag)
            assert end is not None
            tag = tag[: end.start()] + f' {name}="{value}"' + tag[end.start() :]
    return tag
