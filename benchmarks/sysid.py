"""Our calibration beside `mujoco.sysid` on the same drawn joints: `python -m benchmarks sysid` writes docs/sysid.json and the
tables of docs/sysid.md.

Both get the same three recordings of a joint whose every number is drawn within its tolerance, the same description (numbers,
tolerances, sensor noise), and the same unknowns: the calibration variables of `models.calibration`, one standard deviation of
the description each. `mujoco.sysid` minimises the error of a simulation (`rollout`), our calibration that of the balances.

*How the joint is given to `mujoco.sysid`.* As MJCF: rotor, wave generator and link, tendons with polynomial stiffness as close
to the described laws as MJCF allows, LuGre friction, no kinematic error, which MJCF cannot say. With `exact`, a compiled
callback exerts the described laws instead: nothing but integration then separates model and plant. The measured current drives
the rotor. Simulating 30 s from current alone drifts by turns, so a servo on the measured angle holds the simulation near the
measurement. Where unmeasured pushes act, a stiff servo takes the link along the measured motion. Residuals are motor angle, link
angle and joint torque, each divided by its RMS (sensors' noise in that) at the start and, once more, after a first fit; beside
them stand the unknowns over their tolerances. The package's own optimiser (`mujoco`), forward differences, intervals of its
`calculate_intervals`.
"""

from __future__ import annotations

import argparse
import io
import json
import logging
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from scipy.signal import savgol_filter

from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.fit.solver import Fitter, with_dispersion
from flexspline.diagnosis.search.calibrate import calibrate
from flexspline.diagnosis.trials.draw import Challenge, Draw, draw
from flexspline.models import laws
from flexspline.models.calibration import Calibration
from flexspline.models.files import write_into_place
from flexspline.models.parameters import as_floats
from flexspline.models.recording import Recording
from flexspline.sim import callbacks, native, plant, structure
from flexspline.views.limit_tables import markdown

from .convergence import _MAGIC, _passive
from .estimators import fill

ROOT = Path(__file__).resolve().parents[1]
SEED = 4001
HIDDEN = ("friction_periodic", "hysteresis", "link_encoder_eccentricity")
TIMESTEP = 5e-4  # s: of the rollouts, that of the joint's MJCF
INTEGRATOR = mujoco.mjtIntegrator.mjINT_EULER  # without `implicitfast`'s damping of the flexspline's mode
ITERATIONS = (3, 5)  # of the two fits, at most
BANDWIDTH = 300.0  # rad/s: of the servo that holds the rotor's simulated angle to the measured one
STIFF = 800.0  # rad/s: of the servo that takes the link along where pushes act
SMOOTHED = 21  # samples over which measured angles are smoothed for servos' velocities
SKIPPED = 0.05  # s: at the beginning, where filters and servos settle
EPS = 1e-3  # standard deviations: step of the forward differences
DIVERGED = 1e3  # standard deviations: residual of a simulation that is not finite
DAMPING = {"mu_min": 1.0, "mu_factor": 2.0}  # with the defaults, 1e-6 and 1.26, it takes 80 simulations to get damped
SETTLED = 3e-2  # standard deviations: a fit ends when its step is shorter
LABELS = {
    "Kt": "torque constant Kt", "K1": "flexspline stiffness K1", "K2": "K2", "K3": "K3", "Kw0": "wave generator stiffness Kw0",
    "Fc": "Coulomb friction Fc", "bw": "viscous friction of the mesh bw", "Jm": "rotor inertia Jm", "Jl": "link inertia Jl",
    "Mg": "gravity moment Mg",
}  # fmt: skip
COLUMNS = ("motor_position", "link_position", "joint_torque")
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


@dataclass(frozen=True)
class Found:
    """What one tool found: calibration variables with covariance, core time [s], and what it says of its residual."""

    x: np.ndarray
    covariance: np.ndarray
    core_time: float
    said: str


# --- ours --------------------------------------------------------------------------------------------------------------


def calibrated(one: Draw) -> Found:
    """Our calibration, as a diagnosis does it where it finds nothing."""
    begin = time.process_time()
    problem = Problem(*segments(list(one.measurement.recordings), one.nominal), one.nominal)
    fitter = Fitter(problem)
    fit = with_dispersion(problem, fitter.polish(calibrate(problem, fitter)))
    n = problem.calibration.size
    return Found(fit.theta[:n], fit.covariance[:n, :n], time.process_time() - begin, "")


def diagnosed(one: Draw) -> Found:
    """The whole diagnosis, where something may be hidden."""
    begin = time.process_time()
    found = diagnose(one.measurement, one.nominal)
    assert found.problem is not None and found.final is not None
    n = found.problem.calibration.size
    causes = ", ".join(f"{c.name} ({100 * c.confidence:.0f} % sure, {c.worth:.2g} N·m)" for c in found.causes)
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
        ])  # fmt: skip

    def _spec(self, recording: Recording, record: np.ndarray) -> mujoco.MjSpec:
        """The joint's MJCF with the numbers of a record, and the servos."""
        p = record[0]
        spec = structure.read(self.joint.mjcf)
        plant._set_numbers(spec, p, TIMESTEP, True)
        plant._set_friction(spec, p)
        spec.option.integrator = INTEGRATOR
        spec.modelname = recording.name
        spec.joint("rotor").damping = [p["bm"], 0, 0]
        spec.joint("link").damping = [p["bl"], 0, 0]
        spec.actuator("mesh_friction").damping = [p["bw"], 0, 0]
        springs = _polynomials(p)
        for name, damping in (("flexspline", p["df"]), ("wave_generator", p["dw"])):
            spec.tendon(name).damping = [damping, 0, 0]
            spec.tendon(name).stiffness = [0.0] * 3 if self.exact else springs[name]
        if self.exact:
            spec.add_numeric(name="joint", size=1 + as_floats(record).size, data=[0.0])
        motor, Kt = spec.actuator("motor"), float(p["Kt"])
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        kp, kd = self._servo(recording)
        motor.gainprm[0] = Kt
        motor.biasprm[:3] = [-Kt * p["current_offset"], -Kt * kp, -Kt * kd]
        hold = spec.add_actuator(name="hold", target="link", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        hold.gaintype, hold.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        kp, kd = self._hold(recording)
        hold.gainprm[0] = 1.0
        hold.biasprm[:3] = [-kp * p["link_zero"], -kp, -kd]
        spec.add_sensor(name="hold", type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
                        objtype=mujoco.mjtObj.mjOBJ_ACTUATOR, objname="hold")  # fmt: skip
        return spec

    def _servo(self, recording: Recording) -> tuple[float, float]:
        """Gains of the rotor's servo [A/rad, A·s/rad]."""
        p = self.joint.record(recording.link)[0]
        inertia = p["Jm"] + p["Jw"] + (0.0 if self._pushed(recording) else p["Jl"] / p["N"] ** 2)
        return inertia * BANDWIDTH**2 / p["Kt"], 1.4 * inertia * BANDWIDTH / p["Kt"]

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
            model.numeric_data[:] = np.concatenate([[_MAGIC], as_floats(record)])
        return model

    def _build(self, parameters: Any, spec: mujoco.MjSpec) -> mujoco.MjModel:
        return self.build(parameters.as_vector(), spec.modelname)

    def _sequence(self, recording: Recording) -> Any:
        """A recording as `mujoco.sysid` takes it: what drives the model, what is compared, and how it begins (at rest)."""
        t = recording.time - recording.time[0]
        motor, link = recording["motor_position"], recording["link_position"]
        step = float(np.median(np.diff(t)))

        def derivative(y: np.ndarray, order: int, samples: int = SMOOTHED) -> np.ndarray:
            return savgol_filter(y, samples, 3, deriv=order, delta=step)

        kp, kd = self._servo(recording)
        drive = recording["motor_current"] + kp * motor + kd * derivative(motor, 1)
        kp, kd = self._hold(recording)
        hold = kp * link + kd * derivative(link, 1)
        if kp > 0.0:
            p = self.joint.record(recording.link)[0]
            hold = hold + p["Jl"] * derivative(link, 2) + p["Mg"] * np.sin(link) - recording["joint_torque"]
        record = self._record(np.zeros(len(self.free)), recording)
        spec = self._spec(recording, record)
        model = spec.compile()
        control = np.zeros((len(t), model.nu))
        for name, values in (("motor", drive), ("hold", hold)):
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
        at = measured.times[(measured.times > SKIPPED) & (measured.times < time_[-1])]
        real = measured.data[(measured.times > SKIPPED) & (measured.times < time_[-1])]
        torque, hold = model.sensor("torque").adr[0] + 1, model.sensor("hold").adr[0]
        # Sensors are those of the step's beginning.
        Ts = -predicted.data[:, torque] - predicted.data[:, hold]
        found = np.column_stack([
            np.interp(at, time_, state[:, 1]),
            np.interp(at, time_, state[:, 3]) + p["link_zero"],
            np.interp(at, time_ - TIMESTEP, Ts) * p["torque_gain"] + p["torque_offset"],
        ])  # fmt: skip
        counted = [
            1.0,
            float(not self._pushed(self.recordings[name])),
            1.0,
        ]  # where a servo moves the link, its angle says nothing
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
        """RMS of what is left of each channel, by recording."""
        found, *_ = sysid.residual(x, self.parameters.copy(), self.sequences, self._build, self._compare, n_threads=1)
        return {
            name: self.weights[name] * np.sqrt(np.mean(r.reshape(-1, len(COLUMNS)) ** 2, axis=0))
            for name, r in zip(self.recordings, found, strict=True)
        }

    def weigh(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Weights from what is left at a point."""
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


@contextmanager
def described_laws() -> Iterator[None]:
    """Within, models that carry a record get the described laws' torques from a callback, and nothing of the plant's."""
    callbacks.install()
    before = native.ctypes.c_void_p.in_dll(native.library(), "mjcb_passive").value
    native.install("mjcb_passive", _passive().address)
    try:
        with native.quiet():
            yield
    finally:
        native.install("mjcb_passive", before)


def rolled_out(one: Draw, exact: bool, iterations: Sequence[int] = ITERATIONS) -> Found:
    """`mujoco.sysid`'s fit, weighed by what is left at the start, and again after a first fit."""
    begin = time.process_time()
    problem = Rollouts(one, exact)
    x = np.zeros(len(problem.free))
    with described_laws():
        for most in iterations:
            problem.weigh(x)
            start = problem.parameters.copy()
            start.update_from_vector(x)
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
            x = fitted.as_vector()
        left = problem.rms(x)
        residuals, *_ = problem.residual(x, problem.parameters.copy())
    covariance, _ = sysid.calculate_intervals([r.ravel() for r in residuals], np.asarray(result.jac))
    whole = np.zeros((problem.calibration.size,) * 2)
    whole[np.ix_(problem.free, problem.free)] = covariance
    torque = ", ".join(f"{r[2]:.2g}" for r in left.values())
    names = [problem.calibration.names[i] for i in problem.free]
    far = ", ".join(f"{n} {v:+.1f}" for n, v in zip(names, x, strict=True) if abs(v) > FAR) or "none"
    said = f"torque left {torque} N·m; beyond {FAR:g} tolerances: {far}"
    return Found(problem.unknowns(x), whole, time.process_time() - begin, said)


# --- both beside each other ----------------------------------------------------------------------------------------------


def fitted(hidden: str, index: int, tool: str, fit: Callable[[Draw], Found] | None = None) -> Fitted:
    """One draw by one tool."""
    logging.getLogger("absl").setLevel(logging.ERROR)
    challenge = Challenge(seed=SEED, hidden="one", only=(hidden,)) if hidden else Challenge(seed=SEED, hidden="none")
    one = draw(challenge, index)
    if fit is None:
        ours = diagnosed if hidden else calibrated
        fit = {OURS: ours, EXACT: lambda d: rolled_out(d, True), NATIVE: lambda d: rolled_out(d, False)}[tool]
    found = fit(one)
    return Fitted(hidden, index, tool, numbers(one, found), found.core_time, found.said)


def numbers(one: Draw, found: Found) -> dict[str, Number]:
    """The reported numbers of a draw, with the link mounted, as they are and as they were found."""
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
    head = ("number", "before", *(f"{tool}: error" for tool in TOOLS), *(f"{tool}: covered" for tool in TOOLS))
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
        "numbers": markdown(head, rows),
        "time": markdown(("tool", "draws", "median core time [s]", "longest [s]"), cost),
        "hidden": markdown(("hidden (draw)", "tool", "what it says", "core time [s]"), said),
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
    with write_into_place(path) as temporary:
        temporary.write_text(json.dumps([asdict(f) for f in ordered], indent=1) + "\n", encoding="utf-8")


def _warm_up() -> None:
    """Load what is compiled, so that no fit's time has it."""
    fitted("", 0, OURS)


def main(arguments: Sequence[str] = ()) -> None:
    """Fit what is not kept yet, keep it, and write the page's tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=10, help="joints without anything hidden")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--kept", type=Path, default=ROOT / "docs" / "sysid.json")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "sysid.md")
    asked = parser.parse_args(arguments)
    fits = read(asked.kept)
    have = {(f.hidden, f.draw, f.tool) for f in fits}
    few = min(asked.draws, 3)
    wanted = [("", k, tool) for k in range(few) for tool in TOOLS]
    wanted += [(hidden, 0, tool) for hidden in HIDDEN for tool in (OURS, EXACT)]
    wanted += [("", k, tool) for k in range(few, asked.draws) for tool in TOOLS]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(asked.processes, mp_context=context, initializer=_warm_up) as pool:
        running = [pool.submit(fitted, *one) for one in wanted if one not in have]
        for done in as_completed(running):
            one = done.result()
            fits.append(one)
            write(asked.kept, fits)
            print(f"{one.hidden or 'nothing'} {one.draw} {one.tool}: {one.core_time:.0f} s {one.said}", flush=True)
    for table in tables(fits).values():
        print(table, end="\n\n")
    fill(asked.page, tables(fits))
