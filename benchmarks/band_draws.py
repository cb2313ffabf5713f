"""Coverage of the bands of an extended joint outside the range of its fit: simulated channels and estimates.

A joint is measured in a part of its range of angle, speed and load, diagnosed, and then moves through the whole range. Truth is
the noise-free reading of its sensors. Samples in motion outside the first measurement's range count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexspline.diagnosis.answer import Diagnosis
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.improvement import MAIN as ESTIMATORS
from flexspline.diagnosis.trials.draw import Challenge, Draw, draw, drawn_scenarios
from flexspline.diagnosis.trials.motions import jittered, record_motion
from flexspline.diagnosis.validate import SIGMAS, Channels, validate
from flexspline.estimator.offline import estimate_recording
from flexspline.models.joint import Joint
from flexspline.models.recording import Measurement, Recording
from flexspline.scenarios.scenario import Scenario


@dataclass(frozen=True)
class Held:
    """How much of the truth lies in a band beyond the data.

    Attributes:
      samples: in motion beyond the range of the data.
      inside: of these, share of the truth inside the 95 % band.
      error: rms of what the band is about; width: rms of its standard deviation, in its unit.
    """

    samples: int
    inside: float
    error: float
    width: float


@dataclass(frozen=True)
class Part:
    """A draw of which a part was diagnosed.

    Attributes:
      drawn: with recordings of the whole range; seen: what diagnosis saw; found: what it said.
      truth: what its sensors would have read without noise in `drawn`'s recordings.
    """

    drawn: Draw
    seen: Measurement
    found: Diagnosis
    truth: tuple[Recording, ...]


def diagnosed_part(challenge: Challenge, index: int, share: float = 0.6) -> Part:
    """Draw number `index`, measured over a share of its angles, and thereby of speeds and loads, and diagnosed."""
    drawn = draw(challenge, index)
    measurement = Measurement(f"part of draw {index}", Path(), _recorded(challenge, index, drawn, share))
    found = diagnose(measurement, drawn.nominal)
    return Part(drawn, measurement, found, _recorded(challenge, index, drawn, quiet=True))


def _recorded(
    challenge: Challenge, index: int, drawn: Draw, share: float = 1.0, quiet: bool = False
) -> tuple[Recording, ...]:
    """Recordings of a draw's joint again: over a share of its angles; `quiet`, by sensors and clocks without noise."""
    found = []
    flaws = drawn.imperfections
    for k, (scenario, record) in enumerate(
        zip(drawn_scenarios(challenge, index, drawn.nominal), drawn.records, strict=True)
    ):
        true = drawn.nominal if flaws is None else flaws.nominal
        seed, clock = ([challenge.seed, index, at + k] for at in (20, 30))
        one = record_motion(
            without_noise(true) if quiet else true, scenario.mount(drawn.nominal), record,
            smaller(scenario, share), int(np.random.default_rng(seed).integers(2**31)), False,
            0.0 if flaws is None else flaws.warming,
        )  # fmt: skip
        if flaws is not None and not quiet:
            one = jittered(one, flaws.jitter, np.random.default_rng(clock))
        found.append(one)
    return tuple(found)


def smaller(scenario: Scenario, share: float) -> Scenario:
    """The same motion with all angles `share` times as large; pushes unchanged."""
    points = [w.model_copy(update={"position": share * w.position}) for w in scenario.trajectory]
    return scenario.model_copy(update={"trajectory": points})


def without_noise(joint: Joint) -> Joint:
    """The joint with sensors that have no noise; their bandwidth, delay, ripple and crosstalk stay."""
    s = joint.sensors
    still = {"noise": 0.0, "step": 0.0, "flicker": 0.0, "vibration": None}
    quiet = s.model_copy(
        update={
            "link_encoder": s.link_encoder.model_copy(update={"noise": 0.0}),
            "motor_current": s.motor_current.model_copy(update=still),
            "joint_torque": s.joint_torque.model_copy(update=still),
        }
    )
    return joint.model_copy(update={"sensors": quiet})


def channels_held(part: Part) -> dict[str, Held]:
    """Bands of the simulated channels against the truth, beyond the range of the data."""
    extended = part.found.extended
    simulated = validate(part.drawn.measurement, extended)
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for shown, truth in zip(simulated.recordings, part.truth, strict=True):
        use = unseen(shown, extended)
        for name in shown.measured:
            if name not in truth:
                continue
            error = np.interp(shown.time, truth.time, truth[name]) - shown.simulated[name]
            good = use & np.isfinite(error)
            found.setdefault(name, []).append((error[good], shown.deviation[name][good]))
    return {name: _held(pairs) for name, pairs in found.items()}


def estimates_held(part: Part, names: Sequence[str] = ESTIMATORS) -> dict[str, Held]:
    """Bands of torque estimates against the true joint torque, beyond the range of the data."""
    extended = part.found.extended
    simulated = validate(part.drawn.measurement, extended)
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for shown, recording, truth in zip(
        simulated.recordings, part.drawn.measurement.recordings, part.truth, strict=True
    ):
        estimates = estimate_recording(recording, extended, names, bands=True)
        use = unseen(shown, extended)
        for name, values in estimates.torque.items():
            error = np.interp(shown.time, truth.time, truth["joint_torque"]) - values
            width = estimates.deviation[name]
            good = use & np.isfinite(error) & np.isfinite(width)
            found.setdefault(name, []).append((error[good], width[good]))
    return {name: _held(pairs) for name, pairs in found.items()}


def unseen(shown: Channels, joint: Joint) -> np.ndarray:
    """Samples in motion beyond a joint's range of validity, shape (n,), bool."""
    if joint.valid is None:
        return shown.moving
    with np.errstate(invalid="ignore"):
        return shown.moving & (joint.valid.distance(shown.angle, shown.velocity, shown.load) > 0)


def _held(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> Held:
    error, width = (np.concatenate(x) for x in zip(*pairs, strict=True))
    if not len(error):
        return Held(0, float("nan"), float("nan"), float("nan"))
    inside = float(np.mean(np.abs(error) <= SIGMAS * width))
    return Held(len(error), inside, float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(width**2))))
