"""Benchmarks: `python -m benchmarks` or `make bench`. One file per benchmark.

`python -m benchmarks convergence` regenerates the tables and the figure of docs/convergence.md.
"""
