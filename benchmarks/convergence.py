"""The convergence study of docs/convergence.md: error against the reference solutions over the timestep.

Once for the plant, once for MuJoCo's integrators without what the plant adds to them: linear dampings as MuJoCo takes
them, its own LuGre friction, and a callback that exerts the springs' forces and nothing else.
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow.parquet as pq
from numba import carray, cfunc, types

from flexspline.models.joint import Joint, load_joint
from flexspline.models.joint_parts import Mounting
from flexspline.models.parameters import SIZE, as_floats
from flexspline.models.pointers import floats_at, record_at, word_at
from flexspline.sim import native, plant, verify
from flexspline.sim.plugin import transmission_at

STEPS = (1e-3, 5e-4, 2.5e-4, 2e-4, 1e-4, 5e-5)
CHANNELS = ("torsion", "joint_torque", "motor_current")
ROOT = Path(__file__).resolve().parents[1]
INTEGRATORS = {"implicitfast": 3, "implicit": 2, "Euler": 0, "RK4": 1}
MAGIC = 1.2345678901e19
"""Before the record in a model's numbers: that of models whose springs are `springs`."""


@contextmanager
def callback(name: str, address: int | None) -> Iterator[None]:
    """Another C function in the place of one of MuJoCo's global callbacks, or none; then what was there before."""
    place = ctypes.c_void_p.in_dll(native.library(), name)
    before, place.value = place.value, address
    try:
        yield
    finally:
        place.value = before


@cache
def springs() -> Any:
    """The described springs' forces and nothing else, as MuJoCo's callback of passive forces."""
    at = native.offsets()
    NUMERIC, COUNT, QPOS, QVEL, PASSIVE = (
        at[name] for name in ("numeric_data", "nnumericdata", "qpos", "qvel", "qfrc_passive")
    )

    @cfunc(types.void(types.intp, types.intp))
    def passive(m, d):
        if word_at(m + 8 * COUNT) != SIZE + 1 or floats_at(word_at(m + 8 * NUMERIC))[0] != MAGIC:
            return
        p = carray(record_at(word_at(m + 8 * NUMERIC) + 8), 1)[0]
        theta, velocity = carray(floats_at(word_at(d + 8 * QPOS)), 3), carray(floats_at(word_at(d + 8 * QVEL)), 3)
        force = carray(floats_at(word_at(d + 8 * PASSIVE)), 3)
        t = transmission_at(theta, velocity, 0.0, p)
        # MuJoCo exerts both dampings, which are in the torques, too.
        tendon = p.df * (velocity[1] / p.N - velocity[2])
        spring = t.wave_generator_torque - p.dw * (velocity[0] - velocity[1])
        force[0] -= spring
        force[1] += spring - t.flexspline_torque * t.ratio + tendon / p.N
        force[2] += t.flexspline_torque - tendon

    return passive


def set_numbers(spec: mujoco.MjSpec, p: np.void, timestep: float) -> None:
    """Put a record's numbers into a joint's MJCF without the plant's corrections."""
    plant.set_numbers(spec, p, timestep, ideal_current=True)
    error = spec.actuator("mesh_friction").set_to_dcmotor(
        motorconst=[0.0, 0.0], resistance=1.0, lugre=[float(p[name]) for name in ("s0", "s1", "Fc", "Fs", "vs")],
        ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_NONE),
    )  # fmt: skip
    if error:
        raise ValueError(error)
    for name, symbol in (("rotor", "bm"), ("link", "bl")):
        spec.joint(name).damping = [p[symbol], 0, 0]
    for name, symbol in (("flexspline", "df"), ("wave_generator", "dw")):
        spec.tendon(name).damping = [p[symbol], 0, 0]
    spec.actuator("mesh_friction").damping = [p["bw"], 0, 0]


def plain(joint: Joint, mounting: Mounting, reference, timestep: float, integrator: str) -> dict[str, np.ndarray]:
    """As `verify.closed_loop`, without the plant's corrections: state and velocity both belong to the instant."""
    record = joint.record(mounting)
    p = record[0]
    spec = mujoco.MjSpec.from_file(str(joint.mjcf))
    set_numbers(spec, p, timestep)
    spec.option.integrator = INTEGRATORS[integrator]
    spec.add_numeric(name="joint", size=SIZE + 1, data=[0.0])
    model = spec.compile()
    model.tendon_stiffness[:] = 0.0
    model.numeric_data[:] = np.concatenate([[MAGIC], as_floats(record)])
    data = mujoco.MjData(model)
    substeps = round(1e-3 / timestep)
    position, velocity, external = (reference[k] for k in ("position_command", "velocity_command", "external_torque"))
    n, body = len(position), model.body("link").id
    theta, omega, current = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    for k in range(n):
        theta[k], omega[k] = data.qpos, data.qvel
        i = 8 * (p["N"] * position[k] - theta[k, 0]) + 0.08 * (p["N"] * velocity[k] - omega[k, 0])
        current[k] = np.clip(i, -p["current_limit"], p["current_limit"])
        data.ctrl[0] = p["Kt"] * current[k]
        data.xfrc_applied[body, 4] = -external[k]
        mujoco.mj_step(model, data, nstep=substeps)
    torque = np.array([transmission_at(q, w, 0.0, p).flexspline_torque for q, w in zip(theta, omega, strict=True)])
    return {
        "torsion": theta[:, 0] / p["N"] - theta[:, 2],
        "joint_torque": torque - p["bl"] * omega[:, 2],
        "motor_current": current,
    }


def errors(folder: Path, solve, timestep: float) -> dict[tuple[str, str], float]:
    """RMS difference relative to the reference's standard deviation, by file and channel; NaN where it diverged."""
    joint = load_joint("test-joint")
    found = {}
    for name, mounting in verify.CLOSED_LOOP.items():
        table = pq.read_table(folder / f"{name}.parquet")
        reference = {column: table[column].to_numpy() for column in table.column_names}
        theirs = {k: reference[k] for k in ("joint_torque", "motor_current")}
        theirs["torsion"] = reference["motor_position"] / joint.numbers["N"].value - reference["link_position"]
        with np.errstate(all="ignore"):
            ours = solve(joint, joint.mount(mounting), reference, timestep)
            for channel in CHANNELS:
                error = np.sqrt(np.mean((ours[channel] - theirs[channel]) ** 2)) / np.std(theirs[channel])
                found[name, channel] = float(error) if error < 10 else float("nan")
    return found


def _row(label: str, found: dict[tuple[str, str], float]) -> str:
    def shown(value: float) -> str:
        return "diverges" if np.isnan(value) else f"{100 * value:.3g}"

    return f"| {label} | " + " | ".join(shown(found[f, c]) for f in verify.CLOSED_LOOP for c in CHANNELS) + " |"


def figure(path: Path, ours, others) -> None:
    """Error over timestep, both schemes, one panel a channel."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(1, 3, figsize=(10.5, 3.6), sharey=True, layout="constrained")
    colours = {"no_load": "tab:blue", "link_sweep": "tab:green", "external_push": "tab:red"}
    for axis, channel in zip(axes, CHANNELS, strict=True):
        for name, colour in colours.items():
            for found, style, label in ((ours, "o-", "plant"), (others, "s--", "implicitfast alone")):
                values = [100 * found[h][name, channel] for h in STEPS]
                axis.loglog(
                    [1e3 * h for h in STEPS], values, style, color=colour, ms=4, lw=1.2, label=f"{name}, {label}"
                )
        axis.axhline(100 * verify.LIMITS[channel], color="black", lw=1, ls=":")
        axis.text(0.05, 112 * verify.LIMITS[channel], "limit", fontsize=8, va="bottom")
        axis.axvline(1e3 * plant.TIMESTEP, color="0.8", lw=4, zorder=0)
        axis.set_title(channel.replace("_", " "), fontsize=10)
        axis.set_xlabel("timestep (ms)")
        axis.set_xticks([0.05, 0.1, 0.2, 0.5, 1], ["0.05", "0.1", "0.2", "0.5", "1"])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("RMS difference / std (%)")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    path.parent.mkdir(exist_ok=True)
    fig.savefig(path, dpi=130)
    plt.close(fig)


def main() -> None:
    """Print the tables and draw docs/figures/convergence.png."""
    folder = Path(os.environ.get("FLEXSPLINE_SHARED", ROOT.parent / "shared")) / "data" / "reference"
    if not folder.is_dir():
        print(f"convergence: no reference solutions at {folder}; set FLEXSPLINE_SHARED")
        return
    print("RMS difference relative to the reference's standard deviation, %: torsion, joint torque, current of")
    print(", ".join(verify.CLOSED_LOOP))
    ours, others = {}, {}
    for h in STEPS:
        begin = time.perf_counter()
        with native.quiet():
            ours[h] = errors(folder, verify.closed_loop, h)
        print(_row(f"plant, {1e3 * h:g} ms", ours[h]), f"{time.perf_counter() - begin:.1f} s", flush=True)
    with callback("mjcb_passive", springs().address), native.quiet():
        for integrator in INTEGRATORS:
            for h in STEPS if integrator == "implicitfast" else (5e-4, 2.5e-4):
                found = errors(folder, lambda j, m, r, h, i=integrator: plain(j, m, r, h, i), h)
                if integrator == "implicitfast":
                    others[h] = found
                print(_row(f"{integrator}, {1e3 * h:g} ms", found), flush=True)
    figure(ROOT / "docs" / "figures" / "convergence.png", ours, others)
    print(f"figure: {ROOT / 'docs' / 'figures' / 'convergence.png'}")
