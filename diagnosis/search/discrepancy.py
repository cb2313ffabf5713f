"""Unknown effects: a nonparametric model discrepancy, where it acts and on what it depends.

For every place in the joint (`models.parameters.PLACES`) and every variable (`VARIABLES`) a cubic spline is tried in the linear
model about a fit, with all other unknowns free: in addition to the causes found, and in place of some of them. The best few are
fitted through the replay, coefficients and everything else together. The best of these gives place and variable; the joint is
extended by its coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from scipy.interpolate import BSpline

from ...models.causes import put_discrepancy
from ...models.dual import LANES
from ...models.joint_parts import Discrepancy
from ...models.parameters import PLACES, VARIABLES
from ..data.segments import BALANCES, CURRENT, LINK, TORQUE, Segment
from ..fit.residual import Model, Problem
from ..fit.solver import Columns, Fit, Fitter, huber_weight, leverage_weight
from .contribution import alone, excess, made_by, noise_square
from .posterior import ModelPosterior
from .screen import plain_noise

SMALLEST = 0.01
"""RMS over the rated torque that an unknown effect must make, and that must be unexplained for one to be looked for in addition
to the causes: every real joint has smaller ones."""
MORE = 0.03  # part of what the causes explain (mean square) that must be unexplained for one to be tried in their place
SHARE = 0.3  # of the unexplained mean square that it must remove
THIN = 3  # every n-th residual is used at first
REFINED = 3  # candidates that are fitted through the replay
BEHIND = 50.0  # log posterior by which one may be less probable than the known causes and still be fitted again
ALIKE = 0.002  # difference of shares below which two places of a variable have the same residual


@dataclass(frozen=True)
class _Place:
    """A place in the joint: component, unit of an effect, prior standard deviation of a coefficient for a rated torque of 16 N·m,
    words; `inside`: of the transmission, so that it acts through the replay."""

    component: str
    unit: str
    scale: float
    words: str
    inside: bool = False


PLACE = {
    "rotor": _Place("motor", "N·m", 0.02, "a torque on the rotor"),
    "mesh": _Place("transmission", "N·m", 0.02, "a friction torque in the mesh", inside=True),
    "flexspline": _Place("transmission", "N·m", 2.0, "a flexspline torque", inside=True),
    "link": _Place("link", "N·m", 3.0, "a torque on the link"),
    "joint_torque": _Place("sensor", "N·m", 0.6, "an error of the torque sensor"),
    "link_position": _Place("sensor", "rad", 5e-4, "an error of the link encoder", inside=True),
    "motor_current": _Place("sensor", "A", 0.15, "an error of the current reading"),
}


@dataclass(frozen=True)
class _Variable:
    """A variable: coefficients of its spline, and the places where its effects usually sit, which decides between places with the
    same residual. A variable that moved less than `least` shows nothing. `turn`: its period [rad]. `slow`: it changes slowly
    against the wave generator, unlike the rotor's angle, and load, which an effect changes itself."""

    knots: int
    usual: tuple[str, ...]
    least: float = 0.0
    turn: float = 0.0
    slow: bool = False


VARIABLE = {
    "link_position": _Variable(32, ("link", "link_position"), least=0.02, slow=True),
    "motor_position": _Variable(24, ("rotor",), turn=2 * np.pi),
    "motor_position_two_turns": _Variable(32, ("flexspline", "link_position"), turn=4 * np.pi),
    "motor_velocity": _Variable(10, ("mesh",), least=1.0, slow=True),
    "load": _Variable(10, ("flexspline", "mesh", "joint_torque"), least=0.1),
    "time": _Variable(10, ("motor_current", "joint_torque"), least=1.0, slow=True),
    "direction_link_position": _Variable(32, ("mesh",), least=0.02),
}


@dataclass(frozen=True)
class Spline:
    """A discrepancy in a fit: its coordinates are its coefficients in units of their prior standard deviation.

    It has the interface of a hypothesis, and of its cause.
    """

    place: str
    variable: str
    low: float
    high: float
    count: int
    unit: float

    fixed: dict[str, float] = field(default_factory=dict)
    alternatives: int = 1

    name: ClassVar[str] = "unknown"
    free: ClassVar[list] = []
    adds: ClassVar[bool] = True
    ripple: ClassVar[bool] = False
    series: ClassVar[None] = None
    scales: ClassVar[tuple] = ()
    sets: ClassVar[dict[str, str]] = {}
    includes: ClassVar[str] = ""

    @property
    def cause(self) -> Spline:
        """Itself."""
        return self

    @property
    def key(self) -> tuple[Any, ...]:
        """Identity among hypotheses."""
        return (self.name, self.place, self.variable)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.count

    @property
    def magnitudes(self) -> list[int]:
        """All coordinates vanish with the effect."""
        return list(range(self.count))

    @property
    def spread(self) -> np.ndarray:
        """Prior standard deviation of each coordinate, shape (size,)."""
        return np.ones(self.count)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest coordinates, shape (size,) each."""
        return np.full(self.count, -1e3), np.full(self.count, 1e3)

    def values(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Return coefficients in the place's unit."""
        return {"coefficients": self.unit * np.asarray(u)}

    def apply(self, p: np.void, values: dict[str, np.ndarray]) -> None:
        """Put the spline into the first free place of a record."""
        put_discrepancy(p, self.place, self.variable, self.low, self.high, values["coefficients"])

    def basis(self, segment: Segment) -> np.ndarray:
        """Return values of the splines at a segment's residuals, shape (k, count)."""
        x = _values(self.variable, segment)
        B = spline_basis((x - self.low) / (self.high - self.low), self.count)
        return B * np.tanh(segment.motor_velocity)[:, None] if self.variable.startswith("direction") else B

    def as_discrepancy(self, u: np.ndarray) -> Discrepancy:
        """Return the entry of a joint's description."""
        return Discrepancy(
            place=self.place, variable=self.variable, low=self.low, high=self.high, unit=PLACE[self.place].unit,
            coefficients=[float(c) for c in self.values(u)["coefficients"]],
        )  # fmt: skip

    def along(self, problem: Problem, theta: np.ndarray, model: Model, directions: np.ndarray) -> Columns:
        """Return derivatives of the residuals in directions of its coordinates, shape (m, count), at a model without it."""
        whole = np.zeros((len(directions), len(theta) + self.count))
        whole[:, len(theta) :] = directions
        return problem.along(np.concatenate([theta, np.zeros(self.count)]), (*model, self), whole)  # type: ignore[arg-type]

    @property
    def component(self) -> str:
        """Component of the joint; a kinematic error is the gear's: no link encoder knows the motor's angle."""
        return "transmission" if self.kinematic else PLACE[self.place].component

    @property
    def usual(self) -> bool:
        """Whether effects of its variable usually sit there."""
        return self.place in VARIABLE[self.variable].usual

    @property
    def kinematic(self) -> bool:
        """Whether it is an angle error that returns with the motor."""
        return self.place == "link_position" and VARIABLE[self.variable].turn > 0.0

    def describe(self, u: np.ndarray) -> str:
        """Describe the effect in words."""
        curve = spline_basis(np.linspace(0.0, 1.0, 200), self.count) @ self.values(u)["coefficients"]
        what = "a kinematic error" if self.kinematic else PLACE[self.place].words
        variable = self.variable.replace("_two_turns", ", over two turns").replace("_", " ")
        return f"{what} of {float(np.ptp(curve)):.2g} {PLACE[self.place].unit} that depends on {variable}"


def depends_on(variable: str) -> tuple[str, ...]:
    """Return the measured variables of a discrepancy's variable."""
    if variable == "direction_link_position":
        return ("link_position", "direction")
    return (variable.removesuffix("_two_turns"),)


def spline_basis(u: np.ndarray, count: int) -> np.ndarray:
    """Cubic B-splines on a uniform grid at u in [0, 1], clamped, shape (k, count), as `models.laws` evaluates them."""
    knots = (np.arange(count + 4) - 3.0) / (count - 3)
    inside = np.clip(u, 0.0, 1.0)
    return BSpline.design_matrix(np.minimum(inside, 1.0 - 1e-12), knots, 3).toarray()


def _values(name: str, segment: Segment) -> np.ndarray:
    """Values of a variable at a segment's residuals, shape (k,)."""
    if turn := VARIABLE[name].turn:
        return segment.motor_position % turn
    if name == "time":
        return segment.at
    return getattr(segment, name.removeprefix("direction_"))


@dataclass(frozen=True)
class Candidate:
    """A discrepancy in the linear model about a fit.

    Attributes:
      spline: where it acts and on what it depends.
      without: indices of the model's causes that it replaces.
      share: of the mean square of the residual, each balance over its own, that it removes.
      score: log likelihood under white noise as loud as the residual, with the priors of its coefficients.
      coordinates, shift: its coefficients, and the change of the other unknowns.
    """

    spline: Spline
    without: tuple[int, ...]
    share: float
    score: float
    coordinates: np.ndarray
    shift: np.ndarray


def splines(problem: Problem) -> list[Spline]:
    """Return a spline for every place and variable that this measurement can show."""
    numbers = problem.joint.numbers
    rated = numbers["rated_torque"].value / 16.0
    found = []
    for variable in VARIABLES:
        about = VARIABLE[variable]
        values = [_values(variable, s) for s in problem.segments]
        low = 0.0 if about.turn else float(min(x.min() for x in values))
        high = about.turn or float(max(x.max() for x in values))
        if not high - low > about.least:
            continue
        for place in PLACES[1:]:
            if place == "joint_torque" and not problem.has_torque:
                continue
            if place in ("flexspline", "link_position") and not problem.link_measured:
                continue
            unit = PLACE[place].scale
            if place in ("rotor", "mesh"):
                unit *= rated * 100 / numbers["N"].value
            elif place == "motor_current":  # the rotor's current, so that neither is favoured
                unit = PLACE["rotor"].scale * rated * 100 / numbers["N"].value / numbers["Kt"].value
            elif place != "link_position":
                unit *= rated
            found.append(Spline(place, variable, low, high, about.knots, unit))
    return found


class FirstLook:
    """Approximate derivatives of the residuals in splines' coordinates about a model.

    Outside the transmission they have a closed form. Inside it, an effect of a slow variable acts as a constant one; for other
    variables every eighth coordinate moves at once, and a change belongs to the one that acts then or shortly before.
    """

    def __init__(self, problem: Problem, theta: np.ndarray, model: Model):
        self.problem, self.theta, self.model = problem, theta, model
        self._constant: dict[str, Columns] = {}

    def columns(self, spline: Spline) -> Columns:
        """Return derivatives, shape (k, len(BALANCES), count) a segment."""
        if not PLACE[spline.place].inside:
            return self._read_out(spline)
        if VARIABLE[spline.variable].slow:
            constant = zip(self._of_constant(spline), self.problem.segments, strict=True)
            return [J * spline.basis(segment)[:, None, :] for J, segment in constant]
        return self._together(spline)

    def _read_out(self, spline: Spline) -> Columns:
        """In closed form."""
        records, found = self.problem.records(self.theta, self.model), []
        for segment, record in zip(self.problem.segments, records, strict=True):
            p, B = record[0], spline.unit * spline.basis(segment)
            J = np.zeros((len(B), len(BALANCES), spline.count))
            if spline.place == "rotor":
                J[:, CURRENT] = B / p["Kt"]
            elif spline.place == "motor_current":
                J[:, CURRENT] = -B
            elif spline.place == "link":
                softer = segment.stiffness / (p["K1"] + p["K2"] + p["K3"])
                J[:, LINK] = B * (p["torque_gain"] if segment.has_torque else softer)
                if not segment.link_measured:
                    J[:, CURRENT] = B / (p["N"] * p["Kt"])
            elif segment.has_torque:
                J[:, TORQUE] = -B
                J[:, LINK] = -B
            found.append(np.where(segment.balances[:, None], J, 0.0))
        return found

    def _of_constant(self, spline: Spline) -> Columns:
        """Derivatives through the replay in a constant effect at the spline's place, shape (k, len(BALANCES), 1) a segment."""
        if spline.place not in self._constant:
            even = replace(spline, variable="time", low=0.0, high=1.0, count=4)
            self._constant[spline.place] = even.along(self.problem, self.theta, self.model, np.ones((1, 4)))
        return self._constant[spline.place]

    def _together(self, spline: Spline) -> Columns:
        """Derivatives through the replay, every `LANES`-th coordinate at a time: at any time four splines are not zero."""
        n = min(LANES, spline.count)
        sums = (np.arange(spline.count) % n == np.arange(n)[:, None]).astype(float)
        found = []
        moved = spline.along(self.problem, self.theta, self.model, sums)
        for segment, J in zip(self.problem.segments, moved, strict=True):
            u = np.clip((_values(spline.variable, segment) - spline.low) / (spline.high - spline.low), 0.0, 1.0)
            first = np.minimum((u * (spline.count - 3)).astype(int), spline.count - 4) - (n - 4) // 2
            whole = np.zeros((*J.shape[:2], spline.count))
            for lane in range(n):
                owner = first + (lane - first) % n
                there = np.flatnonzero((owner >= 0) & (owner < spline.count))
                whole[there, :, owner[there]] = J[there, :, lane]
            found.append(whole)
        return found


class _Plain:
    """The linear model about a fit under white noise as loud as its residual, on every `THIN`-th sample."""

    def __init__(self, problem: Problem, at: Fit):
        self.problem, self.at = problem, at
        noise = plain_noise(problem, at)
        self.rms = np.array([s.white for s in noise.sensors[0]])
        self.rows = self._rows(
            [np.concatenate([r[..., None], J], -1) for r, J in zip(at.point.residual, at.jacobian, strict=True)]
        )
        weight = huber_weight(self.rows[:, 0])
        self.root = np.sqrt(weight * leverage_weight(self.rows[:, 1 : problem.size + 1]))
        self.rows *= self.root[:, None]
        self.spread = problem.spread(at.model)

    def _rows(self, columns: Columns) -> np.ndarray:
        found = []
        for segment, x in zip(self.problem.segments, columns, strict=True):
            for b in range(len(BALANCES)):
                use = segment.usable[:, b] & ~segment.at_rest
                found.append(x[use][::THIN, b] / self.rms[b])
        return np.concatenate(found)

    def candidate(self, spline: Spline, columns: Columns, without: tuple[int, ...]) -> Candidate:
        """Return a spline in place of some of the model's causes."""
        problem, at = self.problem, self.at
        B = self._rows(columns) * self.root[:, None]
        r, kept = self.rows[:, 0], np.arange(len(at.theta))
        if without:
            own, kept, amount = alone(problem, at, *without)
            r = r - self.rows[:, 1 + own] @ amount
        J = self.rows[:, 1 + kept]
        X = np.concatenate([J, B], -1)
        precision = np.concatenate([1 / self.spread[kept] ** 2, np.ones(spline.count)])
        H = X.T @ X + np.diag(precision)
        g = X.T @ r + precision * np.concatenate([at.theta[kept], np.zeros(spline.count)])
        solution = -np.linalg.solve(H, g)
        left = r + X @ solution
        n = len(kept)
        scaled = H / np.sqrt(precision)[:, None] / np.sqrt(precision)
        cost = np.linalg.slogdet(scaled)[1] - np.linalg.slogdet(scaled[:n, :n])[1]
        score = 0.5 * len(r) * np.log(np.sum(self.rows[:, 0] ** 2) / np.sum(left**2)) - 0.5 * cost
        shift = np.zeros(len(at.theta))
        shift[kept] = solution[:n]
        share = 1 - float(np.sum(left**2) / max(np.sum(self.rows[:, 0] ** 2), 1e-300))
        return Candidate(spline, without, share, float(score), solution[n:], shift)


def find(fitter: Fitter, posterior: ModelPosterior, base: Fit, best: Fit) -> Fit | None:
    """Fit the unknown effect that is more probable than the best model of known causes, as the last effect of its model.

    It is tried in addition to these, and in place of the largest one, of all of its component, and of all. None if there is none,
    or if the residual is small.

    Args:
      base: the calibrated joint without causes.
    """
    problem = fitter.problem
    rated = problem.joint.numbers["rated_torque"].value
    left, least = excess(problem, best), max((SMALLEST * rated) ** 2, noise_square(problem, best))
    explained = excess(problem, base) - left
    full = not np.any(problem.records(best.theta, best.model)[0][0]["discrepancy_place"] == 0)
    in_addition, instead = left > least, explained > least and left > MORE * explained
    drops = [without for without in _drops(problem, best) if (instead if without else in_addition)]
    if full or not drops:
        return None
    plain, look = _Plain(problem, best), FirstLook(problem, best.theta, best.model)
    tried: list[Candidate] = []
    for spline in splines(problem):
        columns = look.columns(spline)
        if all(np.isfinite(c).all() for c in columns):  # else the replay does not follow it
            tried += [plain.candidate(spline, columns, without) for without in drops]
    found = []
    for without in drops:
        for candidate in _promising([c for c in tried if c.without == without]):
            f = _refined(fitter, best, candidate)
            found.append((posterior.judge(f).score, f))
    # The derivatives were taken far from these fits: the most probable are fitted again with their own.
    now = posterior.judge(best).score
    found.sort(key=lambda x: -x[0])
    for _, f in [x for x in found[:REFINED] if x[0] > now - BEHIND]:
        f = fitter.fit(f.model, f.theta, None, 6, best)
        found.append((posterior.judge(f).score, f))
    named = [
        (score, f) for score, f in found
        if score > now
        and left - excess(problem, f) > SHARE * left
        and made_by(problem, f, -1) > (SMALLEST * rated) ** 2
    ]  # fmt: skip
    return max(named, key=lambda x: x[0])[1] if named else None


def _promising(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the best in the linear model; of places with the same residual the usual one."""
    found: list[Candidate] = []
    for c in sorted(candidates, key=lambda c: -c.score):
        same = [f for f in found if f.spline.variable == c.spline.variable and abs(f.share - c.share) < ALIKE]
        if not same:
            found.append(c)
        elif c.spline.usual and not same[0].spline.usual:
            found[found.index(same[0])] = c
        if len(found) > REFINED:
            break
    return found[:REFINED]


def _drops(problem: Problem, best: Fit) -> list[tuple[int, ...]]:
    """Sets of causes that an unknown effect may replace: none, the largest one, all of its component, all."""
    if not best.model:
        return [()]
    top = int(np.argmax([made_by(problem, best, i) for i in range(len(best.model))]))
    component = best.model[top].cause.component
    same = tuple(i for i, h in enumerate(best.model) if h.cause.component == component)
    return list(dict.fromkeys([(), (top,), same, tuple(range(len(best.model)))]))


def _refined(fitter: Fitter, best: Fit, candidate: Candidate) -> Fit:
    """Fit a candidate through the replay."""
    problem = fitter.problem
    kept = [i for i in range(len(best.model)) if i not in candidate.without]
    places = [problem.place(best.model, i) for i in kept]
    index = np.concatenate([np.arange(problem.size), *(np.arange(p.start, p.stop) for p in places)]).astype(int)
    model: Model = tuple(best.model[i] for i in kept)
    start = np.concatenate([(best.theta + candidate.shift)[index], candidate.coordinates])
    near = replace(best, model=model, theta=best.theta[index], jacobian=[J[..., index] for J in best.jacobian])
    return fitter.fit((*model, candidate.spline), start, near, 4, best)  # type: ignore[arg-type]
