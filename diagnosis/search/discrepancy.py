"""What no known cause explains: a nonparametric term, where it acts and on what it depends.

For every place in the joint (`models.parameters.PLACES`) and every variable (`VARIABLES`) a cubic spline is tried, with
all calibration variables free: its marginal likelihood, linear about the fitted joint, in closed form. The best few are
fitted through the replay, coefficients and calibration together (`refine`). The best of these is where the discrepancy
sits and what it depends on; with its coefficients the joint is extended all the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..models.joint import Joint, Term
from ..models.parameters import PLACES, VARIABLES
from .calibrate import HUBER, Fit, Problem, bounded_step, bounds, robust_loss
from .noise import Noise, louder, whiten

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
COUNT = {"link_position": 32, "motor_position": 24, "direction_link_position": 32, "motor_position_two_turns": 32}
_COUNT = 10
PENALTY = 8.0
"""Log prior odds of a known cause against an unknown term."""
_USUAL = {
    "link_position": ("link", "link_position"),
    "motor_position": ("rotor",),
    "motor_position_two_turns": ("flexspline", "link_position"),
    "motor_velocity": ("mesh",),
    "load": ("flexspline", "mesh", "joint_torque"),
    "time": ("motor_current", "joint_torque"),
    "direction_link_position": ("mesh",),
}
"""Where an effect of each variable usually sits: places that the same residual fits are told apart by that alone."""
UNUSUAL = 8.0
"""Log prior odds of a usual place against another."""
_SMALLEST_RANGE = {
    "link_position": 0.02,
    "direction_link_position": 0.02,
    "motor_velocity": 1.0,
    "load": 0.1,
    "time": 1.0,
}
"""A variable that moved less than this has shown nothing."""


@dataclass(frozen=True)
class Candidate:
    """A term, the log evidence that it adds, and the linear estimate of its coefficients and of the other unknowns."""

    term: Term
    gain: float
    theta: np.ndarray

    @property
    def component(self) -> str:
        """Component in which the term sits."""
        return "transmission" if _kinematic(self.term) else COMPONENT[self.term.place]


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
    if name == "motor_position_two_turns":
        return theta_m % (4 * np.pi)
    if name == "motor_velocity":
        return velocity
    if name == "time":
        return drive.at
    return drive.load


def _range(name: str, problem: Problem) -> tuple[float, float]:
    if name == "motor_position":
        return 0.0, float(2 * np.pi)
    if name == "motor_position_two_turns":
        return 0.0, float(4 * np.pi)
    values = np.concatenate([_variable(name, d) for d in problem.drives])
    return float(values.min()), float(values.max())


def candidates(problem: Problem, noise: Noise, at: Fit) -> list[Candidate]:
    """Every term that can be tried on top of a fit, best first."""
    n = at.jacobian[0].shape[-1]
    records = problem.records(at.theta, at.model)
    if not np.any(records[0][0]["term_place"] == 0):  # no room for another
        return []
    pieces: list[tuple[str, str, float, float, int]] = []
    columns: list[list[np.ndarray]] = []
    for variable in VARIABLES:
        low, high = _range(variable, problem)
        if not high - low > _SMALLEST_RANGE.get(variable, 0.0):
            continue
        count = COUNT.get(variable, _COUNT)
        bases = _bases(problem, variable, low, high, count)
        for place in PLACES[1:]:
            if place == "joint_torque" and not problem.has_torque:
                continue
            pieces.append((place, variable, low, high, count))
            columns.append(_columns(problem, records, at, place, variable, low, high, count, bases))
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
        spread = np.concatenate([problem.spread(at.model), np.full(count, _scale(place, records))])
        XW = X * weight[:, None]
        H = XW.T @ X + np.diag(1 / spread**2)
        g = XW.T @ r + np.concatenate([at.theta / spread[:n] ** 2, np.zeros(count)])
        gain = 0.5 * (g @ np.linalg.solve(H, g) - g[:n] @ np.linalg.solve(H[:n, :n], g[:n]))
        scaled = H * spread[:, None] * spread
        gain -= 0.5 * (np.linalg.slogdet(scaled)[1] - np.linalg.slogdet(scaled[:n, :n])[1])
        gain -= prior(place, variable)
        solution = -np.linalg.solve(H, g)
        term = Term(
            place=place, variable=variable, low=low, high=high, unit=UNIT[place],
            coefficients=[float(c) for c in solution[n:]],
        )  # fmt: skip
        found.append(Candidate(term, float(gain), at.theta + solution[:n]))
    return sorted(found, key=lambda c: -c.gain)


def prior(place: str, variable: str) -> float:
    """Minus the log prior of a place and a variable."""
    return 0.0 if place in _USUAL[variable] else UNUSUAL


def _scale(place: str, records) -> float:
    """Prior standard deviation of a coefficient; of the current what the rotor's would draw, so that neither is favoured."""
    return SCALE["rotor"] / float(records[0][0]["Kt"]) if place == "motor_current" else SCALE[place]


def _bases(problem: Problem, variable: str, low: float, high: float, count: int) -> list[np.ndarray]:
    bases = []
    for drive in problem.drives:
        B = _basis((_variable(variable, drive) - low) / (high - low), count)
        if variable == "direction_link_position":
            B *= np.tanh(drive.state[:, 2])[:, None]
        bases.append(B)
    return bases


def _columns(problem, records, at, place, variable, low, high, count, bases) -> list[np.ndarray]:
    """Derivatives of the residuals in a term's coefficients."""
    if place in ("mesh", "flexspline", "link_position"):
        return _replayed(problem, records, at, place, variable, low, high, count, bases)
    return _direct(problem, records, place, bases)


@dataclass(frozen=True)
class Refined:
    """A term fitted together with everything else.

    Attributes:
      candidate: the term, its coefficients as fitted.
      fit: calibration and effects beside it.
      gain: log evidence over the fit that it started from, under the noise that it was judged with.
    """

    candidate: Candidate
    fit: Fit
    gain: float
    columns: list[np.ndarray]
    scale: float

    def score(self, problem: Problem, noise: Noise, temper: float) -> float:
        """Log evidence under a noise, with the prior of place and variable `temper` times as strong."""
        t = self.candidate.term
        found = score(problem, noise, self.fit, self.columns, np.array(t.coefficients), self.scale)
        return found - temper * prior(t.place, t.variable)


def score(problem: Problem, noise: Noise, f: Fit, columns=None, coefficients=None, scale: float = 1.0) -> float:
    """Log evidence (Laplace) of a fit, of a term's coefficients with it; comparable under the same noise."""
    n = f.jacobian[0].shape[-1]
    H, _, loss = _normal(problem, noise, f.model, f.theta, f.state[0], f.jacobian, columns, coefficients, scale)
    spread = problem.spread(f.model)
    cost = loss + float(np.sum((f.theta / spread) ** 2))
    if columns is not None:
        spread = np.concatenate([spread, np.full(len(H) - n, scale)])
        cost += float(np.sum((coefficients / scale) ** 2))
    logdet = np.linalg.slogdet(H * spread[:, None] * spread)[1]
    return -0.5 * (cost + logdet) - sum(np.log(h.alternatives) for h in f.model)


def _normal(problem, noise, model, theta, residuals, jacobian, columns, coefficients, scale):
    """Hessian, gradient (of half the objective) in unknowns and coefficients, and the robust loss."""
    parts = [[r[..., None], j] for r, j in zip(residuals, jacobian, strict=True)]
    weight, at = 1 / problem.spread(model) ** 2, theta
    if columns is not None:
        for part, c in zip(parts, columns, strict=True):
            part.append(c)
        weight = np.concatenate([weight, np.full(len(coefficients), scale**-2)])
        at = np.concatenate([theta, coefficients])
    stack = whiten(problem.drives, noise, [np.concatenate(part, -1) for part in parts])
    r, X = stack[:, 0], stack[:, 1:]
    loss, w = robust_loss(r, HUBER)
    XW = X * w[:, None]
    return XW.T @ X + np.diag(weight), XW.T @ r + weight * at, loss


def refine(problem: Problem, noise: Noise, at: Fit, candidate: Candidate, level, rounds: int = 5) -> Refined:
    """Fit a term's coefficients, calibration and effects together, by Gauss–Newton through the replay.

    Args:
      at: the fit on top of which the term was found.
      level: how much louder than `noise` a fit's residual is, a function of problem, noise and fit.
    """
    term, n = candidate.term, len(at.theta)
    place, variable, count = term.place, term.variable, len(term.coefficients)
    scale = _scale(place, problem.records(at.theta, at.model))
    bases = _bases(problem, variable, term.low, term.high, count)
    low, high = (
        np.concatenate([b, np.full(count, s * np.inf)]) for b, s in zip(bounds(problem, at.model), (-1, 1), strict=True)
    )

    def with_coefficients(c):
        moved = term.model_copy(update={"coefficients": [float(x) for x in c]})
        return Problem(problem.drives, problem.twins, extend(problem.joint, replace(candidate, term=moved))), moved

    x = np.concatenate([at.theta, np.zeros(count)])
    step = np.clip(np.concatenate([candidate.theta, term.coefficients]), low, high) - x
    residuals, jacobian = at.state[0], at.jacobian
    for k in range(rounds + 1):
        loud = louder(noise, level(problem, noise, replace(at, state=(residuals, None))))
        best = _objective(problem, loud, at.model, x, residuals, scale)
        accepted = False
        for part in (1.0, 0.4, 0.1):
            tried = np.clip(x + part * step, low, high)
            extended, _ = with_coefficients(tried[n:])
            rs = extended.residuals([tried[:n]], [at.model])[0]
            cost = _objective(problem, loud, at.model, tried, rs, scale)
            if cost < best:
                x, residuals, accepted = tried, rs, True
                break
        gained = best - cost
        extended, moved = with_coefficients(x[n:])
        here = replace(at, theta=x[:n], state=(residuals, None))
        if (k and (not accepted or gained < 2.0)) or k == rounds:
            break
        jacobian = extended.jacobian(x[:n], at.model, residuals)
        here = replace(here, jacobian=jacobian)
        columns = _columns(
            extended, extended.records(x[:n], at.model), here, place, variable, term.low, term.high, count, bases
        )
        loud = louder(noise, level(problem, noise, here))
        H, g, _ = _normal(problem, loud, at.model, x[:n], residuals, jacobian, columns, x[n:], scale)
        step = bounded_step(H, g, low - x, high - x)
    loudness = level(problem, noise, here)
    judged = louder(noise, loudness)
    H, _, _ = _normal(problem, judged, at.model, x[:n], residuals, jacobian, columns, x[n:], scale)
    here = replace(
        here, jacobian=jacobian, twin_jacobian=None, covariance=np.linalg.inv(H)[:n, :n], state=(residuals, None)
    )
    evidence = score(problem, judged, here, columns, x[n:], scale) - prior(place, variable)
    here = replace(here, log_evidence=evidence)
    gain = evidence - score(problem, judged, at)
    return Refined(replace(candidate, term=moved, theta=x[:n]), here, gain, columns, scale)


def narrowed(refined: Refined) -> Candidate | None:
    """The same term with its knots where its function varies, None where that is nearly everywhere."""
    t = refined.candidate.term
    if t.variable not in ("link_position", "direction_link_position"):
        return None
    c = np.array(t.coefficients)
    change = np.cumsum(np.abs(np.diff(c)))
    inside = np.flatnonzero((change > 0.08 * change[-1]) & (change < 0.92 * change[-1]))
    knots = t.low + (np.arange(len(c)) - 1) / (len(c) - 3) * (t.high - t.low)
    step = knots[1] - knots[0]
    if not len(inside):
        return None
    low, high = max(t.low, knots[inside[0]] - 3 * step), min(t.high, knots[inside[-1] + 1] + 3 * step)
    if high - low > 0.7 * (t.high - t.low):
        return None
    at = low + (np.arange(len(c)) - 1) / (len(c) - 3) * (high - low)
    values = [float(v) for v in np.interp(at, knots, c)]
    term = t.model_copy(update={"low": float(low), "high": float(high), "coefficients": values})
    return replace(refined.candidate, term=term)


def _objective(problem, noise, model, x, residuals, scale) -> float:
    r = whiten(problem.drives, noise, [a[..., None] for a in residuals])[:, 0]
    spread = np.concatenate([problem.spread(model), np.full(len(x) - len(problem.spread(model)), scale)])
    total = robust_loss(r)[0] + float(np.sum((x / spread) ** 2))
    return total if np.isfinite(total) else np.inf


def _direct(problem: Problem, records, place: str, bases: list[np.ndarray]) -> list[np.ndarray]:
    """Derivatives where the term enters a residual as it is."""
    found = []
    for drive, record, B in zip(problem.drives, records, bases, strict=True):
        p = record[0]
        J = np.zeros((len(B), 3, B.shape[1]))
        if place == "rotor":
            J[:, 0] = B / p["Kt"]
        elif place == "link":
            J[:, 2] = B * (p["torque_gain"] if len(drive.torque) else drive.stiffness / (p["K1"] + p["K2"] + p["K3"]))
        elif place == "motor_current":
            J[:, 0] = -B
        elif len(drive.torque):
            J[:, 1] = -B
            J[:, 2] = -B
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
    done = iter(problem.replayed(tasks))
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
    size = float(np.ptp(_basis(np.linspace(0.0, 1.0, 200), len(t.coefficients)) @ np.array(t.coefficients)))
    what = {
        "rotor": "a torque on the rotor", "mesh": "a friction torque in the mesh", "flexspline": "a flexspline torque",
        "link": "a torque on the link", "joint_torque": "an error of the torque sensor",
        "link_position": "a kinematic error" if _kinematic(t) else "an error of the link encoder",
        "motor_current": "an error of the current reading",
    }[t.place]  # fmt: skip
    return f"{what} of {size:.2g} {t.unit} that depends on {_words(t.variable)}"


def _kinematic(term: Term) -> bool:
    """Whether an angle error returns with the motor: no link encoder knows the motor's angle, but the gear does."""
    return term.place == "link_position" and term.variable.startswith("motor_position")


def _words(variable: str) -> str:
    return {"motor_position_two_turns": "motor position, over two turns"}.get(variable, variable.replace("_", " "))


def depends_on(variable: str) -> tuple[str, ...]:
    """Names of the measured variables that a term's variable is made of."""
    return {
        "direction_link_position": ("link_position", "direction"),
        "motor_position_two_turns": ("motor_position",),
    }.get(variable, (variable,))
