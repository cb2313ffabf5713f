"""The page of a validation: prediction errors of a description by channel and region, and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...models.command_lines import command_line
from ...models.errors import InputError
from ...models.joint_parts import beyond_sentence
from ...models.recording import LARGEST
from ...models.tables import read_table
from ..numbers import number, percent
from ..report import listed, plain
from .chart import WIDTH, Chart, limits
from .rendering import file_digest, output_of, render
from .residual_charts import Group

HELD = 0.9  # A description holds for a channel if this share of the samples in motion is inside the 95 % band
_CLEARLY = 2.0
"""An error of more than so many times the sensors' noise has a cause that could be found, also inside the band."""
_WORSE = 1.3  # A region with more than so many times the error of all motion is reported as the worst


@dataclass(frozen=True)
class Validated:
    """A validation from its folder."""

    folder: Path  # of the validation
    answer: dict[str, Any]  # `validation.json`
    # columns of each recording by its name, shape (n,) each: `time`, and of every channel `<channel>`,
    # `<channel>_simulated`, `<channel>_low`, `<channel>_high`
    tables: dict[str, dict[str, np.ndarray]]


def read_validation(folder: Path) -> Validated:
    """Read a validation from its folder. Raises `InputError`: a folder without a validation, or with other tables."""
    with output_of(folder / "validation.json", "validate") as answer:
        for e in answer["residual"].values():
            e |= {key: float(e[key]) for key in ("rms", "mean", "noise", "inside")} | {"samples": int(e["samples"])}
            e["unit"]
        for region in answer["regions"]:
            region |= {key: float(region[key]) for key in ("from", "to", "beyond")}
            region |= {"rms": {name: float(x) for name, x in region["rms"].items()}}
            region["by"], region["unit"]
        answer["joint"], dict(answer["beyond"]), [m["description"] for m in answer["mistakes"]]
        names = [str(name) for name in answer["recordings"]]
    tables = {name: read_table(folder / f"{name}.parquet")[0] for name in names}
    for name, columns in tables.items():
        wanted = {f"{channel}{end}" for channel in _channels(columns) for end in _ENDS}
        if "time" not in columns or not wanted <= set(columns):
            raise InputError(f"{folder / name}.parquet: expected the columns of flexspline validate, got others")
        time, bad = columns["time"], [c for c in ("time", *sorted(wanted)) if not _are_numbers(columns[c])]
        if bad or len(time) < 2 or not (np.isfinite(time).all() and np.all(np.diff(time) > 0)):
            expected = f"numbers less than {LARGEST:g}" if bad else "times that increase"
            raise InputError(
                f"{folder / name}.parquet: column {(bad or ['time'])[0]!r}: expected {expected}, got others"
            )
    return Validated(folder, answer, tables)


_ENDS = ("", "_simulated", "_low", "_high")


def _are_numbers(values: np.ndarray) -> bool:
    """Whether a column has numbers of plausible size, and gaps."""
    return values.dtype.kind == "f" and bool(np.all(abs(values[np.isfinite(values)]) < LARGEST))


def _channels(columns: Mapping[str, np.ndarray]) -> list[str]:
    return [name.removesuffix("_simulated") for name in columns if name.endswith("_simulated")]


def validation_html(found: Validated) -> str:
    """Return the page as text: one file without references to others."""
    answer = found.answer
    context = {
        "joint": answer["joint"],
        "sentence": _verdict(answer),
        "channels": [(name, e, _worst(answer, name)) for name, e in answer["residual"].items()],
        "mistakes": [_mistake(m) for m in answer["mistakes"]],
        "fixed": answer.get("fixed", []),
        "beyond": beyond_sentence(answer["beyond"]),
        "regions": answer["regions"],
        "commands": _commands(found),
        "groups": charts_of(found),
        "folder": str(found.folder),
        "digest": file_digest(found.folder / "validation.json"),
        "measurement": answer.get("measurement"),
        "data": [(name, len(columns["time"])) for name, columns in found.tables.items()],
    }
    return render("validation.html.j2", context)


def _holds(answer: dict[str, Any]) -> bool:
    errors = answer["residual"].values()
    return bool(errors) and not _severe(answer) and all(e["inside"] >= HELD for e in errors)


def _severe(answer: dict[str, Any]) -> list[dict[str, Any]]:
    return [m for m in answer["mistakes"] if m.get("severe", True)]


def _mistake(m: dict[str, Any]) -> str:
    where = ", ".join(x for x in (m.get("recording"), m.get("column"), *m.get("also", ())) if x)
    return f"{where}: {m['description']}" if where else str(m["description"])


def _verdict(answer: dict[str, Any]) -> str:
    joint, errors = answer["joint"], answer["residual"]
    severe = _severe(answer)
    if severe:
        m = next((m for m in severe if m.get("sure", True)), None)
        if m is not None:
            return f"The data have a mistake, so that they show nothing about {joint}: {_mistake(m)}."
        return (
            f"No correction makes the channels fit {joint}: it may be another joint, or the data are wrong in another way. The "
            f"best correction is of {_mistake(severe[0])}."
        )
    if not errors:
        return f"Nothing moves in this measurement, so that it cannot be compared with {joint}."
    out = {name: e for name, e in errors.items() if e["inside"] < HELD}
    if not out:
        least = min(e["inside"] for e in errors.values())
        text = f"The description of {joint} holds: at least {percent(least)} of every channel lies in its 95 % band"
        above = [plain(name) for name in _above_noise(answer)]
        if above:
            text += f"; but {listed(above)} {'is' if len(above) == 1 else 'are'} off by more than noise"
        return f"{text}."
    worst = min(out, key=lambda name: out[name]["inside"])
    e = out[worst]
    return (
        f"The description of {joint} does not predict {listed([plain(name) for name in out])}: {plain(worst)} is off by "
        f"{number(e['rms'], 2)} {e['unit']} RMS, and in its 95 % band {percent(e['inside'])} of the time."
    )


def _above_noise(answer: dict[str, Any]) -> list[str]:
    """Channels with an error of clearly more than the sensors' noise, which the tolerances may explain."""
    return [name for name, e in answer["residual"].items() if e["rms"] > _CLEARLY * e["noise"]]


def _worst(answer: dict[str, Any], channel: str) -> dict[str, Any] | None:
    """The worst region of a channel, if it is clearly worse than the others."""
    regions = [r for r in answer["regions"] if channel in r["rms"]]
    most = max(regions, key=lambda r: float(r["rms"][channel]), default=None)
    if most is None or most["rms"][channel] < _WORSE * answer["residual"][channel]["rms"]:
        return None
    return most


def _commands(found: Validated) -> list[tuple[str, str]]:
    data, joint = found.answer.get("measurement") or "MEASUREMENT", found.answer.get("description") or "JOINT"

    def line(command: str, *out: str) -> str:
        return command_line(command, data, "--joint", joint, *out)

    if _severe(found.answer):
        return [(line("check"), "names the mistake and its correction")]
    estimate = line("estimate", "--out", "estimates"), "estimates the joint torque with this description"
    diagnose = line("diagnose", "--out", "diagnosis"), "finds the cause, and writes a joint that fits"
    if not _holds(found.answer):
        return [diagnose, (line("plan"), "finds out what to measure next")]
    return [estimate, diagnose] if _above_noise(found.answer) else [estimate]


def charts_of(found: Validated) -> list[Group]:
    """Return a group per channel: for each recording the measured and simulated values, above their difference."""
    groups = []
    for channel, error in found.answer["residual"].items():
        of = {name: c for name, c in found.tables.items() if f"{channel}_simulated" in c}
        if not of:
            continue
        left = {name: c[channel] - c[f"{channel}_simulated"] for name, c in of.items()}
        half = {name: c[f"{channel}_high"] - c[f"{channel}_simulated"] for name, c in of.items()}
        finite = [np.concatenate([x[np.isfinite(x)] for x in values.values()]) for values in (left, half)]
        off, band = (float(np.percentile(abs(x), 99.5)) if len(x) else 0.0 for x in finite)
        reach = 1.3 * max(off, min(band, 4 * off))  # of a wide band, only the middle is shown
        y = (-reach, reach) if reach > 0 else (-1.0, 1.0)
        charts = []
        for name, columns in of.items():
            time, curves = (
                columns["time"],
                {"measured broad": columns[channel], "after": columns[f"{channel}_simulated"]},
            )
            x, unit = (float(time[0]), float(time[-1])), error["unit"]
            y_values = limits(np.concatenate([*curves.values()]), 0.05)
            values = Chart(x, y_values, name, ylabel=unit, width=WIDTH, height=190).lines(time, curves)
            below = Chart(x, y, "measured − simulated", "time [s]", unit, width=WIDTH, height=170)
            below.between(time, -half[name], half[name], "noise")
            below.line(time, left[name], "before thin")
            charts.append([values, below])
        groups.append(Group(channel, error["unit"], charts))
    return groups
