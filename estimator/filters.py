"""Filters over arrays of measurements: what a program calls. The recursion itself is compiled (`recursion`).

Sample 0 is the start: the first estimate is X̂(0|0) = Y(0) (or the one given), and every later sample is one update.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..models.errors import InputError
from . import recursion
from .errors import FilterDiverged
from .recursion import FilterBank
from .settings import FilterSettings


@dataclass(frozen=True)
class FilterModel:
    """A linear model with n states and m measurements, Eqs. (8), (9), where the torque filter's F = H = 1 is too small.

    Attributes:
        F: Shape (n, n), transition of one step.
        H: Shape (m, n), observation.
        W: Shape (n, n), process noise covariance of one step.
        V: Shape (m, m), measurement noise covariance; positive definite.
        P0: Shape (n, n), covariance of the first estimate.
        L: Shape (n, n), of Eq. (18); the identity times `FilterSettings.L` where None.
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

    @classmethod
    def of(cls, settings: FilterSettings) -> FilterModel:
        """Return the paper's torque filter: F = H = 1, numbers of the settings."""
        one = np.eye(1)
        return cls(one, one, settings.W * one, settings.V * one, settings.P0 * one, settings.L * one)


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

    settings: FilterSettings | tuple[FilterSettings, ...]
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


def unpack(states: np.ndarray, n: int, m: int, settings: Any = None) -> FilterHistory:
    """Give names to the parts of flat filter states, shape (..., state_size(n, m)); views, no copies."""
    widths = np.cumsum([n, n * n, m, m * m, m * m, m * m])
    x, P, innovation, PY, unadjusted, memory, last = np.split(states, widths, axis=-1)

    def square(flat: np.ndarray, size: int) -> np.ndarray:
        return flat.reshape(*flat.shape[:-1], size, size)

    return FilterHistory(
        settings, x, square(P, n), innovation, square(PY, m), square(unadjusted, m), square(memory, m),
        last[..., 0], last[..., 1], last[..., 2] != 0.0, last[..., 3],
    )  # fmt: skip


def filter_bank(
    settings: FilterSettings | Sequence[FilterSettings], model: FilterModel | None = None, count: int | None = None
) -> FilterBank:
    """Return filters as the stacked arrays that `recursion.update_bank` and a compiled closed loop take.

    Args:
        settings: one per filter, or one for all `count` of them.
        model: for all; without it each is the torque filter of its settings.
        count: how many, where there is one setting.
    """
    several = (settings,) * (count or 1) if isinstance(settings, FilterSettings) else tuple(settings)
    if not several:
        raise InputError("filters: expected at least one filter, got none")
    # Built once for each distinct setting: a batch of thousands usually has one.
    models = {one: model if model is not None else FilterModel.of(one) for one in set(several)}
    identity = np.eye(next(iter(models.values())).F.shape[0])

    def stack(make: Callable[[FilterSettings], np.ndarray]) -> np.ndarray:
        made = {one: make(one) for one in models}
        return np.ascontiguousarray([made[one] for one in several])

    return FilterBank(
        stack(lambda s: models[s].F),
        stack(lambda s: models[s].H),
        stack(lambda s: models[s].W),
        stack(lambda s: models[s].V),
        stack(lambda s: models[s].L if models[s].L is not None else s.L * identity),
        np.concatenate([s.gain(models[s].load_index) for s in several]),
    )


def start_bank(bank: FilterBank, x0: np.ndarray, P0: np.ndarray) -> np.ndarray:
    """Return flat states, shape (N, S), of a bank's filters at first estimates x0 (N, n), covariances P0 (N, n, n)."""
    count, m, n = bank.H.shape
    states = np.empty((count, recursion.state_size(n, m)))
    for i in range(count):
        recursion.start(states[i], x0[i], P0[i], bank.H[i], bank.V[i])
    return states


def run(
    settings: FilterSettings,
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
    y = np.asarray(measurements, dtype=np.float64)
    if y.ndim == 1:
        y = y[:, None]
    if y.ndim != 2:
        raise InputError(f"measurements: expected shape (T,) or (T, m), got {np.shape(measurements)}")
    states, bank = _run((settings,), y[None], time, model, initial_state, None)
    _, m, n = bank.H.shape
    return unpack(states[0], n, m, settings)


def run_batch(
    settings: FilterSettings | Sequence[FilterSettings],
    measurements: np.ndarray,
    *,
    time: np.ndarray | None = None,
    model: FilterModel | None = None,
    initial_state: np.ndarray | None = None,
    estimates_only: bool = False,
) -> FilterHistory | np.ndarray:
    """Run N filters, compiled, without the interpreter's lock. To the bit what N calls of `run` give.

    Args:
        settings: one for all, or one per filter.
        measurements: Shape (N, T) or (N, T, m).
        time, model, initial_state: as for `run`; initial_state (n,) or (N, n).
        estimates_only: return only X̂, shape (N, T, n): a tenth of the memory.

    Raises:
        InputError, FilterDiverged: as `run`; the message names the filter's index.
    """
    y = np.asarray(measurements, dtype=np.float64)
    if y.ndim == 2:
        y = y[:, :, None]
    if y.ndim != 3:
        raise InputError(f"measurements: expected shape (N, T) or (N, T, m), got {np.shape(measurements)}")
    several = (settings,) * len(y) if isinstance(settings, FilterSettings) else tuple(settings)
    if len(several) != len(y):
        raise InputError(f"settings: expected one or {len(y)}, as many as measurements, got {len(several)}")
    m = y.shape[2]
    n = model.F.shape[0] if model is not None else 1
    states, _ = _run(several, y, time, model, initial_state, n if estimates_only else None)
    return states if estimates_only else unpack(states, n, m, several)


def run_extended(
    settings: FilterSettings,
    model: FilterModel,
    measurements: np.ndarray,
    transition: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]],
    observation: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]],
    initial_state: np.ndarray,
    *,
    time: np.ndarray | None = None,
) -> FilterHistory:
    """Run a filter with nonlinear f and h, given as Python functions, through the same compiled update.

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
    y = np.asarray(measurements, dtype=np.float64)
    y = y[:, None] if y.ndim == 1 else y
    bank = filter_bank(settings, model)
    y = _checked(y[None], bank)[0]
    _, m, n = bank.H.shape
    state = start_bank(bank, _initial(initial_state, y[None], bank), model.P0[None])[0]
    history = np.empty((len(y), state.size))
    history[0] = state
    work = recursion.workspace(n, m)
    W, V, L, gain = bank.W[0], bank.V[0], bank.L[0], bank.gains[0]
    for t in range(1, len(y)):
        x, F = transition(t, state[:n].copy())
        x, F = np.array(x, dtype=np.float64).reshape(n), np.array(F, dtype=np.float64, order="C").reshape(n, n)
        y_predicted, H = observation(t, x.copy())
        y_predicted = np.array(y_predicted, dtype=np.float64).reshape(m)
        H = np.array(H, dtype=np.float64, order="C").reshape(m, n)
        status = recursion.update_predicted(state, x, y[t], y_predicted, F, H, W, V, L, gain, work)
        if status != recursion.OK:
            raise _diverged(settings, status, t, time, state, F, W, L, n, None)
        history[t] = state
    return unpack(history, n, m, settings)


def _run(several, y, time, model, initial_state, kept):
    """Run N filters over y (N, T, m); return the history (N, T, kept or all) and the bank."""
    bank = filter_bank(several, model)
    y = _checked(y, bank)
    count, _, n = bank.H.shape
    if model is not None:
        P0 = np.broadcast_to(model.P0, (count, n, n))
    else:
        P0 = np.array([s.P0 for s in several]).reshape(count, 1, 1)
    states = start_bank(bank, _initial(initial_state, y, bank), P0)
    history = np.empty((count, y.shape[1], states.shape[1] if kept is None else kept))
    status = np.empty((count, 2), dtype=np.int64)
    recursion.run_bank(states, y, bank, history, status)
    failed = np.flatnonzero(status[:, 0])
    if failed.size:
        i = int(failed[0])
        code, step = (int(value) for value in status[i])
        index = None if count == 1 else i
        raise _diverged(several[i], code, step, time, states[i], bank.F[i], bank.W[i], bank.L[i], n, index)
    return history, bank


def _checked(y: np.ndarray, bank: FilterBank) -> np.ndarray:
    """Return measurements (N, T, m), contiguous; refuse wrong shapes and values that are not finite."""
    m = bank.H.shape[1]
    if y.shape[1] == 0 or y.shape[2] != m:
        raise InputError(f"measurements: expected at least one sample of {m} value(s), got shape {y.shape[1:]}")
    bad = np.argwhere(~np.isfinite(y))
    if bad.size:
        i, t, _ = bad[0]
        which = f" of filter {i}" if len(y) > 1 else ""
        raise InputError(f"measurements: expected finite numbers, got {y[tuple(bad[0])]} at sample {t}{which}")
    return np.ascontiguousarray(y)


def _initial(initial_state: np.ndarray | None, y: np.ndarray, bank: FilterBank) -> np.ndarray:
    """Return first estimates, shape (N, n)."""
    count, _, n = bank.H.shape
    if initial_state is not None:
        try:
            x0 = np.broadcast_to(np.asarray(initial_state, dtype=np.float64), (count, n))
        except ValueError:
            raise InputError(f"initial_state: expected shape ({n},), got {np.shape(initial_state)}") from None
        if not np.isfinite(x0).all():
            raise InputError("initial_state: expected finite numbers")
        return np.ascontiguousarray(x0)
    if any(H.shape != (n, n) or not np.array_equal(H, np.eye(n)) for H in bank.H[:1]):
        raise InputError("initial_state: expected one, as H is not the identity and Y(0) is not a state; got none")
    return y[:, 0, :].copy()


def _diverged(settings, status, step, time, state, F, W, L, n, index) -> FilterDiverged:
    """Say in words why the update of `state` failed; the state is the last good one."""
    at = float(time[step]) if time is not None else step * 1e-3
    if status == recursion.GAMMA_TOO_SMALL:
        P = F @ state[n : n + n * n].reshape(n, n) @ F.T + W
        needed = np.sqrt(np.linalg.eigvalsh(L @ P @ L.T)[-1])
        reason = (
            f"P⁻¹ - γ⁻²LᵀL of Eq. (18) is not positive definite: gamma = {settings.gamma:g} N·m "
            f"is too small, expected more than {needed:g} N·m here"
        )
    elif status == recursion.FACTOR_OVERFLOW:
        reason = "f_α of Eq. (25) overflows"
        if settings.alpha == "printed":
            reason += (
                f": α = kω² as printed in Eq. (23) goes to zero with the load (the last estimate is "
                f"{state[0]:g} N·m), and 1/α to infinity; alpha: 'max' is the reading that works"
            )
        else:
            reason += ": the innovations are out of all proportion to P_Y; check W, V and the measurements' unit"
    elif status == recursion.NOT_POSITIVE:
        reason = (
            "P_Y of Eq. (14) is not finite and positive definite: W or F is too large, or P has grown without bound"
        )
    else:
        reason = "the measurement or the estimate is not finite"
    return FilterDiverged(settings.name, step, at, reason, index)
