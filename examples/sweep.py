"""Sweep: how the filters' error grows with noise and load, over seeds, with confidence intervals.

The same study as a YAML file runs by `flexspline sweep STUDY.yaml --out DIR`; an interrupted sweep continues.
"""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import flexspline as fs

study = {
    "name": "noise",
    "description": "encoder noise against two loads",
    "seeds": {"first": 1, "count": 4},
    "scenarios": ["external_push"],
    "set": {"duration": 12},
    "axes": [
        {"kind": "set", "name": "encoder_noise", "key": "sensors.link_encoder.noise", "values": [1.5e-6, 6e-6, 2.4e-5]},
        {"kind": "load", "values": [4.5, 9.0]},
    ],
    "filters": ["EKF", "RAREKF", "dynamics_ekf"],
    "metrics": ["rms", "delay_ms"],
}
swept = fs.sweep(study, "sweep", figures=False)
print(swept)

figure, axes = plt.subplots()
for name in study["filters"]:
    for load in (4.5, 9.0):
        points = [a for a in swept.aggregates if a.filter == name and a.columns["load"] == load]
        noise, rms = [a.columns["encoder_noise"] for a in points], [a.values["rms"] for a in points]
        axes.errorbar(noise, [r.mean for r in rms], [r.half for r in rms], label=f"{name}, {load:g} N·m", capsize=3)
        print(f"{name}, {load:g} N·m:", ", ".join(f"{r.mean:.3f} ± {r.half:.3f}" for r in rms), "N·m RMS")
axes.set(xscale="log", xlabel="noise of the link encoder [rad]", ylabel="error [N·m RMS]")
axes.legend()
figure.savefig("sweep.png")
