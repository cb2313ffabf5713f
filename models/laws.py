"""The laws of the joint's elements. `models.dynamics` combines them to equations of motion.

Each law is a compiled scalar function of a state and a parameter record `p` (`models.parameters`), SI units. Angles:
`theta_m` rotor and `theta_w` wave generator, motor side; `theta_l` link, output side. `w` is the wave generator's
velocity. Equation numbers are those of Shi & Liu; other laws are stated in their functions.
"""

from __future__ import annotations

import math

from .dual import decayed, sincos
from .kernels import kernel
from .parameters import N_DISCREPANCIES, N_ORDERS

_SMALLEST_FRICTION = 1e-5  # N·m: effects never make g(w) smaller
# From here the logarithm of Eqs. (3)-(5) continues as its tangent: 0.29 N·m on the motor side of the test joint, more than
# its motor's torque, where the law is too stiff for any practical step.
LOGARITHM_END = 3e-3
_FORGOTTEN = 40.0  # exp(−40) is negligible
_BENDING = 20.0  # Stribeck velocities at which viscous friction changes to a power of speed


@kernel(forceinline=True)
def flexspline_spring(torsion, p):
    """Return the torque k(Δθf) of the flexspline [N·m], Eq. (7) as an odd function, behind a dead zone of width
    `backlash`."""
    x = abs(torsion) - 0.5 * p.backlash
    if x <= 0.0:
        return 0.0
    break1 = p.T1 / p.K1
    break2 = break1 + (p.T2 - p.T1) / p.K2
    if p.knee_width > 0.0:
        width = min(p.knee_width, break1)  # the law stays zero at rest
        torque = p.K1 * x + (p.K2 - p.K1) * _ramp(x - break1, width) + (p.K3 - p.K2) * _ramp(x - break2, width)
    elif x <= break1:
        torque = p.K1 * x
    elif x < break2:
        torque = p.T1 + p.K2 * (x - break1)
    else:
        torque = p.T2 + p.K3 * (x - break2)
    return torque if torsion > 0.0 else -torque


@kernel
def _ramp(u, width):
    """Return max(0, u), rounded by a parabola between ±width."""
    if u <= -width:
        return 0.0
    return u if u >= width else (u + width) ** 2 / (4.0 * width)


@kernel
def flexspline_stiffness(torsion, p):
    """Return the slope of `flexspline_spring` [N·m/rad]: K1, K2 or K3, zero inside the dead zone; linear from one to
    the next over `knee_width` on either side of a breakpoint."""
    x = abs(torsion) - 0.5 * p.backlash
    if x < 0.0:
        return 0.0
    break1 = p.T1 / p.K1
    break2 = break1 + (p.T2 - p.T1) / p.K2
    if p.knee_width <= 0.0:
        return p.K1 if x <= break1 else (p.K2 if x < break2 else p.K3)
    width = min(p.knee_width, break1)
    slope = p.K1 + (p.K2 - p.K1) * min(max(0.5 + 0.5 * (x - break1) / width, 0.0), 1.0)
    return slope + (p.K3 - p.K2) * min(max(0.5 + 0.5 * (x - break2) / width, 0.0), 1.0)


@kernel
def flexspline_torsion(torque, p):
    """Return the torsion Δθf [rad] at a torque [N·m], Eq. (2) as an odd function; the middle of the dead zone at zero
    torque."""
    T = abs(torque)
    if T <= p.T1:
        x = T / p.K1
    elif T < p.T2:
        x = p.T1 / p.K1 + (T - p.T1) / p.K2
    else:
        x = p.T1 / p.K1 + (p.T2 - p.T1) / p.K2 + (T - p.T2) / p.K3
    half = 0.5 * p.backlash
    if p.knee_width > 0.0:  # Newton's steps, on a law that is a parabola at most
        for _ in range(6):
            x -= (flexspline_spring(x + half, p) - T) / flexspline_stiffness(x + half, p)
    if T > 0.0:
        x += half
    return x if torque >= 0.0 else -x


@kernel
def wave_generator_spring(torsion, p):
    """Return the torque of the wave generator's compliance [N·m, motor side] at δ = θm − θw [rad]: Eqs. (3)-(5)
    inverted."""
    u = 1.0 - p.Cw * p.Kw0 * abs(torsion)
    if u > LOGARITHM_END:
        torque = -math.log(u) / p.Cw
    else:
        torque = (-math.log(LOGARITHM_END) + (LOGARITHM_END - u) / LOGARITHM_END) / p.Cw
    return torque if torsion > 0.0 else -torque


@kernel
def wave_generator_stiffness(torsion, p):
    """Return the slope of `wave_generator_spring` [N·m/rad, motor side]: Kw0 exp(Cw |Tw|), Eq. (4)."""
    return p.Kw0 / max(1.0 - p.Cw * p.Kw0 * abs(torsion), LOGARITHM_END)


@kernel
def wave_generator_torsion(torque, p):
    """Return the torsion δ of the wave generator [rad, motor side] at a torque [N·m, motor side], Eq. (5): the
    spring's inverse."""
    exponent = p.Cw * abs(torque)
    u = math.exp(-exponent)
    if u < LOGARITHM_END:
        u = LOGARITHM_END * (1.0 - exponent - math.log(LOGARITHM_END))
    x = (1.0 - u) / (p.Cw * p.Kw0)
    return x if torque >= 0.0 else -x


@kernel
def kinematic_error(theta_w, p):
    """Return the kinematic error θerr [rad, output side] at the wave generator's angle: Σ A_k sin(k θw + φ_k)."""
    error = 0.0
    for k in range(N_ORDERS):
        if p.amplitude[k] != 0.0:
            error += p.amplitude[k] * math.sin(p.order[k] * theta_w + p.phase[k])
    return error


@kernel
def kinematic_error_slope(theta_w, p):
    """Return the derivative dθerr/dθw [1] of the kinematic error."""
    slope = 0.0
    for k in range(N_ORDERS):
        if p.amplitude[k] != 0.0:
            slope += p.order[k] * p.amplitude[k] * math.cos(p.order[k] * theta_w + p.phase[k])
    return slope


@kernel
def magnitude_response(order, speed):
    """Return the magnitude response 1/(1 + (f/fc)⁶) of a smoother to an order of a shaft with a speed in turns per
    1/fc."""
    x = order * speed
    cube = x * x * x
    return 1.0 / (1.0 + cube * cube)


@kernel(forceinline=True)
def smoothed_kinematic_error(theta_w, speed, p):
    """Return the kinematic error [rad] and its derivative [1] after a smoother (`magnitude_response`)."""
    error, slope = 0.0, 0.0
    for k in range(N_ORDERS):
        if p.amplitude[k] != 0.0:
            angle = p.order[k] * theta_w + p.phase[k]
            amplitude = p.amplitude[k] * magnitude_response(p.order[k], speed)
            sine, cosine = sincos(angle)
            error += amplitude * sine
            slope += p.order[k] * amplitude * cosine
    return error, slope


@kernel(forceinline=True)
def stribeck_friction(w, theta_l, load, time, temperature, p):
    """Return the sliding mesh friction g(w) > 0 of the LuGre law [N·m, motor side]: the Stribeck curve with its
    effects.

    `load`: flexspline torque Tf [N·m]; `time` since the recording's start [s]; `temperature` of gear or motor [°C].
    """
    g = p.Fc
    x = (w / p.vs) ** 2
    if x < _FORGOTTEN:
        g += (p.Fs - p.Fc) * math.exp(-x)
    if p.friction_asymmetry != 0.0:
        g *= 1.0 + (p.friction_asymmetry if w > 0.0 else -p.friction_asymmetry)
    if p.drift_amplitude != 0.0:
        g *= 1.0 + p.drift_amplitude * math.exp(-time / p.drift_time)
    if p.friction_load != 0.0:
        more = p.friction_load * abs(load) / p.N
        g += more if load * w >= 0.0 else p.back_driven_friction * more
    for k in range(N_ORDERS):
        if p.friction_amplitude[k] != 0.0:
            g += p.friction_amplitude[k] * math.sin(p.friction_order[k] * theta_l + p.friction_phase[k])
    if p.friction_temperature != 0.0:
        g *= _thermal_factor(temperature, p)
    return max(g, _SMALLEST_FRICTION)


@kernel
def _thermal_factor(temperature, p):
    """Return 1 + c (ϑ − ϑ0), at least a tenth: friction never changes its sign."""
    return max(1.0 + p.friction_temperature * (temperature - p.reference_temperature), 0.1)


@kernel(forceinline=True)
def viscous_friction(w, temperature, p):
    """Return the viscous part of mesh friction [N·m, motor side]: bw w, at high speed |w| to the power
    `viscous_exponent`."""
    torque = p.bw * w
    if p.viscous_exponent != 1.0:
        x = w / (_BENDING * p.vs)
        torque *= (1.0 + x * x) ** (0.5 * (p.viscous_exponent - 1.0))
    if p.friction_temperature != 0.0:
        torque *= _thermal_factor(temperature, p)
    return torque


@kernel
def bristle_rate(z, w, g, p):
    """Return the rate of the LuGre bristle z' = w − s0 |w|/g z [rad/s]."""
    return w - p.s0 * abs(w) / g * z


@kernel
def bristle_step(z, w, g, h, p):
    """Return the bristle deflection after a time `h` [s] at constant velocity: exact, as the rate is stiff at speed."""
    rate = p.s0 * abs(w) / g
    if rate * h > _FORGOTTEN:
        return w / rate
    return z + (w / rate - z) * decayed(rate * h) if rate * h > 1e-12 else z + w * h


@kernel
def mesh_friction(z, w, g, p):
    """Return the mesh friction at the wave generator without its viscous part: s0 z + s1 z' [N·m, motor side]."""
    return p.s0 * z + p.s1 * bristle_rate(z, w, g, p)


@kernel
def dahl_step(z, v, h, p):
    """Return the Dahl state z [rad] of the flexspline's hysteresis after `h` at torsion rate `v`: z' = v − |v| z/x,
    exact."""
    x = p.hysteresis_extent
    return z + ((x if v > 0.0 else -x) - z) * decayed(abs(v) * h / x)


@kernel
def hysteresis_torque(z, p):
    """Return the hysteresis torque F z/x across the flexspline [N·m]."""
    return p.hysteresis_torque * z / p.hysteresis_extent


@kernel
def cogging_torque(theta_m, p, speed=0.0):
    """Return the cogging torque on the rotor: Σ A sin(n θm + φ) [N·m, motor side]; after a smoother,
    `magnitude_response`."""
    torque = 0.0
    for k in range(N_ORDERS):
        if p.cogging_amplitude[k] != 0.0:
            amplitude = p.cogging_amplitude[k] * magnitude_response(p.cogging_order[k], speed)
            torque += amplitude * math.sin(p.cogging_order[k] * theta_m + p.cogging_phase[k])
    return torque


_LINK_SLIDES = 0.01  # rad/s


@kernel
def link_torque(theta_l, p):
    """Return the torque of a cable spring and a hard stop on the link [N·m]."""
    torque = -p.cable_stiffness * (theta_l - p.cable_rest)
    if theta_l > p.stop_angle:
        torque -= p.stop_stiffness * (theta_l - p.stop_angle)
    return torque


@kernel
def link_friction(velocity, p):
    """Friction torque of bearing and seal on the link [N·m] at a velocity [rad/s]; its sign changes smoothly about rest."""
    return -p.link_friction * math.tanh(velocity / _LINK_SLIDES) - p.link_damping * velocity


@kernel
def flexible_inertia(p):
    """Return the inertia J_s [kg·m²] of the flexible part of the link: `flexible_share` of Jl."""
    return p.flexible_share * p.Jl


@kernel
def flexible_torque(angle, rate, p):
    """Return the torque of the flexible part on the rest of the link [N·m]: k φ + d φ' at its angle φ [rad] and rate
    against the link.

    J_s (φ'' + θl'') = −k φ − d φ' with k = J_s ω², d = 2 ζ J_s ω: `flexible_frequency` ω/2π [Hz] and
    `flexible_damping` ζ are those with the link held.
    """
    w = 2.0 * math.pi * p.flexible_frequency
    return flexible_inertia(p) * w * (w * angle + 2.0 * p.flexible_damping * rate)


@kernel
def flexible_step(angle, rate, before, after, h, p):
    """Return the angle φ [rad] and rate of the flexible part after a time `h` [s].

    Exact for a linear change of the link's acceleration [rad/s²] from `before` to `after` (damping below 1).
    """
    return flexible_motion(angle, rate, before, after, flexible_response(h, p))


@kernel
def flexible_response(h, p):
    """Return the coefficients of `flexible_motion` for a time `h` [s]."""
    w, zeta = 2.0 * math.pi * p.flexible_frequency, p.flexible_damping
    wd = w * math.sqrt(1.0 - zeta * zeta)
    c, s, decay = math.cos(wd * h), math.sin(wd * h) / wd, math.exp(-zeta * w * h)
    xx, xv, vx, vv = decay * (c + zeta * w * s), decay * s, -decay * w * w * s, decay * (c - zeta * w * s)
    # Less the particular solution −(a − 2ζ/ω a')/ω² of the straight line, the rest is a free oscillation.
    steady, bent, rate = -1.0 / (w * w), 2.0 * zeta / (w * w * w), -1.0 / (w * w)
    return (
        xx, xv, (1.0 - xx) * steady, ((1.0 - xx) * bent + (h - xv) * rate) / h,
        vx, vv, -vx * steady, ((1.0 - vv) * rate - vx * bent) / h,
    )  # fmt: skip


@kernel(forceinline=True)
def flexible_motion(angle, rate, before, after, response):
    """Return `flexible_step` for known coefficients."""
    change = after - before
    return (
        response[0] * angle + response[1] * rate + response[2] * before + response[3] * change,
        response[4] * angle + response[5] * rate + response[6] * before + response[7] * change,
    )


@kernel
def has_discrepancy(p):
    """Return whether the joint has a nonparametric model discrepancy; they fill their places in order."""
    return p.discrepancy_place[0] != 0.0


@kernel
def _variable(code, theta_m, theta_l, velocity, load, time):
    """Return the variable of a discrepancy, by its index in `parameters.VARIABLES`."""
    if code == 1:
        return theta_m - 2.0 * math.pi * math.floor(theta_m / (2.0 * math.pi))
    if code == 2:
        return velocity
    if code == 3:
        return load
    if code == 4:
        return time
    if code == 6:
        # The period of the flexspline's teeth, two fewer than the circular spline's.
        return theta_m - 4.0 * math.pi * math.floor(theta_m / (4.0 * math.pi))
    return theta_l


@kernel
def _spline(u, k, p):
    """Return the cubic B-spline of discrepancy k at u in [0, 1], clamped; coefficients 0 … count−1 on a uniform grid."""
    n = math.floor(p.discrepancy_count[k])
    s = min(max(u, 0.0), 1.0) * (n - 3)
    i = min(math.floor(s), n - 4)
    t = s - i
    c = p.discrepancy_coefficient[k]
    a = 1.0 - t
    return (
        a * a * a * c[i]
        + (3.0 * t * t * t - 6.0 * t * t + 4.0) * c[i + 1]
        + (3.0 * a * a * a - 6.0 * a * a + 4.0) * c[i + 2]
        + t * t * t * c[i + 3]
    ) / 6.0


@kernel
def discrepancy(place, theta_m, theta_l, velocity, load, time, p):
    """Return the sum of the model discrepancies at `place` (index into `parameters.PLACES`), in that place's unit.

    One in `direction_link_position` is multiplied by the sign of the velocity, like friction.
    """
    total = 0.0
    for k in range(N_DISCREPANCIES):
        if p.discrepancy_place[k] == place:
            code = math.floor(p.discrepancy_variable[k])
            x = _variable(code, theta_m, theta_l, velocity, load, time)
            value = _spline((x - p.discrepancy_low[k]) / (p.discrepancy_high[k] - p.discrepancy_low[k]), k, p)
            if code == 5:
                value *= math.tanh(velocity)
            total += value
    return total


@kernel
def motor_reading(theta_m, p):
    """Return the motor encoder's reading [rad] before noise and counts: eccentricity A (sin(θm + φ) − sin φ)."""
    if p.motor_eccentricity == 0.0:
        return theta_m
    phase = p.motor_eccentricity_phase
    return theta_m + p.motor_eccentricity * (math.sin(theta_m + phase) - math.sin(phase))


@kernel
def link_reading(theta_l, p):
    """Return the link encoder's reading [rad] before delay, noise and bits: zero, and its orders Σ A (sin(n θl + φ) −
    sin φ)."""
    reading = theta_l + p.link_zero
    for k in range(N_ORDERS):
        if p.link_error_amplitude[k] != 0.0:
            phase = p.link_error_phase[k]
            angle = p.link_error_order[k] * theta_l + phase
            reading += p.link_error_amplitude[k] * (math.sin(angle) - math.sin(phase))
    return reading


@kernel
def current_reading(current, p):
    """Return the current sensor's reading [A]."""
    return current + p.current_offset


@kernel
def torque_reading(torque, time, p):
    """Return the joint torque sensor's reading [N·m]: gain, offset and drift."""
    return p.torque_gain * torque + p.torque_offset + p.torque_rate * time


@kernel
def gravity_torque(theta_l, p):
    """Return the torque of the link's weight about the joint axis, −Mg sin(θl + gravity_angle) [N·m]."""
    return -p.Mg * math.sin(theta_l + p.gravity_angle)
