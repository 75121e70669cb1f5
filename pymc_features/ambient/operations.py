"""Ops of the spectral likelihood: its value and its gradient."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply
from pytensor.graph.rewriting.basic import node_rewriter
from pytensor.tensor.rewriting.basic import register_specialize

from pymc_features.ops.arrays import RowOp
from pymc_features.ops.gradient import undefined
from pymc_features.ops.numba_dispatch import run_in_python
from pymc_features.ops.population import take_batches
from pymc_features.simulators.spectra import (
    Lines,
    SpectralParameters,
    spectral_gradient,
    spectral_logp,
)

NDIMS = 1, 1, 2, 4, 2, 3  # of `SpectralParameters`
N = len(NDIMS)


class SpectralOp(RowOp):
    """Base: `SpectralParameters`, then the arrays of `Lines`.

    Parameters
    ----------
    of_spectra : bool
        Whether the transforms depend on parameters.
    """

    __props__ = ("of_spectra",)
    ndims, n_connected = NDIMS, N

    def __init__(self, of_spectra: bool = False):
        self.of_spectra = of_spectra

    def make_node(self, *inputs):
        inputs = [pt.as_tensor_variable(x) for x in inputs]
        inputs = [*(x.astype("float64") for x in inputs[:-1]), inputs[-1].astype("int64")]
        return Apply(self, inputs, self.outputs(inputs))

    def of_rows(self, rows, lines, n) -> list[np.ndarray]:
        """The log-likelihoods (n,) and slopes of parameters with a row for each particle, or one for all."""
        rows, lines = ([np.require(x, requirements=["C", "W"]) for x in arrays] for arrays in (rows, lines))
        results = [np.empty(n), *(np.zeros((n, *x.shape[1:])) for x in rows[: self.n_slopes])]
        self.write(SpectralParameters(*rows), Lines(*lines), *results)
        return results


class SpectralLogp(SpectralOp):
    """Log-likelihood of the transforms in all bands."""

    simulates = True
    write = staticmethod(spectral_logp)

    def pullback(self, inputs, outputs, cotangents):
        """By `SpectralGradient`, which is evaluated once for all."""
        _, *slopes = SpectralGradient(self.of_spectra)(*inputs, return_list=True)
        gradients = self.pulled_back(cotangents[0], inputs, slopes)
        if not self.of_spectra:
            gradients.insert(N - 1, undefined(self, inputs, N - 1))
        return gradients


class SpectralGradient(SpectralOp):
    """The log-likelihood, and its gradient by each of the parameters; by the transforms if `of_spectra`."""

    @property
    def n_slopes(self) -> int:
        """Number of parameters by which the gradient is wanted."""
        return N if self.of_spectra else N - 1

    def write(self, parameters, lines, logp, *slopes):
        """Write the results."""
        none = [] if self.of_spectra else [np.zeros((0, *parameters.spectra.shape[1:]))]
        spectral_gradient(parameters, lines, logp, SpectralParameters(*slopes, *none))

    def pullback(self, inputs, outputs, cotangents):
        """No second derivatives."""
        return [
            *(undefined(self, inputs, i) for i in range(N)),
            *(disconnected_type() for _ in inputs[N:]),
        ]


take_batches(SpectralLogp, SpectralGradient, first=N)
run_in_python(SpectralLogp, SpectralGradient)


@register_specialize
@node_rewriter([SpectralLogp])
def local_value_with_gradient(fgraph, node):
    """Return the log-likelihood that comes with the gradient, where that is evaluated."""
    for client, _ in fgraph.clients[node.inputs[0]]:
        if isinstance(client.op, SpectralGradient) and client.inputs == node.inputs:
            return [client.outputs[0]]
    return None
