"""What every estimator takes and gives: signals that sensors read in, a joint torque out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models.errors import InputError
from ..knobs import Knob


@dataclass(frozen=True)
class JointSignals:
    """What an estimator may read, shape (n,) each, SI. There is no torque sensor in it, by construction.

    Attributes:
        time: [s], increasing. motor_position, link_position: encoders θm [rad, motor side], θl [rad].
        motor_current: as read [A]. current_command: [A], in force from a sample to the next; None where unknown.
    """

    time: np.ndarray
    motor_position: np.ndarray
    link_position: np.ndarray
    motor_current: np.ndarray
    current_command: np.ndarray | None = None

    def __post_init__(self) -> None:
        for name, given in vars(self).items():
            values = None if given is None else np.ascontiguousarray(given, dtype=np.float64)
            if values is not None and (values.shape != np.shape(self.time) or not np.isfinite(values).all()):
                raise InputError(f"signals: {name}: expected finite numbers, shape {np.shape(self.time)}")
            object.__setattr__(self, name, values)
        if self.time.ndim != 1 or len(self.time) < 2 or not (np.diff(self.time) > 0).all():
            raise InputError("signals: time: expected two or more increasing times [s]")


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
        torque: Shape (n,), joint torque Ts as the force/torque sensor would read it [N·m].
        variance: Shape (n,), what the estimator believes its error variance to be [(N·m)²]; None: it has no belief.
        states: Shape (n, N), SI, named by `state_names`.
        innovation, innovation_covariance: Shape (n, m), (n, m, m); row 0, the start, may be zero.
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

    name: str  # how tables call it; also its key in the registry
    causal: ClassVar[bool] = True  # whether the estimate at a sample uses nothing later
    costly: ClassVar[bool] = False  # whether an update takes ten microseconds rather than a tenth of one
    knobs: ClassVar[tuple[Knob, ...]] = ()  # what tuning may turn; first the one that trades noise for delay

    @abstractmethod
    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        """Estimate the joint torque; `record`: shape (1,), what is known of the joint (`models.parameters`)."""
