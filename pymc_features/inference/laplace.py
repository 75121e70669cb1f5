"""Laplace's approximation, the field's asymptotic method: draws, evidence, and how good they are."""

import warnings

import numpy as np
import pymc as pm
import xarray as xr
from pymc.backends.arviz import coords_and_dims_for_inferencedata
from pymc.initial_point import make_initial_point_fn
from pymc.util import RandomState

from pymc_features.exceptions import LaplaceWarning
from pymc_features.inference.parameters import Unconstrained, check_continuous, initial_values
from pymc_features.inference.posterior_modes import Density, climb, distinct
from pymc_features.smc import population_logp, prior_draws

LOW_EFFICIENCY = 0.2


def laplace(
    draws: int = 2000,
    *,
    model: pm.Model | None = None,
    starts: int = 5,
    n_prior: int = 500,
    start: dict | None = None,
    random_seed: RandomState = None,
    compile_kwargs: dict | None = None,
) -> xr.DataTree:
    """Gaussian approximation of the posterior at its modes, on the unconstrained scale, with the evidence.

    The best of a number of prior draws are climbed from to the modes next to them; each mode x with
    curvature H (minus the Hessian of the log-posterior) contributes p(x) (2 pi)^(d/2) det(H)^(-1/2) to the
    evidence and as much to the mixture of Gaussians that is drawn from (Beck & Katafygiotis, J. Eng. Mech.
    124, 1998).

    Parameters
    ----------
    draws : int
        Draws from the approximation.
    model : pymc.Model, optional
        The model of the context by default.
    starts : int
        Climbs.
    n_prior : int
        Prior draws to choose the starts from: the best of half of them, of a quarter, and so on, so that the
        first climbs look for the highest mode and the last for others.
    start : dict, optional
        A point to climb from instead, names to values of free parameters on their own scale.
    random_seed : int or Generator, optional
        For the same draws each time.
    compile_kwargs : dict, optional
        For `pytensor.function`.

    Returns
    -------
    DataTree
        `posterior`: draws (one chain). `sample_stats`: `log_marginal_likelihood` by Laplace's formula. By
        importance sampling of the true posterior with the same draws: `log_marginal_likelihood_is` with
        standard error `log_marginal_likelihood_is_se`, and `efficiency`, the effective share of the draws:
        near one if the posterior is near the approximation. `modes` (mode, or posterior_mode where the model
        has a dimension mode): parameters, `log_density`, `log_marginal_likelihood` and `weight`, the highest
        first.

    Raises
    ------
    ValueError
        If the model has discrete parameters, or no climb ends at a maximum with positive curvature.

    Warns
    -----
    LaplaceWarning
        If the efficiency is below 0.2.

    Examples
    --------
    >>> with pm.Model():
    ...     x = pm.Normal("x")
    ...     y = pm.Normal("y", x, 1.0, observed=[1.0])
    ...     idata = laplace(100, random_seed=1)
    >>> float(idata["sample_stats"]["log_marginal_likelihood"][0].round(6))
    -1.515512
    """
    model = pm.modelcontext(model)
    check_continuous(model, "laplace()")
    for name, value in (("draws", draws), ("starts", starts), ("n_prior", n_prior)):
        if isinstance(value, bool) or int(value) != value or value < 1:
            raise ValueError(f"`{name}` must be a positive integer, got {value}.")
    rng = np.random.default_rng(random_seed)
    density, space = Density(model, compile_kwargs), Unconstrained(model)
    logp = population_logp(model, model.initial_point(), compile_kwargs or {})
    points = starting_points(model, space, logp, rng, starts, n_prior, start)
    found = distinct([mode for point in points if (mode := climb(density, point)) is not None])
    if not found:
        raise ValueError(
            f"the posterior must have a maximum with positive curvature, found none from {len(points)} "
            "starts. The data may not determine its parameters: see fisher_information(). Sample with "
            "sample_smc()."
        )
    evidences = np.array(
        [value + 0.5 * len(x) * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(h)[1] for x, value, h in found]
    )
    particles, log_density = draw_mixture(found, evidences, int(draws), rng)
    prior, likelihood = logp(particles)[:2]
    return tree(model, space, particles, found, evidences, prior + likelihood - log_density)


def starting_points(model, space, logp, rng, starts, n, start):
    """Points (d,) to climb from: the best of equal shares of `n` prior draws, or the one given."""
    if start is not None:
        overrides = initial_values(model, start)
        return [space.join(make_initial_point_fn(model=model, overrides=overrides)(0))]
    names = [model.rvs_to_values[rv].name for rv in model.free_RVs]
    columns = dict(zip(names, prior_draws(model, True)(n, rng), strict=True))
    particles = np.hstack([np.reshape(columns[v.name], (n, -1)) for v in model.value_vars])
    prior, likelihood = logp(particles)[:2]
    total = prior + likelihood
    # shares that shrink by half: the first climbs start from the best of many, the last from about anywhere
    ends = np.unique((n * (1.0 - 0.5 ** np.arange(1, starts + 1))).astype(int))
    shares = np.split(np.arange(n), ends)
    best = [share[total[share].argmax()] for share in shares[:starts] if len(share)]
    return [particles[i] for i in best if np.isfinite(total[i])]


def draw_mixture(modes, evidences, n, rng):
    """Draws (n, d) from Gaussians at the modes, stratified, and their log-density (n,)."""
    log_weights = evidences - np.logaddexp.reduce(evidences)
    weights = np.exp(log_weights)
    which = np.searchsorted(np.cumsum(weights), (np.arange(n) + rng.random()) / n).clip(max=len(modes) - 1)
    z = rng.standard_normal((n, len(modes[0][0])))
    particles = np.empty_like(z)
    for k, (x, _, curvature) in enumerate(modes):
        factor = np.linalg.cholesky(curvature)
        particles[which == k] = x + np.linalg.solve(factor.T, z[which == k].T).T
    parts = []
    for (x, _, curvature), log_weight in zip(modes, log_weights, strict=True):
        away = particles - x
        logdet = np.linalg.slogdet(curvature)[1]
        quadratic = np.einsum("ni,ij,nj->n", away, curvature, away)
        parts.append(log_weight + 0.5 * (logdet - len(x) * np.log(2 * np.pi) - quadratic))
    order = rng.permutation(n)
    return particles[order], np.logaddexp.reduce(parts, axis=0)[order]


def tree(model, space, particles, modes, evidences, log_ratios):
    """The result as a DataTree."""
    import arviz as az  # slow to import

    coords, dims = coords_and_dims_for_inferencedata(model)
    ratios = np.exp(log_ratios - log_ratios.max())
    n = len(ratios)
    efficiency = float(ratios.sum() ** 2 / (ratios**2).sum() / n)
    if efficiency < LOW_EFFICIENCY:
        warnings.warn(
            f"Laplace's approximation is poor here: its draws are worth {100 * efficiency:.2g} % of as many "
            "from the posterior. Sample with sample_smc().",
            LaplaceWarning,
            stacklevel=3,
        )
    stats = {
        "log_marginal_likelihood": [np.logaddexp.reduce(evidences)],
        "log_marginal_likelihood_is": [log_ratios.max() + np.log(ratios.mean())],
        "log_marginal_likelihood_is_se": [ratios.std() / ratios.mean() / np.sqrt(n)],
        "efficiency": [efficiency],
    }
    result = az.from_dict(
        {"posterior": {k: v[None] for k, v in space.variables(particles).items()}}, coords=coords, dims=dims
    )
    result["sample_stats"] = xr.DataTree(xr.Dataset({k: ("chain", np.array(v)) for k, v in stats.items()}))
    # a damping ratio for each mode of vibration may well have taken the name
    over = "posterior_mode" if any("mode" in of_one for of_one in dims.values()) else "mode"
    at_modes = {
        name: ((over, *dims.get(name, [f"{name}_dim_{i}" for i in range(v.ndim - 1)])), v)
        for name, v in space.variables([m[0] for m in modes]).items()
    }
    summary = {
        "log_density": (over, [m[1] for m in modes]),
        "log_marginal_likelihood": (over, evidences),
        "weight": (over, np.exp(evidences - np.logaddexp.reduce(evidences))),
    }
    result["modes"] = xr.DataTree(xr.Dataset({**at_modes, **summary}))
    return result
