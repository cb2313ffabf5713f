"""Joint torque from measurements: the paper's compliance model and filters, and every other estimator behind one interface.

`registry.get(name)` gives an estimator, `KnownJoint.of(joint)` what it may know of a joint, `estimate` runs it over signals.
"""

from ..models.step import step_of
from .arrays import FilterHistory, FilterModel, run, run_batch, run_extended
from .compliance import Compliance, compliance, compliance_torque, measurement_variance, torsions
from .errors import FilterDiverged
from .estimator import CausalEstimator, Estimator, KnownJoint, Posterior, SensorNoise
from .filters.paper import PaperFilter, paper_filters
from .registry import get, names
from .tuning_parameters import TuningParameter

__all__ = [
    "CausalEstimator",
    "Compliance",
    "Estimator",
    "FilterDiverged",
    "FilterHistory",
    "FilterModel",
    "KnownJoint",
    "PaperFilter",
    "Posterior",
    "SensorNoise",
    "TuningParameter",
    "compliance",
    "compliance_torque",
    "get",
    "measurement_variance",
    "names",
    "paper_filters",
    "run",
    "run_batch",
    "run_extended",
    "step_of",
    "torsions",
]
