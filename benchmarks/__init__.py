"""Benchmarks: `python -m benchmarks` or `make bench`. One file per benchmark.

`python -m benchmarks convergence` regenerates the tables and the figure of docs/convergence.md.
`python -m benchmarks.claims` prints the tables of docs/paper.md, `python -m benchmarks.estimators` writes those of
docs/estimators.md with their figures.
"""
