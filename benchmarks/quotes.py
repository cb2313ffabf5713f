"""What pages quote from the estimators' tables: `python -m benchmarks quotes` writes it from the CSVs beside docs/estimators.md,
as every run of `benchmarks.estimators` does, so that none of these numbers is written by hand."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from flexspline.scenarios.evaluation.intervals import Interval
from flexspline.views.tables import markdown_table

from .pages import ROOT, fill, text

OVERALL = "all three"
"""In a CSV, the geometric mean over the three experiments."""
REFERENCE = "RAREKF"
WORTH = ("augmented", "momentum_torsion", "current")
"""The estimators of README's table."""

Line = Mapping[str, str]
Lines = Mapping[tuple[str, float, str], Line]


def read_csv(path: Path) -> Lines:
    """The lines of `estimators.write_csv`, by scenario, tolerance and estimator."""
    with path.open(newline="", encoding="utf-8") as file:
        return {(r["scenario"], float(r["tolerance"]), r["estimator"]): r for r in csv.DictReader(file)}


def write(page: Path, readme: Path) -> None:
    """Put everything quoted between its markers."""
    docs = page.parent
    ideal, real = (read_csv(docs / f"{name}.csv") for name in ("estimators", "estimators_realistic"))
    with (docs / "estimators_cost.csv").open(newline="", encoding="utf-8") as file:
        cost = {r["estimator"]: float(r["us"]) for r in csv.DictReader(file)}
    fill(page, {"situations": _situations(ideal, real, cost), "realistic nees": _realistic_nees(real)})
    fill(readme, {"worth": _worth(ideal, real, cost)})


def _cell(line: Line, measure: str, digits: int) -> str:
    mean, low, high = (float(line[f"{measure}{end}"]) for end in ("", "_low", "_high"))
    return text(Interval(mean, low, high, int(line["draws"])), digits)


def _worth(ideal: Lines, real: Lines, cost: Mapping[str, float]) -> str:
    """README's: shares of RAREKF's error over the three experiments, sensors ideal and `sensors: realistic`, and cost."""
    tolerances = (1.0, 0.2, 0.0)
    rows = []
    for name in WORTH:
        shares = [_cell(some[OVERALL, t, name], "ratio", 2) for some in (ideal, real) for t in tolerances]
        rows.append((f"`{name}`", *shares, f"{cost[name]:.1f}"))
    errors = [_cell(some["link_sweep", t, REFERENCE], "rms", 3) for some in (ideal, real) for t in tolerances]
    rows.append((f"{REFERENCE} in the link sweep [N·m]", *errors, f"{cost[REFERENCE]:.1f}"))
    heads = ("tolerance ×1", "×0.2", "exact", "sensors as they are: ×1", "×0.2", "exact")
    return markdown_table(("estimator", *heads, "µs per update"), rows)


def _situations(ideal: Lines, real: Lines, cost: Mapping[str, float]) -> str:
    """Which estimator to take, and why."""

    def share(tolerance: float, name: str = "augmented", lines: Lines = ideal) -> str:
        return f"{float(lines[OVERALL, tolerance, name]['ratio']):.2f}"

    own = cost["augmented"]
    rows = [
        (
            "a joint with a data sheet, or a diagnosed one; its weight known within per cents",
            "`augmented`",
            f"{share(1.0)} of RAREKF's error at ×1, {share(0.2)} at ×0.2 (with [sensors as they are](#sensors-as-they-are) "
            f"{share(1.0, lines=real)} and {share(0.2, lines=real)}), and it says how wrong it may be; {own:.1f} µs, samples "
            "every millisecond or two",
        ),
        (
            "a joint known exactly (a simulation)",
            "`augmented`",
            f"{share(0.0)} of RAREKF's error; `dynamics_ekf`, which simulates the joint by finite differences, has "
            f"{share(0.0, 'dynamics_ekf')} ({share(0.0, 'dynamics_ekf', real)} with sensors as they are), drifts within a count "
            f"at rest, and costs {cost['dynamics_ekf'] / own:.0f} times as much",
        ),
        (
            "what hangs on the joint is not known, and nobody can say how badly",
            "`momentum_torsion`",
            "asks nothing about the link; `augmented` needs an honest tolerance of the weight",
        ),
        (
            "something that no tolerance covers: a kinematic error, backlash, a late encoder, another weight",
            "diagnose first; until then `current` where torsion is wrong (the first three), `momentum_torsion` where the weight "
            "or an encoder's eccentricity is",
            "each misleads `augmented` and most others, [cause by cause](studies.md#what-the-estimators-do-not-know)",
        ),
        ("no second encoder", "`current`", "nothing else works"),
        (
            "nothing but the paper's filter, tolerances as they come",
            "any of its rules",
            f"stiffness and kinematic error decide, not the gain rule: EKF {share(1.0, 'EKF')}, AREKF {share(1.0, 'AREKF')}, "
            f"REKF {share(1.0, 'REKF')} of RAREKF's error at ×1; AREKF where the joint is known better, "
            f"{share(0.05, 'AREKF')} at ×0.05 ([which reading of Eq. (23)](paper.md#which-reading-serves-best))",
        ),
    ]
    return markdown_table(("situation", "take", "why"), rows, left=3)


def _realistic_nees(real: Lines) -> str:
    """Between which values the mean NEES of those that state a variance lies with sensors as they are."""
    told = []
    for name in ("augmented", "dynamics_ekf"):
        found: dict[float, list[float]] = {}
        for (scenario, tolerance, n), line in real.items():
            if n == name and scenario != OVERALL:
                found.setdefault(tolerance, []).append(float(line["nees"]))
        each = (
            f"{min(values):.1f} to {max(values):.1f} at ×{t:g}" for t, values in sorted(found.items(), reverse=True)
        )
        told.append(f"`{name}` {', '.join(each)}")
    return f"Mean NEES over the three experiments: {'; '.join(told)}."


def main() -> None:
    """Write README and page."""
    write(ROOT / "docs" / "estimators.md", ROOT / "README.md")


if __name__ == "__main__":
    main()
