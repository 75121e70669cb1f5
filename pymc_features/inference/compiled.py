"""`compiled_logp`: the densities of a model as plain functions of arrays, for samplers outside PyMC."""

from typing import NamedTuple

import cloudpickle
import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.logprob.utils import local_remove_check_parameter
from pytensor.graph.basic import Variable
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.replace import graph_replace
from pytensor.graph.rewriting.basic import dfs_rewriter

from pymc_features._checks import as_numbers, check_flag, check_mapping, check_model, message
from pymc_features.inference.parameters import Unconstrained, check_continuous, coordinate_names
from pymc_features.smc import Outputs, RowFunction, batched_graph, population_logp


def unit_cube(model: pm.Model, space: Unconstrained, compile_kwargs: dict) -> tuple[RowFunction, RowFunction]:
    """Rosenblatt's transform of the prior: each parameter by its distribution given those it depends on.

    Compiled functions of rows (n, d), from the unit cube to the unconstrained scale, and back.

    Raises
    ------
    ValueError
        If PyMC cannot invert the distribution function of a prior, or entries of a prior are dependent.
    """
    refused = [rv for rv in model.free_RVs if not has_inverse(rv, model.rvs_to_transforms[rv])]
    if refused:
        got = ", ".join(f"{rv.name} ({rv.owner.op.name})" for rv in refused)
        advice = "Write the prior in parameters with independent priors, for example standard normal ones."
        expected = "one whose priors have inverse distribution functions, for the unit cube"
        raise ValueError(message("model", expected, got, advice))
    graphs = graph_to_theta(model, space), graph_from_theta(model, space)
    return tuple(compiled(*graph, compile_kwargs) for graph in graphs)


def has_inverse(rv, transform) -> bool:
    """Whether PyMC knows the distribution function of each entry of a random variable, and its inverse."""
    if getattr(rv.owner.op, "ndim_supp", 0) or getattr(transform, "ndim_supp", 0):
        return False
    try:
        pm.icdf(rv, rv), pm.logcdf(rv, rv)
    except (NotImplementedError, ValueError):
        return False
    return True


def graph_to_theta(model, space) -> tuple[Variable, Variable]:
    """A vector u (d,) and theta (d,)."""
    u = pt.vector("u")
    parts, own, theta = space.split(u), {}, []
    for rv in model.free_RVs:  # parents come before those that depend on them
        x = pm.icdf(rv, parts[model.rvs_to_values[rv].name])
        transform = model.rvs_to_transforms[rv]
        moved = x if transform is None else transform.forward(x, *rv.owner.inputs)
        own[rv], moved = graph_replace([x, moved], own, strict=False) if own else (x, moved)
        theta.append(moved.ravel())
    return u, pt.concatenate(theta)


def graph_from_theta(model, space) -> tuple[Variable, Variable]:
    """A vector theta (d,) and u (d,)."""
    theta = pt.vector("theta")
    parts = space.split(theta)
    below = model.replace_rvs_by_values([pt.exp(pm.logcdf(rv, rv)).ravel() for rv in model.free_RVs])
    values = {model.rvs_to_values[rv]: parts[model.rvs_to_values[rv].name] for rv in model.free_RVs}
    return theta, pt.concatenate(graph_replace(below, values, strict=False))


def compiled(vector: Variable, result: Variable, compile_kwargs: dict) -> RowFunction:
    """The function of rows; a row with invalid parameters does not raise."""
    graph = FunctionGraph([vector], [result], clone=True, copy_inputs=False)
    dfs_rewriter(local_remove_check_parameter).rewrite(graph)
    [vector], outputs = graph.inputs, list(graph.outputs)
    return RowFunction(batched_graph(Outputs(vector, outputs)), compile_kwargs)


LOWEST = -1e300  # stands for -inf, which nested samplers refuse
SMALLEST = 2.0**-53  # the ends of the cube lie at infinity


class LogDensity(NamedTuple):
    """Log-densities of n points.

    Attributes
    ----------
    prior, likelihood : array (n,)
        -inf where they are not finite. The prior's is that on the unconstrained scale, Jacobian included.
    gradient : array (n, d) or None
        Of their sum, if it was asked for; zero where the sum is not finite.
    """

    prior: np.ndarray
    likelihood: np.ndarray
    gradient: np.ndarray | None = None


class CompiledLogp:
    """Log prior, log-likelihood and gradient of points theta (n, d) on PyMC's unconstrained scale.

    `compiled_logp` makes it. All points of a call are evaluated at once. Every method takes one point (d,) as
    well, and then returns one result without the axis of the points. It can be pickled.

    Attributes
    ----------
    names : list of str
        Of the coordinates: k, or k[0], k[1].
    n_dim : int
        Their number d.
    """

    def __init__(self, model: pm.Model, compile_kwargs: dict):
        self._space = Unconstrained(model)
        self._logp = population_logp(model, self._space.point, compile_kwargs)
        self.names = coordinate_names(model, self._space)
        self.n_dim = len(self.names)
        self._free = [rv.name for rv in model.free_RVs]
        self._cube: tuple[RowFunction, RowFunction] | str
        try:
            self._cube = unit_cube(model, self._space, compile_kwargs)
        except ValueError as error:
            self._cube = str(error)  # for those who ask for it

    def __call__(self, theta: ArrayLike, gradient: bool = False) -> LogDensity:
        """Log prior and log-likelihood, and with `gradient=True` the gradient of their sum.

        Raises
        ------
        ValueError, TypeError
            If `theta` is not (d,) or (n, d) numbers.
        NotDifferentiableError
            If the model has no gradient, and it is asked for.
        """
        points, alone = self._rows(theta, "theta")
        if check_flag(gradient, "gradient"):
            prior, likelihood, _, *slopes = self._logp.gradient(points)
            results = prior, likelihood, np.add(*slopes)
        else:
            results = self._logp(points)[:2]
        return LogDensity(*(x[0] for x in results) if alone else results)

    def log_posterior(self, theta: ArrayLike) -> np.ndarray:
        """Log prior plus log-likelihood (n,), -inf where the prior ends."""
        return np.add(*self(theta)[:2])

    def log_likelihood(self, theta: ArrayLike) -> np.ndarray:
        """Log-likelihood (n,); -1e300 in place of -inf, which nested samplers refuse."""
        return np.maximum(self(theta).likelihood, LOWEST)

    def parameters(self, theta: ArrayLike) -> dict[str, np.ndarray]:
        """Free parameters on their own scale, arrays (n, ...)."""
        points, alone = self._rows(theta, "theta")
        values = self._space.variables(points)
        return {name: values[name][0] if alone else values[name] for name in self._free}

    def from_unit_cube(self, u: ArrayLike) -> np.ndarray:
        """Points theta (n, d) from u (n, d): theta has the model's prior where u is uniform.

        Rosenblatt's transform: each parameter by its distribution given those it depends on. Zeros and ones
        are moved inside by 1e-16.

        Raises
        ------
        ValueError
            If PyMC cannot invert the distribution function of a prior.
        """
        return self._through_cube(0, u, "u")

    def to_unit_cube(self, theta: ArrayLike) -> np.ndarray:
        """The inverse of `from_unit_cube`."""
        return self._through_cube(1, theta, "theta")

    def _through_cube(self, way: int, points, name: str):
        """Rows through one of the functions of the unit cube."""
        if isinstance(self._cube, str):
            raise ValueError(self._cube)
        points, alone = self._rows(points, name)
        if name == "u":
            if np.any((points < 0.0) | (points > 1.0)):
                raise ValueError(message("u", "between 0 and 1", f"{points.min():g} to {points.max():g}"))
            points = np.clip(points, SMALLEST, 1.0 - SMALLEST)
        [moved] = self._cube[way](points)
        return moved[0] if alone else moved

    def __getstate__(self):
        return {"parts": cloudpickle.dumps(self.__dict__)}  # transforms of PyMC hold local functions

    def __setstate__(self, state):
        self.__dict__.update(cloudpickle.loads(state["parts"]))

    def _rows(self, points, name: str) -> tuple[np.ndarray, bool]:
        """Points (n, d), and whether there is one without an axis for points."""
        points = as_numbers(points, name)
        if points.ndim not in (1, 2) or points.shape[-1] != self.n_dim:
            expected = f"of shape ({self.n_dim},) or (n, {self.n_dim})"
            raise ValueError(message(name, expected, points.shape, f"Columns are {', '.join(self.names)}."))
        return np.atleast_2d(points).astype(np.float64), points.ndim == 1


def compiled_logp(model: pm.Model | None = None, *, compile_kwargs: dict | None = None) -> CompiledLogp:
    """The densities of a PyMC model as plain functions of arrays, for samplers outside PyMC.

    Parameters
    ----------
    model : pymc.Model, optional
        Any, with continuous free parameters. The model of the context by default.
    compile_kwargs : dict, optional
        For `pytensor.function`.

    Returns
    -------
    CompiledLogp
        A callable: theta (n, d) to log prior and log-likelihood (n,), and on request the gradient (n, d),
        with the names of the coordinates, their values on their own scale, and the way to the prior's unit
        cube and back.

    Raises
    ------
    ValueError
        If the model has discrete parameters, or none.

    See Also
    --------
    sample : draws from the posterior without another package.

    Notes
    -----
    emcee takes `density.log_posterior` with `vectorize=True`; UltraNest `density.log_likelihood` and
    `density.from_unit_cube` with `vectorized=True`; dynesty the same, point by point; pocoMC
    `density.log_likelihood`; samplers with gradients `density(theta, gradient=True)`.

    Examples
    --------
    >>> with pm.Model():
    ...     x = pm.Exponential("x", 2.0)
    ...     y = pm.Normal("y", x, 1.0, observed=[1.0])
    ...     density = compiled_logp()
    >>> density.names, density([[0.0]], gradient=True).gradient.round(3)
    (['x'], array([[-1.]]))
    >>> float(density.parameters(density.from_unit_cube([0.5]))["x"].round(6))  # ln(2) / 2
    0.346574
    """
    model = check_model(model)
    compile_kwargs = check_mapping(compile_kwargs, "compile_kwargs", "a dict for `pytensor.function`")
    check_continuous(model, "compiled_logp()")
    return CompiledLogp(model, compile_kwargs)
