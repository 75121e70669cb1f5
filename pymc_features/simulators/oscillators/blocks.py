"""A block of samples of structures in the lanes of vector registers: their modes, and the misfits.

So many modes go together as stay in the first-level cache with their outputs and shapes; of more of them the
misfits are kept in between. Three sensors, or two, are compared at a time, at four samples.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes
from pymc_features.simulators.oscillators.lanes import COLUMNS, N_COEFFICIENTS, N_OF_PAIR, SAMPLES


@jit
def march_block(at, block, is_kept):
    """Carry all modes through a block of samples; write the misfits if they are kept, or add their squares.

    Parameters
    ----------
    at : Places
    block : Block
    is_kept : bool
        Whether the misfits are wanted, in `Lanes.misfits`; their squares are not added then.
    """
    m, of_mode = at.m, 2 if at.is_pair else 1
    for first in range(0, m, COLUMNS // of_mode):
        count = min(COLUMNS // of_mode, m - first)
        if at.is_pair:
            advance_pairs(at, block, first, count)
        else:
            advance_lanes(at, block, first, count)
        columns, stage = (of_mode * first, of_mode * count), (first == 0, first + count == m and not is_kept)
        j = 0
        while j < at.n_sensors:
            if at.n_sensors - j in (1, 2, 4):
                compare_two(at, block, columns, stage, j)
                j += 2
            else:
                compare_three(at, block, columns, stage, j)
                j += 3


@jit
def advance_lanes(at, block, first_mode, count):
    """Write `SAMPLES` outputs of an even number of modes into `Lanes.outputs` and carry their states on.

    Two modes go together, so that one does not wait for the other.
    """
    coefficients, states, outputs = at.coefficients, at.states, at.outputs
    ground, stride = block.ground, block.stride
    for i in range(0, count, 2):
        k, row = 2 * (first_mode + i), N_COEFFICIENTS * (first_mode + i)
        a11, b1 = read_lanes(coefficients, row), read_lanes(coefficients, row + 1)
        a21, a22, b2 = read_three(coefficients, row + 2)
        c11, d1 = read_lanes(coefficients, row + 5), read_lanes(coefficients, row + 6)
        c21, c22, d2 = read_three(coefficients, row + 7)
        y1, y2, z1, z2 = read_four(states, k)
        for sample in range(SAMPLES):
            write_lanes(outputs, SAMPLES * i + sample, y1)
            write_lanes(outputs, SAMPLES * (i + 1) + sample, z1)
            for step in range(sample * stride, (sample + 1) * stride):
                a = splat(read_number(ground, step))
                y1, y2 = a11 * y1 + (y2 + b1 * a), a21 * y1 + (a22 * y2 + b2 * a)
                z1, z2 = c11 * z1 + (z2 + d1 * a), c21 * z1 + (c22 * z2 + d2 * a)
        write_four(states, k, (y1, y2, z1, z2))


@jit
def advance_pairs(at, block, first_mode, count):
    """As `advance_lanes`, of modes of which both states are outputs."""
    coefficients, states, outputs = at.coefficients, at.states, at.outputs
    ground, stride = block.ground, block.stride
    for i in range(0, count, 2):
        k, row = 2 * (first_mode + i), N_OF_PAIR * (first_mode + i)
        a11, a12, b1 = read_three(coefficients, row)
        a21, a22, b2 = read_three(coefficients, row + 3)
        c11, c12, d1 = read_three(coefficients, row + 6)
        c21, c22, d2 = read_three(coefficients, row + 9)
        y1, y2, z1, z2 = read_four(states, k)
        for sample in range(SAMPLES):
            place = 2 * SAMPLES * i + sample
            write_lanes(outputs, place, y1)
            write_lanes(outputs, place + SAMPLES, y2)
            write_lanes(outputs, place + 2 * SAMPLES, z1)
            write_lanes(outputs, place + 3 * SAMPLES, z2)
            for step in range(sample * stride, (sample + 1) * stride):
                a = splat(read_number(ground, step))
                y1, y2 = a11 * y1 + (a12 * y2 + b1 * a), a21 * y1 + (a22 * y2 + b2 * a)
                z1, z2 = c11 * z1 + (c12 * z2 + d1 * a), c21 * z1 + (c22 * z2 + d2 * a)
        write_four(states, k, (y1, y2, z1, z2))


@jit
def compare_two(at, block, columns, stage, j):
    """Take what sensors j and j + 1 see of some modes out of the misfits; see `march_block`.

    An only sensor is filled up with one of no consequence.

    Parameters
    ----------
    columns : tuple of int
        First column of the shapes, and how many.
    stage : tuple of bool
        Whether the misfits begin with the data, and whether they end in sums of squares.
    """
    shapes, outputs, misfits, squares = at.shapes, at.outputs, at.misfits, at.squares
    (first, count), (begins, ends), other = columns, stage, min(j + 1, at.n_sensors - 1)
    row_a, row_b = j * at.width + first, (j + 1) * at.width + first
    sum_a, sum_b = read_lanes(squares, j), read_lanes(squares, j + 1)
    for t in range(0, SAMPLES, 4):
        here_a, here_b = SAMPLES * j + t, SAMPLES * (j + 1) + t
        if begins:
            a, b = start(at, block, j, j, t), start(at, block, j + 1, other, t)
        else:
            a, b = read_four(misfits, here_a), read_four(misfits, here_b)
        for r in range(count):
            z = read_four(outputs, SAMPLES * r + t)
            a, b = less(a, read_lanes(shapes, row_a + r), z), less(b, read_lanes(shapes, row_b + r), z)
        if ends:
            sum_a, sum_b = sum_a + sum_of_squares(a), sum_b + sum_of_squares(b)
        else:
            write_four(misfits, here_a, a)
            write_four(misfits, here_b, b)
    write_lanes(squares, j, sum_a)
    write_lanes(squares, j + 1, sum_b)


@jit
def compare_three(at, block, columns, stage, j):
    """As `compare_two`, of sensors j to j + 2."""
    shapes, outputs, misfits, squares = at.shapes, at.outputs, at.misfits, at.squares
    (first, count), (begins, ends) = columns, stage
    row_a, row_b, row_c = j * at.width + first, (j + 1) * at.width + first, (j + 2) * at.width + first
    sum_a, sum_b, sum_c = read_lanes(squares, j), read_lanes(squares, j + 1), read_lanes(squares, j + 2)
    for t in range(0, SAMPLES, 4):
        here_a, here_b, here_c = SAMPLES * j + t, SAMPLES * (j + 1) + t, SAMPLES * (j + 2) + t
        if begins:
            a, b = start(at, block, j, j, t), start(at, block, j + 1, j + 1, t)
            c = start(at, block, j + 2, j + 2, t)
        else:
            a, b, c = read_four(misfits, here_a), read_four(misfits, here_b), read_four(misfits, here_c)
        for r in range(count):
            z = read_four(outputs, SAMPLES * r + t)
            a, b = less(a, read_lanes(shapes, row_a + r), z), less(b, read_lanes(shapes, row_b + r), z)
            c = less(c, read_lanes(shapes, row_c + r), z)
        if ends:
            sum_a, sum_b = sum_a + sum_of_squares(a), sum_b + sum_of_squares(b)
            sum_c = sum_c + sum_of_squares(c)
        else:
            write_four(misfits, here_a, a)
            write_four(misfits, here_b, b)
            write_four(misfits, here_c, c)
    write_lanes(squares, j, sum_a)
    write_lanes(squares, j + 1, sum_b)
    write_lanes(squares, j + 2, sum_c)


@jit
def start(at, block, j, row, t):
    """Data of a row less the feed-through of sensor j, at four samples from t on."""
    ground, data, feed = block.ground, block.data, read_lanes(at.feed, j)
    k, i, stride = t * block.stride, row * block.length + t, block.stride
    misfit = (
        splat(read_number(data, i)) - feed * splat(read_number(ground, k)),
        splat(read_number(data, i + 1)) - feed * splat(read_number(ground, k + stride)),
        splat(read_number(data, i + 2)) - feed * splat(read_number(ground, k + 2 * stride)),
        splat(read_number(data, i + 3)) - feed * splat(read_number(ground, k + 3 * stride)),
    )
    if block.excess:
        excess = block.excess
        more = (
            splat(read_number(excess, t)),
            splat(read_number(excess, t + 1)),
            splat(read_number(excess, t + 2)),
            splat(read_number(excess, t + 3)),
        )
        misfit = less(misfit, read_lanes(at.direct, j), more)
    return misfit


@jit
def read_three(address, row):
    """Three rows, one after the other."""
    return read_lanes(address, row), read_lanes(address, row + 1), read_lanes(address, row + 2)


@jit
def read_four(address, row):
    """Four rows, one after the other."""
    return (
        read_lanes(address, row),
        read_lanes(address, row + 1),
        read_lanes(address, row + 2),
        read_lanes(address, row + 3),
    )


@jit
def write_four(address, row, vectors):
    """Write four rows, one after the other."""
    write_lanes(address, row, vectors[0])
    write_lanes(address, row + 1, vectors[1])
    write_lanes(address, row + 2, vectors[2])
    write_lanes(address, row + 3, vectors[3])


@jit
def less(x, factor, y):
    """x - factor y, of four vectors."""
    return x[0] - factor * y[0], x[1] - factor * y[1], x[2] - factor * y[2], x[3] - factor * y[3]


@jit
def sum_of_squares(x):
    """Of four vectors."""
    return (x[0] * x[0] + x[1] * x[1]) + (x[2] * x[2] + x[3] * x[3])
