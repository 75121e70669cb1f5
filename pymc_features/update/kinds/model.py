"""The PyMC model of a problem under one likelihood, and structures at draws of it."""

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features.exceptions import ConfigError
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.update.config.entries import priors_in
from pymc_features.update.config.messages import named_key
from pymc_features.update.kinds.structure import modes_of

MODAL_DRAWS = 500


def names_for(problem, likelihood: str) -> list[str]:
    """Names of the priors in the model of one likelihood, in the order of the file."""
    used = set(problem.structure.names)
    for data in problem.data:
        used |= {item.prior for value in data.parameters(likelihood) for item in priors_in(value)}
    return [name for name in problem.priors if name in used]


def declare(problem, likelihood: str, tolerance: float | None = None) -> pm.Model:
    """Return the model of a problem under one likelihood.

    Parameters
    ----------
    problem : Problem
    likelihood : str
        Of those of the first kind of data.
    tolerance : float, optional
        delta of ABC [m^2/s^4].

    Returns
    -------
    pymc.Model
        With the priors of the structure and of the errors, and all data: responses are `y` (sensor, time),
        identified modes `modal`.
    """
    with pm.Model() as model:
        values = {name: problem.priors[name].declare(name) for name in names_for(problem, likelihood)}
        with named_key("structure"):
            structure = problem.structure(**{name: values[name] for name in problem.structure.names})
        for data in problem.data:
            data.declare(problem, likelihood, structure, values, tolerance)
    return model


def declares_as_prior(likelihood: str) -> bool:
    """Whether residuals of responses decide the width: all else is then known beforehand."""
    return likelihood in LIKELIHOODS and bool(LIKELIHOODS[likelihood].calibrates)


def thinned(posterior: xr.Dataset, draws: int) -> xr.Dataset:
    """At most `draws` draws, evenly spaced along each chain."""
    n = posterior.sizes["draw"]
    wanted = min(n, max(1, draws // posterior.sizes["chain"]))
    return posterior.isel(draw=(np.arange(wanted) * n / wanted).astype(int))


def each_draw(problem, posterior: xr.Dataset, draws: int, of_structure):
    """Place (chain, draw) and `of_structure(structure)` of some draws, those without a structure left out.

    Raises
    ------
    ConfigError
        If none has one.
    """
    few = thinned(posterior[problem.structure.names], draws)
    columns = {name: few[name].transpose("chain", "draw").values for name in problem.structure.names}
    is_any = False
    for place in np.ndindex(few.sizes["chain"], few.sizes["draw"]):
        try:
            found = of_structure(problem.structure(**{name: float(c[place]) for name, c in columns.items()}))
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
        for place, found in each_draw(
            problem, posterior, MODAL_DRAWS, lambda s: modes_of(s, problem.structure.n_modes)
        )
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
