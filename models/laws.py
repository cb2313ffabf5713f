"""The equations of the joint: the only place where its physics is written.

Each law is a compiled scalar function of a state and a parameter record `p` (`models.parameters`), SI units.
Angles: `theta_m` rotor and `theta_w` wave generator, motor side; `theta_l` link, output side. `w` is the wave
generator's velocity. Equation numbers are those of Shi & Liu; the other laws are stated where they stand.

    rotor           Jm θm'' = Kt i − bm θm' + rotor_torque − Tw
    wave generator  Jw θw'' = Tw − Fmesh − Tf (1/N − θerr'(θw))
    link            Jl θl'' = Ts − Mg sin(θl + gravity_angle) + link_torque + τext        with Ts = Tf − bl θl'
"""

from __future__ import annotations

import math

from numba import njit

from .parameters import N_ORDERS, N_PERIODIC, N_TERMS

_SMALLEST_FRICTION = 1e-5  # N·m: g(w) stays positive whatever an effect subtracts
# The logarithm of Eqs. (3)-(5) goes on as its tangent from here: 0.29 N·m on the motor side of the test joint, beyond what
# its motor gives, where the law is so stiff that no practical step would resolve it.
LOGARITHM_END = 3e-3


@njit(cache=True)
def flexspline_spring(torsion, p):
    """Torque k(Δθf) of the flexspline [N·m], Eq. (7) as an odd function, behind a dead zone of width `backlash`."""
    x = abs(torsion) - 0.5 * p.backlash
    if x <= 0.0:
        return 0.0
    knee1 = p.T1 / p.K1
    knee2 = knee1 + (p.T2 - p.T1) / p.K2
    if x <= knee1:
        torque = p.K1 * x
    elif x < knee2:
        torque = p.T1 + p.K2 * (x - knee1)
    else:
        torque = p.T2 + p.K3 * (x - knee2)
    return torque if torsion > 0.0 else -torque


@njit(cache=True)
def flexspline_torsion(torque, p):
    """Torsion Δθf [rad] at a torque [N·m], Eq. (2) as an odd function; the middle of the dead zone at zero torque."""
    T = abs(torque)
    if T <= p.T1:
        x = T / p.K1
    elif T < p.T2:
        x = p.T1 / p.K1 + (T - p.T1) / p.K2
    else:
        x = p.T1 / p.K1 + (p.T2 - p.T1) / p.K2 + (T - p.T2) / p.K3
    if T > 0.0:
        x += 0.5 * p.backlash
    return x if torque >= 0.0 else -x


@njit(cache=True)
def wave_generator_spring(torsion, p):
    """Torque of the wave generator's compliance [N·m, motor side] at δ = θm − θw [rad]: Eqs. (3)-(5) inverted."""
    u = 1.0 - p.Cw * p.Kw0 * abs(torsion)
    if u > LOGARITHM_END:
        torque = -math.log(u) / p.Cw
    else:
        torque = (-math.log(LOGARITHM_END) + (LOGARITHM_END - u) / LOGARITHM_END) / p.Cw
    return torque if torsion > 0.0 else -torque


@njit(cache=True)
def wave_generator_stiffness(torsion, p):
    """Slope of `wave_generator_spring` [N·m/rad, motor side]: Kw0 exp(Cw |Tw|), Eq. (4)."""
    return p.Kw0 / max(1.0 - p.Cw * p.Kw0 * abs(torsion), LOGARITHM_END)


@njit(cache=True)
def wave_generator_torsion(torque, p):
    """Torsion δ of the wave generator [rad, motor side] at a torque [N·m, motor side], Eq. (5)."""
    x = (1.0 - math.exp(-p.Cw * abs(torque))) / (p.Cw * p.Kw0)
    return x if torque >= 0.0 else -x


@njit(cache=True)
def kinematic_error(theta_w, p):
    """Kinematic error θerr [rad, output side] at the wave generator's angle: Σ A_k sin(k θw + φ_k)."""
    error = 0.0
    for k in range(N_ORDERS):
        if p.amplitude[k] != 0.0:
            error += p.amplitude[k] * math.sin(p.order[k] * theta_w + p.phase[k])
    return error


@njit(cache=True)
def kinematic_error_slope(theta_w, p):
    """Derivative dθerr/dθw [1] of the kinematic error."""
    slope = 0.0
    for k in range(N_ORDERS):
        if p.amplitude[k] != 0.0:
            slope += p.order[k] * p.amplitude[k] * math.cos(p.order[k] * theta_w + p.phase[k])
    return slope


@njit(cache=True)
def smoothed_share(order, speed):
    """What a smoother of passband 1/(1 + (f/fc)⁶) leaves of a harmonic: `speed` is the shaft's in turns per 1/fc."""
    x = order * speed
    return 1.0 / (1.0 + x * x * x * x * x * x)


@njit(cache=True)
def smoothed_kinematic_error(theta_w, speed, p):
    """Kinematic error [rad] and its derivative [1] as they are seen through a smoother (`smoothed_share`)."""
    error, slope = 0.0, 0.0
    for k in range(N_ORDERS):
        if p.amplitude[k] != 0.0:
            angle = p.order[k] * theta_w + p.phase[k]
            amplitude = p.amplitude[k] * smoothed_share(p.order[k], speed)
            error += amplitude * math.sin(angle)
            slope += p.order[k] * amplitude * math.cos(angle)
    return error, slope


@njit(cache=True)
def friction_level(w, theta_l, flexspline_torque, time, p):
    """Sliding mesh friction g(w) > 0 [N·m, motor side] of the LuGre law, with the effects that change it."""
    g = p.Fc + (p.Fs - p.Fc) * math.exp(-((w / p.vs) ** 2))
    if p.friction_asymmetry != 0.0:
        g *= 1.0 + (p.friction_asymmetry if w > 0.0 else -p.friction_asymmetry)
    if p.drift_amplitude != 0.0:
        g *= 1.0 + p.drift_amplitude * math.exp(-time / p.drift_time)
    if p.friction_load != 0.0:
        load = p.friction_load * abs(flexspline_torque) / p.N
        g += load if flexspline_torque * w >= 0.0 else p.back_driven_friction * load
    for k in range(N_PERIODIC):
        if p.friction_amplitude[k] != 0.0:
            g += p.friction_amplitude[k] * math.sin(p.friction_order[k] * theta_l + p.friction_phase[k])
    return max(g, _SMALLEST_FRICTION)


@njit(cache=True)
def bristle_rate(z, w, g, p):
    """Rate of the LuGre bristle z' = w − s0 |w|/g z [rad/s]."""
    return w - p.s0 * abs(w) / g * z


@njit(cache=True)
def bristle_step(z, w, g, h, p):
    """Bristle deflection after a time `h` [s] at constant velocity: exact, as the rate is stiff at speed."""
    rate = p.s0 * abs(w) / g
    decay = -math.expm1(-rate * h)
    return z + (w / rate - z) * decay if rate * h > 1e-12 else z + w * h


@njit(cache=True)
def mesh_friction(z, w, g, p):
    """Mesh friction at the wave generator without its viscous part: s0 z + s1 z' [N·m, motor side]."""
    return p.s0 * z + p.s1 * bristle_rate(z, w, g, p)


@njit(cache=True)
def dahl_step(z, v, h, p):
    """Dahl state z [rad] of the flexspline's hysteresis after `h` at torsion rate `v`: z' = v − |v| z/x, exact."""
    x = p.hysteresis_extent
    decay = -math.expm1(-abs(v) * h / x)
    return z + ((x if v > 0.0 else -x) - z) * decay


@njit(cache=True)
def hysteresis_torque(z, p):
    """Hysteresis torque F z/x across the flexspline [N·m]."""
    return p.hysteresis_torque * z / p.hysteresis_extent


@njit(cache=True)
def rotor_torque(theta_m, p, speed=0.0):
    """Cogging torque on the rotor: Σ A sin(n θm + φ) [N·m, motor side]; seen through a smoother, `smoothed_share`."""
    torque = 0.0
    for k in range(N_PERIODIC):
        if p.cogging_amplitude[k] != 0.0:
            amplitude = p.cogging_amplitude[k] * smoothed_share(p.cogging_order[k], speed)
            torque += amplitude * math.sin(p.cogging_order[k] * theta_m + p.cogging_phase[k])
    return torque


@njit(cache=True)
def link_torque(theta_l, p):
    """Torque of a cable spring and a hard stop on the link [N·m]."""
    torque = -p.cable_stiffness * (theta_l - p.cable_rest)
    if theta_l > p.stop_angle:
        torque -= p.stop_stiffness * (theta_l - p.stop_angle)
    return torque


@njit(cache=True)
def has_terms(p):
    """Whether the joint has a nonparametric term."""
    for k in range(N_TERMS):
        if p.term_place[k] != 0.0:
            return True
    return False


@njit(cache=True)
def _variable(code, theta_m, theta_l, velocity, load, time):
    if code == 0:
        return theta_l
    if code == 1:
        return theta_m - 2.0 * math.pi * math.floor(theta_m / (2.0 * math.pi))
    if code == 2:
        return velocity
    if code == 3:
        return load
    if code == 4:
        return time
    if code == 6:
        # What returns with the flexspline's teeth, two fewer than the circular spline's, and not with the motor.
        return theta_m - 4.0 * math.pi * math.floor(theta_m / (4.0 * math.pi))
    return theta_l


@njit(cache=True)
def _spline(u, k, p):
    """Cubic B-spline of term k at u in [0, 1], clamped; coefficients 0 … count−1 on a uniform grid."""
    n = int(p.term_count[k])
    s = min(max(u, 0.0), 1.0) * (n - 3)
    i = min(int(s), n - 4)
    t = s - i
    c = p.term_coefficient[k]
    a = 1.0 - t
    return (
        a * a * a * c[i]
        + (3.0 * t * t * t - 6.0 * t * t + 4.0) * c[i + 1]
        + (3.0 * a * a * a - 6.0 * a * a + 4.0) * c[i + 2]
        + t * t * t * c[i + 3]
    ) / 6.0


@njit(cache=True)
def term(place, theta_m, theta_l, velocity, load, time, p):
    """Sum of the nonparametric terms that act at `place` (index into `parameters.PLACES`), in that place's unit.

    A term in `direction_link_position` is multiplied by the sign of the velocity (friction in shape).
    """
    total = 0.0
    for k in range(N_TERMS):
        if p.term_place[k] == place:
            code = int(p.term_variable[k])
            x = _variable(code, theta_m, theta_l, velocity, load, time)
            value = _spline((x - p.term_low[k]) / (p.term_high[k] - p.term_low[k]), k, p)
            if code == 5:
                value *= math.tanh(velocity)
            total += value
    return total


@njit(cache=True)
def link_reading(theta_l, p):
    """What the link encoder reads [rad] before delay, noise and bits: zero, eccentricity A (sin(θl + φ) − sin φ)."""
    reading = theta_l + p.link_zero
    if p.eccentricity != 0.0:
        reading += p.eccentricity * (math.sin(theta_l + p.eccentricity_phase) - math.sin(p.eccentricity_phase))
    return reading


@njit(cache=True)
def current_reading(current, p):
    """What the current sensor reads [A]."""
    return current + p.current_offset


@njit(cache=True)
def torque_reading(torque, time, p):
    """What the joint torque sensor reads [N·m]: gain, offset and drift."""
    return p.torque_gain * torque + p.torque_offset + p.torque_rate * time


@njit(cache=True)
def gravity_torque(theta_l, p):
    """Torque of the link's weight about the joint axis, −Mg sin(θl + gravity_angle) [N·m]."""
    return -p.Mg * math.sin(theta_l + p.gravity_angle)
