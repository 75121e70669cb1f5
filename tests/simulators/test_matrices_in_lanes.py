"""Vector lanes: eigenvalues of many matrices."""

import numpy as np
import pytest
from scipy.linalg import eigh_tridiagonal

from pymc_features.simulators.eigen.tridiagonal import diagonalise_lanes
from pymc_features.simulators.numbers.vectors import LANES, new_vectors
from support.linear import noise


def in_lanes(arrays):
    """Arrays of one size as (size, LANES)."""
    found = new_vectors(arrays[0].size)
    for lane, array in enumerate(arrays):
        found[:, lane] = array.ravel()
    return found


def tridiagonals(n):
    """Diagonal and entries beside it of a matrix for each of eight lanes."""
    beside = noise(n, (8, n - 1))
    beside[1, ::3] = 0.0  # in blocks
    beside[2], beside[3] = -1.0, 0.0  # a chain; diagonal already
    diagonal = noise(n + 1, (8, n))
    diagonal[2], diagonal[4] = 2.0, abs(np.arange(n) - 0.5 * n)  # Wilkinson's: pairs of equal values
    beside[4], grade = 1.0, 10.0 ** -np.arange(n)
    diagonal[5], beside[5] = grade, 0.3 * np.sqrt(grade[1:] * grade[:-1])
    diagonal[6], beside[6] = grade[::-1], 0.3 * np.sqrt(grade[1:] * grade[:-1])[::-1]
    diagonal[7], beside[7] = 0.0, 0.0
    return diagonal[:LANES], beside[:LANES]


@pytest.mark.parametrize(("n", "scale"), [(2, 1.0), (3, 1e-12), (10, 1.0), (40, 1e12)])
def test_values_of_tridiagonal_matrices(n, scale):
    """Of matrices of any kind side by side: 1e-15 times n of the largest value."""
    diagonal, beside = (scale * a for a in tridiagonals(n))
    values = in_lanes(diagonal)
    assert diagonalise_lanes(values, in_lanes([np.append(b, 0.0) for b in beside]), new_vectors(0))
    for lane in range(LANES):
        exact = eigh_tridiagonal(diagonal[lane], beside[lane], eigvals_only=True)
        np.testing.assert_allclose(
            np.sort(values[:, lane]), exact, rtol=0, atol=1e-15 * n * abs(exact).max() + 1e-300
        )
