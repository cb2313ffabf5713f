"""The page of a diagnosis: one HTML file for a colleague who knows joints, not this program.

It begins with what was found, how sure that is and what to do now; behind that stand the measured and simulated signals,
what the residuals depend on, what it is worth, what the measurement cannot tell, and how the numbers were obtained.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...diagnosis.coverage import undetermined as coverage
from ...diagnosis.evidence import THRESHOLD
from ...models import causes
from ...models.files import write_into_place
from ..glossary import meaning, pieces
from ..report import Report, listed, plain, title, verdict_sentence
from ..residuals import balances, overlays
from . import residual_charts
from .provenance import provenance
from .rendering import number, percent, render, squeezed, with_std

if TYPE_CHECKING:
    from ...diagnosis.diagnose import Diagnosis, Finding

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
    gain = report.gain
    errors = gain.errors.items() if gain is not None else ()
    filters = [Compared(name, UNIT, before, after, gain.noise if gain else 0.0) for name, (before, after) in errors]
    moved = list(_moved(d))
    return {
        "name": report.measurement.name,
        "joint": report.joint.name,
        "verdict": d.verdict,
        "sentence": verdict_sentence(d),
        "recordings": [(r.name, float(r.time[-1] - r.time[0])) for r in report.measurement.recordings],
        "rate": 1 / report.measurement.recordings[0].interval,
        "sensor": d.problem.has_torque,
        "seconds": report.seconds,
        "head": _head(report, channels, filters, moved),
        "causes": [_cause(report, c) for c in d.causes],
        "alternatives": list(_alternatives(d)),
        "threshold": THRESHOLD,
        "overlays": residual_charts.over_time(overlays(report)),
        "told": residual_charts.told(found),
        "balances": residual_charts.by_variable(found),
        "channels": channels,
        "filters": filters,
        "gain": gain,
        "trace": residual_charts.trace(gain) if gain is not None else None,
        "moved": moved,
        "confusable": [[plain(n) for n in pair] for pair in d.confusable],
        "undetermined": _undetermined(report),
        "plan": _plan(report),
        "fitted": d.problem.calibration.size,
        "library": len(causes.of(d.problem.joint)),
        "held_out": d.held_out,
        "provenance": provenance(report.measurement),
    }


# The head: what was found, how sure, what to do now


def _head(report: Report, channels: list[Compared], filters: list[Compared], moved: list[Moved]) -> dict[str, Any]:
    d = report.diagnosis
    known = len(causes.of(d.problem.joint))
    most = sorted(moved, key=lambda m: -abs(m.deviations))[:SHOWN]
    main = next((f for f in filters if f.name == (d.estimation or {}).get("filter")), filters[-1] if filters else None)
    return {
        "moved": len(moved),
        "most": most,
        "main": main,
        "shown": known - len(set(d.undetermined) & set(causes.of(d.problem.joint))),
        "known": known,
        "left": [(c.name, c.after / c.noise) for c in channels if c.noise > 0],
        "loud": any(c.after > NOISY * c.noise for c in channels),
        "commands": _commands(report),
        "next": _best(report),
    }


def _commands(report: Report) -> dict[str, str]:
    """Command lines that use the extended joint, to copy."""
    folder = shlex.quote(report.folder.as_posix()) if report.folder is not None else "DIR"
    joint = f"{folder}/joint.yaml"
    measured = shlex.quote(Path(report.measurement.path).as_posix())
    mounting = "" if "link" in report.joint.mountings else f" --set mounting={shlex.quote(report.joint.mounting)}"
    return {
        "folder": folder,
        "joint": joint,
        "run": f"flexspline run link_sweep --set joint={joint}{mounting}",
        "estimate": f"flexspline estimate {measured} --joint {joint} --out estimates",
        "diagnose": f"flexspline diagnose NEW_MEASUREMENT --joint {joint} --out check",
    }


def _best(report: Report) -> dict[str, Any] | None:
    """The motion that is expected to decide most, if any is expected to decide anything."""
    best = report.plan.proposals[0] if report.plan.proposals else None
    if best is None or not report.plan.answered(best):
        return None
    return {"motion": best, "decides": listed([q.text for q in report.plan.answered(best)])}


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
        "parameters": rows,
    }


def _alternatives(d: Diagnosis) -> Iterator[tuple[int, str, str, bool]]:
    """Round, cause, log evidence, whether it was taken: of every cause that was fitted."""
    for i, round_ in enumerate(d.rounds):
        chosen = d.rounds[i + 1].base.model[-1].cause.name if i + 1 < len(d.rounds) else None
        for fit, gain in zip(round_.fits, round_.gains, strict=True):
            h = fit.model[-1]
            name = plain(h.cause.name) + "".join(f" ({k} {v:g})" for k, v in h.fixed.items())
            taken = h.cause.name == chosen and gain == max(round_.gains)
            yield i + 1, name, f"{gain:.0f}".replace("-", "−"), taken


# Calibration, limits, plan


def _moved(d: Diagnosis) -> Iterator[Moved]:
    deviations = {}
    for slot in d.problem.calibration.slots:
        n = slot.number
        shared = d.problem.joint.shared_tolerances[n.shared] if n.shared else 0.0
        deviations[slot.name] = float(np.hypot(np.hypot(n.tolerance, shared) * abs(n.value), n.deviation))
    for name, m in d.calibration.items():
        prior = deviations.get(name, 0.0)
        yield Moved(
            name,
            meaning(name),
            with_std(m.nominal, 0.0, m.unit),
            with_std(m.value, m.std, m.unit),
            (m.value - m.nominal) / prior if prior > 0 else 0.0,
        )


def _undetermined(report: Report) -> list[tuple[str, str, str]]:
    """Cause, component, why it could not have shown."""
    names = [n for n in report.diagnosis.undetermined if n in causes.names()]
    reasons = coverage(report.measurement, report.joint) if names else {}
    weak = "too weak beside what the tolerances allow"
    return [(plain(n), causes.get(n).component, reasons.get(n, weak)) for n in names]


def _plan(report: Report) -> dict[str, Any]:
    plan = report.plan
    return {
        "needs_sensor": listed([plain(n) for n in plan.needs_sensor]),
        "best": _best(report),
        "motions": [(plain(p.name), p.duration, p.description) for p in plan.proposals],
        "questions": [
            (q.text, q.needed, q.now, [(p.expected[i], p.expected[i] >= q.needed) for p in plan.proposals])
            for i, q in enumerate(plan.questions)
        ],
    }
