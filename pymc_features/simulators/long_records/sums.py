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
    new_complex,
    new_dual,
    of_kind,
    put_together,
    registers,
    square_root,
    squared_size,
    the_sum,
    the_value,
    with_parts,
)
from pymc_features.simulators.numbers.kinds import Complex, Several, Two, value_of
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
POLE = 7  # numbers of a pole, see `put_poles`
TURN_TERMS = 19  # of exp(x), |x| < 0.75: the first dropped term is below 1e-18


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


mirrored, inverse = compiled(mirrored_of), compiled(inverse_of)


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

    Rows b are s data, c phases of the input, a one behind the last output and, where these are others, own
    values, which the feed-through passes on; functions are P of all rows, then K.

    Attributes
    ----------
    duration, step : float
        Of the record and of the recursion [s].
    spacing : array (levels,)
        Of the nodes [rad/s].
    begins, lowest, highest : integer array (levels N_ROWS,)
        Where a row of nodes begins, and its first and last column; first beyond last if empty.
    values : array (nodes vectors 2 LANES,)
        Functions, real parts and imaginary parts.
    even, odd : array (REACH + 1, TERMS)
        Of the stencil.
    squares, with_own, own : array (s,), (s,), (1,)
        Sums of data squared, of data times own values, and of these squared.
    with_input : array (rows,)
        Sums of rows times input, at the outputs.
    phases : array (c, c)
        Sums of phases times phases.
    first : float
        a[0].
    own_at : int
        Which row has the own values.
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
    squares: np.ndarray
    with_own: np.ndarray
    own: np.ndarray
    with_input: np.ndarray
    phases: np.ndarray
    first: float
    own_at: int


@jit
def is_served(systems, mesh, p, wants_gradient):
    """Whether a table has a structure: not too fast or damped and, for gradients, without close modes."""
    served, longest = systems.valid[p], 4.0 * DECAYED / mesh.duration * 2.0 ** (mesh.spacing.size - 1)
    for r in range(systems.omega.shape[1]):
        omega, damping = systems.omega[p, r], systems.damping[p, r]
        served &= 0.0 <= damping < HEAVY * omega and omega * mesh.step <= FASTEST and damping < longest
        if wants_gradient and r > 0:  # as in `reduction.nearness`, or nearly so
            before, drag = systems.omega[p, r - 1], systems.damping[p, r - 1]
            memory = max(min(mesh.duration, 2.0 / drag), 3.0 / before)
            growth = (omega + before) * mesh.duration**2
            served &= (omega - before) * min(memory, growth) > 2.0 * CLOSE
    return served


@jit
def put_poles(systems, mesh, p, lane, poles, entries, reach):
    """Write poles of a structure into a lane, and where their stencils begin; whether all nodes are there.

    `poles` (m POLE, LANES) are s, d, 1 / spacing, column, row and exp(i omega t) of the nearest node; columns
    that are missing are added to the reach (2, levels N_ROWS).
    """
    h, is_there = mesh.step, True
    for r in range(systems.omega.shape[1]):
        omega, sigma, own = (
            systems.omega[p, r],
            0.5 * systems.damping[p, r],
            poles[POLE * r : POLE * r + POLE],
        )
        level, duration = 0, mesh.duration
        while sigma * duration >= 2.0 * DECAYED:
            level, duration = level + 1, 0.5 * duration
        spacing = mesh.spacing[level]
        row = int(np.rint(sigma / spacing))
        column, at = int(np.rint(np.sqrt(omega * omega - sigma * sigma) / spacing)), level * N_ROWS + row
        if column - REACH < mesh.lowest[at] or column + REACH > mesh.highest[at]:
            reach[0, at] = min(reach[0, at], column - REACH)
            reach[1, at] = max(reach[1, at], column + REACH)
            is_there = False
        entries[r, lane], turn_here = mesh.begins[at] + column - REACH - mesh.lowest[at], TURNS[column % 6]
        own[0, lane], own[1, lane], own[2, lane] = (omega * h) ** 2, 2.0 * sigma * h, 1.0 / (spacing * h)
        own[3, lane], own[4, lane], own[5, lane], own[6, lane] = column, row, turn_here.real, turn_here.imag
    return is_there


class Room(NamedTuple):
    """Memory for the structures in the lanes, as `Rows`: m modes, s sensors, c phases.

    Attributes
    ----------
    poles : numbers (m POLE)
    weights, functions : complex (TAPS), (functions)
        Of one mode.
    modes : complex (m (3 + 2 c))
        Of each mode w, y[0], y[N], D and B.
    reals : numbers, perhaps with derivatives (m (3 + s) + s)
        Of each mode sum y a, what stands before the input in the state, and sums of its output times own
        values and times data less feed-through; then these, of one mode, less what all modes put out.
    sizes, feed, factors, shares : numbers (m), (s), (s), (s m)
        Sizes of outputs, J, -2 w / N and S Phi Gamma.
    """

    poles: object
    weights: object
    functions: object
    modes: object
    reals: object
    sizes: object
    feed: object
    factors: object
    shares: object


@jit
def write_weights(room, mesh, nu):
    """Write the weights of the stencil at nu."""
    even, odd, square = view(mesh.even, 0.0), view(mesh.odd, 0.0), nu * nu
    for n in range(REACH + 1):
        last = n * TERMS + TERMS - 1
        a, b = 0.0 * nu + even[last], 0.0 * nu + odd[last]
        for k in range(1, TERMS):
            a, b = a * square + even[last - k], b * square + odd[last - k]
        b = b * nu
        room.weights[REACH + n], room.weights[REACH - n] = a + b, a - b


@jit
def take_functions(room, values, entries, vectors):
    """Interpolate all functions of one mode of each structure, a function in each lane, and turn them."""
    for v in range(vectors):
        for lane in range(entries.size):
            at = entries[lane] * vectors + v
            last = in_one_lane(room.weights, 2 * REACH, lane) * values[at + 2 * REACH * vectors]
            even, odd = last, zero(room.functions)  # two sums, so that one does not wait for the other
            for n in range(0, 2 * REACH, 2):
                even = even + in_one_lane(room.weights, n, lane) * values[at]
                odd = odd + in_one_lane(room.weights, n + 1, lane) * values[at + vectors]
                at += 2 * vectors
            room.functions[v * entries.size + lane] = even + odd
        first = v * entries.size
        turn(room.functions, first, 1, room.functions, first, 2, 1)


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
def take_mode(room, mesh, entries, r, vectors, quantity):
    """Interpolate the functions of mode r, and write what it gives by itself."""
    own, kind, poles = POLE * r, zero(room.reals), room.poles
    s, d, nil = poles[own], poles[own + 1], 0.0 * poles[own]
    root = square_root(s - 0.25 * d * d)
    by_d = d * (-0.25 / root)
    omega = of_kind(new_dual(root, 0.5 / root, by_d), kind)
    square = root * root  # 1 / i omega_d takes the part beside J for the real one
    inverted = of_kind(new_dual(-1.0 / root, 0.5 / (root * square), by_d / square), kind)
    z = new_complex(of_kind(new_dual(-0.5 * d, nil, nil - 0.5), kind), omega)
    fineness = poles[own + 2]
    nu = new_complex(omega * fineness - poles[own + 3], (-1.0 * z.re) * fineness - poles[own + 4])
    write_weights(room, mesh, nu)
    node = new_complex(nil, nil)
    take_functions(room, view(mesh.values, node), entries, vectors)
    angle, x = 0.0 * nu + 1.0, new_complex((-1.0 * nu.im) * (np.pi / 3.0), nu.re * (np.pi / 3.0))
    for k in range(TURN_TERMS, 0, -1):
        angle = angle * x * (1.0 / k) + 1.0
    angle = angle * new_complex(poles[own + 5], poles[own + 6])
    w, drive, after = drive_of(z, s, d, quantity, mesh.step)
    part = new_complex(0.0 * omega, inverted)
    finish_mode(room, mesh, r, w, drive * part, after * part, angle)


@jit
def finish_mode(room, mesh, r, w, drive, before, angle):
    """Write what the products of mode r with others need, and its sums with data and own values."""
    s, c, rows = mesh.squares.size, mesh.phases.shape[0], mesh.with_input.size
    modes, reals, functions = room.modes, room.reals, room.functions
    own, at, start, after = r * (3 + 2 * c), r * (3 + s), before * mesh.first, before.re
    by_drive, by_start, e, growth = drive * angle, start * angle, w + 1.0, w
    for p in range(c - 1, -1, -1):
        modes[own + 3 + p] = drive
        drive = drive * e
        if p > 0:
            growth = growth + w + growth * w
    end = functions[s + c] * by_drive + functions[rows + s + c] * by_start
    modes[own], modes[own + 1], modes[own + 2] = growth, start, end
    size, e = squared_size(end) + squared_size(start), growth + 1.0
    for p in range(c - 1, -1, -1):
        total = functions[s + p] * by_drive + functions[rows + s + p] * by_start
        reals[at] = total.re
        total = total * e
        for q in range(c):
            total = total + modes[own + 3 + q] * (0.5 * mesh.phases[p, q])
        modes[own + 3 + c + p] = total
        size = size + 2.0 * square_root(squared_size(modes[own + 3 + p]) * squared_size(total))
    i = mesh.own_at
    through = (functions[i] * by_drive + functions[rows + i] * by_start).re - after * mesh.with_input[i]
    reals[at + 1], reals[at + 2] = after, through
    for j in range(s):
        data = (functions[j] * by_drive + functions[rows + j] * by_start).re - after * mesh.with_input[j]
        reals[at + 3 + j] = data - through * room.feed[j]
    decay = magnitude(2.0 * mirrored(growth).first.re + squared_size(growth))
    room.sizes[r] = square_root(size / decay) + magnitude(the_value(after)) * np.sqrt(mesh.with_input[s])


@jit
def product_of(room, mesh, r, q):
    """Sum over time of the outputs of modes r and q, with derivatives by the pole of r."""
    s, c, modes, reals = mesh.squares.size, mesh.phases.shape[0], room.modes, room.reals
    own, other = r * (3 + 2 * c), q * (3 + 2 * c)
    total = mirrored(modes[other + 1]) * modes[own + 1] - mirrored(modes[other + 2]) * modes[own + 2]
    for p in range(3, 3 + c):
        total = total + mirrored(modes[other + p]) * modes[own + p + c]
        total = total + mirrored(modes[other + p + c]) * modes[own + p]
    growth, w = modes[own], mirrored(modes[other])
    total = total * inverse((w * growth + w + growth) * -1.0)
    own, other = r * (3 + s), q * (3 + s)
    passed, after = the_value(reals[other]), the_value(reals[other + 1])
    more = reals[own + 1] * (after * mesh.with_input[s] - passed) - reals[own] * after
    return the_sum(total).re * 0.5 + more


@jit
def write_results(room, mesh, m, quantity, wants_gradient, out):
    """Write the results of the structures in the lanes, see `evaluate`."""
    s, like, reals = mesh.squares.size, 0.0 * room.feed[0], room.reals
    left, relative = m * (3 + s), quantity != RELATIVE_DISPLACEMENT and quantity != RELATIVE_VELOCITY
    for j in range(s):
        feed = room.feed[j]
        out[j] = like + mesh.squares[j] + feed * (feed * mesh.own[0] - 2.0 * mesh.with_own[j])
        out[s + j] = like + np.sqrt(mesh.squares[j]) + magnitude(feed) * np.sqrt(mesh.own[0])
    for r in range(m):
        own, total = r * (3 + s) + 3, zero(reals)
        for j in range(s):
            reals[left + j] = reals[own + j]
        for q in range(m if wants_gradient else r + 1):  # without derivatives pairs are alike
            product = product_of(room, mesh, r, q) * (1.0 if wants_gradient or q == r else 2.0)
            for j in range(s):
                reals[left + j] = reals[left + j] - product * room.shares[j * m + q]
        for j in range(s):
            share, rest, at = room.shares[j * m + r], reals[left + j], 2 * s + j * m + r
            out[j] = out[j] - share * (the_value(reals[own + j]) + the_value(rest))
            out[s + j] = out[s + j] + magnitude(share) * room.sizes[r]
            total = total + rest * (share * room.factors[j])
            if wants_gradient:
                out[at] = the_value(rest) * room.factors[j]
        if wants_gradient:
            slopes, at = with_parts(total), 2 * s + s * m + r
            out[at], out[at + m] = slopes.s, slopes.d
    for j in range(s if wants_gradient and relative else 0):  # the outputs are relative to own values
        rest = like + mesh.with_own[j] - room.feed[j] * mesh.own[0]
        for r in range(m):
            rest = rest - room.shares[j * m + r] * the_value(reals[r * (3 + s) + 2])
        for r in range(m):
            at = 2 * s + j * m + r
            out[at] = out[at] - rest * room.factors[j]


@jit
def put_another(values, lane, some):
    """Write one lane of values (k, lane) into another."""
    for i in range(values.shape[0]):
        values[i, lane] = values[i, some]


@jit
def evaluate(state, systems, mesh, weights, quantity, reach, result):
    """Evaluate structures with numbers like the state where nodes are there; else these go into the reach.

    Parameters
    ----------
    state : complex number
    systems, mesh : Systems, Mesh
    weights : array (p, s) or (0, s)
        -2 w / N of e_j whose weighted sum is differentiated.
    quantity : int
    reach : array (2, levels N_ROWS)
        First and last column that is missing in each row of nodes.
    result : array (p / LANES, rows, LANES)
        Sums of squared misfits (s), roots of what their rounding errors are relative to (s), infinite if not
        evaluated, and what `reduction.derive_from` goes on from: (s m), (m) and (m), by s and d.
    """
    (count, m), s, c, like = systems.omega.shape, mesh.squares.size, mesh.phases.shape[0], in_lanes(0.0)
    one, part, wants_gradient = lanes(like), state.re, weights.shape[0] > 0
    vectors, pole, whole = (2 * mesh.with_input.size + one - 1) // one, POLE * m * one, registers(state) * one
    half, taps, modes = registers(part) * one, pole + TAPS * whole, vectors * one * whole
    reals, sizes = m * (3 + 2 * c) * whole, (m * (3 + s) + s) * half
    modes, reals = taps + modes, taps + modes + reals
    sizes = reals + sizes
    feed = sizes + m * one
    memory, entries = new_numbers(feed + (2 + m) * s * one), np.zeros((m, one), dtype=np.int64)
    poles, own = memory[:pole].reshape((POLE * m, one)), memory[feed:].reshape(((2 + m) * s, one))
    room = Room(
        view(memory, like),
        view(memory[pole:], state),
        view(memory[taps:], state),
        view(memory[modes:], state),
        view(memory[reals:], part),
        view(memory[sizes:], like),
        view(memory[feed:], like),
        view(memory[feed + s * one :], like),
        view(memory[feed + 2 * s * one :], like),
    )
    is_there = np.zeros(one, dtype=np.bool_)
    for first in range(0, count, one):
        for lane in range(one):
            p, here = min(first + lane, count - 1), first + lane < count
            is_there[lane] = here and is_served(systems, mesh, p, wants_gradient)
            is_there[lane] = is_there[lane] and put_poles(systems, mesh, p, lane, poles, entries, reach)
            for j in range(s):
                own[j, lane], own[s + j, lane] = (
                    systems.feed[p, j, 0],
                    weights[p, j] if wants_gradient else 0.0,
                )
                for r in range(m):
                    own[2 * s + j * m + r, lane] = systems.shapes[p, j, r] * systems.participation[p, r, 0]
        if not is_there.any():
            continue
        some = np.argmax(is_there)
        for lane in range(one):
            if not is_there[lane]:  # another one in its place
                put_another(poles, lane, some)
                put_another(own, lane, some)
                put_another(entries, lane, some)
        for r in range(m):
            take_mode(room, mesh, entries[r], r, vectors, quantity)
        write_results(room, mesh, m, quantity, wants_gradient, view(result[first // one], like))
        for lane in range(one):
            if not is_there[lane]:
                result[first // one, s : 2 * s, lane] = np.inf


@jit
def evaluate_values(systems, mesh, weights, quantity, reach, result):
    """Evaluate without derivatives."""
    like = in_lanes(0.0)
    evaluate(new_complex(like, like), systems, mesh, weights, quantity, reach, result)


@jit
def evaluate_slopes(systems, mesh, weights, quantity, reach, result):
    """Evaluate with derivatives by s and d."""
    like = in_lanes(0.0)
    part = new_dual(like, like, like)
    evaluate(new_complex(part, part), systems, mesh, weights, quantity, reach, result)
