"""Models with an external simulator under each likelihood."""

import os
from concurrent.futures import Future

import pymc as pm

from pymc_features import CorrelatedNormal, DiscrepancySimulator, ExpFeature, TruncNormalFeature
from pymc_features.external.workers.calls import Outcome
from support.external_functions import beam

LIKELIHOODS = {
    "NORM": lambda mu, sigma, data: pm.Normal("y", mu, sigma, observed=data),
    "TN": lambda mu, sigma, data: TruncNormalFeature("y", mu, sigma, observed=data),
    "EXP": lambda mu, sigma, data: ExpFeature("y", mu, sigma, observed=data),
    "correlated": lambda mu, sigma, data: CorrelatedNormal(
        "y", mu, sigma, correlation_time=0.1, dt=0.02, observed=data
    ),
    "ABC": lambda mu, sigma, data: DiscrepancySimulator(
        "y", mu, epsilon=0.5, observed=data, kernel="exponential"
    ),
}


def model_of(likelihood, mu_of, data):
    """theta and sigma with a likelihood."""
    with pm.Model() as model:
        theta, sigma = pm.Uniform("theta", 0.5, 1.5), pm.Uniform("sigma", 0.01, 1.0)
        LIKELIHOODS[likelihood](mu_of(theta), sigma, data)
    return model


class BrokenElsewhere:
    """Cannot be unpickled in other processes."""

    def __call__(self, k):
        return beam(k)

    def __reduce__(self):
        fails = "(_ for _ in ()).throw(ImportError('no module named solver'))"
        return eval, (f"__import__('os').getpid() == {os.getpid()} or {fails}",)


class AtOnce:
    """An executor that runs a function here, without a process; counts. Whole responses only."""

    def __init__(self, function):
        self.function, self.runs = function, 0

    def submit(self, call, digest, arguments, *_):
        """The result, done."""
        self.runs += 1
        future = Future()
        try:
            future.set_result(Outcome("ok", self.function(*arguments)))
        except RuntimeError as error:
            future.set_result(Outcome("error", message=str(error)))
        return future
