"""From the derivatives by the modes of dense structures, one in each lane, to those by what theta changes."""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, store
from pymc_features.simulators.compiled.vector_memory import new_vectors, read_lanes
from pymc_features.simulators.derivatives.coupled import add_load_terms, add_terms, write_entries
from pymc_features.simulators.derivatives.memory import get
from pymc_features.simulators.eigen.matrices import multiply_lanes


@jit
def new_spread(n, m):
    """Room for `spread_lanes`: derivatives in modes (n m), left factors and entries, and a vector."""
    return new_vectors(n * m), new_vectors(n * m), new_vectors(n * n), new_vectors(n)


@jit
def add_damping(lanes, lane, gradients):
    """Add the derivatives of one lane by Rayleigh's pair and the ratios."""
    for r in range(lanes.n_modes):
        omega, damping = get(lanes.omega, r, lane), get(lanes.by_damping, r, lane)
        gradients[1][0] += damping
        gradients[1][1] += damping * omega * omega
        gradients[2][r] += damping * 2.0 * omega


@jit
def write_reduced(lanes, sensors, rows, of_mass, reduced):
    """Write the derivatives by Phi'K Phi, or Phi'M Phi, (n m, LANES), those by kept modes in the columns.

    The rows of the modes left out are how the kept ones leave their span, see `outside`.
    """
    (values, vectors), m, n = rows, lanes.n_modes, rows[0].shape[0]
    own = lanes.by_mass if of_mass else lanes.by_stiffness
    for s in range(m):
        for r in range(m):
            store(reduced, s * m + r, read_lanes(own, s * lanes.m + r))
    for s in range(m, n):
        for r in range(m):
            store(reduced, s * m + r, load(vectors, s * (n + 2) + n + 1) * read_lanes(lanes.by_load, r))
        for j in range(sensors.shape[0]):
            seen = splat(0.0)
            for i in range(n):
                if sensors[j, i] != 0.0:
                    seen = seen + load(vectors, s * (n + 2) + i) * sensors[j, i]
            for r in range(m):
                total = load(reduced, s * m + r) + seen * read_lanes(lanes.by_shapes, j * lanes.m + r)
                store(reduced, s * m + r, total)
        for r in range(m):
            value, total = load(values, r), load(reduced, s * m + r)
            total = total / (load(values, s) - value)
            store(reduced, s * m + r, value * total if of_mass else splat(0.0) - total)


@jit
def spread_lanes(parameters, sensors, lanes, rows, matrices, by_theta):
    """Add the derivatives by the entries of K and M, times what theta changes of them, to `by_theta`."""
    (reduced, left, entries, by_load), vectors = matrices, rows[1]
    n, m = by_load.shape[0], lanes.n_modes
    width = n + 2
    for of_mass in (False, True):
        stack = parameters.mass if of_mass else parameters.stiffness
        if stack.shape[0] == 1:
            continue
        write_reduced(lanes, sensors, rows, of_mass, reduced)
        multiply_lanes((vectors, 1, width), (reduced, m, 1), (n, n, m), left, True)
        write_entries((left, m, 1), (vectors, 1, width), m, stack, entries)
        if of_mass:
            for i in range(n):
                total = splat(0.0)
                for r in range(m):
                    total = total + load(vectors, r * width + i) * read_lanes(lanes.by_load, r)
                store(by_load, i, total)
            add_load_terms(by_load, parameters.influence, entries)
        add_terms(stack, entries, by_theta)
