"""Formats of logs: the same numbers in every form that people save them in come out the same, or are refused with the reason."""

from __future__ import annotations

import bz2
import gzip
import json
import lzma
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import yaml

import flexspline as fs
from flexspline.models.errors import InputError, InputWarning
from flexspline.models.recording import read_measurement

h5py = pytest.importorskip("h5py")
openpyxl = pytest.importorskip("openpyxl")

N, SEED = 400, 11
_rng = np.random.default_rng(SEED)
T = np.round(0.004 * np.arange(N), 3)
Q = np.round(0.4 * np.sin(3 * T) + 1e-3 * _rng.normal(size=N), 6)
I = np.round(2.0 * np.cos(3 * T) + 0.02 * _rng.normal(size=N), 5)
ROWS = list(zip(T, Q, I, strict=True))
BY_NAME = {"time": "time", "link_position": "q", "motor_current": "current"}
UNITS = {"time": "s", "link_position": "rad", "motor_current": "A"}


def mapping(folder: Path, names: dict[str, Any] = BY_NAME, **keys: Any) -> Path:
    """A mapping of three columns, with more keys; of a column by a dictionary instead of a name all of it."""
    columns = {
        target: one if isinstance(one, dict) else {"column": one, "unit": UNITS[target]}
        for target, one in (BY_NAME | names).items()
    }
    data = {"format": 1, "name": "case", "joint": "test-joint", "link": {"inertia": 0.35, "gravity_moment": 9.0}}
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(data | {"columns": columns} | keys, allow_unicode=True), encoding="utf-8")
    return path


def comes_out(recording: fs.Recording, keep: slice | np.ndarray = slice(None), atol: float = 1e-9) -> None:
    time = T[keep]
    np.testing.assert_allclose(recording.time - recording.time[0], time - time[0], rtol=0, atol=max(atol, 1e-6))
    np.testing.assert_allclose(recording["link_position"], Q[keep], rtol=0, atol=atol)
    np.testing.assert_allclose(recording["motor_current"], I[keep], rtol=0, atol=atol)


def text(
    separator: str = ",", decimal: str = ".", header: str | None = "time,q,current", end: str = "\n", junk: str = ""
) -> str:
    """The numbers as text; `junk`: one more column that is no number."""
    rows = [
        separator.join([*(f"{x:.6f}".replace(".", decimal) for x in row), *([junk] if junk else [])]) for row in ROWS
    ]
    first = [header.replace(",", separator) + (f"{separator}state" if junk else "")] if header is not None else []
    return end.join([*first, *rows]) + end


def stamps(start: str, form: str) -> list[str]:
    return [
        (pd.Timestamp(start) + pd.Timedelta(seconds=float(t))).strftime(form)[: -3 if form.endswith("%f") else None]
        for t in T
    ]


def with_times(times: list[str], separator: str = ",") -> str:
    return "\n".join(
        [separator.join(["time", "q", "current"])]
        + [f"{t}{separator}{q}{separator}{i}" for t, (_, q, i) in zip(times, ROWS, strict=True)]
    )


TEXTS: dict[str, str | bytes] = {
    "plain": text(),
    "semicolons and decimal commas": text(";", ","),
    "semicolons and points, a text column": text(";", junk="running"),
    "tabs and decimal commas": text("\t", ","),
    "tabs": text("\t"),
    "bars": text("|"),
    "blanks": text(" "),
    "a column of text first": "\n".join(
        f"{'name' if k == 0 else 'arm'},{line}" for k, line in enumerate(text().splitlines())
    )
    + "\n",
    "aligned by blanks": "\n".join(
        ["   time        q   current"] + [f"{t:12.4f}  {q:12.6f} {i:12.5f}" for t, q, i in ROWS]
    ),
    "commas and blanks": text().replace(",", ", "),
    "windows line ends": text(end="\r\n"),
    "utf-8 with a mark": b"\xef\xbb\xbf" + text().encode(),
    "utf-16": text().encode("utf-16"),
    "utf-16 big endian with a mark": b"\xfe\xff" + text().encode("utf-16-be"),
    "utf-16 without a mark": text().encode("utf-16-le"),
    "latin-1": text(junk="25 °C").encode("latin-1"),
    "comments with #": "# bench, joint 2\n# 250 Hz\n" + text(),
    "comments with %": "% bench, joint 2\n%\n" + text(";", ","),
    "comments with //": "// bench\n" + text("\t"),
    "a header that is a comment": "# a bench\n# " + text(),
    "a header that is a comment, blanks": "#" + text(" "),
    "a title and an empty line": "Bench 7; joint 2\nOperator; N. N.\n\n" + text(),
    "many lines before the header": "\n".join(f"key {k} = {k * 3}" for k in range(60)) + "\n" + text(),
    "units in a row": text().replace("current\n", "current\ns,rad,A\n", 1),
    "units in a row, in brackets": text(";").replace("current\n", "current\n[s];[rad];[A]\n", 1),
    "long and short names": "Time stamp,Link angle,Motor current\n" + text(),
    "every row ends with a separator": text().replace("\n", ",\n").replace("current,", "current"),
    "header and rows end with a separator": text(end=";\n", separator=";"),
    "row numbers": "\n".join(f"{k or ''},{line}" for k, line in enumerate(text().splitlines())),
    "row numbers without a name": "\n".join(
        line if k == 0 else f"{k},{line}" for k, line in enumerate(text().splitlines())
    ),
    "quoted": "\n".join(",".join(f'"{cell}"' for cell in line.split(",")) for line in text().splitlines()),
    "quoted decimal commas": "time,q,current\n"
    + "\n".join(",".join(f'"{x}"'.replace(".", ",") for x in row) for row in ROWS),
    "comments between the rows": text().replace("0.400000,", "# marker set\n0.400000,", 1),
    "empty lines between the rows": text().replace("\n0.4", "\n\n0.4"),
    "clock times": with_times(stamps("2024-03-01 12:00:00", "%H:%M:%S.%f")),
    "clock times past midnight": with_times(stamps("2024-03-01 23:59:59.2", "%H:%M:%S.%f")),
    "clock times with a comma": with_times(
        [t.replace(".", ",") for t in stamps("2024-03-01 12:00:00", "%H:%M:%S.%f")], ";"
    ),
    "clock times, milliseconds by a colon": with_times(
        [t.replace(".", ":") for t in stamps("2024-03-01 08:59:59", "%H:%M:%S.%f")]
    ),
    "dates and times": with_times(stamps("2024-03-01 23:59:59", "%Y-%m-%d %H:%M:%S.%f")),
    "dates with T": with_times(stamps("2024-02-28 23:59:59", "%Y-%m-%dT%H:%M:%S.%f")),
    "dates with T and Z": with_times([t + "Z" for t in stamps("2024-03-01 12:00:00", "%Y-%m-%dT%H:%M:%S.%f")]),
    "dates with an offset": with_times([t + "+01:00" for t in stamps("2024-03-01 12:00:00", "%Y-%m-%dT%H:%M:%S.%f")]),
    "dates with points": with_times(stamps("2024-03-01 12:00:00", "%d.%m.%Y %H:%M:%S.%f"), ";"),
    "dates with slashes, past midnight": with_times(stamps("2024-03-01 23:59:59.2", "%m/%d/%Y %H:%M:%S.%f")),
    "dates with slashes, day first": with_times(stamps("2024-03-01 23:59:59.2", "%d/%m/%Y %H:%M:%S.%f")),
    "dates and AM": with_times([t + " PM" for t in stamps("2024-03-01 11:59:58", "%m/%d/%Y %I:%M:%S.%f")]),
    "a date and a clock": with_times(stamps("2024-03-01 12:00:00", "2024-03-01,%H:%M:%S.%f")).replace(
        "time", "date,time", 1
    ),
    "of rostopic": "%" + text(),
    "of a spreadsheet": "sep=;\n" + text(";", ","),
    "names of two levels": text().replace("time,q,current\n", "time,arm,arm\n,q,current\n"),
    "old line ends": text(end="\r"),
    "two lines of names": "log,arm,arm\n" + text(),
    "dates with slashes": with_times(stamps("2024-03-01 12:00:00", "%m/%d/%Y %H:%M:%S.%f")),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_text_is_read_as_it_is(tmp_path, kind):
    given = TEXTS[kind]
    log = tmp_path / "log.csv"
    log.write_bytes(given if isinstance(given, bytes) else given.encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        two = {"link_position": "arm/q", "motor_current": "arm/current"} if "levels" in kind else {}
        comes_out(fs.import_log(mapping(tmp_path, two), log))


@pytest.mark.parametrize(
    ("given", "numbers"),
    [
        (text(header=None), (0, 1, 2)),
        (text(header=None, separator=" "), (0, 1, 2)),
        (text(header=None, separator=";", decimal=","), ("0", "1", "2")),
        ("# bench, 250 Hz, joint\n" + text(header=None), (0, 1, 2)),
        ("0,1,2\n" + text(header=None), (0, 1, 2)),
        (
            ",0,1,2\n" + "\n".join(f"{k},{line}" for k, line in enumerate(text(header=None).splitlines())),
            ("0", "1", "2"),
        ),
    ],
)
def test_columns_go_by_number_without_a_header(tmp_path, given, numbers):
    (tmp_path / "log.txt").write_text(given)
    names = dict(zip(BY_NAME, numbers, strict=True))
    comes_out(fs.import_log(mapping(tmp_path, names), tmp_path / "log.txt"))
    (tmp_path / "log.txt").write_text("Zeit (s),x,y\n" + text(header=None))
    if given.startswith(("0.0", "0,0")):
        comes_out(fs.import_log(mapping(tmp_path, names, header="none"), tmp_path / "log.txt"))


def test_no_header_is_the_reason(tmp_path):
    (tmp_path / "log.csv").write_text(text(header=None))
    with pytest.raises(InputError, match=r"column 'time': missing.*it has no header.*'0', '1', '2'"):
        fs.import_log(mapping(tmp_path), tmp_path / "log.csv")


@pytest.mark.parametrize("unit, factor", [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("suffix", ["csv", "parquet", "npz", "json"])
def test_stamps_of_today_in_any_unit(tmp_path, unit, factor, suffix):
    ticks = np.round((1_760_000_000 + T) * factor).astype(np.int64)
    path = tmp_path / f"log.{suffix}"
    table = pd.DataFrame({"time": ticks, "q": Q, "current": I})
    if suffix == "csv":
        table.to_csv(path, index=False)
    elif suffix == "parquet":
        table.to_parquet(path)
    elif suffix == "npz":
        np.savez(path, **{name: table[name].to_numpy() for name in table})
    else:
        table.to_json(path)
    comes_out(fs.import_log(mapping(tmp_path, {"time": {"column": "time", "unit": unit}}), path))


def test_names_that_do_not_fit_the_rows_are_the_reason(tmp_path):
    """A text with a separator in it: the names were those of the next column."""
    (tmp_path / "log.csv").write_text(text(junk="moving, fast"))
    with pytest.raises(InputError, match=r"'time': missing.*its header has 4 names, and its rows have 5 cells"):
        fs.import_log(mapping(tmp_path), tmp_path / "log.csv")


def test_lines_to_skip_and_a_rate_where_no_time_was_logged(tmp_path):
    (tmp_path / "log.csv").write_text("1,2,3\n4,5,6\n" + text())
    comes_out(fs.import_log(mapping(tmp_path, skip=2), tmp_path / "log.csv"))
    (tmp_path / "log.csv").write_text(text())
    comes_out(fs.import_log(mapping(tmp_path, {"time": {"rate": 250}}), tmp_path / "log.csv"))
    for wrong in ({"time": {"rate": 250, "column": "time", "unit": "s"}}, {"link_position": {"rate": 250}}):
        with pytest.raises(InputError, match="rate"):
            fs.import_log(mapping(tmp_path, wrong), tmp_path / "log.csv")


@pytest.mark.parametrize(
    "tail", ["1.600,0.43", "1.600,0.43,", "1.600", "1.600,0.43,-", '1.600,"0.4', "1.6000,0.1,1.0\0\0\0\0"]
)
def test_a_torn_last_line_is_left_out_and_said(tmp_path, tail):
    (tmp_path / "log.csv").write_text(text() + tail)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = fs.import_log(mapping(tmp_path), tmp_path / "log.csv")
    if tail.endswith("\0"):  # whole, before what a disk had reserved
        assert len(found.time) == N + 1
        return
    comes_out(found)
    assert any("last line is left out" in str(w.message) for w in caught if w.category is InputWarning)


def test_all_damaged_rows_are_named_at_once_and_left_out_by_a_key(tmp_path):
    lines = text().splitlines()
    bad = {
        20: "0.076,,1.0",
        50: "0.196,0.1,err",
        51: "0.2,0.1",
        99: "0.392,nan,1",
        140: "0.556,inf,1",
        200: "n/a,0,0",
        201: "0.8,1,2,3",
        260: "1.036,0x,1",
        300: "1.196,1.2.3,1",
    }
    for line, given in bad.items():
        lines[line] = given
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as caught:
        fs.import_log(mapping(tmp_path), tmp_path / "log.csv")
    said = str(caught.value)
    assert "\n" not in said and "9 of 400 rows are damaged" in said and "`damaged_rows: leave_out`" in said
    for part in (
        "row 19 (line 21)",
        "row 49 (line 51): expected a finite number, got 'err'",
        "expected 3 columns, got 2",
        "got 4",
    ):
        assert part in said
    with pytest.warns(InputWarning, match="9 of 400 rows"):
        found = fs.import_log(mapping(tmp_path, damaged_rows="leave_out"), tmp_path / "log.csv")
    comes_out(found, np.setdiff1d(np.arange(N), np.array(list(bad)) - 1))


def test_a_quote_that_is_left_open_damages_one_row(tmp_path):
    lines = text().splitlines()
    lines[100] = '0.396,"0.1,0.2'
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    with pytest.warns(InputWarning, match=r"row 99 \(line 101\)"):
        found = fs.import_log(mapping(tmp_path, damaged_rows="leave_out"), tmp_path / "log.csv")
    comes_out(found, np.delete(np.arange(N), 99))


def test_rows_at_which_time_does_not_increase_are_damaged(tmp_path):
    order = np.r_[0:100, 99, 100:200, 150, 200:N]
    pd.DataFrame({"time": T[order], "q": Q[order], "current": I[order]}).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match=r"'time', row 100 \(line 102\): expected time to increase.*2 of 402 rows"):
        fs.import_log(mapping(tmp_path), tmp_path / "log.csv")
    with pytest.warns(InputWarning, match="2 of 402 rows"):
        comes_out(fs.import_log(mapping(tmp_path, damaged_rows="leave_out"), tmp_path / "log.csv"))


def test_a_coarse_clock_is_named_with_the_rate_of_its_rows(tmp_path):
    table = pd.DataFrame({"time": np.floor(T / 0.02) * 0.02, "q": Q, "current": I})
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match=r"320 of 400 rows") as caught:
        fs.import_log(mapping(tmp_path), tmp_path / "log.csv")
    rate = float(str(caught.value).split("`time: {rate: ")[1].split("}")[0])
    assert rate == pytest.approx(250, rel=0.02)


def test_a_unit_that_the_log_states_otherwise_is_said(tmp_path):
    (tmp_path / "log.csv").write_text(text().replace("current\n", "current\ns,deg,A\n", 1))
    with pytest.warns(InputWarning, match="'q': its unit in the log is 'deg', in the mapping 'rad'"):
        fs.import_log(mapping(tmp_path), tmp_path / "log.csv")


def test_dates_are_seconds(tmp_path):
    (tmp_path / "log.csv").write_text(TEXTS["dates with T"])
    with pytest.raises(InputError, match="expected unit 's' of dates"):
        fs.import_log(mapping(tmp_path, {"time": {"column": "time", "unit": "ms"}}), tmp_path / "log.csv")


Write = Callable[[Path], None]
ENTRIES = [{"time": t, "q": q, "current": i, "on": True, "note": "x"} for t, q, i in ROWS]
STRUCT = {"t": {"time": T[:, None]}, "joint": {"q": Q, "drive": {"current": I}}}
TABLE = pd.DataFrame({"time": T, "q": Q, "current": I, "state": ["on"] * N})
FIELDS = np.array([tuple(row) for row in ROWS], dtype=[("time", "f8"), ("q", "f8"), ("current", "f8")])


def hdf5(**trees: Any) -> Write:
    def fill(group: Any, tree: dict) -> None:
        for key, one in tree.items():
            fill(group.create_group(key), one) if isinstance(one, dict) else group.create_dataset(key, data=one)

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            fill(file, trees)

    return write


def matlab_7_3(path: Path) -> None:
    """As MATLAB writes it: a block before the HDF5 file, columns as (1, n), a struct as a group, text as numbers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, one in {
            "time": T[None],
            "log/q": Q[None],
            "log/current": I[None],
            "title": np.array([[98], [99]], np.uint16),
        }.items():
            file.create_dataset(name, data=one).attrs["MATLAB_class"] = b"char" if name == "title" else b"double"
        file.create_group("#refs#").create_dataset("a", data=np.arange(4))
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))


def sheet(*before: list, dates: bool = False, second: bool = False) -> Write:
    def write(path: Path) -> None:
        book = openpyxl.Workbook()
        page = book.active
        if second:
            page.append(["Bench", "7"])
            page = book.create_sheet("data")
        for row in before:
            page.append(row)
        page.append(["time", "q", "current"])
        for t, q, i in ROWS:
            page.append(
                [
                    (pd.Timestamp("2024-03-01") + pd.Timedelta(seconds=float(t))).to_pydatetime()
                    if dates
                    else float(t),
                    float(q),
                    float(i),
                ]
            )
        book.save(path)

    return write


def parquet(**columns: Any) -> Write:
    return lambda path: pq.write_table(pa.table(columns), path)


LISTS = pa.FixedSizeListArray.from_arrays(pa.array(np.stack([Q, 2 * Q, Q**2], axis=1).ravel()), 3)
FILES: dict[str, tuple[str, Write, dict[str, Any]]] = {
    "npz": ("log.npz", lambda p: np.savez(p, time=T, q=Q, current=I, note=np.array(["a"])), {}),
    "npz, compressed, with objects": (
        "log.npz",
        lambda p: np.savez_compressed(p, time=T, q=Q, current=I, what=np.array([{}], dtype=object)),
        {},
    ),
    "npz, single precision": ("log.npz", lambda p: np.savez(p, time=T, q=Q.astype("f4"), current=I.astype("f4")), {}),
    "npz of tables": (
        "log.npz",
        lambda p: np.savez(p, t=T, state=np.stack([Q, I], axis=1)),
        {"time": "t", "link_position": "state/0", "motor_current": "state/1"},
    ),
    "npz of tables on their side": (
        "log.npz",
        lambda p: np.savez(p, t=T[None], state=np.stack([Q, I])),
        {"time": "t", "link_position": "state[0]", "motor_current": "state/1"},
    ),
    "npz of one table": (
        "log.npz",
        lambda p: np.savez(p, np.array(ROWS)),
        {"time": 0, "link_position": 1, "motor_current": "arr_0/2"},
    ),
    "npz of fields": (
        "log.npz",
        lambda p: np.savez(p, log=FIELDS),
        {"time": "log/time", "link_position": "q", "motor_current": "log.current"},
    ),
    "npy": ("log.npy", lambda p: np.save(p, np.array(ROWS)), {"time": 0, "link_position": 1, "motor_current": 2}),
    "npy of fields": ("log.npy", lambda p: np.save(p, FIELDS), {}),
    "mat": ("log.mat", lambda p: scipy.io.savemat(p, {"time": T, "q": Q[:, None], "current": I[None]}), {}),
    "mat of structs": (
        "log.mat",
        lambda p: scipy.io.savemat(p, {"log": STRUCT}),
        {"time": "log.t.time", "link_position": "log/joint/q", "motor_current": "current"},
    ),
    "mat of an array of structs": (
        "log.mat",
        lambda p: scipy.io.savemat(
            p, {"log": np.array([(t, [q, 0.0], i) for t, q, i in ROWS], dtype=[("t", "O"), ("q", "O"), ("i", "O")])}
        ),
        {"time": "log/t", "link_position": "log.q[0]", "motor_current": "log.i"},
    ),
    "mat of a matrix": (
        "log.mat",
        lambda p: scipy.io.savemat(p, {"data": np.array(ROWS), "fs": 250.0}),
        {"time": "data/0", "link_position": "data/1", "motor_current": "data/2"},
    ),
    "mat, version 4": ("log.mat", lambda p: scipy.io.savemat(p, {"time": T, "q": Q, "current": I}, format="4"), {}),
    "mat, version 7.3": ("log.mat", matlab_7_3, {"link_position": "log/q", "motor_current": "log.current"}),
    "hdf5": ("log.h5", hdf5(time=T, q=Q, current=I), {}),
    "hdf5 of groups": (
        "log.hdf5",
        hdf5(t={"time": T}, joint={"q": Q[:, None], "i": np.stack([I, -I], 1)}, image=np.zeros((N, 40, 40))),
        {"motor_current": "joint/i/0"},
    ),
    "hdf5 of fields": ("log.h5", hdf5(group={"log": FIELDS}), {"link_position": "/group/log/q"}),
    "hdf5 of pandas": (
        "log.h5",
        hdf5(frame={"block0_items": np.array([b"time", b"q", b"current"]), "block0_values": np.array(ROWS)}),
        {},
    ),
    "json of columns": (
        "log.json",
        lambda p: p.write_text(json.dumps({"time": T.tolist(), "q": Q.tolist(), "current": I.tolist(), "name": "b"})),
        {},
    ),
    "json of entries": ("log.json", lambda p: p.write_text(json.dumps(ENTRIES)), {}),
    "json of entries in a dictionary": (
        "log.json",
        lambda p: p.write_text(json.dumps({"mass": 0.5, "axes": [1, 2], "entries": ENTRIES}, indent=1)),
        {},
    ),
    "json of nested entries": (
        "log.json",
        lambda p: p.write_text(
            json.dumps({"run": {"data": [{"stamp": {"s": t}, "joint": {"q": [0, q]}, "i": i} for t, q, i in ROWS]}})
        ),
        {"time": "stamp/s", "link_position": "joint/q/1", "motor_current": "i"},
    ),
    "json of joint states": (
        "log.json",
        lambda p: p.write_text(
            json.dumps([{"t": t, "name": ["a", "b"], "position": [q, 0], "effort": [i, 1]} for t, q, i in ROWS])
        ),
        {"time": "t", "link_position": "position/a", "motor_current": "effort/a"},
    ),
    "json lines": ("log.jsonl", lambda p: p.write_text("\n".join(map(json.dumps, ENTRIES)) + "\n"), {}),
    "json lines under any name": ("log.log", lambda p: p.write_text("\n".join(map(json.dumps, ENTRIES))), {}),
    "json of pandas": ("log.json", lambda p: TABLE.to_json(p), {}),
    "json of pandas, records": ("log.json", lambda p: TABLE.to_json(p, orient="records"), {}),
    "json of pandas, split": ("log.json", lambda p: TABLE.to_json(p, orient="split"), {}),
    "json of rows": ("log.json", lambda p: p.write_text(json.dumps([["time", "q", "current"], *map(list, ROWS)])), {}),
    "json of rows without names": (
        "log.json",
        lambda p: p.write_text(json.dumps({"data": np.array(ROWS).tolist()})),
        {"time": "data/0", "link_position": "1", "motor_current": 2},
    ),
    "json with dates": (
        "log.json",
        lambda p: p.write_text(
            json.dumps(
                [e | {"time": t} for e, t in zip(ENTRIES, stamps("2024-03-01", "%Y-%m-%dT%H:%M:%S.%f"), strict=True)]
            )
        ),
        {},
    ),
    "xlsx": ("log.xlsx", sheet(), {}),
    "xlsx with a title": ("log.xlsx", sheet(["Bench 7, joint 2"], []), {}),
    "xlsx with dates": ("log.xlsx", sheet(dates=True), {}),
    "xlsx, second sheet": ("log.xlsx", sheet(second=True), {}),
    "parquet": ("log.parquet", lambda p: TABLE.to_parquet(p), {}),
    "parquet, single precision": (
        "log.parquet",
        lambda p: TABLE.astype({"q": "float32", "current": "float32"}).to_parquet(p),
        {},
    ),
    "parquet, nullable": ("log.parquet", lambda p: TABLE.convert_dtypes().to_parquet(p), {}),
    "parquet with dates": (
        "log.pq",
        lambda p: TABLE.assign(time=pd.Timestamp("2024-03-01") + pd.to_timedelta(T, unit="s")).to_parquet(p),
        {},
    ),
    "parquet with durations": (
        "log.parquet",
        lambda p: TABLE.assign(time=pd.to_timedelta(T, unit="s")).to_parquet(p),
        {},
    ),
    "parquet with times as text": (
        "log.parquet",
        lambda p: TABLE.assign(time=stamps("2024-03-01 23:59:59.5", "%H:%M:%S.%f")).to_parquet(p),
        {},
    ),
    "parquet with lists of fixed size": (
        "log.parquet",
        parquet(timestamp=T, **{"observation.state": LISTS, "action": LISTS, "i": I}),
        {"time": "timestamp", "link_position": "observation.state/0", "motor_current": "i"},
    ),
    "parquet with lists": (
        "log.parquet",
        parquet(timestamp=T, state=np.stack([I, Q], 1).tolist()),
        {"time": "timestamp", "link_position": "state/1", "motor_current": "state/0"},
    ),
    "parquet with structs": (
        "log.parquet",
        parquet(time=T, arm=[{"q": q, "i": [0.0, i]} for _, q, i in ROWS]),
        {"link_position": "arm/q", "motor_current": "arm.i[1]"},
    ),
    "arrow": ("log.feather", lambda p: TABLE.to_feather(p), {}),
    "gz of text": ("log.csv.gz", lambda p: p.write_bytes(gzip.compress(text().encode())), {}),
    "bz2 of text": ("log.csv.bz2", lambda p: p.write_bytes(bz2.compress(text(";", ",").encode())), {}),
    "xz of json": ("log.json.xz", lambda p: p.write_bytes(lzma.compress(json.dumps(ENTRIES).encode())), {}),
    "lists in cells": (
        "log.csv",
        lambda p: p.write_text(
            "type,timestamp,positions,torques\n" + "".join(f'STATE,{t},"[0.0, {q}]","[{i}, 1]"\n' for t, q, i in ROWS)
        ),
        {"time": "timestamp", "link_position": "positions/1", "motor_current": "torques/0"},
    ),
    "lists of numpy in cells": (
        "log.csv",
        lambda p: p.write_text("t;state\n" + "".join(f"{t};[{q} {i}]\n" for t, q, i in ROWS)),
        {"time": "t", "link_position": "state[0]", "motor_current": "state[1]"},
    ),
}


@pytest.mark.parametrize("kind", FILES)
def test_files_are_read_as_they_are(tmp_path, kind):
    name, write, names = FILES[kind]
    path = tmp_path / name
    write(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        comes_out(fs.import_log(mapping(tmp_path, names), path), atol=1e-6 if "single" in kind else 1e-9)
    if name.endswith((".npz", ".mat", ".xlsx", ".h5", ".parquet", ".json")):  # by what it is, and not by its name
        packed = tmp_path / f"{name}.gz"
        packed.write_bytes(gzip.compress(path.read_bytes()))
        comes_out(fs.import_log(mapping(tmp_path, names), packed), atol=1e-6 if "single" in kind else 1e-9)


@pytest.mark.parametrize(
    ("name", "given", "reason"),
    [
        ("log.pkl", b"\x80\x04\x95\x10", "pickle file can run code"),
        ("log.csv", b"\x80\x05\x95\x10\0\0\0", "pickle file can run code"),
        ("log.xls", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", r"older Excel format.*\.xlsx"),
        ("log.zip", b"PK\x03\x04" + b"\0" * 40, "archive"),
        ("log.csv", bytes(range(256)) * 20, r"not a format that is read \(CSV"),
        ("log.png", b"\x89PNG\r\n\x1a\n" + bytes(range(32)) * 30, r"not a format that is read"),
        ("log.csv", b"<?xml version='1.0'?><log/>", "XML or HTML"),
        ("log.txt", b"time\nis\nmoney\n", "missing.*no rows of numbers"),
        ("log.npz", b"no archive", "not a readable NumPy file"),
        ("log.mat", b"no matrix", "not a readable MATLAB file"),
        ("log.h5", b"\x89HDF\r\n\x1a\n" + b"\0" * 300, "not a readable HDF5 file"),
        ("log.json", b'{"time": [1, 2', "not a readable JSON file"),
        ("log.json", b'{"name": "x"}', "expected arrays or columns of numbers in the JSON file, found none"),
        ("log.csv.gz", b"\x1f\x8b" + b"\0" * 30, "not a readable"),
        ("log.bag", b"#ROSBAG V2.0\n", "not a readable ROS 1 bag"),
    ],
)
def test_what_is_not_read_is_refused_with_the_reason(tmp_path, name, given, reason):
    (tmp_path / name).write_bytes(given)
    with pytest.raises(InputError, match=reason) as caught:
        fs.import_log(mapping(tmp_path), tmp_path / name)
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_objects_of_numpy_are_not_unpacked(tmp_path):
    np.savez(tmp_path / "log.npz", time=T, q=Q, current=np.array([1, None, *I[2:]], dtype=object))
    with pytest.raises(InputError, match=r"log\.npz: not a readable NumPy file"):
        fs.import_log(mapping(tmp_path), tmp_path / "log.npz")


@pytest.mark.parametrize(
    ("package", "name"), [("h5py", "log.h5"), ("openpyxl", "log.xlsx"), ("rosbags.highlevel", "log.bag")]
)
def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch, package, name):
    import sys

    write: dict[str, Write] = {
        "h5py": hdf5(time=T),
        "openpyxl": sheet(),
        "rosbags.highlevel": lambda p: p.write_bytes(b"#ROSBAG V2.0\n"),
    }
    write[package](tmp_path / name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=r"install flexspline\[logs\]"):
        fs.import_log(mapping(tmp_path), tmp_path / name)


def test_a_gz_that_is_cut_short_is_read_as_far_as_it_goes(tmp_path):
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress(text().encode())[:-400])
    with pytest.warns(InputWarning, match="compressed file is cut short"):
        found = fs.import_log(mapping(tmp_path), tmp_path / "log.csv.gz")
    assert 100 < len(found.time) < N
    comes_out(found, slice(0, len(found.time)))


@pytest.mark.parametrize("suffix", ["parquet", "csv", "json"])
def test_a_recording_of_every_episode(flexspline, tmp_path, suffix):
    """As LeRobot writes them: time begins again; a list a row; episodes of different length."""
    lengths = [120, 3, 277]
    parts = np.repeat([4, 5, 9], lengths)
    begin = np.repeat(np.cumsum([0, *lengths[:-1]]), lengths)
    table = pd.DataFrame({"timestamp": T - T[begin], "state": np.stack([Q, I], 1).tolist(), "episode_index": parts})
    path = tmp_path / f"file-000.{suffix}"
    getattr(table, f"to_{suffix}")(path, **({"index": False} if suffix == "csv" else {}))
    names = {"time": "timestamp", "link_position": "state/0", "motor_current": "state/1"}
    with pytest.raises(InputError, match=r"row 120.*`episodes: COLUMN`"):
        fs.import_log(mapping(tmp_path, names), path)
    with pytest.raises(InputError, match="expected one episode, got 3"):
        fs.import_log(mapping(tmp_path, names, episodes="episode_index"), path)
    code, _, err = flexspline("import", tmp_path / "map.yaml", path, "--out", tmp_path / "out")
    assert code == 0, err
    recordings = read_measurement(tmp_path / "out").recordings
    assert [r.name for r in recordings] == ["file-000_4", "file-000_5", "file-000_9"]
    for recording, episode in zip(recordings, (4, 5, 9), strict=True):
        comes_out(recording, np.flatnonzero(parts == episode))


def test_files_of_a_folder_and_columns_that_take_turns(flexspline, tmp_path):
    """As a robot's exporter writes them: one number a line, joints interleaved; and a file a quantity."""
    folder = tmp_path / "log"
    folder.mkdir()
    for name, joints in (("positions", (0 * Q, Q, Q + 1)), ("torques", (I, 0 * I, -I))):
        (folder / f"{name}.txt").write_text("".join(f"{x}\n" for x in np.stack(joints, 1).ravel()))
    (folder / "time.txt").write_text("".join(f"{t}\n" for t in T))
    names = {"time": "time.txt/0", "link_position": "positions.txt/1", "motor_current": "torques.txt/0"}
    turns = {"positions.txt": 3, "torques.*": 3}
    comes_out(fs.import_log(mapping(tmp_path, names, interleaved=turns), folder))
    with pytest.raises(InputError, match=r"as many rows in every file, got 400 of 'time.txt/0' and 1200"):
        fs.import_log(mapping(tmp_path, names | {"link_position": "positions.txt/0"}), folder)
    with pytest.raises(InputError, match="multiple of 7"):
        fs.import_log(mapping(tmp_path, names, interleaved={"*s.txt": 7}), folder)
    pd.DataFrame({"t": T, "- arm_1_joint": Q}).to_csv(folder / "position.csv", index=False)
    pd.DataFrame({"t": T, "- arm_1_joint": I}).to_csv(folder / "effort.csv", index=False)
    names = {
        "time": "position.csv/t",
        "link_position": "position.csv/- arm_1_joint",
        "motor_current": "effort.csv/- arm_1_joint",
    }
    code, _, err = flexspline("import", mapping(tmp_path, names), folder, "--out", tmp_path / "out")
    assert code == 0, err
    comes_out(read_measurement(tmp_path / "out").recordings[0])


def test_a_joint_that_is_not_there_is_an_error_and_what_was_written_is_listed(flexspline, tmp_path):
    (tmp_path / "log.csv").write_text(text())
    for words in ((mapping(tmp_path), "--joint", tmp_path / "none.yaml"), (mapping(tmp_path, joint="none.yaml"),)):
        code, _, err = flexspline("import", words[0], tmp_path / "log.csv", *words[1:], "--out", tmp_path / "out")
        assert code == 2 and err.count("\n") == 1 and "none.yaml" in err and not (tmp_path / "out").exists()
    data = yaml.safe_load(mapping(tmp_path).read_text())
    del data["link"]
    data |= {"joint": "ur3e-shoulder", "arm": {"model": "ur3e.xml", "joint": "shoulder_lift"}}
    data["columns"]["arm_elbow_position"] = {"column": "q", "unit": "rad"}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(data))
    code, out, err = flexspline("import", tmp_path / "arm.yaml", tmp_path / "log.csv", "--out", tmp_path / "out")
    assert code == 0, err
    for name in (*(path.name for path in (tmp_path / "out").glob("log*")), "arm_elbow_position", "motor_current"):
        assert name in out.replace("\n", "")
