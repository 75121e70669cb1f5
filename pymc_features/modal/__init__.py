"""Modes of a structure: identified ones and their files, those of a model, and the likelihood of both."""

from pymc_features.lazy import lazily

# files of modes are read without PyMC
PLACES = {
    "FrequencyResponse": "frequency_response",
    "ModalData": "data",
    "ModalFeature": "feature",
    "SymbolicModes": "structural_modes",
    "mac": "data",
    "match_modes": "feature",
    "merge_setups": "merge",
    "modes": "structural_modes",
    "read_modal": "files",
    "write_modal": "files",
}
__all__ = [*PLACES]
__getattr__, __dir__ = lazily(__name__, PLACES)
