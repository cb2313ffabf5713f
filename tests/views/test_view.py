"""`flexspline view`: what it opens, and that it listens on this computer only."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from flexspline.commands import view
from flexspline.models.errors import InputError
from flexspline.scenarios.run_folder import save_run
from flexspline.views.rerun import write_rerun


@pytest.mark.parametrize("case", ["missing", "empty", "other", "no_recording"])
def test_what_cannot_be_opened_is_refused_in_one_line(case, tmp_path):
    place = tmp_path / "run"
    if case != "missing":
        place.mkdir()
    if case == "empty":
        (place / "run.rrd").write_bytes(b"")
    if case == "other":
        (place / "run.rrd").write_text("not a recording")
    with pytest.raises(InputError) as error:
        view.find_recording(place)
    assert "\n" not in str(error.value)
    assert str(place) in str(error.value)


@pytest.mark.parametrize("name", ["run.rrd", "report.rrd", "mine.rrd"])
def test_folders_of_runs_and_diagnoses_open(name, tmp_path):
    (tmp_path / "one").mkdir()
    path = tmp_path / "one" / name
    path.write_bytes(b"RRF2")
    assert view.find_recording(path.parent) == path == view.find_recording(path)
    with pytest.raises(InputError, match="there is one in one below it"):
        view.find_recording(tmp_path)


def test_without_a_display_it_says_what_to_do(tmp_path, monkeypatch):
    if not sys.platform.startswith("linux"):
        pytest.skip("Linux only")
    (tmp_path / "run.rrd").write_bytes(b"RRF2")
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(InputError, match="--web"):
        view.command(folders=[tmp_path])


@pytest.mark.parametrize("web", [False, True], ids=["window", "web"])
def test_it_listens_on_this_computer_only(web, pushed, tmp_path):
    if not Path("/proc/net/tcp").exists():
        pytest.skip("no /proc/net/tcp")
    if not web and shutil.which("xvfb-run") is None:
        pytest.skip("no xvfb-run")
    path = write_rerun(pushed, tmp_path / "run.rrd")
    program = "import sys, pathlib; from flexspline.commands.view import command as view; "
    program += f"view(folders=[pathlib.Path(sys.argv[1])], web={web})"
    command = [sys.executable, "-c", program, str(path)]
    if not web:
        command = ["xvfb-run", "-a", *command]
    environment = {**os.environ, "BROWSER": "true"}
    with open(tmp_path / "log", "wb") as log:
        viewer = subprocess.Popen(command, stdout=log, stderr=log, env=environment, start_new_session=True)
    try:
        wanted = 2 if web else 1  # the web page and the data; the data
        found: set[tuple[str, int]] = set()
        end = time.monotonic() + 12
        while len(found) < wanted and time.monotonic() < end and viewer.poll() is None:
            time.sleep(0.3)
            found = listening(viewer.pid)
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)
        try:
            viewer.wait(timeout=3)
        except subprocess.TimeoutExpired:
            os.killpg(viewer.pid, signal.SIGKILL)
            viewer.wait()
    if len(found) < wanted:
        pytest.skip(f"the viewer did not come up: {(tmp_path / 'log').read_text(errors='replace')[-300:]}")
    assert {address for address, _ in found} == {"127.0.0.1"}


def listening(group: int) -> set[tuple[str, int]]:
    """Addresses and ports on which the processes of a session listen for TCP."""
    sockets = set()
    for process in Path("/proc").iterdir():
        if not process.name.isdigit():
            continue
        try:
            fields = (process / "stat").read_text().rsplit(")", 1)[1].split()
            if int(fields[3]) != group:  # session
                continue
            for descriptor in (process / "fd").iterdir():
                target = os.readlink(descriptor)
                if target.startswith("socket:["):
                    sockets.add(target[8:-1])
        except OSError:
            continue
    found = set()
    for table, listen in (("/proc/net/tcp", "0A"), ("/proc/net/tcp6", "0A")):
        if not Path(table).exists():
            continue
        for line in Path(table).read_text().splitlines()[1:]:
            columns = line.split()
            if columns[3] == listen and columns[9] in sockets:
                address, port = columns[1].split(":")
                found.add((readable(address), int(port, 16)))
    return found


def readable(address: str) -> str:
    """An address of /proc/net/tcp: IPv4 in dots, IPv6 unchanged."""
    if len(address) == 8:
        return ".".join(str(int(address[i : i + 2], 16)) for i in (6, 4, 2, 0))
    return address


def test_several_runs_are_laid_over_each_other(pushed, bare, tmp_path):
    """Signals of both on one timeline under their names, errors by filter, a joint each."""
    folders = [save_run(run, tmp_path / where / run.name) for run, where in ((pushed, "a"), (bare, "b"))]
    path = view.overlay(folders, tmp_path / "runs.rrd")
    paths = {str(chunk.entity_path) for chunk in RrdReader(path).stream().to_chunks()}
    for i in (1, 2):
        assert {f"/torque/run_{i}", f"/error/RAREKF/run_{i}", f"/position_error/run_{i}", f"/current/run_{i}"} <= paths
        assert any(one.startswith(f"/scene/run_{i}/") for one in paths)
    with pytest.raises(InputError, match="expected each run once"):
        view.overlay([folders[0], folders[0]], tmp_path / "runs.rrd")
    with pytest.raises(InputError, match="expected a run folder"):
        view.overlay([folders[0], tmp_path], tmp_path / "runs.rrd")
