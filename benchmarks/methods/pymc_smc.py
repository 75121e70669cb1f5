"""`pm.sample_smc` with PyMC's own kernels and with ours."""

import time

import numpy as np
import pymc as pm
from pymc.smc.kernels import IMH, MH

import pymc_features as pmf
from benchmarks.methods.result import NotThereError, Result
from benchmarks.problem import DRAWS

STOCK = {"IMH": IMH, "MH": MH}


class Counted:
    """A compiled log-probability that counts its calls."""

    def __init__(self, function):
        self.function = function
        self.calls = 0

    def __call__(self, point):
        self.calls += 1
        return self.function(point)


def watched(kernel, clock, count):
    """Return a subclass of `kernel` that notes when its set-up ends and, if asked, counts evaluations."""

    class Watched(kernel):
        def initialize_population(self):
            population = super().initialize_population()
            if count:
                self.likelihood_logp_func = clock["likelihood"] = Counted(self.likelihood_logp_func)
            clock["start"] = time.perf_counter()
            return population

        def initial_particles(self, n):  # what our kernels have in its place
            particles = super().initial_particles(n)
            clock["start"] = time.perf_counter()
            return particles

    return Watched


def run_chain(kernel, model, draws, seed):
    """Run one chain; return it without PyMC's checks of convergence."""
    with model:
        return pm.sample_smc(
            draws,
            kernel,
            chains=1,
            cores=1,
            random_seed=seed,
            compute_convergence_checks=False,
            progressbar=False,
        )


def log_evidence(idata):
    """The last estimate of a chain."""
    stages = np.ravel(np.asarray(idata["sample_stats"]["log_marginal_likelihood"].values, dtype=float))
    return stages[np.isfinite(stages)][-1]


def sample(kernel, model, seed, count=False):
    """Run one chain of 1000 draws; evaluations are counted or taken from the kernel's own statistics."""
    clock = {}
    begin = time.perf_counter()
    idata = run_chain(watched(kernel, clock, count), model, DRAWS, seed)
    stats = idata["sample_stats"]
    if count:
        evaluations = clock["likelihood"].calls
    else:
        evaluations = float(np.nansum(stats["evaluations"].values)) if "evaluations" in stats else np.nan
    posterior = idata["posterior"]
    return Result(
        np.ravel(posterior["theta"].values),
        np.ravel(posterior["sigma"].values),
        evaluations,
        log_evidence(idata),
        clock["start"] - begin,
    )


def stock(name):
    """Method: one of PyMC's kernels on our fused Op."""
    return lambda problem, seed: sample(STOCK[name], problem.model, seed, count=True)


def ours(name):
    """Method: one of our kernels on our fused Op."""

    def method(problem, seed):
        kernel = getattr(pmf, name, None)
        if kernel is None:
            raise NotThereError(f"pymc_features has no {name}")
        return sample(kernel, problem.model, seed)

    return method
