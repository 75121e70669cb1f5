"""The PyMC model of a problem under one likelihood."""

import pymc as pm
import pytensor.tensor as pt

from pymc_features.distributions import ExpFeature, TruncNormalFeature
from pymc_features.likelihood_free import DiscrepancySimulator
from pymc_features.ops import response
from pymc_features.update.channels import Keyed
from pymc_features.update.config.entries import evaluated, priors_in
from pymc_features.update.problem import Problem

DIMS = ("sensor", "time")


def _norm(mu, sigma, observed, density, tolerance):
    pm.Normal("y", mu=mu, sigma=sigma[:, None] if sigma.ndim else sigma, observed=observed, dims=DIMS)


def _tn(mu, sigma, observed, density, tolerance):
    TruncNormalFeature("y", mu=mu, sigma=sigma, density=density, observed=observed, dims=DIMS)


def _exp(mu, sigma, observed, density, tolerance):
    ExpFeature("y", mu=mu, sigma=sigma, density=density, observed=observed, dims=DIMS)


def _abc(mu, sigma, observed, density, tolerance):
    DiscrepancySimulator("y", mu, epsilon=tolerance, observed=observed, dims=DIMS)


# The place of a likelihood is part of its seed: new ones go to the end.
LIKELIHOODS = {"NORM": _norm, "TN": _tn, "EXP": _exp, "ABC": _abc}


def names_for(problem: Problem, kind: str) -> list[str]:
    """Names of the priors in the model of one likelihood, in the order of the file."""
    used = set(problem.structure.names)
    if kind != "ABC":
        used |= {item.prior for item in priors_in(problem.config.likelihood.sigma)}
    return [name for name in problem.priors if name in used]


def declare(problem: Problem, kind: str, tolerance: float | None = None) -> pm.Model:
    """Return the model of a problem under one likelihood.

    Parameters
    ----------
    problem : Problem
    kind : {"NORM", "TN", "EXP", "ABC"}
        Eq. (2), (7), (9) of the source, or the simulator of Eqs. (14)-(15).
    tolerance : float, optional
        delta of ABC [m^2/s^4].

    Returns
    -------
    pymc.Model
        With the priors of the structure and of sigma, and the data `y` (sensor, time) [m/s^2].
    """
    measured, likelihood = problem.measured, problem.config.likelihood
    observed = measured.channels
    coords = {dim: observed[dim].values for dim in DIMS}
    with pm.Model(coords=coords) as model:
        values = {name: problem.priors[name].declare(name) for name in names_for(problem, kind)}
        with Keyed("structure"):
            structure = problem.structure(**{name: values[name] for name in problem.structure.names})
            mu = response(
                structure,
                measured.record,
                dt=measured.step,
                sensors=problem.dofs,
                n_modes=problem.structure.n_modes,
            )
        sigma = None
        if kind != "ABC":
            sigma = evaluated(likelihood.sigma, values)
            sigma = pt.stack(sigma) if isinstance(sigma, list) else pt.as_tensor_variable(sigma)
        LIKELIHOODS[kind](mu, sigma, observed.values, likelihood.density, tolerance)
    return model
