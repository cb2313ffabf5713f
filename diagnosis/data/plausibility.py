"""Agreement of channels with each other and with the description, for any cause of ordinary size.

Four relations hold between the channels of a joint, however they were recorded:

    encoders       θm/N − θl is the transmission's wind-up: milliradians
    drive          N Kt i (or N times the motor torque) moves rotor and link, against friction and gravity
    joint torque   Ts moves the link against gravity
    command        the link follows its command

Each is a sum of known shapes (sin θ, θ'', sgn θ', …). Coefficients have Gaussian priors from the description, and bounds of a
description that is wrong by a few times (`AgreementSettings`): a column is wrong only if no such description explains the log.
Residuals are Student-t distributed, as pushes, bumps and stops have no shapes. The log likelihood at the best coefficients is the
*agreement*. Neighbouring samples are correlated: a recording counts as `AgreementSettings.effective` samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter1d

from ...models.joint import Joint
from ...models.joint_parts import Mounting
from ...models.kernels import kernel
from ...models.motion import smooth
from ...models.recording import GAP, Recording
from ...models.signals import DRIVING, POSITIONS


@dataclass(frozen=True)
class AgreementSettings:
    """Settings of smoothing and comparison.

    Set on `benchmarks/mistakes.py`: mistakes hidden in sound measurements, and sound ones in which nothing may be found.
    """

    effective: float = 90.0  # most effective samples of a recording in a relation
    a_second: float = 12.0  # effective samples per second
    samples: int = 320  # of a recording that are used
    cutoff: float = 6.0  # of the smoother [Hz]
    bin: float = 0.01  # over which samples are averaged before [s]
    shortest: tuple[int, float] = (20, 0.3)  # samples and seconds of a part without gaps
    edge: float = 0.05  # at both ends of a part, where the smoother settles [s]
    rated_torque: float = 16.0  # of the joint with the ordinary sizes of payload, cable and stop in N·m [N·m]
    load: tuple[float, float] = (0.45, 2.1)  # least and largest ratio to the description
    inertia: tuple[float, float] = (0.5, 2.4)  # likewise
    friction: tuple[float, float] = (0.2, 8.0)  # likewise
    viscous: tuple[float, float] = (0.0, 10.0)  # likewise
    scale: float = 1.5  # ratio of both numbers of a load to the described ones from which a torque has another scale
    noise: float = 0.04  # least ratio of a torque's residual to its spread
    suspicious: float = -0.15  # misfit below which channels disagree
    sharpest: float = 0.2  # least residual over the expected one that adds information
    vague: float = 0.5  # residual over the expected one above which a relation is examined


SETTINGS = AgreementSettings()
_FREEDOM = 3.0  # of the Student-t distribution
_LIGHTEST = 1e-3  # load of the described one
_CHANNELS = (*POSITIONS, "motor_current", "motor_torque", "joint_torque", "position_command", "external_torque")


@dataclass(frozen=True)
class SmoothedChannels:
    """Smoothed channels of a recording.

    Attributes:
      time: since the recording's start [s], shape (n,).
      channels: value and two derivatives in time by name, shape (n, 3).
      known_torque: on the link by an arm in motion [N·m], shape (n,); inertia: over that of the mounting [1], shape (n,).
      steps: between neighbouring values of the positions, in their units.
    """

    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    known_torque: np.ndarray
    inertia: np.ndarray
    steps: Mapping[str, float]

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    @property
    def position(self) -> str:
        """The channel of the link's motion; the link encoder takes precedence."""
        return "link_position" if "link_position" in self.channels else "motor_position"


def motion_of(recording: Recording) -> SmoothedChannels | None:
    """Smooth a recording's channels; None if no segment is long enough."""
    time = recording.time - recording.time[0]
    interval = float(np.median(np.diff(time)))
    edges = [0, *(np.flatnonzero(np.diff(time) > max(GAP, 5 * interval)) + 1).tolist(), len(time)]
    recorded = sum(
        float(time[b - 1] - time[a]) for a, b in pairwise(edges)
    )  # without gaps: a log may be bursts far apart
    step = max(0.02, interval, recorded / SETTINGS.samples)
    names = [name for name in _CHANNELS if name in recording]
    columns = [recording[name] for name in names]
    if recording.load is not None:
        columns += [recording.load.torque, recording.relative_inertia]
    times, found = [], []
    for part in (slice(a, b) for a, b in pairwise(edges)):
        t = time[part]
        if len(t) < SETTINGS.shortest[0] or t[-1] - t[0] < SETTINGS.shortest[1]:
            continue
        begins = np.arange(len(t))
        if interval < 0.5 * SETTINGS.bin:
            begins = np.flatnonzero(np.diff(np.floor((t - t[0]) / SETTINGS.bin), prepend=-1.0))
        count = np.diff(begins, append=len(t))
        mean = [np.add.reduceat(x[part], begins) / count for x in (time, *columns)]
        if len(mean[0]) < SETTINGS.shortest[0]:
            continue
        s = smooth(mean[0], np.column_stack(mean[1:]), step, SETTINGS.cutoff)
        inside = (s.time >= t[0] + SETTINGS.edge) & (s.time <= t[-1] - SETTINGS.edge)
        times.append(s.time[inside])
        found.append(np.stack([s.value, s.rate, s.acceleration], axis=-1)[inside])
    if not times:
        return None
    values = np.concatenate(found)
    n = len(values)
    arm = recording.load is not None
    return SmoothedChannels(
        time=np.concatenate(times),
        channels={name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)},
        known_torque=values[:, len(names), 0] if arm else np.zeros(n),
        inertia=values[:, len(names) + 1, 0] if arm else np.ones(n),
        steps={name: smallest_step(recording[name]) for name in POSITIONS if name in recording},
    )


def smallest_step(x: np.ndarray) -> float:
    """Return the smallest change of a column between samples, above rounding; 0 if it is constant."""
    change = np.abs(np.diff(x))
    change = change[change > max(1e-9 * float(np.ptp(x)), 4 * float(np.spacing(np.abs(x).max())))]
    return float(change.min()) if len(change) else 0.0


@kernel
def _fit(A, y, sigma, low, high, centre, spread, weight, beta):
    """Fit y = A β within bounds, by iterated weights and coordinate descent, in place.

    Returns the log likelihood, including the priors.
    """
    n, p = A.shape
    beta[:] = centre
    G, g = np.empty((p, p)), np.empty(p)
    w = np.empty(n)
    before = np.empty(p)
    for _ in range(10):
        before[:] = beta
        for i in range(n):
            r = y[i]
            for a in range(p):
                r -= A[i, a] * beta[a]
            s2 = sigma[i] * sigma[i]
            w[i] = weight * (_FREEDOM + 1.0) / (_FREEDOM * s2 + r * r)
        G[:] = 0.0
        g[:] = 0.0
        for i in range(n):
            for a in range(p):
                wa = w[i] * A[i, a]
                g[a] += wa * y[i]
                for b in range(a + 1):
                    G[a, b] += wa * A[i, b]
        for a in range(p):
            for b in range(a):
                G[b, a] = G[a, b]
            G[a, a] += 1.0 / (spread[a] * spread[a])
            g[a] += centre[a] / (spread[a] * spread[a])
        for _ in range(60):
            change = 0.0
            for a in range(p):
                s = g[a]
                for b in range(p):
                    if b != a:
                        s -= G[a, b] * beta[b]
                best = min(max(s / G[a, a], low[a]), high[a])
                change = max(change, abs(best - beta[a]) / spread[a])
                beta[a] = best
            if change < 1e-4:
                break
        moved = 0.0
        for a in range(p):
            moved = max(moved, abs(beta[a] - before[a]) / spread[a])
        if moved < 1e-3:
            break
    total = 0.0
    for i in range(n):
        r = y[i]
        for a in range(p):
            r -= A[i, a] * beta[a]
        u = r / sigma[i]
        total -= weight * (0.5 * (_FREEDOM + 1.0) * np.log1p(u * u / _FREEDOM))
    for a in range(p):
        u = (beta[a] - centre[a]) / spread[a]
        total -= 0.5 * u * u
    return total


class _Shapes:
    """Shapes of a relation, with bounds and priors of their coefficients."""

    def __init__(self, n: int):
        self._n = n
        self._columns: list[np.ndarray] = []
        self._numbers: list[tuple[float, float, float, float]] = []
        self._bounding: list[int] = []

    def __len__(self) -> int:
        return len(self._columns)

    def add(
        self,
        shape: np.ndarray | float,
        low: float,
        high: float,
        centre: float = 0.0,
        spread: float | None = None,
        bounding: bool = False,
    ) -> None:
        """Add a shape with a coefficient between `low` and `high`; `spread` is a third of the range by default.

        Args:
          bounding: whether a coefficient at a bound means a description that is wrong by more than a few times.
        """
        if high > low:
            self._bounding += [len(self._columns)] if bounding else []
            self._columns.append(np.broadcast_to(shape, (self._n,)))
            self._numbers.append((low, high, centre, (high - low) / 3 if spread is None else spread))

    def fit(self, y: np.ndarray, sigma: np.ndarray, least: float, effective: float) -> RelationFit:
        """Fit readings y, shape (n,); `least`: the value of `sigma` without rest."""
        A = np.ascontiguousarray(np.column_stack(self._columns))
        low, high, centre, spread = (np.array(x) for x in zip(*self._numbers, strict=True))
        beta, weight = np.empty(len(low)), effective / self._n
        misfit = float(_fit(A, y, sigma, low, high, centre, spread, weight, beta))
        # A bound counts only if the difference from the centre would be visible.
        shows = least / np.maximum(np.sqrt(np.mean(A * A, axis=0)), 1e-300)
        out = ((beta <= low) & (centre - low > shows)) | ((beta >= high) & (high - centre > shows))
        at_bound = bool(np.any(out[list(self._bounding)]))
        # A residual much smaller than expected adds information.
        u = (y - A @ beta) / sigma
        scale = min(max(1.5 * float(np.median(np.abs(u))), SETTINGS.sharpest), 1.0)
        more = 0.5 * (_FREEDOM + 1) * float(np.mean(np.log1p(u**2 / _FREEDOM) - np.log1p((u / scale) ** 2 / _FREEDOM)))
        readings = misfit + effective * max(more - math.log(scale), 0.0)
        known = -effective * float(np.mean(np.log(sigma / least)))  # less information at rest
        vague, sharp = scale > SETTINGS.vague, readings - misfit
        weights = 1 / sigma**2
        spread = np.average((y - np.average(y, weights=weights)) ** 2, weights=weights)
        rest = math.sqrt(np.average((y - A @ beta) ** 2, weights=weights) / max(spread, 1e-300))
        return RelationFit(readings + known, misfit / effective, readings, sharp, at_bound, vague, rest, beta)


@dataclass(frozen=True)
class RelationFit:
    """A relation at its best coefficients.

    Attributes:
      agreement: log likelihood.
      misfit: part of readings and priors per effective sample: 0 for an ideal fit, −0.6 for readings off by one `sigma`.
      readings: part of readings and priors.
      sharpness: part of residuals much smaller than expected.
      at_bound: whether it needs a description that is wrong by more than a few times.
      vague: whether the residual is not much smaller than expected.
      rest: residual over the spread of the readings.
      coefficients: of the shapes, in their order.
    """

    @property
    def suspicious(self) -> bool:
        """Whether the channels disagree, or agree only with a description that is wrong by more than a few times."""
        return self.misfit < SETTINGS.suspicious or self.at_bound

    agreement: float
    misfit: float
    readings: float
    sharpness: float
    at_bound: bool
    vague: bool
    rest: float
    coefficients: np.ndarray


def _same(a: SmoothedChannels, b: SmoothedChannels, channels: tuple[str, ...]) -> bool:
    """Return whether some channels are the same objects, with the same encoder for the link's motion."""
    return a.position == b.position and all(a.channels.get(n) is b.channels.get(n) for n in channels)


class Plausibility:
    """A joint's description, compared with the channels of one recording.

    `lighter`: rotor and friction may be much smaller than described, as those by rules of a larger gear are.
    """

    def __init__(self, joint: Joint, recording: Recording, lighter: bool = False):
        self.joint, self.mounting = joint, recording.link
        self.p = joint.record(recording.link)[0]
        self.lighter = lighter
        self.pushed = recording.external == "unmeasured"
        self.rated = joint.numbers["rated_torque"].value
        self._size = self.rated / SETTINGS.rated_torque
        self._payload = 4.5 * self._size
        number = joint.numbers["Kt"]
        spread = np.hypot(number.tolerance, number.deviation / max(number.value, 1e-12))
        unsure = min(3 * float(np.hypot(spread, joint.shared_tolerances[number.shared] if number.shared else 0.0)), 0.5)
        self._gain = (0.8 * (1 - unsure), 1.25 * (1 + unsure))

    def agreement(
        self,
        motion: SmoothedChannels,
        before: SmoothedChannels | None = None,
        known: Mapping[str, RelationFit] | None = None,
    ) -> dict[str, RelationFit]:
        """Fit all relations of the channels, by name: `encoders`, `command`, and each torque channel.

        Args:
          motion: the channels.
          before, known: other channels and their relations, which are reused for identical channels.
        """
        relations: dict[str, tuple[str, ...]] = {}
        if all(name in motion for name in POSITIONS):
            relations["encoders"] = POSITIONS
        if "position_command" in motion:
            relations["command"] = (motion.position, "position_command")
        for name in DRIVING:
            if name in motion:
                relations[name] = (motion.position, name, "external_torque")
        fits = {"encoders": self._encoders, "command": self._command}
        return {
            name: known[name]
            if before is not None and known is not None and name in known and _same(motion, before, needed)
            else (fits[name](motion) if name in fits else self.torque(motion, name))
            for name, needed in relations.items()
        }

    def best_load(self, motion: SmoothedChannels, name: str) -> Mounting:
        """Return the load that fits a torque channel best, with the described rotor."""
        p = self.p
        rotor = 0.0 if name == "joint_torque" else float(p["N"] ** 2 * (p["Jm"] + p["Jw"]))
        inertia, along, across = self.torque(motion, name, free=True).coefficients[:3]
        described = float(p["Jl"])
        return self.mounting.model_copy(
            update={
                "inertia": max(inertia * (described + rotor) - rotor, _LIGHTEST * described),
                "gravity_moment": math.hypot(along, across),
                "gravity_angle": self.mounting.gravity_angle + math.atan2(across, along),
            }
        )

    def load_ratios(self, motion: SmoothedChannels, name: str) -> tuple[float, float]:
        """Return inertia (the rotor's included) and gravity moment that fit a torque channel best, over the described ones."""
        inertia, along, across = self.torque(motion, name, free=True).coefficients[:3]
        return float(inertia), math.hypot(along, across) / self.mounting.gravity_moment

    def unlike(self, load: Mounting) -> str:
        """Return in words the described numbers that are wrong by more than a few times if a load is correct; empty if none."""
        inertia, moment = self.mounting.inertia, self.mounting.gravity_moment
        ranges = {
            "inertia": ("kg·m²", SETTINGS.inertia[0] * inertia, SETTINGS.inertia[1] * inertia),
            "gravity_moment": ("N·m", SETTINGS.load[0] * moment, self._heaviest(moment)),
        }
        return ", ".join(
            f"{name} of about {fits:.2g} {unit} fits the torques, not {getattr(self.mounting, name):.3g}"
            for name, (unit, low, high) in ranges.items()
            if not low <= (fits := getattr(load, name)) <= high
        )

    def _heaviest(self, moment: float) -> float:
        """Return the largest gravity moment with an ordinary payload, or of a description that is wrong by a few times [N·m]."""
        return max(SETTINGS.load[1] * moment, 1.25 * moment + self._payload)

    def link(self, motion: SmoothedChannels) -> np.ndarray:
        """Return the link's motion, shape (n, 3): of the link encoder, or the rotor's over the gear ratio."""
        values = motion.channels[motion.position]
        return values if motion.position == "link_position" else values / self.p["N"]

    @staticmethod
    def _effective(motion: SmoothedChannels) -> float:
        """Return the number of effective samples of a recording."""
        seconds = float(motion.time[-1] - motion.time[0])
        return min(SETTINGS.effective, max(SETTINGS.a_second * seconds, 1.0))

    def _encoders(self, motion: SmoothedChannels) -> RelationFit:
        p = self.p
        theta, v = motion.channels["link_position"][:, 0], motion.channels["link_position"][:, 1]
        zero = self.joint.sensors.link_encoder.zero
        wound = self.rated / p["K1"]
        friction = p["Fc"] / (p["Kw0"] * p["N"]) + 3e-4
        off = max(0.01, 5 * zero.deviation if zero is not None else 0.0)
        shapes = _Shapes(len(theta))
        shapes.add(1.0, p["link_zero"] - off, p["link_zero"] + off, float(p["link_zero"]), off / 2)
        shapes.add(theta, -2 * wound - 1e-3, 2 * wound + 1e-3)
        shapes.add(np.sin(theta), -2e-3, 2e-3)
        shapes.add(np.cos(theta), -2e-3, 2e-3)
        shapes.add(v, p["link_delay"] - 2e-3, p["link_delay"] + 1.3e-2, float(p["link_delay"]), 8e-3)
        shapes.add(np.tanh(p["N"] * v / p["vs"]), -4 * friction, 4 * friction)
        y = motion.channels["motor_position"][:, 0] / p["N"] - theta
        sigma = 2e-4 + 0.15 * wound + self.joint.sensors.motor_encoder.resolution / p["N"]
        # Coarser counts are not a mistake; the limit is for other units.
        coarse = min(motion.steps["link_position"], 5e-3) + min(motion.steps["motor_position"] / p["N"], 5e-3)
        sigma = float(np.hypot(sigma, 0.5 * coarse))
        return shapes.fit(y, np.full(len(theta), sigma), sigma, self._effective(motion))

    def _command(self, motion: SmoothedChannels) -> RelationFit:
        x = self.link(motion)
        shapes = _Shapes(len(x))
        shapes.add(1.0, -0.1, 0.1)
        shapes.add(x[:, 0], -0.05, 0.05)
        shapes.add(x[:, 1], -0.02, 0.5, 0.0, 0.2)
        sigma = 0.03 + 0.02 * float(np.ptp(x[:, 0]))
        y = motion.channels["position_command"][:, 0] - x[:, 0]
        return shapes.fit(y, np.full(len(x), sigma), sigma, 0.5 * self._effective(motion))

    def torque(self, motion: SmoothedChannels, name: str, free: bool = False) -> RelationFit:
        """Fit a torque channel to the link's motion.

        Args:
          free: whether inertia and gravity, the first three coefficients, are unbounded, to detect a wrong clock or a torque
            without gravity.
        """
        p, size, rated = self.p, self._size, self.rated
        drive = name != "joint_torque"
        N, weight = float(p["N"]), float(p["Mg"])
        low, high = self._gain if drive else (0.8, 1.25)
        theta, v, a = self.link(motion).T
        rotor = N * N * float(p["Jm"] + p["Jw"]) if drive else 0.0
        inertia = float(p["Jl"]) * motion.inertia + rotor
        least = SETTINGS.inertia[0] * (float(p["Jl"]) / (float(p["Jl"]) + rotor) if self.lighter else 1.0)
        shapes = _Shapes(len(theta))
        shapes.add(
            inertia * a, *((0.0, 1e3, 1.0, 1e3) if free else (least, SETTINGS.inertia[1], 1.0, 0.8)), bounding=True
        )
        # The link's own weight, a payload, a cable, a stop [N·m].
        payload = self._payload
        turned = (0.25 if self.joint.gravity_angle is not None else 0.06) * weight + 0.3 * payload
        angle = theta + p["gravity_angle"]
        low_load = SETTINGS.load[0] * weight * low
        high_load = self._heaviest(weight) * high
        if free:
            low_load, turned = -high_load, high_load
        shapes.add(np.sin(angle), low_load, high_load, weight, 0.5 * (weight + payload), bounding=True)
        shapes.add(np.cos(angle), -turned * high, turned * high, 0.0, turned / 2)
        cable = max(float(p["cable_stiffness"]), 0.0)
        shapes.add(theta, 0.0, (2.0 * size + 2 * cable) * high, cable, 1.0 * size)
        for at in (0.6, 0.8, 1.0):
            shapes.add(np.maximum(theta - at, 0.0), 0.0, 45.0 * max(size, 1.0) * high, 0.0, 15.0 * max(size, 1.0))
        if not free:
            shapes.add(rotor * a, 0.0, 1.5 * high, 0.0, 0.8)
            shapes.add(a, 0.0, 0.2 * size, 0.0, 0.1 * size)
        friction, sliding, level = 0.0, np.tanh(N * v / p["vs"]), 0
        if drive:
            friction, viscous = N * float(p["Fc"]), N * N * float(p["bw"] + p["bm"]) + float(p["bl"])
            level = len(shapes)
            slightest = 0.0 if self.lighter else SETTINGS.friction[0]
            shapes.add(friction * sliding, slightest, SETTINGS.friction[1], 1.0, 2.0, bounding=True)
            shapes.add(viscous * v, SETTINGS.viscous[0], SETTINGS.viscous[1] * high, 1.0, 3.0)
            offset = 0.2 * N * float(p["Kt"]) + 0.5 * friction
            shapes.add(1.0, -offset, offset, N * float(p["Kt"] * p["current_offset"]), offset / 3)
            load = np.abs(weight * np.sin(angle) + p["Jl"] * motion.inertia * a)
            shapes.add(load * sliding, -0.1, 0.6, float(p["friction_load"]), 0.2)
            shapes.add(load * sliding * (np.sin(angle) * v < 0), -0.6, 0.6, 0.0, 0.2)
            for order in (1.0, 2.0, 3.0):
                for wave in (np.sin(order * theta), np.cos(order * theta)):
                    shapes.add(friction * sliding * wave, -0.8 * high, 0.8 * high, 0.0, 0.3)
            for seconds in (6.0, 15.0):
                shapes.add(friction * sliding * np.exp(-motion.time / seconds), 0.0, 2.0 * high, 0.0, 0.7)
        else:
            shapes.add(1.0, -0.06 * rated, 0.06 * rated, float(p["torque_offset"]), 0.02 * rated)
            shapes.add(motion.time, -0.004 * rated, 0.004 * rated, float(p["torque_rate"]), 0.004 * rated / 3)
            # Friction of the output bearing, and a mass model of an arm that is off.
            shapes.add(sliding, 0.0, 0.1 * rated, float(p["link_friction"]), 0.03 * rated)
        if motion.known_torque.any():
            shapes.add(-motion.known_torque, -0.5, 0.5, float(p["arm_scale"]) - 1.0, 0.1)
        if "external_torque" in motion and not self.pushed:  # measured, with a gain near one
            shapes.add(-motion.channels["external_torque"][:, 0], 0.6, 1.5, 1.0, 0.3)
        y = motion.channels[name][:, 0] * (N if drive else 1.0) * (float(p["Kt"]) if name == "motor_current" else 1.0)
        y = y + motion.known_torque
        base = (0.025 if drive else 0.02) * rated * (1.5 if self.pushed else 1.0)
        wide = float(np.hypot(base, min(SETTINGS.noise * float(np.std(y)), 2 * base)))
        if not drive:
            return shapes.fit(y, np.full(len(theta), wide), base, self._effective(motion))
        # At rest, and near it, friction is unknown up to its level.
        near = uniform_filter1d(sliding, 5, mode="nearest")
        resting = np.maximum(np.exp(-((N * v / (2 * p["vs"])) ** 2)), 1 - np.abs(near))
        found = shapes.fit(y, np.hypot(wide, 2 * friction * resting), base, self._effective(motion))
        times = float(found.coefficients[level])
        if times > 1.5:
            found = shapes.fit(y, np.hypot(wide, 2 * times * friction * resting), base, self._effective(motion))
        return found
