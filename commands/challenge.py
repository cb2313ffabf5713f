"""`flexspline challenge`: hide effects, diagnose, count."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..models.errors import InputError
from ..models.files import write_into_place

if TYPE_CHECKING:
    from rich.console import Console


def command(
    n: Annotated[int, typer.Option("--n", min=1, help="number of draws (at each size)")] = 24,
    seed: Annotated[int, typer.Option(min=0, help="of every random stream")] = 1,
    joint: Annotated[str, typer.Option(help="name of, or path to, the nominal joint")] = "test-joint",
    scenario: Annotated[
        list[str] | None,
        typer.Option(help="scenario to measure instead of motions drawn anew (free, push, sweep: 85 s). Repeatable."),
    ] = None,
    size: Annotated[float, typer.Option(min=0.0, help="of the effects, in ordinary sizes")] = 1.0,
    sizes: Annotated[str, typer.Option(help="sizes to scan, e.g. `1,0.3,0.1`, instead of --size")] = "",
    cause: Annotated[list[str] | None, typer.Option(help="draw only from these causes. Repeatable.")] = None,
    exact: Annotated[
        bool, typer.Option("--exact", help="the joint has exactly its nominal numbers, and diagnosis is told so")
    ] = False,
    no_sensor: Annotated[
        bool, typer.Option("--no-sensor", help="no joint torque; irregular 250 Hz with samples missing")
    ] = False,
    two: Annotated[bool, typer.Option("--two", help="hide two effects at once")] = False,
    outside: Annotated[bool, typer.Option("--outside", help="hide effects that are not in the library")] = False,
    none: Annotated[bool, typer.Option("--none", help="hide nothing: false alarms")] = False,
    jobs: Annotated[int | None, typer.Option(min=1, help="processes; all cores by default")] = None,
    out: Annotated[Path | None, typer.Option(help="write every draw to this file, .json or .parquet")] = None,
) -> None:
    """Hide effects in simulated joints, diagnose the recordings, and say how often it was right.

    Joints are drawn within their tolerances and motions anew; diagnosis sees only recordings and the nominal joint. With
    `--sizes` and `--scenario` this tells *before* measuring how small an effect a planned experiment would reveal.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # inherited by the processes
    from ..diagnosis.trials import challenge as challenges
    from ._console import console, progress

    if sum((two, outside, none)) > 1:
        raise InputError("--two, --outside, --none: expected at most one of them")
    if out is not None and out.suffix not in (".json", ".parquet"):
        raise InputError(f"--out {out}: expected a file .json or .parquet")
    scanned = _sizes(sizes) if sizes else (size,)
    asked = challenges.Challenge(
        joint=joint,
        seed=seed,
        hidden="two" if two else "outside" if outside else "none" if none else "one",
        exact=exact,
        sensor=not no_sensor,
        scenarios=tuple(scenario or ()),
        only=tuple(cause or ()),
    )
    outcomes = []
    with progress(counting=True) as bar:
        task = bar.add_task("diagnosing draws", total=n * len(scanned))
        for outcome in challenges.run(asked, n, scanned, jobs or os.cpu_count() or 1):
            outcomes.append(outcome)
            right = sum(o.first_right for o in outcomes)
            bar.update(task, advance=1, description=f"diagnosing draws, {right} of {len(outcomes)} right")
    outcomes.sort(key=lambda o: (o.index, -o.size))
    _show(console(), asked, outcomes, scanned)
    if out is not None:
        _write(out, outcomes)
        console().print(f"{out}", highlight=False)


def _sizes(text: str) -> tuple[float, ...]:
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if not found or min(found) <= 0:
        raise InputError(f"--sizes {text}: expected numbers > 0 with commas between them")
    return tuple(sorted(set(found), reverse=True))


def _show(terminal: Console, asked: Any, outcomes: Sequence[Any], sizes: Sequence[float]) -> None:
    from rich.markup import escape
    from rich.table import Table

    from ..diagnosis.trials import challenge as challenges

    by_size = {s: [o for o in outcomes if o.size == s] for s in sizes}
    kind = {"one": "one effect", "two": "two effects", "outside": "an effect outside the library", "none": "nothing"}
    how = "exact joint" if asked.exact else "joint within tolerance"
    sensor = "" if asked.sensor else ", no torque sensor, irregular 250 Hz"
    table = Table(
        title=f"{kind[asked.hidden]} hidden; {how}{sensor}; seed {asked.seed}", caption="95 % intervals (Wilson)"
    )
    table.add_column("")
    for s in sizes:
        table.add_column("" if asked.hidden == "none" else f"size {s:g}", justify="right")
    columns = [challenges.summary(found) for found in by_size.values()]
    for key in dict.fromkeys(k for c in columns for k in c):
        cells = [c.get(key, "–") for c in columns]
        table.add_row(escape(key), *(f"{x:.3g}" if isinstance(x, float) else str(x) for x in cells))
    terminal.print(table)
    _show_confusion(terminal, challenges.confusion(outcomes))
    rows = challenges.reliability(outcomes)
    if rows:
        table = Table(title="confidence: of the causes named, how many are there")
        for heading in ("confidence", "mean", "right"):
            table.add_column(heading, justify="right")
        for low, high, mean, share in rows:
            table.add_row(f"{low:g}–{high:g}", f"{mean:.2f}", str(share))
        terminal.print(table)
    _show_sizes(terminal, outcomes, sizes)
    for o in outcomes:
        if o.failure:
            terminal.print(f"draw {o.index} at size {o.size:g} failed: {o.failure}", style="red", markup=False)


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


def _show_sizes(terminal: Console, outcomes: Sequence[Any], sizes: Sequence[float]) -> None:
    """How small an effect shows: by cause, what was found, and what the Fisher information allows."""
    import numpy as np
    from rich.table import Table

    from ..diagnosis.trials import challenge as challenges

    if not any(o.smallest is not None for o in outcomes):
        return
    table = Table(
        title="how small an effect this experiment reveals, in ordinary sizes",
        caption=f"Fisher: {challenges.DETECTED} standard deviations of the size, calibration free within tolerance",
    )
    table.add_column("cause")
    for s in sizes:
        table.add_column(f"found at {s:g}", justify="right")
    table.add_column("9 times in 10", justify="right")
    table.add_column("Fisher allows", justify="right")
    names = list(dict.fromkeys(next(iter(o.hidden)) for o in outcomes if o.hidden))
    for name in [*sorted(names), "all"]:
        mine = [o for o in outcomes if o.hidden and (name == "all" or next(iter(o.hidden)) == name)]
        cells = [challenges.rate([o for o in mine if o.size == s], lambda o: o.first_right) for s in sizes]
        best = challenges.found_nine_in_ten(mine)
        limit = np.median([o.smallest for o in mine if o.smallest is not None and np.isfinite(o.smallest)] or [np.nan])
        shown = "–" if best is None else f"{best:.2g}" if best > min(sizes) else f"≤ {best:.2g}"
        table.add_row(name, *(f"{c.right}/{c.of}" for c in cells), shown, f"{limit:.2g}", end_section=name == "all")
    terminal.print(table)


def _write(path: Path, outcomes: Sequence[Any]) -> None:
    rows = [o.row() for o in outcomes]
    with write_into_place(path) as temporary:
        if path.suffix == ".json":
            temporary.write_text(json.dumps(rows, indent=1, ensure_ascii=False), encoding="utf-8")
            return
        import pyarrow as pa
        import pyarrow.parquet as pq

        flat = [
            {k: json.dumps(v, ensure_ascii=False) if isinstance(v, (dict, list)) else v for k, v in row.items()}
            for row in rows
        ]
        pq.write_table(pa.Table.from_pylist(flat), temporary, compression="zstd")
