"""How Numba-compiled graphs run the Ops of the spectral likelihood: through Python, in ten microseconds."""

from pytensor.link.numba.dispatch.basic import default_hash_key_from_props, register_funcify_and_cache_key

from pymc_features.ambient.density import AmbientHistories
from pymc_features.ambient.forces import ModalFactor, ModalFactorGradient
from pymc_features.ambient.operations import SpectralGradient, SpectralLogp
from pymc_features.ambient.transforms import BandHistories, BandTransform
from pymc_features.ops.numba_dispatch import DISPATCH_HASH, in_python

OPS = (
    SpectralLogp,
    SpectralGradient,
    BandTransform,
    BandHistories,
    AmbientHistories,
    ModalFactor,
    ModalFactorGradient,
)


def funcify(op, node=None, **kwargs):
    """A call of `run`; the kernel is no part of the machine code, nor of its key."""
    return in_python(op, node), default_hash_key_from_props(op, dispatch=DISPATCH_HASH)


for _op in OPS:
    register_funcify_and_cache_key(_op)(funcify)
