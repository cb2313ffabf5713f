"""Payloads that a link carries for a time: masses that are picked up and put down."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from .arm import Carried, Load
from .files import Strict
from .joint_parts import Mounting
from .motion import differentiated
from .parameters import GRAVITY

_LEVER = 0.25  # m: largest distance of the link's centre of mass from the axis


class PayloadSpec(Strict):
    """A payload on the link."""

    mass: Annotated[float, Field(ge=0)]
    """[kg]."""
    distance: Annotated[float, Field(ge=0)]
    """Of its centre from the axis [m]."""
    angle: float = 0.0
    """Of it against the link's own centre of mass [rad]."""
    inertia: Annotated[float, Field(ge=0)] = 0.0
    """About its own centre [kg·m²]."""

    @property
    def joint_inertia(self) -> float:
        """Inertia about the joint's axis [kg·m²]."""
        return self.mass * self.distance**2 + self.inertia

    @property
    def gravity_moment(self) -> float:
        """Gravity moment at horizontal [N·m]."""
        return self.mass * GRAVITY * self.distance

    def on(self, link: Mounting) -> Mounting:
        """Return the link with the payload: m g d adds to the gravity moment as a vector, m d² and `inertia` to the inertia."""
        whole = link.gravity_moment + self.gravity_moment * np.exp(1j * self.angle)
        turned = float(np.angle(whole)) if abs(whole) > 0 else 0.0
        return Mounting(
            inertia=link.inertia + self.joint_inertia,
            gravity_moment=float(abs(whole)),
            gravity_angle=link.gravity_angle + turned,
        )


class CarriedMass(PayloadSpec, Carried):
    """A payload that the link picks up and puts down."""


def link_mass(inertia: float, gravity_moment: float) -> tuple[float, float]:
    """Return a mass of a link [kg] and the distance of its centre from the axis [m], by its inertia about the axis
    [kg·m²] and its gravity moment [N·m]: a description has no more."""
    moment = gravity_moment / GRAVITY
    if moment <= 0.0:
        return 0.1, 0.0
    lever = min(_LEVER, 0.6 * inertia / moment)  # its own m r² is at most 60 % of the inertia
    return moment / lever, lever


def carrying(record: np.ndarray, payloads: Sequence[CarriedMass]) -> np.ndarray:
    """Return a joint's parameter record, shape (1,), with payloads on the rigid part of its link."""
    record = record.copy()
    p = record[0]
    flexible = p["flexible_share"] * p["Jl"]
    moment = complex(p["Mg"])
    for one in payloads:
        p["Jl"] += one.joint_inertia
        moment += one.gravity_moment * np.exp(1j * one.angle)
    p["Mg"] = abs(moment)
    p["gravity_angle"] += np.angle(moment)
    p["flexible_share"] = flexible / p["Jl"]
    return record


def load_of(
    payloads: Sequence[CarriedMass], link: Mounting, time: np.ndarray, position: np.ndarray, parts: Sequence[slice]
) -> Load:
    """Return the effect of payloads at each sample, shape (n,), on a link whose load without them is `link`; their
    times count as `time` does [s]. `position`: of the link [rad]; `parts`: samples between gaps."""
    inertia, torque, acceleration = np.full(len(time), link.inertia), np.zeros(len(time)), np.zeros(len(time))
    for one in payloads:
        on = one.carried(time)
        inertia += on * one.joint_inertia
        torque -= on * one.gravity_moment * np.sin(position + link.gravity_angle + one.angle)
    for part in parts:
        acceleration[part] = differentiated(time[part], position[part])[2]
    return Load(inertia, torque, acceleration)
