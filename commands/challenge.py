"""`flexspline challenge`: hide effects, diagnose, count."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..models.errors import InputError
from ..models.output import check_output, output_folder
from ._listing import AsJson
from ._options import with_plugins

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.trials.draw import Challenge
    from ..diagnosis.trials.draw import Hidden as Kind
    from ..diagnosis.trials.score import Outcome


class Hidden(StrEnum):
    """What may be hidden."""

    none = "none"
    one = "one"
    two = "two"
    outside = "outside"


_KINDS: dict[Kind, str] = {
    "one": "one effect",
    "none": "nothing",
    "two": "two effects",
    "outside": "an effect outside the library",
}

_LARGEST_SIZE = 100.0
EXAMPLES = (
    "flexspline challenge --draws 5 --hidden one --out outcomes.json",
    "flexspline challenge --hidden one --measurement hidden",
    "flexspline challenge --scenario link_sweep --cause backlash --sizes 1,0.3,0.1",
    "flexspline challenge --real --hidden one --without joint_torque --without motor_position",
)


@with_plugins
def command(
    draws: Annotated[int, typer.Option(min=1, max=100_000, help="number of draws of each kind (at each size)")] = 24,
    hidden: Annotated[
        list[Hidden] | None,
        typer.Option(
            help="what is hidden: nothing, one effect, two, one outside the library. Repeatable; all by default."
        ),
    ] = None,
    real: Annotated[
        bool, typer.Option("--real", help="every recording has the small imperfections that every real joint has")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="of every random stream")] = 1,
    joint: Annotated[str, typer.Option(help="name of, or path to, the nominal joint")] = "test-joint",
    scenario: Annotated[
        list[str] | None,
        typer.Option(help="scenario to measure instead of motions drawn anew (free, push, sweep: 85 s). Repeatable."),
    ] = None,
    size: Annotated[float, typer.Option(min=0.0, max=_LARGEST_SIZE, help="of the effects, in ordinary sizes")] = 1.0,
    sizes: Annotated[str, typer.Option(help="sizes to scan, e.g. `1,0.3,0.1`, instead of --size")] = "",
    cause: Annotated[list[str] | None, typer.Option(help="draw only from these causes. Repeatable.")] = None,
    exact: Annotated[
        bool, typer.Option("--exact", help="the joint has exactly its nominal numbers, and diagnosis is told so")
    ] = False,
    no_sensor: Annotated[
        bool, typer.Option("--no-sensor", help="no joint torque; irregular 250 Hz with samples missing")
    ] = False,
    without: Annotated[
        list[str] | None,
        typer.Option(metavar="CHANNEL", help="not recorded; what cannot show then is not drawn. Repeatable."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="processes; all cores by default")] = None,
    out: Annotated[
        Path | None, typer.Option(help="write every draw and all tables to this file, .json or .parquet")
    ] = None,
    measurement: Annotated[
        Path | None,
        typer.Option(
            "--measurement",
            help="write the first draw's recordings to this folder, its hidden effects to hidden.json, and diagnose nothing",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Hide effects in simulated joints, diagnose the recordings, and say how often it was right.

    Joints are drawn within their tolerances and motions anew; diagnosis sees only recordings and the nominal joint. With
    `--sizes` and `--scenario` this tells *before* measuring how small an effect a planned experiment would reveal.
    """
    if out is not None:
        if out.suffix not in (".json", ".parquet"):
            raise InputError(f"--out {out}: expected a file .json or .parquet")
        check_output(out.parent, "challenge", writes=[out.name])
    if cause and hidden and set(hidden) == {Hidden.none}:
        raise InputError(
            "--cause: expected --hidden one, two or outside beside it, got --hidden none, which hides nothing"
        )
    scanned = _sizes(sizes) if sizes else (size,)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # inherited by the processes
    from ..diagnosis.trials import score
    from ..diagnosis.trials.draw import Challenge
    from ._console import console, progress

    given = list(dict.fromkeys(hidden or ()))
    kinds: list[Kind] = [h.value for h in given] if given else ["one"] if cause else list(_KINDS)
    asked = [
        Challenge(
            joint=joint, seed=seed, hidden=kind, exact=exact, real=real, sensor=not no_sensor, without=tuple(without or ()),
            scenarios=tuple(scenario or ()), only=tuple(cause or ()),
        )
        for kind in kinds
    ]  # fmt: skip
    if measurement is not None:
        _record(measurement, asked[0])
        console().print(f"{measurement}", highlight=False)
        return
    outcomes: list[Outcome] = []
    with progress(counting=True, remaining=True) as bar:
        task = bar.add_task("diagnosing draws", total=draws * len(scanned) * len(asked))
        for outcome in score.run(asked, draws, scanned, jobs or os.cpu_count() or 1):
            outcomes.append(outcome)
            right = sum(o.first_right for o in outcomes)
            bar.update(task, advance=1, description=f"diagnosing draws, {right} of {len(outcomes)} right")
    outcomes.sort(key=lambda o: (kinds.index(o.kind), o.index, -o.size))
    how = f"{joint}, {'known exactly' if exact else 'within tolerance'}{', with real imperfections' if real else ''}"
    how += f"{', no torque sensor, irregular 250 Hz' if no_sensor else ''}"
    how += f"{', without ' + ', '.join(without) if without else ''}; seed {seed}"
    if out is not None:
        _write(out, outcomes)
    if as_json:
        from ..models.files import json_text

        print(json_text(score.report(outcomes)))
        return
    _show(console(), how, outcomes, scanned)
    if out is not None:
        console().print(f"{out}", highlight=False)


def _record(path: Path, challenge: Challenge) -> None:
    """Write the recordings of the first draw, and what is hidden in them."""
    from ..diagnosis.trials.draw import draw
    from ..models.files import json_text
    from ..models.recording import write_recording

    with output_folder(path, "challenge", whole=True) as folder:
        drawn = draw(challenge, 0)
        for recording in drawn.measurement.recordings:
            write_recording(recording, folder)
        hidden = [{"name": e.name, "parameters": e.values, "description": e.description} for e in drawn.effects]
        (folder / "hidden.json").write_text(json_text(hidden) + "\n", encoding="utf-8")


def _sizes(text: str) -> tuple[float, ...]:
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if not found or not all(0 < size <= _LARGEST_SIZE for size in found):
        raise InputError(f"--sizes {text}: expected numbers > 0, at most {_LARGEST_SIZE:g}, with commas between them")
    return tuple(sorted(set(found), reverse=True))


def _show(terminal: Console, how: str, outcomes: Sequence[Outcome], sizes: Sequence[float]) -> None:
    from rich.table import Table

    from ..diagnosis.trials import score

    largest = [o for o in outcomes if o.size == max(sizes)]
    table = Table(title=how, caption="95 % intervals (Wilson); targets: on real joints")
    for heading in ("", "result", "target"):
        table.add_column(heading, justify="left" if not heading else "right")
    for row in score.rows(largest):
        value = row.value if isinstance(row.value, score.Rate) else f"{row.value:.1f}"
        target = f"{100 * row.target:.0f} %" if isinstance(row.value, score.Rate) else f"{row.target:g}"
        table.add_row(row.name, str(value), f"{'≤' if row.at_most else '≥'} {target}{'' if row.met else '  missed'}")
    terminal.print(table)
    for kind in dict.fromkeys(o.kind for o in outcomes):
        _show_kind(terminal, kind, [o for o in outcomes if o.kind == kind], sizes)
    _show_reliability(terminal, outcomes)
    for o in outcomes:
        if o.failure:
            terminal.print(f"{o.kind}, draw {o.index} at size {o.size:g} failed: {o.failure}", style="red")


def _show_kind(terminal: Console, kind: Kind, outcomes: Sequence[Outcome], sizes: Sequence[float]) -> None:
    """All numbers of one kind of draws, by size."""
    from rich.table import Table

    from ..diagnosis.trials import score

    table = Table(title=f"{_KINDS[kind]} hidden")
    table.add_column("")
    for s in sizes:
        table.add_column("" if kind == "none" else f"size {s:g}", justify="right")
    columns = [score.summary([o for o in outcomes if o.size == s]) for s in sizes]
    for key in dict.fromkeys(k for c in columns for k in c):
        cells = [c.get(key, "–") for c in columns]
        table.add_row(key, *(f"{x:.3g}" if isinstance(x, float) else str(x) for x in cells))
    terminal.print(table)
    _show_confusion(terminal, score.confusion(outcomes))
    if kind == "one":
        _show_sizes(terminal, outcomes, sizes)


def _show_confusion(terminal: Console, confusion: Mapping[str, Any]) -> None:
    from rich.table import Table

    from ..diagnosis.trials.outside import OUTSIDE

    table = Table(title="confusion: what was hidden, and what was named first")
    for heading in ("hidden", "draws", "named rightly", "named otherwise"):
        table.add_column(heading)
    for truth, named in confusion.items():
        expected = (
            {"unknown"} if truth in OUTSIDE else {"consistent"} if truth == "nothing" else set(truth.split(" + "))
        )
        other = [f"{name} ×{count}" for name, count in named.most_common() if name not in expected]
        right = sum(count for name, count in named.items() if name in expected)
        table.add_row(truth, str(sum(named.values())), str(right), ", ".join(other))
    terminal.print(table)


def _show_reliability(terminal: Console, outcomes: Sequence[Outcome]) -> None:
    """Whether confidence is what it says."""
    from rich.table import Table

    from ..diagnosis.trials import score

    found = score.reliability(outcomes)
    if not found:
        return
    table = Table(title="confidence: of the causes named, how many are there")
    for heading in ("confidence", "mean", "there"):
        table.add_column(heading, justify="right")
    for low, high, mean, share in found:
        table.add_row(f"{low:g}–{high:g}", f"{mean:.2f}", str(share))
    terminal.print(table)


def _show_sizes(terminal: Console, outcomes: Sequence[Outcome], sizes: Sequence[float]) -> None:
    """How small an effect shows: by cause, what was found, and what the Fisher information allows."""
    import numpy as np
    from rich.table import Table

    from ..diagnosis.trials import score

    if not any(o.smallest is not None for o in outcomes):
        return
    table = Table(
        title="how small an effect this experiment reveals, in ordinary sizes",
        caption=f"Fisher: {score.DETECTED} standard deviations of the size, calibration free within tolerance",
    )
    table.add_column("cause")
    for s in sizes:
        table.add_column(f"found at {s:g}", justify="right")
    table.add_column("9 times in 10", justify="right")
    table.add_column("Fisher allows", justify="right")
    names = list(dict.fromkeys(next(iter(o.hidden)) for o in outcomes if o.hidden))
    for name in [*sorted(names), "all"]:
        mine = [o for o in outcomes if o.hidden and (name == "all" or next(iter(o.hidden)) == name)]
        cells = [score.rate([o for o in mine if o.size == s], lambda o: o.first_right) for s in sizes]
        best = score.found_nine_in_ten(mine)
        limit = np.median([o.smallest for o in mine if o.smallest is not None and np.isfinite(o.smallest)] or [np.nan])
        shown = "–" if best is None else f"{best:.2g}" if best > min(sizes) else f"≤ {best:.2g}"
        table.add_row(name, *(f"{c.right}/{c.of}" for c in cells), shown, f"{limit:.2g}", end_section=name == "all")
    terminal.print(table)


def _write(path: Path, outcomes: Sequence[Outcome]) -> None:
    from ..diagnosis.trials import score

    with output_folder(path.parent, "challenge") as folder:
        temporary = folder / path.name
        if path.suffix == ".json":
            from ..models.files import json_text

            temporary.write_text(json_text(score.report(outcomes)) + "\n", encoding="utf-8")
            return
        import pyarrow as pa
        import pyarrow.parquet as pq

        flat = [
            {k: json.dumps(v, ensure_ascii=False) if isinstance(v, (dict, list)) else v for k, v in o.row().items()}
            for o in outcomes
        ]
        pq.write_table(pa.Table.from_pylist(flat), temporary, compression="zstd")
