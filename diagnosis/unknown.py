"""What no known cause explains: a nonparametric term, where it acts and on what it depends.

For every place in the joint (`models.parameters.PLACES`) and every variable (`VARIABLES`) a cubic spline is tried, with
all calibration variables free: its marginal likelihood, linear about the fitted joint, in closed form. The best is
where the discrepancy sits and what it depends on; with its coefficients the joint is extended all the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..models.joint import Joint, Term
from ..models.parameters import PLACES, VARIABLES
from .calibrate import Fit, Problem, robust_loss
from .noise import Noise, whiten
from .replay import parallel

COMPONENT = {
    "rotor": "motor", "mesh": "transmission", "flexspline": "transmission", "link": "link",
    "joint_torque": "sensor", "link_position": "sensor", "motor_current": "sensor",
}  # fmt: skip
UNIT = {
    "rotor": "N·m", "mesh": "N·m", "flexspline": "N·m", "link": "N·m",
    "joint_torque": "N·m", "link_position": "rad", "motor_current": "A",
}  # fmt: skip
SCALE = {
    "rotor": 0.02, "mesh": 0.02, "flexspline": 2.0, "link": 3.0,
    "joint_torque": 0.6, "link_position": 5e-4, "motor_current": 0.15,
}  # fmt: skip
"""Prior standard deviation of a coefficient, in the unit of the place."""
COUNT = {"link_position": 28, "motor_position": 24, "direction_link_position": 28}
_COUNT = 10
PENALTY = 8.0
"""Log prior odds of a known cause against an unknown term."""


@dataclass(frozen=True)
class Candidate:
    """A term, the log evidence that it adds, and the linear estimate of its coefficients and of the other unknowns."""

    term: Term
    gain: float
    theta: np.ndarray

    @property
    def component(self) -> str:
        """Component in which the term sits."""
        return COMPONENT[self.term.place]


def _basis(u: np.ndarray, count: int) -> np.ndarray:
    """Cubic B-splines at u in [0, 1], shape (k, count), as `models.laws` evaluates them."""
    s = np.clip(u, 0.0, 1.0) * (count - 3)
    i = np.minimum(s.astype(int), count - 4)
    t = s - i
    a = 1.0 - t
    weights = (a**3, 3 * t**3 - 6 * t**2 + 4, 3 * a**3 - 6 * a**2 + 4, t**3)
    B = np.zeros((len(u), count))
    for m, weight in enumerate(weights):
        B[np.arange(len(u)), i + m] = weight / 6.0
    return B


def _variable(name: str, drive) -> np.ndarray:
    theta_m, theta_l, velocity = drive.state[:, 0], drive.state[:, 1], drive.state[:, 2]
    if name in ("link_position", "direction_link_position"):
        return theta_l
    if name == "motor_position":
        return theta_m % (2 * np.pi)
    if name == "motor_velocity":
        return velocity
    if name == "time":
        return drive.at
    if len(drive.torque):
        return drive.measured[:, 1]
    return drive.gravity_moment * np.sin(theta_l) + drive.inertia * drive.state[:, 4]


def _range(name: str, problem: Problem) -> tuple[float, float]:
    if name == "motor_position":
        return 0.0, float(2 * np.pi)
    values = np.concatenate([_variable(name, d) for d in problem.drives])
    return float(values.min()), float(values.max())


def candidates(problem: Problem, noise: Noise, at: Fit) -> list[Candidate]:
    """Every term that can be tried on top of a fit, best first."""
    n = at.jacobian[0].shape[-1]
    records = problem.records(at.theta, at.model)
    pieces: list[tuple[str, str, float, float, int]] = []
    columns: list[list[np.ndarray]] = []
    for variable in VARIABLES:
        low, high = _range(variable, problem)
        count = COUNT.get(variable, _COUNT)
        bases = []
        for drive in problem.drives:
            B = _basis((_variable(variable, drive) - low) / (high - low), count)
            if variable == "direction_link_position":
                B *= np.tanh(drive.state[:, 2])[:, None]
            bases.append(B)
        for place in PLACES[1:]:
            if place == "joint_torque" and not problem.has_torque:
                continue
            pieces.append((place, variable, low, high, count))
            if place in ("mesh", "flexspline", "link_position"):
                columns.append(_replayed(problem, records, at, place, variable, low, high, count, bases))
            else:
                columns.append(_direct(problem, records, place, bases))
    found = []
    for piece, column in zip(pieces, columns, strict=True):
        place, variable, low, high, count = piece
        stack = whiten(
            problem.drives,
            noise,
            [
                np.concatenate([r[..., None], j, c], -1)
                for r, j, c in zip(at.state[0], at.jacobian, column, strict=True)
            ],
        )
        r, X = stack[:, 0], stack[:, 1:]
        _, weight = robust_loss(r)
        spread = np.concatenate([problem.spread(at.model), np.full(count, SCALE[place])])
        XW = X * weight[:, None]
        H = XW.T @ X + np.diag(1 / spread**2)
        g = XW.T @ r + np.concatenate([at.theta / spread[:n] ** 2, np.zeros(count)])
        gain = 0.5 * (g @ np.linalg.solve(H, g) - g[:n] @ np.linalg.solve(H[:n, :n], g[:n]))
        scaled = H * spread[:, None] * spread
        gain -= 0.5 * (np.linalg.slogdet(scaled)[1] - np.linalg.slogdet(scaled[:n, :n])[1])
        solution = -np.linalg.solve(H, g)
        term = Term(
            place=place, variable=variable, low=low, high=high, unit=UNIT[place],
            coefficients=[float(c) for c in solution[n:]],
        )  # fmt: skip
        found.append(Candidate(term, float(gain), at.theta + solution[:n]))
    return sorted(found, key=lambda c: -c.gain)


def _direct(problem: Problem, records, place: str, bases: list[np.ndarray]) -> list[np.ndarray]:
    """Derivatives where the term enters a residual as it is."""
    found = []
    for drive, record, B in zip(problem.drives, records, bases, strict=True):
        p = record[0]
        J = np.zeros((len(B), 3, B.shape[1]))
        if place == "rotor":
            J[:, 0] = B / p["Kt"]
        elif place == "link":
            J[:, 2] = B
        elif place == "motor_current":
            J[:, 0] = -B
        elif len(drive.torque):
            J[:, 1] = -B
            J[:, 2] = -B / p["torque_gain"]
        found.append(J)
    return found


def _replayed(problem, records, at, place, variable, low, high, count, bases) -> list[np.ndarray]:
    """Derivatives through the replay: every fourth spline at a time, as their supports do not overlap."""
    tasks = []
    for colour in range(4):
        for drive, record in zip(problem.drives, records, strict=True):
            moved = record.copy()
            p = moved[0]
            slot = int(np.flatnonzero(p["term_place"] == 0)[0])
            p["term_place"][slot], p["term_variable"][slot] = PLACES.index(place), VARIABLES.index(variable)
            p["term_low"][slot], p["term_high"][slot], p["term_count"][slot] = low, high, count
            p["term_coefficient"][slot, :count] = _PROBE * SCALE[place] * (np.arange(count) % 4 == colour)
            tasks.append((drive, moved, at.theta))
    done = iter(parallel(problem._one, tasks))
    found = [np.zeros((len(B), 3, count)) for B in bases]
    for colour in range(4):
        for s, drive in enumerate(problem.drives):
            change = (next(done) - at.state[0][s]) / (_PROBE * SCALE[place])
            u = np.clip((_variable(variable, drive) - low) / (high - low), 0.0, 1.0)
            first = np.minimum((u * (count - 3)).astype(int), count - 4)
            owner = first + (colour - first) % 4
            found[s][np.arange(len(owner)), :, owner] = change
    return found


_PROBE = 0.05


def extend(joint: Joint, candidate: Candidate) -> Joint:
    """The joint with the term in it."""
    terms = [*joint.terms, candidate.term]
    extended = joint.model_copy(update={"terms": terms})
    extended._path = joint._path
    return extended


def describe(candidate: Candidate) -> str:
    """The term in a sentence."""
    t = candidate.term
    size = float(np.ptp(t.coefficients))
    what = {
        "rotor": "a torque on the rotor", "mesh": "a friction torque in the mesh", "flexspline": "a flexspline torque",
        "link": "a torque on the link", "joint_torque": "an error of the torque sensor",
        "link_position": "an error of the link encoder", "motor_current": "an error of the current reading",
    }[t.place]  # fmt: skip
    return f"{what} of {size:.2g} {t.unit} that depends on {t.variable.replace('_', ' ')}"
