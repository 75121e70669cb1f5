"""Two stiffness groups at a hard tolerance, with the exact answer by a grid.

The data of `benchmarks.problem` (ten storeys, ten floors measured, 1000 samples, 5 % noise). theta_1 scales
springs 0 to 4 and theta_2 springs 5 to 9, with priors U(0.5, 1.5); the truth is (1, 1). ABC keeps the prior
where rho = sum_j e_j <= epsilon, and epsilon is such that the prior does so with probability P = 2.6e-4.
"""

from functools import cached_property

import numpy as np
import pymc as pm
from scipy.interpolate import RectBivariateSpline

import pymc_features as pmf
from benchmarks.problem import Problem
from pymc_features.simulators import (
    ChainParameters,
    chain_discrepancy,
    chain_response,
    population_discrepancy,
)

LOWER, UPPER = 0.5, 1.5  # of both factors
ACCEPTANCE = 2.6e-4  # P(rho <= epsilon) under the prior
GROUPS = (slice(0, 5), slice(5, 10))
COARSE, NODES, FINE = 101, 61, 1501  # points a side: of the prior, of the region, of its interpolation


class ToleranceProblem:
    """Record, data and simulator.

    Parameters
    ----------
    draws : int
        Asked of every method that lets one ask.
    """

    def __init__(self, draws=1000):
        self.draws = draws
        example = Problem()
        self.record, self.measured = example.record, example.measured
        self.parameters = example.parameters
        self.settings = example.settings

    def stiffness(self, theta):
        """Springs [N/m], shape (..., 10), of factors (..., 2)."""
        stiffness = np.empty((*np.shape(theta)[:-1], 10))
        for k, group in enumerate(GROUPS):
            stiffness[..., group] = self.parameters[1][group] * theta[..., k, None]
        return stiffness

    def rho(self, theta):
        """Discrepancies (n,) of points (n, 2), by the batched kernel."""
        mass, _, *damping = (p[None] for p in self.parameters)
        population = ChainParameters(mass, self.stiffness(np.asarray(theta)), *damping)
        return population_discrepancy(population, *self.settings, self.measured).sum(axis=1)

    def rho_of_one(self, theta):
        """Discrepancy of one point (2,), by the scalar kernel."""
        return chain_discrepancy(self.structure(theta), *self.settings, self.measured).sum()

    def response_of_one(self, theta):
        """Response (10, 1000) of one point (2,)."""
        return chain_response(self.structure(theta), *self.settings)

    def structure(self, theta):
        """Mass, stiffness, damping of one point (2,)."""
        mass, _, *damping = self.parameters
        return ChainParameters(mass, self.stiffness(np.asarray(theta)), *damping)

    @cached_property
    def exact(self):
        """The tolerance and the posterior."""
        return ExactRegion(self.rho)

    @cached_property
    def model(self):
        """The PyMC model with our node."""
        with pm.Model() as model:
            theta = pm.Uniform("theta", LOWER, UPPER, shape=2)
            chain = pmf.paper.chain()
            for k, group in enumerate(GROUPS):
                chain = chain.scale_stiffness(theta[k], springs=range(10)[group])
            response = pmf.response(chain, self.record)
            pmf.DiscrepancySimulator("y", response, epsilon=self.exact.epsilon, observed=self.measured)
        return model


class ExactRegion:
    """{rho <= epsilon}, from rho on a grid.

    A coarse grid over the prior finds the box where rho is small; in it rho is a smooth function, computed
    at 61 x 61 nodes and interpolated by bicubic splines to 1501 x 1501 points.

    Attributes
    ----------
    epsilon : float
        Tolerance with P(rho <= epsilon) = 2.6e-4.
    mean : array (2,)
    covariance : array (2, 2)
        Of the uniform distribution on the region.
    """

    def __init__(self, rho):
        coarse = np.linspace(LOWER, UPPER, COARSE)
        values = rho(grid(coarse, coarse))
        small = np.argwhere(values.reshape(COARSE, COARSE) <= np.quantile(values, 10.0 * ACCEPTANCE))
        corners = np.array([small.min(axis=0) - 1, small.max(axis=0) + 1])
        ends = coarse[np.clip(corners, 0, COARSE - 1)]
        nodes = np.linspace(*ends, NODES)
        spline = RectBivariateSpline(*nodes.T, rho(grid(*nodes.T)).reshape(NODES, NODES))
        fine = np.linspace(*ends, FINE)
        surface = spline(*fine.T)
        cell = np.prod((ends[1] - ends[0]) / (FINE - 1)) / (UPPER - LOWER) ** 2
        self.epsilon = float(np.sort(surface, axis=None)[round(ACCEPTANCE / cell)])
        inside = np.argwhere(surface <= self.epsilon)
        edge = (inside.min(axis=0) == 0) | (inside.max(axis=0) == FINE - 1)
        if edge.any():
            raise RuntimeError("the region within the tolerance reaches out of its box: enlarge the box.")
        region = np.column_stack([fine[inside[:, k], k] for k in (0, 1)])
        self.mean, self.covariance = region.mean(axis=0), np.cov(region.T)


def grid(*axes):
    """Points (n, 2) of a grid, the second coordinate fastest."""
    return np.column_stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")])
