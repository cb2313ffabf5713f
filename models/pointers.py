"""Memory by address in compiled code: MuJoCo's structures, and arguments of this package's C functions."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic as numba_intrinsic
from numba.np.numpy_support import from_dtype

from .parameters import PARAMETERS

intrinsic: Any = numba_intrinsic  # typed: the result takes no typing context, unlike its function


def _pointer(kind: Any) -> Any:
    @intrinsic
    def pointer(typingctx, address):
        def codegen(context, builder, signature, args):
            return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.intp), codegen

    return pointer


floats_at = _pointer(types.float64)  # pointer to float64 at an integer address
ints_at = _pointer(types.int32)  # pointer to int32 at an integer address
record_at = _pointer(from_dtype(PARAMETERS))  # pointer to a parameter record; `carray(…, 1)[0]` is the record


@intrinsic
def word_at(typingctx, address):
    """The 8-byte integer (a size, a pointer) at an integer address."""

    def codegen(context, builder, signature, args):
        return builder.load(builder.inttoptr(args[0], ir.IntType(64).as_pointer()))

    return types.int64(types.intp), codegen


@intrinsic
def call_step(typingctx, function, model, data):
    """Call a C function `void f(const mjModel*, mjData*)` by address, without Python."""

    def codegen(context, builder, signature, args):
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        f = builder.inttoptr(args[0], kind.as_pointer())
        builder.call(f, [builder.inttoptr(args[1], pointer), builder.inttoptr(args[2], pointer)])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp), codegen


@intrinsic
def call_estimator(typingctx, function, memory, sample, record, settings, out):
    """Call a C function `int64 f(void*, void*, void*, void*, void*)` by address, without Python."""

    def codegen(context, builder, signature, args):
        kind = ir.FunctionType(ir.IntType(64), [ir.IntType(64)] * 5)
        f = builder.inttoptr(args[0], kind.as_pointer())
        return builder.call(f, list(args[1:]))

    return types.int64(*[types.intp] * 6), codegen
