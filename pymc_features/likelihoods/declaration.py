"""Arguments of the likelihoods of histories, checked where the model is declared; warnings of posteriors."""

import numpy as np
import pytensor
import pytensor.tensor as pt
from pymc.distributions.distribution import SymbolicRandomVariable
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant, Variable
from pytensor.graph.traversal import ancestors
from pytensor.tensor.random.op import RandomVariable

from pymc_features._checks import as_numbers, masked_as_nan, message, warn_caller
from pymc_features.exceptions import FeatureLikelihoodWarning
from pymc_features.ops import (
    as_tensor,
    by_labels,
    check_dims,
    check_shape,
    mean_square_discrepancy,
    response_step,
    was_simulated,
)
from pymc_features.ops.declared import cheap_values_at_start, positive_tensor

LARGE_CONSTANT = 10**6  # bytes; beyond it Numba cannot keep a compiled graph on disk
NOISE_FREE = 1e-12  # misfit over mean square of the data
COMPLETE = (
    "Cut the record to its complete part, or leave out the sensor; gaps are left out by TruncNormalFeature, "
    "ExpFeature and GammaFeature."
)
ADVICE = {  # on parameters, which are positive: one number or one for each sensor
    "sigma": "Pass the root-mean-square discrepancy expected at the truth, in the units of the data.",
    "correlation_time": "Pass the time in seconds after which the correlation is 1/e.",
    "m": "Pass how many independent observations a sensor's misfit is worth: 1 is TN, 2 is EXP.",
    "dt": "Pass the sampling interval in seconds.",
}


def as_response(mu):
    """Return mu as a tensor; refuse scalars."""
    mu = as_tensor(mu, "mu", "Pass what `response` returned.")
    if mu.ndim < 1:
        raise ValueError("`mu` must be (..., sensor, time), got a scalar. Pass what `response` returned.")
    if 0 in mu.type.shape:
        raise ValueError(f"`mu` must be (..., sensor, time), got shape {mu.type.shape}, without samples.")
    return mu


def check_parameter(name, value, mu):
    """Return a parameter of `ADVICE` as a tensor; refuse numbers not positive or not one for each sensor."""
    tensor = _check_positive(name, value)
    sensors = mu.type.shape[-2] if mu.ndim > 1 else None
    n_values = tensor.type.shape[-1] if tensor.ndim else None
    if None not in (sensors, n_values) and n_values not in (1, sensors):
        expected = f"a scalar or have one value for each of the {sensors} sensors"
        raise ValueError(message(name, expected, n_values))
    return tensor


def check_dt(dt, mu):
    """Return the sampling step [s] as a tensor, that of the response unless it is given."""
    step = response_step(as_response(mu))
    if dt is None and step is None:
        raise ValueError(
            "`dt` must be given where `mu` is not a response of fixed output step, got None. Pass the "
            "sampling interval in seconds."
        )
    tensor = _check_positive("dt", step if dt is None else dt)
    if tensor.ndim:
        raise ValueError(
            f"`dt` must be one number, got {tensor.ndim} dimensions. Pass the sampling interval."
        )
    if step is not None and isinstance(tensor, Constant) and not np.isclose(tensor.data, step, rtol=1e-6):
        raise ValueError(
            f"`dt` must be the output step of the response, {step:g} s, got {float(tensor.data):g}. Leave it "
            "out, or pass the `dt` of the data to `response`."
        )
    return tensor


def _check_positive(name, value):
    """Return a tensor; refuse numbers that are not positive and finite."""
    tensor = positive_tensor(value, name, ADVICE[name])
    if 0 in tensor.type.shape:
        raise ValueError(message(name, "one number or several", "none", ADVICE[name]))
    return tensor


def prepare_observed(mu, observed, name, dims, *, gaps=False, **parameters):
    """Return the data and the names of their axes, checked against `mu` and parameters of each sensor.

    With `gaps` they may have NaN, or be masked. As a shared variable they reach the density as they are: NaN
    in an array PyMC would impute silently, as free variables.
    """
    mu, observed = as_response(mu), by_labels(observed, dims)
    _check_times(observed, response_step(mu))
    is_graph = isinstance(observed, Variable)
    if is_graph:
        as_tensor(observed, "observed")
        _check_dimensions(mu, shape_of(observed))
        _check_is_data(observed)
        values = _values(observed)
    else:
        if np.ma.isMaskedArray(observed) and np.ma.getmaskarray(observed).any():
            if not gaps:
                raise ValueError(f"`observed` must have no missing values, got a masked array. {COMPLETE}")
            observed = masked_as_nan(observed)
        observed = values = np.array(as_numbers(observed, "observed"))
        _check_dimensions(mu, values.shape)
    _check_values(values, gaps)
    check_shape(mu.type.shape, shape_of(observed))
    if not is_graph and (values.nbytes > LARGE_CONSTANT or np.isnan(values).any()):
        observed = pytensor.shared(values, name=f"{name}_data", shape=values.shape)
    dims = check_dims(dims, observed.ndim)
    for parameter, value in parameters.items():
        ndim = as_tensor(value, parameter).ndim
        if ndim > mu.ndim - 1:  # several likelihoods
            expected = "a scalar or have one value for each sensor of `observed`"
            raise ValueError(message(parameter, expected, f"{ndim} dimensions"))
    return observed, dims


def _check_times(observed, step):
    """Refuse labels of times [s] at another step than that of the response, where both are known."""
    times = getattr(observed, "indexes", {}).get("time", ())
    if step is None or len(times) < 2 or times.dtype.kind not in "fmM":  # whole numbers count samples
        return
    own = np.diff(np.asarray(times)).mean()
    own = own / np.timedelta64(1, "s") if times.dtype.kind in "mM" else float(own)
    if observed["time"].attrs.get("units", "s") == "s" and abs(own - step) > 0.01 * step:
        raise ValueError(
            f"`observed` must have the step of the response, {step:g} s, got times {own:g} s apart. Pass "
            f"dt={own:g} to `response`, or observed.values."
        )


def _check_dimensions(mu, shape):
    if len(shape) != mu.ndim:
        expected = f"have {mu.ndim} dimensions (..., sensor, time) to match `mu`"
        raise ValueError(f"`observed` must {expected}, got shape {shape}.")


def _check_is_data(variable):
    """Refuse what has no value, or another at each draw."""
    for v in ancestors([variable]):
        known = isinstance(v, Constant | SharedVariable)
        random = v.owner is not None and isinstance(v.owner.op, RandomVariable | SymbolicRandomVariable)
        if random or (v.owner is None and not known):
            got = f"{'the random variable' if random else 'the input'} {v}"
            raise TypeError(message("observed", "an array or pm.Data", got))


def _check_values(values, gaps):
    if values is None:
        return
    wrong = np.isinf(values) if gaps else ~np.isfinite(values)
    if wrong.any():
        position = tuple(int(i[0]) for i in np.nonzero(wrong))
        advice = "Pass NaN where nothing was measured." if gaps else COMPLETE
        got = f"{values[position]} at index {position} of (sensor, time)"
        raise ValueError(message("observed", "finite", got, advice))
    silent = np.argwhere(np.isnan(values).all(axis=-1)) if values.ndim else []
    if len(silent):
        raise ValueError(
            f"`observed` must have data of every sensor, got NaN alone at sensor {silent[0].tolist()}. Leave "
            "it out."
        )


def _values(variable):
    """Data behind a constant or shared variable, else None."""
    if isinstance(variable, SharedVariable):
        return np.asarray(variable.get_value(borrow=True))
    return np.asarray(variable.data) if isinstance(variable, Constant) else None


def shape_of(data):
    """Shape of an array or a variable, as far as it is known."""
    values = _values(data) if isinstance(data, Variable) else data
    return data.type.shape if values is None else values.shape


def warn_about_the_posterior(likelihood, m, mu, sigma, observed):
    """Warn of posteriors without a finite variance and of data without noise.

    Parameters
    ----------
    likelihood : str
        Its name.
    m : tensor_like () or (sensor,)
        Degrees of freedom of each sensor; only numbers raise the question of the variance.
    mu, sigma, observed
        As passed by the user. A constant sigma raises no question.
    """
    sigma = as_tensor(sigma, "sigma")
    if isinstance(sigma, Constant):
        return
    mu = as_response(mu)
    n_sensors = shape_of(pt.as_tensor_variable(observed))[-2] if mu.ndim > 1 else 1
    m = as_tensor(m, "m")
    if n_sensors is not None and isinstance(m, Constant):
        warn_about_variance(likelihood, np.broadcast_to(m.data, n_sensors), sigma)
    _warn_about_noise(mu, observed)


def warn_about_variance(likelihood, m, sigma):
    """Warn if the degrees of freedom m (sensor,) of all leave no finite variance.

    Each sigma integrates out to S^(-(m - 1)/2); the tail is normalisable in variance above 3.
    """
    alone = sigma.ndim > 0 and sigma.type.shape[-1] != 1
    n_sensors = len(m)
    tail = (m - 1).sum() if alone else m.sum() - 1
    if tail > 3:
        return
    shared = "a sigma for each sensor" if alone else "one sigma"
    consequence = (
        "carry no information on the parameters once sigma is integrated out"
        if tail <= 0
        else "have a posterior without a finite variance but the prior's"
    )
    warn_caller(
        f"{n_sensors} sensor{'s' if n_sensors > 1 else ''} with {shared} {consequence} under {likelihood}. "
        "Add sensors, share sigma among them, fix sigma, or give it an informative prior.",
        FeatureLikelihoodWarning,
    )


def _warn_about_noise(mu, observed):
    """Warn if the response at the model's initial point equals the data: sigma then runs to zero.

    A structure's response is computed only where data of such structures were made before, which compiled
    the functions for it; else they would be compiled for this alone, for 6 to 9 s.
    """
    if not was_simulated(mu):
        return
    if (values := cheap_values_at_start([mu])) is None:
        return
    data = _values(pt.as_tensor_variable(observed))
    misfit = mean_square_discrepancy(values[0], data)
    power = np.nanmean(np.square(data), axis=-1)
    if (power > 0).any() and (misfit[power > 0] <= NOISE_FREE * power[power > 0]).all():
        warn_caller(
            "`observed` equals the response at the model's initial point: the data have no noise. The "
            "discrepancy can vanish, and the posterior of sigma then runs to zero and that of the "
            "parameters to a point. Add the measurement noise, or fix sigma.",
            FeatureLikelihoodWarning,
        )
