"""Compute what docs/ur3e.md states from the measured half of a UR3e's shoulder: one part diagnosed, another predicted.

python -m benchmarks ur3e shoulder_first_half.csv
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import coherence, csd, welch

import flexspline as fs
from flexspline.diagnosis.answer import Diagnosis
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.validate import Channels, validate
from flexspline.models.joint import Joint, load_joint
from flexspline.models.recording import Measurement, Recording
from flexspline.views import style

FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "ur3e_current.png"
MOVING = 0.02
"""Speed of the joint [rad/s] from which on an error counts."""
RIPPLE = 202
"""Twice per turn of the wave generator, in orders of the joint's angle."""
SPLITS = (20.0, 22.0, 24.0, 26.0, 28.0)
"""Ends of what diagnosis sees [s]; after the first one what is held against it are the last 10 s."""


def split(recording: Recording, end: float, start: float | None = None) -> tuple[Recording, Recording]:
    """What comes before `end` [s], and what comes from `start` on (`end` by default)."""
    t = recording.time
    parts = {"first": t < end, "last": t >= (end if start is None else start)}
    first, last = (replace(recording.at(np.flatnonzero(use)), name=name) for name, use in parts.items())
    return first, last


@dataclass(frozen=True)
class Regressions:
    """Errors of linear regressions, the log's own velocity and commanded acceleration given.

    Attributes:
      time: shape (n,) [s]; moving: shape (n,), bool.
      plain: current less gravity, inertia, viscous and Coulomb friction, offset, shape (n,) [A].
      harmonics: with 23 orders about the ripple's, sine and cosine, by direction, as well, shape (n,) [A].
    """

    time: np.ndarray
    moving: np.ndarray
    plain: np.ndarray
    harmonics: np.ndarray

    def rms(self, start: float) -> tuple[float, float]:
        """RMS [A] of both in motion from a time [s] on."""
        use = self.moving & (self.time >= start)
        return _rms(self.plain[use]), _rms(self.harmonics[use])


def regressions(path: Path, end: float) -> Regressions:
    """Fit the current in motion before `end` [s]."""
    log = np.genfromtxt(path, delimiter=",", names=True)
    t, q, v, current = log["t_s"], log["q_rad"], log["qd_rad_s"], log["i_motor_A"]
    moving = np.abs(v) > MOVING
    basis = [np.cos(q), np.sin(q), log["qdd_target_rad_s2"], v, np.sign(v), np.ones_like(q)]
    waves = [
        wave(order * q) * (direction * v > 0)
        for order in range(RIPPLE - 11, RIPPLE + 12)
        for wave in (np.sin, np.cos)
        for direction in (-1, 1)
    ]

    def left(columns: Sequence[np.ndarray]) -> np.ndarray:
        A, fit = np.stack(columns, axis=1), moving & (t < end)
        found, *_ = np.linalg.lstsq(A[fit], current[fit], rcond=None)
        rest: np.ndarray = current - A @ found
        return rest

    return Regressions(t, moving, left(basis), left([*basis, *waves]))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x[np.isfinite(x)] ** 2)))


def error(shown: Channels) -> np.ndarray:
    """Measured less simulated current in motion, NaN elsewhere, shape (n,) [A]."""
    rest = shown.measured["motor_current"] - shown.simulated["motor_current"]
    found: np.ndarray = np.where(np.abs(shown.velocity) > MOVING, rest, np.nan)
    return found


@dataclass(frozen=True)
class Held:
    """A diagnosis of a first part, and what its joint and the description make of the last.

    Attributes:
      answer: of the first part.
      described, extended: the last part's channels, by the description and by what diagnosis wrote.
    """

    answer: Diagnosis
    described: Channels
    extended: Channels


def held_against(first: Recording, last: Recording, joint: Joint) -> Held:
    """Diagnose the first part alone; simulate the last."""
    answer = diagnose(Measurement(first.name, Path(), (first,)), joint)
    rest = Measurement(last.name, Path(), (last,))
    described, extended = (validate(rest, j).recordings[0] for j in (joint, answer.extended))
    return Held(answer, described, extended)


def found(answer: Diagnosis) -> str:
    """Verdict, or causes with their confidence and parameters."""
    causes = []
    for c in answer.causes:
        values = ", ".join(f"{k} {p.value:.3g} ± {p.std:.1g} {p.unit}".strip() for k, p in c.parameters.items())
        causes.append(f"{c.name} ({c.confidence:.2f}: {values})")
    return "; ".join(causes) or answer.verdict


def figure(held: Held, rest: Regressions, start: float, path: Path) -> None:
    """Current and its errors over the part that no fit has seen."""
    fig, (top, *errors) = plt.subplots(3, 1, figsize=(8, 7.4), sharex=True, height_ratios=(3, 1.5, 1.5))
    shown, t = held.extended, start + held.extended.time - held.extended.time[0]
    top.plot(t, held.described.simulated["motor_current"], color=style.MODEL, lw=1.0, label="description")
    top.plot(t, shown.measured["motor_current"], color=style.SENSOR, lw=1.6, label="measured")
    top.plot(t, shown.simulated["motor_current"], color=style.TRUTH, lw=0.9, label="joint.yaml of the diagnosis")
    top.set(ylabel="motor current [A]", title="Diagnosed before, simulated here: nothing is fitted")
    top.legend(fontsize=8, loc="lower left")
    late = rest.time >= start
    plain = np.where(rest.moving, rest.plain, np.nan)[late]
    errors[0].plot(rest.time[late], plain, color=style.FILTERS["EKF"], lw=0.7)
    errors[0].set(title="error in motion: regression (gravity, inertia, viscous and Coulomb friction)")
    errors[1].plot(t, error(shown), color=style.TRUTH, lw=0.7)
    errors[1].set(title="error in motion: joint.yaml of the diagnosis", xlabel="time [s]")
    for ax in errors:
        ax.set(ylabel="A", ylim=(-0.3, 0.3))
    for ax in (top, *errors):
        ax.grid(alpha=0.25)
        ax.title.set_fontsize(9)
    fig.tight_layout()
    fig.savefig(path, dpi=110)
    plt.close(fig)


def velocity_against_angle(path: Path) -> list[tuple[float, float, float, float, float]]:
    """What the log's velocity is to the derivative of its angle, both less what the controller asked for, in motion.

    Returns frequency [Hz], ratio of their amplitudes, lead of the velocity [°], its coherence with angle and current.
    """
    log = np.genfromtxt(path, delimiter=",", names=True)
    t = log["t_s"]
    start = t[np.argmax(np.abs(log["qd_target_rad_s"]) > MOVING)]
    even = np.arange(start, t[-1], 8e-3)
    q, v, i = (
        np.interp(even, t, x)
        for x in (log["q_rad"] - log["q_target_rad"], log["qd_rad_s"] - log["qd_target_rad_s"], log["i_motor_A"])
    )
    f, cross = csd(q, v, 125.0, nperseg=128)
    ratio = cross / welch(q, 125.0, nperseg=128)[1] / np.where(f > 0, 2j * np.pi * f, 1.0)
    with_angle, with_current = (np.sqrt(coherence(x, v, 125.0, nperseg=128)[1]) for x in (q, i))
    rows = (int(np.argmin(np.abs(f - at))) for at in (22.5, 28.3, 34.2, 40.0))
    return [(f[k], abs(ratio[k]), float(np.degrees(np.angle(ratio[k]))), with_angle[k], with_current[k]) for k in rows]


def main(words: Sequence[str] = ()) -> None:
    """Print what the velocity is to the angle, then the table, and draw the figure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks ur3e", description=__doc__.partition("\n\n")[0])
    parser.add_argument("log", type=Path, help="shoulder_first_half.csv")
    path = parser.parse_args(words).log
    for f, ratio, lead, with_angle, with_current in velocity_against_angle(path):
        print(f"{f:.1f} Hz: velocity {ratio:.2f} of the angle's, {lead:+.0f}°; ", end="")
        print(f"coherence {with_angle:.2f} with angle, {with_current:.2f} with current")
    recording = fs.import_log("ur3e", path)
    joint = load_joint(recording.joint)
    end, start = SPLITS[0], float(recording.time[-1]) - 10.0
    for stop in SPLITS:
        begin = start if stop == end else stop
        held = held_against(*split(recording, stop, begin), joint)
        rest = regressions(path, stop)
        plain, harmonics = rest.rms(begin)
        inside = held.answer.residual["motor_current"]
        errors = [_rms(error(held.described)), _rms(error(held.extended)), plain, harmonics]
        print(f"| {stop:.0f} s | {found(held.answer)} | {inside.before:.3f} → {inside.after:.3f} | ", end="")
        print(" | ".join(f"{e:.3f}" for e in errors) + " |", flush=True)
        if stop == end:
            figure(held, rest, start, FIGURE)
