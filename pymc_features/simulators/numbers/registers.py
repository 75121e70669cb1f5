"""Registers of LLVM as Python numbers, while a kernel is compiled."""

import llvmlite.binding as llvm
from llvmlite import ir
from numba.core import cgutils

from pymc_features.simulators.numbers.kinds import Number

# products and sums may be fused and reordered; NaN and infinity keep their meaning
FLAGS = ("contract", "reassoc", "nsz", "arcp")
WIDEST = 8 if llvm.get_host_cpu_features().get("avx512f", False) else 4  # numbers in the widest register
INTEGER, SHORT = ir.IntType(64), ir.IntType(32)


def vector(width):
    """The type of LLVM of a register."""
    return ir.DoubleType() if width == 1 else ir.VectorType(ir.DoubleType(), width)


def integers(numbers):
    """Constant integers in a register."""
    return ir.Constant(ir.VectorType(SHORT, len(numbers)), list(numbers))


class Register:
    """Lanes while a kernel is compiled: a value of LLVM, or None while only types are asked for.

    Of two widths the narrow one is a single number, which goes into every lane.
    """

    def __init__(self, width, builder=None, value=None):
        self.width, self.builder, self.value = width, builder, value

    def wide(self, width):
        """Number of this kind in more lanes."""
        if self.builder is None or width == self.width:
            return Register(width, self.builder, self.value)
        nothing = ir.Constant(vector(width), ir.Undefined)
        one = self.builder.insert_element(nothing, self.value, ir.Constant(SHORT, 0))
        return Register(width, self.builder, self.builder.shuffle_vector(one, nothing, integers([0] * width)))

    def constant(self, x):
        """A number in as many lanes."""
        value = float(x) if self.width == 1 else [float(x)] * self.width
        return Register(self.width, self.builder, ir.Constant(vector(self.width), value))

    def emit(self, instruction, other, swapped=False):
        """The result of an instruction of two numbers."""
        if not isinstance(other, (Register, int, float)):
            return NotImplemented
        other = other if isinstance(other, Register) else self.constant(other)
        width = max(self.width, other.width)
        if self.builder is None:
            return Register(width)
        pair = [self.wide(width).value, other.wide(width).value]
        pair = pair[::-1] if swapped else pair
        return Register(width, self.builder, getattr(self.builder, instruction)(*pair, flags=FLAGS))

    def where_less(self, a, b, other):
        """The number itself in the lanes where a < b, another one elsewhere."""
        width = max(x.width for x in (self, a, b, other))
        if self.builder is None:
            return Register(width)
        a, b, x, y = (each.wide(width).value for each in (a, b, self, other))
        return Register(width, self.builder, self.builder.select(self.builder.fcmp_ordered("<", a, b), x, y))

    def call(self, name):
        """A function of LLVM of one vector."""
        if self.builder is None:
            return self
        kind = ir.FunctionType(vector(self.width), [vector(self.width)])
        suffix = "f64" if self.width == 1 else f"v{self.width}f64"
        function = cgutils.get_or_insert_function(self.builder.module, kind, f"llvm.{name}.{suffix}")
        return Register(self.width, self.builder, self.builder.call(function, [self.value]))

    def lanes(self):
        """Its numbers, one by one."""
        if self.builder is None or self.width == 1:
            return [Register(1, self.builder, self.value)] * self.width
        places = (ir.Constant(SHORT, lane) for lane in range(self.width))
        return [
            Register(1, self.builder, self.builder.extract_element(self.value, place)) for place in places
        ]

    def mix(self, other, places):
        """Numbers out of two registers."""
        if self.builder is None:
            return self
        mixed = self.builder.shuffle_vector(self.value, other.value, integers(places))
        return Register(self.width, self.builder, mixed)

    def __add__(self, other):
        return self.emit("fadd", other)

    def __sub__(self, other):
        return self.emit("fsub", other)

    def __mul__(self, other):
        return self.emit("fmul", other)

    def __truediv__(self, other):
        return self.emit("fdiv", other)

    def __radd__(self, other):
        return self.emit("fadd", other)

    def __rsub__(self, other):
        return self.emit("fsub", other, True)

    def __rmul__(self, other):
        return self.emit("fmul", other)

    def __rtruediv__(self, other):
        return self.emit("fdiv", other, True)


def highest_of(x):
    """Largest number of all lanes."""
    best, *others = x.lanes()
    for other in others:
        best = other.where_less(best, other, best)
    return best


def total_of(x):
    """Sum of all lanes, for each part of a number."""
    if isinstance(x, Number):
        return x.each(total_of)
    parts = x.lanes()
    while len(parts) > 1:
        parts = [a + b for a, b in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


def narrowed(x, like):
    """The number as wide as another: summed over its lanes, or as it is."""
    if isinstance(x, Number):
        return x.each(lambda part: narrowed(part, like))
    return x if x.width == like.width else total_of(x)


def transposed(registers):
    """Rows and columns exchanged, of as many registers as they have lanes."""
    width = half = registers[0].width
    registers = list(registers)
    while half > 1:
        half //= 2
        for i in range(width):
            if not i & half:
                a, b = registers[i], registers[i + half]
                upper = [k if not k & half else width + k - half for k in range(width)]
                lower = [k + half if not k & half else width + k for k in range(width)]
                registers[i], registers[i + half] = a.mix(b, upper), a.mix(b, lower)
    return registers
