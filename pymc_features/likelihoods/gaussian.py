"""NORM without its histories: the Gaussian log-likelihood of a response from mean squares.

`pm.Normal("y", mu=response, sigma=sigma, observed=data)` is the conventional likelihood, Eq. (2). Where
sigma does not vary in time, its sum over the samples depends on the data only through e_j of Eq. (3),

    ln p = sum_j N_D [ -e_j / (2 sigma_j^2) - ln sigma_j - ln(2 pi) / 2 ],

so that compiled log-probabilities need no response history either. The rewrite is part of PyTensor's
default ones and carries the tag `fuse_likelihood`, under which population kernels apply it before they
vectorise a graph.
"""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pymc.logprob.utils import CheckParameterValue
from pytensor.compile import optdb
from pytensor.graph.basic import equal_computations
from pytensor.graph.rewriting.basic import dfs_rewriter, node_rewriter
from pytensor.tensor.basic import Alloc
from pytensor.tensor.math import Sum

from pymc_features.ops import mean_square_discrepancy, measured_samples, response_node


@node_rewriter([Sum])
def fuse_gaussian_likelihood(fgraph, node):
    """Replace the sum of PyMC's Gaussian log-densities of a response by one of mean squares."""
    [x] = node.inputs
    if node.op.axis is not None and tuple(node.op.axis) != (0, 1):
        return None
    if x.owner is not None and isinstance(x.owner.op, Alloc):
        x = x.owner.inputs[0]
    found = gaussian_summand(x)
    if found is None:
        return None
    value, mu, sigma = found
    e = mean_square_discrepancy(mu, value)
    scale = sigma[:, 0]
    n_times = pt.cast(value.shape[1], "float64")
    each = -0.5 * e / pt.sqr(scale) - pt.log(scale) - 0.5 * np.log(2.0 * np.pi)
    failed, n_measured = pt.isnan(e) | pt.isinf(e), measured_samples(value)
    if n_measured is not None:  # here no sample is left out: NaN is no datum
        failed = failed | pt.lt(n_measured, n_times)
    each = pt.switch(failed, -np.inf, n_times * each)
    _, *conditions = x.owner.inputs
    return [x.owner.op(pt.sum(each), *conditions)]


def gaussian_summand(x):
    """Return (value, mu, sigma) if `x` (sensor, time) is the log-density of a response, as PyMC writes it."""
    if x.ndim != 2 or x.owner is None or not isinstance(x.owner.op, CheckParameterValue):
        return None
    try:
        half_square = x.owner.inputs[0].owner.inputs[0].owner.inputs[0]
        ratio = half_square.owner.inputs[1].owner.inputs[0]
        difference, sigma = ratio.owner.inputs
        value, mu = difference.owner.inputs
    except (AttributeError, IndexError, ValueError):  # another density
        return None
    if response_node(mu) is None or not sigma.type.broadcastable[-1] or value.ndim != 2:
        return None
    return (value, mu, sigma) if equal_computations([x], [pm.Normal.logp(value, mu, sigma)]) else None


# before the graph is changed by other rewrites, for then nothing would look like PyMC's density any more
optdb.register(
    "fuse_gaussian_likelihood",
    dfs_rewriter(fuse_gaussian_likelihood, ignore_newtrees=True),
    "fast_run",
    "fuse_likelihood",
    position=0.02,
)
