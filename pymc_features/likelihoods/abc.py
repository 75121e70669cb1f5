"""Likelihood-free updating: a `pm.Simulator` node with the distance of Eq. (15), its kernels and tolerance.

Kernels are log-densities of the mean squares e (sensor,) of a simulation under a tolerance epsilon. They
depend on rho = sum_j e_j, or with one tolerance for each sensor on sum_j e_j / epsilon_j in the place of
rho / epsilon.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import xarray as xr
from numpy.typing import ArrayLike
from pymc.distributions.distribution import SymbolicRandomVariable
from pymc.logprob.abstract import _logprob
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Variable
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorLike, TensorVariable
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.random.op import RandomVariable

from pymc_features._checks import (
    as_numbers,
    check_choice,
    check_integer,
    check_name,
    masked_as_nan,
    shown,
)
from pymc_features.likelihoods.simulator_functions import (
    ADVICE,
    FunctionSimulator,
    ModesSimulator,
    NoisySimulator,
    ResponseSimulator,
    node_of,
)
from pymc_features.modal import SymbolicModes
from pymc_features.modal.feature import add_coordinates
from pymc_features.modal.identified import identified
from pymc_features.ops import (
    NoGradient,
    as_tensor,
    by_labels,
    check_dims,
    check_shape,
    mean_square_discrepancy,
    name_the_time_axis,
    response_node,
)
from pymc_features.ops.declared import positive_tensor

QUANTILE = 0.9  # of sigma under EXP, from which the tolerance follows
ADVICE_ON_EPSILON = (
    "Pass a tolerance on the sum of mean squares, for example `likelihoods.abc_tolerance(sigma, n_sensors)`."
)
ADVICE_ON_NOISE = "Pass a standard deviation in the units of the data."
INSIDE, OUTSIDE = (pt.constant(value, dtype="float64") for value in (0.0, -np.inf))


def uniform_kernel(epsilon, e):
    """Accept where rho <= epsilon, Eq. (14): 0 inside and -inf outside; exact at the edge."""
    tolerance, rho = tolerance_and_rho(epsilon, e)
    return pt.switch(rho <= tolerance, INSIDE, OUTSIDE)


def exponential_kernel(epsilon, e):
    """-sum_j (ln epsilon_j + e_j / epsilon_j): the EXP likelihood at sigma_j^2 = epsilon_j / 2."""
    return -pt.sum(pt.log(epsilon) + e / epsilon, axis=-1)


def gaussian_kernel(epsilon, e):
    """-(rho / epsilon)^2 / 2, PyMC's own soft kernel on rho."""
    tolerance, rho = tolerance_and_rho(epsilon, e)
    return -0.5 * pt.sqr(rho / tolerance)


KERNELS = {
    "uniform": uniform_kernel,
    "exponential": exponential_kernel,
    "gaussian": gaussian_kernel,
}

NO_GRADIENT_OF_FUNCTION = NoGradient(f"a function passed to DiscrepancySimulator has no gradient. {ADVICE}")
NO_GRADIENT_OF_THRESHOLD = NoGradient(
    f"the hard threshold of DiscrepancySimulator has no gradient. {ADVICE} The exponential and the gaussian "
    "kernel are differentiable."
)


class Distance:
    """Distance of a `pm.Simulator` node: one of `KERNELS` at rho = sum_j e_j, Eq. (15)."""

    def __init__(self, kernel: str):
        self.kernel = kernel
        self.hard = kernel == "uniform"

    def __call__(self, epsilon, observed, simulated):
        if observed.ndim == 1:  # a summary: each entry counts once
            e = pt.sqr(observed - simulated)
        else:
            e = mean_square_discrepancy(simulated, observed)
        return NO_GRADIENT_OF_FUNCTION(self.of_discrepancy(epsilon, e))

    def of_discrepancy(self, epsilon, e):
        """Log-density for mean squares e (sensor,); what failed is infinitely far."""
        density = KERNELS[self.kernel](epsilon, pt.switch(pt.isnan(e), np.inf, e))
        return NO_GRADIENT_OF_THRESHOLD(density) if self.hard else density

    @property
    def minus_rho(self):
        """The distance whose log-density is -rho: what a sampler that lowers the tolerance looks at."""
        return MinusRho(self.kernel)


class MinusRho(Distance):
    """-rho in the place of a kernel; -rho / epsilon where epsilon has one value for each sensor."""

    def of_discrepancy(self, epsilon, e):
        """-rho for mean squares e (sensor,)."""
        return -tolerance_and_rho(epsilon, pt.switch(pt.isnan(e), np.inf, e))[1]


def tolerance_and_rho(epsilon, e):
    """Tolerance and rho, Eq. (15); with one tolerance for each sensor, 1 and sum_j e_j / epsilon_j."""
    if epsilon.ndim == 0:
        return epsilon, pt.sum(e, axis=-1)
    return pt.ones(()), pt.sum(e / epsilon, axis=-1)


class ResponseNode:
    """Marks simulator nodes of a response: their density needs no history."""


class ResponseSimulatorNode(pm.Simulator):
    """`pm.Simulator` whose node is also a `ResponseNode`."""

    @classmethod
    def rv_op(cls, *params, class_name, **kwargs):
        """Build the node."""
        plain = super().rv_op(*params, class_name=class_name, **kwargs)
        op = type(class_name, (ResponseNode, type(plain.owner.op)), {})()
        return op.make_node(*plain.owner.inputs).default_output()


@_logprob.register(ResponseNode)
def response_node_logp(op, values, rng, size, *parameters, **kwargs):
    """Log-density of the tolerance, from the fused discrepancy."""
    [value] = values
    return op._distance.of_discrepancy(op.epsilon, op.fn.discrepancy(parameters, value))


def DiscrepancySimulator(
    name: str,
    mu: TensorVariable | SymbolicModes | Callable[..., ArrayLike],
    *params: TensorLike,
    epsilon: TensorLike,
    observed: ArrayLike | Mapping | SharedVariable,
    kernel: str = "uniform",
    noise: TensorLike | None = None,
    dims: Sequence[str] | None = None,
) -> TensorVariable:
    """Likelihood-free node: a `pm.Simulator` with the distance rho = sum_j e_j, Eqs. (14)-(15).

    Parameters
    ----------
    name : str
        Name of the node in the current model.
    mu : TensorVariable (sensor, time), SymbolicModes or callable
        What `response` or `modes` returned: its parameters become the node's. Or a function of the values of
        `params` that returns an array of the shape of `observed`.
    *params : TensorVariable
        Parameters of the function; none if `mu` is a response. A function marked by `function.batched = True`
        is called by population kernels once for all particles: parameters (particle, ...) in, results
        (particle, ...) out.
    epsilon : float, array_like (sensor,) or pm.Data
        Tolerance on rho, in squared units of the data, positive; see `abc_tolerance`. With one for each
        sensor, or entry, rho / epsilon becomes sum_j e_j / epsilon_j.
    observed : array_like (sensor, time) or (entry,), or identified modes
        Measured response, or a summary of it, finite. NaN, or what a masked array hides, is a gap of a
        response: e_j is the mean over the other samples. Of a summary e_j = (y_j - g_j)^2. Beside `modes`
        what `ModalFeature` takes: e_j are (ln f^ - ln f)^2 of all identifications, then 1 - MAC of those with
        a shape, each matched with a mode of its own such that rho is smallest.
    kernel : {"uniform", "exponential", "gaussian"}
        "uniform" accepts where rho <= epsilon; "exponential" is the EXP likelihood at
        sigma^2 = epsilon / 2, constants included: exp(-rho / epsilon) / epsilon^N_0; "gaussian" is
        exp(-(rho / epsilon)^2 / 2).
    noise : float or tensor_like () or (sensor,), optional
        Standard deviation of white Gaussian measurement noise that the simulator adds, in the units of the
        data; may be a random variable. Without it the simulator is the model alone, as in the source.
    dims : tuple of str, optional
        Names of the axes of the data.

    Returns
    -------
    TensorVariable (sensor, time) or (entry,)
        The node; sample it with `pm.sample_smc`, the uniform kernel with `SubsetSimulation`. Predictive draws
        are response histories.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range or shapes do not match.

    Warns
    -----
    SimulationWarning
        If a function raises: its parameters are counted as failed and rejected.

    Notes
    -----
    A failed simulation (NaN, an exception) is outside every tolerance. The density of a response's node needs
    no history, with noise neither: the noisy mean squares are drawn from their exact law. A function is
    called for each set of parameters. With the uniform kernel the stock SMC kernels must reach the tolerance
    from the prior in one stage; `SubsetSimulation` lowers it in many. With noise rho is a larger number, at
    the truth about twice what it is without.
    """
    check_name(name)
    check_choice(kernel, "kernel", KERNELS)
    if isinstance(mu, SymbolicModes):
        if params or noise is not None:
            raise ValueError(
                "`params` and `noise` must be left out when `mu` are modes, got one of them. Modes have "
                "parameters of their own, and identified ones no noise of samples."
            )
        return modes_node(name, mu, identified(observed), epsilon, Distance(kernel), dims)
    data = _checked_data(by_labels(observed, dims))
    dims = check_dims(dims, data.ndim)
    name_the_time_axis(dims, mu if isinstance(mu, Variable) else data, data)
    shape = data.shape if isinstance(data, np.ndarray) else data.get_value(borrow=True).shape
    fn, parameters = _simulator_of(mu, params, shape)
    node = ResponseSimulatorNode if isinstance(fn, ResponseSimulator) else pm.Simulator
    if noise is not None:
        fn = NoisySimulator(fn)
        scale = _per_sensor("noise", noise, shape[0], ADVICE_ON_NOISE, zero=True)
        parameters = [*parameters, pt.broadcast_to(scale, (shape[0],))]
    return node(
        name,
        fn,
        *parameters,
        distance=Distance(kernel),
        sum_stat="identity",
        epsilon=_tolerance(epsilon, shape[0]),
        signature=_signature(fn, shape),
        observed=data,
        dims=dims,
    )


def modes_node(name, mu, data, epsilon, distance, dims) -> TensorVariable:
    """The node of modes that are matched with identified ones."""
    fn = ModesSimulator(node_of(mu, data), data)
    fn.epsilon = _tolerance(epsilon, fn.n_entries, "squared errors")
    return ResponseSimulatorNode(
        name,
        fn,
        *fn.parameters,
        distance=distance,
        sum_stat="identity",
        epsilon=fn.epsilon,
        signature=_signature(fn, data.values.shape),
        observed=data.values,
        dims=add_coordinates(name, data) if dims is None else dims,
    )


def _signature(fn, shape) -> str:
    """Shapes of a simulator's parameters and of what it returns, as of a gufunc."""
    inputs = ",".join(
        "(" + ",".join(f"p{i}{axis}" for axis in range(ndim)) + ")" for i, ndim in enumerate(fn.ndims_params)
    )
    return f"{inputs}->({','.join(map(str, shape))})"


def _simulator_of(mu, params, shape):
    """Return the simulator function and its parameters; refuse a response of another shape."""
    if not isinstance(mu, Variable):
        if not callable(mu):
            raise TypeError(f"`mu` must be what `response` returned or a function, got {type(mu).__name__}.")
        if not params:
            raise ValueError("`params` must be given with a function, got none. Pass its parameters.")
        parameters = [as_tensor(p, "params", "Pass random variables or numbers.") for p in params]
        return FunctionSimulator(mu, tuple(p.ndim for p in parameters), shape), parameters
    node = response_node(mu)
    if node is None or isinstance(node.op, Blockwise):
        raise TypeError(
            "`mu` must be what `response` returned, got another PyTensor expression. Pass a function "
            "of the parameters instead."
        )
    if params:
        raise ValueError("`params` must be left out when `mu` is a response: it has its own.")
    if len(shape) != 2:
        raise ValueError(
            f"`observed` must be (sensor, time) to match a response, got shape {shape}. Pass a function for "
            "a summary."
        )
    check_shape(node.outputs[0].type.shape, shape)
    n = node.op.n_parameters
    return ResponseSimulator(node.op, node.inputs[n:]), node.inputs[:n]


def _tolerance(epsilon, n_sensors, kind="sensors"):
    """Epsilon as a tensor; a random variable is no tolerance."""
    tensor = _per_sensor("epsilon", epsilon, n_sensors, ADVICE_ON_EPSILON, kind=kind)
    owners = (v.owner for v in ancestors([tensor]) if v.owner is not None)
    if any(isinstance(node.op, RandomVariable | SymbolicRandomVariable) for node in owners):
        raise TypeError(
            f"`epsilon` must be a number, an array or pm.Data, got the random variable {tensor}. Look at "
            "several tolerances with sampling.tolerance_sweep()."
        )
    return tensor


def _per_sensor(name, value, n_sensors, advice, *, zero=False, kind="sensors"):
    """A tensor () or (sensor,) whose numbers, where they are known, are positive; or zero, if allowed."""
    tensor = as_tensor(value, name, advice)
    shape = tensor.get_value().shape if isinstance(tensor, SharedVariable) else tensor.type.shape
    if len(shape) > 1 or (len(shape) == 1 and shape[0] not in (None, n_sensors)):
        raise ValueError(
            f"`{name}` must be one number or one for each of the {n_sensors} {kind}, got shape {shape}."
        )
    words = "not negative" if zero else "positive"
    return positive_tensor(tensor, name, advice, zero=zero, data=True, words=words)


def _checked_data(observed):
    """The data as an array or, if they have gaps, as a shared variable: PyMC would impute NaN in an array."""
    values = observed.get_value(borrow=True) if isinstance(observed, SharedVariable) else observed
    values = as_numbers(masked_as_nan(values), "observed")
    gaps = np.isnan(values)
    if values.ndim not in (1, 2) or values.size == 0 or np.isinf(values).any():
        raise ValueError(
            "`observed` must be finite numbers of shape (sensor, time), or (entry,) for a summary, got shape "
            f"{values.shape}."
        )
    silent = np.flatnonzero(gaps.all(axis=-1) if values.ndim == 2 else gaps)
    if silent.size:
        raise ValueError(
            "`observed` must have data of every sensor, or every entry of a summary, got NaN alone at index "
            f"{silent[0]}. Leave it out."
        )
    if isinstance(observed, SharedVariable):
        return observed
    values = np.array(values)
    return pytensor.shared(values, shape=values.shape) if gaps.any() else values


def abc_tolerance(
    sigma: ArrayLike | xr.DataTree | xr.Dataset | xr.DataArray, n_sensors: int
) -> float | np.ndarray:
    """Tolerance delta = 2 N_0 sigma^2 on rho = sum_j e_j, Eq. (16).

    Parameters
    ----------
    sigma : float, array_like (sensor,), DataTree, Dataset or DataArray
        The 90 % quantile of the EXP posterior of sigma, in the units of the data; positive. Its most
        probable value would give the smallest rho there is, and an empty set. Of a posterior (the result of
        sampling an EXP model, with its variable `sigma`, or draws of it with dimensions chain and draw) that
        quantile is taken.
    n_sensors : int
        N_0, at least 1.

    Returns
    -------
    float or array (sensor,)
        delta, in squared units of the data; one for each sensor where sigma has one for each.

    Examples
    --------
    >>> abc_tolerance(0.5, n_sensors=10)
    5.0
    >>> draws = xr.DataArray([[0.1, 0.2, 0.5, 0.6]], dims=("chain", "draw"))
    >>> round(abc_tolerance(draws, n_sensors=10), 4)  # 90 % quantile 0.57
    6.498
    """
    n_sensors = check_integer(n_sensors, "n_sensors")
    if isinstance(sigma, xr.DataTree | xr.Dataset | xr.DataArray):
        sigma = posterior_quantile(sigma)
    values = as_numbers(sigma, "sigma", "Pass a quantile of its posterior.", what="one number")
    if values.shape not in ((), (n_sensors,)):
        raise ValueError(
            f"`sigma` must be one number or one for each of the {n_sensors} sensors, got shape "
            f"{values.shape}. Pass draws as a DataArray with dimensions chain and draw."
        )
    if not (np.isfinite(values) & (values > 0)).all():
        raise ValueError(
            f"`sigma` must be positive and finite, got {shown(values.tolist())}. Pass the 90 % quantile of "
            "the EXP posterior, in the units of the data."
        )
    delta = 2.0 * n_sensors * values**2
    return delta if delta.ndim else float(delta)


def posterior_quantile(posterior):
    """The 90 % quantile of sigma over chains and draws."""
    if isinstance(posterior, xr.DataTree):
        if "posterior" not in posterior.children:
            raise ValueError(
                "`sigma` must hold a posterior, got a DataTree without that group. Pass the result of "
                "sampling an EXP model."
            )
        posterior = posterior["posterior"].to_dataset()
    if isinstance(posterior, xr.Dataset):
        if "sigma" not in posterior:
            raise ValueError(
                f"`sigma` must hold a variable of that name, got {', '.join(map(str, posterior)) or 'none'}. "
                "Pass its draws, posterior[name]."
            )
        posterior = posterior["sigma"]
    over = [dim for dim in ("chain", "draw", "sample") if dim in posterior.dims]
    if not over:
        raise ValueError(f"`sigma` must have the dimensions chain and draw, got {posterior.dims}.")
    if posterior.dtype.kind not in "iuf" or not posterior.size:
        raise TypeError(f"`sigma` must hold draws, got {posterior.size} values of type {posterior.dtype}.")
    return posterior.quantile(QUANTILE, dim=over).values
