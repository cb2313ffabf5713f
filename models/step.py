"""The step of an estimator as a C function: the interface of the closed loop and all estimators.

    int64 step(memory, sample, record, settings, out)        five addresses

It reads one `SAMPLE`, updates the estimator's `memory` and writes `out`, whose first number is the joint torque Ts
[N·m]. At the first sample, whose `interval` is zero, memory is zero and the estimator starts. A status other than
`OK` is the reason of a missing estimate. The compiled loop calls every estimator by address, also one of a plugin.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import types
from numba.np.numpy_support import from_dtype

from .errors import InputError, whole
from .kernels import c_function
from .parameters import PARAMETERS, floats
from .signals import SENSED

SAMPLE = floats("time", "interval", "current_command", "arm_torque", *SENSED)
"""An estimator's inputs at one instant, as a record for compiled code: `time` since the recording's start and
`interval` since the sample before [s] (0 at the first), the current command in force until now [A], the torque of
an arm's other joints on the link [N·m], and every reading; NaN for an unknown or unused command, or a missing
sensor."""

OK, NOT_FINITE = 0, 1
"""Status of a good step, and of an estimate that is not finite; other numbers are defined by the step."""
_PYTHON = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_ssize_t] * 5)
_compiling = threading.RLock()
Arrays = tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Address, memory, record, settings and `out` of a step."""


class Step:
    """A step function of five records of the types `records`, compiled when it is first needed (`step_of`)."""

    def __init__(self, function: Callable[..., int], records: tuple[np.dtype, ...]):
        self.function, self.records = function, records
        self._compiled: Any = None

    @property
    def address(self) -> int:
        """Address of the compiled C function. Raises `InputError`: a function that Numba cannot compile."""
        with _compiling:
            if self._compiled is None:
                try:
                    self._compiled = c_function(types.int64(*map(from_dtype, self.records)), self.function)
                except Exception as error:  # a missing field is a KeyError in Numba
                    code = self.function.__code__
                    raise InputError(
                        f"{code.co_filename}, line {code.co_firstlineno}: {code.co_name}: expected a step that can be compiled, "
                        f"got {type(error).__name__}: {whole(error)}"
                    ) from error
        return int(self._compiled.address)


class PythonStep:
    """A step as a Python function of five records, a thousand times slower.

    An exception ends the loop with status −1 and is kept in `error`.
    """

    def __init__(self, function: Callable[..., int], records: tuple[np.dtype, ...]):
        self.function, self.records = function, records
        self.error: BaseException | None = None

        def guarded(*addresses: int) -> int:
            try:
                at = zip(addresses, records, strict=True)
                memory = [np.frombuffer(memoryview((ctypes.c_char * of.itemsize).from_address(a)), of) for a, of in at]
                return int(function(*(one.view(np.recarray)[0] for one in memory)))
            except BaseException as error:  # no exception may pass through compiled code
                self.error = error
                return -1

        self._callback = _PYTHON(guarded)

    @property
    def address(self) -> int:
        """Address of the C callback."""
        return int(ctypes.cast(self._callback, ctypes.c_void_p).value or 0)


def step_of(
    memory: np.dtype,
    settings: Sequence[str] | np.dtype = ("interval",),
    outputs: Sequence[str] | np.dtype = ("torque",),
    plain: bool = False,
) -> Callable[[Callable[..., int]], Any]:
    """Make a step of a function of five records: memory, sample, parameters, settings, outputs, with fields by name.

    Args:
      memory: of the step, float64 fields and arrays of them.
      settings, outputs: names of float64 fields, or records of such.
      plain: whether to leave it in Python, where it may do anything, a thousand times slower.

    Returns:
      A decorator, which gives a `Step` or a `PythonStep` with the records' types as `records`.
    """
    own = [of if isinstance(of, np.dtype) else floats(*of) for of in (settings, outputs)]
    records = (memory, SAMPLE, PARAMETERS, *own)

    def decorated(function: Callable[..., int]) -> Step | PythonStep:
        return PythonStep(function, records) if plain else Step(function, records)

    return decorated


@dataclass(frozen=True)
class CompiledStep:
    """A step with its data, ready for the loop."""

    address: int  # of the C function
    memory: int  # number of float64 of its memory
    record: np.ndarray  # shape (1,), the known joint (`parameters.PARAMETERS`)
    # float64, its tuning parameters, in its own order
    settings: np.ndarray = field(default_factory=lambda: np.zeros(1))
    outputs: int = 1  # length of `out`
    reads_command: bool = False  # whether its samples contain a known current command; else NaN

    def arrays(self) -> Arrays:
        """Return address, new memory, record, settings and `out`, for compiled code."""
        settings = np.ascontiguousarray(self.settings, dtype=np.float64)
        return self.address, np.zeros(max(self.memory, 1)), self.record, settings, np.zeros(max(self.outputs, 1))
