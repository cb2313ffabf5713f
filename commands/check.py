"""`flexspline check`: what a measurement holds, and what it can therefore not show."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table
from rich.text import Text

from ..diagnosis.coverage import Summary, missing_columns, summarise, undetermined
from ..models import causes
from ..sim.recording import COLUMNS, read_measurement
from ._console import console


def command(
    measurement: Annotated[Path, typer.Argument(help="a recording, or a folder of several")],
    joint: Annotated[str | None, typer.Option(help="name of, or path to, a joint; the recordings' by default")] = None,
) -> None:
    """Say what is in a measurement, what is missing, and what can therefore not be diagnosed."""
    data = read_measurement(measurement)
    described = data.load_joint(joint)
    summaries = [summarise(recording, described) for recording in data.recordings]
    terminal = console()
    table = Table(title=f"{data.name}: {len(summaries)} recording(s) of {described.name}")
    table.add_column("")
    for s in summaries:
        table.add_column(s.name, justify="right")
    for heading, cells in _rows(data.recordings, summaries):
        table.add_row(Text(heading), *cells)
    terminal.print(table)
    for s in summaries:
        for begin, end in s.gaps:
            terminal.print(f"{s.name}: gap of {end - begin:.3f} s at {begin:.3f} s, the recording is split there")
        if s.clipped > 0:
            terminal.print(f"{s.name}: current at its limit in {100 * s.clipped:.2g} % of the samples")
    missing = missing_columns(data)
    if missing:
        terminal.print(f"not there: {', '.join(missing)}")
    reasons = undetermined(data, described)
    if not reasons:
        terminal.print("every known cause can show in this measurement")
        return
    cannot = Table(title="What this measurement cannot show")
    for heading in ("cause", "component", "because"):
        cannot.add_column(heading)
    for name, reason in reasons.items():
        cannot.add_row(name, causes.get(name).component, reason)
    terminal.print(cannot)


def _rows(recordings, summaries: list[Summary]):
    def row(heading, text):
        return heading, [text(s) for s in summaries]

    yield row("samples", lambda s: f"{s.samples}")
    yield row("duration [s]", lambda s: f"{s.duration:.2f}")
    yield row("sample rate [Hz]", lambda s: f"{1 / s.interval:.4g}")
    yield row("jitter of the intervals [ms rms]", lambda s: f"{1e3 * s.jitter:.3f}")
    yield row("time stamps wrong by [ms rms]", lambda s: f"{1e3 * s.late:.2f}" if s.late else "not seen")
    yield row("single samples missing", lambda s: f"{s.missing}")
    yield row("gaps > 0.1 s", lambda s: f"{len(s.gaps)}")
    for column, unit in COLUMNS.items():
        if column != "time" and any(column in s.ranges for s in summaries):
            yield row(
                f"{column} [{unit}]",
                lambda s, c=column: "–" if c not in s.ranges else f"{s.ranges[c][0]:.4g} … {s.ranges[c][1]:.4g}",
            )
    yield row("largest motor speed [rad/s]", lambda s: f"{s.motor_speed:.3g}")
    yield row("largest link speed [rad/s]", lambda s: f"{s.link_speed:.3g}")
    yield row("in motion [%]", lambda s: f"{100 * s.moving:.0f}")
    yield row("reversals", lambda s: f"{s.reversals}")
    yield row(
        "motor travel forward, backward [rev]", lambda s: f"{s.forward / 2 / np.pi:.1f}, {s.backward / 2 / np.pi:.1f}"
    )
    yield row(
        "load [N·m]", lambda s: f"{s.load[0]:.3g} … {s.load[1]:.3g}" + ("" if s.load_measured else " (from current)")
    )
    yield "external torque", [r.external for r in recordings]
    yield row("current at its limit [%]", lambda s: f"{100 * s.clipped:.2g}")
