"""How Numba-compiled graphs run the Ops: the kernels themselves, under keys that know their source."""

import hashlib
from pathlib import Path

import numpy as np
from numba import objmode, types
from numba.extending import overload
from pytensor.link.numba.dispatch.basic import (
    default_hash_key_from_props,
    get_numba_type,
    numba_njit,
    register_funcify_and_cache_key,
)

from pymc_features.ops.comparison import (
    DiscrepancyTangent,
    MisfitGradient,
    StructuralDiscrepancy,
    StructuralMisfit,
)
from pymc_features.ops.gradient import ResponseGradient, ResponseTangent
from pymc_features.ops.population import PopulationDiscrepancy, PopulationGradient, PopulationMisfit
from pymc_features.ops.response import StructuralResponse
from pymc_features.simulators.compiled.dependencies import source_hash
from pymc_features.simulators.oscillators.arguments import Excitation, Outputs

DISPATCH_HASH = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()

OPS = (
    StructuralResponse,
    StructuralDiscrepancy,
    PopulationDiscrepancy,
    StructuralMisfit,
    PopulationMisfit,
    ResponseGradient,
    ResponseTangent,
    MisfitGradient,
    DiscrepancyTangent,
    PopulationGradient,
)


def cache_key(op) -> str:
    """Key of an Op's machine code: type, properties, and hashes of this file and of the kernel's source.

    PyTensor's own key sees neither: an edited kernel would silently run old code. A kernel that runs in
    Python is not part of the machine code.
    """
    kernel = source_hash(op.kernel.__module__) if op.spec.compiled else ""
    return default_hash_key_from_props(op, kernel=kernel, dispatch=DISPATCH_HASH)


def prepared(arrays):
    """The same tuple with contiguous arrays, and numbers for arrays without dimensions, in compiled code."""
    return tuple(np.ascontiguousarray(a) if a.ndim else a.item() for a in arrays)


@overload(prepared)
def _prepared(arrays):
    if len(arrays) == 0:
        return lambda arrays: ()
    if arrays[0].ndim == 0:
        return lambda arrays: (arrays[0].item(), *prepared(arrays[1:]))
    return lambda arrays: (np.ascontiguousarray(arrays[0]), *prepared(arrays[1:]))


def funcify(op, node=None, **kwargs):
    """Return the Op's kernel with its quantity bound."""
    return (compiled(op) if op.spec.compiled else in_python(op, node)), cache_key(op)


def compiled(op):
    """A call from compiled code to compiled code; Numba slices tuples between constants only."""
    kernel, quantity, arguments = op.kernel, op.quantity_code, op.spec.arguments
    settings = len(arguments._fields)
    outputs, more = settings + len(Excitation._fields), op.n_common
    directions = more + len(op.more_ndims) - op.n_parameters

    @numba_njit
    def assembled(inputs):
        parameters, excitation = arguments(*inputs[:settings]), Excitation(*inputs[settings:outputs])
        return parameters, excitation, Outputs(*inputs[outputs:more], quantity)

    @numba_njit
    def structural_op(*inputs):
        given = prepared(inputs)
        return kernel(*assembled(given), *given[more:])

    @numba_njit
    def along_directions(*inputs):
        given = prepared(inputs)
        return kernel(*assembled(given), *given[more:directions], given[directions:])

    return along_directions if op.takes_directions else structural_op


def in_python(op, node):
    """A call from compiled code to a kernel in Python, which costs ten microseconds."""
    one = len(node.outputs) == 1
    results = [get_numba_type(output.type) for output in node.outputs]
    result_type = results[0] if one else types.Tuple(results)

    def run(inputs):
        results = tuple(np.ascontiguousarray(x) for x in op.run(inputs))
        return results[0] if one else results

    @numba_njit
    def structural_op(*inputs):
        with objmode(result=result_type):
            result = run(inputs)
        return result

    return structural_op


for _op in OPS:
    register_funcify_and_cache_key(_op)(funcify)
