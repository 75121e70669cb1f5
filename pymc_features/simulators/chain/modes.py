"""Modes of a spring-mass chain, computed inside compiled code.

The chain's eigenproblem K phi = omega^2 M phi becomes, with y = M^(1/2) phi, that of a symmetric
tridiagonal matrix. It is solved by the implicit QL iteration (Bowdler, Martin, Reinsch & Wilkinson,
Numer. Math. 11, 293-306, 1968), which for a handful of storeys costs a few microseconds and compiles in
a fraction of the time of a general eigen-solver. The eigenvalues are then replaced by the Rayleigh
quotients of their vectors, written as sums of non-negative spring energies: the error of a quotient
is the square of the vector's, so that even the lowest frequency is right to the last digits. Where
eigenvalues differ by more than a million, the lower ones are found by `graded` instead.

Modes of chains whose springs or masses differ by many orders of magnitude, each right to its own digits.

A symmetric eigen-solver errs by rounding of the *largest* eigenvalue: beside a spring of 1e16 times the
others it tells nothing of the lowest. Here no springs are added up. What a force at mass i meets from below
is

    t_i = k_i t_{i-1} / (k_i + t_{i-1}) - lambda m_i,    t_0 = infinity,

springs in series less inertia, and u_i the same from above. Each step is as exact as a spring and a mass
changed in their last digits, which move each eigenvalue by as little *of itself*. How many of k_{i+1} + t_i
are negative is how many eigenvalues lie below lambda (Sylvester). The shape is a chain of quotients from the
mass where the two sides meet with the smallest remainder (Parlett & Dhillon, Linear Algebra Appl. 267,
247-279, 1997).
"""

import numpy as np

from pymc_features.simulators.compiled.arrays import ascending
from pymc_features.simulators.compiled.jit import jit

LOSS = 1e-6  # of the largest: below, quotients of vectors do not bring back the digits that are lost
HALVINGS = 70  # of the ratio of two bounds: 1e60 shrinks to rounding


@jit
def passed_on(spring, beyond):
    """Share of a motion that a spring passes on to what is beyond it, of a stiffness of any sign."""
    total = spring + beyond
    return spring / (total if total != 0.0 else 1e-16 * spring)


@jit
def from_below(mass, stiffness, value, i, beyond):
    """t_i, where `beyond` is t_{i-1}."""
    spring = stiffness[i]
    return (beyond * passed_on(spring, beyond) if i else spring) - value * mass[i]


@jit
def n_below(mass, stiffness, value):
    """Number of eigenvalues below a value."""
    n, count, t = mass.size, 0, 0.0
    for i in range(n):
        t = from_below(mass, stiffness, value, i, t)
        count += t + (stiffness[i + 1] if i + 1 < n else 0.0) < 0.0
    return count


@jit
def eigenvalue_of(mass, stiffness, r):
    """Eigenvalue r, counted from the lowest, right to its own rounding."""
    flexibility, sum_of_inverses, high = 0.0, 0.0, 0.0
    for i in range(mass.size):
        flexibility += 1.0 / stiffness[i]
        sum_of_inverses += mass[i] * flexibility
        high = max(high, 4.0 * stiffness[i] / mass[i])
        if i:
            high = max(high, 4.0 * stiffness[i] / mass[i - 1])
    low = 0.5 / sum_of_inverses
    for _ in range(HALVINGS):
        middle = np.sqrt(low) * np.sqrt(high)
        if n_below(mass, stiffness, middle) > r:
            high = middle
        else:
            low = middle
    return np.sqrt(low) * np.sqrt(high)


@jit
def write_shape(mass, stiffness, value, shape):
    """Write the shape (n,) of an eigenvalue, of any scale."""
    n = mass.size
    below, above = np.empty(n), np.empty(n)
    t = 0.0
    for i in range(n):
        t = below[i] = from_below(mass, stiffness, value, i, t)
    above[n - 1] = -value * mass[n - 1]
    for i in range(n - 2, -1, -1):
        above[i] = above[i + 1] * passed_on(stiffness[i + 1], above[i + 1]) - value * mass[i]
    meets, least = 0, np.inf
    for i in range(n):
        left = abs(below[i] + above[i] + value * mass[i]) / mass[i]
        if left < least:
            meets, least = i, left
    shape[meets] = 1.0
    for i in range(meets - 1, -1, -1):
        shape[i] = shape[i + 1] * passed_on(stiffness[i + 1], below[i])
    for i in range(meets + 1, n):
        shape[i] = shape[i - 1] * passed_on(stiffness[i], above[i])


MAX_ITERATIONS = 60  # QL sweeps per eigenvalue; two or three are typical
GRADED = 1e6  # ratio of two springs from where QL in lanes loses digits of the shapes, 2e-10 at this one


@jit
def diagonalise(diagonal, off_diagonal, vectors):
    """Overwrite `diagonal` by the eigenvalues and the rows of `vectors` (identity) by the vectors.

    `off_diagonal` (n,) holds the n - 1 off-diagonal entries first; it is destroyed. Returns False
    if an eigenvalue does not converge.
    """
    n = diagonal.size
    for low in range(n):
        for sweep in range(MAX_ITERATIONS + 1):
            split = low
            while split < n - 1:
                scale = abs(diagonal[split]) + abs(diagonal[split + 1])
                if abs(off_diagonal[split]) <= 2.3e-16 * scale:
                    break
                split += 1
            if split == low:
                break
            if sweep == MAX_ITERATIONS:
                return False
            # Wilkinson's shift from the leading 2 x 2 block, then chase the bulge upwards
            g = (diagonal[low + 1] - diagonal[low]) / (2.0 * off_diagonal[low])
            r = np.sqrt(g * g + 1.0)
            g = diagonal[split] - diagonal[low] + off_diagonal[low] / (g + (r if g >= 0 else -r))
            s = c = 1.0
            p = 0.0
            deflated = False
            for i in range(split - 1, low - 1, -1):
                f = s * off_diagonal[i]
                b = c * off_diagonal[i]
                r = np.sqrt(f * f + g * g)
                off_diagonal[i + 1] = r
                if r == 0.0:
                    diagonal[i + 1] -= p
                    off_diagonal[split] = 0.0
                    deflated = True
                    break
                s = f / r
                c = g / r
                g = diagonal[i + 1] - p
                r = (diagonal[i] - g) * s + 2.0 * c * b
                p = s * r
                diagonal[i + 1] = g + p
                g = c * r - b
                for k in range(n):
                    upper = vectors[i + 1, k]
                    vectors[i + 1, k] = s * vectors[i, k] + c * upper
                    vectors[i, k] = c * vectors[i, k] - s * upper
            if not deflated:
                diagonal[low] -= p
                off_diagonal[low] = g
                off_diagonal[split] = 0.0
    return True


@jit
def spring_energy_quotient(stiffness, mass, shape):
    """Rayleigh quotient phi' K phi / phi' M phi of a chain, without cancellation, and phi' M phi."""
    energy = 0.0
    inertia = 0.0
    below = 0.0
    for i in range(mass.size):
        drift = shape[i] - below
        energy += stiffness[i] * drift * drift
        inertia += mass[i] * shape[i] * shape[i]
        below = shape[i]
    return energy / inertia, inertia


@jit
def normalise(mass, stiffness, shape):
    """Scale a mode shape in place to phi' M phi = 1 and a positive top; return omega and phi' M 1."""
    eigenvalue, inertia = spring_energy_quotient(stiffness, mass, shape)
    scale = (1.0 if shape[mass.size - 1] >= 0.0 else -1.0) / np.sqrt(inertia)
    total = 0.0
    for i in range(mass.size):
        shape[i] *= scale
        total += mass[i] * shape[i]
    return np.sqrt(eigenvalue), total


@jit
def is_chain(mass, stiffness):
    """Whether every mass and spring is positive and finite; written so that NaN fails too."""
    possible = True
    for i in range(mass.size):
        possible &= 0.0 < mass[i] < np.inf and 0.0 < stiffness[i] < np.inf
    return possible


@jit
def is_graded(stiffness):
    """Whether springs differ so much that a sum of two of them loses the digits of the smaller one."""
    least, largest = stiffness[0], stiffness[0]
    for one in stiffness:
        least, largest = min(least, one), max(largest, one)
    return largest > GRADED * least


@jit
def chain_modes(mass, stiffness, angular_frequencies, mode_shapes, participation):
    """Modes of the fixed-base chain, Eqs. (17)-(20), in ascending order of frequency.

    Parameters
    ----------
    mass, stiffness : array (n,)
        Masses [kg] and spring constants [N/m], both from the base upwards.
    angular_frequencies, participation : array (n,)
        Written: omega_r [rad/s] and Gamma_r = phi_r' M 1.
    mode_shapes : array (n, n)
        Written: **rows** are the mass-normalised mode shapes, phi_r' M phi_r = 1.

    Returns
    -------
    bool
        False where the parameters do not describe a chain (a mass or spring that is not positive
        and finite) or the iteration fails; the arrays are then undefined.
    """
    n = mass.size
    if not is_chain(mass, stiffness):
        return False
    values = np.empty(n)
    off_diagonal = np.zeros(n)
    vectors = np.zeros((n, n))
    for i in range(n):
        above = stiffness[i + 1] if i + 1 < n else 0.0
        values[i] = (stiffness[i] + above) / mass[i]
        if i + 1 < n:
            off_diagonal[i] = -above / (np.sqrt(mass[i]) * np.sqrt(mass[i + 1]))
        vectors[i, i] = 1.0
    if not diagonalise(values, off_diagonal, vectors):
        return False
    order = ascending(values)
    largest = values[order[n - 1]]
    for r in range(n):
        shape = mode_shapes[r]
        if values[order[r]] < LOSS * largest:
            value = eigenvalue_of(mass, stiffness, r)
            write_shape(mass, stiffness, value, shape)
            participation[r] = normalise(mass, stiffness, shape)[1]
            angular_frequencies[r] = np.sqrt(value)
            continue
        for i in range(n):
            shape[i] = vectors[order[r], i] / np.sqrt(mass[i])
        angular_frequencies[r], participation[r] = normalise(mass, stiffness, shape)
    return True
