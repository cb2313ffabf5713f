"""The paper's filters over arrays of measurements: one, many at once, or with another model than the torque's F = H = 1.

Sample 0 is the start: the first estimate is X̂(0|0) = Y(0) (or the one given), and every later sample is one update. One
state with F = H = 1 runs compiled (`recursion.update`), any other model in NumPy (`recursion.vector_update`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..models.errors import InputError
from . import recursion
from .errors import FilterDiverged
from .filters.paper import PaperFilter


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

    Raises:
        InputError: a shape that does not fit, a value that is not finite, a covariance that is none.
    """

    F: np.ndarray
    H: np.ndarray
    W: np.ndarray
    V: np.ndarray
    P0: np.ndarray
    L: np.ndarray | None = None
    load_index: int = 0

    def __post_init__(self) -> None:
        F = _matrix("F", self.F)
        n = F.shape[0]
        H = _matrix("H", self.H)
        shapes = {"F": (n, n), "H": (H.shape[0], n), "W": (n, n), "V": (H.shape[0],) * 2, "P0": (n, n), "L": (n, n)}
        for field, shape in shapes.items():
            if field == "L" and self.L is None:
                continue
            matrix = _matrix(field, getattr(self, field))
            if matrix.shape != shape:
                raise InputError(f"filter model: {field}: expected shape {shape}, got {matrix.shape}")
            if field in ("W", "V", "P0"):
                lowest = np.linalg.eigvalsh(matrix)[0]
                tolerance = 1e-12 * np.abs(matrix).max()
                if not np.allclose(matrix, matrix.T, rtol=0, atol=tolerance) or lowest < -tolerance:
                    raise InputError(f"filter model: {field}: expected a covariance, got one not symmetric or negative")
                if field == "V" and lowest <= 0.0:
                    raise InputError(f"filter model: V: expected positive definite, got lowest eigenvalue {lowest:g}")
            object.__setattr__(self, field, matrix)
        if not 0 <= self.load_index < n:
            raise InputError(f"filter model: load_index: expected a state from 0 to {n - 1}, got {self.load_index!r}")


def _matrix(field: str, value: Any) -> np.ndarray:
    try:
        matrix = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise InputError(f"filter model: {field}: expected a matrix of numbers, got {type(value).__name__}") from None
    if matrix.ndim != 2 or matrix.size == 0 or not np.isfinite(matrix).all():
        raise InputError(f"filter model: {field}: expected a matrix of finite numbers, got shape {matrix.shape}")
    return matrix


@dataclass(frozen=True)
class FilterHistory:
    """What filters did, step by step. With a batch every array has a leading axis N. Row 0 is the start.

    Attributes:
        settings: the filter's settings; a tuple of N for a batch.
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

    settings: PaperFilter | tuple[PaperFilter, ...]
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
        InputError: measurements of the wrong shape, or not finite.
        FilterDiverged: the next estimate would not be finite.
    """
    return _single(settings, measurements, time, model, initial_state, None)


def run_batch(
    settings: PaperFilter | Sequence[PaperFilter],
    measurements: np.ndarray,
    *,
    time: np.ndarray | None = None,
    model: FilterModel | None = None,
    initial_state: np.ndarray | None = None,
    estimates_only: bool = False,
) -> FilterHistory | np.ndarray:
    """Run N filters. To the bit what N calls of `run` give.

    Args:
        settings: one for all, or one per filter.
        measurements: Shape (N, T) or (N, T, m).
        time, model, initial_state: as for `run`; initial_state (n,) or (N, n).
        estimates_only: return only X̂, shape (N, T, n): a tenth of the memory.

    Raises:
        InputError, FilterDiverged: as `run`; the message names the filter's index.
    """
    y = np.asarray(measurements, dtype=np.float64)
    if y.ndim not in (2, 3):
        raise InputError(f"measurements: expected shape (N, T) or (N, T, m), got {np.shape(measurements)}")
    several = (settings,) * len(y) if isinstance(settings, PaperFilter) else tuple(settings)
    if len(several) != len(y):
        raise InputError(f"settings: expected one or {len(y)}, as many as measurements, got {len(several)}")
    if not several:
        raise InputError("filters: expected at least one filter, got none")
    starts = [None] * len(y) if initial_state is None else np.atleast_2d(initial_state)
    starts = starts if len(starts) == len(y) else [starts[0]] * len(y)
    rows = [_single(one, y[i], time, model, starts[i], i) for i, one in enumerate(several)]
    if estimates_only:
        return np.stack([row.x for row in rows])
    arrays = [field.name for field in fields(FilterHistory) if field.name != "settings"]
    return FilterHistory(several, **{name: np.stack([getattr(row, name) for row in rows]) for name in arrays})


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
        InputError, FilterDiverged: as `run`.
    """
    y = _checked(measurements, len(model.H), None)
    return _vector(settings, model, y, transition, observation, _state(initial_state, len(model.F)), time, None)


def _single(settings, measurements, time, model, initial_state, index) -> FilterHistory:
    """One filter, number `index` of a batch; the torque filter from Y(0) is compiled."""
    y = _checked(measurements, 1 if model is None else len(model.H), index)
    if model is None and initial_state is None:
        return _scalar(settings, y[:, 0], time, index)
    model = _torque_model(settings) if model is None else model
    n = len(model.F)
    if initial_state is None and not np.array_equal(model.H, np.eye(n)):
        raise InputError("initial_state: expected one, as H is not the identity and Y(0) is not a state; got none")
    start = y[0] if initial_state is None else _state(initial_state, n)
    F, H = model.F, model.H
    return _vector(settings, model, y, lambda k, x: (F @ x, F), lambda k, x: (H @ x, H), start, time, index)


def _scalar(settings: PaperFilter, y: np.ndarray, time: np.ndarray | None, index: int | None) -> FilterHistory:
    """The compiled filter, one state."""
    states = np.zeros(len(y), recursion.STATE)
    step, status = recursion.run(np.ascontiguousarray(y), settings.record(), states)
    if status != recursion.OK:
        last = states[step - 1]
        P = settings.L**2 * (last["variance"] + settings.W)
        raise FilterDiverged(settings.name, step, _at(time, step), settings.failure(status, last["torque"], P), index)
    column = {name: np.ascontiguousarray(states[name]) for name in recursion.STATE.names or ()}
    square = {name: values[:, None, None] for name, values in column.items()}
    return FilterHistory(
        settings, column["torque"][:, None], square["variance"], column["innovation"][:, None],
        square["innovation_variance"], square["unadjusted_innovation_variance"], square["innovation_memory_variance"],
        column["alpha"], column["f_alpha"], column["robust"] != 0.0, column["nis"],
    )  # fmt: skip


def _vector(settings, model, y, transition, observation, start, time, index) -> FilterHistory:
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
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what overflows is told by its status
            found = recursion.vector_update(f, x, predicted, y[t], F, H, W, V, L, model.load_index, c)
        if isinstance(found, int):
            largest = 0.0
            if found == recursion.GAMMA_TOO_SMALL:
                largest = float(np.linalg.eigvalsh(L @ (F @ f["P"] @ F.T + W) @ L.T)[-1])
            reason = settings.failure(found, f["x"][model.load_index], largest)
            raise FilterDiverged(settings.name, t, _at(time, t), reason, index)
        f = found
        steps.append(f)
    return FilterHistory(settings, **{name: np.array([f[name] for f in steps]) for name in steps[0]})


def _torque_model(settings: PaperFilter) -> FilterModel:
    """The paper's torque filter, F = H = 1, as a model."""
    one = np.eye(1)
    return FilterModel(one, one, settings.W * one, settings.V * one, settings.P0 * one, settings.L * one)


def _at(time: np.ndarray | None, step: int) -> float:
    return float(time[step]) if time is not None else step * 1e-3


def _checked(measurements: np.ndarray, m: int, index: int | None) -> np.ndarray:
    """Measurements as an array, shape (T, m); refuse wrong shapes and values that are not finite."""
    y = np.asarray(measurements, dtype=np.float64)
    y = y[:, None] if y.ndim == 1 else y
    if y.ndim != 2:
        raise InputError(f"measurements: expected shape (T,) or (T, m), got {np.shape(measurements)}")
    if y.shape[0] == 0 or y.shape[1] != m:
        raise InputError(f"measurements: expected at least one sample of {m} value(s), got shape {y.shape}")
    bad = np.argwhere(~np.isfinite(y))
    if bad.size:
        which = "" if index is None else f" of filter {index}"
        raise InputError(f"measurements: expected finite numbers, got {y[tuple(bad[0])]} at sample {bad[0][0]}{which}")
    return y


def _state(given: Any, n: int) -> np.ndarray:
    x = np.asarray(given, dtype=np.float64)
    if x.shape != (n,):
        raise InputError(f"initial_state: expected shape ({n},), got {x.shape}")
    if not np.isfinite(x).all():
        raise InputError("initial_state: expected finite numbers")
    return x
