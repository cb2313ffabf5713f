"""Joint-dynamics EKF: draft."""
from __future__ import annotations
import math
from dataclasses import dataclass
import numpy as np
from numba import njit
from ...models import laws
from . import joint_dynamics as model
from .base import Estimator, JointSignals, SensorNoise, TorqueEstimate, known
from .joint_dynamics import BRISTLE, DAHL, EXTERNAL, LINK, LINK_RATE, MESH, MOTOR, MOTOR_RATE, SIZE, WAVE, WAVE_RATE
from .quantised import update

STEPS = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1e-6, 1e-7, 1e-4, 1e-3, 1e-5, 1e-4, 1e-4, 1e-7])

@njit(cache=True, nogil=True, error_model="numpy")
def run(time, motor, link, current, record, Q, mesh_time, R, q, P0, surge, memory, out_x, out_P, out_T, out_V, out_e, out_S, out_r):
    p = record[0]
    n = SIZE if p.hysteresis_torque != 0.0 else SIZE - 1
    x = np.zeros(SIZE); P = np.zeros((n, n)); work = np.zeros((5, SIZE)); y = np.zeros(SIZE); base = np.zeros(SIZE)
    F = np.zeros((n, n)); A = np.zeros((n, n)); H = np.zeros(n); PH = np.zeros(n)
    model.start(motor[0], link[0], p, x)
    for i in range(n):
        P[i, i] = P0[i]
    i_now = 0.0
    rm = rl = 1.0
    out_x[0] = x
    for k in range(1, len(time)):
        dt = time[k] - time[k - 1]
        steps = model.substeps(x, dt, p)
        forget = math.exp(-dt / mesh_time)
        base[:] = x
        model.advance(base, i_now, current[k], time[k - 1], dt, steps, forget, p, work)
        for j in range(n):
            y[:] = x
            y[j] += STEPS[j]
            model.advance(y, i_now, current[k], time[k - 1], dt, steps, forget, p, work)
            for i in range(n):
                F[i, j] = (y[i] - base[i]) / STEPS[j]
        x[:] = base
        i_now = model.next_current(i_now, current[k], dt, p)
        for i in range(n):
            for j in range(n):
                t = 0.0
                for l in range(n):
                    t += F[i, l] * P[l, j]
                A[i, j] = t
        for i in range(n):
            for j in range(i + 1):
                t = 0.0
                for l in range(n):
                    t += A[i, l] * F[j, l]
                P[i, j] = t
                P[j, i] = t
        for i in range(n):
            P[i, i] += Q[i] * dt
        P[EXTERNAL, EXTERNAL] += surge[0] * dt * min(max((rl - 3.0) / 3.0, 0.0), 1.0)
        P[MESH, MESH] += surge[1] * dt * min(max((rm - 3.0) / 3.0, 0.0), 1.0)
        rm *= memory
        rl *= memory
        H[:] = 0.0
        H[MOTOR] = 1.0
        e0 = motor[k] - x[MOTOR]
        S = update(x, P, H, e0, R[0], q[0], PH)
        out_e[k, 0] = e0
        out_S[k, 0] = S + q[0] ** 2 / 12
        rm += (1-memory) * e0 * e0 / out_S[k, 0]
        H[MOTOR] = 0.0
        h0 = model.link_encoder(x, time[k], p)
        y[:] = x
        y[LINK] += 1e-5
        H[LINK] = (model.link_encoder(y, time[k], p) - h0) / 1e-5
        H[LINK_RATE] = -p.link_delay * H[LINK]
        e1 = link[k] - h0
        S = update(x, P, H, e1, R[1], q[1], PH)
        out_e[k, 1] = e1
        out_S[k, 1] = S + q[1] ** 2 / 12
        rl += (1-memory) * e1 * e1 / out_S[k, 1]
        out_V[k]=rl
        T = model.joint_torque(x, time[k], p)
        for j in range(n):
            y[:] = x
            y[j] += STEPS[j]
            H[j] = (model.joint_torque(y, time[k], p) - T) / STEPS[j]
        V = 0.0
        for i in range(n):
            for j in range(n):
                V += H[i] * P[i, j] * H[j]
        H[:] = 0
        out_T[k] = T
        out_V[k] = V
        out_r[k,0]=rm; out_r[k,1]=rl
        out_x[k] = x
        for i in range(n):
            out_P[k, i] = P[i, i]
