"""Joint torque estimation with harmonic drives: simulate, estimate, diagnose, validate."""

__version__ = "0.1.0"
