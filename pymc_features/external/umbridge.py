"""Models and samplers in other languages over the protocol UM-Bridge, on both sides.

L. Seelinger et al., UM-Bridge: uncertainty quantification and modeling bridge, J. Open Source Software 8
(2023) 4748.
"""

import functools
import json
from types import ModuleType
from typing import Unpack
from urllib.parse import urlsplit

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
from pymc.pytensorf import join_nonshared_inputs
from pytensor.gradient import NullTypeGradError
from pytensor.tensor.variable import TensorVariable

from pymc_features._checks import check_integer, check_mapping, check_model, check_text, message, shown
from pymc_features.exceptions import NotDifferentiableError
from pymc_features.external.evaluator import EvaluationOptions
from pymc_features.external.simulator import ExternalSimulator
from pymc_features.inference import compiled_logp
from pymc_features.inference.compiled import LOWEST

__all__ = ["RemoteModel", "from_umbridge", "serve"]


def umbridge() -> ModuleType:
    """The library of UM-Bridge, which is an extra."""
    try:
        import umbridge as library
    except ImportError as error:
        raise ImportError(
            "models and samplers over UM-Bridge need its library. Install it: "
            "pip install pymc-features[umbridge]"
        ) from error
    return library


@functools.cache
def connected(url: str, model: str):
    """The client of a model; one for each process."""
    return umbridge().HTTPModel(url, model)


@functools.cache
def sizes_of(url: str, model: str, config: str) -> tuple[list[int], list[int]]:
    """Lengths of inputs and outputs; asked for once in each process."""
    remote, settings = connected(url, model), json.loads(config)
    return remote.get_input_sizes(settings), remote.get_output_sizes(settings)


class RemoteModel:
    """Parameters to the outputs (sensor, time) of a model on a server; what `from_umbridge` runs."""

    def __init__(self, url: str, model: str, shape: tuple[int, int], config: dict):
        self.url, self.model, self.shape, self.config = url, model, shape, config

    def __call__(self, *parameters):
        outputs = connected(self.url, self.model)(self.inputs(parameters), self.config)
        return np.concatenate([np.ravel(output) for output in outputs]).reshape(self.shape)

    def gradient(self, *parameters_and_cotangent) -> list[np.ndarray]:
        """Return the gradient of sum(cotangent * result), for each parameter."""
        *parameters, cotangent = parameters_and_cotangent
        remote, inputs = connected(self.url, self.model), self.inputs(parameters)
        _, sizes = sizes_of(self.url, self.model, json.dumps(self.config))
        parts = np.split(np.ravel(cotangent), np.cumsum(sizes)[:-1])
        slopes = [
            sum(
                np.asarray(remote.gradient(number, at, inputs, part.tolist(), self.config), dtype=np.float64)
                for number, part in enumerate(parts)
            )
            for at in range(len(inputs))
        ]
        flat = np.split(np.concatenate(slopes), np.cumsum([np.size(p) for p in parameters])[:-1])
        return [slope.reshape(np.shape(p)) for slope, p in zip(flat, parameters, strict=True)]

    def inputs(self, parameters) -> list[list[float]]:
        """Input vectors of the model: one for each parameter, or all entries in their order."""
        sizes, _ = sizes_of(self.url, self.model, json.dumps(self.config))
        flat = np.concatenate([np.ravel(p).astype(np.float64) for p in parameters])
        if flat.size != sum(sizes):
            what = f"the {sum(sizes)} entries of the inputs of {self.model}"
            raise ValueError(f"`parameters` must have {what}, got {flat.size}.")
        return [part.tolist() for part in np.split(flat, np.cumsum(sizes)[:-1])]


def from_umbridge(
    url: str,
    model: str,
    *,
    shape: tuple[int, int] | None = None,
    config: dict | None = None,
    **kwargs: Unpack[EvaluationOptions],
) -> ExternalSimulator:
    """A model that someone else serves over UM-Bridge, as a simulator inside PyMC models.

    Parameters
    ----------
    url, model : str
        Address of the server, as "http://localhost:4242", and the model's name there.
    shape : tuple of two int, optional
        Sensors and times: what all outputs, one behind the other, are brought to. By default each output is
        a sensor, if they are equally long.
    config : dict, optional
        Settings of the model, as its server documents them.
    **kwargs
        `executor`, `timeout`, `retries`, `cache` and `progress` of `ExternalSimulator`. As many requests are
        under way at once as `executor` has processes: a server should be able to answer them.

    Returns
    -------
    ExternalSimulator
        Called with random variables, one for each input of the model, or any with as many entries. With the
        gradient if the server offers one.

    Raises
    ------
    ImportError, ConnectionError
        If the extra `umbridge` is not installed; if nothing answers there.
    ValueError, TypeError
        If the server has no such model, or an argument is out of range.
    """
    check_text(url, "url")
    check_text(model, "model")
    config = check_mapping(config, "config", "a dict of settings of the model")
    if urlsplit(url).scheme not in ("http", "https"):
        raise ValueError(message("url", "an address as http://localhost:4242", repr(url)))
    library = umbridge()
    try:
        known = library.supported_models(url)
    except (OSError, KeyError) as error:
        raise ConnectionError(
            f"`url` must be that of a running UM-Bridge server, {url} does not answer as one. Start it first."
        ) from error
    if model not in known:
        raise ValueError(message("model", f"one of {', '.join(known)}", repr(model)))
    remote = connected(url, model)
    if not remote.supports_evaluate():
        raise ValueError(
            f"`model` must be one that can be evaluated, the server only has {model} for other uses."
        )
    _, sizes = sizes_of(url, model, json.dumps(config))
    function = RemoteModel(url, model, checked_shape(shape, sizes), config)
    gradient = function.gradient if remote.supports_gradient() else None
    return ExternalSimulator(function, function.shape, gradient=gradient, **kwargs)


def checked_shape(shape, sizes: list[int]) -> tuple[int, int]:
    """Sensors and times with as many entries as all outputs."""
    product = f"two numbers with the product {sum(sizes)}"
    if shape is None:
        if len(set(sizes)) != 1:
            raise ValueError(message("shape", product, "none", "Say how many sensors and times that is."))
        return len(sizes), sizes[0]
    if not isinstance(shape, tuple | list) or len(shape) != 2:
        raise TypeError(message("shape", "two whole numbers, sensors and times", repr(shape)))
    checked = tuple(check_integer(n, "shape") for n in shape)
    if checked[0] * checked[1] != sum(sizes):
        raise ValueError(message("shape", product, checked))
    return checked


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
        Where to listen. Anyone who reaches it can evaluate the model.
    compile_kwargs : dict, optional
        For `pytensor.function`.

    Raises
    ------
    ImportError, ValueError, TypeError
        If the extra `umbridge` is not installed; if an argument is out of range.

    Notes
    -----
    `compiled_logp(model)` has the names of the entries of theta, and their values on the scale of the
    parameters.
    """
    port = check_integer(port, "port")
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
    point, weights = model.initial_point(), pt.vector("weights")
    [graph] = model.replace_rvs_by_values([response])
    [joined], theta = join_nonshared_inputs(point, [graph.ravel()], model.value_vars)
    settings = {"on_unused_input": "ignore", **(compile_kwargs or {})}
    value = pytensor.function([theta], joined, **settings)
    try:
        slope = pt.grad(pt.sum(weights * joined), theta, disconnected_inputs="ignore")
        gradient = pytensor.function([theta, weights], slope, **settings)
    except (NotDifferentiableError, NotImplementedError, NullTypeGradError):
        gradient = None
    start = np.concatenate([np.ravel(point[v.name]) for v in model.value_vars])
    return value(start).size, value, gradient
