"""A short vector of numbers, one for each particle, as a value inside compiled code.

Left to itself the compiler does not vectorise the recursion over particles: it cannot prove that the arrays
do not overlap, nor keep accumulators in registers. Here the vector is a type of its own, and a kernel
written with it reads as the same kernel for one particle.
"""

import operator

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model


def _lanes_of_this_machine() -> int:
    """Numbers that fill the widest vector register: 8 with AVX-512, otherwise 4."""
    return 8 if llvm.get_host_cpu_features().get("avx512f", False) else 4


LANES = _lanes_of_this_machine()
VECTOR = ir.VectorType(ir.DoubleType(), LANES)
# products and sums may be fused and reordered; NaN and infinity keep their meaning
_FLAGS = ("contract", "reassoc", "nsz", "arcp")


class LanesType(types.Type):
    """Numba's name for `LANES` float64 numbers in a register."""

    def __init__(self):
        super().__init__(name=f"Lanes{LANES}")


LANES_TYPE = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, VECTOR)


def _address(context, builder, array_type, array, row):
    """Pointer to row `row` of a C-contiguous float64 array whose rows have `LANES` numbers."""
    data = cgutils.create_struct_proxy(array_type)(context, builder, value=array).data
    first = builder.mul(row, ir.Constant(row.type, LANES))
    return builder.bitcast(builder.gep(data, [first]), VECTOR.as_pointer())


@intrinsic
def load(typingctx, array, row):
    """Row `row` of an array (rows, LANES)."""

    def codegen(context, builder, signature, args):
        return builder.load(_address(context, builder, signature.args[0], *args), align=8)

    return LANES_TYPE(array, types.intp), codegen


@intrinsic
def store(typingctx, array, row, value):
    """Write row `row` of an array (rows, LANES)."""

    def codegen(context, builder, signature, args):
        array, row, value = args
        builder.store(value, _address(context, builder, signature.args[0], array, row), align=8)
        return context.get_dummy_value()

    return types.none(array, types.intp, LANES_TYPE), codegen


@intrinsic
def splat(typingctx, number):
    """Vector of one number in every lane."""

    def codegen(context, builder, signature, args):
        one = builder.insert_element(
            ir.Constant(VECTOR, ir.Undefined), args[0], ir.Constant(ir.IntType(32), 0)
        )
        mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return builder.shuffle_vector(one, ir.Constant(VECTOR, ir.Undefined), mask)

    return LANES_TYPE(types.float64), codegen


def _elementwise(instruction):
    """Return an intrinsic for an instruction of two vectors."""

    @intrinsic
    def operation(typingctx, a, b):
        def codegen(context, builder, signature, args):
            return getattr(builder, instruction)(*args, flags=_FLAGS)

        return LANES_TYPE(LANES_TYPE, LANES_TYPE), codegen

    return operation


_add, _subtract, _multiply, _divide = (_elementwise(name) for name in ("fadd", "fsub", "fmul", "fdiv"))


def _intrinsic_of_llvm(name):
    """Return an intrinsic for an LLVM function of one vector."""

    @intrinsic
    def operation(typingctx, a):
        def codegen(context, builder, signature, args):
            kind = ir.FunctionType(VECTOR, [VECTOR])
            function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
            return builder.call(function, args)

        return LANES_TYPE(LANES_TYPE), codegen

    return operation


square_root, magnitude, nearest = (_intrinsic_of_llvm(name) for name in ("sqrt", "fabs", "rint"))


@intrinsic
def where_less(typingctx, a, b, x, y):
    """x in the lanes where a < b, and y elsewhere."""

    def codegen(context, builder, signature, args):
        a, b, x, y = args
        return builder.select(builder.fcmp_ordered("<", a, b), x, y)

    return LANES_TYPE(LANES_TYPE, LANES_TYPE, LANES_TYPE, LANES_TYPE), codegen


@intrinsic
def highest(typingctx, a):
    """Largest number of all lanes."""

    def codegen(context, builder, signature, args):
        best = builder.extract_element(args[0], ir.Constant(ir.IntType(32), 0))
        for lane in range(1, LANES):
            other = builder.extract_element(args[0], ir.Constant(ir.IntType(32), lane))
            best = builder.select(builder.fcmp_ordered(">", other, best), other, best)
        return best

    return types.float64(LANES_TYPE), codegen


def _spread(a):
    """The vector itself, or the number in every lane; for compiled code only."""


def _operands(a, b):
    """Whether an operation is one of lanes: of two vectors, or of a vector and a number."""
    kinds = [isinstance(x, LanesType) for x in (a, b)]
    return any(kinds) and all(k or isinstance(x, types.Number) for k, x in zip(kinds, (a, b), strict=True))


@overload(_spread)
def _spread_overload(a):
    return (lambda a: a) if isinstance(a, LanesType) else (lambda a: splat(float(a)))


@overload(operator.add)
def _add_lanes(a, b):
    return (lambda a, b: _add(_spread(a), _spread(b))) if _operands(a, b) else None


@overload(operator.sub)
def _subtract_lanes(a, b):
    return (lambda a, b: _subtract(_spread(a), _spread(b))) if _operands(a, b) else None


@overload(operator.mul)
def _multiply_lanes(a, b):
    return (lambda a, b: _multiply(_spread(a), _spread(b))) if _operands(a, b) else None


@overload(operator.truediv)
def _divide_lanes(a, b):
    return (lambda a, b: _divide(_spread(a), _spread(b))) if _operands(a, b) else None
