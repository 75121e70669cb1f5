"""Every public name: what most models take, and the submodules with the rest.

`import name as name` tells type checkers that a name is handed on.
"""

import logging as _logging
from types import ModuleType as _Module

from pymc_features import ambient as ambient
from pymc_features import calibration as calibration
from pymc_features import datasets as datasets
from pymc_features import events as events
from pymc_features import exceptions as exceptions
from pymc_features import external as external
from pymc_features import io as io
from pymc_features import likelihoods as likelihoods
from pymc_features import modal as modal
from pymc_features import plots as plots
from pymc_features import prediction as prediction
from pymc_features import sampling as sampling
from pymc_features import signals as signals
from pymc_features import structures as structures
from pymc_features import study as study
from pymc_features.ambient import AmbientResponse as AmbientResponse
from pymc_features.ambient import identify_modes as identify_modes
from pymc_features.calibration import calibrate as calibrate
from pymc_features.calibration import effective_samples as effective_samples
from pymc_features.calibration import event_check as event_check
from pymc_features.events import compare as compare
from pymc_features.events import hierarchical as hierarchical
from pymc_features.external import ExternalSimulator as ExternalSimulator
from pymc_features.external import ProgramSimulator as ProgramSimulator
from pymc_features.external import emulate as emulate
from pymc_features.ground_motion import synthetic_earthquake as synthetic_earthquake
from pymc_features.io import read_channels as read_channels
from pymc_features.io import read_matrices as read_matrices
from pymc_features.io import read_record as read_record
from pymc_features.likelihoods import CorrelatedNormal as CorrelatedNormal
from pymc_features.likelihoods import DiscrepancySimulator as DiscrepancySimulator
from pymc_features.likelihoods import ExpFeature as ExpFeature
from pymc_features.likelihoods import GammaFeature as GammaFeature
from pymc_features.likelihoods import TruncNormalFeature as TruncNormalFeature
from pymc_features.modal import FrequencyResponse as FrequencyResponse
from pymc_features.modal import ModalFeature as ModalFeature
from pymc_features.modal import modes as modes
from pymc_features.modal import read_modal as read_modal
from pymc_features.ops import mean_square_discrepancy as mean_square_discrepancy
from pymc_features.ops import response as response
from pymc_features.prediction import sensor_placement as sensor_placement
from pymc_features.records import Loading as Loading
from pymc_features.records import Record as Record
from pymc_features.sampling import TMCMC as TMCMC
from pymc_features.sampling import PersistentSMC as PersistentSMC
from pymc_features.sampling import SubsetSimulation as SubsetSimulation
from pymc_features.sampling import compiled_logp as compiled_logp
from pymc_features.sampling import fisher_information as fisher_information
from pymc_features.sampling import laplace as laplace
from pymc_features.sampling import sample as sample
from pymc_features.sampling import sample_nuts as sample_nuts
from pymc_features.sampling import sample_smc as sample_smc
from pymc_features.simulators import simulate as simulate
from pymc_features.structures import AffineStructure as AffineStructure
from pymc_features.structures import DuffingChain as DuffingChain
from pymc_features.structures import HystereticChain as HystereticChain
from pymc_features.structures import LinearStructure as LinearStructure
from pymc_features.structures import ModalDamping as ModalDamping
from pymc_features.structures import RayleighDamping as RayleighDamping
from pymc_features.structures import SpringMassChain as SpringMassChain
from pymc_features.study import paper as paper

if not _logging.root.handlers:  # messages are shown as those of PyMC are
    _logging.getLogger("pymc_features").setLevel(_logging.INFO)
    _logging.getLogger("pymc_features").addHandler(_logging.StreamHandler())

#: Names in the order of the alphabet, those of submodules last.
_all = sorted(
    (name for name in globals() if not name.startswith("_")),
    key=lambda name: (isinstance(globals()[name], _Module), name),
)
