"""Replay of measured motion: what the sensors should have read while the joint moved as it did.

Both ends of the joint are driven by their *measured* motion, rotor and link; what is simulated is only what lies
between and is not measured: the wave generator, the friction's bristle and the flexspline's Dahl state. Hence

    joint torque    Tf − bl θl', as the torque sensor would read it,
    motor current   (Jm θm'' + bm θm' + Tw − rotor_torque)/Kt, as the current sensor would read it,
    link balance    Ts + link torques + τext − Jl θl'', zero when the link's description is right; where the torque is
                    measured, its reading stands for Ts and the rest as that sensor would read it.

Nothing drifts, since both ends are tied to the data, and a push of unknown size on the link does no harm: it enters the
link balance alone, which is then left out. The motion is reconstructed from the encoders' readings with
the parameters of the encoders (zero, delay, eccentricity) in the record. It has been smoothed, and so have current and
torque: what is linear does not mind, and of the orders of motor and gear the replay has what the smoother leaves of them
at that speed.
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import welch

from ..models import laws
from ..models.joint import EncoderSpec, Joint, Mounting
from ..models.parameters import PLACES
from .motion import passband, smooth
from .sampling import between, fresh, timing_error

STEP = 1e-3
"""Step of the replay [s]."""
DECIMATION = 8
"""Replay steps per residual: one residual every 8 ms, the mean over a Hann window of 16 ms."""
CHANNELS = ("motor_current", "joint_torque", "link")
"""Residual channels: current [A], transmission [N·m], link balance [N·m]."""
THREADS = 2

_RUNAWAY = 1e5
"""Speed of the wave generator [rad/s] that no joint reaches."""

_STIFFEST = 2.5
"""Torque of the wave generator's compliance beyond any that a joint carries, in torques of its motor at the limit."""

_ROTOR, _MESH, _FLEXSPLINE, _LINK, _JOINT_TORQUE, _LINK_POSITION, _CURRENT = (
    PLACES.index(name)
    for name in ("rotor", "mesh", "flexspline", "link", "joint_torque", "link_position", "motor_current")
)


@dataclass(frozen=True)
class Drive:
    """One stretch of a recording, smoothed, as the replay takes it; n replay steps, k residuals.

    Attributes:
      recording: index of its recording in the measurement.
      time: of each replay step since the recording's start [s], shape (n,).
      rotor: θm and its two derivatives [rad], shape (n, 3).
      link: link encoder's reading and its two derivatives [rad], shape (n, 3).
      torque: joint torque reading [N·m], shape (n,); empty without a sensor.
      external: known torque on the link [N·m], shape (n,).
      mounting: of the link.
      stiffness: sum of the described joint's K1 to K3 [N·m/rad].
      at: time of each residual [s], shape (k,).
      measured: decimated readings of current and joint torque (zero without sensor), shape (k, 2).
      measured_rate: their rates [1/s], shape (k, 2).
      state: decimated θm, θl, θm', θl' and θl'', shape (k, 5), for weights and regressors.
      load: what the joint gives the link [N·m]: the torque sensor's reading or, without one, what the link as it is
        described and a known push ask for; shape (k,).
      usable: which residuals count, shape (k, 3).
      held_out: residuals kept from every fit, to measure what was gained, shape (k, 3).
      at_rest: where the rotor moves so little that its encoder's counts do not average out, shape (k,).
      passband: of the smoother, as turns per radian of a shaft that makes one in 1/fc: 1/(2π fc) [s].
      block: residuals that count as one, where the motion is so slow that above some frequency it is noise alone.
    """

    recording: int
    time: np.ndarray
    rotor: np.ndarray
    link: np.ndarray
    torque: np.ndarray
    external: np.ndarray
    mounting: Mounting
    stiffness: float
    at: np.ndarray
    measured: np.ndarray
    measured_rate: np.ndarray
    state: np.ndarray
    load: np.ndarray
    usable: np.ndarray
    held_out: np.ndarray
    at_rest: np.ndarray
    passband: float
    block: int = 1


HELD_OUT_BLOCK, HELD_OUT_EVERY = 0.5, 6
"""Every sixth block of half a second is kept from the fit."""
_SETTLE_TIME = 0.06
"""Time [s] at both ends of a stretch in which the smoother and the transmission are still settling."""
_SETTLE_TRAVEL = 0.6
"""Travel of the rotor [rad] after which the unknown initial state of the friction is forgotten."""


_REST_TRAVEL = 0.06
"""Travel of the rotor [rad] below which neither counts nor presliding friction average out."""


def decimate(x: np.ndarray) -> np.ndarray:
    """Hann-weighted means around every `DECIMATION`-th sample, shape (k, …), as the replay takes them."""
    k = (len(x) - 1) // DECIMATION + 1
    out = np.zeros((k, *x.shape[1:]))
    total = np.zeros(k)
    for j in range(-DECIMATION + 1, DECIMATION):
        weight = _WINDOW[abs(j)]
        i = np.arange(k) * DECIMATION + j
        inside = (i >= 0) & (i < len(x))
        out[inside] += weight * x[i[inside]]
        total[inside] += weight
    return out / total.reshape(-1, *[1] * (x.ndim - 1))


def _at_rest(theta_m: np.ndarray) -> np.ndarray:
    """Where the rotor travels less than `_REST_TRAVEL` within ±40 ms, and 24 ms around that."""
    low = minimum_filter1d(theta_m, 11)
    high = maximum_filter1d(theta_m, 11)
    return maximum_filter1d((high - low < _REST_TRAVEL).astype(np.int8), 7).astype(bool)


_WINDOW = 0.5 * (1 + np.cos(np.pi * np.arange(DECIMATION) / DECIMATION))


def drives(recordings: list, joint: Joint, seed: int = 1) -> tuple[list[Drive], list[Drive]]:
    """Smooth every stretch of every recording (`sim.recording.Recording`) into what the replay takes.

    Returns the stretches, and their twins: the same with the sensors' noise added a second time, drawn anew. The
    difference between the two tells what the noise of the motion does to a residual, at any parameters.
    """
    rng = np.random.default_rng(seed)
    sensors = joint.sensors
    analog = (sensors.motor_current, sensors.joint_torque)
    rms = [0.0, 0.0, *(float(np.hypot(x.noise, x.step / np.sqrt(12))) for x in analog)]
    found, twins = [], []
    for index, recording in enumerate(recordings):
        p = joint.record(recording.link)[0]
        for stretch in recording.stretches:
            time = recording.time[stretch]
            if len(time) < 50 or time[-1] - time[0] < 0.5:
                continue
            columns = [recording.motor_position, recording.link_position, recording.motor_current]
            deviations = rms[:3]
            has_torque = recording.joint_torque is not None
            if has_torque:
                columns.append(recording.joint_torque)
                deviations.append(rms[3])
            known_push = recording.external == "measured"
            if known_push:
                columns.append(recording.external_torque)
            rates = [sensors.motor_encoder.rate, sensors.link_encoder.rate, *(x.rate for x in analog[: 1 + has_torque])]
            rates += [sensors.wrench.rate] * known_push
            slow = int(np.argmin(rates[:2]))
            news = fresh(time, columns[slow][stretch], rates[slow])
            time, columns = time[news], [x[stretch][news] for x in columns]
            noise = np.empty((len(time), len(deviations)))
            for i, encoder in enumerate((sensors.motor_encoder, sensors.link_encoder)):
                noise[:, i] = _encoder_noise(time, columns[i], encoder, rng)
            for i in range(2, len(columns)):
                at = fresh(time, columns[i], rates[i])
                columns[i] = between(time, time[at], columns[i][at])
                if i < len(deviations):
                    noise[:, i] = between(time, time[at], deviations[i] * rng.standard_normal(int(at.sum())))
            c = len(columns)
            s = smooth(time, np.column_stack([*columns, noise]), STEP)
            read = slice(2, 4) if has_torque else slice(2, 3)
            noise_read = slice(c + 2, c + len(deviations))
            motion, disturbance = (
                [np.column_stack([s.value[:, i], s.rate[:, i], s.acceleration[:, i]]) for i in (first, first + 1)]
                for first in (0, c)
            )
            pad = ((0, 0), (0, 0 if has_torque else 1))
            measured, measured_rate, noise_value, noise_rate = (
                np.pad(decimate(x), pad)
                for x in (s.value[:, read], s.rate[:, read], s.value[:, noise_read], s.rate[:, noise_read])
            )
            since = s.time - recording.time[0]
            n = len(since)
            external = np.ascontiguousarray(s.value[:, c - 1]) if known_push else np.zeros(n)
            at = decimate(since)
            state = decimate(np.column_stack([motion[0][:, 0], motion[1][:, 0], motion[0][:, 1], motion[1][:, 1],
                                              motion[1][:, 2]]))  # fmt: skip
            travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(state[:, 0])))])
            settled = (at > at[0] + _SETTLE_TIME) & (at < at[-1] - _SETTLE_TIME)
            begun = settled & (travel > _SETTLE_TRAVEL)
            held_out = (np.floor(at / HELD_OUT_BLOCK).astype(int) + index) % HELD_OUT_EVERY == HELD_OUT_EVERY - 1
            usable = np.column_stack([begun, begun & has_torque, settled & (recording.external != "unmeasured")])
            if not has_torque:
                usable[:, 2] &= begun
            scored = usable & held_out[:, None]
            usable &= ~held_out[:, None]
            found.append(
                Drive(
                    recording=index,
                    time=since,
                    rotor=np.ascontiguousarray(motion[0]),
                    link=np.ascontiguousarray(motion[1]),
                    torque=np.ascontiguousarray(s.value[:, 3]) if has_torque else np.empty(0),
                    external=external,
                    mounting=recording.link,
                    stiffness=float(p["K1"] + p["K2"] + p["K3"]),
                    at=at,
                    measured=measured,
                    measured_rate=measured_rate,
                    state=state,
                    load=measured[:, 1] if has_torque else _own_torque(p, state) - decimate(external),
                    usable=usable,
                    held_out=scored,
                    at_rest=_at_rest(state[:, 0]),
                    passband=1 / (2 * np.pi * passband(time)),
                )
            )
            # Wrong stamps are louder in the accelerations than all that the twin has of noise.
            mistimed = timing_error(time, columns[0], columns[1]) > 0.0
            found[-1] = replace(found[-1], block=_BLOCK if mistimed else _block(motion, disturbance))
            twins.append(
                replace(
                    found[-1],
                    rotor=motion[0] + disturbance[0],
                    link=motion[1] + disturbance[1],
                    torque=found[-1].torque + s.value[:, c + 3] if has_torque else found[-1].torque,
                    measured=measured + noise_value,
                    measured_rate=measured_rate + noise_rate,
                )
            )
    return found, twins


def _own_torque(p: np.void, state: np.ndarray) -> np.ndarray:
    """Torque [N·m] that gravity and inertia of the link ask for, shape (k,)."""
    return p["Mg"] * np.sin(state[:, 1] + p["gravity_angle"]) + p["Jl"] * state[:, 4]


_BLOCK = 8
"""Most residuals that count as one."""
_ABOVE_NOISE = 10.0
"""Power of the measured acceleration over its noise's, from which on it is motion."""


def _block(motion: list[np.ndarray], disturbance: list[np.ndarray]) -> int:
    """How many residuals count as one: as many as leave the frequencies in which the joint moves.

    The replay turns the noise of the acceleration into noise of its derivatives in the inertias and dampings. Where the
    joint does not move, they are nothing else: least squares would fit the noise with itself (errors in variables).
    """
    highest = 0.0
    rate = 1.0 / (STEP * DECIMATION)
    for signal, noise in zip(motion, disturbance, strict=True):
        x, y = decimate(signal[:, 2]), decimate(noise[:, 2])
        if len(x) < 64:
            return 1
        f, power = welch(np.column_stack([x, y]), rate, nperseg=min(256, len(x)), axis=0)
        power = uniform_filter1d(power, 5, axis=0, mode="nearest")
        above = f[power[:, 0] > _ABOVE_NOISE * power[:, 1]]
        highest = max(highest, float(above.max()) if len(above) else 0.0)
    return int(np.clip(0.5 * rate / max(highest, 1e-3), 1, _BLOCK))


_SHIFT = 1 / 3
"""Zero of the other draw, in counts: nearer to the reading's own, its smoothed angle falls on the same counts again."""


def _encoder_noise(time: np.ndarray, reading: np.ndarray, encoder: EncoderSpec, rng: np.random.Generator) -> np.ndarray:
    """Another draw of an encoder's error [rad]: noise, and the counts as they fall with another zero.

    At rest the error of the counts is a constant, and so it is here.
    """
    motion = smooth(time, reading[:, None], float(np.median(np.diff(time))))
    angle = np.interp(time, motion.time, motion.value[:, 0]) + _SHIFT * encoder.resolution
    noisy = angle + encoder.noise * rng.standard_normal(len(time))
    return np.round(noisy / encoder.resolution) * encoder.resolution - angle


@njit(cache=True, nogil=True)
def _transmission(p, time, rotor, link, passband, h, inner):
    """Move the wave generator, the bristle and the Dahl state; fills `inner`, shape (n, len(_INNER)). False: runaway."""
    n = len(time)
    terms = laws.has_terms(p)
    dahl_present = p.hysteresis_torque != 0.0
    shift = p.link_delay / h
    inverse_N = 1.0 / p.N
    reach = laws.wave_generator_torsion(_STIFFEST * p.Kt * p.current_limit, p)

    z = 0.0
    dahl = 0.0
    w = rotor[0, 1]
    theta_w = rotor[0, 0]
    l1, vl1 = 0.0, 0.0
    for i in range(n):
        # Link motion: the reading, earlier by its delay, without the encoder's zero and eccentricity.
        j = min(i + int(shift), n - 2)
        f = min(i + shift - j, 1.0)
        d = link[j + 1, 0] - link[j, 0]
        a0 = h * link[j, 1] - d
        a1 = d - h * link[j + 1, 1]
        reading = (1.0 - f) * link[j, 0] + f * link[j + 1, 0] + f * (1.0 - f) * ((1.0 - f) * a0 + f * a1)
        l0, vl0 = l1, vl1
        vl1 = (1.0 - f) * link[j, 1] + f * link[j + 1, 1]
        al1 = (1.0 - f) * link[j, 2] + f * link[j + 1, 2]
        rough = reading - p.link_zero
        l1 = reading - (laws.link_reading(rough, p) - rough)
        if terms:
            l1 -= laws.term(_LINK_POSITION, rotor[i, 0], rough, rotor[i, 1], 0.0, time[i], p)
        if i == 0:
            # Start in equilibrium, friction unstressed; what is wrong with that is forgotten after a little travel.
            low = rotor[0, 0] - 1.0 / (p.Cw * p.Kw0)
            high = rotor[0, 0] + 1.0 / (p.Cw * p.Kw0)
            for _ in range(40):
                theta_w = 0.5 * (low + high)
                torsion = theta_w * inverse_N - l1 - laws.kinematic_error(theta_w, p)
                spring = laws.wave_generator_spring(rotor[0, 0] - theta_w, p)
                if spring > laws.flexspline_spring(torsion, p) * inverse_N:
                    low = theta_w
                else:
                    high = theta_w
            l0, vl0 = l1, vl1
        else:
            # One linearly implicit midpoint step of the wave generator.
            m = 0.5 * (rotor[i - 1, 0] + rotor[i, 0]) + 0.125 * h * (rotor[i - 1, 1] - rotor[i, 1])
            vm = 0.5 * (rotor[i - 1, 1] + rotor[i, 1])
            l = 0.5 * (l0 + l1) + 0.125 * h * (vl0 - vl1)
            vl = 0.5 * (vl0 + vl1)
            x = theta_w + 0.5 * h * w
            error, error_slope = laws.smoothed_kinematic_error(x, abs(w) * passband, p)
            slope = inverse_N - error_slope
            torsion = x * inverse_N - l - error
            rate = w * slope - vl
            middle = dahl
            if dahl_present:
                middle = laws.dahl_step(dahl, rate, 0.5 * h, p)
            Tf = laws.flexspline_spring(torsion, p) + p.df * rate + laws.hysteresis_torque(middle, p)
            spring = laws.wave_generator_spring(m - x, p)
            load = Tf
            mesh_term = 0.0
            if terms:
                Tf += laws.term(_FLEXSPLINE, m, l, w, load, time[i], p)
                mesh_term = laws.term(_MESH, m, l, w, load, time[i], p)
            g = laws.friction_level(w, l, Tf, time[i], p)
            z_middle = laws.bristle_step(z, w, g, 0.5 * h, p)
            force = (
                spring + p.dw * (vm - w) - laws.mesh_friction(z_middle, w, g, p) - p.bw * w - mesh_term - Tf * slope
            ) / p.Jw
            sliding = p.s0 * z_middle / g * (1.0 if w > 0.0 else -1.0)
            stiffness = laws.wave_generator_stiffness(m - x, p) + p.K1 * slope * slope
            damping = p.dw + p.bw + p.df * slope * slope + p.s1 * max(1.0 - sliding, 0.0)
            stiffness += p.s0 * max(1.0 - sliding, 0.0)
            change = h * force / (1.0 + h * (0.25 * h * stiffness + 0.5 * damping) / p.Jw)
            w_middle = w + 0.5 * change
            theta_w += h * w_middle
            w += change
            if not abs(w) < _RUNAWAY:  # parameters beyond reason: give up on the stretch
                return False
            z = laws.bristle_step(z, w_middle, g, h, p)
            if abs(rotor[i, 0] - theta_w) > reach:  # where the compliance is all but rigid
                theta_w = rotor[i, 0] - (reach if rotor[i, 0] > theta_w else -reach)
                w = rotor[i, 1]
            if dahl_present:
                dahl = laws.dahl_step(dahl, w_middle * slope - vl, h, p)
        error, error_slope = laws.smoothed_kinematic_error(theta_w, abs(w) * passband, p)
        torsion = theta_w * inverse_N - l1 - error
        Tf = laws.flexspline_spring(torsion, p) + p.df * (w * (inverse_N - error_slope) - vl1)
        if dahl_present:
            Tf += laws.hysteresis_torque(dahl, p)
        inner[i, 5] = Tf
        if terms:
            Tf += laws.term(_FLEXSPLINE, rotor[i, 0], l1, w, Tf, time[i], p)
        inner[i, 0], inner[i, 1], inner[i, 2], inner[i, 3] = w, l1, vl1, al1
        inner[i, 4] = Tf
        inner[i, 6] = laws.wave_generator_spring(rotor[i, 0] - theta_w, p) + p.dw * (rotor[i, 1] - w)
    return True


_INNER = ("wave_generator_velocity", "link_position", "link_velocity", "link_acceleration", "flexspline_torque",
          "load", "wave_generator_torque")  # fmt: skip
"""What `_transmission` computes at every step: link as corrected, load without nonparametric terms."""

READ_OUT = (
    "Jm", "Kt", "bm", "R", "L", "supply_voltage", "current_limit", "bl", "Jl", "Mg", "gravity_angle",
    "cogging_order", "cogging_amplitude", "cogging_phase", "cable_stiffness", "cable_rest", "stop_angle",
    "stop_stiffness", "current_offset", "torque_gain", "torque_offset", "torque_rate",
)  # fmt: skip
"""Numbers that change what the sensors read, but nothing inside a transmission whose both ends move as measured."""


@njit(cache=True, nogil=True)
def _readings(p, time, rotor, torque, external, stiffness, inner, passband, every, window, out):
    """Means of current reading, torque reading and link balance; fills out, shape (k, 3)."""
    n = len(time)
    out[:] = 0.0
    weights = np.zeros(len(out))
    terms = laws.has_terms(p)
    has_torque = len(torque) > 0
    for i in range(n):
        w, l1, vl1, al1 = inner[i, 0], inner[i, 1], inner[i, 2], inner[i, 3]
        Tf, load, Tw = inner[i, 4], inner[i, 5], inner[i, 6]
        on_rotor = laws.rotor_torque(rotor[i, 0], p, abs(rotor[i, 1]) * passband)
        on_link = laws.link_torque(l1, p) + external[i] + laws.gravity_torque(l1, p)
        if terms:
            on_rotor += laws.term(_ROTOR, rotor[i, 0], l1, w, load, time[i], p)
            on_link += laws.term(_LINK, rotor[i, 0], l1, w, load, time[i], p)
        current = laws.current_reading((p.Jm * rotor[i, 2] + p.bm * rotor[i, 1] + Tw - on_rotor) / p.Kt, p)
        Ts = Tf - p.bl * vl1
        sensed = laws.torque_reading(Ts, time[i], p)
        offset = laws.torque_reading(0.0, time[i], p)
        if terms:
            current += laws.term(_CURRENT, rotor[i, 0], l1, w, load, time[i], p)
            more = laws.term(_JOINT_TORQUE, rotor[i, 0], l1, w, load, time[i], p)
            sensed += more
            offset += more
        # The link's balance as the torque sensor reads it: in these units its noise is the same at all parameters.
        balance = on_link - p.Jl * al1
        # Without one the noise is the torsion's, which the stiffness scales: at the described stiffness it stays the same.
        if has_torque:
            balance = torque[i] - offset + p.torque_gain * balance
        else:
            balance = (Ts + balance) * stiffness / (p.K1 + p.K2 + p.K3)
        k = i // every
        r = i - k * every
        u = window[r]
        out[k, 0] += u * current
        out[k, 1] += u * sensed
        out[k, 2] += u * balance
        weights[k] += u
        if r > 0 and k + 1 < len(out):
            u = window[every - r]
            out[k + 1, 0] += u * current
            out[k + 1, 1] += u * sensed
            out[k + 1, 2] += u * balance
            weights[k + 1] += u
    for k in range(len(out)):
        for c in range(3):
            out[k, c] /= weights[k]


def transmission(drive: Drive, record: np.ndarray) -> np.ndarray:
    """What moves between rotor and link, shape (n, len(_INNER)); not a number where the record is beyond reason."""
    inner = np.empty((len(drive.time), len(_INNER)))
    if not _transmission(record[0], drive.time, drive.rotor, drive.link, drive.passband, STEP, inner):
        inner[:] = np.nan
    return inner


def replay(drive: Drive, record: np.ndarray, inner: np.ndarray | None = None) -> np.ndarray:
    """Predicted current reading [A], joint torque reading [N·m] and link balance [N·m], shape (k, 3).

    Args:
      inner: of `transmission` for a record that differs in `READ_OUT` at most.
    """
    inner = transmission(drive, record) if inner is None else inner
    out = np.empty((len(drive.at), 3))
    _readings(
        record[0],
        drive.time,
        drive.rotor,
        drive.torque,
        drive.external,
        drive.stiffness,
        inner,
        drive.passband,
        DECIMATION,
        _WINDOW,
        out,
    )
    return out


def residual(drive: Drive, record: np.ndarray, inner: np.ndarray | None = None) -> np.ndarray:
    """Measured minus predicted current [A] and torque [N·m], and the link balance [N·m], shape (k, 3)."""
    out = replay(drive, record, inner)
    out[:, :2] = drive.measured - out[:, :2]
    return out


def residuals(pairs: list[tuple[Drive, np.ndarray]]) -> list[np.ndarray]:
    """`residual` of many pairs in parallel; where records differ in `READ_OUT` only, what moves inside is shared."""
    keys = [(id(drive), _inside(record)) for drive, record in pairs]
    times = Counter(keys)
    shared = {key: pair for key, pair in zip(keys, pairs, strict=True) if times[key] > 1}
    inner = dict(zip(shared, parallel(lambda pair: transmission(*pair), list(shared.values())), strict=True))
    tasks = [(*pair, inner.get(key)) for key, pair in zip(keys, pairs, strict=True)]
    return parallel(lambda task: residual(*task), tasks)


def _inside(record: np.ndarray) -> bytes:
    """All of a record that what moves inside the transmission depends on."""
    copy = record.copy()
    for name in READ_OUT:
        copy[name] = 0.0
    return copy.tobytes()


_pool = ThreadPoolExecutor(THREADS)


def parallel(function, tasks: list) -> list:
    """Apply `function` to the tasks on `THREADS` threads; the compiled replay holds no lock."""
    return list(_pool.map(function, tasks))
