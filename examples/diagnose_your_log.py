"""Diagnose your log: from a CSV file with its own names and units to what the description of the joint gets wrong.

Without an argument a log is made first: a joint whose friction is 35 % higher forward than backward.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import flexspline as fs
from flexspline.models.joint_parts import Effect, Estimate

LOG = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("log.csv")
joint = fs.load_joint("test-joint")

if not LOG.exists():
    effect = Effect(name="friction_asymmetry", parameters={"ratio": Estimate(value=0.35)})
    worn = joint.model_copy(update={"effects": [effect]})
    sweep = [(0.5, 0.0), (3.5, 1.2), (9.0, -1.2), (13.0, 1.0), (16.0, 0.0)]  # s, rad
    run = fs.simulate(
        "link_sweep", joint=worn, duration=17, trajectory=[{"time": t, "position": x} for t, x in sweep],
        controller={"kp": 8.0, "kd": 0.08, "ki": 20.0},
    )  # fmt: skip
    made = {"t_ms": 1e3 * run.time, "motor_deg": np.degrees(run.reading("motor_position"))}
    made |= {"link_deg": np.degrees(run.reading("link_position")), "i_A": run.reading("motor_current")}
    pd.DataFrame(made).to_csv(LOG, index=False)

log = pd.read_csv(LOG)
recording = fs.Recording(
    "log",
    time=1e-3 * log["t_ms"].to_numpy(),
    columns={
        "motor_position": np.radians(log["motor_deg"].to_numpy()),  # rad, motor side
        "link_position": np.radians(log["link_deg"].to_numpy()),  # rad, output side
        "motor_current": log["i_A"].to_numpy(),
    },
    link=joint.mount("link"),  # what was bolted to the output: inertia and gravity moment
)
found = fs.diagnose(recording, joint)
print(found.verdict)
for mistake in found.mistakes:
    print(f"mistake in the data: {mistake.column} {mistake.description}")
for cause in found.causes:
    values = ", ".join(f"{name} {p.value:.3g} ± {p.std:.1g} {p.unit}" for name, p in cause.parameters.items())
    print(f"{cause.name}: {100 * cause.confidence:.0f} % sure, {values}, contributes {cause.contribution:.2f} N·m")
found.extended.write(Path("extended.yaml"))  # every command accepts it in place of the description
print(f"{len(found.undetermined)} causes could not have shown:", ", ".join(found.undetermined))
