"""Modes of a structure: identified ones and their files, those of a model, and the likelihood of both."""

from pymc_features.lazy import lazily

TYPE_CHECKING = False  # that of `typing`
if TYPE_CHECKING:
    from pymc_features.modal.data import ModalData, mac  # noqa: F401
    from pymc_features.modal.feature import ModalFeature, match_modes  # noqa: F401
    from pymc_features.modal.files import read_modal, write_modal  # noqa: F401
    from pymc_features.modal.frequency_response import FrequencyResponse  # noqa: F401
    from pymc_features.modal.merge import merge_setups  # noqa: F401
    from pymc_features.modal.structural_modes import SymbolicModes, modes  # noqa: F401

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
