"""The page of a diagnosis: one HTML file for a colleague who knows joints, not this program.

It begins with what is wrong, how grave it is, how sure, and what to do. Then come the signals, the residuals, the errors on
held-out data, what the measurement does not show, and how the numbers were obtained.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...models import causes, plugins
from ...models.characteristics import drive_gains
from ...models.command_lines import checking, mending
from ..advice import advice, parameter_text
from ..glossary import meaning, pieces
from ..numbers import number, percent, with_std
from ..report import (
    Report,
    confused_with,
    further_reasons,
    gravity_sentence,
    held_out_rows,
    plain,
    share_line,
    title,
    verdict_sentence,
)  # fmt: skip
from ..residuals import balances, overlays
from . import residual_charts
from .chart import response_context
from .rendering import fingerprint, render

if TYPE_CHECKING:
    from ...diagnosis.answer import Diagnosis, Finding
    from ...diagnosis.search.explore import Decision

NOISY = 1.6  # A residual this many times its noise is more than noise
SHOWN = 4  # number of calibrated numbers that the head of the page lists


@dataclass(frozen=True)
class Compared:
    """Errors before and after, and the noise, in one unit: a row with bars."""

    name: str
    before: float
    after: float
    noise: float
    unit: str

    @property
    def change(self) -> str:
        """After relative to before."""
        return percent(self.after / self.before - 1, sign=True) if self.before > 0 else "–"

    def width(self, value: float) -> float:
        """Length of a bar as a share of the longest, in percent."""
        return round(100 * value / (max(self.before, self.after, self.noise) or 1.0), 1)


def html(report: Report) -> str:
    """Return the page as text: one file without references to others."""
    d, gained, recordings = report.diagnosis, report.improvement, report.measurement.recordings
    found = balances(report)
    rows = [Compared(*row) for row in held_out_rows(d, None)]
    noise = gained.noise if gained is not None else 0.0
    errors = gained.errors.items() if gained is not None else ()
    estimators = [Compared(name, *pair, noise, "N·m") for name, pair in errors]
    moved = [
        (name, meaning(name), with_std(m.nominal, 0.0, m.unit), with_std(m.value, m.std, m.unit), m.moved)
        for name, m in d.calibration.items()
    ]
    context = {
        "d": d,
        "name": report.measurement.name,
        "joint": report.joint.name,
        "sentence": verdict_sentence(d),
        "gravity": gravity_sentence(d, gained),
        "reasons": further_reasons(d),
        "zeroed": d.extended.sensors.link_encoder.zero != report.joint.sensors.link_encoder.zero,
        "lost": any(m.lost for m in d.mistakes),
        "computed": d.problem is not None,
        "both_ends": d.problem is not None and d.problem.link_measured,
        "recordings": [(r.name, float(r.time[-1] - r.time[0])) for r in recordings],
        "rate": 1 / recordings[0].interval,
        "sensor": any("joint_torque" in r for r in recordings),
        "both": all("motor_position" in r and "link_position" in r for r in recordings),
        "current": any("motor_current" in r or "motor_torque" in r for r in recordings),
        "most": sorted(moved, key=lambda m: -abs(m[-1]))[:SHOWN],
        "main": next((e for e in estimators if gained is not None and e.name == gained.main), None),
        "left": [(c.name, c.after / c.noise) for c in rows if c.noise > 0],
        "loud": any(c.after > NOISY * c.noise for c in rows),
        "commands": _commands(report),
        "next": next(iter(report.plan.proposals), None) if report.plan is not None else None,
        "causes": [_cause(report, c) for c in d.causes],
        "minor": [_cause(report, c) for c in d.minor],
        "decisions": _decisions(d),
        "overlays": residual_charts.over_time(overlays(report)),
        "main_variable": residual_charts.main_variable(found),
        "balances": residual_charts.by_variable(found),
        "measured_response": response_context(report.response),
        "channels": rows,
        "estimators": estimators,
        "improvement": gained,
        "trace": residual_charts.trace(gained) if gained is not None else None,
        "moved": moved,
        "confused": confused_with(d.confusable),
        "undetermined": [(plain(n), causes.get(n).component, reason) for n, reason in d.undetermined.items()],
        "plan": report.plan,
        "library": len(causes.of(report.joint)),
        "data": [(r.name, len(r.time), ", ".join(r.columns), fingerprint(r)) for r in recordings],
    }  # fmt: skip
    return render("diagnosis.html.j2", context)


def _commands(report: Report) -> dict[str, str]:
    mounting = "" if "link" in report.joint.mountings else f" --set mounting={shlex.quote(report.joint.mounting)}"
    sets = f"--set joint={report.extended}{mounting}{_gains(report)}"
    return {
        "folder": "DIR" if report.folder is None else report.folder.as_posix(),
        "run": f"flexspline run link_sweep {sets}{plugins.options()}",
        "estimate": report.estimating,
        "validate": report.validating,
        "check": checking(report.measurement, report.joint),
        "mend": mending(report.measurement, report.joint),
    }


def _gains(report: Report) -> str:
    """Options with the controller's gains for a joint that has none in its file."""
    if report.joint.name == "test-joint" or report.joint.controller is not None:
        return ""
    kp, kd = drive_gains(report.joint)
    return f" --set controller.kp={kp:.2g} --set controller.kd={kd:.2g}"


def _cause(report: Report, c: Finding) -> dict[str, Any]:
    joint = report.diagnosis.extended
    text = c.description if c.name == "unknown" else causes.get(c.name).description
    rows = []
    for name in c.parameters:
        q = next(q for q in causes.get(c.name).parameters if q.name == name)
        unit = float(report.joint.record()[0][q.relative]) if q.relative else 1.0
        ordinary = " or ".join(f"{number(a * unit, 3)} … {number(b * unit, 3)}" for a, b in q.ordinary)
        rows.append((plain(name), parameter_text(name, c, joint), "a whole number" if q.integer else ordinary))
    return {
        "title": title(c),
        "component": c.component,
        "text": text,
        "advice": advice(c, joint),
        "size": share_line(c, report.diagnosis),
        "symbols": {piece: words for piece, words in pieces(text) if words},
        "confidence": c.confidence,
        "explains": c.explains,
        "contribution": c.contribution,
        "of": "simulation error" if np.isnan(c.estimation) else "simulation and estimation error",
        "parameters": rows,
    }


_STAGES = {"add": "a cause more", "drop": "a cause less", "swap": "in another's place"}


def _decisions(d: Diagnosis) -> list[dict[str, Any]]:
    """Every step of the search: those that were taken first, of the others of a cause the best of each kind."""
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
