"""How well channels agree with each other and with the joint's description, whatever cause of ordinary size is in it.

Four relations hold between the channels of a joint, however they were recorded:

    encoders       θm/N − θl is the transmission's wind-up: milliradians
    drive          N Kt i (or N times the motor torque) moves rotor and link, against friction and gravity
    joint torque   Ts moves the link against gravity
    command        the link follows its command

Each is a sum of known shapes (sin θ, θ'', sgn θ', …) whose coefficients the description knows, give or take its tolerances and
all causes of ordinary size: bounds, and Gaussian priors within them. What is left is taken to be Student-t distributed, as
pushes, bumps and stops are not in the shapes. The log likelihood of the best coefficients is the *agreement*; samples a few
milliseconds apart say the same thing, so a recording counts as `AgreementSettings.effective` samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...estimator.motion import smooth
from ...models.joint import Joint, Number
from ...models.kernels import kernel
from ...models.recording import GAP, Recording
from ...models.signals import DRIVING, POSITIONS


@dataclass(frozen=True)
class AgreementSettings:
    """How channels are smoothed and held against each other.

    Set on `benchmarks/mistakes.py`: mistakes hidden in sound measurements, and sound ones in which nothing may be found.

    Attributes:
      effective: samples that a recording counts as in a relation between its channels at the most; a_second: of it.
      samples: of a recording that are looked at.
      cutoff: of the smoother [Hz].
      bin: over which samples are averaged before [s].
      shortest: samples and seconds of a part without gaps.
      edge: at both ends of a part, where the smoother settles [s].
      rated_torque: of the joint for which ordinary sizes in N·m are stated: a payload, a cable, a stop [N·m].
    """

    effective: float = 90.0
    a_second: float = 12.0
    samples: int = 320
    cutoff: float = 6.0
    bin: float = 0.01
    shortest: tuple[int, float] = (20, 0.3)
    edge: float = 0.05
    rated_torque: float = 16.0


SETTINGS = AgreementSettings()
_FREEDOM = 3.0  # of the Student-t distribution
_CHANNELS = (*POSITIONS, "motor_current", "motor_torque", "joint_torque", "position_command", "external_torque")


@dataclass(frozen=True)
class SmoothedChannels:
    """A recording's channels, smoothed.

    Attributes:
      time: since the recording's start [s], shape (n,).
      channels: value and two derivatives in time by name, shape (n, 3).
      known_torque: on the link by an arm in motion [N·m], shape (n,); inertia: over that of the mounting [1], shape (n,).
    """

    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    known_torque: np.ndarray
    inertia: np.ndarray

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    def with_channels(self, **channels: np.ndarray) -> SmoothedChannels:
        """The same with channels replaced."""
        return replace(self, channels={**self.channels, **channels})

    def without(self, *names: str) -> SmoothedChannels:
        """The same without channels."""
        return replace(self, channels={n: x for n, x in self.channels.items() if n not in names})

    @property
    def position(self) -> str:
        """The channel that tells the link's motion: of both encoders the link's."""
        return "link_position" if "link_position" in self.channels else "motor_position"


def motion_of(recording: Recording, second: float = 1.0) -> SmoothedChannels | None:
    """Smooth a recording's channels; None where no part without gaps is long enough.

    Args:
      recording: whose samples were checked one by one already.
      second: what one unit of its time is [s].
    """
    time = second * (recording.time - recording.time[0])
    interval = float(np.median(np.diff(time)))
    cuts = np.flatnonzero(np.diff(time) > max(GAP, 5 * interval)) + 1
    step = max(0.02, interval, float(time[-1]) / SETTINGS.samples)
    names = [name for name in _CHANNELS if name in recording]
    columns = [recording[name] for name in names]
    if recording.load is not None:
        columns += [recording.load.torque, recording.relative_inertia]
    times, found = [], []
    for part in np.split(np.arange(len(time)), cuts):
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
    )


@kernel
def _fit(A, y, sigma, low, high, centre, spread, weight, beta):
    """Coefficients within bounds that make y = A β likeliest, by iterated weights and coordinate descent; in place.

    Returns the log likelihood, that of the coefficients' priors included.
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
    """Columns of a relation with bounds and priors of their coefficients."""

    def __init__(self, n: int):
        self._n = n
        self._columns: list[np.ndarray] = []
        self._numbers: list[tuple[float, float, float, float]] = []

    def add(
        self, shape: np.ndarray | float, low: float, high: float, centre: float = 0.0, spread: float | None = None
    ) -> None:
        """A shape whose coefficient lies between `low` and `high`, about `centre` (a third of the range by default)."""
        if high > low:
            self._columns.append(np.broadcast_to(shape, (self._n,)))
            self._numbers.append((low, high, centre, (high - low) / 3 if spread is None else spread))

    def fit(self, y: np.ndarray, sigma: np.ndarray, least: float, effective: float) -> RelationFit:
        """The best coefficients for readings y, shape (n,); `least`: what `sigma` is where all is known."""
        A = np.ascontiguousarray(np.column_stack(self._columns))
        low, high, centre, spread = (np.array(x) for x in zip(*self._numbers, strict=True))
        beta = np.empty(len(low))
        misfit = float(_fit(A, y, sigma, low, high, centre, spread, effective / self._n, beta))
        known = -effective * float(np.mean(np.log(sigma / least)))  # what is not known at rest says less
        return RelationFit(misfit + known, misfit / effective, misfit)


@dataclass(frozen=True)
class RelationFit:
    """A relation at its best coefficients.

    Attributes:
      agreement: log likelihood.
      misfit: its part that readings and priors make up, per effective sample: 0 where all is as expected, −0.6 where readings
        are off by one `sigma`.
      readings: that part of the whole.
    """

    agreement: float
    misfit: float
    readings: float


def _same(a: SmoothedChannels, b: SmoothedChannels, channels: tuple[str, ...]) -> bool:
    """Whether some channels are the very same, and both tell the link's motion by the same encoder."""
    return a.position == b.position and all(a.channels.get(n) is b.channels.get(n) for n in channels)


class Plausibility:
    """A joint's description as what the channels of one recording are held against."""

    def __init__(self, joint: Joint, recording: Recording):
        self.joint = joint
        self.p = joint.record(recording.link)[0]
        self.pushed = recording.external == "unmeasured"
        self._size = joint.numbers["rated_torque"].value / SETTINGS.rated_torque
        self._turned = joint.gravity_angle is not None

    def agreement(
        self,
        motion: SmoothedChannels,
        before: SmoothedChannels | None = None,
        known: Mapping[str, RelationFit] | None = None,
    ) -> dict[str, RelationFit]:
        """All relations that the channels allow, by name: `encoders`, `command`, and the name of each torque channel.

        Args:
          motion: the channels.
          before, known: other channels and their relations, of which those are taken over whose channels are the same.
        """
        found = {}
        for name, needed in self._relations(motion).items():
            if before is not None and known is not None and name in known and _same(motion, before, needed):
                found[name] = known[name]
            else:
                found[name] = self._fit(name, motion)
        return found

    def torques(self, motion: SmoothedChannels) -> dict[str, RelationFit]:
        """The relations of torques alone."""
        return {name: self._fit(name, motion) for name in self._relations(motion) if name in DRIVING}

    def _relations(self, motion: SmoothedChannels) -> dict[str, tuple[str, ...]]:
        """Relations that the channels allow, each with the channels that it is between."""
        found: dict[str, tuple[str, ...]] = {}
        if all(name in motion for name in POSITIONS):
            found["encoders"] = POSITIONS
        if "position_command" in motion:
            found["command"] = (motion.position, "position_command")
        for name in DRIVING:
            if name in motion:
                found[name] = (motion.position, name, "external_torque")
        return found

    def _fit(self, name: str, motion: SmoothedChannels) -> RelationFit:
        if name == "encoders":
            return self._encoders(motion)
        if name == "command":
            return self._command(motion)
        return self._joint_torque(motion) if name == "joint_torque" else self._drive(motion, name)

    def link(self, motion: SmoothedChannels) -> np.ndarray:
        """The link's motion, shape (n, 3): of the link encoder, or the rotor's over the gear ratio."""
        values = motion.channels[motion.position]
        return values if motion.position == "link_position" else values / self.p["N"]

    def _tolerance(self, symbol: str) -> float:
        """Relative standard deviation of a number of the description, of a reading of the drive that of Kt."""
        number: Number = self.joint.numbers[symbol]
        shared = self.joint.shared_tolerances[number.shared] if number.shared else 0.0
        return float(np.hypot(np.hypot(number.tolerance, shared), number.deviation / max(number.value, 1e-12)))

    @staticmethod
    def _effective(motion: SmoothedChannels) -> float:
        """Samples that a recording counts as: no more than its passband has in so many seconds."""
        seconds = float(motion.time[-1] - motion.time[0])
        return min(SETTINGS.effective, max(SETTINGS.a_second * seconds, 1.0))

    def _encoders(self, motion: SmoothedChannels) -> RelationFit:
        p = self.p
        theta, v = motion.channels["link_position"][:, 0], motion.channels["link_position"][:, 1]
        zero = self.joint.sensors.link_encoder.zero
        wound = self.joint.numbers["rated_torque"].value / p["K1"]
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
        sigma = 2e-4 + 0.15 * wound + (self.joint.sensors.motor_encoder.resolution / p["N"])
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

    def _gravity(self, shapes: _Shapes, theta: np.ndarray, scale: tuple[float, float]) -> None:
        """Shapes of what the link's own weight, a payload, a cable and a stop ask for [N·m]; `scale`: of the reading."""
        p, size = self.p, self._size
        weight, payload = float(p["Mg"]), 4.5 * max(size, 1.0)
        turned = (0.25 if self._turned else 0.03) * weight + 0.3 * payload
        low, high = scale
        shapes.add(
            np.sin(theta + p["gravity_angle"]), 0.75 * weight * low, (1.25 * weight + payload) * high, weight,
            0.25 * weight + 0.5 * payload,
        )  # fmt: skip
        shapes.add(np.cos(theta + p["gravity_angle"]), -turned * high, turned * high, 0.0, turned / 2)
        cable = max(float(p["cable_stiffness"]), 0.0)
        shapes.add(theta, 0.0, (2.0 * size + 2 * cable) * high, cable, 1.0 * size)
        for angle in (0.6, 0.8, 1.0):
            shapes.add(np.maximum(theta - angle, 0.0), 0.0, 45.0 * max(size, 1.0) * high, 0.0, 15.0 * max(size, 1.0))

    def _known(self, shapes: _Shapes, motion: SmoothedChannels) -> np.ndarray:
        """Torque that is known to push the link, which the joint need not give; a measured one with a gain near one [N·m]."""
        if "external_torque" in motion and not self.pushed:
            shapes.add(-motion.channels["external_torque"][:, 0], 0.6, 1.5, 1.0, 0.3)
        return -motion.known_torque

    def _drive(self, motion: SmoothedChannels, name: str) -> RelationFit:
        p, size = self.p, self._size
        N = float(p["N"])
        theta, v, a = self.link(motion).T
        unsure = min(3 * self._tolerance("Kt"), 0.5)
        scale = (0.8 * (1 - unsure), 1.25 * (1 + unsure))
        low, high = scale
        rotor = N * N * float(p["Jm"] + p["Jw"])
        inertia = float(p["Jl"]) * motion.inertia + rotor
        friction = N * float(p["Fc"])
        loose = 1 + min(3 * self._tolerance("Fc"), 2.0)
        viscous = N * N * float(p["bw"] + p["bm"]) + float(p["bl"])
        sliding = np.tanh(N * v / p["vs"])
        offset = 0.2 * N * float(p["Kt"]) + 0.5 * friction
        shapes = _Shapes(len(theta))
        self._gravity(shapes, theta, scale)
        shapes.add(inertia * a, 0.4 * low, 3.0 * high, 1.0, 0.6)
        shapes.add(rotor * a, 0.0, 1.5 * high, 0.0, 0.8)
        shapes.add(a, 0.0, 0.2 * size, 0.0, 0.1 * size)
        shapes.add(friction * sliding, 0.4 * low / loose, 2.8 * high * loose, 1.0, 0.8 * loose)
        shapes.add(viscous * v, 0.0, 8.0 * high, 1.0, 2.0)
        shapes.add(1.0, -offset, offset, N * float(p["Kt"] * p["current_offset"]), offset / 3)
        load = np.abs(p["Mg"] * np.sin(theta + p["gravity_angle"]) + p["Jl"] * motion.inertia * a)
        shapes.add(load * sliding, -0.1, 0.6, float(p["friction_load"]), 0.2)
        driven = np.sign(np.sin(theta + p["gravity_angle"]) * v) < 0
        shapes.add(load * sliding * driven, -0.6, 0.6, 0.0, 0.2)
        for order in (1.0, 2.0, 3.0):
            for wave in (np.sin(order * theta), np.cos(order * theta)):
                shapes.add(friction * sliding * wave, -0.8 * high, 0.8 * high, 0.0, 0.3)
        for seconds in (6.0, 15.0):
            shapes.add(friction * sliding * np.exp(-motion.time / seconds), 0.0, 2.0 * high, 0.0, 0.7)
        known = self._known(shapes, motion)
        y = N * motion.channels[name][:, 0] * (float(p["Kt"]) if name == "motor_current" else 1.0)
        # At rest friction may be anything up to its level.
        resting = np.exp(-((N * v / (2 * p["vs"])) ** 2))
        sigma = 0.025 * self.joint.numbers["rated_torque"].value * (1.5 if self.pushed else 1.0)
        return shapes.fit(y - known, np.hypot(sigma, 2 * friction * resting), sigma, self._effective(motion))

    def _joint_torque(self, motion: SmoothedChannels) -> RelationFit:
        size, rated = self._size, self.joint.numbers["rated_torque"].value
        theta, _, a = self.link(motion).T
        inertia = float(self.p["Jl"]) * motion.inertia
        shapes = _Shapes(len(theta))
        self._gravity(shapes, theta, (0.8, 1.25))
        shapes.add(inertia * a, 0.4, 3.0, 1.0, 0.5)
        shapes.add(a, 0.0, 0.2 * size, 0.0, 0.1 * size)
        shapes.add(1.0, -0.06 * rated, 0.06 * rated, float(self.p["torque_offset"]), 0.02 * rated)
        drift = 0.004 * rated
        shapes.add(motion.time, -drift, drift, float(self.p["torque_rate"]), drift / 3)
        known = self._known(shapes, motion)
        sigma = 0.02 * rated * (1.5 if self.pushed else 1.0)
        y = motion.channels["joint_torque"][:, 0] - known
        return shapes.fit(y, np.full(len(theta), sigma), sigma, self._effective(motion))
