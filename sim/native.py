"""Fields of MuJoCo's C structures, and addresses of its functions.

Compiled code gets the addresses of an mjModel and an mjData, and the offsets of their fields by MuJoCo's introspection.
MuJoCo is imported on use: `import mujoco` itself may run this (`flexspline.__init__`).
"""

from __future__ import annotations

import ctypes
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from numba import types

from ..models.kernels import c_function


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


_TYPES = {
    "mjtNum": ctypes.c_double, "float": ctypes.c_float, "mjtSize": ctypes.c_int64, "mjtBool": ctypes.c_bool,
    "size_t": ctypes.c_size_t, "uintptr_t": ctypes.c_size_t, "uint64_t": ctypes.c_uint64,
}  # fmt: skip
"""Types of C by their names in MuJoCo's structures; others are int."""


def _type(kind: Any) -> Any:
    """Return a type of MuJoCo's introspection as one of ctypes."""
    from mujoco.introspect import ast_nodes, structs

    if isinstance(kind, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(kind, ast_nodes.ArrayType):
        return _type(kind.inner_type) * math.prod(kind.extents)
    fields = getattr(structs.STRUCTS.get(getattr(kind, "name", ""), kind), "fields", None)
    if fields is None:
        return _TYPES.get(kind.name, ctypes.c_int)
    return type("Structure", (ctypes.Structure,), {"_fields_": [(one.name, _type(one.type)) for one in fields]})


@cache
def offsets() -> dict[str, int]:
    """Return offsets, in words of 8 bytes, of the fields for compiled code: sizes and arrays of mjModel and mjData by
    name, `timestep` of mjModel's options, `time` of mjData and, in words of 4 bytes, `disableflags` of mjModel's
    options. Raises `RuntimeError`: a MuJoCo whose structures are not as it states."""
    import mujoco
    from mujoco.introspect import structs

    of_model, of_data = (_type(structs.STRUCTS[name]) for name in ("mjModel", "mjData"))
    found = {name: getattr(of_model, name).offset // 8 for name, _ in of_model._fields_}
    arrays = [name for name, kind in of_data._fields_ if kind is ctypes.c_void_p]
    found |= {name: getattr(of_data, name).offset // 8 for name in (*arrays, "time")}
    options = _type(structs.STRUCTS["mjOption"])
    found["timestep"] = (of_model.opt.offset + options.timestep.offset) // 8
    found["disableflags"] = (of_model.opt.offset + options.disableflags.offset) // 4
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    for one, name in ((model, "body_ipos"), (mujoco.MjData(model), "xpos")):
        if ctypes.c_uint64.from_address(one._address + 8 * found[name]).value != getattr(one, name).ctypes.data:
            raise RuntimeError(f"MuJoCo {mujoco.__version__}: its structures have an unknown layout")
    return found
