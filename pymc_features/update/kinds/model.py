"""The PyMC model of a problem under one likelihood, and what structures are at draws of it."""

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features.exceptions import ConfigError
from pymc_features.update.config.entries import priors_in
from pymc_features.update.config.messages import named_key
from pymc_features.update.config.structures import modes_of

MODAL_DRAWS = 500


def kinds_of(result) -> list[str]:
    """Likelihoods in a result."""
    return [name for name, part in result.children.items() if "posterior" in part.children]


def names_for(problem, likelihood: str) -> list[str]:
    """Names of the priors in the model of one likelihood, in the order of the file."""
    used = set(problem.structure.names)
    for data in problem.data:
        used |= {item.prior for value in data.parameters(likelihood) for item in priors_in(value)}
    return [name for name in problem.priors if name in used]


def declare(problem, likelihood: str, tolerance: float | None = None) -> pm.Model:
    """The model of a problem under one likelihood of its first kind of data; `tolerance` is delta of ABC.

    It has the priors of the structure and of the errors, and all data: responses are `y` (sensor, time),
    identified modes `modal`.
    """
    with pm.Model() as model:
        values = {name: problem.priors[name].declare(name) for name in names_for(problem, likelihood)}
        with named_key("structure"):
            structure = problem.structure(**{name: values[name] for name in problem.structure.names})
        for data in problem.data:
            data.declare(problem, likelihood, structure, values, tolerance)
    return model


def draws_of_priors(problem, names, n: int) -> xr.Dataset:
    """Draws (chain, draw) of some priors."""
    columns = {
        name: (("chain", "draw"), problem.priors[name].draw(n, k)[None]) for k, name in enumerate(names)
    }
    return xr.Dataset(columns, coords={"chain": [0], "draw": np.arange(n)})


def thinned(posterior: xr.Dataset, draws: int) -> xr.Dataset:
    """At most `draws` draws, evenly spaced along each chain."""
    n = posterior.sizes["draw"]
    wanted = min(n, max(1, draws // posterior.sizes["chain"]))
    return posterior.isel(draw=(np.arange(wanted) * n / wanted).astype(int))


def modes_of_draws(problem, draws: xr.Dataset, n_modes: int | None):
    """Place (chain, draw) and modes of each draw, those without a structure left out."""
    columns = {name: draws[name].transpose("chain", "draw").values for name in problem.structure.names}
    is_any = False
    for place in np.ndindex(draws.sizes["chain"], draws.sizes["draw"]):
        try:
            structure = problem.structure(**{name: float(c[place]) for name, c in columns.items()})
            found = modes_of(structure, n_modes)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):
            continue
        is_any = True
        yield place, found
    if not is_any:
        raise ConfigError("`structure` must have natural modes, got none at any draw of the posterior.")


def frequencies(problem, posterior: xr.Dataset) -> xr.Dataset:
    """Natural frequencies [Hz] and damping ratios [-] of draws (chain, draw, mode); NaN if impossible."""
    few = thinned(posterior[problem.structure.names], MODAL_DRAWS)
    modes = {
        place: (found.natural_frequencies, found.damping_ratios)
        for place, found in modes_of_draws(problem, few, problem.structure.n_modes)
    }
    n_modes = next(iter(modes.values()))[0].size
    found = np.full((2, few.sizes["chain"], few.sizes["draw"], n_modes), np.nan)
    for place, values in modes.items():
        found[(slice(None), *place)] = values
    dims = ("chain", "draw", "mode")
    parts = {
        "natural_frequency": (dims, found[0], {"units": "Hz"}),
        "damping_ratio": (dims, found[1], {"units": "1"}),
    }
    return xr.Dataset(parts, {"chain": few["chain"], "draw": few["draw"], "mode": 1 + np.arange(n_modes)})
