"""Files of a collapsed joint for other simulators: MJCF, URDF, mjlab, Isaac Lab; and changes to a user's file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..models.errors import InputError
from ..models.parameters import GRAVITY

if TYPE_CHECKING:
    from ..diagnosis.collapse import Collapse

_FILES = {"mjcf": "joint.xml.j2", "urdf": "joint.urdf.j2", "mjlab": "mjlab.py.j2", "isaac": "isaac.py.j2"}
TARGETS = tuple(_FILES)
TEMPLATES = Path(__file__).parent / "templates"


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
            "Friction: s0 is the joint's, s1 is small enough for this timestep. Neither has an effect in motion."
        )
    return lines


def written(found: Collapse, target: str, hinge: str, notes: list[str], link: Mapping[str, float]) -> str:
    """Return the whole file of a target.

    Args:
      found: the collapsed joint; hinge: name of the joint in the target; notes: of `heading`.
      link: `inertia` [kg·m²], `mass` [kg], and `lever` [m] and `angle` [rad] of the centre of mass of the payload.
    """
    context = {
        "structure": found.structure, "p": found.parameters, "hinge": hinge, "notes": notes, "mass": link["mass"],
        "inertia": link["inertia"] - link["mass"] * link["lever"] ** 2, "gravity": GRAVITY,
        "centre": [link["lever"] * math.sin(link["angle"]), 0.0, -link["lever"] * math.cos(link["angle"])],
    }  # fmt: skip
    templates = Environment(
        loader=FileSystemLoader(TEMPLATES), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    templates.filters |= {"n": _n, "comment": _comment}
    return templates.get_template(_FILES[target]).render(context)


def _g(x: float | None) -> str:
    return f"{x:.4g}"


def _n(x: Any) -> str:
    return " ".join(f"{one:.9g}" for one in (x if isinstance(x, (list, tuple)) else [x]))


def _comment(notes: list[str], indent: str = "  ") -> str:
    text = f"\n{indent}     ".join(note.replace("--", "- -") for note in notes)
    return f"{indent}<!-- {text} -->"


def put_into(text: str, found: Collapse, hinge: str, notes: list[str], file: str) -> str:
    """Return a user's MJCF or URDF with the numbers of one joint changed, and everything else unchanged.

    Args:
      text: of the file; hinge: name of the joint; file: for messages.

    Raises:
      InputError: the file has no such joint, or it is not a hinge.
    """
    p = found.parameters
    tag = _joint_tag(text, hinge, file)
    begin, end = tag.span()
    if re.search(r"<robot\b", _blind(text)) is None:
        kind = re.search(r"""\btype\s*=\s*["'](\w+)["']""", tag.group())
        if kind is not None and kind.group(1) != "hinge":
            raise InputError(f"{file}: joint {hinge!r}: expected a hinge, got type {kind.group(1)}")
        values = {name: _n(p[name]) for name in ("armature", "damping", "frictionloss")}
        if p["stiffness"]:
            radian = re.search(r"""<compiler\b[^>]*\bangle\s*=\s*["']radian""", _blind(text))
            values |= {
                "stiffness": _n(p["stiffness"]),
                "springref": _n(p["springref"] * (1.0 if radian else 180.0 / math.pi)),
            }
        limit = _n(p["torque_limit"])
        values |= {"actuatorfrcrange": f"-{limit} {limit}", "actuatorfrclimited": "true"}
        changed = _with_attributes(tag.group(), values)
    else:
        if tag.group().endswith("/>"):
            raise InputError(f"{file}: joint {hinge!r}: expected an element with parent and child, got none")
        begin, end = end, _blind(text).index("</joint>", end)
        changed = text[begin:end]
        for name, values in (
            ("limit", {"effort": _n(p["torque_limit"]), "velocity": _n(p["speed_limit"])}),
            ("dynamics", {"damping": _n(p["damping"]), "friction": _n(p["frictionloss"])}),
        ):
            there = re.search(rf"<{name}\b[^>]*>", _blind(changed))
            if there is not None:
                changed = changed[: there.start()] + _with_attributes(there.group(), values) + changed[there.end() :]
            else:
                element = "<" + name + "".join(f' {key}="{value}"' for key, value in values.items()) + "/>"
                space = re.search(r"\n?[ \t]*$", changed)
                assert space is not None
                before = changed[: space.start()]
                changed = before + (f"{space.group()}  " if space.group() else "") + element + space.group()
    whole = text[:begin] + changed + text[end:]
    declaration = re.match(r"\s*<\?xml.*?\?>\s*\n", whole)
    at = declaration.end() if declaration else 0
    return whole[:at] + _comment(notes, "") + "\n" + whole[at:]


def _blind(text: str) -> str:
    """Return a text with comments replaced by spaces."""
    return re.sub(r"<!--.*?-->", lambda m: " " * len(m.group()), text, flags=re.DOTALL)


def _joint_tag(text: str, hinge: str, file: str) -> re.Match[str]:
    named = re.compile(r"""\bname\s*=\s*(["'])(.*?)\1""")
    tags = {m: named.search(m.group()) for m in re.finditer(r"<joint\b[^>]*>", _blind(text))}
    names = {m: name.group(2) for m, name in tags.items() if name is not None}
    found = [m for m, name in names.items() if name == hinge]
    if len(found) != 1:
        known = ", ".join(dict.fromkeys(names.values())) or "none"
        raise InputError(f"{file}: expected one joint {hinge!r}, got {len(found)}; its joints are {known}")
    return found[0]


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
