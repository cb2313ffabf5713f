"""A measurement, a joint and what may move: residuals and their derivatives at any parameters.

Unknowns are the joint's calibration variables (`models.calibration`, standard normal by construction), what sensors do that no
description states (the times by which the current and torque samples may be off, the torque sensor's crosstalk), and the
coordinates of the effects under test (`coordinates`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from ...models.calibration import Calibration
from ...models.errors import InputError
from ...models.joint import Joint
from ...models.joint_parts import AnalogSpec, Mounting
from ...models.parameters import SIZE as PARAMETERS_SIZE
from ...models.parameters import as_floats
from ..data.segments import BALANCES, CURRENT, ENOUGH, LINK, TORQUE, Segment, mirrored
from .coordinates import Hypothesis
from .replay import derivatives, residuals

TIMING = np.array([0.5e-3, 1.0e-3])
"""Prior standard deviation [s] of the time by which current and joint torque samples are off what the description states: drives
filter currents at 150 Hz and more, amplifiers and buses of torque sensors take up to 2 ms."""
LATEST = 6e-3
"""Time [s] by which they may be off at most: what is later by more than 5 ms is a mistake in the data (`data.lateness`)."""
CROSSTALK = 0.01
"""Prior standard deviation of the amplitude, over the cosine of the link's angle, of what the link's weight makes a torque sensor
read across its axis: a share of the gravity moment (data sheets of six-axis sensors: 1 to 2 % of the load)."""
REACH = 2.6
"""Standard deviations within which every calibration variable stays: joints are drawn within 2.5, and two variables that
move the same number (its own tolerance and a shared one) reach little further together than the number's own limit
(`models.calibration.WITHIN`)."""
_STEP, _FAR = 1e-6, 1e-4  # of differences of the record's numbers
_STEP_X, _STEP_U = 0.05, 0.03  # of differences of residuals, where these stand for derivatives
_BENT = 0.2  # part of a number's change over such a step by which it may differ from its derivative
_ANY_PHASE = 2 * np.pi / np.sqrt(12)  # standard deviation [rad] of a phase of which nothing is known
_UNBOUNDED = 100.0  # times what nine of ten are at most
_INFINITE = 1e6  # A or N·m per standard deviation or ordinary size: a derivative that is as good as infinite
_HELD = 1e-4  # prior standard deviation of what stays as described
_LINEAR = ("Jm", "bm", "bl", "Jl", "Mg", "current_offset", "torque_offset")
_ZEROS = ("link_encoder_zero", "torque_sensor_offset")
_TIMED = (CURRENT, TORQUE)

Model = tuple[Hypothesis, ...]


class Problem:
    """A measurement, a joint, and what may move.

    Attributes:
      segments, replicates: of the measurement (`data.segments`).
      joint: its description.
      calibration: the joint's variables.
      size: number of unknowns that every model has: calibration, two sample times and the crosstalk.
      late: by how much current and joint torque are described to be sampled later than the motor encoder [s], shape (2,).
      crosstalk: prior standard deviation of its amplitude [N·m].
      linear: of these, the ones whose derivatives do not depend on where they are taken, shape (m,).
      bias: of the residuals, taken from them: shape (k, len(BALANCES)) a segment; None for none (`noise_bias`).
      zeros: of these, zeros of link encoder and torque sensor, of which a description says next to nothing.
      held: of these, the ones that stay as described, shape (size,), bool.
      output_scale: newton metres at the output per unit of each balance, shape (len(BALANCES),): of a current N Kt, of a
        torque one.
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
        linear = {slot.name for slot in self.calibration.slots if slot.field in _LINEAR}
        at = [i for i, name in enumerate(self.calibration.names) if name in linear]
        self.linear = np.array([*at, self.size - 1])
        self.held = np.zeros(self.size, bool)
        self.output_scale = np.ones(len(BALANCES))
        self.output_scale[CURRENT] = joint.numbers["N"].value * joint.numbers["Kt"].value
        self.zeros = np.array([i for i, name in enumerate(self.calibration.names) if name in _ZEROS], int)

    def as_described(self) -> Problem:
        """The same problem where nothing but zeros may differ from the description; a current's is like friction."""
        other = copy(self)
        other.held = np.zeros(self.size, bool)
        other.held[: self.calibration.size] = True
        other.held[self.zeros] = False
        return other

    def tared(self) -> Problem:
        """The same problem where nothing but the link encoder's zero may differ from the description."""
        other = self.as_described()
        other.held[: self.calibration.size] = [name != "link_encoder_zero" for name in self.calibration.names]
        return other

    def with_segments(self, change: Callable[[Segment], Segment]) -> Problem:
        """The same problem with segments and noise replicates changed alike."""
        other = copy(self)
        other.segments, other.replicates = (
            [change(s) for s in segments] for segments in (self.segments, self.replicates)
        )
        return other

    def of_recording(self, name: str) -> Problem:
        """The same problem of one of the recordings alone."""
        other = copy(self)
        kept = [i for i, s in enumerate(self.segments) if s.name == name]
        other.segments, other.replicates = (
            [segments[i] for i in kept] for segments in (self.segments, self.replicates)
        )
        if self.bias is not None:
            other.bias = [self.bias[i] for i in kept]
        return other

    def with_held_out(self) -> Problem:
        """The same problem to which all data count, blocks that were kept from fits too."""
        return self.with_segments(lambda s: replace(s, usable=s.usable | s.held_out))

    def mirrored(self) -> Problem:
        """The same problem with the noise replicates' mirror images."""
        other = copy(self)
        other.replicates = [mirrored(a, b) for a, b in zip(self.segments, self.replicates, strict=True)]
        return other

    def less(self, bias: Sequence[np.ndarray]) -> Problem:
        """The same problem with a bias taken from its residuals, shape (k, len(BALANCES)) a segment."""
        other = copy(self)
        other.bias = list(bias)
        return other

    @property
    def mountings(self) -> list[Mounting]:
        """Of the link, one a segment."""
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
        """Standard deviations of an effect's free parameters at its coordinates, from their covariance.

        The phase of a ripple counts from the rotor's angle. Where only the link's encoder was read, that is known up to this
        encoder's zero: 1 mrad of it is 1.2 rad of an order of 12 behind a gear of 100. Estimates from the same encoder have the
        same angle, so that bands do not grow by it.
        """
        std = effect.deviation(u, covariance)
        if "phase" in std and effect.cause.ripple and not any(s.rotor_measured for s in self.segments):
            zeros = [self.calibration.deviation(s) for s in self.calibration.slots if s.name == "link_encoder_zero"]
            turned = effect.values(u)["order"] * self.joint.numbers["N"].value * max(zeros, default=0.0)
            std["phase"] = min(float(np.hypot(std["phase"], turned)), _ANY_PHASE)
        return std

    @property
    def holds_out(self) -> bool:
        """Whether enough residuals were kept from the fits to judge by them."""
        kept, fitted = (sum(int(getattr(s, name).sum()) for s in self.segments) for name in ("held_out", "usable"))
        return kept > ENOUGH * (kept + fitted)

    @property
    def judged(self) -> list[np.ndarray]:
        """Residuals by which a fit is judged, shape (k, len(BALANCES)) a segment: those kept from it, all where none is."""
        some = self.holds_out
        return [s.held_out if some else s.usable for s in self.segments]

    def split(self, theta: np.ndarray, model: Model) -> list[np.ndarray]:
        """Coordinates of each hypothesis in the vector of unknowns."""
        parts, at = [], self.size
        for h in model:
            parts.append(theta[at : at + h.size])
            at += h.size
        return parts

    def place(self, model: Model, index: int) -> slice:
        """Where the coordinates of a hypothesis stand in the vector of unknowns."""
        start = self.size + sum(h.size for h in model[:index])
        return slice(start, start + model[index].size)

    def records(self, theta: np.ndarray, model: Model) -> list[np.ndarray]:
        """Parameter records of the joint at `theta`, one a segment."""
        parts = self.split(theta, model)
        made: dict[Mounting, np.ndarray] = {}
        found = []
        for mounting in self.mountings:
            if mounting not in made:
                record = self.calibration.record(theta[: self.calibration.size], mounting)
                for h, u in zip(model, parts, strict=True):
                    h.cause.apply(record[0], h.values(u))
                made[mounting] = record
            found.append(made[mounting])
        return found

    def with_room(self, model: Model, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Hypotheses for which the joint has room beside the effects of a model: orders of one kind are limited in number."""
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
        """Residuals, shape (k, len(BALANCES)) a segment, at each of several points (of several models), in parallel."""
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
        """Residuals, shape (k, len(BALANCES)), of segments under records, with the sensors' unknowns; in parallel."""
        found = residuals([(segment, record) for segment, record, _ in tasks])
        for (segment, _, theta), r in zip(tasks, found, strict=True):
            for i, x in enumerate(theta[self.calibration.size : self.size]):
                balances, off, _ = self._read(segment, i, x)
                r[:, balances] -= off
        return found

    def _read(self, segment: Segment, i: int, x: float) -> tuple[list[int], np.ndarray, np.ndarray]:
        """What the i-th of the sensors' unknowns takes from residuals at x standard deviations, and its derivative in x.

        Returns:
          Balances, and shape (k, 1 or 2) each; the link's balance is told as the torque sensor reads it.
        """
        balances = [CURRENT] if i == CURRENT else [TORQUE, LINK]
        there = segment.balances[balances]
        if i < len(_TIMED):
            # Readings that much later or earlier, to second order: at 25 Hz two milliseconds are a third of a radian.
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
        """Derivatives of the residuals, shape (k, len(BALANCES), len(columns)) a segment.

        They are zero of what is held.
        """
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
        """Derivatives of the residuals in directions of the effects' coordinates, shape (m, len(theta)).

        Returns:
          Of each segment, shape (k, len(BALANCES), m).
        """
        steps = np.full(len(directions), _STEP_U)
        return self._replayed_derivatives(theta, model, directions, steps, self.segments)

    def _replayed_derivatives(
        self, theta: np.ndarray, model: Model, directions: np.ndarray, steps: np.ndarray, segments: Sequence[Segment]
    ) -> list[np.ndarray]:
        """Derivatives in directions of the record's unknowns, shape (k, len(BALANCES), len(directions)) a segment.

        Exact ones (`replay.derivatives`), but by differences of `steps` where those say nothing of a change of any size: in
        unknowns of which the record is no smooth function there (an amplitude with a phase, where it is next to nothing), and
        where the replay runs into the end of a law again and again and an exact derivative grows without bound.
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
        # Differences, where they are asked for: one replay each, and one of each segment as it is.
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
        """Amplitude of the torque sensor's crosstalk at a fit, and what is not known of it [N·m], root of the sum of squares."""
        j = self.size - 1
        return float(self.crosstalk * np.sqrt(theta[j] ** 2 + covariance[j, j]))

    def spread(self, model: Model) -> np.ndarray:
        """Prior standard deviation of every unknown; of those that are held next to nothing."""
        return np.concatenate([np.where(self.held, _HELD, 1.0), *(h.spread for h in model)])

    def replaced(self, model: Sequence[Hypothesis]) -> np.ndarray:
        """Indices of the common unknowns whose numbers effects set to a value of their own: beside these they do nothing."""
        fields = {field for h in model for field in h.cause.sets.values()}
        names = {
            name for s in self.calibration.slots if s.field in fields for name in (s.name, f"shared {s.number.shared}")
        }
        return np.array([i for i, name in enumerate(self.calibration.names) if name in names], int)

    def start(self, x: np.ndarray | None, model: Model) -> np.ndarray:
        """A vector of unknowns: the common ones at x, the effects absent."""
        return np.concatenate([np.zeros(self.size) if x is None else x, np.zeros(sum(h.size for h in model))])

    def bounds(self, model: Model) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest value of every unknown."""
        common = np.full(self.size, REACH)
        common[self.calibration.size : -1] = LATEST / TIMING
        common[self.held] = 0.0
        limits = [h.limits for h in model]
        low = np.concatenate([-common, *(l for l, _ in limits)])
        return low, np.concatenate([common, *(u for _, u in limits)])

    def quantum(self) -> np.ndarray:
        """What the rotor encoder's quantisation (rms) leaves in each balance where it does not average out."""
        rms = self.joint.sensors.motor_encoder.resolution / np.sqrt(12)
        value = {name: number.value for name, number in self.joint.numbers.items()}
        found = np.zeros(len(BALANCES))
        found[CURRENT], found[TORQUE] = value["Kw0"] * rms / value["Kt"], value["K1"] * rms / value["N"]
        return found


def lateness(joint: Joint) -> np.ndarray:
    """By how much current and joint torque are described to be read later than the motor encoder [s], shape (2,).

    Delays, and by how much a low-pass lags behind slow signals.
    """
    sensors = joint.sensors

    def late(s: AnalogSpec) -> float:
        return s.delay + (1 / (2 * np.pi * s.bandwidth) if s.bandwidth else 0.0) - sensors.motor_encoder.delay

    return np.array([late(s) for s in (sensors.motor_current, sensors.joint_torque)])


def _unbounded(J: np.ndarray) -> np.ndarray:
    """Whether derivatives, shape (k, len(BALANCES), n), are anywhere far beyond what they usually are in their balance, or no
    numbers; shape (n,)."""
    size = np.abs(J)
    most = np.max(size, axis=0)
    usual = np.partition(size, int(0.9 * len(J)), axis=0)[int(0.9 * len(J))]
    with np.errstate(over="ignore"):  # squares of what grew without bound may be infinite
        rms = np.sqrt(np.mean(size * size, axis=0))
    return ~np.all((most < _INFINITE) & (most <= _UNBOUNDED * np.maximum(usual, 0.1 * rms)), axis=0)
