"""A sweep on a Dask cluster of real processes: the same rows, also when a worker is killed in the middle."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from small import rows, run, same, study

from flexspline.models.errors import InputError
from flexspline.scenarios.studies.dataset import Dataset
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.sweep import sweep, versions

WORKERS = 2
PATIENCE = 90  # s


@pytest.fixture
def cluster(tmp_path) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """Address of a scheduler, and its workers: a process and a thread each, nobody restarts them."""
    pytest.importorskip("distributed")
    note = tmp_path / "scheduler.json"
    environment = os.environ | {"DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION": "2"}
    processes = []

    def start(name: str, *arguments: str) -> subprocess.Popen:
        with (tmp_path / f"{name}{len(processes)}.log").open("w") as log:
            command = [sys.executable, "-m", f"distributed.cli.dask_{name}", "--scheduler-file", str(note), *arguments]
            processes.append(subprocess.Popen(command, stdout=log, stderr=log, env=environment, cwd=tmp_path))
        return processes[-1]

    try:
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        workers = [start("worker", "--no-nanny", "--nthreads", "1", "--no-dashboard") for _ in range(WORKERS)]
        begin = time.monotonic()
        while not note.exists() or not note.read_text().strip():
            assert time.monotonic() - begin < PATIENCE, "no scheduler"
            time.sleep(0.05)
        address = json.loads(note.read_text())["address"]
        yield address, workers
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()
        for log in sorted(tmp_path.glob("*.log")):
            print(log.name, log.read_text()[-1500:])


@pytest.mark.slow
def test_a_killed_worker_costs_nothing_but_time(cluster, tmp_path):
    """One of two workers is killed with SIGKILL while it computes: all rows come, the same to the bit as on threads."""
    from distributed import Client

    address, workers = cluster
    watcher = Client(address, set_as_default=False)
    watcher.wait_for_workers(WORKERS, timeout=PATIENCE)
    places = {pid: place for place, pid in watcher.run(os.getpid).items()}
    watcher.run(importlib.import_module, sweep.__module__)
    asked = study(seeds={"count": 8})
    design = Design.of(asked)
    dataset = Dataset.open(tmp_path / "cluster", design, versions())
    written, lost = [], []

    def kill(runs: int) -> None:
        written.append(runs)
        if len(written) >= 4 and not lost:
            lost.extend(watcher.processing()[places[workers[0].pid]])
            if lost:
                workers[0].send_signal(signal.SIGKILL)
                workers[0].wait()

    sweep(design, dataset, chunk=1, scheduler=address, progress=kill)
    watcher.close()
    print(f"killed after {len(written)} chunks with {lost} under way")
    assert workers[0].returncode == -signal.SIGKILL and workers[1].poll() is None
    assert len(written) == design.runs, "a chunk came twice, or never"
    assert rows(dataset).num_rows == design.runs * 3
    assert same(dataset, run(tmp_path / "threads", asked, jobs=2))


def test_no_scheduler_there_is_one_line(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("flexspline.scenarios.studies.sweep._PATIENCE", 1)
    design = Design.of(study())
    for address in ("tcp://127.0.0.1:9", "nowhere"):
        with pytest.raises(InputError) as caught:
            sweep(design, Dataset.open(tmp_path / "a", design, versions()), scheduler=address)
        message = str(caught.value)
        print(message)
        assert "\n" not in message and address in message and "scheduler" in message


def test_without_dask_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    design = Design.of(study())
    with pytest.raises(InputError, match=r"flexspline\[cluster\]"):
        sweep(design, Dataset.open(Path(tmp_path / "a"), design, versions()), scheduler="tcp://127.0.0.1:8786")
