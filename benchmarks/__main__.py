"""Run the benchmarks: all, or those named. Those that take minutes, or hours, run only when named.

Options after a name belong to that benchmark: `python -m benchmarks sysid --help`, `… studies model_error --jobs 1`.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import itertools
import os
import platform
import sys
from importlib import metadata

NAMES = ("closed_loop", "updates", "sweep", "commands")
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
    "reliability",
    "lara8",
    "ur3e",
    "link_flexibility",
)


def main() -> None:
    """Run and print."""
    known = f"any of {', '.join(NAMES + NAMED_ONLY)}; the first {len(NAMES)} by default"
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="name", help=known)
    names = list(itertools.takewhile({*NAMES, *NAMED_ONLY}.__contains__, sys.argv[1:]))
    options = sys.argv[1 + len(names) :]
    if not names and (unknown := parser.parse_args(options).names):
        parser.error(f"unknown benchmark {unknown[0]!r}: expected {known}")
    if options:
        run = importlib.import_module(f"benchmarks.{names[-1]}").main
        if len(names) > 1 or not inspect.signature(run).parameters:
            parser.error(f"{' '.join(names)}: expected no options, got {' '.join(options)}")
        run(options)
        return
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("mujoco", "numba", "numpy"))
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    print(f"{platform.machine()}, {os.cpu_count()} cores{load}; Python {platform.python_version()}, {versions}")
    print("medians after a warm-up, with lowest and highest\n")
    for name in names or NAMES:
        importlib.import_module(f"benchmarks.{name}").main()
        print()


if __name__ == "__main__":
    main()
