"""MuJoCo's C structures and functions: where their fields lie, what their addresses are.

Compiled code gets the addresses of an mjModel and an mjData. Where a field lies inside them is found once per
process, by looking for the address that Python's view of the field reports, so that it holds for any build.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

_FARTHEST = 1 << 19  # bytes: beyond the largest structure
_AT_ONCE = 64  # words


@cache
def library() -> ctypes.CDLL:
    """MuJoCo's shared library, the one that the Python bindings use."""
    folder = Path(mujoco.__file__).parent
    found = sorted([*folder.glob("libmujoco.so*"), *folder.glob("libmujoco*.dylib"), *folder.glob("mujoco.dll")])
    return ctypes.CDLL(str(found[0]))


def function_address(name: str) -> int:
    """Address of a function of the library."""
    return int(ctypes.cast(getattr(library(), name), ctypes.c_void_p).value or 0)


def install(name: str, address: int) -> None:
    """Install a C function as a global callback, `mjcb_passive` and the like."""
    ctypes.c_void_p.in_dll(library(), name).value = address


def installed(name: str) -> bool:
    """Whether a global callback is set."""
    return bool(ctypes.c_void_p.in_dll(library(), name).value)


_ignore = ctypes.CFUNCTYPE(None, ctypes.c_char_p)(lambda message: None)
_quiet_runs = 0
_quiet_lock = threading.Lock()


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo from printing its warnings and writing them to MUJOCO_LOG.TXT; it still counts them (`mjData.warning`).

    May be entered by several threads. A handler that somebody else has set is left alone.
    """
    global _quiet_runs
    with _quiet_lock:
        if _quiet_runs > 0 or not installed("mju_user_warning"):
            if _quiet_runs == 0:
                install("mju_user_warning", int(ctypes.cast(_ignore, ctypes.c_void_p).value or 0))
            _quiet_runs += 1
            ours = True
        else:
            ours = False
    try:
        yield
    finally:
        if ours:
            with _quiet_lock:
                _quiet_runs -= 1
                if _quiet_runs == 0:
                    ctypes.c_void_p.in_dll(library(), "mju_user_warning").value = None


@cache
def offsets() -> dict[str, int]:
    """Offsets, in 8-byte words, of the fields that compiled code reads.

    Keys: `numeric_data`, `nnumericdata` of mjModel; `time`, `qpos`, `qvel`, `act`, `ctrl`, `qfrc_passive`,
    `xfrc_applied`, `sensordata` of mjData.
    """
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><custom><numeric name="n" data="1 2 3"/></custom><worldbody><body><joint name="j"/>'
        '<geom size="1"/></body></worldbody><actuator><dcmotor joint="j" motorconst="1 1" resistance="1"'
        ' inductance="1 0"/></actuator><sensor><jointpos joint="j"/></sensor></mujoco>'
    )
    data = mujoco.MjData(model)
    found = {"numeric_data": _find(model._address, model.numeric_data.ctypes.data)}
    names = [field.name for field in _model_fields()]
    found["nnumericdata"] = names.index("nnumericdata")  # the sizes stand first, one word each
    if ctypes.c_int64.from_address(model._address + 8 * found["nnumericdata"]).value != 3:
        raise RuntimeError(f"MuJoCo {mujoco.__version__}: mjModel is laid out in an unknown way")
    for name in ("qpos", "qvel", "act", "ctrl", "qfrc_passive", "xfrc_applied", "sensordata"):
        found[name] = _find(data._address, getattr(data, name).ctypes.data)
    data.time = 1.2345678e-77
    found["time"] = _find(data._address, int(np.float64(data.time).view(np.uint64)))
    return found


def _model_fields() -> tuple[Any, ...]:
    from mujoco.introspect import structs

    return tuple(structs.STRUCTS["mjModel"].fields)


def _find(address: int, value: int) -> int:
    """The first word at an address, and behind it, that holds a value."""
    for begin in range(0, _FARTHEST // 8, _AT_ONCE):
        words = np.array((ctypes.c_uint64 * _AT_ONCE).from_address(address + 8 * begin))
        found = np.flatnonzero(words == np.uint64(value))
        if len(found):
            return begin + int(found[0])
    raise RuntimeError(f"MuJoCo {mujoco.__version__}: a structure is laid out in an unknown way")
