"""How Numba-compiled graphs run the Ops: they call the kernels, under keys that know their source.

A kernel is compiled once, for arrays in C order, whatever calls it. Numba would otherwise put a copy of its
code into each function of a graph that calls it, directly or not, and optimise each copy anew.
"""

import functools
import hashlib
import warnings
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
from numba import objmode, typeof, types
from numba.core import cgutils
from numba.extending import intrinsic, overload
from pytensor.link.numba.dispatch.basic import (
    default_hash_key_from_props,
    generate_fallback_impl,
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
from pymc_features.ops.excitation import OwnValues, Refined
from pymc_features.ops.external import (
    ExternalDiscrepancy,
    ExternalDiscrepancyGradient,
    ExternalGradient,
    ExternalResponse,
)
from pymc_features.ops.gradient import ResponseGradient, ResponseTangent
from pymc_features.ops.long_records import hash_of_data, is_known_long
from pymc_features.ops.population import PopulationDiscrepancy, PopulationGradient, PopulationMisfit
from pymc_features.ops.response import StructuralResponse
from pymc_features.simulators.compiled.dependencies import source_hash
from pymc_features.simulators.compiled.jit import Kernel
from pymc_features.simulators.families import count
from pymc_features.simulators.linear.known import KNOWN
from pymc_features.simulators.long_records.misfits import Tables
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


def cache_key(op, data="") -> str:
    """Key of an Op's machine code: type, properties, and hashes of this file and of the kernel's source.

    `data` is the hash of what a node has a table of.

    PyTensor's own key sees neither: an edited kernel would silently run old code. A kernel that runs in
    Python is not part of the machine code.
    """
    kernel = source_hash(op.kernel.py_func.__module__) if is_compiled(op) else ""
    return default_hash_key_from_props(op, kernel=kernel, dispatch=DISPATCH_HASH, data=data)


def prepared(arrays):
    """Make arrays of a tuple contiguous, and numbers of those without dimensions, in compiled code."""
    return tuple(np.ascontiguousarray(a) if a.ndim else a.item() for a in arrays)


@overload(prepared)
def _prepared(arrays):
    entries = (
        f"arrays[{i}].item()" if a.ndim == 0 else f"np.ascontiguousarray(arrays[{i}])"
        for i, a in enumerate(arrays)
    )
    return eval(f"lambda arrays: ({', '.join(entries)},)", {"np": np})  # one function, not one for each entry


def funcify(op, node=None, **kwargs):
    """Return the Op's kernel with its quantity bound.

    A long record is taken from the table of its node. If its data are no constants, the machine code is not
    kept.
    """
    if is_known_long(op, node):
        data = hash_of_data(op, node)
        return in_python(op, node, Tables()), data and cache_key(op, data)
    return (compiled(op) if is_compiled(op) else in_python(op, node)), cache_key(op)


def is_compiled(op) -> bool:
    """Whether compiled code can call the Op's kernel; others are functions of Python that call some."""
    return isinstance(op.kernel, Kernel)


@functools.cache
def linked(kernel, argument_types) -> tuple[str, types.Type]:
    """The name under which compiled code finds a kernel for arguments of these types, and what it returns.

    The name is the same in all processes, for code that Numba has kept on disk calls it by this name.
    """
    kernel.compile(argument_types)
    result = kernel.overloads[argument_types]
    key = f"{source_hash(kernel.py_func.__module__)} {argument_types}"
    name = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}.{hashlib.sha256(key.encode()).hexdigest()}"
    llvm.add_symbol(name, result.library.get_pointer_to_function(result.fndesc.llvm_func_name))
    return name, result.signature.return_type


def caller(kernel, argument_types):
    """A function for compiled code that calls a kernel with a tuple of its arguments.

    Whether the arrays in it may be written makes no difference: the kernels write to none.
    """
    name, return_type = linked(kernel, argument_types)

    @intrinsic
    def call(typing_context, arguments):
        def emit(context, builder, signature, values):
            given = cgutils.unpack_tuple(builder, values[0])
            conventions = context.call_conv
            function_type = conventions.get_function_type(return_type, argument_types)
            function = cgutils.get_or_insert_function(builder.module, function_type, name)
            status, result = conventions.call_function(builder, function, return_type, argument_types, given)
            with cgutils.if_unlikely(builder, status.is_error):
                conventions.return_status_propagate(builder, status)
            return result

        return return_type(arguments), emit

    return call


def kernel_types(op) -> tuple[types.Type, ...]:
    """Types of the kernel's arguments, which are also those of `StructuralOp.run`."""
    ndims = [count(dims) for dims in op.spec.inputs.values()]
    for i in range(op.n_parameters):
        ndims[i] += op.batched
    common = [np.ones((1,) * n, op.spec.dtype(name)) for n, name in zip(ndims, op.names, strict=True)]
    more = [np.ones((1,) * n) for n in op.more_ndims]
    return tuple(typeof(argument) for argument in op.arguments([*common, *more]))


def compiled(op):
    """A call from compiled code to compiled code; Numba slices tuples between constants only."""
    kernel = caller(op.kernel, kernel_types(op))
    quantity, arguments = op.quantity_code, op.spec.arguments
    settings = len(arguments._fields)
    outputs, more = settings + len(Excitation._fields), op.n_common

    @numba_njit
    def assembled(inputs):
        parameters, excitation = arguments(*inputs[:settings]), Excitation(*inputs[settings:outputs])
        return parameters, excitation, Outputs(*inputs[outputs:more], quantity)

    @numba_njit
    def structural_op(*inputs):
        given = prepared(inputs)
        return kernel((*assembled(given), *given[more:]))

    return structural_op


def in_python(op, node, *tables):
    """A call from compiled code to a kernel in Python, which costs ten microseconds.

    What other functions have learnt of their structures is forgotten, so that a run with the same seed is the
    same, whatever was before.
    """
    KNOWN.forget()
    one = len(node.outputs) == 1
    results = [get_numba_type(output.type) for output in node.outputs]
    result_type = results[0] if one else types.Tuple(results)

    def run(inputs):
        results = tuple(np.ascontiguousarray(x) for x in op.run(inputs, *tables))
        return results[0] if one else results

    @numba_njit
    def structural_op(*inputs):
        with objmode(result=result_type):
            result = run(inputs)
        return result

    return structural_op


for _op in OPS:
    register_funcify_and_cache_key(_op)(funcify)


def run_in_python(*ops):
    """Let Numba-compiled graphs call `run` of Ops, which is no part of the machine code nor of its key."""

    def funcify_call(op, node=None, **kwargs):
        return in_python(op, node), default_hash_key_from_props(op, dispatch=DISPATCH_HASH)

    for op in ops:
        register_funcify_and_cache_key(op)(funcify_call)


def funcify_perform(op, node=None, **kwargs):
    """A call of `perform`, without a warning; no key, for machine code that holds a simulator is not kept."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Numba will use object mode", category=UserWarning)
        return generate_fallback_impl(op, node=node, **kwargs), None


EXTERNAL = ExternalResponse, ExternalDiscrepancy, ExternalGradient, ExternalDiscrepancyGradient
for _op in (*EXTERNAL, OwnValues, Refined):
    register_funcify_and_cache_key(_op)(funcify_perform)
