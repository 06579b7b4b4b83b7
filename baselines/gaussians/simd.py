"""Vectors of 16 float32 lanes inside numba functions: what its own loops do not reliably become.

In a compiled function, `broadcast` and `load` make vectors, and `+ - * /` work on them and between
them and scalars. LLVM fits them to the machine: one AVX-512 register, two of AVX2, four of NEON.
"""

import operator

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

LANES = 16

_FLOAT, _INT, _BIT = ir.FloatType(), ir.IntType(32), ir.IntType(1)
_FLOATS, _INTS, _BITS = (ir.VectorType(scalar, LANES) for scalar in (_FLOAT, _INT, _BIT))


class _Vector(types.Type):
    """(16,) float32."""


class _Mask(types.Type):
    """(16,) bool."""


VECTOR, MASK = _Vector("vector of 16 float32"), _Mask("mask of 16")


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _FLOATS)


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _BITS)


def _constant(values):
    """A vector constant of 16 floats or integers, or of one repeated."""
    kind = _INTS if isinstance(values, int) else _FLOATS
    return ir.Constant(kind, [values] * LANES)


def _widen(builder, value):
    """A scalar in all lanes; vectors as they are."""
    if isinstance(value.type, ir.VectorType):
        return value
    if value.type != _FLOAT:
        value = builder.fptrunc(value, _FLOAT)
    single = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), value, _INT(0))
    return builder.shuffle_vector(single, single, ir.Constant(_INTS, [0] * LANES))


def _is_operand(kind):
    return kind == VECTOR or isinstance(kind, types.Float)


def _call(builder, name, *arguments):
    """One of LLVM's own functions, from vectors to a vector."""
    signature = ir.FunctionType(_FLOATS, [_FLOATS] * len(arguments))
    function = cgutils.get_or_insert_function(builder.module, signature, f"{name}.v16f32")
    return builder.call(function, arguments)


def _emitter(emit):
    """The lowering that widens scalars and hands the vectors to `emit`."""

    def lower(context, builder, signature, arguments):
        return emit(builder, *(_widen(builder, argument) for argument in arguments))

    return lower


def _operator(symbol, emit):
    @type_callable(symbol)
    def type_operator(context):
        def typer(left, right):
            if VECTOR in (left, right) and _is_operand(left) and _is_operand(right):
                return VECTOR
            return None

        return typer

    for kinds in ((_Vector, _Vector), (_Vector, types.Float), (types.Float, _Vector)):
        lower_builtin(symbol, *kinds)(_emitter(emit))


_operator(operator.add, lambda builder, a, b: builder.fadd(a, b))
_operator(operator.sub, lambda builder, a, b: builder.fsub(a, b))
_operator(operator.mul, lambda builder, a, b: builder.fmul(a, b))
_operator(operator.truediv, lambda builder, a, b: builder.fdiv(a, b))


@intrinsic
def broadcast(typing, value):
    """A scalar in all lanes."""
    return VECTOR(value), _emitter(lambda builder, value: value)


@intrinsic
def fma(typing, a, b, c):
    """The sum a * b + c, rounded once where the machine can."""
    lower = _emitter(lambda builder, a, b, c: _call(builder, "llvm.fmuladd", a, b, c))
    return VECTOR(a, b, c), lower


@intrinsic
def minimum(typing, a, b):
    """The lower of each lane; `b` where a lane is NaN."""

    def emit(builder, a, b):
        return builder.select(builder.fcmp_ordered("<", a, b), a, b)

    return VECTOR(a, b), _emitter(emit)


@intrinsic
def maximum(typing, a, b):
    """The higher of each lane; `b` where a lane is NaN."""

    def emit(builder, a, b):
        return builder.select(builder.fcmp_ordered(">", a, b), a, b)

    return VECTOR(a, b), _emitter(emit)


@intrinsic
def greater(typing, a, b):
    """The mask of a > b; false where a lane is NaN."""
    return MASK(a, b), _emitter(lambda builder, a, b: builder.fcmp_ordered(">", a, b))


@intrinsic
def select(typing, mask, a, b):
    """`a` where the mask is set, `b` elsewhere."""
    return VECTOR(mask, a, b), _emitter(lambda builder, mask, a, b: builder.select(mask, a, b))


@intrinsic
def both(typing, a, b):
    """The mask of lanes that are set in both masks."""

    def lower(context, builder, signature, arguments):
        return builder.and_(*arguments)

    return MASK(a, b), lower


@intrinsic
def bits(typing, mask):
    """The mask as an integer, lane 0 in its lowest bit."""

    def lower(context, builder, signature, arguments):
        return builder.zext(builder.bitcast(arguments[0], ir.IntType(16)), _INT)

    return types.uint32(mask), lower


@intrinsic
def lowest_bit(typing, value):
    """The place of the lowest bit that is set; of an integer that is not 0."""

    def lower(context, builder, signature, arguments):
        return builder.cttz(arguments[0], _BIT(1))

    return types.uint32(types.uint32), lower


def _address(context, builder, kind, array, index):
    data = context.make_array(kind)(context, builder, array).data
    pointer = builder.gep(data, [index], inbounds=True)
    return builder.bitcast(pointer, _FLOATS.as_pointer())


@intrinsic
def load(typing, array, index):
    """16 floats of a contiguous float32 array from a flat index on."""

    def lower(context, builder, signature, arguments):
        pointer = _address(context, builder, signature.args[0], *arguments)
        return builder.load(pointer, align=4)

    return VECTOR(array, types.intp), lower


@intrinsic
def store(typing, array, index, value):
    """Write 16 floats to a contiguous float32 array from a flat index on."""

    def lower(context, builder, signature, arguments):
        array, index, value = arguments
        pointer = _address(context, builder, signature.args[0], array, index)
        builder.store(value, pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, VECTOR), lower


_POLYNOMIAL = np.polynomial.chebyshev.Chebyshev.interpolate(np.exp2, 5, [-0.5, 0.5])
_COEFFICIENTS = _POLYNOMIAL.convert(kind=np.polynomial.Polynomial).coef.tolist()
# Adding it to a float leaves the nearest integer in the lowest bits of the sum.
_ROUNDER = 1.5 * 2.0**23


@intrinsic
def exp2(typing, a):
    """2 ** a to 3e-7 of it, for -126 < a < 127; rubbish elsewhere."""

    def emit(builder, a):
        shifted = builder.fadd(a, _constant(_ROUNDER))
        fraction = builder.fsub(a, builder.fsub(shifted, _constant(_ROUNDER)))
        power = _constant(_COEFFICIENTS[-1])
        for coefficient in reversed(_COEFFICIENTS[:-1]):
            power = _call(builder, "llvm.fmuladd", power, fraction, _constant(coefficient))
        exponent = builder.shl(builder.bitcast(shifted, _INTS), _constant(23))
        return builder.bitcast(builder.add(builder.bitcast(power, _INTS), exponent), _FLOATS)

    return VECTOR(a), _emitter(emit)


@intrinsic
def sum_lanes(typing, vectors):
    """The vector whose lane k is the sum of the k-th of up to 16 vectors, given as a tuple.

    Pairs are folded into one another, so that all sums together take 15 additions.
    """

    def lower(context, builder, signature, arguments):
        folded = cgutils.unpack_tuple(builder, arguments[0])
        folded += [_constant(0.0)] * (LANES - len(folded))
        for half in (8, 4, 2, 1):
            folded = [_fold(builder, folded[k], folded[k + half], half) for k in range(half)]
        return folded[0]

    return VECTOR(vectors), lower


def _fold(builder, a, b, half):
    """Halve the lanes of two vectors by adding, and interleave what is left."""
    low = [k + LANES * ((k & half) > 0) - (k & half) for k in range(LANES)]
    high = [k + half for k in low]
    parts = (builder.shuffle_vector(a, b, ir.Constant(_INTS, order)) for order in (low, high))
    return builder.fadd(*parts)


@numba.njit
def aligned(count):
    """(count,) float32, unset, such that no vector of 16 that starts at 16 k straddles cache lines.

    Its memory comes with it: hold on to nothing else.
    """
    memory = np.empty(count + LANES, np.float32)
    start = (-memory.ctypes.data) % (4 * LANES) // 4
    return memory[start : start + count]
