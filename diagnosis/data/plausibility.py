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
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from ...models.joint import Joint
from ...models.joint_parts import Mounting
from ...models.kernels import kernel
from ...models.motion import smooth
from ...models.recording import Recording
from ...models.signals import DRIVING, POSITIONS


@dataclass(frozen=True)
class AgreementSettings:
    """Settings of smoothing and comparison. Set on `benchmarks/mistakes.py`."""

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
    weight: float = 0.05  # gravity over rated torque, below which a torque without it looks the same
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
    """Smoothed channels of a recording."""

    time: np.ndarray  # since the recording's start [s], shape (n,)
    channels: Mapping[str, np.ndarray]  # value and two derivatives in time by name, shape (n, 3)
    known_torque: np.ndarray  # on the link by an arm in motion [N·m], shape (n,)
    inertia: np.ndarray  # over that of the mounting [1], shape (n,)
    steps: Mapping[str, float]  # between neighbouring values of the positions, in their units

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    @property
    def position(self) -> str:
        """The channel of the link's motion; the link encoder takes precedence."""
        return "link_position" if "link_position" in self.channels else "motor_position"


def motion_of(recording: Recording) -> SmoothedChannels | None:
    """Smooth a recording's channels; None if no segment is long enough."""
    time, interval, parts = recording.time - recording.time[0], recording.interval, recording.segments
    recorded = sum(float(time[p.stop - 1] - time[p.start]) for p in parts)  # a log may be bursts far apart
    step = max(0.02, interval, recorded / SETTINGS.samples)
    columns = {name: recording[name] for name in _CHANNELS if name in recording}
    if recording.load is not None:
        columns |= {"known_torque": recording.load.torque, "inertia": recording.relative_inertia}
    times, found = [], []
    for part in parts:
        t = time[part]
        if len(t) < SETTINGS.shortest[0] or t[-1] - t[0] < SETTINGS.shortest[1]:
            continue
        begins = np.arange(len(t))
        if interval < 0.5 * SETTINGS.bin:
            begins = np.flatnonzero(np.diff(np.floor((t - t[0]) / SETTINGS.bin), prepend=-1.0))
        if len(begins) < SETTINGS.shortest[0]:
            continue
        count = np.diff(begins, append=len(t))
        at, *mean = [np.add.reduceat(x[part], begins) / count for x in (time, *columns.values())]
        s = smooth(at, np.column_stack(mean), step, SETTINGS.cutoff)
        inside = (s.time >= t[0] + SETTINGS.edge) & (s.time <= t[-1] - SETTINGS.edge)
        times.append(s.time[inside])
        found.append(np.stack([s.value, s.rate, s.acceleration], axis=-1)[inside])
    if not times:
        return None
    values = np.concatenate(found)
    channels = {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(columns)}
    return SmoothedChannels(
        time=np.concatenate(times),
        known_torque=channels.pop("known_torque", np.zeros_like(values[:, 0]))[:, 0],
        inertia=channels.pop("inertia", np.ones_like(values[:, 0]))[:, 0],
        channels=channels,
        steps={name: smallest_step(recording[name]) for name in POSITIONS if name in recording},
    )


def smallest_step(x: np.ndarray) -> float:
    """Return the smallest change of a column between samples, above rounding; 0 if it is constant."""
    change = np.abs(np.diff(x))
    change = change[change > max(1e-9 * float(np.ptp(x)), 4 * float(np.spacing(np.abs(x).max())))]
    return float(change.min()) if len(change) else 0.0


@kernel
def _fit(A, y, sigma, low, high, centre, spread, weight, beta):
    """Fit y = A β within bounds, by iterated weights and coordinate descent, in place; return the log likelihood with priors."""
    beta[:] = centre
    prior = 1.0 / (spread * spread)
    for _ in range(10):
        before = beta.copy()
        r = y - A @ beta
        w = weight * (_FREEDOM + 1.0) / (_FREEDOM * sigma * sigma + r * r)
        weighted = np.ascontiguousarray((A * w.reshape(-1, 1)).T)
        G, g = weighted @ A + np.diag(prior), weighted @ y + centre * prior
        for _ in range(60):
            change = 0.0
            for a in range(len(beta)):
                best = min(max(beta[a] + (g[a] - G[a] @ beta) / G[a, a], low[a]), high[a])
                change = max(change, abs(best - beta[a]) / spread[a])
                beta[a] = best
            if change < 1e-4:
                break
        if np.max(np.abs(beta - before) / spread) < 1e-3:
            break
    u, v = (y - A @ beta) / sigma, (beta - centre) / spread
    return -0.5 * (weight * (_FREEDOM + 1.0) * np.sum(np.log1p(u * u / _FREEDOM)) + np.sum(v * v))


class _Shape(NamedTuple):
    """A shape of a relation, with bounds and prior of its coefficient."""

    values: np.ndarray | float  # shape (n,)
    low: float
    high: float
    centre: float = 0.0
    spread: float | None = None  # a third of the range by default
    bounding: bool = False  # whether a bound means a description that is wrong by more than a few times


@dataclass(frozen=True)
class RelationFit:
    """A relation at its best coefficients."""

    agreement: float  # log likelihood
    # part of readings and priors per effective sample: 0 for an ideal fit, −0.6 for readings off by one `sigma`
    misfit: float
    readings: float  # part of readings and priors
    sharpness: float  # part of residuals much smaller than expected
    at_bound: bool  # whether it needs a description that is wrong by more than a few times
    vague: bool  # whether the residual is not much smaller than expected
    rest: float  # residual over the spread of the readings
    coefficients: np.ndarray  # of the shapes, in their order

    @property
    def suspicious(self) -> bool:
        """Whether the channels disagree, or agree only with a description that is wrong by more than a few times."""
        return self.misfit < SETTINGS.suspicious or self.at_bound


def _fitted(
    shapes: list[_Shape], y: np.ndarray, sigma: np.ndarray | float, least: float, effective: float
) -> RelationFit:
    """Fit readings y, shape (n,); `least`: the value of `sigma` without rest."""
    A = np.ascontiguousarray(np.column_stack([np.broadcast_to(s.values, y.shape) for s in shapes]))
    low, high, centre = (np.array(x) for x in list(zip(*shapes, strict=True))[1:4])
    spread = np.array([(s.high - s.low) / 3 if s.spread is None else s.spread for s in shapes])
    sigma, beta = np.broadcast_to(sigma, y.shape).copy(), np.empty(len(shapes))
    misfit = float(_fit(A, y, sigma, low, high, centre, spread, effective / len(y), beta))
    # A bound counts only if the difference from the centre would be visible.
    shows = least / np.maximum(np.sqrt(np.mean(A * A, axis=0)), 1e-300)
    out = ((beta <= low) & (centre - low > shows)) | ((beta >= high) & (high - centre > shows))
    # A residual much smaller than expected adds information.
    residual = y - A @ beta
    u = residual / sigma
    scale = min(max(1.5 * float(np.median(np.abs(u))), SETTINGS.sharpest), 1.0)
    more = 0.5 * (_FREEDOM + 1) * float(np.mean(np.log1p(u**2 / _FREEDOM) - np.log1p((u / scale) ** 2 / _FREEDOM)))
    sharpness = effective * max(more - math.log(scale), 0.0)
    known = -effective * float(np.mean(np.log(sigma / least)))  # less information at rest
    weights = 1 / sigma**2
    variance = np.average((y - np.average(y, weights=weights)) ** 2, weights=weights)
    return RelationFit(
        agreement=misfit + sharpness + known,
        misfit=misfit / effective,
        readings=misfit + sharpness,
        sharpness=sharpness,
        at_bound=any(s.bounding and beyond for s, beyond in zip(shapes, out, strict=True)),
        vague=scale > SETTINGS.vague,
        rest=math.sqrt(np.average(residual**2, weights=weights) / max(variance, 1e-300)),
        coefficients=beta,
    )


def _same(a: SmoothedChannels, b: SmoothedChannels, channels: tuple[str, ...]) -> bool:
    """Return whether some channels are the same objects, with the same encoder for the link's motion."""
    return a.position == b.position and all(a.channels.get(n) is b.channels.get(n) for n in channels)


class Plausibility:
    """A joint's description, compared with the channels of one recording. `lighter`: rotor and friction may be much smaller than
    described, as those by rules of a larger gear are."""

    def __init__(self, joint: Joint, recording: Recording, lighter: bool = False):
        self.joint, self.mounting = joint, recording.link
        self.p = joint.record(recording.link)[0]
        self.lighter = lighter
        self.pushed = recording.external == "unmeasured"
        self.rated = joint.numbers["rated_torque"].value
        self.heavy = self.p["Mg"] > SETTINGS.weight * self.rated
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
        known: Mapping[str, RelationFit] = MappingProxyType({}),
    ) -> dict[str, RelationFit]:
        """Fit all relations of the channels, by name: `encoders`, `command`, and each torque channel. `before`, `known`: other
        channels and their relations, which are reused for identical channels."""
        needed = {"encoders": POSITIONS, "command": (motion.position, "position_command")}
        fits = {"encoders": self._encoders, "command": self._command}
        for name in DRIVING:
            needed[name], fits[name] = (motion.position, name), partial(self.torque, name=name)
        return {
            name: known[name]
            if before is not None and name in known and _same(motion, before, (*channels, "external_torque"))
            else fits[name](motion)
            for name, channels in needed.items()
            if all(channel in motion for channel in channels)
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
        shapes = [
            _Shape(1.0, p["link_zero"] - off, p["link_zero"] + off, p["link_zero"], off / 2),
            _Shape(theta, -2 * wound - 1e-3, 2 * wound + 1e-3),
            _Shape(np.sin(theta), -2e-3, 2e-3),
            _Shape(np.cos(theta), -2e-3, 2e-3),
            _Shape(v, p["link_delay"] - 2e-3, p["link_delay"] + 1.3e-2, p["link_delay"], 8e-3),
            _Shape(np.tanh(p["N"] * v / p["vs"]), -4 * friction, 4 * friction),
        ]
        y = motion.channels["motor_position"][:, 0] / p["N"] - theta
        sigma = 2e-4 + 0.15 * wound + self.joint.sensors.motor_encoder.resolution / p["N"]
        # Coarser counts are not a mistake; the limit is for other units.
        coarse = min(motion.steps["link_position"], 5e-3) + min(motion.steps["motor_position"] / p["N"], 5e-3)
        sigma = float(np.hypot(sigma, 0.5 * coarse))
        return _fitted(shapes, y, sigma, sigma, self._effective(motion))

    def _command(self, motion: SmoothedChannels) -> RelationFit:
        theta, v, _ = self.link(motion).T
        shapes = [_Shape(1.0, -0.1, 0.1), _Shape(theta, -0.05, 0.05), _Shape(v, -0.02, 0.5, 0.0, 0.2)]
        sigma = 0.03 + 0.02 * float(np.ptp(theta))
        y = motion.channels["position_command"][:, 0] - theta
        return _fitted(shapes, y, sigma, sigma, 0.5 * self._effective(motion))

    def torque(self, motion: SmoothedChannels, name: str, free: bool = False) -> RelationFit:
        """Fit a torque channel to the link's motion. `free`: whether inertia and gravity, the first three coefficients, are
        unbounded, to detect a wrong clock or a torque without gravity."""
        p, size, rated, payload = self.p, self._size, self.rated, self._payload
        drive = name != "joint_torque"
        N, weight = float(p["N"]), float(p["Mg"])
        low, high = self._gain if drive else (0.8, 1.25)
        theta, v, a = self.link(motion).T
        rotor = N * N * float(p["Jm"] + p["Jw"]) if drive else 0.0
        inertia = float(p["Jl"]) * motion.inertia + rotor
        least = SETTINGS.inertia[0] * (float(p["Jl"]) / (float(p["Jl"]) + rotor) if self.lighter else 1.0)
        # The link's own weight, a payload, a cable, a stop [N·m].
        angle, heaviest = theta + p["gravity_angle"], self._heaviest(weight) * high
        turned = heaviest if free else (0.25 if self.joint.gravity_angle is not None else 0.06) * weight + 0.3 * payload
        cable = max(float(p["cable_stiffness"]), 0.0)
        shapes = [
            _Shape(inertia * a, *((0.0, 1e3, 1.0, 1e3) if free else (least, SETTINGS.inertia[1], 1.0, 0.8)), bounding=True),
            _Shape(
                np.sin(angle), -heaviest if free else SETTINGS.load[0] * weight * low, heaviest, weight,
                0.5 * (weight + payload), bounding=True,
            ),
            _Shape(np.cos(angle), -turned * high, turned * high, 0.0, turned / 2),
            _Shape(theta, 0.0, (2.0 * size + 2 * cable) * high, cable, size),
            *(
                _Shape(np.maximum(theta - at, 0.0), 0.0, 45.0 * max(size, 1.0) * high, 0.0, 15.0 * max(size, 1.0))
                for at in (0.6, 0.8, 1.0)
            ),
        ]  # fmt: skip
        if not free:
            shapes += [_Shape(rotor * a, 0.0, 1.5 * high, 0.0, 0.8), _Shape(a, 0.0, 0.2 * size, 0.0, 0.1 * size)]
        sliding, level = np.tanh(N * v / p["vs"]), len(shapes)
        friction = N * float(p["Fc"])
        if drive:
            offset = 0.2 * N * float(p["Kt"]) + 0.5 * friction
            load = np.abs(weight * np.sin(angle) + p["Jl"] * motion.inertia * a)
            viscous = N * N * float(p["bw"] + p["bm"]) + float(p["bl"])
            slightest = 0.0 if self.lighter else SETTINGS.friction[0]
            shapes += [
                _Shape(friction * sliding, slightest, SETTINGS.friction[1], 1.0, 2.0, bounding=True),
                _Shape(viscous * v, SETTINGS.viscous[0], SETTINGS.viscous[1] * high, 1.0, 3.0),
                _Shape(1.0, -offset, offset, N * float(p["Kt"] * p["current_offset"]), offset / 3),
                _Shape(load * sliding, -0.1, 0.6, p["friction_load"], 0.2),
                _Shape(load * sliding * (np.sin(angle) * v < 0), -0.6, 0.6, 0.0, 0.2),
                *(
                    _Shape(friction * sliding * wave(order * theta), -0.8 * high, 0.8 * high, 0.0, 0.3)
                    for order in (1.0, 2.0, 3.0) for wave in (np.sin, np.cos)
                ),
                *(
                    _Shape(friction * sliding * np.exp(-motion.time / seconds), 0.0, 2.0 * high, 0.0, 0.7)
                    for seconds in (6.0, 15.0)
                ),
            ]  # fmt: skip
        else:
            shapes += [
                _Shape(1.0, -0.06 * rated, 0.06 * rated, p["torque_offset"], 0.02 * rated),
                _Shape(motion.time, -0.004 * rated, 0.004 * rated, p["torque_rate"], 0.004 * rated / 3),
                # Friction of the output bearing, and a mass model of an arm that is off.
                _Shape(sliding, 0.0, 0.1 * rated, p["link_friction"], 0.03 * rated),
            ]
        if motion.known_torque.any():
            shapes.append(_Shape(-motion.known_torque, -0.5, 0.5, float(p["arm_scale"]) - 1.0, 0.1))
        if "external_torque" in motion and not self.pushed:  # measured, with a gain near one
            shapes.append(_Shape(-motion.channels["external_torque"][:, 0], 0.6, 1.5, 1.0, 0.3))
        y = motion.channels[name][:, 0] * (N if drive else 1.0) * (float(p["Kt"]) if name == "motor_current" else 1.0)
        y = y + motion.known_torque
        base = (0.025 if drive else 0.02) * rated * (1.5 if self.pushed else 1.0)
        wide = float(np.hypot(base, min(SETTINGS.noise * float(np.std(y)), 2 * base)))
        fit = partial(_fitted, shapes, y, least=base, effective=self._effective(motion))
        if not drive:
            return fit(sigma=wide)
        # At rest, and near it, friction is unknown up to its level.
        near = uniform_filter1d(sliding, 5, mode="nearest")
        resting = np.maximum(np.exp(-((N * v / (2 * p["vs"])) ** 2)), 1 - np.abs(near))
        found = fit(sigma=np.hypot(wide, 2 * friction * resting))
        times = float(found.coefficients[level])
        return found if times <= 1.5 else fit(sigma=np.hypot(wide, 2 * times * friction * resting))
