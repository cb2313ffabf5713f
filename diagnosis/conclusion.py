"""Intermediate result of a diagnosis, and the settings by which it becomes an answer."""

from __future__ import annotations

from dataclasses import dataclass

from ..models import causes
from .fit.regions import Shrunk
from .fit.residual import Problem
from .fit.solver import Fit
from .search.explore import Explored


@dataclass(frozen=True)
class AnswerSettings:
    """Thresholds of the answer. A noise ratio is a residual's normalised RMS against the sensors' noise alone."""

    surest: float = 0.99  # largest confidence
    unsure: float = 0.5  # largest confidence of a cause that does not hold on unseen data, or is confounded with many
    small: float = 0.5  # a cause is minor below this share of its probability as an effect of ordinary size,
    likely: float = 0.25  # below this probability as such an effect,
    slight: float = 0.3  # or below this ratio of its contribution to the unexplained error (RMS)
    quiet: float = 1.25  # noise ratio up to which only noise remains
    far: float = 5.0  # noise ratio from which a residual is never consistent, and largest factor on standard deviations
    least: float = 0.02  # share of the rated torque below which a residual is consistent all the same
    near: float = 2.0  # the same noise ratio where the fit that explains the residual is not written
    nearly_all: float = 2 / 3  # share of undetectable causes from which a measurement is inconclusive
    about: float = 0.9  # ratio of two contributions from which they count as equal; of one to the error, as all of it
    inexact_bias: float = 0.35  # unknown part of the correction for noise in the motion
    many: int = 4  # numbers outside their tolerances at once, from which the data are of another joint
    apart: float = 5.0  # error of a recording over every other's from which it may be of another joint,
    explained: float = 0.5  # if the fit leaves more than this part of it
    rezeroed: float = 0.2  # shift of the encoder zero between recordings that is reported [torsion at rated torque],
    less: float = 0.3  # if it lowers the logarithm of the residual by this much
    diluted: float = 0.1  # share of encoder noise in the information on an inertia from which the inertia is not sure


ANSWER = AnswerSettings()


@dataclass(frozen=True)
class Conclusion:
    """Intermediate result of a diagnosis.

    Attributes:
      found: result of the search.
      judged: the final model, fitted without the held-out blocks.
      final: the same; with one encoder fitted to the held-out blocks too.
      shrunk: `final`, shrunk towards the description as far as held-out data require.
      missing: causes that this measurement cannot show at ordinary size, with the reason.
      undetermined: these and other undetectable causes, with the reason.
      alike: pairs of confounded causes.
      surest: largest confidence of a cause; vague: of one that does not explain nearly all (`AnswerSettings.about`).
      zeros: link encoder's zero of each recording relative to the first [rad]; empty if it did not move.
    """

    problem: Problem
    found: Explored
    judged: Fit
    final: Fit
    shrunk: Shrunk
    missing: dict[str, str]
    undetermined: dict[str, str]
    alike: tuple[tuple[str, str], ...]
    surest: float
    vague: float
    zeros: dict[str, float]

    @property
    def nearly_all(self) -> bool:
        """Whether nearly all causes are undetectable with this measurement."""
        return len(self.undetermined) >= ANSWER.nearly_all * len(causes.of(self.problem.joint))
