"""Benchmarks: `python -m benchmarks` or `make bench`. One file per benchmark; `convergence` regenerates docs/convergence.md's table."""
