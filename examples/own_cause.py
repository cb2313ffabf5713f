"""An own cause: a hose that is pinched near one angle of the link and pushes back there; hidden, diagnosed, named.

A cause says what it does to the joint's numbers. What no number holds, a smooth function of one variable holds: a torque on
rotor, mesh, flexspline or link, or an error of a reading. By its name it is known everywhere, as here to
`flexspline diagnose MEASUREMENT --plugin examples/own_cause.py --out DIR`; docs/plugins.md says how a package offers it.
"""

import numpy as np

import flexspline as fs
from flexspline.models.causes import Cause, CauseParameter, Requirements, put_discrepancy, spline_through


class PinchedHose(Cause):
    """Torque on the link −A exp(−((θl − c)/w)²) [N·m]."""

    name = "pinched_hose"
    component = "link"
    description = "a hose is pinched and pushes back near one angle of the link: −A exp(−((θl − c)/w)²)"
    adds = True  # a second hose in addition to the first
    requires = Requirements(link_travel=0.5, known_push=True)
    parameters = (
        CauseParameter("torque", "N·m", (0.0, 20.0), ((1.0, 2.5),), magnitude=True),
        CauseParameter("angle", "rad", (-3.2, 3.2), ((0.2, 0.6),), neutral=0.4),
        CauseParameter("width", "rad", (0.05, 1.0), ((0.2, 0.4),), neutral=0.3),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        """Put it into the joint's numbers, in place."""
        at = np.linspace(-3.0, 3.0, 30)  # in widths, from the angle
        low, high = (values["angle"] + end * values["width"] for end in (at[0], at[-1]))
        torque = spline_through(-values["torque"] * np.exp(-(at**2)))
        put_discrepancy(p, "link", "link_position", low, high, torque)


CAUSES = (PinchedHose(),)

if __name__ == "__main__":
    from flexspline.models.joint import Effect

    fs.load_plugin(__file__)
    joint = fs.load_joint("test-joint")
    hidden = {"torque": {"value": 1.6}, "angle": {"value": 0.4}, "width": {"value": 0.25}}
    worn = joint.model_copy(update={"effects": [Effect.model_validate({"name": "pinched_hose", "parameters": hidden})]})
    sweep = [(0.5, 0.0), (3.5, 1.2), (9.0, -1.2), (13.0, 1.0), (16.0, 0.0)]  # s, rad
    moves, gains = [{"time": t, "position": x} for t, x in sweep], {"kp": 8.0, "kd": 0.08, "ki": 20.0}
    run = fs.simulate("link_sweep", joint=worn, duration=17, trajectory=moves, controller=gains)
    found = fs.diagnose(run.as_recording(), joint)
    for cause in found.causes:
        values = ", ".join(f"{name} {p.value:.3g} ± {p.std:.1g} {p.unit}" for name, p in cause.parameters.items())
        print(f"{cause.name}: {100 * cause.confidence:.0f} % sure, {values}")
