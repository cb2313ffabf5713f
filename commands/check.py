"""`flexspline check`: contents of a measurement, its mistakes, and what it cannot show."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from ._console import console, print_table
from ._measurement import load_measurement, print_mistakes
from ._options import AsJson, MeasurementPath, OtherJoint, with_plugins

if TYPE_CHECKING:
    from ..diagnosis.check import Check
    from ..diagnosis.data.coverage import RecordingSummary
    from ..models.recording import Measurement, Recording

EXAMPLES = ("flexspline check measurement", "flexspline check measurement --joint my_joint.yaml --json")


@with_plugins
def command(measurement: MeasurementPath, joint: OtherJoint = None, as_json: AsJson = False) -> Any:
    """Check a measurement: what it contains, mistakes in it, what is missing, and which causes it cannot show."""
    from ..diagnosis.check import check
    from ..diagnosis.data import coverage
    from ..models import causes
    from ..models.chunks import give_back_large_arrays
    from ..models.command_lines import mending

    give_back_large_arrays()
    given, described = load_measurement(measurement, joint)
    found = check(given, described)
    if as_json:
        return found.to_json()
    data = given if found.corrected is None else found.corrected
    terminal = console()
    print_mistakes(terminal, found.mistakes, mending(given, described) if found.corrected is not None else "")
    bolted = ", ".join(r.name for r in given.recordings if r.link.locked)
    if bolted:
        terminal.print(f"{bolted}: bolted to the bench, not checked for mistakes")
    corrected = ", as corrected" if any(m.sure for m in found.mistakes) else ""
    title = f"{given.name}: {len(found.recordings)} recording(s) of {described.name}{corrected}"
    print_table(terminal, title, ("", *(s.name for s in found.recordings)), _rows(data.recordings, found.recordings))
    for line in _lines(data, found):
        terminal.print(line)
    for regression in found.regressions:
        heads = ("shape", f"coefficient [{regression.unit}/…]", "meaning", "described")
        print_table(terminal, f"Plain regression of {regression.title}", heads, regression.rows, 4)
        if regression.left_out:
            terminal.print(f"confounded with others in this motion: {', '.join(regression.left_out)}")
    if not any("link_position" in r and "motor_position" in r for r in data.recordings):
        terminal.print("one encoder: torsion is not measured, the other side's motion follows from the description")
    if found.can_show:
        masked = "unless masked by the parameter tolerances (flexspline joint show)"
        terminal.print(f"detectable with these channels and this motion, {masked}: {', '.join(found.can_show)}")
    elif nothing := coverage.too_little(data, described):
        terminal.print(f"no cause is detectable: {nothing}")
    if found.undetermined:
        rows = [(name, causes.get(name).component, reason) for name, reason in found.undetermined.items()]
        print_table(terminal, "Not detectable with this measurement", ("cause", "component", "because"), rows, 3)


def _lines(data: Measurement, found: Check) -> Iterator[str]:
    for recording, s in zip(data.recordings, found.recordings, strict=True):
        yield from (f"{s.name}: {line}" for line in _remarks(recording, s))
    yield from (f"{one.text}; a diagnosis accounts for it" for one in found.coarse)
    if found.missing:
        yield f"missing: {', '.join(found.missing)}"
    if any("motor_current" in r and "motor_torque" in r for r in data.recordings):
        yield "`motor_current` takes precedence over `motor_torque`"
    for balance in found.balances:
        some = "" if len(balance.recordings) == len(data.recordings) else f" ({', '.join(balance.recordings)})"
        yield f"compared: {balance.description}{some}"


def _remarks(recording: Recording, s: RecordingSummary) -> Iterator[str]:
    from ..diagnosis.data.coverage import INERTIA_RATE, SLOWEST, TORSION_RATE

    if recording.sparse:
        yield (
            f"{len(s.gaps)} gaps of more than {recording.gap:.2g} s among {s.samples} samples: the motion in them is unknown; "
            "record at 50 Hz at least, better at 250 Hz or more"
        )
    else:
        for begin, end in s.gaps:
            yield f"gap of {end - begin:.3f} s at {begin:.3f} s, the recording is split there"
    yield from s.done
    if SLOWEST <= 1 / s.interval < TORSION_RATE:
        unseen = "torsion, friction at a reversal" + (", inertia" if 1 / s.interval < INERTIA_RATE else "")
        yield f"{1 / s.interval:.3g} Hz do not show {unseen}"
    if s.clipped:
        yield f"current at its limit in {100 * s.clipped:.2g} % of the samples"


def _rows(recordings: Sequence[Recording], summaries: Sequence[RecordingSummary]) -> Iterator[tuple[str, ...]]:
    from ..models.signals import CHANNELS

    def row(heading: str, text: Callable[[RecordingSummary], str]) -> tuple[str, ...]:
        return heading, *(text(s) for s in summaries)

    def extent(name: str) -> Callable[[RecordingSummary], str]:
        return lambda s: f"{s.ranges[name][0]:.4g} … {s.ranges[name][1]:.4g}" if name in s.ranges else "–"

    turn = 2 * math.pi
    yield row("samples", lambda s: f"{s.samples}")
    yield row("duration [s]", lambda s: f"{s.duration:.2f}")
    yield row("sample rate [Hz]", lambda s: f"{1 / s.interval:.4g}")
    yield row("jitter of the intervals [ms rms]", lambda s: f"{1e3 * s.jitter:.3f}")
    yield row("error of the time stamps [ms rms]", lambda s: f"{1e3 * s.late:.2f}" if s.late else "not seen")
    yield row("single samples missing", lambda s: f"{s.missing}")
    yield row("gaps", lambda s: f"{len(s.gaps)}")
    yield row("bandwidth of the motion [Hz]", lambda s: f"{s.passband:.3g}")
    for name, channel in CHANNELS.items():
        if name != "time" and any(name in s.ranges for s in summaries):
            yield row(f"{name} [{channel.unit}]", extent(name))
    yield row("largest motor speed [rad/s]", lambda s: f"{s.motor_speed:.3g}")
    yield row("largest link speed [rad/s]", lambda s: f"{s.link_speed:.3g}")
    yield row("gear sliding [% of the time]", lambda s: f"{100 * s.sliding:.0f}")
    yield row("reversals", lambda s: f"{s.reversals}")
    yield row("motor travel forward, backward [rev]", lambda s: f"{s.forward / turn:.1f}, {s.backward / turn:.1f}")
    drive = " (from the drive)"
    yield row("load [N·m]", lambda s: f"{s.load[0]:.3g} … {s.load[1]:.3g}{'' if s.load_measured else drive}")
    yield "external torque", *(r.external for r in recordings)
    yield row("current at its limit [%]", lambda s: "–" if s.clipped is None else f"{100 * s.clipped:.2g}")
