"""Matrices of many structures in vector lanes: eigenvalues alone, products, and the sign of damping."""

import numpy as np
import pytest
from scipy.linalg import eigh_tridiagonal

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.matrices import (
    filled_places,
    is_never_negative,
    multiply_lanes,
    multiply_sparse,
)
from pymc_features.simulators.eigen.tridiagonal import values_of_lanes
from support.linear import noise, spring_chain


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


@pytest.mark.parametrize("scale", [1.0, 1e12, 1e-12])
@pytest.mark.parametrize("n", [2, 3, 10, 40])
def test_values_without_roots(n, scale):
    """Of matrices of any kind side by side: 1e-15 times n of the largest value."""
    diagonal, beside = (scale * a for a in tridiagonals(n))
    values = in_lanes(diagonal)
    assert values_of_lanes(values, in_lanes([np.append(b * b, 0.0) for b in beside]))
    for lane in range(LANES):
        exact = eigh_tridiagonal(diagonal[lane], beside[lane], eigvals_only=True)
        np.testing.assert_allclose(
            np.sort(values[:, lane]), exact, rtol=0, atol=1e-15 * n * abs(exact).max() + 1e-300
        )


def test_values_that_are_no_numbers():
    """A lane with NaN, which it keeps, does not hold up the others."""
    values, beside = in_lanes([np.array([2.0, 3.0, 1.0])] * LANES), in_lanes([np.ones(3)] * LANES)
    values[1, 0] = np.nan
    assert values_of_lanes(values, beside)
    exact = eigh_tridiagonal([2.0, 3.0, 1.0], np.ones(2), eigvals_only=True)
    np.testing.assert_allclose(np.sort(values[:, 1]), exact, rtol=1e-14)
    assert np.isnan(values[:, 0]).any()


@pytest.mark.parametrize("n", [1, 4, 6, 9])
def test_products(n):
    """L C of a banded C, and half of the symmetric product L C L', as NumPy has them."""
    m = n + 1
    stack = np.array([spring_chain(n, 2.0).toarray().ravel(), np.diag(np.eye(n)[0]).ravel()])
    matrices = [(stack[0] + lane * stack[1]).reshape(n, n) for lane in range(LANES)]
    left = [noise(lane, (m, n)) for lane in range(LANES)]
    x, half, out = in_lanes(left), new_vectors(m * n), new_vectors(m * m)
    places = filled_places(stack, n)
    assert places[1].size == 3 * n - 2
    multiply_sparse((x, n, 1), in_lanes(matrices), places, (m, n), half)
    multiply_lanes((half, n, 1), (x, 1, n), (m, n, m), out, False)
    for lane in range(LANES):
        along = left[lane] @ matrices[lane]
        np.testing.assert_allclose(half[:, lane].reshape(m, n), along, atol=1e-13)
        np.testing.assert_allclose(out[:, lane].reshape(m, m), along @ left[lane].T, atol=1e-12)


DEFINITE = spring_chain(4, 2.0).toarray()
SIGNS = {
    "definite": ([DEFINITE], True),
    "one dashpot": ([np.diag([0.0, 0.0, 2.0, 0.0])], True),
    "none": ([np.zeros((4, 4))], True),
    "free, in doubt": ([spring_chain(4, 2.0, free=True).toarray()], False),
    "negative": ([DEFINITE - np.diag([0.0, 0.0, 0.0, 2.0])], False),
    "zero with neighbours": ([np.array([[0.0, 1.0], [1.0, 2.0]])], False),
    "no numbers": ([np.nan * DEFINITE], False),
    "varied": ([DEFINITE, DEFINITE], False),
}


@pytest.mark.parametrize(("stack", "expected"), SIGNS.values(), ids=SIGNS)
def test_damping_that_is_never_negative(stack, expected):
    """Only of a C that is the same for all, and where rounding leaves no doubt."""
    n = len(stack[0])
    assert is_never_negative(np.array(stack).reshape(len(stack), -1), n) == expected
