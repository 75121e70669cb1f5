"""`serve`: the densities and responses of a PyMC model for samplers in other languages."""

import json

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
from pymc.pytensorf import join_nonshared_inputs
from pytensor.gradient import NullTypeGradError
from pytensor.tensor.variable import TensorVariable

from pymc_features._checks import check_integer, check_model, message, shown
from pymc_features.exceptions import NotDifferentiableError
from pymc_features.inference import compiled_logp
from pymc_features.inference.compiled import LOWEST
from pymc_features.umbridge.extra import umbridge


def serve(
    model: pm.Model | None = None,
    *,
    response: TensorVariable | None = None,
    port: int = 4242,
    compile_kwargs: dict | None = None,
) -> None:
    """Serve a PyMC model over UM-Bridge, until it is stopped: to samplers in R, Julia, MATLAB or C++.

    The server has the model `posterior`: of the input theta, the point on PyMC's unconstrained scale that
    `compiled_logp(model)` takes, the output is the log-density of prior and likelihood, with its gradient.
    Where it is -inf the output is -1e300, for JSON has no infinity; a response that is not finite is answered
    by the protocol's error InvalidOutput. With `response` there is another model,
    `response`, of theta to all entries of this response, with its gradient.

    Parameters
    ----------
    model : pymc.Model, optional
        With continuous free parameters. The model of the context by default.
    response : TensorVariable, optional
        A variable of the model, such as what `pmf.response` returned.
    port : int
        Where to listen.
    compile_kwargs : dict, optional
        For `pytensor.function`.

    Raises
    ------
    ImportError
        If the extra `umbridge` is not installed.
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Anyone who reaches the port can evaluate the model. `compiled_logp(model)` has the names of the entries of
    theta, and their values on the scale of the parameters.
    """
    port = check_integer(port, "port", least=1)
    umbridge().serve_models(models_of(model, response, compile_kwargs), port)


def models_of(model, response, compile_kwargs) -> list:
    """The models that are served."""
    library, model = umbridge(), check_model(model)
    density = compiled_logp(model, compile_kwargs=compile_kwargs)

    class Served(library.Model):
        """One function of theta, and its gradient."""

        def __init__(self, name, size, value, slope):
            super().__init__(name)
            self.size, self.value, self.slope = size, value, slope

        def get_input_sizes(self, config=None):
            return [density.n_dim]

        def get_output_sizes(self, config=None):
            return [self.size]

        def supports_evaluate(self):
            return True

        def supports_gradient(self):
            return self.slope is not None

        def __call__(self, parameters, config=None):
            return [for_json(self.value(np.array(parameters[0], dtype=np.float64)))]

        def gradient(self, out_wrt, in_wrt, parameters, sens, config=None):
            point = np.array(parameters[0], dtype=np.float64)
            return for_json(self.slope(point, np.array(sens, dtype=np.float64)))

    def log_posterior(theta):
        return np.maximum(np.atleast_1d(density.log_posterior(theta)), LOWEST)

    def slope_of_posterior(theta, weight):
        return weight[0] * density(theta, gradient=True).gradient

    try:
        density(np.zeros(density.n_dim), gradient=True)
    except NotDifferentiableError:
        slope_of_posterior = None
    served = [Served("posterior", 1, log_posterior, slope_of_posterior)]
    if response is not None:
        served.append(Served("response", *functions_of(model, response, compile_kwargs)))
    return served


def for_json(numbers) -> list:
    """A list of numbers; the protocol's error, an answer of its own, where JSON has none for them."""
    if np.isfinite(numbers).all():
        return numbers.tolist()
    from aiohttp import web  # which umbridge serves with

    error = {"type": "InvalidOutput", "message": "The output is not finite: theta describes no structure."}
    raise web.HTTPInternalServerError(text=json.dumps({"error": error}), content_type="application/json")


def functions_of(model, response, compile_kwargs):
    """Size of a response, and functions of theta to its entries and to their gradient with weights."""
    if not isinstance(response, TensorVariable):
        raise TypeError(message("response", "a variable of the model", shown(response)))
    point = model.initial_point()
    [graph] = model.replace_rvs_by_values([response])
    [joined_response], theta = join_nonshared_inputs(point, [graph.ravel()], model.value_vars)
    weights = pt.vector("weights")
    settings = {"on_unused_input": "ignore", **(compile_kwargs or {})}
    value = pytensor.function([theta], joined_response, **settings)
    try:
        slope = pt.grad(pt.sum(weights * joined_response), theta, disconnected_inputs="ignore")
        gradient = pytensor.function([theta, weights], slope, **settings)
    except (NotDifferentiableError, NotImplementedError, NullTypeGradError):
        gradient = None
    start = np.concatenate([np.ravel(point[v.name]) for v in model.value_vars])
    return value(start).size, value, gradient
