"""Every public name: what most models take, and the submodules with the rest."""

import logging

from pymc_features import (
    ambient,
    calibration,
    datasets,
    events,
    exceptions,
    external,
    io,
    likelihoods,
    modal,
    plots,
    prediction,
    sampling,
    signals,
    structures,
    study,
)
from pymc_features.ambient import AmbientResponse, identify_modes
from pymc_features.calibration import calibrate, effective_samples, event_check
from pymc_features.events import compare, hierarchical
from pymc_features.external import ExternalSimulator, ProgramSimulator, emulate
from pymc_features.ground_motion import synthetic_earthquake
from pymc_features.io import read_channels, read_matrices, read_record
from pymc_features.likelihoods import (
    CorrelatedNormal,
    DiscrepancySimulator,
    ExpFeature,
    GammaFeature,
    TruncNormalFeature,
)
from pymc_features.modal import FrequencyResponse, ModalFeature, modes, read_modal
from pymc_features.ops import mean_square_discrepancy, response
from pymc_features.prediction import sensor_placement
from pymc_features.records import Loading, Record
from pymc_features.sampling import (
    TMCMC,
    PersistentSMC,
    SubsetSimulation,
    compiled_logp,
    fisher_information,
    laplace,
    sample,
    sample_nuts,
    sample_smc,
)
from pymc_features.simulators import simulate
from pymc_features.structures import (
    AffineStructure,
    DuffingChain,
    HystereticChain,
    LinearStructure,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
)
from pymc_features.study import paper

if not logging.root.handlers:  # messages are shown as those of PyMC are
    logging.getLogger("pymc_features").setLevel(logging.INFO)
    logging.getLogger("pymc_features").addHandler(logging.StreamHandler())

__all__ = [
    "AffineStructure",
    "AmbientResponse",
    "CorrelatedNormal",
    "DiscrepancySimulator",
    "DuffingChain",
    "ExpFeature",
    "ExternalSimulator",
    "FrequencyResponse",
    "GammaFeature",
    "HystereticChain",
    "LinearStructure",
    "Loading",
    "ModalDamping",
    "ModalFeature",
    "PersistentSMC",
    "ProgramSimulator",
    "RayleighDamping",
    "Record",
    "SpringMassChain",
    "SubsetSimulation",
    "TMCMC",
    "TruncNormalFeature",
    "calibrate",
    "compare",
    "compiled_logp",
    "effective_samples",
    "emulate",
    "event_check",
    "fisher_information",
    "hierarchical",
    "identify_modes",
    "laplace",
    "mean_square_discrepancy",
    "modes",
    "read_channels",
    "read_matrices",
    "read_modal",
    "read_record",
    "response",
    "sample",
    "sample_nuts",
    "sample_smc",
    "sensor_placement",
    "simulate",
    "synthetic_earthquake",
]
__all__ += [  # submodules
    "ambient",
    "calibration",
    "datasets",
    "events",
    "exceptions",
    "external",
    "io",
    "likelihoods",
    "modal",
    "paper",
    "plots",
    "prediction",
    "sampling",
    "signals",
    "structures",
    "study",
]
