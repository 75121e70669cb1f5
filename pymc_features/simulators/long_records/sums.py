"""Sums over time without going through time, for one structure in each lane, with derivatives or without.

The number that is marched is y = g (u + phi_2 a), of which the response takes the part beside J. As a complex
number, divided by i omega_d, it is that the response takes its real part of. From one output to the next, c
steps of the recursion,

    y[n+1] = E y[n] + sum_p D_p a_p[n],   E = e^c,   D_p = e^(c-1-p) (drive),   a_p[n] = a[c n + p],

and so, multiplied by itself for two modes and summed over n = 0 ... N - 1, with E = 1 + w,

    -(w_r + w_s + w_r w_s) sum_n y_r y_s = sum_p (D_pr B_ps + D_ps B_pr) + y_r[0] y_s[0] - y_r[N] y_s[N],
    B_p = E sum_n a_p[n] y[n] + (1/2) sum_q (sum_n a_p a_q) D_q.

The real part of two products is half of this, plus half of the same with the conjugate of y_s. What a sum
over time with any row b needs are the polynomials P = sum_l e^(l-1) sum_k b[k] a[k-l] and, if the record does
not begin with zero, K = sum_k b[k] e^k:

    sum_k b[k] y[k] = (drive) P + y[0] K,   y[0] = g phi_2 a[0].
"""

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.long_records.stencil import REACH, TAPS, TERMS
from pymc_features.simulators.numbers.compiled_numbers import (
    NumberType,
    compiled,
    in_lanes,
    lanes,
    magnitude,
    n_lanes,
    n_registers,
    new_dual,
    of_kind,
    put_together,
    registers,
    square_root,
    the_sum,
    the_value,
    with_parts,
)
from pymc_features.simulators.numbers.kinds import Number, Several, Two, value_of
from pymc_features.simulators.numbers.registers import INTEGER, Register
from pymc_features.simulators.numbers.rows import turn, view, zero
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY
from pymc_features.simulators.oscillators.exact_step import exponentials
from pymc_features.simulators.oscillators.reduction import CLOSE
from pymc_features.simulators.oscillators.samples import new_numbers

FASTEST = 25.0  # omega h of a mode that is evaluated
HEAVY = 1.98  # D over omega from which a pole and its conjugate come too near each other
DECAYED = 37.0  # e^-37 = 1e-16
N_ROWS = 48  # rows of nodes of a level: more than 2 DECAYED (N + 8) / (2 pi / 3 N)
TURNS = np.exp(1j * np.pi / 3.0 * np.arange(6))  # exp(i omega t) at the nodes, t the centre of time
TURN_TERMS = 19  # of exp(x), |x| < 0.75: the first dropped term is below 1e-18


class Complex(Number):
    """Complex numbers, whose parts may carry derivatives: multiplied from the right by what has one part."""

    __slots__ = ()
    fields = ("re", "im")

    def __mul__(self, other):
        if type(other) is not Complex:
            return super().__mul__(other)
        (a, b), (c, d) = self, other
        return Complex(a * c - b * d, a * d + b * c)


def plain_of(x):
    """A complex number, or several, without derivatives."""
    return x.each(plain_of) if isinstance(x, Several) else Complex(value_of(x[0]), value_of(x[1]))


def mirrored_of(x):
    """A complex number without derivatives, and its conjugate, side by side."""
    re, im = plain_of(x)
    return Two(Complex(re, im), Complex(re, -1.0 * im))


def inverse_of(x):
    """1 / x, of complex numbers: Newton's step from an exact start gives the derivatives."""
    if isinstance(x, Several):
        return x.each(inverse_of)
    re, im = plain_of(x)
    start = Complex(re, -1.0 * im) * (1.0 / (re * re + im * im))
    return start if isinstance(x[0], Register) else start * (2.0 - x * start)


new_complex, mirrored, inverse = map(compiled, (Complex, mirrored_of, inverse_of))
size_of = compiled(lambda x: plain_of(x)[0] * plain_of(x)[0] + plain_of(x)[1] * plain_of(x)[1])


@intrinsic
def in_one_lane(typingctx, rows, index, lane):
    """Number `index` in memory as it is in one lane."""

    def narrow(kind):
        return NumberType(kind.kind, narrow(kind.part)) if isinstance(kind, NumberType) else types.float64

    kind, width, count = narrow(rows.number), n_lanes(rows.number), n_registers(rows.number)

    def codegen(context, builder, signature, args):
        address, index, lane = args
        first = builder.add(builder.mul(index, ir.Constant(INTEGER, width * count)), lane)

        def read(kind, part):
            if isinstance(kind, NumberType):
                each = n_registers(kind.part)
                return kind.kind(*(read(kind.part, part + i * each) for i in range(len(kind.kind.fields))))
            place = builder.add(first, ir.Constant(INTEGER, part * width))
            place = builder.add(address, builder.mul(place, ir.Constant(INTEGER, 8)))
            return Register(1, builder, builder.load(builder.inttoptr(place, ir.DoubleType().as_pointer())))

        return put_together(context, builder, read(kind, 0))

    return kind(rows, types.intp, types.intp), codegen


class Mesh(NamedTuple):
    """What compiled code reads of a table.

    Attributes
    ----------
    duration, step : float
        Of the record and of the recursion [s].
    spacing : array (levels,)
        Of the nodes [rad/s].
    begins, lowest, highest : integer array (levels N_ROWS,)
        Where a row of nodes begins, and its first and last column; first beyond last if empty.
    values : array (nodes blocks vectors 2 LANES,)
        P of all rows b and, if the record does not begin with zero, K: real parts and imaginary parts.
    even, odd : array (REACH + 1, TERMS)
        Of the stencil.
    """

    duration: float
    step: float
    spacing: np.ndarray
    begins: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    values: np.ndarray
    even: np.ndarray
    odd: np.ndarray


class Products(NamedTuple):
    """Sums of products of record and data over all outputs; rows b are s data, c phases, the end, own values.

    Attributes
    ----------
    squares, with_own, own : array (s,), (s,), (1,)
        Data by themselves and with the values that the feed-through passes on, and these by themselves.
    with_input : array (functions,)
        Rows with the input that is marched.
    phases : array (c, c)
    first : float
        a[0].
    own_at : int
        Which row has the own values.
    """

    squares: np.ndarray
    with_own: np.ndarray
    own: np.ndarray
    with_input: np.ndarray
    phases: np.ndarray
    first: float
    own_at: int


class Found(NamedTuple):
    """Results for all structures; the last three empty where no gradient is asked.

    Attributes
    ----------
    squares, sizes : array (p, s)
        Sums of squared misfits, and what their rounding errors are relative to; infinite if not evaluated.
    outputs, by_square, by_damping : array (p, s, m), (p, m), (p, m)
        What `reduction.derive_from` goes on from.
    """

    squares: np.ndarray
    sizes: np.ndarray
    outputs: np.ndarray
    by_square: np.ndarray
    by_damping: np.ndarray


@jit
def place_of(mesh, square, damping):
    """Row and column of the nearest node, and the spacing; row -1 if the mesh does not reach there."""
    sigma, level, duration = 0.5 * damping, 0, mesh.duration
    if not (damping >= 0.0 and damping * damping < HEAVY * HEAVY * square):  # NaN too
        return -1, 0, 1.0
    while sigma * duration >= 2.0 * DECAYED:
        level, duration = level + 1, 0.5 * duration
    if level >= mesh.spacing.size or square * mesh.step**2 > FASTEST**2:
        return -1, 0, 1.0
    spacing = mesh.spacing[level]
    column = np.rint(np.sqrt(square - sigma * sigma) / spacing)
    return level * N_ROWS + int(np.rint(sigma / spacing)), int(column), spacing


@jit
def are_apart(systems, p, duration):
    """Whether no two modes of a structure are close as in `reduction.nearness`, nor nearly so."""
    for r in range(systems.omega.shape[1] - 1):
        omega, after, damping = systems.omega[p, r], systems.omega[p, r + 1], systems.damping[p, r]
        memory = max(min(duration, 2.0 / damping), 3.0 / omega)
        growth = (after + omega) * duration * duration
        if not (after - omega) * min(memory, growth) > 2.0 * CLOSE:
            return False
    return True


@jit
def put_places(systems, mesh, p, lane, numbers, entries, reach, wants_gradient):
    """Write the poles of structure p into a lane, and where their stencils begin; whether nodes are there.

    `numbers` (m 7, LANES) are s, d, fineness, column, row and exp(i omega t) of the node; columns that are
    needed and missing are added to the reach. A structure that the table does not serve leaves it as it is.
    """
    m, h, is_served, is_there = systems.omega.shape[1], mesh.step, systems.valid[p], True
    if wants_gradient:
        is_served &= are_apart(systems, p, mesh.duration)
    for r in range(m):
        row, _, _ = place_of(mesh, systems.omega[p, r] ** 2, systems.damping[p, r])
        is_served &= row >= 0
    for r in range(m):
        s, d, own = 1.0, 0.1, numbers[7 * r : 7 * r + 7]
        own[2:, lane] = 0.0
        if is_served:
            s, d = (systems.omega[p, r] * h) ** 2, systems.damping[p, r] * h
            row, column, spacing = place_of(mesh, systems.omega[p, r] ** 2, systems.damping[p, r])
            if column - REACH < mesh.lowest[row] or column + REACH > mesh.highest[row]:
                reach[0, row], reach[1, row] = (
                    min(reach[0, row], column - REACH),
                    max(reach[1, row], column + REACH),
                )
                is_there = False
            entries[r, lane] = mesh.begins[row] + column - REACH - mesh.lowest[row]
            angle = TURNS[column % 6]
            own[2, lane], own[3, lane], own[4, lane] = 1.0 / (spacing * h), column, row % N_ROWS
            own[5, lane], own[6, lane] = angle.real, angle.imag
        own[0, lane], own[1, lane] = s, d
    return is_served and is_there


class Room(NamedTuple):
    """Memory for the structures in the lanes, as `Rows`; of each mode unless said otherwise.

    Attributes
    ----------
    weights, found : complex (TAPS), (functions)
        Of one mode.
    growth, start, end : complex (m)
        w, y[0] and y[N].
    drive, before : complex (m c)
        D and B.
    passed, after, through : part (m)
        sum y a, what stands before the input in the state, and sums of the output times own values.
    first, left : part (m s), (s)
        Sums of the output times data less feed-through, and, of one mode, less what all modes put out.
    sizes : (m)
    shares, feed, factors : (s m), (s), (s)
        S Phi Gamma, J and -2 w / N.
    """

    weights: object
    found: object
    growth: object
    start: object
    end: object
    drive: object
    before: object
    passed: object
    after: object
    through: object
    first: object
    left: object
    sizes: object
    shares: object
    feed: object
    factors: object


@jit
def new_room(m, s, c, n_functions, state):
    """The `Room` of numbers like the state, and its last three parts as arrays, which the caller keeps."""
    like, part = in_lanes(0.0), state.re
    one = lanes(like)
    whole, half, f = registers(state) * one, registers(part) * one, (n_functions + one - 1) // one * one
    sizes = np.array(
        (TAPS * whole, 2 * f * whole, m * whole, m * whole, m * whole, m * c * whole, m * c * whole)
        + (m * half, m * half, m * half, m * s * half, s * half, m * one, s * m * one, s * one, s * one)
    )
    at = np.cumsum(sizes)
    memory, at = new_numbers(at[-1]), at - sizes
    return (memory[at[13] : at[14]], memory[at[14] : at[15]], memory[at[15] :]), Room(
        view(memory[at[0] :], state),
        view(memory[at[1] :], state),
        view(memory[at[2] :], state),
        view(memory[at[3] :], state),
        view(memory[at[4] :], state),
        view(memory[at[5] :], state),
        view(memory[at[6] :], state),
        view(memory[at[7] :], part),
        view(memory[at[8] :], part),
        view(memory[at[9] :], part),
        view(memory[at[10] :], part),
        view(memory[at[11] :], part),
        view(memory[at[12] :], like),
        view(memory[at[13] :], like),
        view(memory[at[14] :], like),
        view(memory[at[15] :], like),
    )


@jit
def write_weights(room, even, odd, nu):
    """Write the weights of the stencil at nu; coefficients are rows of numbers."""
    square = nu * nu
    for n in range(REACH + 1):
        last = n * TERMS + TERMS - 1
        a, b = 0.0 * nu + even[last], 0.0 * nu + odd[last]
        for k in range(1, TERMS):
            a, b = a * square + even[last - k], b * square + odd[last - k]
        b = b * nu
        room.weights[REACH + n], room.weights[REACH - n] = a + b, a - b


@jit
def take_functions(room, values, lane, entry, blocks, vectors):
    """Interpolate all functions of a lane, whose lanes are functions then; `values` are rows of nodes."""
    for i in range(blocks * vectors):
        total = zero(room.found)
        at = entry * blocks * vectors + i
        for n in range(TAPS):
            total = total + in_one_lane(room.weights, n, lane) * values[at]
            at += blocks * vectors
        room.found[i * lanes(total) + lane] = total


@jit
def drive_of(z, s, d, quantity, h):
    """e - 1, c and g phi_2 of a step, as `exact_step`."""
    _, phi_1, phi_2 = exponentials(z, s, d)
    w = z * phi_1
    if quantity == RELATIVE_DISPLACEMENT:
        return w, (phi_1 + phi_2 * w) * (0.0 - h * h), phi_2 * (h * h)
    if quantity == RELATIVE_VELOCITY:
        return w, phi_1 * w * (0.0 - h), (phi_1 - 1.0) * h
    return w, w * w * -1.0, z * (phi_1 - 1.0)


@jit
def take_mode(room, numbers, entries, r, count, given, quantity):
    """Write what mode r of the structures in `count` lanes gives by itself.

    `given` are mesh, products, rows of the stencil's coefficients, of nodes, and the number of vectors.
    """
    mesh, products, even, odd, values, vectors = given
    own, kind, h = 7 * r, zero(room.passed), mesh.step
    s, d, nil = numbers[own], numbers[own + 1], 0.0 * numbers[own]
    root = square_root(s - 0.25 * d * d)
    by_d = d * (-0.25 / root)
    omega = of_kind(new_dual(root, 0.5 / root, by_d), kind)
    # -i / omega_d, which takes the part beside J for the real one
    inverted = of_kind(new_dual(-1.0 / root, 0.5 / (root * root * root), by_d / (root * root)), kind)
    z = new_complex(of_kind(new_dual(-0.5 * d, nil, nil - 0.5), kind), omega)
    part = new_complex(0.0 * omega, inverted)
    fineness, column, row = numbers[own + 2], numbers[own + 3], numbers[own + 4]
    nu = new_complex(omega * fineness - column, (-1.0 * z.re) * fineness - row)
    write_weights(room, even, odd, nu)
    blocks = 1 if products.first == 0.0 else 2
    for lane in range(count):
        if in_one_lane(numbers, own + 2, lane) > 0.0:
            take_functions(room, values, lane, entries[r, lane], blocks, vectors)
    for i in range(blocks * vectors):
        first = i * lanes(nil)
        turn(room.found, first, 1, room.found, first, 2, 1)
    angle, x = nu * nu * 0.0 + 1.0, new_complex((-1.0 * nu.im) * (np.pi / 3.0), nu.re * (np.pi / 3.0))
    for k in range(TURN_TERMS, 0, -1):
        angle = angle * x * (1.0 / k) + 1.0
    angle = angle * new_complex(numbers[own + 5], numbers[own + 6])
    w, drive, after = drive_of(z, s, d, quantity, h)
    drive, after = drive * part, after * part
    start = after * products.first
    room.start[r], room.after[r] = start, after.re
    finish_mode(room, products, r, (w, drive, drive * angle, start * angle), blocks, vectors)


@jit
def function_of(room, f, scales, blocks, second):
    """sum_k b[k] y[k] of row f; functions of the second block lie `second` behind."""
    total = room.found[f] * scales[0]
    if blocks > 1:
        total = total + room.found[second + f] * scales[1]
    return total


@jit
def finish_mode(room, products, r, steps, blocks, vectors):
    """Write what the products of mode r with others need, and its sums with data and own values."""
    w, drive = steps[:2]
    scales = steps[2:]
    e, c, s = w + 1.0, products.phases.shape[0], products.squares.size
    second, after = vectors * lanes(room.shares[0]), room.after[r]
    growth = w
    for p in range(c - 1, -1, -1):
        room.drive[r * c + p] = drive
        drive = drive * e
        if p > 0:
            growth = growth + w + growth * w
    room.growth[r], e = growth, growth + 1.0
    room.end[r] = function_of(room, s + c, scales, blocks, second)
    size = size_of(room.end[r]) + size_of(room.start[r])
    for p in range(c):
        total = function_of(room, s + p, scales, blocks, second)
        if p == 0:
            room.passed[r] = total.re
        total = total * e
        for q in range(c):
            total = total + room.drive[r * c + q] * (0.5 * products.phases[p, q])
        room.before[r * c + p] = total
        size = size + 2.0 * square_root(size_of(room.drive[r * c + p]) * size_of(total))
    through = function_of(room, products.own_at, scales, blocks, second).re
    room.through[r] = through - after * products.with_input[products.own_at]
    for j in range(s):
        data = function_of(room, j, scales, blocks, second).re - after * products.with_input[j]
        room.first[r * s + j] = data - room.through[r] * room.feed[j]
    decay = magnitude(2.0 * mirrored(growth).first.re + size_of(growth))
    size = square_root(size / decay) + magnitude(the_value(after)) * np.sqrt(products.with_input[s])
    room.sizes[r] = size


@jit
def product_of(room, products, r, q):
    """Sum over time of the outputs of modes r and q, with derivatives by the pole of r."""
    c = products.phases.shape[0]
    total = mirrored(room.start[q]) * room.start[r] - mirrored(room.end[q]) * room.end[r]
    for p in range(c):
        drive, before = mirrored(room.drive[q * c + p]), mirrored(room.before[q * c + p])
        total = total + drive * room.before[r * c + p] + before * room.drive[r * c + p]
    growth, other = room.growth[r], mirrored(room.growth[q])
    total = total * inverse((other * growth + other + growth) * -1.0)
    after, passed = the_value(room.after[q]), the_value(room.passed[q])
    own = room.after[r] * (after * products.with_input[products.squares.size] - passed)
    return the_sum(total).re * 0.5 + own - room.passed[r] * after


@jit
def write_results(room, products, places, is_there, m, quantity, found):
    """Write results of structures; `places` is the first, `is_there` which lanes are evaluated."""
    s, like = products.squares.size, 0.0 * room.feed[0]
    numbers = new_numbers((2 * s + s * m + 2 * m) * lanes(like))
    out, wants_gradient = view(numbers, like), found.by_square.shape[0] > 0
    relative = quantity != RELATIVE_DISPLACEMENT and quantity != RELATIVE_VELOCITY
    for j in range(s):
        feed = room.feed[j]
        out[j] = like + products.squares[j] + feed * (feed * products.own[0] - 2.0 * products.with_own[j])
        out[s + j] = like + np.sqrt(products.squares[j]) + magnitude(feed) * np.sqrt(products.own[0])
    for r in range(m):
        total = zero(room.left)
        for j in range(s):
            room.left[j] = room.first[r * s + j]
        for q in range(m):
            product = product_of(room, products, r, q)
            for j in range(s):
                room.left[j] = room.left[j] - product * room.shares[j * m + q]
        for j in range(s):
            share, left, first = room.shares[j * m + r], room.left[j], the_value(room.first[r * s + j])
            out[j] = out[j] - share * (first + the_value(left))
            out[s + j] = out[s + j] + magnitude(share) * room.sizes[r]
            total = total + left * (share * room.factors[j])
            out[2 * s + j * m + r] = the_value(left)
        slopes = with_parts(total)
        out[2 * s + s * m + 2 * r], out[2 * s + s * m + 2 * r + 1] = slopes.s, slopes.d
    if wants_gradient:
        for j in range(s):
            of_own = like + products.with_own[j] - room.feed[j] * products.own[0]
            for r in range(m):
                of_own = of_own - room.shares[j * m + r] * the_value(room.through[r])
            of_own = of_own * (1.0 if relative else 0.0)
            for r in range(m):
                at = 2 * s + j * m + r
                out[at] = (out[at] - of_own) * room.factors[j]
    write_lanes(numbers.reshape((2 * s + s * m + 2 * m, lanes(like))), places, is_there, found)


@jit
def write_lanes(numbers, places, is_there, found):
    """Write the numbers of all lanes that are evaluated."""
    s, m = found.squares.shape[1], found.by_square.shape[1]
    for lane in range(is_there.size):
        if is_there[lane]:
            p = places + lane
            for j in range(s):
                found.squares[p, j], found.sizes[p, j] = numbers[j, lane], numbers[s + j, lane] ** 2
            if found.by_square.shape[0] == 0:
                continue
            for j in range(s):
                for r in range(m):
                    found.outputs[p, j, r] = numbers[2 * s + j * m + r, lane]
            for r in range(m):
                at = 2 * s + s * m + 2 * r
                found.by_square[p, r], found.by_damping[p, r] = numbers[at, lane], numbers[at + 1, lane]


@jit
def evaluate(state, systems, mesh, products, weights, quantity, reach, found):
    """Evaluate structures with numbers like the state; those whose nodes are missing add to the reach."""
    count, m = systems.omega.shape
    s, c, n_functions = products.squares.size, products.phases.shape[0], products.with_input.size
    (shares, feed, factors), room = new_room(m, s, c, n_functions, state)
    width = feed.size // s
    poles, entries = new_numbers(7 * m * width), np.zeros((m, width), dtype=np.int64)
    in_rows, is_there = poles.reshape((7 * m, width)), np.zeros(width, dtype=np.bool_)
    simple = in_lanes(0.0)
    numbers, node = view(poles, simple), new_complex(simple, simple)
    vectors = (n_functions + width - 1) // width
    given = mesh, products, view(mesh.even, 0.0), view(mesh.odd, 0.0), view(mesh.values, node), vectors
    for first in range(0, count, width):
        size, is_any = min(width, count - first), False
        for lane in range(size):
            p = first + lane
            is_there[lane] = put_places(systems, mesh, p, lane, in_rows, entries, reach, weights.shape[0] > 0)
            is_any |= is_there[lane]
            for j in range(s):
                feed[j * width + lane] = systems.feed[p, j, 0] if is_there[lane] else 0.0
                if weights.shape[0] > 0:
                    factors[j * width + lane] = weights[p, j]
                for r in range(m):
                    share = systems.shapes[p, j, r] * systems.participation[p, r, 0]
                    shares[(j * m + r) * width + lane] = share if is_there[lane] else 0.0
        for lane in range(size, width):
            is_there[lane] = False
            in_rows[:, lane] = in_rows[:, 0]
            in_rows[2::7, lane] = 0.0
        if not is_any:
            continue
        for lane in range(size):
            if not is_there[lane]:
                in_rows[2::7, lane] = 0.0
        for r in range(m):
            take_mode(room, numbers, entries, r, size, given, quantity)
        write_results(room, products, first, is_there, m, quantity, found)


@jit
def evaluate_values(systems, mesh, products, weights, quantity, reach, found):
    """As `evaluate`, without derivatives."""
    like = in_lanes(0.0)
    evaluate(new_complex(like, like), systems, mesh, products, weights, quantity, reach, found)


@jit
def evaluate_slopes(systems, mesh, products, weights, quantity, reach, found):
    """As `evaluate`, with derivatives by s and d."""
    like = in_lanes(0.0)
    part = new_dual(like, like, like)
    evaluate(new_complex(part, part), systems, mesh, products, weights, quantity, reach, found)
