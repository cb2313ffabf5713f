"""How far each estimator is from what is possible, and whether it knows: error beside the bound, NIS, NEES, whiteness."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...estimator import bound, consistency
from ...estimator.compliance import measurement_variance
from ...estimator.consistency import Mean
from ...estimator.errors import FilterDiverged
from ...estimator.estimator import Estimator, KnownJoint
from ...estimator.joint_model import STATES
from ...models.calibration import Calibration
from ...models.errors import InputError
from ...models.joint import Joint, Mounting
from ...models.parameters import PARAMETERS
from ..run import Run, simulate_scenario
from ..scenario import Disturbance, Scenario
from .draws import of_seed

BIN = 0.1
"""Time [s] over which errors are averaged to be shown over time."""
LAGS = 50
"""Lags of the innovations' autocorrelation, samples."""
_UNSEEN = ("link_encoder_zero", "current_offset", "torque_sensor_gain", "torque_sensor_offset")
_APART = 0.25  # s: errors this far apart count for NEES; the slowest filter forgets in a tenth of it


@dataclass(frozen=True)
class Assessment:
    """What one estimator is worth in a scenario over M seeds.

    Attributes:
        name: of the estimator. causal: whether it uses nothing later.
        rms: Shape (M,), RMS error of each seed after the transient [N·m]; NaN where it diverged.
        error: Shape (B,), RMS error over seeds in each time bin [N·m].
        nis: mean normalised innovation squared with its interval; None where it states no innovations.
        nees: mean normalised error squared; None where it states no variance. Only one error per run counts as independent
            for its interval: errors are correlated in time.
        nees_over_time: Shape (B,), mean over seeds of the NEES at one sample of each bin; None likewise.
        nees_share: share of those bins in which that mean lies within its 95 % interval; None likewise.
        autocorrelation: Shape (LAGS,), of the normalised innovations of the channel that is least white, mean over seeds.
        outside: share of lags outside the band of white innovations of one run, mean over seeds; 0.05 is expected.
        whiteness: mean over seeds of the Ljung-Box probability.
    """

    name: str
    causal: bool
    rms: np.ndarray
    error: np.ndarray
    nis: Mean | None = None
    nees: Mean | None = None
    nees_over_time: np.ndarray | None = None
    nees_share: float | None = None
    autocorrelation: np.ndarray | None = None
    outside: float | None = None
    whiteness: float | None = None

    @property
    def mean_rms(self) -> float:
        """RMS error over all seeds [N·m]."""
        return float(np.sqrt(np.mean(self.rms**2)))


@dataclass(frozen=True)
class Limits:
    """Estimators beside the bounds, in one scenario.

    Attributes:
        scenario: its name. seeds: Shape (M,). time: Shape (B,), middles of the bins [s]. transient: left out of RMS [s].
        intensity: of the external torque's random walk in the joint's model [N·m/√s]; `fitted`: what the scenario gave.
        bound: Shape (B,), square root of the bound of the error variance [N·m], joint's dynamics with encoders and command.
        bound_rms: of it after the transient [N·m].
        torsion_bound, torsion_bound_rms: likewise for the paper's model: the joint torque as a random walk of intensity
            `torsion_intensity` [N·m/√s], fitted to it, seen through the compliance model with the encoders' noise only.
        tolerance: share of the joint's tolerances with which nobody knows it better than described.
        tolerance_bound, tolerance_bound_rms: the bound with these as prior, the link encoder's zero tared; NaN at 0.
        band: half-width of the band of white innovations [1].
        estimators: what each is worth.
    """

    scenario: str
    seeds: np.ndarray
    time: np.ndarray
    transient: float
    intensity: float
    fitted: float
    bound: np.ndarray
    bound_rms: float
    torsion_intensity: float
    torsion_bound: np.ndarray
    torsion_bound_rms: float
    tolerance: float
    tolerance_bound: np.ndarray
    tolerance_bound_rms: float
    band: float
    estimators: tuple[Assessment, ...]

    def ratio(self, name: str) -> float:
        """RMS error of an estimator in units of the bound."""
        return next(e for e in self.estimators if e.name == name).mean_rms / self.bound_rms


def matched(scenario: Scenario, intensity: float) -> Scenario:
    """The scenario with its disturbances replaced by the random walk of the bound's model, another for each seed."""
    walk = Disturbance(
        kind="walk", start=0.0, duration=scenario.duration, torque=intensity * np.sqrt(scenario.duration)
    )
    return scenario.model_copy(update={"disturbances": [walk]})


def fitted_intensity(scenario: Scenario) -> float:
    """Intensity [N·m/√s] of the random walk that changes as much as the scenario's external torque (`bound.walk_intensity`)."""
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
    """Run a scenario with every seed and hold every estimator against the bounds.

    Args:
        scenario: without torque feedback, so that all estimators see the same.
        folder: of the scenario's file.
        seeds: one or more.
        estimators: by name.
        intensity: of the external torque in the bound [N·m/√s]; by default fitted to the scenario, and at least
            0.001·T2, a joint whose load is known to 1 % after 40 s: nobody knows that nothing acts. What is drawn is fitted
            together, as the root mean square of the seeds' own.
        tolerance: share of the joint's tolerances that are the prior of the second bound; 0 leaves it out.
        progress: called after each seed.
        vary: whether start, pace and pushes are drawn per seed (`draws.varied`): seeds of the sensors' noise alone are no
            independent runs, and intervals over them mean nothing.

    Raises:
        InputError: torque feedback, no seeds, or a joint whose bound is not defined.
    """
    if len(seeds) == 0:
        raise InputError("bound: expected at least one seed, got none")
    joint, _ = scenario.load_joint(folder)
    record = joint.record(scenario.mount(joint))
    if record[0]["hysteresis_torque"] != 0.0:
        raise InputError(f"joint {joint.name}: no bound: the true state of the flexspline's hysteresis is not recorded")
    drawn = [of_seed(scenario, seed, vary) for seed in seeds]
    fitted = math.sqrt(np.mean([fitted_intensity(one) ** 2 for one in drawn]))
    if intensity is None:
        intensity = max(fitted, bound.QUIET.external * float(record[0]["T2"]))

    collected = [_Collected(name, one) for name, one in estimators.items()]
    others = doubtful(joint, scenario.mount(joint), tolerance)
    variances, torsion_variances, doubtful_variances, walks = [], [], [], []
    for one, seed in zip(drawn, seeds, strict=True):
        run = simulate_scenario(one, folder, seed)
        variances.append(joint_variance(run, record, intensity))
        if len(others):
            doubtful_variances.append(joint_variance(run, record, intensity, others))
        walks.append(bound.walk_intensity(run.truth("joint_torque"), run.time))
        torsion_variances.append(torsion_variance(run, record, walks[-1]))
        for each in collected:
            each.add(run)
        progress()
    kept = run.time >= scenario.transient
    size = round(BIN / (run.time[1] - run.time[0]))
    v, t = np.mean(variances, axis=0), np.mean(torsion_variances, axis=0)
    d = np.mean(doubtful_variances, axis=0) if len(others) else np.full_like(v, np.nan)
    return Limits(
        scenario.name, np.array(seeds), _binned(run.time, size), scenario.transient, float(intensity), fitted,
        np.sqrt(_binned(v, size)), float(np.sqrt(v[kept].mean())),
        float(np.mean(walks)), np.sqrt(_binned(t, size)), float(np.sqrt(t[kept].mean())),
        tolerance, np.sqrt(_binned(d, size)), float(np.sqrt(d[kept].mean())),
        consistency.white_band(int(np.count_nonzero(kept))),
        tuple(one.assessment() for one in collected),
    )  # fmt: skip


def true_states(run: Run) -> np.ndarray:
    """True states of a run, columns `joint_model.STATES`, shape (n, len(STATES)); hysteresis of the flexspline is left out."""
    states = np.zeros((len(run.time), len(STATES)))
    truth = run.simulation.truth
    for i, name in enumerate(STATES):
        if name == "external_torque":
            states[:, i] = run.external_torque
        elif name in (truth.dtype.names or ()):
            states[:, i] = truth[name]
    return states


def doubtful(joint: Joint, mounting: Mounting, tolerance: float) -> np.ndarray:
    """Records of a joint with one number each a standard deviation off, shape (k,): `tolerance` times its tolerances.

    The link encoder's zero is tared. Numbers that neither motion nor encoders show stay as they are.
    """
    calibration = Calibration(joint)
    found = []
    for i, name in enumerate(calibration.names):
        if name not in _UNSEEN and tolerance > 0.0:
            x = np.zeros(calibration.size)
            x[i] = tolerance
            found.append(calibration.record(x, mounting))
    return np.concatenate(found) if found else np.zeros(0, PARAMETERS)


def joint_variance(run: Run, record: np.ndarray, intensity: float, others: np.ndarray | None = None) -> np.ndarray:
    """Bound of the error variance along a run's truth, shape (n,) [(N·m)²]; `record`: of the plant; `others`: `doubtful`."""
    noise = KnownJoint.of(run.joint).noise
    current, command = run.truth("motor_current"), run.simulation.command
    return bound.joint_bound(run.time, true_states(run), current, command, record, noise, intensity, others=others)


def torsion_variance(run: Run, record: np.ndarray, intensity: float) -> np.ndarray:
    """Bound for the paper's model, shape (n,): random walk of the joint torque, encoders' noise through the stiffness."""
    p, noise = record[0], KnownJoint.of(run.joint).noise
    load = np.abs(run.truth("flexspline_torque"))
    stiffness = np.where(load < p["T1"], p["K1"], np.where(load < p["T2"], p["K2"], p["K3"]))
    unit = measurement_variance(
        1.0, noise.motor_resolution, noise.link_resolution, noise.link_noise, noise.motor_noise, ratio=float(p["N"])
    )
    V = unit * stiffness**2
    return bound.random_walk_bound(intensity**2 * (run.time[1] - run.time[0]), V, V[0])


def _binned(values: np.ndarray, size: int) -> np.ndarray:
    """Means of `size` samples; a rest at the end is left out."""
    whole = len(values) // size * size
    return values[:whole].reshape(-1, size).mean(axis=1)


class _Collected:
    """What is kept of one estimator from seed to seed: a few numbers and curves, not the signals."""

    def __init__(self, name: str, estimator: Estimator):
        self.name, self.estimator = name, estimator
        self.rms: list[float] = []
        self.squares: list[np.ndarray] = []
        self.nis: list[tuple[float, int, int]] = []
        self.nees: list[np.ndarray] = []
        self.nees_apart: list[np.ndarray] = []
        self.rho: list[np.ndarray] = []
        self.kept = 0

    def add(self, run: Run) -> None:
        """Run over one more seed."""
        kept = run.time >= run.scenario.transient
        size = round(BIN / (run.time[1] - run.time[0]))
        try:
            estimate = self.estimator.estimate(run.signals, run.known)
        except FilterDiverged:
            self.rms.append(np.nan)
            return
        error = estimate.mean - run.truth("joint_torque")
        self.rms.append(float(np.sqrt(np.mean(error[kept] ** 2))))
        self.squares.append(_binned(error**2, size))
        if estimate.variance is not None:
            nees = error**2 / np.maximum(estimate.variance, 1e-300)
            # One sample per bin: those of different seeds are independent.
            self.nees.append(nees[size // 2 :: size][: len(self.squares[-1])])
            self.nees_apart.append(nees[kept][:: round(_APART / (run.time[1] - run.time[0]))])
        e, S = estimate.innovation, estimate.innovation_covariance
        if e is not None and S is not None and self.estimator.causal:
            e, S = e[kept], S[kept]
            squares = consistency.normalised_squares(e, S)
            self.nis.append((float(np.mean(squares)), e.shape[1], len(e)))
            normal = e / np.sqrt(np.diagonal(S, axis1=1, axis2=2))
            channels = [consistency.autocorrelation(normal[:, i], LAGS) for i in range(e.shape[1])]
            self.rho.append(np.array(channels))
            self.kept = len(e)

    def assessment(self) -> Assessment:
        """Everything over the seeds."""
        error = np.sqrt(np.mean(self.squares, axis=0)) if self.squares else np.zeros(0)
        found = Assessment(self.name, self.estimator.causal, np.array(self.rms), error)
        if self.nees:
            nees = np.array(self.nees)
            found = replace(
                found,
                nees=consistency.mean_consistency(np.array(self.nees_apart), 1, samples=len(nees)),
                nees_over_time=nees.mean(axis=0),
                nees_share=consistency.share_inside(nees, 1),
            )
        if self.nis:
            mean, dof = float(np.mean([m for m, _, _ in self.nis])), self.nis[0][1]
            samples = sum(n for _, _, n in self.nis)
            rho = np.array(self.rho)  # (M, m, LAGS)
            worst = int(np.argmax(np.mean(rho**2, axis=(0, 2))))
            band = consistency.white_band(self.kept)
            found = replace(
                found,
                nis=consistency.mean_consistency(np.array([mean]), dof, samples=samples),
                autocorrelation=rho[:, worst].mean(axis=0),
                outside=float(np.mean(np.abs(rho[:, worst]) > band)),
                whiteness=float(np.mean([consistency.ljung_box(r, self.kept) for r in rho[:, worst]])),
            )
        return found
