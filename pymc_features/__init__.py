"""Bayesian updating of structural models from measured vibration, as a plugin for PyMC.

The flow: read a record, declare a structure whose parameters are random variables, compare its response
with the measured one by a feature likelihood, sample.

    record = pmf.read_record("elcentro.dat", units="g")
    with pm.Model(coords={"sensor": range(10)}):
        theta = pm.Uniform("theta", 0.5, 1.5)
        sigma = pm.Uniform("sigma", 0.0, 2.0)
        acceleration = pmf.response(pmf.paper.chain(theta), record)
        pmf.TruncNormalFeature("y", mu=acceleration, sigma=sigma, observed=measured)
        idata = pmf.sample_smc()

A feature likelihood is a probability model of the mean-square discrepancy of each sensor, not of each time
sample: its uncertainty does not depend on the sampling rate.
"""

from pymc_features import datasets, signals
from pymc_features.distributions import CorrelatedNormal, ExpFeature, TruncNormalFeature, sigma_mpv
from pymc_features.external import CommandLine, ExternalSimulator, Surrogate
from pymc_features.ground_motion import synthetic_earthquake
from pymc_features.inference import fisher_information, laplace, sample_nuts, tolerance_sweep
from pymc_features.io import read_channels, read_matrices, read_record
from pymc_features.likelihood_free import DiscrepancySimulator, abc_tolerance
from pymc_features.ops import mean_square_discrepancy, response
from pymc_features.prediction import first_passage_probability, posterior_response
from pymc_features.records import Loading, Record
from pymc_features.signals import check_channels
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
from pymc_features.study import paper, sampling_rate_study

__all__ = [
    "AffineStructure",
    "CommandLine",
    "CorrelatedNormal",
    "DiscrepancySimulator",
    "DuffingChain",
    "ExpFeature",
    "ExternalSimulator",
    "HystereticChain",
    "LinearStructure",
    "Loading",
    "ModalDamping",
    "PersistentSMC",
    "PopulationIMH",
    "PopulationMH",
    "RayleighDamping",
    "Record",
    "SpringMassChain",
    "SubsetSimulation",
    "Surrogate",
    "TMCMC",
    "TruncNormalFeature",
    "abc_tolerance",
    "check_channels",
    "datasets",
    "first_passage_probability",
    "fisher_information",
    "integration_error",
    "laplace",
    "mean_square_discrepancy",
    "paper",
    "plot_chains",  # noqa: F822
    "plot_loops",  # noqa: F822
    "plot_natural_frequencies",  # noqa: F822
    "plot_predictive",  # noqa: F822
    "plot_prior_posterior",  # noqa: F822
    "plot_record",  # noqa: F822
    "plot_response_bands",  # noqa: F822
    "plot_sampling_rate",  # noqa: F822
    "plot_tempering",  # noqa: F822
    "plot_tolerance",  # noqa: F822
    "plot_widths",  # noqa: F822
    "posterior_response",
    "read_channels",
    "read_matrices",
    "read_record",
    "response",
    "sample_nuts",
    "sample_smc",
    "sampling_rate_study",
    "sigma_mpv",
    "signals",
    "simulate",
    "spring_forces",
    "synthetic_earthquake",
    "tolerance_sweep",
]

# on demand: matplotlib takes a second to import
_PLOTS = (
    "plot_chains",
    "plot_loops",
    "plot_natural_frequencies",
    "plot_predictive",
    "plot_prior_posterior",
    "plot_record",
    "plot_response_bands",
    "plot_sampling_rate",
    "plot_tempering",
    "plot_tolerance",
    "plot_widths",
)


def __getattr__(name):
    if name in _PLOTS:
        from pymc_features import plots

        return getattr(plots, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
