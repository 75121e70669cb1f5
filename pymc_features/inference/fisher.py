"""Fisher information: what data can tell, before there are any."""

from functools import singledispatch

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from pymc.pytensorf import compile as compile_function
from pytensor.gradient import disconnected_grad, pullback, pushforward
from pytensor.graph.replace import graph_replace
from pytensor.tensor.random.basic import NormalRV

from pymc_features._checks import check_model
from pymc_features.inference.parameters import check_continuous, entry_names, initial_values
from pymc_features.likelihoods.correlated import CorrelatedNormalRV
from pymc_features.likelihoods.mean_square import FeatureRV
from pymc_features.ops import measured_samples
from pymc_features.smc.density.rows import with_mode


@singledispatch
def informative(op, rv, observed):
    """Return pairs (quantity, information on each entry of it), both tensors.

    `observed` (tensor) are the data, of which the shape counts, and where they have gaps.

    Register a distribution's Op to make `fisher_information` know it.
    """
    raise TypeError(
        "`model` must have Normal, CorrelatedNormal, TruncNormalFeature or ExpFeature likelihoods, got "
        f"{type(op).__name__} ({rv.name}). Register it with pymc_features.inference.fisher.informative, or "
        "use laplace()."
    )


@informative.register(NormalRV)
def informative_normal(op, rv, observed):
    """1 / sigma^2 on the mean and 2 on ln sigma, for each observation."""
    mu, sigma = (pt.broadcast_to(x, tuple(observed.shape)) for x in op.dist_params(rv.owner))
    return [(mu, 1.0 / pt.sqr(sigma)), (pt.log(sigma), pt.full_like(sigma, 2.0))]


@informative.register(FeatureRV)
def informative_feature(op, rv, observed):
    """1 / (N_D sigma^2) on the response and 2 m on ln sigma, for each sensor; N_D are those measured."""
    if op.density != "feature":
        raise ValueError(f"`model` must have likelihoods with density='feature', got 'data' ({rv.name}).")
    _, _, mu, sigma, *m = rv.owner.inputs
    shape, n_measured = tuple(observed.shape), measured_samples(observed)
    mu = pt.broadcast_to(mu, shape)
    sigma = pt.broadcast_to(sigma, shape[:-1])
    weight = 1.0 / ((shape[-1] if n_measured is None else n_measured) * pt.sqr(sigma))
    weight = pt.broadcast_to(weight[..., None], shape)
    return [
        (mu, weight if n_measured is None else pt.switch(pt.isnan(observed), 0.0, weight)),
        (pt.log(sigma), pt.broadcast_to(2.0 * op.degrees(*m), sigma.shape)),
    ]


@informative.register(CorrelatedNormalRV)
def informative_correlated(op, rv, observed):
    """1 on each entry of the whitened response; on the scales and on phi, what each new sample adds."""
    _, _, mu, sigma, correlation_time, dt = rv.owner.inputs
    shape = tuple(observed.shape)
    mu = pt.broadcast_to(mu, shape)
    sigma, decay = (pt.broadcast_to(x, shape[:-1]) for x in (sigma, dt / correlation_time))
    phi, share = pt.exp(-decay), -pt.expm1(-2.0 * decay)  # share of the variance that is new in each sample
    innovation = sigma * pt.sqrt(share)
    fixed_sigma, fixed_phi, fixed_innovation = (disconnected_grad(x) for x in (sigma, phi, innovation))
    first = mu[..., 0] / fixed_sigma
    later = (mu[..., 1:] - fixed_phi[..., None] * mu[..., :-1]) / fixed_innovation[..., None]
    return [
        (first, pt.ones_like(first)),
        (later, pt.ones_like(later)),
        (pt.log(sigma), pt.full_like(sigma, 2.0)),
        (pt.log(innovation), pt.full_like(sigma, 2.0) * (shape[-1] - 1)),
        (phi, (shape[-1] - 1) / share),
    ]


def fisher_information(model: pm.Model | None = None, point: dict | None = None) -> xr.Dataset:
    """Expected information of the likelihoods on the free parameters, at a point.

    I = sum J' W J, with J the derivatives of response and ln sigma and W what the likelihood tells of these:
    under TN and EXP 1 / (N_D sigma^2) on each sample of the response, so that the information does not grow
    with the sampling rate; under a Normal 1 / sigma^2; under a CorrelatedNormal the inverse covariance, whose
    information settles as the rate grows. Priors are left out. No data are used but their shape and their
    gaps, NaN, about which TN, EXP and GammaFeature tell nothing.

    Parameters
    ----------
    model : pymc.Model, optional
        The model of the context by default.
    point : dict, optional
        Values of free parameters, in their own units. The model's initial point by default.

    Returns
    -------
    Dataset
        `information` ``(parameter, parameter_)``, in the inverse of the parameters' units;
        `standard_deviation` (parameter), the Cramer-Rao bound, infinite where the data tell nothing;
        `eigenvalue` (direction), descending, and `direction_vector` (direction, parameter) of the
        information on relative changes of the parameters: directions with an eigenvalue near 0 cannot be
        identified, one over the root of it is the relative standard deviation; `point` (parameter).

    Raises
    ------
    TypeError, ValueError
        If a likelihood is not known, or the model has discrete parameters.

    Notes
    -----
    One forward and one reverse derivative for each parameter; no Jacobian is stored. The forward ones are
    differences of two responses, which make the information right to 1e-5 of nonlinear chains, and to 1e-6 of
    linear structures (`simulators/oscillators/differences.py`).

    Examples
    --------
    >>> with pm.Model():
    ...     x = pm.Normal("x", 2.0, 1.0)
    ...     y = pm.Normal("y", 3.0 * x, 0.5, observed=[1.0, 2.0])
    ...     information = fisher_information()
    >>> information["information"].values.round(6)
    array([[72.]])
    """
    model = check_model(model)
    check_continuous(model, "fisher_information()")
    values = initial_values(model, point)
    function = product_function(model)
    names = [name for rv in model.free_RVs for name in entry_names(rv.name, values[rv.name].shape)]
    x = np.concatenate([v.ravel() for v in values.values()])
    information = np.array([function(*values.values(), row) for row in np.eye(len(x))])
    if not np.isfinite(information).all():
        raise ValueError(
            f"`point` must describe a structure with a finite response, got {values}. Pass another one."
        )
    return describe(0.5 * (information + information.T), x, names)


def product_function(model):
    """Compile (values of the free parameters, direction) -> I direction, flat."""
    rvs = model.free_RVs
    pairs = [
        pair for rv in model.observed_RVs for pair in informative(rv.owner.op, rv, model.rvs_to_values[rv])
    ]
    inputs = [rv.type(name=rv.name) for rv in rvs]
    flat = graph_replace(
        [tensor for pair in pairs for tensor in pair], dict(zip(rvs, inputs, strict=True)), strict=False
    )
    direction = pt.vector("direction")
    tangents, first = [], 0
    for x in inputs:
        size = pt.prod(x.shape, dtype="int64")
        tangents.append(pt.specify_shape(direction[first : first + size].reshape(x.shape), x.type.shape))
        first = first + size
    quantities, weights = flat[::2], flat[1::2]
    moved = pushforward(
        quantities, inputs, tangents, disconnected_outputs="ignore", return_disconnected="zero"
    )
    back = pullback(
        quantities,
        inputs,
        [w * d for w, d in zip(weights, moved, strict=True)],
        disconnected_inputs="ignore",
        return_disconnected="zero",
    )
    product = pt.concatenate([g.ravel() for g in back])
    return compile_function(
        [*inputs, direction], product, **with_mode({"on_unused_input": "ignore"}, [product])
    )


def describe(information: np.ndarray, x: np.ndarray, names: list[str]) -> xr.Dataset:
    """Bounds and directions of an information matrix (d, d) at x (d,)."""
    scale = np.where(x == 0.0, 1.0, np.abs(x))
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    eigenvalues, vectors = np.maximum(eigenvalues[::-1], 0.0), vectors[:, ::-1]
    lost = eigenvalues <= 1e-13 * eigenvalues[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.where(lost, np.where(np.abs(vectors) > 1e-6, np.inf, 0.0), vectors**2 / eigenvalues)
    return xr.Dataset(
        {
            "information": (("parameter", "parameter_"), information),
            "standard_deviation": ("parameter", scale * np.sqrt(parts.sum(axis=1))),
            "eigenvalue": ("direction", eigenvalues),
            "direction_vector": (("direction", "parameter"), vectors.T),
            "point": ("parameter", x),
        },
        coords={"parameter": names, "parameter_": names},
    )
