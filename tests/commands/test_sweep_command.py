"""`flexspline sweep` from the command line: what it writes, what it says, and that Ctrl-C loses nothing."""

from __future__ import annotations

import html
import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import matplotlib.image
import pytest

from flexspline import commands
from flexspline.views.sweep_tables import BETTER, WORSE, with_interval

STUDY = """
name: quick
seeds: {count: SEEDS}
scenarios: [link_sweep]
set: {duration: 1.5, transient: 0.5}
axes:
  - {kind: cause, causes: [stiffness, hard_stop], sizes: [0, 1]}
  - {kind: set, name: k, key: filters.RAREKF.k, values: [0, 0.1]}
metrics: [rms]
"""


def write(folder, seeds=2):
    path = folder / "quick.yaml"
    path.write_text(STUDY.replace("SEEDS", str(seeds)), encoding="utf-8")
    return path


def call(monkeypatch, capsys, *arguments, command="sweep") -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["flexspline", command, *map(str, arguments)])
    try:
        commands.main()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    out = capsys.readouterr()
    return code, out.out, out.err


def test_a_study_into_a_folder(tmp_path, monkeypatch, capsys):
    code, out, _ = call(monkeypatch, capsys, write(tmp_path), "--out", tmp_path / "out", "--jobs", 2)
    assert code == 0
    assert "quick" in out and "RAREKF" in out and "stiffness" in out and "±" in out
    folder = tmp_path / "out"
    assert json.loads((folder / "study.json").read_text())["study"]["name"] == "quick"
    text = (folder / "summary.md").read_text()
    assert "## RMS error [N·m]" in text
    assert text.count("| link_sweep |") == (1 + 2) * 2  # points × k
    # Points × (RAREKF with either k, and three filters for each of these).
    assert len((folder / "summary.csv").read_text().splitlines()) == 1 + 3 * (2 + 3 * 2)
    pictures = sorted(path.name for path in (folder / "figures").iterdir())
    assert pictures == ["link_sweep_rms.png", "link_sweep_rms_difference.png"]
    assert matplotlib.image.imread(folder / "figures" / pictures[0]).std() > 0.01

    code, _, err = call(monkeypatch, capsys, "load_dependent_alpha", "--out", folder)
    assert code == 2 and err.count("\n") == 1 and "quick" in err and str(folder) in err
    code, _, err = call(monkeypatch, capsys, "noise_and_lod", "--out", tmp_path / "other")
    assert code == 2 and err.count("\n") == 1 and "noise_and_load" in err
    assert not (tmp_path / "other").exists()


def test_fewer_seeds_than_there_are_and_a_page_whose_command_runs(tmp_path, monkeypatch, capsys):
    """Three seeds were counted where two were asked for; the page's command named the study, which no one ships."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine" / "my study.yaml"
    quick = STUDY[: STUDY.index("axes")] + "metrics: [rms]\nfilters: [EKF]\n"
    path.write_text(quick.replace("SEEDS", "3"), encoding="utf-8")
    base = ("mine/my study.yaml", "--out", "out", "--no-figures", "--json")
    three = json.loads(call(monkeypatch, capsys, *base)[1])
    assert [row["runs"] for row in three] == [3]
    fewer = json.loads(call(monkeypatch, capsys, *base, "--seeds", 2)[1])
    fresh = json.loads(call(monkeypatch, capsys, base[0], "--out", "two", *base[3:], "--seeds", 2)[1])
    assert fewer == fresh and [row["runs"] for row in fewer] == [2]
    assert (tmp_path / "out" / "summary.csv").read_bytes() == (tmp_path / "two" / "summary.csv").read_bytes()
    assert json.loads(call(monkeypatch, capsys, *base)[1]) == three

    def shown(folder) -> list[str]:
        assert call(monkeypatch, capsys, folder, "--out", tmp_path / "page.html", command="report")[0] == 0
        code = re.search(r"<pre><code>flexspline sweep (.*?)</code>", (tmp_path / "page.html").read_text())
        return shlex.split(html.unescape(code[1]))

    assert shown("out") == ["mine/my study.yaml", "--seeds", "6", "--out", "out"]
    monkeypatch.chdir(tmp_path / "elsewhere")
    words = shown("../out")
    assert words == ["../mine/my study.yaml", "--seeds", "6", "--out", "../out"]
    code, out, _ = call(monkeypatch, capsys, *words, "--no-figures", "--json")
    assert code == 0 and [row["runs"] for row in json.loads(out)] == [6]
    shutil.move(tmp_path / "mine", tmp_path / "other")  # its study is in another folder now
    call(monkeypatch, capsys, "../other/my study.yaml", *words[3:], "--no-figures", "--seeds", 2)
    assert shown("../out")[0] == "../other/my study.yaml"


@pytest.mark.parametrize(("name", "said"), [("tolerance", "tolerance"), ("small", "small.yaml")])
def test_a_page_of_an_older_dataset(tmp_path, monkeypatch, capsys, name, said):
    """It does not say where its study came from."""
    folder = shutil.copytree(Path(__file__).parents[1] / "frozen" / "sweep", tmp_path / "sweep")
    note = folder / "study.json"
    note.write_text(note.read_text().replace('"name": "small"', f'"name": "{name}"'))
    assert call(monkeypatch, capsys, folder, "--out", tmp_path / "page.html", command="report")[0] == 0
    page = (tmp_path / "page.html").read_text()
    assert f"flexspline sweep {said} --seeds 4 --out" in page
    assert ("the path of your study" in page) == (name == "small")


def test_seeds_that_are_listed_are_not_twice_as_many(tmp_path, monkeypatch, capsys):
    path = write(tmp_path)
    path.write_text(
        path.read_text().replace("{count: 2}", "[3, 5]").replace("sizes: [0, 1]", "sizes: [0]"), encoding="utf-8"
    )
    assert call(monkeypatch, capsys, path, "--out", tmp_path / "out", "--no-figures")[0] == 0
    assert call(monkeypatch, capsys, tmp_path / "out", "--out", tmp_path / "page.html", command="report")[0] == 0
    page = (tmp_path / "page.html").read_text()
    assert f"flexspline sweep {path} --out" in page and "more seeds" in page and "--seeds" not in page


def test_ctrl_c_says_that_the_same_command_goes_on(tmp_path):
    """Also where stderr is no terminal."""
    stopped = (
        "import signal, sys\nfrom flexspline import commands\nfrom flexspline.scenarios.studies import sweep\n"
        "def stop(*a): signal.raise_signal(signal.SIGINT)\nsweep.sweep = stop\n"
        "sys.argv[1:1] = ['sweep']\ncommands.main()"
    )
    words = [sys.executable, "-c", stopped, str(write(tmp_path)), "--out", str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 130
    assert done.stderr.strip().splitlines() == [
        f"stopped; 0 of 6 runs are in {tmp_path / 'out'}; the same command continues"
    ]


@pytest.mark.slow
def test_ctrl_c_leaves_a_dataset_that_goes_on(tmp_path):
    """SIGINT to the running command: exit code 130, one line, no traceback; the same command does the rest."""
    command = [sys.executable, "-X", "faulthandler", "-c", "from flexspline import commands; commands.main()", "sweep"]
    command += [
        str(write(tmp_path, 60)),
        "--out",
        str(tmp_path / "out"),
        "--chunk",
        "2",
        "--jobs",
        "2",
        "--no-figures",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    begin = time.monotonic()
    while len(list(tmp_path.glob("out/rows/*/*/runs-*.parquet"))) < 3:
        assert time.monotonic() - begin < 120 and process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "continues" in err and "Traceback" not in err
    parts = {path: path.stat().st_mtime_ns for path in tmp_path.glob("out/rows/*/*/runs-*.parquet")}
    assert 3 <= len(parts) < 90
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    after = {path: path.stat().st_mtime_ns for path in tmp_path.glob("out/rows/*/*/runs-*.parquet")}
    assert len(after) == 90 and parts.items() <= after.items()


def test_numbers_have_the_digits_of_their_intervals():
    from flexspline.scenarios.studies.statistics import Interval

    assert with_interval(Interval(0.145237, 0.144937, 0.145537, 9)) == "0.1452 ± 0.0003"
    assert with_interval(Interval(0.145237, 0.144117, 0.146357, 9)) == "0.1452 ± 0.0011"
    assert with_interval(Interval(1234.0, 1111.0, 1357.0, 9)) == "1234 ± 123"
    assert with_interval(Interval(0.05, 0.04, 0.06, 9), 100) == "5.0 ± 1.0"
    assert with_interval(Interval(0.25, 0.25, 0.25, 9)) == "0.25"
    assert with_interval(Interval(0.48, -1.12, 2.08, 3)) == "0.5 ± 1.6"  # not 0: a mean that is small, not none
    assert with_interval(Interval(0.0, -1.6, 1.6, 3)) == "0 ± 2"
    assert with_interval(Interval(float("nan"), float("nan"), float("nan"), 0)) == "–"
    assert with_interval(Interval(0.0, 0.0, 0.0, 9)) == "0"
    assert BETTER != WORSE
