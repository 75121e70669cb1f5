"""Natural modes inside a model, and the likelihood of identified ones."""

from pymc_features.modal_features.feature import ModalFeature, match_modes
from pymc_features.modal_features.matching import mac
from pymc_features.modal_features.structural_modes import SymbolicModes, modes

__all__ = ["ModalFeature", "SymbolicModes", "mac", "match_modes", "modes"]
