"""Compare filters: which torque estimator for slow motion, and which where somebody pushes?

Every filter sees the same simulated sensors. Run it with `python examples/compare_filters.py`.
"""

import flexspline as fs

FILTERS = ["EKF", "RAREKF", "lowpass", "kalman", "dynamics_ekf"]

table = fs.compare(["link_sweep", "external_push"], FILTERS, seed=1, duration=20)
shown = table[["rms", "noise", "delay_ms"]].rename(
    columns={"rms": "rms [N·m]", "noise": "noise [N·m]", "delay_ms": "delay [ms]"}
)
print(shown.round(4).to_string())

for scenario, errors in table["rms"].groupby("scenario"):
    best = errors.idxmin()[1]
    print(f"{scenario}: {best} is closest, {errors.min():.3f} N·m RMS; RAREKF {errors[scenario, 'RAREKF']:.3f}")

# The same filters on the same signals, one of them tuned differently: entries may carry tuning parameters.
run = fs.simulate(
    "external_push",
    seed=1,
    duration=20,
    filters=["dynamics_ekf", {"name": "quick", "estimator": "dynamics_ekf", "process.push": 8.0}],
)
for name, measures in run.metrics["filters"].items():
    print(f"{name}: {measures['rms']:.4f} N·m RMS, {measures['delay_ms']:.1f} ms late")
