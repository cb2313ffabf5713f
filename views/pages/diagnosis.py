"""The page of a diagnosis: one HTML file for a colleague who knows joints, not this program.

It begins with what was found, how sure that is and what to do now; behind that stand the measured and simulated signals,
what the residuals depend on, what it is worth, what the measurement cannot tell, and how the numbers were obtained.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...models import causes, plugins
from ...models.command_lines import checking, mending
from ...models.files import write_into_place
from ..glossary import meaning, pieces
from ..report import Report, further_reasons, listed, look_alikes, plain, title, verdict_sentence
from ..residuals import balances, overlays
from . import residual_charts
from .provenance import provenance
from .rendering import number, percent, render, squeezed, with_std

if TYPE_CHECKING:
    from ...diagnosis.answer import Diagnosis, Finding
    from ...diagnosis.data.mistakes import Mistake
    from ...diagnosis.search.explore import Decision

UNIT = "N·m"
NOISY = 1.6
"""A residual this many times its noise is more than noise."""
SHOWN = 4
"""How many numbers that moved are named at the head of the page."""


@dataclass(frozen=True)
class Compared:
    """A quantity before and after beside its noise, all in one unit, for a row with bars."""

    name: str
    unit: str
    before: float
    after: float
    noise: float

    @property
    def change(self) -> str:
        """After relative to before."""
        return percent(self.after / self.before - 1, sign=True) if self.before > 0 else "–"

    def width(self, value: float) -> float:
        """Length of a bar as a share of the longest, in percent."""
        return round(100 * value / (max(self.before, self.after, self.noise) or 1.0), 1)


@dataclass(frozen=True)
class Moved:
    """A number that calibration moved; `deviations`: by how many standard deviations of its tolerance."""

    name: str
    meaning: str
    nominal: str
    value: str
    deviations: float


def write_report(report: Report, path: Path) -> Path:
    """Write the page.

    Args:
      report: what it shows.
      path: of the HTML file, moved into place when complete.

    Raises:
      InputError: the file cannot be written.
    """
    with write_into_place(path) as temporary:
        temporary.write_text(html(report), encoding="utf-8")
    return path


def html(report: Report) -> str:
    """The page as text: one file that refers to nothing outside itself."""
    return squeezed(render("diagnosis.html.j2", context(report)))


def context(report: Report) -> dict[str, Any]:
    """What the template is filled with."""
    d = report.diagnosis
    found = balances(report)
    channels = [Compared(plain(name), x.unit, x.before, x.after, x.noise) for name, x in d.residual.items()]
    gained = report.improvement
    errors = gained.errors.items() if gained is not None else ()
    estimators = [Compared(name, UNIT, *pair, gained.noise if gained else 0.0) for name, pair in errors]
    moved = list(_moved(report))
    return {
        "name": report.measurement.name,
        "joint": report.joint.name,
        "verdict": d.verdict,
        "sentence": verdict_sentence(d),
        "reasons": further_reasons(d),
        "share": d.share,
        "tared": d.extended.sensors.link_encoder.zero != report.joint.sensors.link_encoder.zero,
        "mistakes": [_mistake(m) for m in d.mistakes],
        "mendable": d.mendable,
        "lost": any(m.lost for m in d.mistakes),
        "computed": d.problem is not None,
        "both_ends": d.problem is not None and d.problem.link_measured,
        "recordings": [(r.name, float(r.time[-1] - r.time[0])) for r in report.measurement.recordings],
        "rate": 1 / report.measurement.recordings[0].interval,
        "sensor": any("joint_torque" in r for r in report.measurement.recordings),
        "both": all("motor_position" in r and "link_position" in r for r in report.measurement.recordings),
        "current": any("motor_current" in r or "motor_torque" in r for r in report.measurement.recordings),
        "seconds": d.seconds,
        "head": _head(report, channels, estimators, moved),
        "causes": [_cause(report, c) for c in d.causes],
        "minor": [_cause(report, c) for c in d.minor],
        "decisions": _decisions(d),
        "regressions": d.regressions,
        "overlays": residual_charts.over_time(overlays(report)),
        "told": residual_charts.told(found),
        "balances": residual_charts.by_variable(found),
        "channels": channels,
        "regions": [(r.name, r.described, r.extended, r.unseen, r.ratio, r.worse) for r in d.regions],
        "valid": _valid(d),
        "estimators": estimators,
        "improvement": gained,
        "trace": residual_charts.trace(gained) if gained is not None else None,
        "moved": moved,
        "confusable": d.confusable,
        "alike": [(plain(name), [plain(other) for other in others]) for name, others in look_alikes(d.confusable)],
        "undetermined": [(plain(n), causes.get(n).component, reason) for n, reason in d.undetermined.items()],
        "plan": _plan(report),
        "fitted": d.problem.calibration.size if d.problem is not None else 0,
        "library": len(causes.of(report.joint)),
        "held_out": d.held_out,
        "provenance": provenance(report.measurement),
    }


# The head: what was found, how sure, what to do now


def _head(report: Report, channels: list[Compared], estimators: list[Compared], moved: list[Moved]) -> dict[str, Any]:
    d = report.diagnosis
    known = set(causes.of(report.joint))
    worst = d.regions[0] if d.regions else None
    main = report.improvement.main if report.improvement is not None else ""
    return {
        "moved": len(moved),
        "most": sorted(moved, key=lambda m: -abs(m.deviations))[:SHOWN],
        "main": next((e for e in estimators if e.name == main), None),
        "shown": len(known - set(d.undetermined)),
        "known": len(known),
        "left": [(c.name, c.after / c.noise) for c in channels if c.noise > 0],
        "loud": any(c.after > NOISY * c.noise for c in channels),
        "worst": worst,
        "commands": _commands(report),
        "next": _best(report),
    }


def _mistake(m: Mistake) -> dict[str, Any]:
    """A mistake in the data with the change that mends it."""
    mends = m.remedy if m.lost else m.change if m.sure else f"most: {m.change}"
    return {
        "name": plain(m.name), "column": m.columns, "recording": m.recording,
        "text": m.description, "mends": mends, "confidence": m.confidence, "severe": m.severe,
    }  # fmt: skip


def _valid(d: Diagnosis) -> list[tuple[str, str, str, str]]:
    """Where the data have been: variable, from, to, unit."""
    valid = d.extended.valid
    if valid is None:
        return []
    rows = (
        ("link angle", valid.link_position, "rad"),
        ("link velocity", valid.link_velocity, "rad/s"),
        ("joint torque", valid.joint_torque, "N·m"),
    )
    return [(name, number(low, 3), number(high, 3), unit) for name, (low, high), unit in rows]


def _commands(report: Report) -> dict[str, str]:
    """Command lines that use the extended joint, to copy."""
    folder = shlex.quote(report.folder.as_posix()) if report.folder is not None else "DIR"
    joint = f"{folder}/joint.yaml"
    measured = shlex.quote(Path(report.measurement.path).as_posix())
    mounting = "" if "link" in report.joint.mountings else f" --set mounting={shlex.quote(report.joint.mounting)}"
    return {
        "folder": folder,
        "measured": measured,
        "run": f"flexspline run link_sweep --set joint={joint}{mounting}{plugins.options()}",
        "estimate": f"flexspline estimate {measured} --joint {joint} --out estimates{plugins.options()}",
        "validate": f"flexspline validate NEW_MEASUREMENT --joint {joint} --out check{plugins.options()}",
        "check": checking(report.measurement, report.joint),
        "mend": mending(report.measurement, report.joint),
    }


def _best(report: Report) -> dict[str, Any] | None:
    """The experiment that is expected to tell most, if any tells something."""
    plan = report.plan
    best = plan.proposals[0] if plan is not None and plan.proposals else None
    if plan is None or best is None:
        return None
    return {"motion": best, "tells": plan.sentence(best), "decides": listed([q.text for q in plan.answered(best)])}


# Causes


def _cause(report: Report, c: Finding) -> dict[str, Any]:
    text = c.description if c.name == "unknown" else causes.get(c.name).description
    rows = []
    for name, p in c.parameters.items():
        q = next(q for q in causes.get(c.name).parameters if q.name == name)
        unit = float(report.joint.record()[0][q.relative]) if q.relative else 1.0
        ordinary = " or ".join(f"{number(a * unit, 3)} … {number(b * unit, 3)}" for a, b in q.ordinary)
        rows.append(
            (plain(name), with_std(p.value, p.std, p.unit), "chosen among whole numbers" if q.integer else ordinary)
        )
    return {
        "title": title(c),
        "component": c.component,
        "text": text,
        "symbols": {piece: told for piece, told in pieces(text) if told},
        "confidence": c.confidence,
        "explains": c.explains,
        "worth": c.worth,
        "of": "simulation error" if np.isnan(c.estimation) else "simulation and estimation error",
        "parameters": rows,
    }


_STAGES = {"add": "a cause more", "drop": "a cause less", "swap": "in another's place"}


def _decisions(d: Diagnosis) -> list[dict[str, Any]]:
    """What became of every proposal: those that were taken first, of a cause's others the best of each kind of proposal."""
    best: dict[tuple[str, str, str | None], list[Decision]] = {}
    for x in d.decisions:
        best.setdefault((x.stage, x.cause, str(x.fixed) if x.taken else None), []).append(x)
    rows: dict[tuple[str, ...], dict[str, Any]] = {}
    for alike in best.values():
        x = max(alike, key=lambda x: x.gain if np.isfinite(x.gain) else -np.inf)
        row = {
            "cause": plain(x.cause) + "".join(f" ({k} {v:g})" for k, v in x.fixed.items()),
            "others": len(alike) - 1,
            "gain": f"{x.gain:.0f}".replace("-", "−") if np.isfinite(x.gain) else "–",
            "taken": x.taken,
            "reason": re.sub(r"(?<![\w.])-(?=\d)", "−", x.reason),
        }
        kept = rows.setdefault(tuple(map(str, row.values())), row | {"stages": [], "order": x.gain})
        kept["stages"].append(_STAGES.get(x.stage, x.stage))
    return sorted(rows.values(), key=lambda row: (not row["taken"], -np.nan_to_num(row["order"])))


# Calibration, limits, plan


def _moved(report: Report) -> Iterator[Moved]:
    for name, m in report.diagnosis.calibration.items():
        yield Moved(name, meaning(name), with_std(m.nominal, 0.0, m.unit), with_std(m.value, m.std, m.unit), m.moved)


def _plan(report: Report) -> dict[str, Any] | None:
    plan = report.plan
    if plan is None:
        return None
    return {
        "best": _best(report),
        "motions": [(plain(p.name), p.duration, plan.sentence(p)) for p in plan.proposals],
        "questions": [
            (q.text, q.needed, q.now, [(p.expected[i], p.expected[i] >= q.needed) for p in plan.proposals])
            for i, q in enumerate(plan.questions)
        ],
    }
