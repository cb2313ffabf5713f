"""What diagnosis gains for estimation: torque error of the filters before and after they know the effect.

Each filter runs on the recordings twice, with the calibrated joint and with the calibrated joint that has the causes in it
(the description as it came, where no cause was found), without reading the torque sensor. The error is taken against the sensor,
in motion and at rest, over the blocks of time that were kept from every fit.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..models.joint import Joint
from ..sim.recording import Measurement, Recording
from . import diagnose as core
from .diagnose import Diagnosis
from .estimate import estimate
from .replay import HELD_OUT_BLOCK, HELD_OUT_EVERY

FILTERS = ("EKF", "AREKF", "RAREKF")
MAIN = "RAREKF"


@dataclass(frozen=True)
class Trace:
    """Joint torque over one recording, shape (n,) each, N·m: time [s], sensor, `MAIN` before and after."""

    name: str
    time: np.ndarray
    sensor: np.ndarray
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class Gain:
    """Torque error of the filters on held-out data.

    Attributes:
      errors: filter → (before, after), RMS [N·m] against the torque sensor.
      noise: of the sensor [N·m rms]: what remains of a perfect estimate.
      known_before: what the filters knew before, for people.
      traces: of `MAIN`, by recording.
    """

    errors: dict[str, tuple[float, float]]
    noise: float
    known_before: str
    traces: tuple[Trace, ...] = field(repr=False)

    def to_json(self) -> dict[str, Any]:
        """What `diagnosis.json` holds as `estimation`."""
        before, after = self.errors[MAIN]
        return {"filter": MAIN, "before": before, "after": after, "unit": "N·m"}


def estimation(measurement: Measurement, joint: Joint, diagnosis: Diagnosis) -> Gain | None:
    """Torque error of the filters before and after, None without a torque sensor.

    Args:
      joint: the description that diagnosis was given.
    """
    sensed = [(i, r) for i, r in enumerate(measurement.recordings) if r.joint_torque is not None]
    if not sensed:
        return None
    before = core._extended(diagnosis.problem, diagnosis.rounds[0].base, joint) if diagnosis.causes else joint
    with ThreadPoolExecutor(2) as pool:
        tasks = [pool.submit(estimate, r, known) for _, r in sensed for known in (before, diagnosis.extended)]
        done = iter([task.result() for task in tasks])
    squares: dict[str, list[list[np.ndarray]]] = {name: [[], []] for name in FILTERS}
    traces = []
    for index, recording in sensed:
        pair = [next(done), next(done)]
        kept = held_out(recording, index)
        for name in FILTERS:
            for k, estimates in enumerate(pair):
                error = (estimates.torque[name] - recording.joint_torque)[kept]
                squares[name][k].append(error[np.isfinite(error)] ** 2)
        traces.append(
            Trace(
                recording.name,
                recording.time - recording.time[0],
                recording.joint_torque,
                *(e.torque[MAIN] for e in pair),
            )
        )
    errors = {
        name: tuple(float(np.sqrt(np.mean(np.concatenate(parts)))) for parts in both) for name, both in squares.items()
    }
    return Gain(
        errors=errors,
        noise=joint.sensors.joint_torque.noise,
        known_before="the calibrated joint without the causes" if diagnosis.causes else "the description as it came",
        traces=tuple(traces),
    )


def held_out(recording: Recording, index: int) -> np.ndarray:
    """Samples in the blocks of time that no fit saw, shape (n,), bool; `index` of the recording in its measurement."""
    block = np.floor((recording.time - recording.time[0]) / HELD_OUT_BLOCK).astype(int)
    return (block + index) % HELD_OUT_EVERY == HELD_OUT_EVERY - 1


def with_gain(diagnosis: Diagnosis, gain: Gain | None) -> Diagnosis:
    """The diagnosis with the gain in it."""
    return replace(diagnosis, estimation=None if gain is None else gain.to_json())
