"""What no known cause explains: a nonparametric model discrepancy, where it acts and on what it depends.

For every place in the joint (`models.parameters.PLACES`) and every variable (`VARIABLES`) a cubic spline is tried in the
linear model about a fit, with all other unknowns free: on top of the causes that were found, and in place of some of them. The
best few are fitted through the replay, coefficients and everything else together. The best of these is where the discrepancy
sits and what it depends on; with its coefficients the joint is extended all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from scipy.interpolate import BSpline

from ...models.causes import put_discrepancy
from ...models.dual import LANES
from ...models.joint import Joint
from ...models.joint_parts import Discrepancy
from ...models.parameters import PLACES, VARIABLES
from ..data.segments import BALANCES, CURRENT, LINK, TORQUE, Segment
from ..fit.residual import Model, Problem
from ..fit.solver import SETTINGS as SOLVER
from ..fit.solver import Columns, Fit, Fitter, huber_weight, leverage_weight
from .posterior import ModelPosterior
from .screen import plain_noise
from .worth import alone, left_by, made_by, noise_of

COMPONENT = {
    "rotor": "motor", "mesh": "transmission", "flexspline": "transmission", "link": "link",
    "joint_torque": "sensor", "link_position": "sensor", "motor_current": "sensor",
}  # fmt: skip
UNIT = {
    "rotor": "N·m", "mesh": "N·m", "flexspline": "N·m", "link": "N·m",
    "joint_torque": "N·m", "link_position": "rad", "motor_current": "A",
}  # fmt: skip
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
_SMALLEST_RANGE = {
    "link_position": 0.02, "direction_link_position": 0.02, "motor_velocity": 1.0, "load": 0.1, "time": 1.0,
}  # fmt: skip
"""A variable that moved less than this has shown nothing."""
_TURNS = {"motor_position": 2 * np.pi, "motor_position_two_turns": 4 * np.pi}
_INSIDE = ("mesh", "flexspline", "link_position")
"""Places inside the transmission: what acts there goes through the replay."""
_SLOW = ("link_position", "motor_velocity", "time")
"""Variables that change slowly beside the wave generator between measured ends: not what turns with the velocity, the rotor's
angle, or load, which an effect there changes itself."""


@dataclass(frozen=True)
class DiscrepancySettings:
    """How unknown effects are looked for.

    Attributes:
      worth: root mean square, as a share of the rated torque, that one must make, and that must be left unexplained beyond the
        noise for one to be looked for beside the causes: of what is less every real joint has a little.
      more: part of what the causes explain (mean square) that must be left for one to be looked for in their place.
      share: of the mean square that is left unexplained that one must remove to be named.
      thin: every n-th residual is looked at first.
      refined: candidates that are fitted through the replay.
      alike: difference of their shares below which two places of a variable are the same residual.
      knots: coefficients of a spline by variable.
      scale: prior standard deviation of a coefficient by place, for a rated torque of 16 N·m.
    """

    worth: float = 0.01
    more: float = 0.03
    share: float = 0.3
    thin: int = 3
    refined: int = 3
    alike: float = 0.002
    knots: dict[str, int] = field(
        default_factory=lambda: {
            "link_position": 32, "motor_position": 24, "direction_link_position": 32, "motor_position_two_turns": 32,
            "motor_velocity": 10, "load": 10, "time": 10,
        }
    )  # fmt: skip
    scale: dict[str, float] = field(
        default_factory=lambda: {
            "rotor": 0.02, "mesh": 0.02, "flexspline": 2.0, "link": 3.0, "joint_torque": 0.6, "link_position": 5e-4,
            "motor_current": 0.15,
        }
    )  # fmt: skip


SETTINGS = DiscrepancySettings()


@dataclass(frozen=True)
class Spline:
    """A discrepancy as a fit sees it: its coefficients are its coordinates, in units of their prior standard deviation.

    It stands in a model beside hypotheses of causes and has what a fit asks of them.
    """

    place: str
    variable: str
    low: float
    high: float
    count: int
    unit: float

    fixed: dict[str, float] = field(default_factory=dict)
    alternatives: int = 1

    @property
    def cause(self) -> Spline:
        """Itself: it applies its own values."""
        return self

    @property
    def name(self) -> str:
        """As causes have one."""
        return "unknown"

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells it from hypotheses of causes."""
        return (self.name, self.place, self.variable)

    adds = True
    ripple = False
    series = None
    scales = ()
    sets: ClassVar[dict[str, str]] = {}

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.count

    @property
    def magnitudes(self) -> list[int]:
        """All coordinates vanish with the effect."""
        return list(range(self.count))

    @property
    def free(self) -> list:
        """It has no named parameters."""
        return []

    @property
    def spread(self) -> np.ndarray:
        """Prior standard deviation of each coordinate, shape (size,)."""
        return np.ones(self.count)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates are free."""
        return np.full(self.count, -1e3), np.full(self.count, 1e3)

    def values(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Coefficients in the place's unit."""
        return {"coefficients": self.unit * np.asarray(u)}

    def apply(self, p: np.void, values: dict[str, np.ndarray]) -> None:
        """Put the spline into the first free place of a record."""
        put_discrepancy(p, self.place, self.variable, self.low, self.high, values["coefficients"])

    def basis(self, segment: Segment) -> np.ndarray:
        """Values of the splines at a segment's residuals, shape (k, count)."""
        x = _variable(self.variable, segment)
        B = spline_basis((x - self.low) / (self.high - self.low), self.count)
        return B * np.tanh(segment.motor_velocity)[:, None] if self.variable.startswith("direction") else B

    def as_discrepancy(self, u: np.ndarray) -> Discrepancy:
        """As a joint's description states it."""
        return Discrepancy(
            place=self.place, variable=self.variable, low=self.low, high=self.high, unit=UNIT[self.place],
            coefficients=[float(c) for c in self.values(u)["coefficients"]],
        )  # fmt: skip

    def derivatives(self, problem: Problem, theta: np.ndarray, model: Model) -> Columns:
        """Derivatives of the residuals in its coordinates, at a model without it or with it, shape (k, len(BALANCES), count) a
        segment."""
        return self.along(problem, theta, model, np.eye(self.count))

    def along(self, problem: Problem, theta: np.ndarray, model: Model, directions: np.ndarray) -> Columns:
        """Likewise in directions of its coordinates, shape (m, count)."""
        index = next((i for i, h in enumerate(model) if h is self), len(model))
        if index == len(model):
            theta, model = np.concatenate([theta, np.zeros(self.count)]), (*model, self)  # type: ignore[arg-type]
        whole = np.zeros((len(directions), len(theta)))
        whole[:, problem.place(model, index)] = directions
        return problem.along(theta, model, whole)

    @property
    def component(self) -> str:
        """Component of the joint in which it sits. An angle error that returns with the motor is the gear's: no link encoder
        knows the motor's angle."""
        return "transmission" if self.kinematic else COMPONENT[self.place]

    @property
    def usual(self) -> bool:
        """Whether effects of its variable usually sit there."""
        return self.place in _USUAL[self.variable]

    @property
    def kinematic(self) -> bool:
        """Whether it is an angle error that returns with the motor."""
        return self.place == "link_position" and self.variable in _TURNS


def spline_basis(u: np.ndarray, count: int) -> np.ndarray:
    """Cubic B-splines on a uniform grid at u in [0, 1], clamped, shape (k, count), as `models.laws` evaluates them."""
    knots = (np.arange(count + 4) - 3.0) / (count - 3)
    inside = np.clip(u, 0.0, 1.0)
    return BSpline.design_matrix(np.minimum(inside, 1.0 - 1e-12), knots, 3).toarray()


def _variable(name: str, segment: Segment) -> np.ndarray:
    if name in _TURNS:
        return segment.motor_position % _TURNS[name]
    return {
        "link_position": segment.link_position, "direction_link_position": segment.link_position,
        "motor_velocity": segment.motor_velocity, "time": segment.at, "load": segment.load,
    }[name]  # fmt: skip


def _range(name: str, problem: Problem) -> tuple[float, float]:
    if name in _TURNS:
        return 0.0, float(_TURNS[name])
    values = np.concatenate([_variable(name, s) for s in problem.segments])
    return float(values.min()), float(values.max())


@dataclass(frozen=True)
class Candidate:
    """A discrepancy in the linear model about a fit.

    Attributes:
      spline: where it acts and on what it depends.
      without: indices of the model's causes in whose place it stands.
      more: part of what the causes explain (mean square) that must be left for one to be looked for in their place.
      share: of the mean square of the residual, each balance over its own, that it takes away.
      score: by which candidates are ranked: log likelihood under white noise as loud as the residual, with the priors of its
        coefficients.
      coordinates, shift: its coefficients, and the change of the unknowns that stay.
    """

    spline: Spline
    without: tuple[int, ...]
    share: float
    score: float
    coordinates: np.ndarray
    shift: np.ndarray


@dataclass(frozen=True)
class Unknown:
    """An unknown effect that was found.

    Attributes:
      spline: where it acts and on what it depends.
      fit: of the model with it as its last effect.
      gain: log posterior over the best model of known causes.
    """

    spline: Spline
    fit: Fit
    gain: float

    @property
    def discrepancy(self) -> Discrepancy:
        """As a joint's description states it."""
        return self.spline.as_discrepancy(self.fit.theta[-self.spline.count :])


def splines(problem: Problem, settings: DiscrepancySettings = SETTINGS) -> list[Spline]:
    """Every place and variable that this measurement can show."""
    rated = problem.joint.numbers["rated_torque"].value / 16.0
    numbers = problem.joint.numbers
    found = []
    for variable in VARIABLES:
        low, high = _range(variable, problem)
        if not high - low > _SMALLEST_RANGE.get(variable, 0.0):
            continue
        for place in PLACES[1:]:
            if place == "joint_torque" and not problem.has_torque:
                continue
            if place in ("flexspline", "link_position") and not problem.link_measured:
                continue
            unit = settings.scale[place]
            if place in ("rotor", "mesh"):
                unit *= rated * 100 / numbers["N"].value
            elif place == "motor_current":  # what the rotor's would draw, so that neither is favoured
                unit = settings.scale["rotor"] * rated * 100 / numbers["N"].value / numbers["Kt"].value
            elif place != "link_position":
                unit *= rated
            found.append(Spline(place, variable, low, high, settings.knots[variable], unit))
    return found


class FirstLook:
    """Derivatives of the residuals in splines' coordinates about a model, as exact as a first look needs.

    What only reads out is told in closed form, at the residuals' own times. Inside the transmission, what is slow beside it does
    what the same effect would if it were constant; of the rest every eighth coordinate is moved at once, and what changes belongs
    to the one that acts then or did shortly before. A fit has exact derivatives (`Spline.derivatives`).
    """

    def __init__(self, problem: Problem, theta: np.ndarray, model: Model):
        self.problem, self.theta, self.model = problem, theta, model
        self._constant: dict[str, Columns] = {}

    def columns(self, spline: Spline) -> Columns:
        """Of each segment, shape (k, len(BALANCES), count)."""
        if spline.place not in _INSIDE:
            return self._read_out(spline)
        if spline.variable in _SLOW:
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
        """Derivatives through the replay in an effect at the spline's place that is the same throughout, shape (k,
        len(BALANCES), 1) a segment."""
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
            u = np.clip((_variable(spline.variable, segment) - spline.low) / (spline.high - spline.low), 0.0, 1.0)
            first = np.minimum((u * (spline.count - 3)).astype(int), spline.count - 4) - (n - 4) // 2
            whole = np.zeros((*J.shape[:2], spline.count))
            for lane in range(n):
                owner = first + (lane - first) % n
                there = np.flatnonzero((owner >= 0) & (owner < spline.count))
                whole[there, :, owner[there]] = J[there, :, lane]
            found.append(whole)
        return found


class _Plain:
    """The linear model about a fit under white noise as loud as its residual, on every n-th sample."""

    def __init__(self, problem: Problem, at: Fit, thin: int):
        self.problem, self.at, self.thin = problem, at, thin
        noise = plain_noise(problem, at)
        self.rms = np.array([s.white for s in noise.sensors[0]])
        self.rows = self._rows(
            [np.concatenate([r[..., None], J], -1) for r, J in zip(at.point.residual, at.jacobian, strict=True)]
        )
        weight = huber_weight(self.rows[:, 0], SOLVER.huber)
        self.root = np.sqrt(weight * leverage_weight(self.rows[:, 1 : problem.size + 1], SOLVER.leverage))
        self.rows *= self.root[:, None]
        self.spread = problem.spread(at.model)

    def _rows(self, columns: Columns) -> np.ndarray:
        found = []
        for segment, x in zip(self.problem.segments, columns, strict=True):
            for b in range(len(BALANCES)):
                use = segment.usable[:, b] & ~segment.at_rest
                found.append(x[use][:: self.thin, b] / self.rms[b])
        return np.concatenate(found)

    def candidate(self, spline: Spline, columns: Columns, without: tuple[int, ...]) -> Candidate:
        """A spline in the place of some of the model's causes."""
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


def find(
    fitter: Fitter, posterior: ModelPosterior, base: Fit, best: Fit, settings: DiscrepancySettings = SETTINGS
) -> Unknown | None:
    """The unknown effect that makes a joint more probable than the best model of known causes: beside these, or in the place of
    the one that is worth most, of all of its component, or of all. None where there is none, or next to nothing is left.

    Args:
      base: the calibrated joint without causes.
    """
    problem = fitter.problem
    rated = problem.joint.numbers["rated_torque"].value
    left, least = left_by(problem, best), max((settings.worth * rated) ** 2, noise_of(problem, best))
    explained = left_by(problem, base) - left
    full = not np.any(problem.records(best.theta, best.model)[0][0]["discrepancy_place"] == 0)
    beside, instead = left > least, explained > least and left > settings.more * explained
    drops = [without for without in _drops(problem, best) if (instead if without else beside)]
    if full or not drops:
        return None
    plain, look = _Plain(problem, best, settings.thin), FirstLook(problem, best.theta, best.model)
    tried: list[Candidate] = []
    for spline in splines(problem, settings):
        columns = look.columns(spline)
        if all(np.isfinite(c).all() for c in columns):  # else beyond what the replay follows
            tried += [plain.candidate(spline, columns, without) for without in drops]
    now, found = posterior.judge(best).score, list[Unknown]()
    for without in drops:
        for candidate in _promising([c for c in tried if c.without == without], settings):
            f = _refined(fitter, best, candidate)
            found.append(Unknown(candidate.spline, f, posterior.judge(f).score - now))
    # The derivatives were taken far from where these end: the most probable are fitted once more with their own.
    found.sort(key=lambda u: -u.gain)
    for u in found[: settings.refined]:
        f = fitter.fit(u.fit.model, u.fit.theta, None, 6, best)
        found.append(replace(u, fit=f, gain=posterior.judge(f).score - now))
    named = [
        u for u in found
        if u.gain > 0.0
        and left - left_by(problem, u.fit) > settings.share * left
        and made_by(problem, u.fit, u.fit, -1).sum() > (settings.worth * rated) ** 2
    ]  # fmt: skip
    return max(named, key=lambda u: u.gain, default=None)


def _promising(candidates: Sequence[Candidate], settings: DiscrepancySettings) -> list[Candidate]:
    """Those that look best in the linear model; of places that are the same residual the usual one."""
    found: list[Candidate] = []
    for c in sorted(candidates, key=lambda c: -c.score):
        same = [f for f in found if f.spline.variable == c.spline.variable and abs(f.share - c.share) < settings.alike]
        if not same:
            found.append(c)
        elif c.spline.usual and not same[0].spline.usual:
            found[found.index(same[0])] = c
        if len(found) > settings.refined:
            break
    return found[: settings.refined]


def _drops(problem: Problem, best: Fit) -> list[tuple[int, ...]]:
    """Sets of causes in whose place an unknown effect may stand: none, the one that is worth most, all of its component, all."""
    if not best.model:
        return [()]
    size = [made_by(problem, best, best, i).sum() for i in range(len(best.model))]
    top = int(np.argmax(size))
    component = best.model[top].cause.component
    same = tuple(i for i, h in enumerate(best.model) if h.cause.component == component)
    return list(dict.fromkeys([(), (top,), same, tuple(range(len(best.model)))]))


def _refined(fitter: Fitter, best: Fit, candidate: Candidate) -> Fit:
    """A candidate fitted through the replay."""
    problem = fitter.problem
    kept = [i for i in range(len(best.model)) if i not in candidate.without]
    places = [problem.place(best.model, i) for i in kept]
    index = np.concatenate([np.arange(problem.size), *(np.arange(p.start, p.stop) for p in places)]).astype(int)
    model: Model = tuple(best.model[i] for i in kept)
    start = np.concatenate([(best.theta + candidate.shift)[index], candidate.coordinates])
    near = replace(best, model=model, theta=best.theta[index], jacobian=[J[..., index] for J in best.jacobian])
    return fitter.fit((*model, candidate.spline), start, near, 4, best)  # type: ignore[arg-type]


def extend(joint: Joint, found: Unknown) -> Joint:
    """The joint with the discrepancy in it."""
    return joint.model_copy(update={"discrepancies": [*joint.discrepancies, found.discrepancy]})


def describe(found: Unknown) -> str:
    """The effect in a sentence."""
    s, d = found.spline, found.discrepancy
    values = spline_basis(np.linspace(0.0, 1.0, 200), len(d.coefficients)) @ np.array(d.coefficients)
    what = {
        "rotor": "a torque on the rotor", "mesh": "a friction torque in the mesh", "flexspline": "a flexspline torque",
        "link": "a torque on the link", "joint_torque": "an error of the torque sensor",
        "link_position": "a kinematic error" if s.kinematic else "an error of the link encoder",
        "motor_current": "an error of the current reading",
    }[s.place]  # fmt: skip
    return f"{what} of {float(np.ptp(values)):.2g} {d.unit} that depends on {_words(s.variable)}"


def _words(variable: str) -> str:
    return {"motor_position_two_turns": "motor position, over two turns"}.get(variable, variable.replace("_", " "))


def depends_on(variable: str) -> tuple[str, ...]:
    """Names of the measured variables that a discrepancy's variable is made of."""
    return {
        "direction_link_position": ("link_position", "direction"),
        "motor_position_two_turns": ("motor_position",),
    }.get(variable, (variable,))


__all__ = ["DiscrepancySettings", "Spline", "Unknown", "depends_on", "describe", "extend", "find"]
