"""The PyMC model of a problem under one likelihood."""

import pymc as pm
import pytensor.tensor as pt

from pymc_features.likelihoods import DIMS, LIKELIHOODS, Comparison
from pymc_features.ops import response
from pymc_features.update.config.entries import evaluated, priors_in
from pymc_features.update.problem.channels import named_key
from pymc_features.update.problem.read import Problem


def names_for(problem: Problem, kind: str) -> list[str]:
    """Names of the priors in the model of one likelihood, in the order of the file."""
    used = set(problem.structure.names)
    for _, value in problem.config.likelihood.parameters_of(kind):
        used |= {item.prior for item in priors_in(value)}
    return [name for name in problem.priors if name in used]


def declare(problem: Problem, kind: str, tolerance: float | None = None) -> pm.Model:
    """Return the model of a problem under one likelihood.

    Parameters
    ----------
    problem : Problem
    kind : str
        A name of `LIKELIHOODS`.
    tolerance : float, optional
        delta of ABC [m^2/s^4].

    Returns
    -------
    pymc.Model
        With the priors of the structure and of the errors, and the data `y` (sensor, time) [m/s^2].
    """
    measured, asked = problem.measured, problem.config.likelihood
    observed = measured.channels
    coords = {dim: observed[dim].values for dim in DIMS}
    with pm.Model(coords=coords) as model:
        values = {name: problem.priors[name].declare(name) for name in names_for(problem, kind)}
        with named_key("structure"):
            structure = problem.structure(**{name: values[name] for name in problem.structure.names})
            mu = response(
                structure,
                measured.record,
                dt=measured.step,
                sensors=problem.dofs,
                n_modes=problem.structure.n_modes,
            )
        errors = {
            name: pt.as_tensor_variable(evaluated(value, values)) for name, value in asked.parameters_of(kind)
        }
        if problem.config.processing.compare is not None:
            mu = mu[:, measured.compared]
            errors["dt"] = pt.constant(measured.step)  # which likelihoods no longer see
        given = Comparison(mu, observed.values, epsilon=tolerance, density=asked.density, **errors)
        LIKELIHOODS[kind].declare(given)
    return model
