"""More about vectors (`lanes.py`): memory by its address, neighbours, comparisons, exponents."""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from pymc_features.simulators.compiled.jit import inline, jit
from pymc_features.simulators.compiled.vector import LANES, LANES_TYPE, VECTOR

_LONG, _SHORT = ir.IntType(64), ir.IntType(32)
_LONGS = ir.VectorType(_LONG, LANES)
_MANTISSA_BITS = ir.Constant(_LONGS, [52] * LANES)
LINE = 64  # bytes: a vector that begins at a multiple of its length is loaded at once


def aligned(size: int) -> np.ndarray:
    """Return `size` float64 zeros that begin with a line of the cache.

    Compiled code reaches them by their address, `array.ctypes.data`: an array among the arguments of each
    small function costs two atomic operations of reference counting, more than the work in it. Whoever calls
    a kernel keeps the array until it returns.
    """
    whole = np.zeros(size + LINE // 8)
    first = -whole.ctypes.data % LINE // 8
    return whole[first : first + size]


@inline
def address(array):
    """Address of the first entry of an array, as a signed integer.

    `ctypes.data` is unsigned in compiled code. Where a condition picks it or a signed address, Numba makes
    floats of both.
    """
    return np.int64(array.ctypes.data)


@jit
def new_vectors(rows):
    """Zeros (rows, LANES) that begin with a line of the cache, for `load` and `store` in compiled code."""
    whole = np.zeros(rows * LANES + LINE // 8)
    first = -whole.ctypes.data % LINE // 8
    return whole[first : first + rows * LANES].reshape((rows, LANES))


def _pointer(builder, address, index, kind, size):
    """Pointer to number `index` of numbers or vectors of `size` bytes."""
    return builder.inttoptr(
        builder.add(address, builder.mul(index, ir.Constant(index.type, size))), kind.as_pointer()
    )


def _memory_access(kind, numba_kind, size):
    """Return intrinsics that read and write numbers, or vectors, at an address."""

    @intrinsic
    def read(typingctx, address, index):
        def codegen(context, builder, signature, args):
            return builder.load(_pointer(builder, *args, kind, size), align=8)

        return numba_kind(types.intp, types.intp), codegen

    @intrinsic
    def write(typingctx, address, index, value):
        def codegen(context, builder, signature, args):
            builder.store(args[2], _pointer(builder, *args[:2], kind, size), align=8)
            return context.get_dummy_value()

        return types.none(types.intp, types.intp, numba_kind), codegen

    return read, write


read_number, write_number = _memory_access(ir.DoubleType(), types.float64, 8)
read_lanes, write_lanes = _memory_access(VECTOR, LANES_TYPE, 8 * LANES)


@intrinsic
def prefetch(typingctx, address, index):
    """Bring vector `index` into the first cache, for who will read it soon."""

    def codegen(context, builder, signature, args):
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, _SHORT, _SHORT, _SHORT])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        pointer = builder.bitcast(_pointer(builder, *args, VECTOR, 8 * LANES), byte)
        builder.call(function, [pointer, *(ir.Constant(_SHORT, x) for x in (0, 3, 1))])
        return context.get_dummy_value()

    return types.none(types.intp, types.intp), codegen


@intrinsic
def stream_lanes(typingctx, address, index, value):
    """Write a vector past the caches: it will not be read soon. The address is one of `aligned`."""

    def codegen(context, builder, signature, args):
        store = builder.store(args[2], _pointer(builder, *args[:2], VECTOR, 8 * LANES), align=8 * LANES)
        store.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(_SHORT, 1)]))
        return context.get_dummy_value()

    return types.none(types.intp, types.intp, LANES_TYPE), codegen


def _shift(first):
    """Return an intrinsic for `LANES` numbers out of two vectors in a row, from number `first` on."""

    @intrinsic
    def operation(typingctx, a, b):
        def codegen(context, builder, signature, args):
            picked = [first + lane for lane in range(LANES)]
            return builder.shuffle_vector(*args, ir.Constant(ir.VectorType(_SHORT, LANES), picked))

        return LANES_TYPE(LANES_TYPE, LANES_TYPE), codegen

    return operation


# of (last, this): every lane's lower neighbour; of (this, next): its upper neighbour
below, above = _shift(LANES - 1), _shift(1)


def _comparison(symbol, every):
    """Return an intrinsic: whether a comparison, false for NaN, holds in every lane, or in any."""

    @intrinsic
    def operation(typingctx, a, b):
        def codegen(context, builder, signature, args):
            bits = builder.bitcast(builder.fcmp_ordered(symbol, *args), ir.IntType(LANES))
            if every:
                return builder.icmp_unsigned("==", bits, ir.Constant(bits.type, -1))
            return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

        return types.boolean(LANES_TYPE, LANES_TYPE), codegen

    return operation


all_less, all_equal, any_less = _comparison("<", True), _comparison("==", True), _comparison("<", False)


@intrinsic
def lanes_less(typingctx, a, b):
    """The lanes where a < b, as the bits of an integer."""

    def codegen(context, builder, signature, args):
        bits = builder.bitcast(builder.fcmp_ordered("<", *args), ir.IntType(LANES))
        return builder.zext(bits, _LONG)

    return types.intp(LANES_TYPE, LANES_TYPE), codegen


@intrinsic
def first_lane(typingctx, lanes):
    """The first of the lanes in an integer of `lanes_less` that is not zero."""

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.intp(types.intp), codegen


@intrinsic
def exponent(typingctx, a):
    """The e for which a = m 2^e with m from sqrt(1/2) to sqrt(2); `a` is a normal positive number."""

    def codegen(context, builder, signature, args):
        lowest_mantissa = ir.Constant(_LONGS, [0x3FE6A09E667F3BCD] * LANES)  # sqrt(1/2)
        bits = builder.sub(builder.bitcast(args[0], _LONGS), lowest_mantissa)
        return builder.sitofp(builder.ashr(bits, _MANTISSA_BITS), VECTOR)

    return LANES_TYPE(LANES_TYPE), codegen


@intrinsic
def scale(typingctx, a, e):
    """a 2^e for whole numbers `e`; result and `a` are normal numbers."""

    def codegen(context, builder, signature, args):
        shift = builder.shl(builder.fptosi(args[1], _LONGS), _MANTISSA_BITS)
        return builder.bitcast(builder.add(builder.bitcast(args[0], _LONGS), shift), VECTOR)

    return LANES_TYPE(LANES_TYPE, LANES_TYPE), codegen


@intrinsic
def total(typingctx, a):
    """Sum of all lanes."""

    def codegen(context, builder, signature, args):
        parts = [builder.extract_element(args[0], ir.Constant(_SHORT, i)) for i in range(LANES)]
        while len(parts) > 1:
            parts = [builder.fadd(x, y) for x, y in zip(parts[::2], parts[1::2], strict=True)]
        return parts[0]

    return types.float64(LANES_TYPE), codegen
