"""What errors correlated in time need of the misfit, as a PyTensor Op that never stores the response."""

import pytensor.tensor as pt
from pytensor.gradient import disconnected_type

from pymc_features.ops.discrepancy import StructuralComparison
from pymc_features.ops.gradient import ResponseGradient
from pymc_features.ops.response import StructuralResponse


class StructuralMisfit(StructuralComparison):
    """Statistics of the misfit (sensor, 4), as `misfit_values`, straight from parameters and data."""

    kernel_name = "misfit"
    output_signature = "(s,4)"
    values = (4,)

    def pullback(self, inputs, outputs, cotangents):
        """From the response of this one particle, by its gradient."""
        *common, observed = inputs
        misfit = observed - self.like(StructuralResponse)(*common)
        by_misfit = misfit_cotangent(misfit, *cotangents)
        return [
            *self.like(ResponseGradient)(*common, -by_misfit, return_list=True),
            *(disconnected_type() for _ in common[self.n_parameters :]),
            by_misfit,
        ]


def misfit_values(misfit):
    """Statistics (..., 4) of r (..., time).

    Mean of r(k)^2, sum of [r(k) - r(k - 1)]^2 over the number of samples, first r, last r.
    """
    n_times = pt.cast(misfit.shape[-1], "float64")
    steps = misfit[..., 1:] - misfit[..., :-1]
    squares = (pt.sum(pt.sqr(x), axis=-1) / n_times for x in (misfit, steps))
    return pt.stack([*squares, misfit[..., 0], misfit[..., -1]], axis=-1)


def misfit_cotangent(misfit, cotangent):
    """Derivative (..., time) of the sum of c (..., 4) times `misfit_values` by the misfit."""
    c = [cotangent[..., i, None] for i in range(4)]
    steps = misfit[..., 1:] - misfit[..., :-1]
    none = pt.zeros_like(misfit[..., :1])
    bends = pt.concatenate([none, steps], axis=-1) - pt.concatenate([steps, none], axis=-1)
    by_squares = (2.0 / misfit.shape[-1]) * (c[0] * misfit + c[1] * bends)
    by_first = pt.inc_subtensor(by_squares[..., :1], c[2])
    return pt.inc_subtensor(by_first[..., -1:], c[3])
