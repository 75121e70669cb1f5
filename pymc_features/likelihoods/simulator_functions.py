"""Simulator functions, which a `pm.Simulator` node calls, `fn(rng, *parameters, size)`.

Of a response or a user's function, with or without measurement noise, they return histories or summaries; of
modes those that match identified ones, whose squared errors of ln f and 1 - MAC stand for mean squares.
"""

import warnings
from collections.abc import Callable

import numpy as np
import pytensor
import pytensor.tensor as pt
from pymc.distributions.simulator import SimulatorRV
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant
from scipy.optimize import linear_sum_assignment

from pymc_features.exceptions import SimulationWarning, UnknownIdentityError
from pymc_features.fingerprint import fingerprint
from pymc_features.modal import SymbolicModes, mac
from pymc_features.modal.identified import Identified
from pymc_features.modal.matching import Assignment, one_minus_mac
from pymc_features.modal.structural_modes import StructuralModes
from pymc_features.ops import NoGradient, StructuralResponse, mean_square_discrepancy, measured_samples
from pymc_features.ops.declared import IN_PYTHON

ADVICE = (
    "Sample with pmf.sample_smc(), or choose a gradient-free method yourself: "
    "pm.sample(step=pm.DEMetropolisZ()), pm.find_MAP(method='powell')."
)
FAR = 1e30  # stands for an infinite distance in sums of which the smallest is sought
NO_GRADIENT_OF_NOISE = NoGradient(f"a simulator with noise has no gradient. {ADVICE}")


class SimulatorFunction:
    """Base: `core` simulates one set of parameters, `settings` are the inputs of `op` behind them."""

    draws_random_numbers = False

    def results(self, parameters):
        """Outputs of `op` for one set of parameters; data among the settings are read anew in each call."""
        settings = (np.asarray(number(value)) for value in self.settings)
        return self.op.run([*(np.asarray(p, dtype=np.float64) for p in parameters), *settings])

    def __call__(self, rng, *parameters_and_size):
        *parameters, size = parameters_and_size
        return simulate_batch(self.core, *spread_batch(parameters, self.ndims_params, size))


class ResponseSimulator(SimulatorFunction):
    """Simulator function of a response, `fn(rng, *parameters, size)`.

    Parameters
    ----------
    op : StructuralResponse
        Which response.
    settings : list of TensorVariable
        The inputs behind its parameters.
    """

    def __init__(self, op: StructuralResponse, settings: list):
        self.op = op
        self.settings = settings
        self.ndims_params = op.parameter_ndims

    def core(self, *parameters):
        """Response (sensor, time) of one set of parameters."""
        return self.results(parameters)[0]

    def discrepancy(self, parameters, value):
        """e_j of the parameters, as a tensor, without a history."""
        return mean_square_discrepancy(self.op(*parameters, *self.settings), value)


class FunctionSimulator:
    """Simulator function of a user's function theta -> response (sensor, time) or summary (entry,).

    If the function has an attribute `batched` that is true, it is called once for all particles, with
    parameters (particle, ...), and returns (particle, ...). An exception is a failed simulation: NaN, and a
    warning for the first of its type.

    Attributes
    ----------
    last_error : str
        What the function raised last, or nothing.
    identity : str
        Fingerprint of the function as it was given, for checkpoints; empty where it cannot be told.
    """

    batched = True  # takes batches, by a loop where the function does not
    draws_random_numbers = False

    def __init__(self, function: Callable, ndims_params: tuple[int, ...], shape: tuple[int, ...]):
        self.function = function
        self.function_takes_batches = bool(getattr(function, "batched", False))
        self.ndims_params = ndims_params
        self.shape = shape
        self.last_error, self.warned_of = "", set()
        try:
            self.identity = fingerprint(function)
        except UnknownIdentityError:
            self.identity = ""

    def __call__(self, rng, *parameters_and_size):
        *parameters, size = parameters_and_size
        batch, spread = spread_batch(parameters, self.ndims_params, size)
        if batch and self.function_takes_batches:
            flat = [p.reshape(-1, *p.shape[len(batch) :]) for p in spread]
            try:
                return self.checked(self.function(*flat), (len(flat[0]),)).reshape(batch + self.shape)
            except Exception:  # for one of them; below it is found out for which
                pass
        return simulate_batch(self.core, batch, spread)

    def core(self, *parameters):
        """Result of one set of parameters."""
        try:
            if self.function_takes_batches:
                return self.checked(self.function(*(p[None] for p in parameters)), (1,))[0]
            return self.checked(self.function(*parameters), ())
        except Exception as error:  # a solver may fail in its own way, and a wrong result is a failure
            self.note(error)
            return np.full(self.shape, np.nan)

    def note(self, error):
        """Keep an exception's text; warn of the first of its type, for the text may be another each time."""
        self.last_error = f"{type(error).__name__}: {str(error).partition('\n')[0]}"
        if type(error) not in self.warned_of:
            self.warned_of.add(type(error))
            warnings.warn(
                f"the simulator failed: {self.last_error}. Parameters at which it does are counted as "
                "failed, and rejected.",
                SimulationWarning,
                stacklevel=3,
            )

    def checked(self, result, batch):
        """A copy of the result, if it has the shape of the data; a solver may use its array again."""
        if np.iscomplexobj(result):
            raise TypeError("the simulator must return real numbers, got complex ones. Pass their parts.")
        result = np.array(result, dtype=np.float64)
        if result.shape != batch + self.shape:
            raise ValueError(
                f"the simulator must return the shape of `observed`, {batch + self.shape}, got "
                f"{result.shape}. Time is the last axis, and a batch of particles the first."
            )
        return result


class NoisySimulator:
    """A simulator with white Gaussian measurement noise on its results; its last parameter is the scale.

    Parameters
    ----------
    simulator : ResponseSimulator or FunctionSimulator
        Without noise.
    """

    batched = True

    def __init__(self, simulator):
        self.simulator = simulator
        self.ndims_params = (*simulator.ndims_params, 1)

    @property
    def last_error(self) -> str:
        """Text of the last exception of the simulator, or nothing."""
        return getattr(self.simulator, "last_error", "")

    def __call__(self, rng, *parameters_and_size):
        *parameters, noise, size = parameters_and_size
        if size is None:  # noise may span a batch that the other parameters do not
            batch, _ = spread_batch([*parameters, noise], self.ndims_params, size)
            size = batch or None
        exact = self.simulator(rng, *parameters, size)
        scale = np.asarray(noise)
        if exact.ndim > scale.ndim:
            scale = scale[..., None]  # of each sensor, the same at all times
        return exact + scale * rng.standard_normal(exact.shape)

    def discrepancy(self, parameters, value):
        """e_j of one noisy measurement, as a tensor, drawn without a history."""
        *parameters, noise = parameters
        exact = self.simulator.discrepancy(parameters, value)
        stream = pytensor.shared(np.random.default_rng(), name="noise")
        n_measured = measured_samples(value)
        n_times = value.shape[-1] if n_measured is None else n_measured
        return NO_GRADIENT_OF_NOISE(
            NoisyMeanSquare().make_node(stream, None, exact, noise, n_times).outputs[1]
        )


def noisy_mean_square(rng, exact, noise, n_times, size):
    """A draw of the mean square of a misfit and white noise, from the mean square of the misfit.

    The sum of squares of N_D white errors around a misfit of length R depends on its direction through
    one normal variable z only: N_D e = (R - sigma z)^2 + sigma^2 chi^2 with N_D - 1 degrees of freedom.
    """
    shape = np.broadcast_shapes(
        np.shape(exact), np.shape(noise), np.shape(n_times), () if size is None else size
    )
    along = np.sqrt(n_times * exact) + noise * rng.standard_normal(shape)
    across = noise**2 * 2.0 * rng.standard_gamma(0.5 * (n_times - 1.0), shape)
    return (along**2 + across) / n_times


noisy_mean_square.batched = True


class NoisyMeanSquare(SimulatorRV):
    """`noisy_mean_square` as an Op: of PyMC's simulators, for it allows no other draws in a log-density."""

    name = "NoisyMeanSquare"
    signature = "(),(),()->()"
    dtype = "float64"
    fn = staticmethod(noisy_mean_square)


def spread_batch(parameters, ndims_params, size):
    """Return the batch shape that parameters and `size` span, and the parameters spread over it."""
    parameters = [np.asarray(p) for p in parameters]
    batches = [p.shape[: p.ndim - n] for p, n in zip(parameters, ndims_params, strict=True)]
    batch = np.broadcast_shapes(*batches, () if size is None else tuple(size))
    return batch, [
        np.broadcast_to(p, batch + p.shape[p.ndim - n :])
        for p, n in zip(parameters, ndims_params, strict=True)
    ]


def simulate_batch(core, batch, spread):
    """Call `core` for every entry of a batch of parameters."""
    if batch == ():
        return core(*spread)
    results = [core(*(p[index] for p in spread)) for index in np.ndindex(*batch)]
    return np.stack(results).reshape(batch + results[0].shape)


def number(variable):
    """Value of a constant, of data, or of what follows from them: the record, the sampling, the sensors."""
    if isinstance(variable, SharedVariable):
        value = variable.get_value()
    elif isinstance(variable, Constant):
        value = variable.data
    else:
        value = variable.eval(mode=IN_PYTHON)
    value = np.asarray(value)
    return value.item() if value.ndim == 0 else value


class ModesSimulator(SimulatorFunction):
    """Simulator function of modes, `fn(rng, *parameters, size)`: those that are matched, in one array.

    Parameters
    ----------
    node : Apply
        Of a `StructuralModes`.
    data : Identified

    Attributes
    ----------
    epsilon : TensorVariable () or (entry,)
        Tolerance, by which errors of frequencies and shapes are weighed in the assignment.
    there, with_shape : bool array (g, k)
        Identifications of each mode, and those that have a shape: entries are all frequencies, then these.
    """

    def __init__(self, node, data: Identified):
        self.op, n = node.op, node.op.n_parameters
        self.parameters, self.settings = node.inputs[:n], node.inputs[n:]
        self.ndims_params = self.op.ndims[:n]
        self.data = data
        self.epsilon = pt.ones(())
        self.there, self.with_shape = ~np.isnan(data.frequencies), ~np.isnan(data.shapes).all(axis=2)

    @property
    def n_entries(self) -> int:
        """Number of squared errors."""
        return int(self.there.sum() + self.with_shape.sum())

    def weights(self, epsilon):
        """1 / epsilon of each identification's frequency and shape, (2, g, k); zero where there is none."""
        places = np.zeros((2, *self.there.shape, self.n_entries))
        places[*np.nonzero([self.there, self.with_shape]), np.arange(self.n_entries)] = 1.0
        return (places / epsilon).sum(axis=-1)

    def core(self, *parameters):
        """Values (g, c) of one set of parameters, shapes scaled such that they fit best."""
        frequencies, shapes, _ = self.results(parameters)
        data = self.data
        if not np.isfinite(frequencies).all():
            return np.full(data.values.shape, np.nan)
        there, known = self.there[..., None], ~np.isnan(data.shapes)
        measured = np.where(known, data.shapes, 0.0)
        with np.errstate(divide="ignore"):
            errors = np.square(
                np.log(np.where(there, data.frequencies[..., None], 1.0)) - np.log(frequencies)
            )
        shapes = shapes if measured.size else np.empty((len(shapes), 0))
        distances = np.zeros(errors.shape)
        distances[self.with_shape] = 1.0 - mac(data.shapes[self.with_shape], shapes)
        weights = self.weights(number(self.epsilon))[..., None]
        cost = np.minimum(weights[0] * errors + weights[1] * distances, FAR).sum(axis=1, where=there)
        taken = linear_sum_assignment(cost)[1]
        fitted = shapes[taken, None] * known
        squares = np.sum(fitted**2, axis=2, keepdims=True)
        scale = np.sum(fitted * measured, axis=2, keepdims=True) / np.where(squares > 0.0, squares, 1.0)
        frequencies = np.where(self.there, frequencies[taken, None], np.nan)
        return data._replace(frequencies=frequencies, shapes=scale * fitted).values

    def discrepancy(self, parameters, value):
        """Squared errors (entry,), a tensor: (ln f^ - ln f)^2 of each, then 1 - MAC of those with a shape."""
        frequencies, shapes, _ = self.op(*parameters, *self.settings)
        data = self.data
        (g, k), s = self.there.shape, data.shapes.shape[2]
        value = value.reshape((g, k, -1))
        errors = pt.sqr(pt.log(pt.switch(self.there, value[..., 0], 1.0))[..., None] - pt.log(frequencies))
        parts = [value[..., 1 + i * s : 1 + (i + 1) * s] for i in range(1 + data.is_complex)]
        known = pt.as_tensor_variable((~np.isnan(data.shapes)).astype(np.float64))
        distances = one_minus_mac(shapes, parts, known) if s else pt.zeros_like(errors)
        weights = self.weights(pt.broadcast_to(self.epsilon, (self.n_entries,)))[..., None]
        cost = pt.minimum(weights[0] * errors + weights[1] * distances, FAR)
        chosen = Assignment()(-pt.sum(pt.switch(self.there[..., None], cost, 0.0), axis=1))[:, None] > 0.5
        taken = [pt.sum(pt.switch(chosen, e, 0.0), axis=-1) for e in (errors, distances)]
        return pt.concatenate([taken[0][np.nonzero(self.there)], taken[1][np.nonzero(self.with_shape)]])


def node_of(mu: SymbolicModes, data: Identified):
    """The node of modes that come from `modes`, at the channels of the data."""
    node = mu.frequencies.owner
    if node is None or not isinstance(node.op, StructuralModes) or mu.shapes.owner is not node:
        raise TypeError(
            "`mu` must be what `modes` returned, at `sensors`, got other expressions. Pass a function of the "
            "parameters instead."
        )
    (m, s), wanted = node.outputs[1].type.shape, data.shapes.shape[2]
    if wanted and s not in (None, wanted):
        raise ValueError(
            f"`observed` must have shapes at the {s} sensors of `modes`, got {wanted} channels. Pass those "
            "of the data as `sensors`."
        )
    if m is not None and m < len(data.labels):
        raise ValueError(
            f"`modes` must have at least as many modes as were identified, {len(data.labels)}, got {m}. Ask "
            "`modes` for more."
        )
    return node
