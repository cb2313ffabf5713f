"""Plan an experiment: what a first measurement left open, which experiment answers it, and whether it did.

A joint with one encoder and a current sensor, as most robots have; backlash is hidden in it.
"""

from dataclasses import replace
from pathlib import Path

import flexspline as fs
from flexspline.diagnosis.planning import experiments, perform
from flexspline.models.joint_parts import Effect, Estimate

HIDDEN = "backlash"
joint = fs.load_joint("test-joint")
effect = Effect(name=HIDDEN, parameters={"width": Estimate(value=4e-4, unit="rad")})
worn = joint.model_copy(update={"effects": [effect]})
worn.write(Path("worn.yaml"))

sweep = [(0.5, 0.0), (3.5, 1.2), (9.0, -1.2), (13.0, 1.0), (16.0, 0.0)]  # s, rad
run = fs.simulate(
    "link_sweep", joint=str(Path("worn.yaml").resolve()), duration=17, trajectory=[{"time": t, "position": x} for t, x in sweep],
    controller={"kp": 8.0, "kd": 0.08, "ki": 20.0}, record=["motor_position", "motor_current"],
)  # fmt: skip
first = fs.Measurement("bench", Path(), (run.as_recording(),))

found = fs.diagnose(first, joint)
print(f"first: {found.verdict}; could {HIDDEN} have shown? {'no' if HIDDEN in found.undetermined else 'yes'}")

plan = fs.plan(first, joint, found)
for number, sentence in enumerate(plan.sentences()[:3], 1):
    print(f"{number}. {sentence}")

# The simulated joint is used as the bench: the first proposal is carried out on it.
best = next(e for e in experiments(first, joint, found) if e.name == plan.proposals[0].name)
second = perform(best, worn, joint, seed=7)
found = fs.diagnose(replace(first, recordings=(*first.recordings, second)), joint)
print(f"after {best.name}: {found.verdict}")
for cause in found.causes:
    values = ", ".join(f"{name} {p.value:.3g} ± {p.std:.1g} {p.unit}" for name, p in cause.parameters.items())
    print(f"{cause.name}: {values}")
