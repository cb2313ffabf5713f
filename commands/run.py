"""`flexspline run`: scenarios into run folders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ._console import console
from ._options import AsJson, Changes, Out, Scenarios, Seed, option, with_plugins

EXAMPLES = (
    "flexspline run external_push",
    "flexspline run link_sweep --set joint=my_joint.yaml --set controller.kp=6 --seed 3 --out runs",
    "flexspline run external_push --set disturbances.0.torque=4 --set sensors.joint_torque.noise=0.05 --set feedback=none",
    "flexspline run my_scenario.yaml --no-figures --json",
    "flexspline run two_joints --set arm.1.joint=my_joint.yaml",
)


@with_plugins
def command(
    scenarios: Scenarios,
    out: Out = Path("runs"),
    seed: Seed = None,
    changes: Changes = None,
    figures: Annotated[bool, option("Draw the figures.")] = True,
    recording: Annotated[bool, option("Write the Rerun recording.")] = True,
    as_json: AsJson = False,
) -> Any:
    """Run scenarios; write signals, estimates, metrics, figures and a Rerun recording, for an arm of every joint."""
    from ._runs import metrics_of, print_notes, run_all

    runs = run_all(scenarios, out, seed, changes, figures, recording)
    if as_json:
        return metrics_of(runs)
    from ..views.tables import comparison_table

    terminal = console()
    terminal.print(comparison_table({run.name: run.metrics for run, _ in runs}))
    print_notes(terminal, runs)
    for _, folder in runs:
        terminal.print(f"{folder}")
