"""Nested sampling (optional): dynesty's dynamic sampler and UltraNest, with their defaults.

Both see the unit cube; all points of a call are evaluated at once where they take it.
"""

import functools

import numpy as np

import pymc_features as pmf
from benchmarks.methods import NotThereError
from benchmarks.methods.result import equally_weighted
from benchmarks.samplers.run import tree

IMPOSSIBLE = -1e300  # in place of -inf, which samplers elsewhere do not take


class Counted:
    """The log-likelihood of points on the sampled scale, (d,) or (n, d), and how many there were."""

    def __init__(self, density):
        self.density, self.calls = density, 0

    def __call__(self, theta):
        theta = np.asarray(theta)
        self.calls += len(np.atleast_2d(theta))
        values = self.density.log_likelihood(np.atleast_2d(theta))
        values = np.where(np.isfinite(values), values, IMPOSSIBLE)
        return values if theta.ndim == 2 else float(values[0])


@functools.lru_cache(maxsize=2)
def density_of(model):
    """Compiled once for all runs."""
    density = pmf.compiled_logp(model)
    try:
        density.from_unit_cube(np.full((1, density.n_dim), 0.5))
    except ValueError as error:
        raise NotThereError(f"the prior has no map from the unit cube: {error}") from error
    return density


def dynesty(model, seed):
    """One run."""
    from dynesty import DynamicNestedSampler

    density, rng = density_of(model), np.random.default_rng(seed)
    counted = Counted(density)

    def transform(u):
        return density.from_unit_cube(np.atleast_2d(u))[0]

    sampler = DynamicNestedSampler(counted, transform, density.n_dim, rstate=rng)
    sampler.run_nested(print_progress=False)
    found = sampler.results
    draws = equally_weighted(found.samples, found.importance_weights(), rng)
    return tree(density.parameters(draws), counted.calls, found.logz[-1], found.logzerr[-1])


def ultranest(model, seed):
    """One run."""
    from ultranest import ReactiveNestedSampler

    np.random.seed(seed)  # UltraNest draws from NumPy's global generator
    density = density_of(model)
    counted = Counted(density)
    names = [f"x{i}" for i in range(density.n_dim)]
    sampler = ReactiveNestedSampler(names, counted, density.from_unit_cube, vectorized=True)
    found = sampler.run(show_status=False, viz_callback=False)
    weighted = found["weighted_samples"]
    draws = equally_weighted(weighted["points"], weighted["weights"], np.random.default_rng(seed))
    return tree(density.parameters(draws), counted.calls, found["logz"], found["logzerr"])
