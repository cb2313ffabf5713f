"""The MJCF of a joint: the test joint's bodies, with the numbers of a description."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from .joint import Joint, shipped
from .mjcf import STATED
from .payload import link_mass

_COMMENT = """ {name}: one robot joint with a harmonic drive; rotor, wave generator, flange and link on one axis.

       Opens in any MuJoCo viewer. Alone, the two torsion tendons are linear springs (K1, Kw0). The testbed sets every
       number from the joint's YAML and replaces the linear springs by what MJCF cannot say: the stiffening flexspline
       Eq. (7), the wave generator's logarithmic law Eqs. (3)-(5), and the kinematic error. Angle zero: the link hangs
       straight down. SI units; rotor and wave generator turn on the motor side, {N:g} times the output. """


def mjcf_text(joint: Joint) -> str:
    """Return the MJCF of a description with its default mounting, as text.

    Inertias, springs and dampings (K1, df, Kw0, dw, bm, bl), motor and mesh friction are the description's; shapes
    and colours the test joint's.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(shipped("test_joint.xml").read_text(encoding="utf-8"), parser=parser)
    p = joint.bare_record()[0]
    n = {symbol: f"{number.value:.8g}" for symbol, number in joint.numbers.items()}
    root.set("model", joint.name)
    comment = next(child for child in root if child.tag is ElementTree.Comment)
    comment.text = _COMMENT.format(name=joint.name, N=p["N"])

    def put(path: str, **attributes: str) -> None:
        element = root.find(path)
        assert element is not None, path
        for name, value in attributes.items():
            element.set(name, value)

    for path, attribute, symbols in STATED:
        put(path, **{attribute: " ".join(n.get(symbol, symbol) for symbol in symbols)})
    put(".//body[@name='link']/inertial", **_inertial(float(p["Jl"]), float(p["Mg"])))
    put(".//tendon/fixed[@name='flexspline']/joint[@joint='wave_generator']", coef=f"{1 / p['N']:.12g}")
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _inertial(inertia: float, moment: float) -> dict[str, str]:
    """Return mass, place and shape of a link by its inertia about the axis [kg·m²] and gravity moment [N·m]."""
    mass, lever = link_mass(inertia, moment)
    own = inertia - mass * lever**2
    return {
        "mass": f"{mass:.8g}",
        "pos": f"0 0 {-lever:.8g}",
        "diaginertia": f"{own:.8g} {own:.8g} {min(own, 0.01):.8g}",
    }
