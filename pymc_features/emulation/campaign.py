"""Runs of a simulator so far, the emulator that they make, and densities of the model with it."""

import logging
import warnings
from contextlib import contextmanager

import numpy as np

from pymc_features.emulation.emulator import Coordinates, Emulator
from pymc_features.emulation.replacement import Replacement
from pymc_features.exceptions import SamplingWarning
from pymc_features.inference.parameters import Unconstrained, to_unconstrained
from pymc_features.smc import population_logp, sample_smc

REFIT = 1.2  # growth of the number of runs after which the hyperparameters are fitted again
LEAST_USABLE = 5


@contextmanager
def quietly():
    """Without what samplers say of each run: there are many."""
    logger = logging.getLogger("pymc")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SamplingWarning)
            yield
    finally:
        logger.setLevel(level)


class Campaign:
    """Simulations, one batch after the other.

    Parameters
    ----------
    replacement : Replacement
    prior : array (n, d)
        Draws from the prior, unconstrained, for the scales of the parameters.

    Attributes
    ----------
    theta : array (run, d)
        Where the model was run, unconstrained.
    """

    def __init__(self, replacement: Replacement, prior):
        self.simulator, self.stand_in, self.model, self.parameters_of = replacement
        self.space = Unconstrained(self.model)
        self.coordinates = Coordinates.of(self.x_of(prior))
        self.theta, self.x = np.empty((0, prior.shape[1])), None
        self.responses, self.fitted_to, self._logp = None, 0, None

    def x_of(self, theta):
        """Arguments of the simulator as rows of numbers (n, k)."""
        parameters = self.parameters_of(theta)
        return np.concatenate([p.reshape(len(theta), -1) for p in parameters], axis=1)

    @property
    def n_runs(self) -> int:
        """Simulations, those that failed included."""
        return len(self.theta)

    def run(self, theta):
        """Simulate at points (n, d), and emulate with what is known then."""
        parameters, x = self.parameters_of(theta), self.x_of(theta)
        if self.simulator.returns == "mean_square":
            found = self.simulator.discrepancies(*parameters, observed=None)
        else:
            found = self.simulator.responses(*parameters)
        before = self.x is not None
        self.theta = np.concatenate([self.theta, theta])
        self.x = np.concatenate([self.x, x]) if before else x
        self.responses = np.concatenate([self.responses, found]) if before else found
        self.fit()

    def fit(self):
        """Emulate all runs."""
        usable = np.isfinite(self.responses).reshape(self.n_runs, -1).all(axis=1)
        if usable.sum() < LEAST_USABLE:
            failure = next(iter(self.simulator.failures), None)
            raise RuntimeError(
                f"{self.n_runs - usable.sum()} of {self.n_runs} simulations failed, too many to go on: "
                f"{failure.message if failure else 'results are not finite'}. See simulator.failures."
            )
        refit = self.n_runs >= REFIT * self.fitted_to
        self.stand_in.emulator = Emulator(
            self.x, self.responses, self.coordinates, self.stand_in.emulator, refit
        )
        if refit:
            self.fitted_to = self.n_runs

    @property
    def logp(self):
        """Log prior and log-likelihood of points (n, d), compiled once."""
        if self._logp is None:
            self._logp = population_logp(self.model, self.space.point, {})
        return self._logp

    def log_likelihood(self, theta, shift=None):
        """Of points (n, d) by the emulator; with components off their means by so many deviations."""
        if shift is None:
            return self.logp(theta)[1]
        with self.stand_in.shifted(shift):
            return self.logp(theta)[1]

    def true_log_likelihood(self, theta):
        """Of points (n, d) at which the simulator was run."""
        with self.stand_in.true_runs():
            return self.logp(theta)[1]

    def sample(self, n, random_seed):
        """Draws (n, d) from the posterior of the emulator."""
        with quietly():
            idata = sample_smc(
                n,
                chains=1,
                cores=1,
                model=self.model,
                random_seed=random_seed,
                progressbar=False,
                compute_convergence_checks=False,
            )
        return to_unconstrained(self.model, idata["posterior"].to_dataset())[0]
