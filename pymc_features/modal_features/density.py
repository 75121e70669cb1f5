"""The random variable behind `ModalFeature`: its draws, its density, and the assignment in it."""

import numpy as np
import pytensor.tensor as pt
from pymc.distributions.dist_math import check_parameters
from pymc.distributions.distribution import SymbolicRandomVariable
from pymc.distributions.shape_utils import maybe_resize, rv_size_is_none
from pymc.logprob.abstract import _logprob
from pymc.pytensorf import normalize_rng_param
from pytensor.graph.basic import Variable
from pytensor.tensor import TensorVariable
from pytensor.tensor.random.utils import normalize_size_param

from pymc_features.distributions.gamma import GammaFeatureRV
from pymc_features.modal_features.assignment import Assignment
from pymc_features.modal_features.mac import one_minus_mac

UNMATCHED = -1e30  # stands for a log-density of -inf in sums of which the largest is wanted


class ModalFeatureRV(SymbolicRandomVariable):
    """Identified modes, one in each row: the frequency, then the entries of the shape."""

    name = "ModalFeature"
    extended_signature = "[rng],[size],(m),(m,s),(),(),(),(k),(g,i),(m)->[rng],(c)"
    _print_name = ("ModalFeature", "\\operatorname{ModalFeature}")

    @classmethod
    def rv_op(
        cls, *parameters: TensorVariable, size: TensorVariable | None = None, rng: Variable | None = None
    ) -> TensorVariable:
        """Build draws: ln f normal; shapes at a distance by the feature's law, in any direction alike.

        Parameters
        ----------
        frequencies, shapes : tensor (m,), (m, s)
            Of the model.
        sd, sigma, degrees : tensor (i,)
            Standard deviation of ln f^; sigma_phi and degrees of freedom of 1 - MAC.
        known : tensor (i, k)
            1 where an entry of `Identified.values` behind the frequency is known.
        groups : tensor (g, i)
        match : tensor (i, m)
            Which mode of the model is drawn for each identification.
        """
        parameters = [pt.as_tensor_variable(x) for x in parameters]
        frequencies, shapes, sd, sigma, degrees, known, _, match = parameters
        rng, size = normalize_rng_param(rng), normalize_size_param(size)
        full_size = tuple(sd.shape) if rv_size_is_none(size) else tuple(size)
        rng_1, z = pt.random.normal(0.0, 1.0, size=full_size, rng=rng, return_next_rng=True)
        rng_2, chi_square = pt.random.gamma(
            0.5 * degrees, scale=2.0, size=full_size, rng=rng_1, return_next_rng=True
        )
        k = known.shape[-1]
        next_rng, normal = pt.random.normal(0.0, 1.0, size=(*full_size, k), rng=rng_2, return_next_rng=True)
        drawn = [(pt.dot(match, frequencies) * pt.exp(sd * z))[..., None]]
        if known.type.shape[-1]:
            unit = normalised(pt.dot(match, shapes) * mask_of(known, shapes))
            parts, s = n_parts(known, shapes), shapes.type.shape[-1]
            noise = [(normal * known)[..., i * s : (i + 1) * s] for i in range(parts)]
            other = normalised(pt.concatenate([across(x, unit) for x in noise], axis=-1))
            e = pt.minimum(pt.sqr(sigma) * chi_square, 1.0)[..., None]
            unit = pt.concatenate([unit, *(pt.zeros_like(unit) for _ in range(parts - 1))], axis=-1)
            drawn.append(pt.sqrt(1.0 - e) * unit + pt.sqrt(e) * other)
        inputs = [rng, size, *parameters]
        return cls(inputs=inputs, outputs=[next_rng, pt.concatenate(drawn, axis=-1)])(*inputs)


def n_parts(known, shapes) -> int:
    """1 for real shapes, 2 for complex ones."""
    return known.type.shape[-1] // shapes.type.shape[-1]


def mask_of(known, shapes):
    """Where channels are known, (i, s)."""
    return known[..., : shapes.type.shape[-1]]


def normalised(rows):
    """Rows of length one; rows of zeros stay."""
    squares = pt.sum(pt.sqr(rows), axis=-1, keepdims=True)
    return rows / pt.sqrt(pt.switch(squares > 0.0, squares, 1.0))


def across(rows, unit):
    """What of rows is orthogonal to rows of length one."""
    return rows - pt.sum(rows * unit, axis=-1, keepdims=True) * unit


def log_densities(value, frequencies, shapes, sd, sigma, degrees, known):
    """Log-density (..., i, m) of each identification, were it of each mode of the model."""
    there = pt.gt(frequencies, 0.0)  # neither NaN nor a rigid body
    z = pt.log(value[..., 0])[..., None] - pt.log(pt.switch(there, frequencies, 1.0))[..., None, :]
    density = -0.5 * pt.sqr(z / sd[..., None]) - pt.log(sd)[..., None] - 0.5 * np.log(2.0 * np.pi)
    if known.type.shape[-1]:
        s, mask = shapes.type.shape[-1], mask_of(known, shapes)
        parts = [value[..., 1 + i * s : 1 + (i + 1) * s] for i in range(n_parts(known, shapes))]
        e = one_minus_mac(shapes, parts, mask)
        of_shape = GammaFeatureRV.feature_logp(e, sigma[..., None], degrees[..., None])
        density = density + pt.switch(pt.any(mask > 0.0, axis=-1)[..., None], of_shape, 0.0)
    return pt.switch(there[..., None, :] & ~pt.isnan(density), density, -np.inf)


def matched(density, groups):
    """Ones (..., i, m) where an identification takes a mode, from its log-densities (..., i, m).

    Those of one mode take the same, those of different modes different ones: such that the sum is largest.
    """
    score = pt.matmul(groups, pt.switch(pt.isinf(density), UNMATCHED, density))
    return pt.matmul(groups.T, Assignment()(score))


@_logprob.register(ModalFeatureRV)
def modal_logprob(op, values, *inputs, **kwargs):
    """Log-likelihood of each identification, matched such that their sum is largest."""
    [value] = values
    _, size, *parameters, groups, _ = inputs
    density = log_densities(value, *parameters)
    logp = pt.sum(pt.switch(matched(density, groups) > 0.5, density, 0.0), axis=-1)
    _, _, sd, sigma, degrees, _ = parameters
    logp = check_parameters(
        logp, sd > 0, sigma > 0, degrees > 0, msg="sigma_f > 0, sigma_phi > 0, density > 0"
    )
    return maybe_resize(logp, size)
