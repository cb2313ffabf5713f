"""`flexspline estimate`: joint torque and external torque of a measurement by every estimator."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

from ..models.errors import InputError, InputWarning
from ..models.output import check_output, made_from, output_folder
from ._console import console
from ._measurement import load_measurement
from ._options import AsJson, Estimators, MeasurementPath, OtherJoint, ResultFolder, with_plugins

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from rich.table import Table

    from ..diagnosis.data.changes import Mistake
    from ..estimator.offline import Estimates
    from ..estimator.scoring import Score
    from ..models.joint import Joint
    from ..models.recording import Measurement, Recording

EXAMPLES = (
    "flexspline estimate measurement --out estimates",
    "flexspline estimate measurement --joint diagnosis/joint.yaml --filter dynamics_ekf --out estimates",
)


_CONTRADICTED = {
    "load_error": "the load is not as described: current and link balance differ by {:.3g} N·m in most of the motion. "
    "Correct `link` (inertia, gravity_moment) of the recording. Until then, do not use estimators that need the load.",
    "torsion_error": "torsion contradicts the current by {:.3g} N·m: an encoder is eccentric, late or slips, or the stiffness "
    "is wrong. Diagnose the joint. Until then, do not use estimators that need torsion.",
}
"""Notes on a recording's description, in words."""


@with_plugins
def command(
    measurement: MeasurementPath,
    out: ResultFolder,
    joint: OtherJoint = None,
    filter_: Estimators = None,
    as_json: AsJson = False,
) -> Any:
    """Estimate the torques of a measurement without reading its torque sensor; compare them with the sensor, if there is one.

    With a joint that states its uncertainty (as `diagnose` writes it), estimates have 95 % bands; estimators that simulate the
    joint's dynamics have bands only if `--filter` names them. Data with a mistake that makes estimates meaningless are refused.
    """
    from ..diagnosis.data.mistakes import require_sound
    from ..diagnosis.doubts import doubts
    from ..estimator import registry
    from ..estimator.offline import beyond_range, estimate_recording, lacking, write_estimates
    from ..estimator.scoring import no_estimates
    from ..models.chunks import give_back_free_pages, give_back_large_arrays
    from ..models.files import plain, write_json

    give_back_large_arrays()
    data, described = load_measurement(measurement, joint)
    for name in filter_ or ():
        registry.get(name)
    if out.resolve() == data.folder.resolve():
        raise InputError(f"--out {out}: expected another folder than the measurement's")
    maker = made_from("estimate", measurement)
    written = [f"{recording.name}{suffix}" for recording in data.recordings for suffix in (".parquet", ".csv", ".yaml")]
    check_output(out, maker, inputs=data.files, writes=["metrics.json", *written])
    data, unread = require_sound(data, described)
    give_back_free_pages()
    _check_samples(measurement, data)
    wrong_load, others = doubts(data, described, lost={m.column for m in unread})
    for text in (*(f"{data.name}: {text}" for text in wrong_load), *others):
        warnings.warn(text, InputWarning, stacklevel=2)
    for recording in data.recordings:
        for name, why in lacking(recording, filter_ or ()).items():
            raise _missing(recording, name, why)
    report: dict[str, dict[str, Any]] = {}
    lines: list[tuple[Any, str]] = []
    bands = described.uncertainty is not None
    with output_folder(out, maker) as folder:
        for recording in data.recordings:
            found = estimate_recording(recording, described, filter_, bands)
            for name in filter_ or ():
                if name in found.left_out:
                    raise _missing(recording, name, found.left_out[name])
            path = out / write_estimates(found, folder).name
            scores = _scored(recording, found, described, unread)
            poor = no_estimates(recording, found, described, scores)
            one = report[recording.name] = {
                "joint": described.name,
                "notes": found.notes,
                "left_out": found.left_out,
                "untrusted": found.untrusted,
                "beyond": beyond_range(recording, described),
                "wrong_load": list(wrong_load),
                "no_estimates": {what: sorted(worse) for what, (_, worse) in poor.items()}
                | ({"external_torque": sorted(found.external_torque)} if wrong_load else {}),
                **plain(scores),
            }
            table = [(_table(recording, scores, found.untrusted), "")] if scores and not as_json else []
            remarks = [(f"{recording.name}: {text}", style) for text, style in _remarks(poor, one)]
            lines += [(f"{path}", ""), *table, *remarks]
        write_json(folder / "metrics.json", report)
    if as_json:
        return report
    terminal = console()
    for line, style in lines:
        terminal.print(line, style=style)
    terminal.print(f"{out / 'metrics.json'}")


def _check_samples(path: Path, data: Measurement) -> None:
    """Refuse data that are too slow or too short for estimates."""
    from ..diagnosis.data.coverage import SLOWEST
    from ..estimator.offline import SHORTEST, too_short

    slow = [r.interval for r in data.recordings if r.interval * SLOWEST > 1.0]
    if len(slow) == len(data.recordings):
        raise InputError(
            f"{path}: expected {SLOWEST:g} samples a second at least, got samples that are {slow[0]:.3g} s apart"
        )
    if all(map(too_short, data.recordings)):
        one, got = data.recordings[0], "none: too short to estimate"
        if all(recording.sparse for recording in data.recordings):
            got = f"{len(one.gaps)} gaps of more than {one.gap:.2g} s among {len(one.time)} samples"
        raise InputError(f"{path}: expected a part without gaps of {SHORTEST} samples at least, got {got}")


def _scored(
    recording: Recording, found: Estimates, joint: Joint, unread: Sequence[Mistake]
) -> dict[str, dict[str, Score]]:
    """Compare estimates with the recording's columns, but for those with a mistake, which a warning states."""
    from ..estimator.scoring import score

    wrong = {m.column: m.description for m in unread if m.recording in ("", recording.name)}
    for column, what in wrong.items():
        text = f"{recording.name}: {column}: {what}: nothing is scored against it"
        warnings.warn(text, InputWarning, stacklevel=3)
    return {k: v for k, v in score(recording, found, joint).items() if k not in wrong}


def _missing(recording: Recording, name: str, why: str) -> InputError:
    return InputError(f"{recording.source or recording.name}: filter {name!r}: {why}")


def _remarks(poor: dict[str, tuple[str, dict[str, float]]], report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield remarks on a recording's estimates with their styles: wrong ones, extrapolated ones, missing ones."""
    from ..models.joint_parts import beyond_sentence

    if report["wrong_load"]:
        yield (
            "the external torques are no estimates: they include the error of the described load. Correct `link` of the "
            f"recording. {' '.join(report['wrong_load'])}",
            "yellow",
        )
    for text, worse in poor.values():
        listed = ", ".join(f"{estimator} {error:.3g}" for estimator, error in worse.items())
        yield (
            f"{text}; errors of more than half of that are no estimates. The joint, its load or the sampling is not as "
            f"described. Estimators: {listed}",
            "yellow",
        )
    for estimator, why in report["untrusted"].items():
        yield f"{estimator} is not to be trusted: {why}", "yellow"
    for key, text in _CONTRADICTED.items():
        off = max((note.get(key, 0.0) for note in report["notes"]), default=0.0)
        if off > 0.0:
            yield text.format(off), "yellow"
    if report["beyond"]:
        yield beyond_sentence(report["beyond"]), ""
    for why in dict.fromkeys(report["left_out"].values()):
        yield f"{', '.join(name for name, other in report['left_out'].items() if other == why)}: {why}", ""


def _table(recording: Recording, scores: dict[str, dict[str, Score]], untrusted: dict[str, str]) -> Table:
    from rich.text import Text

    from ..views.tables import UNTRUSTED, heading, marked, narrow_table

    none = recording.external == "none" and "external_torque" in scores
    caption = f"Whole recording, and in motion{'; there was no external torque' if none else ''}"
    caption += f";{UNTRUSTED} not to be trusted" if untrusted else ""
    table = narrow_table(f"{recording.name}: RMS error", caption)
    table.add_column("estimator", no_wrap=True)
    for what in scores:
        for words in (what.replace("_", " "), "in motion"):
            table.add_column(heading(words, "N·m"), justify="right", no_wrap=True, vertical="bottom")
    for estimator in dict.fromkeys(name for found in scores.values() for name in found):
        rows = [found.get(estimator) for found in scores.values()]
        figures = [x for s in rows for x in ((math.nan, math.nan) if s is None else (s.rms, s.rms_moving))]
        cells = ("–" if math.isnan(x) else f"{x:.3f}" for x in figures)
        table.add_row(Text(marked(estimator, {"untrusted": untrusted})), *cells)
    return table
