"""Recordings: the readings of a joint's sensors over time, as a table and a YAML file of the same stem.

The format is the same for a simulator and a robot. A *measurement* is one recording or a folder of several of the
same joint. Sampling may be irregular, with single samples missing; a gap splits a recording into segments.
`models.signals` lists the channels and units.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import model_validator

from . import units
from .arm import ArmRecord, ArmSpec, CarriedMass, Load, joint_of, load_of
from .arm import column as arm_column
from .chunks import BLOCK, large
from .errors import InputError, InputWarning, nearest
from .files import Strict, check_name, load, write_into_place, write_text, yaml_text
from .joint import Joint, load_joint
from .joint_parts import Mounting
from .notebook import html_table, paragraph
from .output import recover
from .own_sensors import channel
from .signals import CHANNELS, DRIVING, POSITIONS, Signals, at_samples
from .tables import reading_parquet, write_table
from .text_tables import TextTable

if TYPE_CHECKING:
    import pyarrow as pa

GAP = 0.1 + 1e-6  # least time [s] between samples of a gap: more than 0.1 s, however stamps are rounded
SEVERAL = 5.0  # least gap, in intervals of a log
LARGEST = 1e30  # largest reading of any sensor in any unit; its powers are still finite
SUFFIXES = (".parquet", ".csv")

External = Literal["none", "measured", "unmeasured"]


_LINK = Mounting(inertia=0.35, gravity_moment=9.0)  # the test joint's


class Sidecar(Strict):
    """The YAML file of a recording's table.

    `external_torque`: `none`; `measured`, the column of that name; or `unmeasured`: unmeasured pushes may occur and
    are not causes. The load of the joint is `link`, or `arm`, whose MJCF is in the same folder.
    """

    format: Literal[1]
    joint: str
    """Name of a shipped joint, or path of its file."""
    description: str = ""
    """Of the measurement."""
    link: Mounting | None = None
    """Load on the output; alternative to `arm`."""
    arm: ArmSpec | None = None
    """Arm of the joint; alternative to `link`."""
    payloads: tuple[CarriedMass, ...] = ()
    """Masses that the link picks up and puts down, in addition to `link`; their times are the table's."""
    external_torque: External = "none"
    """Whether the link was pushed, and whether that was measured."""
    fixed: tuple[str, ...] = ()
    """Changes of `flexspline import --fix` to the table."""

    @model_validator(mode="after")
    def _one_load(self) -> Sidecar:
        if (self.link is None) == (self.arm is None):
            raise ValueError(f"expected either link or arm, got {'none' if self.link is None else 'both'}")
        if self.arm is not None and self.payloads:
            raise ValueError("payloads: expected them with link, or in arm with the body that carries them, got arm")
        return self


@dataclass(frozen=True)
class Recording:
    """One recording.

    Attributes:
      name: stem of its files.
      time: [s], increasing; not necessarily even, nor from zero; shape (n,).
      columns: its channels by name (`signals.CHANNELS`), shape (n,) each, SI; at least one position, and one of motor
        current, motor torque and joint torque. `recording["link_position"]` is one of them.
      joint: name of the joint's description, or path to one.
      description: in words.
      link: load on the output; of an arm, with the other joints in the middle of their ranges.
      arm: the joint's arm, None with `link`; load: of its motion, or of payloads, on the link, in addition to `link`,
        None while the other joints are at rest (`models.arm_dynamics`) and without payloads.
      payloads: masses that the link picks up and puts down; their times are those of its table.
      logged: time in its table [s], shape (n,), if `time` has gaps that the table does not show; else None.
      external: whether there was external torque: none, measured (the column) or unmeasured.
      source: its file, for messages.
      fixed: changes of `flexspline import --fix`, in words.

    Raises:
      InputError: columns of different length, values that are not finite or beyond `LARGEST`, time that does not
        increase, missing channels.
    """

    name: str
    time: np.ndarray
    columns: Mapping[str, np.ndarray]
    joint: str = "test-joint"
    description: str = ""
    link: Mounting = _LINK
    external: External = "none"
    source: str = ""
    arm: ArmRecord | None = None
    load: Load | None = None
    logged: np.ndarray | None = None
    fixed: tuple[str, ...] = ()
    payloads: tuple[CarriedMass, ...] = ()

    def __post_init__(self) -> None:
        where = self.source or f"recording {self.name!r}"
        object.__setattr__(self, "time", np.ascontiguousarray(self.time, dtype=np.float64))
        found = {}
        for name, given in {"time": self.time, **self.columns}.items():
            if channel(name) is None:
                raise InputError(f"{where}: column {name!r}: unknown column{nearest(name, CHANNELS)}")
            values = np.ascontiguousarray(given, dtype=np.float64)
            if values.ndim != 1 or len(values) != len(self.time):
                raise InputError(f"{where}: column {name!r}: expected shape ({len(self.time)},), got {values.shape}")
            found[name] = values
            _check_numbers(where, name, values)
        object.__setattr__(self, "columns", {k: v for k, v in found.items() if k != "time"})
        check_channels(where, self.columns)
        if len(self.time) < 2:
            raise InputError(f"{where}: expected at least 2 rows, got {len(self.time)}")
        back = np.flatnonzero(np.diff(self.time) <= 0)
        if len(back):
            i = int(back[0])
            raise InputError(
                f"{where}: column 'time', {_row(self.source, i + 1)}: expected time to increase, "
                f"got {self.time[i + 1]:.9g} s after {self.time[i]:.9g} s"
            )
        if self.external == "measured" and "external_torque" not in self.columns:
            raise InputError(f"{where}: column 'external_torque': missing, while external_torque is measured")
        if self.external != "measured" and np.any(self.columns.get("external_torque", 0.0)):
            raise InputError(
                f"{where}: external_torque: expected 'measured', as the table has that column, got {self.external!r}"
            )

    def __getitem__(self, channel: str) -> np.ndarray:
        if channel not in self.columns:
            raise InputError(f"{self.source or self.name}: column {channel!r}: missing{nearest(channel, self.columns)}")
        return self.columns[channel]

    def __contains__(self, channel: str) -> bool:
        return channel in self.columns

    def __repr__(self) -> str:
        seconds = self.time[-1] - self.time[0] if len(self.time) else 0.0
        return f"Recording({self.name!r}: {len(self.time)} samples, {seconds:.4g} s; {', '.join(self.columns)})"

    def _repr_html_(self) -> str:
        rows = [(name, _unit(name), float(x.min()), float(x.max())) for name, x in self.columns.items()]
        seconds = float(self.time[-1] - self.time[0])
        text = f"{self.joint}, {seconds:.1f} s at {1 / self.interval:.4g} Hz, {len(self.segments)} segment(s)"
        return paragraph(self.name, text) + html_table(("channel", "unit", "smallest", "largest"), rows)

    @property
    def signals(self) -> Signals:
        """Its channels."""
        return Signals(self.time, self.columns)

    def without(self, *channels: str) -> Recording:
        """Return the recording without some sensors."""
        kept = {name: values for name, values in self.columns.items() if name not in channels}
        external = self.external
        if "external_torque" in channels and external == "measured":
            external = "unmeasured"
        return replace(self, columns=kept, external=external)

    def at(self, samples: slice | np.ndarray, time: np.ndarray | None = None) -> Recording:
        """Return the recording at some of its samples, by default with their own time stamps [s]."""
        return at_samples(self, samples, **({} if time is None else {"time": time, "logged": None}))

    @property
    def stamps(self) -> np.ndarray:
        """Time of the samples in its table, shape (n,) [s]; results use it, so that both can be joined."""
        return self.time if self.logged is None else self.logged

    @cached_property
    def known_torque(self) -> np.ndarray:
        """Known torque on the link, shape (n,) [N·m]: measured, and of a moving arm."""
        known = np.zeros(len(self.time)) if self.load is None else self.load.torque.copy()
        return known + self["external_torque"] if self.external == "measured" else known

    @cached_property
    def relative_inertia(self) -> np.ndarray:
        """Inertia about the joint's axis over that of `link`, shape (n,) [1]; 1 except for a moving arm."""
        return np.ones(len(self.time)) if self.load is None else self.load.inertia / self.link.inertia

    @cached_property
    def torque_of_arm(self) -> np.ndarray:
        """Effect of a moving arm, as torque on a link of constant inertia, shape (n,) [N·m]; 0 without."""
        return np.zeros(len(self.time)) if self.load is None else self.load.on(self.link.inertia)

    @cached_property
    def segments(self) -> tuple[slice, ...]:
        """The parts between gaps, as slices of samples."""
        cuts = np.flatnonzero(np.diff(self.time) > self.gap) + 1
        edges = [0, *cuts.tolist(), len(self.time)]
        return tuple(slice(a, b) for a, b in pairwise(edges))

    @cached_property
    def gaps(self) -> tuple[tuple[float, float], ...]:
        """Start and end of every gap longer than `gap` [s]."""
        return tuple((float(self.time[s.start - 1]), float(self.time[s.start])) for s in self.segments[1:])

    @cached_property
    def interval(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time), overwrite_input=True))

    @property
    def gap(self) -> float:
        """Largest time [s] between samples of a segment: more than 0.1 s and several of its intervals."""
        return max(GAP, SEVERAL * self.interval)

    @property
    def sparse(self) -> bool:
        """Whether most samples are separated by gaps."""
        return len(self.gaps) > 0.1 * len(self.time)


@dataclass(frozen=True)
class Measurement:
    """Recordings of the same joint.

    Attributes:
      name: of the file or folder.
      path: of the file or folder.
      recordings: at least one, by name.
      passed_over: tables that were not read, with the reason: no YAML file of their stem, or another table of it was
        read.
    """

    name: str
    path: Path
    recordings: tuple[Recording, ...]
    passed_over: Mapping[Path, str] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """The folder of its files."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def files(self) -> list[Path]:
        """Its files: tables and their YAML files."""
        tables = [Path(recording.source) for recording in self.recordings if recording.source]
        return [file for table in tables for file in (table, table.with_suffix(".yaml"))]

    @property
    def fixed(self) -> tuple[str, ...]:
        """Changes of `flexspline import --fix`, a line per changed recording."""
        return tuple(f"{r.name}: changed by import --fix: {'; '.join(r.fixed)}" for r in self.recordings if r.fixed)

    def _repr_html_(self) -> str:
        rows = [(r.name, float(r.time[-1] - r.time[0]), 1 / r.interval, ", ".join(r.columns)) for r in self.recordings]
        return paragraph(self.name) + html_table(("recording", "duration [s]", "rate [Hz]", "channels"), rows)

    def load_joint(self, option: str | Path | None = None) -> Joint:
        """Return the joint of the recordings, or that of the command line, which wins."""
        if option is not None:
            return load_joint(option)
        return load_joint(self.recordings[0].joint, beside=self.folder)


def read_measurement(path: str | Path) -> Measurement:
    """Read a measurement: the file of one recording, or a folder in which every table with a YAML file of its stem is
    one.

    Of two tables of a stem the Parquet file is read, unless the other is named. Unread tables are in `passed_over`.
    Raises `InputError`: not found, a wrong recording, or recordings of different joints.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: expected a recording ({' or '.join(SUFFIXES)}) or a folder of several, not found")
    recover(path if path.is_dir() else path.parent)
    if not path.is_dir():
        recording = read_recording(path)
        table = Path(recording.source)
        named = table == path
        others = [t for suffix in SUFFIXES if (t := path.with_suffix(suffix)) != table and not named and t.is_file()]
        return Measurement(recording.name, path, (recording,), {other: f"{table.name} was read" for other in others})
    tables: dict[str, Path] = {}
    passed_over: dict[Path, str] = {}
    for suffix in SUFFIXES:
        for table in sorted(path.glob(f"*{suffix}")):
            if table.name.startswith("."):
                continue
            sidecar = table.with_suffix(".yaml")
            if not sidecar.is_file():
                passed_over[table] = f"{sidecar.name} is missing"
            elif tables.setdefault(table.stem, table) != table:
                passed_over[table] = f"{tables[table.stem].name} was read"
    if not tables:
        raise InputError(
            f"{path}: expected tables ({' or '.join(SUFFIXES)}), each with a YAML file of its stem, got none"
        )
    recordings = tuple(read_recording(tables[stem]) for stem in sorted(tables))
    for other in recordings[1:]:
        if other.joint != recordings[0].joint:
            raise InputError(
                f"{tables[other.name].with_suffix('.yaml')}: joint: expected {recordings[0].joint!r}, as in "
                f"{recordings[0].name}.yaml, got {other.joint!r}"
            )
    return Measurement(path.resolve().name, path, recordings, passed_over)


def read_recording(path: str | Path) -> Recording:
    """Read a recording from its table (or its YAML file). Raises `InputError`: one line with file, column and row of
    the error. Rows are counted from 0, without the header."""
    path = Path(path)
    if path.suffix in (".yaml", ".yml"):
        found = [path.with_suffix(s) for s in SUFFIXES if path.with_suffix(s).is_file()]
        if not found:
            raise InputError(
                f"{path}: expected a table {path.stem}.parquet or {path.stem}.csv next to it, found neither"
            )
        path = found[0]
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: expected a table ({' or '.join(SUFFIXES)}), got {path.suffix or 'no suffix'!r}")
    if not path.is_file():
        raise InputError(f"{path}: cannot read a recording: no such file")
    sidecar_path = path.with_suffix(".yaml")
    if not sidecar_path.is_file():
        raise InputError(f"{path}: expected a YAML file {sidecar_path.name} next to it, found none")
    sidecar = load(sidecar_path, Sidecar, "the YAML file of a recording")
    columns = _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)
    if "time" not in columns:
        raise InputError(f"{path}: column 'time': missing{nearest('time', columns)}")
    time = columns.pop("time")
    angles = {name: columns.pop(name) for name in list(columns) if channel(name) is None}
    recording = Recording(
        name=path.stem,
        time=time,
        columns=columns,
        joint=sidecar.joint,
        description=sidecar.description,
        link=sidecar.link if sidecar.link is not None else _LINK,
        external=sidecar.external_torque,
        source=str(path),
        fixed=sidecar.fixed,
        payloads=sidecar.payloads,
    )
    if sidecar.arm is not None:
        return in_arm(recording, sidecar.arm, angles, sidecar_path, sidecar_path.parent, sidecar_path.parent)
    if angles:
        raise InputError(
            f"{path}: column {next(iter(angles))!r}: expected {sidecar_path.name} to have `arm:`, got link"
        )
    return with_load(recording, home=sidecar_path.parent)


def in_arm(
    recording: Recording, spec: ArmSpec, angles: Mapping[str, np.ndarray], path: Path, folder: Path, home: Path | None
) -> Recording:
    """Return the recording with mounting and load from its arm.

    Args:
      recording: of one of the arm's joints; its own mounting is ignored.
      spec: of the arm; angles: columns of its other joints, shape (n,) each [rad].
      path: of the file for messages; folder: of the arm's MJCF; home: to which a path to the joint is relative.
    """
    from .arm_dynamics import Arm

    for name, values in angles.items():
        _check_numbers(recording.source, name, values)
    try:
        arm = Arm(spec, folder)
        positions = {str(joint_of(name)): values for name, values in angles.items()}
        position = _own_angle(recording, None, home)
        link, load = arm.of(recording.time, position, positions, recording.segments, recording.stamps)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return replace(recording, link=link, load=load, arm=ArmRecord(spec, arm.mjcf(), positions))


def with_load(recording: Recording, gear_ratio: float | None = None, home: Path | None = None) -> Recording:
    """Return a recording with mounting and load from its arm, or with the load of its payloads, at its angle; unchanged
    without both. `gear_ratio`: by default that of its joint; `home`: as of `in_arm`. Raises `InputError`: as of `in_arm`."""
    from .arm_dynamics import Arm

    if recording.arm is None and not recording.payloads:
        return recording
    position = _own_angle(recording, gear_ratio, home)
    if recording.arm is None:
        payloads, link = recording.payloads, recording.link
        return replace(recording, load=load_of(payloads, link, recording.stamps, position, recording.segments))
    arm = Arm(recording.arm.spec, recording.arm.mjcf)
    link, load = arm.of(recording.time, position, recording.arm.positions, recording.segments, recording.stamps)
    return replace(recording, link=link, load=load)


def _own_angle(recording: Recording, gear_ratio: float | None, home: Path | None) -> np.ndarray:
    """Return the joint's angle in its arm, shape (n,) [rad]: of the link's encoder, else the motor's over the ratio."""
    if "link_position" in recording:
        return recording["link_position"]
    return recording["motor_position"] / (gear_ratio or load_joint(recording.joint, home).numbers["N"].value)


def write_recording(recording: Recording, folder: str | Path) -> Path:
    """Write a recording as Parquet (units in the columns' metadata) and YAML; return the table's path.

    An arm is written as an MJCF of masses and joints. Files of these names are replaced one after the other; together,
    and only the same maker's, inside an `output.output_folder`. Raises `InputError`: an invalid file name, or a folder
    that cannot be written to.
    """
    folder, arm = Path(folder), recording.arm
    check_name(recording.name, "recording: name")
    path = folder / f"{recording.name}.parquet"
    sidecar = Sidecar(
        format=1,
        joint=recording.joint,
        description=recording.description,
        link=recording.link if arm is None else None,
        arm=None if arm is None else arm.spec.model_copy(update={"model": f"{recording.name}_arm.xml"}),
        external_torque=recording.external,
        fixed=recording.fixed,
        payloads=recording.payloads,
    )
    data = sidecar.model_dump(mode="json", exclude_none=True)
    for name in ("fixed", "payloads"):
        if not data[name]:
            del data[name]
    if sidecar.link is not None:
        data["link"] = sidecar.link.model_dump(mode="json", exclude_defaults=True)
    if arm is not None and sidecar.arm is not None:
        if not data["arm"]["payloads"]:
            del data["arm"]["payloads"]
        write_text(folder / sidecar.arm.model, arm.mjcf)
    text = yaml_text(data)
    columns = ordered(recording)
    notes = {"flexspline.fixed": "; ".join(recording.fixed)} if recording.fixed else {}
    with write_into_place(path) as temporary:
        units_of = {name: _unit(name) for name in columns}
        write_table(temporary, columns, units_of, metadata={_WRITTEN: _digest(text), **notes})
    write_text(path.with_suffix(".yaml"), text)
    return path


def ordered(recording: Recording) -> dict[str, np.ndarray]:
    """Return the columns of a recording's table in order, shape (n,) each."""
    known = [*CHANNELS, *(name for name in recording.columns if name not in CHANNELS)]
    ordered = {"time": recording.time, **{n: recording.columns[n] for n in known if n in recording.columns}}
    if recording.arm is not None:
        ordered |= {arm_column(joint): angle for joint, angle in recording.arm.positions.items()}
    return ordered


_WRITTEN = "flexspline.yaml"  # metadata of a recording's table: digest of its YAML file, to detect an edited one


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def edited(path: Path) -> bool:
    """Return whether the YAML file of a recording's table was edited since; False if unknown."""
    import pyarrow as pa
    import pyarrow.parquet

    try:
        written = (pa.parquet.read_schema(path).metadata or {}).get(_WRITTEN.encode(), b"").decode()
        return bool(written) and _digest(path.with_suffix(".yaml").read_text(encoding="utf-8")) != written
    except (OSError, pa.ArrowException, UnicodeDecodeError):
        return False


def _unit(name: str) -> str:
    found = channel(name)
    return found.unit if found is not None else "rad"  # an angle of an arm


def _row(source: str, index: int) -> str:
    """Return a row for messages: counted from 0 without the header, with the line of a CSV file."""
    line = f" (line {index + 2})" if source.endswith(".csv") else ""
    return f"row {index}{line}"


def _check_numbers(where: str, name: str, values: np.ndarray) -> None:
    for i in np.flatnonzero(~(np.abs(values) <= LARGEST))[:1]:
        wanted = "a finite number" if not np.isfinite(values[i]) else f"a number of at most {LARGEST:g}"
        raise InputError(f"{where}: column {name!r}, {_row(where, int(i))}: expected {wanted}, got {values[i]}")


def check_channels(where: str, columns: Iterable[str]) -> None:
    """Raise `InputError` for columns without a position or a torque."""
    columns = set(columns)
    for wanted, what in ((POSITIONS, "position"), (DRIVING, "torque")):
        if not columns.intersection(wanted):
            found = ", ".join(sorted(columns)) or "none"
            raise InputError(
                f"{where}: expected a {what}, one of the columns {', '.join(wanted)} at least, got {found}"
            )


def _check_header(path: Path, names: list[str]) -> None:
    for i, name in enumerate(names):
        if channel(name) is None and joint_of(name) is None:
            raise InputError(
                f"{path}: column {name!r}: unknown column{nearest(name, CHANNELS)}; known are {', '.join(CHANNELS)} "
                "(`flexspline import` reads a log with other columns)"
            )
        if name in names[:i]:
            raise InputError(f"{path}: column {name!r}: duplicate column")


def _read_parquet(path: Path) -> dict[str, np.ndarray]:
    import pyarrow as pa
    import pyarrow.parquet

    with reading_parquet(path):
        file = pa.parquet.ParquetFile(path, memory_map=False, pre_buffer=False)
        # Names are decoded on access.
        fields = [one for one in file.schema_arrow if not one.name.startswith("__index_level")]
        stated = {one.name: one.metadata[b"unit"].decode() for one in fields if b"unit" in (one.metadata or {})}
    _check_header(path, [one.name for one in fields])
    columns = {}
    for one in fields:  # one at a time: of an hour, 30 MB each
        kind = one.type
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            raise InputError(f"{path}: column {one.name!r}: expected numbers, got {kind}")
        expected = _unit(one.name)
        unit = stated.get(one.name, expected)
        if not units.same(unit, expected):
            raise InputError(f"{path}: column {one.name!r}: expected unit {expected!r}, got {unit!r}")
        columns[one.name] = _parquet_column(path, file, one.name)
    pa.default_memory_pool().release_unused()  # of an hour, 40 MB
    return columns


def _parquet_column(path: Path, file: pa.parquet.ParquetFile, name: str) -> np.ndarray:
    """Return a column of numbers, shape (n,), read in batches: Arrow keeps memory that it once had."""
    begin = 0
    with reading_parquet(path):
        found = large(file.metadata.num_rows)
        for batch in file.iter_batches(BLOCK, columns=[name]):
            column = batch.column(0)
            if column.null_count:
                i = begin + int(np.flatnonzero(column.is_null().to_numpy(zero_copy_only=False))[0])
                raise InputError(f"{path}: column {name!r}, {_row(str(path), i)}: expected a number, got none")
            found[begin : begin + len(column)] = np.from_dlpack(column)  # `to_numpy` would import pandas, 40 MB
            begin += len(column)
        if begin < len(found):
            raise ValueError(f"expected {len(found)} rows, as its footer states, got {begin}")
    return found


def _read_csv(path: Path) -> dict[str, np.ndarray]:
    try:
        table = TextTable(path, path.read_bytes(), CHANNELS)
    except OSError as error:
        raise InputError(f"{path}: not a readable CSV file: {error.strerror}") from error
    _check_header(path, table.names)
    if table.torn:
        warnings.warn(f"{path}: the last line is left out, as it is cut short", InputWarning, stacklevel=2)
    columns = table.read(table.names)
    for i in sorted(int(np.argmax(bad)) for values in columns.values() if np.any(bad := ~np.isfinite(values)))[:1]:
        name = next(name for name, values in columns.items() if not np.isfinite(values[i]))
        raise InputError(f"{path}: {table.fault(name, i)}")
    return columns
