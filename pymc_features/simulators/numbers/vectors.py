"""Registers of `LANES` numbers: in arrays and at addresses, neighbours, comparisons, exponents.

Left to itself the compiler does not vectorise a recursion over particles: it cannot prove that the arrays do
not overlap, nor keep accumulators in registers. A kernel written with these reads as that for one particle.
"""

from inspect import signature

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from pymc_features.simulators.compiled.jit import inline, jit
from pymc_features.simulators.numbers.compiled_numbers import compiled, in_lanes, register_type, taken_apart
from pymc_features.simulators.numbers.registers import INTEGER, SHORT, WIDEST, total_of, vector
from pymc_features.simulators.numbers.rows import places_of, read_from, write_to

LANES, LANES_TYPE = WIDEST, register_type(WIDEST)
VECTOR, _LONGS = vector(LANES), ir.VectorType(INTEGER, LANES)
_MANTISSA_BITS = ir.Constant(_LONGS, [52] * LANES)
LINE = 64  # bytes: a vector that begins at a multiple of its length is loaded at once

splat, total = in_lanes, compiled(total_of)  # one number in every lane; the sum of all lanes
nearest = compiled(lambda a: a.call("rint"))
# of (last, this): every lane's lower neighbour; of (this, next): its upper neighbour
below = compiled(lambda a, b: a.mix(b, range(LANES - 1, 2 * LANES - 1)))
above = compiled(lambda a, b: a.mix(b, range(1, LANES + 1)))


def aligned(size: int) -> np.ndarray:
    """Return `size` float64 zeros that begin with a line of the cache.

    Compiled code reaches them by their address, `array.ctypes.data`: an array among the arguments of each
    small function costs two atomic operations of reference counting, more than the work in it. Whoever calls
    a kernel keeps the array until it returns.
    """
    whole = np.zeros(size + LINE // 8)
    first = -whole.ctypes.data % LINE // 8
    return whole[first : first + size]


new_numbers = jit(aligned)


@jit
def new_vectors(rows):
    """Zeros (rows, LANES) that begin with a line of the cache, for `load` and `store` in compiled code."""
    return new_numbers(rows * LANES).reshape((rows, LANES))


@inline
def address(array):
    """Address of the first entry of an array, as a signed integer.

    `ctypes.data` is unsigned in compiled code. Where a condition picks it or a signed address, Numba makes
    floats of both.
    """
    return np.int64(array.ctypes.data)


def _memory_access(kind):
    """Return intrinsics that read and write numbers of a type in C-contiguous arrays or at addresses."""

    def begin(context, builder, place, value):
        if isinstance(place, types.Array):
            value = cgutils.create_struct_proxy(place)(context, builder, value=value).data
            return builder.ptrtoint(value, INTEGER)
        return value

    @intrinsic
    def read(typingctx, place, row):
        def codegen(context, builder, signature, args):
            return read_from(builder, begin(context, builder, place, args[0]), args[1], kind).value

        return kind(place, types.intp), codegen

    @intrinsic
    def write(typingctx, place, row, value):
        def codegen(context, builder, signature, args):
            number = taken_apart(value, builder, args[2], context)
            write_to(builder, begin(context, builder, place, args[0]), args[1], kind, number)
            return context.get_dummy_value()

        return types.none(place, types.intp, value), codegen

    return read, write


read_number, write_number = _memory_access(types.float64)
load, store = _memory_access(LANES_TYPE)


def _emitted(emit, result=LANES_TYPE, given=LANES_TYPE):
    """Return an intrinsic for what a function emits of one vector or two."""

    def form(*kinds):
        return result(*kinds), lambda context, builder, signature, args: emit(builder, *args)

    if len(signature(emit).parameters) == 2:
        return intrinsic(lambda typingctx, a: form(given))
    return intrinsic(lambda typingctx, a, b: form(given, given))


def _bits(symbol, builder, a, b):
    return builder.bitcast(builder.fcmp_ordered(symbol, a, b), ir.IntType(LANES))


def _all(symbol):
    """Return an intrinsic: whether a comparison, false for NaN, holds in every lane."""
    every = ir.Constant(ir.IntType(LANES), -1)
    return _emitted(
        lambda builder, a, b: builder.icmp_unsigned("==", _bits(symbol, builder, a, b), every), types.boolean
    )


all_less, all_equal = _all("<"), _all("==")
# the lanes where a < b, as the bits of an integer, and the first of them
lanes_less = _emitted(lambda builder, a, b: builder.zext(_bits("<", builder, a, b), INTEGER), types.intp)
first_lane = _emitted(
    lambda builder, a: builder.cttz(a, ir.Constant(ir.IntType(1), 1)), types.intp, types.intp
)


@inline
def any_less(a, b):
    """Whether a < b in any lane."""
    return lanes_less(a, b) != 0


def _exponent(builder, a):
    lowest_mantissa = ir.Constant(_LONGS, [0x3FE6A09E667F3BCD] * LANES)  # sqrt(1/2)
    bits = builder.sub(builder.bitcast(a, _LONGS), lowest_mantissa)
    return builder.sitofp(builder.ashr(bits, _MANTISSA_BITS), VECTOR)


def _scale(builder, a, e):
    shift = builder.shl(builder.fptosi(e, _LONGS), _MANTISSA_BITS)
    return builder.bitcast(builder.add(builder.bitcast(a, _LONGS), shift), VECTOR)


# a = m 2^e of normal positive numbers with m from sqrt(1/2) to sqrt(2): the exponent e, and a 2^e
exponent, scale = _emitted(_exponent), _emitted(_scale)


@intrinsic
def prefetch(typingctx, address, index):
    """Bring vector `index` into the first cache, for who will read it soon."""

    def codegen(context, builder, signature, args):
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, SHORT, SHORT, SHORT])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        pointer = builder.bitcast(next(places_of(builder, *args, LANES_TYPE)), byte)
        builder.call(function, [pointer, *(ir.Constant(SHORT, x) for x in (0, 3, 1))])
        return context.get_dummy_value()

    return types.none(types.intp, types.intp), codegen


@intrinsic
def stream(typingctx, address, index, value):
    """Write a vector past the caches: it will not be read soon. The address is one of `aligned`."""

    def codegen(context, builder, signature, args):
        place = next(places_of(builder, *args[:2], LANES_TYPE))
        written = builder.store(args[2], place, align=8 * LANES)
        written.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(SHORT, 1)]))
        return context.get_dummy_value()

    return types.none(types.intp, types.intp, LANES_TYPE), codegen
