"""Other programs' logs as recordings: a mapping file says which of their columns is what, in which unit.

    value = sign · scale · unit · column  (or the sum of several such, or the integral of a speed)  − zero + offset

`docs/importing.md` describes the mapping file. The mappings in `layouts/` are shipped and have names.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from fnmatch import fnmatchcase
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from ...models.arm import ArmSpec, CarriedMass, PayloadSpec, joint_of
from ...models.errors import InputError, InputWarning, nearest, unknown_key
from ...models.files import Strict, load
from ...models.joint import load_joint
from ...models.joint_parts import Mounting
from ...models.recording import External, Recording, check_channels, in_arm, with_load
from ...models.signals import CHANNELS
from ...models.text_tables import TextForm, seconds
from .log import Log
from .logs import LogForm, open_log

UNITS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "ns": ("s", 1e-9),
    "rad": ("rad", 1.0), "mrad": ("rad", 1e-3), "deg": ("rad", np.pi / 180), "°": ("rad", np.pi / 180),
    "rev": ("rad", 2 * np.pi), "counts": ("rad", 2 * np.pi),
    "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", np.pi / 180), "°/s": ("rad/s", np.pi / 180),
    "rpm": ("rad/s", 2 * np.pi / 60),
    "A": ("A", 1.0), "mA": ("A", 1e-3),
    "N·m": ("N·m", 1.0), "Nm": ("N·m", 1.0), "mN·m": ("N·m", 1e-3), "mNm": ("N·m", 1e-3),
    "N": ("N", 1.0), "°C": ("°C", 1.0), "degC": ("°C", 1.0),
    "1": ("1", 1.0),
}  # fmt: skip
"""Unit of a foreign column: SI unit and factor; `counts` per revolution have their own field."""


ColumnName = Annotated[
    str, BeforeValidator(lambda name: str(name) if type(name) is int else name, json_schema_input_type=str | int)
]
"""Name of a foreign column, or its number where the log has no header."""


class Zero(Strict):
    """Where a channel's zero is: its mean (or first) difference from `scale` times another column is taken off.

    `beyond`: only where that difference is larger (SI): a zero that is known already, by `offset`, is kept.
    """

    column: ColumnName
    """The foreign column that it is compared with."""
    unit: str
    """Of that column."""
    counts: Annotated[int, Field(gt=1, le=2**40)] | None = None
    """Per revolution, for unit `counts`."""
    scale: float = 1.0
    """Factor on that column; may carry a unit."""
    at: Literal["mean", "first"] = "mean"
    """All of the log, or its first sample."""
    beyond: Annotated[float, Field(ge=0)] = 0.0
    """Only where the difference is larger, SI."""

    def away(self, values: np.ndarray, table: dict[str, np.ndarray]) -> float:
        """Return the difference of a channel, shape (n,), from the compared column, SI."""
        off = values - self.scale * _factor(self.unit, self.counts) * table[self.column]
        return float(off[0] if self.at == "first" else np.mean(off))


class _Reading(Strict):
    """Properties of a foreign column's numbers."""

    scale: float = 1.0
    """Factor; may carry a unit."""
    sign: Literal[1, -1] = 1
    """−1 where the log counts the other way."""
    counts: Annotated[int, Field(gt=1, le=2**40)] | None = None
    """Per revolution, for unit `counts`."""
    wraps: bool = False
    """Whether the angle starts again after a turn; jumps of more than half a turn are undone."""


class SourceColumn(_Reading):
    """One foreign column in SI: sign · scale · unit · column. `scale` may have a unit (a lever, A per N·m)."""

    column: ColumnName
    """Name in the log; of a message, topic and field."""
    unit: str
    """Unit in the log: `deg`, `rpm`, `counts`, …"""

    @model_validator(mode="after")
    def _known_unit(self) -> SourceColumn:
        _check_counts(self.unit, self.counts)
        if self.wraps and UNITS[self.unit][0] != "rad":
            raise ValueError(f"wraps: expected only with angles, got unit {self.unit!r}")
        return self

    def read(self, table: dict[str, np.ndarray]) -> np.ndarray:
        """Values in SI, shape (n,)."""
        values = table[self.column] * _factor(self.unit, self.counts)
        if self.wraps:
            values = np.unwrap(values)
        return self.sign * self.scale * values

    def makes(self, unit: str) -> bool:
        """Return whether it has that SI unit, or a factor that may convert to it."""
        lever = (UNITS[self.unit][0], unit) == ("N", "N·m") and "scale" in self.model_fields_set
        return UNITS[self.unit][0] == unit or self.scale != 1.0 or lever


class ChannelSource(_Reading):
    """A column of a recording: one foreign column with its unit, or the `sum` of several; then offset and zero.

    `integrate`: the column is a speed, and its integral the channel. `optional`: used if the log has the column.
    """

    column: ColumnName | None = None
    """Name in the log; of a message, topic and field."""
    unit: str | None = None
    """Unit in the log: `deg`, `rpm`, `counts`, …"""
    sum: list[SourceColumn] | None = None
    """Several columns that make one channel."""
    rate: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """Of a time that was not logged [Hz]: rows are so many a second."""
    integrate: bool = False
    """A velocity whose integral is the angle."""
    optional: bool = False
    """Left out where the log does not have it."""
    offset: float = 0.0
    """Added at the end, SI; of a zero with `beyond`, the zero that is known already."""
    zero: Literal["first"] | Zero | None = None
    """Where the zero is: `first` sample, or another column."""

    @model_validator(mode="after")
    def _one_or_several(self) -> ChannelSource:
        own = self.model_fields_set & set(SourceColumn.model_fields)
        if self.rate is not None:
            if own or self.sum is not None:
                raise ValueError("rate: expected without column and sum, for a log without time")
        elif self.sum is not None:
            if own:
                raise ValueError(f"expected either column or sum, got sum and {', '.join(sorted(own))}")
            if not self.sum:
                raise ValueError("sum: expected at least one column, got none")
        elif self.column is None or self.unit is None:
            raise ValueError("expected column and unit (or sum)")
        else:
            self.parts  # noqa: B018  checks them
        if isinstance(self.zero, Zero):
            _check_counts(self.zero.unit, self.zero.counts, "zero.")
        return self

    @property
    def parts(self) -> list[SourceColumn]:
        """The columns that are summed; none of a time that was not logged."""
        if self.sum is not None or self.rate is not None:
            return self.sum or []
        own = self.model_fields_set & set(SourceColumn.model_fields)
        return [SourceColumn.model_validate({name: getattr(self, name) for name in own})]

    @property
    def sources(self) -> list[str]:
        """Names of the foreign columns."""
        return [part.column for part in self.parts] + ([self.zero.column] if isinstance(self.zero, Zero) else [])

    def read(self, table: dict[str, np.ndarray], time: np.ndarray) -> np.ndarray:
        """Values in SI, shape (n,); of an integral at the times [s] of the samples, of a time that was not logged at the rows of
        these numbers, shape (n,) each."""
        if self.rate is not None:
            return time / self.rate + self.offset
        values = np.sum([part.read(table) for part in self.parts], axis=0)
        if self.integrate:
            from scipy.integrate import cumulative_trapezoid

            values = cumulative_trapezoid(values, time, initial=0.0)
        if self.zero == "first":
            return values - values[0] + self.offset
        known = values + self.offset
        if self.zero is None:
            return known
        if self.zero.beyond == 0:
            return values - self.zero.away(values, table) + self.offset
        away = self.zero.away(known, table)
        return known - away if abs(away) > self.zero.beyond else known


class LogLoad(Strict):
    """Differences of some logs: `link` or `mounting` instead of the mapping's, payloads, `arm`, external torque."""

    link: Mounting | None = None
    """Load of the joint, instead of the mapping's."""
    mounting: str | None = None
    """The same by its name in the joint's description."""
    payload: PayloadSpec | None = None
    """Added to the link."""
    payloads: tuple[CarriedMass, ...] | None = None
    """Carried for a time, instead of the mapping's."""
    arm: ArmSpec | None = None
    """Another arm."""
    external_torque: External | None = None
    """Whether it was pushed."""


class Layout(Strict):
    """A mapping file: from another program's log to a recording.

    `separator` and `decimal` are found in a CSV file where they are not stated. `logs`: what differs, by patterns of file names.
    """

    format: Literal[1]
    name: str
    """Of the layout."""
    description: str = ""
    """Which program writes such logs."""
    joint: str
    """Name of a shipped joint, or path of its file."""
    link: Mounting | None = None
    """Load of the joint; alternatively `mounting` or `arm`."""
    mounting: str | None = None
    """The same by its name among the `mountings` of the joint's description."""
    arm: ArmSpec | None = None
    """The arm that the joint is part of; or else `link` or `mounting`."""
    payloads: tuple[CarriedMass, ...] = ()
    """Masses that the link picks up and puts down; their times are those of the recording's `time`. An arm has its own."""
    external_torque: External = "none"
    """Whether the link was pushed, and whether that was measured."""
    separator: Annotated[str, Field(min_length=1, max_length=1)] | None = None
    """Of a CSV file's columns; found where it is not stated."""
    decimal: Literal[".", ","] | None = None
    """Point or comma; found where it is not stated."""
    skip: Annotated[int, Field(ge=0)] = 0
    """Lines of a text file or sheet before everything else; comments and titles are found."""
    header: Literal["none"] | None = None
    """`none`: columns are numbered, 0, 1, …; there is no header."""
    interleaved: dict[str, Annotated[int, Field(ge=1, le=1000)]] = {}
    """How many columns take turns in a file of one number a line, by patterns of file names."""
    episodes: ColumnName | None = None
    """Column that parts a log into recordings: one of each of its values."""
    damaged_rows: Literal["refuse", "leave_out"] = "refuse"
    """Rows with a cell that is no number, or at which time does not increase."""
    columns: dict[str, ChannelSource]
    """Channels of the recording by name, each from the log's."""
    logs: dict[str, LogLoad] = {}
    """What differs, by patterns of file names."""
    _folder: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _one_load(self) -> Layout:
        loads = [name for name in ("link", "mounting", "arm") if getattr(self, name) is not None]
        if len(loads) != 1:
            raise ValueError(f"expected one of link, mounting and arm, got {' and '.join(loads) or 'none'}")
        if self.arm is not None and self.payloads:
            raise ValueError("payloads: expected them in arm, with the body that carries them, got them next to it")
        for pattern, other in self.logs.items():
            own = other.model_fields_set - {"external_torque"}
            if self.arm is not None and own - {"arm"}:
                given = " and ".join(sorted(own))
                raise ValueError(f"logs.{pattern}: expected arm, as in the mapping (it can have payloads), got {given}")
            if self.arm is None and other.arm:
                expected = f"link, mounting or payload, as the mapping has {loads[0]}"
                raise ValueError(f"logs.{pattern}: expected {expected}, got arm")
            if other.link and other.mounting:
                raise ValueError(f"logs.{pattern}: expected either link or mounting, got both")
        return self

    @model_validator(mode="after")
    def _columns_fit(self) -> Layout:
        for name in self.columns:
            if name not in CHANNELS and (joint_of(name) is None or self.arm is None):
                raise ValueError(f"columns.{name}: {unknown_key(name, CHANNELS)}")
        if "time" not in self.columns:
            raise ValueError("columns.time: missing")
        if any(channel.rate is not None for name, channel in self.columns.items() if name != "time"):
            raise ValueError("columns: expected rate only of time")
        if self.columns["time"].integrate:
            raise ValueError("columns.time.integrate: expected false, as other columns are integrated over time")
        check_channels("columns", self.columns)
        others = {f"logs.{pattern}.": other.external_torque for pattern, other in self.logs.items()}
        for where, external in ({"": self.external_torque} | others).items():
            if external is not None and (external == "measured") != ("external_torque" in self.columns):
                expected = "'measured' where columns has external_torque and only there"
                raise ValueError(f"{where}external_torque: expected {expected}")
        for name, channel in self.columns.items():
            unit = CHANNELS[name].unit if name in CHANNELS else "rad"
            rate, zero = f"{unit}/s" if channel.integrate else unit, channel.zero
            places = [f"sum.{i}.unit" if channel.sum else "unit" for i in range(len(channel.parts))]
            wrong = [
                (at, rate, part.unit) for at, part in zip(places, channel.parts, strict=True) if not part.makes(rate)
            ]
            if isinstance(zero, Zero) and zero.scale == 1.0 and UNITS[zero.unit][0] != unit:
                wrong.insert(0, ("zero.unit", unit, zero.unit))
            for place, expected, got in wrong[:1]:
                text = f"expected one of {expected!r}, or a scale that makes it so, got {got!r}"
                raise ValueError(f"columns.{name}.{place}: {text}")
        return self

    def of(self, log: Path, joint: str | None = None) -> Layout:
        """Return the mapping for one log, with its load as `link` or `arm`. `joint`: the joint with the mountings, by default the
        mapping's. Raises `InputError`: several patterns fit the log's name, or no such joint or mounting."""
        fitting = [pattern for pattern in self.logs if fnmatchcase(log.name, pattern)]
        if len(fitting) > 1:
            raise InputError(
                f"{log}: expected one pattern of `logs` to fit (format {self.name!r}), got {', '.join(map(repr, fitting))}"
            )
        other = self.logs[fitting[0]] if fitting else LogLoad()
        link, mounting = (other.link, other.mounting) if other.link or other.mounting else (self.link, self.mounting)
        if mounting is not None:
            described = load_joint(self.joint, self._folder) if joint is None else load_joint(joint)
            link = described.mount(mounting)
        if other.payload is not None and link is not None:
            link = other.payload.on(link)
        kept = {name: getattr(self, name) for name in ("arm", "payloads", "external_torque")}
        kept |= {name: given for name in kept if (given := getattr(other, name)) is not None}
        return self.model_copy(update={"link": link, "mounting": None, **kept})


def unfitting(layout: Layout, logs: Sequence[str | Path]) -> list[str]:
    """Patterns of a mapping's `logs` that fit none of these logs' names."""
    names = [Path(log).name for log in logs]
    return [pattern for pattern in layout.logs if not any(fnmatchcase(name, pattern) for name in names)]


def _factor(unit: str, counts: int | None) -> float:
    """Of a foreign column, to SI."""
    return UNITS[unit][1] / (counts or 1)


def _check_counts(unit: str, counts: int | None, where: str = "") -> None:
    if unit not in UNITS:
        raise ValueError(f"{where}unit: expected one of {', '.join(UNITS)}, got {unit!r}{nearest(unit, UNITS)}")
    if (unit == "counts") != (counts is not None):
        raise ValueError(f"{where}counts: expected with unit 'counts' and only then (per revolution)")


def known_layouts() -> dict[str, Path]:
    """The shipped mapping files by name."""
    folder = Path(str(resources.files(__package__).joinpath("layouts")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_layout(source: str | Path) -> Layout:
    """Load a mapping file by the name of a shipped one, or by its path."""
    known = known_layouts()
    path = known.get(str(source), Path(source))
    if not path.is_file():
        raise InputError(
            f"format {str(source)!r}: expected a mapping file or one of {sorted(known)}, "
            f"found neither{nearest(str(source), known)}"
        )
    layout = load(path, Layout, "a mapping file")
    layout._folder = path.parent
    return layout


def import_recording(layout: Layout, path: str | Path, name: str | None = None, joint: str | None = None) -> Recording:
    """Read another program's log as a recording; as `import_recordings`, of a log that is one.

    Raises:
      InputError: as of that, and a log of several episodes.
    """
    found = import_recordings(layout, path, name, joint)
    if len(found) > 1:
        raise InputError(
            f"{path}: expected one episode, got {len(found)}; `flexspline import` writes a recording of each"
        )
    return found[0]


def import_recordings(
    layout: Layout, path: str | Path, name: str | None = None, joint: str | None = None
) -> list[Recording]:
    """Read another program's log as recordings: one, or one of each episode.

    Args:
      layout: the mapping.
      path: of the file, of a bag's folder, or of a folder of files that belong together.
      name: of the recording; the file's by default. That of an episode has its number behind.
      joint: name of, or path to, the joint; the mapping's by default.

    Raises:
      InputError: a file that cannot be read, a column that is not there, cells that are no numbers, time that does not
        increase.

    Warns:
      InputWarning: rows or messages that were left out, units that the log states otherwise.
    """
    path = Path(path)
    if not (path.is_file() or path.is_dir()):  # nor a pipe, which may never end
        raise InputError(f"{path}: cannot read a log of format {layout.name!r}: no such file")
    layout = layout.of(path, joint)
    form = LogForm(TextForm(layout.separator, layout.decimal, layout.skip, layout.header == "none"), layout.interleaved)
    sources = [column for channel in layout.columns.values() for column in channel.sources]
    log = open_log(path, [*sources, *([layout.episodes] if layout.episodes else [])], form)
    channels, columns = _found(layout, log)
    read = log.read(list(dict.fromkeys(columns.values())))
    if log.note:
        warnings.warn(f"{path}: {log.note}", InputWarning, stacklevel=2)
    table = {column: read[theirs] for column, theirs in columns.items()}
    rows = len(next(iter(table.values())))
    if not rows:
        raise InputError(f"{path}: expected rows, got a header alone")
    dated = {column for column, values in table.items() if values.dtype.kind in "mM"}
    for target, part in ((target, part) for target, channel in channels.items() for part in channel.parts):
        if part.column in dated and part.unit != "s":
            raise InputError(
                f"{path}: column {part.column!r}: expected unit 's' of dates and clock times, got {part.unit!r} ({target})"
            )
    table |= {column: seconds(table[column]) for column in dated}
    kept = np.all([np.isfinite(values) for values in table.values()], axis=0)
    if not np.all(kept):
        faults = [
            log.fault(columns[next(c for c, values in table.items() if not np.isfinite(values[i]))], int(i))
            for i in np.flatnonzero(~kept)[:_NAMED]
        ]
        _damaged(layout, path, faults, int(np.count_nonzero(~kept)), rows)
    episodes = table[layout.episodes] if layout.episodes else np.zeros(rows)
    found = []
    for value in dict.fromkeys(episodes[kept].tolist()):
        its = np.flatnonzero(kept & (episodes == value))
        time = channels["time"].read({column: values[its] for column, values in table.items()}, its)
        later = np.diff(np.maximum.accumulate(time), prepend=-np.inf) > 0
        if not np.all(later):
            i = int(np.argmin(later))
            fault = f"expected time to increase, got {time[i]:.9g} s after {time[i - 1]:.9g} s"
            fault = f"column 'time', {log.row(int(its[i]))}: {fault}"
            if time[i - 1] - time[i] > 0.5 * (time[i - 1] - time[0]) > 0 and not layout.episodes:
                raise InputError(
                    f"{path}: {fault}; it begins again there: `episodes: COLUMN` parts a log into recordings"
                )
            if 10 * np.count_nonzero(~later) > len(its) and time[-1] > time[0]:
                rate = (len(its) - 1) / (time[-1] - time[0])
                fault += f" (a coarse clock? `time: {{rate: {rate:.4g}}}` counts rows instead)"
            _damaged(layout, path, [fault], int(np.count_nonzero(~later)), len(its))
        own = {column: values[its[later]] for column, values in table.items()}
        stem = (name or path.stem) + (f"_{value:g}" if layout.episodes else "")
        found.append(_recording(layout, channels, own, time[later], path, stem, joint))
    return found


_NAMED = 12
"""Damaged rows that a message names."""


def _damaged(layout: Layout, path: Path, faults: list[str], count: int, rows: int) -> None:
    """Say that rows are left out, or that they are wrong, all of them at once."""
    others = f"; {count} of {rows} rows are damaged" if count > 1 else ""
    text = f"{'; '.join(faults)}{', …' if 1 < len(faults) < count else ''}{others}"
    if layout.damaged_rows == "refuse" or count > rows - 2:
        key = "; `damaged_rows: leave_out` in the mapping leaves such rows out"
        raise InputError(f"{path}: {text}{key if layout.damaged_rows == 'refuse' else ''}")
    warnings.warn(f"{path}: left out: {text}", InputWarning, stacklevel=3)


def _found(layout: Layout, log: Log) -> tuple[dict[str, ChannelSource], dict[str, str]]:
    """The mapping's channels that a log has, and the log's names of their columns; those of time first, whose topic the samples
    are. Raises `InputError`: a column that is not there, or several times."""
    path = log.path
    channels = {
        target: channel
        for target, channel in sorted(layout.columns.items(), key=lambda one: one[0] != "time")
        if not channel.optional or all(log.find(column) is not None for column in channel.sources)
    }
    wanted = [(column, target) for target, channel in channels.items() for column in channel.sources]
    wanted += [(layout.episodes, "episodes")] if layout.episodes else []
    columns = {}
    for column, target in wanted:
        theirs = log.find(column)
        if theirs is None:
            raise InputError(
                f"{path}: column {column!r}: missing, {target} is made of it (format {layout.name!r})"
                f"{f'; {log.why}' if log.why else nearest(column, log.names)}"
            )
        if log.names.count(theirs) > 1:
            raise InputError(f"{path}: column {column!r}: expected once, found {log.names.count(theirs)} times")
        columns[column] = theirs
    for channel in channels.values():
        for part in channel.parts:
            stated = _SPELT.get(log.units.get(columns[part.column], ""))
            if stated and UNITS[stated] != UNITS[part.unit]:
                text = (
                    f"{path}: column {part.column!r}: its unit in the log is {stated!r}, in the mapping {part.unit!r}"
                )
                warnings.warn(text, InputWarning, stacklevel=3)
    return channels, columns


_SPELT = {unit.lower(): unit for unit in UNITS if unit not in ("1", "counts", "mN·m", "mNm")} | {"sec": "s"}
"""Units as logs state them, in small letters."""


def _recording(
    layout: Layout,
    channels: dict[str, ChannelSource],
    table: dict[str, np.ndarray],
    time: np.ndarray,
    path: Path,
    name: str,
    joint: str | None,
) -> Recording:
    """A recording of a log's columns, shape (n,) each, at its times, shape (n,) [s]."""
    columns = {target: channel.read(table, time) for target, channel in channels.items() if target != "time"}
    angles = {target: columns.pop(target) for target in list(columns) if target not in CHANNELS}
    external = layout.external_torque
    if external == "measured" and "external_torque" not in columns:
        external = "unmeasured"
    recording = Recording(
        name=name,
        time=time,
        columns=columns,
        joint=joint or layout.joint,
        description=f"{path.name}, imported as {layout.name}",
        link=layout.link or Mounting(inertia=1.0, gravity_moment=0.0),
        external=external,
        source=str(path),
        payloads=layout.payloads,
    )
    home = layout._folder if joint is None else None
    for i, one in enumerate(layout.payloads if layout.arm is None else layout.arm.payloads):
        if not np.any(one.carried(time)):
            text = f"{path}: payloads.{i}: it is carried at no time of the log, {time[0]:g} to {time[-1]:g} s"
            warnings.warn(text, InputWarning, stacklevel=3)
    if layout.arm is None:
        return with_load(recording, home=home)
    beside_log = (path.parent / layout.arm.model).is_file()
    return in_arm(recording, layout.arm, angles, path, path.parent if beside_log else layout._folder, home)
