"""Vector lanes: eigenvalues of many matrices, and steps of a lone structure's modes."""

import itertools

import numpy as np
import pytest
from scipy.linalg import eigh_tridiagonal

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.tridiagonal import diagonalise_lanes
from pymc_features.simulators.oscillators.table import (
    N_ROWS,
    OUT_P,
    OUT_Q,
    P_NEXT,
    P_NOW,
    P_P,
    P_Q,
    Q_NEXT,
    Q_NOW,
    Q_P,
    Q_Q,
    advance,
    scale_input,
    whole_vectors,
    write_table,
)
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


BEHIND = np.full(2 * LANES, 7.0)  # what must not be written to


def stepped(rows, q, p, ground):
    """States q and p of all modes after the steps between samples of the excitation."""
    for now, after in itertools.pairwise(ground):
        load_q, load_p = rows[[Q_NOW, P_NOW]] * now + rows[[Q_NEXT, P_NEXT]] * after
        q, p = rows[Q_Q] * q + rows[Q_P] * p + load_q, rows[P_Q] * q + rows[P_P] * p + load_p
    return q, p


@pytest.mark.parametrize("n_modes", [1, LANES, 3 * LANES - 1])
def test_modes_in_vectors(n_modes):
    """Outputs of two inputs; nothing is written behind states and outputs."""
    rng, width, count, stride = np.random.default_rng(n_modes), whole_vectors(n_modes), 7, 3
    room = np.append(np.zeros(count * n_modes + LANES), BEHIND)
    outputs, expected = room[: count * n_modes].reshape(count, n_modes), np.zeros((count, n_modes))
    for i in range(2):
        table, ground = np.zeros((N_ROWS, width)), rng.standard_normal(count * stride + 1)
        write_table(rng.uniform(1.0, 50.0, n_modes), rng.uniform(0.0, 3.0, n_modes), 0.01, 0, table)
        scale_input(table, rng.standard_normal(n_modes))
        rows, q, p = table[:, :n_modes], np.zeros(n_modes), np.zeros(n_modes)
        whole = np.append(np.zeros(2 * width), BEHIND)
        states = whole[: 2 * width].reshape(2, width)
        advance(table, i == 0, states, ground, stride, count, outputs)
        for b in range(count):
            expected[b] += rows[OUT_Q] * q + rows[OUT_P] * p
            q, p = stepped(rows, q, p, ground[b * stride : (b + 1) * stride + 1])
        np.testing.assert_allclose(states[:, :n_modes], [q, p], rtol=1e-11, atol=1e-13)
        assert (states[:, n_modes:] == 0.0).all() and (whole[2 * width :] == BEHIND).all()
    np.testing.assert_allclose(outputs, expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())
    assert (room[-BEHIND.size :] == BEHIND).all()
