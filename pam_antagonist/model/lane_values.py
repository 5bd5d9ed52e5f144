"""Four or eight numbers that one instruction works on: a type for compiled code, with the operators of a number.

A kernel on such *lanes* computes as many results at once: lane k of every result has the bits that the kernel gives for
the numbers in lane k of its arguments. The processor has the instructions (AVX-512, AVX or SSE), or LLVM uses several
smaller ones; the bits are the same.

A comparison of lanes gives a *mask*, a truth value for each. An ``if`` cannot take two branches at once: :func:`some`
says whether any lane takes a branch, and :func:`where` chooses between the results of two branches, lane by lane.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from numba.core import cgutils, codegen, config, types
from numba.core.typing import signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model, type_callable

# The builder of LLVM code that numba uses.
ir: Any = cgutils.ir


def width(features: str) -> tuple[int, int]:
    """How many numbers a step in lanes takes, and from how many on it is faster than one number after another.

    With AVX2, eight numbers need two registers: they take as long a number as four, and fill up more rarely.

    `features`: what the processor can do, in LLVM's words, separated by commas. Returns both, as measured. With SSE2
    alone, a step in lanes is never faster.
    """
    each = features.split(",")
    if "+avx512f" in each:
        return 8, 3
    return (4, 2) if "+avx2" in each else (4, 5)


LANES, FEWEST = width(config.CPU_FEATURES or codegen.get_host_cpu_features())
CHUNK = 64
"""Samples of all lanes that are collected before they are copied to each model: so many fit into the cache."""
_DOUBLE, _BIT, _INDEX = ir.DoubleType(), ir.IntType(1), ir.IntType(32)
_LANES, _MASK = ir.VectorType(_DOUBLE, LANES), ir.VectorType(_BIT, LANES)


class _Wide(types.Type):  # type: ignore[misc]
    """LANES numbers, or LANES truth values."""

    def __init__(self, name: str, of: Any, single: Any) -> None:
        super().__init__(name=name)
        self.of, self.single = of, single  # kind of a value that goes into each lane, and its type for one lane

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        """A number, or a truth value, is the same in each lane."""
        return typingctx.can_convert(other, self.single) if isinstance(other, self.of) else None

    def unify(self, typingctx: Any, other: Any) -> Any:
        """A variable that is lanes in one branch and a number in the other is lanes after both; likewise a mask."""
        return self if isinstance(other, self.of) else None


class _LanesType(_Wide):
    """LANES float64."""


class _MaskType(_Wide):
    """LANES truth values."""


lanes = _LanesType("lanes", types.Number, types.float64)
mask = _MaskType("mask", types.Boolean, types.boolean)


def _in_registers(kind: _Wide, whole: Any) -> None:
    """Tell numba how lanes or a mask are kept, and how one value is spread over the lanes."""

    @register_model(type(kind))
    class _Model(models.PrimitiveModel):  # type: ignore[misc]
        def __init__(self, dmm: Any, fe_type: Any) -> None:
            super().__init__(dmm, fe_type, whole)

    @lower_cast(kind.of, kind)
    def spread(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
        nothing, each = ir.Constant(whole, ir.Undefined), ir.Constant(ir.VectorType(_INDEX, LANES), None)
        one = builder.insert_element(nothing, context.cast(builder, value, fromty, kind.single), _INDEX(0))
        return builder.shuffle_vector(one, nothing, each)


_in_registers(lanes, _LANES)
_in_registers(mask, _MASK)


def _any_lanes(*args: Any) -> bool:
    """Whether all arguments are numbers or lanes, and at least one is lanes."""
    return lanes in args and all(arg is lanes or isinstance(arg, types.Number) for arg in args)


def _define(function: Callable[..., Any], count: int, result: Any, lowered: Callable[..., Any]) -> None:
    """Define a function of one or two numbers for lanes. `lowered`: makes its code from arguments that are lanes."""

    @type_callable(function)
    def typed(context: Any) -> Any:
        if count == 1:
            return lambda a: result if a is lanes else None
        return lambda a, b: result if _any_lanes(a, b) else None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        given = (context.cast(builder, v, t, lanes) for v, t in zip(args, sig.args, strict=True))
        return lowered(context, builder, *given)

    for kinds in [(lanes,)] if count == 1 else [(lanes, lanes), (lanes, types.Number), (types.Number, lanes)]:
        lower_builtin(function, *kinds)(lower)


def _operator(function: Callable[..., Any], result: Any, build: Callable[..., Any], count: int = 2) -> None:
    """Define a function that has an instruction for lanes."""
    _define(function, count, result, lambda context, builder, *given: build(builder, *given))


for _function, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _operator(_function, lanes, lambda b, x, y, name=_name: getattr(b, name)(x, y))
    _operator(getattr(operator, f"i{_function.__name__}"), lanes, lambda b, x, y, name=_name: getattr(b, name)(x, y))
for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
):
    _operator(_function, mask, lambda b, x, y, sign=_sign: b.fcmp_ordered(sign, x, y))
_operator(operator.ne, mask, lambda b, x, y: b.fcmp_unordered("!=", x, y))
_operator(operator.neg, lanes, lambda b, x: b.fneg(x), 1)
# As for numbers: the second argument only if it is greater (or less), so that a NaN in the first one stays.
_operator(max, lanes, lambda b, x, y: b.select(b.fcmp_ordered(">", y, x), y, x))
_operator(min, lanes, lambda b, x, y: b.select(b.fcmp_ordered("<", y, x), y, x))


def _by_llvm(name: str) -> Callable[..., Any]:
    def build(builder: Any, x: Any) -> Any:
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_LANES, [_LANES]), f"llvm.{name}.v{LANES}f64"
        )
        return builder.call(function, [x])

    return build


_operator(abs, lanes, _by_llvm("fabs"), 1)
_operator(math.sqrt, lanes, _by_llvm("sqrt"), 1)


def _one_by_one(function: Callable[..., Any], count: int) -> None:
    """Define a function without an instruction for lanes: it is called for one lane after another."""

    def lowered(context: Any, builder: Any, *given: Any) -> Any:
        each = context.get_function(function, signature(types.float64, *[types.float64] * count))
        out = ir.Constant(_LANES, ir.Undefined)
        for k in range(LANES):
            value = each(builder, [builder.extract_element(x, _INDEX(k)) for x in given])
            out = builder.insert_element(out, value, _INDEX(k))
        return out

    _define(function, count, lanes, lowered)


for _of_one in (math.exp, math.log, math.sin, math.cos, math.tan, math.tanh, math.atan):
    _one_by_one(_of_one, 1)
for _of_two in (operator.pow, math.atan2, math.hypot, math.copysign):
    _one_by_one(_of_two, 2)


@intrinsic
def some(typingctx: Any, condition: Any) -> Any:
    """Whether a condition holds in any lane; of a truth value: whether it holds."""
    if condition is not mask and not isinstance(condition, types.Boolean):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if sig.args[0] is not mask:
            return args[0]
        byte = ir.IntType(LANES)
        return builder.icmp_unsigned("!=", builder.bitcast(args[0], byte), byte(0))

    return signature(types.boolean, condition), codegen


def _logic(name: str, doc: str) -> Any:
    def typer(typingctx: Any, a: Any, b: Any) -> Any:
        if not all(arg is mask or isinstance(arg, types.Boolean) for arg in (a, b)):
            return None
        result = mask if mask in (a, b) else types.boolean

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            x, y = (context.cast(builder, v, t, result) for v, t in zip(args, sig.args, strict=True))
            return getattr(builder, name)(x, y)

        return signature(result, a, b), codegen

    typer.__doc__ = doc
    return intrinsic(typer)


both = _logic("and_", "Where two conditions hold.")
either = _logic("or_", "Where one of two conditions holds, or both.")


@intrinsic
def no(typingctx: Any, a: Any) -> Any:
    """Where a condition does not hold."""
    if a is not mask and not isinstance(a, types.Boolean):
        return None
    return signature(a, a), lambda context, builder, sig, args: builder.not_(args[0])


@intrinsic
def where(typingctx: Any, condition: Any, a: Any, b: Any) -> Any:
    """A choice between two values, for each lane. Numbers and truth values are allowed as well."""
    unified = typingctx.unify_types(a, b)
    if unified is None:
        return None
    result = unified
    if condition is mask:
        result = mask if unified is mask or isinstance(unified, types.Boolean) else lanes
    elif not isinstance(condition, types.Boolean):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        x, y = (context.cast(builder, v, t, result) for v, t in zip(args[1:], sig.args[1:], strict=True))
        return builder.select(args[0], x, y)

    return signature(result, condition, a, b), codegen


def _address(context: Any, builder: Any, arrayty: Any, array: Any, index_type: Any, index: Any) -> Any:
    """Address of the first lane of an entry."""
    holder = context.make_array(arrayty)(context, builder, array)
    many = isinstance(index_type, types.BaseTuple)
    kinds = list(index_type.types) if many else [index_type]
    values = cgutils.unpack_tuple(builder, index) if many else [index]
    # An index read from an array of floats is an integer by now. No index is negative.
    at = [context.cast(builder, v, t, types.intp) for v, t in zip(values, kinds, strict=True)]
    at.append(context.get_constant(types.intp, 0))
    return cgutils.get_item_pointer(context, builder, arrayty, holder, at, wraparound=False)


def _dimensions(index: Any) -> int:
    return len(index.types) if isinstance(index, types.BaseTuple) else 1


@intrinsic
def item(typingctx: Any, array: Any, index: Any) -> Any:
    """An entry of an array: a number, or lanes where the array has a further dimension of LANES, or a row of either."""
    if not isinstance(array, types.Array):
        return None
    left = array.ndim - _dimensions(index)
    if left == 0:
        result = array.dtype
    elif left == 1 and array.layout == "C":
        result = lanes
    else:
        result = array.copy(ndim=left)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if sig.return_type is lanes:
            at = _address(context, builder, sig.args[0], args[0], sig.args[1], args[1])
            return builder.load(builder.bitcast(at, _LANES.as_pointer()), align=8)
        if isinstance(sig.args[1], types.BaseTuple):
            return context.get_function(operator.getitem, sig)(builder, args)
        at = context.cast(builder, args[1], sig.args[1], types.intp)
        whole = signature(sig.return_type, sig.args[0], types.intp)
        return context.get_function(operator.getitem, whole)(builder, (args[0], at))

    return signature(result, array, index), codegen


@intrinsic
def put(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    """Set an entry of an array with a further dimension of LANES."""
    if not isinstance(array, types.Array) or array.layout != "C" or array.ndim != _dimensions(index) + 1:
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        at = _address(context, builder, sig.args[0], args[0], sig.args[1], args[1])
        value = context.cast(builder, args[2], sig.args[2], lanes)
        builder.store(value, builder.bitcast(at, _LANES.as_pointer()), align=8)
        return context.get_dummy_value()

    return signature(types.void, array, index, value), codegen


@intrinsic
def shared(typingctx: Any, array: Any, index: Any) -> Any:
    """An entry of an array of lanes that is the same in all of them, as a number. `array`: (n, LANES)."""
    if not isinstance(array, types.Array) or array.layout != "C" or array.ndim != 2:
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_address(context, builder, sig.args[0], args[0], sig.args[1], args[1]))

    return signature(array.dtype, array, index), codegen


_LONG = ir.IntType(64)


def _of_bits(doc: str, build: Callable[..., Any]) -> Any:
    """Define a function of the bits of a number, or of those of each lane."""

    def typer(typingctx: Any, value: Any) -> Any:
        if value is not lanes and not isinstance(value, types.Float):
            return None

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = _LANES if sig.args[0] is lanes else _DOUBLE
            whole = ir.VectorType(_LONG, LANES) if sig.args[0] is lanes else _LONG

            def constant(number: int) -> Any:
                return ir.Constant(whole, [number] * LANES) if sig.args[0] is lanes else whole(number)

            return builder.bitcast(build(builder, builder.bitcast(args[0], whole), constant), kind)

        return signature(value, value), codegen

    typer.__doc__ = doc
    return intrinsic(typer)


power_of_two = _of_bits(
    "2 to the whole number n, −1022 to 1023, that was added to 1.5 · 2^52.",
    lambda b, bits, c: b.shl(b.add(bits, c(1023)), c(52)),
)
fraction = _of_bits(
    "The number with another exponent: from 1 to 2.",
    lambda b, bits, c: b.or_(b.and_(bits, c(0x000F_FFFF_FFFF_FFFF)), c(0x3FF0_0000_0000_0000)),
)
exponent = _of_bits(
    "2^52 and the exponent of a number, with the bias of 1023.",
    lambda b, bits, c: b.or_(b.lshr(bits, c(52)), c(0x4330_0000_0000_0000)),
)
