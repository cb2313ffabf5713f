"""Joint torque from measurements: the paper's compliance model and filters, and every other estimator behind one interface.

`registry.get(name)` gives an estimator, `KnownJoint.of(joint)` what it may know of a joint, `estimate` runs it over signals.
"""

from ..models.errors import FilterDiverged
from ..models.step import step_of
from .compliance import measurement_variance
from .estimator import CausalEstimator, Estimator, KnownJoint, Posterior, SensorNoise, TuningParameter
from .filters.paper import PaperFilter
from .registry import get, names

__all__ = [
    "CausalEstimator", "Estimator", "FilterDiverged", "KnownJoint", "PaperFilter", "Posterior", "SensorNoise", "TuningParameter",
    "get", "measurement_variance", "names", "step_of",
]  # fmt: skip
