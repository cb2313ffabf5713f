"""What every estimator takes and gives: signals that sensors read in, a joint torque out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from ...models.errors import InputError
from ...models.parameters import PARAMETERS


@dataclass(frozen=True)
class JointSignals:
    """What an estimator may read; shape (n,) each, SI. There is no torque sensor in it, by construction.

    Attributes:
        time: [s], increasing.
        motor_position, link_position: encoders θm [rad, motor side], θl [rad].
        motor_current: as read [A].
        current_command: [A], commanded at a sample and in force until the next; None where unknown.
    """

    time: np.ndarray
    motor_position: np.ndarray
    link_position: np.ndarray
    motor_current: np.ndarray
    current_command: np.ndarray | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.time)
        for name in ("time", "motor_position", "link_position", "motor_current", "current_command"):
            if name == "current_command" and self.current_command is None:
                continue
            values = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if values.ndim != 1 or values.shape != shape or len(values) < 2 or not np.isfinite(values).all():
                raise InputError(f"signals: {name}: expected finite numbers of shape {shape}, got {values.shape}")
            object.__setattr__(self, name, values)
        if not (np.diff(self.time) > 0).all():
            raise InputError("signals: time: expected increasing times [s], got a step back or none")

    @property
    def interval(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def current(self) -> np.ndarray:
        """Current in force until each sample [A]: the last command, or the reading (offset included) without one."""
        command = self.current_command
        return self.motor_current if command is None else np.concatenate([[0.0], command[:-1]])


@dataclass(frozen=True)
class SensorNoise:
    """Resolution (one count) and noise (rms) of the sensors: [rad, motor side], [rad], [A]."""

    motor_resolution: float = 2 * math.pi / 4096
    motor_noise: float = 0.0
    link_resolution: float = 2 * math.pi / 2**20
    link_noise: float = 1.5e-6
    current_noise: float = 0.01


@dataclass(frozen=True)
class TorqueEstimate:
    """A torque estimate over n samples.

    Attributes:
        name: of the estimator.
        torque: Shape (n,), joint torque Ts as the force/torque sensor would read it [N·m].
        variance: Shape (n,), what the estimator believes its error variance to be [(N·m)²]; None where it has no belief.
        states: Shape (n, N), in SI; `state_names` says which.
        innovation, innovation_covariance: Shape (n, m), (n, m, m); row 0, the start, is zero.
    """

    name: str
    torque: np.ndarray
    variance: np.ndarray | None = None
    states: np.ndarray | None = None
    state_names: tuple[str, ...] = ()
    innovation: np.ndarray | None = None
    innovation_covariance: np.ndarray | None = None


class Estimator(ABC):
    """An estimator of the joint torque: a frozen dataclass of its knobs, with units."""

    name: str
    """How tables call it; also its key in the registry."""
    causal: bool = True
    """Whether the estimate at a sample uses nothing later."""

    @abstractmethod
    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        """Estimate the joint torque; `record`: shape (1,), what is known of the joint (`models.parameters`)."""


def known(record: np.ndarray) -> np.ndarray:
    """Return the parameter record, shape (1,); `InputError` where it is none."""
    if getattr(record, "dtype", None) != PARAMETERS or record.shape != (1,):
        raise InputError(f"estimator: record: expected a parameter record of shape (1,), got {type(record).__name__}")
    return record
