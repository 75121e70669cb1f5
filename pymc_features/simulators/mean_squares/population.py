"""Misfits of populations under long records: from tables, and by the march where that is not sure.

A structure's numbers do not depend on the others of its population, nor on what the tables were asked before.
"""

import numpy as np

from pymc_features.simulators.mean_squares.asked import Asked
from pymc_features.simulators.mean_squares.evaluate import evaluate
from pymc_features.simulators.mean_squares.kept import KEPT

FEWEST_STEPS = 2000  # of the recursion; below, the march is as fast
MOST_STRIDE = 8  # steps between outputs: what a table costs grows with their square
FEWEST_ALONE, LEAST_ALONE = 4000, 80_000  # of one structure: samples, and samples times modes
ROUNDING = 5e-15  # errors of a sum, relative to what `evaluate` calls sizes: ten times what was found
SURE = 1e-8  # error of e_j that makes no difference to TN and EXP
NATS = 1e-3  # error of the log-likelihood of independent samples, whose variance is near e_j
AGREEMENT = 1e-6  # with the march


def is_long(stride, observed) -> bool:
    """Whether tables are faster."""
    return stride <= MOST_STRIDE and stride * observed.shape[-1] >= FEWEST_STEPS


def is_long_alone(stride, observed, n_modes) -> bool:
    """Whether tables are faster for one structure, whose modes do not fill the lanes of a vector."""
    n_times = observed.shape[-1]
    return stride <= MOST_STRIDE and n_times >= FEWEST_ALONE and n_times * n_modes >= LEAST_ALONE


def mean_squares(family, arguments, observed) -> np.ndarray:
    """e_j (p, s) of Eq. (3) for a population; NaN in the rows whose parameters describe no structure.

    Parameters
    ----------
    family : Family
        With the kernels "population_discrepancy", the march, and "population_systems".
    arguments : tuple
        Parameters, with a row for each particle or one for all, `Excitation` and `Outputs`.
    observed : array (s, N)
        Data.
    """
    return misfits(family, arguments, observed, "population_discrepancy")


def misfits(family, arguments, observed, kernel, is_alone=False) -> np.ndarray:
    """What a kernel gives, "population_discrepancy" (p, s) or "population_misfit" (p, s, 4).

    One structure that `is_alone` is marched, where it is, by the kernels for one.
    """
    data = KEPT.of(observed, arguments[1])
    asked, parts = Asked(family, arguments, data, is_alone), []
    tables = data.tables(4 if kernel == "population_misfit" else 1)
    if tables:
        for part, systems, poles in asked.parts("population_systems", tables):
            found, is_sure = from_tables(data, tables, systems, poles)
            if not is_sure.all():
                found[~is_sure] = asked.march(kernel, part[~is_sure])
            parts.append(found)
    if not parts:
        return asked.march(kernel)
    found = np.concatenate(parts)
    if asked.is_due(kernel):
        if not data.same(observed, np.atleast_2d(arguments[1].acceleration)):  # changed in place
            KEPT.forget(data)
            return misfits(family, arguments, observed, kernel, is_alone)
        if not agree(found[asked.some], asked.march(kernel, asked.some)):
            data.drop_tables()
            return asked.march(kernel)
    return found


def from_tables(data, tables, systems, poles):
    """Statistics of the misfit (p, s) or (p, s, 4), and whether they are as exact as needed, (p,)."""
    shape, n_times = systems.feed.shape[:2], data.observed.shape[1]
    is_sure, squares = np.ones(len(systems.valid), dtype=bool), []
    for table in tables:
        e, sizes, ends = np.full(shape, np.nan), np.full(shape, np.inf), np.full(shape, np.nan)
        evaluate(table.mesh, table.of.sums, systems, poles, e, sizes, ends)
        is_sure &= are_sure(e, sizes, n_times)
        squares.append((e / n_times, ends))
    is_sure &= systems.valid  # else no structure, or one with modes that follow: the march tells
    if len(tables) == 1:
        return squares[0][0], is_sure
    (mean_square, ends), (increment, _) = squares
    sums, observed = tables[0].of.sums, data.observed
    first = observed[:, 0] - systems.feed @ sums.own_first
    last = observed[:, -1] - systems.feed @ sums.own_last - ends
    first[~systems.valid] = np.nan
    return np.stack([mean_square, increment, first, last], axis=-1), is_sure


def are_sure(squares, sizes, n_times):
    """Whether sums of squares (p, s) are as exact as the likelihoods need, (p,)."""
    bound = min(SURE, 2.0 * NATS / (n_times * squares.shape[1]))
    return (ROUNDING * sizes <= bound * squares).all(axis=1)


def agree(found, marched) -> bool:
    """Whether tables and the march give the same: e_j, or all statistics."""
    limits = abs(marched)
    if marched.ndim == 3:  # the first and the last misfit may be zero
        limits = limits + np.sqrt(marched[:, :, :1]) * np.array([0.0, 0.0, 1.0, 1.0])
    is_same = (abs(found - marched) <= AGREEMENT * limits) | (np.isnan(found) & np.isnan(marched))
    return bool(is_same.all())
