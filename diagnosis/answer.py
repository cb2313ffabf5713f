"""The answer of a diagnosis: causes, their confidence, and the evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..models.files import plain
from ..models.joint import Joint
from ..models.notebook import html_table, paragraph
from ..models.recording import Measurement
from .data.mistakes import Mistake
from .fit.regions import Region
from .fit.residual import Problem
from .fit.solver import Fit
from .regression import Regression
from .search.explore import Decision, Explored

if TYPE_CHECKING:
    from .planning import Plan


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter of a cause: value, standard deviation, unit."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Finding:
    """A cause that was found.

    Attributes:
      name, component: as in the library, or `unknown`.
      confidence: posterior probability of this cause.
      parameters: of the extended model.
      explains: share of the held-out residual that it removes, in mean squares of output torque.
      contribution: RMS that it alone removes from the simulation error [N·m at the output]; of several causes,
        together with `estimation`.
      description, depends_on: of an unknown effect.
      estimation: RMS that it removes from the error of torque estimates [N·m]; NaN for one cause, or if no torque was measured.
    """

    name: str
    component: str
    confidence: float
    parameters: dict[str, ParameterEstimate]
    explains: float
    contribution: float
    description: str = ""
    depends_on: tuple[str, ...] = ()
    estimation: float = float("nan")

    @property
    def determined(self) -> bool:
        """Whether its parameters are known: phases within a quarter of a turn, a size above its standard deviation."""
        sizes = [p for name, p in self.parameters.items() if name not in ("phase", "order")]
        phase = self.parameters.get("phase")
        return (phase is None or phase.std < math.pi / 2) and (not sizes or any(abs(p.value) > p.std for p in sizes))

    def to_json(self) -> dict[str, Any]:
        """Return the entry in `diagnosis.json`."""
        entry: dict[str, Any] = {
            "name": self.name,
            "component": self.component,
            "confidence": round(self.confidence, 3),
            "parameters": plain(self.parameters),
            "explains": round(self.explains, 4),
            "worth": {"value": self.contribution, "unit": "N·m"},
        }
        if math.isfinite(self.estimation):
            entry["worth"]["estimation"] = self.estimation
        if self.name == "unknown":
            entry["description"] = self.description
            entry["depends_on"] = list(self.depends_on)
        return entry


@dataclass(frozen=True)
class ParameterShift:
    """A number that calibration moved within its tolerance; `moved`: by how many of its standard deviations."""

    nominal: float
    value: float
    std: float
    tolerance: float
    unit: str
    moved: float = 0.0


@dataclass(frozen=True)
class BalanceResidual:
    """RMS of one balance on held-out data: with the calibrated joint, with the extended joint, and of the sensors' noise."""

    before: float
    after: float
    noise: float
    unit: str


@dataclass(frozen=True)
class Diagnosis:
    """The answer of a diagnosis.

    Attributes:
      verdict: consistent, discrepancy or inconclusive; reasons: for it, and for what limits the answer.
      causes: by contribution; minor: effects too small to be causes.
      calibration: numbers that moved.
      confusable: pairs of confounded causes.
      undetermined: causes that this measurement cannot show at ordinary size, with the reason.
      residual: by balance.
      regions: errors in held-out regions, the worst first.
      extended: the joint with calibration and effects; unseen: the same, fitted without the held-out blocks, None if equal.
      mistakes: in the data.
      decisions: about every hypothesis of the search.
      problem, search: of the computation; None for data with severe mistakes.
      final: fit of the extended joint: `whole`, the fit to the data, shrunk to `share` of its way from the description.
      before, after: residuals of every segment, shape (k, len(BALANCES)).
      estimation: gain for torque estimates.
      plan: what to measure next (`planning.plan`), if asked for.
      held_out: how data were held out.
      regressions: plain regressions of each torque channel.
      used: the parts of the measurement that were diagnosed; None without a diagnosis.
      drive_torque: torque constant of the drive [N·m/A] if it reported a torque and no current, else 0. The drive's balance
        is then `motor_torque` in `residual` [N·m].
      complete: whether time sufficed for all stages; seconds: run time.
    """

    verdict: str
    reasons: tuple[str, ...]
    causes: tuple[Finding, ...]
    calibration: dict[str, ParameterShift]
    confusable: tuple[tuple[str, str], ...]
    undetermined: dict[str, str]
    residual: dict[str, BalanceResidual]
    regions: tuple[Region, ...]
    extended: Joint
    minor: tuple[Finding, ...] = ()
    mistakes: tuple[Mistake, ...] = ()
    decisions: tuple[Decision, ...] = field(default=(), repr=False)
    problem: Problem | None = field(default=None, repr=False)
    search: Explored | None = field(default=None, repr=False)
    final: Fit | None = field(default=None, repr=False)
    whole: Fit | None = field(default=None, repr=False)
    share: float = 1.0
    unseen: Joint | None = field(default=None, repr=False)
    before: list[np.ndarray] = field(default_factory=list, repr=False)
    after: list[np.ndarray] = field(default_factory=list, repr=False)
    estimation: dict[str, Any] | None = None
    plan: Plan | None = field(default=None, repr=False)
    held_out: str = ""
    regressions: tuple[Regression, ...] = ()
    drive_torque: float = 0.0
    complete: bool = True
    seconds: float = 0.0
    used: Measurement | None = field(default=None, repr=False)

    @property
    def reason(self) -> str:
        """The reasons as one line of `diagnosis.json`."""
        return "; ".join(self.reasons)

    def logged_as(self, balance: str) -> tuple[str, float]:
        """Return the log's channel of a balance, and the factor from the balance's unit to the channel's."""
        if self.drive_torque and balance == "motor_current":
            return "motor_torque", self.drive_torque
        return balance, 1.0

    @property
    def mendable(self) -> bool:
        """Whether a known change corrects every severe mistake."""
        return all(m.sure for m in self.mistakes if m.severe)

    def __repr__(self) -> str:
        named = ", ".join(f"{c.name} {c.confidence:.2f}" for c in self.causes) or "no cause"
        return f"Diagnosis({self.verdict!r}: {named}{'; ' if self.reasons else ''}{self.reason})"

    def _repr_html_(self) -> str:
        causes_ = [
            (
                c.name.replace("_", " "), c.component, f"{100 * c.confidence:.0f} %", f"{100 * c.explains:.0f} %", c.contribution,
                c.description
                or ", ".join(f"{k} = {p.value:.4g} ± {p.std:.2g} {p.unit}".rstrip() for k, p in c.parameters.items()),
            )
            for c in self.causes
        ]  # fmt: skip
        residual = [(name, r.before, r.after, r.noise, r.unit) for name, r in self.residual.items()]
        return "".join(
            (
                paragraph(self.verdict, self.reason),
                *(paragraph(f"{m.name}:", f"{m.column} {m.description}") for m in self.mistakes),
                html_table(("cause", "component", "sure", "explains", "contribution [N·m]", "parameters"), causes_),
                html_table(("residual", "before", "after", "noise", "unit"), residual),
                paragraph("Confounded:", "; ".join(" and ".join(p) for p in self.confusable))
                if self.confusable
                else "",
                paragraph("Undetectable:", ", ".join(self.undetermined)) if self.undetermined else "",
                "" if self.plan is None else self.plan._repr_html_(),
            )
        )

    def to_json(self) -> dict[str, Any]:
        """Return the content of `diagnosis.json`."""
        shifts = {k: {name: x for name, x in vars(m).items() if name != "moved"} for k, m in self.calibration.items()}
        decisions = [
            {
                "stage": d.stage, "cause": d.cause, "parameters": d.fixed, "gain": float(f"{d.gain:.4g}"),
                "size": round(d.size, 4), "taken": d.taken, "reason": d.reason,
            }
            for d in self.decisions
        ]  # fmt: skip
        return plain(
            {
                "verdict": self.verdict, "reason": self.reason, "causes": self.causes, "minor": self.minor,
                "calibration": shifts, "confusable": self.confusable, "undetermined": list(self.undetermined),
                "residual": self.residual, "regressions": self.regressions, "regions": self.regions,
                "estimation": self.estimation, "held_out": self.held_out, "next": self.plan, "mistakes": self.mistakes,
                "decisions": decisions, "complete": self.complete,
            }
        )  # fmt: skip
