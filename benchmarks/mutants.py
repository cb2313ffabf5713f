"""Mutation testing: one operator or number of the estimators and of diagnosis' statistics is changed, and a fast test must fail.

`python -m benchmarks.mutants --count 40 --seed 1` draws mutants, each place that could be changed as likely as another; `--file`
names files. Every mutant runs in a copy of the sources, in the order drawn: where a run is stopped, those done are a sample too.
`--copy` names a folder for that copy, whose compiled code serves the next run. Exit code 1 where fewer than 85 % were killed;
survivors are listed (docs/reliability.md).
"""

from __future__ import annotations

import argparse
import ast
import importlib
import math
import os
import random
import resource
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from scipy.stats import binomtest

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 400
"""Seconds of a processor after which a mutant counts as killed: it hangs, however busy the machine is."""
WANTED = 0.85
_E, _D = "tests/estimator/test_", "tests/diagnosis/test_"


def _symmetric(*names: str) -> list[str]:
    """Tests that hold of every estimator, of these alone."""
    there = f"{_E}symmetry.py::test_"
    kinds = [f"{there}torques_scale_with_the_joint[{n}-{case}]" for n in names for case in ("rich", "late")]
    return [*kinds, *(f"{there}a_joint_turned_round_has_the_same_torques_the_other_way[{n}-rich]" for n in names)]


def _filter(*names: str) -> list[str]:
    return [
        f"{_E}torque_filters.py",
        *_symmetric(*names),
        f"{_E}invariance.py",
        f"{_E}estimator.py",
        f"{_E}known_effects.py",
    ]


_AUGMENTED = [f"{_E}settings.py", f"{_E}augmented_model.py", *_symmetric("augmented"), f"{_E}augmented.py"]
_DYNAMICS = [f"{_E}settings.py", f"{_E}dynamics_reference.py", f"{_E}dynamics_filters.py"]
TESTS = {
    "estimator/arrays.py": [f"{_E}recursion.py", f"{_E}paper_filter.py"],
    "estimator/bands.py": [f"{_E}bands.py", f"{_D}uncertainty.py"],
    "estimator/bound.py": [f"{_E}bound.py"],
    "estimator/compliance.py": [
        f"{_E}compliance.py",
        *_symmetric("model"),
        f"{_E}paper_filter.py",
        f"{_E}printed.py",
        f"{_E}known_effects.py",
    ],
    "estimator/consistency.py": [f"{_E}consistency.py"],
    "estimator/dynamics_filter.py": [*_DYNAMICS, *_symmetric("dynamics_ukf", "dynamics_ekf"), f"{_E}estimator.py"],
    "estimator/estimator.py": [f"{_E}estimator.py", f"{_E}settings.py", f"{_E}invariance.py", f"{_E}offline.py"],
    "estimator/external.py": [f"{_E}sensing.py", "tests/scenarios/evaluation/test_contact.py"],
    "estimator/joint_model.py": [
        *_DYNAMICS,
        *_symmetric("dynamics_ukf", "dynamics_ekf"),
        f"{_E}bound.py",
        f"{_E}augmented_model.py",
    ],
    "estimator/motion.py": [f"{_E}motion.py", f"{_E}smoothed.py", f"{_E}torque_filters.py", f"{_E}invariance.py"],
    "estimator/offline.py": [f"{_E}offline.py", f"{_E}invariance.py", f"{_E}bands.py"],
    "estimator/online.py": [f"{_E}estimator.py"],
    "estimator/payload_model.py": [f"{_E}payload_model.py", *_filter("payload", "payload_smoothed")],
    "estimator/quantised.py": [f"{_E}dynamics_filters.py", f"{_E}dynamics_reference.py"],
    "estimator/recursion.py": [f"{_E}recursion.py", f"{_E}invariance.py", f"{_E}printed.py"],
    "estimator/registry.py": [f"{_E}estimator.py"],
    "estimator/sensing.py": [
        f"{_E}sensing.py",
        *_symmetric("payload", "model"),
        f"{_E}estimator.py",
        f"{_E}known_effects.py",
    ],
    "estimator/smoothed.py": [
        f"{_E}smoothed.py",
        *_symmetric("current_smoothed"),
        f"{_D}balance.py",
        f"{_E}invariance.py",
        f"{_E}offline.py",
    ],
    "estimator/tuning_parameters.py": [f"{_E}estimator.py"],
    "estimator/filters/augmented.py": [*_AUGMENTED, f"{_E}invariance.py", f"{_E}estimator.py"],
    "estimator/filters/compliance_model.py": _filter("model"),
    "estimator/filters/current.py": _filter("current"),
    "estimator/filters/current_smoothed.py": _filter("current_smoothed"),
    "estimator/filters/dynamics_ekf.py": [*_DYNAMICS, f"{_E}estimator.py"],
    "estimator/filters/dynamics_ukf.py": [*_DYNAMICS, f"{_E}estimator.py"],
    "estimator/filters/h_infinity.py": _filter("h_infinity"),
    "estimator/filters/huber.py": _filter("huber"),
    "estimator/filters/kalman.py": _filter("kalman", "h_infinity"),
    "estimator/filters/lowpass.py": _filter("lowpass", "lowpass_first_order"),
    "estimator/filters/momentum.py": _filter("momentum", "momentum_torsion"),
    "estimator/filters/paper.py": [
        f"{_E}paper_filter.py",
        f"{_E}printed.py",
        *_symmetric("RAREKF"),
        f"{_E}estimator.py",
    ],
    "estimator/filters/payload.py": _filter("payload", "payload_smoothed"),
    "estimator/filters/rts_smoother.py": [f"{_E}dynamics_filters.py", *_symmetric("rts_smoother"), f"{_E}estimator.py"],
    "estimator/filters/strong_tracking.py": _filter("strong_tracking"),
    "benchmarks/balance.py": [f"{_D}balance.py"],
    "diagnosis/uncertainty.py": [f"{_D}uncertainty.py"],
}
"""Files, and the fast tests that are to notice what is changed in them, those first that compile least and say most."""
_OTHER: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A changed source: `file`, what was changed where, the text of the file."""

    file: str
    change: str
    text: str


def drawn(files: list[str], count: int, rng: random.Random) -> list[Mutant]:
    """Mutants of files, drawn without repetition: what is only said (messages, types, defaults) is left."""
    everywhere = [(file, place) for file in files for place in _places(file)]
    return [_mutant(file, place) for file, place in rng.sample(everywhere, min(count, len(everywhere)))]


def _places(file: str) -> list[int]:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    silent = _silent(tree)
    return [k for k, node in enumerate(ast.walk(tree)) if k not in silent and any(_changes(node))]


def _mutant(file: str, place: int) -> Mutant:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    target: Any = next(node for k, node in enumerate(ast.walk(tree)) if k == place)
    before = ast.unparse(target)
    next(_changes(target))(target)
    return Mutant(
        file,
        f"line {target.lineno}, column {target.col_offset + 1}: {before} → {ast.unparse(target)}",
        ast.unparse(tree),
    )


def _changes(node: Any) -> Iterator[Callable[[Any], None]]:
    if isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in _OTHER:
        yield lambda n: setattr(n, "op", _OTHER[type(n.op)]())
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in _OTHER:
        yield lambda n: n.ops.__setitem__(0, _OTHER[type(n.ops[0])]())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield lambda n: setattr(n, "op", ast.UAdd())
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield lambda n: setattr(n, "value", n.value + 1 if n.value in (0, 1, 2) else 1.5 * n.value)


def _silent(tree: ast.AST) -> set[int]:
    """Places of nodes that only say something: messages, types, decorators, numbers outside functions, sizes of buffers."""
    inside: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.Lambda)):
            inside |= {id(n) for part in _bodies(node) for n in ast.walk(part)}
    quiet: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Raise, ast.JoinedStr, ast.Assert)):
            quiet |= {id(n) for n in ast.walk(node)}
        if isinstance(node, ast.Call) and _name(node.func) in ("carray", "empty"):  # a record, or room for more
            quiet |= {id(n) for part in node.args for n in ast.walk(part)}
        if isinstance(node, ast.AnnAssign):
            quiet |= {id(n) for n in ast.walk(node.annotation)}
    return {k for k, n in enumerate(ast.walk(tree)) if id(n) not in inside or id(n) in quiet}


def _name(function: ast.AST) -> str:
    return str(getattr(function, "id", "") or getattr(function, "attr", ""))


def _bodies(node: ast.FunctionDef | ast.Lambda) -> list[ast.AST]:
    return [node.body] if isinstance(node, ast.Lambda) else list(node.body)


def survives(mutant: Mutant, sources: Path) -> bool:
    """Whether all fast tests of its file pass in a copy of the sources."""
    path = sources / mutant.file
    before = path.read_bytes()
    path.write_text(mutant.text, encoding="utf-8")
    try:
        return _passes(TESTS[mutant.file], sources)
    finally:
        path.write_bytes(before)


def _passes(tests: list[str], sources: Path, limit: int = LIMIT) -> bool:
    """Whether tests pass in a copy of the sources: in a fork of this process, which has imported what takes long."""
    child = os.fork()
    if child == 0:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        os._exit(_tested(tests, sources, limit))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def _tested(tests: list[str], sources: Path, limit: int) -> int:
    import pytest

    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    os.environ |= {
        "PYTHONPATH": str(sources), "FLEXSPLINE_SHARED": os.environ.get("FLEXSPLINE_SHARED", str(ROOT.parent / "shared"))
    }  # fmt: skip
    own = {str(ROOT), "", "."}
    sys.path[:] = [str(sources), *(path for path in sys.path if path not in own)]
    sys.dont_write_bytecode = True
    os.chdir(sources)
    try:
        return int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", *tests]))
    except BaseException:  # a source that cannot be imported, whatever it raises
        return 1


def _warm_up() -> None:
    """Import what the tests do, but for this package, and let Numba compile for the first time."""
    for name in (
        "filterpy.kalman",
        "hypothesis",
        "mujoco",
        "pandas",
        "pyarrow.parquet",
        "scipy.optimize",
        "scipy.signal",
        "yaml",
    ):
        importlib.import_module(name)
    record = np.zeros(2, [("a", np.float64), ("b", np.float64, 3)])

    @numba.njit(error_model="numpy")
    def of(values, records):
        total = 0.0
        for k in range(len(values)):
            total += math.exp(-min(abs(values[k]), 1.0)) / (1.0 + records[0].b[0])
        return total

    of(np.ones(3), record)


def main() -> None:
    """Draw mutants, print what became of each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--file", action="append", choices=list(TESTS), help="Repeatable; all by default.")
    parser.add_argument("--copy", type=Path, help="A folder for the copy of the sources, kept.")
    parser.add_argument("--passing", action="store_true", help="The tests are known to pass as it is: do not try them.")
    parser.add_argument("--done", type=int, default=0, help="How many of them have been done already.")
    asked = parser.parse_args()
    _warm_up()
    mutants = drawn(asked.file or list(TESTS), asked.count, random.Random(asked.seed))
    survivors: list[Mutant] = []
    with tempfile.TemporaryDirectory(prefix="mutants") as name:
        sources = asked.copy or Path(name) / "sources"
        for link in filter(Path.is_symlink, sources.glob("*/*")):  # no copy is made over one
            link.unlink()
        left = shutil.ignore_patterns(".git", ".venv*", "docs", "runs")
        shutil.copytree(ROOT, sources, symlinks=True, ignore=left, dirs_exist_ok=asked.copy is not None)
        # All at once: what is compiled and set up serves many of them.
        whole = list(dict.fromkeys(test.partition("::")[0] for m in mutants for test in TESTS[m.file]))
        if not asked.passing and not _passes(whole, sources, limit=10 * LIMIT):
            sys.exit(f"expected the tests to pass as it is, they fail: {' '.join(whole)}")
        for number, mutant in list(enumerate(mutants, 1))[asked.done :]:
            alive = survives(mutant, sources)
            survivors += [mutant] if alive else []
            print(f"{number:3}  {'survives' if alive else 'killed':8}  {mutant.file}, {mutant.change}", flush=True)
    total = len(mutants) - asked.done
    share = 1 - len(survivors) / max(total, 1)
    low, high = binomtest(total - len(survivors), total).proportion_ci(0.95, "wilson")
    print(
        f"seed {asked.seed}: {total} mutants, {100 * share:.0f} % killed (95 %: {100 * low:.0f} to {100 * high:.0f} %)"
    )
    print(*(f"  survives: {m.file}, {m.change}" for m in survivors), sep="\n")
    sys.exit(share < WANTED)


if __name__ == "__main__":
    main()
