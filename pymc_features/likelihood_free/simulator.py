"""Likelihood-free updating: a `pm.Simulator` node with the distance of Eq. (15)."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.distributions.distribution import SymbolicRandomVariable
from pymc.logprob.abstract import _logprob
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant, Variable
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorLike, TensorVariable
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.random.op import RandomVariable

from pymc_features._checks import as_numbers, check_choice, check_name, masked_as_nan, shown
from pymc_features.likelihood_free.functions import (
    FunctionSimulator,
    NoisySimulator,
    ResponseSimulator,
    number,
)
from pymc_features.likelihood_free.kernels import KERNELS, Distance
from pymc_features.likelihood_free.modal import ModesSimulator, node_of
from pymc_features.modal_features import SymbolicModes
from pymc_features.modal_features.feature import add_coordinates
from pymc_features.modal_features.identified import identified
from pymc_features.ops import (
    as_tensor,
    by_labels,
    check_dims,
    check_shape,
    name_the_time_axis,
    response_node,
)

ADVICE_ON_EPSILON = (
    "Pass a tolerance on the sum of mean squares, for example `abc_tolerance(sigma, n_sensors)`."
)
ADVICE_ON_NOISE = "Pass a standard deviation in the units of the data."


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
            "several tolerances with tolerance_sweep()."
        )
    return tensor


def _per_sensor(name, value, n_sensors, advice, *, zero=False, kind="sensors"):
    """A tensor () or (sensor,) whose numbers, where they are known, are positive; or zero, if allowed."""
    tensor = as_tensor(value, name, advice)
    known = isinstance(tensor, Constant | SharedVariable)
    values = np.asarray(number(tensor)) if known else None
    shape = values.shape if known else tensor.type.shape
    if len(shape) > 1 or (len(shape) == 1 and shape[0] not in (None, n_sensors)):
        raise ValueError(
            f"`{name}` must be one number or one for each of the {n_sensors} {kind}, got shape {shape}."
        )
    if known and not (np.isfinite(values) & ((values > 0) | (zero & (values == 0)))).all():
        wanted = "not negative" if zero else "positive"
        raise ValueError(f"`{name}` must be {wanted} and finite, got {shown(values.tolist())}. {advice}")
    return tensor


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
