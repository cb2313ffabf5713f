"""The command line as a program: what goes wrong around it is one line, and nothing is left behind."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from flexspline import commands
from flexspline.commands import view
from flexspline.models.files import json_text

PROGRAM = [sys.executable, "-m", "flexspline"]
RUN = ["run", "no_load", "--set", "duration=3", "--no-figures", "--no-recording"]


def called(*arguments, **environment):
    return subprocess.run(
        [*PROGRAM, *map(str, arguments)], capture_output=True, env={**os.environ, **environment}, timeout=60
    )


def test_home_is_known_where_the_shell_leaves_it(flexspline, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    code, _, err = flexspline(*RUN, "--out=~/runs")
    assert code == 0, err
    assert (tmp_path / "runs" / "no_load" / "metrics.json").is_file()


def test_a_terminal_that_only_knows_ascii(tmp_path):
    done = called("scenarios", PYTHONIOENCODING="ascii")
    assert done.returncode == 0 and b"Traceback" not in done.stderr
    done = called("check", "/nothing/µ°", PYTHONIOENCODING="ascii")
    assert done.returncode == 2 and done.stderr.count(b"\n") == 1


@pytest.mark.parametrize("error", [OSError(28, "No space left on device", "x"), MemoryError(), OSError("?")])
def test_what_the_system_refuses_is_one_line(monkeypatch, capsys, error):
    def fails(**options):
        raise error

    monkeypatch.setattr(commands, "app", fails)
    with pytest.raises(SystemExit) as stop:
        commands.main()
    err = capsys.readouterr().err
    assert stop.value.code == 2 and err.count("\n") == 1 and err.startswith("flexspline: ")


@pytest.mark.parametrize(
    "change", ["filters.².k=1", "filters.99999999999999999999.k=1", "filters.٣=a", "trajectory.x.time=1", "a.b.c", "=1"]
)
def test_keys_that_lead_nowhere(flexspline, tmp_path, change):
    code, _, err = flexspline("run", "no_load", "--set", change, "--out", tmp_path)
    assert code == 2 and err.count("\n") == 1, err


@pytest.mark.parametrize("after", [0.0, 0.1, 0.3, 0.6])
def test_ctrl_c_in_the_first_second_is_silent(tmp_path, after):
    """From where this package begins; before, Python itself is being loaded."""
    program = "import sys; from flexspline.__main__ import main; print(flush=True); main()"
    process = subprocess.Popen(
        [sys.executable, "-c", program, *RUN, "--out", str(tmp_path / "o")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    process.stdout.readline()
    time.sleep(after + 0.02)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert b"Traceback" not in err and process.returncode in (130, -signal.SIGINT, 0)


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="no process groups")
@pytest.mark.parametrize("after", [0.2, 0.5, 0.9, 1.3])
def test_ctrl_c_of_a_terminal_is_a_line_at_most(tmp_path, after):
    """It goes to all processes of the command, also to those that draw and may be loading still."""
    process = subprocess.Popen(
        [*PROGRAM, *(word for word in RUN if not word.startswith("--no-")), "--out", str(tmp_path / "o")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    time.sleep(after)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert err in (b"", b"flexspline: interrupted, nothing is half-written\n")
    assert process.returncode in (130, -signal.SIGINT, 0)


@pytest.mark.parametrize(
    "after", ["raise RuntimeError('no compiled object yet')", "time.sleep(20)"], ids=["fails", "goes_on"]
)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_request_to_end_that_falls_into_compiled_code_is_not_lost(after, number):
    """A call from C cannot raise: Python only prints what came, and the interrupted call fails elsewhere or continues."""
    program = f"""
import ctypes, os, signal, time
from flexspline import commands
called = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), {number:d}) or time.sleep(0.01))
def app(**options):
    called()
    {after}
commands.app = app
commands.main()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=15)
    assert (done.returncode, done.stdout) == (128 + number, "")
    assert done.stderr in ("", "flexspline: interrupted, nothing is half-written\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_request_to_end_that_somebody_keeps_ends_what_goes_on(tmp_path, number):
    """An error that is kept with the request in it, as libraries keep why an import failed: it is raised once."""
    program = f"""
import os, time
from pathlib import Path
from flexspline import commands
from flexspline.models.output import output_folder
commands._AT_LATEST = 1.0
kept = []
def app(**options):
    with output_folder(Path({str(tmp_path / "o")!r}), "run") as staging:
        (staging / "begun").touch()
        try:
            os.kill(os.getpid(), {number:d})
        except BaseException as error:
            kept.append(error)
        time.sleep(60)
commands.app = app
commands.main()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout) == (128 + number, "")
    assert done.stderr in ("", "flexspline: interrupted, nothing is half-written\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.fast_every(2)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("command", ["run", "compare"])
def test_asked_to_end_it_ends_and_leaves_nothing(flexspline, tmp_path_factory, tmp_path, number, command):
    """In the middle of an hour's simulation, which is compiled code, compiled before."""
    assert flexspline(*RUN, "--out", tmp_path_factory.mktemp("before"))[0] == 0
    process = subprocess.Popen(
        [*PROGRAM, command, "no_load", "--set", "duration=3600", "--out", str(tmp_path / "o"), *RUN[4:]],
        stderr=subprocess.PIPE,
    )
    time.sleep(2.5)
    assert process.poll() is None
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number and b"Traceback" not in err
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="no umask")
def test_nothing_executable_lies_in_a_folder_that_is_drawn_into(tmp_path):
    """With rights for everybody: what others could replace while a run is drawn is data, which nothing executes."""
    out = tmp_path / "o"
    words = [word for word in RUN if not word.startswith("--no-")]
    process = subprocess.Popen([*PROGRAM, *words, "--out", str(out)], umask=0, stdout=subprocess.PIPE)
    seen = {}
    while process.poll() is None:
        for folder, _, names in os.walk(out):  # which passes over what is moved meanwhile
            for path in (Path(folder) / name for name in names):
                with contextlib.suppress(OSError):
                    seen[path.name] = path.stat().st_mode & 0o111, path.open("rb").read(2)[:1]
        time.sleep(0.002)
    assert process.returncode == 0
    assert {"signals.parquet", "error.png"} <= set(seen)
    data = re.compile(r".+\.(parquet|yaml|json|png|rrd)|\.flexspline")
    assert not [name for name in seen if not data.fullmatch(name)]
    for name, (executable, first) in seen.items():
        assert not executable and first != b"\x80", name  # how a pickle begins


def test_the_viewer_sends_no_usage_data(monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    environment = view.viewer_environment()
    assert environment["CI"] == "1" and "FORCE_RERUN_ANALYTICS" not in environment and environment["PATH"]


def test_a_scenario_is_not_run_over_its_own_files(flexspline, tmp_path):
    code, _, err = flexspline(*RUN, "--out", tmp_path)
    assert code == 0, err
    before = {p.name: p.read_bytes() for p in (tmp_path / "no_load").iterdir()}
    code, _, err = flexspline("run", tmp_path / "no_load" / "scenario.yaml", "--out", tmp_path, *RUN[2:])
    assert code == 2 and "which is read" in err and err.count("\n") == 1
    assert {p.name: p.read_bytes() for p in (tmp_path / "no_load").iterdir()} == before


def test_a_link_in_out_leads_nowhere(flexspline, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "no_load").symlink_to(tmp_path / "elsewhere")
    code, _, err = flexspline(*RUN, "--out", tmp_path / "o")
    assert code == 2 and "link that leads elsewhere" in err
    assert not list((tmp_path / "elsewhere").iterdir())


@pytest.mark.parametrize("timestep", ["0.0007", "0.0003", "1.1e-4"])
def test_verify_takes_whole_fractions_of_the_control_period(flexspline, tmp_path, timestep):
    code, _, err = flexspline("verify", tmp_path, "--timestep", timestep)
    assert code == 2 and "timestep: expected a whole fraction of 0.001 s" in err and err.count("\n") == 1


def test_json_has_no_infinity():
    assert json.loads(json_text({"a": [1.5, float("inf")], "b": (float("nan"), "µ", None, 3)})) == {
        "a": [1.5, None],
        "b": [None, "µ", None, 3],
    }


def test_brackets_in_names_are_no_markup(flexspline, tmp_path):
    out = tmp_path / "a[" / "b][bold]"  # which reads as the end of a markup tag
    code, text, err = flexspline(*RUN, "--out", out)
    assert code == 0, err
    assert str(out / "no_load") in text.replace("\n", "")


@pytest.mark.parametrize("command", [["check"], ["view"], ["verify"], ["run"], ["import", "lara8"], ["sweep"]])
def test_a_pipe_is_refused_at_once(flexspline, tmp_path, command):
    (tmp_path / "in").mkdir()
    for name in ("m.csv", "m.yaml", "run.rrd", "no_load.parquet"):
        os.mkfifo(tmp_path / "in" / name)
    place = {"check": "m.csv", "view": "run.rrd", "verify": "", "run": "m.yaml", "import": "m.csv", "sweep": "m.yaml"}
    out = [] if command[0] in ("check", "view", "verify") else ["--out", tmp_path / "out"]
    code, _, err = flexspline(*command, tmp_path / "in" / place[command[0]], *out)
    assert code == 2 and err.count("\n") == 1, err


def test_a_command_ends_at_once_and_in_order():
    """What is to happen at the end happens, output is whole, and the code is the command's."""
    program = (
        "import atexit, sys, threading, time\n"
        "from flexspline.__main__ import main\n"
        "atexit.register(print, 'in the end')\n"
        "threading.Thread(target=lambda: (time.sleep(1.5), print('late'))).start()\n"
        "main()"
    )
    for words, code in ((["--version"], 0), (["run", "nowhere"], 2)):
        done = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, timeout=60)
        said = done.stdout.split(b"\n")
        assert done.returncode == code and said[-2] == b"in the end" and b"late" in said, done


def test_a_link_that_leads_to_itself_is_one_line(flexspline, tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for words in (("run", "no_load", "--out"), ("tune", "no_load", "--out"), ("check",)):
        code, out, err = flexspline(*words, tmp_path / "loop")
        assert code == 2 and not out
        assert "got a link that leads to itself" in err and len(err.splitlines()) == 1


def test_words_between_colons_are_no_pictures(flexspline, tmp_path):
    code, _, err = flexspline("check", tmp_path / "a:x:b")
    assert code == 2 and "a:x:b: expected a recording" in err


@pytest.mark.fast_every(3)
@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed_change_nothing_but_what_is_said(tmp_path, closed):
    for words, code in ((["causes"], 0), (["check", "nowhere"], 2)):
        done = subprocess.run(
            ["sh", "-c", f'exec "$@" {closed}', "sh", *PROGRAM, *words], capture_output=True, timeout=60
        )
        assert done.returncode == code and b"Traceback" not in done.stderr, done


@pytest.mark.fast_every(3)
@pytest.mark.parametrize(
    "words",
    ["check DATA", "check DATA --json", "joints", "causes --json", "schema joint", "joint show test-joint", "-h"],
)
def test_output_that_nobody_reads_is_141_and_silent(words):
    words = words.replace("DATA", str(Path(__file__).parents[1] / "frozen" / "measurement"))
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([*PROGRAM, *words.split()], stdout=writing, stderr=subprocess.PIPE, timeout=60)
    os.close(writing)
    assert done.returncode == 141 and not done.stderr


def test_a_refusal_that_nobody_reads_is_141():
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([*PROGRAM, "check", "/nowhere"], stdout=writing, stderr=writing, timeout=60)
    os.close(writing)
    assert done.returncode == 141


COMMANDS = [
    *([name] for name in commands._files() if name != "joint"), *(["joint", name] for name in commands._files("joint"))
]  # fmt: skip


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_an_unknown_option_of_any_command_is_one_line(flexspline, words):
    code, out, err = flexspline(*words, "--no-such-option")
    assert (code, out) == (2, "")
    assert err.startswith(f"flexspline: {' '.join(words)}: no such option") and err.count("\n") == 1
    assert "--no-such-option" in err  # the rest of the words are Typer's, and of its version


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["run"], ["run: missing argument", "scenarios"]),
        (["run", "no_load", "--out"], ["run: option '--out' requires an argument"]),
        (["run", "no_load", "--seed", "x"], ["run: --seed: ", " valid integer", "'x'"]),
        (["run", "no_load", "--seed=-1"], ["run: --seed: ", "-1"]),
        (["sweep", "x", "--seeds=0"], ["sweep: --seeds: ", "0"]),
        (["run", "no_load", "--outt", "x"], ["run: no such option", "--outt"]),
        (["runn"], ["flexspline: no such command 'runn'", "'run'"]),
        (["joint", "nope"], ["joint: no such command 'nope'"]),
        (["scenarios", "x"], ["scenarios: ", "x"]),
        (["run", "no_load", "--x\x1b[31m\n"], ["run: no such option", "--x"]),
        (["--nope"], ["flexspline: no such option", "--nope"]),
        (["challenge", "--size", "inf"], ["challenge: --size: ", "inf"]),
        (["challenge", "--hidden", "nope"], ["--hidden: expected one of 'none', 'one', 'two', 'outside', got 'nope';"]),
        (["contact", "--rate", "inf"], ["contact: --rate: ", "inf"]),
        (["contact", "--tolerance", "inf"], ["contact: --tolerance: ", "inf"]),
    ],
    ids=" ".join,
)  # fmt: skip
def test_a_mistake_in_the_call_is_one_line_with_where_help_is(flexspline, words, expected):
    code, out, err = flexspline(*words)
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert err.startswith("flexspline: ") and "-h`" in err and "\x1b" not in err
    assert all(part in err.lower() for part in expected), err


def test_the_program_alone_and_a_group_show_help(flexspline):
    for words, headings in (([], list(commands.GROUPS)), (["joint"], ["Commands"])):
        code, out, err = flexspline(*words)
        shown = re.findall(r"─ ([A-Z][a-z ]+) ─", out + err)
        assert code in (0, 2) and shown[1:] == headings
