"""What diagnosis makes of draws, and how often it is right.

A cause that is named is *there* where it was hidden, or where it is one of the imperfections of a real draw
(`Cause.imperfection`). Shares carry Wilson's 95 % intervals. Core time is what a diagnosis took of one process's cores.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np
from scipy.stats import binomtest

from ...models import causes, plugins, processes
from ...models.errors import InputError
from ...models.files import plain
from ...models.joint import Joint, load_joint
from ...models.output import at_end
from ...models.parameters import short_way
from ...scenarios.scenario import load_scenario
from ..answer import Diagnosis, Finding
from ..diagnose import diagnose
from ..fit.coordinates import Hypothesis, hypotheses
from ..fit.noise import whiten
from .draw import Challenge, Draw, Hidden, HiddenEffect, draw

DETECTED = 3.33
"""Standard deviations at which an effect is found 9 times in 10 while 2 % of the alarms are false (Gaussian)."""
ALARM = 0.5
"""Confidence from which on a cause that is not there is a false alarm on a real joint."""
SURE = 0.9
"""Confidence from which on a cause is stated as a fact."""
PARAMETER_LIMIT = 3.0
"""Standard deviations within which a parameter counts as right."""
CONFIDENCES = (0.0, 0.5, 0.7, 0.9, 0.97, 1.0)
_TIMES: dict[str, Callable[[list[float]], float]] = {"median": np.median, "worst": np.max}
_SIXTH = 6.0  # order of the kinematic error that imperfections have
_PROBE = 0.05  # of an effect, in ordinary sizes, by which its derivative is taken


# --- one draw, diagnosed ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What diagnosis made of a draw."""

    kind: Hidden  # what was hidden
    index: int  # of the draw
    size: float  # of the effect, in ordinary sizes
    real: bool  # with a real joint's imperfections
    hidden: dict[str, dict[str, float]]  # name → parameters
    component: str  # of the first
    description: str  # of the effects
    verdict: str = "failed"  # as in `diagnosis.json`
    causes: tuple[dict[str, Any], ...] = ()  # likewise
    minor: tuple[dict[str, Any], ...] = ()  # likewise
    # of every parameter of every cause that was named rightly: "cause.parameter" → error in standard deviations, and as a share
    # of the true value (of the ordinary range for an angle or a place)
    deviations: dict[str, tuple[float, float]] | None = None
    smallest: float | None = None  # size that the Fisher information allows to find 9 times in 10
    core_time: float = float("nan")  # that diagnosis took of the cores [s]
    seconds: float = float("nan")  # by the clock
    failure: str = ""  # message of an exception

    @property
    def named(self) -> list[str]:
        """Names of the causes found, the largest contribution first."""
        return [c["name"] for c in self.causes]

    def is_there(self, cause: dict[str, Any]) -> bool:
        """Whether a cause as in `diagnosis.json` is really there: hidden, or a special case of what is (`Cause.includes`), or an
        imperfection of this joint."""
        known = (n for n in self.hidden if n != "unknown")
        if cause["name"] in (*self.hidden, *(causes.get(n).includes for n in known)):
            return True
        if not self.real or cause["name"] == "unknown" or not causes.get(cause["name"]).imperfection:
            return False
        return cause["name"] != "kinematic_error" or cause["parameters"]["order"]["value"] == _SIXTH

    @property
    def first_right(self) -> bool:
        """Whether the first cause is one of the hidden ones (or, where nothing is hidden, that there is no false alarm)."""
        if not self.hidden:
            return not self.failure and not self.false_alarm
        return bool(self.named) and self.named[0] in self.hidden

    @property
    def first_beside_imperfections(self) -> bool:
        """Whether the first cause is hidden, without present imperfections, which may contribute more."""
        named = (c["name"] for c in self.causes if c["name"] in self.hidden or not self.is_there(c))
        return next(named, None) in self.hidden

    @property
    def component_right(self) -> bool:
        """Whether the first cause's component is that of a hidden effect."""
        if not self.causes or not self.hidden:
            return not self.causes and not self.hidden
        components = {self.component} if "unknown" in self.hidden else {causes.get(n).component for n in self.hidden}
        return self.causes[0]["component"] in components

    @property
    def all_named(self) -> bool:
        """Whether all hidden effects are named."""
        return set(self.hidden) <= set(self.named)

    @property
    def unknown_in_place(self) -> bool:
        """Whether the first cause is called unknown and put into the right component."""
        return bool(self.named) and self.named[0] == "unknown" and self.component_right

    @property
    def false_alarm(self) -> bool:
        """Whether something is named that is not there: on a real joint with confidence `ALARM` at least."""
        least = ALARM if self.real else 0.0
        return any(c["confidence"] >= least and not self.is_there(c) for c in self.causes)

    def row(self) -> dict[str, Any]:
        """As plain data, for JSON and Parquet."""
        judged = {n: getattr(self, n) for n in ("first_right", "component_right", "all_named", "false_alarm")}
        return asdict(self) | judged | {"deviations": {k: list(v) for k, v in (self.deviations or {}).items()}}


def attempt(challenge: Challenge, index: int, size: float = 1.0) -> Outcome:
    """Draw, diagnose, compare."""
    drawn = draw(challenge, index, size)
    hidden = {e.name: e.values for e in drawn.effects}
    head: dict[str, Any] = {
        "kind": challenge.hidden, "index": index, "size": size, "real": challenge.real, "hidden": hidden,
        "component": drawn.effects[0].component if hidden else "",
        "description": "; ".join(e.description for e in drawn.effects),
    }  # fmt: skip
    clock, core = time.perf_counter(), time.process_time()
    try:
        found: Diagnosis | None = diagnose(drawn.measurement, drawn.nominal)
    except Exception as error:  # a draw that breaks diagnosis is a result, not the end of the challenge
        found, head["failure"] = None, f"{type(error).__name__}: {error}"
    head |= {"core_time": time.process_time() - core, "seconds": time.perf_counter() - clock}
    if found is None:
        return Outcome(**head)
    smallest = None
    if challenge.hidden in ("one", "two"):
        limit = smallest_size(found, drawn.nominal, drawn.effects[0])
        smallest = None if limit is None else limit * size
    answer = found.to_json()
    return Outcome(
        **head, verdict=found.verdict, causes=tuple(answer["causes"]), minor=tuple(answer["minor"]),
        deviations=deviations(drawn, found), smallest=smallest,
    )  # fmt: skip


def deviations(drawn: Draw, found: Diagnosis) -> dict[str, tuple[float, float]]:
    """Errors of the parameters of causes that were named rightly: in standard deviations, and relative."""
    errors = {}
    for effect in drawn.effects:
        cause = _named(effect, found)
        if cause is None:
            continue
        flaws = drawn.imperfections
        values = effect.values if flaws is None else flaws.whole(effect.name, effect.values)
        for q in causes.get(cause.name).parameters:
            if q.integer:
                continue
            p, true = cause.parameters[q.name], values[q.name]
            error, scale = p.value - true, abs(true)
            if q.period:
                error, scale = float(short_way(error, q.period)), 1.0
            elif not q.magnitude:
                scale = max(scale, q.ordinary[-1][1] - q.ordinary[0][0])
            errors[f"{cause.name}.{q.name}"] = (
                float(abs(error) / p.std) if p.std > 0 else float(np.inf if error else 0.0),
                float(abs(error) / scale) if scale else float(np.inf),
            )
    return errors


def _named(effect: HiddenEffect, found: Diagnosis) -> Finding | None:
    """The cause that names an effect, of several the one with its whole numbers; None where there is none."""
    same = [c for c in found.causes if c.name == effect.name != "unknown"]
    if not same:
        return None
    whole = [q.name for q in causes.get(effect.name).parameters if q.integer]
    return max(same, key=lambda c: all(c.parameters[name].value == effect.values[name] for name in whole))


def smallest_size(found: Diagnosis, nominal: Joint, effect: HiddenEffect) -> float | None:
    """Return the size of an effect, in its units, that is `DETECTED` standard deviations: Fisher information's limit.

    The information is the Schur complement after all calibration variables, within tolerance, under the noise and model
    discrepancy that were learned. None where nothing was computed.
    """
    if found.problem is None or found.search is None or found.final is None:
        return None
    problem, base = found.problem, found.search.base
    h = matching(nominal, effect)
    u = coordinates(h, effect.values)
    length = float(np.linalg.norm(u[h.magnitudes]))
    if not length > 0:
        return np.inf
    step = u.copy()
    step[h.magnitudes] *= _PROBE / length
    moved = problem.residuals([np.concatenate([base.theta, step])], [(h,)])[0]
    column = [(m - r)[..., None] * (length / _PROBE) for m, r in zip(moved, base.point.residual, strict=True)]
    n = problem.size
    X = whiten(problem.segments, found.final.noise, column, base.jacobian).rows
    G = X.T @ X
    H = G[1:, 1:] + np.eye(n)
    information = float(G[0, 0] - G[0, 1:] @ np.linalg.solve(H, G[1:, 0]))
    return float(DETECTED / np.sqrt(max(information, 1e-12)))


def matching(nominal: Joint, effect: HiddenEffect) -> Hypothesis:
    """The hypothesis that an effect of the library is an instance of."""
    whole = {q.name: effect.values[q.name] for q in causes.get(effect.name).parameters if q.integer}
    for h in hypotheses(causes.get(effect.name), nominal.record()):
        if all(h.fixed.get(k) == v for k, v in whole.items()):
            return h
    raise InputError(f"{effect.name}: no hypothesis with {whole}")


def coordinates(h: Hypothesis, values: dict[str, float]) -> np.ndarray:
    """All coordinates of parameter values in a hypothesis, shape (size,): the inverse of `Hypothesis.values`."""
    u = h.coordinates(values)
    if h.polar:
        return u
    for i, q in enumerate(h.free):
        if not q.magnitude:
            start, value = h.start[q.name], values[q.name]
            u[i] = (np.log(value / start) if q.ordinary[0][0] > 0 else value - start) / h.scale[q.name]
    return u


# --- many draws ------------------------------------------------------------------------------------------------------


def run(
    asked: Challenge | Sequence[Challenge], count: int, sizes: Sequence[float] = (1.0,), jobs: int = 1, first: int = 0
) -> Iterator[Outcome]:
    """Outcomes of draws first … first + count − 1 of every challenge at every size, as they come, on `jobs` processes.

    These end with this one, however it ends.

    Raises:
      InputError: a joint, scenario or cause that does not exist; before anything is drawn.
    """
    challenges = (asked,) if isinstance(asked, Challenge) else tuple(asked)
    for challenge in challenges:
        nominal = load_joint(challenge.joint)
        challenge.pool()
        for name in challenge.scenarios:
            load_scenario(name)[0].mount(nominal)
    tasks = [(c, i, size) for c in challenges for i in range(first, first + count) for size in sizes]
    if jobs <= 1:
        for task in tasks:
            yield attempt(*task)
        return
    with ProcessPoolExecutor(
        jobs, get_context("spawn"), initializer=processes.begin, initargs=(plugins.files(),)
    ) as pool:
        with processes.no_interrupts():
            pending = [pool.submit(attempt, *task) for task in tasks]
        try:
            with at_end(processes.end):
                for future in as_completed(pending):
                    yield future.result()
        except BaseException:
            processes.end()
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


@dataclass(frozen=True)
class Rate:
    """A share of right answers with its 95 % interval (Wilson)."""

    right: int
    of: int

    @property
    def share(self) -> float:
        """Share, NaN of none."""
        return self.right / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 95 % interval."""
        if not self.of:
            return 0.0, 1.0
        ci = binomtest(self.right, self.of).proportion_ci(0.95, "wilson")
        return float(ci.low), float(ci.high)

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"{100 * self.share:.0f} % ({self.right}/{self.of}; {100 * low:.0f}–{100 * high:.0f})" if self.of else "–"
        )

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {"right": self.right, "of": self.of, "interval": list(self.interval)}


def rate(outcomes: Sequence[Outcome], what: Callable[[Outcome], bool]) -> Rate:
    """Share of outcomes of which `what` is true."""
    return Rate(sum(bool(what(o)) for o in outcomes), len(outcomes))


def summary(outcomes: Sequence[Outcome]) -> dict[str, Rate | float]:
    """The rates of one size; times and parameter errors as medians."""
    hidden = [o for o in outcomes if o.hidden]
    quiet = [o for o in outcomes if not o.hidden]
    several = [o for o in hidden if any(len(other.hidden) > 1 for other in hidden)]
    shares: tuple[tuple[str, list[Outcome], Callable[[Outcome], bool]], ...] = (
        ("false alarms", quiet, lambda o: o.false_alarm),
        ("first cause right", hidden, lambda o: o.first_right),
        ("component right", hidden, lambda o: o.component_right),
        ("nothing found", hidden, lambda o: not o.causes),
        ("a cause named that is not there", hidden, lambda o: o.false_alarm),
        ("called unknown, component right", [o for o in hidden if "unknown" in o.hidden], lambda o: o.unknown_in_place),
        ("both named", several, lambda o: o.all_named),
    )
    found: dict[str, Rate | float] = {name: rate(some, what) for name, some, what in shares if some}
    if errors := [v for o in hidden for v in (o.deviations or {}).values()]:
        within = [(s <= PARAMETER_LIMIT, r <= 0.15) for s, r in errors]
        found["parameters within 3 std"] = Rate(sum(right for right, _ in within), len(errors))
        found["parameters within 3 std and 15 %"] = Rate(sum(map(all, within)), len(errors))
        std, share = np.median(errors, axis=0).tolist()
        found |= {"median parameter error [std]": std, "median parameter error [%]": 100 * share}
    if sure := [o.is_there(c) for o in outcomes for c in o.causes if c["confidence"] >= SURE]:
        found[f"of causes named at ≥ {SURE:g}: are there"] = Rate(sum(sure), len(sure))
    if any(o.failure for o in outcomes):
        found["failed"] = rate(outcomes, lambda o: bool(o.failure))
    return found | {f"core time, {name} [s]": float(of([o.core_time for o in outcomes])) for name, of in _TIMES.items()}


@dataclass(frozen=True)
class Row:
    """A line of the answer to "how often is it right"."""

    name: str  # for people
    value: Rate | float  # share with its interval, or seconds
    target: float  # on real joints (`challenge --real`)
    at_most: bool = False  # whether the target is an upper one

    @property
    def met(self) -> bool:
        """Whether the target is met."""
        value = self.value.share if isinstance(self.value, Rate) else self.value
        return value <= self.target if self.at_most else value >= self.target

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        value = plain(self.value) if isinstance(self.value, Rate) else {"seconds": self.value}
        return {"name": self.name, **value, "target": self.target, "at_most": self.at_most}


def rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """What diagnosis must be good at, over outcomes of every kind; rows of which there is no outcome are left out. A diagnosis
    that failed counts as wrong in every row."""
    of = {kind: [o for o in outcomes if o.kind == kind] for kind in ("one", "none", "two", "outside")}
    errors = [s for o in of["one"] for s, _ in (o.deviations or {}).values()]
    sure = [o.is_there(c) for o in outcomes for c in o.causes if c["confidence"] >= SURE]
    found = [
        Row("one effect: first cause right", rate(of["one"], lambda o: o.first_right), 0.92),
        Row(
            "… imperfections that are there set aside",
            rate([o for o in of["one"] if o.real], lambda o: o.first_beside_imperfections), 0.92,
        ),
        Row("one effect: parameters within 3 std", Rate(sum(s <= PARAMETER_LIMIT for s in errors), len(errors)), 0.95),
        Row(
            "nothing hidden: a cause named that is not there",
            rate(of["none"], lambda o: bool(o.failure) or any(c["confidence"] >= ALARM and not o.is_there(c) for c in o.causes)),
            0.04, at_most=True,
        ),
        Row(f"causes named at ≥ {SURE:g}: are there", Rate(sum(sure), len(sure)), 0.97),
        Row("two effects: both named", rate(of["two"], lambda o: o.all_named), 0.75),
        Row("outside the library: right component", rate(of["outside"], lambda o: o.component_right), 0.80),
    ]  # fmt: skip
    found = [r for r in found if isinstance(r.value, Rate) and r.value.of]
    times = [o.core_time for o in outcomes]
    limits = {"median": 20.0, "worst": 60.0} if times else {}
    return found + [Row(f"core time, {n} [s]", float(_TIMES[n](times)), s, at_most=True) for n, s in limits.items()]


def confusion(outcomes: Sequence[Outcome]) -> dict[str, Counter[str]]:
    """What was hidden → what was named first, counted; `nothing` where there was none."""
    table: dict[str, Counter[str]] = {}
    for o in sorted(outcomes, key=lambda o: o.index):
        truth = " + ".join(o.hidden) or "nothing"
        if "unknown" in o.hidden:
            truth = o.description.split(":")[0]
        table.setdefault(truth, Counter())[o.named[0] if o.named else o.verdict] += 1
    return table


def reliability(outcomes: Sequence[Outcome]) -> list[tuple[float, float, float, Rate]]:
    """Calibration of confidence, over all named causes: from, to, mean confidence, share that is there."""
    named = [(c["confidence"], o.is_there(c)) for o in outcomes for c in o.causes]
    rows = []
    for low, high in itertools.pairwise(CONFIDENCES):
        inside = [(c, right) for c, right in named if low <= c < high or (high == 1.0 and c == 1.0)]
        if inside:
            mean = float(np.mean([c for c, _ in inside]))
            rows.append((low, high, mean, Rate(sum(right for _, right in inside), len(inside))))
    return rows


def found_nine_in_ten(outcomes: Sequence[Outcome]) -> float | None:
    """Smallest size at which, and above which, nine in ten first causes are right, between sizes on the log scale; None where
    not even the largest size reaches that."""
    best: float | None = None
    above = np.nan
    for size in sorted({o.size for o in outcomes}, reverse=True):
        share = rate([o for o in outcomes if o.size == size], lambda o: o.first_right).share
        if share < 0.9:
            weight = (above - 0.9) / max(above - share, 1e-9)
            return best and float(np.exp((1 - weight) * np.log(best) + weight * np.log(size)))
        best, above = size, share
    return best


def report(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Everything above as plain data, by size."""
    sizes = sorted({o.size for o in outcomes}, reverse=True)
    return {
        "rows": plain(rows(outcomes)),
        "sizes": {f"{size:g}": plain(summary([o for o in outcomes if o.size == size])) for size in sizes},
        "confusion": plain(confusion(outcomes)),
        "reliability": [
            {"from": low, "to": high, "mean": mean, **share.to_json()} for low, high, mean, share in reliability(outcomes)
        ],
        "draws": [o.row() for o in outcomes],
    }  # fmt: skip
