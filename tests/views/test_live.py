"""`flexspline view --live`: what it streams is what a run writes, on this computer only, and Ctrl-C ends it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from test_view import listening

from flexspline.commands.view import play, viewer_command, viewer_environment
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.views.rerun import RunRecording, write_rerun

CHANGES = [
    "duration=3",
    "transient=0.5",
    "filters=[EKF, AREKF, RAREKF, rts_smoother, augmented]",
    "disturbances=[{kind: push, start: 1.5, duration: 0.2, torque: 5}]",
    "feedback=RAREKF",
    "current=command",
]


def columns(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Times [s] and values of every series and lane of a recording, by entity."""
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if name in ("Scalars:scalars", "StateChange:state")]
        if chunk.is_static or not names:
            continue
        times = batch.column("time").to_numpy(zero_copy_only=False).astype("timedelta64[ns]").astype(np.int64)
        values = np.array([row[0] for row in batch.column(names[0]).to_pylist()])
        found.setdefault(chunk.entity_path, []).append((times, values))
    merged = {}
    for path_, parts in found.items():
        times, values = (np.concatenate(one) for one in zip(*parts, strict=True))
        order = np.argsort(times, kind="stable")
        merged[path_] = times[order], values[order]
    return merged


def test_what_is_streamed_is_what_a_run_writes(tmp_path, rng):
    """Stretches of any length; entities and values as in the run's recording."""
    scenario, folder = load_scenario("external_push", CHANGES, 7)
    run = run_scenario(scenario, folder)
    stream = rr.RecordingStream("test")
    written = stream.binary_stream()
    shown, done, n = RunRecording(stream, run, live=True), 0, len(run.time)
    while done < n:
        end = min(done + int(rng.integers(2, 200)), n)
        end = n if n - end == 1 else end
        part = run.part(slice(done, end))
        for name in ("model_torque", "kinematic_error", "external_torque", "position_command", "command_error"):
            np.testing.assert_array_equal(getattr(part, name), getattr(run, name)[done:end])
        np.testing.assert_array_equal(part.estimate("RAREKF"), run.estimate("RAREKF")[done:end])
        np.testing.assert_array_equal(part.signals["motor_current"], run.signals["motor_current"][done:end])
        shown.send(slice(done, end))
        done = end
    shown.finish()
    (tmp_path / "live.rrd").write_bytes(written.read() or b"")

    streamed, recorded = columns(tmp_path / "live.rrd"), columns(write_rerun(run, tmp_path / "run.rrd"))
    assert streamed.keys() == recorded.keys()
    assert "/error/rts_smoother" in streamed and "/mode/RAREKF" in streamed and "/mode/EKF" not in streamed
    for path, (times, values) in recorded.items():
        if path.startswith("/mode/"):
            np.testing.assert_array_equal(streamed[path][0], times)
            np.testing.assert_array_equal(streamed[path][1], values)
            continue
        common, here, there = np.intersect1d(times, streamed[path][0], return_indices=True)
        assert len(common) > 0.2 * min(len(times), len(streamed[path][0]))
        np.testing.assert_array_equal(values[here], streamed[path][1][there], err_msg=path)
        assert streamed[path][1].max() == values.max() and streamed[path][1].min() == values.min()  # peaks stay
    assert len(RrdReader(tmp_path / "live.rrd").blueprints()) == 1
    scene = {p for p in RrdReader(tmp_path / "run.rrd").store().schema().entity_paths() if p.startswith("/scene")}
    assert scene <= set(RrdReader(tmp_path / "live.rrd").store().schema().entity_paths())


def test_it_keeps_pace():
    """At twice the speed 1 s of a scenario takes half a second, not less, in stretches that grow with the delay."""
    run = run_scenario(*load_scenario("no_load", ["duration=1", "transient=0.2", "filters=[RAREKF]"]))
    stream = rr.RecordingStream("test")
    written = stream.binary_stream()
    shown = RunRecording(stream, run, live=True)
    begin = time.monotonic()
    assert play(shown, 2.0)
    assert 0.45 <= time.monotonic() - begin
    assert written.read()


def test_a_stretch_may_have_no_window_of_a_filters_mode():
    """A fast computer shows two ticks at a time."""
    run = run_scenario(*load_scenario("no_load", ["duration=1", "transient=0.2", "filters=[RAREKF]"]))
    stream = rr.RecordingStream("test")
    written = stream.binary_stream()
    shown = RunRecording(stream, run, live=True)
    for first in range(0, 80, 2):
        shown.send(slice(first, first + 2))
    assert written.read()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "expected folders, or --live with a scenario, got neither"),
        (["somewhere", "--live", "no_load"], "got both"),
        (["somewhere", "--set", "duration=3"], "--set, --seed, --speed: expected --live with them"),
        (["--live", "no_lod", "--web"], "no_load"),
    ],
)
def test_what_does_not_go_together_is_refused(flexspline, words, said):
    code, out, err = flexspline("view", *words)
    assert code == 2 and not out
    assert said in err and len(err.splitlines()) == 1


def test_it_listens_here_only_and_ctrl_c_ends_it(tmp_path):
    if not Path("/proc/net/tcp").exists():
        pytest.skip("no /proc/net/tcp")
    program = "import sys; from flexspline.commands import main; sys.argv[0] = 'flexspline'; main()"
    words = ["view", "--live", "no_load", "--web", "--set", "filters=[RAREKF]", "--json"]
    with open(tmp_path / "log", "wb") as log, open(tmp_path / "out", "wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-c", program, *words], stdout=out, stderr=log, start_new_session=True,
            env={**os.environ, "BROWSER": "true"},
        )  # fmt: skip
    try:
        found: set[tuple[str, int]] = set()
        end = time.monotonic() + 40
        while len(found) < 2 and time.monotonic() < end and process.poll() is None:
            time.sleep(0.3)
            found = listening(process.pid)
        if len(found) < 2:
            pytest.skip(f"the viewer did not come up: {(tmp_path / 'log').read_text(errors='replace')[-300:]}")
        assert {address for address, _ in found} == {"127.0.0.1"}
        time.sleep(0.5)
        assert process.poll() is None
        os.kill(process.pid, signal.SIGINT)  # the command alone: the viewer is its to end
        assert process.wait(timeout=20) == 130
        assert listening(process.pid) == set()
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    assert "Traceback" not in (tmp_path / "log").read_text(errors="replace")
    assert (tmp_path / "out").read_text() == ""


def test_measures_in_the_end_as_json(flexspline, monkeypatch):
    """A viewer that ends when the run has: its place is taken by a server without one."""
    sent = {}

    def shown(run, web, speed):
        assert viewer_environment()["CI"] == "1" and {"127.0.0.1", "9876"} <= set(viewer_command(None, web, 9876))
        sent["speed"] = speed
        stream = rr.RecordingStream("test")
        stream.binary_stream()
        assert play(RunRecording(stream, run, live=True), 1000.0)

    monkeypatch.setattr("flexspline.commands.view.show_live", shown)
    monkeypatch.setenv("DISPLAY", ":0")
    code, out, err = flexspline(
        "view", "--live", "no_load", "--set", "duration=2", "--set", "filters=[RAREKF]", "--speed", 4, "--json"
    )
    assert code == 0, err
    assert sent["speed"] == 4
    assert set(json.loads(out)["no_load"]["filters"]) == {"RAREKF"}
