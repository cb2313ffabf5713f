"""What docs/lara8.md states, computed: hold-out table, figures, and the extended joint, from the measured sweep.

python -m docs.lara8 joint3_outbound.csv          # table and figures
python -m docs.lara8 joint3_outbound.csv --write  # and models/lara8_joint3_extended.yaml
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import least_squares

from flexspline.diagnosis.answer import Diagnosis
from flexspline.diagnosis.data.importing import import_recording, load_layout
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

HERE = Path(__file__).parent
CAUSES = ("load_dependent_friction", "gravity_direction")
DESCRIPTION = (
    "lara8-joint3 with what its outbound sweep showed: friction grows with the load, gravity pulls from another "
    "direction than the controller believes, the link encoder has a once-per-revolution error. Made by "
    "`python -m docs.lara8 … --write` from motor current, encoders and the flange sensor at joint angles from -2.6 to "
    "0 rad; standard deviations beside the values."
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

    def residual(u: np.ndarray) -> np.ndarray:
        record = bare.copy()
        for name in names:
            own = {
                q.name: a + s * x for (n, q), a, s, x in zip(parameters, present, spread, u, strict=True) if n == name
            }
            causes.get(name).apply(record[0], own)
        own_joint = replace(known, record=record)
        torque = smoothed.torque_from_current(motion, own_joint) - own_joint.p["bl"] * motion.link_velocity
        return np.r_[(torque - smoothed.own_torque(motion, own_joint, load) + external)[chosen] / sigma, u]

    found = least_squares(residual, np.zeros(len(parameters)), diff_step=1e-3)
    std = spread * np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    values = {
        (n, q.name): (a, q.unit, s) for (n, q), a, s in zip(parameters, present + spread * found.x, std, strict=True)
    }
    return [_effect(name, {key: v for (n, key), v in values.items() if n == name}) for name in names]


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
DIAGNOSED = ("model", "RAREKF", "current", "payload_smoothed")


def external_torques(recording: Recording, joint: Joint) -> dict[str, np.ndarray]:
    """External torque [N·m] by estimator, shape (n,)."""
    return estimate_recording(recording, joint, ESTIMATORS).external_torque


def taken(recording: Recording, samples: np.ndarray) -> Recording:
    """Some samples of a recording, shape (n,), bool."""
    columns = {name: values[samples] for name, values in recording.columns.items()}
    return replace(recording, time=recording.time[samples], columns=columns)


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


def published(recording: Recording, path: Path) -> np.ndarray:
    """The published way: feed-forward less torque of the motor current [N·m]."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    return table["target_joint_torque_3"] - table["joint_torque_current_3"]


def feed_forward(recording: Recording, path: Path) -> tuple[np.ndarray, float]:
    """The controller's model: coefficients of sin q, cos q, sgn v, v, a (of its target), rms of the rest [N·m]."""
    log = np.genfromtxt(path, delimiter=",", names=True)
    time, q, v = recording.time, recording["link_position"], log["target_joint_velocity_3"]
    s = smooth(time, v[:, None], 1e-3, 10.0)
    a = np.interp(time, s.time, s.rate[:, 0])
    basis = np.stack([np.sin(q), np.cos(q), np.ones(len(q)), v, a], axis=1)
    moving = time > 0.12  # the target has set off
    found, *_ = np.linalg.lstsq(basis[moving], log["target_joint_torque_3"][moving], rcond=None)
    rest = (log["target_joint_torque_3"] - basis @ found)[moving]
    return found, float(np.sqrt(np.mean(rest**2)))


def remembered(recording: Recording) -> tuple[float, list[float]]:
    """RMS [N·m] of a rigid payload fitted to the sensor itself: to all of it (the sensor's vibration), and held out."""
    time, q = recording.time, recording["link_position"]
    s = smooth(time, recording["motor_position"][:, None], 1e-3, 5.0)
    v, a = (np.interp(time, s.time, x[:, 0]) / 101 for x in (s.rate, s.acceleration))
    basis, moving = np.stack([np.sin(q), np.cos(q), -a], axis=1), v > 0.05

    def rms(fit: np.ndarray, test: np.ndarray) -> float:
        found, *_ = np.linalg.lstsq(basis[fit & moving], recording["external_torque"][fit & moving], rcond=None)
        return float(np.sqrt(np.mean((recording["external_torque"] - basis @ found)[test & moving] ** 2)))

    return rms(moving, moving), [rms(fit, test) for fit, test in hold_outs(q).values()]


def table(recording: Recording, path: Path) -> list[tuple[str, list[float]]]:
    """RMS [N·m] in motion, on samples that the fit did not see: published way, then every estimator."""
    joint, q = load_joint(recording.joint), recording["link_position"]
    moving = np.gradient(q, recording.time) > 0.05
    rows = []
    for name, (fit, test) in hold_outs(q).items():
        found = external_torques(recording, extend(recording, joint, fit))
        where = test & moving
        errors = [published(recording, path), *(found[e] for e in ESTIMATORS)]
        rows.append((name, [float(np.sqrt(np.mean((e - recording["external_torque"])[where] ** 2))) for e in errors]))
    return rows


def diagnosed(recording: Recording) -> Iterator[tuple[str, Diagnosis, list[float]]]:
    """What `flexspline diagnose` makes of a part of the sweep by itself, and RMS [N·m] in motion on the rest of it."""
    joint, q = load_joint(recording.joint), recording["link_position"]
    moving = np.gradient(q, recording.time) > 0.05
    everything = np.ones(len(q), bool)
    for name, (fit, test) in [("nothing", (everything, everything)), *hold_outs(q).items()]:
        part = taken(recording, fit)
        answer = diagnose(Measurement(part.name, Path(), (part,)), joint)
        found = external_torques(recording, answer.extended)
        errors = [(found[e] - recording["external_torque"])[test & moving] for e in DIAGNOSED]
        yield name, answer, [float(np.sqrt(np.mean(e**2))) for e in errors]


def described(recording: Recording) -> list[list[float]]:
    """RMS [N·m] of the nominal joint in motion on what is scored in `diagnosed`, row by row."""
    q, found = recording["link_position"], external_torques(recording, load_joint(recording.joint))
    moving = np.gradient(q, recording.time) > 0.05
    parts = [np.ones(len(q), bool), *(test for _, test in hold_outs(q).values())]
    errors = [[(found[e] - recording["external_torque"])[test & moving] for e in DIAGNOSED] for test in parts]
    return [[float(np.sqrt(np.mean(e**2))) for e in row] for row in errors]


def mirrored(recording: Recording, joint: Joint, share: float, payload: float = 1.0) -> tuple[Recording, np.ndarray]:
    """The sweep with a made-up second half: the outbound motion mirrored about q = 0, current after an assumed truth.

    Args:
      share: of the load-dependent friction that acts when the load drives the motor; −1 is what would look like a wrong
        torque constant, or a wrong gravity moment, instead of friction.
      payload: the second half's payload in units of the first's.

    Returns:
      The whole sweep, and which samples are the second half's, in motion.
    """
    p = joint.record()[0]
    t, q = recording.time, recording["link_position"]
    s = smooth(t, np.column_stack([recording["motor_position"] / p["N"], q]), 1e-3, 5.0)
    v, a = (np.interp(t, s.time, x[:, 0]) for x in (s.rate, s.acceleration))
    basis = np.stack([np.sin(q), np.cos(q), -a], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, recording["external_torque"], rcond=None)
    vibration = recording["external_torque"] - basis @ fitted
    inertia = p["Jl"] + p["N"] ** 2 * (p["Jm"] + p["Jw"])

    def needed(q, a, external):
        return p["Mg"] * np.sin(q + p["gravity_angle"]) + inertia * a - external

    def torsion(q, torque, current):  # of both compliances, less the link encoder's error
        compliance = np.array([laws.flexspline_torsion(x, p) for x in torque])
        error = np.array([laws.link_reading(x, p) for x in q]) - q
        return compliance + p["Kt"] * current / p["Kw0"] / p["N"] - error

    beyond = (
        recording["motor_position"] / p["N"] - q - torsion(q, needed(q, a, basis @ fitted), recording["motor_current"])
    )

    time, q, v, a = 2 * t[-1] + 4e-3 - t[::-1], -q[::-1], v[::-1], -a[::-1]
    external = payload * (np.stack([np.sin(q), np.cos(q), -a], axis=1) @ fitted)
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
        "external_torque": np.r_[recording["external_torque"], external + vibration[::-1]],
    }
    return replace(recording, time=np.r_[t, time], columns=columns), np.r_[np.zeros(len(t), bool), v > 0.05]


SHARES = (("as much", 1.0), ("half as much", 0.5), ("none", 0.0), ("a wrong gain instead", -1.0))
"""Of the load-dependent friction that may act when the load drives the motor (`mirrored`)."""


def assumed(recording: Recording) -> list[tuple[str, list[float]]]:
    """RMS [N·m] at q > 0 under assumed truths: the whole sweep estimated, and the second half alone."""
    joint = extend(recording, load_joint(recording.joint))
    rows = []
    for name, share in SHARES:
        whole, test = mirrored(recording, joint, share)
        n = len(recording.time)
        second = taken(whole, np.arange(len(whole.time)) >= n)
        values = []
        for part, where in ((whole, test), (second, test[n:])):
            found = external_torques(part, joint)
            errors = [(found[e] - part["external_torque"])[where] for e in ("RAREKF", "current", "payload_smoothed")]
            values += [float(np.sqrt(np.mean(e**2))) for e in errors]
        rows.append((name, values))
    return rows


def figures(recording: Recording, path: Path, folder: Path) -> None:
    """Draw both figures of the page."""
    joint, q, S = load_joint(recording.joint), recording["link_position"], recording["external_torque"]
    fit = q < -1.04
    known = external_torques(recording, extend(recording, joint, fit))
    nominal = external_torques(recording, joint)

    fig, axes = plt.subplots(2, 1, figsize=(8, 7), sharex=True, height_ratios=(3, 2))
    top, bottom = axes
    for name, color, label, width in (
        ("RAREKF", style.FILTERS["EKF"], "RAREKF on encoders, extended joint", 0.6),
        ("sensor", style.SENSOR, "flange sensor", 1.4),
        ("current", style.EXTERNAL, "current, extended joint", 1.4),
        ("payload", style.TRUTH, "payload observer, extended joint", 1.4),
    ):
        values = S if name == "sensor" else known[name]
        top.plot(q, values, color=color, lw=width, label=label)
        if name != "sensor":
            bottom.plot(q, values - S, color=color, lw=width)
    top.plot(q, nominal["current"], color=style.MODEL, lw=1.4, label="current, nominal joint")
    bottom.plot(q, nominal["current"] - S, color=style.MODEL, lw=1.4)
    for ax in axes:
        ax.axvline(-1.04, color="black", lw=0.8, ls=":")
        ax.grid(alpha=0.25)
    top.set(ylim=(-45, 8), ylabel="external torque [N·m]", title="Fitted left of the dotted line, tested right of it")
    bottom.set(ylim=(-16, 16), ylabel="error [N·m]", xlabel="joint angle [rad]")
    top.legend(fontsize=8, loc="lower right")
    fig.tight_layout()
    fig.savefig(folder / "lara8_external_torque.png", dpi=110)
    plt.close(fig)

    # What the nominal joint gets wrong: torque from current less what the sensor asks for, term by term.
    fig, ax = plt.subplots(figsize=(8, 4.2))
    whole = extend(recording, joint)
    values = {e.name: e.values for e in whole.effects}
    moving = np.gradient(q, recording.time) > 0.05
    residual = S - nominal["current"]
    load = np.abs(estimate_recording(recording, whole, ["current"]).torque["current"])
    gravity = joint.mount().gravity_moment
    turned = joint.gravity_angle.value + values["gravity_direction"]["angle"]
    direction = gravity * (np.sin(q + turned) - np.sin(q + joint.gravity_angle.value))
    friction = values["load_dependent_friction"]["coefficient"] * load
    ax.plot(
        q[moving],
        residual[moving],
        color=style.SENSOR,
        lw=0.8,
        label="nominal joint: torque from current − torque needed",
    )
    ax.plot(q[moving], friction[moving], color=style.FILTERS["AREKF"], lw=1.2, label="load-dependent friction μ|T|")
    ax.plot(q[moving], direction[moving], color=style.FILTERS["EKF"], lw=1.2, label="direction of gravity")
    ax.plot(q[moving], (friction + direction)[moving], color=style.FILTERS["RAREKF"], lw=1.6, label="both")
    ax.set(ylim=(-12, 14), xlabel="joint angle [rad]", ylabel="N·m")
    ax.grid(alpha=0.25)
    ax.legend(fontsize=8)
    fig.tight_layout()
    fig.savefig(folder / "lara8_residual.png", dpi=110)
    plt.close(fig)


def main() -> None:
    """Print the table, draw the figures, write the extended joint if asked."""
    parser = argparse.ArgumentParser(description="What docs/lara8.md states, and its figures, from the measured sweep.")
    parser.add_argument("log", type=Path, help="joint3_outbound.csv")
    parser.add_argument("--write", action="store_true", help="models/lara8_joint3_extended.yaml, too")
    asked = parser.parse_args()
    path = asked.log
    recording = import_recording(load_layout("lara8"), path)
    joint = load_joint(recording.joint)
    found, rest = feed_forward(recording, path)
    print("feed-forward: sin q, cos q, sgn v, v, a", found.round(3), f"rms of the rest {rest:.3f} N·m")
    floor, memory = remembered(recording)
    print(f"payload fitted to the sensor: {floor:.2f} N·m, held out {np.round(memory, 2)}\n")
    print("| held out | current − feed-forward | " + " | ".join(ESTIMATORS) + " |")
    print("|---" * (len(ESTIMATORS) + 2) + "|")
    for name, values in table(recording, path):
        print(f"| {name} | " + " | ".join(f"{v:.2f}" for v in values) + " |")
    print()
    print("| friction when the load drives | whole: RAREKF | current | payload | alone: RAREKF | current | payload |")
    print("|---|---|---|---|---|---|---|")
    for name, values in assumed(recording):
        print(f"| {name} | " + " | ".join(f"{v:.2f}" for v in values) + " |")
    shown = DIAGNOSED[1:]
    print("| held out | cause (confidence) | " + " | ".join(f"{n}: nominal | diagnosed" for n in shown) + " |")
    print("|---" * (2 * len(shown) + 2) + "|")
    for (name, answer, values), nominal in zip(diagnosed(recording), described(recording), strict=True):
        causes = ", ".join(f"{c.name} ({c.confidence:.2f})" for c in answer.causes) or answer.verdict
        pairs = [f"{a:.2f} | {b:.2f}" for a, b in zip(nominal[1:], values[1:], strict=True)]
        print(f"| {name} | {causes} | " + " | ".join(pairs) + " |")
    print()
    folder = HERE / "figures"
    folder.mkdir(exist_ok=True)
    figures(recording, path, folder)
    made = extend(recording, joint)
    for effect in made.effects:
        print(effect.name, {k: (e.value, e.std, e.unit) for k, e in effect.parameters.items()})
    if asked.write:
        made.write(shipped("lara8_joint3_extended.yaml"))


if __name__ == "__main__":
    main()
