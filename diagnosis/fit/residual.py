"""A measurement, a joint and its unknowns: residuals and their derivatives.

Unknowns are the joint's calibration variables (`models.calibration`, standard normal by construction), sensor errors that no
description states (time offsets of current and torque samples, the torque sensor's crosstalk), and the coordinates of the effects
under test (`coordinates`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from ...models.calibration import NARROW, ZEROS, Calibration
from ...models.errors import InputError
from ...models.joint import Joint
from ...models.joint_parts import AnalogSpec, Mounting
from ...models.parameters import SIZE as PARAMETERS_SIZE
from ...models.parameters import as_floats
from ..data.segments import BALANCES, CURRENT, ENOUGH, LINK, TORQUE, Segment, mirrored
from .coordinates import Hypothesis
from .replay import derivatives, residuals

TIMING = np.array([0.5e-3, 1.0e-3])
"""Prior standard deviation of the time offset of current and joint torque samples against the description [s]: drives filter
currents at 150 Hz and more, amplifiers and buses of torque sensors take up to 2 ms."""
LATEST = 6e-3
"""Largest time offset [s]: more than 5 ms is a mistake in the data (`data.time_offsets`)."""
CROSSTALK = 0.01
"""Prior standard deviation of the torque sensor's crosstalk, the link's weight across its axis over the cosine of its angle:
share of the gravity moment (data sheets of six-axis sensors: 1 to 2 % of the load)."""
REACH = 2.6
"""Bound of every calibration variable [standard deviations]: joints are drawn within 2.5, and two variables of one number (own
tolerance and a shared one) together reach little beyond the number's own limit (`models.calibration.WITHIN`)."""
AT_BOUND = 2.55  # standard deviations from which a variable counts as being at that bound
_STEP, _FAR = 1e-6, 1e-4  # of differences of the record's numbers
_STEP_X, _STEP_U = 0.05, 0.03  # of differences of residuals, where these stand for derivatives
_BENT = 0.2  # part of a number's change over such a step by which secant and derivative may differ
_ANY_PHASE = 2 * np.pi / np.sqrt(12)  # standard deviation of an unknown phase [rad]
_UNBOUNDED = 100.0  # times the ninth decile
_INFINITE = 1e6  # A or N·m per standard deviation or ordinary size: a derivative that counts as infinite
_HELD = 1e-4  # prior standard deviation of a held unknown
_LINEAR = ("current_offset", "torque_offset")
_TIMED = (CURRENT, TORQUE)

Model = tuple[Hypothesis, ...]


class Problem:
    """A measurement, a joint, and its unknowns.

    Attributes:
      segments, replicates: of the measurement (`data.segments`).
      joint: its description.
      calibration: the joint's variables.
      size: number of unknowns of every model: calibration, two sample times and the crosstalk.
      late: described delay of current and joint torque samples against the motor encoder [s], shape (2,).
      crosstalk: prior standard deviation of its amplitude [N·m].
      linear: indices of unknowns with constant derivatives.
      zeros: indices of the zeros of link encoder and torque sensor, which a description does not specify.
      held: unknowns that stay as described, shape (size,), bool.
      bias: subtracted from the residuals, shape (k, len(BALANCES)) a segment; None for none (`motion_noise`).
      output_scale: output torque per unit of each balance, shape (len(BALANCES),): N Kt of a current, 1 of a torque.
    """

    def __init__(self, segments: Sequence[Segment], replicates: Sequence[Segment], joint: Joint):
        self.segments, self.replicates = list(segments), list(replicates)
        self.joint = joint
        self.bias: list[np.ndarray] | None = None
        self.calibration = Calibration(joint)
        self.size = self.calibration.size + len(_TIMED) + 1
        self.late = lateness(joint)
        # With one encoder the torque is compared with the load alone, and a crosstalk would be taken for a part of it.
        both = any(s.link_measured for s in segments)
        self.crosstalk = CROSSTALK * max(m.gravity_moment for m in (joint.mount(), *self.mountings)) if both else 0.0
        slots = self.calibration.slots
        curved = [s for s in slots if s.field not in _LINEAR or s.number.shared or s.number.tolerance > NARROW]
        bent = {i for s in curved for i in self.calibration.variables(s)}
        at = [i for i in range(self.calibration.size) if i not in bent]
        self.linear = np.array([*at, self.size - 1])
        self.held = np.zeros(self.size, bool)
        self.output_scale = np.ones(len(BALANCES))
        self.output_scale[CURRENT] = joint.numbers["N"].value * joint.numbers["Kt"].value
        self.zeros = np.array([i for i, name in enumerate(self.calibration.names) if name in ZEROS], int)

    def only_zero(self) -> Problem:
        """Return the problem in which only the link encoder's zero may differ from the description."""
        other = copy(self)
        other.held = np.zeros(self.size, bool)
        other.held[: self.calibration.size] = [name != "link_encoder_zero" for name in self.calibration.names]
        return other

    def with_segments(self, change: Callable[[Segment], Segment]) -> Problem:
        """Return the problem with segments and noise replicates changed alike."""
        other = copy(self)
        other.segments, other.replicates = (
            [change(s) for s in segments] for segments in (self.segments, self.replicates)
        )
        return other

    def of_recording(self, name: str) -> Problem:
        """Return the problem of one recording."""
        other = copy(self)
        kept = [i for i, s in enumerate(self.segments) if s.name == name]
        other.segments, other.replicates = (
            [segments[i] for i in kept] for segments in (self.segments, self.replicates)
        )
        if self.bias is not None:
            other.bias = [self.bias[i] for i in kept]
        return other

    def with_held_out(self) -> Problem:
        """Return the problem with the held-out blocks included."""
        return self.with_segments(lambda s: replace(s, usable=s.usable | s.held_out))

    def mirrored(self) -> Problem:
        """Return the problem with the mirror images of the noise replicates."""
        other = copy(self)
        other.replicates = [mirrored(a, b) for a, b in zip(self.segments, self.replicates, strict=True)]
        return other

    def less(self, bias: Sequence[np.ndarray]) -> Problem:
        """Return the problem with a bias subtracted from its residuals, shape (k, len(BALANCES)) a segment."""
        other = copy(self)
        other.bias = list(bias)
        return other

    @property
    def mountings(self) -> list[Mounting]:
        """Mounting of the link, one a segment."""
        return [s.mounting for s in self.segments]

    @property
    def has_torque(self) -> bool:
        """Whether a joint torque sensor was read."""
        return any(s.has_torque for s in self.segments)

    @property
    def link_measured(self) -> bool:
        """Whether both encoders were read."""
        return any(s.link_measured for s in self.segments)

    def deviation(self, effect: Hypothesis, u: np.ndarray, covariance: np.ndarray) -> dict[str, float]:
        """Return standard deviations of an effect's free parameters from the covariance of its coordinates.

        The phase of a ripple refers to the rotor's angle. With only the link's encoder that is known up to this encoder's zero:
        1 mrad of it is 1.2 rad of an order of 12 behind a gear of 100. Estimates from the same encoder have the same angle, so
        their bands do not grow by it.
        """
        std = effect.deviation(u, covariance)
        if "phase" in std and effect.cause.ripple and not any(s.rotor_measured for s in self.segments):
            zeros = [self.calibration.deviation(s) for s in self.calibration.slots if s.name == "link_encoder_zero"]
            turned = effect.values(u)["order"] * self.joint.numbers["N"].value * max(zeros, default=0.0)
            std["phase"] = min(float(np.hypot(std["phase"], turned)), _ANY_PHASE)
        return std

    @property
    def holds_out(self) -> bool:
        """Whether enough residuals are held out to judge by them."""
        kept, fitted = (sum(int(getattr(s, name).sum()) for s in self.segments) for name in ("held_out", "usable"))
        return kept > ENOUGH * (kept + fitted)

    @property
    def judged(self) -> list[np.ndarray]:
        """Residuals by which a fit is judged, shape (k, len(BALANCES)) a segment: held-out ones if enough, else all."""
        some = self.holds_out
        return [s.held_out if some else s.usable for s in self.segments]

    def split(self, theta: np.ndarray, model: Model) -> list[np.ndarray]:
        """Return the coordinates of each hypothesis in the vector of unknowns."""
        parts, at = [], self.size
        for h in model:
            parts.append(theta[at : at + h.size])
            at += h.size
        return parts

    def place(self, model: Model, index: int) -> slice:
        """Return the place of a hypothesis in the vector of unknowns."""
        start = self.size + sum(h.size for h in model[:index])
        return slice(start, start + model[index].size)

    def records(self, theta: np.ndarray, model: Model) -> list[np.ndarray]:
        """Return parameter records of the joint at `theta`, one a segment."""
        values = [h.values(u) for h, u in zip(model, self.split(theta, model), strict=True)]
        made: dict[Mounting, np.ndarray] = {}
        found = []
        for mounting in self.mountings:
            if mounting not in made:
                record = self.calibration.record(theta[: self.calibration.size], mounting)
                for h, own in zip(model, values, strict=True):
                    h.cause.apply(record[0], own)
                made[mounting] = record
            found.append(made[mounting])
        return found

    def with_room(self, model: Model, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return the hypotheses that the joint can have in addition to a model: orders of one kind are limited in number."""
        full = self.calibration.record(np.zeros(self.calibration.size))
        for h in model:
            h.cause.apply(full[0], h.values(np.ones(h.size)))

        def fits(h: Hypothesis) -> bool:
            try:
                h.cause.apply(full.copy()[0], h.values(np.ones(h.size)))
            except InputError:
                return False
            return True

        return [h for h in hypotheses if fits(h)]

    def residuals(
        self, thetas: Sequence[np.ndarray], models: Sequence[Model], replicate: bool = False
    ) -> list[list[np.ndarray]]:
        """Return residuals, shape (k, len(BALANCES)) a segment, at several points (of several models), in parallel."""
        chosen = self.replicates if replicate else self.segments
        tasks = [
            (segment, record, theta)
            for theta, model in zip(thetas, models, strict=True)
            for segment, record in zip(chosen, self.records(theta, model), strict=True)
        ]
        done = iter(self.replayed(tasks))
        found = [[next(done) for _ in chosen] for _ in thetas]
        return found if self.bias is None else [[r - b for r, b in zip(rs, self.bias, strict=True)] for rs in found]

    def replayed(self, tasks: Sequence[tuple[Segment, np.ndarray, np.ndarray]]) -> list[np.ndarray]:
        """Return residuals, shape (k, len(BALANCES)), of segments under records, with the sensors' unknowns; in parallel."""
        found = residuals([(segment, record) for segment, record, _ in tasks])
        for (segment, _, theta), r in zip(tasks, found, strict=True):
            for i, x in enumerate(theta[self.calibration.size : self.size]):
                balances, off, _ = self._read(segment, i, x)
                r[:, balances] -= off
        return found

    def _read(self, segment: Segment, i: int, x: float) -> tuple[list[int], np.ndarray, np.ndarray]:
        """Part of the residuals due to the i-th of the sensors' unknowns at x standard deviations, and its derivative in x.

        Returns:
          Balances, and shape (k, 1 or 2) each; the link's balance is in the torque sensor's units.
        """
        balances = [CURRENT] if i == CURRENT else [TORQUE, LINK]
        there = segment.balances[balances]
        if i < len(_TIMED):
            # A time offset to second order: at 25 Hz two milliseconds are a third of a radian.
            rate, bend = segment.measured_rate[:, [_TIMED[i]]], segment.measured_bend[:, [_TIMED[i]]]
            earlier = TIMING[i] * x - self.late[i]
            return (
                balances,
                earlier * (rate - 0.5 * earlier * bend) * there,
                TIMING[i] * (rate - earlier * bend) * there,
            )
        size = self.crosstalk if segment.has_torque else 0.0
        read = size * segment.link_cosine[:, None] * there
        return balances, x * read, read

    def jacobian(
        self,
        theta: np.ndarray,
        model: Model,
        columns: np.ndarray | None = None,
        replicate: bool = False,
    ) -> list[np.ndarray]:
        """Return derivatives of the residuals, shape (k, len(BALANCES), len(columns)) a segment; zero in held unknowns."""
        n = len(theta)
        columns = np.arange(n) if columns is None else columns
        still = np.concatenate([self.held, np.zeros(n - self.size, bool)])
        replayed = [int(j) for j in columns if not self.calibration.size <= j < self.size and not still[j]]
        segments = self.replicates if replicate else self.segments
        directions = np.zeros((len(replayed), n))
        directions[np.arange(len(replayed)), replayed] = 1.0
        steps = np.where(np.array(replayed, int) < self.size, _STEP_X, _STEP_U)
        parts = self._replayed_derivatives(theta, model, directions, steps, segments)
        found = []
        for segment, done in zip(segments, parts, strict=True):
            J = np.zeros((len(segment.at), len(BALANCES), len(columns)))
            for i, j in enumerate(columns):
                if j in replayed:
                    J[..., i] = done[..., replayed.index(j)]
                elif not still[j]:
                    balances, _, rate = self._read(segment, j - self.calibration.size, theta[j])
                    J[:, balances, i] = -rate
            found.append(J)
        return found

    def along(self, theta: np.ndarray, model: Model, directions: np.ndarray) -> list[np.ndarray]:
        """Derivatives in directions of the effects' coordinates, shape (m, len(theta)): (k, len(BALANCES), m) a segment."""
        steps = np.full(len(directions), _STEP_U)
        return self._replayed_derivatives(theta, model, directions, steps, self.segments)

    def _replayed_derivatives(
        self, theta: np.ndarray, model: Model, directions: np.ndarray, steps: np.ndarray, segments: Sequence[Segment]
    ) -> list[np.ndarray]:
        """Derivatives in directions of the record's unknowns, shape (k, len(BALANCES), len(directions)) a segment.

        Exact ones (`replay.derivatives`), but differences of `steps` where exact ones hold for no step of any size: in unknowns
        of which the record is not smooth (an amplitude with a phase, near zero), and where the replay meets the end of a law
        again and again, so that an exact derivative grows without bound.
        """
        records = self.records(theta, model)
        mountings = {mounting: s for s, mounting in reversed(list(enumerate(self.mountings)))}
        slopes = {m: np.empty((len(directions), PARAMETERS_SIZE)) for m in mountings}
        bent = np.zeros(len(directions), bool)
        for i, direction in enumerate(directions):
            near, far = (self.records(theta + h * direction, model) for h in (_STEP, _FAR))
            for mounting, s in mountings.items():
                slope, secant = ((as_floats(r[s]) - as_floats(records[s])) / h for r, h in ((near, _STEP), (far, _FAR)))
                slopes[mounting][i] = slope
                largest = np.maximum(np.abs(slope), np.abs(secant))
                bent[i] |= bool(np.any(np.abs(slope - secant) > _BENT * largest + 1e-9))
        smooth = np.flatnonzero(~bent).tolist()
        trios = [
            (segment, record, slopes[mounting][smooth])
            for segment, record, mounting in zip(segments, records, self.mountings, strict=True)
        ]
        found, rough = [], []
        for s, exact in enumerate(derivatives(trios) if len(smooth) else [None] * len(segments)):
            J = np.empty((len(segments[s].at), len(BALANCES), len(directions)))
            wild = bent.copy()
            if exact is not None:
                J[..., smooth] = exact
                wild[smooth] = _unbounded(exact)
            found.append(J)
            rough += [(s, i) for i in np.flatnonzero(wild).tolist()]
        # Differences: one replay each, and one of each segment at `theta`.
        bases = sorted({s for s, _ in rough})
        points = [theta + steps[i] * directions[i] for _, i in rough]
        tasks = [(segments[s], records[s], theta) for s in bases]
        tasks += [
            (segments[s], self.records(point, model)[s], point) for (s, _), point in zip(rough, points, strict=True)
        ]
        replayed = self.replayed(tasks)
        base = dict(zip(bases, replayed, strict=False))
        for (s, i), moved in zip(rough, replayed[len(bases) :], strict=True):
            found[s][..., i] = (moved - base[s]) / steps[i]
        return found

    def crosstalk_at(self, theta: np.ndarray, covariance: np.ndarray) -> float:
        """Root sum square of the torque sensor's crosstalk amplitude at a fit and of its standard deviation [N·m]."""
        j = self.size - 1
        return float(self.crosstalk * np.sqrt(theta[j] ** 2 + covariance[j, j]))

    def spread(self, model: Model) -> np.ndarray:
        """Return the prior standard deviation of every unknown, almost zero for held ones."""
        return np.concatenate([np.where(self.held, _HELD, 1.0), *(h.spread for h in model)])

    def replaced(self, model: Sequence[Hypothesis]) -> np.ndarray:
        """Return indices of the common unknowns of numbers that the effects replace, and that therefore have no influence."""
        fields = {field for h in model for field in h.cause.sets.values()}
        moving = [self.calibration.variables(s) for s in self.calibration.slots if s.field in fields]
        return np.array(sorted({i for variables in moving for i in variables}), int)

    def start(self, x: np.ndarray | None, model: Model) -> np.ndarray:
        """Return a vector of unknowns: the common ones at x (0 for None), the effects absent."""
        return np.concatenate([np.zeros(self.size) if x is None else x, np.zeros(sum(h.size for h in model))])

    def bounds(self, model: Model) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest and largest value of every unknown."""
        common = np.full(self.size, REACH)
        common[self.calibration.size : -1] = LATEST / TIMING
        common[self.held] = 0.0
        limits = [h.limits for h in model]
        low = np.concatenate([-common, *(l for l, _ in limits)])
        return low, np.concatenate([common, *(u for _, u in limits)])

    def quantum(self) -> np.ndarray:
        """Rms of the rotor encoder's quantisation in each balance where it does not average out, shape (len(BALANCES),)."""
        rms = self.joint.sensors.motor_encoder.resolution / np.sqrt(12)
        value = {name: number.value for name, number in self.joint.numbers.items()}
        found = np.zeros(len(BALANCES))
        found[CURRENT], found[TORQUE] = value["Kw0"] * rms / value["Kt"], value["K1"] * rms / value["N"]
        return found


def lateness(joint: Joint) -> np.ndarray:
    """Described delay of current and joint torque against the motor encoder [s], low-pass filters included, shape (2,)."""
    sensors = joint.sensors

    def late(s: AnalogSpec) -> float:
        return s.delay + (1 / (2 * np.pi * s.bandwidth) if s.bandwidth else 0.0) - sensors.motor_encoder.delay

    return np.array([late(s) for s in (sensors.motor_current, sensors.joint_torque)])


def _unbounded(J: np.ndarray) -> np.ndarray:
    """Whether derivatives, shape (k, len(BALANCES), n), are anywhere far beyond their usual size, or NaN; shape (n,)."""
    size = np.abs(J)
    most = np.max(size, axis=0)
    usual = np.partition(size, int(0.9 * len(J)), axis=0)[int(0.9 * len(J))]
    with np.errstate(over="ignore"):  # squares of unbounded derivatives may be infinite
        rms = np.sqrt(np.mean(size * size, axis=0))
    return ~np.all((most < _INFINITE) & (most <= _UNBOUNDED * np.maximum(usual, 0.1 * rms)), axis=0)
