"""Kinds of numbers: derivatives and complex numbers are the number system's business.

A kernel is written once, for numbers. What it computes follows from the type that it is compiled for:

    kind          parts             stands for                          in a kernel it gives
    lanes         -                 n structures, modes or samples      values; one lane is float64
    Dual          v, s, d           v and its derivatives by s and d    gradients
    Slopes        v, by             v and its derivatives, side by side gradients by many parameters
    Quadratic     re, im, square    re + im J with J^2 = square         modes, of any damping
    Complex       re, im            re + im i                           poles, responses to harmonic forces
    Two, Four     first ... fourth  the same for several numbers        modes or samples side by side

Parts are lanes or, again, numbers: Quadratic of Dual is a pole with derivatives. Each kind is a Python class
of a few lines. In compiled code the same class is used at compile time: its operators run once, on the
registers of LLVM, and what they emit is the machine code, see `registers` and `compiled_numbers`.
"""

import operator


class Number(tuple):
    """Numbers made of parts; a constant added to one is added to its first part."""

    __slots__ = ()
    fields = ()

    def __new__(cls, *parts):
        return super().__new__(cls, parts)

    def each(self, function, *others):
        """Apply a function to all parts."""
        return type(self)(*map(function, self, *others))

    def __add__(self, other):
        if type(other) is type(self):
            return self.each(operator.add, other)
        return type(self)(self[0] + other, *self[1:])

    def __mul__(self, other):
        return self.each(lambda part: part * other)

    def __sub__(self, other):
        return self + -1.0 * other

    def __rsub__(self, other):
        return -1.0 * self + other

    def __radd__(self, other):
        return self + other

    def __rmul__(self, other):
        return self * other


class Dual(Number):
    """A value and its derivatives by s = (omega h)^2 and d = D h."""

    __slots__ = ()
    fields = ("v", "s", "d")

    def __mul__(self, other):
        if type(other) is not Dual:
            return super().__mul__(other)
        (a, *slopes), (b, *others) = self, other
        return Dual(a * b, *(slope * b + a * change for slope, change in zip(slopes, others, strict=True)))


class Slopes(Number):
    """A value, in each lane of a register, and its derivatives by as many parameters."""

    __slots__ = ()
    fields = ("v", "by")

    def __mul__(self, other):
        if type(other) is not Slopes:
            return super().__mul__(other)
        (a, by_a), (b, by_b) = self, other
        return Slopes(a * b, by_a * b + a * by_b)


class Quadratic(Number):
    """Numbers re + im J, J^2 = square: complex below critical damping, two real poles above."""

    __slots__ = ()
    fields = ("re", "im", "square")

    def __add__(self, other):
        if type(other) is not Quadratic:
            return Quadratic(self[0] + other, self[1], self[2])
        return Quadratic(self[0] + other[0], self[1] + other[1], self[2])

    def __mul__(self, other):
        a, b, square = self
        if type(other) is not Quadratic:
            return Quadratic(a * other, b * other, square)
        c, d, _ = other
        return Quadratic(a * c + (square * b) * d, a * d + b * c, square)


class Complex(Number):
    """Complex numbers, whose parts may carry derivatives: multiplied from the right by what has one part."""

    __slots__ = ()
    fields = ("re", "im")

    def __mul__(self, other):
        if type(other) is not Complex:
            return super().__mul__(other)
        (a, b), (c, d) = self, other
        return Complex(a * c - b * d, a * d + b * c)


class Several(Number):
    """Numbers side by side: all operations are done with each."""

    __slots__ = ()

    def __add__(self, other):
        return self.each(operator.add, other) if type(other) is type(self) else self.each(lambda x: x + other)

    def __mul__(self, other):
        return self.each(operator.mul, other) if type(other) is type(self) else self.each(lambda x: x * other)


class Two(Several):
    """Two numbers."""

    __slots__ = ()
    fields = ("first", "second")


class Four(Several):
    """Four numbers."""

    __slots__ = ()
    fields = ("first", "second", "third", "fourth")


def value_of(x):
    """The number without its derivatives."""
    if isinstance(x, Several):
        return x.each(value_of)
    return x[0] if isinstance(x, Dual) else x


def output_of(y):
    """Output of a mode: the J part of its state."""
    if isinstance(y, Several):
        return y.each(output_of)
    return y[1] if isinstance(y, Quadratic) else y


def scalar_of(x):
    """The value of a number with slopes, or the number itself."""
    return x[0].lanes()[0] if isinstance(x, Slopes) else x


def chained(x, value, by):
    """A function of x by its value and its derivative by x."""
    return Slopes(value.wide(x[0].width), x[1] * by) if isinstance(x, Slopes) else value


def conjugate_of(x):
    """Conjugate of a complex number."""
    return Complex(x[0], -1.0 * x[1])


def square_of(x):
    """Square of the absolute value of a complex number, without derivatives."""
    re, im = value_of(x[0]), value_of(x[1])
    return re * re + im * im


def choose(a, b, x, y):
    """x in the lanes where a < b, y elsewhere."""
    return x.each(lambda p, q: choose(a, b, p, q), y) if isinstance(x, Number) else x.where_less(a, b, y)


def sum_of(x):
    """Sum of several numbers."""
    return (x[0] + x[1]) + (x[2] + x[3]) if len(x) == 4 else x[0] + x[1]


def parts_of(x):
    """Value and derivatives, which are zero of a number that carries none."""
    return x if isinstance(x, Dual) else Dual(x, 0.0 * x, 0.0 * x)


def as_kind(x, like):
    """A number with derivatives as one of the kind of another: with them, or without."""
    if isinstance(x, Several):
        return x.each(lambda y: as_kind(y, like))
    return x if isinstance(like, Dual) else x[0]


def dot_of(x, a, b, c):
    """a times the value of a number, plus b and c times its derivatives."""
    return x.each(lambda y: dot_of(y, a, b, c)) if isinstance(x, Several) else x[0] * a + x[1] * b + x[2] * c
