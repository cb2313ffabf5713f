"""What every command offers: help with examples, `-h`, completion, JSON for programs."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from flexspline import commands

ALL = [(folder, name) for folder in ("", "joint") for name in commands._files(folder) if name != "joint"]
SHORT = ["--set", "duration=3", "--set", "filters=[RAREKF, current]"]


@pytest.mark.parametrize(("folder", "name"), ALL, ids=[" ".join(one).strip() for one in ALL])
def test_every_command_has_examples_in_its_help(flexspline, folder, name):
    words = [word for word in (folder, name) if word]
    code, out, err = flexspline(*words, "-h")
    assert code == 0 and not err
    text = " ".join(out.split())
    for example in commands.find(name, folder)[1]:
        assert example.startswith(f"flexspline {' '.join(words)}")
        assert example in text


@pytest.mark.parametrize(("folder", "name"), ALL, ids=[" ".join(one).strip() for one in ALL])
def test_no_help_is_cut_in_a_narrow_terminal(flexspline, folder, name):
    """Every word of what is said of every option, 80 columns wide."""
    words = [word for word in (folder, name) if word]
    code, out, _ = flexspline(*words, "-h", columns=80)
    assert code == 0 and max(map(len, out.splitlines())) <= 80
    shown = set(out.split())
    for option in commands._load(name, folder).params:
        assert not [word for word in (option.help or "").replace("`", "").split() if word not in shown], option.name


WITHOUT_JSON = {"schema": "prints JSON Schema, which is JSON already", "export-estimator": "writes a C header"}


@pytest.mark.parametrize(("folder", "name"), ALL, ids=[" ".join(one).strip() for one in ALL])
def test_every_command_answers_programs(flexspline, folder, name):
    """By `--json`, the only name of the option, except for a reason above."""
    words = [word for word in (folder, name) if word]
    code, out, _ = flexspline(*words, "-h")
    assert code == 0
    assert ("--json" in out) != (" ".join(words) in WITHOUT_JSON)


def test_logs_and_pages_as_json(flexspline, tmp_path, monkeypatch):
    """One object on stdout and nothing else, of what was written; errors as without."""
    monkeypatch.chdir(tmp_path)
    code, _, err = flexspline("run", "no_load", *SHORT, "--out", "runs", "--no-figures", "--no-recording")
    assert code == 0, err
    code, out, err = flexspline("report", "runs/no_load", "--out", "page.html", "--json")
    assert code == 0, err
    assert json.loads(out) == {"page": "page.html", "of": ["runs/no_load"]} and (tmp_path / "page.html").is_file()
    pytest.importorskip("mcap_ros2")
    code, out, err = flexspline("export", "runs/no_load/no_load.yaml", "--out", "mcap", "--json")
    assert code == 0, err
    assert json.loads(out) == {"no_load": {"file": "mcap/no_load.mcap"}} and (tmp_path / "mcap/no_load.mcap").is_file()
    code, out, err = flexspline("import", "runs/no_load/no_load.yaml", "--fix", "--out", "mended", "--json")
    assert code == 0, err
    answer = json.loads(out)
    recording = answer["recordings"]["no_load"]
    assert (tmp_path / recording["file"]).is_file() and recording["samples"] == 3000 and answer["mended"] == []
    assert recording["columns"][0] == "time" and not recording["description_kept"]
    for name, *more in (("import", "--out", "x"), ("export", "--out", "x"), ("report",), ("view",)):
        words = [name, "nowhere", *more]
        plain, answer = flexspline(*words), flexspline(*words, "--json")
        assert plain == answer and plain[0] == 2 and not plain[1]


def test_what_is_viewed_as_json(tmp_path):
    """The viewer takes the command's place and may say what it likes, on stderr."""
    (tmp_path / "run.rrd").write_bytes(b"RRF2")
    program = (
        "import os, sys; from flexspline.commands import view, main\n"
        "view.viewer_command = lambda *given: [sys.executable, '-c', 'print(\"a word of the viewer\")']\n"
        f"sys.argv = ['flexspline', 'view', {str(tmp_path)!r}, '--web', '--json']; main()"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"opened": [str(tmp_path)], "address": "127.0.0.1"}
    assert "a word of the viewer" in done.stderr


def test_exit_codes_are_documented(flexspline):
    _, out, _ = flexspline("-h")
    assert "Exit codes: 0 done; 1 a limit is missed" in " ".join(out.split())


def test_version_says_what_it_is_made_of(flexspline):
    _, out, _ = flexspline("--version")
    lines = out.splitlines()
    assert lines[0].startswith("flexspline ") and lines[1].startswith("Python ")
    assert {"mujoco", "numpy", "numba", "rerun-sdk"} <= {line.split()[0] for line in lines}


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("ru", "run"), ("run ext", "external_push"), ("run --se", "--seed"), ("joint sh", "show"), ("sweep noi", "noise_and_load")],
)  # fmt: skip
def test_a_shell_completes(typed, offered):
    words = {"COMP_WORDS": f"flexspline {typed}", "COMP_CWORD": str(len(typed.split()))}
    program = "import sys; sys.argv = ['flexspline']; from flexspline.commands import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True,
        env={**os.environ, "_FLEXSPLINE_COMPLETE": "complete_bash", **words},
    )  # fmt: skip
    assert offered in done.stdout.split()


def test_a_run_and_a_comparison_as_json(flexspline, tmp_path):
    code, out, err = flexspline("run", "no_load", *SHORT, "--out", tmp_path, "--no-figures", "--no-recording", "--json")
    assert code == 0, err
    (run,) = json.loads(out).values()
    assert run["folder"] == str(tmp_path / "no_load") and set(run["filters"]) == {"RAREKF", "current"}
    code, out, err = flexspline(
        "compare", "no_load", *SHORT, "--out", tmp_path, "--no-figures", "--no-recording", "--json"
    )
    assert code == 0, err
    assert json.loads(out)["no_load"]["filters"] == run["filters"]
    measured = tmp_path / "no_load" / "no_load.yaml"
    code, out, err = flexspline("estimate", measured, "--filter", "current", "--out", tmp_path / "estimates", "--json")
    assert code == 0, err
    assert json.loads(out) == json.loads((tmp_path / "estimates" / "metrics.json").read_text())
    code, out, err = flexspline("validate", measured, "--out", tmp_path / "check", "--json")
    assert code == 0, err
    assert json.loads(out) == json.loads((tmp_path / "check" / "validation.json").read_text())


def test_limits_as_json(flexspline):
    code, out, err = flexspline("bound", "no_load", *SHORT, "--seeds", 1, "--filter", "RAREKF", "--json")
    assert code == 0, err
    (row,) = json.loads(out)
    assert row["estimator"] == "RAREKF" and row["rms"] > row["bound"] / 3 > 0
