"""How the posterior of likelihood-free updating depends on its one knob, the tolerance."""

from collections.abc import Sequence

import numpy as np
import pymc as pm
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import (
    as_numbers,
    check_integer,
    check_model,
    check_seed,
    check_share,
    message,
    shown,
)
from pymc_features.exceptions import ToleranceNotReachedError
from pymc_features.smc import SubsetSimulation, open_workers, sample_smc

OF_THE_SAMPLER = ("log_probability", "log_probability_se", "simulations")


def tolerance_sweep(
    epsilon: ArrayLike,
    *,
    model: pm.Model | None = None,
    draws: int = 1000,
    probability: float = 0.9,
    random_seed: int | Sequence[int] | None = None,
    **kwargs,
) -> xr.Dataset:
    """Posterior intervals of every parameter at several tolerances, by `SubsetSimulation`.

    Parameters
    ----------
    epsilon : array_like (n,)
        Tolerances, positive, in squared units of the data.
    model : pymc.Model, optional
        With one `pm.Simulator` node; that of the context by default. Its own epsilon is not used.
    draws : int
        Draws of each chain at each tolerance.
    probability : float
        Of the equal-tailed intervals, between 0 and 1.
    random_seed : int or sequence of int, optional
        Of all runs: the same, so that intervals differ by their tolerance and little else.
    **kwargs
        Of `sample_smc` and `SubsetSimulation` (`chains`, `cores`, `executor`, `p0`, ...).

    Returns
    -------
    Dataset
        Over `epsilon`, the tolerances in descending order: quantiles of each parameter (epsilon, quantile,
        ...) at (1 - probability) / 2, 0.5 and (1 + probability) / 2; `log_probability` of rho <= epsilon, its
        standard error, and `simulations` of all chains. NaN where a tolerance was not reached, which is no
        error here. `plots.tolerance` draws it.

    Notes
    -----
    A large tolerance gives the prior. As it falls to the smallest rho there is, the interval shrinks to a
    point: the tolerance *is* the statement on the uncertainty. That of `abc_tolerance` gives an interval
    about twice as wide as EXP's in the ten-storey example (notebooks/3_tolerance.ipynb).
    """
    epsilon = np.sort(np.atleast_1d(as_numbers(epsilon, "epsilon", what="numbers")))[::-1]
    if epsilon.ndim != 1 or not (epsilon.size and (np.isfinite(epsilon) & (epsilon > 0)).all()):
        raise ValueError(message("epsilon", "positive and finite", shown(epsilon.tolist())))
    probability = check_share(probability, "probability", "Pass 0.9 for 5-95 %.")
    check_integer(draws, "draws", least=2)
    check_seed(random_seed)
    model = check_model(model)
    names = [rv.name for rv in model.free_RVs]
    if taken := {"epsilon", "quantile", *OF_THE_SAMPLER} & set(names):
        raise ValueError(f"`model` must not have parameters named {', '.join(sorted(taken))}. Rename them.")
    quantiles = [round(q, 12) for q in (0.5 - 0.5 * probability, 0.5, 0.5 + 0.5 * probability)]
    if random_seed is None:
        random_seed = int(np.random.SeedSequence().generate_state(1)[0])
    kwargs.setdefault("compute_convergence_checks", False)
    rows, reached = [], []
    with open_workers(kwargs.pop("executor", None)) as workers:
        for value in epsilon:
            try:
                result = sample_smc(
                    draws,
                    SubsetSimulation,
                    model=model,
                    epsilon=float(value),
                    random_seed=random_seed,
                    executor=workers,
                    **kwargs,
                )
            except ToleranceNotReachedError:
                break  # smaller ones are not reached either
            rows.append(summary(result, names, quantiles))
            reached.append(value)
    if not rows:
        raise ToleranceNotReachedError(
            f"`epsilon` must be within reach of the simulator, got {epsilon[0]:.6g} as the largest. "
            "Sample with SubsetSimulation at that one to see how far it comes."
        )
    along = xr.DataArray(reached, dims="epsilon", name="epsilon")
    return xr.concat(rows, dim=along).reindex({"epsilon": epsilon}).drop_attrs()


def summary(result, names, quantiles) -> xr.Dataset:
    """Quantiles of the parameters, and what the sampler says of the tolerance."""
    stats = result["sample_stats"]
    of_posterior = result["posterior"].to_dataset()[names].quantile(quantiles, dim=["chain", "draw"])
    n_chains = stats.sizes["chain"]
    return of_posterior.assign(
        log_probability=float(np.log(np.mean(np.exp(stats["log_marginal_likelihood"].values)))),
        log_probability_se=float(np.sqrt((stats["log_marginal_likelihood_se"] ** 2).mean() / n_chains)),
        simulations=float(stats["evaluations"].sum()),
    )
