"""Dense structures with classical damping under one input: a population in one compiled call."""

import numpy as np

from pymc_features.algebra import assemble
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.linear.arguments import writable
from pymc_features.simulators.linear.dense import assemble_dense, dense_modes, is_finite
from pymc_features.simulators.oscillators_old.march import classical_drag, feed_through, modal_table
from pymc_features.simulators.oscillators_old.population_march import march_group
from pymc_features.simulators.oscillators_old.recursion import N_ROWS


@jit
def fill_tables(mass, stiffness, rayleigh, ratios, loads, sensors, step, quantity, tables):
    """Write what the recursion of one structure needs; False, and they are undefined, where it is none.

    Parameters
    ----------
    mass, stiffness : array (n, n)
    rayleigh, ratios : array (2,), (>= m,)
    loads : tuple of arrays (n, d)
        Influence and forces.
    sensors : array (s, n)
        Outputs.
    step, quantity
        Of the recursion [s], and the code of the quantity.
    tables : tuple of arrays (11, m), (d, s, m), (s, d)
        Written: `table`, `shapes` and `direct` of `march_modes`.
    """
    influence, forces = loads
    table, shapes, direct = tables
    n, n_modes = mass.shape[0], table.shape[1]
    omega, drag, rows = np.empty(n_modes), np.empty(n_modes), np.empty((n_modes, n))
    if not dense_modes(mass, stiffness, omega, rows):
        return False
    if not classical_drag(omega, rayleigh, ratios, step, drag):
        return False
    modal_table(omega, drag, step, quantity, table)
    pushed, seen, moved = np.dot(rows, forces), np.dot(sensors, rows.T), np.dot(sensors, influence)
    participation = np.dot(rows, np.dot(mass, influence) - forces)
    feed_through(seen, participation, pushed, moved, quantity, n_modes == n, direct)
    for i in range(shapes.shape[0]):
        for j in range(shapes.shape[1]):
            for r in range(n_modes):
                shapes[i, j, r] = participation[r, i] * seen[j, r]
    return True


def dense_tables(a):
    """`table`, `shapes` and `direct` of `march_modes` for one structure; None where it is none."""
    if not all(np.isfinite(values).all() for values in (a.theta, a.rayleigh, a.ratios)):
        return None
    n, (n_inputs, n_sensors) = a.influence.shape[0], (a.acceleration.shape[0], a.sensors.shape[0])
    with np.errstate(over="ignore", invalid="ignore"):
        mass, stiffness = (assemble(stack, a.theta, a.rows, a.starts, n) for stack in (a.mass, a.stiffness))
    tables = (
        *(np.empty((N_ROWS, a.n_modes)), np.empty((n_inputs, n_sensors, a.n_modes))),
        np.empty((n_sensors, n_inputs)),
    )
    found = fill_tables(
        *(writable(mass), writable(stiffness), writable(a.rayleigh), writable(a.ratios), a.loads),
        *(a.outputs, a.step, a.quantity, tables),
    )
    return tables if found else None


@jit
def march_dense(
    parameters, stacks, loads, acceleration, step, grid, sensors, n_modes, quantity, observed, increments
):
    """Misfits of all particles, the modes found one by one and the recursion run for `LANES` at once.

    Parameters
    ----------
    parameters : tuple of arrays (p or 1, ...)
        theta, rayleigh and ratios, a row for each particle or one for all.
    stacks : tuple of arrays (1 + p, n n) or (1, n n)
        Entries of M and K, as in `Arguments`.
    loads : tuple of arrays (n, 1)
        Influence and forces.
    acceleration : array (t,)
    step, grid
        Of the recursion [s]; substeps and stride.
    sensors, n_modes, quantity, observed
        As in `Arguments`, and the data (s, u).
    increments
        As in `march_group`.

    Returns
    -------
    array (p, s, 1), or (p, s, 4) with increments
        NaN in the rows whose parameters describe no structure.
    """
    theta, rayleigh, ratios = parameters
    n, n_sensors = loads[0].shape[0], sensors.shape[0]
    count = max(theta.shape[0], rayleigh.shape[0], ratios.shape[0])
    result = np.full((count, n_sensors, 1 if increments is None else 4), np.nan)
    mass, stiffness = np.empty((n, n)), np.empty((n, n))
    tables, direct = np.empty((LANES, N_ROWS, n_modes)), np.empty((LANES, n_sensors, 1))
    shapes = np.empty((LANES, 1, n_sensors, n_modes))
    waiting, places = 0, np.empty(LANES, dtype=np.int64)
    for p in range(count):
        own_theta, pair = theta[p % theta.shape[0]], rayleigh[p % rayleigh.shape[0]]
        own_ratios = ratios[p % ratios.shape[0]]
        if is_finite(own_theta) and is_finite(pair) and is_finite(own_ratios):
            assemble_dense(stacks[0], own_theta, mass)
            assemble_dense(stacks[1], own_theta, stiffness)
            own = tables[waiting], shapes[waiting], direct[waiting]
            if fill_tables(mass, stiffness, pair, own_ratios, loads, sensors, step, quantity, own):
                places[waiting] = p
                waiting += 1
        if waiting == LANES or (waiting > 0 and p == count - 1):
            group = march_group(
                *(tables[:waiting], shapes.reshape(LANES, n_sensors, n_modes)[:waiting]),
                *(direct.reshape(LANES, n_sensors)[:waiting], acceleration, *grid, observed, increments),
            )
            for lane in range(waiting):
                result[places[lane]] = group[lane]
            waiting = 0
    return result
