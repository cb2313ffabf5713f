"""Mutation testing: one operator or number of the estimators and of diagnosis' statistics is changed, and a fast test must fail.

`python -m benchmarks.mutants --count 40 --seed 1` draws mutants, evenly over the files; `--file` names files. Every mutant runs
in a copy of the sources. Exit code 1 where fewer than 85 % were killed; survivors are listed (docs/reliability.md).
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 400
"""Seconds of a processor after which a mutant counts as killed: it hangs, however busy the machine is."""
WANTED = 0.85
_E, _D = "tests/estimator/test_", "tests/diagnosis/test_"
TESTS = {
    "estimator/consistency.py": [f"{_E}consistency.py"],
    "estimator/recursion.py": [f"{_E}recursion.py", f"{_E}invariance.py", f"{_E}printed.py"],
    "estimator/motion.py": [f"{_E}motion.py", f"{_E}torque_filters.py", f"{_E}invariance.py"],
    "estimator/compliance.py": [f"{_E}compliance.py", f"{_E}paper_filter.py", f"{_E}printed.py"],
    "estimator/arrays.py": [f"{_E}recursion.py", f"{_E}paper_filter.py"],
    "estimator/bound.py": [f"{_E}bound.py"],
    "estimator/filters/kalman.py": [f"{_E}torque_filters.py", f"{_E}invariance.py"],
    "estimator/filters/h_infinity.py": [f"{_E}torque_filters.py", f"{_E}invariance.py"],
    "estimator/filters/momentum.py": [f"{_E}torque_filters.py"],
    "estimator/quantised.py": [f"{_E}dynamics_filters.py"],
    "diagnosis/uncertainty.py": [f"{_D}uncertainty.py"],
    "diagnosis/balance.py": [f"{_D}balance.py"],
}
"""Files, and the fast tests that are to notice what is changed in them."""
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


def drawn(file: str, count: int, rng: random.Random) -> list[Mutant]:
    """Mutants of a file, drawn without repetition: what is only said (messages, types, defaults) is left."""
    text = (ROOT / file).read_text(encoding="utf-8")
    tree = ast.parse(text)
    silent = _silent(tree)
    places = [k for k, node in enumerate(ast.walk(tree)) if k not in silent and any(_changes(node))]
    found = []
    for place in sorted(rng.sample(places, min(count, len(places)))):
        other = ast.parse(text)
        target = next(node for k, node in enumerate(ast.walk(other)) if k == place)
        before = ast.unparse(target)
        next(_changes(target))(target)
        change = f"line {getattr(target, 'lineno', '?')}: {before} → {ast.unparse(target)}"
        found.append(Mutant(file, change, ast.unparse(other)))
    return found


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
    """Places of nodes that only say something: messages, types, decorators, numbers outside functions, lengths of views."""
    inside: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.Lambda)):
            inside |= {id(n) for part in _bodies(node) for n in ast.walk(part)}
    quiet: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Raise, ast.JoinedStr, ast.Assert)):
            quiet |= {id(n) for n in ast.walk(node)}
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "carray":  # a record, or room for more
            quiet |= {id(n) for n in node.args}
        if isinstance(node, ast.AnnAssign):
            quiet |= {id(n) for n in ast.walk(node.annotation)}
    return {k for k, n in enumerate(ast.walk(tree)) if id(n) not in inside or id(n) in quiet}


def _bodies(node: ast.FunctionDef | ast.Lambda) -> list[ast.AST]:
    return [node.body] if isinstance(node, ast.Lambda) else list(node.body)


def survives(mutant: Mutant, sources: Path) -> bool:
    """Whether all fast tests of its file pass in a copy of the sources."""
    path = sources / mutant.file
    before = path.read_bytes()
    path.write_text(mutant.text, encoding="utf-8")
    try:
        return _passes(mutant.file, sources)
    finally:
        path.write_bytes(before)


def _passes(file: str, sources: Path) -> bool:
    environment = os.environ | {
        "PYTHONPATH": str(sources), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1",
        "FLEXSPLINE_SHARED": os.environ.get("FLEXSPLINE_SHARED", str(ROOT.parent / "shared")),
    }  # fmt: skip
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", *TESTS[file]]
    limited = partial(resource.setrlimit, resource.RLIMIT_CPU, (LIMIT, LIMIT))
    return subprocess.run(words, cwd=sources, env=environment, capture_output=True, preexec_fn=limited).returncode == 0


def main() -> None:
    """Draw mutants, print what became of each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--file", action="append", choices=list(TESTS), help="Repeatable; all by default.")
    asked = parser.parse_args()
    rng, files = random.Random(asked.seed), asked.file or list(TESTS)
    survivors: list[Mutant] = []
    with tempfile.TemporaryDirectory(prefix="mutants") as name:
        sources = Path(name) / "sources"
        shutil.copytree(ROOT, sources, symlinks=True, ignore=shutil.ignore_patterns(".git", ".venv*", "docs", "runs"))
        total = 0
        for file in files:
            chosen = drawn(file, min(-(-asked.count // len(files)), asked.count - total), rng)
            if not _passes(file, sources):
                sys.exit(f"{file}: expected its tests to pass as it is, they fail")
            killed = 0
            for mutant in chosen:
                alive = survives(mutant, sources)
                killed += not alive
                survivors += [mutant] if alive else []
                print(f"{'survives' if alive else 'killed':8}  {file}, {mutant.change}", file=sys.stderr, flush=True)
            total += len(chosen)
            print(f"{file:34} {killed:3} of {len(chosen):3} killed", flush=True)
    share = 1 - len(survivors) / max(total, 1)
    print(f"seed {asked.seed}: {total} mutants, {100 * share:.0f} % killed")
    print(*(f"  survives: {m.file}, {m.change}" for m in survivors), sep="\n")
    sys.exit(share < WANTED)


if __name__ == "__main__":
    main()
