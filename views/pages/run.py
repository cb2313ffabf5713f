"""The page of one or several runs: the closest estimator, its confidence, what to do, and the signals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...estimator.estimator import KnownJoint
from ...models.command_lines import command_line
from ...models.parameters import as_floats
from ..numbers import number
from ..report import listed
from ..style import FILTERS
from ..tables import COLUMNS, RAW_MODEL, comparison_rows, doubts, marked, misjudged
from .chart import WIDTH, Chart, limits, response_context
from .rendering import fingerprint, render

if TYPE_CHECKING:
    from ...diagnosis.bode import Response
    from ...scenarios.run import Run

_NEAR = 1.25  # errors within this ratio are equal, as the noise of a run is drawn once


def runs_html(
    runs: Sequence[tuple[Run, Path]], arm: Path | None = None, responses: Sequence[Response | None] = ()
) -> str:
    """Return the page as text, one file without references to others. `runs`: with their folders, each of another
    scenario; `arm`: folder of an arm's run, if they are its joints; `responses`: frequency response of each, None
    without enough excitation."""
    names = list(dict.fromkeys(name for run, _ in runs for name in run.estimates))
    named = {run.name if arm is None else folder.name: run for run, folder in runs}
    kinds, common = line_kinds(names), _common(named, names)
    means = _means(common.values(), names)
    closest = [*(name for name, _ in means), *names, "RAREKF"][0]
    scenarios = [
        _scenario(name, run, kinds, arm is not None) | {"response": response_context(response)}
        for (name, run), response in zip(named.items(), responses or [None] * len(runs), strict=True)
    ]
    title = " and ".join(run.name for run, _ in runs) if len(runs) < 3 else f"{len(runs)} scenarios"
    context = {
        "title": title if arm is None else arm.resolve().name,
        "arm": arm is not None,
        "joints": list(dict.fromkeys(run.joint.name for run, _ in runs)),
        "sentence": _verdict(named, names, "scenarios" if arm is None else "joints"),
        "scenarios": scenarios,
        "means": means if len(runs) > 1 else [],
        "common": len(common),
        "seeds": sorted({run.scenario.seed for run, _ in runs}),
        "knowledge": _knowledge(named, arm is not None),
        "honest": _honest(named),
        "notes": [(name, note) for name, run in named.items() for note in run.notes],
        "commands": _commands(*runs[0], closest) if arm is None else _arm_commands(runs, arm),
        "columns": COLUMNS,
        "data": [
            (run.name, len(run.time), run.joint.name, run.scenario.seed, fingerprint(run.as_recording()), str(folder))
            for run, folder in runs
        ],
    }
    return render("run.html.j2", context)


def line_kinds(names: Sequence[str]) -> dict[str, str]:
    """Return the style class of each filter's lines; 32 are different, and the paper's are the same on every page."""
    own = {name: f"s{i}" for i, name in enumerate(FILTERS)}
    spare = itertools.cycle(f"s{i}" for i in range(len(own), 32))
    return own | {name: next(spare) for name in names if name not in own}


def _error(run: Run, name: str) -> float:
    value = run.metrics["filters"].get(name, {}).get("rms")
    return float(value) if value is not None else math.nan


def _common(runs: Mapping[str, Run], names: Sequence[str]) -> dict[str, Run]:
    """Runs in which all estimators have an error, if they have one in any run."""
    there = [name for name in names if any(_error(run, name) > 0 for run in runs.values())]
    return {key: run for key, run in runs.items() if there and all(_error(run, name) > 0 for name in there)}


def _means(runs: Collection[Run], names: Sequence[str]) -> list[tuple[str, float]]:
    """Geometric mean over the scenarios of each estimator's error [N·m], the smallest first, without untrusted estimators."""
    found = []
    for name in names:
        errors = np.array([_error(run, name) for run in runs])
        if any(name in run.metrics["untrusted"] for run in runs):
            continue
        if len(errors) and np.all(np.isfinite(errors)) and np.all(errors > 0):
            found.append((name, float(np.exp(np.mean(np.log(errors))))))
    return sorted(found, key=lambda one: one[1])


def _verdict(runs: Mapping[str, Run], names: Sequence[str], of: str) -> str:
    """The closest estimator in a sentence, over the runs with all estimators, or in each run."""
    common = _common(runs, names)
    if not common:
        each = [(name, _means([run], names)) for name, run in runs.items()]
        best = [f"in {name} {rank[0][0]} with {number(rank[0][1], 2)} N·m RMS" for name, rank in each if rank]
        if not best:
            return f"No estimator has an error in any of these {of}."
        return f"None of these {of} has all estimators. Closest to the true joint torque is {', '.join(best)}."
    ranked = _means(common.values(), names)
    if not ranked:
        return f"No estimator is to be trusted in all of these {of}."
    (best_name, error), rest = ranked[0], ranked[1:]
    over = f" (geometric mean over {len(common)} {of})" if len(common) > 1 else ""
    if len(common) < len(runs):
        over += f", in {listed([*common])}: the other {of} lack estimators"
    text = f"{best_name} is closest to the true joint torque: {number(error, 2)} N·m RMS{over}"
    near = [name for name, other in rest if other < _NEAR * error]
    if near:
        text += f", {', '.join(near)} as good on a single run"
    far = rest[-1] if rest else None
    if far is not None and far[0] not in near:
        text += f"; {far[0]}, the farthest, has {number(far[1], 2)} N·m"
    return f"{text}."


def _knowledge(runs: Mapping[str, Run], arm: bool) -> str:
    """Whether the estimators know the simulated joint exactly, and in which of several runs."""
    exact = [name for name, run in runs.items() if _known_exactly(run, arm)]
    other = [name for name in runs if name not in exact]
    if not other:
        return "The estimators know the simulated joint exactly: expect larger errors on a real joint."
    if not exact:
        return "The estimators do not know the simulated joint exactly."
    return (
        f"The estimators know the simulated joint exactly in {listed(exact)} (expect larger errors on a real joint), "
        f"but not in {listed(other)}."
    )


def _known_exactly(run: Run, arm: bool) -> bool:
    """Whether the estimators know every number of the simulated joint, its load and its sensors."""
    true, known = (KnownJoint.of(joint, run.scenario.mount(joint)) for joint in (run.joint, run.known_joint))
    same = np.array_equal(as_floats(true.record), as_floats(known.record)) and true.rated_torque == known.rated_torque
    # In an arm, the load includes the other joints; the joint's mounting is a part of it.
    mounted = not arm or run.joint.mountings == run.known_joint.mountings
    carried = run.scenario.known_payloads or not (run.scenario.payloads or arm)
    return same and true.noise == known.noise and mounted and carried


def _honest(runs: Mapping[str, Run]) -> dict[str, list[tuple[str, str, float]]]:
    """Estimators with a wrong variance, by direction: scenario, name, mean NIS."""
    found: dict[str, list[tuple[str, str, float]]] = {}
    for scenario, run in runs.items():
        for name, nis in misjudged(run.metrics).items():
            found.setdefault("more" if nis > 1 else "less", []).append((scenario, name, nis))
    return found


def _commands(run: Run, folder: Path, chosen: str) -> list[tuple[str, str]]:
    why, scenario = "for this motion", folder / "scenario.yaml"
    if off := misjudged(run.metrics):
        chosen, nis = next(iter(off.items()))  # the farthest off
        why = f"for this joint and motion: its mean NIS is {number(nis, 2)}"
    bound = "compares each estimator with the Cramér-Rao bound, with intervals"
    return [
        (command_line("view", folder), "shows the joint in motion, estimates and innovations"),
        (command_line("bound", scenario, "--seeds", 10), bound),
        (command_line("tune", scenario, "--filter", chosen, "--out", "tuned"), f"tunes {chosen} {why}"),
    ]


def _arm_commands(runs: Sequence[tuple[Run, Path]], arm: Path) -> list[tuple[str, str]]:
    run, folder = runs[-1]
    diagnose = command_line("diagnose", folder / f"{run.name}.yaml", "--out", "diagnosis")
    again = command_line("run", arm / "arm.yaml", "--seed", 2, "--out", "again")
    return [
        (command_line("view", *(place for _, place in runs)), "shows every joint's motion, estimates and innovations"),
        (again, "runs the same arm with other noise"),
        (diagnose, f"diagnoses {folder.name} by its sensors in the arm"),
    ]


def _scenario(name: str, run: Run, kinds: dict[str, str], joint: bool) -> dict[str, Any]:
    metrics = run.metrics
    rows = [(marked(n, metrics), kinds.get(n, "measured"), cells) for _, n, *cells in comparison_rows({name: metrics})]
    doubted = {RAW_MODEL, *(marked(n, metrics) for n in metrics["untrusted"])}
    own = [row for row in rows if row[0] not in doubted]
    best = {
        k: min(own, key=lambda row: float(row[2][k]))[0]
        for k, column in enumerate(COLUMNS)
        if column.key in ("rms", "max", "noise_ratio") and all(row[2][k] != "–" for row in own) and len(own) > 1
    }
    return {
        "name": name,
        "description": "" if joint else run.scenario.description,
        "span": _span(run),
        "joint": run.joint.name,
        "duration": run.scenario.duration,
        "seed": run.scenario.seed,
        "rows": rows,
        "doubts": doubts({name: metrics}),
        "best": best,
        "legend": [
            ("after", "true"),
            ("measured", "torque sensor"),
            *((kinds[n], marked(n, metrics)) for n in run.estimates),
        ],
        "charts": _charts(run, kinds),
    }


def _span(run: Run) -> str:
    angle, torque = np.degrees(run.truth("link_position")), run.truth("joint_torque")
    return (
        f"link {number(round(angle.min()) + 0.0)}° to {number(round(angle.max()) + 0.0)}°, "
        f"joint torque {number(torque.min(), 2)} to {number(torque.max(), 2)} N·m"
    )


def _charts(run: Run, kinds: dict[str, str]) -> list[list[Chart]]:
    time, truth = run.time, run.truth("joint_torque")
    settled = time >= run.scenario.transient
    x = (float(time[0]), float(time[-1]))
    torque = Chart(x, limits(truth, 0.0), "joint torque", ylabel="N·m", width=WIDTH, height=220)
    torque.line(time, run.reading("joint_torque"), "measured thin")
    for name in run.estimates:
        torque.line(time, run.estimate(name), kinds[name])
    torque.line(time, truth, "after")
    errors = {name: run.estimate(name) - truth for name in run.estimates}
    all_errors = np.concatenate([e[settled] for e in errors.values()]) if errors else truth * 0
    error = Chart(x, limits(all_errors, 0.1, 0.1), "estimate − true", "time [s]", "N·m", width=WIDTH, height=200)
    for name, values in errors.items():
        error.line(time, values, f"{kinds[name]} thin")
    angle, current, external = np.degrees(run.truth("link_position")), run.reading("motor_current"), run.external_torque
    position = Chart(x, limits(angle, 0.0), "link angle", ylabel="°", width=WIDTH, height=150)
    if run.position_command is not None:
        position.line(time, np.degrees(run.position_command), "measured thin")
    drive = Chart(x, limits(current, 0.1), "motor current", "", "A", width=WIDTH, height=130)
    push = Chart(x, limits(external, 0.0, least=0.1), "external torque", "time [s]", "N·m", width=WIDTH, height=140)
    position.line(time, angle, "after")
    drive.line(time, current, "measured thin")
    push.line(time, external, "backward")
    return [[torque, error], [position, drive, push]]
