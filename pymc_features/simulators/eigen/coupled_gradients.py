"""Gradients of populations of dense structures whose damping is a matrix, by complex modes in lanes."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, splat, store
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.complex_modes import (
    PANEL,
    check_sums,
    fill_lanes,
    new_complex,
    new_oscillator_pairs,
    settle_panel,
    start_panel,
)
from pymc_features.simulators.eigen.coupled import (
    all_columns,
    check_damping,
    new_lanes,
    project,
    sort_modes,
    write_sensors,
)
from pymc_features.simulators.eigen.matrices import (
    all_diagonal,
    assemble_lanes,
    filled_places,
    is_never_negative,
    multiply_lanes,
    store_four,
)
from pymc_features.simulators.eigen.pair_gradients import (
    add_mass_terms,
    complete_sums,
    multiply_left,
    new_pairs,
    poles_apart,
    put_number,
    write_differences,
    write_pair,
    write_right,
)
from pymc_features.simulators.eigen.structures import new_structures, solve_structures
from pymc_features.simulators.numbers.compiled_numbers import new_dual
from pymc_features.simulators.oscillators.modal_system import highest_coupled_step
from pymc_features.simulators.oscillators.samples import of_population
from pymc_features.simulators.oscillators.sums import new_gradient_walk, sum_history

# Residues above that many times the classical ones: the derivatives lose digits by the third power of it
CANCELLING = 100.0
FEW = 0.3  # share of the entries of a matrix below which those that depend on theta are computed one by one


@jit
def add_coupled_gradients(parameters, excitation, wanted, observed, weights, gradient):
    """Add the gradients by theta of the weighted e_j, of the particles whose complex modes come out right.

    Parameters
    ----------
    parameters : LinearParameters
        theta (p or 1, k); dense matrices, C symmetric.
    excitation : Excitation
        With one input (1, t).
    wanted : Outputs
        All modes.
    observed : array (s, u)
        Data.
    weights : array (p, s, 1)
    gradient : array (p or 1, k)
        Updated.

    Returns
    -------
    bool array (p,)
        Which particles are done. The others may be invalid, lack mass, or have poles that are close.
    """
    theta, (n_sensors, n), count = parameters.theta, wanted.sensors.shape, weights.shape[0]
    step, n_times = excitation.dt / excitation.substeps, observed.shape[1]
    is_done, widths = np.zeros(count, dtype=np.bool_), of_population()
    columns, stacks = all_columns(parameters), (parameters.mass, parameters.stiffness)
    oscillators, modes = new_oscillator_pairs(n, n_sensors), new_complex(n, n_sensors)
    dual = new_dual(widths.wide, widths.wide, widths.wide)
    walk = new_gradient_walk(excitation, observed, False, True, 2 * n, dual, widths)
    lot = new_lanes(parameters, wanted, n, walk.samples, step, widths)
    structures, pairs = new_structures(n, theta.shape[1], n + 2), new_pairs(n, n, n_sensors)
    damping, room = new_vectors(n * n), new_vectors(n * n)
    places = filled_places(parameters.damping, n)
    is_safe = is_never_negative(parameters.damping, n)
    by_theta = new_vectors(theta.shape[1])
    order, matrices = np.empty(n, dtype=np.int64), new_matrices(n, n_sensors)
    is_diagonal, support_motion = all_diagonal(parameters.mass, n), np.dot(wanted.sensors, columns[1])
    for first in range(0, count, LANES):
        for lane in range(LANES):
            p = min(first + lane, count - 1)
            structures.theta[:, lane] = theta[p % theta.shape[0]]
            for j in range(n_sensors):
                walk.sum_arrays.factors[j * LANES + lane] = -2.0 * weights[p, j, 0] / n_times
        solve_structures(structures, stacks, is_diagonal, columns)
        for lane in range(LANES):
            modes.is_good[0, lane] = 1.0 if structures.is_good[lane] and first + lane < count else 0.0
        products = sort_modes(structures, modes, order)
        assemble_lanes(parameters.damping, structures.theta, n, True, damping)
        project(modes, damping, places, products, room)
        check_damping(modes, structures.factor, damping, highest_coupled_step(excitation) / step, is_safe)
        write_sensors(modes, oscillators.forced, products, wanted, support_motion)
        fill_gradient_pairs(oscillators, pairs, modes, products, wanted.quantity)
        store(
            modes.is_good, 0, load(modes.is_good, 0) * poles_apart(pairs, n_times * excitation.stride * step)
        )
        fill_lanes(lot, oscillators, modes.is_good)
        sum_history(lot, walk, widths)
        complete_sums(pairs, lot, walk.found, wanted.quantity, widths)
        by_theta.fill(0.0)
        spread_to_theta(parameters, pairs, modes, products, matrices, (n_sensors, wanted.quantity), by_theta)
        for lane in range(LANES):
            if modes.is_good[0, lane] > 0.0:
                is_done[first + lane] = True
                gradient[(first + lane) % gradient.shape[0]] += by_theta[:, lane]
    return is_done


@jit
def new_matrices(n, n_sensors):
    """Room for `spread_to_theta`: matrices (n 2n), the differences, entries, sensors and vectors."""
    return (
        new_vectors(2 * n * n),
        new_vectors(2 * n * n),
        new_vectors(2 * n * n),
        new_vectors(4 * n * n),
        new_vectors(n * n),
        new_vectors(n_sensors * n),
        new_vectors(4 * n),
        new_vectors(n),
        new_vectors(n),
    )


@jit
def fill_gradient_pairs(oscillators, pairs, modes, products, quantity):
    """Find the complex modes of all lanes, and write all that the march and the gradient need of them."""
    m, n_sensors = modes.omega.shape[0], oscillators.forced.shape[0]
    for i in range(3 * n_sensors):
        store(modes.sums, i, splat(0.0))
    for first in range(0, m, PANEL):
        start_panel(modes, first)
        settle_panel(modes, first)
        write_vectors(pairs, modes, products, first)
        for p in range(min(PANEL, m - first)):
            write_pair(oscillators, pairs, modes, first + p, p, quantity)
    check_sums(modes, n_sensors, CANCELLING)


@jit
def write_vectors(pairs, modes, products, first):
    """Write Phi x of a panel of two modes, four entries at a time."""
    m, x = modes.omega.shape[0], modes.vectors
    width, n = products.shape[0] // m, pairs.vectors.shape[0] // (2 * m)
    last = min(first + 1, m - 1)
    for i in range(0, n, 4):
        i1, i2, i3 = min(i + 1, n - 1), min(i + 2, n - 1), min(i + 3, n - 1)
        a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = splat(0.0)
        c0 = c1 = c2 = c3 = d0 = d1 = d2 = d3 = splat(0.0)
        for s in range(m):
            x0, x1 = load(x, 2 * PANEL * s), load(x, 2 * PANEL * s + 1)
            x2, x3 = load(x, 2 * PANEL * s + 2), load(x, 2 * PANEL * s + 3)
            y = load(products, s * width + i)
            a0, a1, a2, a3 = a0 + y * x0, a1 + y * x1, a2 + y * x2, a3 + y * x3
            y = load(products, s * width + i1)
            b0, b1, b2, b3 = b0 + y * x0, b1 + y * x1, b2 + y * x2, b3 + y * x3
            y = load(products, s * width + i2)
            c0, c1, c2, c3 = c0 + y * x0, c1 + y * x1, c2 + y * x2, c3 + y * x3
            y = load(products, s * width + i3)
            d0, d1, d2, d3 = d0 + y * x0, d1 + y * x1, d2 + y * x2, d3 + y * x3
        places = 2 * first, 2 * first + 1, 2 * last, 2 * last + 1
        store_four(pairs.vectors, 2 * m * i, places, (a0, a1, a2, a3))
        store_four(pairs.vectors, 2 * m * i1, places, (b0, b1, b2, b3))
        store_four(pairs.vectors, 2 * m * i2, places, (c0, c1, c2, c3))
        store_four(pairs.vectors, 2 * m * i3, places, (d0, d1, d2, d3))


@jit
def spread_to_theta(parameters, pairs, modes, products, matrices, request, by_theta):
    """Add the derivatives by the entries of K, C and M, times what theta changes of them, to `by_theta`."""
    n, n_sensors = parameters.influence.shape[0], request[0]
    left, right, partners, differences, entries, sensors, own, load_shape, by_load = matrices
    write_right(pairs, right)
    for k in range(n):
        put_number(own, k, write_differences(pairs, k, n_sensors, differences))
    width = 2 * n
    multiply_lanes((right, width, 1), (differences, 1, width), (n, width, width), partners, True)
    multiply_left(pairs, False, left)
    if parameters.stiffness.shape[0] > 1:
        write_entries((left, width, 1), (partners, width, 1), width, parameters.stiffness, entries)
        add_terms(parameters.stiffness, entries, by_theta)
    if parameters.damping.shape[0] == 1 and parameters.mass.shape[0] == 1:
        return
    multiply_left(pairs, True, left)
    if parameters.damping.shape[0] > 1:
        write_entries((left, width, 1), (partners, width, 1), width, parameters.damping, entries)
        add_terms(parameters.damping, entries, by_theta)
    if parameters.mass.shape[0] > 1:
        multiply_left(pairs, True, left)
        write_entries((left, width, 1), (partners, width, 1), width, parameters.mass, entries)
        write_shapes(modes, products, sensors, load_shape)
        add_mass_terms(pairs, sensors, (right, load_shape, by_load), request, own, entries)
        add_load_terms(by_load, parameters.influence, entries)
        add_terms(parameters.mass, entries, by_theta)


@jit
def write_entries(left, right, inner, stack, entries):
    """Write a product (n n, LANES) at the places where a stack (1 + p, n n) depends on theta, or everywhere.

    Parameters
    ----------
    left : tuple of array (.., LANES), int, int
        See `multiply_lanes`.
    right : tuple
        As `left`, of the transposed matrix.
    inner : int
        Columns of the left matrix.
    """
    (x, x_down, x_along), (y, y_down, y_along), size = left, right, stack.shape[1]
    n, places, count = int(np.sqrt(size)), np.empty(size, dtype=np.int64), 0
    for e in range(size):
        for term in range(1, stack.shape[0]):
            if stack[term, e] != 0.0:
                places[count] = e
                count += 1
                break
    if count > FEW * size:
        multiply_lanes(left, (y, y_along, y_down), (n, inner, n), entries, True)
        return
    for e in places[:count]:
        a, b = (e // n) * x_down, (e % n) * y_down
        even = odd = splat(0.0)
        for k in range(0, inner - 1, 2):
            even = even + load(x, a + k * x_along) * load(y, b + k * y_along)
            odd = odd + load(x, a + (k + 1) * x_along) * load(y, b + (k + 1) * y_along)
        if inner % 2 == 1:
            even = even + load(x, a + (inner - 1) * x_along) * load(y, b + (inner - 1) * y_along)
        store(entries, e, even + odd)


@jit
def add_load_terms(by_load, influence, entries):
    """Add to the derivatives by M those by the load M influence, (n, LANES); influence (n, 1)."""
    n = by_load.shape[0]
    for i in range(n):
        for k in range(n):
            store(entries, i * n + k, load(entries, i * n + k) + load(by_load, i) * influence[k, 0])


@jit
def add_terms(stack, entries, by_theta):
    """Add the products of the terms of a stack (1 + p, n n) with the derivatives by all entries."""
    for term in range(1, stack.shape[0]):
        total = load(by_theta, term - 1)
        for e in range(stack.shape[1]):
            share = stack[term, e]
            if share != 0.0:
                total = total + splat(share) * load(entries, e)
        store(by_theta, term - 1, total)


@jit
def write_shapes(modes, products, sensors, load_shape):
    """Write M^-1 S' (s n, LANES) and M^-1 times the load (n, LANES)."""
    m, n = modes.omega.shape[0], load_shape.shape[0]
    width = products.shape[0] // m
    for i in range(n):
        total = splat(0.0)
        for s in range(m):
            total = total + load(products, s * width + i) * load(modes.participation, s)
        store(load_shape, i, total)
        for j in range(sensors.shape[0] // n):
            total = splat(0.0)
            for s in range(m):
                total = total + load(products, s * width + i) * load(modes.seen, j * m + s)
            store(sensors, j * n + i, total)
