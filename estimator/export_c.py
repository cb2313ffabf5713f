"""An estimator's step as one C99 header, generated from Numba's typed intermediate code.

Every kernel of a step is printed as C, one function per set of argument types. Records and arrays of float64 become
pointers; named tuples become structures.
"""

from __future__ import annotations

import builtins
import math
import operator
import re
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import ir, types
from numba.core.compiler import run_frontend
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target
from numba.core.typed_passes import type_inference_stage
from numba.np.numpy_support import from_dtype

from ..models import dual
from ..models.errors import InputError
from ..models.step import OK, SAMPLE, Step
from .estimator import CausalEstimator, KnownJoint

_MATH = frozenset(
    "fabs pow hypot atan2 copysign fmod sin cos tan asin acos atan sinh cosh tanh exp expm1 log log1p sqrt".split()
)
_VALUELESS = (
    types.NoneType, types.Dispatcher, types.Function, types.Module, types.SliceType, types.NumberClass,
    types.NamedTupleClass,
)  # fmt: skip
_NUMBER = bool | int | float | np.number
_BINARY = {
    operator.add: "+", operator.sub: "-", operator.mul: "*", operator.lt: "<", operator.le: "<=", operator.gt: ">",
    operator.ge: ">=", operator.eq: "==", operator.ne: "!=", operator.and_: "&", operator.or_: "|", operator.iadd: "+",
    operator.isub: "-", operator.imul: "*",
}  # fmt: skip
_UNARY = {operator.not_: "!", operator.neg: "-"}
_TYPES = (
    (types.Boolean, "int"), (types.Integer, "int64_t"), (types.Float, "double"), (types.Record, "double *"),
    (types.RangeType, "fs_range"), (types.RangeIteratorType, "fs_range"),
)  # fmt: skip
"""C types of Numba's."""
_PREFIX = {
    abs: "fabs", math.fabs: "fabs", float: "(double)", int: "(int64_t)", math.floor: "(int64_t)floor",
    math.ceil: "(int64_t)ceil", math.isfinite: "0 != isfinite", np.isfinite: "0 != isfinite", math.isnan: "0 != isnan",
    np.isnan: "0 != isnan", np.sign: "fs_sign",
}  # fmt: skip
"""C before the argument, in brackets, of functions of one argument."""
_HELPERS = """
typedef struct { double *p; int64_t n[2]; } fs_array;
typedef struct { int64_t at, stop, step; } fs_range;
static inline int64_t fs_mod(int64_t a, int64_t b) { int64_t r = a % b; return r != 0 && ((r < 0) != (b < 0)) ? r + b : r; }
static inline int64_t fs_div(int64_t a, int64_t b) { return (a - fs_mod(a, b)) / b; }
static inline double fs_fmod(double a, double b)
{ double r = fmod(a, b); return r != 0.0 && ((r < 0.0) != (b < 0.0)) ? r + b : r; }
static inline double fs_sign(double x) { return x > 0.0 ? 1.0 : (x < 0.0 ? -1.0 : x); }
static inline void fs_fill(fs_array a, double x)
{ int64_t i, n = a.n[0] * (a.n[1] > 0 ? a.n[1] : 1); for (i = 0; i < n; ++i) a.p[i] = x; }
"""


_QUIET = (  # the compiled code has labels and variables for every case
    "#ifdef __GNUC__",
    "#pragma GCC diagnostic push",
    '#pragma GCC diagnostic ignored "-Wunused-but-set-variable"',
    '#pragma GCC diagnostic ignored "-Wunused-label"',
    "#endif",
)
_LOUD = ("#ifdef __GNUC__", "#pragma GCC diagnostic pop", "#endif")


def header(estimator: CausalEstimator, joint: KnownJoint, interval: float) -> str:
    """Return an estimator's step for a joint's numbers as the text of a C99 header; the estimator is scaled to the
    joint and to the `interval` [s] between samples. Raises `InputError`: a step that is not compiled, or code without a
    C equivalent."""
    name = re.sub(r"\W", "_", estimator.name.lower())
    step = estimator.step(joint, interval)
    compiled = estimator.compiled
    if not isinstance(compiled, Step):
        raise InputError(f"estimator {estimator.name!r}: expected a compiled step, got one in Python")
    unit = _Unit(name)
    entry = unit.function(compiled.function, tuple(map(from_dtype, compiled.records)))
    memory = max(step.memory, 1)
    record = np.frombuffer(step.record.tobytes(), dtype=np.float64)
    outputs = " ".join(f"double {output};" for output in estimator.outputs)
    return "\n".join(
        [
            f"/* {estimator.name}: {estimator.description}.",
            f"   For samples {interval:g} s apart. Units: s, A, rad (motor side for motor_position), N*m. What is not",
            "   measured is NAN. interval: 0 at the first sample. Returns 0, or another status where there is no estimate. */",
            f"#ifndef FLEXSPLINE_{name.upper()}_H",
            f"#define FLEXSPLINE_{name.upper()}_H",
            "#include <math.h>",
            "#include <stdint.h>",
            "#include <string.h>",
            *_QUIET,
            "#ifndef FLEXSPLINE_HELPERS",
            "#define FLEXSPLINE_HELPERS",
            _HELPERS.strip(),
            f"typedef struct {{ double {', '.join(SAMPLE.names or ())}; }} flexspline_sample;",
            "static inline flexspline_sample flexspline_no_readings(void)",
            f"{{ const flexspline_sample none = {{{', '.join(['NAN'] * len(SAMPLE.names or ()))}}}; return none; }}",
            "#endif",
            *unit.structures.values(),
            *(f"{head};" for head in unit.heads.values()),
            *unit.bodies.values(),
            _constants(f"{name}_record", record),
            _constants(f"{name}_settings", np.ascontiguousarray(step.settings, dtype=np.float64)),
            f"typedef struct {{ double memory[{memory}]; }} {name}_state;",
            f"typedef struct {{ {outputs} }} {name}_output;",
            f"static inline void {name}_init({name}_state *state) {{ memset(state, 0, sizeof *state); }}",
            f"static inline int {name}_step({name}_state *state, const flexspline_sample *sample, {name}_output *out)",
            f"{{ return (int){entry}(state->memory, (double *)sample, (double *){name}_record, (double *){name}_settings, "
            f"(double *)out) - {OK}; }}",
            *_LOUD,
            "#endif",
            "",
        ]
    )


def _constants(name: str, values: np.ndarray) -> str:
    return f"static const double {name}[{len(values)}] = {{{', '.join(_number(float(x)) for x in values)}}};"


def _variable(name: str) -> str:
    return "v_" + re.sub(r"\W", "_", name)


def _number(value: Any) -> str:
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    if isinstance(value, int | np.integer):
        return f"INT64_C({int(value)})"
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return repr(float(value)) if value >= 0 else f"({float(value)!r})"


class _Unit:
    """The C functions of one header; each is made when it is first called."""

    def __init__(self, prefix: str):
        self.prefix = prefix
        self.structures: dict[str, str] = {}
        self.heads: dict[str, str] = {}
        self.bodies: dict[str, str] = {}
        self._names: dict[Any, str] = {}

    def c_type(self, kind: Any) -> str:
        """The C type of a Numba type."""
        kind = types.unliteral(kind)
        for of, text in _TYPES:
            if isinstance(kind, of):
                return text
        if isinstance(kind, types.Array):
            return "double *" if isinstance(kind.dtype, types.Record) else "fs_array"
        if isinstance(kind, types.BaseTuple):
            members = [self.c_type(member) for member in kind.types]  # type: ignore[attr-defined]
            name = "tuple_" + "_".join(re.sub(r"\W+", "p", member) for member in members)
            return self._structure(name, " ".join(f"{member} f{i};" for i, member in enumerate(members)))
        if isinstance(kind, types.UniTupleIter):
            inner = self.c_type(kind.container)
            return self._structure(f"{inner.removeprefix(f'{self.prefix}_')}_iter", f"{inner} t; int64_t at;")
        if isinstance(kind, types.Pair):
            first = self.c_type(kind.first_type)
            return self._structure("pair_" + re.sub(r"\W+", "p", first), f"{first} first; int second;")
        raise InputError(f"export to C: expected numbers, records, arrays and tuples, got {kind}")

    def _structure(self, name: str, fields: str) -> str:
        name = f"{self.prefix}_{name}"
        self.structures.setdefault(name, f"typedef struct {{ {fields} }} {name};")
        return name

    def function(self, python: Callable[..., Any], arguments: tuple[Any, ...]) -> str:
        """The name of a function for argument types."""
        key = (python, arguments)
        if key not in self._names:
            name = f"{self.prefix}_{python.__name__.strip('_')}_{len(self._names)}"
            self._names[key] = name
            _Function(self, name, python, arguments).write()
        return self._names[key]


class _Function:
    def __init__(self, unit: _Unit, name: str, python: Callable[..., Any], arguments: tuple[Any, ...]):
        self.unit, self.name, self.arguments = unit, name, arguments
        self.code = run_frontend(python)
        context, target = cpu_target.typing_context, cpu_target.target_context
        found = type_inference_stage(context, target, self.code, arguments, None)
        self.types, self.result, self.calls = found.typemap, found.return_type, found.calltypes
        self.known: dict[str, Any] = {}
        lines = [line for block in self.code.blocks.values() for line in block.body]
        self.count = Counter(line.target.name for line in lines if isinstance(line, ir.Assign))

    def of(self, variable: ir.Var) -> str:
        """A variable's value in C."""
        known = self.known.get(variable.name)
        return _number(known) if isinstance(known, _NUMBER) else _variable(variable.name)

    def write(self) -> None:
        """Print head and body."""
        unit = self.unit
        lines = [line for label, block in self.code.blocks.items() for line in self._block(label, block)]
        nothing = isinstance(self.result, types.NoneType)
        result = "void" if nothing else unit.c_type(self.result)
        head = ", ".join(f"{unit.c_type(kind)} a{i}" for i, kind in enumerate(self.arguments)) or "void"
        used = "\n".join(lines)
        names = {_variable(name): kind for name, kind in self.types.items()}
        declared = [f"  {unit.c_type(kind)} {n};" for n, kind in names.items() if re.search(rf"\b{n}\b", used)]
        unit.heads[self.name] = f"static {result} {self.name}({head})"
        unit.bodies[self.name] = "\n".join([unit.heads[self.name], "{", *declared, used, "}"])

    def _block(self, label: int, block: ir.Block) -> list[str]:
        return [f"L{label}: ;", *("  " + text for line in block.body if (text := self._line(line)))]

    def _line(self, line: Any) -> str:
        if isinstance(line, ir.Assign):
            return self._assign(line.target, line.value)
        if isinstance(line, ir.Jump):
            return f"goto L{line.target};"
        if isinstance(line, ir.Branch):
            return f"if ({self.of(line.cond)}) goto L{line.truebr}; else goto L{line.falsebr};"
        if isinstance(line, ir.Return):
            return "return;" if isinstance(self.result, types.NoneType) else f"return {self.of(line.value)};"
        if isinstance(line, ir.SetAttr):
            return f"{self._field(line.target, line.attr)} = {self.of(line.value)};"
        if isinstance(line, ir.SetItem | ir.StaticSetItem):
            index = line.index if isinstance(line, ir.SetItem) else line.index_var
            if isinstance(self.types[index.name], types.SliceType):
                return f"fs_fill({self.of(line.target)}, {self.of(line.value)});"
            return f"{self._element(line.target, index)} = {self.of(line.value)};"
        if isinstance(line, ir.Del):
            return ""
        raise self._none(line)

    def _none(self, what: Any) -> InputError:
        return InputError(f"export to C: {self.code.func_id.func_qualname}: expected code that has C, got {what}")

    def _field(self, target: ir.Var, name: str) -> str:
        offset = self.types[target.name].offset(name) // 8
        return f"{self.of(target)}[{offset}]"

    def _element(self, target: ir.Var, index: ir.Var) -> str:
        kind, at, array = self.types[index.name], self.of(index), self.of(target)
        if self.types[target.name].ndim == 2 and not isinstance(kind, types.BaseTuple):  # a row
            return f"(fs_array){{{array}.p + {at} * {array}.n[1], {{{array}.n[1], 0}}}}"
        if isinstance(kind, types.BaseTuple):
            return f"{array}.p[{at}.f0 * {array}.n[1] + {at}.f1]"
        return f"{array}.p[{at}]"

    def _assign(self, target: ir.Var, value: Any) -> str:
        name, kind = target.name, self.types[target.name]
        if isinstance(value, ir.Global | ir.FreeVar | ir.Const):
            if self.count[name] == 1:
                self.known[name] = value.value
            if isinstance(value.value, tuple):
                members = ", ".join(_number(x) for x in value.value)
                return f"{_variable(name)} = ({self.unit.c_type(kind)}){{{members}}};"
            return f"{_variable(name)} = {_number(value.value)};" if isinstance(value.value, _NUMBER) else ""
        if isinstance(value, ir.Arg):
            return f"{_variable(name)} = a{value.index};"
        if isinstance(value, ir.Var):
            if value.name in self.known and self.count[name] == 1:
                self.known[name] = self.known[value.name]
            return "" if isinstance(kind, _VALUELESS) else f"{_variable(name)} = {self.of(value)};"
        if not isinstance(value, ir.Expr):
            raise self._none(value)
        text = self._expression(target, value)
        if text is None or isinstance(kind, _VALUELESS):
            return f"{text};" if text else ""
        return f"{_variable(name)} = {text};"

    def _expression(self, target: ir.Var, e: ir.Expr) -> str | None:
        kind = self.types[target.name]
        match e.op:
            case "binop" | "inplace_binop":
                return self._binary(e, e.fn if e.op == "binop" else e.immutable_fn)
            case "unary":
                return f"{_UNARY.get(e.fn, '+')}{self.of(e.value)}"
            case "cast":
                return None if isinstance(kind, _VALUELESS) else self.of(e.value)
            case "build_tuple":
                if any(isinstance(self.types[item.name], _VALUELESS) for item in e.items):
                    return None
                return f"({self.unit.c_type(kind)}){{{', '.join(self.of(item) for item in e.items)}}}"
            case "static_getitem" | "getitem":
                return self._item(e)
            case "getiter" if isinstance(self.types[e.value.name], types.BaseTuple):
                return f"({self.unit.c_type(kind)}){{{self.of(e.value)}, 0}}"
            case "getiter" | "exhaust_iter":
                return self.of(e.value)
            case "getattr":
                return self._attribute(target, e)
            case "iternext":
                return self._next(kind, e)
            case "pair_first" | "pair_second":
                return f"{self.of(e.value)}.{e.op.removeprefix('pair_')}"
            case "call":
                return self._call(target, e)
        raise self._none(e)

    def _next(self, kind: Any, e: ir.Expr) -> str:
        at, name = self.of(e.value), self.unit.c_type(kind)
        inner = self.types[e.value.name]
        if isinstance(inner, types.UniTupleIter):
            n = len(inner.container)
            return f"({name}){{{at}.at < {n} ? (&{at}.t.f0)[{at}.at] : (&{at}.t.f0)[0], {at}.at < {n}}}; {at}.at += 1"
        return f"({name}){{{at}.at, {at}.step > 0 ? {at}.at < {at}.stop : {at}.at > {at}.stop}}; {at}.at += {at}.step"

    def _item(self, e: ir.Expr) -> str | None:
        kind = self.types[e.value.name]
        if isinstance(kind, types.BaseTuple):
            if e.op == "static_getitem":
                return f"{self.of(e.value)}.f{e.index % len(kind)}"
            return f"(&{self.of(e.value)}.f0)[{self.of(e.index)}]"
        if isinstance(kind, types.Array) and isinstance(kind.dtype, types.Record):
            return self.of(e.value)  # the one record that is there
        index = e.index_var if e.op == "static_getitem" else e.index
        return self._element(e.value, index)

    def _attribute(self, target: ir.Var, e: ir.Expr) -> str | None:
        kind, name = self.types[e.value.name], target.name
        if isinstance(kind, types.Module):
            self.known[name] = getattr(self.known[e.value.name], e.attr)
            value = self.known[name]
            return _number(value) if isinstance(value, int | float) else None
        if isinstance(kind, types.BaseNamedTuple):
            names: Any = kind
            return f"{self.of(e.value)}.f{names.fields.index(e.attr)}"
        if isinstance(kind, types.Record):
            field = kind.typeof(e.attr)
            at = f"{self.of(e.value)} + {kind.offset(e.attr) // 8}"
            if isinstance(field, types.Record):
                return at
            if isinstance(field, types.NestedArray):
                shape = [*field.shape, 0][:2]
                return f"(fs_array){{{at}, {{{shape[0]}, {shape[1]}}}}}"
            return self._field(e.value, e.attr)
        raise self._none(e)

    def _binary(self, e: ir.Expr, f: Any) -> str:
        a, b = self.of(e.lhs), self.of(e.rhs)
        whole = all(isinstance(self.types[x.name], types.Integer | types.Boolean) for x in (e.lhs, e.rhs))
        if f in (operator.truediv, operator.itruediv):
            return f"(double){a} / (double){b}"
        if f in (operator.pow, operator.ipow):
            n = self.known.get(e.rhs.name)
            if isinstance(n, int) and 0 < n < 9:
                return _power(a, n)
            return f"pow({a}, {b})"
        if f in (operator.floordiv, operator.ifloordiv):
            return f"fs_div({a}, {b})" if whole else f"floor({a} / {b})"
        if f in (operator.mod, operator.imod):
            return f"{'fs_mod' if whole else 'fs_fmod'}({a}, {b})"
        if f in _BINARY:
            return f"{a} {_BINARY[f]} {b}"
        raise self._none(e)

    def _call(self, target: ir.Var, e: ir.Expr) -> str | None:
        f = self.known.get(e.func.name)
        kind = self.types[e.func.name]
        if isinstance(kind, types.Dispatcher):
            f = kind.dispatcher
        arguments = [self.of(x) for x in e.args]
        if isinstance(f, Dispatcher):
            return self._called(f, e)
        if f is dual.value_of:  # of plain numbers
            return arguments[0]
        if f is dual.sincos:
            return self._called(dual._sincos, e)
        if isinstance(f, type) and issubclass(f, tuple):
            return f"({self.unit.c_type(self.types[target.name])}){{{', '.join(arguments)}}}"
        if f in (range, builtins.range):
            bounds = {1: ("0", arguments[0], "1"), 2: (*arguments, "1"), 3: tuple(arguments)}[len(arguments)]
            return f"(fs_range){{{', '.join(bounds)}}}"
        return None if f is slice else self._builtin(f, arguments)

    def _builtin(self, f: Any, arguments: list[str]) -> str:
        if f in (min, max):
            text = arguments[0]
            for other in arguments[1:]:
                text = f"({other} {'<' if f is min else '>'} {text} ? {other} : {text})"
            return text
        if f is bool:
            return f"{arguments[0]} != 0"
        if f in _PREFIX:
            return f"({_PREFIX[f]}({arguments[0]}))"
        name = getattr(f, "__name__", "")
        if name in _MATH and f in (getattr(math, name, None), getattr(np, name, None)):
            return f"{name}({', '.join(arguments)})"
        raise self._none(f"a call of {f}")

    def _called(self, f: Dispatcher, e: ir.Expr) -> str:
        signature = self.calls[e]
        by_name = dict(zip(f.py_func.__code__.co_varnames, e.args, strict=False)) | dict(e.kws)
        given, kinds = [], []
        for name, kind in zip(f.py_func.__code__.co_varnames, signature.args, strict=False):
            if isinstance(kind, types.Omitted):
                given.append(_number(kind.value))
                kind = types.literal(kind.value).literal_type if isinstance(kind.value, int) else types.float64
            else:
                given.append(self.of(by_name[name]))
            kinds.append(types.unliteral(kind))
        return f"{self.unit.function(f.py_func, tuple(kinds))}({', '.join(given)})"


def _power(x: str, n: int) -> str:
    """x to the n-th by squaring, in Numba's order."""
    text, square = "", x
    while n:
        if n & 1:
            text = f"({text} * {square})" if text else square
        n >>= 1
        square = f"({square} * {square})"
    return text
