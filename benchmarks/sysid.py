"""The calibration and `mujoco.sysid` on the same drawn joints: `python -m benchmarks sysid` writes docs/sysid.json and the
tables of docs/sysid.md.

Both get the same three recordings of a joint whose every number is drawn within its tolerance, the same description (numbers,
tolerances, sensor noise), and the same unknowns: the calibration variables of `models.calibration`, one standard deviation of
the description each. `mujoco.sysid` minimises the error of a simulation (`rollout`), our calibration that of the balances.

*How the joint is given to `mujoco.sysid`.* As MJCF: rotor, wave generator and link, tendons with polynomial stiffness as close
to the described laws as MJCF allows, LuGre friction, no kinematic error, which MJCF cannot say. With `exact`, a compiled
callback exerts the described laws instead: nothing but integration then separates model and plant. The drive's own position
controller follows the recorded command in the simulation (a callback): the inputs have no noise then, and the current is an
output. The calibration knows no controller. Where unmeasured pushes act, a stiff servo takes the
link along the measured motion, and the link's angle does not count. Residuals are motor angle, link angle, joint torque and
current while the command moves, each divided by its RMS at the start and, once more, after a first fit; next to them are the
unknowns over their tolerances. The package's own optimiser (`mujoco`), forward differences, intervals of its
`calculate_intervals`.
"""

from __future__ import annotations

import argparse
import io
import json
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from numba import carray, cfunc, types
from scipy.signal import savgol_filter

from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.trials.draw import Challenge, Draw, draw
from flexspline.diagnosis.trials.motions import CONTROLLER
from flexspline.models import laws
from flexspline.models.calibration import Calibration
from flexspline.models.files import write_text
from flexspline.models.joint import load_joint, shipped
from flexspline.models.parameters import as_floats
from flexspline.models.pointers import floats_at, word_at
from flexspline.models.recording import Recording
from flexspline.sim import native
from flexspline.sim.loop import CONTROL_PERIOD
from flexspline.views.tables import markdown_table

from .convergence import MAGIC, callback, set_numbers, springs
from .kept import computed
from .pages import ROOT, fill

SEED = 4001
HIDDEN = ("position_dependent_friction", "link_encoder_eccentricity", "hysteresis")
TIMESTEP = 5e-4  # s: of the rollouts, that of the joint's MJCF
INTEGRATOR = mujoco.mjtIntegrator.mjINT_EULER  # without `implicitfast`'s damping of the flexspline's mode
ITERATIONS = (3, 5)  # of the two fits, at most
STIFF = 800.0  # rad/s: of the servo that takes the link along where pushes act
SMOOTHED = 21  # samples over which the link's angle is smoothed for the servo's velocity
MOVING = 0.1  # rad/s: speed of the command from which on samples count: no rollout predicts friction at rest
SKIPPED = 0.05  # s: at the beginning, where the servo settles
EPS = 1e-3  # standard deviations: step of the forward differences
DIVERGED = 1e3  # standard deviations: residual of a simulation that is not finite
DAMPING = {"mu_min": 1.0, "mu_factor": 2.0}  # with the defaults, 1e-6 and 1.26, it takes 80 simulations to get damped
SETTLED = 3e-2  # standard deviations: a fit ends when its step is shorter
LABELS = {
    "Kt": "torque constant Kt", "K1": "flexspline stiffness K1", "K2": "K2", "K3": "K3", "Kw0": "wave generator stiffness Kw0",
    "Fc": "Coulomb friction Fc", "bw": "viscous friction of the mesh bw", "Jm": "rotor inertia Jm", "Jl": "link inertia Jl",
    "Mg": "gravity moment Mg",
}  # fmt: skip
AT_POSITION, AT_VELOCITY = 1, 2  # of the commands among the controls; the motor is the first
COMMANDS = ("position_command", "velocity_command")
COLUMNS = ("motor_position", "link_position", "joint_torque", "motor_current")
OURS, EXACT, NATIVE = "calibration", "mujoco.sysid, laws in a callback", "mujoco.sysid, MJCF alone"
TOOLS = (OURS, NATIVE, EXACT)
FAR = 2.5  # standard deviations: drawn joints are within


@dataclass(frozen=True)
class Number:
    """A number of the joint: nominal, true, found, its stated standard deviation, whether the 95 % interval holds the truth."""

    nominal: float
    true: float
    value: float
    std: float
    covered: bool


@dataclass(frozen=True)
class Fitted:
    """A draw as one tool fitted it: numbers, core time [s], and what the tool says of a cause."""

    hidden: str
    draw: int
    tool: str
    numbers: dict[str, Number]
    core_time: float
    said: str


class Diverged(Exception):
    """A simulation near a point of a fit is not finite; the package stops."""


@dataclass(frozen=True)
class Found:
    """What one tool found: calibration variables with covariance, core time [s], and what it says of its residual."""

    x: np.ndarray
    covariance: np.ndarray
    core_time: float
    said: str


# --- ours --------------------------------------------------------------------------------------------------------------


def diagnosed(one: Draw) -> Found:
    """What a diagnosis ends with: only at its end what the noise of the motion makes of the numbers is taken out."""
    begin = time.process_time()
    found = diagnose(one.measurement, one.nominal)
    assert found.problem is not None and found.final is not None
    n = found.problem.calibration.size
    causes = ", ".join(f"{c.name} ({100 * c.confidence:.0f} % sure, {c.contribution:.2g} N·m)" for c in found.causes)
    said = f"{found.verdict}: {causes}" if causes else found.verdict
    return Found(found.final.theta[:n], found.final.covariance[:n, :n], time.process_time() - begin, said)


# --- mujoco.sysid --------------------------------------------------------------------------------------------------------


class Rollouts:
    """A draw as a problem of `mujoco.sysid`.

    Args:
      one: the draw.
      exact: the described laws in a compiled callback, in place of what MJCF can say.
    """

    def __init__(self, one: Draw, exact: bool):
        self.joint, self.exact = one.nominal, exact
        self.calibration = Calibration(one.nominal)
        self.recordings = {r.name: r for r in one.measurement.recordings}
        skip = set() if exact else {n for n in self.calibration.names if n[0] in "Aφ" and n[1:].isdigit()}
        self.free = [i for i, n in enumerate(self.calibration.names) if n not in skip]
        self.parameters = sysid.ParameterDict()
        for i in self.free:
            self.parameters.add(sysid.Parameter(self.calibration.names[i], 0.0, -3.5, 3.5))
        self.weights = {name: self._noise() for name in self.recordings}
        self.moving = {
            name: np.abs(np.gradient(r["position_command"], r.time)) > MOVING for name, r in self.recordings.items()
        }
        self.sequences = [self._sequence(r) for r in self.recordings.values()]
        self.lengths: list[int] = []

    def unknowns(self, x: np.ndarray) -> np.ndarray:
        """All calibration variables, those that MJCF cannot hold at zero."""
        whole = np.zeros(self.calibration.size)
        whole[self.free] = x
        return whole

    def _record(self, x: np.ndarray, recording: Recording) -> np.ndarray:
        return self.calibration.record(self.unknowns(x), recording.link)

    def _noise(self) -> np.ndarray:
        s = self.joint.sensors
        return np.array([
            s.motor_encoder.resolution / np.sqrt(12),
            np.hypot(s.link_encoder.noise, s.link_encoder.resolution / np.sqrt(12)),
            s.joint_torque.noise,
            s.motor_current.noise,
        ])  # fmt: skip

    def _spec(self, recording: Recording, record: np.ndarray) -> mujoco.MjSpec:
        """The joint's MJCF with the numbers of a record, the commands, and the link's servo."""
        p = record[0]
        spec = mujoco.MjSpec.from_file(str(shipped("test_joint.xml")))
        set_numbers(spec, p, TIMESTEP)
        spec.option.integrator = INTEGRATOR
        spec.modelname = recording.name
        for name, stiffness in _polynomials(p).items():
            spec.tendon(name).stiffness = [0.0] * 3 if self.exact else stiffness
        if self.exact:
            spec.add_numeric(name="joint", size=1 + as_floats(record).size, data=[0.0])
        motor = spec.actuator("motor")
        motor.dyntype, motor.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTEREXACT, p["L"] / p["R"]
        motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE
        motor.gainprm[0] = p["Kt"]
        spec.nuserdata = 4
        for name in COMMANDS:
            command = spec.add_actuator(name=name, target="rotor", trntype=mujoco.mjtTrn.mjTRN_JOINT)
            command.gaintype, command.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE
            command.gainprm[0] = 0.0
        hold = spec.add_actuator(name="hold", target="link", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        hold.gaintype, hold.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        kp, kd = self._hold(recording)
        hold.gainprm[0] = 1.0
        hold.biasprm[:3] = [-kp * p["link_zero"], -kp, -kd]
        spec.add_sensor(name="hold", type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
                        objtype=mujoco.mjtObj.mjOBJ_ACTUATOR, objname="hold")  # fmt: skip
        return spec

    def _hold(self, recording: Recording) -> tuple[float, float]:
        """Gains of the link's servo [N·m/rad, N·m·s/rad]."""
        if not self._pushed(recording):
            return 0.0, 0.0
        inertia = float(self.joint.record(recording.link)[0]["Jl"])
        return inertia * STIFF**2, 1.4 * inertia * STIFF

    @staticmethod
    def _pushed(recording: Recording) -> bool:
        return recording.external == "unmeasured"

    def build(self, x: np.ndarray, name: str) -> mujoco.MjModel:
        """The model of a recording at a point."""
        recording = self.recordings[name]
        record = self._record(x, recording)
        model = self._spec(recording, record).compile()
        model.wrap_prm[model.tendon_adr[model.tendon("flexspline").id]] = 1.0 / record[0]["N"]
        if self.exact:
            model.numeric_data[:] = np.concatenate([[MAGIC], as_floats(record)])
        return model

    def _build(self, parameters: Any, spec: mujoco.MjSpec) -> mujoco.MjModel:
        return self.build(parameters.as_vector(), spec.modelname)

    def _sequence(self, recording: Recording) -> Any:
        """A recording as `mujoco.sysid` takes it: what drives the model, what is compared, and how it begins (at rest)."""
        t = recording.time - recording.time[0]
        link = recording["link_position"]
        step = float(np.median(np.diff(t)))

        def derivative(y: np.ndarray, order: int, samples: int = SMOOTHED) -> np.ndarray:
            return savgol_filter(y, samples, 3, deriv=order, delta=step)

        p = self.joint.record(recording.link)[0]
        kp, kd = self._hold(recording)
        hold = kp * link + kd * derivative(link, 1)
        if kp > 0.0:
            hold = hold + p["Jl"] * derivative(link, 2) + p["Mg"] * np.sin(link) - recording["joint_torque"]
        command = recording["position_command"]
        spec = self._spec(recording, self._record(np.zeros(len(self.free)), recording))
        model = spec.compile()
        addresses = [int(model.actuator_ctrladr[model.actuator(name).id]) for name in ("motor", *COMMANDS)]
        assert addresses == [0, AT_POSITION, AT_VELOCITY], addresses
        control = np.zeros((len(t), model.nu))
        commands = (command, np.gradient(command, step))
        for name, values in (*zip(COMMANDS, commands, strict=True), ("hold", hold)):
            control[:, model.actuator_ctrladr[model.actuator(name).id]] = values
        data = np.column_stack([recording[c] for c in COLUMNS])
        begin = sysid.create_initial_state(model, np.zeros(model.nq))
        measured = sysid.TimeSeries(t, data)
        return sysid.ModelSequences(
            recording.name, spec, recording.name, begin, sysid.TimeSeries(t, control), measured, allow_missing_sensors=True
        )  # fmt: skip

    def _compare(self, parameters, predicted, measured, model, return_all, state=None, **_):
        """Weighted difference of what the sensors read and what they would read of the rollout."""
        name = model.names.split(b"\0", 1)[0].decode()
        p = self._record(parameters.as_vector(), self.recordings[name])[0]
        time_ = state[:, 0]
        used = self.moving[name] & (measured.times > SKIPPED) & (measured.times < time_[-1])
        at, real = measured.times[used], measured.data[used]
        torque, hold = model.sensor("torque").adr[0] + 1, model.sensor("hold").adr[0]
        # Sensors are those of the step's beginning.
        Ts = -predicted.data[:, torque] - predicted.data[:, hold]
        found = np.column_stack([
            np.interp(at, time_, state[:, 1]),
            np.interp(at, time_, state[:, 3]) + p["link_zero"],
            np.interp(at, time_ - TIMESTEP, Ts) * p["torque_gain"] + p["torque_offset"],
            np.interp(at, time_, state[:, 7]) + p["current_offset"],
        ])  # fmt: skip
        counted = np.array([1.0, not self._pushed(self.recordings[name]), 1.0, 1.0])
        shown = [sysid.TimeSeries(at, y) for y in (found, real)]
        return counted * (real - found) / self.weights[name], *shown

    def residual(self, x: np.ndarray, parameters: Any, **options: Any):
        """Residuals of all recordings, and the unknowns over their tolerances; all large where a simulation diverges."""
        try:
            found, *shown = sysid.residual(
                x, parameters, self.sequences, self._build, self._compare, n_threads=1, **options
            )
        except ValueError:
            # A simulation that is not finite ends early, and the package raises over its times: no step of the optimiser.
            if (x.ndim > 1 and x.shape[1] > 1) or not self.lengths:
                raise
            far = [np.full((n, 1) if x.ndim > 1 else n, DIVERGED) for n in self.lengths]
            return [*far, x], [], []
        self.lengths = [len(r) for r in found]
        return [*found, x], *shown

    def rms(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """RMS residual of each channel, by recording."""
        found, *_ = sysid.residual(x, self.parameters.copy(), self.sequences, self._build, self._compare, n_threads=1)
        return {
            name: self.weights[name] * np.sqrt(np.mean(r.reshape(-1, len(COLUMNS)) ** 2, axis=0))
            for name, r in zip(self.recordings, found, strict=True)
        }

    def weigh(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Weights from the residuals at a point."""
        left, noise = self.rms(x), self._noise()
        self.weights = {name: np.maximum(r, noise) for name, r in left.items()}
        return left


def _polynomials(p: np.void) -> dict[str, np.ndarray]:
    """Stiffness, and what it grows by with torsion and its square, of both springs: MJCF's nearest to the laws' torque."""
    found = {}
    top = laws.flexspline_torsion(16.0, p)
    for name, law, end in (
        ("flexspline", laws.flexspline_spring, top),
        ("wave_generator", laws.wave_generator_spring, laws.wave_generator_torsion(0.16, p)),
    ):
        x = np.linspace(end / 200, end, 200)
        y = np.array([law(v, p) for v in x])
        powers = np.column_stack([x, x**2, x**3])
        found[name] = np.linalg.lstsq(powers / y[:, None], np.ones(len(y)), rcond=None)[0]
    return found


@cache
def _drive():
    """The drive's position controller (`models.controller.control`, with the gains of the trials) as MuJoCo's control callback.

    It reads the commands from the controls of `COMMANDS`, writes the current's into that of the motor, and remembers in
    `userdata`; encoder counts are left out, so that a rollout is a smooth function of the numbers.
    """
    at = native.offsets()
    TIME, QPOS, CTRL, USER = (at[name] for name in ("time", "qpos", "ctrl", "userdata"))
    c = CONTROLLER.record(load_joint("test-joint").record()[0], CONTROL_PERIOD, False)[0]
    kp, kd, ki, filtered, limit, gear = (float(c[n]) for n in ("kp", "kd", "ki", "filter", "limit", "gear"))
    step, substeps, dt = TIMESTEP, round(CONTROL_PERIOD / TIMESTEP), CONTROL_PERIOD

    @cfunc(types.void(types.intp, types.intp))
    def drive(m, d):
        time_ = floats_at(d + 8 * TIME)[0]
        angle = floats_at(word_at(d + 8 * QPOS))[0]
        control = carray(floats_at(word_at(d + 8 * CTRL)), 4)
        memory = carray(floats_at(word_at(d + 8 * USER)), 4)
        k = round(time_ / step)
        if k == 0:
            memory[:] = 0.0
            memory[0] = angle
        if k % substeps == 0:
            memory[1] += filtered * ((angle - memory[0]) / dt - memory[1])
            memory[0] = angle
            error = gear * control[AT_POSITION] - angle
            memory[2] += error * dt
            current = kp * error + kd * (gear * control[AT_VELOCITY] - memory[1]) + ki * memory[2]
            memory[3] = min(max(current, -limit), limit)
        control[0] = memory[3]

    return drive


@contextmanager
def described_laws() -> Iterator[None]:
    """Within, models that carry a record get the described laws' torques from a callback, and nothing of the plant's."""
    with (
        callback("mjcb_passive", springs().address),
        callback("mjcb_control", _drive().address),
        native.quiet(),
    ):
        yield


def rolled_out(one: Draw, exact: bool, iterations: Sequence[int] = ITERATIONS) -> Found:
    """`mujoco.sysid`'s fit, weighted by the residuals at the start, and again after a first fit."""
    begin = time.process_time()
    problem = Rollouts(one, exact)
    x = np.zeros(len(problem.free))
    with described_laws():
        for most in iterations:
            start = problem.parameters.copy()
            start.update_from_vector(x)
            try:
                problem.weigh(x)
                fitted, result = sysid.optimize(
                    start,
                    problem.residual,
                    optimizer="mujoco",
                    verbose=False,
                    max_iters=most,
                    eps=EPS,
                    xtol=SETTLED,
                    output=io.StringIO(),  # of its trace
                    **DAMPING,
                )
            except ValueError as error:  # over the times of a simulation that ended early
                raise Diverged(str(error)) from error
            x = fitted.as_vector()
        left = problem.rms(x)
        residuals, *_ = problem.residual(x, problem.parameters.copy())
    n = len(problem.free)
    covariance, _ = sysid.calculate_intervals([r.ravel() for r in residuals], np.asarray(result.jac))
    whole = np.zeros((problem.calibration.size,) * 2)
    whole[np.ix_(problem.free, problem.free)] = covariance[:n, :n]
    torque = ", ".join(f"{r[2]:.2g}" for r in left.values())
    names = [problem.calibration.names[i] for i in problem.free]
    far = ", ".join(f"{n} {v:+.1f}" for n, v in zip(names, x[:n], strict=True) if abs(v) > FAR) or "none"
    said = f"torque left {torque} N·m; beyond {FAR:g} tolerances: {far}"
    return Found(problem.unknowns(x), whole, time.process_time() - begin, said)


# --- both ----------------------------------------------------------------------------------------------


def fitted(hidden: str, index: int, tool: str, fit: Callable[[Draw], Found] | None = None) -> Fitted:
    """One draw by one tool."""
    logging.getLogger("absl").setLevel(logging.ERROR)
    challenge = Challenge(seed=SEED, hidden="one", only=(hidden,)) if hidden else Challenge(seed=SEED, hidden="none")
    one = draw(challenge, index)
    if fit is None:
        fit = {OURS: diagnosed, EXACT: lambda d: rolled_out(d, True), NATIVE: lambda d: rolled_out(d, False)}[tool]
    found = fit(one)
    return Fitted(hidden, index, tool, numbers(one, found), found.core_time, found.said)


def numbers(one: Draw, found: Found) -> dict[str, Number]:
    """The reported numbers of a draw, with the link mounted, true and found."""
    calibration, step = Calibration(one.nominal), 1e-3
    mounting = one.measurement.recordings[-1].link

    def values(x: np.ndarray) -> np.ndarray:
        p = calibration.record(x, mounting)[0]
        return np.array([p[name] for name in LABELS])

    nominal, value = values(np.zeros(calibration.size)), values(found.x)
    slope = np.stack([(values(found.x + step * e) - value) / step for e in np.eye(calibration.size)], axis=1)
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slope, found.covariance, slope), 0.0))
    true = np.array([one.records[-1][0][name] for name in LABELS])
    covered = np.abs(value - true) <= 1.96 * std
    return {
        name: Number(float(nominal[i]), float(true[i]), float(value[i]), float(std[i]), bool(covered[i]))
        for i, name in enumerate(LABELS)
    }


def tables(fits: Sequence[Fitted]) -> dict[str, str]:
    """The page's tables, by marker."""
    plain = [f for f in fits if not f.hidden]
    count = {tool: sum(f.tool == tool for f in plain) for tool in TOOLS}
    head = (
        "number", "before", *(f"{tool}, {count[tool]} joints: error" for tool in TOOLS), *(f"{tool}: covered" for tool in TOOLS)
    )  # fmt: skip
    rows = []
    for name, label in LABELS.items():
        by = {tool: [f.numbers[name] for f in plain if f.tool == tool] for tool in TOOLS}
        before = _rms([n.nominal / n.true - 1 for n in by[OURS]])
        errors = [_rms([n.value / n.true - 1 for n in by[tool]]) for tool in TOOLS]
        covered = [f"{sum(n.covered for n in by[tool])} of {len(by[tool])}" for tool in TOOLS]
        rows.append((label, before, *errors, *covered))
    every = {tool: [n for f in plain if f.tool == tool for n in f.numbers.values()] for tool in TOOLS}
    share = [f"{100 * np.mean([n.covered for n in every[tool]]):.0f} %" if every[tool] else "" for tool in TOOLS]
    rows.append(("all", "", "", "", "", *share))
    times = [[f.core_time for f in plain if f.tool == tool] for tool in TOOLS]
    cost = [
        (tool, str(len(t)), f"{np.median(t):.0f}" if t else "", f"{max(t):.0f}" if t else "")
        for tool, t in zip(TOOLS, times, strict=True)
    ]
    said = [
        (f"{f.hidden} ({f.draw})", f.tool if f.tool != OURS else "diagnose", f.said, f"{f.core_time:.0f}")
        for f in sorted(fits, key=lambda f: (f.hidden, f.draw, TOOLS.index(f.tool)))
        if f.hidden
    ]
    return {
        "numbers": markdown_table(head, rows),
        "time": markdown_table(("tool", "draws", "median core time [s]", "longest [s]"), cost),
        "hidden": markdown_table(("hidden (draw)", "tool", "what it says", "core time [s]"), said)
        if said
        else "(not run yet)",
    }


def _rms(relative: Sequence[float]) -> str:
    """Root mean square of relative errors in %."""
    return f"{100 * np.sqrt(np.mean(np.square(relative))):.2g} %" if len(relative) else ""


def read(path: Path) -> list[Fitted]:
    """Fits that are kept."""
    if not path.exists():
        return []
    kept = json.loads(path.read_text(encoding="utf-8"))
    return [Fitted(**{**f, "numbers": {k: Number(**n) for k, n in f["numbers"].items()}}) for f in kept]


def write(path: Path, fits: Sequence[Fitted]) -> None:
    """Keep fits, sorted."""
    ordered = sorted(fits, key=lambda f: (f.hidden, f.draw, TOOLS.index(f.tool)))
    write_text(path, json.dumps([asdict(f) for f in ordered], indent=1) + "\n")


def _warm_up() -> None:
    """Load what is compiled, so that no fit's time has it."""
    fitted("", 0, OURS)


def main(arguments: Sequence[str] = ()) -> None:
    """Fit what is not kept yet, keep it, and write the page's tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks sysid", description=__doc__)
    parser.add_argument(
        "--draws", type=int, default=10, help="joints without anything hidden; 0 writes the tables of what is kept"
    )
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--kept", type=Path, default=ROOT / "docs" / "sysid.json")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "sysid.md")
    asked = parser.parse_args(arguments)
    fits = read(asked.kept)
    have = {(f.hidden, f.draw, f.tool) for f in fits}
    few = min(asked.draws, 2)
    wanted = [("", k, tool) for k in range(few) for tool in TOOLS]
    if few:
        wanted += [(hidden, 0, tool) for hidden in HIDDEN for tool in (OURS, EXACT)]
    wanted += [("", k, tool) for k in range(few, asked.draws) for tool in TOOLS]
    waiting = [one for one in wanted if one not in have]
    for asked_for, done in computed(fitted, waiting, asked.processes, initializer=_warm_up):
        try:
            one = done.result()
        except Diverged as error:
            print(*asked_for, f"ended without a fit: {error}", flush=True)
            continue
        fits.append(one)
        write(asked.kept, fits)
        print(f"{one.hidden or 'nothing'} {one.draw} {one.tool}: {one.core_time:.0f} s {one.said}", flush=True)
    for table in tables(fits).values():
        print(table, end="\n\n")
    fill(asked.page, tables(fits))
