"""Steps of a lone structure's modes in vectors, beside the same steps of single modes."""

import itertools

import numpy as np
import pytest

from pymc_features.simulators.compiled.vector import LANES
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

BEHIND = np.full(2 * LANES, 7.0)  # what must not be written to


def stepped(rows, q, p, ground):
    """States q and p of all modes after the steps between samples of the excitation."""
    for now, after in itertools.pairwise(ground):
        load_q, load_p = rows[[Q_NOW, P_NOW]] * now + rows[[Q_NEXT, P_NEXT]] * after
        q, p = rows[Q_Q] * q + rows[Q_P] * p + load_q, rows[P_Q] * q + rows[P_P] * p + load_p
    return q, p


@pytest.mark.parametrize("n_modes", [1, 3, LANES, LANES + 1, 2 * LANES, 3 * LANES - 1, 5 * LANES + 2])
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
