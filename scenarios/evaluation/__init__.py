"""Evaluation of estimators: metrics, tuning, bounds, intervals."""
