"""Text of a collapsed joint for other simulators: MJCF, URDF, mjlab, Isaac Lab; and a user's file with some numbers changed."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..models.errors import InputError
from ..models.parameters import GRAVITY

if TYPE_CHECKING:
    from ..diagnosis.collapse import Collapse

TARGETS = ("mjcf", "urdf", "mjlab", "isaac")


def heading(found: Collapse, joint: str, motion: str) -> list[str]:
    """What the file says first: what the collapse costs, on which motion, and where it is worst."""
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
        lines.append(f"The description before identification, written likewise: {_g(found.nominal)} A.")
    if found.worst is not None:
        w = found.worst
        lines.append(f"Worst: {w.by} from {_g(w.low)} to {_g(w.high)} {w.unit}, {_g(w.rms)} A.")
    speed, load = found.visited
    lines.append(f"Visited: speed to {_g(speed)} rad/s, load to {_g(load)} N·m. Beyond it nothing was fitted.")
    if found.structure == "two_bodies":
        lines.append(
            "Of the friction, s0 is the joint's own and s1 small enough for this timestep: they do not show in motion."
        )
    return lines


def written(found: Collapse, target: str, hinge: str, notes: list[str], link: Mapping[str, float]) -> str:
    """The whole file of a target.

    Args:
      found: the collapse; hinge: name of the joint in the target; notes: of `heading`.
      link: `inertia` [kg·m²], `mass` [kg], and `lever` [m] and `angle` [rad] of its centre, of what is on the joint: for a
        model of its own.
    """
    return {"mjcf": _mjcf, "urdf": _urdf, "mjlab": _mjlab, "isaac": _isaac}[target](found, hinge, notes, link)


def _g(x: float | None) -> str:
    return f"{x:.4g}"


def _n(x: Any) -> str:
    return " ".join(f"{one:.9g}" for one in (x if isinstance(x, (list, tuple)) else [x]))


def _centre(link: Mapping[str, float]) -> str:
    return _n([link["lever"] * math.sin(link["angle"]), 0.0, -link["lever"] * math.cos(link["angle"])])


def _comment(notes: list[str], indent: str = "  ") -> str:
    text = f"\n{indent}     ".join(note.replace("--", "- -") for note in notes)
    return f"{indent}<!-- {text} -->\n"


def _mjcf(found: Collapse, hinge: str, notes: list[str], link: Mapping[str, float]) -> str:
    p = found.parameters
    about = _n([link["inertia"] - link["mass"] * link["lever"] ** 2] * 3)
    inertial = f'<inertial pos="{_centre(link)}" mass="{_n(link["mass"])}" diaginertia="{about}"/>'
    head = (
        f'<mujoco model="{hinge}">\n{_comment(notes)}  <compiler angle="radian" autolimits="true"/>\n'
        f'  <option timestep="0.001" integrator="implicitfast" gravity="0 0 {-GRAVITY}"/>\n  <worldbody>\n'
    )
    if found.structure != "two_bodies":
        attributes = " ".join(f'{name}="{_n(p[name])}"' for name in _HINGE if p[name])
        limit = _n(p["torque_limit"])
        return head + (
            f'    <body name="link">\n      <joint name="{hinge}" axis="0 -1 0" {attributes}/>\n      {inertial}\n    </body>\n'
            f"  </worldbody>\n  <actuator>\n    <!-- ctrl: torque at the output, N Kt times the current [N·m] -->\n"
            f'    <motor name="{hinge}" joint="{hinge}" ctrlrange="-{limit} {limit}" forcerange="-{limit} {limit}"/>\n'
            "  </actuator>\n</mujoco>\n"
        )
    inertia = _n(p["inertia"])
    cogging = f' cogging="{_n(p["cogging"])}"' if p["cogging"][0] else ""
    return head + (
        f'    <body name="{hinge}_rotor">\n'
        f'      <joint name="{hinge}_rotor" axis="0 -1 0" damping="{_n(p["damping"])}"/>\n'
        f'      <inertial pos="0 0 0" mass="1e-6" diaginertia="{inertia} {inertia} {inertia}"/>\n    </body>\n'
        f'    <body name="link">\n      <joint name="{hinge}" axis="0 -1 0" damping="{_n(p["link_damping"])}"/>\n'
        f"      {inertial}\n    </body>\n  </worldbody>\n  <tendon>\n"
        f'    <fixed name="{hinge}_torsion" stiffness="{_n(p["stiffness"])}" damping="{_n(p["spring_damping"])}" '
        'springlength="0">\n'
        f'      <joint joint="{hinge}_rotor" coef="{_n(1 / p["N"])}"/>\n      <joint joint="{hinge}" coef="-1"/>\n'
        "    </fixed>\n  </tendon>\n  <actuator>\n"
        "    <!-- ctrl: torque that the current controller is asked for, Kt times the current [N·m, motor side] -->\n"
        f'    <dcmotor name="{hinge}" joint="{hinge}_rotor" input="ff" motorconst="{_n([p["Kt"]] * 2)}" '
        f'resistance="{_n(p["R"])}" inductance="{_n(p["L"])} 0" saturation="0 {_n(p["current_limit"])} 0" '
        f'controller="0 0 0 0 0 {_n(p["supply_voltage"])}"{cogging}/>\n'
        f'    <dcmotor name="{hinge}_friction" joint="{hinge}_rotor" input="none" motorconst="0 0" resistance="1" '
        f'lugre="{_n([p[name] for name in ("s0", "s1", "Fc", "Fs", "vs")])}"/>\n  </actuator>\n</mujoco>\n'
    )


_HINGE = ("armature", "damping", "frictionloss", "stiffness", "springref")


def _urdf(found: Collapse, hinge: str, notes: list[str], link: Mapping[str, float]) -> str:
    p = found.parameters
    own = _n(link["inertia"] - link["mass"] * link["lever"] ** 2)
    return (
        f'<robot name="{hinge}">\n{_comment(notes)}  <link name="base"/>\n  <link name="link">\n    <inertial>\n'
        f'      <origin xyz="{_centre(link)}"/>\n      <mass value="{_n(link["mass"])}"/>\n'
        f'      <inertia ixx="{own}" iyy="{own}" izz="{own}" ixy="0" ixz="0" iyz="0"/>\n    </inertial>\n  </link>\n'
        f'  <joint name="{hinge}" type="revolute">\n    <parent link="base"/>\n    <child link="link"/>\n'
        '    <axis xyz="0 -1 0"/>\n'
        f'    <limit lower="-3.14159" upper="3.14159" effort="{_n(p["torque_limit"])}" velocity="{_n(p["speed_limit"])}"/>\n'
        f'    <dynamics damping="{_n(p["damping"])}" friction="{_n(p["frictionloss"])}"/>\n  </joint>\n</robot>\n'
    )


def _mjlab(found: Collapse, hinge: str, notes: list[str], link: Mapping[str, float]) -> str:
    p = found.parameters
    return (
        "".join(f"# {note}\n" for note in notes)
        + f"""from mjlab.actuator import BuiltinMotorActuatorCfg

ACTUATOR = BuiltinMotorActuatorCfg(
    target_names_expr=("{hinge}",),
    effort_limit={p["torque_limit"]:.9g},  # N·m
    armature={p["armature"]:.9g},  # kg·m²
    frictionloss={p["frictionloss"]:.9g},  # N·m
)


def with_passive_forces(spec):
    \"\"\"Set what the actuator's configuration does not hold; call it in the entity's `spec_fn`.\"\"\"
    joint = spec.joint("{hinge}")
    joint.damping = [{p["damping"]:.9g}, 0.0, 0.0]  # N·m·s/rad
    joint.stiffness = [{p["stiffness"]:.9g}, 0.0, 0.0]  # N·m/rad
    joint.springref = {p["springref"]:.9g}  # rad
    return spec
"""
    )


def _isaac(found: Collapse, hinge: str, notes: list[str], link: Mapping[str, float]) -> str:
    p = found.parameters
    return (
        "".join(f"# {note}\n" for note in notes)
        + f"""from isaaclab.actuators import ImplicitActuatorCfg

# Efforts are commanded: gains of a position drive are yours to set. Friction is an effort (Isaac Sim 5).
ACTUATOR = ImplicitActuatorCfg(
    joint_names_expr=["{hinge}"],
    effort_limit_sim={p["torque_limit"]:.9g},  # N·m
    velocity_limit_sim={p["speed_limit"]:.9g},  # rad/s
    stiffness=0.0,
    damping=0.0,
    armature={p["armature"]:.9g},  # kg·m²
    friction={p["frictionloss"]:.9g},  # N·m
    dynamic_friction={p["frictionloss"]:.9g},  # N·m
    viscous_friction={p["damping"]:.9g},  # N·m·s/rad
)
"""
    )


def put_into(text: str, found: Collapse, hinge: str, notes: list[str], file: str) -> str:
    """A user's MJCF or URDF with the numbers of one joint changed, everything else to the letter.

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
    return whole[:at] + _comment(notes, "") + whole[at:]


def _blind(text: str) -> str:
    """Text with comments blotted out, place for place."""
    return re.sub(r"<!--.*?-->", lambda m: " " * len(m.group()), text, flags=re.DOTALL)


def _joint_tag(text: str, hinge: str, file: str) -> re.Match[str]:
    """The opening tag of the joint of a body (MJCF) or robot (URDF) by its name."""
    named = re.compile(r"""\bname\s*=\s*(["'])(.*?)\1""")
    tags = {m: named.search(m.group()) for m in re.finditer(r"<joint\b[^>]*>", _blind(text))}
    names = {m: name.group(2) for m, name in tags.items() if name is not None}
    found = [m for m, name in names.items() if name == hinge]
    if len(found) != 1:
        known = ", ".join(dict.fromkeys(names.values())) or "none"
        raise InputError(f"{file}: expected one joint {hinge!r}, got {len(found)}; its joints are {known}")
    return found[0]


def _with_attributes(tag: str, values: Mapping[str, str]) -> str:
    """An opening tag with attributes set, the others and all white space kept."""
    for name, value in values.items():
        there = re.search(rf"""(\s{name}\s*=\s*)(["'])(.*?)\2""", tag)
        if there is not None:
            tag = tag[: there.start()] + there.group(1) + there.group(2) + value + there.group(2) + tag[there.end() :]
        else:
            end = re.search(r"\s*/?>$", tag)
            assert end is not None
            tag = tag[: end.start()] + f' {name}="{value}"' + tag[end.start() :]
    return tag
