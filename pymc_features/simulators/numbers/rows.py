"""Numbers in memory, reached by address: rows[i] reads one, rows[i] = x writes one.

Whoever takes them with `view` keeps the array until the kernel returns: arrays among the arguments of each
small function would cost two atomic operations of reference counting, more than the work in it.
"""

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from pymc_features.simulators.numbers.compiled_numbers import (
    NumberType,
    n_lanes,
    n_registers,
    put_together,
    taken_apart,
    together,
)
from pymc_features.simulators.numbers.registers import INTEGER, Register, transposed, vector


class RowsType(types.Type):
    """Numba's name for numbers in memory."""

    def __init__(self, number):
        self.number = number
        super().__init__(f"Rows({number.name})")


@register_model(RowsType)
class _RowsModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, INTEGER)


@intrinsic
def zero(typingctx, rows):
    """Nothing, as a number like those in memory."""
    kind = rows.number

    def codegen(context, builder, signature, args):
        return cgutils.get_null_value(context.get_value_type(kind))

    return kind(rows), codegen


@intrinsic
def view(typingctx, array, like):
    """An array as `Rows` of numbers like the one given."""

    def codegen(context, builder, signature, args):
        data = cgutils.create_struct_proxy(array)(context, builder, value=args[0]).data
        return builder.ptrtoint(data, INTEGER)

    return RowsType(like)(array, like), codegen


@intrinsic
def moved(typingctx, rows, count):
    """The numbers in memory from `count` float64 on."""

    def codegen(context, builder, signature, args):
        return builder.add(args[0], builder.mul(args[1], ir.Constant(INTEGER, 8)))

    return rows(rows, types.intp), codegen


@intrinsic
def side_by_side(typingctx, rows):
    """Numbers in memory, as many in one as go together."""
    return RowsType(together(rows.number))(rows), lambda context, builder, signature, args: args[0]


def places_of(builder, address, index, kind):
    """Pointers to all registers of number `index`."""
    width = n_lanes(kind)
    first = builder.mul(index, ir.Constant(INTEGER, 8 * width * n_registers(kind)))
    first = builder.add(address, first)
    for i in range(n_registers(kind)):
        place = builder.add(first, ir.Constant(INTEGER, 8 * width * i))
        yield builder.inttoptr(place, vector(width).as_pointer())


def read_from(builder, address, index, number):
    places, width = places_of(builder, address, index, number), n_lanes(number)

    def read(kind):
        if not isinstance(kind, NumberType):
            return Register(width, builder, builder.load(next(places), align=8))
        return kind.kind(*(read(kind.part) for _ in kind.kind.fields))

    return read(number)


def write_to(builder, address, index, kind, number):
    places, width = places_of(builder, address, index, kind), n_lanes(kind)

    def write(number):
        if isinstance(number, Register):
            builder.store(number.wide(width).value, next(places), align=8)
        else:
            for part in number:
                write(part)

    write(number)


@type_callable(operator.getitem)
def _type_of_read(context):
    def type_of_read(rows, index):
        return rows.number if isinstance(rows, RowsType) and isinstance(index, types.Integer) else None

    return type_of_read


@lower_builtin(operator.getitem, RowsType, types.Integer)
def _read(context, builder, signature, args):
    rows, index = signature.args
    index = context.cast(builder, args[1], index, types.intp)
    return put_together(context, builder, read_from(builder, args[0], index, rows.number))


@type_callable(operator.setitem)
def _type_of_write(context):
    def type_of_write(rows, index, number):
        return types.none if isinstance(rows, RowsType) and isinstance(index, types.Integer) else None

    return type_of_write


@lower_builtin(operator.setitem, RowsType, types.Integer, types.Any)
def _write(context, builder, signature, args):
    (rows, index, number), (address, at, x) = signature.args, args
    at = context.cast(builder, at, index, types.intp)
    write_to(builder, address, at, rows.number, taken_apart(number, builder, x, context))
    return context.get_dummy_value()


@intrinsic
def turn(typingctx, rows, first, step, target, place, outer, inner):
    """Write numbers `first`, `first + step`, ... with lanes exchanged for numbers: one for each lane.

    Number m goes to `place + (m // 2) outer + (m % 2) inner`.
    """

    def codegen(context, builder, signature, args):
        (rows_at, first, step, target_at, place, outer, inner), kind = args, rows.number
        width = n_lanes(kind)

        def flat(x):
            return [x] if isinstance(x, Register) else [leaf for part in x for leaf in flat(part)]

        def built(kind, leaves):
            if not isinstance(kind, NumberType):
                return next(leaves)
            return kind.kind(*(built(kind.part, leaves) for _ in kind.kind.fields))

        def at(start, stride, m):
            return builder.add(start, builder.mul(stride, ir.Constant(INTEGER, m)))

        read = [flat(read_from(builder, rows_at, at(first, step, m), kind)) for m in range(width)]
        parts = [transposed([number[i] for number in read]) for i in range(len(read[0]))]
        for m in range(width):
            here, number = (
                at(at(place, outer, m // 2), inner, m % 2),
                built(kind, iter([p[m] for p in parts])),
            )
            write_to(builder, target_at, here, target.number, number)
        return context.get_dummy_value()

    return types.none(rows, types.intp, types.intp, target, types.intp, types.intp, types.intp), codegen
