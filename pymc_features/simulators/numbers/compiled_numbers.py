"""Numbers in compiled code: their types and operators, and the functions of them."""

import operator
from inspect import signature
from itertools import product

from llvmlite import ir
from numba import types
from numba.extending import (
    intrinsic,
    lower_builtin,
    make_attribute_wrapper,
    models,
    register_model,
    type_callable,
)

from pymc_features.simulators.numbers.kinds import (
    Complex,
    Dual,
    Four,
    Quadratic,
    Slopes,
    Two,
    as_kind,
    chained,
    choose,
    conjugate_of,
    dot_of,
    output_of,
    parts_of,
    scalar_of,
    square_of,
    sum_of,
    value_of,
)
from pymc_features.simulators.numbers.registers import (
    INTEGER,
    WIDEST,
    Register,
    highest_of,
    narrowed,
    vector,
)

SLOPES = 16  # derivatives of a number with slopes


class AnyNumberType(types.Type):
    """Numba's names for numbers."""


class RegisterType(AnyNumberType):
    """Numba's name for `width` float64 numbers in a register."""

    def __init__(self, width):
        self.width = width
        super().__init__(f"Register{width}")


class NumberType(AnyNumberType):
    """Numba's name for numbers of a kind, whose parts are lanes or numbers."""

    def __init__(self, kind, part):
        self.kind, self.part = kind, part
        super().__init__(f"{kind.__name__}({part.name})")


@register_model(RegisterType)
class _RegisterModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, vector(fe_type.width))


@register_model(NumberType)
class _NumberModel(models.StructModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, [(name, fe_type.part) for name in fe_type.kind.fields])


for _name in {name for kind in (Dual, Slopes, Quadratic, Two, Four) for name in kind.fields}:
    make_attribute_wrapper(NumberType, _name, _name)


def register_type(width):
    """The type of Numba of a register; one number is float64."""
    return types.float64 if width == 1 else RegisterType(width)


def taken_apart(kind, builder=None, value=None, context=None):
    """The Python number of registers for a value of a type of Numba."""
    if isinstance(kind, NumberType):
        parts = [builder and builder.extract_value(value, i) for i in range(len(kind.kind.fields))]
        return kind.kind(*(taken_apart(kind.part, builder, part, context) for part in parts))
    if isinstance(kind, RegisterType):
        return Register(kind.width, builder, value)
    return Register(1, builder, builder and context.cast(builder, value, kind, types.float64))


def type_of(number):
    """The type of Numba of a Python number of registers."""
    if isinstance(number, Register):
        return register_type(number.width)
    return NumberType(type(number), type_of(number[0]))


def put_together(context, builder, number):
    """The value of LLVM of a Python number of registers."""
    if isinstance(number, Register):
        return number.value
    value = context.get_value_type(type_of(number))(ir.Undefined)
    for i, part in enumerate(number):
        value = builder.insert_value(value, put_together(context, builder, part), i)
    return value


def emitter(function):
    """What emits the code of a function of Python numbers, as Numba calls it."""

    def emit(context, builder, signature, args):
        pairs = zip(signature.args, args, strict=True)
        numbers = (taken_apart(kind, builder, x, context) for kind, x in pairs)
        return put_together(context, builder, function(*numbers))

    return emit


def compiled(function):
    """Make a function of Python numbers one of compiled code; its code is emitted where it is called."""

    def emit(*kinds):
        return type_of(function(*map(taken_apart, kinds)))(*kinds), emitter(function)

    forms = (
        lambda typingctx, a: emit(a),
        lambda typingctx, a, b: emit(a, b),
        lambda typingctx, a, b, c: emit(a, b, c),
        lambda typingctx, a, b, c, d: emit(a, b, c, d),
    )
    count = len(function.fields) if isinstance(function, type) else len(signature(function).parameters)
    return intrinsic(forms[count - 1])


def _install(symbol):
    """Let an operator in compiled code take numbers."""

    @type_callable(symbol)
    def _type(context):
        def type_of_result(a, b):
            is_known = all(isinstance(x, (AnyNumberType, types.Number)) for x in (a, b))
            if is_known and (isinstance(a, AnyNumberType) or isinstance(b, AnyNumberType)):
                return type_of(symbol(taken_apart(a), taken_apart(b)))
            return None

        return type_of_result

    for pair in product((AnyNumberType, types.Number), repeat=2):
        if AnyNumberType in pair:
            lower_builtin(symbol, *pair)(emitter(symbol))


for _symbol in (operator.add, operator.sub, operator.mul, operator.truediv):
    _install(_symbol)

# In compiled code the kinds and their functions go by these names
new_dual, new_quadratic, new_complex, new_two, new_four = map(compiled, (Dual, Quadratic, Complex, Two, Four))
conjugate, squared_size = compiled(conjugate_of), compiled(square_of)
scalar, chain = compiled(scalar_of), compiled(chained)  # the latter: f(x) by its value and df/dx
with_parts, of_kind, dot = compiled(parts_of), compiled(as_kind), compiled(dot_of)
the_value, the_output, where_less, the_sum, the_narrowed, highest = map(
    compiled, (value_of, output_of, choose, sum_of, narrowed, highest_of)
)
square_root, magnitude = compiled(lambda a: a.call("sqrt")), compiled(lambda a: a.call("fabs"))
alike = compiled(lambda like, x: x.wide(like.width))  # a number in every lane
larger = compiled(lambda a, b: b.where_less(a, b, a))
in_lanes = compiled(lambda x: x.wide(WIDEST))
with_slopes = compiled(lambda x: Slopes(x.wide(SLOPES), x.wide(SLOPES)))  # the type of a number with slopes


def n_registers(kind):
    """Number of registers of a number."""
    return len(kind.kind.fields) * n_registers(kind.part) if isinstance(kind, NumberType) else 1


def n_lanes(kind):
    """Number of lanes of a number."""
    return n_lanes(kind.part) if isinstance(kind, NumberType) else getattr(kind, "width", 1)


def _fact(function):
    """An integer that the type of an argument knows, in compiled code."""

    @intrinsic
    def fact(typingctx, like):
        def codegen(context, builder, signature, args):
            return ir.Constant(INTEGER, function(getattr(like, "number", like)))

        return types.intp(like), codegen

    return fact


def together(number):
    """Numbers of a type go two at a time, unless they carry derivatives, which fill the registers alone."""
    kind = number
    while isinstance(kind, NumberType):
        if kind.kind is Dual:
            return number
        kind = kind.part
    return NumberType(Two, number)


lanes, registers = _fact(n_lanes), _fact(n_registers)
abreast = _fact(lambda number: 1 if together(number) is number else 2)  # how many go together
