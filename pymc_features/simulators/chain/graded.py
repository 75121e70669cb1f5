"""Modes of chains whose springs or masses differ by many orders of magnitude, each right to its own digits.

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
