"""The joint that a fit says: its description with calibrated numbers and with effects."""

from __future__ import annotations

import numpy as np

from ..models import causes
from ..models.calibration import Calibration, Slot
from ..models.joint import Joint
from ..models.joint_parts import Effect, Estimate
from .answer import ParameterShift
from .fit.residual import TIMING, Problem
from .fit.solver import Fit
from .search.discrepancy import Spline


def parameter_shifts(problem: Problem, at: Fit) -> dict[str, ParameterShift]:
    """Numbers that differ from nominal by more than the data's own uncertainty."""
    c = problem.calibration
    x = at.theta[: c.size]
    covariance = at.covariance[: c.size, : c.size]
    moved = {}
    for slot in c.slots:
        value, std = value_and_std(c, slot, x, covariance)
        number = slot.number
        shared = problem.joint.shared_tolerances[number.shared] if number.shared else 0.0
        tolerance = float(np.hypot(np.hypot(number.tolerance, shared), number.deviation))
        prior = c.deviation(slot)
        if _told(value - number.value, std, prior):
            unit = "" if number.unit == "1" else number.unit
            moved[slot.name] = ParameterShift(number.value, value, std, tolerance, unit, (value - number.value) / prior)
    return moved | {DELAYS[sensor]: shift for sensor, shift in _delays(problem, at).items()}


def _told(shift: float, std: float, prior: float) -> bool:
    """Return whether the data significantly change a number and reduce its uncertainty."""
    return std < 0.8 * prior and abs(shift) > max(2 * std, 0.1 * prior)


DELAYS = {"motor_current": "current_delay", "joint_torque": "torque_sensor_delay"}
"""Sensors with a fitted delay, and its name."""


def _delays(problem: Problem, at: Fit) -> dict[str, ParameterShift]:
    """Delays of sensors that differ from the description by more than the data's own uncertainty."""
    found = {}
    for i, sensor in enumerate(DELAYS):
        j, prior = problem.calibration.size + i, float(TIMING[i])
        shift, std = -prior * float(at.theta[j]), prior * float(np.sqrt(at.covariance[j, j]))
        if _told(shift, std, prior):
            described = getattr(problem.joint.sensors, sensor).delay
            late = max(described + shift, 0.0)  # not negative
            found[sensor] = ParameterShift(described, late, std, prior, "s", (late - described) / prior)
    return found


def value_and_std(c: Calibration, slot: Slot, x: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Return a number and its standard deviation, with a covariance of the calibration variables x, shape (n, n)."""
    value = c.value(slot, x)
    step = 1e-3
    slope = np.array([(c.value(slot, x + step * e) - value) / step for e in np.eye(c.size)])
    return value, float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


_PLACES = {
    "link_encoder_zero": ("sensors", "link_encoder", "zero"),
    "current_offset": ("sensors", "motor_current", "offset"),
    "torque_sensor_gain": ("sensors", "joint_torque", "gain"),
    "torque_sensor_offset": ("sensors", "joint_torque", "offset"),
    "Jl": ("link_tolerances", "inertia"),
    "Mg": ("link_tolerances", "gravity_moment"),
    "arm_load": ("link_tolerances", "arm"),
    "gravity_angle": ("gravity_angle",),
}
"""Path in a joint's description of numbers outside `numbers`."""


def calibrated(problem: Problem, at: Fit, joint: Joint) -> Joint:
    """Return the joint with the numbers of a fit, their nominal values and standard deviations; of those that it held
    as they were described."""
    c = problem.calibration
    x, covariance = at.theta[: c.size], at.covariance[: c.size, : c.size]
    data = joint.model_dump()
    for slot in c.slots:
        if np.all(problem.held[c.variables(slot)]):
            continue  # as it was described
        value, std = value_and_std(c, slot, x, covariance)
        if slot.field in ("amplitude", "phase"):
            target = data["kinematic_error"][slot.index][slot.field]
        elif slot.name in _PLACES:
            target = data
            for key in _PLACES[slot.name]:
                target = target[key]
        else:
            target = data["numbers"][slot.name]
        nominal = target["value"] if target.get("nominal") is None else target["nominal"]
        target.update(value=value, std=std, nominal=nominal)
    for sensor, delay in _delays(problem, at).items():
        data["sensors"][sensor]["delay"] = delay.value
    found = Joint.model_validate(data)
    found._path = joint._path
    return found


def extended(problem: Problem, at: Fit, joint: Joint) -> Joint:
    """Return the joint with calibrated numbers (their nominal values included), effects and discrepancies of a fit."""
    found = calibrated(problem, at, joint)
    effects: list[Effect] = []
    discrepancies = list(joint.discrepancies)
    for i, (h, u) in enumerate(zip(at.model, problem.split(at.theta, at.model), strict=True)):
        if isinstance(h, Spline):
            discrepancies.append(h.as_discrepancy(u))
            continue
        block = problem.place(at.model, i)
        values, std = h.values(u), problem.deviation(h, u, at.covariance[block, block])
        parameters = {
            q.name: Estimate(value=values[q.name], unit=q.unit, std=std.get(q.name)) for q in h.cause.parameters
        }
        effects.append(Effect(name=h.cause.name, parameters=parameters))
    names = {e.name for e in effects}
    kept = [e for e in joint.effects if e.name not in names or causes.get(e.name).adds]
    return found.model_copy(update={"effects": [*kept, *effects], "discrepancies": discrepancies})
