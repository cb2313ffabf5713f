"""What a diagnosis came to, before it is told, and the settings of how it is told."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..models import causes
from .fit.regions import DrawnBack
from .fit.residual import Problem
from .fit.solver import Fit
from .search.discrepancy import Unknown
from .search.explore import Explored


@dataclass(frozen=True)
class AnswerSettings:
    """How what was found is told.

    Attributes:
      surest: largest confidence; unsure: of what does not hold where it was not fitted, or could be anything.
      small: share of a cause's probability that must be that of an effect, for it not to be minor; likely: probability of an
        effect below which it is minor, too; slight: worth over what nothing explains (RMS) below which it is.
      quiet: normalised RMS against the sensors' noise up to which nothing but noise is left.
      nearly_all: share of the causes that could not have shown, from which on a measurement is inconclusive.
      about: part of what one effect is worth from which on another is worth about the same: it is known no better than that.
      inflation: largest factor on standard deviations where more than noise is left; lookalike: part of an effect's ordinary size
        that may then be small imperfections which look like it; inexact_size: where only noise is left, part that may be the
        reconstruction of the motion from counts; inexact_bias: part that is not known of by how much the motion's noise moves a
        number: in the mean it is one draw, and to second order, and averages are not free of it.
      diluted: part of the information about an inertia that may be the encoders' noise, for it to be sure.
      useless: ratio of the mean square that is left with causes to the one without from which on no cause is sure.
      end: standard deviations of its tolerance from which on a number is at the end of it: no variable goes beyond 2.6
        (`fit.residual.REACH`).
      far, worth: a residual so many times the sensors' noise, and of so large a share of the rated torque, is never consistent;
        near: so many times the noise, where the fit was taken back that would explain it.
      apart: error of a recording by the description over that of every other, from which on it may be of another joint, where
        more than `explained` of it is left with what was found.
      rezeroed: by how much the link encoder's zero differs between recordings from which on that is told, in torsions under the
        rated torque: a stiffness that is off does less; less: logarithm by which what the description leaves must become less.
      lost: ratio of mean squares that are left after a correction and before it from which on it went astray.
      chance: part of the sensors' noise (mean square) by which what is left may differ by chance.
    """

    surest: float = 0.99
    unsure: float = 0.5
    small: float = 0.5
    likely: float = 0.25
    slight: float = 0.3
    quiet: float = 1.25
    nearly_all: float = 2 / 3
    about: float = 0.9
    inflation: float = 5.0
    lookalike: float = 0.05
    inexact_size: float = 0.01
    inexact_bias: float = 0.35
    end: float = 2.55
    far: float = 5.0
    near: float = 2.0
    worth: float = 0.02
    apart: float = 5.0
    explained: float = 0.5
    rezeroed: float = 0.2
    less: float = 0.3
    diluted: float = 0.1
    useless: float = 1.05
    lost: float = 2.25
    chance: float = 0.1


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
      surest: largest confidence of a cause.
      zeros: by how much the link encoder's zero of each recording lies from that of the first [rad]; empty where it is one.
    """

    problem: Problem
    found: Explored
    unknown: Unknown | None
    judged: Fit
    final: Fit
    drawn: DrawnBack
    missing: dict[str, str]
    undetermined: dict[str, str]
    alike: tuple[tuple[str, str], ...]
    surest: float = 1.0
    zeros: dict[str, float] = field(default_factory=dict)

    @property
    def nearly_all(self) -> bool:
        """Whether nearly all causes could not have shown."""
        return len(self.undetermined) >= ANSWER.nearly_all * len(causes.of(self.problem.joint))
