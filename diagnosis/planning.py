"""What to measure next: how much each possible motion would tell about what the measurement left open.

Every motion is taken as the drive would ideally follow it; the Fisher information that the sensors would gain on it is
added to what the measurement has given, all calibration variables free within tolerance. No measuring, no plant: the
derivatives of the replay along that motion are all that is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..models import causes, laws
from ..models.joint import Joint, Mounting
from ..scenarios.scenario import Scenario, load_scenario
from ..sim.recording import Recording
from .calibrate import Problem
from .challenge import _waypoints
from .coordinates import Hypothesis, hypotheses
from .diagnose import Diagnosis
from .evidence import THRESHOLD
from .identify import ALIKE, _distance
from .noise import ChannelNoise, Noise, whiten
from .noise import estimate as estimate_noise
from .replay import drives

SHIPPED = ("link_sweep", "external_push")
"""Shipped scenarios that are proposed; `no_load`, 82 s at 2 °/s, never tells more than the free sweeps below."""
_VARIANTS = 3  # hypotheses a cause is represented by


@dataclass(frozen=True)
class Question:
    """What the measurement left open: whether a cause is there, or which of two.

    Attributes:
      names: one cause, or a pair.
      now: log evidence at ordinary size that the measurement has for it.
      needed: log evidence that decides.
    """

    names: tuple[str, ...]
    now: float
    needed: float

    @property
    def text(self) -> str:
        """For people."""
        return " or ".join(n.replace("_", " ") for n in self.names)


@dataclass(frozen=True)
class Proposal:
    """A motion, and the log evidence for each question once it has been measured too.

    Attributes:
      name: of a shipped scenario (`shipped`), or of a motion.
      description: for people.
      duration: [s].
      expected: shape (questions,).
    """

    name: str
    description: str
    shipped: bool
    duration: float
    expected: tuple[float, ...]


@dataclass(frozen=True)
class Plan:
    """Open questions and motions, the one that answers most first; and causes that only another sensor shows."""

    questions: tuple[Question, ...]
    proposals: tuple[Proposal, ...]
    needs_sensor: tuple[str, ...]

    def answered(self, proposal: Proposal) -> list[Question]:
        """Questions that a proposal is expected to decide."""
        return [q for q, e in zip(self.questions, proposal.expected, strict=True) if e >= q.needed]


def plan(diagnosis: Diagnosis, joint: Joint) -> Plan:
    """Open questions of a diagnosis, and what each motion would tell about them.

    Args:
      joint: the description that diagnosis was given.
    """
    problem = diagnosis.problem
    missing = tuple(
        n for n in diagnosis.undetermined if not problem.has_torque and "joint_torque" in causes.get(n).needs
    )
    singles = [(n,) for n in diagnosis.undetermined if n not in missing and n in causes.names()]
    pairs = [pair for pair in diagnosis.confusable if set(pair) <= set(causes.names()) - set(missing)]
    open_ = [*singles, *pairs]
    if not open_:
        return Plan((), (), missing)
    base = diagnosis.rounds[0].base
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    wanted = {name: _variants(name, record) for names in open_ for name in names}
    tried = [h for group in wanted.values() for h in group]
    noise = estimate_noise(problem.drives, diagnosis.after, np.zeros(3))
    known = _information(problem, noise, base.theta, base.jacobian, tried)
    now = [_evidence(known, problem.size, tried, names) for names in open_]
    questions = tuple(
        Question(names, e, THRESHOLD if len(names) == 1 else 0.5 * ALIKE) for names, e in zip(open_, now, strict=True)
    )
    questions = tuple(q for q in questions if q.now < q.needed)
    if not questions:
        return Plan((), (), missing)
    proposals = []
    for scenario, description, shipped in _motions(joint):
        mounting = joint.mount(scenario.mounting or None)
        record = problem.calibration.record(base.theta[: problem.calibration.size], mounting)
        recording = ideal_recording(record, mounting, scenario, problem.has_torque)
        new = Problem(*drives([recording], joint), joint)
        if not new.drives:
            continue
        state = new.residuals([base.theta], [()])[0]
        jacobian = new.jacobian(base.theta, (), state)
        more = _information(new, _typical(problem, noise, len(new.drives)), base.theta, jacobian, tried)
        expected = tuple(_evidence(known + more, problem.size, tried, q.names) for q in questions)
        proposals.append(Proposal(scenario.name, description, shipped, scenario.duration, expected))

    def worth(p: Proposal) -> float:
        shares = [min(e / q.needed, 1.0) for q, e in zip(questions, p.expected, strict=True)]
        return sum(shares) + 1e-3 * sum(np.log1p(e) for e in p.expected) - 1e-4 * p.duration

    return Plan(questions, tuple(sorted(proposals, key=lambda p: -worth(p))), missing)


def _variants(name: str, record: np.ndarray) -> list[Hypothesis]:
    found = hypotheses(causes.get(name), record)
    return [found[i] for i in np.unique(np.linspace(0, len(found) - 1, min(_VARIANTS, len(found))).astype(int))]


def _information(problem: Problem, noise: Noise, theta, jacobian, tried: list[Hypothesis]) -> np.ndarray:
    """Fisher information about the common unknowns and the magnitudes of the hypotheses."""
    thetas, models, probe = [], [], 0.1
    for h in tried:
        for j in h.magnitudes:
            u = np.zeros(h.size)
            u[j] = probe
            thetas.append(np.concatenate([theta, u]))
            models.append((h,))
    # A cause that replaces a number takes its calibration away: the difference is to the same cause at its neutral value.
    neutral = [np.concatenate([theta, np.zeros(len(t) - len(theta))]) for t in thetas]
    base = problem.residuals(neutral, models)
    moved = problem.residuals(thetas, models)
    stack = []
    for s, J in enumerate(jacobian):
        columns = [(m[s] - b[s])[..., None] / probe for m, b in zip(moved, base, strict=True)]
        stack.append(np.concatenate([J[..., : problem.size], *columns], axis=-1))
    X = whiten(problem.drives, noise, stack)
    X = X[np.all(np.isfinite(X), axis=1)]
    return X.T @ X


def _evidence(information: np.ndarray, n: int, tried: list[Hypothesis], names: tuple[str, ...]) -> float:
    """Log evidence expected at ordinary size: of a cause's presence, or of one cause against another."""
    H = information[:n, :n] + np.eye(n)
    left = information[n:, n:] - information[n:, :n] @ np.linalg.solve(H, information[:n, n:])
    blocks: dict[str, list[slice]] = {}
    position = 0
    for h in tried:
        blocks.setdefault(h.cause.name, []).append(slice(position, position + len(h.magnitudes)))
        position += len(h.magnitudes)
    if len(names) == 1:
        strengths = [float(np.trace(left[b, b]) / max(b.stop - b.start, 1)) for b in blocks[names[0]]]
        return 0.5 * float(np.median(strengths))
    return 0.5 * max(_distance(left, blocks[names[0]], blocks[names[1]]), 0.0)


def _typical(problem: Problem, noise: Noise, count: int) -> Noise:
    """Noise of the measurement's stretches, for stretches that are not measured yet: of each channel the middle one."""
    channels: list[ChannelNoise] = []
    for c in range(3):
        seen = [n[c] for d, n in zip(problem.drives, noise, strict=True) if d.usable[:, c].sum() > 100]
        channels.append(sorted(seen, key=lambda n: n.white)[len(seen) // 2] if seen else noise[0][c])
    return [channels] * count


def _motions(joint: Joint):
    """Motions that could be measured: scenario, description, whether it is shipped."""
    found = []
    for name in SHIPPED:
        scenario = load_scenario(name)[0]
        if scenario.mounting in ("", *joint.mountings):
            found.append((scenario, scenario.description, True))
    lightest = min(joint.mountings, key=lambda m: joint.mountings[m].gravity_moment)
    there_and_back = [1.3, -1.3, 1.3, 0.0]

    def motion(name, mounting, seconds, text):
        points = _waypoints(there_and_back, [0.5 * seconds, seconds, seconds, 0.5 * seconds], [1, 1, 1, 1], 0.5)
        scenario = Scenario(name=name, mounting=mounting, duration=points[-1].time + 0.5, trajectory=points)
        found.append((scenario, text, False))

    motion("sweeps", joint.mounting, 7.0, f"mounting {joint.mounting}, ±1.3 rad and back, 7 s each way")
    motion("fast_sweeps", joint.mounting, 3.5, f"mounting {joint.mounting}, ±1.3 rad and back, 3.5 s each way")
    if lightest != joint.mounting:
        motion("free_sweeps", lightest, 4.0, f"mounting {lightest}, ±1.3 rad and back, 4 s each way")
    return found


def ideal_recording(record: np.ndarray, mounting: Mounting, scenario: Scenario, sensor: bool) -> Recording:
    """What noiseless sensors would read if the link of a joint with this record followed a scenario's command exactly."""
    position, velocity = scenario.commands()
    external = scenario.external_torque()
    time = scenario.time
    columns = np.empty((len(time), 3))
    _inverse(record, time, position, velocity, np.gradient(velocity, time), external, columns)
    return Recording(
        name=scenario.name,
        time=time,
        motor_position=columns[:, 0],
        link_position=position + record[0]["link_zero"],
        motor_current=columns[:, 1],
        joint_torque=columns[:, 2] if sensor else None,
        external_torque=external if np.any(external) else None,
        link=mounting,
        external="measured" if np.any(external) else "none",
    )


@njit(cache=True)
def _inverse(record, time, q, v, a, external, out):
    """Rotor angle [rad], motor current [A] and joint torque [N·m] that a motion of the link takes, quasi-static friction."""
    p = record[0]
    for i in range(len(q)):
        Ts = p.Jl * a[i] - laws.gravity_torque(q[i], p) - laws.link_torque(q[i], p) - external[i]
        Tf = Ts + p.bl * v[i]
        wound = laws.flexspline_torsion(Tf, p)
        theta_w = p.N * (q[i] + wound)
        for _ in range(3):
            theta_w = p.N * (q[i] + wound + laws.kinematic_error(theta_w, p))
        w = p.N * v[i]
        g = laws.friction_level(w, q[i], Tf, time[i], p)
        Tw = (
            Tf * (1.0 / p.N - laws.kinematic_error_slope(theta_w, p))
            + g * np.tanh(w / p.vs)
            + p.bw * w
            + p.Jw * p.N * a[i]
        )
        out[i, 0] = theta_w + laws.wave_generator_torsion(Tw, p)
        out[i, 1] = (Tw + p.Jm * p.N * a[i] + p.bm * w - laws.rotor_torque(theta_w, p)) / p.Kt
        out[i, 2] = Ts
