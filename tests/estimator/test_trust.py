"""A diverging estimate is marked with the reason everywhere; a good one is not."""

import numpy as np
import pytest

import flexspline as fs
from flexspline.estimator.trust import Watch

FILTERS = ["RAREKF", "dynamics_ekf", "augmented"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [{"sensors.motor_encoder.noise": 0.1}, {"sensors.motor_encoder.counts": 16}, {"controller.delay": 0.01},
     {"sensors.motor_current.noise": 100}, {"known_joint": "csg-40-120-ilm115"}],
    ids=str,
)  # fmt: skip
def test_a_diverging_estimate_is_marked(change):
    run = fs.simulate("link_sweep", duration=8, filters=FILTERS, **change)
    truth = run.truth("joint_torque")
    rated = run.known.rated_torque
    for name, found in run.estimates.items():
        off = float(np.sqrt(np.mean((found.mean - truth)[1000:] ** 2)))
        if off > rated:
            assert found.untrusted, (name, off)
            assert any(note.startswith(f"{name} is not to be trusted") for note in run.notes)
            assert run.metrics["untrusted"][name] == found.untrusted
    assert run.estimates["dynamics_ekf"].untrusted


def test_an_estimate_that_knows_it_is_unsure_is_marked():
    """A current sensor with noise of ten times the current: 4.6 N·m of error at torques within the gear's."""
    run = fs.simulate("link_sweep", duration=5, filters=["RAREKF", "augmented"], **{"sensors.motor_current.noise": 30})
    assert run.estimates["RAREKF"].untrusted is None  # which takes the command's current
    assert run.estimates["augmented"].untrusted.startswith("its own standard deviation is ")
    assert np.isfinite(run.estimates["augmented"].mean).all()


@pytest.mark.parametrize("scenario", ["no_load", "link_sweep", "external_push"])
def test_a_good_estimate_is_trusted(scenario):
    run = fs.simulate(
        scenario, sensors="realistic", filters=["RAREKF", "EKF", "augmented", "current", "momentum_torsion"]
    )
    assert {name: found.untrusted for name, found in run.estimates.items() if found.untrusted} == {}


@pytest.mark.parametrize("block", [1, 7, 500, 5000])
def test_blocks_have_no_effect(block):
    rng = np.random.default_rng(5)
    time = np.arange(5000) * 1e-3
    out = np.column_stack([rng.standard_normal(5000), 6.0 * rng.standard_normal(5000), np.ones(5000)])
    watch = Watch(16.0, ("torque", "innovation", "innovation_variance"))
    for begin in range(0, 5000, block):
        watch.add(time[begin : begin + block], out[begin : begin + block])
    assert watch.reason is not None and watch.reason.startswith("innovations 6")
