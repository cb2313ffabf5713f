"""Random inputs: mutations of every shipped file, descriptions drawn from the schemas, damaged tables. Each must be used, or
refused in one line.

An input is made from (seed, number) alone, so that it can be made again.
"""

from __future__ import annotations

import copy
import json
import os
import random
import shutil
import sqlite3
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import yaml

from flexspline.diagnosis.data.exporting import write_mcap
from flexspline.diagnosis.data.importing import Layout, import_recording, known_layouts, load_layout
from flexspline.models.errors import InputError, InputWarning
from flexspline.models.joint import Joint, known_joints, load_joint, shipped
from flexspline.models.recording import Recording, Sidecar, read_measurement, write_recording
from flexspline.scenarios.arms.arm_run import run_arm
from flexspline.scenarios.arms.arm_scenario import ArmScenario, load_any
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import Scenario, load_scenario, shipped_arms, shipped_scenarios
from flexspline.scenarios.studies.dataset import Dataset, read_note
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.study import Study, load_study, shipped_studies
from flexspline.sim import plant
from flexspline.views.pages.two_diagnoses import read_diagnosis

from .jobs import recording

RESULTS = Path(__file__).resolve().parents[1] / "tests" / "frozen"
"""Small folders that commands wrote."""
ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 7, 1e-300, 1e300, -1e9, 0.5, 2**63, 2**70, 10**400, float("inf"), float("nan"), "", " ",
    "a", "1", "ä°µ", "../../../etc/passwd", "/etc/passwd", "~/x", "[bold]x[/]", "x\ny", "\x1b[31m", "a" * 5000, "no_load",
    "test-joint", "EKF", "none", "deg", "rad", [], {}, [[]], [None], [1, 2], ["a"], {"a": 1}, {"value": 1}, [1e308] * 3,
)  # fmt: skip
"""Values in place of expected ones."""
_SPLICES = (
    b"\x00", b"\xff\xfe", b"\xb0", b"\t", b"{", b"[", b"- ", b": ", b"&a *a", b"!!python/object:os.system x", b"!!binary x",
    b"1e999", b"nan", b"0x", b"'", b'"', b"#", b"|", b"...\n---\n", b"<<: *a", b"? ", b"\r\n", b"\xc2\xb2", b"[" * 200,
)  # fmt: skip


@dataclass(frozen=True)
class Failure:
    """An input that was neither used nor refused in one line.

    Attributes:
      number: of the input. kind: of file. what: what happened. where: last line of this package that took part.
    """

    number: int
    kind: str
    what: str
    where: str


@dataclass(frozen=True)
class Case:
    """A kind of file: shipped examples, and what a command does with one.

    Attributes:
      name: of the kind. sources: files. use: uses a file at a path, in a separate folder. schema: of what is in it, if any.
    """

    name: str
    sources: list[Path]
    use: Callable[[Path, random.Random], object]
    schema: Any = None


def cases() -> dict[str, Case]:
    """All kinds of files that people hand to a command."""
    found = [
        Case("joint", list(known_joints().values()), _use_joint, Joint),
        Case("scenario", list(shipped_scenarios().values()), _use_scenario, Scenario),
        Case("study", list(shipped_studies().values()), _use_study, Study),
        Case("layout", list(known_layouts().values()), _use_layout, Layout),
        Case("mjcf", sorted(shipped().glob("*joint*.xml")), _use_mjcf),
        Case("arm", list(shipped_arms().values()), _use_arm, ArmScenario),
        Case("sidecar", [], _use_sidecar, Sidecar),
        Case("table", [], _use_table),
        Case("messages", [], _use_messages),
        Case("results", [], _use_results),
    ]
    return {case.name: case for case in found}


def _use_joint(path: Path, rng: random.Random) -> None:
    joint = load_joint(path)
    for name in joint.mountings:
        joint.record(joint.mount(name))
    if rng.random() < 0.3:
        plant.build(joint)


def _use_scenario(path: Path, rng: random.Random) -> None:
    scenario, folder = load_scenario(path)
    if scenario.duration <= 100:
        experiment = Experiment.of(scenario, folder)
        if scenario.duration <= 6:
            experiment.simulate()


def _use_arm(path: Path, rng: random.Random) -> None:
    scenario, path = load_any(path)
    if isinstance(scenario, ArmScenario) and scenario.duration <= 6 and rng.random() < 0.3:
        run_arm(scenario, path.parent)


def _use_study(path: Path, rng: random.Random) -> None:
    study, folder = load_study(path)
    cells = np.prod([float(len(getattr(a, "values", None) or getattr(a, "sizes", [0]))) for a in study.axes] or [1.0])
    if cells * len(study.scenarios) < 200 and rng.random() < 0.2:
        Design.of(study, folder)


def _use_layout(path: Path, rng: random.Random) -> None:
    layout = load_layout(path)
    names = [column for channel in layout.columns.values() for column in channel.sources]
    log = path.with_name("log.csv")
    rows = rng.choice([0, 1, 2, 30])
    lines = [(layout.separator or ",").join(dict.fromkeys(names))]
    lines += [
        (layout.separator or ",").join(str(0.004 * k + 0.001 * i) for i, _ in enumerate(dict.fromkeys(names)))
        for k in range(rows)
    ]
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    import_recording(layout, log)


def _use_mjcf(path: Path, rng: random.Random) -> None:
    text = (
        known_joints()["test-joint"].read_text(encoding="utf-8").replace("model: test_joint.xml", f"model: {path.name}")
    )
    path.with_name("j.yaml").write_text(text, encoding="utf-8")
    with warnings.catch_warnings():  # a warning about other numbers is not tested here
        warnings.simplefilter("ignore", InputWarning)
        plant.build(load_joint(path.with_name("j.yaml")))


def _use_sidecar(path: Path, rng: random.Random) -> None:
    _use_measurement(path, rng)


def _use_table(path: Path, rng: random.Random) -> None:
    _use_measurement(path, rng)


def _use_results(folder: Path, rng: random.Random) -> None:
    from flexspline.commands import plan, report

    with redirect_stdout(StringIO()):
        if (folder / "diagnosis.json").is_file() and rng.random() < 0.5:
            read_diagnosis(folder)
            plan.command(source=folder)
        elif (folder / "study.json").is_file() and rng.random() < 0.5:
            design = Design.of(*load_study(str(RESULTS / "study.yaml")))
            list(Dataset.open(folder, design, read_note(RESULTS / "sweep" / "study.json")["versions"]).missing(1))
        else:
            report.command(folders=[folder], out=folder.parent / "report.html")


def _use_messages(path: Path, rng: random.Random) -> None:
    import_recording(load_layout(path.with_name("mapping.yaml")), path)


def _use_measurement(path: Path, rng: random.Random) -> None:
    from flexspline.commands import check, estimate

    data = read_measurement(path)
    data.load_joint()
    with redirect_stdout(StringIO()):
        if rng.random() < 0.5:
            check.command(measurement=path)
        if rng.random() < 0.1:
            estimate.command(measurement=path, out=path.parent / "estimates", filter_=["model", "EKF", "lowpass"])


# --- what is made of them ---------------------------------------------------------------------------------------------


def bytes_mutated(content: bytes, rng: random.Random) -> bytes:
    """A file with a few bytes, lines or numbers changed."""
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        at = rng.randrange(len(data) + 1)
        kind = rng.randrange(8)
        if kind == 0:
            data = data[:at]
        elif kind == 1:
            data[at : at + rng.choice([1, 3, 30])] = b""
        elif kind == 2:
            data[at:at] = rng.choice(_SPLICES)
        elif kind == 3 and data:
            data[at % len(data)] = rng.randrange(256)
        elif kind == 4:
            lines = bytes(data).split(b"\n")
            k = rng.randrange(len(lines))
            data = bytearray(b"\n".join([*lines[: k + 1], *lines[k:]]))
        elif kind == 5:
            lines = bytes(data).split(b"\n")
            del lines[rng.randrange(len(lines))]
            data = bytearray(b"\n".join(lines))
        elif kind == 6:
            data = bytearray(data.decode("utf-8", "replace").encode("latin-1", "replace"))
        else:
            words = bytes(data).split(b" ")
            words[rng.randrange(len(words))] = str(rng.choice(ODD)).encode()[:200]
            data = bytearray(b" ".join(words))
    return bytes(data)


def structure_mutated(data: Any, rng: random.Random) -> Any:
    """Plain data with values replaced, keys removed, renamed or added."""
    data = copy.deepcopy(data)
    for _ in range(rng.choice([1, 1, 2, 4])):
        places = list(_places(data))
        if not places:
            return rng.choice(ODD)
        holder, key = rng.choice(places)
        kind = rng.randrange(6)
        if kind == 0:
            del holder[key]
        elif kind == 1 and isinstance(holder, dict):
            holder[rng.choice([f"{key}x", "name", 3, "a b"])] = holder.pop(key)
        elif kind == 2 and isinstance(holder, list):
            holder.extend(copy.deepcopy(holder[key]) for _ in range(rng.choice([1, 40])))
        elif kind == 3 and isinstance(holder[key], (int, float)) and not isinstance(holder[key], bool):
            factor = rng.choice([-1, 0, 1e-9, 1e9, 1e30, 57.3, 1000, 0.001])
            with suppress(OverflowError):  # 10⁴⁰⁰, put there before, is no float
                holder[key] = holder[key] * factor
        else:
            holder[key] = copy.deepcopy(rng.choice(ODD))
    return data


def _places(data: Any) -> Iterator[tuple[Any, Any]]:
    for key in list(data) if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ():
        yield data, key
        yield from _places(data[key])


def drawn(schema: dict[str, Any], whole: dict[str, Any], rng: random.Random, depth: int = 0) -> Any:
    """Data drawn from a JSON schema, mostly as it wants them, at its bounds, and odd here and there."""
    if rng.random() < 0.03 or depth > 8:
        return copy.deepcopy(rng.choice(ODD))
    if "$ref" in schema:
        return drawn(whole["$defs"][schema["$ref"].rsplit("/", 1)[-1]], whole, rng, depth)
    for key in ("anyOf", "oneOf", "allOf"):
        if key in schema:
            return drawn(rng.choice(schema[key]), whole, rng, depth)
    if "const" in schema or "enum" in schema:
        return rng.choice(schema.get("enum", [schema.get("const")]))
    kind = schema.get("type")
    if kind == "object":
        found = {
            name: drawn(inner, whole, rng, depth + 1)
            for name, inner in schema.get("properties", {}).items()
            if name in schema.get("required", ()) or rng.random() < 0.5
        }
        extra = schema.get("additionalProperties")
        if isinstance(extra, dict):
            for name in rng.sample(
                ["N", "Jm", "link", "no_load", "a", "K1", "time", "motor_position"], rng.randrange(4)
            ):
                found[name] = drawn(extra, whole, rng, depth + 1)
        return found
    if kind == "array":
        low = schema.get("minItems", 0)
        return [drawn(schema.get("items", {}), whole, rng, depth + 1) for _ in range(low + rng.randrange(3))]
    if kind in ("number", "integer"):
        low = schema.get("minimum", schema.get("exclusiveMinimum", -1e3))
        high = schema.get("maximum", schema.get("exclusiveMaximum", 1e3))
        value = rng.choice([low, high, rng.uniform(float(low), min(float(high), 1e6)), 1, 0])
        return int(value) if kind == "integer" else float(value)
    if kind == "boolean":
        return rng.random() < 0.5
    if kind == "null":
        return None
    return rng.choice(["a", "test-joint", "no_load", "link", "EKF", "rad", "N·m", "s", "measured", "A", "1"])


def measurement(rng: random.Random, folder: Path) -> Path:
    """A small recording, such as people have: scales, rates, units and lengths that are ordinary and that are not."""
    n = rng.choice([2, 3, 10, 49, 50, 200, 1500])
    rate = rng.choice([1.0, 20.0, 100.0, 1000.0, 1e6])
    t = np.arange(n) / rate * rng.choice([1.0, 1.0, 1.0, 1e3])
    q = rng.choice([0.0, 0.4, 57.3, 1e6]) * np.sin(2 * t)
    noise = np.random.default_rng(rng.randrange(2**32)).normal
    columns = {
        "motor_position": 100 * q + noise(0, 1e-4, n),
        "link_position": q + noise(0, 1e-6, n),
        "motor_current": rng.choice([0.0, 1.0, 1e3, 1e9]) * np.cos(2 * t) + noise(0, 1e-3, n),
        "joint_torque": rng.choice([0.0, 5.0, 5e3]) * np.cos(2 * t),
    }
    for name in rng.sample(sorted(columns), rng.randrange(4)):
        kind = rng.randrange(5)
        if kind == 0:
            columns[name] = np.zeros(n)
        elif kind == 1:
            columns[name] = np.full(n, rng.choice([1.0, 1e29, -1e-300]))  # the largest that a recording holds is 1e30
        elif kind == 2:
            columns[name] = -columns[name]
        elif kind == 3:
            columns[name][rng.randrange(n)] += rng.choice([1e9, 2 * np.pi, 1e-9])
    if rng.random() < 0.2:
        columns["motor_position"], columns["link_position"] = columns["link_position"], columns["motor_position"]
    kept = {name: x for name, x in columns.items() if rng.random() < 0.85}
    if not {"motor_position", "link_position"} & set(kept) or not {"motor_current", "joint_torque"} & set(kept):
        kept = columns
    external = rng.choice(["none", "unmeasured"])
    return write_recording(Recording("m", t + rng.choice([0.0, 1e9]), kept, external=external), folder)


def table_damaged(path: Path, rng: random.Random) -> Path:
    """A table of which bytes, cells, columns or rows are wrong; as Parquet or as CSV."""
    table = pq.read_table(path)
    kind = rng.randrange(7)
    if kind == 0:
        path.write_bytes(bytes_mutated(path.read_bytes(), rng))
        return path
    if kind == 1:
        name = rng.choice(table.column_names)
        values = table[name].to_numpy().copy()
        values = values.astype(float) if values.dtype.kind in "iu" else values
        values[rng.randrange(len(values))] = rng.choice([np.nan, np.inf, -np.inf, 1e308])
        table = table.set_column(table.column_names.index(name), name, pa.array(values))
    elif kind == 2:
        name = rng.choice(table.column_names)
        table = table.set_column(
            table.column_names.index(name), name, pa.array([rng.choice(["a", "1", "°"])] * len(table))
        )
    elif kind == 3:
        table = table.drop_columns([rng.choice(table.column_names)])
    elif kind == 4:
        table = table.slice(0, rng.choice([0, 1, 2]))
    elif kind == 5:
        order = list(range(len(table)))
        rng.shuffle(order)
        table = table.take(order)
    if rng.random() < 0.5:
        pq.write_table(table, path)
        return path
    path.unlink()
    text = path.with_suffix(".csv")
    pa.csv.write_csv(table, text)
    if kind == 6:
        text.write_bytes(bytes_mutated(text.read_bytes(), rng))
    return text


_COLUMNS = {
    "time": "/joint_states/stamp", "motor_position": "/joint_states/position/motor",
    "link_position": "/joint_states/position/link", "motor_current": "/motor_current/data",
}  # fmt: skip


def messages_damaged(rng: random.Random, folder: Path) -> Path:
    """An MCAP file of ROS 2 or of JSON, or a bag as a database, of which bytes or values are wrong; and its mapping."""
    units = ("s", "rad", "rad", "A")
    columns = {k: {"column": v, "unit": u} for (k, v), u in zip(_COLUMNS.items(), units, strict=True)}
    mapping = {"format": 1, "name": "log", "joint": "test-joint", "link": {"inertia": 0.35, "gravity_moment": 9.0}}
    (folder / "mapping.yaml").write_text(yaml.safe_dump(mapping | {"columns": columns}), encoding="utf-8")
    t = np.arange(rng.choice([2, 30, 100])) * 1e-3 + rng.choice([0.0, 1e9])
    if rng.random() < 0.4:
        made = {"motor_position": 100 * t, "link_position": t, "motor_current": np.cos(t)}
        write_mcap(Recording("m", t, made), folder / "log.mcap")
        (folder / "log.mcap").write_bytes(bytes_mutated((folder / "log.mcap").read_bytes(), rng))
        return folder / "log.mcap"
    told = []
    for k, seconds in enumerate(t):
        stamp = {"sec": int(seconds // 1), "nanosec": int(1e9 * (seconds % 1))}
        states = {"header": {"stamp": stamp}, "name": ["motor", "link"], "position": [100.0 * k, 1.0 * k]}
        for topic, message in (("/joint_states", states), ("/motor_current", {"data": 0.1 * k})):
            told.append((topic, structure_mutated(message, rng) if rng.random() < 0.02 else message))
    if rng.random() < 0.5:
        return _json_mcap(told, folder / "log.mcap")
    return _bag(told, folder / "bag", rng)


def _json_mcap(told: list[tuple[str, Any]], path: Path) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {topic: writer.register_channel(topic, "json", schema) for topic in dict(told)}
        for k, (topic, message) in enumerate(told):
            writer.add_message(channels[topic], 1_000_000 * k, json.dumps(message).encode(), 1_000_000 * k)
        writer.finish()
    return path


def _bag(told: list[tuple[str, Any]], folder: Path, rng: random.Random) -> Path:
    """A bag whose database holds anything that SQLite accepts: text for numbers, nothing, blobs."""

    def odd(value: Any) -> Any:
        return rng.choice([None, "x", b"\xff\x00", -1, 2**62, 1.5, "", "../x"]) if rng.random() < 0.003 else value

    folder.mkdir()
    with closing(sqlite3.connect(folder / "log.db3")) as file:
        file.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        file.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        file.execute("CREATE TABLE message_definitions(topic_type, encoding, encoded_message_definition)")
        topics = list(dict(told))
        for number, topic in enumerate(topics):
            file.execute("INSERT INTO topics VALUES (?, ?, ?, ?)", (odd(number), odd(topic), odd("any"), odd("json")))
        if rng.random() < 0.9:
            file.execute("INSERT INTO message_definitions VALUES (?, ?, ?)", (odd("any"), odd("ros2msg"), odd("x y")))
        rows = [
            (odd(topics.index(n)), odd(1_000_000 * k), odd(json.dumps(m).encode())) for k, (n, m) in enumerate(told)
        ]
        file.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        file.commit()
    if rng.random() < 0.2:
        (folder / "log.db3").write_bytes(bytes_mutated((folder / "log.db3").read_bytes(), rng))
    about: Any = {"rosbag2_bagfile_information": {"relative_file_paths": ["log.db3"], "compression_mode": ""}}
    about = structure_mutated(about, rng) if rng.random() < 0.1 else about
    (folder / "metadata.yaml").write_text(yaml.dump(about), encoding="utf-8")
    return folder


def results_damaged(rng: random.Random, folder: Path) -> Path:
    """What a command wrote, of which one file is wrong or missing."""
    kind = rng.choice(["run", "sweep", "diagnosis", "validation", "contact"])
    path = folder / kind
    if kind == "contact":
        path.mkdir()
        shutil.copy(RESULTS.parents[1] / "docs" / "contact.csv", path)
    elif kind == "validation":
        _validate(path)
    else:
        shutil.copytree(RESULTS / kind, path)
    chosen = rng.choice(sorted(p for p in path.rglob("*") if p.is_file()))
    if rng.random() < 0.05:
        chosen.unlink()
    elif chosen.suffix == ".parquet":
        table_damaged(chosen, rng)
    elif chosen.suffix in (".json", ".yaml") and rng.random() < 0.7:
        data = structure_mutated(yaml.safe_load(chosen.read_bytes()), rng)
        text = json.dumps(data) if chosen.suffix == ".json" else yaml.safe_dump(data, allow_unicode=True)
        chosen.write_text(text, encoding="utf-8")
    else:
        chosen.write_bytes(bytes_mutated(chosen.read_bytes(), rng))
    return path


def _validate(out: Path) -> None:
    from flexspline.commands import validate

    write_recording(recording(2.0), out.parent / "m")
    with redirect_stdout(StringIO()):
        validate.command(measurement=out.parent / "m", out=out)


def make(case: Case, rng: random.Random, folder: Path) -> Path:
    """An input of a kind in a separate folder."""
    if case.name == "results":
        return results_damaged(rng, folder)
    if case.name == "messages":
        return messages_damaged(rng, folder)
    if case.name in ("sidecar", "table"):
        path = measurement(rng, folder)
        if case.name == "table":
            return table_damaged(path, rng)
        sidecar = path.with_suffix(".yaml")
        _write_mutated(sidecar, sidecar.read_bytes(), case, rng)
        return path
    source = rng.choice(case.sources)
    path = folder / source.name
    if case.name == "mjcf":
        path.write_bytes(bytes_mutated(source.read_bytes(), rng))
        return path
    for mjcf in source.parent.glob("*.xml"):
        shutil.copy(mjcf, folder)
    _write_mutated(path, source.read_bytes(), case, rng)
    return path


def _write_mutated(path: Path, content: bytes, case: Case, rng: random.Random) -> None:
    kind = rng.random()
    if kind < 0.35:
        path.write_bytes(bytes_mutated(content, rng))
        return
    if kind < 0.75 or case.schema is None:
        data = structure_mutated(yaml.safe_load(content), rng)
    else:
        schema = case.schema.model_json_schema(mode="validation")
        data = drawn(schema, schema, rng)
    path.write_text(yaml.dump(data, allow_unicode=True), encoding="utf-8")


# --- and what became of them ------------------------------------------------------------------------------------------


def one(seed: int, number: int, only: tuple[str, ...] = ()) -> tuple[str, str, Failure | None]:
    """Make an input and use it: its kind, `used` or `refused`, and the failure if that is what it was."""
    rng = random.Random(f"{seed}/{number}")
    known = cases()
    case = known[rng.choice(only or tuple(known))]
    with _sandbox() as (outside, folder):
        path = make(case, rng, folder)
        inputs = {p: p.read_bytes() for p in folder.iterdir() if p.is_file()}
        became, failure = "used", None
        try:
            case.use(path, rng)
        except InputError as error:
            became = "refused"
            text = str(error)
            if "\n" in text or len(text) > 1000 or not text.isprintable():
                failure = Failure(number, case.name, f"refused in other than one line: {text[:200]!r}", "")
        except Exception as error:
            became = "failed"
            own = [f for f in traceback.extract_tb(error.__traceback__) if "site-packages" not in f.filename]
            where = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
            failure = Failure(number, case.name, f"{type(error).__name__}: {str(error)[:150]}", where)
        changed = [p.name for p, content in inputs.items() if not p.exists() or p.read_bytes() != content]
        if changed:
            failure = Failure(number, case.name, f"changed its input {changed}", "")
        stray = sorted(p.name for p in outside.iterdir() if p != folder and p.name != "cwd")
        stray += sorted(p.name for p in (outside / "cwd").iterdir())
        if stray:
            failure = Failure(number, case.name, f"wrote elsewhere: {stray}", "")
    return case.name, became, failure


@contextmanager
def _sandbox() -> Iterator[tuple[Path, Path]]:
    before = Path.cwd()
    outside = Path(tempfile.mkdtemp(prefix="fuzz"))
    try:
        (outside / "cwd").mkdir()
        (outside / "in").mkdir()
        os.chdir(outside / "cwd")
        yield outside, outside / "in"
    finally:
        os.chdir(before)
        shutil.rmtree(outside, ignore_errors=True)


def main() -> None:
    """Use the inputs `begin` … `end` − 1 and print what became of each, a line each: for `benchmarks.reliability`."""
    import warnings

    warnings.simplefilter("ignore")
    seed, begin, end = (int(word) for word in sys.argv[1:4])
    only = tuple(sys.argv[4:])
    for number in range(begin, end):
        print(f"begin\t{number}", flush=True)
        kind, became, failure = one(seed, number, only)
        found = "" if failure is None else f"{failure.what}\t{failure.where}"
        print(f"end\t{number}\t{kind}\t{became}\t{found}".replace("\n", " "), flush=True)


if __name__ == "__main__":
    main()
