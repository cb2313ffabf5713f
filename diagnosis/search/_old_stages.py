"""Which causes the data speak for: screening of the whole library, then evidence of the few that could be it.

*Screening* is linear: the derivative of the replayed residuals with respect to every cause (a secant at part of its
ordinary size), at the calibrated joint, with all calibration variables free to answer. It gives each cause's
approximate log evidence in closed form. *Finalists* are fitted through the replay together with the calibration, and
compared by their Laplace evidence. A further cause is added when it earns more than `THRESHOLD`.

Encoders are so precise that a wrong model is wrong by hundreds of standard deviations, where nothing is linear. The
search therefore takes the noise to be as loud as the residual is, and lets it become quieter as the model improves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .calibrate import (
    REACH,
    Echo,
    Fit,
    Problem,
    bounded_step,
    bounds,
    echo,
    evaluate,
    fit,
    prior_cost,
    robust_loss,
    with_dispersion,
)
from .coordinates import Hypothesis
from .noise import Noise, estimate, first_guess, louder, whiten

THRESHOLD = 7.0
"""Log evidence that a cause must add."""
PROBE, PROBE_LOUD = 0.03, 0.3
"""Part of the ordinary size at which a cause is probed, where the residual is nearly noise and where it is not."""
FINALISTS = 4
SMALLEST = 0.03
"""Effects below this part of the ordinary size are not named: the laws themselves are not better than that."""


@dataclass(frozen=True)
class Screened:
    """A hypothesis with its linearised gain in log evidence, and where the linear model puts it.

    Attributes:
      start: coordinates of the hypothesis.
      shift: change of the other unknowns that goes with them.
    """

    hypothesis: Hypothesis
    gain: float
    start: np.ndarray
    shift: np.ndarray


class Library:
    """Columns of every hypothesis at a fit, for screening.

    Attributes:
      hypotheses: the hypotheses.
      origins: of each the coordinates at which the joint stays as it is, shape (size,).
      columns: of each the derivatives of the residuals, shape (k, 3, m) a stretch.
      noise_columns: the motion noise's share of them.
    """

    def __init__(self, problem: Problem, at: Fit, hypotheses: list[Hypothesis], probe: float):
        self.hypotheses = hypotheses
        thetas, models = [], []
        record = problem.records(at.theta, at.model)[0][0]
        # A cause that replaces a number starts from what calibration has made of it.
        self.origins = [h.coordinates(h.cause.centre(record, h.fixed)) for h in hypotheses]
        for h, origin in zip(hypotheses, self.origins, strict=True):
            for j in _probed(h):
                u = origin.copy()
                u[j] += probe
                thetas.append(np.concatenate([at.theta, u]))
                models.append((*at.model, h))
        base = at.state[0]
        done = iter(problem.residuals(thetas, models))
        self.columns = []
        for h in hypotheses:
            parts = [next(done) for _ in _probed(h)]
            self.columns.append(
                [np.stack([(part[s] - base[s]) / probe for part in parts], -1) for s in range(len(base))]
            )


def _probed(h: Hypothesis) -> list[int]:
    return h.magnitudes


def screen(problem: Problem, noise: Noise, at: Fit, library: Library) -> list[Screened]:
    """Linearised gain in log evidence of every hypothesis, best first; one per cause and order, its best start."""
    count = [len(_probed(h)) for h in library.hypotheses]
    all_columns = [np.concatenate([c[s] for c in library.columns], axis=-1) for s in range(len(problem.drives))]
    stack = whiten(
        problem.drives,
        noise,
        [
            np.concatenate([r[..., None], j, c], -1)
            for r, j, c in zip(at.state[0], at.jacobian, all_columns, strict=True)
        ],
    )
    r, X = stack[:, 0], stack[:, 1:]
    _, weight = robust_loss(r)
    n = at.jacobian[0].shape[-1]
    prior = 1 / problem.spread(at.model) ** 2
    XW = X[:, :n] * weight[:, None]
    H, g = XW.T @ X[:, :n] + np.diag(prior), XW.T @ r + prior * at.theta
    low, high = bounds(problem, at.model)
    held = (at.theta <= low + 1e-6) | (at.theta >= high - 1e-6)  # at the end of its tolerance: cannot answer further
    bare, H = H, H + np.diag(np.where(held, 1e15, 0.0))
    C = X[:, n:]
    CW = C * weight[:, None]
    cross = CW.T @ X[:, :n]
    solved = np.linalg.solve(H, cross.T)
    information = CW.T @ C - cross @ solved
    score = -(CW.T @ r) + solved.T @ g
    # Calibration's own way back from its bounds is no merit of a cause.
    own = bounded_step(bare, g, low - at.theta, high - at.theta)
    idle = g @ own + 0.5 * own @ bare @ own
    found: dict[tuple, Screened] = {}
    position = 0
    for h, m, origin in zip(library.hypotheses, count, library.origins, strict=True):
        block = slice(position, position + m)
        position += m
        spread, origin = h.spread[_probed(h)], origin[_probed(h)]
        A = information[block, block] + np.diag(1 / spread**2)
        b = score[block] - origin / spread**2
        change = np.linalg.solve(A, b)
        _, logdet = np.linalg.slogdet(A * spread[:, None] * spread)
        gain = 0.5 * b @ change - 0.5 * logdet - np.log(h.alternatives)
        start = np.zeros(h.size)
        start[_probed(h)] = origin + change
        if not h.polar and np.any(h.confine(start) != start):
            # The sign is not possible: what the bound leaves.
            start = h.confine(start)
            change = start[_probed(h)] - origin
            gain = b @ change - 0.5 * change @ A @ change - 0.5 * logdet - np.log(h.alternatives)
        shift = -solved[:, block] @ change
        if held.any():
            # What is at the end of its tolerance may come back when the cause takes over its part.
            joined = np.block(
                [[bare, cross[block].T], [cross[block], CW[:, block].T @ C[:, block] + np.diag(1 / spread**2)]]
            )
            slope = np.concatenate([g, CW[:, block].T @ r + origin / spread**2])
            u_low, u_high = (limit[_probed(h)] - origin for limit in h.limits)
            step = bounded_step(
                joined, slope, np.concatenate([low - at.theta, u_low]), np.concatenate([high - at.theta, u_high])
            )
            relieved = idle - (slope @ step + 0.5 * step @ joined @ step) - 0.5 * logdet - np.log(h.alternatives)
            if relieved > gain:
                gain, shift = relieved, step[:n]
                start[_probed(h)] = origin + step[n:]
        key = (h.cause.name, *h.fixed.items())
        if key not in found or gain > found[key].gain:
            found[key] = Screened(h, float(gain), start, shift)
    return sorted(found.values(), key=lambda s: -s.gain)


def size(h: Hypothesis, u: np.ndarray) -> float:
    """Size of an effect in ordinary sizes."""
    return float(np.linalg.norm(u[h.magnitudes]))


def finalists(screened: list[Screened], count: int, per_cause: int = 2) -> list[Screened]:
    """The best hypotheses that could matter, at most `per_cause` of the same cause."""
    screened = [s for s in screened if s.gain > 0.5 * THRESHOLD and size(s.hypothesis, s.start) > 0.5 * SMALLEST]
    chosen: list[Screened] = []
    taken: dict[str, int] = {}
    for s in screened:
        name = s.hypothesis.cause.name
        if taken.get(name, 0) < per_cause and len(taken | {name: 0}) <= count:
            taken[name] = taken.get(name, 0) + 1
            chosen.append(s)
    return chosen


def clean(problem: Problem, noise: Noise, at: Fit, library: Library) -> list[np.ndarray]:
    """Residuals without anything that a calibration variable or a cause can explain (ridge): noise, nearly."""
    columns = [np.concatenate([j, *(c[s] for c in library.columns)], axis=-1) for s, j in enumerate(at.jacobian)]
    stack = whiten(
        problem.drives,
        noise,
        [np.concatenate([r[..., None], c], -1) for r, c in zip(at.state[0], columns, strict=True)],
    )
    r, X = stack[:, 0], stack[:, 1:]
    _, weight = robust_loss(r, 3.0 * max(1.0, 1.4826 * float(np.median(np.abs(r[r != 0])))))
    XW = X * weight[:, None]
    A = XW.T @ X
    d = np.sqrt(np.diag(A)) + 1e-12
    u = np.linalg.solve(A / d[:, None] / d + 1e-6 * np.eye(len(A)), XW.T @ r / d) / d
    return [res - c @ u for res, c in zip(at.state[0], columns, strict=True)]


def sensors(problem: Problem, at: Fit) -> list[np.ndarray]:
    """What the sensors' stated noise leaves in the residuals at a fit, shape (k, 3) a stretch: another draw of it."""
    twin = problem.residuals([at.theta], [at.model], twin=True)[0]
    return [b - a for a, b in zip(at.state[0], twin, strict=True)]


def excess(problem: Problem, at: Fit) -> list[float]:
    """How many times the sensors' stated noise the motion's noise is, one a stretch, at a fit that is nearly right.

    A logger slower than the control loop folds what the loop does above its Nyquist frequency into the motion. It shows
    in the torsion: the fast part of the residual where torsion is compared with a torque, against the sensors' share.
    """
    found: list[float | None] = []
    for drive, r, s in zip(problem.drives, at.state[0], sensors(problem, at), strict=True):
        ratio = None
        for c in (1, 2):
            use = drive.usable[:, c] & ~drive.at_rest
            use = use[2:] & use[1:-1] & use[:-2]
            if ratio is None and use.sum() > 100:
                fast, stated = (np.median(np.abs(np.diff(x[:, c], 2)[use])) for x in (r, s))
                ratio = float(fast / max(stated, 1e-12))
        found.append(ratio)
    known = [f for f in found if f is not None]
    usual = float(np.median(known)) if known else 1.0
    return [1.0 if f < _EXCESS else min(f, 5.0) for f in (usual if f is None else f for f in found)]


_EXCESS = 1.15
"""Noise of the motion below so many times what the sensors state is what they state."""


def fine(problem: Problem, noise: Noise, at: Fit, cleaned: list[np.ndarray]) -> list[float]:
    """What is missing from the twins' motion noise to that of the residuals, one factor a stretch, near one.

    The shares must balance: where the twin is a few per cent too loud, whatever makes noise louder would look better, the
    scale of all torques first of all.
    """
    found = []
    for drive, channels, r, s in zip(problem.drives, noise, cleaned, sensors(problem, at), strict=True):
        white = [whiten([drive], [channels], [x[..., None]]).reshape(3, -1) for x in (r, s)]
        losses = [[robust_loss(x[c])[0] for c in (1, 2)] for x in white]
        c = 0 if drive.usable[:, 1].any() else 1
        ratio = losses[0][c] / losses[1][c] if losses[1][c] > 0 else 1.0
        found.append(float(np.clip(np.sqrt(ratio), _FINE, 1 / _FINE)))
    return found


_FINE = 0.85


def level(problem: Problem, noise: Noise, at: Fit) -> float:
    """How many times the noise the residual is: one when the model is right."""
    r = whiten(problem.drives, noise, [x[..., None] for x in at.state[0]])[:, 0]
    r = r[r != 0]
    return max(1.0, float(np.sqrt(np.mean(np.minimum(r * r, 1e4 * np.median(r * r))))))


def settle(
    problem: Problem, noise: Noise, model: tuple[Hypothesis, ...], theta: np.ndarray, common, echo: Echo | None,
    loudness: float, steps: int = 3,
) -> Fit:  # fmt: skip
    """Fit a model with noise taken `loudness` times as large and then quieter, down to what its residual is."""
    f = None
    for _ in range(steps):
        quiet = loudness < _QUIET
        f = fit(
            problem, noise if quiet else louder(noise, loudness), model, theta, 5 if quiet else 2, 1.0, common,
            echo if loudness < _LOUD else None, refresh=quiet or f is not None,
        )  # fmt: skip
        theta, common = f.theta, f.jacobian
        if quiet:
            return f
        after = level(problem, noise, f)
        loudness = 1.0 if after < 2.0 else min(after, loudness)
    return f


_STUCK = 0.92 * REACH
"""A number so many standard deviations from nominal may stand in for an effect."""
_UNSETTLED = 1.35
"""A residual that should be noise and is so many times the noise it was taken for: calibration got stuck."""
_LOUD = 2.0
"""Where the residual is more than so many times the noise, the noise's share of it does not matter."""
_QUIET = 1.2
"""Where the residual is less than so many times the noise, it is taken for noise."""


def log_evidence(problem: Problem, noise: Noise, f: Fit, loudness: float) -> float:
    """Log evidence of a fit under noise of a common loudness."""
    noise = noise if loudness < _QUIET else louder(noise, loudness)
    if loudness < _LOUD:
        return evaluate(problem, noise, f.model, f.theta, f.state, f.jacobian, f.twin_jacobian).log_evidence
    return evaluate(problem, noise, f.model, f.theta, (f.state[0], None), f.jacobian).log_evidence


@dataclass(frozen=True)
class Round:
    """One round of the search: a base model and what adding a cause to it gave.

    Attributes:
      base: the model to which causes were added.
      loudness: of the residual of `base`, in times the noise.
      screened: all hypotheses by their linearised gain.
      fits: finalists, best first.
      gains: their log evidence over the base's.
      nameable: whether each is large enough to be named, and beyond what tolerances can express.
    """

    base: Fit
    loudness: float
    screened: list[Screened]
    fits: list[Fit]
    gains: list[float]
    nameable: list[bool]

    @property
    def named(self) -> list[tuple[str, float]]:
        """Names and gains of those that could be named, best first."""
        return [
            (f.model[-1].cause.name, gain)
            for f, gain, nameable in zip(self.fits, self.gains, self.nameable, strict=True)
            if nameable
        ]


@dataclass(frozen=True)
class Search:
    """What the search found: the rounds, the chosen model, the noise, and the motion noise's share.

    `noise` is as loud as the chosen model's residual, `rounds_noise` is not.
    """

    rounds: tuple[Round, ...]
    chosen: Fit
    noise: Noise
    rounds_noise: Noise
    echo: Echo
    loudness: float


def converge(problem: Problem, noise: Noise, f: Fit, echo: Echo | None = None) -> Fit:
    """Fit on, with fresh derivatives, under noise a little quieter than the residual, until that no longer helps."""
    loudness = level(problem, noise, f)
    for _ in range(5):
        if loudness < _QUIET:
            break
        f = fit(problem, louder(noise, max(0.7 * loudness, 1.0)), f.model, f.theta, 4, 2.0, None, echo)
        before, loudness = loudness, level(problem, noise, f)
        if loudness > 0.93 * before:
            break
    return f


def _stuck(problem: Problem, f: Fit) -> bool:
    """Whether a number that the data know well is near the end of its tolerance: a local minimum, or an effect."""
    known = np.diag(f.covariance)[: problem.calibration.size] < 0.3**2
    return bool(np.any(known & (np.abs(f.theta[: problem.calibration.size]) > _STUCK)))


def _afresh(problem: Problem, noise: Noise, f: Fit, echo: Echo | None) -> Fit:
    """The same model calibrated anew, its effects as they are: numbers that stood in for an effect let go of it."""
    theta = np.concatenate([np.zeros(problem.size), f.theta[problem.size :]])
    again = fit(problem, louder(noise, 30.0), f.model, theta, 3, 5.0, None, echo)
    again = settle(problem, noise, f.model, again.theta, again.jacobian, echo, 5.0)
    again = converge(problem, noise, again, echo)
    if level(problem, noise, again) < _LOUD:  # far from where it began: to the end, with fresh columns
        again = fit(problem, noise, f.model, again.theta, 12, 1.0, None, echo)
    loudness = min(level(problem, noise, g) for g in (f, again))
    return max(f, again, key=lambda g: log_evidence(problem, noise, g, loudness))


def hand_over(problem: Problem, theta: np.ndarray, model: tuple[Hypothesis, ...]) -> np.ndarray:
    """The same joint with less strain: what a cause that scales numbers can do better than their tolerances, it does.

    Along that path products stay constant, which is straight to first order only: Gauss–Newton does not find the way.
    """
    theta = theta.copy()
    c, at = problem.calibration, problem.size
    for h in model:
        slots = _scaled(problem, h, theta[: c.size])
        if slots:
            x, u = theta[: c.size], theta[at : at + 1]
            best, options = np.inf, h.values(u)["scale"] * np.geomspace(0.6, 1.6, 121)
            for scale in (h.values(u)["scale"], *options):
                shares = _shares(problem, slots, x, h.values(u)["scale"] / scale)
                v = h.coordinates({"scale": scale})
                low, high = h.limits
                if shares is None or not low[0] <= v[0] <= high[0]:
                    continue
                cost = float(sum(y * y for y in shares.values()) + (v[0] / h.spread[0]) ** 2)
                if cost < best - 1e-9:
                    best, chosen = cost, (shares, v)
            if np.isfinite(best):
                for name, y in chosen[0].items():
                    theta[c.names.index(name)] = y
                theta[at : at + 1] = chosen[1]
        at += h.size
    return theta


def _scaled(problem: Problem, h: Hypothesis, x: np.ndarray) -> list:
    """The numbers with tolerances that a cause scales; none where it does something else."""
    if [q.name for q in h.free] != ["scale"]:
        return []
    one = problem.calibration.record(x, max(problem.mountings, key=lambda m: m.gravity_moment))
    two = one.copy()
    h.cause.apply(two[0], {"scale": 2.0})
    return [s for s in problem.calibration.slots if s.index < 0 and one[0][s.field] != two[0][s.field]]


def _shares(problem: Problem, slots: list, x: np.ndarray, factor: float) -> dict[str, float] | None:
    """Calibration variables that make the numbers `factor` times what they are at x; None where tolerances end."""
    c, joint = problem.calibration, problem.joint
    ratios = {s.name: factor * c.value(s, x) / s.number.value for s in slots}
    shared = {s.number.shared for s in slots}
    found: dict[str, float] = {}
    common = 1.0
    if shared != {None}:
        if len(shared) != 1:
            return None
        name = shared.pop()
        spread = joint.shared_tolerances[name]
        logs = np.log([ratios[s.name] for s in slots])
        own = np.array([s.number.tolerance for s in slots])
        weight = 1 / np.maximum(own, 1e-6) ** 2
        y = spread * np.sum(weight * logs) / (1 + spread**2 * np.sum(weight))
        found[f"shared {name}"] = float(y)
        common = 1 + spread * y
    for s in slots:
        if s.number.tolerance:
            found[s.name] = (ratios[s.name] / common - 1) / s.number.tolerance
    return found if all(abs(y) <= REACH for y in found.values()) else None


def held_out_loss(problem: Problem, noise: Noise, f: Fit, corrected: bool = True) -> float:
    """Robust sum of squares of the whitened residual on held-out samples; `corrected`: less the motion noise's share."""
    drives = [replace(d, usable=d.held_out) for d in problem.drives]
    total = robust_loss(whiten(drives, noise, [r[..., None] for r in f.state[0]])[:, 0], 10.0)[0]
    if corrected and f.state[1] is not None:
        total -= robust_loss(whiten(drives, noise, [r[..., None] for r in f.state[1]])[:, 0], 10.0)[0]
    return total


def significance(problem: Problem, f: Fit) -> float:
    """How many of its standard deviations the last effect of a fit is away from absent."""
    h = f.model[-1]
    before = problem.records(f.theta[: len(f.theta) - h.size], f.model[:-1])[0][0]
    absent = h.coordinates(h.cause.centre(before, h.fixed))[h.magnitudes]
    where = len(f.theta) - h.size + np.asarray(h.magnitudes)
    away = f.theta[where] - absent
    return float(np.sqrt(max(away @ np.linalg.solve(f.covariance[np.ix_(where, where)], away), 0.0)))


SIGNIFICANT = 4.0
"""Standard deviations that an effect must be away from absent."""
HELD_OUT_SHARE = 0.2
"""Of what an effect gains on the data of the fit, it must gain so much on as many held-out data."""


def _holds(
    problem: Problem, noise: Noise, base: Fit, f: Fit, gain: float, best: float, loudness: float, small: bool
) -> bool:
    """Whether an effect is significant, no stand-in for another, and improves data that the fit did not see.

    Args:
      small: it must stand out from what the laws leave over, too.
    """
    tempered = noise if loudness < _QUIET else louder(noise, loudness)
    scale = 1.0 if loudness < _QUIET else level(problem, noise, f)
    if _scaled(problem, f.model[-1], f.theta[: problem.calibration.size]):
        # Numbers strained against their tolerances are at odds with what is known of them, not with the data.
        relief = 0.5 * (prior_cost(problem, base.theta, base.model) - prior_cost(problem, f.theta, f.model))
        if relief > THRESHOLD:
            return True
    if gain < _PROXY * best:
        return False
    if small and significance(problem, with_dispersion(problem, noise, f)) < SIGNIFICANT:
        return False
    significant = significance(problem, f) >= SIGNIFICANT * scale
    share = sum(d.held_out.sum() for d in problem.drives) / max(sum(d.usable.sum() for d in problem.drives), 1)
    if share < 0.02:
        return significant
    before, after = (held_out_loss(problem, tempered, g, loudness < _LOUD) for g in (base, f))
    if loudness > _UNSETTLED and before - after > (2 * SIGNIFICANT * scale) ** 2:
        # Numbers at the end of their tolerances may leave an effect's size open, not its presence.
        significant = True
    return bool(significant and before - after > HELD_OUT_SHARE * 2 * gain * share)


def _start(problem: Problem, noise: Noise, base: Fit, s: Screened) -> np.ndarray:
    """Where to start a finalist: at the linear solution, a part of the way to it, or where the effect is absent."""
    model = (*base.model, s.hypothesis)
    low, high = bounds(problem, model)
    u = s.hypothesis.confine(np.clip(s.start, -3.0, 3.0))
    step = np.concatenate([np.clip(s.shift, -2.0, 2.0), u])
    absent = np.concatenate([base.theta, np.zeros(len(u))])
    starts = [np.clip(absent + part * step, low, high) for part in (1.0, 0.3, 0.0)]
    starts += [hand_over(problem, t, model) for t in starts]
    residuals = problem.residuals(starts, [model] * len(starts))
    costs = [
        robust_loss(whiten(problem.drives, noise, [r[..., None] for r in rs])[:, 0])[0]
        + prior_cost(problem, theta, model)
        for rs, theta in zip(residuals, starts, strict=True)
    ]
    return starts[int(np.nanargmin(costs))]


def _to_the_end(problem: Problem, noise: Noise, f: Fit, echo: Echo | None, loudness: float) -> Fit:
    if loudness > _QUIET:
        return converge(problem, noise, f, echo)
    return fit(problem, noise, f.model, f.theta, 8, 0.5, None, echo)


_SMALL, _SMALLEST_GAIN = 0.2, 100.0
"""A cause that earns less than this part of what the first did, or less than this, must stand out from what the laws
leave, too."""
_PROXY = 0.5
"""A cause that earns less than this part of what another earns, be that too small to be named, stands in for it."""


def _ranked(problem, noise, base: Fit, fits: list[Fit], loudness: float) -> tuple[list[Fit], list[float]]:
    """Fits by their gain in log evidence over the base, best first, and these gains."""
    reference = log_evidence(problem, noise, base, loudness)
    gains = [log_evidence(problem, noise, f, loudness) - reference for f in fits]
    order = np.argsort(gains)[::-1]
    return [fits[i] for i in order], [gains[i] for i in order]


def search(problem: Problem, hypotheses: list[Hypothesis], quantum: np.ndarray, most: int = 3) -> Search:
    """Find the causes: calibrate, screen, fit the finalists, add the best; again until none earns its place."""
    theta = problem.start(None, ())
    noise = first_guess(problem.drives, problem.residuals([theta], [()])[0], quantum)
    base = fit(problem, louder(noise, 30.0), (), theta, 3, 5.0)
    base = settle(problem, noise, (), base.theta, base.jacobian, None, 5.0)
    base = converge(problem, noise, base)
    rounds: list[Round] = []
    echoed: Echo | None = None
    estimated = again = False
    while True:
        loudness = level(problem, noise, base)
        library = Library(problem, base, [h for h in hypotheses if h.cause.name not in _names(base.model)],
                          PROBE if loudness < _LOUD else PROBE_LOUD)  # fmt: skip
        if loudness < _LOUD:
            if not estimated:
                problem.match_twins(excess(problem, base))
            cleaned = clean(problem, noise, base, library)
            noise = estimate(problem.drives, cleaned, quantum, sensors(problem, base), base.state[0])
            if not estimated:
                problem.match_twins(fine(problem, noise, base, cleaned))
                echoed = echo(problem, base.theta, base.model, base.jacobian)
            base = fit(problem, noise, base.model, base.theta, 5, 1.0, base.jacobian, echoed)
            estimated = True
            if level(problem, noise, base) > _UNSETTLED:
                base = converge(problem, noise, base, echoed)
            loudness = level(problem, noise, base)
        tempered = noise if loudness < _QUIET else louder(noise, loudness)
        screened = screen(problem, tempered, base, library)
        fits = []
        strained = bool(np.any(np.abs(base.theta[: problem.calibration.size]) > _STUCK))
        for s in finalists(screened, FINALISTS if loudness > _LOUD or strained else 2):
            model = (*base.model, s.hypothesis)
            start = _start(problem, tempered, base, s)
            fits.append(settle(problem, noise, model, start, base.jacobian, echoed, loudness))
        fits, gains = _ranked(problem, noise, base, fits, loudness)
        if len(gains) > 1 and gains[1] > max(0.5 * gains[0], 0.0):  # a close race is decided by fits at their ends
            rivals = [
                _to_the_end(problem, noise, f, echoed, loudness) if g > 0.5 * gains[0] else f
                for f, g in zip(fits, gains, strict=True)
            ]
            fits, gains = _ranked(problem, noise, base, rivals, loudness)
        nameable = [
            size(f.model[-1], problem.split(f.theta, f.model)[-1]) > SMALLEST
            and not problem.is_calibration(f.theta, f.model)
            for f in fits
        ]
        rounds.append(Round(base, loudness, screened, fits, gains, nameable))
        before = rounds[0].gains[0] if len(rounds) > 1 else 0.0
        small = loudness < _QUIET and bool(gains) and gains[0] < max(_SMALL * before, _SMALLEST_GAIN)
        earned = [
            f
            for f, gain, named in zip(fits, gains, nameable, strict=True)
            if named and gain > THRESHOLD and _holds(problem, noise, base, f, gain, gains[0], loudness, small)
        ]
        if not earned and not again and (loudness > _UNSETTLED or _stuck(problem, base)):
            again, other = True, _afresh(problem, noise, base, echoed)
            if other is not base:
                base = other
                rounds.pop()
                continue
        if not earned or len(base.model) >= most:
            break
        base = converge(problem, noise, earned[0], echoed)
        if level(problem, noise, base) > _LOUD or _stuck(problem, base):
            base = _afresh(problem, noise, base, echoed)
    loudness = level(problem, noise, base)
    if echoed is None:
        echoed = echo(problem, base.theta, base.model, base.jacobian)
    if base.model:
        # What either can express, numbers and effects share as the priors say: to the end, with fresh columns.
        quiet = noise if loudness < _QUIET else louder(noise, loudness)
        if loudness < _QUIET:  # all that is left is noise: now it is known how much of it the motion brings
            problem.match_twins(fine(problem, noise, base, base.state[0]))
            echoed = echo(problem, base.theta, base.model, base.jacobian)
        theta = hand_over(problem, base.theta, base.model)
        base = fit(problem, quiet, base.model, theta, 8, 0.5, None, echoed)
        if _stuck(problem, base):
            base = _afresh(problem, quiet, base, echoed)
    return Search(tuple(rounds), base, noise if estimated else louder(noise, loudness), noise, echoed, loudness)


def _names(model: tuple[Hypothesis, ...]) -> set[str]:
    return {h.cause.name for h in model}
