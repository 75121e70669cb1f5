"""NUTS that starts from draws of `sample`, since time histories make for many modes."""

import inspect
import warnings
from collections.abc import Sequence

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import xarray as xr
from pymc.step_methods.hmc.quadpotential import QuadPotentialFullAdapt

from pymc_features._checks import check_integer, check_keywords, check_mapping, check_model, check_seed, shown
from pymc_features.exceptions import ChainsDisagreeWarning
from pymc_features.inference.parameters import check_continuous, posterior_for, some_draws
from pymc_features.inference.sample import AGREEMENT, sample
from pymc_features.smc import processors

NUTS_SAMPLERS = ("pymc", "nutpie", "numpyro", "blackjax")
# arguments of `pm.sample` that are not passed on: ours, or given by us
OURS = {"draws", "tune", "chains", "model", "nuts_sampler", "random_seed", "kwargs"}
OURS |= {"initvals", "compute_convergence_checks", "return_inferencedata"}
OF_PYMC = [*(name for name in inspect.signature(pm.sample).parameters if name not in OURS), "target_accept"]
N_PARTICLES = 500  # draws of `sample` to start from


def sample_nuts(
    draws: int = 1000,
    *,
    tune: int = 1000,
    chains: int = 4,
    particles: xr.DataTree | None = None,
    sample_settings: dict | None = None,
    model: pm.Model | None = None,
    nuts_sampler: str = "pymc",
    random_seed: int | Sequence[int] | None = None,
    **kwargs,
) -> xr.DataTree:
    """`sample` first, then NUTS started from its draws.

    Posteriors of several stiffnesses have several modes: a chain that starts from the prior may end in a
    wrong one and stay. `sample` finds the modes and their weights; NUTS, started at one of its draws in each
    chain and with their covariance as its first mass matrix, then explores what is around them.

    Parameters
    ----------
    draws, tune, chains : int
        As in `pm.sample`.
    particles : DataTree, optional
        What `sample` or `sample_smc` returned for the same model; sampled here by default.
    sample_settings : dict, optional
        Arguments of `sample`, such as {"draws": 2000, "chains": 2}; 500 draws of one chain by default.
    model : pymc.Model, optional
        The model of the context by default.
    nuts_sampler : {"pymc", "nutpie", "numpyro", "blackjax"}
        As in `pm.sample`; the first takes over the covariance of the particles, the others adapt their own.
        With nutpie each chain draws its particle by its own seed, so that two may have the same.
    random_seed : int or sequence of int, optional
        For the same draws each time.
    **kwargs
        Of `pm.sample`, such as `cores`, `target_accept` and `progressbar`, which holds for `sample` as well.

    Returns
    -------
    DataTree
        As from `pm.sample`, and `particles`: the posterior that the chains started from. The attributes of
        `posterior` say whether the chains agree: `max_r_hat`, and `chains_agree`, 1 if that is below 1.01.

    Raises
    ------
    ValueError
        If the model has discrete parameters, or the particles are not of this model.
    NotDifferentiableError
        If a part of the model has no gradient, such as the hard threshold of ABC.

    Warns
    -----
    ChainsDisagreeWarning
        If an R-hat is above 1.01: the modes are then as the particles weigh them, not as the chains do.
    """
    for name, value, least in (("draws", draws, 1), ("tune", tune, 0), ("chains", chains, 1)):
        check_integer(value, name, least=least)
    check_seed(random_seed)
    sample_settings = check_mapping(sample_settings, "sample_settings", "a dict of arguments of `sample`")
    model = check_model(model)
    check_continuous(model, "sample_nuts()")
    if not isinstance(nuts_sampler, str) or nuts_sampler not in NUTS_SAMPLERS:
        raise ValueError(
            f"`nuts_sampler` must start each chain at its own particle, as {', '.join(NUTS_SAMPLERS)} do, "
            f"got {shown(nuts_sampler)}. Call pm.sample() for others."
        )
    check_keywords(kwargs, OF_PYMC, "sample_nuts")
    if particles is not None:
        posterior_for(model, particles, "particles")
    model.dlogp()  # says at once if there is no gradient
    first_seed, pick_seed, nuts_seed = np.random.SeedSequence(random_seed).generate_state(3)
    if particles is None:
        settings = {"draws": N_PARTICLES, "chains": 1, "random_seed": int(first_seed)}
        settings |= {"progressbar": bool(kwargs.get("progressbar", True))}
        particles = sample(model=model, **settings | sample_settings)
    posterior = posterior_for(model, particles, "particles")
    if nuts_sampler == "nutpie":
        starts = picked_by_seed(model, posterior)
        kwargs["compile_kwargs"] = {"jitter_rvs": set()} | kwargs.get("compile_kwargs", {})
    else:
        starts = pick(model, posterior, chains, np.random.default_rng(pick_seed))
    if nuts_sampler == "pymc":
        kwargs.setdefault("cores", min(chains, processors()))
        target_accept = kwargs.pop("target_accept", 0.8)
        kwargs.setdefault("step", nuts_step(model, posterior, target_accept))
    idata = pm.sample(
        draws,
        tune=tune,
        chains=chains,
        model=model,
        initvals=starts,
        nuts_sampler=nuts_sampler,
        random_seed=int(nuts_seed),
        compute_convergence_checks=False,
        **kwargs,
    )
    idata["particles"] = particles["posterior"].copy()
    return judge(idata, [rv.name for rv in model.free_RVs])


def pick(model, posterior, chains, rng):
    """Values of the free parameters at one particle for each chain, drawn without replacement."""
    n_draws = posterior.sizes["draw"]
    chosen = rng.choice(posterior.sizes["chain"] * n_draws, size=chains, replace=False)
    return [
        {rv.name: posterior[rv.name].values[i // n_draws, i % n_draws] for rv in model.free_RVs}
        for i in chosen
    ]


def picked_by_seed(model, posterior):
    """Values of the free parameters at one particle, a random number that each chain draws anew.

    nutpie takes one set of starting values for all chains, but evaluates it with a seed for each.
    """
    n = posterior.sizes["chain"] * posterior.sizes["draw"]
    chosen = pt.random.integers(0, n, rng=pytensor.shared(np.random.default_rng(0)))
    columns = {rv.name: posterior[rv.name].values for rv in model.free_RVs}
    return {name: pt.constant(v.reshape(n, *v.shape[2:]))[chosen] for name, v in columns.items()}


def nuts_step(model, posterior, target_accept):
    """NUTS with the particles' covariance as its first mass matrix."""
    flat = some_draws(model, posterior, 500 * posterior.sizes["chain"])
    covariance = np.atleast_2d(np.cov(flat, rowvar=False))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="QuadPotentialFullAdapt is an experimental")
        potential = QuadPotentialFullAdapt(flat.shape[1], flat.mean(axis=0), covariance, initial_weight=10)
    return pm.NUTS(potential=potential, target_accept=target_accept, model=model)


def judge(idata, names):
    """Note in the result, and warn, where chains disagree."""
    import arviz as az  # slow to import

    posterior = idata["posterior"].to_dataset()
    r_hats = {name: float(np.max(az.rhat(posterior[[name]])[name].values)) for name in names}
    worst = max(r_hats.values())
    posterior.attrs |= {"max_r_hat": worst, "chains_agree": int(worst <= AGREEMENT)}
    idata["posterior"] = xr.DataTree(posterior)
    if not worst <= AGREEMENT:
        bad = ", ".join(f"{name} {r:.3f}" for name, r in r_hats.items() if not r <= AGREEMENT)
        warnings.warn(
            f"the chains of NUTS disagree (R-hat: {bad}). If the posterior has several modes, chains stay in "
            "that where they start: use the draws that they started from, in the group `particles`. "
            "Otherwise increase `tune` or `draws`.",
            ChainsDisagreeWarning,
            stacklevel=3,
        )
    return idata
