"""Identifiability: causes that a measurement cannot show, and pairs that are confounded in it."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from ..fit.noise import whiten
from ..fit.residual import Problem
from ..fit.solver import Fit, gram, leverage_weight
from .screen import Library

SHOWS = 14.0
"""χ² from which a cause of ordinary size is detectable."""
ALIKE = 9.0
"""Two causes are confounded if their difference at ordinary size is less than this in χ²."""


def limits(problem: Problem, at: Fit, library: Library) -> tuple[list[str], list[tuple[str, str]]]:
    """Return undetectable causes and confounded pairs at ordinary size, by the Fisher information.

    The information is that beyond every calibration variable, under the noise and discrepancy that were learned.
    """
    if not library.hypotheses:
        return [], []
    n = at.jacobian[0].shape[-1]
    X = whiten(problem.segments, at.noise, at.jacobian, library.whole).rows
    G = gram(X, leverage_weight(X[:, : problem.size]))
    H = G[:n, :n] + np.diag(1 / problem.spread(at.model) ** 2)
    information = G[n:, n:] - G[n:, :n] @ np.linalg.solve(H, G[:n, n:])
    blocks: dict[str, list[slice]] = {}
    position = 0
    for h in library.hypotheses:
        m = len(h.magnitudes)
        blocks.setdefault(h.cause.name, []).append(slice(position, position + m))
        position += m

    def strength(block: slice) -> float:
        A = information[block, block]
        return float(np.trace(A) / len(A)) if A.size else 0.0

    weak = [name for name, places in blocks.items() if np.median([strength(b) for b in places]) < SHOWS]
    strong = [name for name in blocks if name not in weak]
    alike = []
    for i, a in enumerate(strong):
        for b in strong[i + 1 :]:
            if distance(information, blocks[a], blocks[b]) < ALIKE:
                alike.append((a, b))
    return weak, alike


def distance(information: np.ndarray, first: list[slice], second: list[slice]) -> float:
    """Return the least χ² between one cause at ordinary size and what the other can imitate.

    Only directions count in which a cause is detectable: a stop beyond the motion looks like anything. Zero if there is none.
    """
    best = np.inf
    for p in first:
        for q in second:
            A, B, C = information[p, p], information[q, q], information[p, q]
            for S, T, U in ((A, B, C), (B, A, C.T)):
                if np.trace(T) < SHOWS * len(T):
                    continue
                left = S - U @ np.linalg.solve(T + 1e-9 * np.eye(len(T)) * max(np.trace(T), 1e-12), U.T)
                _, directions = eigh(left, S + 1e-9 * np.eye(len(S)) * max(np.trace(S), 1e-12))
                for v in (directions / np.linalg.norm(directions, axis=0)).T:
                    if v @ S @ v >= SHOWS:
                        best = min(best, max(float(v @ left @ v), 0.0))
    return best if np.isfinite(best) else 0.0
