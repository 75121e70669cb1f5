"""Dense structures with classical damping in compiled code: one of them, or a population under one input."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.linear.dense import assemble_dense, dense_modes, is_finite
from pymc_features.simulators.linear.system import ModalTables
from pymc_features.simulators.oscillators.march import classical_drag, feed_through, modal_table
from pymc_features.simulators.oscillators.population_march import march_group
from pymc_features.simulators.oscillators.recursion import N_ROWS


class DenseStructure(NamedTuple):
    """M(theta) and K(theta) (n, n) of one structure, and what else `LinearParameters` have."""

    mass: np.ndarray
    stiffness: np.ndarray
    rayleigh: np.ndarray
    ratios: np.ndarray
    influence: np.ndarray
    forces: np.ndarray


@jit
def fill_tables(structure, wanted, step, tables):
    """Write what the recursion of one structure needs; False, and it is undefined, where there is none.

    Parameters
    ----------
    structure : DenseStructure
    wanted : Outputs
    step : float
        Step of the recursion [s].
    tables : ModalTables
        Written.
    """
    mass, stiffness, rayleigh, ratios, influence, forces = structure
    n, n_modes = mass.shape[0], wanted.n_modes
    omega, modal_damping, rows = np.empty(n_modes), np.empty(n_modes), np.empty((n_modes, n))
    if not dense_modes(mass, stiffness, omega, rows):
        return False
    if not classical_drag(omega, rayleigh, ratios, step, modal_damping):
        return False
    modal_table(omega, modal_damping, step, wanted.quantity, tables.table)
    output_shapes, support_motion = np.dot(wanted.sensors, rows.T), np.dot(wanted.sensors, influence)
    modal_forces, participation = np.dot(rows, forces), np.dot(rows, np.dot(mass, influence) - forces)
    feed_through(
        output_shapes,
        participation,
        modal_forces,
        support_motion,
        wanted.quantity,
        n_modes == n,
        tables.direct,
    )
    shapes = tables.shapes
    for i in range(shapes.shape[0]):
        for j in range(shapes.shape[1]):
            for r in range(n_modes):
                shapes[i, j, r] = participation[r, i] * output_shapes[j, r]
    return True


def dense_tables(a) -> ModalTables | None:
    """Tables of one structure; None where the parameters describe none."""
    given, (n_sensors, _), n_inputs = a.parameters, a.shape, a.parameters.influence.shape[1]
    if not given.is_finite:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        matrices = given.assemble(given.mass), given.assemble(given.stiffness)
    others = given.rayleigh, given.ratios, given.influence, given.forces
    tables = ModalTables(
        np.empty((N_ROWS, a.wanted.n_modes)),
        np.empty((n_inputs, n_sensors, a.wanted.n_modes)),
        np.empty((n_sensors, n_inputs)),
    )
    structure = DenseStructure(*map(writable, (*matrices, *others)))
    return tables if fill_tables(structure, a.outputs, a.step, tables) else None


@jit
def march_dense(parameters, excitation, wanted, observed, increments):
    """Misfits of all particles, the modes found one by one and the recursion run for `LANES` at once.

    Parameters
    ----------
    parameters : LinearParameters
        theta, rayleigh and ratios (p or 1, ...) have a row for each particle or one for all.
    excitation : Excitation
        With one input (1, t).
    wanted : Outputs
    observed : array (s, u)
        Data.
    increments
        As in `march_group`.

    Returns
    -------
    array (p, s, 1), or (p, s, 4) with increments
        NaN in the rows whose parameters describe no structure.
    """
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    n, n_sensors, m = parameters.influence.shape[0], wanted.sensors.shape[0], wanted.n_modes
    acceleration, step = excitation.acceleration[0], excitation.dt / excitation.substeps
    count = max(theta.shape[0], rayleigh.shape[0], ratios.shape[0])
    result = np.full((count, n_sensors, 1 if increments is None else 4), np.nan)
    mass, stiffness = np.empty((n, n)), np.empty((n, n))
    table, direct = np.empty((LANES, N_ROWS, m)), np.empty((LANES, n_sensors, 1))
    shapes = np.empty((LANES, 1, n_sensors, m))
    waiting, places = 0, np.empty(LANES, dtype=np.int64)
    for p in range(count):
        own_theta, own_rayleigh = theta[p % theta.shape[0]], rayleigh[p % rayleigh.shape[0]]
        own_ratios = ratios[p % ratios.shape[0]]
        if is_finite(own_theta) and is_finite(own_rayleigh) and is_finite(own_ratios):
            assemble_dense(parameters.mass, own_theta, mass)
            assemble_dense(parameters.stiffness, own_theta, stiffness)
            structure = DenseStructure(
                mass, stiffness, own_rayleigh, own_ratios, parameters.influence, parameters.forces
            )
            tables = ModalTables(table[waiting], shapes[waiting], direct[waiting])
            if fill_tables(structure, wanted, step, tables):
                places[waiting] = p
                waiting += 1
        if waiting == LANES or (waiting > 0 and p == count - 1):
            group = march_group(
                table[:waiting],
                shapes.reshape(LANES, n_sensors, m)[:waiting],
                direct.reshape(LANES, n_sensors)[:waiting],
                acceleration,
                excitation.substeps,
                excitation.stride,
                observed,
                increments,
            )
            for lane in range(waiting):
                result[places[lane]] = group[lane]
            waiting = 0
    return result
