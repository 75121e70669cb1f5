"""Every public name: a new one is a line here."""

from pymc_features import datasets, exceptions, plots, signals
from pymc_features.ambient import AmbientResponse, identify_modes, propose_bands, spectral_response
from pymc_features.calibration import calibrate, effective_samples, event_check, fill_degrees
from pymc_features.events import compare, hierarchical
from pymc_features.events.sequence import continue_with, sample_in_sequence
from pymc_features.external import ExternalSimulator, ProgramSimulator, emulate
from pymc_features.ground_motion import synthetic_earthquake
from pymc_features.inference import (
    compiled_logp,
    fisher_information,
    laplace,
    sample,
    sample_nuts,
    tolerance_sweep,
)
from pymc_features.io import (
    read_channels,
    read_channels_with_gaps,
    read_cyclic_test,
    read_matrices,
    read_record,
    write_channels,
)
from pymc_features.likelihoods import (
    CorrelatedNormal,
    DiscrepancySimulator,
    ExpFeature,
    GammaFeature,
    TruncNormalFeature,
    abc_tolerance,
    sigma_mpv,
)
from pymc_features.modal import ModalData, ModalFeature, mac, match_modes, merge_setups, modes
from pymc_features.modal.files import read_modal, write_modal
from pymc_features.ops import mean_square_discrepancy, response
from pymc_features.plots import *  # noqa: F403  plot_chains, plot_loops, ...
from pymc_features.prediction import first_passage_probability, posterior_response, sensor_placement
from pymc_features.records import CyclicTest, Loading, Record
from pymc_features.simulators import integration_error, simulate, spring_forces
from pymc_features.smc import TMCMC, PersistentSMC, PopulationIMH, PopulationMH, SubsetSimulation, sample_smc
from pymc_features.structures import (
    AffineStructure,
    DuffingChain,
    HystereticChain,
    LinearStructure,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
)
from pymc_features.structures.specimens import Degradation, HystereticSpecimen, Pinching
from pymc_features.study import paper, sampling_rate_study

__all__ = [
    "AffineStructure",
    "AmbientResponse",
    "CorrelatedNormal",
    "CyclicTest",
    "Degradation",
    "DiscrepancySimulator",
    "DuffingChain",
    "ExpFeature",
    "GammaFeature",
    "ExternalSimulator",
    "HystereticChain",
    "HystereticSpecimen",
    "LinearStructure",
    "Loading",
    "ModalDamping",
    "ModalData",
    "ModalFeature",
    "PersistentSMC",
    "Pinching",
    "PopulationIMH",
    "PopulationMH",
    "ProgramSimulator",
    "RayleighDamping",
    "Record",
    "SpringMassChain",
    "SubsetSimulation",
    "TMCMC",
    "TruncNormalFeature",
    "abc_tolerance",
    "calibrate",
    "compare",
    "compiled_logp",
    "continue_with",
    "datasets",
    "effective_samples",
    "emulate",
    "event_check",
    "exceptions",
    "fill_degrees",
    "first_passage_probability",
    "fisher_information",
    "hierarchical",
    "identify_modes",
    "integration_error",
    "laplace",
    "mac",
    "match_modes",
    "mean_square_discrepancy",
    "merge_setups",
    "modes",
    "paper",
    "posterior_response",
    "propose_bands",
    "read_channels",
    "read_channels_with_gaps",
    "read_cyclic_test",
    "read_matrices",
    "read_modal",
    "read_record",
    "response",
    "sample",
    "sample_in_sequence",
    "sample_nuts",
    "sample_smc",
    "sampling_rate_study",
    "sensor_placement",
    "sigma_mpv",
    "signals",
    "simulate",
    "spectral_response",
    "spring_forces",
    "synthetic_earthquake",
    "tolerance_sweep",
    "write_channels",
    "write_modal",
]
__all__ += plots.__all__
