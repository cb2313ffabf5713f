"""Compute what docs/lara8.md states: hold-out table, figures, and the extended joint, from the measured sweep.

python -m benchmarks lara8 joint3_outbound.csv          # table and figures
python -m benchmarks lara8 joint3_outbound.csv --write  # and models/lara8_joint3_extended.yaml
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import least_squares

import flexspline as fs
from flexspline.diagnosis.answer import Diagnosis
from flexspline.diagnosis.diagnose import diagnose
from flexspline.estimator import smoothed
from flexspline.estimator.estimator import KnownJoint
from flexspline.estimator.offline import estimate_recording
from flexspline.models import causes, laws
from flexspline.models.joint import Joint, load_joint, shipped
from flexspline.models.joint_parts import Effect, Estimate
from flexspline.models.motion import smooth
from flexspline.models.recording import Measurement, Recording
from flexspline.views import style
from flexspline.views.tables import markdown_table

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
CAUSES = ("load_dependent_friction", "gravity_direction")
DESCRIPTION = (
    "lara8-joint3 with what its outbound sweep showed: friction grows with the load, gravity pulls from another "
    "direction than the controller believes, the link encoder has a once-per-revolution error. Made by "
    "`python -m benchmarks lara8 … --write` from motor current, encoders and the flange sensor at joint angles from -2.6 to "
    "0 rad; values with standard deviations."
)


MOVING = 0.05
"""Output velocity [rad/s] above which samples count: friction at rest is anything up to its level."""
SENSOR_NOISE, SENSOR_MEMORY = 1.05, 0.1
"""Noise of the external torque [N·m rms], the flange sensor's vibration; its correlation time [s]: neighbouring samples do
not count twice."""


def fit_current(
    recording: Recording, joint: Joint, names: tuple[str, ...], use: np.ndarray | None = None
) -> list[Effect]:
    """Causes fitted to the balance of motor current and measured external torque,

        torque from current minus friction and rotor  =  own gravity and inertia − external torque.

    Each parameter has a Gaussian prior about its absence with the largest ordinary size as deviation.

    Args:
      joint: without those causes.
      use: which samples may be used, shape (n,), bool; all by default. Samples at rest are left out.
    """
    bare = joint.record(recording.link)
    parameters = [(name, q) for name in names for q in causes.get(name).parameters]
    present = np.array([causes.get(name).present(bare[0])[q.name] for name, q in parameters])
    spread = np.array([
        max(abs(x - q.neutral) for ends in q.ordinary for x in ends) * (float(bare[0][q.relative]) if q.relative else 1.0)
        for _, q in parameters
    ])  # fmt: skip
    motion, known = _motion(recording, joint, bare)
    external = np.interp(motion.time, recording.time, recording["external_torque"])
    chosen = _moving(recording, motion, use)
    load = smoothed.torque_from_current(motion, known)
    # One number every grid step: of those within the vibration's memory, together one is news.
    sigma = SENSOR_NOISE * np.sqrt(SENSOR_MEMORY / smoothed.STEP)

    def by_cause(values: Iterable[Any]) -> dict[str, dict[str, Any]]:
        found: dict[str, dict[str, Any]] = {name: {} for name in names}
        for (name, q), value in zip(parameters, values, strict=True):
            found[name][q.name] = value
        return found

    def residual(u: np.ndarray) -> np.ndarray:
        record = bare.copy()
        for name, own in by_cause(present + spread * u).items():
            causes.get(name).apply(record[0], own)
        own_joint = replace(known, record=record)
        torque = smoothed.torque_from_current(motion, own_joint) - own_joint.p["bl"] * motion.link_velocity
        return np.r_[(torque - smoothed.own_torque(motion, own_joint, load) + external)[chosen] / sigma, u]

    found = least_squares(residual, np.zeros(len(parameters)), diff_step=1e-3)
    std = spread * np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    values = zip(present + spread * found.x, (q.unit for _, q in parameters), std, strict=True)
    return [_effect(name, own) for name, own in by_cause(values).items()]


def fit_eccentricity(recording: Recording, joint: Joint, use: np.ndarray | None = None) -> Effect:
    """`link_encoder_eccentricity`, fitted to the torsion that the external torque asks for.

    A once-per-revolution error and a stiffness that is off look alike in a sweep, as the load goes with the sine of the
    angle: the standard deviation of the amplitude is what the stiffness' tolerance makes of it.
    """
    record = joint.record(recording.link)
    motion, known = _motion(recording, joint, record)
    load = smoothed.torque_from_current(motion, known)
    external = np.interp(motion.time, recording.time, recording["external_torque"])
    torque = smoothed.own_torque(motion, known, load) - external
    chosen, torsion = _moving(recording, motion, use), smoothed.torsion_of(motion, known, load)
    # reading = θl + A (sin(θl + φ) − sin φ): torsion is too small by that. Zero and delay (v) are free.
    q, v, prior = motion.link_position, motion.link_velocity, np.diag([1.5e-3, 1.5e-3, 5e-3, 0.3e-3])
    noise = 1.5e-4 * np.sqrt(SENSOR_MEMORY / smoothed.STEP)
    A = np.stack([np.sin(q), np.cos(q), np.ones(len(q)), v], axis=1)[chosen] / noise

    def amplitude(scale: float) -> complex:
        softer = known.with_numbers(**{name: scale * known.p[name] for name in ("K1", "K2", "K3")})
        b = np.r_[(smoothed.wound(torque, softer) - torsion)[chosen] / noise, np.zeros(4)]
        return complex(*np.linalg.lstsq(np.vstack([A, np.linalg.inv(prior)]), b, rcond=None)[0][:2])

    number = joint.numbers["K1"]
    tolerance = np.hypot(number.tolerance, joint.shared_tolerances.get(number.shared or "", 0.0))
    z, std = amplitude(1.0), 0.5 * abs(amplitude(1 + tolerance) - amplitude(1 - tolerance))
    values = {"amplitude": (abs(z), "rad", std), "phase": (float(np.angle(z)), "rad", std / abs(z))}
    return _effect("link_encoder_eccentricity", values)


def _motion(recording: Recording, joint: Joint, record: np.ndarray) -> tuple[smoothed.Motion, KnownJoint]:
    known = replace(KnownJoint.of(joint, recording.link, record), start=float(recording.time[0]))
    signals = recording.signals
    return smoothed.smooth_motion(signals, known, smoothed.bandwidth(signals, known)), known


def _moving(recording: Recording, motion: smoothed.Motion, use: np.ndarray | None) -> np.ndarray:
    allowed = np.ones(len(recording.time)) if use is None else use.astype(float)
    return (np.abs(motion.link_velocity) > MOVING) & (np.interp(motion.time, recording.time, allowed) > 0.99)


def _effect(name: str, values: dict[str, tuple[float, str, float]]) -> Effect:
    parameters = {
        k: Estimate(value=float(f"{x:.4g}"), unit=u, std=float(f"{s:.2g}")) for k, (x, u, s) in values.items()
    }
    return Effect(name=name, parameters=parameters)


def with_effects(joint: Joint, effects: list[Effect]) -> Joint:
    """The joint with effects added, as it is shipped."""
    update = {"name": "lara8-joint3-extended", "description": DESCRIPTION, "effects": [*joint.effects, *effects]}
    return joint.model_copy(update=update)


def extend(recording: Recording, joint: Joint, use: np.ndarray | None = None) -> Joint:
    """The joint with the three effects, fitted to the samples in `use`."""
    known = with_effects(joint, fit_current(recording, joint, CAUSES, use))
    return with_effects(known, [fit_eccentricity(recording, known, use)])


ESTIMATORS = ("model", "EKF", "AREKF", "RAREKF", "current", "current_smoothed", "payload", "payload_smoothed")
ASSUMED = ("RAREKF", "current", "payload_smoothed")
DIAGNOSED = ("model", "RAREKF", "current", "payload_smoothed")


def external_torques(recording: Recording, joint: Joint) -> dict[str, np.ndarray]:
    """External torque [N·m] by estimator, shape (n,)."""
    return estimate_recording(recording, joint, ESTIMATORS).external_torque


def moving(recording: Recording) -> np.ndarray:
    """Which samples are in motion, shape (n,), bool."""
    return np.gradient(recording["link_position"], recording.time) > MOVING


def errors(recording: Recording, joint: Joint, names: Sequence[str], where: np.ndarray) -> list[float]:
    """RMS error [N·m] of the external torque by estimators, over some samples, shape (n,), bool."""
    found = external_torques(recording, joint)
    return [_rms((found[name] - recording["external_torque"])[where]) for name in names]


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def hold_outs(q: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Name → samples to fit to, samples to score on."""
    found = {
        "fit q < −1.04 (first 60 %), test the rest": (q < -1.04, q >= -1.04),
        "fit q < −1.30, test the rest": (q < -1.3, q >= -1.3),
        "fit q < −0.65, test the rest": (q < -0.65, q >= -0.65),
        "fit q ≥ −1.30, test what came before": (q >= -1.3, q < -1.3),
    }
    for low in (-2.6, -1.95, -1.3):
        block = (q > low) & (q <= low + 0.65)
        found[f"test {low:.2f} < q ≤ {low + 0.65:.2f}, fit the others"] = (~block, block)
    return found


def feed_forward(recording: Recording, path: Path) -> tuple[np.ndarray, float]:
    """The controller's model: coefficients of sin q, cos q, sgn v, v, a (of its target), rms of the rest [N·m]."""
    log = np.genfromtxt(path, delimiter=",", names=True)
    q, v = recording["link_position"], log["target_joint_velocity_3"]
    a, _ = _rates(recording.time, v, 10.0)
    late = recording.time > 0.12  # the target has set off
    basis, torque = (
        np.stack([np.sin(q), np.cos(q), np.ones(len(q)), v, a], axis=1)[late],
        log["target_joint_torque_3"][late],
    )
    found = np.linalg.lstsq(basis, torque, rcond=None)[0]
    return found, _rms(torque - basis @ found)


def _rates(time: np.ndarray, x: np.ndarray, frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivative of a signal up to a frequency [Hz], shape (n,) each."""
    s = smooth(time, x[:, None], 1e-3, frequency)
    return np.interp(time, s.time, s.rate[:, 0]), np.interp(time, s.time, s.acceleration[:, 0])


def _rigid(q: np.ndarray, a: np.ndarray) -> np.ndarray:
    """External torque of a rigid payload by its two gravity moments and its inertia, shape (n, 3)."""
    return np.stack([np.sin(q), np.cos(q), -a], axis=1)


def remembered(recording: Recording) -> tuple[float, list[float]]:
    """RMS [N·m] of a rigid payload fitted to the sensor itself: to all of it (the sensor's vibration), and held out."""
    q, S = recording["link_position"], recording["external_torque"]
    v, a = _rates(recording.time, recording["motor_position"] / 101, 5.0)
    basis, moves = _rigid(q, a), v > MOVING

    def rms(fit: np.ndarray, test: np.ndarray) -> float:
        found = np.linalg.lstsq(basis[fit & moves], S[fit & moves], rcond=None)[0]
        return _rms((S - basis @ found)[test & moves])

    return rms(moves, moves), [rms(fit, test) for fit, test in hold_outs(q).values()]


def table(recording: Recording, path: Path) -> list[tuple[str, list[float]]]:
    """RMS [N·m] in motion, on samples that the fit did not see: published way (feed-forward less torque of the
    motor current), then every estimator."""
    joint, log = load_joint(recording.joint), np.genfromtxt(path, delimiter=",", names=True)
    before = log["target_joint_torque_3"] - log["joint_torque_current_3"] - recording["external_torque"]
    rows = []
    for name, (fit, test) in hold_outs(recording["link_position"]).items():
        where = test & moving(recording)
        found = errors(recording, extend(recording, joint, fit), ESTIMATORS, where)
        rows.append((name, [_rms(before[where]), *found]))
    return rows


def diagnosed(recording: Recording) -> Iterator[tuple[str, Diagnosis, list[float], list[float]]]:
    """What `flexspline diagnose` makes of a part of the sweep by itself, and RMS [N·m] in motion on the rest of it: of the
    nominal joint, and of the diagnosed one."""
    joint, everything = load_joint(recording.joint), np.ones(len(recording.time), bool)
    parts = {"nothing": (everything, everything)} | hold_outs(recording["link_position"])
    for name, (fit, test) in parts.items():
        part = recording.at(np.flatnonzero(fit))
        answer = diagnose(Measurement(part.name, Path(), (part,)), joint)
        nominal, extended = (
            errors(recording, j, DIAGNOSED, test & moving(recording)) for j in (joint, answer.extended)
        )
        yield name, answer, nominal, extended


def mirrored(recording: Recording, joint: Joint, share: float) -> tuple[Recording, np.ndarray]:
    """The sweep with a made-up second half: the outbound motion mirrored about q = 0, current after an assumed truth.

    Args:
      share: of the load-dependent friction that acts when the load drives the motor; −1 is what would look like a wrong
        torque constant, or a wrong gravity moment, instead of friction.

    Returns:
      The whole sweep, and which samples are the second half's, in motion.
    """
    p = joint.record()[0]
    t, q, S = recording.time, recording["link_position"], recording["external_torque"]
    v, a = _rates(t, recording["motor_position"] / p["N"], 5.0)
    payload = np.linalg.lstsq(_rigid(q, a), S, rcond=None)[0]
    fitted = _rigid(q, a) @ payload
    inertia = p["Jl"] + p["N"] ** 2 * (p["Jm"] + p["Jw"])

    def needed(q, a, external):
        return p["Mg"] * np.sin(q + p["gravity_angle"]) + inertia * a - external

    def torsion(q, torque, current):  # of both compliances, less the link encoder's error
        compliance = np.array([laws.flexspline_torsion(x, p) for x in torque])
        error = np.array([laws.link_reading(x, p) for x in q]) - q
        return compliance + p["Kt"] * current / p["Kw0"] / p["N"] - error

    first = torsion(q, needed(q, a, fitted), recording["motor_current"])
    beyond = recording["motor_position"] / p["N"] - q - first

    time, q, v, a = 2 * t[-1] + 4e-3 - t[::-1], -q[::-1], v[::-1], -a[::-1]
    external = _rigid(q, a) @ payload
    torque = needed(q, a, external)
    on = np.tanh(v / 0.01)
    friction = p["N"] * p["Fc"] * on + p["N"] ** 2 * p["bw"] * v
    back_driven = np.where(torque * v < 0, share, 1.0)
    noise = 2.3 * np.random.default_rng(0).standard_normal(len(t))
    current = torque + friction + back_driven * p["friction_load"] * np.abs(torque) * on + noise
    motor = p["N"] * (q + torsion(q, torque, current - noise) + beyond[::-1])
    columns = {
        "motor_position": np.r_[recording["motor_position"], motor],
        "link_position": np.r_[recording["link_position"], q],
        "motor_current": np.r_[recording["motor_current"], current],
        "external_torque": np.r_[S, external + (S - fitted)[::-1]],
    }
    return replace(recording, time=np.r_[t, time], columns=columns), np.r_[np.zeros(len(t), bool), v > MOVING]


SHARES = (("as much", 1.0), ("half as much", 0.5), ("none", 0.0), ("a wrong gain instead", -1.0))
"""Of the load-dependent friction that may act when the load drives the motor (`mirrored`)."""


def assumed(recording: Recording) -> list[tuple[str, list[float]]]:
    """RMS [N·m] at q > 0 under assumed truths: the whole sweep estimated, and the second half alone."""
    joint, n = extend(recording, load_joint(recording.joint)), len(recording.time)
    rows = []
    for name, share in SHARES:
        whole, test = mirrored(recording, joint, share)
        second = whole.at(np.arange(n, len(whole.time)))
        rows.append((name, errors(whole, joint, ASSUMED, test) + errors(second, joint, ASSUMED, test[n:])))
    return rows


def figures(recording: Recording, folder: Path) -> None:
    """Draw both figures of the page."""
    joint, q, S = load_joint(recording.joint), recording["link_position"], recording["external_torque"]
    known = external_torques(recording, extend(recording, joint, q < -1.04))
    nominal = external_torques(recording, joint)["current"]

    fig, (top, bottom) = plt.subplots(2, 1, figsize=(8, 7), sharex=True, height_ratios=(3, 2))
    for values, color, label, width in (
        (known["RAREKF"], style.FILTERS["EKF"], "RAREKF on encoders, extended joint", 0.6),
        (S, style.SENSOR, "flange sensor", 1.4),
        (known["current"], style.EXTERNAL, "current, extended joint", 1.4),
        (known["payload"], style.TRUTH, "payload observer, extended joint", 1.4),
        (nominal, style.MODEL, "current, nominal joint", 1.4),
    ):
        top.plot(q, values, color=color, lw=width, label=label)
        if values is not S:
            bottom.plot(q, values - S, color=color, lw=width)
    for ax in (top, bottom):
        ax.axvline(-1.04, color="black", lw=0.8, ls=":")
    top.set(ylim=(-45, 8), ylabel="external torque [N·m]", title="Fitted left of the dotted line, tested right of it")
    bottom.set(ylim=(-16, 16), ylabel="error [N·m]", xlabel="joint angle [rad]")
    top.legend(fontsize=8, loc="lower right")
    _save(fig, folder / "lara8_external_torque.png")

    # What the nominal joint gets wrong: torque from current less what the sensor asks for, term by term.
    fig, ax = plt.subplots(figsize=(8, 4.2))
    whole = extend(recording, joint)
    values = {e.name: e.values for e in whole.effects}
    load = np.abs(estimate_recording(recording, whole, ["current"]).torque["current"])
    turned = joint.gravity_angle.value + values["gravity_direction"]["angle"]
    direction = joint.mount().gravity_moment * (np.sin(q + turned) - np.sin(q + joint.gravity_angle.value))
    friction = values["load_dependent_friction"]["coefficient"] * load
    moves = moving(recording)
    for term, color, label, width in (
        (S - nominal, style.SENSOR, "nominal joint: torque from current − torque needed", 0.8),
        (friction, style.FILTERS["AREKF"], "load-dependent friction μ|T|", 1.2),
        (direction, style.FILTERS["EKF"], "direction of gravity", 1.2),
        (friction + direction, style.FILTERS["RAREKF"], "both", 1.6),
    ):
        ax.plot(q[moves], term[moves], color=color, lw=width, label=label)
    ax.set(ylim=(-12, 14), xlabel="joint angle [rad]", ylabel="N·m")
    ax.legend(fontsize=8)
    _save(fig, folder / "lara8_residual.png")


def _save(fig: Figure, path: Path) -> None:
    for ax in fig.axes:
        ax.grid(alpha=0.25)
    fig.tight_layout()
    fig.savefig(path, dpi=110)
    plt.close(fig)


def main(words: Sequence[str] = ()) -> None:
    """Print the table, draw the figures, write the extended joint if asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks lara8", description=__doc__.partition("\n\n")[0])
    parser.add_argument("log", type=Path, help="joint3_outbound.csv")
    parser.add_argument("--write", action="store_true", help="models/lara8_joint3_extended.yaml, too")
    asked = parser.parse_args(words)
    path = asked.log
    recording = fs.import_log("lara8", path)
    joint = load_joint(recording.joint)
    found, rest = feed_forward(recording, path)
    print("feed-forward: sin q, cos q, sgn v, v, a", found.round(3), f"rms of the rest {rest:.3f} N·m")
    floor, memory = remembered(recording)
    print(f"payload fitted to the sensor: {floor:.2f} N·m, held out {np.round(memory, 2)}\n")
    rows = [(name, *(f"{v:.2f}" for v in values)) for name, values in table(recording, path)]
    print(markdown_table(("held out", "current − feed-forward", *ESTIMATORS), rows), end="\n\n")
    rows = [(name, *(f"{v:.2f}" for v in values)) for name, values in assumed(recording)]
    heads = (f"{part}: {name}" for part in ("whole", "alone") for name in ASSUMED)
    print(markdown_table(("friction when the load drives", *heads), rows), end="\n\n")
    rows = []
    for name, answer, nominal, extended in diagnosed(recording):
        found_causes = ", ".join(f"{c.name} ({c.confidence:.2f})" for c in answer.causes) or answer.verdict
        pairs = zip(nominal[1:], extended[1:], strict=True)
        rows.append((name, found_causes, *(f"{v:.2f}" for pair in pairs for v in pair)))
    shown = (head for name in DIAGNOSED[1:] for head in (f"{name}: nominal", "diagnosed"))
    print(markdown_table(("held out", "cause (confidence)", *shown), rows), end="\n\n")
    figures(recording, FIGURES)
    made = extend(recording, joint)
    for effect in made.effects:
        print(effect.name, {k: (e.value, e.std, e.unit) for k, e in effect.parameters.items()})
    if asked.write:
        made.write(shipped("lara8_joint3_extended.yaml"))
