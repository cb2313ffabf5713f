"""Logs of messages as tables: MCAP files and bags. A column is a topic and a field in it: `/joint_states/position/elbow`.

Fields lie inside each other by slashes. In a list an element is named by its index, or by its name where the message has a list
`name` (or `joint_names`, …) of the same length, as `sensor_msgs/JointState` has. `TOPIC/stamp` is a message's time [s]: its
header's stamp, or else when it was logged; where most stamps of a topic were there before, that of all topics is when they were
logged.

Samples are the messages of one topic, that of the column that is asked for first (the mapping's time). Numbers of
other topics are interpolated linearly between their messages; a sample that does not lie between two of these, or in a gap
of theirs, is left out.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Set
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from ...models.errors import InputError
from ...models.files import shown
from ...models.recording import GAP
from .log import LABELS, Log, needing, reading

STAMP = "stamp"
_FARTHEST = 2**62  # ns, so that differences of times fit into 64 bits
_LISTED = 50
"""Messages of a topic in which names of columns are looked for."""

_HEADER = """std_msgs/Header header
{}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_WRENCH = """================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
DEFINITIONS = {
    "sensor_msgs/msg/JointState": _HEADER.format(
        "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    "geometry_msgs/msg/WrenchStamped": _HEADER.format("geometry_msgs/Wrench wrench") + _WRENCH,
    "sensor_msgs/msg/Temperature": _HEADER.format("float64 temperature\nfloat64 variance"),
    "std_msgs/msg/Float64": "float64 data\n",
    "std_msgs/msg/Float32": "float32 data\n",
}
"""Definitions of the usual messages, which a bag does not bring itself."""


@dataclass
class _Topic:
    """Messages of one topic: stamps and times of logging [ns], and the numbers of every wanted field at them; NaN where a message
    has it not."""

    times: list[int] = field(default_factory=list)
    logged: list[int] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=dict)
    names: dict[str, None] = field(default_factory=dict)


class Messages(Log):
    """Messages as a table; its names are the columns of the topics that were read, and the topics that were not."""

    def __init__(self, path: Path, topics: dict[str, _Topic], others: Iterable[str]):
        self.path = path
        self._topics = topics
        self.names = [f"{topic}/{name}" for topic, t in topics.items() for name in (STAMP, *t.names)] + list(others)

    def find(self, column: str) -> str | None:
        return column if column in self.names else None

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        """Columns, shape (n,) each, at the messages of the first one's topic."""
        split = {column: self._split(column) for column in wanted}
        by_topic: dict[str, list[str]] = {}
        for topic, name in split.values():
            by_topic.setdefault(topic, []).append(name)
        found = {topic: self._table(topic, names) for topic, names in by_topic.items()}
        notes = []
        if coarse := [f"{again} of {count} of {t}" for t, (_, again, count) in found.items() if 2 * again > count]:
            for topic in by_topic:
                self._topics[topic].times = self._topics[topic].logged
            found = {topic: self._table(topic, names) for topic, names in by_topic.items()}
            notes = [
                f"most stamps were there before ({', '.join(coarse)}): times are those at which messages were logged"
            ]
        if alone := [topic for topic, (table, *_) in found.items() if len(table[STAMP]) < 2]:
            raise InputError(f"{self.path}: topic {alone[0]}: expected messages at different times, got all at one")
        dropped = [f"{again} of {count} messages of {topic}" for topic, (_, again, count) in found.items() if again]
        notes += [f"{', '.join(dropped)} are left out, as their time was there before"] if dropped else []
        self.note = "; ".join(notes)
        tables = {topic: table for topic, (table, *_) in found.items()}
        main, *others = by_topic
        times = tables[main][STAMP]
        inside = np.ones(len(times), dtype=bool)
        for topic in others:
            theirs = tables[topic][STAMP]
            after = np.clip(np.searchsorted(theirs, times), 1, max(len(theirs) - 1, 1))
            near = (theirs[after] - theirs[after - 1] <= 1e9 * GAP) | np.isin(times, theirs)
            inside &= (times >= theirs[0]) & (times <= theirs[-1]) & near
        if not np.any(inside):
            raise InputError(f"{self.path}: expected messages of {', '.join(by_topic)} at the same time, got none")
        at, columns = times[inside], {}
        for column, (topic, name) in split.items():
            if name == STAMP:
                columns[column] = 1e-9 * (at - at[0])
            elif topic == main:
                columns[column] = tables[topic][name][inside]
            else:
                columns[column] = np.interp(at - at[0], tables[topic][STAMP] - at[0], tables[topic][name])
        return columns

    def _split(self, column: str) -> tuple[str, str]:
        topic = max((t for t in self._topics if column.startswith(f"{t}/")), key=len)
        return topic, column[len(topic) + 1 :]

    def _table(self, topic: str, names: list[str]) -> tuple[dict[str, np.ndarray], int, int]:
        """Times [ns] and numbers of the messages of a topic that have all of them, in order, each time once; how many messages
        are left out for that, and of how many."""
        one = self._topics[topic]
        columns = {name: np.array(one.values[name]) for name in names if name != STAMP}
        stamps = np.array(one.times, dtype=np.int64)
        whole = np.all([np.ones(len(stamps), bool), *map(np.isfinite, columns.values())], axis=0)
        times, rows = np.unique(stamps[whole], return_index=True)
        count = int(np.count_nonzero(whole))
        if count < 2:
            raise InputError(f"{self.path}: topic {topic}: expected messages with {', '.join(names)}, got {count}")
        table = {STAMP: times} | {name: values[whole][rows] for name, values in columns.items()}
        return table, count - len(times), count

    def row(self, index: int) -> str:
        """A sample for people."""
        return f"sample {index}"


def open_messages(path: Path, wanted: Set[str] | None = None) -> Messages:
    """Read the `wanted` columns (None: all) of an MCAP file or a bag; `path`: of the file, or of a ROS 2 bag's folder. Raises
    `InputError`: a file that cannot be read, messages in an unknown encoding, packages that are not installed."""
    topics: dict[str, _Topic] = {}
    others: dict[str, None] = {}

    def is_wanted(topic: str) -> bool:
        if wanted is None or any(column.startswith(f"{topic}/") for column in wanted):
            return True
        others[topic] = None
        return False

    reader = _mcap if path.suffix == ".mcap" else _bag
    for topic, logged, message in reader(path, is_wanted):
        one = topics.setdefault(topic, _Topic())
        try:
            _add(one, topic, logged, message, wanted)
        except ValueError as error:
            raise InputError(f"{path}: topic {topic}, message {len(one.times) + 1}: {error}") from error
    if not topics:
        known = f"; it has {', '.join(others)}" if others else ""
        raise InputError(f"{path}: expected messages of the topics that the mapping names, got none{known}")
    return Messages(path, topics, others)


def _add(one: _Topic, topic: str, logged: int, message: Any, wanted: Set[str] | None) -> None:
    """Take a message's wanted numbers."""
    one.times.append(_time(message, logged))
    one.logged.append(_nanoseconds([0, logged]))
    if len(one.times) <= _LISTED:
        one.names.update(dict.fromkeys(_numbers(message)))
    columns = [f"{topic}/{name}" for name in one.names] if wanted is None else wanted
    mine = [column.removeprefix(f"{topic}/") for column in columns if column.startswith(f"{topic}/")]
    for name in (name for name in mine if name != STAMP):
        values = one.values.setdefault(name, [np.nan] * (len(one.times) - 1))
        values.append(_number(message, name.split("/")))
        if np.isfinite(values[-1]):  # another publisher may have been first
            one.names[name] = None


def _time(message: Any, logged: Any) -> int:
    """When a message was stamped, or else logged [ns]; `ValueError` where that is no such number."""
    stamp = _inside(_inside(message, "header"), "stamp") or _inside(message, "timestamp")
    seconds, *rest = (_inside(stamp, name) for name in ("sec", "nanosec", "nsec"))
    rest = [x for x in rest if x is not None]
    stamped = 0 if seconds is None or not rest else _nanoseconds([seconds, rest[0]])
    return stamped or _nanoseconds([0, logged])  # a stamp of zero is unset


def _nanoseconds(parts: list[Any]) -> int:
    with suppress(TypeError, ValueError, OverflowError):
        whole = [int(x) for x in parts]
        if whole == parts and abs(at := whole[0] * 10**9 + whole[1]) < _FARTHEST:
            return at
    raise ValueError(f"expected a stamp in whole seconds and nanoseconds, got {shown(parts)}")


def _inside(message: Any, name: str) -> Any:
    return message.get(name) if isinstance(message, dict) else getattr(message, name, None)


def _number(message: Any, parts: list[str], names: list[str] | None = None) -> float:
    """A number in a message; NaN where there is none. `names`: of the elements, where the message is a list."""
    for at, part in enumerate(parts):
        if _is_list(message):
            rest = "/".join(parts[at:])  # a joint's name may have slashes
            if names and rest in names:
                message, parts = message[names.index(rest)], []
                break
            if not part.isdecimal() or int(part) >= len(message):
                return np.nan
            message, names = message[int(part)], None
            continue
        found = _inside(message, part)
        names = _names_of(message, found)
        message = found
    try:
        return float(message) if isinstance(message, (int, float, np.number)) else np.nan
    except OverflowError:  # of JSON, which has whole numbers of any size
        return np.nan


def _is_list(found: Any) -> bool:
    return isinstance(found, (list, tuple)) or (
        hasattr(found, "__getitem__") and hasattr(found, "__len__") and not isinstance(found, (str, bytes, dict))
    )


def _names_of(message: Any, found: Any) -> list[str] | None:
    """Names of a list's elements, where its message has some."""
    if not _is_list(found):
        return None
    for key in LABELS:
        names = _inside(message, key)
        if _is_list(names) and len(names) == len(found) and all(isinstance(n, str) for n in names):
            return list(names)
    return None


def _numbers(message: Any, prefix: str = "", names: list[str] | None = None) -> Iterator[str]:
    """Names of all numbers in a message."""
    if isinstance(message, (int, float, np.number)):
        yield prefix.rstrip("/")
    elif isinstance(message, (str, bytes)) or message is None:
        return
    elif _is_list(message):
        for index, one in enumerate(message):
            yield from _numbers(one, f"{prefix}{names[index] if names else index}/")
    else:
        own = getattr(message, "__slots__", None) or getattr(message, "__dict__", {})
        fields = message if isinstance(message, dict) else [name for name in own if not name.startswith("_")]
        for key in fields:
            found = _inside(message, key)
            yield from _numbers(found, f"{prefix}{key}/", _names_of(message, found))


Wanted = Callable[[str], bool]
Found = Iterator[tuple[str, int, Any]]
"""Topic, when it was logged [ns], and the message."""


def _decoder(factory: Any, path: Path, topic: str, encoding: str, schema: Any) -> Callable[[bytes], Any]:
    """What makes messages of a topic's bytes."""
    from mcap.records import Schema

    if encoding == "json":
        return json.loads
    try:
        if encoding == "cdr" and schema is not None:
            text = DEFINITIONS.get(schema.name, "")
            if schema.encoding != "ros2msg" and text:
                schema = Schema(data=text.encode(), encoding="ros2msg", id=schema.id, name=schema.name)
            with redirect_stdout(StringIO()):  # it prints what it cannot read
                found = factory.decoder_for(encoding, schema)
            if found is not None:
                return found
    except Exception as error:  # of the parser
        raise InputError(f"{path}: topic {topic}: not a readable definition of {schema.name}: {error}") from error
    kind = f"{encoding or 'no encoding'}, defined in {schema.encoding or 'nothing'}" if schema is not None else encoding
    raise InputError(f"{path}: topic {topic}: expected messages of ROS 2 (cdr, ros2msg) or JSON, got {kind}")


def _mcap(path: Path, wanted: Wanted) -> Found:
    with needing("packages mcap and mcap-ros2-support", "reading MCAP files", "mcap"):
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    factory = DecoderFactory()
    decoders: dict[int, Callable[[bytes], Any]] = {}
    with path.open("rb") as stream, reading(path, "MCAP file"):
        reader = make_reader(stream)
        summary = reader.get_summary()
        chosen = None if summary is None else [c.topic for c in summary.channels.values() if wanted(c.topic)]
        if chosen == []:
            return
        for schema, channel, message in reader.iter_messages(topics=chosen):
            topic = channel.topic
            if not wanted(topic):
                continue
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(factory, path, topic, channel.message_encoding, schema)
            try:
                found = decoders[channel.id](message.data)
            except Exception as error:  # of bytes that are none of such a message
                kind = type(error).__name__
                raise InputError(f"{path}: topic {topic}: not a readable message: {kind}: {error}") from error
            yield topic, message.log_time, found


def _bag(path: Path, wanted: Wanted) -> Found:
    """Messages of a ROS 1 bag, or of a ROS 2 bag's folder or database; the usual definitions where it brings none."""
    with needing("package rosbags", "reading bags"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    store = get_typestore(Stores.ROS2_HUMBLE)
    what = "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag"
    with reading(path, what), AnyReader([path], default_typestore=store) as reader:
        chosen = [connection for connection in reader.connections if wanted(connection.topic)]
        for connection, logged, data in reader.messages(chosen) if chosen else ():
            yield connection.topic, logged, reader.deserialize(data, connection.msgtype)
