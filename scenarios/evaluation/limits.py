"""Errors of estimators relative to the Cramér-Rao bound, and consistency of their variances: NIS, NEES, whiteness."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...estimator import bound, consistency
from ...estimator.compliance import measurement_variance
from ...estimator.consistency import Mean
from ...estimator.estimator import Estimator, KnownJoint
from ...estimator.joint_model import STATES
from ...models.calibration import Calibration
from ...models.errors import FilterDiverged, InputError
from ...models.joint import Joint
from ...models.joint_parts import Mounting
from ...models.parameters import PARAMETERS
from ..run import Run, simulate_scenario
from ..scenario import Disturbance, Scenario
from .draws import of_seed

BIN = 0.1  # time [s] over which errors are averaged for curves over time
LAGS = 50  # lags of the innovations' autocorrelation, samples
_UNSEEN = ("link_encoder_zero", "current_offset", "torque_sensor_gain", "torque_sensor_offset")
_APART = 0.25  # s: errors this far apart count for NEES; the slowest filter forgets in a tenth of it


@dataclass(frozen=True)
class Assessment:
    """Errors and consistency of one estimator in a scenario over M seeds."""

    name: str  # of the estimator
    causal: bool  # whether it uses no later samples
    rms: np.ndarray  # shape (M,), RMS error of each seed after the transient [N·m]; NaN where it diverged
    error: np.ndarray  # shape (B,), RMS error over seeds in each time bin [N·m]
    nis: Mean | None = None  # mean normalised innovation squared with its interval; None without innovations
    # mean normalised error squared; None without a variance. Errors are correlated in time: only one per run counts as
    # independent for the interval.
    nees: Mean | None = None
    nees_over_time: np.ndarray | None = None  # shape (B,), mean over seeds of the NEES at one sample of each bin
    nees_share: float | None = None  # share of these bins in which that mean lies within its 95 % interval
    # shape (LAGS,), of the normalised innovations of the least white channel, mean over seeds
    autocorrelation: np.ndarray | None = None
    # share of lags outside the band of white innovations of one run, mean over seeds; 0.05 is expected
    outside: float | None = None
    whiteness: float | None = None  # mean over seeds of the Ljung-Box probability

    @property
    def mean_rms(self) -> float:
        """RMS error over all seeds [N·m]."""
        return float(np.sqrt(np.mean(self.rms**2)))


@dataclass(frozen=True)
class Limits:
    """Estimators and the bounds in one scenario."""

    scenario: str  # its name
    seeds: np.ndarray  # shape (M,)
    time: np.ndarray  # shape (B,), middles of the bins [s]
    transient: float  # not part of RMS [s]
    intensity: float  # of the external torque's random walk in the joint's model [N·m/√s]
    fitted: float  # the scenario's own intensity [N·m/√s]
    # shape (B,), square root of the bound of the error variance [N·m], joint's dynamics with encoders and command
    bound: np.ndarray
    bound_rms: float  # its RMS after the transient [N·m]
    torsion_intensity: float
    # torsion_bound, torsion_bound_rms: for the paper's model: the joint torque as a random walk of intensity
    # `torsion_intensity` [N·m/√s], fitted to it, seen through the compliance model with the encoders' noise only
    torsion_bound: np.ndarray
    torsion_bound_rms: float
    tolerance: float  # share of the joint's tolerances that are the prior of `tolerance_bound`
    # tolerance_bound, tolerance_bound_rms: for a joint that is known within its tolerances; NaN at tolerance 0
    tolerance_bound: np.ndarray
    tolerance_bound_rms: float
    band: float  # half-width of the band of white innovations [1]
    estimators: tuple[Assessment, ...]  # their assessments

    def ratio(self, name: str) -> float:
        """Return the RMS error of an estimator relative to the bound."""
        return next(e for e in self.estimators if e.name == name).mean_rms / self.bound_rms


def matched(scenario: Scenario, intensity: float) -> Scenario:
    """Return the scenario with the random walk of the bound's model as its only disturbance, new for each seed."""
    torque = intensity * np.sqrt(scenario.duration)
    walk = Disturbance(kind="walk", start=0.0, duration=scenario.duration, torque=torque)
    return scenario.model_copy(update={"disturbances": [walk]})


def fitted_intensity(scenario: Scenario) -> float:
    """Return the intensity [N·m/√s] of the random walk that changes as much as the scenario's external torque."""
    return bound.walk_intensity(scenario.external_torque(), scenario.time)


def assess(
    scenario: Scenario,
    folder: Path | None,
    seeds: Sequence[int],
    estimators: Mapping[str, Estimator],
    intensity: float | None = None,
    tolerance: float = 1.0,
    progress: Callable[[], None] = lambda: None,
    vary: bool = True,
) -> Limits:
    """Run a scenario with every seed and compare estimators, by name, with the bounds.

    `intensity`: of the external torque in the bound [N·m/√s]; by default fitted to the scenario (root mean square over
    seeds), and at least 0.001·T2, which means a load known to 1 % after 40 s. `tolerance`: share of the joint's tolerances
    that are the prior of the second bound; 0 omits it. `vary`: whether start, pace and pushes are drawn per seed
    (`draws.varied`): seeds that change the sensors' noise alone are not independent. `progress`: called after each seed.
    Raises `InputError`: torque feedback, payloads, no seeds, or a joint whose bound is not defined.
    """
    if len(seeds) == 0:
        raise InputError("bound: expected at least one seed, got none")
    if scenario.payloads:
        raise InputError(f"scenario {scenario.name}: payloads: expected none, as the bound's link has a constant load")
    joint, _ = scenario.load_joint(folder)
    record = joint.record(scenario.mount(joint))
    if record[0]["hysteresis_torque"] != 0.0:
        raise InputError(f"joint {joint.name}: no bound: the true state of the flexspline's hysteresis is not recorded")
    drawn = [of_seed(scenario, seed, vary) for seed in seeds]
    fitted = math.sqrt(np.mean([fitted_intensity(one) ** 2 for one in drawn]))
    if intensity is None:
        intensity = max(fitted, bound.QUIET.external * float(record[0]["T2"]))

    results: dict[str, list[dict[str, Any]]] = {name: [] for name in estimators}
    others = doubtful(joint, scenario.mount(joint), tolerance)
    variances, torsion_variances, doubtful_variances, walks = [], [], [], []
    for one, seed in zip(drawn, seeds, strict=True):
        run = simulate_scenario(one, folder, seed)
        variances.append(joint_variance(run, record, intensity))
        if len(others):
            doubtful_variances.append(joint_variance(run, record, intensity, others))
        walks.append(bound.walk_intensity(run.truth("joint_torque"), run.time))
        torsion_variances.append(torsion_variance(run, record, walks[-1]))
        for name, estimator in estimators.items():
            results[name].append(_result(estimator, run))
        progress()
    kept = run.time >= scenario.transient
    size = _bin_size(run)
    v, t = np.mean(variances, axis=0), np.mean(torsion_variances, axis=0)
    d = np.mean(doubtful_variances, axis=0) if len(others) else np.full_like(v, np.nan)
    return Limits(
        scenario.name, np.array(seeds), _binned(run.time, size), scenario.transient, float(intensity), fitted,
        np.sqrt(_binned(v, size)), float(np.sqrt(v[kept].mean())),
        float(np.mean(walks)), np.sqrt(_binned(t, size)), float(np.sqrt(t[kept].mean())),
        tolerance, np.sqrt(_binned(d, size)), float(np.sqrt(d[kept].mean())),
        consistency.white_band(int(np.count_nonzero(kept))),
        tuple(_assessment(name, estimators[name], found) for name, found in results.items()),
    )  # fmt: skip


def true_states(run: Run) -> np.ndarray:
    """Return true states of a run, columns `joint_model.STATES`, shape (n, len(STATES)), without hysteresis."""
    truth = run.simulation.truth
    states = np.zeros((len(run.time), len(STATES)))
    for i, name in enumerate(STATES):
        if name == "external_torque":
            states[:, i] = run.external_torque
        elif name in (truth.dtype.names or ()):
            states[:, i] = truth[name]
    return states


def doubtful(joint: Joint, mounting: Mounting, tolerance: float) -> np.ndarray:
    """Return records of a joint with one number each changed by `tolerance` standard deviations, shape (k,).

    The link encoder is zeroed. Numbers that neither motion nor encoders show are left out.
    """
    calibration = Calibration(joint)
    changes = zip(calibration.names, tolerance * np.eye(calibration.size), strict=True)
    found = [calibration.record(x, mounting) for name, x in changes if name not in _UNSEEN and tolerance > 0.0]
    return np.concatenate(found) if found else np.zeros(0, PARAMETERS)


def joint_variance(run: Run, record: np.ndarray, intensity: float, others: np.ndarray | None = None) -> np.ndarray:
    """Return the bound of the error variance along a run's truth, shape (n,) [(N·m)²]; the arguments as of
    `bound.joint_bound`."""
    noise = KnownJoint.of(run.joint).noise
    states, temperature = true_states(run), run.scenario.temperature.signal(run.time)
    current, command = run.truth("motor_current"), run.simulation.command
    return bound.joint_bound(run.time, states, current, command, record, noise, intensity, temperature, others)


def torsion_variance(run: Run, record: np.ndarray, intensity: float) -> np.ndarray:
    """Return the bound for the paper's model, shape (n,): random walk of the joint torque, encoders' noise through the
    stiffness."""
    p, noise = record[0], KnownJoint.of(run.joint).noise
    load = np.abs(run.truth("flexspline_torque"))
    stiffness = np.where(load < p["T1"], p["K1"], np.where(load < p["T2"], p["K2"], p["K3"]))
    unit = measurement_variance(
        1.0, noise.motor_resolution, noise.link_resolution, noise.link_noise, noise.motor_noise, ratio=float(p["N"])
    )
    V = unit * stiffness**2
    return bound.random_walk_bound(intensity**2 * (run.time[1] - run.time[0]), V, V[0])


def _bin_size(run: Run) -> int:
    return round(BIN / (run.time[1] - run.time[0]))


def _binned(values: np.ndarray, size: int) -> np.ndarray:
    """Means of `size` samples; an incomplete last bin is left out."""
    whole = len(values) // size * size
    return values[:whole].reshape(-1, size).mean(axis=1)


def _result(estimator: Estimator, run: Run) -> dict[str, Any]:
    """Numbers and curves of one estimator with one seed; `rms` alone where it diverged."""
    kept, size = run.time >= run.scenario.transient, _bin_size(run)
    try:
        estimate = estimator.estimate(run.signals, run.known)
    except FilterDiverged:
        return {"rms": np.nan}
    error = estimate.mean - run.truth("joint_torque")
    squares = _binned(error**2, size)
    found: dict[str, Any] = {"rms": float(np.sqrt(np.mean(error[kept] ** 2))), "squares": squares}
    if estimate.variance is not None:
        nees = error**2 / np.maximum(estimate.variance, 1e-300)
        # One sample per bin: those of different seeds are independent.
        found["nees"] = nees[size // 2 :: size][: len(squares)]
        found["nees_apart"] = nees[kept][:: round(_APART / (run.time[1] - run.time[0]))]
    e, S = estimate.innovation, estimate.innovation_covariance
    if e is not None and S is not None and estimator.causal:
        e, S = e[kept], S[kept]
        normal = e / np.sqrt(np.diagonal(S, axis1=1, axis2=2))
        found["nis"] = float(np.mean(consistency.normalised_squares(e, S))), e.shape[1], len(e)
        found["rho"] = np.array([consistency.autocorrelation(normal[:, i], LAGS) for i in range(e.shape[1])])
    return found


def _assessment(name: str, estimator: Estimator, results: Sequence[Mapping[str, Any]]) -> Assessment:
    def every(key: str) -> list[Any]:
        return [one[key] for one in results if key in one]

    more: dict[str, Any] = {}
    if every("nees"):
        nees = np.array(every("nees"))
        apart = np.array(every("nees_apart"))
        more["nees"] = consistency.mean_consistency(apart, 1, samples=len(nees))
        more |= {"nees_over_time": nees.mean(axis=0), "nees_share": consistency.share_inside(nees, 1)}
    if every("nis"):
        means, dofs, samples = zip(*every("nis"), strict=True)
        rho = np.array(every("rho"))  # (M, m, LAGS)
        least_white = rho[:, int(np.argmax(np.mean(rho**2, axis=(0, 2))))]
        more |= {
            "nis": consistency.mean_consistency(np.array([float(np.mean(means))]), dofs[0], samples=sum(samples)),
            "autocorrelation": least_white.mean(axis=0),
            "outside": float(np.mean(np.abs(least_white) > consistency.white_band(samples[-1]))),
            "whiteness": float(np.mean([consistency.ljung_box(r, samples[-1]) for r in least_white])),
        }
    squares = every("squares")
    error = np.sqrt(np.mean(squares, axis=0)) if squares else np.zeros(0)
    return Assessment(name, estimator.causal, np.array(every("rms")), error, **more)
