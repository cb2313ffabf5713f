"""Run the benchmarks: all, or those named. Those that take minutes, or hours, run only when named.

Options after a name belong to that benchmark: `python -m benchmarks sysid --help`, `… studies model_error --jobs 1`.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import os
import platform
import sys
from importlib import metadata

NAMES = ("closed_loop", "updates", "compiled_loop", "sweep", "commands", "views", "derivatives", "elementary")
NAMED_ONLY = (
    "convergence",
    "estimators",
    "claims",
    "readings",
    "mistakes",
    "calibrated",
    "independent",
    "bands",
    "sysid",
    "contact",
    "torque_control",
    "bound",
    "studies",
    "arms",
    "real_logs",
    "accuracy",
)


def main() -> None:
    """Run and print."""
    words = sys.argv[1:]
    one = bool(words) and not words[0].startswith("-") and not {*words[1:]} <= {*NAMES, *NAMED_ONLY}
    options = words[1:] if one else []
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="name",
        help=f"any of {', '.join(NAMES + NAMED_ONLY)}; the first {len(NAMES)} by default",
    )
    arguments = parser.parse_args(words[:1] if one else words)
    unknown = [name for name in arguments.names if name not in NAMES + NAMED_ONLY]
    if unknown:
        parser.error(f"unknown benchmark {unknown[0]!r}: expected any of {', '.join(NAMES + NAMED_ONLY)}")
    if options:
        run = importlib.import_module(f"benchmarks.{words[0]}").main
        if not inspect.signature(run).parameters:
            parser.error(f"benchmark {words[0]!r} has no options, got {' '.join(options)}")
        run(options)
        return
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("mujoco", "numba", "numpy"))
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    print(f"{platform.machine()}, {os.cpu_count()} cores{load}; Python {platform.python_version()}, {versions}")
    print("medians after a warm-up, with lowest and highest\n")
    for name in arguments.names or NAMES:
        importlib.import_module(f"benchmarks.{name}").main()
        print()


if __name__ == "__main__":
    main()
