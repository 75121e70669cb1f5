"""Natural modes inside a model, and the likelihood of identified ones."""

from pymc_features.modal_features import numba_dispatch
from pymc_features.modal_features.feature import ModalFeature
from pymc_features.modal_features.mac import mac
from pymc_features.modal_features.match import match_modes
from pymc_features.modal_features.quantities import SymbolicModes, modes

OPS = numba_dispatch.OPS

__all__ = ["OPS", "ModalFeature", "SymbolicModes", "mac", "match_modes", "modes"]
