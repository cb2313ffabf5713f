"""A link that is not rigid."""

from .base import Cause, CauseParameter, Requirements


class LinkFlexibility(Cause):
    """Part of the link's inertia is connected by a spring: a second resonance.

    J_s (φ'' + θl'') = −k φ − d φ' with J_s = share · Jl; frequency and damping ratio are those with the link held.
    Ordinary: a slender tool or a payload in a rubber grip, near the joint's own resonance (19 Hz with the test
    joint's link), damped as metal and rubber are.
    """

    name = "link_flexibility"
    component = "link"
    imperfection = True
    description = "part of the link's inertia is connected by a spring: a second resonance"
    parameters = (
        CauseParameter("share", "1", (0.0, 0.9), ((0.15, 0.4),), magnitude=True),
        # From damping that is broad enough for the next frequency to be within reach.
        CauseParameter(
            "frequency", "Hz", (1.0, 200.0), ((10.0, 25.0),), starts=(10.0, 11.7, 13.6, 15.8, 18.4, 21.4, 25.0)
        ),
        CauseParameter("damping", "1", (1e-3, 0.5), ((0.01, 0.05),), starts=(0.05,)),
    )
    sets = {"share": "flexible_share", "frequency": "flexible_frequency", "damping": "flexible_damping"}
    behind_link_encoder = "it is faster than the rotor's motion that the link's encoder shows"
    resonance = True
    requires = Requirements(known_push=True)
