"""The random variable behind `AmbientResponse`: its draws and its density."""

from collections.abc import Sequence

import numpy as np
import pytensor.tensor as pt
from pymc.distributions.distribution import SymbolicRandomVariable
from pymc.logprob.abstract import _logprob
from pymc.pytensorf import normalize_rng_param
from pytensor.graph.basic import Apply, Constant, Variable
from pytensor.graph.op import Op
from pytensor.tensor import TensorLike, TensorVariable

from pymc_features.ambient.bands import Bands
from pymc_features.ambient.operations import SpectralLogp
from pymc_features.ambient.transfer import transfer_functions
from pymc_features.ambient.transforms import BandTransform, band_histories

PARTS = "(m),(m),(m,s),(b,m,r,c),(b,s)"
LINES = "bins", "weights", "gains", "starts", "dt"  # of `Bands`


class AmbientHistories(Op):
    """Histories (s, t) whose transforms in some bands have the covariance E_k, from standard normal numbers.

    Inputs are those of `AmbientResponseRV`, and normal numbers (2, k, r) of forces and (s, 2, k) of errors.
    """

    __props__ = ()
    gufunc_signature = f"{PARTS},(s,t),(k),(k),(k),(e),(),(c,k,r),(s,c,k)->(s,t)"

    def make_node(self, *inputs):
        inputs = [pt.as_tensor_variable(x) for x in inputs]
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=inputs[5].type.shape)])

    def perform(self, node, inputs, output_storage):
        [output_storage[0][0]] = self.run(inputs)

    def infer_shape(self, node, shapes):
        return [shapes[5]]

    def run(self, inputs) -> tuple[np.ndarray]:
        """Histories of arrays."""
        natural, ratios, shapes, factor, error, mean, bins, weights, gains, starts, dt, *normal = inputs
        of_forces, of_error = (np.sqrt(0.5) * x for x in normal)
        band = np.repeat(np.arange(len(starts) - 1), np.diff(starts))  # of each frequency
        frequencies = bins / (dt * mean.shape[-1])
        transfer = gains[:, None] * transfer_functions(natural, ratios, frequencies)
        factor, of_forces = factor[..., 0] + 1j * factor[..., 1], of_forces[0] + 1j * of_forces[1]
        forces = np.einsum("kmr,kr->km", factor[band], of_forces)
        response = ((transfer * forces) @ shapes).T
        spectra = np.stack([response.real, response.imag], axis=1)
        spectra += of_error * np.sqrt(error[band].T[:, None])
        return (mean + band_histories(spectra, bins, weights, dt, mean.shape[-1]) / dt,)


class AmbientResponseRV(SymbolicRandomVariable):
    """Channels (s, t) whose transforms in some bands are Gaussian; draws have nothing else but the mean."""

    name = "AmbientResponse"
    extended_signature = f"[rng],{PARTS},(s,t),(k),(k),(k),(e),()->[rng],(s,t)"
    _print_name = ("AmbientResponse", "\\operatorname{AmbientResponse}")

    @classmethod
    def rv_op(
        cls,
        parameters: Sequence[TensorLike],
        bands: Bands,
        *,
        rng: Variable | None = None,
        size: TensorVariable | None = None,
    ) -> TensorVariable:
        """Build draws from `SpectralParameters`, with the mean (s, t) in place of transforms, and `Bands`."""
        parameters = [pt.as_tensor_variable(x) for x in parameters]
        lines = [pt.as_tensor_variable(getattr(bands, name)) for name in LINES]
        rng = normalize_rng_param(rng)
        _, _, shapes, factor, *_ = parameters
        k = bands.bins.size
        next_rng, forces = pt.random.normal(size=(2, k, factor.shape[2]), rng=rng, return_next_rng=True)
        next_rng, errors = pt.random.normal(size=(shapes.shape[1], 2, k), rng=next_rng, return_next_rng=True)
        histories = AmbientHistories()(*parameters, *lines, forces, errors)
        return cls(inputs=[rng, *parameters, *lines], outputs=[next_rng, histories])(rng, *parameters, *lines)


def parameters_of(rv: TensorVariable) -> list[Variable]:
    """Frequencies, damping ratios, shapes, factor of the forces and error of an `AmbientResponse`."""
    return rv.owner.inputs[1:6]


@_logprob.register(AmbientResponseRV)
def ambient_logprob(op, values, rng, *inputs, **kwargs):
    """Log-likelihood of the transforms in all bands."""
    [value] = values
    natural, ratios, shapes, factor, error, mean, bins, weights, gains, starts, dt = inputs
    spectra = BandTransform()(value - mean, bins, weights, dt)
    frequencies = bins / (dt * value.shape[-1])
    logp = SpectralLogp(of_spectra=not isinstance(mean, Constant))
    return logp(natural, ratios, shapes, factor, error, spectra, frequencies, weights, gains, starts)
