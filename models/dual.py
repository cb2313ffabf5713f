"""Dual numbers: compiled forward-mode automatic differentiation.

A dual number is a value with its derivatives in `LANES` directions, a + b₁ε₁ + … + bₙεₙ with εᵢεⱼ = 0 (Griewank &
Walther, *Evaluating Derivatives*, 2008, chapter 3). A kernel that takes a record of numbers also takes one of dual
numbers, and computes the same values and, by the chain rule, their exact derivatives. The derivatives of a number are
one vector register, so a dozen of them cost about as much as the value.

Branches follow the value. Two numbers are equal only if their derivatives are, too: an absent effect with a
derivative is not skipped.

Sine, cosine and exponential of plain and dual numbers are faster than the C library's.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.cgutils import create_struct_proxy
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_cast,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    overload,
    register_model,
)

from .kernels import kernel

LANES = 8  # number of directions of a dual number's derivatives

_DOUBLE, _INDEX = ir.DoubleType(), ir.IntType(64)
_VECTOR = ir.VectorType(_DOUBLE, LANES)
# π/2 in three parts, two of 33 bits: whole multiples up to 2²⁰ are exact (Cody & Waite; numbers of Sun's fdlibm).
_QUARTER = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_FAR = 1e6  # rad: beyond, the C library
_SMALL = 0.5
_CONTRACT = ("contract", "reassoc")  # products and sums of derivatives may be fused
_REAL = (types.Float, types.Integer)


# --- types -----------------------------------------------------------------------------------------------------------


class _Tangent(types.Type):
    pass


class Dual(types.Type):
    """A dual number. A plain number becomes one with zero derivatives."""

    def unify(self, typingctx: Any, other: types.Type) -> types.Type | None:
        return self if isinstance(other, _REAL) else None

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        return Conversion.safe if isinstance(other, _REAL) else None


class _Memory(types.Type):
    """Values and their derivatives in the caller's memory."""


class DualRecord(_Memory):
    """A record of dual numbers, as a `types.Record` of float64 fields."""

    def __init__(self, record: types.Record):
        self.record = record
        super().__init__(f"DualRecord({record})")


class DualArray(_Memory):
    """An array of dual numbers, of their records, or of rows, which are arrays with a `count` known at compile time."""

    def __init__(self, item: types.Type, count: int = 0):
        self.item, self.count = item, count
        super().__init__(f"DualArray({item}, {count})")


tangent, dual = _Tangent("Tangent"), Dual("Dual")


@register_model(_Tangent)
class _TangentModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: types.Type):
        super().__init__(manager, kind, _VECTOR)


@register_model(Dual)
class _DualModel(models.StructModel):
    def __init__(self, manager: Any, kind: types.Type):
        super().__init__(manager, kind, [("value", types.float64), ("tangent", tangent)])


@register_model(DualRecord)
@register_model(DualArray)
class _MemoryModel(models.StructModel):
    def __init__(self, manager: Any, kind: types.Type):
        numbers = types.CPointer(types.float64)
        super().__init__(manager, kind, [("values", numbers), ("tangents", numbers), ("length", types.intp)])


# --- arithmetic ------------------------------------------------------------------------------------------------------


def _splat(builder: Any, x: Any) -> Any:
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), x, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), mask)


def _parts(context: Any, builder: Any, kind: types.Type, x: Any) -> tuple[Any, Any]:
    """Return value and derivatives; None for those of a plain number."""
    if kind == dual:
        pair = create_struct_proxy(dual)(context, builder, value=x)
        return pair.value, pair.tangent
    return context.cast(builder, x, kind, types.float64), None


def _made(context: Any, builder: Any, value: Any, derivatives: Any) -> Any:
    pair = create_struct_proxy(dual)(context, builder)
    pair.value, pair.tangent = value, derivatives
    return pair._getvalue()


def _times(builder: Any, derivatives: Any, factor: Any) -> Any:
    return None if derivatives is None else builder.fmul(derivatives, _splat(builder, factor), flags=_CONTRACT)


def _plus(builder: Any, a: Any, b: Any) -> Any:
    if a is None or b is None:
        return a if b is None else b
    return builder.fadd(a, b, flags=_CONTRACT)


def _minus(builder: Any, a: Any) -> Any:
    return None if a is None else builder.fneg(a)


def _add(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> tuple[Any, Any]:
    return builder.fadd(x, y), _plus(builder, dx, dy)


def _sub(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> tuple[Any, Any]:
    if dx is not None and dy is not None:
        return builder.fsub(x, y), builder.fsub(dx, dy, flags=_CONTRACT)
    return builder.fsub(x, y), _plus(builder, dx, _minus(builder, dy))


def _mul(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> tuple[Any, Any]:
    return builder.fmul(x, y), _plus(builder, _times(builder, dx, y), _times(builder, dy, x))


def _div(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> tuple[Any, Any]:
    ratio, inverse = builder.fdiv(x, y), builder.fdiv(ir.Constant(_DOUBLE, 1.0), y)
    change = _plus(builder, dx, _minus(builder, _times(builder, dy, ratio)))
    return ratio, _times(builder, change, inverse)


_OPERATIONS: dict[Any, Callable[..., tuple[Any, Any]]] = {
    operator.add: _add, operator.iadd: _add, operator.sub: _sub, operator.isub: _sub, operator.mul: _mul,
    operator.imul: _mul, operator.truediv: _div, operator.itruediv: _div,
}  # fmt: skip
_COMPARISONS = {operator.lt: "<", operator.le: "<=", operator.gt: ">", operator.ge: ">="}
_PAIRS = ((Dual, Dual), (Dual, types.Float), (types.Float, Dual), (Dual, types.Integer), (types.Integer, Dual))


def _is_pair(args: tuple[types.Type, ...]) -> bool:
    return len(args) == 2 and dual in args and all(a == dual or isinstance(a, _REAL) for a in args)


def _register(name: Any, result: types.Type, lowered: Callable[..., Any]) -> None:
    """Define an operation on a pair: `lowered(builder, x, dx, y, dy)`, value and derivatives or a truth value."""

    @infer_global(name)
    class _Typed(AbstractTemplate):
        def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
            return signature(result, *args) if _is_pair(args) else None

    def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        (x, dx), (y, dy) = (_parts(context, builder, k, a) for k, a in zip(sig.args, args, strict=True))
        found = lowered(builder, x, dx, y, dy)
        return _made(context, builder, *found) if result == dual else found

    for pair in _PAIRS:
        lower_builtin(name, *pair)(lower)


def _differ(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> Any:
    zero = ir.Constant(_VECTOR, [0.0] * LANES)
    apart = builder.fcmp_unordered("!=", dx or zero, dy or zero)
    any_apart = builder.icmp_unsigned("!=", builder.bitcast(apart, ir.IntType(LANES)), ir.IntType(LANES)(0))
    return builder.or_(builder.fcmp_unordered("!=", x, y), any_apart)


for _name, _operation in _OPERATIONS.items():
    _register(_name, dual, _operation)
for _name, _symbol in _COMPARISONS.items():
    _register(_name, types.boolean, lambda builder, x, dx, y, dy, sign=_symbol: builder.fcmp_ordered(sign, x, y))
_register(operator.ne, types.boolean, _differ)
_register(operator.eq, types.boolean, lambda builder, *parts: builder.not_(_differ(builder, *parts)))


@lower_cast(types.Float, Dual)
@lower_cast(types.Integer, Dual)
def _lower_cast(context: Any, builder: Any, fromty: types.Type, toty: types.Type, x: Any) -> Any:
    value, _ = _parts(context, builder, fromty, x)
    return _made(context, builder, value, ir.Constant(_VECTOR, [0.0] * LANES))


# --- functions -------------------------------------------------------------------------------------------------------


@intrinsic
def _value(typingctx: Any, x: Any) -> Any:
    def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        return _parts(context, builder, sig.args[0], args[0])[0]

    return types.float64(x), lower


value_of: Any = _value
"""`value_of(x)` in a kernel: the value of a dual number without its derivatives; a plain number unchanged."""


@intrinsic
def _chain_rule(typingctx: Any, x: Any, value: Any, slope: Any) -> Any:
    """A function of a dual number with known value and slope."""

    def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        _, derivatives = _parts(context, builder, sig.args[0], args[0])
        return _made(context, builder, args[1], _times(builder, derivatives, args[2]))

    return dual(x, types.float64, types.float64), lower


chained: Any = _chain_rule
"""`chained(x, value, slope)` in a kernel: a function of a dual number with known value and slope."""


def _exp(x):
    y = math.exp(value_of(x))
    return chained(x, y, y)


def _sqrt(x):
    y = math.sqrt(value_of(x))
    return chained(x, y, 0.5 / y)


def _tanh(x):
    y = math.tanh(value_of(x))
    return chained(x, y, 1.0 - y * y)


_FUNCTIONS: dict[Any, Callable[[Any], Any]] = {
    math.exp: _exp,
    math.expm1: lambda x: chained(x, math.expm1(value_of(x)), math.exp(value_of(x))),
    math.log: lambda x: chained(x, math.log(value_of(x)), 1.0 / value_of(x)),
    math.sqrt: _sqrt,
    math.tanh: _tanh,
    operator.neg: lambda x: chained(x, -value_of(x), -1.0),
    math.sin: lambda x: sincos(x)[0],
    math.cos: lambda x: sincos(x)[1],
    math.floor: lambda x: math.floor(value_of(x)),
    np.sign: lambda x: np.sign(value_of(x)),
    abs: lambda x: x if value_of(x) >= 0.0 else -x,
}


def _overload(function: Any, kernel: Callable[[Any], Any]) -> None:
    overload(function)(lambda x: kernel if x == dual else None)


for _function, _kernel in _FUNCTIONS.items():
    _overload(_function, _kernel)


@overload(min)
def _min(a, b):
    if _is_pair((a, b)):
        return lambda a, b: b if value_of(b) < value_of(a) else a
    return None


@overload(max)
def _max(a, b):
    if _is_pair((a, b)):
        return lambda a, b: b if value_of(b) > value_of(a) else a
    return None


@overload(operator.pow)
def _pow(x, y):
    if not _is_pair((x, y)):
        return None
    if y == dual:

        def power(x, y):
            base = value_of(x)
            whole = base ** value_of(y)
            return chained(y, whole, whole * math.log(base)) + (x - base) * (value_of(y) * base ** (value_of(y) - 1.0))

        return power

    def fixed(x, y):
        return chained(x, value_of(x) ** y, y * value_of(x) ** (y - 1))

    return fixed


# --- elementary functions faster than the C library's, exact to the last digit or two -------------------------------
# A replay spends a third of its time in sines and exponentials.


def sincos(x):
    """Return sine and cosine of an angle [rad], within 2e-16 of the exact ones (likewise for a dual number)."""
    return _sincos(x)


@kernel(forceinline=True)
def _sincos(x):
    """Reduce to ±π/4 about a multiple of π/2, then use fdlibm's polynomials (k_sin, k_cos)."""
    if not abs(x) < _FAR:
        return math.sin(x), math.cos(x)
    n = math.floor(x * (2.0 / math.pi) + 0.5)
    r = ((x - n * _QUARTER[0]) - n * _QUARTER[1]) - n * _QUARTER[2]
    z = r * r
    zz = z * z
    s = -1.98412698295895385996e-4 + z * 2.75573136213857245213e-6
    s += zz * (-2.50507477628578072866e-8 + z * 1.58962301576546568060e-10)
    s = r + r * z * (-1.66666666666666307295e-1 + z * 8.33333333332211858878e-3 + zz * s)
    c = 2.48015872888517045348e-5 - z * 2.75573141792967388112e-7
    c += zz * (2.08757008419747316778e-9 - z * 1.13585365213876817300e-11)
    c = 1.0 - 0.5 * z + zz * (4.16666666666665929218e-2 - z * 1.38888888888730564116e-3 + zz * c)
    # Without branches, which turning angles make hard to predict.
    sine, cosine = (s, c) if n & 1 == 0 else (c, s)
    return sine * (1.0 - (n & 2)), cosine * (1.0 - (n + 1 & 2))


@overload(sincos)
def _sincos_of(x):
    if x != dual:
        return lambda x: _sincos(x)

    def both(x):
        s, c = _sincos(value_of(x))
        return chained(x, s, c), chained(x, c, -s)

    return both


@kernel(forceinline=True)
def decayed(x):
    """Return 1 − exp(−x) for x ≥ 0, exact near zero; `expm1` takes several times as long as `exp`."""
    return 1.0 - math.exp(-x) if value_of(x) > _SMALL else -math.expm1(-x)


# --- memory ----------------------------------------------------------------------------------------------------------


def _size(kind: types.Type) -> int:
    """Return how many numbers a number, a record or a row has."""
    if isinstance(kind, DualArray):
        return kind.count * _size(kind.item)
    return kind.record.size // 8 if isinstance(kind, DualRecord) else 1


def _at(context: Any, builder: Any, kind: types.Type, memory: Any, offset: Any) -> tuple[Any, Any]:
    """Return the addresses of values and derivatives from an offset in memory on."""
    m = create_struct_proxy(kind)(context, builder, value=memory)
    return builder.gep(m.values, [offset]), builder.gep(m.tangents, [builder.mul(offset, _INDEX(LANES))])


def _found(context: Any, builder: Any, kind: types.Type, memory: Any, offset: Any, item: types.Type) -> Any:
    """Return the number at an offset, or the record or row that starts there."""
    values, tangents = _at(context, builder, kind, memory, offset)
    if item == dual:
        derivatives = builder.bitcast(tangents, _VECTOR.as_pointer())
        return _made(context, builder, builder.load(values), builder.load(derivatives, align=8))
    part = create_struct_proxy(item)(context, builder)
    part.values, part.tangents, part.length = values, tangents, _INDEX(getattr(item, "count", 0))
    return part._getvalue()


def _stored(context: Any, builder: Any, kind: types.Type, memory: Any, offset: Any, number: Any) -> None:
    values, tangents = _at(context, builder, kind, memory, offset)
    x, dx = _parts(context, builder, dual, number)
    builder.store(x, values)
    builder.store(dx, builder.bitcast(tangents, _VECTOR.as_pointer()), align=8)


def _field(kind: DualRecord, name: str) -> tuple[types.Type, Any]:
    """Return type and offset of a field."""
    of: Any = kind.record.typeof(name)
    item: types.Type = dual
    for count in reversed(of.shape) if isinstance(of, types.NestedArray) else ():
        item = DualArray(item, count)
    return item, _INDEX(kind.record.offset(name) // 8)


@infer_getattr
class _Fields(AttributeTemplate):
    key = DualRecord

    def generic_resolve(self, kind: Any, name: str) -> Any:  # type: ignore[override]
        return _field(kind, name)[0] if name in kind.record.fields else None


@lower_getattr_generic(DualRecord)
def _lower_getattr(context: Any, builder: Any, kind: DualRecord, record: Any, name: str) -> Any:
    item, offset = _field(kind, name)
    return _found(context, builder, kind, record, offset, item)


@lower_setattr_generic(DualRecord)
def _lower_setattr(context: Any, builder: Any, sig: Any, args: tuple[Any, ...], name: str) -> None:
    _stored(context, builder, sig.args[0], args[0], _field(sig.args[0], name)[1], args[1])


_PAIR_OF_INDICES = types.UniTuple(types.intp, 2)


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
        memory, index = args
        if isinstance(memory, DualArray):
            if isinstance(index, types.Integer):
                return signature(memory.item, memory, types.intp)
            if isinstance(index, types.BaseTuple) and len(index) == 2 and isinstance(memory.item, DualArray):
                return signature(memory.item.item, memory, _PAIR_OF_INDICES)
        return None


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
        memory, index, _ = args
        if isinstance(memory, DualArray) and isinstance(index, types.BaseTuple):
            return signature(types.none, memory, _PAIR_OF_INDICES, dual)
        return None


def _offset(builder: Any, kind: Any, index: Any) -> Any:
    row, column = (builder.extract_value(index, i) for i in range(2))
    return builder.add(builder.mul(row, _INDEX(_size(kind.item))), column)


@lower_builtin(operator.getitem, DualArray, types.Integer)
def _lower_getitem(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
    offset = builder.mul(args[1], _INDEX(_size(sig.return_type)))
    return _found(context, builder, sig.args[0], args[0], offset, sig.return_type)


@lower_builtin(operator.getitem, DualArray, types.UniTuple)
def _lower_getitem_2d(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
    return _found(context, builder, sig.args[0], args[0], _offset(builder, sig.args[0], args[1]), dual)


@lower_builtin(operator.setitem, DualArray, types.UniTuple, Dual)
def _lower_setitem(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
    _stored(context, builder, sig.args[0], args[0], _offset(builder, sig.args[0], args[1]), args[2])
    return context.get_dummy_value()


@infer_global(len)
class _Length(AbstractTemplate):
    def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
        return signature(types.intp, *args) if isinstance(args[0], DualArray) else None


@lower_builtin(len, DualArray)
def _lower_length(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
    return create_struct_proxy(sig.args[0])(context, builder, value=args[0]).length


def _memory(kind: Callable[[Any], _Memory], shaped: Callable[[Any], bool]) -> Any:
    """Return an intrinsic that views two arrays as dual numbers: values, and derivatives of shape (…, LANES)."""

    def typed(typingctx: Any, values: Any, tangents: Any) -> Any:
        if not (isinstance(values, types.Array) and shaped(values) and values.layout == tangents.layout == "C"):
            return None

        def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
            numbers = context.get_value_type(types.CPointer(types.float64))
            found = create_struct_proxy(sig.return_type)(context, builder)
            a, b = (create_struct_proxy(k)(context, builder, value=x) for k, x in zip(sig.args, args, strict=True))
            found.values = builder.bitcast(a.data, numbers)
            found.tangents = builder.bitcast(b.data, numbers)
            found.length = builder.extract_value(a.shape, 0)
            return found._getvalue()

        return kind(values)(values, tangents), lower

    return intrinsic(typed)


dual_records = _memory(
    lambda values: DualArray(DualRecord(values.dtype)),
    lambda values: values.ndim == 1 and isinstance(values.dtype, types.Record),
)
"""`dual_records(values, tangents)` in a kernel: writable records of dual numbers. Values: shape (n,), records of
float64 fields; tangents: shape (n, fields, LANES), both C-contiguous."""


def dual_table(columns: int) -> Any:
    """Return `table(values, tangents)` for kernels: an array of dual numbers, shape (n, columns), tangents (n,
    columns, LANES)."""
    return _memory(lambda values: DualArray(DualArray(dual, columns)), lambda values: values.ndim == 2)
