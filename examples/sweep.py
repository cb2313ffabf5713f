"""Sweep: how the filters' error grows with noise and load, over seeds, with confidence intervals.

The same study as a YAML file runs by `flexspline sweep STUDY.yaml --out DIR`; an interrupted sweep continues.
"""

import os
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from flexspline.scenarios.studies.dataset import Dataset
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.statistics import aggregate
from flexspline.scenarios.studies.study import Study
from flexspline.scenarios.studies.sweep import sweep, versions

study = Study.model_validate(
    {
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
)  # fmt: skip
design = Design.of(study)
dataset = Dataset.open(Path("sweep"), design, versions())
sweep(design, dataset, os.cpu_count() or 1, progress=lambda runs: print(f"{runs} more of {design.runs} runs"))

figure, axes = plt.subplots()
found = list(aggregate(dataset))
for name in study.names:
    for load in (4.5, 9.0):
        points = [a for a in found if a.filter == name and a.columns["load"] == load]
        noise, rms = [a.columns["encoder_noise"] for a in points], [a.values["rms"] for a in points]
        axes.errorbar(noise, [r.mean for r in rms], [r.half for r in rms], label=f"{name}, {load:g} N·m", capsize=3)
        print(f"{name}, {load:g} N·m:", ", ".join(f"{r.mean:.3f} ± {r.half:.3f}" for r in rms), "N·m RMS")
axes.set(xscale="log", xlabel="noise of the link encoder [rad]", ylabel="error [N·m RMS]")
axes.legend()
figure.savefig("sweep.png")
