"""Laplace's approximation, the field's asymptotic method: draws, evidence, and how good they are."""

import warnings
from collections.abc import Callable

import numpy as np
import pymc as pm
import xarray as xr
from pymc.util import RandomState

from pymc_features._checks import check_integer, check_mapping, check_model, check_seed
from pymc_features.exceptions import LaplaceWarning
from pymc_features.inference.parameters import (
    Unconstrained,
    check_continuous,
    entry_names,
    forward_transform,
    initial_values,
)
from pymc_features.smc import find_reference, likelihood_kinds, population_logp, prior_points
from pymc_features.smc.proposals.pool import QUANTILES, log_mean
from pymc_features.smc.proposals.reference import Density, climb, curvature, in_units

MAX_NEWTON, MAX_HALVINGS = 30, 30
NO_GAIN = 1e-12  # in the log-density, of the next step: at a mode
SMALL_GAIN = 1e-4  # above which rounding does not keep it
SAME_MODE = 0.1  # squared distance in standard deviations of modes that are one


def gaussian_at(density: Callable, x: np.ndarray, scale: np.ndarray):
    """Go on from near a mode to it.

    Parameters
    ----------
    density : callable
        Log-density (n,) and its gradient (n, d) at points (n, d).
    x : array (d,)
    scale : array (d,)
        Of the coordinates.

    Returns
    -------
    x, value, curvature
        The mode, its log-density, and minus the Hessian there; None if there is no maximum with a positive
        definite curvature.
    """
    scaled, u = in_units(density, 0.0, scale), x / scale
    value, slope = (part[0] for part in scaled(u[None]))
    for _ in range(MAX_NEWTON):
        hessian = curvature(scaled, u)
        if not np.isfinite(hessian).all():
            return None
        eigenvalues, vectors = np.linalg.eigh(hessian)
        least = 1e-12 * np.abs(eigenvalues).max()
        step = vectors @ ((vectors.T @ slope) / np.maximum(np.abs(eigenvalues), least))
        gain = float(slope @ step)
        if gain < NO_GAIN:
            break
        further = half_steps(scaled, u, value, step)
        if further is None:
            break
        u, value, slope = further
    if not (np.isfinite(value) and eigenvalues[0] > 0.0 and gain < SMALL_GAIN):
        return None
    return scale * u, float(value), hessian / np.outer(scale, scale)


def half_steps(density, x, value, step):
    """The first of ever shorter steps that is higher: point, value and slope; None if there is none."""
    for _ in range(MAX_HALVINGS):
        values, slopes = density((x + step)[None])
        if values[0] > value:
            return x + step, values[0], slopes[0]
        step = 0.5 * step
    return None


def distinct(modes: list) -> list:
    """Modes (x, value, curvature) from the highest on, without those that were found before."""
    kept = []
    for mode in sorted(modes, key=lambda m: -m[1]):
        x, _, hessian = mode
        if all((x - other) @ hessian @ (x - other) > SAME_MODE for other, _, _ in kept):
            kept.append(mode)
    return kept


LOW_EFFICIENCY = 0.2
LARGE_ERROR = 0.2  # of a quantile, over the 5-95 % width


def laplace(
    draws: int = 2000,
    *,
    model: pm.Model | None = None,
    start: dict | None = None,
    random_seed: RandomState = None,
    compile_kwargs: dict | None = None,
) -> xr.DataTree:
    """Gaussian approximation of the posterior at its modes, on the unconstrained scale, with the evidence.

    Climbs from the best of some prior draws find the modes, as those of `sample` do; each mode x with
    curvature H (minus the Hessian of the log-posterior) contributes p(x) (2 pi)^(d/2) det(H)^(-1/2) to the
    evidence and as much to the mixture of Gaussians that is drawn from (Beck & Katafygiotis, J. Eng. Mech.
    124, 1998).

    Parameters
    ----------
    draws : int
        Draws from the approximation, and the gradients to spend on the search for more modes than the first
        eight climbs find.
    model : pymc.Model, optional
        The model of the context by default.
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
        standard error `log_marginal_likelihood_is_se`; `efficiency`, the effective share of the draws: near
        one if the posterior is near the approximation; and `largest_error`, by how much the 5, 50 and 95 %
        quantiles of the parameters are off, over the 5-95 % width, at worst; the attribute `worst_parameter`
        names which. `modes` (mode, or posterior_mode where the model
        has a dimension mode): parameters, `log_density`, `log_marginal_likelihood` and `weight`, the highest
        first.

    Raises
    ------
    ValueError
        If the model has discrete parameters, or no climb ends at a maximum with positive curvature.
    NotDifferentiableError
        If a part of the model has no gradient.

    Warns
    -----
    LaplaceWarning
        If the efficiency is below 0.2, or a quantile is off by more than 0.2 of the 5-95 % width.

    Examples
    --------
    >>> with pm.Model():
    ...     x = pm.Normal("x")
    ...     y = pm.Normal("y", x, 1.0, observed=[1.0])
    ...     idata = laplace(100, random_seed=1)
    >>> float(idata["sample_stats"]["log_marginal_likelihood"][0].round(6))
    -1.515512
    """
    draws = check_integer(draws, "draws")
    rng = np.random.default_rng(check_seed(random_seed, states=True))
    compile_kwargs = check_mapping(compile_kwargs, "compile_kwargs", "a dict for `pytensor.function`")
    model = check_model(model)
    check_continuous(model, "laplace()")
    if start is not None:
        values = initial_values(model, start, "start")
        start = forward_transform(model)(*(values[rv.name].astype(rv.dtype) for rv in model.free_RVs))
    space = Unconstrained(model)
    logp = population_logp(model, model.initial_point(), compile_kwargs)
    logp.compile_gradient()
    found = modes_from(Density(logp, lambda n: prior_points(model, n, rng)), start, draws)
    if not found:
        raise ValueError(
            "the posterior must have a maximum with positive curvature, found none from "
            f"{'the prior' if start is None else '`start`'}. The data may not determine its parameters: see "
            "fisher_information(). Sample with sample()."
        )
    evidences = np.array(
        [value + 0.5 * len(x) * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(h)[1] for x, value, h in found]
    )
    particles, log_density = draw_mixture(found, evidences, draws, rng)
    prior, likelihood = logp(particles)[:2]
    return tree(model, space, particles, found, evidences, prior + likelihood - log_density)


def modes_from(density: Density, start, effort) -> list:
    """Modes (x, value, curvature), the highest first, that climbs lead to, from `start` (d,) or the prior."""
    if start is None:
        reference = find_reference(density, effort)
        ends, scale = ([], 1.0) if reference is None else (reference.peaks, reference.scale)
    else:
        ends, _ = climb(density.gradients, start[None], lambda x: np.zeros(len(x), dtype=bool))
        scale = np.ones(len(start))
    return distinct([mode for x in ends if (mode := gaussian_at(density.gradients, x, scale)) is not None])


def draw_mixture(modes, evidences, n, rng):
    """Draws (n, d) from Gaussians at the modes, stratified, and their log-density (n,)."""
    log_weights = evidences - np.logaddexp.reduce(evidences)
    weights = np.exp(log_weights)
    which = np.searchsorted(np.cumsum(weights), (np.arange(n) + rng.random()) / n).clip(max=len(modes) - 1)
    z = rng.standard_normal((n, len(modes[0][0])))
    particles = np.empty_like(z)
    for k, (x, _, hessian) in enumerate(modes):
        factor = np.linalg.cholesky(hessian)
        particles[which == k] = x + np.linalg.solve(factor.T, z[which == k].T).T
    parts = []
    for (x, _, hessian), log_weight in zip(modes, log_weights, strict=True):
        away = particles - x
        logdet = np.linalg.slogdet(hessian)[1]
        quadratic = np.einsum("ni,ij,nj->n", away, hessian, away)
        parts.append(log_weight + 0.5 * (logdet - len(x) * np.log(2 * np.pi) - quadratic))
    order = rng.permutation(n)
    return particles[order], np.logaddexp.reduce(parts, axis=0)[order]


def tree(model, space, particles, modes, evidences, log_ratios):
    """The result as a DataTree."""
    import arviz as az  # slow to import

    coords = {name: np.array(values) for name, values in model.coords.items() if values is not None}
    ratios = np.exp(log_ratios - log_ratios.max())
    n = len(ratios)
    efficiency = float(ratios.sum() ** 2 / (ratios**2).sum() / n)
    values = space.variables(particles)
    log_z, error = log_mean(log_ratios)
    worst, largest = largest_error({rv.name: values[rv.name] for rv in model.free_RVs}, ratios)
    if efficiency < LOW_EFFICIENCY or largest > LARGE_ERROR:
        warnings.warn(
            f"Laplace's approximation is poor here: its draws are worth {100 * efficiency:.2g} % of as many "
            f"from the posterior, and a quantile of {worst} is off by {100 * largest:.0f} % of the 5-95 % "
            "width. Sample with sample().",
            LaplaceWarning,
            stacklevel=3,
        )
    stats = {
        "log_marginal_likelihood": [np.logaddexp.reduce(evidences)],
        "log_marginal_likelihood_is": [log_z],
        "log_marginal_likelihood_is_se": [error],
        "efficiency": [efficiency],
        "largest_error": [largest],
    }
    result = az.from_dict(
        {"posterior": {k: v[None] for k, v in values.items()}}, coords=coords, dims=model.named_vars_to_dims
    )
    result["sample_stats"] = xr.DataTree(
        xr.Dataset(
            {k: ("chain", np.array(v)) for k, v in stats.items()},
            attrs={"worst_parameter": worst, "likelihoods": likelihood_kinds(model)},
        )
    )
    summary = {
        "log_density": [m[1] for m in modes],
        "log_marginal_likelihood": evidences,
        "weight": np.exp(evidences - np.logaddexp.reduce(evidences)),
    }
    result["modes"] = xr.DataTree(space.modes(model, [m[0] for m in modes], **summary))
    return result


def largest_error(values, ratios):
    """Parameter whose quantiles change the most when its draws (n, ...) are weighed, and by how much.

    In units of the weighted 5-95 % width.
    """
    worst, largest = "", 0.0
    weights = ratios / ratios.sum()
    for name, draws in values.items():
        columns = draws.reshape(len(draws), -1).T
        for entry, column in zip(entry_names(name, draws.shape[1:]), columns, strict=True):
            exact = np.quantile(column, QUANTILES, weights=weights, method="inverted_cdf")
            own = np.quantile(column, QUANTILES, method="inverted_cdf")
            width = exact[-1] - exact[0]
            error = np.abs(own - exact).max() / width if width > 0 else np.inf
            if error > largest:
                worst, largest = entry, float(error)
    return worst, largest
