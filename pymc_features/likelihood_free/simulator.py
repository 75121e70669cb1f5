"""Likelihood-free updating: a `pm.Simulator` node with the distance of Eq. (15)."""

from collections.abc import Callable

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pymc.logprob.abstract import _logprob
from pytensor.compile.mode import Mode
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant, Variable
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops import (
    N_PARAMETERS,
    ChainResponse,
    NoGradient,
    check_shape,
    mean_square_discrepancy,
    response_node,
)
from pymc_features.simulators import QUANTITIES, chain_response


class ResponseSimulator:
    """Simulator function of a response, `fn(rng, mass, stiffness, rayleigh, ratios, size)`.

    Parameters
    ----------
    settings : list of TensorVariable
        The other inputs of the response; data among them are read anew in each call.
    quantity : str
        One of `simulators.QUANTITIES`.
    """

    ndims_params = (1, 1, 1, 1)

    def __init__(self, settings: list, quantity: str):
        self.settings = settings
        self.quantity = quantity

    def core(self, *parameters):
        """Response (sensor, time) of one set of parameters."""
        arrays = (np.ascontiguousarray(p, dtype=np.float64) for p in parameters)
        settings = (_number(value) for value in self.settings)
        return chain_response(*arrays, *settings, QUANTITIES.index(self.quantity))

    def __call__(self, rng, *parameters_and_size):
        *parameters, size = parameters_and_size
        return simulate_batch(self.core, parameters, self.ndims_params, size)

    def discrepancy(self, parameters, value):
        """e_j of the parameters, as a tensor, without a history."""
        return mean_square_discrepancy(ChainResponse(self.quantity)(*parameters, *self.settings), value)


class FunctionSimulator:
    """Simulator function of a user's function theta -> response (sensor, time).

    If the function has an attribute `batched` that is true, it is called once for all particles, with
    parameters (particle, ...), and returns (particle, sensor, time).
    """

    def __init__(self, function: Callable, ndims_params: tuple[int, ...]):
        self.function = function
        self.ndims_params = ndims_params
        self.batched = bool(getattr(function, "batched", False))

    def core(self, *parameters):
        """Response (sensor, time) of one set of parameters, or of all."""
        return np.asarray(self.function(*parameters), dtype=np.float64)

    def __call__(self, rng, *parameters_and_size):
        *parameters, size = parameters_and_size
        batch, spread = spread_batch(parameters, self.ndims_params, size)
        if self.batched and batch:
            return self.core(*spread)
        return simulate_batch(self.core, parameters, self.ndims_params, size)


def spread_batch(parameters, ndims_params, size):
    """Return the batch shape that parameters and `size` span, and the parameters spread over it."""
    parameters = [np.asarray(p) for p in parameters]
    batches = [p.shape[: p.ndim - n] for p, n in zip(parameters, ndims_params, strict=True)]
    batch = np.broadcast_shapes(*batches, () if size is None else tuple(size))
    return batch, [
        np.broadcast_to(p, batch + p.shape[p.ndim - n :])
        for p, n in zip(parameters, ndims_params, strict=True)
    ]


def simulate_batch(core, parameters, ndims_params, size):
    """Call `core` for every entry of the batch that parameters and `size` span."""
    batch, spread = spread_batch(parameters, ndims_params, size)
    if batch == ():
        return core(*spread)
    results = [core(*(p[index] for p in spread)) for index in np.ndindex(*batch)]
    return np.stack(results).reshape(batch + results[0].shape)


def uniform_kernel(epsilon, rho):
    """Accept where rho <= epsilon, Eq. (14): 0 inside and -inf outside."""
    return pt.switch(rho <= epsilon, 0.0, -np.inf)


def exponential_kernel(epsilon, rho):
    """-rho / epsilon: with epsilon = 2 sigma^2 the EXP likelihood at that sigma."""
    return -rho / epsilon


def gaussian_kernel(epsilon, rho):
    """-(rho / epsilon)^2 / 2, PyMC's own soft kernel on rho."""
    return -0.5 * pt.sqr(rho / epsilon)


KERNELS = {
    "uniform": uniform_kernel,
    "exponential": exponential_kernel,
    "gaussian": gaussian_kernel,
}


ADVICE = (
    "Sample with pmf.sample_smc(), or choose a gradient-free method yourself: "
    "pm.sample(step=pm.DEMetropolisZ()), pm.find_MAP(method='powell')."
)
NO_GRADIENT_OF_FUNCTION = NoGradient(f"a function passed to DiscrepancySimulator has no gradient. {ADVICE}")
NO_GRADIENT_OF_THRESHOLD = NoGradient(
    f"the hard threshold of DiscrepancySimulator has no gradient. {ADVICE} The exponential and the gaussian "
    "kernel are differentiable."
)


class Distance:
    """What `pm.Simulator` calls a distance: one of `KERNELS` at rho = sum_j e_j, Eq. (15)."""

    def __init__(self, kernel: str):
        self.kernel = kernel

    def __call__(self, epsilon, observed, simulated):
        return NO_GRADIENT_OF_FUNCTION(
            self.of_discrepancy(epsilon, mean_square_discrepancy(simulated, observed))
        )

    def of_discrepancy(self, epsilon, e):
        """Log-density of the kernel for mean squares e (..., sensor); what failed is infinitely far."""
        density = KERNELS[self.kernel](epsilon, pt.sum(pt.switch(pt.isnan(e), np.inf, e), axis=-1))
        return NO_GRADIENT_OF_THRESHOLD(density) if self.kernel == "uniform" else density


class ResponseNode:
    """Marks simulator nodes of a response: their density needs no random draw and no history."""


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


def DiscrepancySimulator(name, mu, *params, epsilon, observed, kernel="uniform", dims=None):
    """Likelihood-free node: a `pm.Simulator` with the distance rho = sum_j e_j, Eqs. (14)-(15).

    Parameters
    ----------
    name : str
        Name of the node in the current model.
    mu : TensorVariable (sensor, time) or callable
        What `response` returned: its parameters become the node's. Or a function of the values of
        `params` that returns an array (sensor, time).
    *params : TensorVariable
        Parameters of the function; none if `mu` is a response. A function marked by `function.batched = True`
        is called by population kernels once for all particles: parameters (particle, ...) in, responses
        (particle, sensor, time) out.
    epsilon : float or pm.Data
        Tolerance on rho, in squared units of the data, positive; see `abc_tolerance`.
    observed : array_like (sensor, time)
        Measured response, finite.
    kernel : {"uniform", "exponential", "gaussian"}
        "uniform" accepts where rho <= epsilon; "exponential" is exp(-rho / epsilon), the EXP
        likelihood at sigma^2 = epsilon / 2; "gaussian" is exp(-(rho / epsilon)^2 / 2).
    dims : tuple of str, optional
        Names of the axes of the data.

    Returns
    -------
    TensorVariable (sensor, time)
        The node; sample it with `pm.sample_smc`. Predictive draws are response histories.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range or shapes do not match.

    Notes
    -----
    A failed simulation (NaN) is outside every tolerance. The density of a response's node needs no history
    and no random draw; a function is called for each set of parameters. With the uniform kernel the stock
    SMC kernels reach the tolerance from the prior in one stage: enough prior draws must lie inside it.
    """
    if kernel not in KERNELS:
        raise ValueError(f"`kernel` must be one of {', '.join(KERNELS)}, got {kernel!r}.")
    fn, parameters, expected = _simulator_of(mu, params)
    data = _checked_data(observed, expected)
    shape = data.shape if isinstance(data, np.ndarray) else data.get_value(borrow=True).shape
    core_inputs = ",".join(
        "(" + ",".join(f"p{i}{axis}" for axis in range(ndim)) + ")" for i, ndim in enumerate(fn.ndims_params)
    )
    node = ResponseSimulatorNode if isinstance(fn, ResponseSimulator) else pm.Simulator
    return node(
        name,
        fn,
        *parameters,
        distance=Distance(kernel),
        sum_stat="identity",
        epsilon=_checked_epsilon(epsilon),
        signature=f"{core_inputs}->({shape[0]},{shape[1]})",
        observed=data,
        dims=dims,
    )


def _simulator_of(mu, params):
    """Return the simulator function, its parameters and the shape of a response, if known."""
    if not isinstance(mu, Variable):
        if not callable(mu):
            raise TypeError(f"`mu` must be what `response` returned or a function, got {type(mu).__name__}.")
        if not params:
            raise ValueError("`params` must be given with a function, got none. Pass its parameters.")
        parameters = [pt.as_tensor_variable(p) for p in params]
        return FunctionSimulator(mu, tuple(p.ndim for p in parameters)), parameters, (None, None)
    node = response_node(mu)
    if node is None or isinstance(node.op, Blockwise):
        raise TypeError(
            "`mu` must be what `response` returned, got another PyTensor expression. Pass a function "
            "of the parameters instead."
        )
    if params:
        raise ValueError("`params` must be left out when `mu` is a response: it has its own.")
    fn = ResponseSimulator(node.inputs[N_PARAMETERS:], node.op.quantity)
    return fn, node.inputs[:N_PARAMETERS], node.outputs[0].type.shape


def _number(variable):
    """Value of a constant, of data, or of what follows from them: the record, the sampling, the sensors."""
    if isinstance(variable, SharedVariable):
        value = variable.get_value()
    elif isinstance(variable, Constant):
        value = variable.data
    else:
        value = variable.eval(mode=Mode(linker="py", optimizer=None))
    value = np.asarray(value)
    return value.item() if value.ndim == 0 else value


def _checked_epsilon(epsilon):
    tensor = pt.as_tensor_variable(epsilon)
    if isinstance(tensor, Constant | SharedVariable):
        value = np.asarray(_number(tensor))
        if not (np.isfinite(value) & (value > 0)).all():
            raise ValueError(
                f"`epsilon` must be positive and finite, got {value.tolist()}. Pass a tolerance on the "
                "sum of mean squares, for example `abc_tolerance(sigma, n_sensors)`."
            )
    return tensor


def _checked_data(observed, expected):
    values = observed
    if isinstance(observed, SharedVariable):
        values = observed.get_value(borrow=True)
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 2 or not np.isfinite(values).all():
        raise ValueError(
            f"`observed` must be finite numbers of shape (sensor, time), got shape {values.shape}."
        )
    check_shape(expected, values.shape)
    return observed if isinstance(observed, SharedVariable) else np.ascontiguousarray(values)
