"""What each estimator is worth: `python -m benchmarks.estimators` writes the tables and figures of docs/estimators.md.

Tuning on seeds 1 … TRAIN, everything reported on seeds 101 … 100 + SEEDS. The tables go between the markers
`<!-- begin NAME -->` and `<!-- end NAME -->` of the page.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexspline.estimator import registry
from flexspline.estimator.estimator import Estimator
from flexspline.estimator.tuning_parameters import with_values
from flexspline.models.files import write_into_place
from flexspline.scenarios.evaluation import limits, tuning
from flexspline.scenarios.evaluation.intervals import interval
from flexspline.scenarios.evaluation.limits import Limits
from flexspline.scenarios.evaluation.tuning import Tuned
from flexspline.scenarios.filters import PAPER, estimators
from flexspline.scenarios.run import Run
from flexspline.scenarios.scenario import load_scenario
from flexspline.views.limit_figures import limits_figure, pareto_figure, save_figure
from flexspline.views.limit_tables import markdown, number

from .timing import measure

SCENARIOS = ("no_load", "link_sweep", "external_push")
MISTAKES = {
    "flexspline 10 % softer": ["plant.K1=7560", "plant.K2=8460", "plant.K3=11700"],
    "friction 50 % higher": ["plant.Fc=0.027", "plant.Fs=0.033"],
    "torque constant 5 % lower": ["plant.Kt=0.0573"],
}
"""What the plant has and the estimators do not know, in the link sweep."""
READINGS = {
    "RAREKF": {}, "AREKF (α = 1)": {"rule": "arekf"}, "α as printed, Eq. (23)": {"alpha": "printed"},
    "1/α as printed": {"alpha": "inverse"},
    "memory as printed, Eq. (20)": {"memory": "printed"}, "adjusted covariance, Eqs. (14), (19)": {"covariance": "adjusted"},
}  # fmt: skip
"""How the paper's equations may be read."""
FEW = 5
"""Test seeds for what hardly differs between seeds: noise against delay, model error."""
ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Results:
    """Of one scenario: errors of every estimator on the test seeds, tuned ones, bounds."""

    limits: Limits
    tuned: dict[str, Tuned]

    def default(self, name: str) -> np.ndarray:
        """RMS errors of the default settings, shape (seeds,) [N·m]."""
        return next(e.rms for e in self.limits.estimators if e.name == name)

    def best(self, name: str) -> np.ndarray:
        """RMS errors of the tuned settings, or of the defaults where a filter was not tuned."""
        return self.tuned[name].test_tuned[0] if name in self.tuned else self.default(name)


def ratio(values: np.ndarray, others: np.ndarray) -> str:
    """Mean ratio with its 95 % interval, paired over seeds."""
    if not (np.isfinite(values).all() and np.all(values < 1e5)):
        return "diverged"
    i = interval(values / others)
    return f"{i.mean:.2f} [{i.low:.2f}, {i.high:.2f}]" if np.isfinite(i.low) else f"{i.mean:.2f}"


def rms(values: np.ndarray) -> str:
    """Mean RMS with its 95 % half-width [N·m]."""
    i = interval(values)
    half = f" ± {i.high - i.mean:.4f}" if np.isfinite(i.high) else ""
    return number(i.mean, 4) + (half if i.mean < 1e5 else "")


def error_table(results: Results) -> str:
    """RMS error by default and tuned, against RAREKF and against the bound; the smallest tuned error first."""
    rows = []
    by_error = sorted(results.limits.estimators, key=lambda e: float(np.nan_to_num(results.best(e.name), nan=9).mean()))
    for e in by_error:
        default, best = results.default(e.name), results.best(e.name)
        rows.append(
            (
                e.name if e.causal else f"{e.name} (not causal)", rms(default),
                rms(best) if e.name in results.tuned and results.tuned[e.name].values else "–",
                ratio(default, results.default("RAREKF")), ratio(best, results.best("RAREKF")),
                number(results.limits.ratio(e.name), 2),
            )
        )  # fmt: skip
    heads = (
        "estimator", "RMS, default [N·m]", "tuned", "/ RAREKF, default", "/ RAREKF, both tuned", "default / bound",
    )  # fmt: skip
    return markdown(heads, rows)


def claim_table(every: dict[str, Results], together: Sequence[Tuned]) -> str:
    """The best causal baseline of each scenario against RAREKF."""
    rows = []
    common = next(one for one in together if one.name == "RAREKF").test_tuned
    for name, results in every.items():
        causal = [e.name for e in results.limits.estimators if e.causal and e.name not in PAPER]
        default = min(causal, key=lambda n: results.default(n).mean())
        best = min(causal, key=lambda n: results.best(n).mean())
        simple = [name for name in causal if not registry.get(name).costly]
        without = min(simple, key=lambda n: results.best(n).mean())
        rows.append(
            (
                name, f"{default}: {ratio(results.default(default), results.default('RAREKF'))}",
                f"{default}: {ratio(results.default(default), common[len(rows)])}",
                f"{default}: {ratio(results.default(default), results.best('RAREKF'))}",
                f"{best}: {ratio(results.best(best), results.best('RAREKF'))}",
                f"{without}: {ratio(results.best(without), results.best('RAREKF'))}",
            )
        )  # fmt: skip
    heads = (
        "scenario", "best default / RAREKF", "/ RAREKF tuned for all three", "/ RAREKF tuned for this one",
        "best tuned / RAREKF tuned for this one", "likewise, without the joint's dynamics",
    )  # fmt: skip
    return markdown(heads, rows)


def consistency_table(every: dict[str, Results]) -> str:
    """NIS with its verdict, NEES and how often it is inside, whiteness; default settings."""
    rows = []
    names = [e.name for e in next(iter(every.values())).limits.estimators if e.nees is not None]
    for name in names:
        row = [name]
        for results in every.values():
            e = next(e for e in results.limits.estimators if e.name == name)
            row.append("–" if e.nis is None else f"{e.nis.value:.2f}")
            row.append(f"{e.nees.value:.2f}")
            row.append(f"{100 * e.nees_share:.0f}")
            row.append("–" if e.outside is None else f"{100 * e.outside:.0f}")
        rows.append(row)
    heads = ["estimator"]
    for name in every:
        heads += [f"{name}: NIS", "NEES", "inside [%]", "ρ outside [%]"]
    first = next(iter(every.values())).limits
    low, high = first.estimators[0].nees.low, first.estimators[0].nees.high
    widest = max(e.nis.high - 1 for r in every.values() for e in r.limits.estimators if e.nis is not None)
    note = (
        f"\n\n95 % intervals: NIS within 1 ± {widest:.3f} or less (all samples); NEES {low:.2f} to {high:.2f} (one error of "
        f"each of {len(first.seeds)} runs); *inside* and *ρ outside* should be 95 and 5."
    )
    return markdown(heads, rows) + note


def parameters_table(every: dict[str, Results]) -> str:
    """What tuning chose for each filter in each scenario, and how much it took off the error."""
    rows = []
    for name in next(iter(every.values())).tuned:
        row = [name]
        for results in every.values():
            one = results.tuned[name]
            values = ", ".join(
                f"{k.split('.')[-1]} {v:.2g}" + ("!" if k in one.at_bound else "") for k, v in one.values.items()
            )
            change = 100 * (one.test_tuned.mean() / one.test_default.mean() - 1)
            row.append(f"{values} ({change:+.0f} %)" if values else "–")
        if any(cell != "–" for cell in row[1:]):
            rows.append(row)
    return markdown(["filter", *every], rows)


def together_table(found: Sequence[Tuned]) -> str:
    """One setting for all scenarios, on the test seeds."""
    rows = []
    reference = next(one for one in found if one.name == "RAREKF").test_tuned
    for one in sorted(found, key=lambda one: tuning.score(one.test_tuned)):
        values = ", ".join(f"{k.split('.')[-1]} {v:.2g}" for k, v in one.values.items()) or "–"
        cells = [rms(row) for row in one.test_tuned]
        means = np.sqrt(
            np.prod([a.mean() / b.mean() for a, b in zip(one.test_tuned, reference, strict=True)]) ** (2 / 3)
        )
        rows.append((one.name, *cells, f"{means:.2f}", values))
    return markdown(
        ("filter", *(f"{s} [N·m]" for s in SCENARIOS), "/ RAREKF, geometric mean", "tuning parameters"), rows
    )


def cost_table(chosen: Mapping[str, Estimator], run: Run) -> str:
    """Time of one update, core time, median of five."""
    rows = []
    for name, one in chosen.items():
        timing = measure(lambda one=one: one.estimate(run.signals, run.known))
        rows.append((name, f"{1e6 * timing.core / len(run.time):.2f}"))
    rows.sort(key=lambda row: float(row[1]))
    return markdown(("estimator", "µs per update"), rows)


def mistake_table(chosen: Mapping[str, Estimator], seeds: Sequence[int], threads: int) -> str:
    """RMS error in the link sweep where the plant is not what the estimators know."""
    columns = []
    for changes in MISTAKES.values():
        scenario, folder = load_scenario("link_sweep", [*changes, "known_joint=test-joint"])
        runs = tuning.simulated([(scenario, folder)], seeds)
        columns.append({name: tuning.errors(one, runs, threads)[0] for name, one in chosen.items()})
    order = sorted(chosen, key=lambda name: columns[0][name].mean())
    rows = [(name, *(f"{column[name].mean():.3f}" for column in columns)) for name in order]
    return markdown(("estimator", *(f"{name} [N·m]" for name in MISTAKES)), rows)


def readings_table(every: dict[str, list[Run]]) -> str:
    """RMS error of the paper's filter by the reading of its equations."""
    rows = []
    for label, changes in READINGS.items():
        reading = with_values(registry.get("RAREKF"), changes)
        cells = [rms(tuning.errors(reading, [runs])[0]) for runs in every.values()]
        rows.append((label, *cells))
    return markdown(("reading", *(f"{name} [N·m]" for name in every)), rows)


def walk_table(chosen: Mapping[str, Estimator], seeds: Sequence[int]) -> tuple[str, Limits]:
    """Error in units of the bound on draws of the bound's own external torque: nothing causal may be below 1."""
    scenario, folder = load_scenario("external_push", ["duration=12"])
    found = limits.assess(limits.matched(scenario, 1.0), folder, seeds, chosen, 1.0)
    rows = [
        (e.name if e.causal else f"{e.name} (not causal)", rms(e.rms), number(found.ratio(e.name), 2))
        for e in sorted(found.estimators, key=lambda e: e.mean_rms)
    ]
    head = (
        f"12 s of the link sweep, external torque a random walk of 1 N·m/√s, {len(seeds)} draws. Bound "
        f"{found.bound_rms:.4f} N·m; of the paper's model {found.torsion_bound_rms:.4f} N·m.\n\n"
    )
    return head + markdown(("estimator", "RMS [N·m]", "/ bound"), rows), found


def fill(page: Path, tables: dict[str, str]) -> None:
    """Put each table between its markers."""
    text = page.read_text(encoding="utf-8")
    for name, table in tables.items():
        begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
        if begin not in text or end not in text:
            raise SystemExit(f"{page}: expected the markers {begin} and {end}")
        pattern = re.escape(begin) + ".*?" + re.escape(end)
        text = re.sub(pattern, lambda _, t=f"{begin}\n{table}\n{end}": t, text, flags=re.DOTALL)
    with write_into_place(page) as temporary:
        temporary.write_text(text, encoding="utf-8")


def main() -> None:
    """Run everything and write the page's tables and figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="test seeds, from 101 on")
    parser.add_argument("--train", type=int, default=5, help="training seeds, from 1 on")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument(
        "--quick", action="store_true", help="leave the filters that simulate the joint at their defaults"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "figures", help="folder of the figures")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "estimators.md")
    asked = parser.parse_args()
    seeds = range(101, 101 + asked.seeds)
    few = seeds[:FEW]
    chosen = estimators()
    began = time.perf_counter()

    def say(what: str) -> None:
        print(f"{time.perf_counter() - began:7.0f} s  {what}", flush=True)

    every, runs, fronts = {}, {}, []
    train_runs: dict[str, list[Run]] = {}
    to_tune = {name: one for name, one in chosen.items() if not (asked.quick and one.costly)}
    for name in SCENARIOS:
        scenario, folder = load_scenario(name)
        train_runs[name] = tuning.simulated([(scenario, folder)], range(1, 1 + asked.train))[0]
        runs[name] = tuning.simulated([(scenario, folder)], seeds)[0]
        say(f"{name}: bounds and consistency")
        found = limits.assess(scenario, folder, seeds, chosen)
        save_figure(limits_figure(found), asked.out / f"estimators_{name}.png")
        tuned = {}
        for estimator, one in to_tune.items():
            say(f"{name}: tuning {estimator}")
            tuned[estimator] = tuning.tune(one, [train_runs[name]], [runs[name]], threads=asked.threads)
        every[name] = Results(found, tuned)
    for name, one in chosen.items():
        say(f"noise against delay: {name}")
        best = every["external_push"].tuned.get(name)
        pushed = runs["external_push"][:FEW]
        fronts.append(tuning.pareto(one, pushed, best.tuned if best else None, threads=asked.threads))
    save_figure(pareto_figure(fronts, "external_push", len(few)), asked.out / "estimators_pareto.png")
    together = []
    for name, one in to_tune.items():
        say(f"one setting for all: {name}")
        together.append(tuning.tune(one, list(train_runs.values()), list(runs.values()), threads=asked.threads))
    if asked.quick:
        together += [_untuned(one, list(runs.values()), asked.threads) for one in chosen.values() if one.costly]
    say("model error, readings, the bound's own model, cost")
    walk, _ = walk_table(chosen, seeds)
    tables = {
        "about": about(asked, len(seeds)),
        "claim": claim_table(every, together),
        **{f"errors {name}": error_table(results) for name, results in every.items()},
        "consistency": consistency_table(every),
        "parameters": parameters_table(every),
        "together": together_table(together),
        "mistakes": mistake_table(chosen, few, asked.threads),
        "readings": readings_table(runs),
        "walk": walk,
        "bounds": bounds_table(every),
        "cost": cost_table(chosen, runs["link_sweep"][0]),
    }
    fill(asked.page, tables)
    say(f"{asked.page}")


def _untuned(estimator: Estimator, runs: Sequence[Sequence[Run]], threads: int) -> Tuned:
    found = tuning.errors(estimator, runs, threads)
    return Tuned(estimator.name, estimator, estimator, {}, (np.nan, np.nan), 0, found, found, ())


def bounds_table(every: dict[str, Results]) -> str:
    """The bounds of each scenario."""
    rows = [
        (
            name, f"{r.limits.fitted:.3g}", f"{r.limits.intensity:.3g}", f"{r.limits.bound_rms:.4f}",
            f"{r.limits.torsion_intensity:.3g}", f"{r.limits.torsion_bound_rms:.4f}",
        )
        for name, r in every.items()
    ]  # fmt: skip
    heads = (
        "scenario", "fitted intensity [N·m/√s]", "stated", "bound [N·m]", "joint torque's intensity",
        "bound, paper's model [N·m]",
    )  # fmt: skip
    return markdown(heads, rows)


def about(asked: argparse.Namespace, seeds: int) -> str:
    """How the page's numbers were made."""
    quick = " --quick" if asked.quick else ""
    command = f"python -m benchmarks.estimators --seeds {seeds} --train {asked.train}{quick}"
    left = ""
    if asked.quick:
        left = " The filters that simulate the joint (`dynamics_*`, `rts_smoother`) were left at their defaults."
    return (
        f"Everything below is printed by `{command}`: {seeds} test seeds (101 to {100 + seeds}), tuning on seeds 1 to "
        f"{asked.train}.{left} Intervals are 95 %, Student's t over seeds; ratios are paired over seeds. Noise against delay and "
        f"model error: {min(seeds, FEW)} seeds."
    )


if __name__ == "__main__":
    main()
