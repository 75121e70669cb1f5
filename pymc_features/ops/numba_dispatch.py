"""How Numba-compiled graphs run the Ops: the kernels themselves, under keys that know their source."""

import hashlib
from pathlib import Path

import numpy as np
from pytensor.link.numba.dispatch.basic import (
    default_hash_key_from_props,
    numba_njit,
    register_funcify_and_cache_key,
)

from pymc_features.ops.discrepancy import ChainDiscrepancy
from pymc_features.ops.population import PopulationDiscrepancy
from pymc_features.ops.response import ChainResponse
from pymc_features.simulators import (
    SOURCE_HASH,
    chain_discrepancy,
    chain_response,
    population_discrepancy,
)

DISPATCH_HASH = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()


def cache_key(op) -> str:
    """Key of an Op's machine code: type, properties, and hashes of the kernels' source and of this file.

    PyTensor's own key sees neither: an edited kernel would silently run old code.
    """
    return default_hash_key_from_props(op, kernel=SOURCE_HASH, dispatch=DISPATCH_HASH)


@register_funcify_and_cache_key(ChainResponse)
def funcify_response(op, node=None, **kwargs):
    """Return the response kernel with the Op's quantity bound."""
    quantity = op.quantity_code

    @numba_njit
    def chain_response_op(
        mass, stiffness, rayleigh, ratios, acceleration, dt, substeps, stride, sensors, n_modes
    ):
        return chain_response(
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
        )

    return chain_response_op, cache_key(op)


@register_funcify_and_cache_key(ChainDiscrepancy)
def funcify_discrepancy(op, node=None, **kwargs):
    """Return the fused kernel with the Op's quantity bound."""
    return bind_discrepancy(chain_discrepancy, op.quantity_code), cache_key(op)


@register_funcify_and_cache_key(PopulationDiscrepancy)
def funcify_population(op, node=None, **kwargs):
    """Return the fused kernel of populations with the Op's quantity bound."""
    return bind_discrepancy(population_discrepancy, op.quantity_code), cache_key(op)


def bind_discrepancy(kernel, quantity):
    """A function of a node's inputs that calls one of the discrepancy kernels."""

    @numba_njit
    def discrepancy_op(
        mass,
        stiffness,
        rayleigh,
        ratios,
        acceleration,
        dt,
        substeps,
        stride,
        sensors,
        n_modes,
        observed,
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
            np.ascontiguousarray(observed),
        )

    return discrepancy_op
