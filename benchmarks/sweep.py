"""A sweep of the paper's filters, and `mujoco.batch` and `mujoco.rollout` with the same models, on the same cores."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from mujoco import batch, rollout

from flexspline.scenarios.studies.dataset import Dataset
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.study import Study
from flexspline.scenarios.studies.sweep import sweep, versions
from flexspline.sim import native, plant

from .timing import alternately, verdict

SECONDS = 40.0
SEEDS = 4
LOADS = [3, 9]  # N·m
REPEATS = 5
THROUGHPUT, SCALING = 0.75, 1.8
"""Targets: share of bare stepping, one core to two."""
GROWTH = 1.1
"""Memory of four times as many runs, at most; the rest is the allocator's."""
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_STEPS_AT_ONCE = 5000  # of a rollout, which keeps all states


def study(seeds: int = SEEDS, seconds: float = SECONDS) -> Design:
    """The external push, the paper's filters, two loads."""
    return Design.of(
        Study.model_validate(
            {
                "name": "benchmark",
                "seeds": {"count": seeds},
                "scenarios": ["external_push"],
                "set": {"duration": seconds},
                "axes": [{"kind": "load", "values": LOADS}],
            }
        )
    )


def run_sweep(design: Design, jobs: int) -> None:
    """The sweep into a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        sweep(design, Dataset.open(Path(folder) / "sweep", design, versions()), jobs)


def models(design: Design) -> tuple[list[mujoco.MjModel], np.ndarray]:
    """The models of all runs of a design, and their first states, shape (runs, nstate)."""
    found, states = [], []
    for cell in design.cells:
        model = design.experiment(cell).build()
        data = mujoco.MjData(model)
        plant.start(model, data, np.array([50.0, 50.0, 0.5]))
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, state, _STATE)
        found += [model] * SEEDS
        states += [state] * SEEDS
    return found, np.array(states)


def batched(design: Design, threads: int, at_once: int = 0) -> Callable[[], None]:
    """Step the design's models with `mujoco.batch`; in calls of `at_once` steps, or all in one."""
    all_models, states = models(design)
    steps = round(SECONDS / all_models[0].opt.timestep)

    def run() -> None:
        simulations = batch.Batch(all_models[0], len(all_models), nthread=threads)
        simulations.set_models(all_models)
        data = mujoco.MjData(all_models[0])
        for name in ("time", "qpos", "qvel", "act"):
            values = []
            for state in states:
                mujoco.mj_setState(all_models[0], data, state, _STATE)
                values.append(np.array(getattr(data, name)))
            simulations.bind(name)[:] = np.array(values).reshape(simulations.bind(name).shape)
        for _ in range(steps // (at_once or steps)):
            simulations.step(nstep=at_once or steps)

    return run


def rolled_out(design: Design, threads: int) -> Callable[[], None]:
    """Step the design's models with `mujoco.rollout`."""
    all_models, states = models(design)
    steps = round(SECONDS / all_models[0].opt.timestep)

    def run() -> None:
        data = [mujoco.MjData(all_models[0]) for _ in range(threads)]
        state = states
        kept = np.empty((len(all_models), _STEPS_AT_ONCE, states.shape[1]))
        with rollout.Rollout(nthread=threads) as pool:
            for _ in range(steps // _STEPS_AT_ONCE):
                pool.rollout(all_models, data, state, nstep=_STEPS_AT_ONCE, state=kept)
                state = kept[:, -1].copy()

    return run


def peak_memory(seeds: int) -> float:
    """Most memory [MB] of a process that sweeps that many seeds on all cores."""
    command = [sys.executable, "-m", "benchmarks.sweep", str(seeds)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Print throughput, scaling and memory, each as a ratio or against its target."""
    design = study()
    total = design.runs * SECONDS
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    counts = sorted({1, min(2, cores)})
    functions: dict[str, Callable[[], None]] = {}
    for c in counts:
        functions[f"sweep {c}"] = lambda c=c: run_sweep(design, c)
        functions[f"batch {c}"] = batched(design, c)
        functions[f"rollout {c}"] = rolled_out(design, c)
    functions[f"ticks {counts[-1]}"] = batched(design, counts[-1], at_once=5)
    with native.quiet():
        t = alternately(functions, REPEATS)
    print(
        f"{design.runs} runs of external_push, {SECONDS:g} s each, {', '.join(design.study.names)}; joint-seconds per second"
    )
    for c in counts:
        sweeping = t[f"sweep {c}"]
        print(f"  sweep, {c} thread(s)                {total / sweeping.median:6.1f}   {sweeping}")
        for name in ("batch", "rollout"):
            bare = t[f"{name} {c}"]
            ratio, by_core = bare.median / sweeping.median, bare.core / sweeping.core
            print(f"  mujoco.{name:7s} alone, {c} thread(s) {total / bare.median:6.1f}   {bare}")
            print(f"    sweep / {name:7s}                {ratio:6.2f}   by the cores' time {by_core:.2f} ", end="")
            print(f"(target ≥ {THROUGHPUT:g}: {verdict(ratio >= THROUGHPUT)})")
    ticks = t[f"ticks {counts[-1]}"]
    print(f"  mujoco.batch, a call per control tick {total / ticks.median:6.1f}   {ticks}: before any sensor or filter")
    if len(counts) > 1:
        ratio, bare = (t[f"{name} 1"].median / t[f"{name} 2"].median for name in ("sweep", "batch"))
        print(f"  one core to two            {ratio:.2f} × (target ≥ {SCALING:g}: {verdict(ratio >= SCALING)})", end="")
        print(f"; mujoco.batch alone at the same time {bare:.2f} ×")
    once, more = peak_memory(SEEDS), peak_memory(4 * SEEDS)
    print(
        f"  peak memory                {once:.0f} MB for {design.runs} runs, {more:.0f} MB for {4 * design.runs}",
        end="",
    )
    print(f" (target ≤ {GROWTH:g} ×: {more / once:.2f}, {verdict(more <= GROWTH * once)})")


if __name__ == "__main__":  # a separate process, whose memory is measured
    run_sweep(study(int(sys.argv[1]), 10.0), os.cpu_count() or 1)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
