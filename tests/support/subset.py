"""Models with known answers for subset simulation."""

from functools import cache

import numpy as np
import pymc as pm
from scipy.special import expit, gamma

from pymc_features import DiscrepancySimulator, SubsetSimulation, sample_smc
from support.sampling import SERIAL, run_chain


def batched(function):
    """Mark a function as one that takes all particles at once."""
    function.batched = True
    return function


def run(model, draws=500, seed=0, kernel=SubsetSimulation, **settings):
    return run_chain(kernel, model, draws, seed, **settings)


def sample(model, draws=300, chains=1, **settings):
    return sample_smc(
        draws, SubsetSimulation, model=model, chains=chains, **{"random_seed": 1, **SERIAL, **settings}
    )


@batched
def itself(x):
    return x


@cache
def ball(d, epsilon):
    """|x|^2 <= epsilon in a cube of side 2: the exact volume and moments are known."""
    with pm.Model() as model:
        x = pm.Uniform("x", -1.0, 1.0, shape=d)
        DiscrepancySimulator("y", itself, x, epsilon=epsilon, observed=np.zeros(d))
    return model


def radius(d, probability):
    """Of the ball that holds this share of the cube."""
    return 2.0 * (probability * gamma(0.5 * d + 1)) ** (1 / d) / np.sqrt(np.pi)


def cube(r):
    return 2.0 * expit(r.draws) - 1.0


class TwoModes:
    """One parameter, two intervals of unequal share; seeds enough for a mixture of two."""

    epsilon = 1e-4
    stage_draws = 1000

    @staticmethod
    @batched
    def square(x):
        return x[:, None] ** 2

    def model(self):
        with pm.Model() as model:
            x = pm.Normal("x", 0.3, 1.0)
            DiscrepancySimulator("y", self.square, x, epsilon=self.epsilon, observed=np.ones(1))
        return model

    def prior(self, rng, n):
        return rng.normal(0.3, 1.0, (n, 1))

    def rho(self, x, rng):
        return (x[:, 0] ** 2 - 1.0) ** 2

    def natural(self, x):
        return x


class Banana:
    """Two parameters, one of them positive, on a bent strip."""

    epsilon = 1e-3
    stage_draws = None

    @staticmethod
    @batched
    def bent(a, b):
        return np.stack([a**2 + b, 0.3 * a], axis=1)

    def model(self):
        with pm.Model() as model:
            a, b = pm.Normal("a"), pm.Gamma("b", 2.0, 1.0)
            DiscrepancySimulator("y", self.bent, a, b, epsilon=self.epsilon, observed=[1.0, 0.06])
        return model

    def prior(self, rng, n):
        return np.column_stack([rng.normal(size=n), rng.gamma(2.0, size=n)])

    def rho(self, x, rng):
        a, b = x.T
        return (a**2 + b - 1.0) ** 2 + (0.3 * a - 0.06) ** 2

    def natural(self, x):
        return np.column_stack([x[:, 0], np.exp(x[:, 1])])


def stock(function=itself, *, observed=(0.0,), prior=None, **settings):
    """PyMC's own node, of x between -1 and 1."""
    with pm.Model() as model:
        x = pm.Uniform("x", -1.0, 1.0) if prior is None else prior()
        pm.Simulator("y", function, x, observed=np.array(observed), **settings)
    return model


@batched
def identity(rng, x, size):
    return x + np.zeros(np.shape(x) if size is None else np.broadcast_shapes(np.shape(x), tuple(size)))


def own(function, epsilon=1e-4):
    with pm.Model() as model:
        DiscrepancySimulator("y", function, pm.Uniform("x", -1, 1), epsilon=epsilon, observed=np.zeros(1))
    return model


@batched
def twice(rng, x, size):
    return np.broadcast_to(x, (*np.shape(x)[:-1], 2)) * [1.0, -2.0]
