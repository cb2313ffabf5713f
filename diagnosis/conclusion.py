"""What a diagnosis came to, before it is told, and the settings of how it is told."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..models import causes
from .fit.regions import DrawnBack
from .fit.residual import Problem
from .fit.solver import Fit
from .search.acceptance import MORE_THAN_NOISE
from .search.discrepancy import Unknown
from .search.stages import Search


@dataclass(frozen=True)
class AnswerSettings:
    """How what was found is told.

    Attributes:
      temper: by how much log evidence is divided before it becomes a probability: the laws are not exact and neither is the noise
        model; `inexact` of what other hypotheses still gain is added.
      significant: standard deviations that an effect must be away from absent where the fit ends; by those that are inflated, it
        is no surer than `beside` below, and minor below `barely`; plainly: one worth so many times what nothing explains is never
        minor for it, and may be sure from `barely` on.
      slim: share of what all effects are worth together (mean square) below which one is sure only from `clearly` standard
        deviations on, and an unknown one never: what a law of another leaves, in the hundredths, may look like it.
      entangled: share of what two effects are worth together (mean square) below which what either is worth beside the other says
        nothing: how they share it is not told, and neither is sure.
      surest: largest confidence; beside: of a cause beside which an unknown effect was found; unsure: of what does not hold where
        it was not fitted, or could be anything.
      plain_share: share of the explanations from which on a cause and its special cases are told apart.
      nearly_all: share of the causes that could not have shown, from which on a measurement is inconclusive.
      minor, quiet: part of the ordinary size below which an effect is minor, where the residual is more than `quiet` times the
        sensors' noise even with all of them: a real joint has a little of everything. Minor effects are part of the extended
        joint, and told, but none of the causes.
      little: part of the rated torque that an unknown effect must be worth there, not to be a minor one; or `mostly` of what all
        effects are worth together (mean square), or so much that what nothing explains would be `plainer` times as large (mean
        square) without it: what real joints have a little of everything of does not stand out so.
      about: part of what one effect is worth from which on another is worth about the same: it is known no better than that.
      inflation: largest factor on standard deviations where more than noise is left; lookalike: part of an effect's ordinary size
        that may then be small imperfections which look like it; inexact_size: where only noise is left, part that may be the
        reconstruction of the motion from counts; inexact_bias: part that is not known of by how much the motion's noise moves a
        number: in the mean it is one draw, and to second order, and averages are not free of it.
      slight: part of the root mean square of what nothing explains that a cause beside an unknown effect must be worth.
      diluted: part of the information about an inertia that may be the encoders' noise, for it to be sure.
      useless: ratio of the mean square that is left with causes to the one without from which on no cause is sure.
      simpler: ratio of errors on regions that a fit has not seen up to which, where nearly nothing could have shown, numbers
        as described are preferred to numbers that calibration moved.
      orders: so many orders of one law of the link's angle any law of it has: none of them is sure then.
      end: standard deviations of its tolerance from which on a number is at the end of it: no variable goes beyond 2.6
        (`fit.residual.REACH`); crowded: so many numbers there, with one encoder, beside which no cause is likely.
      far, worth: a residual so many times the sensors' noise, and of so large a share of the rated torque, is never consistent,
        and with one encoder no cause is sure where so many times the noise is left, nor likely where it is the link's (`behind`);
        near: so many times the noise, where the fit was taken back that would explain it.
      apart: error of a recording by the description over that of every other, from which on it may be of another joint, where
        more than `explained` of it is left with what was found.
      stribeck: tolerance of static friction apart from Coulomb friction, where orders that cancel each other have stood for it.
      rezeroed: by how much the link encoder's zero differs between recordings from which on that is told, in torsions under the
        rated torque: a stiffness that is off does less; less: logarithm by which what the description leaves must become less.
    """

    temper: float = 5.0
    inexact: float = 0.02
    significant: float = 3.0
    barely: float = 2.0
    plainly: float = 2.0
    slim: float = 0.01
    clearly: float = 5.0
    entangled: float = 0.01
    surest: float = 0.99
    unsure: float = 0.5
    behind: float = 0.45
    beside: float = 0.7
    plain_share: float = 0.95
    nearly_all: float = 2 / 3
    minor: float = 0.12
    quiet: float = MORE_THAN_NOISE
    little: float = 0.015
    mostly: float = 0.6
    plainer: float = 4.0
    about: float = 0.9
    inflation: float = 5.0
    lookalike: float = 0.05
    inexact_size: float = 0.01
    inexact_bias: float = 0.35
    slight: float = 0.25
    end: float = 2.55
    crowded: int = 3
    far: float = 5.0
    near: float = 2.0
    worth: float = 0.02
    apart: float = 5.0
    explained: float = 0.5
    stribeck: float = 0.2
    rezeroed: float = 0.2
    less: float = 0.3
    diluted: float = 0.1
    useless: float = 1.05
    simpler: float = 2.0
    orders: int = 3


ANSWER = AnswerSettings()


@dataclass(frozen=True)
class Conclusion:
    """What was found, before it is told.

    Attributes:
      found, unknown: what the search came to, and an unknown effect beside it.
      judged: the model at its end, from which blocks of the data were kept.
      final: the same, with one encoder fitted to these blocks too; drawn: that, drawn back to what holds where it was not fitted.
      missing: causes that such a measurement cannot show at ordinary size, with the reason.
      undetermined: these and others that could not have shown; alike: pairs that look the same.
      doubted: causes in whose place an unknown effect might stand (`discrepancy.UnknownEffects`).
      surest: largest confidence of a cause.
      zeros: by how much the link encoder's zero of each recording lies from that of the first [rad]; empty where it is one.
      behind: whether much is left where the rotor's motion follows from the link's: nothing is sure but what the link's own
        balance tells.
    """

    problem: Problem
    found: Search
    unknown: Unknown | None
    judged: Fit
    final: Fit
    drawn: DrawnBack
    missing: dict[str, str]
    undetermined: dict[str, str]
    alike: tuple[tuple[str, str], ...]
    doubted: frozenset[tuple[Any, ...]] = frozenset()
    surest: float = 1.0
    zeros: dict[str, float] = field(default_factory=dict)
    behind: bool = False

    @property
    def nearly_all(self) -> bool:
        """Whether nearly all causes could not have shown."""
        return len(self.undetermined) >= ANSWER.nearly_all * len(causes.of(self.problem.joint))

    @property
    def only_unknown(self) -> bool:
        """Whether no known cause was found, and what else was does not hold everywhere that it was not fitted."""
        return self.unknown is not None and not self.found.chosen.model and self.drawn.share < 1.0
