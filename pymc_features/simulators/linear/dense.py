"""Modes of dense structures inside compiled code, as `algebra.natural_modes`, and a test that they exist.

K phi = omega^2 M phi becomes the standard problem of F^-1 K F^-T, F F' = M, for LAPACK; where M is diagonal F
is its root and costs nothing. What has no mass is condensed first. The eigenvalues are then replaced by the
Rayleigh quotients of their vectors.

Symmetric matrices in compiled code: Cholesky factors, and condensation as in `algebra.massless`.
"""

import numpy as np

from pymc_features.algebra import INDEFINITE, MASSLESS, NEGATIVE, ROUNDING, UNHELD, ZERO_STIFFNESS
from pymc_features.simulators.compiled.arrays import ascending, copy_entries
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.modal_system import write_damping


@jit
def is_diagonal(matrix):
    """Whether all entries off the diagonal are zero."""
    for i in range(matrix.shape[0]):
        for j in range(i):
            if matrix[i, j] != 0.0 or matrix[j, i] != 0.0:
                return False
    return True


@jit
def factorise(matrix, factor, floor):
    """Write the Cholesky factor of a matrix into the lower half of another; False if it is not definite.

    `floor` is the share of its diagonal entry that a pivot must exceed.
    """
    for i in range(matrix.shape[0]):
        row = factor[i]
        for j in range(i + 1):
            other, total = factor[j], matrix[i, j]
            for k in range(j):
                total -= row[k] * other[k]
            if j < i:
                row[j] = total / other[j]
            elif floor * matrix[i, i] < total < np.inf:
                row[i] = np.sqrt(total)
            else:
                return False
    return True


@jit
def factorise_semidefinite(matrix, factor, independent):
    """Factorise M, and tell whether a row (n,) depends on those before it; its column is then zero.

    False if the matrix has a negative eigenvalue.
    """
    for i in range(matrix.shape[0]):
        row, own = factor[i], np.sqrt(matrix[i, i])
        for j in range(i + 1):
            other, total = factor[j], matrix[i, j]
            for k in range(j):
                total -= row[k] * other[k]
            if j == i:
                independent[i] = total > MASSLESS * matrix[i, i]
            row[j] = 0.0
            if not independent[j]:
                if not abs(total) <= INDEFINITE * own * np.sqrt(matrix[j, j]):  # NaN too
                    return False
            elif j < i:
                row[j] = total / other[j]
            else:
                row[i] = np.sqrt(total)
    return True


@jit
def null_space(factor, independent, motions):
    """Write the null space, rows (k, n) of zeros before, of a matrix from its `factorise_semidefinite`.

    Each is one in its own dependent row, zero in the others.
    """
    r = 0
    for i in range(independent.size):
        if independent[i]:
            continue
        motion = motions[r]
        for j in range(i):
            motion[j] = -factor[i, j]
        for k in range(i - 1, -1, -1):
            if independent[k]:
                motion[k] /= factor[k, k]
                for j in range(k):
                    motion[j] -= motion[k] * factor[k, j]
        motion[i] = 1.0
        r += 1


@jit
def condense(mass, stiffness, independent):
    """Static condensation of motions without mass.

    Parameters
    ----------
    mass, stiffness : array (n, n)
    independent : bool (n,)
        Written: degrees of freedom with mass, as many as M has ranks.

    Returns
    -------
    possible : bool
        False, the rest then undefined, where M is not positive semi-definite or K not definite on its null
        space.
    shapes : array (r, n)
        Rows: unit displacements of the degrees of freedom with mass, what has none following.
    motions : array (n - r, n)
        Rows: the null space of M, x' K y of any two 1 or 0.
    """
    n = mass.shape[0]
    factor, rank = np.empty((n, n)), 0
    possible = factorise_semidefinite(mass, factor, independent)
    for i in range(n):
        rank += independent[i]
    motions, shapes = np.zeros((n - rank, n)), np.zeros((rank, n))
    if possible:
        null_space(factor, independent, motions)
        loads = np.dot(motions, stiffness)
        held, root = np.dot(loads, motions.T), np.empty((n - rank, n - rank))
        possible = factorise(held, root, UNHELD)
    if possible:
        for i in range(n - rank):
            for j in range(i + 1):
                share = root[i, j]
                for k in range(n):
                    if j < i:
                        motions[i, k] -= share * motions[j, k]
                        loads[i, k] -= share * loads[j, k]
                    else:
                        motions[i, k] /= share
                        loads[i, k] /= share
        static, r = np.dot(loads.T, motions), 0
        for i in range(n):
            if independent[i]:
                for k in range(n):
                    shapes[r, k] = (1.0 if k == i else 0.0) - static[i, k]
                r += 1
    return possible, shapes, motions


@jit
def assemble_dense(stack, theta, matrix):
    """Write A_0 + sum_i theta_i A_i (n, n); entries (1 + p, n n) or, of a constant, (1, n n)."""
    entries = matrix.reshape(-1)
    copy_entries(stack[0], entries)
    for i in range(stack.shape[0] - 1):
        factor, term = theta[i], stack[1 + i]
        for e in range(entries.size):
            entries[e] += factor * term[e]


@jit
def is_finite(array):
    """Whether no entry of an array, of any shape, is NaN or infinite."""
    possible = True
    for value in array.flat:
        possible &= np.isfinite(value)
    return possible


@jit
def spectral_shift(mass, stiffness):
    """`algebra.spectral_shift`."""
    inertia, spring = 0.0, 0.0
    for i in range(mass.shape[0]):
        if mass[i, i] > 0.0:
            inertia += mass[i, i]
            spring += stiffness[i, i]
    return ZERO_STIFFNESS * (abs(spring) / inertia if spring != 0.0 else 1.0)


@jit
def reduce_stiffness(mass, stiffness, diagonal, factor, reduced):
    """Write F, and A = F^-1 K F^-T; False if M is not positive definite. `diagonal` says whether M is."""
    n, possible = mass.shape[0], True
    if diagonal:
        for i in range(n):
            possible &= mass[i, i] > 0.0
            factor[i, i] = np.sqrt(mass[i, i])
    else:
        possible = factorise(mass, factor, MASSLESS)
    if not possible:
        return False
    half = np.empty((n, n))  # F^-1 K
    for i in range(n):
        row, multipliers = half[i], factor[i]
        copy_entries(stiffness[i], row)
        for k in range(0 if diagonal else i):
            other = half[k]
            for j in range(n):
                row[j] -= multipliers[k] * other[j]
        for j in range(n):
            row[j] /= multipliers[i]
    for i in range(n):
        row = reduced[i]
        for j in range(i + 1):
            total, multipliers = half[i, j], factor[j]
            for k in range(0 if diagonal else j):
                total -= row[k] * multipliers[k]
            row[j] = reduced[j, i] = total / multipliers[j]
    return True


@jit
def physical_shapes(factor, diagonal, vectors, shapes):
    """Write phi = F^-T y into the rows of `shapes` (m, n), y the first columns of `vectors` (n, n)."""
    n = factor.shape[0]
    for r in range(shapes.shape[0]):
        shape = shapes[r]
        for i in range(n):
            shape[i] = vectors[i, r]
        for k in range(n - 1, -1, -1):
            multipliers = factor[k]
            shape[k] /= multipliers[k]
            for i in range(0 if diagonal else k):
                shape[i] -= shape[k] * multipliers[i]


@jit
def rayleigh_quotient(stiffness, largest, shape, forces, inertia):
    """phi' K phi / phi' M phi; zero where only rounding is left of it, NaN where it is negative beyond that.

    `forces` (n,) are K phi, `inertia` phi' M phi, and no row of |K| has a sum above `largest`.
    """
    n = shape.size
    energy, square = 0.0, 0.0
    for i in range(n):
        energy += shape[i] * forces[i]
        square += shape[i] * shape[i]
    if energy >= ROUNDING * largest * square:  # which bounds the sum below, at less cost
        return energy / inertia
    terms = 0.0
    for i in range(n):
        for j in range(n):
            terms += abs(shape[i] * stiffness[i, j] * shape[j])
    if energy >= ROUNDING * terms:
        return energy / inertia
    return 0.0 if energy >= -NEGATIVE * terms else np.nan


@jit
def normalise(mass, stiffness, diagonal, omega, shapes):
    """Write the frequencies, ascending, and scale and sort the shapes as `algebra.natural_modes`.

    False where one is imaginary.
    """
    n_modes, n = shapes.shape
    forces = np.dot(shapes, stiffness)
    momenta = shapes if diagonal else np.dot(shapes, mass)
    largest = 0.0
    for i in range(n):
        largest = max(largest, np.abs(stiffness[i]).sum())
    for r in range(n_modes):
        shape, inertia, peak = shapes[r], 0.0, 0
        for i in range(n):
            inertia += shape[i] * momenta[r, i] * (mass[i, i] if diagonal else 1.0)
            if abs(shape[i]) > abs(shape[peak]):
                peak = i
        omega[r] = np.sqrt(rayleigh_quotient(stiffness, largest, shape, forces[r], inertia))
        if not omega[r] >= 0.0:
            return False
        scale = (-1.0 if shape[peak] < 0.0 else 1.0) / np.sqrt(inertia)
        for i in range(n):
            shape[i] *= scale
    order = ascending(omega)
    copy_entries(omega[order], omega)
    copy_entries(shapes[order].reshape(-1), shapes.reshape(-1))
    return True


@jit
def lowest_shapes(mass, stiffness, diagonal, factor, reduced, shapes):
    """Write the lowest modes, unscaled, into the rows (m, n); False if M is not positive definite.

    `diagonal` says whether M is, `factor` and `reduced` (n, n) are overwritten.
    """
    if not (reduce_stiffness(mass, stiffness, diagonal, factor, reduced) and is_finite(reduced)):
        return False  # LAPACK would raise
    try:
        _, vectors = np.linalg.eigh(reduced)
    except Exception:  # noqa: BLE001  the iteration did not converge; compiled code knows no other class
        return False
    physical_shapes(factor, diagonal, vectors, shapes)
    return True


@jit
def condensed_shapes(mass, stiffness, shapes):
    """Lowest modes as in `lowest_shapes`, of an M that is singular; number of modes found, or 0.

    The rows behind them are motions without mass, phi' K phi = 1.
    """
    n, independent = mass.shape[0], np.empty(mass.shape[0], dtype=np.bool_)
    possible, static, motions = condense(mass, stiffness, independent)
    rank = static.shape[0]
    count = min(rank, shapes.shape[0])
    if not possible or rank == 0 or rank == n:
        return 0
    own_mass, r = np.empty((rank, rank)), 0
    for i in range(n):
        if independent[i]:
            s = 0
            for j in range(n):
                if independent[j]:
                    own_mass[r, s] = mass[i, j]
                    s += 1
            r += 1
    own_stiffness = np.dot(np.dot(static, stiffness), static.T)
    factor, reduced, own_shapes = np.empty((rank, rank)), np.empty((rank, rank)), np.empty((count, rank))
    if not lowest_shapes(own_mass, own_stiffness, is_diagonal(own_mass), factor, reduced, own_shapes):
        return 0
    np.dot(own_shapes, static, shapes[:count])
    for r in range(count, shapes.shape[0]):
        for k in range(n):
            shapes[r, k] = motions[r - count, k]
    return count


@jit
def dense_modes(mass, stiffness, omega, shapes):
    """Lowest modes of a structure, if it is admissible.

    Parameters
    ----------
    mass, stiffness : array (n, n)
        [kg] and [N/m], symmetric; only read.
    omega, shapes : array (m,), (m, n)
        Written: [rad/s], ascending, exactly zero for rigid-body modes; **rows** are mass-normalised, the
        largest entry of each positive. Beyond the rank of M omega is infinite and the rows are motions
        without mass, orthogonal and normalised by K.

    Returns
    -------
    bool
        False, the arrays then undefined, where M or some omega^2 is negative, or K not positive definite on
        what has no mass.

    Notes
    -----
    O(n^3), for n = 100 spent in LAPACK's syevd. Agrees with `algebra.natural_modes` to rounding
    (tests/simulators/test_linear_kernels.py).
    """
    n, count = mass.shape[0], omega.size
    if not (is_finite(mass) and is_finite(stiffness)):
        return False
    factor, reduced = np.empty((n, n)), np.empty((n, n))
    shift = spectral_shift(mass, stiffness)
    for i in range(n):
        for j in range(i + 1):
            reduced[i, j] = stiffness[i, j] + shift * mass[i, j]
    if not factorise(reduced, factor, 0.0):
        return False
    diagonal = is_diagonal(mass)
    if not lowest_shapes(mass, stiffness, diagonal, factor, reduced, shapes):
        count = condensed_shapes(mass, stiffness, shapes)
        omega[count:] = np.inf
    return count > 0 and normalise(mass, stiffness, diagonal, omega[:count], shapes[:count])


@jit
def solve_dense(parameters, own, step, n_modes, n_kept):
    """Lowest modes of one structure, with the damping of those that are kept.

    Parameters
    ----------
    parameters : LinearParameters
        For the matrices, dense.
    own : tuple of arrays (p,), (2,), (k,)
        theta, rayleigh and ratios.
    step : float
        Step of the recursion [s].
    n_modes, n_kept : int

    Returns
    -------
    valid : bool
        False if there is no structure; the rest is undefined then.
    omega, rows : array (n_modes,), (n_modes, n)
        As `dense_modes` writes them.
    damping : array (n_kept,)
        D [1/s].
    load : array (n, d)
        M influence - forces.
    """
    n, (theta, rayleigh, ratios) = parameters.influence.shape[0], own
    mass, stiffness = np.empty((n, n)), np.empty((n, n))
    omega, damping, rows = np.empty(n_modes), np.empty(n_kept), np.zeros((n_modes, n))
    valid = is_finite(theta) and is_finite(rayleigh) and is_finite(ratios)
    if valid:
        assemble_dense(parameters.mass, theta, mass)
        assemble_dense(parameters.stiffness, theta, stiffness)
        valid = dense_modes(mass, stiffness, omega, rows)
    if valid:
        valid = write_damping(omega[:n_kept], rayleigh, ratios, step, damping)
    return valid, omega, rows, damping, np.dot(mass, parameters.influence) - parameters.forces
