"""Where pairs of complex modes of structures lie, one structure in each lane; `pair_lanes` fills it."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, store
from pymc_features.simulators.compiled.vector_memory import new_vectors


class PairLanes(NamedTuple):
    """Pairs of complex modes of structures, one in each lane. Two vectors for each complex number.

    Attributes
    ----------
    poles : array (3 m, LANES)
        a, b and i^2.
    left, right : array (2 m, LANES)
        1 / alpha and x'Gamma / alpha, alpha = x' (2 lambda + D) x.
    seen : array (2 s m, LANES)
        S x, of sensor j and mode r in rows 2 (j m + r) ...
    vectors : array (2 m n, LANES)
        Phi x, of entry i and mode r in rows 2 (i m + r) ...
    sums : array (4 s m, LANES)
        Of dL/dy_j times the output of a pole, and its derivative by lambda.
    of_ground : array (s, LANES)
        Of dL/dy_j times the input.
    """

    poles: np.ndarray
    left: np.ndarray
    right: np.ndarray
    seen: np.ndarray
    vectors: np.ndarray
    sums: np.ndarray
    of_ground: np.ndarray


@jit
def new_pairs(n, m, n_sensors):
    """Room for structures of n degrees of freedom and m pairs of modes."""
    s = n_sensors + n_sensors % 2
    return PairLanes(
        poles=new_vectors(3 * m),
        left=new_vectors(2 * m),
        right=new_vectors(2 * m),
        seen=new_vectors(2 * s * m),
        vectors=new_vectors(2 * m * n),
        sums=new_vectors(4 * s * m),
        of_ground=new_vectors(s),
    )


@jit
def put_number(matrix, i, number):
    """Write a complex number."""
    store(matrix, 2 * i, number[0])
    store(matrix, 2 * i + 1, number[1])


@jit
def number(matrix, i):
    """A complex number."""
    return load(matrix, 2 * i), load(matrix, 2 * i + 1)
