"""Complex modes of many structures in the form in which tables are asked, see `mean_squares.systems`."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat, store
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.complex_modes import (
    PANEL,
    mode_places,
    new_complex,
    pole_of,
    settle_panel,
    start_panel,
)
from pymc_features.simulators.eigen.coupled import (
    all_columns,
    check_damping,
    project,
    sort_modes,
    write_sensors,
)
from pymc_features.simulators.eigen.damping_matrices import filled_places, is_never_negative
from pymc_features.simulators.eigen.matrices import all_diagonal, assemble_lanes
from pymc_features.simulators.eigen.pairs import write_shares
from pymc_features.simulators.eigen.residues import CANCELLING, check_sums
from pymc_features.simulators.eigen.structures import new_structures, solve_structures
from pymc_features.simulators.oscillators.arguments import at_every_step
from pymc_features.simulators.oscillators.fast_modes import highest_coupled_step
from pymc_features.simulators.oscillators.lanes import new_lanes


@jit
def write_pairs(lanes, modes, kept, n_sensors, quantity):
    """Find the complex modes of all lanes; write their shapes, and stiffness and D of the pairs into `kept`.

    `kept` are two arrays (m, LANES); the shapes are those of displacements and velocities in SI units.
    """
    (stiffness, drag), m, zero = kept, modes.omega.shape[0], splat(0.0)
    at = mode_places(modes)
    for i in range(3 * n_sensors):
        store(modes.sums, i, zero)
    for first in range(0, m, PANEL):
        start_panel(modes, first)
        settle_panel(modes, first)
        for p in range(min(PANEL, m - first)):
            (a, b), square = pole_of(at, p)
            store(stiffness, first + p, a * a - square * (b * b))
            store(drag, first + p, 0.0 - 2.0 * a)
            write_shares(lanes, at, (first + p, p), (zero, zero), 1.0, quantity)
    check_sums(modes, n_sensors, CANCELLING)


@jit
def put_pairs(systems, p, lanes, kept, lane):
    """Write structure p of a lane: its pairs as displacements, then as velocities."""
    (n_sensors, width), (stiffness, drag) = systems.shapes[p].shape, kept
    m, even = width // 2, lanes.states.shape[0] // 2
    for r in range(m):
        omega, damping = np.sqrt(stiffness[r, lane]), drag[r, lane]
        for at in (r, m + r):
            systems.omega[p, at], systems.damping[p, at] = omega, damping
            systems.participation[p, at, 0] = 1.0
        for j in range(n_sensors):
            row = 2 * (j * even + r)
            systems.shapes[p, j, r] = lanes.shapes[row, lane]
            systems.shapes[p, j, m + r] = lanes.shapes[row + 1, lane]
    for j in range(n_sensors):
        systems.feed[p, j, 0] = lanes.feed[j, lane]


@jit
def fill_systems(systems, parameters, excitation, wanted, observed):
    """Write the complex modes of all particles; where they do not come out right frequencies are NaN.

    Parameters as in `march_coupled`, and `systems` with twice as many modes as are wanted.
    """
    theta, (n_sensors, n), m = parameters.theta, wanted.sensors.shape, wanted.n_modes
    count, highest = theta.shape[0], highest_coupled_step(excitation) * excitation.substeps / excitation.dt
    columns, stacks = all_columns(parameters), (parameters.mass, parameters.stiffness)
    lanes, modes = (
        new_lanes(observed[:, :1].copy(), m, at_every_step(excitation), True),
        new_complex(m, n_sensors),
    )
    structures = new_structures(n, theta.shape[1], columns[0].shape[1])
    damping, room = new_vectors(n * n), new_vectors(m * n)
    places = filled_places(parameters.damping, n)
    is_safe = is_never_negative(parameters.damping, n)
    order, kept = np.empty(n, dtype=np.int64), (new_vectors(m), new_vectors(m))
    is_diagonal, support_motion = all_diagonal(parameters.mass, n), np.dot(wanted.sensors, columns[1])
    systems.valid[:], systems.omega[:] = True, np.nan
    for first in range(0, count, LANES):
        for lane in range(LANES):
            structures.theta[:, lane] = theta[min(first + lane, count - 1)]
        solve_structures(structures, stacks, is_diagonal, columns)
        for lane in range(LANES):
            modes.is_good[0, lane] = 1.0 if structures.is_good[lane] and first + lane < count else 0.0
        products = sort_modes(structures, modes, order)
        assemble_lanes(parameters.damping, structures.theta, n, True, damping)
        project(modes, damping, places, products, room)
        check_damping(modes, structures.factor, damping, highest, is_safe)
        write_sensors(modes, lanes, products, wanted, support_motion)
        write_pairs(lanes, modes, kept, n_sensors, wanted.quantity)
        for lane in range(LANES):
            if modes.is_good[0, lane] > 0.0:
                put_pairs(systems, first + lane, lanes, kept, lane)
