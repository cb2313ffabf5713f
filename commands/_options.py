"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_SET_HELP = (
    "Override `KEY=VALUE` in the scenario, SI units; dotted keys reach inside. Examples: `duration=20` [s], "
    "`controller.kp=6` [A/rad], `filters.2.k=0.1` [1/(N·m)²], `plant.K1=9000` [N·m/rad], "
    "`sensors.joint_torque.noise=0.05` [N·m], `trajectory.1.position=1.0` [rad], `disturbances.0.torque=4` [N·m], "
    "`filters.3=dynamics_ekf`, `temperature=40` [°C], `feedback=none`. Repeatable."
)

Scenarios = Annotated[list[str], typer.Argument(help="Names of shipped scenarios, or paths of YAML files.")]
Out = Annotated[Path, typer.Option("--out", help="Folder to write to; one folder per scenario inside.")]
Seed = Annotated[
    int | None, typer.Option("--seed", min=0, help="Seed of every random stream, instead of the scenario's.")
]
Estimators = Annotated[
    list[str] | None, typer.Option("--filter", help="An estimator by its name; repeatable. All by default.")
]
Changes = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help=_SET_HELP)]
