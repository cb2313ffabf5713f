"""Low-pass filtered compliance: the compliance model through a Butterworth low-pass of first or second order.

Zhang, Ahmad & Liu, "Torque Estimation Technique of Robotic Joint with Harmonic Drive Transmission", ICRA 2013, filter the
torsion's torque so. Digital design by the bilinear transform; it starts settled at the first sample. Where
samples are uneven their median interval counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from ...models.errors import InputError
from ..knobs import Knob
from .base import Estimator, JointSignals, SensorNoise, TorqueEstimate
from .compliance_model import compliance_measurement


@dataclass(frozen=True)
class LowPass(Estimator):
    """Butterworth low-pass of the compliance model.

    Attributes:
        cutoff: −3 dB frequency [Hz].
        order: 1 or 2.
    """

    name: str = "lowpass"
    cutoff: float = 30.0
    order: int = 2
    knobs: ClassVar[tuple[Knob, ...]] = (Knob("cutoff", 1.0, 400.0),)

    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        raw, _ = compliance_measurement(signals, record, noise)
        nyquist = 0.5 / float(np.median(np.diff(signals.time)))
        if not 0.0 < self.cutoff < nyquist or self.order not in (1, 2):
            raise InputError(
                f"{self.name}: expected a cutoff between 0 and {nyquist:g} Hz and order 1 or 2, "
                f"got {self.cutoff:g} Hz and {self.order}"
            )
        sections = butter(self.order, self.cutoff / nyquist, output="sos")
        torque, _ = sosfilt(sections, raw, zi=sosfilt_zi(sections) * raw[0])
        return TorqueEstimate(self.name, torque)


ESTIMATORS = (LowPass(), LowPass("lowpass_first_order", 30.0, 1))
