"""Frequency response of a joint, measured and as its description has it: from motor current to motor velocity.

Spectra are Welch's, over all segments of smooth motion (`data.segments`), of the readings and of what the joint's laws ask for on
the same motion (`fit.replay`), averaged over bands of a twelfth of an octave. Where the recording has its position command, it
is the reference of both spectra (Sωr/Sir), so that the loop's own noise does not bias the response. The coherence is the lesser
one of reference and current, and of reference and position. Nothing is said above the smoother's passband.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter, minimum_filter1d
from scipy.signal import csd, find_peaks

from ..estimator.conditioning import as_logged
from ..models.errors import InputError
from ..models.joint import Joint
from ..models.recording import Measurement
from .data.segments import CURRENT, STEP, segments
from .data.stretches import most_telling
from .fit.replay import readings

_WINDOW = 4.0  # s: of a spectrum, or a quarter of the longest segment
_BAND = 2 ** (1 / 12)  # between frequencies
_COHERENT = 0.5  # least coherence of a resonance
_EXCITED = 0.25  # least share of coherent frequencies
_PROMINENT = 0.35  # of a peak in ln |H|: 3 dB


@dataclass(frozen=True)
class Response:
    """A frequency response; m frequencies."""

    frequency: np.ndarray  # [Hz], shape (m,)
    measured: np.ndarray  # motor velocity over motor current [rad/(s·A)], complex, shape (m,)
    simulated: np.ndarray  # likewise
    coherence: np.ndarray  # of current or velocity with the reference, the lesser one, shape (m,)
    own: np.ndarray  # the same of the simulated current
    reference: bool  # the position command was the reference

    @property
    def coherent(self) -> np.ndarray:
        """Whether current and velocity are coherent with the reference, shape (m,)."""
        return self.coherence > _COHERENT

    def resonances(self, simulated: bool = False) -> tuple[list[float], list[float]]:
        """Frequencies [Hz] of peaks and of dips, where current and velocity are coherent; simulated: that current, too."""
        size = np.log(np.abs(self.simulated if simulated else self.measured))
        kept = minimum_filter1d(self.coherence, 3) > _COHERENT  # one bin alone may be so by chance
        if simulated:  # at a resonance the laws need next to no current: its neighbours are coherent
            kept &= minimum_filter(self.own, footprint=[1, 0, 1]) > _COHERENT
        return tuple(  # type: ignore[return-value]
            [float(self.frequency[k]) for k in find_peaks(sign * size, prominence=_PROMINENT)[0] if kept[k]]
            for sign in (1, -1)
        )

    def to_json(self) -> dict[str, Any]:
        """As `flexspline bode --json` prints it."""
        of = {}
        for name, simulated in (("measured", False), ("simulated", True)):
            peaks, dips = self.resonances(simulated)
            of[name] = {"resonances": peaks, "antiresonances": dips}
        good = self.coherent
        ratio = np.abs(self.simulated / self.measured)[good]
        share = float(np.sqrt(np.mean(np.log(ratio) ** 2))) if np.any(good) else None
        return of | {
            "coherent_share": float(np.mean(good)), "rms_log_ratio": share, "to": float(self.frequency[-1]),
            "reference": "position_command" if self.reference else "motor_current", "unit": "rad/(s·A)",
        }  # fmt: skip


def excited_response(measurement: Measurement, joint: Joint) -> Response | None:
    """Return the response (`response`) if a quarter of its frequencies is coherent; else None."""
    try:
        found = response(most_telling(measurement), joint)
    except InputError:
        return None
    return found if np.mean(found.coherent) >= _EXCITED else None


def response(measurement: Measurement, joint: Joint) -> Response:
    """The frequency response of a measurement's motion.

    Args:
      measurement: with `motor_position` and `motor_current` (or `motor_torque`).
      joint: its description.

    Raises:
      InputError: a measurement without these, or shorter than two seconds without gaps.
    """
    joint = as_logged(joint, measurement.recordings)
    found, _ = segments(list(measurement.recordings), joint)
    having = [s for s in found if s.balances[CURRENT] and s.rotor_measured and s.time[-1] - s.time[0] > 2.0]
    if not having:
        raise InputError(
            f"{measurement.path}: expected two seconds of motor_position and motor_current without gaps, got none"
        )
    longest = max(len(s.time) for s in having)
    size = min(round(_WINDOW / STEP), longest // 4)
    recordings = measurement.recordings
    reference = all("position_command" in recordings[s.recording] for s in having)
    total: dict[str, np.ndarray] = {}
    for s in (s for s in having if len(s.time) >= size):
        r = recordings[s.recording]
        since, record = r.time - r.time[0], joint.record(s.mounting)
        current = np.interp(
            s.time, since, r["motor_current"] if "motor_current" in r else r["motor_torque"] / record["Kt_drive"][0]
        )
        own = readings(s, record)[:, CURRENT]
        if not np.isfinite(own).all():
            raise InputError(f"{measurement.path}: the joint cannot follow the motion of {s.name}: is it in rad?")
        raw = np.interp(s.time, since, r["motor_position"])
        ref = np.interp(s.time, since, r["position_command"]) if reference else current
        for name, a, b in (
            ("ri", ref, current), ("rq", ref, raw), ("rs", ref, own), ("rm", ref, s.rotor[:, 0]), ("rr", ref, ref),
            ("ii", current, current), ("qq", raw, raw), ("ss", own, own),
        ):  # fmt: skip
            frequency, spectrum = csd(a, b, fs=1 / STEP, nperseg=size, detrend="linear")
            total[name] = total.get(name, 0.0) + spectrum * len(s.time)
    end = max(1 / (2 * np.pi * s.passband) for s in having)
    centres = frequency[1] * _BAND ** np.arange(int(np.log(end / frequency[1]) / np.log(_BAND)) + 1)
    ends: list[int] = np.searchsorted(frequency, np.r_[centres, centres[-1] * _BAND] / _BAND**0.5).tolist()
    bands = [slice(i, j) for i, j in pairwise(ends) if j > i]
    f = np.array([np.mean(frequency[band]) for band in bands])
    t = {name: np.array([np.mean(spectrum[band]) for band in bands]) for name, spectrum in total.items()}
    omega = 2j * np.pi * f
    with np.errstate(divide="ignore", invalid="ignore"):  # a reference at rest
        coherence = [np.nan_to_num(np.abs(t[f"r{x}"]) ** 2 / np.real(t["rr"] * t[x + x])) for x in ("i", "q", "s")]
        least = np.minimum(*coherence[:2])
        return Response(f, omega * t["rq"] / t["ri"], omega * t["rm"] / t["rs"], least, coherence[2], reference)
