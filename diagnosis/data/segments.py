"""Prepare recordings for the replay: segments of smoothed motion on an even grid, with the readings to explain.

Every channel of a segment goes through the same linear smoother (`models.motion`): for a linear joint, computed and measured
torques then have no relative smoothing error. Each segment has a *noise replicate*: the same motion and readings with the
sensors' stated noise drawn and added again. Their difference gives the effect of the motion's noise on a residual.

With one encoder, the rotor's motion follows from that encoder and the description; the replay simulates the link
(`Segment.link_measured`).

The link encoder alone also sees the gear's kinematic error and the link's resonance. The rotor then follows the link below the
frequency of that resonance, and moves evenly above. The gear's orders are in the simulation alone, and readings need less
smoothing than motion: a log slower than the residuals has them at its samples only, as friction reverses between two. A torque
sensor is compared with the link's measured motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from ...estimator.conditioning import Conditioned, between, condition
from ...models import dynamics, laws
from ...models.joint import Joint
from ...models.joint_parts import EncoderSpec, Mounting
from ...models.kernels import kernel
from ...models.motion import CUTOFF, SHARE, passband, smooth
from ...models.recording import Recording

STEP = 1e-3
"""Step of the replay [s]."""
DECIMATION = 8
"""Replay steps per residual: one residual every 8 ms, the mean over a Hann window of 16 ms."""
BALANCES = ("motor_current", "joint_torque", "link_balance")
"""Torque balances of a joint: current [A], transmission [N·m], link [N·m]."""
CURRENT, TORQUE, LINK = range(len(BALANCES))
ENCODERS = ("motor_position", "link_position")
_WEIGHING = ("link_position", "joint_torque", "external_torque", "arm_torque")
UNITS = {"motor_current": "A", "joint_torque": "N·m", "link_balance": "N·m"}


@dataclass(frozen=True)
class SegmentSettings:
    """Settings of segments."""

    held_out_block: float = 0.5  # length of held-out blocks [s]
    held_out_every: int = 6  # blocks of which one is held out
    settle_time: float = 0.06  # at both ends of a segment, where smoother and transmission settle [s]
    settle_travel: float = 0.6  # of the rotor, after which the unknown initial state of the friction is forgotten [rad]
    rest_travel: float = 0.06  # of the rotor within ±40 ms, below which presliding friction does not average out [rad]
    rest_counts: float = 2.0  # of the encoder in the same time, below which these do not
    shortest: tuple[int, float] = (50, 0.5)  # least samples and seconds of a segment
    block: int = 8  # most residuals that count as one, for slow motion with noise above
    above_noise: float = 10.0  # least power ratio of measured acceleration to its noise that counts as motion
    # noise of the rotor's acceleration, as a current, over the current's noise above which more residuals count as one
    shaken: float = 0.9
    # passband of the rotor's motion from the link encoder, over the described resonance of the link against a fixed rotor
    following: float = 0.5
    slowest: float = 1.0  # least passband of such a motion [Hz]
    readings: float = 0.8  # passband over sample rate of readings with such a motion; they are not differentiated


SETTINGS = SegmentSettings()


@dataclass(frozen=True)
class Segment:
    """A part of a recording without gaps, smoothed; n replay steps, k residuals."""

    recording: int  # index of its recording in the measurement
    name: str  # of that recording
    time: np.ndarray  # of each replay step since the recording's start [s], shape (n,)
    rotor: np.ndarray  # motor encoder's reading and its two derivatives [rad], shape (n, 3)
    link: np.ndarray  # the same of the link encoder; without it, as described
    rotor_measured: bool  # by a motor encoder; otherwise the rotor's angle follows from the link's
    link_measured: bool  # the motion of both ends; otherwise the link's is simulated
    # the link balance uses measured motion: of both encoders, or of the link encoder with a torque sensor
    weighed: bool
    torque: np.ndarray  # joint torque reading [N·m], shape (n,); empty without a sensor
    external: np.ndarray  # known torque on the link [N·m], shape (n,)
    arm: np.ndarray  # its part from other links of an arm, shape (n,)
    temperature: np.ndarray  # [°C], shape (n,)
    mounting: Mounting  # of the link
    stiffness: float  # sum of the described joint's K1 to K3 [N·m/rad]
    at: np.ndarray  # time of each residual [s], shape (k,)
    measured: np.ndarray  # decimated readings of current and joint torque (zero without a sensor), shape (k, 2)
    measured_rate: np.ndarray  # their first derivative in time [1/s], shape (k, 2)
    measured_bend: np.ndarray  # their second derivative [1/s²], shape (k, 2)
    state: np.ndarray  # decimated θm, θl, θm', θl' and θl'', shape (k, 5), for weights and regressors
    # joint torque on the link [N·m], shape (k,): measured, or from the described link and known pushes
    load: np.ndarray
    balances: np.ndarray  # which balances can be formed, shape (len(BALANCES),), bool
    usable: np.ndarray  # which residuals count, shape (k, len(BALANCES))
    held_out: np.ndarray  # residuals kept from every fit, same shape
    at_rest: np.ndarray  # the rotor moves so little that its encoder's counts do not average out, shape (k,)
    passband: float  # of the smoother, as turns per radian of a shaft that makes one in 1/fc: 1/(2π fc) [s]
    block: int = 1  # residuals that count as one (`SegmentSettings.block`)
    sampled: float = 1.0  # share of the residuals with a reading of the slowest channel

    @cached_property
    def link_cosine(self) -> np.ndarray:
        """Cosine of the link's angle at the residuals, shape (k,)."""
        return np.cos(self.state[:, 1])

    @property
    def motor_position(self) -> np.ndarray:
        """θm at the residuals [rad], shape (k,)."""
        return self.state[:, 0]

    @property
    def link_position(self) -> np.ndarray:
        """θl at the residuals [rad], shape (k,)."""
        return self.state[:, 1]

    @property
    def motor_velocity(self) -> np.ndarray:
        """θm' at the residuals [rad/s], shape (k,)."""
        return self.state[:, 2]

    @property
    def has_torque(self) -> bool:
        """Whether there was a joint torque sensor."""
        return len(self.torque) > 0


WINDOW = 0.5 * (1 + np.cos(np.pi * np.arange(DECIMATION) / DECIMATION))
"""Half of the Hann window of a residual."""


def decimate(x: np.ndarray) -> np.ndarray:
    """Hann-weighted means around every `DECIMATION`-th sample, shape (k, …), as the replay takes them."""
    k = (len(x) - 1) // DECIMATION + 1
    out = np.zeros((k, *x.shape[1:]))
    total = np.zeros(k)
    for j in range(-DECIMATION + 1, DECIMATION):
        weight = WINDOW[abs(j)]
        i = np.arange(k) * DECIMATION + j
        inside = (i >= 0) & (i < len(x))
        out[inside] += weight * x[i[inside]]
        total[inside] += weight
    return out / total.reshape(-1, *[1] * (x.ndim - 1))


def pushed(recording: Recording) -> bool:
    """Return whether unmeasured pushes affect a recording's balances: with one encoder and a free link."""
    both = all(name in recording for name in ENCODERS)
    return recording.external == "unmeasured" and not both and not recording.link.locked


def undisturbed(recordings: Sequence[Recording]) -> list[Recording]:
    """Return the recordings without unmeasured pushes (`pushed`), or all if every one may have them."""
    return [r for r in recordings if not pushed(r)] or list(recordings)


def segments(recordings: Sequence[Recording | Conditioned], joint: Joint) -> tuple[list[Segment], list[Segment]]:
    """Smooth every segment of every recording, conditioned or not; return segments and noise replicates. Recordings with
    unmeasured pushes (`pushed`) do not count if there are others."""
    rng = np.random.default_rng(1)
    found, replicates = [], []
    prepared = [r if isinstance(r, Conditioned) else condition(r, joint) for r in recordings]
    counted = undisturbed([c.recording for c in prepared])
    for index, conditioned in enumerate(prepared):
        recording = conditioned.recording
        for part in recording.segments:
            time = recording.time[part]
            if len(time) < SETTINGS.shortest[0] or time[-1] - time[0] < SETTINGS.shortest[1]:
                continue
            one, replicate = _segment(conditioned, index, part, joint, rng)
            if not any(recording is r for r in counted):
                none = np.zeros_like(one.usable)
                one, replicate = (replace(s, usable=none, held_out=none) for s in (one, replicate))
            found.append(one)
            replicates.append(replicate)
    return found, replicates


def mirrored(segment: Segment, replicate: Segment) -> Segment:
    """Return the opposite noise replicate of a segment: its noise subtracted."""
    drawn = ("rotor", "link", "torque", "measured", "measured_rate", "measured_bend")
    return replace(segment, **{name: 2 * getattr(segment, name) - getattr(replicate, name) for name in drawn})


def _segment(
    conditioned: Conditioned, index: int, part: slice, joint: Joint, rng: np.random.Generator
) -> tuple[Segment, Segment]:
    recording = conditioned.recording
    p = joint.record(recording.link)[0]
    channels, noise = _channels(conditioned, part, joint, p, rng)
    names = list(channels)
    link_measured = all(name in recording for name in ENCODERS)
    has_torque = "joint_torque" in recording
    # Pushes that nobody measured may be anything.
    weighed = "link_position" in recording and (link_measured or (has_torque and recording.external != "unmeasured"))
    values = np.column_stack([*channels.values(), *(noise[name] for name in names)])
    time, values, whole, settle = _smoothed(conditioned, recording.time[part], values, names, weighed, p)
    clean = {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}
    drawn = {name: values[:, len(names) + i] for i, name in enumerate(names)}
    zero = np.zeros((len(time), 3))
    rotor, link = (clean[name] for name in ENCODERS)
    read, read_noise = (np.stack([of.get(b, zero) for b in BALANCES[:LINK]], axis=1) for of in (clean, drawn))
    external, arm = (np.ascontiguousarray(clean.get(n, zero)[:, 0]) for n in ("external_torque", "arm_torque"))
    temperature = np.full(len(time), p["reference_temperature"])
    if "temperature" in recording:
        temperature = np.interp(time, recording.time[part], recording["temperature"][part])
    since = time - recording.time[0]
    at = decimate(since)
    state = decimate(np.column_stack([rotor[:, 0], link[:, 0], rotor[:, 1], link[:, 1], link[:, 2]]))
    measured, rate, bend = np.moveaxis(decimate(read), -1, 0)
    # With one encoder the sensor is compared with the link's motion, measured or simulated.
    balances = np.array(["motor_current" in recording, has_torque and (link_measured or not weighed), weighed])
    usable, held_out = _usable(recording, index, at, state[:, 0], balances, settle)
    sampled = np.ones_like(usable)
    if "motor_position" not in recording:
        sampled = _sampled(conditioned, part, at + recording.time[0])
    usable, held_out = usable & sampled, held_out & sampled
    # Torque of the link's gravity and inertia.
    own = p["Mg"] * np.sin(state[:, 1] + p["gravity_angle"]) + p["Jl"] * state[:, 4]
    s = joint.sensors
    count = s.motor_encoder.resolution if "motor_position" in recording else p["N"] * s.link_encoder.resolution
    one = Segment(
        recording=index, name=recording.name, time=since, rotor=rotor, link=link,
        rotor_measured="motor_position" in recording, link_measured=link_measured, weighed=weighed,
        torque=np.ascontiguousarray(read[:, TORQUE, 0]) if has_torque else np.empty(0),
        external=external, arm=arm, temperature=temperature, mounting=recording.link,
        stiffness=float(p["K1"] + p["K2"] + p["K3"]), at=at, measured=measured, measured_rate=rate, measured_bend=bend,
        state=state, load=measured[:, TORQUE] if has_torque else own - decimate(external),
        balances=balances, usable=usable, held_out=held_out, at_rest=_at_rest(state[:, 0], count),
        passband=1 / (2 * np.pi * whole), sampled=float(sampled.mean(axis=0).min()),
    )  # fmt: skip
    one = replace(one, block=_block(one, conditioned, [drawn[n] for n in ENCODERS], read_noise[:, CURRENT, 0], p))
    more, rate_noise, bend_noise = np.moveaxis(decimate(read_noise), -1, 0)
    replicate = replace(
        one, rotor=rotor + drawn["motor_position"], link=link + drawn["link_position"],
        torque=one.torque + read_noise[:, TORQUE, 0] if has_torque else one.torque,
        measured=measured + more, measured_rate=rate + rate_noise, measured_bend=bend + bend_noise,
    )  # fmt: skip
    return one, replicate


def _smoothed(
    conditioned: Conditioned, time: np.ndarray, values: np.ndarray, names: list[str], weighed: bool, p: np.void
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Smooth channels and their noise, shape (n, 2 len(names)). Return times [s]; values with two derivatives, shape
    (m, 2 len(names), 3); the passband of the readings [Hz]; the time in which the smoother settles [s]."""

    def through(cutoff: float, share: float = SHARE) -> tuple[np.ndarray, np.ndarray]:
        s = smooth(time, values, STEP, cutoff, share=share)
        return s.time, np.stack([s.value, s.rate, s.acceleration], axis=-1)

    cutoff = conditioned.passband
    if "motor_position" in conditioned.recording:
        return *through(cutoff), passband(time, cutoff), SETTINGS.settle_time
    readings = min([CUTOFF, *(SETTINGS.readings * conditioned.channels[name].rate for name in conditioned.news)])
    following = max(SETTINGS.following * float(np.sqrt(p["K1"] / p["Jl"])) / (2 * np.pi), SETTINGS.slowest)
    following = min(following, cutoff)
    at, found = through(readings, SETTINGS.readings)
    found = np.where(np.isin([*names, *names], ENCODERS)[:, None], through(following)[1], found)
    if weighed:  # channels that are compared go through one smoother
        found = np.where(np.isin([*names, *names], _WEIGHING)[:, None], through(cutoff)[1], found)
    settle = max(SETTINGS.settle_time, 1 / passband(time, following))
    return at, found, passband(time, readings, SETTINGS.readings), settle


def _block(
    one: Segment, conditioned: Conditioned, noises: Sequence[np.ndarray], current_noise: np.ndarray, p: np.void
) -> int:
    """Return how many residuals count as one (`SegmentSettings.block`), which keeps the frequencies of the motion: above them,
    acceleration is noise alone, and least squares would be biased (errors in variables)."""
    rate, most = 1.0 / (STEP * DECIMATION), SETTINGS.block
    block = int(np.clip(0.5 / (STEP * DECIMATION * conditioned.passband), 1, most))
    if not one.link_measured:  # orders of the motor show in the current above the passband of the link's encoder
        return block if one.rotor_measured else 1
    if conditioned.stamps.error:
        return most  # replicates do not have errors of time
    highest = max(_highest(x, noise, rate) for x, noise in zip((one.rotor, one.link), noises, strict=True))
    block = max(block, int(np.clip(0.5 * rate / max(highest, 1e-3), 1, most)))
    # The drive reacts to encoder counts, which replicates do not have. This biases a fit towards a light rotor and a strong
    # motor. The noise decreases with frequency to the power 5/2.
    shakes, current = (float(np.std(decimate(x))) for x in (noises[0][:, 2], current_noise))
    shakes *= float(p["Jm"] / p["Kt"])
    # Without a current, or without its noise, there is no limit.
    while block < most and current and shakes / block**2.5 > SETTINGS.shaken * current:
        block += 1
    return block


def _highest(motion: np.ndarray, noise: np.ndarray, rate: float) -> float:
    """Return the highest frequency [Hz] at which a motion's acceleration is above its noise."""
    from scipy.signal import welch

    x = decimate(np.column_stack([motion[:, 2], noise[:, 2]]))
    if len(x) < 64:
        return np.inf
    f, power = welch(x, rate, nperseg=min(256, len(x)), axis=0)
    power = uniform_filter1d(power, 5, axis=0, mode="nearest")
    return float(f.max(where=power[:, 0] > SETTINGS.above_noise * power[:, 1], initial=0.0))


def _channels(conditioned: Conditioned, part: slice, joint: Joint, p: np.void, rng: np.random.Generator):
    """Return channels of a segment by name, and another draw of their noise; shape (n,) each."""
    s, recording = joint.sensors, conditioned.recording
    time = recording.time[part]
    columns = {name: values[part] for name, values in recording.columns.items()}
    encoders = {"motor_position": s.motor_encoder, "link_position": s.link_encoder}
    present = [name for name in encoders if name in columns]

    def as_read(name: str, noise: np.ndarray) -> np.ndarray:
        """Return the noise of a channel with repeated readings."""
        if name not in conditioned.news:
            return noise
        fresh = conditioned.news[name][part]
        return between(time, time[fresh], noise[fresh])

    noise = {name: as_read(name, _encoder_noise(time, columns[name], encoders[name], rng)) for name in present}
    if len(present) == 1:
        _complete(columns, noise, time - recording.time[0], p)
    kept = {name: columns[name] for name in encoders}
    for name, spec in (("motor_current", s.motor_current), ("joint_torque", s.joint_torque)):
        if name in columns:
            rms = float(np.hypot(spec.noise, spec.step / np.sqrt(12)))
            kept[name], noise[name] = columns[name], as_read(name, rms * rng.standard_normal(len(time)))
    arm, known = recording.load is not None, recording.torque_of_arm[part]
    if recording.external == "measured" or arm:
        kept["external_torque"] = known + columns.get("external_torque", 0.0)
    if arm:
        kept["arm_torque"] = known
    return kept, {name: noise.get(name, np.zeros(len(time))) for name in kept}


def _complete(columns: dict, noise: dict, since: np.ndarray, p: np.void) -> None:
    """Add the missing encoder's motion from the other one and the description, in place. It includes wind-up under the link's
    weight and inertia, and the kinematic error."""
    is_link = "link_position" in columns
    missing, known = ENCODERS if is_link else ENCODERS[::-1]
    rough = columns[known] if is_link else columns[known] / p["N"]
    motion = smooth(since, rough[:, None], float(np.median(np.diff(since))), 8.0)
    v, a = (np.interp(since, motion.time, x[:, 0]) for x in (motion.rate, motion.acceleration))
    columns[missing] = np.empty(len(since))
    _other_end(columns[known], is_link, v, a, since, p, columns[missing])
    noise[missing] = (p["N"] if is_link else 1 / p["N"]) * noise[known]


@kernel
def _other_end(known, is_link, v, a, since, p, out):
    """Compute rotor angles from link angles, or the reverse [rad], with springs in equilibrium under the link's load."""
    for i in range(len(known)):
        if is_link:
            link = dynamics.actual_link_position(known[i], p.N * known[i], p.N * v[i], since[i], p)
            motor, _, _ = dynamics.steady_motion(link, v[i], a[i], 0.0, since[i], p.reference_temperature, p)
            out[i] = laws.motor_reading(motor, p)
        else:
            rotor = dynamics.actual_motor_position(known[i], p)
            link = rotor / p.N
            for _ in range(3):
                motor, _, _ = dynamics.steady_motion(link, v[i], a[i], 0.0, since[i], p.reference_temperature, p)
                link += (rotor - motor) / p.N
            out[i] = laws.link_reading(link, p)


ENOUGH = 0.1
"""Least share of held-out residuals to judge a fit."""


def in_held_out_block(time: np.ndarray, index: int) -> np.ndarray:
    """Return whether times [s] since a recording's start, shape (n,), are held out; `index`: of the recording."""
    block = np.floor(time / SETTINGS.held_out_block).astype(int) + index
    return block % SETTINGS.held_out_every == SETTINGS.held_out_every - 1


def _usable(
    recording: Recording, index: int, at: np.ndarray, theta_m: np.ndarray, balances: np.ndarray, settle: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return which residuals count in a fit, and which are held out, shape (k, len(BALANCES)) each."""
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(theta_m)))])
    settled = (at > at[0] + settle) & (at < at[-1] - settle)
    begun = settled & (travel > SETTINGS.settle_travel)
    sensor = "joint_torque" in recording
    # Without a torque sensor, the torsion is less accurate than an arm's mass model.
    weighed = recording.external != "unmeasured" and (sensor or recording.load is None)
    usable = np.column_stack([begun, begun, (settled if sensor else begun) & weighed]) & balances
    held_out = in_held_out_block(at, index)[:, None]
    return usable & ~held_out, usable & held_out


def _sampled(conditioned: Conditioned, part: slice, at: np.ndarray) -> np.ndarray:
    """Return which residuals at times `at` [s] have a reading within half of their interval, shape (k, len(BALANCES)).

    In a log that is read as often, all have.
    """
    found = np.ones((len(at), len(BALANCES)), bool)
    for balance, name in ((CURRENT, "motor_current"), (TORQUE, "joint_torque")):
        if name in conditioned.channels and STEP * DECIMATION * conditioned.channels[name].rate < 1.0:
            time = conditioned.recording.time[part]
            time = time[conditioned.news[name][part]] if name in conditioned.news else time
            after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
            away = np.minimum(np.abs(time[after] - at), np.abs(time[after - 1] - at))
            found[:, balance] = away <= 0.5 * STEP * DECIMATION
    return found


def _at_rest(theta_m: np.ndarray, count: float) -> np.ndarray:
    """Return where the rotor hardly travels (`rest_travel`, `rest_counts`), and 24 ms around, shape (k,), bool."""
    least = max(SETTINGS.rest_travel, SETTINGS.rest_counts * count)
    travel = maximum_filter1d(theta_m, 11) - minimum_filter1d(theta_m, 11)
    return maximum_filter1d((travel < least).astype(np.int8), 7).astype(bool)


_SHIFT = 1 / 3
"""Zero of the other draw, in counts; a smaller one reproduces the same counts."""


def _encoder_noise(time: np.ndarray, reading: np.ndarray, encoder: EncoderSpec, rng: np.random.Generator) -> np.ndarray:
    """Draw an encoder's error again [rad]: noise, and counts with another zero; constant at rest."""
    motion = smooth(time, reading[:, None], float(np.median(np.diff(time))))
    angle = np.interp(time, motion.time, motion.value[:, 0]) + _SHIFT * encoder.resolution
    noisy = angle + encoder.noise * rng.standard_normal(len(time))
    return np.round(noisy / encoder.resolution) * encoder.resolution - angle
