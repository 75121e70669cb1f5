"""How Numba-compiled graphs run external simulators and records: in Python, without a warning."""

import warnings

from pytensor.link.numba.dispatch.basic import generate_fallback_impl, register_funcify_and_cache_key

from pymc_features.ops.excitation import OwnValues, Refined
from pymc_features.ops.external import (
    ExternalDiscrepancy,
    ExternalDiscrepancyGradient,
    ExternalGradient,
    ExternalResponse,
)


def funcify(op, node=None, **kwargs):
    """A call of the Op's `perform`; no key, for machine code that holds a simulator is not kept."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Numba will use object mode", category=UserWarning)
        return generate_fallback_impl(op, node=node, **kwargs), None


for _op in (
    ExternalResponse,
    ExternalDiscrepancy,
    ExternalGradient,
    ExternalDiscrepancyGradient,
    OwnValues,
    Refined,
):
    register_funcify_and_cache_key(_op)(funcify)
