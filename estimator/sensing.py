"""Meaning of a sample's readings, for compiled steps: the actual current, the temperature, smooth motion."""

from __future__ import annotations

import math

import numpy as np

from ..models import dynamics
from ..models.dynamics import UNREAD, State
from ..models.kernels import kernel
from ..models.parameters import floats

LOWPASS = floats("value", "rate", "acceleration")
"""A low-passed signal, and its first two derivatives in time."""


@kernel
def lowpass(m, u, interval, cutoff):
    """Update a record of `LOWPASS` with a sample u: y'' = ω²(u − y) − √2·ω·y' (Butterworth), ω = `cutoff` [rad/s].

    Semi-implicit: stable at any `interval` [s]; at interval zero it starts at rest at u.
    """
    if interval == 0.0:
        m.value, m.rate, m.acceleration = u, 0.0, 0.0
        return
    damping = 1.0 + math.sqrt(2.0) * cutoff * interval + (cutoff * interval) ** 2
    before = m.rate
    m.rate = (before + cutoff**2 * interval * (u - m.value)) / damping
    m.value += interval * m.rate
    m.acceleration = (m.rate - before) / interval


@kernel
def motor_current(s, motor_position, link_position, velocity, load, p):
    """Return the motor current [A] at a sample, a record of `models.step.SAMPLE`: the command in force, or without
    one the reading less its known error. A model discrepancy may depend on positions, motor velocity and load."""
    if math.isnan(s.current_command):
        return dynamics.actual_motor_current(s.motor_current, motor_position, link_position, velocity, load, s.time, p)
    return s.current_command


@kernel
def temperature(s, p):
    """Return the temperature [°C] at a sample; without a sensor that of the stated friction."""
    return p.reference_temperature if math.isnan(s.temperature) else s.temperature


@kernel
def arm_torque(s):
    """Return the torque of an arm's other joints on the link [N·m] at a sample; 0 if unknown."""
    return 0.0 if math.isnan(s.arm_torque) else s.arm_torque


VELOCITY = 2.0 * math.pi * 40.0  # bandwidth [rad/s] of the rotor's velocity on which a model discrepancy may depend


@kernel
def read_joint_torque(torque, motor_position, link_position, time, record, out):
    """Write the joint torque sensor's readings [N·m] before noise, shape (n,), into `out`, by positions as read [rad]
    and the time since the recording began [s]."""
    p, m = record[0], np.zeros(1, LOWPASS)[0]
    for i in range(len(torque)):
        motor = dynamics.actual_motor_position(motor_position[i], p)
        lowpass(m, motor, time[i] - time[i - 1] if i > 0 else 0.0, VELOCITY)
        w = m.rate
        link = dynamics.actual_link_position(link_position[i], motor, w, time[i], p)
        state = State(motor, w, motor, w, link, w / p.N, UNREAD, UNREAD, UNREAD, time[i], UNREAD)
        out[i] = dynamics.read_joint_torque(torque[i], state, torque[i], p)


RING = 512  # longest delay of the link encoder, in samples. Beyond it the oldest sample is used.
_FEWEST = 5


@kernel
def place_in_ring(times, newest, then):
    """Return the position of an instant in a ring of times, shape (RING,): sample before it, sample after it, and share
    of the way between; `newest`: number of the last sample, from 0; its index is that number modulo RING."""
    k, oldest = newest, max(newest - RING + 1, 0)
    while k > oldest and times[k % RING] > then:
        k -= 1
    a, b = k % RING, min(k + 1, newest) % RING
    span = times[b] - times[a]
    return a, b, min(max((then - times[a]) / span, 0.0), 1.0) if span > 0.0 else 0.0


@kernel
def line_in_ring(times, values, newest, window, at):
    """Return the line through the last samples of a ring (least squares) at an instant `at` [s]; the last value while
    there are few. `newest`: as of `place_in_ring`; `window`: of the fit [s], five samples at least."""
    oldest, last = max(newest - RING + 1, 0), times[newest % RING]
    count, mean_t, mean_x, k = 0, 0.0, 0.0, newest
    while k >= oldest and (last - times[k % RING] <= window or count < _FEWEST):
        count += 1
        mean_t += times[k % RING]
        mean_x += values[k % RING]
        k -= 1
    if count < _FEWEST:
        return values[newest % RING]
    mean_t, mean_x = mean_t / count, mean_x / count
    top, bottom = 0.0, 0.0
    for j in range(k + 1, newest + 1):
        t = times[j % RING] - mean_t
        top += t * (values[j % RING] - mean_x)
        bottom += t * t
    return mean_x + top / bottom * (at - mean_t)
