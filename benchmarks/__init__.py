"""Benchmarks, one per file: `python -m benchmarks` or `make bench`.

`python -m benchmarks --help` lists them. Those that write tables of a page name it in their first line.
"""
