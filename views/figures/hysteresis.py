"""The paper's Fig. 3: torsion against torque, the hysteresis loop of the locked rotor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ...models.laws import flexspline_torsion, kinematic_error, wave_generator_torsion
from ..posteriors import settled
from ..style import COMMAND, EXTERNAL, MODEL, TRUTH
from .sheet import sheet, styled
from .signals import peak

if TYPE_CHECKING:
    from ...scenarios.run import Run

POINTS = 6000  # largest number of points of the loop, which cannot be drawn as an envelope


@styled
def stiffness(run: Run) -> Figure:
    """Fig. 3: torsion over torque of the locked rotor, with its hysteresis, and the nominal compliance curve."""
    p = run.joint.record(run.scenario.mount(run.joint))[0]
    torque = run.truth("joint_torque")
    total = run.truth("motor_position") / p["N"] - run.truth("link_position")
    # The kinematic error of a locked rotor depends on its position only.
    total = 1e3 * (total - kinematic_error(run.truth("motor_position")[0], p))
    loop = settled(run)
    reach = 1.05 * np.abs(torque[loop]).max()
    grid = np.linspace(-reach, reach, 401)
    flexspline = 1e3 * np.array([flexspline_torsion(T, p) for T in grid])
    both = flexspline + 1e3 * np.array([wave_generator_torsion(T / p["N"], p) for T in grid]) / p["N"]
    half = half_width(torque[loop], total[loop])
    caption = (
        "Paper: a typical curve; stiffness increases with torsion (K1, K2, K3, changes at T1, T2), with hysteresis, so "
        "that the torsion at zero torque lies between ±Ψ/2; no numbers. "
        f"Ours, rotor locked: ±{peak(total[loop]):.2f} mrad at ±{peak(torque[loop]):.1f} N·m, Ψ/2 = {half:.3f} mrad; "
        f"K1, K2, K3 = {p['K1']:.0f}, {p['K2']:.0f}, {p['K3']:.0f} N·m/rad, T1, T2 = {p['T1']:.1f}, {p['T2']:.1f} N·m. "
        "The loop lies about the nominal curve of Eqs. (2) + (5): mesh friction takes a part of the torque before "
        "it reaches the wave generator."
    )
    figure, ((axes,),) = sheet(f"Fig. 3  Stiffness and hysteresis  ·  {run.name}", caption, [4.2])
    some = slice(None, None, -(-len(torque) // POINTS))
    axes.plot(total[some], torque[some], color=TRUTH, lw=1.8, label="joint, hysteresis loop")
    axes.plot(flexspline, grid, color=COMMAND, ls="--", label="flexspline alone, Eq. (2)")
    axes.plot(both, grid, color=MODEL, ls="-", lw=1.6, label="with wave generator, Eqs. (2) + (5)")
    for corner, name in ((p["T1"], "T1"), (p["T2"], "T2")):
        for sign in (1, -1):
            if corner < reach:
                x = 1e3 * flexspline_torsion(sign * corner, p)
                axes.plot(x, sign * corner, "o", ms=4, color=COMMAND)
                axes.annotate(
                    name if sign > 0 else f"−{name}", (x, sign * corner), xytext=(-6 * sign, 4 * sign),
                    textcoords="offset points", ha="right" if sign > 0 else "left", va="center", color=COMMAND,
                )  # fmt: skip
    axes.axhline(0, color="#B9BEC5", lw=0.8)
    axes.axvline(0, color="#B9BEC5", lw=0.8)
    axes.plot([-half, half], [0, 0], color=EXTERNAL, lw=2.5, solid_capstyle="butt", label=f"Ψ = {2 * half:.3f} mrad")
    axes.set(xlabel="torsion Δθ − θerr [mrad]", ylabel="joint torque [N·m]")
    axes.legend(loc="upper left")
    return figure


def half_width(torque: np.ndarray, torsion: np.ndarray) -> float:
    """Return half the difference of torsion at rising and falling zero crossings of the torque, shape (n,) each."""
    # Crossings between excursions beyond half the largest torque, not those of a joint that settles around zero.
    far = np.flatnonzero(np.abs(torque) > 0.5 * np.abs(torque).max())
    turns = np.flatnonzero(np.signbit(torque[far[1:]]) != np.signbit(torque[far[:-1]]))
    if not turns.size:
        return 0.0
    cross = np.array(
        [
            i + int(np.flatnonzero(np.diff(np.signbit(torque[i : j + 1])))[0])
            for i, j in zip(far[turns], far[turns + 1], strict=True)
        ]
    )
    u = -torque[cross] / (torque[cross + 1] - torque[cross])
    at = torsion[cross] + u * (torsion[cross + 1] - torsion[cross])
    rising = torque[cross + 1] > torque[cross]
    if rising.all() or not rising.any():
        return float(np.abs(at).max())
    return float(abs(np.mean(at[rising]) - np.mean(at[~rising])) / 2)
