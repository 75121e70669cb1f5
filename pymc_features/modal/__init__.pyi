# The names of the room for type checkers, which do not see what is imported when it is asked for.

from pymc_features.modal.data import ModalData as ModalData
from pymc_features.modal.data import mac as mac
from pymc_features.modal.feature import ModalFeature as ModalFeature
from pymc_features.modal.feature import match_modes as match_modes
from pymc_features.modal.files import read_modal as read_modal
from pymc_features.modal.files import write_modal as write_modal
from pymc_features.modal.frequency_response import FrequencyResponse as FrequencyResponse
from pymc_features.modal.merge import merge_setups as merge_setups
from pymc_features.modal.structural_modes import SymbolicModes as SymbolicModes
from pymc_features.modal.structural_modes import modes as modes
