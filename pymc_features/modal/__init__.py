"""Modes of a structure: identified ones and their files, those of a model, and the likelihood of both."""

from pymc_features.lazy import lazily

__all__ = ["ModalData", "ModalFeature", "SymbolicModes", "mac", "match_modes", "merge_setups", "modes"]

# files of modes are read without PyMC
__getattr__, __dir__ = lazily(
    __name__,
    {
        "ModalData": "data",
        "ModalFeature": "feature",
        "SymbolicModes": "structural_modes",
        "mac": "data",
        "match_modes": "feature",
        "merge_setups": "merge",
        "modes": "structural_modes",
    },
)
