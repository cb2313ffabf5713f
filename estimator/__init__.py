"""Joint torque from measurements: the compliance model, Eqs. (1)-(7), and the filters, Eqs. (10)-(25)."""

from .compliance import Compliance, compliance, compliance_torque, torsions
from .errors import FilterDiverged
from .filters import (
    FilterHistory,
    FilterModel,
    filter_bank,
    run,
    run_batch,
    run_extended,
    start_bank,
    unpack,
)
from .recursion import FilterBank, state_size, update, update_bank, update_predicted, workspace
from .settings import FilterSettings, measurement_variance, paper_filters

__all__ = [
    "Compliance",
    "FilterBank",
    "FilterDiverged",
    "FilterHistory",
    "FilterModel",
    "FilterSettings",
    "compliance",
    "compliance_torque",
    "filter_bank",
    "measurement_variance",
    "paper_filters",
    "run",
    "run_batch",
    "run_extended",
    "start_bank",
    "state_size",
    "torsions",
    "unpack",
    "update",
    "update_bank",
    "update_predicted",
    "workspace",
]
