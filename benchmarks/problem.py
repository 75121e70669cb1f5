"""The example whose posterior every method is asked for, with its exact solution by quadrature.

The ten-storey chain of the source (1800 N/m, theta scales the lowest three springs), all ten floors
measured, TN likelihood, priors theta ~ U(0.5, 1.5) and sigma ~ U(0.01, 0.5) m/s^2. The record is
`synthetic_earthquake(19.98, 0.02, random_seed=1, pga=2.0)`: 1000 samples, scaled so that sigma lies around
0.08 with its 99.99 % quantile at 0.33, well inside its prior. Data: theta = 1 with 5 % noise, seed 2.
"""

from functools import cached_property

import numpy as np
import pymc as pm

import pymc_features as pmf
from pymc_features.likelihoods.catalogue import TN
from pymc_features.simulators import ChainParameters, Excitation, Outputs, chain_discrepancy
from pymc_features.study.exact import DiscrepancyCurve, exact_posterior

LOWER = np.array([0.5, 0.01])  # theta [-], sigma [m/s^2]
UPPER = np.array([1.5, 0.5])
NAMES = ("theta", "sigma")
PROBABILITIES = np.array([0.05, 0.5, 0.95])
DRAWS = 1000  # asked of every method that lets one ask


class Problem:
    """Record, data, likelihood, and the exact posterior."""

    def __init__(self):
        record = pmf.synthetic_earthquake(19.98, 0.02, random_seed=1, pga=2.0)
        self.record = pmf.paper.with_straight_lines(record)
        self.measured = pmf.paper.measurements(self.record, multipliers=(1.0,), random_seed=2).values
        self.parameters = [np.array(p) for p in pmf.paper.chain().parameters()]
        self.settings = (
            Excitation(np.array(self.record.acceleration), self.record.dt, 1, 1),
            Outputs(np.arange(10), n_modes=10, quantity=0),
        )

    def discrepancies(self, theta):
        """e_j by the scalar kernel, shape (10,)."""
        mass, stiffness, rayleigh, ratios = self.parameters
        stiffness = stiffness.copy()
        stiffness[:3] *= theta
        chain = ChainParameters(mass, stiffness, rayleigh, ratios)
        return chain_discrepancy(chain, *self.settings, self.measured)

    def log_likelihood(self, theta, sigma):
        """TN, Eq. (7)."""
        e = self.discrepancies(theta)
        return e.size * (0.5 * np.log(2.0 / np.pi) - np.log(sigma)) - e.sum() / (2.0 * sigma**2)

    @cached_property
    def exact(self):
        """Marginals and log evidence by quadrature."""
        bounds = tuple(zip(LOWER, UPPER, strict=True))
        curve = DiscrepancyCurve(lambda theta: self.discrepancies(theta).sum(), bounds[0], self.measured.size)
        return exact_posterior(curve, TN.exponents(*self.measured.shape), bounds[1])

    @cached_property
    def model(self):
        """The PyMC model on our fused Op."""
        return self.declare(lambda theta: pmf.response(pmf.paper.chain(theta), self.record))

    def declare(self, response):
        """The PyMC model with the response computed by `response(theta)`."""
        with pm.Model() as model:
            theta = pm.Uniform("theta", LOWER[0], UPPER[0])
            sigma = pm.Uniform("sigma", LOWER[1], UPPER[1])
            pmf.TruncNormalFeature("y", mu=response(theta), sigma=sigma, observed=self.measured)
        return model


class CountedLikelihood:
    """The scalar log-likelihood of (theta, sigma), counting its calls."""

    def __init__(self, problem):
        self.problem = problem
        self.calls = 0

    def __call__(self, point):
        """ln L of one point (theta, sigma), array (2,)."""
        self.calls += 1
        theta, sigma = np.ravel(point)
        return self.problem.log_likelihood(theta, sigma)

    def of_unit_cube(self, point):
        """ln L of a point of the unit cube."""
        return self(from_unit_cube(point))


def from_unit_cube(point):
    """Prior transform: (..., 2) in the unit cube to (theta, sigma)."""
    return LOWER + np.asarray(point) * (UPPER - LOWER)


def moments(marginal):
    """Mean and variance of a marginal of `exact_posterior`."""
    weights = np.diff(marginal.below)
    nodes = 0.5 * (marginal.nodes[1:] + marginal.nodes[:-1])
    mean = weights @ nodes
    return mean, weights @ (nodes - mean) ** 2
