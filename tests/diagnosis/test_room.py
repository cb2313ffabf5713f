"""Orders of one kind are limited in number: a search proposes no more than there is room for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from swing import recording

from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.fit.coordinates import hypotheses
from flexspline.diagnosis.fit.residual import Problem
from flexspline.models import causes
from flexspline.models.joint import as_joint, load_joint
from flexspline.models.parameters import N_ORDERS


def test_no_order_is_tried_that_the_joint_has_no_room_for():
    def order(n: int) -> dict:
        return {"order": {"value": n}, "amplitude": {"value": 1e-5}, "phase": {"value": 0.3}}

    effects = [{"name": "cogging", "parameters": order(40 + n)} for n in range(N_ORDERS - 1)]
    joint = as_joint(load_joint("test-joint").model_dump() | {"effects": effects}, Path("full.yaml"))
    problem = Problem(*segments([recording(seconds=3.0)], joint), joint)
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    tried = hypotheses(causes.get("cogging"), record)
    assert problem.with_room((), tried) == tried  # one is left …
    assert problem.with_room((tried[0],), tried) == [tried[0]]  # … and then none but the one that is there
    ripple = hypotheses(causes.get("kinematic_error"), record)
    assert problem.with_room((tried[0],), ripple) == ripple
