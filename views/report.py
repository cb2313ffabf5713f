"""A diagnosis in words, the same for the terminal, the page and the recording."""

from __future__ import annotations

import math
import re
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..models import plugins
from .advice import advice, parameter_text
from .numbers import percent
from .tables import markdown_table

if TYPE_CHECKING:
    from ..diagnosis.answer import Diagnosis, Finding
    from ..diagnosis.bode import Response
    from ..diagnosis.improvement import Improvement
    from ..diagnosis.planning import Plan
    from ..models.joint import Joint
    from ..models.recording import Measurement

SHOWN = 3  # proposals and regions that are shown


@dataclass(frozen=True)
class Report:
    """What a report shows."""

    # measurement, joint: the measurement, and the description that the diagnosis started from
    measurement: Measurement
    joint: Joint
    # diagnosis, improvement, plan: results; None where they were not asked for or not computed
    diagnosis: Diagnosis
    improvement: Improvement | None = None
    plan: Plan | None = None
    folder: Path | None = None  # of the report, as one would type it; None where it is not known
    # frequency response, measured and of the extended joint; None without enough excitation
    response: Response | None = None

    @property
    def used(self) -> Measurement:
        """The parts of the measurement that the diagnosis used; its segments count these recordings."""
        return self.diagnosis.used or self.measurement

    @property
    def extended(self) -> str:
        """The file of the extended joint, quoted for a command line."""
        return f"{shlex.quote((self.folder or Path('DIR')).as_posix())}/joint.yaml"

    @property
    def estimating(self) -> str:
        """The command line that estimates torques of the measurement with the extended joint."""
        measured = shlex.quote(Path(self.measurement.path).as_posix())
        return f"flexspline estimate {measured} --joint {self.extended} --out estimates{plugins.options()}"

    @property
    def validating(self) -> str:
        """The command line that compares a new measurement with the extended joint."""
        return f"flexspline validate NEW_MEASUREMENT --joint {self.extended} --out check{plugins.options()}"


def verdict_sentence(d: Diagnosis) -> str:
    """Return the verdict in one sentence, with the physical meaning of each cause."""
    if d.verdict == "inconclusive":
        return f"This measurement is inconclusive{f': {d.reasons[0]}' if d.reasons else ''}."
    if not d.causes:
        blind = len(d.undetermined)
        rest = f"; {blind} cause{'s' if blind > 1 else ''} could not have shown" if blind else ""
        return f"The joint behaves as its description says, within its tolerances{rest}."
    text = listed([f"{advice(c, d.extended).sentence} ({percent(c.confidence)} sure)" for c in d.causes])
    return f"{text[:1].upper()}{text[1:]}."


def gravity_sentence(d: Diagnosis, gained: Improvement | None) -> str:
    """Return how grave the causes are: share of the error, of the rated torque, and of an estimator's error."""
    if not d.causes:
        return ""
    whole, one = min(sum(c.explains for c in d.causes), 1.0), len(d.causes) == 1
    largest = max(d.causes, key=lambda c: c.contribution)
    text = (
        f"{'This explains' if one else 'Together they explain'} {percent(whole)} of the error after calibration; "
        f"{'it' if one else title(largest)} makes the simulation wrong by {_torque(largest.contribution, d)}."
    )
    if gained is not None and gained.main in gained.errors:
        before, after = gained.errors[gained.main]
        text += f" The torque error of {plain(gained.main)} goes from {before:.3f} to {after:.3f} N·m with the extended joint."
    return text


def further_reasons(d: Diagnosis) -> tuple[str, ...]:
    """Return the reasons that `verdict_sentence` does not have."""
    return d.reasons[1:] if d.verdict == "inconclusive" else d.reasons


def share_line(c: Finding, d: Diagnosis) -> str:
    """Return confidence and size of a finding."""
    text = f"{percent(c.confidence)} sure, explains {percent(c.explains)}, {_torque(c.contribution, d)} of the simulation's error"
    return text + ("" if math.isnan(c.estimation) else f" and {c.estimation:.2g} N·m of the estimates'")


def _torque(value: float, d: Diagnosis) -> str:
    rated = d.extended.numbers["rated_torque"].value
    return f"{value:.2g} N·m RMS ({100 * value / rated:.2g} % of the rated torque)"


def advice_lines(c: Finding, d: Diagnosis) -> list[str]:
    """Return usual origin, check and remedy of a finding, a line each; none for a cause without advice."""
    found = advice(c, d.extended)
    named = (("usual origin", found.typical), ("check", found.check), ("remedy", found.do))
    return [f"{name}: {text}" for name, text in named if text]


def held_out_rows(d: Diagnosis, gained: Improvement | None) -> list[tuple[str, float, float, float, str]]:
    """Return name, errors before and after [unit], noise and unit, of every channel and estimator."""
    rows = [(plain(name), r.before, r.after, r.noise, r.unit) for name, r in d.residual.items()]
    if gained is not None:
        errors = gained.errors.items()
        rows += [(f"estimate, {plain(name)}", *pair, gained.noise, "N·m") for name, pair in errors]
    return rows


def confused_with(pairs: Sequence[Sequence[str]]) -> list[tuple[str, list[str]]]:
    """Group pairs of confused causes by the cause with most partners; each pair occurs once."""
    left, found = [tuple(pair) for pair in pairs], []
    while left:
        counts = Counter(name for pair in left for name in pair)
        most = max(counts, key=lambda name: counts[name])
        found.append((plain(most), [plain(a if b == most else b) for a, b in left if most in (a, b)]))
        left = [pair for pair in left if most not in pair]
    return found


def title(c: Finding) -> str:
    """Return a cause's name for people."""
    return "an effect that no known cause explains" if c.name == "unknown" else plain(c.name)


def plain(name: str) -> str:
    """Return a name without underscores."""
    return name.replace("_", " ")


def listed(parts: list[str]) -> str:
    """Return `a`, `a and b`, `a, b and c`."""
    return " and ".join([*([", ".join(parts[:-1])] if len(parts) > 1 else []), *parts[-1:]])


def markdown(report: Report) -> str:
    """Return the answer as Markdown: what is wrong, how grave it is, how sure, what to do; then the rest."""
    d, gained = report.diagnosis, report.improvement
    lines = [f"{d.verdict}: {verdict_sentence(d)}", "", gravity_sentence(d, gained), ""]
    lines += [f"- {reason}" for reason in further_reasons(d)]
    if d.mistakes:
        lines += ["", "## Mistakes in the data"]
    for m in d.mistakes:
        where = "".join(f"{x}, " for x in (m.recording, m.columns) if x)[:-2]
        text = f"{m.description} ({100 * m.confidence:.0f} % sure); {m.remedy}"
        lines.append(f"- {plain(m.name)}: {f'{where}: ' if where else ''}{text}")
    for heading, findings in (("Causes", d.causes), ("Minor effects", d.minor)):
        lines += ["", f"## {heading}"] if findings else []
        for c in findings:
            more = [c.description] if c.description else []
            more += [f"{name} = {parameter_text(name, c, d.extended)}" for name in c.parameters]
            more += advice_lines(c, d) if findings is d.causes else []
            lines += [f"- {title(c)} ({c.component}): {share_line(c, d)}", *(f"    - {line}" for line in more)]
    if d.residual:
        rows = [
            (name, f"{a:.3g}", f"{b:.3g}", f"{noise:.2g}" if noise else "–", u)
            for name, a, b, noise, u in held_out_rows(d, gained)
        ]
        lines += ["", "## RMS error on held-out data", "", markdown_table(("", "before", "after", "noise", ""), rows)]
    if d.regions:
        regions = [
            (r.name, f"{r.described:.3g}", f"{r.unseen:.3g}", "N·m", "worse than described" if r.worse else "")
            for r in d.regions[:SHOWN]
        ]
        heads = ("", "described", "extended", "", "")
        lines += ["", "## RMS error in regions that no fit saw, the worst first", "", markdown_table(heads, regions)]
    if d.problem is not None:
        groups = [f"- confounded: {name} with {', '.join(others)}" for name, others in confused_with(d.confusable)]
        blind = [f"- could not have shown: {', '.join(map(plain, d.undetermined))}"] if d.undetermined else []
        every = ["- every known cause would have shown at ordinary size"]
        lines += ["", "## What this measurement does not show", *(groups + blind or every)]
    if d.plan is not None and d.plan.proposals:
        sentences = enumerate(d.plan.sentences()[:SHOWN], 1)
        lines += ["", "## What to measure next", *(f"{number}. {sentence}" for number, sentence in sentences)]
    text = re.sub(r"[*_<]", r"\\\g<0>", "\n".join(lines))
    return f"**{d.verdict}**{text.removeprefix(d.verdict)}\n"
