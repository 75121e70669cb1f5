"""Matching of identified modes with those of a model: assurance criterion, assignment, and the density in it.

The random variable behind `ModalFeature` has, for each identified mode, the frequency and then the shape.
"""

import numpy as np
import pytensor.tensor as pt
from pymc.distributions.dist_math import check_parameters
from pymc.distributions.distribution import SymbolicRandomVariable
from pymc.distributions.shape_utils import maybe_resize, rv_size_is_none
from pymc.logprob.abstract import _logprob
from pymc.pytensorf import normalize_rng_param
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor import TensorVariable
from pytensor.tensor.random.utils import normalize_size_param
from scipy.optimize import linear_sum_assignment

from pymc_features.ops.numba_dispatch import run_in_python

UNMATCHED = -1e30  # stands for a log-density of -inf in sums of which the largest is sought
IMPOSSIBLE = 1e100  # what a cost that is infinite or NaN counts as


def one_minus_mac(shapes, parts, known):
    """1 - MAC of each measured shape and each of the model, a tensor (..., m).

    Parameters
    ----------
    shapes : tensor (m, s)
        Of the model, real.
    parts : list of tensor (..., s)
        Real, and imaginary, part of the measured shapes, zero where an entry is missing.
    known : tensor (..., s)
        1 where an entry is known; rows of zeros are shapes that are missing, and give zero.
    """
    products = sum(pt.sqr(pt.dot(part, shapes.T)) for part in parts)
    own = sum(pt.sum(pt.sqr(part), axis=-1) for part in parts)[..., None]
    norms = own * pt.dot(known, pt.sqr(shapes).T)
    there = pt.gt(norms, 0.0)
    mac = products / pt.switch(there, norms, 1.0)
    has_shape = pt.gt(pt.sum(known, axis=-1), 0.0)[..., None]
    return pt.switch(has_shape, pt.switch(there, 1.0 - mac, 1.0), 0.0)


class Assignment(Op):
    """Ones where a row takes a column, each its own, at the largest total score; zeros elsewhere.

    Scores (..., row, column), with any number of leading batch dimensions and rows <= columns; -inf and NaN
    are taken last. Constant between the points where the best assignment changes: its derivative is zero.
    """

    __props__ = ()

    def make_node(self, score):
        score = pt.as_tensor_variable(score).astype("float64")
        if score.ndim < 2:
            raise ValueError(f"`score` must be (..., row, column), got {score.ndim} dimensions.")
        return Apply(self, [score], [score.type()])

    def perform(self, node, inputs, output_storage):
        [output_storage[0][0]] = self.run(inputs)

    def run(self, inputs) -> tuple[np.ndarray]:
        """The assignments of arrays."""
        [score] = inputs
        rows, columns = score.shape[-2:]
        if rows > columns:
            raise ValueError(f"an assignment must have as many columns as rows, got {columns} for {rows}.")
        cost, chosen = np.where(np.abs(score) < IMPOSSIBLE, -score, IMPOSSIBLE), np.zeros(score.shape)
        for own, taken in zip(*(x.reshape(-1, rows, columns) for x in (cost, chosen)), strict=True):
            taken[linear_sum_assignment(own)] = 1.0
        return (chosen,)

    def infer_shape(self, node, shapes):
        return shapes

    def pullback(self, inputs, outputs, cotangents):
        """Zero."""
        return [pt.zeros_like(inputs[0])]


@_vectorize_node.register(Assignment)
def vectorize_assignment(op, node, score):
    """Assign a batch."""
    return [op(score)]


run_in_python(Assignment)


class ModalFeatureRV(SymbolicRandomVariable):
    """Identified modes, one in each row: of each of its identifications the frequency, then the shape."""

    name = "ModalFeature"
    extended_signature = "[rng],[size],(m),(m,s),(),(),(),(k),(k),(c),(m)->[rng],(c)"
    _print_name = ("ModalFeature", "\\operatorname{ModalFeature}")

    @classmethod
    def rv_op(
        cls, *parameters: TensorVariable, size: TensorVariable | None = None, rng: Variable | None = None
    ) -> TensorVariable:
        """Build draws: ln f normal; shapes at a distance by the feature's law, in any direction alike.

        Where a mode has several identifications, the error of the model is drawn once for all of them.
        `parameters` are frequencies (m,) and shapes (m, s) of the model; its error (g,), standard deviation
        of ln f, scale and degrees of freedom of 1 - MAC; the scatter (g, k) of `Identified`; 1 where an entry
        of `by_label` is known (g, c); which mode of the model is drawn for each (g, m).
        """
        parameters = [pt.as_tensor_variable(x) for x in parameters]
        frequencies, shapes, *errors, known, match = parameters
        degrees, k = errors[2], errors[3].type.shape[-1]
        rng, size = normalize_rng_param(rng), normalize_size_param(size)
        full_size = tuple(degrees.shape) if rv_size_is_none(size) else tuple(size)
        there, mask = masks(known, k, shapes)
        of_f, of_shapes = variances(*errors, there)
        rng_1, z = pt.random.normal(size=(*full_size, 1 + k), rng=rng, return_next_rng=True)
        rng_2, chi_square = pt.random.gamma(
            0.5 * degrees[..., None], scale=2.0, size=(*full_size, 1 + k), rng=rng_1, return_next_rng=True
        )
        s = shapes.type.shape[-1]
        p = known.type.shape[-1] // k - 1
        next_rng, normal = pt.random.normal(size=(*full_size, 1 + k, p), rng=rng_2, return_next_rng=True)
        f = pt.dot(match, frequencies)[..., None] * pt.exp(shared_and_each(z, *of_f))
        drawn = [pt.switch(there > 0.0, f, 0.0)[..., None]]
        if p:
            unit = normalised(pt.dot(match, shapes)[..., None, :] * mask)
            noise = [normal[..., i * s : (i + 1) * s] for i in range(p // s)]
            directions = [
                normalised(pt.concatenate([across(x[..., part, :] * mask, unit) for x in noise], axis=-1))
                for part in (slice(0, 1), slice(1, None))
            ]
            shared, each = (pt.sqrt(v)[..., None] for v in of_shapes)
            length = pt.sqrt(chi_square)[..., None]
            off = shared * length[..., :1, :] * directions[0] + each * length[..., 1:, :] * directions[1]
            e = pt.sum(pt.sqr(off), axis=-1, keepdims=True)
            unit = pt.concatenate([unit, *(pt.zeros_like(unit) for _ in noise[1:])], axis=-1)
            drawn.append(pt.sqrt(1.0 - pt.minimum(e, 1.0)) * unit + off / pt.sqrt(pt.maximum(e, 1.0)))
        value = pt.concatenate(drawn, axis=-1).reshape((*full_size, k * (1 + p)))
        inputs = [rng, size, *parameters]
        return cls(inputs=inputs, outputs=[next_rng, value])(*inputs)


def by_identification(rows, k, n):
    """Rows (..., k n) of modes as (..., k, n), an axis for their identifications."""
    return rows.reshape((*rows.shape[:-1], k, n))


def masks(known, k, shapes):
    """Ones where there is an identification (..., k), and where a channel of it is known (..., k, s)."""
    known = by_identification(known, k, known.type.shape[-1] // k)
    return known[..., 0], known[..., 1 : 1 + shapes.type.shape[-1]]


def variances(sigma_f, sigma_phi, degrees, sd, scatter, there):
    """Shared (..., 1) and own (..., k) variances of ln f^; the same, for each degree of freedom, of shapes.

    The error of the model is shared by the identifications of a mode. Where there is one, it is its own.
    """
    of_f, of_shapes = pt.sqr(sigma_f)[..., None], pt.sqr(sigma_phi)[..., None]
    several = pt.sum(there, axis=-1, keepdims=True) > 1.0
    with_shapes = pt.any(scatter > 0.0, axis=-1, keepdims=True)
    return (
        (pt.switch(several, of_f, 0.0), pt.sqr(sd) + pt.switch(several, 0.0, of_f)),
        (
            pt.switch(with_shapes, of_shapes, 0.0),
            pt.switch(scatter > 0.0, scatter / degrees[..., None], of_shapes),
        ),
    )


def shared_and_each(z, shared, each):
    """Normal errors (..., k) of standard normal numbers (..., 1 + k)."""
    return pt.sqrt(shared) * z[..., :1] + pt.sqrt(each) * z[..., 1:]


def normalised(rows):
    """Rows of length one; rows of zeros stay."""
    squares = pt.sum(pt.sqr(rows), axis=-1, keepdims=True)
    return rows / pt.sqrt(pt.switch(squares > 0.0, squares, 1.0))


def across(rows, unit):
    """Part of each row that is orthogonal to rows of length one."""
    return rows - pt.sum(rows * unit, axis=-1, keepdims=True) * unit


def log_densities(value, frequencies, shapes, *errors, known):
    """Log-density (..., g, m) of the identifications of each mode, were they of each mode of the model."""
    k = errors[3].type.shape[-1]
    there, mask = masks(known, k, shapes)
    of_f, of_shapes = variances(*errors, there)
    n = known.type.shape[-1] // k
    value = by_identification(value, k, n)
    exists = pt.gt(frequencies, 0.0)  # neither NaN nor a rigid body
    ln_f = pt.log(pt.switch(exists, frequencies, 1.0))
    x = pt.log(pt.switch(there > 0.0, value[..., 0], 1.0))[..., None, :] - ln_f[..., None, :, None]
    shared, each = (v[..., None, :] for v in of_f)
    there = there[..., None, :]
    squares, common = compound_symmetric(x, shared, each, there, axis=-1)
    own = pt.sum(there * pt.log(2.0 * np.pi * each), axis=-1)
    density = -0.5 * (squares + own + pt.log(common))
    if mask.type.shape[-1]:
        s = mask.type.shape[-1]
        parts = [value[..., 1 + i : 1 + i + s] for i in range(0, n - 1, s)]
        density = density + log_density_of_shapes(parts, shapes, mask, errors[2], of_shapes)
    return pt.switch(exists[..., None, :] & ~pt.isnan(density), density, -np.inf)


def log_density_of_shapes(parts, shapes, mask, degrees, variances):
    """Log-density (..., g, m) of measured shapes, real and perhaps imaginary parts (..., g, k, s).

    Channel by channel normal with a compound-symmetric covariance; all channels of an identification count
    as its degrees of freedom.
    """
    mask, model = mask[..., None, :, :], shapes[..., None, :, None, :]
    shared, each = (v[..., None, :, None] for v in variances)
    own = sum(pt.sum(pt.sqr(x), axis=-1, keepdims=True) for x in parts)[..., None, :, :]
    length = pt.sqrt(pt.switch(own > 0.0, own, 1.0))
    norms = pt.sum(mask * pt.sqr(model), axis=-1, keepdims=True)
    squares = 0.0
    for part in parts:
        x = part[..., None, :, :]
        scale = pt.sum(x * model, axis=-1, keepdims=True) / pt.switch(norms > 0.0, norms, 1.0)
        off = mask * (x - scale * model) / length
        of_part, common = compound_symmetric(off, shared, each, mask, axis=-2)
        squares = squares + pt.sum(of_part, axis=-1)
    channels = pt.sum(mask, axis=-1, keepdims=True)
    has_shape = pt.gt(channels, 0.0)
    of_channel = mask / pt.switch(has_shape, channels, 1.0)
    share = pt.sum(of_channel, axis=-2) / pt.maximum(pt.sum(mask, axis=-2), 1.0)
    log_size = pt.sum(pt.switch(has_shape, pt.log(each), 0.0), axis=(-2, -1))
    log_size = log_size + pt.sum(share * pt.log(common), axis=-1)
    m = degrees[..., None]
    constant = -0.5 * m * np.log(2.0) - pt.gammaln(0.5 * m + 1.0)
    return pt.sum(has_shape, axis=(-2, -1)) * constant - 0.5 * (m * log_size + squares)


def compound_symmetric(x, shared, each, there, axis):
    """x' C^-1 x and |C| / prod(each) of C = shared 1 1' + diag(each), along an axis.

    By Sherman and Morrison about the weighted mean, where nothing cancels; `there` has zeros for entries that
    do not count.
    """
    if each.type.shape[axis] == 1:  # nobody to share with
        return pt.squeeze(there * pt.sqr(x) / each, axis=axis), pt.ones_like(pt.squeeze(there, axis=axis))
    weights = there / each
    total = pt.sum(weights, axis=axis, keepdims=True)
    mean = pt.sum(weights * x, axis=axis, keepdims=True) / pt.switch(total > 0.0, total, 1.0)
    common = 1.0 + shared * total
    squares = pt.sum(weights * pt.sqr(x - mean), axis=axis, keepdims=True) + pt.sqr(mean) * total / common
    return pt.squeeze(squares, axis=axis), pt.squeeze(common, axis=axis)


def matched(density):
    """Ones (..., g, m) where a measured mode takes one of the model, from log-densities (..., g, m).

    Different ones take different modes: such that the sum is largest.
    """
    return Assignment()(pt.switch(pt.isinf(density), UNMATCHED, density))


@_logprob.register(ModalFeatureRV)
def modal_logprob(op, values, *inputs, **kwargs):
    """Log-likelihood of each measured mode, matched such that their sum is largest."""
    [value] = values
    _, size, *parameters, known, _ = inputs
    density = log_densities(value, *parameters, known=known)
    logp = pt.sum(pt.switch(matched(density) > 0.5, density, 0.0), axis=-1)
    _, _, sigma_f, sigma_phi, degrees, sd, _ = parameters
    positive = pt.sqr(sigma_f)[..., None] + pt.sqr(sd) > 0
    logp = check_parameters(
        logp, positive, sigma_phi > 0, degrees > 0, msg="sigma_f > 0, sigma_phi > 0, density > 0"
    )
    return maybe_resize(logp, size)
