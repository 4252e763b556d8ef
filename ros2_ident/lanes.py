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
from inspect import Parameter, Signature
import math
import operator
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.typeconv import Conversion
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
_BITS, _BYTE = ir.VectorType(ir.IntType(1), WIDTH), ir.IntType(WIDTH)


class _LanesType(types.Type):
    def can_convert_from(self, typingctx, other):
        return Conversion.safe if isinstance(other, (types.Float, types.Integer)) else None


class _MaskType(types.Type):
    """Which lanes."""


lanes_type = _LanesType(name='Lanes')
mask_type = _MaskType(name='LanesMask')


for _kind, _form in ((_LanesType, _VECTOR), (_MaskType, _BITS)):
    register_model(_kind)(lambda dmm, fe, form=_form: models.PrimitiveModel(dmm, fe, form))


def _spread(context, builder, given, lanes, value):
    """Return a number of a type in every lane."""
    zero = ir.Constant(ir.IntType(32), 0)
    value = context.cast(builder, value, given, types.float64)
    single = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, zero)
    order = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(single, ir.Constant(_VECTOR, ir.Undefined), order)


for _number in (types.Float, types.Integer):
    lower_cast(_number, _LanesType)(_spread)


def _operator(op, emit, result, *operands):
    @infer_global(op)
    class _Template(ConcreteTemplate):
        cases = [signature(result, *operands)]

    @lower_builtin(op, *operands)
    def _lower(context, builder, sig, args):
        return emit(builder, *args)


def _flagged(name):
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=_FLAGS)


_TWO = lanes_type, lanes_type
for _op, _name in (('add', 'fadd'), ('sub', 'fsub'), ('mul', 'fmul'), ('truediv', 'fdiv')):
    _operator(getattr(operator, _op), _flagged(_name), lanes_type, *_TWO)
_operator(operator.neg, lambda builder, x: builder.fneg(x), lanes_type, lanes_type)
for _op, _symbol in (('lt', '<'), ('le', '<='), ('gt', '>'), ('ge', '>=')):
    _compare = lambda b, x, y, s=_symbol: b.fcmp_ordered(s, x, y)  # noqa: E731
    _operator(getattr(operator, _op), _compare, mask_type, *_TWO)
_operator(operator.and_, lambda b, x, y: b.and_(x, y), mask_type, mask_type, mask_type)
_operator(operator.or_, lambda b, x, y: b.or_(x, y), mask_type, mask_type, mask_type)


def _function(doc, emit, result, *operands):
    """Return a function for kernels, emitted by builder and operands; numbers are spread."""

    def define(typingctx, *given):
        return result(*operands), lambda context, builder, sig, args: emit(builder, *args)

    names = 'typingctx', *'abc'[: len(operands)]
    define.__signature__ = Signature(Parameter(x, Parameter.POSITIONAL_ONLY) for x in names)
    define.__doc__ = doc
    return intrinsic(define)


def _library(name):
    """Return what calls a function of LLVM's."""

    def emit(builder, *args):
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(args))
        function = cgutils.get_or_insert_function(builder.module, kind, f'{name}.v{WIDTH}f64')
        return builder.call(function, args)

    return emit


def _series(*coefficients):
    """Return a function that sums a polynomial by Horner's rule, its highest power first."""
    first, *others = (ir.Constant(_VECTOR, [x] * WIDTH) for x in coefficients)

    def emit(builder, x):
        total = first
        for one in others:
            total = builder.fadd(builder.fmul(total, x, flags=_FLAGS), one, flags=_FLAGS)
        return total

    return _function('Return the sum of a polynomial.', emit, lanes_type, lanes_type)


def _two_to_the(builder, exponent):
    biased = builder.add(builder.fptosi(exponent, _LONGS), ir.Constant(_LONGS, [1023] * WIDTH))
    return builder.bitcast(builder.shl(biased, ir.Constant(_LONGS, [52] * WIDTH)), _VECTOR)


spread = _function('Return a number in every lane.', lambda b, x: x, lanes_type, lanes_type)
product = _function(
    'Return a * b, rounded: never fused with a sum, so that no choice of the compiler shows.',
    lambda builder, a, b: builder.fmul(a, b),
    *(lanes_type, *_TWO),
)
where = _function(
    'Return b in the lanes where the mask a holds and c in the others.',
    lambda builder, mask, a, b: builder.select(mask, a, b),
    *(lanes_type, mask_type, *_TWO),
)
with_sign = _function('Return a with the sign of b.', _library('llvm.copysign'), lanes_type, *_TWO)
sqrt, absolute, floor = (
    _function(doc, _library(name), lanes_type, lanes_type)
    for name, doc in (
        ('llvm.sqrt', 'Return the square root, NaN below zero.'),
        ('llvm.fabs', 'Return the absolute value.'),
        ('llvm.floor', 'Return the largest whole number not above.'),
    )
)
any_lane = _function(
    'Return True where the mask holds in at least one lane.',
    lambda b, mask: b.icmp_unsigned('!=', b.bitcast(mask, _BYTE), ir.Constant(_BYTE, 0)),
    *(types.boolean, mask_type),
)
_power_of_two = _function(
    "Return 2**a for whole exponents within a double's range.", _two_to_the, lanes_type, lanes_type
)


def _pointer(context, builder, sig, args):
    """Return where `WIDTH` neighbours begin, by an array and an offset."""
    data = context.make_array(sig.args[0])(context, builder, args[0]).data
    index = context.cast(builder, args[1], sig.args[1], types.intp)
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


@intrinsic
def load(typingctx, array, offset):
    """Return `WIDTH` neighbours of the flat float64 `array` from `offset` on, unchecked."""

    def codegen(context, builder, sig, args):
        return builder.load(_pointer(context, builder, sig, args), align=8)

    return lanes_type(array, offset), codegen


@intrinsic
def store(typingctx, array, offset, value):
    """Write `value` to `WIDTH` neighbours of the flat float64 `array`, unchecked."""

    def codegen(context, builder, sig, args):
        builder.store(args[2], _pointer(context, builder, sig, args), align=8)
        return context.get_dummy_value()

    return types.none(array, offset, lanes_type), codegen


@inlined
def load_three(array, row):
    """Return the rows of the flat float64 `array` from `row` on, three of them."""
    return (
        load(array, row * WIDTH),
        load(array, (row + 1) * WIDTH),
        load(array, (row + 2) * WIDTH),
    )


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


_exponential = _series(*(1.0 / math.factorial(k) for k in range(13, -1, -1)))


@inlined
def exp(x):
    """Return e**x to 2e-16 relative; arguments beyond +-700 saturate.

    Reduction x = n ln 2 + r, then the Taylor series of e**r up to r**13, |r| <= ln(2)/2.
    """
    x = clip(x, spread(-700.0), spread(700.0))
    n = floor(x * 1.4426950408889634 + 0.5)
    r = x - n * 0.6931471803691238 - n * 1.9082149292705877e-10
    return _exponential(r) * _power_of_two(n)


_sine = _series(*((-1.0) ** k / math.factorial(2 * k + 1) for k in range(9, 0, -1)))


@inlined
def sine(x):
    """Return sin(x) to about 1e-15 absolute for |x| < 1e5.

    Reduction by whole multiples of pi, then the Taylor series up to r**19, |r| <= pi/2.
    """
    n = floor(x * 0.3183098861837907 + 0.5)
    r = x - n * 3.141592653589793116 - n * 1.2246467991473532e-16
    odd = n - 2.0 * floor(n * 0.5)
    q = r * r
    return (_sine(q) * q * r + r) * (1.0 - 2.0 * odd)


@inlined
def cosine(x):
    """Return cos(x), as accurate as `sine`."""
    return sine(x + 1.5707963267948966)


_short_sine = _series(*((-1.0) ** k / math.factorial(2 * k + 1) for k in range(7, 0, -1)))
_short_cosine = _series(*((-1.0) ** k / math.factorial(2 * k) for k in range(8, 0, -1)))


@inlined
def sine_and_cosine(x):
    """Return sin(x) and cos(x) to about 1e-11 absolute for |x| < 1e5, in little more than one.

    As `sine`, with one reduction for both and fewer terms.
    """
    n = floor(x * 0.3183098861837907 + 0.5)
    r = x - n * 3.141592653589793116 - n * 1.2246467991473532e-16
    sign = 1.0 - 2.0 * (n - 2.0 * floor(n * 0.5))
    q = r * r
    return (_short_sine(q) * q * r + r) * sign, (_short_cosine(q) * q + 1.0) * sign


_above = _series(
    0.15476603502272979,
    5.612164909892022,
    25.43779612478148,
    31.6171925602088,
    11.92557785362088,
    0.9999999997639548,
)
_below = _series(
    12.528558028118812,
    132.10893444678678,
    302.2215188334761,
    208.87906864537354,
    40.13891109171854,
    1.0,
)


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
    return where(near, x * _above(u) / _below(u), flat)


@inlined
def combined(a, b, c, by):
    """Return the sum of three vectors, times the three numbers of `by`.

    Of the axes of a frame it is a vector of that frame in the one they are stated in.
    """
    return (
        a[0] * by[0] + b[0] * by[1] + c[0] * by[2],
        a[1] * by[0] + b[1] * by[1] + c[1] * by[2],
        a[2] * by[0] + b[2] * by[1] + c[2] * by[2],
    )


def room(*shape: int) -> np.ndarray:
    """Return an unset float64 array that begins where a vector register's line does.

    One that lies across two of the cache's lines is read in twice the time.
    """
    size = math.prod(shape)
    raw = np.empty(size + 7)
    start = -raw.__array_interface__['data'][0] // 8 % 8
    return raw[start : start + size].reshape(shape)


def padded(values: np.ndarray) -> np.ndarray:
    """Pad candidates to whole vectors.

    Args:
        values: (S, N) one candidate a row; the last is repeated, so no lane diverges.

    Returns:
        (G, N, WIDTH) C-contiguous: candidate g * WIDTH + k is in lane k of block g.
    """
    groups = -(-values.shape[0] // WIDTH)
    whole = np.pad(values, ((0, groups * WIDTH - values.shape[0]), (0, 0)), mode='edge')
    out = room(groups, values.shape[1], WIDTH)
    out[:] = whole.reshape(groups, WIDTH, -1).transpose(0, 2, 1)
    return out
