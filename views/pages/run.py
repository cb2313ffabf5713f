"""The page of a run, or of several compared: which estimator is closest, how sure that is, what to do now; the signals."""

from __future__ import annotations

import itertools
import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...estimator.estimator import KnownJoint
from ...models import plugins
from ...models.parameters import as_floats
from ..numbers import number
from ..report import listed
from ..style import FILTERS
from ..tables import COLUMNS, RAW_MODEL, doubts, marked, misjudged
from .chart import Chart, limits
from .provenance import fingerprint
from .rendering import render

if TYPE_CHECKING:
    from ...scenarios.run import Run

_WIDTH = 540
_NEAR = 1.25
"""As much larger an error is no better or worse on a single run, whose noise is drawn once."""


def runs_html(runs: Sequence[tuple[Run, Path]], arm: Path | None = None) -> str:
    """Return the page as text: one file without references to others.

    Args:
      runs: with the folders that they were read from, each of another scenario.
      arm: folder of an arm's run, whose joints `runs` are, from the base to the tip.
    """
    return render("run.html.j2", _context(runs, arm))


def line_kinds(names: Sequence[str]) -> dict[str, str]:
    """Classes of each filter's lines in the style sheet, 32 of them different; the paper's have the same on every page."""
    own = {name: f"s{i}" for i, name in enumerate(FILTERS)}
    spare = itertools.cycle(f"s{i}" for i in range(len(own), 32))
    return own | {name: next(spare) for name in names if name not in own}


def _context(runs: Sequence[tuple[Run, Path]], arm: Path | None) -> dict[str, Any]:
    names = list(dict.fromkeys(name for run, _ in runs for name in run.estimates))
    kinds = line_kinds(names)
    scenarios = [_scenario(run, folder, kinds, arm is not None) for run, folder in runs]
    title = " and ".join(run.name for run, _ in runs) if len(runs) < 3 else f"{len(runs)} scenarios"
    return {
        "title": title if arm is None else arm.resolve().name,
        "arm": arm is not None,
        "joints": list(dict.fromkeys(run.joint.name for run, _ in runs)),
        "sentence": _verdict(runs, names, "scenarios" if arm is None else "joints"),
        "scenarios": scenarios,
        "means": _means(_common(runs, names), names) if len(runs) > 1 else [],
        "common": len(_common(runs, names)),
        "seeds": sorted({run.scenario.seed for run, _ in runs}),
        "told": _told(scenarios, runs, arm is not None),
        "honest": _honest(scenarios, runs),
        "notes": [(s["name"], note) for s, (run, _) in zip(scenarios, runs, strict=True) for note in run.notes],
        "commands": _commands(runs, names) if arm is None else _arm_commands(runs, arm),
        "columns": COLUMNS,
        "data": [
            (run.name, len(run.time), run.joint.name, run.scenario.seed, fingerprint(run.as_recording()), str(folder))
            for run, folder in runs
        ],
    }


def _error(run: Run, name: str) -> float:
    value = run.metrics["filters"].get(name, {}).get("rms")
    return float(value) if value is not None else math.nan


def _common(runs: Sequence[tuple[Run, Path]], names: Sequence[str]) -> list[tuple[Run, Path]]:
    """The runs in which every estimator that has an error in any of them has one: over others nothing can be compared."""
    there = [name for name in names if any(_error(run, name) > 0 for run, _ in runs)]
    return [one for one in runs if there and all(_error(one[0], name) > 0 for name in there)]


def _means(runs: Sequence[tuple[Run, Path]], names: Sequence[str]) -> list[tuple[str, float]]:
    """Geometric mean over the scenarios of each estimator's error [N·m], the smallest first; of those that are in all, and are to
    be trusted in all."""
    found = []
    for name in names:
        errors = np.array([_error(run, name) for run, _ in runs])
        if any(name in run.metrics["untrusted"] for run, _ in runs):
            continue
        if len(errors) and np.all(np.isfinite(errors)) and np.all(errors > 0):
            found.append((name, float(np.exp(np.mean(np.log(errors))))))
    return sorted(found, key=lambda one: one[1])


def _verdict(runs: Sequence[tuple[Run, Path]], names: Sequence[str], of: str) -> str:
    """Which estimator is closest, in a sentence: over the runs that have all of them, or in each."""

    def name_of(run: Run, folder: Path) -> str:
        return folder.name if of == "joints" else run.name

    common = _common(runs, names)
    if not common:
        each = [(name_of(run, folder), _means([(run, folder)], names)) for run, folder in runs]
        best = [f"in {name} {rank[0][0]} with {number(rank[0][1], 2)} N·m RMS" for name, rank in each if rank]
        if not best:
            return f"No estimator has an error in any of these {of}."
        return f"None of these {of} has all estimators; closest to the true joint torque is {', '.join(best)}."
    ranked = _means(common, names)
    if not ranked:
        return f"No estimator is to be trusted in all of these {of}."
    (best_name, error), rest = ranked[0], ranked[1:]
    over = f" (geometric mean over {len(common)} {of})" if len(common) > 1 else ""
    if len(common) < len(runs):
        where = listed([name_of(*one) for one in common])
        over += f", in {where}: the other {of} lack estimators"
    text = f"{best_name} is closest to the true joint torque: {number(error, 2)} N·m RMS{over}"
    near = [name for name, other in rest if other < _NEAR * error]
    if near:
        text += f", {', '.join(near)} as good on a single run"
    far = rest[-1] if rest else None
    if far is not None and far[0] not in near:
        text += f"; {far[0]}, the farthest, has {number(far[1], 2)} N·m"
    return f"{text}."


def _told(scenarios: Sequence[dict[str, Any]], runs: Sequence[tuple[Run, Path]], arm: bool) -> str:
    """What the estimators know of the joint, and in which of several runs, where they do not know as much in all."""
    exact: list[str] = []
    other: list[str] = []
    for s, (run, _) in zip(scenarios, runs, strict=True):
        (exact if _known_exactly(run, arm) else other).append(s["name"])
    if not other:
        return "The estimators are told the joint exactly as it is simulated: on a real joint, expect more error."
    if not exact:
        return "The estimators are told another joint than the one that is simulated."
    return (
        f"The estimators are told the joint exactly as it is simulated in {listed(exact)} (on a real joint, expect more error), "
        f"and another joint than the one that is simulated in {listed(other)}."
    )


def _known_exactly(run: Run, arm: bool) -> bool:
    """Whether the estimators are told every number of the joint, its load and its sensors as they are simulated; how sure of them
    they are told to be is none of these."""
    own, told = (KnownJoint.of(joint, run.scenario.mount(joint)) for joint in (run.joint, run.known_joint))
    same = np.array_equal(as_floats(own.record), as_floats(told.record)) and own.rated_torque == told.rated_torque
    # A run in an arm has the link that the others make of it, of which the joint's own mounting is a part.
    bolted = not arm or run.joint.mountings == run.known_joint.mountings
    return same and own.noise == told.noise and bolted


def _honest(
    scenarios: Sequence[dict[str, Any]], runs: Sequence[tuple[Run, Path]]
) -> dict[str, list[tuple[str, str, float]]]:
    """Estimators whose own variance is not right: which way, then scenario, name, mean NIS."""
    found: dict[str, list[tuple[str, str, float]]] = {}
    for s, (run, _) in zip(scenarios, runs, strict=True):
        for name, nis in misjudged(run.metrics).items():
            found.setdefault("more" if nis > 1 else "less", []).append((s["name"], name, nis))
    return found


def _commands(runs: Sequence[tuple[Run, Path]], names: Sequence[str]) -> list[tuple[str, str]]:
    """Command lines to go on with, and what they do."""
    folder = runs[0][1]
    place = shlex.quote(folder.as_posix())
    chosen = next((name for name, _ in _means(_common(runs, names), names)), None) or (names or ["RAREKF"])[0]
    why = "for this motion"
    for name, nis in misjudged(runs[0][0].metrics).items():  # the farthest off
        chosen, why = name, f"for this joint and motion: its mean NIS is {number(nis, 2)}"
        break
    scenario, own = f"{place}/scenario.yaml", plugins.options()
    return [
        (f"flexspline view {place}{own}", "looks at it: the joint in motion, estimates, innovations"),
        (f"flexspline bound {scenario} --seeds 10{own}", "says with intervals how far each is from what is possible"),
        (f"flexspline tune {scenario} --filter {chosen} --out tuned{own}", f"tunes {chosen} {why}"),
    ]  # fmt: skip


def _arm_commands(runs: Sequence[tuple[Run, Path]], arm: Path) -> list[tuple[str, str]]:
    """Likewise of an arm: with the other joints moving, which its joints' scenarios alone would not do."""
    places = [shlex.quote(folder.as_posix()) for _, folder in runs]
    own = shlex.quote((runs[-1][1] / f"{runs[-1][0].name}.yaml").as_posix())
    again, more = shlex.quote((arm / "arm.yaml").as_posix()), plugins.options()
    return [
        (f"flexspline view {' '.join(places)}", "looks at it: every joint's motion, estimates, innovations"),
        (f"flexspline run {again} --seed 2 --out again{more}", "moves the same arm with other noise"),
        (f"flexspline diagnose {own} --out diagnosis{more}", f"diagnoses {runs[-1][1].name} from its own sensors in the arm"),
    ]  # fmt: skip


def _scenario(run: Run, folder: Path, kinds: dict[str, str], joint: bool) -> dict[str, Any]:
    metrics = run.metrics
    entries = {RAW_MODEL: metrics["model"]} if metrics.get("model") else {}
    rows = []
    for name, values in (entries | dict(metrics["filters"])).items():
        rows.append((marked(name, metrics), kinds.get(name, "measured"), [column.text(values) for column in COLUMNS]))
    doubted = {RAW_MODEL, *(marked(name, metrics) for name in metrics["untrusted"])}
    own = [row for row in rows if row[0] not in doubted]
    best = {
        k: min(own, key=lambda row: float(row[2][k]))[0]
        for k, column in enumerate(COLUMNS)
        if column.key in ("rms", "max", "noise_ratio") and all(row[2][k] != "–" for row in own) and len(own) > 1
    }
    return {
        "name": folder.name if joint else run.name,
        "description": "" if joint else run.scenario.description,
        "span": _span(run),
        "joint": run.joint.name,
        "duration": run.scenario.duration,
        "seed": run.scenario.seed,
        "folder": str(folder),
        "rows": rows,
        "doubts": doubts({folder.name if joint else run.name: metrics}),
        "best": best,
        "legend": [
            ("after", "true"),
            ("measured", "torque sensor"),
            *((kinds[n], marked(n, metrics)) for n in run.estimates),
        ],
        "motion": [("after", "true"), ("measured", "measured"), ("backward", "external")],
        "charts": _charts(run, kinds),
    }


def _span(run: Run) -> str:
    """From where to where the link goes, and what torque the joint carries."""
    angle, torque = np.degrees(run.truth("link_position")), run.truth("joint_torque")
    return (
        f"link {number(round(angle.min()) + 0.0)}° to {number(round(angle.max()) + 0.0)}°, "
        f"joint torque {number(torque.min(), 2)} to {number(torque.max(), 2)} N·m"
    )


def _charts(run: Run, kinds: dict[str, str]) -> list[list[Chart]]:
    """Torques above their errors; beside them the motion, and what pushes."""
    time, truth = run.time, run.truth("joint_torque")
    settled = time >= run.scenario.transient
    x = (float(time[0]), float(time[-1]))
    torque = Chart(x, limits(truth, 0.0), "joint torque", ylabel="N·m", width=_WIDTH, height=220)
    torque.line(time, run.reading("joint_torque"), "measured thin")
    for name in run.estimates:
        torque.line(time, run.estimate(name), kinds[name])
    torque.line(time, truth, "after")
    errors = {name: run.estimate(name) - truth for name in run.estimates}
    all_errors = np.concatenate([e[settled] for e in errors.values()]) if errors else truth * 0
    error = Chart(x, limits(all_errors, 0.1, 0.1), "estimate − true", "time [s]", "N·m", width=_WIDTH, height=200)
    for name, values in errors.items():
        error.line(time, values, f"{kinds[name]} thin")
    angle = np.degrees(run.truth("link_position"))
    position = Chart(x, limits(angle, 0.0), "link angle", ylabel="°", width=_WIDTH, height=150)
    position.line(time, np.degrees(run.position_command), "measured thin")
    position.line(time, angle, "after")
    current = run.reading("motor_current")
    drive = Chart(x, limits(current, 0.1), "motor current", "", "A", width=_WIDTH, height=130)
    drive.line(time, current, "measured thin")
    external = run.external_torque
    push = Chart(x, limits(external, 0.0, least=0.1), "external torque", "time [s]", "N·m", width=_WIDTH, height=140)
    push.line(time, external, "backward")
    return [[torque, error], [position, drive, push]]
