"""Prepare recordings for the replay: segments of smoothed motion on an even grid, with the readings to explain.

Every channel of a segment goes through the same linear smoother (`models.motion`): for a linear joint, computed and measured
torques then have no relative smoothing error. Each segment has a *noise replicate*: the same motion and readings with the
sensors' stated noise drawn and added again. Their difference gives the effect of the motion's noise on a residual.

With one encoder, the rotor's motion follows from that encoder and the description; the replay simulates the link
(`Segment.link_measured`).

The link encoder alone also sees the gear's kinematic error and the link's resonance. The rotor then follows the link below the
frequency of that resonance, and moves evenly above. The gear's orders are in the simulation alone, and readings need less
smoothing than motion. A torque sensor is compared with the link's measured motion.
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
from ...models.motion import CUTOFF, SHARE, Smooth, passband, smooth
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
    """Settings of segments.

    Attributes:
      held_out_block, held_out_every: length [s] of held-out blocks, every n-th of which is held out.
      settle_time: at both ends of a segment, where smoother and transmission settle [s].
      settle_travel: of the rotor, after which the unknown initial state of the friction is forgotten [rad].
      rest_travel: of the rotor within ±40 ms, below which presliding friction does not average out [rad]; rest_counts: encoder
        counts, below which these do not.
      shortest: least samples and seconds of a segment.
      block: most residuals that count as one, for slow motion with noise above.
      above_noise: least power ratio of measured acceleration to its noise that counts as motion.
      shaken: noise of the rotor's acceleration, as a current, over the current's noise above which more residuals count as one.
      following: passband of the rotor's motion from the link encoder, over the described resonance of the link against a fixed
        rotor; slowest: its least value [Hz].
      readings: passband over sample rate of readings with such a motion; they are not differentiated.
    """

    held_out_block: float = 0.5
    held_out_every: int = 6
    settle_time: float = 0.06
    settle_travel: float = 0.6
    rest_travel: float = 0.06
    rest_counts: float = 2.0
    shortest: tuple[int, float] = (50, 0.5)
    block: int = 8
    above_noise: float = 10.0
    shaken: float = 0.9
    following: float = 0.5
    slowest: float = 1.0
    readings: float = 0.8


SETTINGS = SegmentSettings()


@dataclass(frozen=True)
class Segment:
    """A part of a recording without gaps, smoothed; n replay steps, k residuals.

    Attributes:
      recording: index of its recording in the measurement.
      name: of that recording.
      time: of each replay step since the recording's start [s], shape (n,).
      rotor: motor encoder's reading and its two derivatives [rad], shape (n, 3).
      link: link encoder's reading and its two derivatives [rad], shape (n, 3); where it is not measured, as described.
      rotor_measured: whether there is a motor encoder; otherwise the rotor's angle follows from the link's.
      link_measured: whether the motion of both ends was measured; else the link's is simulated.
      weighed: whether the link balance uses measured motion: with both encoders, or with a link encoder and a torque sensor.
      torque: joint torque reading [N·m], shape (n,); empty without a sensor.
      external: known torque on the link [N·m], shape (n,); arm: the part of it that other links of an arm make.
      temperature: [°C], shape (n,).
      mounting: of the link.
      stiffness: sum of the described joint's K1 to K3 [N·m/rad].
      at: time of each residual [s], shape (k,).
      measured: decimated readings of current and joint torque (zero where there is none), shape (k, 2).
      measured_rate, measured_bend: their first [1/s] and second [1/s²] derivatives in time, shape (k, 2).
      state: decimated θm, θl, θm', θl' and θl'', shape (k, 5), for weights and regressors.
      load: joint torque on the link [N·m], shape (k,): measured, or from the described link and known pushes.
      balances: which balances can be formed, shape (len(BALANCES),), bool.
      usable: which residuals count, shape (k, len(BALANCES)).
      held_out: residuals kept from every fit, same shape.
      at_rest: where the rotor moves so little that its encoder's counts do not average out, shape (k,).
      passband: of the smoother, as turns per radian of a shaft that makes one in 1/fc: 1/(2π fc) [s].
      block: residuals that count as one (`SegmentSettings.block`).
    """

    recording: int
    name: str
    time: np.ndarray
    rotor: np.ndarray
    link: np.ndarray
    rotor_measured: bool
    link_measured: bool
    weighed: bool
    torque: np.ndarray
    external: np.ndarray
    arm: np.ndarray
    temperature: np.ndarray
    mounting: Mounting
    stiffness: float
    at: np.ndarray
    measured: np.ndarray
    measured_rate: np.ndarray
    measured_bend: np.ndarray
    state: np.ndarray
    load: np.ndarray
    balances: np.ndarray
    usable: np.ndarray
    held_out: np.ndarray
    at_rest: np.ndarray
    passband: float
    block: int = 1

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


def segments(
    recordings: Sequence[Recording | Conditioned], joint: Joint, seed: int = 1, settings: SegmentSettings = SETTINGS
) -> tuple[list[Segment], list[Segment]]:
    """Smooth every segment of every recording, conditioned or not; return segments and noise replicates.

    Recordings with unmeasured pushes (`pushed`) do not count if there are others.
    """
    rng = np.random.default_rng(seed)
    found, replicates = [], []
    prepared = [r if isinstance(r, Conditioned) else condition(r, joint) for r in recordings]
    counted = undisturbed([c.recording for c in prepared])
    for index, conditioned in enumerate(prepared):
        recording = conditioned.recording
        for part in recording.segments:
            time = recording.time[part]
            if len(time) < settings.shortest[0] or time[-1] - time[0] < settings.shortest[1]:
                continue
            one, replicate = _segment(conditioned, index, part, joint, rng, settings)
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
    conditioned: Conditioned, index: int, part: slice, joint: Joint, rng, settings: SegmentSettings
) -> tuple[Segment, Segment]:
    recording = conditioned.recording
    p = joint.record(recording.link)[0]
    channels, noise = _channels(conditioned, part, joint, p, rng)
    names = list(channels)
    values = np.column_stack([*channels.values(), *(noise[name] for name in names)])
    link_measured = "link_position" in recording and "motor_position" in recording
    # Pushes that nobody measured may be anything.
    alone = "joint_torque" in recording and recording.external != "unmeasured"
    weighed = "link_position" in recording and (link_measured or alone)
    s, whole, settle = _smoothed(conditioned, recording.time[part], values, names, weighed, p, settings)
    place = {name: i for i, name in enumerate(names)}

    def of(name: str, what: np.ndarray, noisy: bool = False) -> np.ndarray:
        return what[:, place[name] + (len(names) if noisy else 0)]

    def motion(name: str, noisy: bool) -> np.ndarray:
        return np.column_stack([of(name, what, noisy) for what in (s.value, s.rate, s.acceleration)])

    n = len(s.time)
    rotor, rotor_noise = motion("motor_position", False), motion("motor_position", True)
    link, link_noise = motion("link_position", False), motion("link_position", True)
    has = {b: b in names for b in ("motor_current", "joint_torque")}
    zero = np.zeros(n)
    (read, read_noise), (read_rate, noise_rate), (read_bend, noise_bend) = (
        [
            np.column_stack([of(b, what, noisy) if has[b] else zero for b in ("motor_current", "joint_torque")])
            for noisy in (False, True)
        ]
        for what in (s.value, s.rate, s.acceleration)
    )
    since = s.time - recording.time[0]
    external = np.ascontiguousarray(of("external_torque", s.value)) if "external_torque" in place else zero
    arm = np.ascontiguousarray(of("arm_torque", s.value)) if "arm_torque" in place else zero
    temperature = np.full(n, p["reference_temperature"])
    if "temperature" in recording:
        temperature = np.interp(s.time, recording.time[part], recording["temperature"][part])
    at = decimate(since)
    state = decimate(np.column_stack([rotor[:, 0], link[:, 0], rotor[:, 1], link[:, 1], link[:, 2]]))
    measured = decimate(read)
    at_rest = _at_rest(state[:, 0], max(settings.rest_travel, settings.rest_counts * _rotor_count(recording, joint, p)))
    # With one encoder the sensor is compared with the link's motion, measured or simulated.
    transmitted = has["joint_torque"] and (link_measured or not weighed)
    balances = np.array([has["motor_current"], transmitted, weighed])
    usable, held_out = _usable(recording, index, at, state[:, 0], balances, has["joint_torque"], settle, settings)
    load = measured[:, TORQUE] if has["joint_torque"] else _own_torque(p, state) - decimate(external)
    one = Segment(
        recording=index, name=recording.name, time=since, rotor=np.ascontiguousarray(rotor),
        link=np.ascontiguousarray(link), rotor_measured="motor_position" in recording, link_measured=link_measured,
        weighed=weighed,
        torque=np.ascontiguousarray(read[:, TORQUE]) if has["joint_torque"] else np.empty(0),
        external=external, arm=arm, temperature=temperature, mounting=recording.link,
        stiffness=float(p["K1"] + p["K2"] + p["K3"]), at=at, measured=measured, measured_rate=decimate(read_rate),
        measured_bend=decimate(read_bend), state=state, load=load, balances=balances, usable=usable, held_out=held_out,
        at_rest=at_rest, passband=1 / (2 * np.pi * whole),
    )  # fmt: skip
    block = _residuals_at_once(one, conditioned, rotor_noise, link_noise, read_noise[:, CURRENT], p, settings)
    one = replace(one, block=block)
    replicate = replace(
        one,
        rotor=rotor + rotor_noise,
        link=link + link_noise,
        torque=one.torque + read_noise[:, TORQUE] if has["joint_torque"] else one.torque,
        measured=measured + decimate(read_noise),
        measured_rate=one.measured_rate + decimate(noise_rate),
        measured_bend=one.measured_bend + decimate(noise_bend),
    )
    return one, replicate


def _smoothed(
    conditioned: Conditioned,
    time: np.ndarray,
    values: np.ndarray,
    names: Sequence[str],
    weighed: bool,
    p: np.void,
    settings: SegmentSettings,
) -> tuple[Smooth, float, float]:
    """Smooth channels and their noise, shape (n, 2 len(names)); also return the passband of the readings [Hz] and the time in
    which the smoother settles [s]."""
    cutoff = conditioned.passband
    if "motor_position" in conditioned.recording:
        return smooth(time, values, STEP, cutoff), passband(time, cutoff), settings.settle_time
    readings = min([CUTOFF, *(SHARE * conditioned.channels[name].rate for name in conditioned.news)])
    following = _following(p, conditioned, settings)
    s = _joined(
        [name in ENCODERS for name in (*names, *names)],
        smooth(time, values, STEP, following),
        smooth(time, values, STEP, readings, share=settings.readings),
    )
    if weighed:  # what is held against each other goes through one smoother
        s = _joined([name in _WEIGHING for name in (*names, *names)], smooth(time, values, STEP, cutoff), s)
    return s, passband(time, readings, settings.readings), max(settings.settle_time, 1 / passband(time, following))


def _following(p: np.void, conditioned: Conditioned, settings: SegmentSettings) -> float:
    """Passband of the rotor's motion from the link encoder [Hz]."""
    resonance = float(np.sqrt(p["K1"] / p["Jl"])) / (2 * np.pi)
    return min(max(settings.following * resonance, settings.slowest), conditioned.passband)


def _residuals_at_once(
    one: Segment,
    conditioned: Conditioned,
    rotor_noise: np.ndarray,
    link_noise: np.ndarray,
    current_noise: np.ndarray,
    p: np.void,
    settings: SegmentSettings,
) -> int:
    """Return how many residuals count as one (`SegmentSettings.block`): above its passband a motion has no information."""
    current = one.balances[CURRENT] and not one.rotor_measured
    # An octave above the passband 1.5 % of a motion pass the smoother.
    shown = 2 * _following(p, conditioned, settings) if current else conditioned.passband
    block = int(np.clip(0.5 / (STEP * DECIMATION * shown), 1, settings.block))
    if not one.link_measured:
        return block
    if conditioned.stamps.error:
        return settings.block  # replicates do not have errors of time
    block = max(block, _block((one.rotor, one.link), (rotor_noise, link_noise), settings))
    # The drive reacts to encoder counts, which replicates do not have. This biases a fit towards a light rotor and a strong
    # motor. The noise decreases with frequency to the power 5/2.
    shakes, current = (float(np.std(decimate(x))) for x in (rotor_noise[:, 2], current_noise))
    shakes *= float(p["Jm"] / p["Kt"])
    # Without a current, or without its noise, there is no limit.
    while block < settings.block and current and shakes / block**2.5 > settings.shaken * current:
        block += 1
    return block


def _joined(first: Sequence[bool], one: Smooth, other: Smooth) -> Smooth:
    """Combine two smoothings on the same grid: channels in `first`, shape (c,), from the first one."""
    return Smooth(
        one.time,
        np.where(first, one.value, other.value),
        np.where(first, one.rate, other.rate),
        np.where(first, one.acceleration, other.acceleration),
    )


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
    if recording.external == "measured" or recording.load is not None:
        kept["external_torque"] = recording.torque_of_arm[part] + columns.get("external_torque", 0.0)
        noise["external_torque"] = np.zeros(len(time))
    if recording.load is not None:
        kept["arm_torque"] = recording.torque_of_arm[part]
        noise["arm_torque"] = np.zeros(len(time))
    return kept, noise


def _complete(columns: dict, noise: dict, since: np.ndarray, p: np.void) -> None:
    """Add the missing encoder's motion from the other one and the description, in place.

    It includes wind-up under the link's weight and inertia, and the kinematic error.
    """
    known = "motor_position" if "motor_position" in columns else "link_position"
    missing = "link_position" if known == "motor_position" else "motor_position"
    ratio = p["N"] if known == "link_position" else 1 / p["N"]
    rough = columns["link_position"] if known == "link_position" else columns["motor_position"] / p["N"]
    motion = smooth(since, rough[:, None], float(np.median(np.diff(since))), 8.0)
    v, a = (np.interp(since, motion.time, x[:, 0]) for x in (motion.rate, motion.acceleration))
    other = np.empty(len(since))
    _other_end(columns[known], known == "link_position", v, a, since, p, other)
    columns[missing] = other
    noise[missing] = ratio * noise[known]


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


def in_held_out_block(time: np.ndarray, index: int, settings: SegmentSettings = SETTINGS) -> np.ndarray:
    """Return whether times [s] since a recording's start, shape (n,), are held out; `index`: of the recording."""
    block = np.floor(time / settings.held_out_block).astype(int) + index
    return block % settings.held_out_every == settings.held_out_every - 1


def _usable(recording, index: int, at, theta_m, balances, has_torque: bool, settle: float, settings: SegmentSettings):
    """Which residuals count in a fit, and which are held out, shape (k, len(BALANCES)) each."""
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(theta_m)))])
    settled = (at > at[0] + settle) & (at < at[-1] - settle)
    begun = settled & (travel > settings.settle_travel)
    held_out = in_held_out_block(at, index, settings)
    usable = np.empty((len(at), len(BALANCES)), bool)
    usable[:, CURRENT] = begun
    usable[:, TORQUE] = begun
    # Without a torque sensor, the torsion is less accurate than an arm's mass model.
    weighed = recording.external != "unmeasured" and (has_torque or recording.load is None)
    usable[:, LINK] = (settled if has_torque else begun) & weighed
    usable &= balances
    return usable & ~held_out[:, None], usable & held_out[:, None]


def _own_torque(p: np.void, state: np.ndarray) -> np.ndarray:
    """Return the torque [N·m] of the link's gravity and inertia, shape (k,)."""
    return p["Mg"] * np.sin(state[:, 1] + p["gravity_angle"]) + p["Jl"] * state[:, 4]


def _rotor_count(recording: Recording, joint: Joint, p: np.void) -> float:
    """Return a count of the encoder that shows the rotor's motion [rad of the rotor]."""
    s = joint.sensors
    return s.motor_encoder.resolution if "motor_position" in recording else p["N"] * s.link_encoder.resolution


def _at_rest(theta_m: np.ndarray, travel: float) -> np.ndarray:
    """Return where the rotor travels less than `travel` within ±40 ms, and 24 ms around, shape (k,), bool."""
    low = minimum_filter1d(theta_m, 11)
    high = maximum_filter1d(theta_m, 11)
    return maximum_filter1d((high - low < travel).astype(np.int8), 7).astype(bool)


def _block(motions, noises, settings: SegmentSettings) -> int:
    """Return how many residuals count as one, which keeps the frequencies of the motion.

    Above them, acceleration is noise alone, and least squares would be biased (errors in variables).
    """
    from scipy.signal import welch

    highest, rate = 0.0, 1.0 / (STEP * DECIMATION)
    for motion, noise in zip(motions, noises, strict=True):
        x, y = decimate(motion[:, 2]), decimate(noise[:, 2])
        if len(x) < 64:
            return 1
        f, power = welch(np.column_stack([x, y]), rate, nperseg=min(256, len(x)), axis=0)
        power = uniform_filter1d(power, 5, axis=0, mode="nearest")
        above = f[power[:, 0] > settings.above_noise * power[:, 1]]
        highest = max(highest, float(above.max()) if len(above) else 0.0)
    return int(np.clip(0.5 * rate / max(highest, 1e-3), 1, settings.block))


_SHIFT = 1 / 3
"""Zero of the other draw, in counts; a smaller one reproduces the same counts."""


def _encoder_noise(time: np.ndarray, reading: np.ndarray, encoder: EncoderSpec, rng: np.random.Generator) -> np.ndarray:
    """Draw an encoder's error again [rad]: noise, and counts with another zero; constant at rest."""
    motion = smooth(time, reading[:, None], float(np.median(np.diff(time))))
    angle = np.interp(time, motion.time, motion.value[:, 0]) + _SHIFT * encoder.resolution
    noisy = angle + encoder.noise * rng.standard_normal(len(time))
    return np.round(noisy / encoder.resolution) * encoder.resolution - angle
