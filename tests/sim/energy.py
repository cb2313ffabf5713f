"""The energy of a joint: what its bodies, springs, weight and bristle hold, in closed form.

Velocities in the model's state belong to the middle of its steps (leapfrog; `plant.start`). The energy here is that at the
last instant whose positions, and the velocities half a step before and after, are all known: one step ago.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from flexspline.models import laws
from flexspline.models.laws import LOGARITHM_END
from flexspline.sim import plant
from flexspline.sim.plugin import BRISTLE, DAHL, FLEXIBLE, LINK, MEMORY, ROTOR, WAVE_GENERATOR


@dataclass(frozen=True)
class Energy:
    """Where the energy of a joint is [J]."""

    kinetic: float
    flexspline: float
    wave_generator: float
    gravity: float
    link: float
    """Cable spring and hard stop."""
    cogging: float
    friction: float
    """Stored in the bristles of mesh friction and hysteresis."""
    flexible: float
    """Motion and spring of the flexible part of the link."""

    @property
    def total(self) -> float:
        """Sum of all parts [J]."""
        parts = (
            self.kinetic,
            self.flexspline,
            self.wave_generator,
            self.gravity,
            self.link,
            self.cogging,
            self.friction,
            self.flexible,
        )
        return float(sum(parts))


def energy(model: mujoco.MjModel, data: mujoco.MjData, record: np.ndarray) -> Energy:
    """Energy of a plant at the instant `data.time` less one step.

    Args:
      model, data: of `plant.build`, at least one step after `plant.start`.
      record: the parameter record that the model was built with, shape (1,).
    """
    memory = plant.memory(model, data)
    return energy_of(
        record,
        data.qpos - model.opt.timestep * data.qvel,
        0.5 * (memory[MEMORY : MEMORY + model.nv] + data.qvel),
        float(memory[BRISTLE]),
        float(memory[DAHL]),
    )


def energy_of(
    record: np.ndarray, position: np.ndarray, velocity: np.ndarray, bristle: float = 0.0, dahl: float = 0.0
) -> Energy:
    """Energy of a joint in a state.

    Args:
      record: parameters, shape (1,).
      position, velocity: rotor, wave generator, link, rad and rad/s; shape (3,), or (4,) with the angle against the link of
        the flexible part.
      bristle: deflection of the mesh friction's bristle [rad]; dahl: Dahl state of the flexspline's hysteresis [rad].
    """
    p = record[0]
    theta_m, theta_w, theta_l = position[ROTOR], position[WAVE_GENERATOR], position[LINK]
    flexible = float(laws.flexible_inertia(p))
    angle, rate = (position[FLEXIBLE], velocity[FLEXIBLE]) if len(position) > FLEXIBLE else (0.0, 0.0)
    inertia = np.array([p["Jm"], p["Jw"], p["Jl"] - flexible])
    torsion = theta_w / p["N"] - theta_l - laws.kinematic_error(theta_w, p)
    link = 0.5 * p["cable_stiffness"] * (theta_l - p["cable_rest"]) ** 2
    link += 0.5 * p["stop_stiffness"] * max(theta_l - p["stop_angle"], 0.0) ** 2
    on = p["cogging_amplitude"] != 0
    order, amplitude, phase = (p[f"cogging_{name}"][on] for name in ("order", "amplitude", "phase"))
    friction = 0.5 * p["s0"] * bristle**2
    friction += 0.5 * p["hysteresis_torque"] / p["hysteresis_extent"] * dahl**2
    return Energy(
        kinetic=float(0.5 * np.sum(inertia * np.asarray(velocity)[:3] ** 2)),
        flexspline=flexspline_energy(float(torsion), p),
        wave_generator=wave_generator_energy(float(theta_m - theta_w), p),
        gravity=float(p["Mg"] * (1.0 - np.cos(theta_l + p["gravity_angle"]))),
        link=float(link),
        cogging=float(np.sum(amplitude / order * np.cos(order * theta_m + phase))),
        friction=float(friction),
        flexible=float(
            0.5 * flexible * (velocity[LINK] + rate) ** 2 + 0.5 * laws.flexible_torque(angle, 0.0, p) * angle
        ),
    )


def flexspline_energy(torsion: float, p: np.void) -> float:
    """Energy of the flexspline's spring [J]: the integral of `laws.flexspline_spring`, quadratic between the breakpoints.

    Each change of slope adds the integral of its ramp: (u + w)³/12w inside ±w of its breakpoint, u²/2 + w²/6 beyond.
    """
    x = max(abs(torsion) - 0.5 * p["backlash"], 0.0)
    break1 = p["T1"] / p["K1"]
    break2 = break1 + (p["T2"] - p["T1"]) / p["K2"]
    width = min(p["knee_width"], break1)
    total = 0.5 * p["K1"] * x**2
    for place, change in ((break1, p["K2"] - p["K1"]), (break2, p["K3"] - p["K2"])):
        u = x - place
        if u >= width:
            total += change * (0.5 * u**2 + width**2 / 6)
        elif u > -width:
            total += change * (u + width) ** 3 / (12 * width)
    return float(total)


def wave_generator_energy(torsion: float, p: np.void) -> float:
    """Energy of the wave generator's compliance [J]: the integral of `laws.wave_generator_spring`.

    With u = 1 − Cw·Kw0·|δ| it is (u ln u − u + 1)/(Cw²·Kw0); where the law continues as a tangent, quadratic.
    """
    slope = p["Cw"] * p["Kw0"]
    u = 1.0 - slope * abs(torsion)
    end = max(u, LOGARITHM_END)
    # u ln u − u + 1 without cancellation at small torsion: expm1-like, from log1p.
    x = 1.0 - end
    logarithmic = x + (1.0 - x) * np.log1p(-x) if x > 1e-3 else x**2 / 2 + x**3 / 6 + x**4 / 12 + x**5 / 20
    beyond = end - u
    tangent = -np.log(LOGARITHM_END) * beyond + 0.5 * beyond**2 / LOGARITHM_END
    return float((logarithmic + tangent) / (p["Cw"] * slope))
