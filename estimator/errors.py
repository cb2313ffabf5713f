"""The exception of a diverged filter."""

from __future__ import annotations


class FilterDiverged(ArithmeticError):
    """The next estimate would not be a finite number with a positive definite covariance.

    The message is one line: filter, step, time [s], reason.

    Attributes:
      filter: name of the estimator.
      step: index of the measurement.
      time: its time [s].
      reason: the reason.
    """

    def __init__(self, filter: str, step: int, time: float, reason: str):
        self.filter, self.step, self.time, self.reason = filter, step, time, reason
        super().__init__(f"filter {filter!r} diverged at step {step}, t = {time:g} s: {reason}")

    def __reduce__(self):
        return type(self), (self.filter, self.step, self.time, self.reason)
