"""The report of a diagnosis: one self-contained HTML page, and the same channels as a Rerun recording.

The page is for a colleague who knows joints, not this program: what is wrong, how that shows, how sure it is, what it is worth,
and what the measurement cannot tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..diagnosis.coverage import undetermined as coverage
from ..diagnosis.diagnose import Diagnosis, Finding
from ..diagnosis.evidence import THRESHOLD
from ..diagnosis.gain import FILTERS, Gain
from ..diagnosis.planning import Plan
from ..diagnosis.replay import HELD_OUT_BLOCK, HELD_OUT_EVERY
from ..models import causes
from ..models.files import write_into_place
from ..models.joint import Joint
from ..sim.recording import Measurement
from . import diagnosis_figures as figures
from .rerun_view import Channel, rerun_measurement

CHANNEL_NAMES = ("motor current", "joint torque", "link balance")
_KEYS = ("motor_current", "joint_torque", "link_balance")
BALANCES = (
    "Motor and mesh: current that the motion takes",
    "Transmission: torque against torsion",
    "Link: torque against its inertia and gravity",
)
_UNITS = ("A", "N·m", "N·m")
_MEANING = {
    "time": "time since the start", "link": "the link angle", "turn": "the angle of the motor within a turn",
    "velocity": "the motor's velocity", "load": "the load", "loading": "the load and whether it rises or falls",
    "direction": "the direction of motion",
}  # fmt: skip


@dataclass(frozen=True)
class Report:
    """What a report shows.

    Attributes:
      measurement, joint: what was measured, and the description that diagnosis was given.
      diagnosis, gain, plan: what came out.
      seconds: that diagnosis took.
    """

    measurement: Measurement
    joint: Joint
    diagnosis: Diagnosis
    gain: Gain | None
    plan: Plan
    seconds: float


def verdict_sentence(d: Diagnosis) -> str:
    """The verdict in one sentence."""
    if d.verdict == "inconclusive":
        count = f"{len(d.undetermined)} of {len(causes.of(d.problem.joint))}"
        return f"This measurement cannot tell: {count} known causes would not have shown in it."
    if not d.causes:
        text = "The joint behaves as its description says, within its tolerances"
        return f"{text}; {len(d.undetermined)} causes could not have shown." if d.undetermined else f"{text}."
    parts = [f"{_title(c)} ({c.component}, {100 * c.confidence:.0f} % sure)" for c in d.causes]
    whole = min(sum(c.explains for c in d.causes), 1.0)
    listed = parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1]
    return (
        f"The joint differs from its description by {listed}, which "
        f"{'explains' if len(parts) == 1 else 'explain'} {100 * whole:.0f} % of what calibration leaves."
    )


def _title(c: Finding) -> str:
    if c.name == "unknown":
        return "an effect that no known cause explains"
    return c.name.replace("_", " ")


def write_report(report: Report, path: Path) -> Path:
    """Write the HTML page."""
    with write_into_place(path) as temporary:
        temporary.write_text(html(report), encoding="utf-8")
    return path


def html(report: Report) -> str:
    """The page."""
    d = report.diagnosis
    noise = sensor_noise(d)
    overlays, balances = _overlays(report, noise), _balances(report, noise)
    told = figures.telling(balances)
    parts = [
        _head(report),
        _causes(report),
        _section("Measured and simulated", _overlay_text(d), _overlay_figures(overlays)),
        _section("Where it shows, and what it depends on", *_balance_sections(balances, told, d)),
        _section("What it is worth on data that no fit saw", _held_out(report), _estimation(report)),
        _section("Calibration: numbers that moved within their tolerance", _calibration(d)),
        _section("What this measurement cannot tell", _limits(report)),
        _section("What to measure next", _next(report)),
        _section("How these numbers were obtained", _method(report)),
    ]
    title = f"{escape(report.measurement.name)}: diagnosis"
    head = f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title><style>{_CSS}</style>"
    return f"{head}<main>{''.join(parts)}</main></html>\n"


def _section(title: str, *parts: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{''.join(parts)}</section>"


def _p(text: str, kind: str = "") -> str:
    return f'<p class="{kind}">{text}</p>' if kind else f"<p>{text}</p>"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    """Cells are HTML; the first column is text, the others numbers."""
    head = "".join(f"<th>{h}</th>" for h in heads)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    return f'<table class="{kind}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'


def _number(value: float, digits: int = 4) -> str:
    """A number for people: powers of ten only far from 1."""
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa.replace('-', '−')}·10<sup>{int(exponent)}</sup>".replace("<sup>-", "<sup>−")
    return f"{value:.{digits}g}".replace("-", "−")


def _with_std(value: float, std: float, unit: str) -> str:
    unit = f" {escape(unit)}" if unit and unit != "1" else ""
    if not std > 0:
        return f"{_number(value)}{unit}"
    digits = int(np.clip(np.ceil(np.log10(max(abs(value), std) / std)) + 1, 2, 6)) if std < np.inf else 4
    return f"{_number(value, digits)} ± {_number(std, 2)}{unit}"


# --- head and causes ---------------------------------------------------------------------------------------------------


def _head(r: Report) -> str:
    d = r.diagnosis
    recordings = ", ".join(f"{x.name} ({x.time[-1] - x.time[0]:.0f} s)" for x in r.measurement.recordings)
    rate = 1 / r.measurement.recordings[0].interval
    sensor = "with" if d.problem.has_torque else "without"
    return (
        f'<header><p class="small">Diagnosis of <b>{escape(r.measurement.name)}</b> '
        f"against the joint <b>{escape(r.joint.name)}</b></p>"
        f'<h1><span class="verdict {d.verdict}">{d.verdict}</span>{escape(verdict_sentence(d))}</h1>'
        f'<p class="small">{escape(recordings)}; {rate:.0f} Hz, {sensor} joint torque sensor; '
        f"{r.seconds:.0f} s of computing</p></header>"
    )


def _causes(r: Report) -> str:
    d = r.diagnosis
    if not d.causes:
        return ""
    cards = []
    for c in d.causes:
        text = c.description if c.name == "unknown" else causes.get(c.name).description
        rows = []
        for name, p in c.parameters.items():
            q = next(q for q in causes.get(c.name).parameters if q.name == name)
            unit = float(r.joint.record()[0][q.relative]) if q.relative else 1.0
            ordinary = " or ".join(f"{_number(a * unit, 3)} … {_number(b * unit, 3)}" for a, b in q.ordinary)
            fixed = "chosen among whole numbers" if q.integer else ordinary
            rows.append((escape(name), _with_std(p.value, p.std, p.unit), fixed))
        table = _table(("parameter", "value ± standard deviation", "ordinary size"), rows) if rows else ""
        cards.append(
            f'<div class="card"><h3>{escape(_title(c))}</h3><p class="small">{c.component}</p><p>{_sentence(text)}</p>'
            f'<div class="facts"><div><b>{100 * c.confidence:.0f} %</b>confidence</div>'
            f"<div><b>{100 * c.explains:.0f} %</b>of the held-out discrepancy</div></div>{table}</div>"
        )
    return _section("What was found", f'<div class="cards">{"".join(cards)}</div>', _alternatives(d))


def _sentence(text: str) -> str:
    return escape(text[:1].upper() + text[1:].rstrip(".")) + "."


def _alternatives(d: Diagnosis) -> str:
    rows = []
    for i, round_ in enumerate(d.rounds):
        chosen = d.rounds[i + 1].base.model[-1].cause.name if i + 1 < len(d.rounds) else None
        for fit, gain in zip(round_.fits, round_.gains, strict=True):
            h = fit.model[-1]
            name = h.cause.name.replace("_", " ") + "".join(f" ({k} {v:g})" for k, v in h.fixed.items())
            mark = "<b>taken</b>" if h.cause.name == chosen and gain == max(round_.gains) else ""
            rows.append((f"{i + 1}", escape(name), f"{gain:.0f}".replace("-", "−"), mark))
    if not rows:
        return ""
    return (
        "<details><summary>What else was tried, and what it would have gained</summary>"
        + _p(
            "Each round adds the one cause that the data speak for most, all calibration numbers free to answer. A cause must "
            f"gain more than {THRESHOLD:g} in log evidence."
        )
        + _table(("round", "cause", "log evidence", ""), rows)
        + "</details>"
    )


# --- overlays ----------------------------------------------------------------------------------------------------------


def _overlay_text(d: Diagnosis) -> str:
    before = "calibrated within its tolerances" + (", without the causes" if d.causes else "")
    return _p(
        "Both ends of the simulated joint follow their measured motion; what the sensors should then have read stands "
        f"against what they did read. <b>Before</b>: the joint {before}. <b>After</b>: the extended joint. The blue "
        "band is what the sensors' own noise explains (two standard deviations); sand-coloured stretches were kept from "
        "every fit. Residuals are left out where the motion starts or rests: friction may there be anything up to its level."
    ) + figures.legend(
        [
            (figures.MEASURED, "measured"), (figures.BEFORE, "simulated before"), (figures.AFTER, "simulated after"),
            (figures.NOISE, "noise ± 2 σ"), (figures.HELD_OUT, "held out"),
        ]
    )  # fmt: skip


Noise = list[dict[int, tuple[np.ndarray, np.ndarray]]]
"""By channel and recording: what the sensors' noise makes of a residual in motion, and which samples count; shape (k,)."""


def sensor_noise(d: Diagnosis) -> Noise:
    """What the sensors' noise makes of the residuals: the difference to the twin, the same motion with noise drawn anew."""
    p = d.problem
    base = d.rounds[0].base
    plain = base.state[0]
    twin = p.residuals([base.theta], [base.model], twin=True)[0]
    found: Noise = [{}, {}, {}]
    for c in range(3):
        for index in {drive.recording for drive in p.drives}:
            pieces = [s for s, drive in enumerate(p.drives) if drive.recording == index]
            use = [(p.drives[s].usable | p.drives[s].held_out)[:, c] & ~p.drives[s].at_rest for s in pieces]
            found[c][index] = (np.concatenate([(twin[s] - plain[s])[:, c] for s in pieces]), np.concatenate(use))
    return found


def _robust_rms(x: np.ndarray) -> float:
    """Standard deviation by the median: bursts where the motion hardly moves do not count."""
    return 1.4826 * float(np.median(np.abs(x))) if len(x) else 0.0


def _overlays(r: Report, noise: Noise) -> list[list[figures.Overlay]]:
    """By channel, one a recording."""
    d, p = r.diagnosis, r.diagnosis.problem
    found = []
    for c in range(3):
        if _KEYS[c] not in d.residual:
            continue
        row = []
        for index, recording in enumerate(r.measurement.recordings):
            pieces = [s for s, drive in enumerate(p.drives) if drive.recording == index]
            if not pieces or not any((p.drives[s].usable[:, c] | p.drives[s].held_out[:, c]).any() for s in pieces):
                continue
            time, measured, before, after = [], [], [], []
            for s in pieces:
                drive = p.drives[s]
                use = drive.usable[:, c] | drive.held_out[:, c]
                if c < 2:  # at rest friction is anything up to its level
                    use &= ~drive.at_rest
                gap = [np.nan]
                time.append(np.concatenate([drive.at, [drive.at[-1] + 1e-6]]))
                measured.append(np.concatenate([_measured(drive, c), gap]))
                before.append(np.concatenate([np.where(use, d.before[s][:, c], np.nan), gap]))
                after.append(np.concatenate([np.where(use, d.after[s][:, c], np.nan), gap]))
            t = np.concatenate(time)
            blocks = np.arange(int(t[-1] / HELD_OUT_BLOCK) + 1)
            held = [
                (b * HELD_OUT_BLOCK, (b + 1) * HELD_OUT_BLOCK)
                for b in blocks[(blocks + index) % HELD_OUT_EVERY == HELD_OUT_EVERY - 1]
            ]
            values = np.nan_to_num(np.concatenate(measured)) if c < 2 or p.has_torque else None
            echo, use = noise[c][index]
            floor = _robust_rms(echo[use])
            row.append(
                figures.Overlay(
                    recording.name, CHANNEL_NAMES[c], _UNITS[c], t, values, np.concatenate(before), np.concatenate(after),
                    floor, held,
                )
            )  # fmt: skip
        found.append(row)
    return found


def _measured(drive, c: int) -> np.ndarray:
    """What was measured of a channel; of the link's balance the torque that the sensor reports."""
    return drive.measured[:, min(c, 1)]


def _overlay_figures(overlays: list[list[figures.Overlay]]) -> str:
    out = []
    for row in overlays:
        if not row:
            continue
        channel = row[0].channel
        both = np.concatenate([x for o in row for x in (o.before, o.after)])
        y = figures.limits(both, 0.3, 0.1, 2.5 * row[0].noise)
        note = {
            "motor current": "the current that motor, mesh and load take",
            "joint torque": "the torque of the flexspline at the measured torsion, as the sensor reads it",
            "link balance": "the torque that the sensor reports, against what the link's inertia and gravity ask for",
        }[channel]
        out.append(f"<h3>{channel.capitalize()}</h3>" + _p(note, "small"))
        out.append(f'<div class="grid">{"".join(figures.overlay(o, y) for o in row)}</div>')
    return "".join(out)


# --- balances ----------------------------------------------------------------------------------------------------------


def _balances(r: Report, noise: Noise) -> list[figures.Balance]:
    d, p = r.diagnosis, r.diagnosis.problem
    found = []
    for c in range(3):
        if _KEYS[c] not in d.residual:
            continue
        columns: list[list[np.ndarray]] = [[] for _ in range(8)]
        for drive, before, after in zip(p.drives, d.before, d.after, strict=True):
            use = (drive.usable[:, c] | drive.held_out[:, c]) & ~drive.at_rest
            theta_m, theta_l, w = drive.state.T[:3]
            rising = np.gradient(uniform_filter1d(drive.load, 3)) > 0
            values = (before[:, c], after[:, c], drive.at, theta_l, theta_m, w, drive.load, rising)
            for column, x in zip(columns, values, strict=True):
                column.append(x[use])
        before, after, *variables = (np.concatenate(x) for x in columns)
        if len(before) > 200:
            floor = _robust_rms(np.concatenate([echo[use] for echo, use in noise[c].values()]))
            found.append(figures.Balance(BALANCES[c], _UNITS[c], before, after, floor, *variables))
    return found


def _balance_sections(balances, told, d: Diagnosis) -> list[str]:
    out = [
        _p(
            "A joint has three torque balances, and an effect breaks only those that it touches. Each point is the "
            "residual of one balance after calibration, before any cause; the lines are its means over forward and backward "
            "motion, and the mean that the extended joint leaves. The titles say how much of the residual's power the "
            "variable explains before, and then after."
        ),
        figures.legend(
            [
                (figures.MEASURED, "residual before"), (figures.FORWARD, "mean before, forward (or load rising)"),
                (figures.BACKWARD, "mean before, backward (or load falling)"), (figures.AFTER, "mean after"),
                (figures.NOISE, "noise ± 2 σ"),
            ]
        ),
    ]  # fmt: skip
    if told is not None:
        b, key, share = told
        after = figures.explained(b, b.after, key)
        told_by = "What gives it away:" if share > 0.3 else "No single variable gives it away; most telling is"
        out.append(
            _p(
                f"<b>{told_by}</b> {escape(b.name.split(':')[0].lower())} against {_MEANING[key]}, which explains "
                f"{100 * share:.0f} % of that residual before"
                + (f" and {100 * after:.0f} % after the causes are in the model." if d.causes else "."),
                "note",
            )
        )
    elif not d.causes:
        out.append(_p("No variable explains a residual beyond its noise.", "note"))
    for b in balances:
        rms = [float(np.sqrt(np.mean(x**2))) for x in (b.before, b.after)]
        out.append(f"<h3>{escape(b.name)}</h3>")
        out.append(
            _p(
                f"RMS {_number(rms[0], 3)} {b.unit} before, {_number(rms[1], 3)} after, noise {_number(b.noise, 3)} {b.unit}",
                "small",
            )
        )
        out.append(figures.balance(b, told[1] if told is not None and told[0] is b else None))
    return out


# --- tables ------------------------------------------------------------------------------------------------------------


def _bar(before: float, after: float, noise: float) -> str:
    whole = max(before, after, noise) or 1.0
    width = [160 * x / whole for x in (before, after, noise)]
    return (
        '<svg viewBox="0 0 164 22" width="164" height="22">'
        f'<rect y="2" width="{width[0]:.0f}" height="8" fill="{figures.BEFORE}"/>'
        f'<rect y="12" width="{width[1]:.0f}" height="8" fill="{figures.AFTER}"/>'
        f'<path d="M{width[2]:.0f} 0v22" stroke="#2B3138" stroke-dasharray="2 2"/></svg>'
    )


def _held_out(r: Report) -> str:
    rows = [
        (name.replace("_", " "), *(f"{v:.4g} {x.unit}" for v in (x.before, x.after, x.noise)), _bar(x.before, x.after, x.noise))
        for name, x in r.diagnosis.residual.items()
    ]  # fmt: skip
    return _p("Simulation error (RMS); the dashed line is the noise floor.") + _table(
        ("channel", "before", "after", "noise", ""), rows
    )


def _estimation(r: Report) -> str:
    if r.gain is None:
        return _p("There is no joint torque sensor, so that the estimators' torque cannot be scored.")
    g = r.gain
    rows = []
    for name in FILTERS:
        before, after = g.errors[name]
        change = f"{100 * (after / before - 1):+.0f} %".replace("-", "−") if before > 0 else "–"
        rows.append((name, f"{before:.3f} N·m", f"{after:.3f} N·m", change, _bar(before, after, g.noise)))
    # The recording in which torque changes most.
    trace = max(g.traces, key=lambda t: float(np.ptp(t.sensor)))
    return (
        "<h3>Torque estimation</h3>"
        + _p(
            "Error (RMS against the torque sensor) of the filters, which never read that sensor: before, they know "
            f"{escape(g.known_before)}; after, the extended joint. The sensor's own noise, {g.noise:g} N·m, is in both (dashed)."
        )
        + _table(("filter", "before", "after", "change", ""), rows)
        + figures.torque_trace(f"RAREKF, {trace.name}", trace.time, trace.sensor, trace.before, trace.after)
    )


def _calibration(d: Diagnosis) -> str:
    if not d.calibration:
        return _p("None did: what the datasheet says is as good as what the data say.")
    deviations = _prior_deviations(d)
    rows = []
    for name, m in d.calibration.items():
        prior = deviations.get(name, 0.0)
        z = (m.value - m.nominal) / prior if prior > 0 else 0.0
        rows.append((escape(name), _with_std(m.nominal, 0.0, m.unit), _with_std(m.value, m.std, m.unit), _moved(z)))
    return _p("A number within three standard deviations of its tolerance is calibration, not a cause.") + _table(
        ("number", "description says", "measured", "moved, in standard deviations of the tolerance"), rows
    )


def _prior_deviations(d: Diagnosis) -> dict[str, float]:
    found = {}
    for slot in d.problem.calibration.slots:
        n = slot.number
        shared = d.problem.joint.shared_tolerances[n.shared] if n.shared else 0.0
        found[slot.name] = float(np.hypot(np.hypot(n.tolerance, shared) * abs(n.value), n.deviation))
    return found


def _moved(z: float) -> str:
    x = 100 + 30 * float(np.clip(z, -3.2, 3.2))
    return (
        '<svg viewBox="0 0 250 16" width="250" height="16"><path d="M10 8h180M100 2v12" stroke="#C9CFD6"/>'
        f'<path d="M10 4v8M190 4v8" stroke="#E0533D"/><circle cx="{x:.0f}" cy="8" r="4" fill="#2F7FD1"/>'
        f'<text x="198" y="12" class="t">{z:+.1f}</text></svg>'.replace(">-", ">−")
    )


def _limits(r: Report) -> str:
    d = r.diagnosis
    out = []
    if d.confusable:
        pairs = "".join(f"<li>{' and '.join(escape(n.replace('_', ' ')) for n in pair)}</li>" for pair in d.confusable)
        out.append(_p("<b>Cannot be told apart here:</b>") + f"<ul>{pairs}</ul>")
    else:
        out.append(_p("Of the causes that could have shown, no two look alike in this measurement."))
    if d.undetermined:
        reasons = coverage(r.measurement, r.joint)
        rows = [
            (
                escape(n.replace("_", " ")),
                causes.get(n).component,
                escape(reasons.get(n, "too weak beside what the tolerances allow")),
            )
            for n in d.undetermined
            if n in causes.names()
        ]
        out.append(
            _p("<b>Could not have shown at ordinary size:</b>") + _table(("cause", "component", "because"), rows)
        )
    else:
        out.append(_p("Every known cause would have shown at ordinary size."))
    return "".join(out)


def _next(r: Report) -> str:
    plan = r.plan
    out = []
    if plan.needs_sensor:
        names = ", ".join(n.replace("_", " ") for n in plan.needs_sensor)
        out.append(_p(f"Only a joint torque sensor shows {escape(names)}."))
    if not plan.questions:
        return "".join(out) + _p(
            "Nothing is left open that another motion would answer." if not out else "No motion would answer more."
        )
    best = plan.proposals[0] if plan.proposals else None
    if best is not None and plan.answered(best):
        decided = ", ".join(q.text for q in plan.answered(best))
        how = (
            f"<code>flexspline run {escape(best.name)}</code> shows its motion"
            if best.shipped
            else escape(best.description)
        )
        out.append(
            _p(f"<b>Measure “{escape(best.name)}”</b> ({how}): it is expected to decide {escape(decided)}.", "note")
        )
    else:
        out.append(
            _p(
                "None of these motions is expected to decide what is open: the tolerances themselves can imitate it.",
                "note",
            )
        )
    heads = [
        "open question",
        "decided from",
        "now",
        *(f"{escape(p.name.replace('_', ' '))}<br>{p.duration:.0f} s" for p in plan.proposals),
    ]
    rows = []
    for i, q in enumerate(plan.questions):
        cells = [
            f"<b>{_evidence(p.expected[i])}</b>" if p.expected[i] >= q.needed else _evidence(p.expected[i])
            for p in plan.proposals
        ]
        rows.append((escape(q.text), f"{q.needed:g}", _evidence(q.now), *cells))
    out.append(
        _p(
            "Log evidence expected at ordinary size, of this measurement alone and with each further motion: from the Fisher "
            "information of the sensors along it, all calibration numbers free within their tolerances."
        )
    )
    out.append(_table(heads, rows))
    motions = "".join(
        f"<li><b>{escape(p.name.replace('_', ' '))}</b>: {escape(p.description)}</li>" for p in plan.proposals
    )
    return "".join(out) + f'<ul class="small">{motions}</ul>'


def _evidence(value: float) -> str:
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def _method(r: Report) -> str:
    d = r.diagnosis
    return (
        "<ol>"
        "<li>Encoders, current and torque are smoothed by one and the same linear filter, so that no "
        "smoothing error enters their comparison.</li>"
        "<li>The joint is replayed between its measured rotor and link motion; current, joint torque and the link's "
        "balance follow. Nothing drifts.</li>"
        f"<li>{d.problem.calibration.size} numbers of the joint are fitted with their tolerances as priors, together with "
        "the causes under test; residuals are whitened, outliers count linearly.</li>"
        f"<li>All {len(causes.of(d.problem.joint))} known causes are screened on the linearised residuals; the "
        "finalists are fitted through the replay and compared by their evidence. What no cause explains gets a spline "
        "at the place and in the variable that explain it best.</li>"
        f"<li>Held out: {escape(d.held_out)}.</li>"
        "<li>Confidence is the share of the evidence that the cause has among all that were tried, tempered, "
        "since neither laws nor noise model are exact.</li>"
        "</ol>"
    )


# --- Rerun -------------------------------------------------------------------------------------------------------------


def write_rerun_report(report: Report, path: Path) -> Path:
    """Write the overlays as a Rerun recording, notes beside them."""
    channels = []
    for row in _overlays(report, sensor_noise(report.diagnosis)):
        for o in row:
            base = o.measured if o.measured is not None else np.zeros(len(o.time))
            channels.append(
                Channel(f"{o.name} {o.channel}", o.unit, o.time, base, base - o.before, {"extended": base - o.after})
            )
    return rerun_measurement(path, f"diagnosis of {report.measurement.name}", channels, markdown(report))


def markdown(report: Report) -> str:
    """The verdict and its tables, short, in Markdown."""
    d = report.diagnosis
    lines = [f"# {d.verdict}", verdict_sentence(d), ""]
    for c in d.causes:
        lines.append(f"## {_title(c)}")
        lines.append(c.description or causes.get(c.name).description)
        lines += [f"- {name}: {p.value:.4g} ± {p.std:.2g} {p.unit}" for name, p in c.parameters.items()]
    lines += ["", "## Held out", "| channel | before | after | noise |", "|---|---:|---:|---:|"]
    lines += [f"| {k} [{x.unit}] | {x.before:.4g} | {x.after:.4g} | {x.noise:.4g} |" for k, x in d.residual.items()]
    if report.gain is not None:
        lines += ["", "## Torque error [N·m]", "| filter | before | after |", "|---|---:|---:|"]
        lines += [f"| {k} | {a:.3f} | {b:.3f} |" for k, (a, b) in report.gain.errors.items()]
    if d.confusable:
        lines += ["", "Cannot be told apart: " + "; ".join(" and ".join(p) for p in d.confusable)]
    if d.undetermined:
        lines += ["", "Could not have shown: " + ", ".join(d.undetermined)]
    lines += ["", "*simulated*: the calibrated joint; *extended*: with the causes in it."]
    return "\n".join(lines)


_CSS = """
body{margin:0;background:#F6F7F9;color:#2B3138;font:15px/1.5 "Inter","Segoe UI","Helvetica Neue",Arial,sans-serif}
main{max-width:1200px;margin:0 auto;padding:28px 20px 60px}
header,section{background:#fff;border:1px solid #E3E7EB;border-radius:10px;padding:20px 26px;margin:0 0 18px}
h1{font-size:23px;line-height:1.35;margin:8px 0;font-weight:600}
h2{font-size:18px;margin:0 0 8px}
h3{font-size:15px;margin:16px 0 2px}
p{margin:6px 0;max-width:86ch}
.small{color:#66707B;font-size:13px}
.verdict{display:inline-block;font-size:13px;font-weight:600;border-radius:5px;padding:2px 9px;margin-right:10px;
  vertical-align:3px;color:#fff}
.verdict.consistent{background:#00875F}
.verdict.discrepancy{background:#C8442F}
.verdict.inconclusive{background:#8A6D1D}
.grid{display:flex;flex-wrap:wrap;gap:6px 4px;margin:4px 0 0}
.stack{display:flex;flex-direction:column}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(420px,1fr));gap:14px}
.card{border:1px solid #E3E7EB;border-left:4px solid #C8442F;border-radius:6px;padding:10px 16px}
.card h3{margin:0;font-size:17px;}
.card .small{margin:0}
.card h3::first-letter{text-transform:uppercase}
.facts{display:flex;gap:26px;margin:6px 0}
.facts div{font-size:12px;color:#66707B}
.facts b{display:block;font-size:20px;color:#2B3138}
table{border-collapse:collapse;margin:8px 0;font-size:13.5px}
th{text-align:left;font-weight:500;color:#66707B;vertical-align:bottom}
td,th{padding:4px 18px 4px 0;border-bottom:1px solid #EDF0F2}
td{font-variant-numeric:tabular-nums;vertical-align:middle}
.legend{font-size:12.5px;color:#4A535C}
.legend{max-width:none}
.legend span{margin-right:16px;white-space:nowrap}
.legend i{display:inline-block;width:18px;height:8px;border-radius:2px;margin-right:6px}
.note{background:#FFF9EC;border-left:3px solid #E8A100;padding:7px 12px}
details{margin-top:12px}
summary{cursor:pointer;color:#2F7FD1}
code{background:#F1F3F5;border-radius:3px;padding:1px 4px}
svg .t{font-size:10px;fill:#66707B}
svg .l{font-size:11px;fill:#4A535C}
svg .h{font-size:11.5px;font-weight:600;fill:#2B3138}
svg text{font-family:inherit}
ul,ol{margin:6px 0;padding-left:22px}
sup{line-height:0}
@media print{body{background:#fff}
section,header{break-inside:avoid-page}}
"""
