"""A joint with an effect in closed loop, and estimators that know it: for `test_known_effects`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from flexspline.estimator import Estimator, KnownJoint
from flexspline.models import causes
from flexspline.models.controller import Controller
from flexspline.models.joint import load_joint
from flexspline.models.signals import Signals
from flexspline.sim import loop, plant, sensors

JOINT = load_joint("test-joint")
MOUNTING = JOINT.mount("link")
DURATION, TRANSIENT, WARMING = 7.0, 0.8, 20.0  # s, s, K
DRAWS = (11, 12, 13)
"""Seeds: of the motion, of the sensors' noise, and of what is periodic or turned in an effect."""


class Middle:
    """A random generator that gives the middle of every range, and draws whole turns and choices."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng(seed)

    def uniform(self, low, high):
        return self.rng.uniform(low, high) if high - low > 6.0 and low == 0.0 and high < 6.5 else 0.5 * (low + high)

    def integers(self, low, high=None):
        return self.rng.integers(low) if high is None else round(0.5 * (low + high - 1))

    def choice(self, count, p=None):
        return self.rng.choice(count, p=p)


@dataclass(frozen=True)
class Case:
    """An effect: its name, a cause's or one that comes with fields of the record, or with a model discrepancy (place, variable,
    range of it, size)."""

    name: str
    fields: tuple[tuple[str, object], ...] = ()
    discrepancy: tuple[str, str, float, float, float] | None = None

    def record(self, seed: int) -> np.ndarray:
        """The joint's record with the effect, shape (1,)."""
        record = JOINT.record(MOUNTING)
        p = record[0]
        if not self.fields and self.discrepancy is None and self.name != "none":
            cause = causes.get(self.name)
            cause.apply(p, cause.draw(p, Middle(seed)))
        for name, value in self.fields:
            p[name] = value
        if self.discrepancy is not None:
            place, variable, low, high, size = self.discrepancy
            shape = np.random.default_rng(seed).standard_normal(9)
            coefficients = size * (shape - shape.mean()) / np.abs(shape - shape.mean()).max()
            causes.put_discrepancy(p, place, variable, low, high, coefficients)
        return record


NONE = Case("none")
CASES = (
    *(Case(name) for name in causes.names()),
    Case("link_encoder_zero", (("link_zero", 1e-3),)),
    Case("viscous_exponent", (("viscous_exponent", 0.6),)),
    Case("knee_width", (("knee_width", 2e-4),)),
    Case("discrepancy_rotor", discrepancy=("rotor", "link_position", -1.5, 1.5, 8e-3)),
    Case("discrepancy_mesh", discrepancy=("mesh", "motor_velocity", -160.0, 160.0, 8e-3)),
    Case("discrepancy_flexspline", discrepancy=("flexspline", "load", -15.0, 15.0, 1.0)),
    Case("discrepancy_link", discrepancy=("link", "link_position", -1.5, 1.5, 1.0)),
    Case("discrepancy_joint_torque", discrepancy=("joint_torque", "link_position", -1.5, 1.5, 0.5)),
    Case("discrepancy_link_position", discrepancy=("link_position", "link_position", -1.5, 1.5, 4e-4)),
    Case("discrepancy_motor_current", discrepancy=("motor_current", "link_position", -1.5, 1.5, 0.1)),
)
"""Every known cause at the middle of its ordinary size; what a record can say beyond them; a model discrepancy at every place."""


def motion(seed: int, push: bool) -> tuple[np.ndarray, ...]:
    """Time [s], link position [rad], velocity [rad/s], external torque [N·m] of a draw: a sweep and half of the way back."""
    rng = np.random.default_rng([seed, 7])
    time = np.arange(round(DURATION / 1e-3)) * 1e-3
    begin, way = rng.uniform(0.45, 0.65), rng.uniform(0.45, 0.55)
    position, velocity = np.full(len(time), begin), np.zeros(len(time))
    for start, duration, distance in ((0.8, rng.uniform(3.6, 4.0), way), (5.0, 1.8, -0.35 * way)):
        u = np.clip((time - start) / duration, 0, 1)  # minimum jerk
        position += distance * u**3 * (10 - 15 * u + 6 * u**2)
        velocity += distance / duration * 30 * u**2 * (1 - u) ** 2
    external = np.zeros(len(time))
    if push:
        for centre in rng.uniform((1.6, 4.2), (3.4, 6.2)):
            u = np.clip(np.abs(time - centre) / 0.35, 0, 1)
            external += rng.uniform(4.0, 7.0) * rng.choice([-1, 1]) * 0.5 * (1 + np.cos(np.pi * u))
    return time, position, velocity, external


def simulate(model, *driven, **options) -> loop.Simulation:
    """Run the closed loop of one joint; further arguments as of `loop.Driven`."""
    joint = loop.Driven(*driven, **options)
    found = loop.ClosedLoop(model, (joint,))
    found.advance(len(joint.command))
    return found.simulation


@cache
def signals_of(case: Case, seed: int, push: bool) -> tuple[Signals, np.ndarray]:
    """What the sensors of a joint with the effect read in a draw, without the torque sensor; and its true joint torque Ts."""
    time, position, velocity, external = motion(seed, push)
    record = case.record(seed)
    run = simulate(
        plant.build(JOINT, MOUNTING, record=record), record, position, velocity, external,
        sensors.sensor_records(JOINT, float(record[0]["link_delay"]), loop.CONTROL_PERIOD),
        sensors.noise(JOINT, seed, len(time), loop.CONTROL_PERIOD),
        Controller(kp=8.0, kd=0.08).record(record[0], loop.CONTROL_PERIOD, False),
        temperature=25.0 + WARMING * time / DURATION,
    )  # fmt: skip
    columns = {name: run.readings[name] for name in ("motor_position", "link_position", "motor_current", "temperature")}
    return Signals(time, {**columns, "current_command": run.command}), run.truth["joint_torque"]


def errors(
    estimator: Estimator,
    case: Case,
    push: bool,
    draws: tuple[int, ...],
    known_as: Case | None = None,
    command: bool = True,
):
    """RMS errors [N·m] against the true joint torque over several draws: after the transient, and of that in motion.

    Args:
      known_as: the effect that the estimator knows; the case's own by default.
      command: whether it knows the current command; otherwise it has the reading only.
    """
    whole, moving = [], []
    for seed in draws:
        signals, truth = signals_of(case, seed, push)
        given = signals if command else signals.without("current_command")
        known = KnownJoint.of(JOINT, MOUNTING, (known_as or case).record(seed))
        error = estimator.estimate(given, known).mean - truth
        kept = signals.time >= TRANSIENT
        # Faster than 2.5 Stribeck velocities: below, friction is anything up to its level.
        turning = kept & (np.abs(motion(seed, push)[2]) * JOINT.numbers["N"].value > 2.5 * JOINT.numbers["vs"].value)
        whole.append(np.mean(error[kept] ** 2))
        moving.append(np.mean(error[turning] ** 2))
    return float(np.sqrt(np.mean(whole))), float(np.sqrt(np.mean(moving)))
