"""The paper's filters over arrays of measurements, step by step, also with another model than the torque's F = H = 1.

Sample 0 is the start: the first estimate is X̂(0|0) = Y(0) (or the one given), and every later sample is one update. One
state with F = H = 1 runs compiled (`recursion.update`), any other model in NumPy (`vector_update`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexspline.estimator import recursion
from flexspline.estimator.filters.paper import PaperFilter
from flexspline.models.errors import FilterDiverged
from flexspline.models.kernels import kernel


@dataclass(frozen=True)
class FilterModel:
    """A linear model with n states and m measurements, Eqs. (8), (9), where the torque filter's F = H = 1 is too small.

    Attributes:
        F: Shape (n, n), transition of one step.
        H: Shape (m, n), observation.
        W: Shape (n, n), process noise covariance of one step.
        V: Shape (m, m), measurement noise covariance; positive definite.
        P0: Shape (n, n), covariance of the first estimate.
        L: Shape (n, n), of Eq. (18); the identity times `PaperFilter.L` where None.
        load_index: which state is the torque load ω [N·m] of Eq. (23).
    """

    F: np.ndarray
    H: np.ndarray
    W: np.ndarray
    V: np.ndarray
    P0: np.ndarray
    L: np.ndarray | None = None
    load_index: int = 0

    def __post_init__(self) -> None:
        for field in ("F", "H", "W", "V", "P0"):
            object.__setattr__(self, field, np.array(getattr(self, field), dtype=np.float64, order="C"))


@dataclass(frozen=True)
class FilterHistory:
    """What filters did, step by step. Row 0 is the start.

    Attributes:
        settings: the filter's settings.
        x: Shape (T, n), estimates X̂(k|k).
        P: Shape (T, n, n), their covariance, Eq. (17).
        innovation: Shape (T, m), Ỹ of Eq. (13).
        innovation_covariance: Shape (T, m, m), P_Y of Eq. (14), of the adjusted prediction: the one in the gain.
        unadjusted_covariance: Shape (T, m, m), P_Y of the unadjusted prediction.
        memory: Shape (T, m, m), P̄_Y of Eq. (20).
        alpha: Shape (T,), redundancy factor α.
        f_alpha: Shape (T,), compensation factor f_α of Eq. (25), 1 in optimal mode; tr Σ / tr P for the fixed-γ rule.
        robust: Shape (T,), bool, whether the step was in robust mode.
        nis: Shape (T,), normalised innovation squared Ỹᵀ P_Y⁻¹ Ỹ, with the P_Y of Eq. (14).
    """

    settings: PaperFilter
    x: np.ndarray
    P: np.ndarray
    innovation: np.ndarray
    innovation_covariance: np.ndarray
    unadjusted_covariance: np.ndarray
    memory: np.ndarray
    alpha: np.ndarray
    f_alpha: np.ndarray
    robust: np.ndarray
    nis: np.ndarray

    @property
    def torque(self) -> np.ndarray:
        """The first state, shape (T,): the torque [N·m] of the paper's filter."""
        return self.x[..., 0]


def run(
    settings: PaperFilter,
    measurements: np.ndarray,
    *,
    time: np.ndarray | None = None,
    model: FilterModel | None = None,
    initial_state: np.ndarray | None = None,
) -> FilterHistory:
    """Run one filter over measurements; by default the paper's, F = H = 1.

    Args:
        settings: the filter.
        measurements: Shape (T,) or (T, m); torque [N·m] of the compliance model for the paper's filter.
        time: Shape (T,), sample times [s], for the message of `FilterDiverged`; 1 ms apart by default.
        model: a model with other dimensions; its W, V, P0, L then replace the settings'.
        initial_state: Shape (n,), X̂(0|0). By default Y(0), where the model observes its states directly (H = I).

    Raises:
        FilterDiverged: the next estimate would not be finite.
    """
    y = _column(measurements)
    if model is None and initial_state is None:
        return _scalar(settings, y[:, 0], time)
    one = np.eye(1)
    if model is None:
        model = FilterModel(one, one, settings.W * one, settings.V * one, settings.P0 * one, settings.L * one)
    F, H = model.F, model.H
    start = y[0] if initial_state is None else initial_state
    return _vector(settings, model, y, lambda k, x: (F @ x, F), lambda k, x: (H @ x, H), start, time)


def run_extended(
    settings: PaperFilter,
    model: FilterModel,
    measurements: np.ndarray,
    transition: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]],
    observation: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]],
    initial_state: np.ndarray,
    *,
    time: np.ndarray | None = None,
) -> FilterHistory:
    """Run a filter with nonlinear f and h, given as Python functions.

    Args:
        settings: the gain rule.
        model: W, V, P0, L and dimensions; F and H only give shapes.
        measurements: Shape (T,) or (T, m).
        transition: `(k, x) → (f(k, x), ∂f/∂x)`, shapes (n,), (n, n): from step k-1 to k, Eqs. (10), (11).
        observation: `(k, x) → (h(x), ∂h/∂x)`, shapes (m,), (m, n), at the predicted state.
        initial_state: Shape (n,), X̂(0|0).
        time: Shape (T,), sample times [s].

    Raises:
        FilterDiverged: as `run`.
    """
    return _vector(settings, model, _column(measurements), transition, observation, initial_state, time)


def _scalar(settings: PaperFilter, y: np.ndarray, time: np.ndarray | None) -> FilterHistory:
    """The compiled filter, one state."""
    states = np.zeros(len(y), recursion.STATE)
    step, status = _run(np.ascontiguousarray(y), settings.record(), states)
    if status != recursion.OK:
        last = states[step - 1]
        P = settings.L**2 * (last["variance"] + settings.W)
        raise FilterDiverged(settings.name, step, _at(time, step), settings.failure(status, last["torque"], P))
    column = {name: np.ascontiguousarray(states[name]) for name in recursion.STATE.names or ()}
    square = {name: values[:, None, None] for name, values in column.items()}
    return FilterHistory(
        settings, column["torque"][:, None], square["variance"], column["innovation"][:, None],
        square["innovation_variance"], square["unadjusted_innovation_variance"], square["innovation_memory_variance"],
        column["alpha"], column["f_alpha"], column["robust"] != 0.0, column["nis"],
    )  # fmt: skip


def _vector(settings, model, y, transition, observation, start, time) -> FilterHistory:
    """The filter of any dimension: `recursion.vector_update` at every sample."""
    c = settings.record()[0]
    n, m = len(start), y.shape[1]
    W, V, L = model.W, model.V, settings.L * np.eye(n) if model.L is None else model.L
    P_Y = model.H @ model.P0 @ model.H.T + V
    f = {
        "x": start, "P": model.P0, "innovation": np.zeros(m), "innovation_covariance": P_Y, "unadjusted_covariance": P_Y,
        "memory": np.zeros((m, m)), "alpha": 1.0, "f_alpha": 1.0, "robust": False, "nis": 0.0,
    }  # fmt: skip
    steps = [f]
    for t in range(1, len(y)):
        x, F = (np.asarray(a, dtype=np.float64) for a in transition(t, f["x"].copy()))
        x, F = x.reshape(n), F.reshape(n, n)
        predicted, H = (np.asarray(a, dtype=np.float64) for a in observation(t, x.copy()))
        predicted, H = predicted.reshape(m), H.reshape(m, n)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # an overflow shows in its status
            found = vector_update(f, x, predicted, y[t], F, H, W, V, L, model.load_index, c)
        if isinstance(found, int):
            largest = 0.0
            if found == recursion.GAMMA_TOO_SMALL:
                largest = float(np.linalg.eigvalsh(L @ (F @ f["P"] @ F.T + W) @ L.T)[-1])
            reason = settings.failure(found, f["x"][model.load_index], largest)
            raise FilterDiverged(settings.name, t, _at(time, t), reason)
        f = found
        steps.append(f)
    return FilterHistory(settings, **{name: np.array([f[name] for f in steps]) for name in steps[0]})


def _at(time: np.ndarray | None, step: int) -> float:
    return float(time[step]) if time is not None else step * 1e-3


def _column(measurements: Any) -> np.ndarray:
    y = np.asarray(measurements, dtype=np.float64)
    return y[:, None] if y.ndim == 1 else y


@kernel
def _run(y, settings, history):
    """Run a filter over measurements, shape (T,), into `history`, shape (T,), records of `STATE`.

    Returns:
        The sample at which it failed, and the status; (T, OK) where it did not.
    """
    c = settings[0]
    recursion.start(history[0], y[0], c)
    for t in range(1, len(y)):
        history[t] = history[t - 1]
        status = recursion.update(history[t], y[t], c)
        if status != recursion.OK:
            return t, status
    return len(y), recursion.OK


def vector_update(
    f: dict[str, Any],
    x: np.ndarray,
    y_predicted: np.ndarray,
    y: np.ndarray,
    F: np.ndarray,
    H: np.ndarray,
    W: np.ndarray,
    V: np.ndarray,
    L: np.ndarray,
    load_index: int,
    c: np.void,
) -> dict[str, Any] | int:
    """One step of the recursion for n states and m measurements, from a predicted state and measurement.

    Args:
        f: the filter, a dictionary of `x` (n,), `P` (n, n), `innovation_covariance`, `memory` (m, m).
        x: Shape (n,), the prediction of Eq. (10), F·X̂ or f(X̂). y_predicted: Shape (m,), H·x or h(x).
        y: Shape (m,), the measurement.
        F, H: Shape (n, n), (m, n): the model, or the Jacobians of f at X̂ and of h at x.
        W, V, L: Shape (n, n), (m, m), (n, n): noise covariances; L of Eq. (18).
        load_index: which state is the torque load ω.
        c: record of `SETTINGS`; its W, V, P0, L are not looked at.

    Returns:
        The next filter, with `unadjusted_covariance`, `innovation` (m,), `alpha`, `f_alpha`, `robust`, `nis`; or the status, an
        integer, where there is none.
    """
    P = F @ f["P"] @ F.T + W  # (11)
    unadjusted = H @ P @ H.T + V  # (14), of the unadjusted prediction
    innovation = y - y_predicted  # (13)
    past = f["innovation_covariance"] if c["printed_memory"] else f["memory"]
    memory = (c["rho"] * past + np.outer(innovation, innovation)) / (c["rho"] + 1.0)  # (20)
    if not np.isfinite(np.trace(memory)):
        return recursion.NOT_FINITE
    alpha = recursion.redundancy_factor(f["x"][load_index], c)
    if c["rule"] == recursion.ROBUST:  # (18), without inverting P: Σ = P + γ⁻² P Lᵀ (I − γ⁻² L P Lᵀ)⁻¹ L P
        LP, g = L @ P, c["inverse_gamma_squared"]
        M = np.eye(len(P)) - g * LP @ L.T
        # For P > 0, M is positive definite exactly when P⁻¹ − γ⁻²LᵀL is. γ = ∞ gives P to the bit.
        if not _positive(M):
            return recursion.GAMMA_TOO_SMALL
        sigma = P + g * LP.T @ np.linalg.solve(M, LP)
        f_alpha = np.trace(sigma) / np.trace(P) if np.trace(P) > 0.0 else 1.0
    else:
        f_alpha = recursion.compensation_factor(np.trace(memory), np.trace(unadjusted), np.trace(V), alpha, c)
        if not f_alpha <= recursion.LARGEST_FACTOR:
            return recursion.FACTOR_OVERFLOW
        sigma = f_alpha * P  # (12), (19)
    P_Y = H @ sigma @ H.T + V  # (14)
    if not _positive(P_Y):
        return recursion.NOT_POSITIVE
    K = np.linalg.solve(P_Y, H @ sigma).T  # (15)
    x = x + K @ innovation  # (16)
    A = np.eye(len(P)) - K @ H
    P = A @ sigma @ A.T + K @ V @ K.T  # (17) in Joseph's form, which needs no inverse of Σ and stays positive
    if not (np.isfinite(x).all() and np.isfinite(P).all()):
        return recursion.NOT_FINITE
    P = 0.5 * (P + P.T)
    if not _positive(P):
        P = _without_negative(P)
    return {
        "x": x, "P": P, "innovation": innovation, "innovation_covariance": P_Y,
        "unadjusted_covariance": unadjusted, "memory": memory, "alpha": alpha, "f_alpha": f_alpha,
        "robust": bool(c["rule"] == recursion.ROBUST or f_alpha != 1.0), "nis": innovation @ np.linalg.solve(P_Y, innovation),
    }  # fmt: skip


def _without_negative(P: np.ndarray) -> np.ndarray:
    """The nearest covariance to a symmetric P, which is none by rounding where a state is known exactly.

    Left alone, what is negative there and not observed is multiplied by f_α in every step.
    """
    values, vectors = np.linalg.eigh(P)
    if values[0] >= 0.0:
        return P
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return root @ root.T


def _positive(S: np.ndarray) -> bool:
    """Whether a symmetric matrix is finite and positive definite."""
    if not np.isfinite(S).all():
        return False
    try:
        np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return False
    return True
