"""Matching of identified modes with those of a model: assurance criterion, assignment, and the density in it.

The random variable behind `ModalFeature` has, for each identification, the frequency, the damping ratio where
it is compared, and then the shape.
"""

from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from pymc.distributions.dist_math import check_parameters
from pymc.distributions.distribution import SymbolicRandomVariable
from pymc.distributions.shape_utils import maybe_resize, rv_size_is_none
from pymc.logprob.abstract import _logprob
from pymc.pytensorf import normalize_rng_param
from pytensor.graph.basic import Apply, Variable
from pytensor.tensor import TensorVariable
from pytensor.tensor.linalg import cholesky, solve_triangular
from pytensor.tensor.random.utils import normalize_size_param
from scipy.optimize import linear_sum_assignment

from pymc_features.ops.arrays import ArrayOp
from pymc_features.ops.batches import take_batches
from pymc_features.ops.numba_dispatch import run_in_python

UNMATCHED = -1e30  # stands for a log-density of -inf in sums of which the largest is sought
IMPOSSIBLE = 1e100  # what a cost that is infinite or NaN counts as


def one_minus_mac(shapes, parts, known):
    """1 - MAC (..., m) of parts (..., s) of measured shapes, 1 where they are `known`, and shapes (m, s)."""
    products = sum(pt.sqr(pt.dot(part, shapes.T)) for part in parts)
    own = sum(pt.sum(pt.sqr(part), axis=-1) for part in parts)[..., None]
    norms = own * pt.dot(known, pt.sqr(shapes).T)
    there = pt.gt(norms, 0.0)
    mac = products / pt.switch(there, norms, 1.0)
    has_shape = pt.gt(pt.sum(known, axis=-1), 0.0)[..., None]
    return pt.switch(has_shape, pt.switch(there, 1.0 - mac, 1.0), 0.0)


class Assignment(ArrayOp):
    """Ones where a row takes a column, each its own, at the largest total score; zeros elsewhere.

    Scores (..., row, column), with any number of leading batch dimensions and rows <= columns; -inf and NaN
    are taken last. Constant between the points where the best assignment changes: its derivative is zero.
    """

    def make_node(self, score):
        score = pt.as_tensor_variable(score).astype("float64")
        return Apply(self, [score], [score.type()])

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


take_batches(Assignment)
run_in_python(Assignment)


class Parameters(NamedTuple):
    """Parameters of the random variable, for g modes with up to k identifications at s channels."""

    frequencies: TensorVariable  # (m,) of the model [Hz]
    ratios: TensorVariable  # (m,), or (0,) where damping ratios are not compared
    shapes: TensorVariable  # (m, s)
    sigma_f: TensorVariable  # (g,), errors of the model: of ln f
    sigma_zeta: TensorVariable  # (g,), of ln zeta
    sigma_phi: TensorVariable  # (g,), of shapes
    degrees: TensorVariable  # (g,), of freedom of 1 - MAC
    sd_f: TensorVariable  # (g, k), scatter of ln f^
    sd_zeta: TensorVariable  # (g, k), of ln zeta^; or (g, 0)
    scatter: TensorVariable  # (g, k), mean squares of shapes of length one; or (g, k s), of each entry
    known: TensorVariable  # (g, c), 1 where an entry of the data is known
    match: TensorVariable  # (g, m), 1 at the mode of the model that draws are of

    @property
    def by_entry(self) -> bool:
        """Whether each entry of a shape has a scatter of its own."""
        return self.scatter.type.shape[-1] != self.sd_f.type.shape[-1]

    def split(self, rows) -> tuple[TensorVariable, TensorVariable | None, list[TensorVariable]]:
        """Frequencies and damping ratios (..., k), and real (and imaginary) parts (..., k, s) of shapes."""
        k, s = self.sd_f.type.shape[-1], self.shapes.type.shape[-1]
        n, damped = self.known.type.shape[-1] // k, self.sd_zeta.type.shape[-1] > 0
        rows = rows.reshape((*rows.shape[:-1], k, n))
        parts = [rows[..., i : i + s] for i in range(1 + damped, n, s)] if s else []
        return rows[..., 0], rows[..., 1] if damped else None, parts


class ModalFeatureRV(SymbolicRandomVariable):
    """Identified modes, one in each row: frequency, damping ratio and shape of each identification."""

    name = "ModalFeature"
    extended_signature = "[rng],[size],(m),(z),(m,s),(),(),(),(),(k),(y),(e),(c),(m)->[rng],(c)"
    _print_name = ("ModalFeature", "\\operatorname{ModalFeature}")

    @classmethod
    def rv_op(
        cls, *parameters: TensorVariable, size: TensorVariable | None = None, rng: Variable | None = None
    ) -> TensorVariable:
        """Build draws: ln f and ln zeta normal; shapes as `drawn_shapes` says; `parameters` are `Parameters`.

        Where a mode has several identifications, the error of the model is drawn once for all of them.
        """
        p = Parameters(*map(pt.as_tensor_variable, parameters))
        rng, size = normalize_rng_param(rng), normalize_size_param(size)
        full_size = tuple(p.degrees.shape) if rv_size_is_none(size) else tuple(size)
        k, next_rng, drawn = p.sd_f.type.shape[-1], rng, []
        there, damped, masks = p.split(p.known)
        logs = [(p.frequencies, p.sigma_f, p.sd_f, there)]
        logs += [] if damped is None else [(p.ratios, p.sigma_zeta, p.sd_zeta, damped)]
        for model, sigma, sd, known in logs:
            next_rng, z = pt.random.normal(size=(*full_size, 1 + k), rng=next_rng, return_next_rng=True)
            shared, each = variances(sigma, sd, known)
            error = pt.sqrt(shared) * z[..., :1] + pt.sqrt(each) * z[..., 1:]
            values = pt.dot(p.match, model)[..., None] * pt.exp(error)
            drawn.append(pt.switch(known > 0.0, values, 0.0)[..., None])
        if masks:
            next_rng, shapes = drawn_shapes(p, masks, full_size, next_rng)
            drawn.append(shapes)
        value = pt.concatenate(drawn, axis=-1)
        value = value.reshape((*full_size, p.known.type.shape[-1]))
        inputs = [rng, size, *p]
        return cls(inputs=inputs, outputs=[next_rng, value])(*inputs)


def drawn_shapes(p: Parameters, masks, full_size, rng):
    """Shapes (..., k, s) of the modes that are matched, with errors.

    By entry, of a root mean square of one before the errors; else of length one, at a distance by the law of
    1 - MAC, in any direction alike.
    """
    k, s = masks[0].type.shape[-2:]
    unit = normalised(pt.dot(p.match, p.shapes)[..., None, :] * masks[0])
    if p.by_entry:
        shared, each = entry_variances(p, masks[0])
        rng, normal = pt.random.normal(size=(*full_size, 1 + k, s), rng=rng, return_next_rng=True)
        error = pt.sqrt(shared) * normal[..., :1, :] + pt.sqrt(each) * normal[..., 1:, :]
        return rng, masks[0] * (unit * pt.sqrt(pt.sum(masks[0], axis=-1, keepdims=True)) + error)
    shared, each = (pt.sqrt(v)[..., None] for v in shape_variances(p))
    rng, chi_square = pt.random.gamma(
        0.5 * p.degrees[..., None], scale=2.0, size=(*full_size, 1 + k), rng=rng, return_next_rng=True
    )
    size = (*full_size, 1 + k, s * len(masks))
    rng, normal = pt.random.normal(size=size, rng=rng, return_next_rng=True)
    directions = [
        normalised(
            pt.concatenate(
                [across(normal[..., rows, i * s : (i + 1) * s] * masks[0], unit) for i in range(len(masks))],
                axis=-1,
            )
        )
        for rows in (slice(0, 1), slice(1, None))
    ]
    length = pt.sqrt(chi_square)[..., None]
    off = shared * length[..., :1, :] * directions[0] + each * length[..., 1:, :] * directions[1]
    e = pt.sum(pt.sqr(off), axis=-1, keepdims=True)
    unit = pt.concatenate([unit, *(pt.zeros_like(unit) for _ in masks[1:])], axis=-1)
    return rng, pt.sqrt(1.0 - pt.minimum(e, 1.0)) * unit + off / pt.sqrt(pt.maximum(e, 1.0))


def split_error(sigma, own, several):
    """Variances that the identifications of a mode share, and `own` ones of each: the error of the model.

    Where there are several it is shared by them. Where there is one, it is its own.
    """
    return pt.switch(several, pt.sqr(sigma), 0.0), own + pt.switch(several, 0.0, pt.sqr(sigma))


def variances(sigma, sd, there):
    """Shared (..., 1) and own (..., k) variances of logarithms."""
    return split_error(sigma[..., None], pt.sqr(sd), pt.sum(there, axis=-1, keepdims=True) > 1.0)


def shape_variances(p: Parameters):
    """Variances of shapes, for each degree of freedom: the scatter of lone ones is zero."""
    sigma, scatter = p.sigma_phi[..., None], p.scatter > 0.0
    several = pt.any(scatter, axis=-1, keepdims=True)
    shared, own = split_error(sigma, p.scatter / p.degrees[..., None], several)
    return shared, pt.switch(scatter, own, pt.sqr(sigma))


def entry_variances(p: Parameters, mask):
    """Shared (..., 1, 1) and own (..., k, s) variances of entries of a root mean square of one, 1 of none."""
    several = pt.sum(pt.any(mask > 0.0, axis=-1), axis=-1)[..., None, None] > 1
    scatter = p.scatter.reshape((*p.scatter.shape[:-1], *mask.type.shape[-2:]))
    shared, own = split_error(p.sigma_phi[..., None, None], scatter, several)
    return shared, pt.switch(mask > 0.0, own, 1.0)


def normalised(rows):
    """Rows of length one; rows of zeros stay."""
    squares = pt.sum(pt.sqr(rows), axis=-1, keepdims=True)
    return rows / pt.sqrt(pt.switch(squares > 0.0, squares, 1.0))


def across(rows, unit):
    """Part of each row that is orthogonal to rows of length one."""
    return rows - pt.sum(rows * unit, axis=-1, keepdims=True) * unit


def log_densities(value, p: Parameters):
    """Log-density (..., g, m) of the identifications of each mode, were they of each mode of the model."""
    f, zeta, parts = p.split(value)
    there, damped, masks = p.split(p.known)
    density = log_normal(f, p.frequencies, p.sigma_f, p.sd_f, there)
    if zeta is not None:
        density = density + log_normal(zeta, p.ratios, p.sigma_zeta, p.sd_zeta, damped)
    if parts and p.by_entry:
        density = density + log_density_of_entries(parts[0], p, masks[0])
    elif parts:
        density = density + log_density_of_shapes(parts, p, masks[0])
    return pt.switch(density > -np.inf, density, -np.inf)  # nor a gradient of what is impossible


def log_normal(values, model, sigma, sd, there):
    """Log-density (..., g, m) of the logarithms of values (..., g, k) about those of the model (..., m).

    -inf where the model has none: NaN, and zero of a rigid body or without damping.
    """
    exists = pt.gt(model, 0.0)
    x = pt.log(pt.switch(there > 0.0, values, 1.0))[..., None, :]
    x = x - pt.log(pt.switch(exists, model, 1.0))[..., None, :, None]
    shared, each = (v[..., None, :] for v in variances(sigma, sd, there))
    known = there[..., None, :]
    squares, common = compound_symmetric(x, shared, each, known, axis=-1)
    own = pt.sum(known * pt.log(2.0 * np.pi * each), axis=-1)
    possible = exists[..., None, :] | (pt.sum(known, axis=-1) < 1.0)
    return pt.switch(possible, -0.5 * (squares + own + pt.log(common)), -np.inf)


def log_density_of_shapes(parts, p: Parameters, mask):
    """Log-density (..., g, m) of measured shapes, real and perhaps imaginary parts (..., g, k, s).

    Channel by channel normal with a compound-symmetric covariance; all channels of an identification count
    as its degrees of freedom.
    """
    mask, model = mask[..., None, :, :], p.shapes[..., None, :, None, :]
    shared, each = (v[..., None, :, None] for v in shape_variances(p))
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
    m = p.degrees[..., None]
    constant = -0.5 * m * np.log(2.0) - pt.gammaln(0.5 * m + 1.0)
    return pt.sum(has_shape, axis=(-2, -1)) * constant - 0.5 * (m * log_size + squares)


def log_density_of_entries(part, p: Parameters, mask):
    """Log-density (..., g, m) of the parts of measured shapes (..., g, k, s) across those of the model.

    x_i = a_i u_i + b + n_i, of a root mean square of one, with u_i of length one at the channels of x_i. Each
    a_i has a flat density; C is the covariance of b + n, compound-symmetric in each channel; d is the part of
    x across u. With r = U' C^-1 d, the result is -1/2 times
    (n - k) ln 2 pi + ln |C| + ln |U' C^-1 U| + d' C^-1 d - r' (U' C^-1 U)^-1 r.
    """
    count = pt.sum(mask, axis=-1)
    x = normalised(part) * pt.sqrt(count)[..., None]
    spoilt = pt.any(pt.isnan(p.shapes), axis=-1)  # no structure
    model = pt.switch(spoilt[..., None], 0.0, p.shapes)[..., None, :, None, :]
    x, mask = x[..., None, :, :], mask[..., None, :, :]
    u = normalised(model * mask)
    d = across(x, u)
    shared, each = (v[..., None, :, :] for v in entry_variances(p, mask[..., 0, :, :]))
    squares, common = compound_symmetric(d, shared, each, mask, axis=-2)
    weights = mask / each
    shrunk = shared[..., 0, :] / common
    wu = weights * u
    mean = shrunk * pt.sum(weights * d, axis=-2)
    r = pt.sum(wu * (d - mean[..., None, :]), axis=-1)
    gram = pt.sum(wu * u, axis=-1)
    has_shape = pt.gt(pt.sum(pt.sqr(u), axis=-1), 0.0)
    if (k := mask.type.shape[-2]) == 1:
        gram = pt.switch(has_shape, gram - pt.sum(shrunk[..., None, :] * pt.sqr(wu), axis=-1), 1.0)
        of_scale = pt.log(gram) - pt.sqr(r) / gram
    else:
        both = pt.sum(shrunk[..., None, None, :] * wu[..., :, None, :] * wu[..., None, :, :], axis=-1)
        gram = pt.eye(k) * pt.switch(has_shape, gram, 1.0)[..., None] - both
        root = cholesky(gram)
        r = solve_triangular(root, r[..., None], lower=True, b_ndim=2)[..., 0]
        of_scale = 2.0 * pt.log(pt.diagonal(root, axis1=-2, axis2=-1)) - pt.sqr(r)
    free = pt.sum(count - (count > 0.0), axis=-1)[..., None]
    log_size = pt.sum(mask * pt.log(each), axis=(-2, -1)) + pt.sum(pt.log(common), axis=-1)
    squares = pt.sum(squares, axis=-1) + pt.sum(of_scale, axis=-1)
    density = -0.5 * (free * np.log(2.0 * np.pi) + log_size + squares)
    return pt.switch(spoilt[..., None, :], -np.inf, density)


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
    _, size, *parameters = inputs
    p = Parameters(*parameters)
    density = log_densities(value, p)
    logp = pt.sum(pt.switch(matched(density) > 0.5, density, 0.0), axis=-1)
    of_shapes = p.sigma_phi
    if p.by_entry:
        known = pt.concatenate(p.split(p.known)[2], axis=-1).reshape(p.scatter.shape)
        of_shapes = pt.sqr(p.sigma_phi)[..., None] + pt.switch(known > 0.0, p.scatter, 1.0)
    logp = check_parameters(
        logp,
        pt.sqr(p.sigma_f)[..., None] + pt.sqr(p.sd_f) > 0,
        pt.sqr(p.sigma_zeta)[..., None] + pt.sqr(p.sd_zeta) > 0,
        of_shapes > 0,
        p.degrees > 0,
        msg="sigma_f > 0, sigma_zeta > 0, sigma_phi > 0, density > 0",
    )
    return maybe_resize(logp, size)
