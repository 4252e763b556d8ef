# SPDX-License-Identifier: Apache-2.0
"""A vector of doubles as a numba type: one candidate in each SIMD lane.

Kernels are written once, as if for one candidate; every operation on a `Lanes` value works on
`WIDTH` of them. The compiler splits the vector into the machine's registers. Lanes never mix, so a
candidate's result does not depend on its neighbours.

Values come from `load(array, offset)` and `spread(scalar)`, go back with `store`, and combine with
`+ - * /`, the comparisons (which give a `Mask`) and the functions below. Division by zero gives
inf or NaN, as in numpy.
"""
# mypy: ignore-errors
# numba's extension interface is not typed.

from functools import partial
import math
import operator
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic as _intrinsic
from numba.extending import lower_builtin, lower_cast, models, register_model
import numpy as np

from ros2_ident.compiled import cached

# One register of AVX-512, two of AVX2. Twice as many hide more latency, but small batches, as
# local fits make them, then fill half a vector only.
WIDTH = 8


def intrinsic(function) -> Any:
    """Return numba's intrinsic; its own type says nothing of the arguments kernels pass."""
    return _intrinsic(function)


# Kernels are many small functions; a call that stays a call spills every vector register. Nor may
# arrays be counted on the way: atomic, and a call each; so a kernel gets its room from outside.
# What only kernels call has no entry from Python: it would nearly double the compiling.
_INSIDE = {'_nrt': False, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}
INLINED = {'forceinline': True, **_INSIDE}
inlined = njit(**INLINED)
called = njit(**_INSIDE)
kernel = partial(cached, _nrt=False)
# Contraction lets the compiler fuse a*b + c; reassociation would make results depend on its mood.
_FLAGS = ('contract',)
_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_LONGS = ir.VectorType(ir.IntType(64), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)


class _LanesType(types.Type):
    def __init__(self):
        super().__init__(name='Lanes')

    def can_convert_from(self, typingctx, other):
        if isinstance(other, (types.Float, types.Integer)):
            from numba.core.typeconv import Conversion

            return Conversion.safe
        return None


class _MaskType(types.Type):
    def __init__(self):
        super().__init__(name='LanesMask')


lanes_type = _LanesType()
mask_type = _MaskType()


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VECTOR)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _BITS)


def _splat(builder, value, vector):
    zero = ir.Constant(ir.IntType(32), 0)
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), value, zero)
    order = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(single, ir.Constant(vector, ir.Undefined), order)


@lower_cast(types.Float, _LanesType)
@lower_cast(types.Integer, _LanesType)
def _number_to_lanes(context, builder, fromty, toty, value):
    return _splat(builder, context.cast(builder, value, fromty, types.float64), _VECTOR)


def _binary(op, emit, result=lanes_type, operand=lanes_type):
    @infer_global(op)
    class _Template(ConcreteTemplate):
        cases = [signature(result, operand, operand)]

    @lower_builtin(op, operand, operand)
    def _lower(context, builder, sig, args):
        return emit(builder, *args)


def _flagged(name):
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=_FLAGS)


_binary(operator.add, _flagged('fadd'))
_binary(operator.sub, _flagged('fsub'))
_binary(operator.mul, _flagged('fmul'))
_binary(operator.truediv, _flagged('fdiv'))
for _op, _symbol in (
    (operator.lt, '<'),
    (operator.le, '<='),
    (operator.gt, '>'),
    (operator.ge, '>='),
):
    _binary(_op, lambda b, x, y, s=_symbol: b.fcmp_ordered(s, x, y), result=mask_type)
_binary(operator.and_, lambda b, x, y: b.and_(x, y), mask_type, mask_type)
_binary(operator.or_, lambda b, x, y: b.or_(x, y), mask_type, mask_type)


@infer_global(operator.neg)
class _NegTemplate(ConcreteTemplate):
    cases = [signature(lanes_type, lanes_type)]


@lower_builtin(operator.neg, lanes_type)
def _neg(context, builder, sig, args):
    return builder.fneg(args[0])


def _call(builder, name, arguments):
    function_type = ir.FunctionType(_VECTOR, [_VECTOR] * len(arguments))
    function = cgutils.get_or_insert_function(builder.module, function_type, f'{name}.v{WIDTH}f64')
    return builder.call(function, arguments)


@intrinsic
def spread(typingctx, value):
    """Return the scalar `value` in every lane."""
    if not isinstance(value, (types.Float, types.Integer)):
        return None

    def codegen(context, builder, sig, args):
        return _number_to_lanes(context, builder, sig.args[0], lanes_type, args[0])

    return lanes_type(value), codegen


def _pointer(context, builder, array_type, array, offset, offset_type):
    data = context.make_array(array_type)(context, builder, array).data
    index = context.cast(builder, offset, offset_type, types.intp)
    return builder.gep(data, [index])


@intrinsic
def load(typingctx, array, offset):
    """Return `WIDTH` neighbours of the flat float64 `array` from `offset` on, unchecked."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], sig.args[1])
        pointer = builder.bitcast(pointer, _VECTOR.as_pointer())
        return builder.load(pointer, align=8)

    return lanes_type(array, offset), codegen


@intrinsic
def store(typingctx, array, offset, value):
    """Write `value` to `WIDTH` neighbours of the flat float64 `array`, unchecked."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], sig.args[1])
        pointer = builder.bitcast(pointer, _VECTOR.as_pointer())
        builder.store(args[2], pointer, align=8)
        return context.get_dummy_value()

    return types.none(array, offset, lanes_type), codegen


@inlined
def parted(room, rows):
    """Return the first `rows` rows of the flat float64 array `room`, and the rest of it."""
    return room[: rows * WIDTH], room[rows * WIDTH :]


@called
def copied(values, out):
    """Write the flat float64 array `values` to `out`."""
    for i in range(values.size):
        out[i] = values[i]


@intrinsic
def take(typingctx, array, index):
    """Return elements of the flat float64 `array` at the whole numbers `index`, unchecked."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        whole = builder.fptosi(args[1], _LONGS)
        result = ir.Constant(_VECTOR, ir.Undefined)
        for k in range(WIDTH):
            lane = ir.Constant(ir.IntType(32), k)
            pointer = builder.gep(data, [builder.extract_element(whole, lane)])
            result = builder.insert_element(result, builder.load(pointer), lane)
        return result

    return lanes_type(array, lanes_type), codegen


@intrinsic
def product(typingctx, a, b):
    """Return a * b, rounded: never fused with a sum, so that no choice of the compiler shows."""

    def codegen(context, builder, sig, args):
        return builder.fmul(args[0], args[1])

    return lanes_type(lanes_type, lanes_type), codegen


@intrinsic
def where(typingctx, mask, a, b):
    """Return `a` in the lanes where `mask` holds and `b` in the others."""

    def codegen(context, builder, sig, args):
        return builder.select(args[0], args[1], args[2])

    return lanes_type(mask_type, lanes_type, lanes_type), codegen


def _unary_intrinsic(name, doc):
    @intrinsic
    def function(typingctx, value):
        def codegen(context, builder, sig, args):
            return _call(builder, name, [args[0]])

        return lanes_type(lanes_type), codegen

    function.__doc__ = doc
    return function


sqrt = _unary_intrinsic('llvm.sqrt', 'Return the square root, NaN below zero.')
absolute = _unary_intrinsic('llvm.fabs', 'Return the absolute value.')
floor = _unary_intrinsic('llvm.floor', 'Return the largest whole number not above.')


@intrinsic
def with_sign(typingctx, value, sign):
    """Return `value` with the sign of `sign`."""

    def codegen(context, builder, sig, args):
        return _call(builder, 'llvm.copysign', list(args))

    return lanes_type(lanes_type, lanes_type), codegen


@intrinsic
def any_lane(typingctx, mask):
    """Return True where the mask holds in at least one lane."""

    def codegen(context, builder, sig, args):
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned('!=', bits, ir.Constant(ir.IntType(WIDTH), 0))

    return types.boolean(mask_type), codegen


@intrinsic
def _power_of_two(typingctx, exponent):
    """Return 2**exponent for whole exponents within a double's range."""

    def codegen(context, builder, sig, args):
        whole = builder.fptosi(args[0], _LONGS)
        biased = builder.add(whole, ir.Constant(_LONGS, [1023] * WIDTH))
        return builder.bitcast(builder.shl(biased, ir.Constant(_LONGS, [52] * WIDTH)), _VECTOR)

    return lanes_type(lanes_type), codegen


@inlined
def minimum(a, b):
    """Return the smaller of two, lane by lane; `b` where `a` is NaN."""
    return where(a < b, a, b)


@inlined
def maximum(a, b):
    """Return the larger of two, lane by lane; `b` where `a` is NaN."""
    return where(a > b, a, b)


@inlined
def clip(value, low, high):
    """Return `value` limited to [low, high], lane by lane."""
    return minimum(maximum(value, low), high)


@inlined
def exp(x):
    """Return e**x to 2e-16 relative; arguments beyond +-700 saturate.

    Reduction x = n ln 2 + r, then the Taylor series of e**r up to r**13, |r| <= ln(2)/2.
    """
    x = clip(x, spread(-700.0), spread(700.0))
    n = floor(x * 1.4426950408889634 + 0.5)
    r = x - n * 0.6931471803691238 - n * 1.9082149292705877e-10
    s = spread(1.0 / 6227020800.0)
    s = s * r + 1.0 / 479001600.0
    s = s * r + 1.0 / 39916800.0
    s = s * r + 1.0 / 3628800.0
    s = s * r + 1.0 / 362880.0
    s = s * r + 1.0 / 40320.0
    s = s * r + 1.0 / 5040.0
    s = s * r + 1.0 / 720.0
    s = s * r + 1.0 / 120.0
    s = s * r + 1.0 / 24.0
    s = s * r + 1.0 / 6.0
    s = s * r + 0.5
    s = s * r + 1.0
    s = s * r + 1.0
    return s * _power_of_two(n)


@inlined
def sine(x):
    """Return sin(x) to about 1e-15 absolute for |x| < 1e5.

    Reduction by whole multiples of pi, then the Taylor series up to r**19, |r| <= pi/2.
    """
    n = floor(x * 0.3183098861837907 + 0.5)
    r = x - n * 3.141592653589793116 - n * 1.2246467991473532e-16
    odd = n - 2.0 * floor(n * 0.5)
    q = r * r
    s = spread(-1.0 / 121645100408832000.0)
    s = s * q + 1.0 / 355687428096000.0
    s = s * q - 1.0 / 1307674368000.0
    s = s * q + 1.0 / 6227020800.0
    s = s * q - 1.0 / 39916800.0
    s = s * q + 1.0 / 362880.0
    s = s * q - 1.0 / 5040.0
    s = s * q + 1.0 / 120.0
    s = s * q - 1.0 / 6.0
    s = s * q * r + r
    return s * (1.0 - 2.0 * odd)


@inlined
def cosine(x):
    """Return cos(x), as accurate as `sine`."""
    return sine(x + 1.5707963267948966)


@inlined
def sine_and_cosine(x):
    """Return sin(x) and cos(x) to about 1e-11 absolute for |x| < 1e5, in little more than one.

    As `sine`, with one reduction for both and fewer terms.
    """
    n = floor(x * 0.3183098861837907 + 0.5)
    r = x - n * 3.141592653589793116 - n * 1.2246467991473532e-16
    sign = 1.0 - 2.0 * (n - 2.0 * floor(n * 0.5))
    q = r * r
    s = spread(-1.0 / 1307674368000.0)
    c = spread(1.0 / 20922789888000.0)
    s = s * q + 1.0 / 6227020800.0
    c = c * q - 1.0 / 87178291200.0
    s = s * q - 1.0 / 39916800.0
    c = c * q + 1.0 / 479001600.0
    s = s * q + 1.0 / 362880.0
    c = c * q - 1.0 / 3628800.0
    s = s * q - 1.0 / 5040.0
    c = c * q + 1.0 / 40320.0
    s = s * q + 1.0 / 120.0
    c = c * q - 1.0 / 720.0
    s = s * q - 1.0 / 6.0
    c = c * q + 1.0 / 24.0
    c = c * q - 0.5
    return (s * q * r + r) * sign, (c * q + 1.0) * sign


@inlined
def tanh(x):
    """Return the hyperbolic tangent to 5e-11 absolute.

    A rational fit x P(x**2)/Q(x**2) on [-9.2, 9.2] (minimax by reweighted least squares), constant
    beyond. Where every lane is beyond, as friction is most of the time, nothing is evaluated.
    """
    near = absolute(x) < spread(9.2)
    flat = with_sign(spread(0.9999999795820788), x)
    if not any_lane(near):
        return flat
    u = x * x * (1.0 / 84.64)
    p = spread(0.15476603502272979)
    p = p * u + 5.612164909892022
    p = p * u + 25.43779612478148
    p = p * u + 31.6171925602088
    p = p * u + 11.92557785362088
    p = p * u + 0.9999999997639548
    q = spread(12.528558028118812)
    q = q * u + 132.10893444678678
    q = q * u + 302.2215188334761
    q = q * u + 208.87906864537354
    q = q * u + 40.13891109171854
    q = q * u + 1.0
    return where(near, x * p / q, flat)


def room(*shape: int) -> np.ndarray:
    """Return an unset float64 array that begins where a vector register's line does.

    One that lies across two of the cache's lines is read in twice the time.
    """
    size = math.prod(shape)
    raw = np.empty(size + 7)
    start = -raw.__array_interface__['data'][0] // 8 % 8
    return raw[start : start + size].reshape(shape)


def padded(values: np.ndarray, fill: str = 'edge') -> np.ndarray:
    """Pad candidates to whole vectors.

    Args:
        values: (S, N) one candidate a row.
        fill: `numpy.pad` mode; the last candidate is repeated by default, so no lane diverges.

    Returns:
        (G, N, WIDTH) C-contiguous: candidate g * WIDTH + k is in lane k of block g.
    """
    groups = -(-values.shape[0] // WIDTH)
    whole = np.pad(values, ((0, groups * WIDTH - values.shape[0]), (0, 0)), mode=fill)
    out = room(groups, values.shape[1], WIDTH)
    out[:] = whole.reshape(groups, WIDTH, -1).transpose(0, 2, 1)
    return out
