"""How Numba-compiled graphs run the Ops: the kernels themselves, under keys that know their source."""

import hashlib
from pathlib import Path

import numpy as np
from numba.extending import overload
from pytensor.link.numba.dispatch.basic import (
    default_hash_key_from_props,
    numba_njit,
    register_funcify_and_cache_key,
)

from pymc_features.ops.discrepancy import ChainDiscrepancy
from pymc_features.ops.gradient import (
    ChainDiscrepancyGradient,
    ChainDiscrepancyTangent,
    ChainResponseGradient,
    ChainResponseTangent,
    PopulationGradient,
)
from pymc_features.ops.misfit import ChainMisfit
from pymc_features.ops.population import PopulationDiscrepancy, PopulationMisfit
from pymc_features.ops.response import ChainResponse
from pymc_features.simulators import (
    SOURCE_HASH,
    chain_discrepancy,
    chain_misfit,
    chain_response,
    discrepancy_gradient,
    discrepancy_tangent,
    population_discrepancy,
    population_gradient,
    population_misfit,
    response_gradient,
    response_tangent,
)

DISPATCH_HASH = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()


def cache_key(op) -> str:
    """Key of an Op's machine code: type, properties, and hashes of the kernels' source and of this file.

    PyTensor's own key sees neither: an edited kernel would silently run old code.
    """
    return default_hash_key_from_props(op, kernel=SOURCE_HASH, dispatch=DISPATCH_HASH)


KERNELS = {
    ChainResponse: chain_response,
    ChainDiscrepancy: chain_discrepancy,
    PopulationDiscrepancy: population_discrepancy,
    ChainMisfit: chain_misfit,
    PopulationMisfit: population_misfit,
    ChainResponseGradient: response_gradient,
    ChainResponseTangent: response_tangent,
    ChainDiscrepancyGradient: discrepancy_gradient,
    ChainDiscrepancyTangent: discrepancy_tangent,
    PopulationGradient: population_gradient,
}


def contiguous(arrays):
    """The same tuple with contiguous arrays, inside compiled code."""
    return tuple(np.ascontiguousarray(a) for a in arrays)


@overload(contiguous)
def _contiguous(arrays):
    if len(arrays) == 0:
        return lambda arrays: ()
    return lambda arrays: (np.ascontiguousarray(arrays[0]), *contiguous(arrays[1:]))


def funcify(op, node=None, **kwargs):
    """Return the Op's kernel with its quantity bound."""
    kernel, quantity = KERNELS[type(op)], op.quantity_code

    @numba_njit
    def chain_op(
        mass, stiffness, rayleigh, ratios, acceleration, dt, substeps, stride, sensors, n_modes, *more
    ):
        return kernel(
            np.ascontiguousarray(mass),
            np.ascontiguousarray(stiffness),
            np.ascontiguousarray(rayleigh),
            np.ascontiguousarray(ratios),
            np.ascontiguousarray(acceleration),
            dt.item(),
            substeps.item(),
            stride.item(),
            np.ascontiguousarray(sensors),
            n_modes.item(),
            quantity,
            *contiguous(more),
        )

    return chain_op, cache_key(op)


for _op in KERNELS:
    register_funcify_and_cache_key(_op)(funcify)
