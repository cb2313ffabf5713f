"""The C99 header of an estimator computes what the compiled step computes, over every shipped scenario."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import flexspline as fs
from flexspline.estimator import registry
from flexspline.estimator.estimator import as_samples, go_on
from flexspline.estimator.export_c import header
from flexspline.scenarios.scenario import shipped_scenarios

NAMES = ("EKF", "AREKF", "RAREKF", "REKF", "momentum_torsion", "current", "augmented")
pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
MAIN = """
#include "estimator.h"
#include <stdio.h>
int main(void) {{
  static {name}_state state; {name}_output out; flexspline_sample s; int status = 0;
  {name}_init(&state);
  while (fread(&s, sizeof s, 1, stdin) == 1) {{
    status |= {name}_step(&state, &s, &out);
    fwrite(&out, sizeof out, 1, stdout);
  }}
  return status;
}}
"""


def c_outputs(folder, estimator, known, interval, samples):
    """Outputs of the header's step over samples, shape (n, outputs)."""
    name = estimator.name.lower()
    (folder / "estimator.h").write_text(header(estimator, known, interval))
    (folder / "main.c").write_text(MAIN.format(name=name))
    command = [
        "gcc",
        "-std=c99",
        "-O1",
        "-ffp-contract=off",
        "-Wall",
        "-Wextra",
        "-pedantic",
        "-Werror",
        "main.c",
        "-o",
        "main",
        "-lm",
    ]
    subprocess.run(command, cwd=folder, check=True)
    found = subprocess.run([folder / "main"], input=samples.tobytes(), capture_output=True, check=True).stdout
    return np.frombuffer(found).reshape(len(samples), -1)


def compare(folder, scenario, names):
    run = fs.simulate(scenario)
    known = replace(run.known, start=float(run.signals.time[0]))
    for name in names:
        estimator = registry.get(name).scaled(known, 1e-3)
        step = estimator.step(known, 1e-3)
        samples = as_samples(run.signals, (), known, estimator.reads_command)
        expected = np.zeros((len(samples), step.outputs))
        assert go_on(step.arrays(), samples, expected) == (len(samples), 0)
        found = c_outputs(folder, estimator, known, 1e-3, samples)
        scale = np.maximum(np.abs(expected), np.sqrt(np.mean(expected**2, axis=0)))
        off = np.max(np.abs(found - expected) / np.where(scale > 0, scale, 1.0))
        assert off <= 1e-12, (scenario, name, off)


@pytest.mark.fast_every(6)  # a paper's filter, and the augmented one
@pytest.mark.parametrize("name", NAMES)
def test_header_computes_what_the_step_computes(tmp_path, name):
    compare(tmp_path, "no_load", [name])


@pytest.mark.fast_every(3)
@pytest.mark.slow
@pytest.mark.parametrize("scenario", sorted(shipped_scenarios()))
def test_every_scenario(tmp_path, scenario):
    compare(tmp_path, scenario, NAMES)
