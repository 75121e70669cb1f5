"""`ExternalSimulator`: a model that runs outside PyTensor, inside PyMC models."""

from collections.abc import Callable
from typing import Self, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pytensor.graph.basic import Variable
from pytensor.tensor.variable import TensorVariable

from pymc_features._checks import (
    LARGEST_COUNT,
    as_array,
    as_numbers,
    check_choice,
    check_keywords,
    is_number,
    message,
    shown,
)
from pymc_features.exceptions import UnknownIdentityError
from pymc_features.external.evaluator import EvaluationOptions, Evaluator, Failure, Task, check_seconds
from pymc_features.external.program import FlatGradient
from pymc_features.fingerprint import fingerprint
from pymc_features.ops import ExternalResponse, as_tensor


class ExternalSimulator:
    """A simulator that runs in processes of its own, as a part of PyMC models.

    Called with random variables it gives what `response` gives, for feature likelihoods, `pm.Normal` and
    `DiscrepancySimulator`. Population kernels evaluate many parameters at once: here on several processes,
    or machines.

    Parameters
    ----------
    function : callable
        Parameters, numbers or arrays, to an array; for example a `ProgramSimulator`. It is sent to the
        processes that run it, so that whatever it needs must be found there.
    shape : tuple of two int
        Of the data: sensors and times.
    returns : {"response", "mean_square"}
        What the function returns: histories (sensor, time), or e_j of Eq. (3), (sensor,), from data of its
        own.
    gradient : callable, optional
        `gradient(*parameters, cotangent)`: for each parameter the derivative of sum(cotangent * result).
    version : str, optional
        Stands for the function of this name in the cache. By default that is its code, that of the functions
        and classes it names, and what they hold; not what installed packages, modules that it calls by name
        (`solver.run()`) or programs do, so give a version where these change.
    dt : float, optional
        Time step of the data [s], for the time axis.
    **kwargs
        `executor`, `timeout`, `retries`, `scratch`, `cache` and `progress` of `Evaluator`: how simulations
        are run and kept. By default only a function that says that it needs one has a scratch folder, as
        `ProgramSimulator` does.

    Raises
    ------
    ValueError, TypeError
        If a setting cannot be used.

    Notes
    -----
    Results do not depend on the executor. A failure gives -inf, is counted (`sample_stats["failed"]`) and
    never stops sampling. `sample_smc` runs chains one after the other: their simulations are parallel.

    Examples
    --------
    >>> def beam(stiffness):
    ...     return np.outer([1.0, 2.0], np.arange(3)) / stiffness
    >>> with ExternalSimulator(beam, shape=(2, 3), executor=1) as simulator:
    ...     simulator.responses(np.array([1.0, 2.0]))[:, 1, 2]
    array([4., 2.])
    """

    def __init__(
        self,
        function: Callable[..., ArrayLike],
        shape: tuple[int, int],
        *,
        returns: str = "response",
        gradient: Callable | None = None,
        version: str | None = None,
        dt: float | None = None,
        **kwargs: Unpack[EvaluationOptions],
    ):
        check_keywords(kwargs, EvaluationOptions.__annotations__, "ExternalSimulator")
        for name, value in (("function", function), ("gradient", gradient)):
            if not callable(value) and not (name == "gradient" and value is None):
                raise TypeError(f"`{name}` must be callable, got {type(value).__name__}.")
        sizes = as_array(shape).tolist() if as_array(shape).ndim == 1 else []
        if len(sizes) != 2 or not all(is_number(n) and n % 1 == 0 and 1 <= n <= LARGEST_COUNT for n in sizes):
            what = "(sensors, times) of the data"
            raise ValueError(message("shape", what, shown(shape), "Pass data.shape."))
        check_choice(returns, "returns", ("response", "mean_square"))
        check_seconds("dt", dt)
        if not (version is None or isinstance(version, str)):
            raise TypeError(f"`version` must be a text, got {shown(version)}.")
        self.function, self.shape, self.returns = function, tuple(int(n) for n in shape), returns
        self.gradient, self.version, self.dt = gradient, version, dt
        self.evaluator = Evaluator(**{"scratch": getattr(function, "needs_scratch", False)} | kwargs)
        self.identity = self._identity(function)
        if gradient is not None:
            self._flat_gradient, self._gradient_identity = FlatGradient(gradient), self._identity(gradient)

    def _identity(self, function) -> str:
        if self.version is not None:
            name = getattr(function, "__qualname__", type(function).__qualname__)
            return fingerprint(name, self.version)
        try:
            return fingerprint(function)
        except UnknownIdentityError as error:
            if self.evaluator.cache is None:
                return ""
            raise ValueError(
                f"`version` must be given with `cache` for this function: {error}. Choose a text, and "
                "another one whenever results change."
            ) from None

    def __call__(self, *parameters: ArrayLike | Variable) -> TensorVariable:
        """The response (sensor, time) inside a model, at tensors or numbers."""
        if not parameters:
            raise ValueError("the simulator must be called with parameters, got none. Pass random variables.")
        tensors = [as_tensor(p, "parameters", "Pass random variables or numbers.") for p in parameters]
        return ExternalResponse(self, tuple(t.ndim for t in tensors))(*tensors)

    @property
    def counts(self) -> dict[str, int]:
        """How many simulations were "ok", "error", "timeout", "died", "invalid" or found in the cache."""
        return dict(self.evaluator.counts)

    @property
    def failures(self) -> list[Failure]:
        """The last thousand failures in this process, with their parameters.

        All of them, also those of chains in other processes: `external.EvaluationCache(path).failures()`.
        """
        return list(self.evaluator.failures)

    def responses(self, *parameters: ArrayLike) -> np.ndarray:
        """Responses (particle, sensor, time) at parameters (particle, ...) each; NaN where they fail."""
        if self.returns == "mean_square":
            raise ValueError(
                "the simulator must return responses for this, got one that returns mean squares. Histories "
                'and predictions need `returns="response"`.'
            )
        task = Task(self.function, self.shape, None, self.identity)
        return self.evaluator.run(task, spread(parameters))

    def discrepancies(self, *parameters: ArrayLike, observed: ArrayLike | None) -> np.ndarray:
        """e_j (particle, sensor) of Eq. (3) at parameters (particle, ...) each; NaN where they fail."""
        if self.returns == "mean_square":
            task = Task(self.function, self.shape[:1], None, self.identity)
        else:
            observed = as_numbers(observed, "observed", "Pass the data.")
            if observed.shape != self.shape:
                raise ValueError(
                    f"`observed` must have shape (sensor, time) = {self.shape}, got {observed.shape}. Give "
                    "one row for each sensor and one column for each output step."
                )
            task = Task(self.function, self.shape, observed, self.identity)
        return self.evaluator.run(task, spread(parameters))

    def gradients(self, *parameters: ArrayLike, cotangent: ArrayLike) -> list[np.ndarray]:
        """Gradients of sum(cotangent * result), each with a row for every row of the parameters."""
        rows = spread(parameters)
        cotangent = as_numbers(cotangent, "cotangent", "Pass an array of the shape of the result.")
        more = np.broadcast_to(cotangent, (len(rows[0]), *np.shape(cotangent)))
        size = sum(r[0].size for r in rows)
        task = Task(self._flat_gradient, (size,), None, self._gradient_identity)
        return unflat(self.evaluator.run(task, [*rows, more]), rows)

    def close(self) -> None:
        """End the processes that were started; they start again when needed."""
        self.evaluator.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error):
        self.close()

    def __deepcopy__(self, memo):
        return self  # copies of a model run on the same processes

    def __repr__(self):
        name = getattr(self.function, "__qualname__", type(self.function).__qualname__)
        return f"ExternalSimulator({name}, shape={self.shape})"


def spread(parameters) -> list[np.ndarray]:
    """Parameters (particle, ...) with equally many rows, from some that have one for all."""
    rows = [as_numbers(p, "parameters", "Pass a row for each particle.") for p in parameters]
    if not rows or min(r.ndim for r in rows) == 0:
        raise ValueError("`parameters` must have a row for each particle, got a number. Pass arrays.")
    n = max(len(r) for r in rows)
    if any(len(r) not in (1, n) for r in rows):
        got = ", ".join(str(len(r)) for r in rows)
        raise ValueError(message("parameters", "arrays with one row or as many as the others", f"{got} rows"))
    return [np.broadcast_to(r, (n, *r.shape[1:])) for r in rows]


def unflat(gradient, parameters) -> list[np.ndarray]:
    """Gradients (n, d) as one array for each parameter (particle, ...)."""
    sizes = [np.prod(np.shape(p)[1:], dtype=int) for p in parameters]
    parts = np.split(gradient, np.cumsum(sizes)[:-1], axis=1)
    return [part.reshape(-1, *np.shape(p)[1:]) for part, p in zip(parts, parameters, strict=True)]
