"""A disk that is full from the n-th write on, for every n: a command must end in one line and leave nothing half-written.

A library that is loaded before the C library (LD_PRELOAD) counts the writes below a folder and refuses them from the n-th
on. Linux, with a C compiler.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from flexspline.models.output import MANIFEST, recover

from .jobs import Job, content, jobs

_SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static volatile long *state;  /* how many there were, and how many there may be (-1: any number) */
static const char *root;

__attribute__((constructor)) static void begin(void)
{
    root = getenv("FULL_DISK");
    const char *path = getenv("FULL_DISK_STATE");
    int file = path ? open(path, O_RDWR) : -1;
    if (file < 0 || !root) return;
    void *found = mmap(0, 16, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (found != MAP_FAILED) state = found;
    close(file);
}

static int refused(const char *path)
{
    if (!state || strncmp(path, root, strlen(root))) return 0;
    long count = __sync_add_and_fetch(&state[0], 1), most = state[1];
    if (most < 0 || count <= most) return 0;
    errno = ENOSPC;
    return 1;
}

static int refused_file(int file)
{
    char link[64], path[4096];
    int before = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    errno = before;
    if (length <= 0) return 0;
    path[length] = 0;
    return refused(path);
}

static int refused_at(int folder, const char *path)
{
    char whole[8192] = "";
    if (path[0] != '/') {
        if (folder == AT_FDCWD) {
            if (!getcwd(whole, 4096)) return 0;
        } else {
            char link[64];
            snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
            ssize_t length = readlink(link, whole, 4095);
            if (length <= 0) return 0;
            whole[length] = 0;
        }
        strcat(whole, "/");
    }
    strncat(whole, path, 4000);
    return refused(whole);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define OPEN(name, folder, head, args) \
    int name head { \
        mode_t mode = 0; \
        if (flags & O_CREAT) { va_list rest; va_start(rest, flags); mode = va_arg(rest, mode_t); va_end(rest); } \
        if ((flags & O_CREAT) && faccessat(folder, path, F_OK, 0) && refused_at(folder, path)) return -1; \
        return REAL(name) args; }
OPEN(open, AT_FDCWD, (const char *path, int flags, ...), (path, flags, mode))
OPEN(open64, AT_FDCWD, (const char *path, int flags, ...), (path, flags, mode))
OPEN(openat, folder, (int folder, const char *path, int flags, ...), (folder, path, flags, mode))
OPEN(openat64, folder, (int folder, const char *path, int flags, ...), (folder, path, flags, mode))
#define WRITE(name, head, args) ssize_t name head { return refused_file(file) ? -1 : REAL(name) args; }
WRITE(write, (int file, const void *from, size_t size), (file, from, size))
WRITE(pwrite, (int file, const void *from, size_t size, off_t at), (file, from, size, at))
WRITE(pwrite64, (int file, const void *from, size_t size, off64_t at), (file, from, size, at))
WRITE(writev, (int file, const struct iovec *from, int parts), (file, from, parts))
#define PATH(name, head, args) int name head { return refused_at(AT_FDCWD, path) ? -1 : REAL(name) args; }
PATH(mkdir, (const char *path, mode_t mode), (path, mode))
PATH(rename, (const char *old, const char *path), (old, path))
#define PATH_AT(name, head, args) int name head { return refused_at(folder, path) ? -1 : REAL(name) args; }
PATH_AT(mkdirat, (int folder, const char *path, mode_t mode), (folder, path, mode))
PATH_AT(renameat, (int from, const char *old, int folder, const char *path), (from, old, folder, path))
"""


_STAGE = re.compile(r" *\d+\.\d s +\d+ %  ")  # how far it is, where there is no terminal
HANG = 300.0
"""Seconds after which a command that met a full disk counts as frozen."""


def full_disk(
    names: list[str] | None = None, step: int = 1, until: float = math.inf
) -> tuple[Counter[str], list[str]] | None:
    """Run commands on a disk that is full from the n-th write on: how often each was refused or done, and what was wrong.

    Args:
      names: of the jobs (`jobs.jobs`); all by default.
      step: every so many n only.
      until: when no further one begins, as of `time.time`.

    Returns:
      None where there is no C compiler, or another system than Linux.
    """
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        return None
    with tempfile.TemporaryDirectory(prefix="full-disk") as name:
        folder = Path(name)
        (folder / "full.c").write_text(_SOURCE)
        library = folder / "full.so"
        subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, folder / "full.c", "-ldl"], check=True)
        state = folder / "state"
        state.write_bytes(struct.pack("ll", 0, -1))
        disk = folder / "disk"
        disk.mkdir()
        environment = os.environ | {"LD_PRELOAD": str(library), "FULL_DISK": f"{disk}/", "FULL_DISK_STATE": str(state)}
        words = [sys.executable, "-m", __name__, str(folder), str(step), str(until), *(names or [])]
        process = subprocess.run(words, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    done, wrong = json.loads(process.stdout)
    return Counter(done), wrong


def _every(folder: Path, step: int, until: float, names: list[str]) -> tuple[Counter[str], list[str]]:
    """`full_disk` in a process with the refusing library, by a fork for every n."""
    done, wrong = Counter[str](), []
    with (folder / "state").open("r+b") as file:
        state = mmap.mmap(file.fileno(), 16)
    for job in jobs(folder / "inputs"):
        if (names and job.name not in names) or time.time() > until:
            continue
        out, kept = folder / "disk" / job.name, folder / "kept" / job.name
        _call(job.words("old", out), folder)
        _main(job.words("new", folder / "warm" / job.name))  # loads and compiles before the processes part
        shutil.copytree(out, kept)
        old = content(out)
        for most in _counts(step):
            if time.time() > until:
                break
            shutil.rmtree(out)
            shutil.copytree(kept, out)
            state[:] = struct.pack("ll", 0, most)
            code, err = _call(job.words("new", out), folder)
            count, _ = struct.unpack("ll", state[:])
            state[:] = struct.pack("ll", 0, -1)
            done[f"{job.name}, {'done' if code == 0 else 'refused'}"] += 1
            wrong += [f"{job.name}, full after {most} of {count}: {what}" for what in _wrong(job, out, old, code, err)]
            if count <= most:
                new = content(out)
                if code != 0 or new == old:
                    wrong.append(f"{job.name}: not done with room enough: {code} {err}")
                if count < 2 * len(new):
                    wrong.append(
                        f"{job.name}: {len(new)} files made and filled by {count} writes: some are not counted"
                    )
                break
    return done, wrong


def _counts(step: int) -> Iterator[int]:
    most = 0
    while True:
        yield most
        most += step


def _wrong(job: Job, out: Path, old: dict[str, bytes], code: int, err: str) -> Iterator[str]:
    """What is not as it should be after a command met a full disk."""
    lines = [line for line in err.splitlines() if not _STAGE.match(line)]
    if code == 2 and (len(lines) != 1 or not lines[0].startswith("flexspline: ")):
        yield f"expected one line, got {err[-400:]!r}"
    elif code not in (0, 2):
        yield f"exit code {code}: {err[-600:]}"
    interrupted = [p for p in out.rglob(f"{MANIFEST}-done-*")]
    for place in {p.parent for p in interrupted}:  # with room again, the next to open it completes it
        recover(place)
    found = content(out)
    if job.name == "sweep":  # grows file by file
        torn = any(name not in found for name in old)
    else:
        torn = code != 0 and not interrupted and found != old
    if torn:
        yield f"torn: {sorted(name for name in found.keys() | old.keys() if found.get(name) != old.get(name))}"
    left = sorted(p.relative_to(out).as_posix() for p in out.rglob(".*") if p.name != MANIFEST)
    if left:
        yield f"left {left}"


def _call(words: list[str], folder: Path) -> tuple[int, str]:
    """Exit code and stderr of a command in a separate process with the same start."""
    errors = folder / "stderr"
    process = os.fork()
    if process == 0:
        os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), 2)
        code = 1
        try:
            code = _main(words)
        except BaseException:
            import traceback

            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    end = time.monotonic() + HANG
    while True:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status), errors.read_text(errors="replace")
        if time.monotonic() > end:
            os.kill(process, 9)
            os.waitpid(process, 0)
            return -1, "frozen"
        time.sleep(0.01)


def _main(words: list[str]) -> int:
    """Call the command line here; its exit code."""
    from flexspline import commands

    replay = sys.modules.get("flexspline.diagnosis.fit.replay")
    if replay is not None:
        replay._pool.cache_clear()  # threads do not pass through a fork
    sys.argv = ["flexspline", *words]
    stdout = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    try:
        commands.main()
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
    finally:
        sys.stdout.flush()
        os.dup2(stdout, 1)
        os.close(stdout)
    return 0


if __name__ == "__main__":
    print(json.dumps(_every(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4:])))
