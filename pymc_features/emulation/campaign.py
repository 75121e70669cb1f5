"""Runs of a simulator so far, the emulator that they make, and densities of the model with it."""

import logging
import warnings
from contextlib import ExitStack, contextmanager

import numpy as np

from pymc_features.emulation.emulator import Coordinates, Emulator
from pymc_features.emulation.replacement import Part
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


class Response:
    """Runs of one simulator so far, and their emulator.

    Parameters
    ----------
    part : Part
    prior : array (n, d)
        Draws from the prior, unconstrained, for the scales of the parameters.

    Attributes
    ----------
    x : array (run, parameter)
        What the simulator was called with.
    found : array (run, sensor, time) or (run, sensor)
    """

    def __init__(self, part: Part, prior):
        self.simulator, self.stand_in, self.parameters_of = part
        x = self.x_of(prior)
        self.coordinates, self.x = Coordinates.of(x), x[:0]
        shape = self.simulator.shape
        self.found = np.empty((0, *(shape[:1] if self.simulator.returns == "mean_square" else shape)))

    @property
    def emulator(self) -> Emulator:
        """The emulator of all runs."""
        return self.stand_in.emulator

    def x_of(self, theta):
        """Arguments of the simulator as rows of numbers (n, parameter)."""
        parameters = self.parameters_of(theta)
        return np.concatenate([p.reshape(len(theta), -1) for p in parameters], axis=1)

    def run(self, theta, refit):
        """Simulate at points (n, d), and emulate with what is known then."""
        parameters = self.parameters_of(theta)
        if self.simulator.returns == "mean_square":
            found = self.simulator.discrepancies(*parameters, observed=None)
        else:
            found = self.simulator.responses(*parameters)
        self.x = np.concatenate([self.x, self.x_of(theta)])
        self.found = np.concatenate([self.found, found])
        usable = np.isfinite(self.found).reshape(len(self.found), -1).all(axis=1).sum()
        if usable < LEAST_USABLE:
            failure = next(iter(self.simulator.failures), None)
            raise RuntimeError(
                f"{len(self.found) - usable} of {len(self.found)} simulations failed, too many to go on: "
                f"{failure.message if failure else 'results are not finite'}. See simulator.failures."
            )
        self.stand_in.emulator = Emulator(self.x, self.found, self.coordinates, self.emulator, refit)


class Campaign:
    """Simulations, one batch after the other.

    Parameters
    ----------
    model : pymc.Model
        With stand-ins.
    parts : list of Part
        Its responses.
    prior : array (n, d)
        Draws from the prior, unconstrained.

    Attributes
    ----------
    theta : array (run, d)
        Where the model was run, unconstrained.
    """

    def __init__(self, model, parts: list[Part], prior):
        self.model, self.space = model, Unconstrained(model)
        self.responses = [Response(part, prior) for part in parts]
        self.theta, self.fitted_to, self._logp = prior[:0], 0, None

    @property
    def n_runs(self) -> int:
        """Simulations of each response, those that failed included."""
        return len(self.theta)

    def run(self, theta):
        """Simulate at points (n, d), and emulate with what is known then."""
        self.theta = np.concatenate([self.theta, theta])
        refit = self.n_runs >= REFIT * self.fitted_to
        for response in self.responses:
            response.run(theta, refit)
        if refit:
            self.fitted_to = self.n_runs

    @property
    def logp(self):
        """Log prior and log-likelihood of points (n, d), compiled once."""
        if self._logp is None:
            self._logp = population_logp(self.model, self.space.point, {})
        return self._logp

    def log_likelihood(self, theta, shifts=None):
        """Log-likelihood of points (n, d) by the emulators; with components off by so many deviations."""
        with ExitStack() as stack:
            for response, shift in zip(self.responses, shifts or [], strict=shifts is not None):
                stack.enter_context(response.stand_in.shifted(shift))
            return self.logp(theta)[1]

    def true_log_likelihood(self, theta):
        """Log-likelihood of points (n, d) at which the simulators were run."""
        with ExitStack() as stack:
            for response in self.responses:
                stack.enter_context(response.stand_in.true_runs())
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
