"""PyMC's two Metropolis kernels, random-walk and independent, on whole populations."""

from os import PathLike

import numpy as np
import pymc as pm
from pymc.pytensorf import floatX
from pymc.smc import IMH, MH
from pymc.util import RandomState

from pymc_features._checks import check_positive
from pymc_features.smc.kernels.base import PopulationKernel


class Metropolis(PopulationKernel):
    """Steps of a stage that go on for as long as particles move away from where they began."""

    def __init__(
        self,
        draws: int = 2000,
        *,
        threshold: float = 0.5,
        correlation_threshold: float = 0.01,
        start: dict | None = None,
        model: pm.Model | None = None,
        random_seed: RandomState = None,
        compile_kwargs: dict | None = None,
        checkpoint: str | PathLike | None = None,
    ):
        correlation_threshold = check_positive(
            correlation_threshold, "correlation_threshold", "0.01 is usual."
        )
        PopulationKernel.__init__(
            self,
            draws,
            threshold=threshold,
            start=start,
            model=model,
            random_seed=random_seed,
            compile_kwargs=compile_kwargs,
            checkpoint=checkpoint,
        )
        self.correlation_threshold = correlation_threshold
        self.proposal_dist = None


class PopulationMH(Metropolis, MH):
    """Random-walk Metropolis: the particles of `pymc.smc.MH`, evaluated all at once.

    Parameters
    ----------
    correlation_threshold : float
        Steps of a stage go on while the correlation with its first particles falls by more than this.
    draws, threshold, start, model, random_seed, compile_kwargs, checkpoint
        As of `PopulationKernel`.

    Notes
    -----
    The same seed gives the same particles as PyMC's kernel (tests/smc/test_population.py).
    """

    proposal_scales = chain_acc_rate = None
    stats_dtypes_shapes = {
        **PopulationKernel.stats_dtypes_shapes,
        "mean_accept_rate": (float, []),
        "mean_proposal_scale": (float, []),
    }

    def propose(self) -> tuple[np.ndarray, np.ndarray | float, np.ndarray | float]:
        """Step from each particle, with the covariance of all and a scale of its own."""
        step = self.proposal_dist(num_draws=self.draws, rng=self.rng)
        return floatX(self.tempered_posterior + step * self.proposal_scales[:, None]), 0.0, 0.0

    def mutate(self) -> None:
        """Metropolis steps; their acceptance sets the scales of the next stage."""
        super().mutate()
        self.chain_acc_rate = np.mean(self.accepted, axis=0)

    def sample_stats(self) -> dict:
        """Statistics of the stage just finished."""
        return {
            **PopulationKernel.sample_stats(self),
            "mean_accept_rate": float(self.chain_acc_rate.mean()),
            "mean_proposal_scale": float(self.proposal_scales.mean()),
        }


class PopulationIMH(Metropolis, IMH):
    """Independent Metropolis-Hastings: the particles of `pymc.smc.IMH`, evaluated all at once.

    Parameters
    ----------
    correlation_threshold : float
        Steps of a stage go on while the correlation with its first particles falls by more than this.
    draws, threshold, start, model, random_seed, compile_kwargs, checkpoint
        As of `PopulationKernel`.

    Notes
    -----
    The same seed gives the same particles as PyMC's kernel (tests/smc/test_population.py). Like there,
    1e-6 is added to the variances of the proposal, which starves posteriors narrower than 1e-3 in the sampled
    coordinates: take `PersistentSMC` for those.
    """

    stats_dtypes_shapes = {**PopulationKernel.stats_dtypes_shapes, "accept_rate": (float, [])}

    def propose(self) -> tuple[np.ndarray, np.ndarray | float, np.ndarray | float]:
        """Draw from the Gaussian fitted to the resampled particles."""
        proposal = floatX(self.proposal_dist.rvs(size=self.draws, random_state=self.rng))
        proposal = proposal.reshape(len(proposal), -1)
        forward = self.proposal_dist.logpdf(proposal)
        return proposal, self.proposal_dist.logpdf(self.tempered_posterior), forward

    def sample_stats(self) -> dict:
        """Statistics of the stage just finished."""
        return {**PopulationKernel.sample_stats(self), "accept_rate": float(np.mean(self.accepted))}
