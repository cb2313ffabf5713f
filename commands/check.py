"""`flexspline check`: what a measurement holds, and what it can therefore not show."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from ..models.errors import InputWarning
from ._measurement import parted_measurement
from ._options import MeasurementPath, OtherJoint, with_plugins

if TYPE_CHECKING:
    from ..diagnosis.data.coverage import RecordingSummary
    from ..models.recording import Recording

EXAMPLES = (
    "flexspline check measurement",
    "flexspline check measurement --joint my_joint.yaml --json",
)


@with_plugins
def command(
    measurement: MeasurementPath,
    joint: OtherJoint = None,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON instead of tables")] = False,
) -> None:
    """Say what is in a measurement, which mistakes are, what is missing, and what can therefore not be diagnosed."""
    from rich.table import Table
    from rich.text import Text

    from ..diagnosis.data.coverage import (
        INERTIA_RATE,
        SLOWEST,
        TORSION_RATE,
        balances,
        missing_columns,
        summarise,
        too_little,
        torque_over_current,
        undetermined,
    )
    from ..diagnosis.data.mistakes import find_mistakes, mended_if_possible
    from ..diagnosis.regression import regressions
    from ..estimator.conditioning import coarser
    from ..models import causes
    from ..models.command_lines import mending
    from ..models.files import json_text
    from ..models.memory import give_back_large_arrays
    from ._console import console
    from ._mistakes import print_mistakes

    give_back_large_arrays()
    given, described = parted_measurement(measurement, joint)
    mistakes = find_mistakes(given, described)
    possible = mended_if_possible(given, described, mistakes)
    data, mend = (given, "") if possible is None else (possible, mending(given, described))
    summaries = [summarise(recording, described) for recording in data.recordings]
    missing, found, reasons = missing_columns(data), balances(data), undetermined(data, described, summaries)
    shows = [name for name in causes.of(described) if name not in reasons]
    coarse = coarser(data.recordings, described)
    plain = regressions(data, described)
    for recording in data.recordings:
        ratio = torque_over_current(recording, described)
        if ratio is not None:
            warnings.warn(
                f"{recording.name}: motor_torque is {ratio:.3g} times the torque constant that the drive believes in times "
                "motor_current: one of the three is wrong",
                InputWarning,
                stacklevel=2,
            )
    if as_json:
        report = {
            "measurement": given.name,
            "joint": described.name,
            "mistakes": [m.to_json() for m in mistakes],
            "fixed": list(given.fixed),
            "recordings": [asdict(s) for s in summaries],
            "missing": missing,
            "coarser": [asdict(one) for one in coarse],
            "balances": [asdict(b) for b in found],
            "regressions": [r.to_json() for r in plain],
            "can_show": shows,
            "undetermined": reasons,
        }
        print(json_text(report))
        return
    terminal = console()
    print_mistakes(terminal, mistakes, mend)
    bolted = ", ".join(r.name for r in given.recordings if r.link.locked)
    if bolted:
        terminal.print(Text(f"{bolted}: bolted to the bench, where mistakes are not looked for"))
    title = f"{given.name}: {len(summaries)} recording(s) of {described.name}" + (
        ", as mended" if any(m.sure for m in mistakes) else ""
    )
    table = Table(title=Text(title))
    table.add_column("")
    for s in summaries:
        table.add_column(Text(s.name), justify="right")
    for heading, cells in _rows(data.recordings, summaries):
        table.add_row(Text(heading), *cells)
    terminal.print(table)
    for recording, s in zip(data.recordings, summaries, strict=True):
        if recording.sparse:
            terminal.print(
                f"{s.name}: {len(s.gaps)} gaps of more than {recording.gap:.2g} s among {s.samples} samples: what happens in "
                "them is unknown; record at 50 Hz at least, 250 Hz and more serve"
            )
        else:
            for begin, end in s.gaps:
                text = f"{s.name}: gap of {end - begin:.3f} s at {begin:.3f} s, the recording is split there"
                terminal.print(text)
        for line in s.done:
            terminal.print(Text(f"{s.name}: {line}"))
        if SLOWEST <= 1 / s.interval < TORSION_RATE:
            unseen = "torsion, friction at a reversal" + (", inertia" if 1 / s.interval < INERTIA_RATE else "")
            terminal.print(f"{s.name}: {1 / s.interval:.3g} Hz do not show {unseen}")
        if s.clipped:
            terminal.print(f"{s.name}: current at its limit in {100 * s.clipped:.2g} % of the samples")
    for one in coarse:
        terminal.print(f"{one.text}; a diagnosis takes it as it comes")
    if missing:
        terminal.print(f"not there: {', '.join(missing)}")
    if any("motor_current" in r and "motor_torque" in r for r in data.recordings):
        terminal.print("motor_current and motor_torque are both there: the current is read, the torque is not")
    for balance in found:
        some = "" if len(balance.recordings) == len(data.recordings) else f" ({', '.join(balance.recordings)})"
        terminal.print(Text(f"held against each other: {balance.description}{some}"))
    for regression in plain:
        said = Table(title=Text(f"What a plain regression says of {regression.title}"))
        for heading in ("shape", f"coefficient [{regression.unit}/…]", "says", "described"):
            said.add_column(heading)
        for row in regression.rows:
            said.add_row(*map(Text, row))
        terminal.print(said)
        if regression.left_out:
            terminal.print(f"this motion does not tell apart from the others: {', '.join(regression.left_out)}")
    if not any("link_position" in r and "motor_position" in r for r in data.recordings):
        terminal.print(
            "one encoder: torsion cannot be seen, the other side's motion follows from the joint's description"
        )
    if shows:
        swallowed = "unless the joint's tolerances swallow it (flexspline joint show)"
        terminal.print(f"can be found by channels and motion, {swallowed}: {', '.join(shows)}")
    elif nothing := too_little(data, described):
        terminal.print(f"no cause can be found: {nothing}")
    if not reasons:
        return
    cannot = Table(title="What this measurement cannot show")
    for heading in ("cause", "component", "because"):
        cannot.add_column(heading)
    for name, reason in reasons.items():
        cannot.add_row(name, causes.get(name).component, reason)
    terminal.print(cannot)


def _rows(recordings: Sequence[Recording], summaries: Sequence[RecordingSummary]) -> Iterator[tuple[str, list[str]]]:
    from ..models.signals import CHANNELS

    def row(heading: str, text: Callable[[RecordingSummary], str]) -> tuple[str, list[str]]:
        return heading, [text(s) for s in summaries]

    def extent(name: str) -> Callable[[RecordingSummary], str]:
        return lambda s: f"{s.ranges[name][0]:.4g} … {s.ranges[name][1]:.4g}" if name in s.ranges else "–"

    turn = 2 * math.pi
    yield row("samples", lambda s: f"{s.samples}")
    yield row("duration [s]", lambda s: f"{s.duration:.2f}")
    yield row("sample rate [Hz]", lambda s: f"{1 / s.interval:.4g}")
    yield row("jitter of the intervals [ms rms]", lambda s: f"{1e3 * s.jitter:.3f}")
    yield row("time stamps wrong by [ms rms]", lambda s: f"{1e3 * s.late:.2f}" if s.late else "not seen")
    yield row("single samples missing", lambda s: f"{s.missing}")
    yield row("gaps", lambda s: f"{len(s.gaps)}")
    yield row("motion known up to [Hz]", lambda s: f"{s.passband:.3g}")
    for name, channel in CHANNELS.items():
        if name != "time" and any(name in s.ranges for s in summaries):
            yield row(f"{name} [{channel.unit}]", extent(name))
    yield row("largest motor speed [rad/s]", lambda s: f"{s.motor_speed:.3g}")
    yield row("largest link speed [rad/s]", lambda s: f"{s.link_speed:.3g}")
    yield row("gear sliding [% of the time]", lambda s: f"{100 * s.sliding:.0f}")
    yield row("reversals", lambda s: f"{s.reversals}")
    yield row("motor travel forward, backward [rev]", lambda s: f"{s.forward / turn:.1f}, {s.backward / turn:.1f}")
    yield row(
        "load [N·m]", lambda s: f"{s.load[0]:.3g} … {s.load[1]:.3g}" + ("" if s.load_measured else " (from the drive)")
    )
    yield "external torque", [r.external for r in recordings]
    yield row("current at its limit [%]", lambda s: "–" if s.clipped is None else f"{100 * s.clipped:.2g}")
