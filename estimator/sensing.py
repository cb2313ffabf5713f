"""What a sample's readings mean, for compiled steps: the current that flowed, the temperature, motion without its noise."""

from __future__ import annotations

import math

import numpy as np

from ..models import dynamics
from ..models.kernels import kernel

LOWPASS = np.dtype([("value", np.float64), ("rate", np.float64), ("acceleration", np.float64)])
"""A signal behind a low-pass, and its first two derivatives in time."""


@kernel
def lowpass(m, u, interval, cutoff):
    """Move a record of `LOWPASS` on to a sample u: y'' = ω²(u − y) − √2·ω·y' (Butterworth), ω = `cutoff` [rad/s].

    Stepped semi-implicitly: stable at any `interval` [s]; where that is zero it starts at rest at u.
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
    """Motor current [A] at a sample, a record of `models.step.SAMPLE`: the command in force, or the reading less its known
    error where no command is known. Positions, motor velocity and load: on which a model discrepancy may depend."""
    if math.isnan(s.current_command):
        return dynamics.actual_motor_current(s.motor_current, motor_position, link_position, velocity, load, s.time, p)
    return s.current_command


@kernel
def temperature(s, p):
    """Temperature [°C] at a sample; the one that the friction is stated for where there is no sensor."""
    return p.reference_temperature if math.isnan(s.temperature) else s.temperature
