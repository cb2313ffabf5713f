"""`flexspline challenge`: hide effects, diagnose, count."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..models.errors import InputError
from ..models.output import check_output, output_folder
from ..models.processes import single_threaded
from ._console import console, print_table, progress
from ._options import AsJson, Jobs, option, with_plugins

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.trials.draw import Challenge
    from ..diagnosis.trials.draw import Hidden as Kind
    from ..diagnosis.trials.score import Outcome


class Hidden(StrEnum):
    """What may be hidden."""

    none, one, two, outside = "none", "one", "two", "outside"


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
    draws: Annotated[int, option("number of draws of each kind (at each size)", min=1, max=100_000)] = 24,
    hidden: Annotated[
        list[Hidden] | None,
        option("what is hidden: nothing, one effect, two, one outside the library. Repeatable; all by default."),
    ] = None,
    real: Annotated[
        bool, option("add the small imperfections that every real joint has to every recording", "--real")
    ] = False,
    seed: Annotated[int, option("of every random stream", min=0)] = 1,
    joint: Annotated[str, option("name or path of the nominal joint")] = "test-joint",
    scenario: Annotated[
        list[str] | None, option("scenario to measure instead of drawn motions (free, push, sweep: 85 s). Repeatable.")
    ] = None,
    size: Annotated[float, option("of the effects, in ordinary sizes", min=0.0, max=_LARGEST_SIZE)] = 1.0,
    sizes: Annotated[str, option("sizes to scan, e.g. `1,0.3,0.1`, instead of --size")] = "",
    cause: Annotated[list[str] | None, option("draw only from these causes. Repeatable.")] = None,
    exact: Annotated[
        bool, option("the joint has exactly its nominal numbers, and the diagnosis knows it", "--exact")
    ] = False,
    no_sensor: Annotated[bool, option("no joint torque; irregular 250 Hz with samples missing", "--no-sensor")] = False,
    without: Annotated[
        list[str] | None,
        option("not recorded; causes that cannot show then are not drawn. Repeatable.", metavar="CHANNEL"),
    ] = None,
    jobs: Jobs = None,
    out: Annotated[Path | None, option("write every draw and all tables to this file, .json or .parquet")] = None,
    measurement: Annotated[
        Path | None,
        option(
            "write the first draw's recordings to this folder, its hidden effects to hidden.json, and diagnose nothing"
        ),
    ] = None,
    as_json: AsJson = False,
) -> Any:
    """Hide effects in simulated joints, diagnose the recordings, and report how often the diagnosis is right.

    Joints are drawn within their tolerances, motions are drawn too. The diagnosis sees only recordings and the nominal joint.
    With `--sizes` and `--scenario` it finds *before* measuring how small an effect a planned experiment would reveal.
    """
    if out is not None:
        if out.suffix not in (".json", ".parquet"):
            raise InputError(f"--out {out}: expected a file .json or .parquet")
        check_output(out.parent, "challenge", writes=[out.name])
    if cause and hidden and set(hidden) == {Hidden.none}:
        raise InputError("--cause: expected --hidden one, two or outside, got --hidden none, which hides nothing")
    scanned = _sizes(sizes) if sizes else (size,)
    single_threaded()
    from ..diagnosis.trials import score
    from ..diagnosis.trials.draw import Challenge

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
    outcomes = _outcomes(asked, draws, scanned, jobs or os.cpu_count() or 1)
    outcomes.sort(key=lambda o: (kinds.index(o.kind), o.index, -o.size))
    if out is not None:
        _write(out, outcomes)
    if as_json:
        return score.report(outcomes)
    how = f"{joint}, {'known exactly' if exact else 'within tolerance'}{', with real imperfections' if real else ''}"
    how += f"{', no torque sensor, irregular 250 Hz' if no_sensor else ''}"
    how += f"{', without ' + ', '.join(without) if without else ''}; seed {seed}"
    terminal = console()
    _show(terminal, how, outcomes, scanned)
    if out is not None:
        terminal.print(f"{out}")


def _outcomes(asked: list[Challenge], draws: int, scanned: tuple[float, ...], jobs: int) -> list[Outcome]:
    """Diagnose draws of every challenge at every size, with a progress bar."""
    from ..diagnosis.trials import score

    outcomes: list[Outcome] = []
    with progress(counting=True, remaining=True) as bar:
        task = bar.add_task("diagnosing draws", total=draws * len(scanned) * len(asked))
        for outcome in score.run(asked, draws, scanned, jobs):
            outcomes.append(outcome)
            right = sum(o.first_right for o in outcomes)
            bar.update(task, advance=1, description=f"diagnosing draws, {right} of {len(outcomes)} right")
    return outcomes


def _record(path: Path, challenge: Challenge) -> None:
    """Write the recordings of the first draw, and what is hidden in them."""
    from ..diagnosis.trials.draw import draw
    from ..models.files import write_json
    from ..models.recording import write_recording

    with output_folder(path, "challenge", whole=True) as folder:
        drawn = draw(challenge, 0)
        for recording in drawn.measurement.recordings:
            write_recording(recording, folder)
        hidden = [{"name": e.name, "parameters": e.values, "description": e.description} for e in drawn.effects]
        write_json(folder / "hidden.json", hidden)


def _sizes(text: str) -> tuple[float, ...]:
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if not found or not all(0 < size <= _LARGEST_SIZE for size in found):
        raise InputError(f"--sizes {text}: expected numbers > 0, at most {_LARGEST_SIZE:g}, with commas between them")
    return tuple(sorted(set(found), reverse=True))


def _show(terminal: Console, how: str, outcomes: Sequence[Outcome], sizes: Sequence[float]) -> None:
    from ..diagnosis.trials import score

    rows = []
    for row in score.rows([o for o in outcomes if o.size == max(sizes)]):
        rate = isinstance(row.value, score.Rate)
        target = f"{'≤' if row.at_most else '≥'} {f'{100 * row.target:.0f} %' if rate else f'{row.target:g}'}"
        value = str(row.value) if rate else f"{row.value:.1f}"
        rows.append((row.name, value, target + ("" if row.met else "  missed")))
    caption = "95 % intervals (Wilson); targets: on real joints"
    print_table(terminal, how, ("", "result", "target"), rows, caption=caption)
    for kind in dict.fromkeys(o.kind for o in outcomes):
        own = [o for o in outcomes if o.kind == kind]
        columns = [score.summary([o for o in own if o.size == s]) for s in sizes]
        heads = ("", *("" if kind == "none" else f"size {s:g}" for s in sizes))
        cells = [
            (key, *(_cell(c.get(key, "–")) for c in columns)) for key in dict.fromkeys(k for c in columns for k in c)
        ]
        print_table(terminal, f"{_KINDS[kind]} hidden", heads, cells)
        _show_confusion(terminal, score.confusion(own))
        if kind == "one":
            _show_sizes(terminal, own, sizes)
    reliable = [(f"{a:g}–{b:g}", f"{mean:.2f}", str(share)) for a, b, mean, share in score.reliability(outcomes)]
    if reliable:
        title = "reliability: share of the named causes that are present"
        print_table(terminal, title, ("confidence", "mean", "present"), reliable, 0)
    for o in outcomes:
        if o.failure:
            terminal.print(f"{o.kind}, draw {o.index} at size {o.size:g} failed: {o.failure}", style="red")


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _show_confusion(terminal: Console, confusion: Mapping[str, Any]) -> None:
    from ..diagnosis.trials.outside import OUTSIDE

    rows = []
    for truth, named in confusion.items():
        expected = (
            {"consistent"} if truth == "nothing" else {"unknown"} if truth in OUTSIDE else set(truth.split(" + "))
        )
        other = [f"{name} ×{count}" for name, count in named.most_common() if name not in expected]
        right = sum(count for name, count in named.items() if name in expected)
        rows.append((truth, str(sum(named.values())), str(right), ", ".join(other)))
    print_table(
        terminal, "confusion: hidden cause and first named cause", ("hidden", "draws", "right", "other"), rows, 4
    )


def _show_sizes(terminal: Console, outcomes: Sequence[Outcome], sizes: Sequence[float]) -> None:
    """Print by cause how small an effect is found, and how small one the Fisher information allows."""
    import numpy as np

    from ..diagnosis.trials import score

    if not any(o.smallest is not None for o in outcomes):
        return
    rows = []
    for name in [*sorted({next(iter(o.hidden)) for o in outcomes if o.hidden}), "all"]:
        mine = [o for o in outcomes if o.hidden and name in ("all", next(iter(o.hidden)))]
        rates = [score.rate([o for o in mine if o.size == s], lambda o: o.first_right) for s in sizes]
        best = score.found_nine_in_ten(mine)
        limit = np.median([o.smallest for o in mine if o.smallest is not None and np.isfinite(o.smallest)] or [np.nan])
        shown = "–" if best is None else f"{best:.2g}" if best > min(sizes) else f"≤ {best:.2g}"
        rows.append((name, *(f"{c.right}/{c.of}" for c in rates), shown, f"{limit:.2g}"))
    heads = ("cause", *(f"found at {s:g}" for s in sizes), "9 times in 10", "Fisher allows")
    caption = f"Fisher: {score.DETECTED} standard deviations of the size, calibration free within tolerance"
    print_table(terminal, "smallest detectable effect, in ordinary sizes", heads, rows, caption=caption)


def _write(path: Path, outcomes: Sequence[Outcome]) -> None:
    from ..diagnosis.trials import score

    with output_folder(path.parent, "challenge") as folder:
        temporary = folder / path.name
        if path.suffix == ".json":
            from ..models.files import write_json

            write_json(temporary, score.report(outcomes))
            return
        import pyarrow as pa
        import pyarrow.parquet as pq

        flat = [
            {k: json.dumps(v, ensure_ascii=False) if isinstance(v, (dict, list)) else v for k, v in o.row().items()}
            for o in outcomes
        ]
        pq.write_table(pa.Table.from_pylist(flat), temporary, compression="zstd")
