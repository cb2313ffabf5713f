"""Reliability in numbers: random inputs, plausible wrong inputs, killed processes, full disks, memory.

`python -m benchmarks reliability` runs as much of every part as `--minutes` (10) allow; names of parts (fuzz, nonsense,
kills, disk, memory) select them. `--inputs`, `--wrong`, `--kills` and `--seed` limit them. Exit code 1 after a
failure. The figures are in docs/reliability.md.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from flexspline.models.output import MANIFEST, recover
from flexspline.models.recording import write_recording
from flexspline.models.signals import WRENCH

from .full_disk import full_disk
from .jobs import Job, content, jobs, recording
from .nonsense import nonsense

HANG = 60.0
"""Seconds of a processor after which an input counts as frozen, compiling included."""
_BATCH = 50
PARTS = {"fuzz": 0.2, "nonsense": 0.45, "kills": 0.2, "disk": 0.1, "memory": 0.05}
"""Parts, and the share of the time that each may take where all are run."""


# --- inputs -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fuzzed:
    """What became of inputs: by kind and outcome, and a line for each that failed."""

    outcomes: Counter[tuple[str, str]]
    failures: list[str]


def fuzz(count: int, seed: int, processes: int = 2, until: float = math.inf) -> Fuzzed:
    """Use `count` inputs in separate processes, so that one that freezes or ends its process is seen; `until`: when this
    ends, as of `time.time`."""
    spans = [(begin, min(begin + _BATCH, count)) for begin in range(0, count, _BATCH)]
    outcomes: Counter[tuple[str, str]] = Counter()
    failures: list[str] = []
    with ThreadPoolExecutor(processes) as pool:
        for lines in pool.map(lambda span: list(_batch(seed, *span, until)), spans):
            for kind, became, failure in lines:
                outcomes[kind, became] += 1
                failures += [failure] if failure else []
    return Fuzzed(outcomes, failures)


def _batch(seed: int, begin: int, end: int, until: float) -> Iterator[tuple[str, str, str]]:
    """Kind, outcome and failure of the inputs of a span, in one process after the other where one ends early."""
    while begin < end and time.time() < until:
        words = [sys.executable, "-m", "benchmarks.fuzzing", str(seed), str(begin), str(end)]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert process.stdout is not None
        at = begin
        while True:
            used, ready = _seconds_used(process.pid), False
            while not ready and _seconds_used(process.pid) - used < HANG and time.time() < until:
                ready = bool(select.select([process.stdout], [], [], min(2.0, max(until - time.time(), 0.0)))[0])
            line = process.stdout.readline() if ready else None
            if not line:
                break
            what, number, *rest = line.rstrip("\n").split("\t")
            if what == "begin":
                at = int(number)
            elif what == "end":
                kind, became, *failure = rest
                yield kind, became, f"{kind} {number}: {' '.join(failure)}" if failure[0] else ""
                begin = int(number) + 1
        if begin < end and time.time() < until:
            why = "freezes" if line is None else f"took its process down ({process.wait()})"
            yield "?", "failed", f"input {at}: {why}"
            begin = at + 1
        process.kill()
        process.wait()


def _seconds_used(process: int) -> float:
    """Processor time [s] of a process (Linux), which does not grow while others are at work; elsewhere, time."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return time.monotonic()


# --- kills ------------------------------------------------------------------------------------------------------------

_DYING = """
import os, shutil, sys
left = int(sys.argv.pop(1))
def dying(function):
    def call(*arguments, **options):
        global left
        left -= 1
        if left < 0:
            os.kill(os.getpid(), 9)
        return function(*arguments, **options)
    return call
for name in ("rename", "replace"):
    setattr(os, name, dying(getattr(os, name)))
from flexspline.commands import main
main()
"""
"""The command line, killed before the n-th time that it moves something into place."""


def kills(random_moments: int, chosen: int, seed: int, until: float = math.inf) -> tuple[Counter[str], list[str]]:
    """Kill commands while they replace earlier output; what was done, and what was torn, refused or left.

    Args:
      random_moments: kills (SIGKILL, SIGTERM, SIGINT) at moments drawn over a command's duration.
      chosen: kills at most before each time that something is moved into place, one command after the other.
      seed: of the moments.
      until: when no further one begins, as of `time.time`.
    """
    rng, done, wrong = random.Random(seed), Counter[str](), []
    with _folder() as folder:
        every = [job for job in jobs(folder) if job.repeats]
        complete = {job.name: _outputs(job, folder) for job in every if time.time() < until}
        for number in range(random_moments):
            if time.time() > until:
                break
            job = every[number % len(every)]
            name = rng.choice(["SIGKILL", "SIGTERM", "SIGINT"])
            at = rng.uniform(0.05, 1.15) * complete[job.name][2]
            done[f"{job.name}, {name}"] += 1
            wrong += _killed(job, complete[job.name], folder, [], getattr(signal, name), at)
        for job in every:
            for step in range(chosen):
                if time.time() > until:
                    break
                before = len(wrong)
                wrong += _killed(job, complete[job.name], folder, [str(step)], None, 0.0)
                if _ran_through:
                    break
                done[f"{job.name}, before it moves something"] += 1
                if len(wrong) > before:
                    wrong[-1] += f" (step {step})"
    return done, wrong


_ran_through: list[bool] = []


def _outputs(job: Job, folder: Path) -> tuple[dict[str, bytes], dict[str, bytes], float]:
    """Complete outputs of a job, the earlier and the new one over it, and how long the latter takes [s]."""
    out = folder / "complete" / job.name
    _call(job.words("old", out))
    old = content(out)
    began = time.monotonic()
    _call(job.words("new", out))
    return old, content(out), time.monotonic() - began


def _killed(
    job: Job, complete: tuple[dict[str, bytes], dict[str, bytes], float], folder: Path, step: list[str],
    number: int | None, at: float,
) -> list[str]:  # fmt: skip
    """Kill a job at a time, or at a step; what is wrong afterwards."""
    print(f"{job.name} {step} {number} {at:.2f}", file=sys.stderr, flush=True)
    old, new, _ = complete
    out = folder / "killed" / job.name
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(folder / "old" / job.name, out) if (folder / "old" / job.name).exists() else _call(
        job.words("old", out)
    )
    if not (folder / "old" / job.name).exists():
        shutil.copytree(out, folder / "old" / job.name)
    (out / "mine.txt").write_text("a person's own")
    program = ["-c", _DYING, *step] if step else ["-m", "flexspline"]
    process = subprocess.Popen(
        [sys.executable, *program, *job.words("new", out)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    if number is not None:
        with suppress(subprocess.TimeoutExpired):
            process.wait(at)
        process.send_signal(number)
    _, err = process.communicate(timeout=120)
    _ran_through[:] = [True] if step and process.returncode == 0 else []
    wrong = []
    if b"Traceback" in err and at > 0.3:
        wrong.append(f"{job.name}: a traceback: {err.decode()[-200:]}")
    for place in (out, *(p for p in out.iterdir() if p.is_dir())):
        recover(place)
    found = content(out)
    if job.name == "sweep":  # grows file by file
        whole = all(found[name] in (old.get(name), new.get(name)) for name in found)
    else:
        whole = found in (old, new)
    if not whole:
        wrong.append(f"{job.name}: torn: {sorted(found)}")
    code, err_text = _call(job.words("new", out))
    if code != 0:
        wrong.append(f"{job.name}: refused to start again: {err_text}")
    elif content(out) != new:
        wrong.append(f"{job.name}: another result after it was killed")
    if (out / "mine.txt").read_text() != "a person's own":
        wrong.append(f"{job.name}: a person's own file is gone")
    left = [p.name for p in out.rglob(".*") if p.name != MANIFEST]
    if left:
        wrong.append(f"{job.name}: left {left}")
    return wrong


def _call(words: list[str]) -> tuple[int, str]:
    done = subprocess.run([sys.executable, "-m", "flexspline", *words], capture_output=True, text=True, timeout=300)
    return done.returncode, done.stderr.strip()


# --- memory -----------------------------------------------------------------------------------------------------------


def memory(
    hours: float, commands: Sequence[str] = ("check", "estimate", "run"), until: float = math.inf
) -> list[tuple[str, float, float]]:
    """Largest memory [MB, 10⁶ bytes] and time [s] of commands: `check` and `estimate` over ten columns of so many hours at 1 kHz,
    `run` over ten minutes and over so many hours, as many as end by `until`.
    Compiling, which happens once and takes 100 MB more, is done before."""
    found = []
    with _folder() as folder:
        long = recording(3600 * hours)
        axes = {name: long["joint_torque"] for name in WRENCH[:5]}
        write_recording(replace(long, columns={**long.columns, **axes}), folder / "m")
        del long, axes
        write_recording(recording(6.0), folder / "short")
        estimators = [word for name in ("EKF", "model", "current") for word in ("--filter", name)]
        plain, out = ["--no-figures", "--no-recording"], ["--out", str(folder / "r")]
        for name, words in (
            ("check", ["check", str(folder / "m")]),
            ("estimate, three filters", ["estimate", str(folder / "m"), "--out", str(folder / "e"), *estimators]),
            ("estimate, all", ["estimate", str(folder / "m"), "--out", str(folder / "a")]),
            ("run, 600 s", ["run", "external_push", "--set", "duration=600", *plain, *out]),
            (f"run, {3600 * hours:g} s", ["run", "external_push", "--set", f"duration={3600 * hours:g}", *plain, *out]),
            (
                f"run with views, {3600 * hours:g} s",
                ["run", "external_push", "--set", f"duration={3600 * hours:g}", *out],
            ),
        ):
            if words[0] not in commands:
                continue
            if time.time() > until:
                break
            # Compiled once and for all, into a separate folder: estimates of another measurement are not replaced.
            first = [word.replace(str(folder / "m"), str(folder / "short")) for word in words]
            if "--out" in first:
                first[first.index("--out") + 1] += "-first"
            _call([*first, "--set", "duration=5"] if words[0] == "run" else first)
            with suppress(subprocess.TimeoutExpired):
                size, seconds, error = peak([sys.executable, "-m", "flexspline", *words], until - time.time())
                found.append((f"{name} ({error})" if error else name, size, seconds))
    return found


_PEAK = """
import os, subprocess, sys, time
began = time.monotonic()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(usage.ru_maxrss, time.monotonic() - began, os.waitstatus_to_exitcode(status))
"""


def peak(words: Sequence[str], limit: float = math.inf) -> tuple[float, float, str]:
    """Largest memory [MB, 10⁶ bytes] and time [s] of a program, and the last line of its errors where it fails.

    It is ended after `limit` seconds.

    Linux counts with a process what the one that started it held until then: a small one is put between.
    """
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", _PEAK, *words], text=True, start_new_session=True, **pipes) as process:
        try:
            out, err = process.communicate(timeout=None if limit == math.inf else max(limit, 0.0))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    kilobytes, seconds, code = out.split()
    error = (err.strip().splitlines() or ["?"])[-1] if int(code) else ""
    return float(kilobytes) * 1024 / 1e6, float(seconds), error


@contextmanager
def _folder() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="reliability"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main(arguments: Sequence[str] = ()) -> None:
    """Run what is asked and print its figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks reliability", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="part", help=f"any of {', '.join(PARTS)}; all by default")
    parser.add_argument("--minutes", type=float, default=10.0, help="that all of it may take")
    parser.add_argument("--inputs", type=int, default=12_000, help="made at random, at most")
    parser.add_argument("--wrong", type=int, default=200, help="plausible wrong inputs, at most")
    parser.add_argument(
        "--diagnose", type=float, default=0.0, metavar="SECONDS", help="of search for what nothing else answers"
    )
    parser.add_argument("--kills", type=int, default=100, help="at random moments")
    parser.add_argument("--chosen", type=int, default=12, help="moments of each command, at most")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hours", type=float, default=0.1, help="of recordings and runs whose memory is measured")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, help="that use inputs at a time")
    asked = parser.parse_args(arguments)
    parts = asked.parts or list(PARTS)
    whole = sum(PARTS[part] for part in parts)

    def until(part: str) -> float:
        return time.time() + 60 * asked.minutes * PARTS[part] / whole

    failed = False
    if "fuzz" in parts:
        found = fuzz(asked.inputs, asked.seed, asked.processes, until("fuzz"))
        print(f"inputs, seed {asked.seed}: {found.outcomes.total()} answered in time, failed: {len(found.failures)}")
        for (kind, became), count in sorted(found.outcomes.items()):
            print(f"  {kind:10} {became:8} {count}")
        print(*(f"  {line}" for line in found.failures), sep="\n")
        failed |= bool(found.failures) or not found.outcomes
    if "nonsense" in parts:
        answers = nonsense(asked.wrong, asked.seed, asked.processes, until("nonsense"), asked.diagnose)
        silent = Counter(a.kind for a in answers if a.silent)
        wrong = sum(a.kind != "sound" for a in answers)
        print(
            f"silent nonsense, seed {asked.seed}: {silent.total()} of {wrong} wrong inputs; {len(answers)} answered in time"
        )
        for kind, count in sorted(Counter(a.kind for a in answers).items()):
            own = [a for a in answers if a.kind == kind]
            named, warned = sum(bool(a.mistakes) for a in own), sum(a.estimate != "silent" for a in own)
            print(f"  {kind:14} {silent[kind]:3} of {count:3} silent; by check {named}, by estimate {warned}")
        failed |= silent.total() > 0.05 * wrong or not answers
    for part, result in (
        ("kills", lambda: kills(asked.kills, asked.chosen, asked.seed, until("kills"))),
        (
            "disk",
            lambda: full_disk(
                None if asked.minutes > 60 else ["import", "estimate"], 1 if asked.minutes > 60 else 10, until("disk")
            ),
        ),
    ):
        if part in parts:
            answer = result()
            if answer is None:
                print(f"{part}: not run, expected Linux with a C compiler")
                continue
            done, wrong = answer
            total = sum(n for what, n in done.items() if not what.startswith("of these"))
            print(f"{part}: {total}, wrong: {len(wrong)}")
            for what, count in sorted(done.items()):
                print(f"  {what:40} {count}")
            print(*(f"  {line}" for line in wrong), sep="\n")
            failed |= bool(wrong)
    if "memory" in parts:
        for name, size, seconds in memory(asked.hours, until=until("memory")):
            print(f"memory: {name}: {size:.0f} MB, {seconds:.0f} s")
    sys.exit(failed)
