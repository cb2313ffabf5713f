"""Fields of MuJoCo's C structures, and addresses of its functions.

Compiled code gets the addresses of an mjModel and an mjData. The offset of a field is found once per process by
searching the address that Python's view of the field reports, so that it works for any build. MuJoCo is imported on
use: `import mujoco` itself may run this (`flexspline.__init__`).
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numba import types

from ..models.kernels import c_function

_FARTHEST = 1 << 19  # bytes: beyond the largest structure
_AT_ONCE = 64  # words


@cache
def library() -> ctypes.CDLL:
    """Return MuJoCo's shared library, as used by the Python bindings."""
    import mujoco

    folder = Path(mujoco.__file__).parent
    found = sorted([*folder.glob("libmujoco.so*"), *folder.glob("libmujoco*.dylib"), *folder.glob("mujoco.dll")])
    return ctypes.CDLL(str(found[0]))


def function_address(name: str) -> int:
    """Return the address of a function of the library."""
    return int(ctypes.cast(getattr(library(), name), ctypes.c_void_p).value or 0)


def _callback(name: str) -> ctypes.c_void_p:
    """Return the place of a global callback, whose `value` is the function's address, None without one."""
    return ctypes.c_void_p.in_dll(library(), name)


class _Replacement:
    """Replaces a global callback while any thread is inside; afterwards the previous one is restored. `function`
    returns the address of the other function, when it is first needed; `wanted`, whether to replace the current one."""

    def __init__(self, name: str, function: Callable[[], int], wanted: Callable[[], bool]):
        self._name, self._function, self._wanted = name, function, wanted
        self._lock = threading.Lock()
        self._inside = 0
        self._before: int | None = None

    @contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            ours = self._inside > 0 or self._wanted()
            if ours:
                if self._inside == 0:
                    place = _callback(self._name)
                    self._before, place.value = place.value, self._function()
                self._inside += 1
        try:
            yield
        finally:
            if ours:
                with self._lock:
                    self._inside -= 1
                    if self._inside == 0:
                        _callback(self._name).value = self._before


_ignore = ctypes.CFUNCTYPE(None, ctypes.c_char_p)(lambda message: None)
quiet = _Replacement(
    "mju_user_warning",
    lambda: int(ctypes.cast(_ignore, ctypes.c_void_p).value or 0),
    lambda: not _callback("mju_user_warning").value,
)
"""`with quiet():` suppresses MuJoCo's warnings on the terminal and in MUJOCO_LOG.TXT; it still counts them (`mjData.warning`).
Several threads may enter it. Another handler is kept."""


def _no_time():
    return 0.0


@cache
def _clock_stopped() -> Any:
    return c_function(types.float64(), _no_time)


def _no_own_clock() -> bool:
    import mujoco

    return mujoco.get_mjcb_time() is None


untimed = _Replacement("mjcb_time", lambda: int(_clock_stopped().address), _no_own_clock)
"""`with untimed():` stops MuJoCo's clock for `mjData.timer`, which takes a fifth of a step. MuJoCo's Python package installs
that clock. Several threads may enter; another clock is kept. It is stopped, not removed, as another thread may be about to
call it."""


@cache
def offsets() -> dict[str, int]:
    """Return offsets, in words of 8 bytes, of the fields for compiled code: sizes and arrays of mjModel and mjData by
    name, `timestep` of mjModel's options, `time` of mjData and, in words of 4 bytes, `disableflags` of mjModel's
    options."""
    import mujoco
    from mujoco.introspect import structs

    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j"/><geom size="1"/></body></worldbody>'
        '<tendon><fixed><joint joint="j" coef="1"/></fixed></tendon></mujoco>'
    )
    data = mujoco.MjData(model)
    found: dict[str, int] = {}
    for struct, instance, first, known in (("mjModel", model, "qpos0", "body_ipos"), ("mjData", data, "qpos", "qvel")):
        names = [field.name for field in structs.STRUCTS[struct].fields]
        begin = find(instance._address, getattr(instance, known).ctypes.data) - names.index(known)
        found |= {name: begin + i for i, name in enumerate(names) if i >= names.index(first)}  # one pointer each
    names = [field.name for field in structs.STRUCTS["mjModel"].fields]
    found |= {name: i for i, name in enumerate(names[: names.index("opt")])}  # the sizes come first, one word each
    for name, instance, expected in (
        ("wrap_prm", model, model.wrap_prm.ctypes.data), ("qfrc_passive", data, data.qfrc_passive.ctypes.data),
        ("ntendon", model, 1),
    ):  # fmt: skip
        if ctypes.c_uint64.from_address(instance._address + 8 * found[name]).value != expected:
            raise RuntimeError(f"MuJoCo {mujoco.__version__}: its structures have an unknown layout")
    model.opt.disableflags, model.opt.timestep, data.time = 0x5C3A6E17, 2.3456781e-77, 1.2345678e-77
    found["disableflags"] = find(model._address, model.opt.disableflags, ctypes.c_uint32)
    found["timestep"] = find(model._address, int(np.float64(model.opt.timestep).view(np.uint64)))
    found["time"] = find(data._address, int(np.float64(data.time).view(np.uint64)))
    return found


def find(address: int, value: int, word: type[ctypes.c_uint64] | type[ctypes.c_uint32] = ctypes.c_uint64) -> int:
    """Return the index of the first word from an address on with a value."""
    size = ctypes.sizeof(word)
    for begin in range(0, _FARTHEST // size, _AT_ONCE):
        words = np.array((word * _AT_ONCE).from_address(address + size * begin))
        found = np.flatnonzero(words == value)
        if len(found):
            return begin + int(found[0])
    raise RuntimeError("MuJoCo: a structure has an unknown layout")
