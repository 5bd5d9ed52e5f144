"""Four or eight numbers that one instruction works on: a type for compiled code, with the operators of a number.

Sums, products, roots and comparisons of :data:`lanes` are one instruction of the processor (AVX-512, AVX or SSE), or
LLVM uses several smaller ones with the same bits. Functions without an instruction are called for each lane in turn. A
comparison gives a :data:`mask`, a truth value for each lane; ``&``, ``|`` and ``^`` join masks. A number stands for
lanes that all have it, and a truth value for a mask.

In memory, an array (n, LANES) of numbers is an array (n,) of lanes (:func:`in_lanes`), with numba's own indices and
slices. :mod:`pam_antagonist.model.lane_form` compiles the equations for them.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from numba.core import cgutils, codegen, config, types
from numba.core.typeconv import Conversion
from numba.core.typing import signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model, type_callable
from numba.np.arrayobj import populate_array


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
ir: Any = cgutils.ir
"""The builder of LLVM's code that numba uses."""
_INDEX, WHOLE = ir.IntType(32), ir.VectorType(ir.DoubleType(), LANES)


# Types: what lanes and masks are, in registers and in memory.


class _Wide(types.Type):  # type: ignore[misc]
    """LANES numbers or truth values. `single`: their type. `kind`: what may stand for all of them, the same in each."""

    def __init__(self, name: str, single: Any, kind: Any) -> None:
        super().__init__(name=name)
        self.single, self.kind = single, kind

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        """A number, or a truth value, is the same in each lane. A kernel for numbers fits a number better."""
        return Conversion.safe if isinstance(other, self.kind) else None

    def unify(self, typingctx: Any, other: Any) -> Any:
        """A variable that is lanes after one branch and a number after the other is lanes; likewise a mask."""
        return self if isinstance(other, self.kind) else None


lanes, mask = _Wide("lanes", types.float64, types.Number), _Wide("mask", types.boolean, types.Boolean)


@register_model(_Wide)
class _Register(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, kind: _Wide) -> None:
        super().__init__(dmm, kind, ir.VectorType(dmm[kind.single].get_value_type(), LANES))


@lower_cast(types.Number, _Wide)
@lower_cast(types.Boolean, _Wide)
def _spread(context: Any, builder: Any, given: Any, kind: Any, value: Any) -> Any:
    """Code that puts one value into each lane."""
    nothing, first = (
        ir.Constant(context.get_value_type(kind), ir.Undefined),
        ir.Constant(ir.VectorType(_INDEX, LANES), None),
    )
    one = builder.insert_element(nothing, context.cast(builder, value, given, kind.single), _INDEX(0))
    return builder.shuffle_vector(one, nothing, first)


def array_of_lanes(dimensions: int) -> Any:
    """Type of an array of lanes. numpy does not align arrays to whole registers."""
    return types.Array(lanes, dimensions, "C", aligned=False)


@intrinsic
def in_lanes(typingctx: Any, array: Any) -> Any:
    """An array (..., LANES) of numbers as an array (...) of lanes, on the same memory."""
    if not isinstance(array, types.Array) or array.layout != "C":
        return None
    result = array_of_lanes(array.ndim - 1)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        old, new = context.make_array(array)(context, builder, args[0]), context.make_array(result)(context, builder)
        shape, strides = (cgutils.unpack_tuple(builder, part)[:-1] for part in (old.shape, old.strides))
        populate_array(new, builder.bitcast(old.data, new.data.type), shape, strides, 8 * LANES, None)
        return new._getvalue()

    return signature(result, array), code


# Operators and functions of numbers, for lanes; and of truth values, for masks.


def _define(function: Any, kind: Any, result: Any, build: Callable[..., Any], count: int = 2) -> None:
    """Define a function of one or two arguments. `build`: makes its code from a builder and arguments of a kind."""

    def typed(context: Any) -> Any:
        if count == 1:
            return lambda a: result if a is kind else None
        return lambda a, b: (
            result if kind in (a, b) and all(x is kind or isinstance(x, kind.kind) for x in (a, b)) else None
        )

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return build(
            builder, *(context.cast(builder, x, t, kind) for x, t in zip(args, sig.args, strict=True)), context
        )

    type_callable(function)(typed)
    for kinds in [(kind,)] if count == 1 else [(kind, kind), (kind, kind.kind), (kind.kind, kind)]:
        lower_builtin(function, *kinds)(lowered)


def _one_by_one(function: Any, count: int) -> Callable[..., Any]:
    """Code of a function without an instruction for lanes."""

    def build(builder: Any, *given: Any) -> Any:
        *values, context = given
        each, out = context.get_function(function, signature(types.float64, *[types.float64] * count)), values[0]
        for k in range(LANES):
            value = each(builder, [builder.extract_element(x, _INDEX(k)) for x in values])
            out = builder.insert_element(out, value, _INDEX(k))
        return out

    return build


def _by_llvm(builder: Any, name: str, x: Any) -> Any:
    kind = ir.FunctionType(WHOLE, [WHOLE])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64"), [x])


for _name, _code in {"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}.items():
    _define(getattr(operator, _name), lanes, lanes, lambda b, x, y, _, code=_code: getattr(b, code)(x, y))
for _name, _code in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "=="}.items():
    _define(getattr(operator, _name), lanes, mask, lambda b, x, y, _, code=_code: b.fcmp_ordered(code, x, y))
for _name in ("and_", "or_", "xor"):
    _define(getattr(operator, _name), mask, mask, lambda b, x, y, _, code=_name: getattr(b, code)(x, y))
_define(operator.ne, lanes, mask, lambda b, x, y, _: b.fcmp_unordered("!=", x, y))
# As for numbers: the second argument only if it is greater (or less), so that a NaN in the first one stays.
_define(max, lanes, lanes, lambda b, x, y, _: b.select(b.fcmp_ordered(">", y, x), y, x))
_define(min, lanes, lanes, lambda b, x, y, _: b.select(b.fcmp_ordered("<", y, x), y, x))
_define(operator.neg, lanes, lanes, lambda b, x, _: b.fneg(x), 1)
_define(abs, lanes, lanes, lambda b, x, _: _by_llvm(b, "fabs", x), 1)
_define(math.sqrt, lanes, lanes, lambda b, x, _: _by_llvm(b, "sqrt", x), 1)
for _of_one in (math.exp, math.log, math.sin, math.cos, math.tan, math.tanh, math.atan):
    _define(_of_one, lanes, lanes, _one_by_one(_of_one, 1), 1)
for _of_two in (operator.pow, math.atan2, math.hypot, math.copysign):
    _define(_of_two, lanes, lanes, _one_by_one(_of_two, 2))


# What takes the place of branches.


@intrinsic
def some(typingctx: Any, condition: Any) -> Any:
    """Whether a condition holds in any lane; of a truth value: whether it holds."""
    if condition is mask:
        bits = ir.IntType(LANES)
        return signature(types.boolean, mask), lambda c, b, s, args: b.icmp_unsigned(
            "!=", b.bitcast(args[0], bits), bits(0)
        )
    return (signature(condition, condition), lambda c, b, s, args: args[0]) if condition == types.boolean else None


@intrinsic
def where(typingctx: Any, condition: Any, a: Any, b: Any) -> Any:
    """A choice between two values, for each lane: lanes or numbers, masks or truth values, or tuples of them."""
    result = _chosen(typingctx, condition, a, b)
    if result is None or condition not in (mask, types.boolean):
        return None

    def select(context: Any, builder: Any, kind: Any, yes: Any, x: Any, y: Any) -> Any:
        if not isinstance(kind, types.BaseTuple):
            return builder.select(yes, x, y)
        pairs = zip(kind.types, cgutils.unpack_tuple(builder, x), cgutils.unpack_tuple(builder, y), strict=True)
        return context.make_tuple(builder, kind, [select(context, builder, part, yes, v, w) for part, v, w in pairs])

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        x, y = (context.cast(builder, v, t, result) for v, t in zip(args[1:], sig.args[1:], strict=True))
        return select(context, builder, result, args[0], x, y)

    return signature(result, condition, a, b), code


def _chosen(typingctx: Any, condition: Any, a: Any, b: Any) -> Any:
    """Type of a choice; None where there is none."""
    if isinstance(a, types.BaseTuple) and isinstance(b, types.BaseTuple) and len(a) == len(b):
        parts = [_chosen(typingctx, condition, x, y) for x, y in zip(a.types, b.types, strict=True)]
        return None if None in parts else types.Tuple(parts)
    both = typingctx.unify_types(a, b)
    wide = next((kind for kind in (lanes, mask) if both is kind or isinstance(both, kind.kind)), None)
    return wide if condition is mask or wide is None else types.unliteral(both)


@intrinsic
def in_lane(typingctx: Any, value: Any, k: Any) -> Any:
    """The number in lane k; a number is the same in all."""
    if isinstance(value, types.Number):
        return signature(value, value, k), lambda c, b, s, args: args[0]
    return (
        (signature(types.float64, value, k), lambda c, b, s, args: b.extract_element(*args)) if value is lanes else None
    )


@intrinsic
def shared(typingctx: Any, value: Any) -> Any:
    """A number that is the same in all lanes, as a number: it may be an index or an option."""
    if value is lanes:
        return signature(types.float64, value), lambda c, b, s, args: b.extract_element(args[0], _INDEX(0))
    return (signature(value, value), lambda c, b, s, args: args[0]) if isinstance(value, types.Number) else None
