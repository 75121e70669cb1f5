"""How Numba-compiled graphs run the Ops on modes: through Python, which costs ten microseconds."""

from pytensor.link.numba.dispatch.basic import default_hash_key_from_props, register_funcify_and_cache_key

from pymc_features.modal_features.assignment import Assignment
from pymc_features.modal_features.operations import ModesGradient, StructuralModes
from pymc_features.ops.numba_dispatch import DISPATCH_HASH, in_python

OPS = (StructuralModes, ModesGradient, Assignment)


def funcify(op, node=None, **kwargs):
    """A call of `run`; the kernel is no part of the machine code, nor of its key."""
    return in_python(op, node), default_hash_key_from_props(op, dispatch=DISPATCH_HASH)


for _op in OPS:
    register_funcify_and_cache_key(_op)(funcify)
