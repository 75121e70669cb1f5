"""The PyMC model of a problem under one likelihood."""

import pymc as pm
import pytensor.tensor as pt

from pymc_features.ambient import AmbientResponse, spectral_response
from pymc_features.likelihoods import DIMS, Comparison
from pymc_features.modal_features import ModalFeature, modes
from pymc_features.modal_features.feature import checked_parameters
from pymc_features.modal_features.identified import identified
from pymc_features.ops import response
from pymc_features.ops.excitation import request_in_model
from pymc_features.simulators.quantities import checked_request
from pymc_features.update.config.entries import evaluated, priors_in
from pymc_features.update.problem.channels import named_key
from pymc_features.update.problem.kinds import AMBIENT, KINDS, MODAL
from pymc_features.update.problem.read import Problem


def names_for(problem: Problem, kind: str) -> list[str]:
    """Names of the priors in the model of one likelihood, in the order of the file."""
    used = set(problem.structure.names)
    values = []
    if kind == AMBIENT.name:
        values += [value for *_, value in problem.config.ambient.parameters()]
    elif kind != MODAL.name:
        values += [value for _, value in problem.config.likelihood.parameters_of(kind)]
    if problem.config.modal is not None:
        values += [problem.config.modal.sigma_f, problem.config.modal.sigma_phi]
    for value in values:
        used |= {item.prior for item in priors_in(value)}
    return [name for name in problem.priors if name in used]


def declare(problem: Problem, kind: str, tolerance: float | None = None) -> pm.Model:
    """Return the model of a problem under one likelihood.

    Parameters
    ----------
    problem : Problem
    kind : str
        A name of `KINDS`.
    tolerance : float, optional
        delta of ABC [m^2/s^4].

    Returns
    -------
    pymc.Model
        With the priors of the structure and of the errors, and the data: responses `y` (sensor, time)
        [m/s^2], unless kind is MODAL, and identified modes `modal`, if there are any, unless it is AMBIENT.
        Where residuals of the responses decide the width, modes are part of what is known beforehand.
    """
    with pm.Model() as model:
        values = {name: problem.priors[name].declare(name) for name in names_for(problem, kind)}
        with named_key("structure"):
            structure = problem.structure(**{name: values[name] for name in problem.structure.names})
        if kind == AMBIENT.name:
            compare_spectra(problem, structure, values)
            return model
        if kind != MODAL.name:
            compare_responses(problem, kind, structure, values, tolerance)
        if problem.modal is not None:
            compare_modes(problem, structure, values, as_prior=bool(KINDS[kind].calibrates))
    return model


def compare_responses(problem, kind, structure, values, tolerance) -> None:
    """Add the measured responses to the model of the context."""
    measured, asked = problem.measured, problem.config.likelihood
    observed = measured.channels
    pm.modelcontext(None).add_coords({dim: observed[dim].values for dim in DIMS})
    with named_key("structure"):
        mu = response(
            structure,
            measured.record,
            dt=measured.step,
            sensors=problem.dofs,
            quantity=problem.quantity,
            n_modes=problem.structure.n_modes,
        )
    errors = {
        name: pt.as_tensor_variable(evaluated(value, values)) for name, value in asked.parameters_of(kind)
    }
    if problem.config.processing.compare is not None:
        mu = mu[:, measured.compared]
        errors["dt"] = pt.constant(measured.step)  # which likelihoods no longer see
    given = Comparison(mu, observed.values, epsilon=tolerance, density=asked.density, **errors)
    KINDS[kind].declare(given)


def request_of(problem: Problem):
    """The request of the model's response, with the refinement that its priors need, and its outputs."""
    record = problem.measured.record
    with pm.Model():
        values = {name: problem.priors[name].declare(name) for name in problem.structure.names}
        structure = problem.structure(**values)
        asked, outputs = checked_request(
            structure,
            record,
            problem.quantity,
            dt=problem.measured.step,
            sensors=problem.dofs,
            n_modes=problem.structure.n_modes,
        )
        return request_in_model(structure, record, asked), outputs


def compare_spectra(problem, structure, values) -> None:
    """Add the response to forces that nobody measured to the model of the context."""
    ambient, asked = problem.ambient, problem.config.ambient
    pm.modelcontext(None).add_coords({dim: ambient.channels[dim].values for dim in DIMS})
    force, error = (pt.as_tensor_variable(evaluated(v, values)) for v in (asked.force, asked.error))
    with named_key("ambient", excitation="ambient.force", error="ambient.error"):
        found = spectral_response(
            structure, force, forces=asked.forces, sensors=problem.dofs, n_modes=problem.structure.n_modes
        )
        AmbientResponse(
            "y",
            found,
            error=error,
            bands=ambient.bands,
            dt=ambient.step,
            observed=ambient.channels.values,
            dims=DIMS,
        )


def compare_modes(problem, structure, values, *, as_prior=False) -> None:
    """Add the identified modes to the model of the context, `as_prior` as a factor of the prior."""
    modal, asked = problem.modal, problem.config.modal
    with named_key("modal", n_modes="modal.n_modes"):
        found = modes(structure, modal.n_modes, sensors=modal.dofs or None)
        scales = [
            None if value is None else pt.as_tensor_variable(evaluated(value, values))
            for value in (asked.sigma_f, asked.sigma_phi)
        ]
        labels = [str(label) for label in modal.labels]
        if not as_prior:
            ModalFeature(
                "modal",
                found,
                observed=modal.data,
                sigma_f=scales[0],
                sigma_phi=scales[1],
                density=asked.density,
                labels=labels,
            )
            return
        data = identified(modal.data, labels)
        terms = ModalFeature.dist(*checked_parameters(found, data, *scales, asked.density))
        pm.Potential("modal", pm.logp(terms, data.values).sum())
