"""Natural modes inside a model, and the likelihood of identified ones."""

from pymc_features.modal import numba_dispatch
from pymc_features.modal.feature import ModalFeature
from pymc_features.modal.mac import mac
from pymc_features.modal.match import match_modes
from pymc_features.modal.quantities import SymbolicModes, modes

OPS = numba_dispatch.OPS

__all__ = ["OPS", "ModalFeature", "SymbolicModes", "mac", "match_modes", "modes"]
