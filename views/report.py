"""What a report of a diagnosis holds, and its verdict in words; pages and recordings are made of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..models import causes

if TYPE_CHECKING:
    from ..diagnosis.answer import Diagnosis, Finding
    from ..diagnosis.improvement import Improvement
    from ..diagnosis.planning import Plan
    from ..models.joint import Joint
    from ..models.recording import Measurement


@dataclass(frozen=True)
class Report:
    """What a report shows.

    Attributes:
      measurement, joint: what was measured, and the description that diagnosis was given.
      diagnosis, improvement, plan: what came out; no plan where none was asked for or nothing was computed.
      folder: where the report lies, as one would type it; `DIR` where that is not known.
    """

    measurement: Measurement
    joint: Joint
    diagnosis: Diagnosis
    improvement: Improvement | None = None
    plan: Plan | None = None
    folder: Path | None = None


def look_alikes(pairs: Sequence[Sequence[str]]) -> list[tuple[str, list[str]]]:
    """Pairs of causes that look alike, by cause: first the one that most look like, with those; each pair once."""
    left, found = [tuple(pair) for pair in pairs], []
    while left:
        counts = Counter(name for pair in left for name in pair)
        most = max(counts, key=lambda name: counts[name])
        found.append((most, [a if b == most else b for a, b in left if most in (a, b)]))
        left = [pair for pair in left if most not in pair]
    return found


def verdict_sentence(d: Diagnosis) -> str:
    """The verdict in one sentence; why else, and what holds it back, is `further_reasons`."""
    if d.verdict == "inconclusive":
        reason = f": {d.reasons[0]}" if d.reasons else ""
        return f"This measurement cannot tell{reason}."
    if not d.causes:
        blind = len(d.undetermined)
        left = f"; {blind} cause{'s' if blind > 1 else ''} could not have shown" if blind else ""
        return f"The joint behaves as its description says, within its tolerances{left}."
    parts = [f"{title(c)} ({c.component}, {100 * c.confidence:.0f} % sure)" for c in d.causes]
    whole = min(sum(c.explains for c in d.causes), 1.0)
    return (
        f"The joint differs from its description by {listed(parts)}, which "
        f"{'explains' if len(parts) == 1 else 'explain'} {100 * whole:.0f} % of what calibration leaves."
    )


def further_reasons(d: Diagnosis) -> tuple[str, ...]:
    """A diagnosis's reasons beside the one that its verdict in a sentence has."""
    return d.reasons[1:] if d.verdict == "inconclusive" else d.reasons


def title(c: Finding) -> str:
    """A cause's name for people."""
    return "an effect that no known cause explains" if c.name == "unknown" else plain(c.name)


def plain(name: str) -> str:
    """A name for people."""
    return name.replace("_", " ")


def listed(parts: list[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join([*([", ".join(parts[:-1])] if len(parts) > 1 else []), *parts[-1:]])


def markdown(report: Report) -> str:
    """The verdict and its tables, short, in Markdown."""
    d = report.diagnosis
    lines = [f"# {d.verdict}", verdict_sentence(d), "", *(f"- {reason}" for reason in further_reasons(d)), ""]
    for m in d.mistakes:
        lines.append(f"- mistake in the data, {plain(m.name)}: {m.description}")
    for c in d.causes:
        lines.append(f"## {title(c)}")
        lines.append(c.description or causes.get(c.name).description)
        lines += [f"- {name}: {p.value:.4g} ± {p.std:.2g} {p.unit}" for name, p in c.parameters.items()]
    if d.minor:
        lines += ["", "There, but no causes of their own: " + ", ".join(title(c) for c in d.minor)]
    if d.residual:
        lines += ["", "## Held out", "| channel | before | after | noise |", "|---|---:|---:|---:|"]
        lines += [f"| {k} [{x.unit}] | {x.before:.4g} | {x.after:.4g} | {x.noise:.4g} |" for k, x in d.residual.items()]
    if d.regions:
        lines += ["", "## Not seen by the fit [N·m]", "| region | described | extended |", "|---|---:|---:|"]
        lines += [f"| {r.name} | {r.described:.3g} | {r.unseen:.3g} |" for r in d.regions]
    if report.improvement is not None:
        lines += ["", "## Torque error [N·m]", "| estimator | before | after |", "|---|---:|---:|"]
        lines += [f"| {k} | {a:.3f} | {b:.3f} |" for k, (a, b) in report.improvement.errors.items()]
    if d.confusable:
        groups = (f"{name} from {', '.join(others)}" for name, others in look_alikes(d.confusable))
        lines += ["", "Cannot be told apart: " + "; ".join(groups)]
    if d.undetermined:
        lines += ["", "Could not have shown: " + ", ".join(d.undetermined)]
    lines += ["", "*simulated*: the calibrated joint; *extended*: with the causes in it."]
    return "\n".join(lines)
