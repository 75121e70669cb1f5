"""`from_umbridge`: a model that someone else serves, as a simulator inside PyMC models."""

import functools
import json
from typing import Unpack
from urllib.parse import urlsplit

import numpy as np

from pymc_features._checks import check_integer, check_mapping, check_text, message
from pymc_features.external import ExternalSimulator
from pymc_features.external.evaluator import EvaluationOptions
from pymc_features.umbridge.extra import umbridge


class RemoteModel:
    """Parameters to the outputs of a model that a server evaluates; what `from_umbridge` runs.

    Parameters
    ----------
    url : str
        Of the server.
    model : str
        Its name there.
    shape : tuple of two int
        Of the result: sensors and times.
    config : dict
        Settings of the model, as its server documents them.
    """

    def __init__(self, url: str, model: str, shape: tuple[int, int], config: dict):
        self.url, self.model, self.shape, self.config = url, model, shape, config

    def __call__(self, *parameters):
        remote, inputs = self._asked(parameters)
        outputs = remote(inputs, self.config)
        return np.concatenate([np.ravel(output) for output in outputs]).reshape(self.shape)

    def gradient(self, *parameters_and_cotangent) -> list[np.ndarray]:
        """Return the gradient of sum(cotangent * result), for each parameter."""
        *parameters, cotangent = parameters_and_cotangent
        remote, inputs = self._asked(parameters)
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

    def _asked(self, parameters):
        """The model, and its input vectors: one for each parameter, or all entries in their order."""
        remote = connected(self.url, self.model)
        sizes, _ = sizes_of(self.url, self.model, json.dumps(self.config))
        flat = np.concatenate([np.ravel(p).astype(np.float64) for p in parameters])
        if flat.size != sum(sizes):
            raise ValueError(
                f"`parameters` must have the {sum(sizes)} entries of the inputs of {self.model}, got "
                f"{flat.size}."
            )
        return remote, [part.tolist() for part in np.split(flat, np.cumsum(sizes)[:-1])]


@functools.cache
def connected(url: str, model: str):
    """The client of a model; one for each process."""
    return umbridge().HTTPModel(url, model)


@functools.cache
def sizes_of(url: str, model: str, config: str) -> tuple[list[int], list[int]]:
    """Lengths of inputs and outputs; asked for once in each process."""
    remote, settings = connected(url, model), json.loads(config)
    return remote.get_input_sizes(settings), remote.get_output_sizes(settings)


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
    url : str
        Of the server, as "http://localhost:4242".
    model : str
        Its name there.
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
    ImportError
        If the extra `umbridge` is not installed.
    ConnectionError
        If nothing answers there.
    ValueError, TypeError
        If the server has no such model, or an argument is out of range.

    References
    ----------
    L. Seelinger et al., UM-Bridge: uncertainty quantification and modeling bridge, J. Open Source Software 8
    (2023) 4748.
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
    total = sum(sizes)
    if shape is None:
        if len(set(sizes)) != 1:
            advice = "Say how many sensors and times that is."
            raise ValueError(message("shape", f"two numbers with the product {total}", "none", advice))
        return len(sizes), sizes[0]
    if not isinstance(shape, tuple | list) or len(shape) != 2:
        raise TypeError(message("shape", "two whole numbers, sensors and times", repr(shape)))
    checked = tuple(check_integer(n, "shape", least=1) for n in shape)
    if checked[0] * checked[1] != total:
        raise ValueError(message("shape", f"two numbers with the product {total}", checked))
    return checked
