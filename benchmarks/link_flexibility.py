"""Diagnose joints whose link is not rigid with and without that cause, for docs/link_flexibility.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import welch

from flexspline.diagnosis.data import coverage
from flexspline.diagnosis.data.segments import LINK, segments
from flexspline.diagnosis.fit.coordinates import Hypothesis, hypotheses
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.fit.solver import Fit, Fitter
from flexspline.diagnosis.search.calibrate import calibrate
from flexspline.diagnosis.search.explore import Explored, Explorer
from flexspline.diagnosis.search.posterior import quiet_rms
from flexspline.diagnosis.trials.motions import motions, record_motion
from flexspline.models import causes
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement, Recording
from flexspline.views import style

FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "link_flexibility.png"
SEED = 5
HIDDEN = (
    {"share": 0.3, "frequency": 14.0, "damping": 0.02},
    {"share": 0.4, "frequency": 20.0, "damping": 0.1},
    {"share": 0.3, "frequency": 8.0, "damping": 0.3},
)
NUMBERS = ("df", "bl", "dw", "Jm", "Jl")


def recorded(hidden: dict[str, float]) -> Measurement:
    """Three motions of a test joint that is as described but for its link: encoders and current, no torque sensor."""
    nominal = load_joint("test-joint")
    found: list[Recording] = []
    for k, scenario in enumerate(motions(np.random.default_rng(SEED))):
        mounting = scenario.mount(nominal)
        record = nominal.record(mounting)
        causes.get("link_flexibility").apply(record[0], hidden)
        found.append(record_motion(nominal, mounting, record, scenario, SEED + k).without("joint_torque"))
    return Measurement("flexible link", Path(), tuple(found))


@dataclass(frozen=True)
class Comparison:
    """One measurement diagnosed with the whole library and without a flexible link in it.

    Attributes:
      problem: the measurement.
      whole, rigid: the searches.
      delay: the calibrated rigid joint with a late link encoder.
    """

    problem: Problem
    whole: Explored
    rigid: Explored
    delay: Fit

    def numbers(self, f: Fit) -> dict[str, float]:
        """`NUMBERS` of a fit's joint over the true ones; of Jl, the link's whole inertia."""
        true = self.problem.joint.record(self.problem.mountings[-1])[0]
        record = self.problem.records(f.theta, f.model)[-1][0]
        return {name: float(record[name] / true[name]) for name in NUMBERS}

    def effects(self, f: Fit) -> dict[str, dict[str, float]]:
        """Parameters of a fit's causes, by name."""
        parts = self.problem.split(f.theta, f.model)
        return {h.cause.name: h.values(u) for h, u in zip(f.model, parts, strict=True)}


def compared(hidden: dict[str, float]) -> Comparison:
    """Diagnose a joint with that flexibility of its link."""
    measurement = recorded(hidden)
    nominal = load_joint("test-joint")
    problem = Problem(*segments(list(measurement.recordings), nominal), nominal)
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    available = [n for n in causes.of(nominal) if coverage.can_show(n, measurement, problem.link_measured)]

    def tried(names: Sequence[str]) -> list[Hypothesis]:
        return [h for n in names for h in hypotheses(causes.get(n), record)]

    def search(names: Sequence[str]) -> Explored:
        fitter = Fitter(problem)
        base = calibrate(fitter)
        return Explorer(fitter, tried(names)).explore(base, base)

    whole = search(available)
    rigid = search([n for n in available if n != "link_flexibility"])
    (late,) = tried(["encoder_delay"])
    start = np.concatenate([rigid.base.theta, np.zeros(late.size)])
    return Comparison(problem, whole, rigid, Fitter(problem).fit((late,), start))


def named(effects: dict[str, dict[str, float]]) -> str:
    """Causes with their parameters."""
    text = [f"{n} ({', '.join(f'{k} {v:.3g}' for k, v in values.items())})" for n, values in effects.items()]
    return "; ".join(text) or "nothing"


def spectrum(c: Comparison, f: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Magnitude of the link balance's residual in the last recording: frequencies [Hz], N·m/√Hz."""
    segment, r = c.problem.segments[-1], f.point.residual[-1][:, LINK]
    step = float(np.median(np.diff(segment.at)))
    frequency, power = welch(np.where(segment.usable[:, LINK], r, 0.0), 1 / step, nperseg=min(1024, len(r)))
    return frequency, np.sqrt(power)


def figure(c: Comparison, path: Path) -> None:
    """What is left of the link's balance: calibrated, with the other causes, with the flexible link."""
    fig, ax = plt.subplots(figsize=(8, 3.8))
    for f, label, color in (
        (c.rigid.base, "calibrated, rigid link", style.SENSOR),
        (c.rigid.best, "with what the library has without a flexible link", style.FILTERS["AREKF"]),
        (c.whole.best, "with a flexible link", style.TRUTH),
    ):
        ax.semilogy(*spectrum(c, f), color=color, lw=1.3, label=label)
    ax.set(xlim=(0, 60), xlabel="frequency [Hz]", ylabel="N·m/√Hz", title="What is left of the link's balance")
    ax.grid(alpha=0.25)
    ax.legend(fontsize=8)
    fig.tight_layout()
    fig.savefig(path, dpi=110)
    plt.close(fig)


def main() -> None:
    """Print the table and draw the figure."""
    for i, hidden in enumerate(HIDDEN):
        c = compared(hidden)
        numbers = " | ".join(f"{x:.2f}" for x in c.numbers(c.rigid.best).values())
        late = 1e3 * c.effects(c.delay)["encoder_delay"]["seconds"]
        print(f"| {hidden} | {numbers} | {late:.2f} ms | {named(c.effects(c.rigid.best))} | ", end="")
        rigid, whole = (quiet_rms(c.problem, x.best) for x in (c.rigid, c.whole))
        print(f"{rigid:.1f} | {named(c.effects(c.whole.best))} | {whole:.1f} |", flush=True)
        if i == 0:
            figure(c, FIGURE)
