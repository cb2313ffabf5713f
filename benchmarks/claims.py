"""What the paper claims, measured: `python -m benchmarks.claims` prints the tables of docs/paper.md."""

from __future__ import annotations

import argparse

import numpy as np

from flexspline.scenarios.filters import FilterEntry, paper_entries
from flexspline.scenarios.run import Run, run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim.loop import CONTROL_PERIOD

FILTERS = [
    *paper_entries(),
    FilterEntry.model_validate({"name": "printed", "rule": "rarekf", "alpha": "printed"}),
]
LOADS = ((0, 3), (3, 6), (6, 20))
MISTAKEN = {"exact": {}, "flexspline 10 % softer than known": {"K1": 7560, "K2": 8460, "K3": 11700}}


def _run(name: str, seed: int, plant: dict[str, float] | None = None) -> Run:
    scenario, folder = load_scenario(name, seed=seed)
    update = {"filters": FILTERS}
    if plant:
        # What the estimators know stays nominal.
        update |= {"plant": plant, "known_joint": scenario.joint}
    return run_scenario(scenario.model_copy(update=update), folder)


def _row(*cells: str) -> None:
    print(f"| {' | '.join(cells)} |")


def _head(*cells: str) -> None:
    _row(*cells)
    print("|" + "---|" * len(cells))


def _spread(values: list[float], scale: float = 1.0, digits: int = 3) -> str:
    a = np.array(values) * scale
    return f"{a.mean():.{digits}f} ± {a.std(ddof=1):.{digits}f}" if len(a) > 1 else f"{a[0]:.{digits}f}"


def no_load(seeds: range) -> None:
    """Claim 1: without load the difference to the sensor is below 0.1 N·m after a transient, in optimal mode."""
    runs = [_run("no_load", seed) for seed in seeds]
    print("\n## No load: error after 1 s\n")
    _head("filter", "RMS [N·m]", "largest [N·m]", "below 0.1 N·m [% of time]", "to sensor, below 0.1", "robust [%]")
    for f in (f.name for f in FILTERS):
        rows = []
        for run in runs:
            kept = run.time >= run.scenario.transient
            e = (run.estimate(f) - run.truth("joint_torque"))[kept]
            s = (run.estimate(f) - run.reading("joint_torque"))[kept]
            rows.append((np.sqrt(np.mean(e**2)), np.abs(e).max(), np.mean(np.abs(e) < 0.1), np.mean(np.abs(s) < 0.1),
                         np.mean(run.estimates[f].robust[kept])))  # fmt: skip
        c = list(zip(*rows, strict=True))
        _row(f, _spread(c[0]), _spread(c[1]), _spread(c[2], 100, 2), _spread(c[3], 100, 2), _spread(c[4], 100, 1))


def load(seeds: range) -> None:
    """Claim 2: optimal at low load, more robust as the load grows."""
    for label, plant in MISTAKEN.items():
        runs = [_run("link_sweep", seed, plant) for seed in seeds]
        print(f"\n## Link sweep, {label}: share of robust mode [%] by load, and RMS error\n")
        heads = " | ".join(f"{a}–{b} N·m" for a, b in LOADS)
        print(f"| filter | {heads} | RMS [N·m] |\n|---|{'---|' * (len(LOADS) + 1)}")
        for f in (f.name for f in FILTERS):
            cells = []
            for low, high in LOADS:
                shares = []
                for run in runs:
                    size = np.abs(run.truth("joint_torque"))
                    where = (run.time >= run.scenario.transient) & (size >= low) & (size < high)
                    shares.append(np.mean(run.estimates[f].robust[where]))
                cells.append(_spread(shares, 100, 1))
            rms = [run.metrics["filters"][f]["rms"] for run in runs]
            print(f"| {f} | {' | '.join(cells)} | {_spread(rms)} |")


def push(seeds: range) -> None:
    """Claim 3: fast response to pushes, with less noise than a filter that is always robust."""
    for label, plant in MISTAKEN.items():
        runs = [_run("external_push", seed, plant) for seed in seeds]
        print(f"\n## External push, {label}\n")
        _head(
            "filter", "RMS [N·m]", "largest [N·m]", "90 % response after the truth's [ms]", "delay [ms]",
            "noise / raw model", "robust [%]",
        )  # fmt: skip
        for f in ("model", *(f.name for f in FILTERS)):
            rows = []
            for run in runs:
                m = run.metrics["model"] if f == "model" else run.metrics["filters"][f]
                late = np.nan if m["response_ms"] is None else m["response_ms"]
                rows.append((m["rms"], m["max"], late, m["delay_ms"], m["noise_ratio"], m.get("robust_share", np.nan)))
            c = list(zip(*rows, strict=True))
            _row(
                f, _spread(c[0]), _spread(c[1], 1, 2), _spread(c[2], 1, 1), _spread(c[3], 1, 2), _spread(c[4], 1, 2),
                _spread(c[5], 100, 1),
            )  # fmt: skip


def equal_noise(seeds: range) -> None:
    """Claim 3 at equal noise: an EKF with W raised until its noise is RAREKF's; what the push then costs each."""
    print("\n## External push: EKF with W raised, beside RAREKF\n")
    _head("filter", "noise / raw model", "RMS [N·m]", "largest [N·m]")
    choices = [FilterEntry.model_validate("RAREKF")]
    choices += [
        FilterEntry.model_validate({"name": f"EKF-{i}", "rule": "ekf", "W": w})
        for i, w in enumerate((1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3, 3.2e-3))
    ]
    collected: dict[str, list] = {c.name: [] for c in choices}
    for seed in seeds:
        scenario, folder = load_scenario("external_push", seed=seed)
        run = run_scenario(scenario.model_copy(update={"filters": choices}), folder)
        for c in choices:
            m = run.metrics["filters"][c.name]
            collected[c.name].append((m["noise_ratio"], m["rms"], m["max"]))
    for c in choices:
        a = list(zip(*collected[c.name], strict=True))
        label = f"EKF, W = {c.parameters['W']:g}" if "W" in c.parameters else c.name
        print(f"| {label} | {_spread(a[0], 1, 2)} | {_spread(a[1])} | {_spread(a[2], 1, 2)} |")


def feedback(seeds: range) -> None:
    """What joint torque feedback buys: position error with the RAREKF's estimate fed back, and without."""
    print(
        "\n## Joint torque feedback: position error after 1 s\n\n| feedback | RMS [mrad] | largest [mrad] |\n|---|---|---|"
    )
    for choice in ("none", "EKF", "AREKF", "RAREKF", "sensor"):
        errors = []
        for seed in seeds:
            scenario, folder = load_scenario("torque_feedback", [f"feedback={choice}"], seed)
            errors.append(run_scenario(scenario, folder).metrics["position_error"])
        print(
            f"| {choice} | {_spread([e['rms'] for e in errors], 1e3, 3)} | {_spread([e['max'] for e in errors], 1e3, 3)} |"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = range(1, parser.parse_args().seeds + 1)
    print(f"mean ± standard deviation over {len(seeds)} seeds; control period {CONTROL_PERIOD:g} s")
    no_load(seeds)
    load(seeds)
    push(seeds)
    equal_noise(seeds)
    feedback(seeds)
