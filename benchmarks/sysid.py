"""Our calibration beside `mujoco.sysid` on the same drawn joints: `python -m benchmarks sysid` writes docs/sysid.csv and the
tables of docs/sysid.md.

Both get the same three recordings of a joint whose every number is drawn within its tolerance, the same description (numbers,
tolerances, sensor noise), and the same unknowns: the calibration variables of `models.calibration`, one standard deviation of
the description each. `mujoco.sysid` minimises the error of a simulation (`rollout`), our calibration that of the balances.

*How the joint is given to `mujoco.sysid`.* The joint's MJCF: rotor, wave generator and link, tendons with polynomial stiffness
as close to the described laws as MJCF allows, LuGre friction. With `exact`, a compiled callback exerts the described laws
instead: nothing but integration then separates model and plant. The measured current drives the rotor. Simulating 30 s from
current alone drifts by turns, so a servo on the measured angle holds the simulation near the measurement, as slow as the
current's noise and the encoder's counts ask for (the bandwidth of their Kalman filter); what it has to exert shows in the
residual. Where unmeasured pushes act, a stiff servo takes the link along the measured motion. Residuals are motor angle, link
angle and joint torque, each divided by its RMS after a first fit (sensors' noise in that), and the unknowns over their
tolerances; forward differences, the package's own optimiser (`mujoco`), at most `ITERATIONS` iterations.
"""

from __future__ import annotations

import argparse
import csv
import logging
import multiprocessing
import re
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from scipy.signal import savgol_filter

from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.diagnose import _value, diagnose
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
ITERATIONS = 25  # of a fit; two fits
BANDWIDTH = 150.0  # rad/s: of the servo that holds the rotor's simulated angle to the measured one
STIFF = 800.0  # rad/s: of the servo that takes the link along where pushes act
SMOOTHED = 21  # samples over which measured angles are smoothed for servos' velocities
SKIPPED = 0.05  # s: at the beginning, where filters and servos settle
EPS = 1e-4  # standard deviations: step of the forward differences
REPORTED = ("Kt", "K1", "K2", "K3", "Kw0", "Fc", "bw", "bm", "Jm", "Jl", "Mg")
LABELS = {
    "Kt": "torque constant", "K1": "flexspline stiffness K1", "K2": "K2", "K3": "K3", "Kw0": "wave generator stiffness",
    "Fc": "Coulomb friction", "bw": "viscous friction, mesh", "bm": "viscous friction, motor", "Jm": "rotor inertia",
    "Jl": "link inertia", "Mg": "gravity",
}  # fmt: skip
COLUMNS = ("motor_position", "link_position", "joint_torque")


@dataclass(frozen=True)
class Row:
    """A number of a draw as one tool found it: error [%], stated standard deviation [%], error in those, whether the 95 %
    interval holds the truth; core time [s] of that fit (the same in all rows of a fit)."""

    hidden: str
    draw: int
    tool: str
    number: str
    nominal: float
    true: float
    value: float
    error: float
    std: float
    z: float
    covered: bool
    core_time: float


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
        weights = self.weights[name]
        shown = [sysid.TimeSeries(at, y) for y in (found, real)]
        return (real - found) / weights, *shown

    def residual(self, x: np.ndarray, parameters: Any, **options: Any):
        """Residuals of all recordings, and the unknowns over their tolerances."""
        found, *shown = sysid.residual(
            x, parameters, self.sequences, self._build, self._compare, n_threads=1, **options
        )  # fmt: skip
        return [*found, x if x.ndim > 1 else x.reshape(-1, 1)], *shown

    def rms(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """RMS of what is left of each channel, by recording."""
        found, *_ = sysid.residual(x, self.parameters.copy(), self.sequences, self._build, self._compare, n_threads=1)
        return {
            name: self.weights[name] * np.sqrt(np.mean(r.reshape(-1, len(COLUMNS)) ** 2, axis=0))
            for name, r in zip(self.recordings, found, strict=True)
        }

    def weigh(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Weights from what is left at a point; the link's angle says nothing where a servo moves it."""
        noise = self._noise()
        left = self.rms(x)
        for name, r in left.items():
            self.weights[name] = np.maximum(r, noise)
            if self._pushed(self.recordings[name]):
                self.weights[name][1] = np.inf
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
