"""Chains that ended in modes without weight, left out of a result."""

import warnings

import numpy as np
import xarray as xr

from pymc_features.exceptions import ChainsDisagreeWarning
from pymc_features.inference.parameters import to_unconstrained
from pymc_features.smc import population_logp

FAR = 20.0  # below the best chain, in logarithms: such a mode has a weight of 2e-9
N_DRAWS = 200  # of each chain, to judge it by
MANY = 0.5  # share of lost chains above which the best may be lost, too


def without_lost_chains(idata: xr.DataTree, model) -> xr.DataTree:
    """A result without the chains that are far below another, and a warning that names them.

    A chain is far below another if both its mean log posterior and the log mass of its mode are lower by more
    than 20. The log mass is the mean log posterior plus the entropy of independent Gaussians with the
    variances of the draws, on the sampled scale; so a mode is kept that is low but wide.
    """
    posterior = idata["posterior"].to_dataset()
    names = posterior["chain"].values
    if len(names) < 2:
        return idata
    every = max(1, posterior.sizes["draw"] // N_DRAWS)
    points = to_unconstrained(model, posterior.isel(draw=slice(None, None, every)))
    logp = population_logp(model, model.initial_point(), {})
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.array([np.mean(prior + likelihood) for prior, likelihood, _ in map(logp, points)])
        mass = height + 0.5 * np.log(points.var(axis=1)).sum(axis=1)
        below = np.nanmax(np.fmin(height - height[:, None], mass - mass[:, None]), axis=1)
    lost = below > FAR
    if not lost.any():
        return idata
    told = ", ".join(f"chain {names[i]} by {below[i]:.0f}" for i in np.flatnonzero(lost))
    few = f" Rely on none, for {lost.sum()} of {lost.size} went astray." if lost.mean() > MANY else ""
    warnings.warn(
        "chains are left out that ended in modes without weight, their log posterior being below that of "
        f"chain {names[height.argmax()]}: {told}.{few} Increase `draws`, or narrow the priors, until "
        "all chains find the best mode.",
        ChainsDisagreeWarning,
        stacklevel=2,
    )
    kept = idata.copy()
    for group in {"posterior", "sample_stats"} & set(idata.children):
        dataset = idata[group].to_dataset().sel(chain=names[~lost])
        if "ess" in dataset.attrs:  # a sum over chains
            dataset.attrs = dataset.attrs | {"ess": float(dataset["ess"].sum())}
        kept[group] = xr.DataTree(dataset)
    return kept
