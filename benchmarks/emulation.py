"""Posteriors from some hundred runs, beside those of the simulator itself.

Ten storeys under the strong part of El Centro with three or five unknown stiffness factors, run as an
external simulator. The answer weighs the draws by the likelihood of the compiled model, so that the error is
the emulator's and not the sampler's.
"""

from concurrent.futures import Future

import numpy as np
import pymc as pm

import pymc_features as pmf
from benchmarks.tables import significant, table
from pymc_features import paper
from pymc_features.external.emulation import largest_change
from pymc_features.external.workers.calls import Outcome
from pymc_features.inference.parameters import Unconstrained, to_unconstrained
from pymc_features.smc import population_logp

GROUPS = {3: ([0, 1, 2], [3, 4, 5], [6, 7, 8, 9]), 5: ([0, 1], [2, 3], [4, 5], [6, 7], [8, 9])}
RUNS = {3: 150, 5: 400}
LIKELIHOODS = ("TN", "EXP", "NORM")
SEEDS = range(1, 5)


class Here:
    """An executor that runs a function at once, in this process, and counts."""

    def __init__(self, function):
        self.function, self.runs = function, 0

    def submit(self, call, digest, arguments, *_):
        """The result, done."""
        self.runs += 1
        future = Future()
        future.set_result(Outcome("ok", self.function(*arguments)))
        return future


def storeys(factors):
    """The chain of the source with a stiffness factor for each group of storeys."""
    structure = paper.chain(1.0)
    for i, springs in enumerate(GROUPS[len(factors)]):
        structure = structure.scale_stiffness(factors[i], springs=springs)
    return structure


def model_of(likelihood, n_factors, response, data):
    """The model, with the response as a function of the factors."""
    with pm.Model() as model:
        factors = [pm.Uniform(f"x{i}", 0.8, 1.2) for i in range(n_factors)]
        sigma = pm.Uniform("sigma", 0.0, 0.5)
        if likelihood == "NORM":
            pm.Normal("y", response(factors), sigma, observed=data)
        else:
            kind = pmf.TruncNormalFeature if likelihood == "TN" else pmf.ExpFeature
            kind("y", mu=response(factors), sigma=sigma, observed=data)
    return model


def emulated(likelihood, n_factors, seed, record, data):
    """Runs, error of quantiles over the 5-95 % width, error of the log-likelihood, and what was stated."""

    def simulated(*factors):
        return pmf.simulate(storeys(factors), record).values

    runner = Here(simulated)
    simulator = pmf.ExternalSimulator(simulated, data.shape, executor=runner, version="1", progress=False)
    model = model_of(likelihood, n_factors, lambda factors: simulator(*factors), data)
    idata, copy = pmf.emulate(
        RUNS[n_factors], model=model, draws=2000, chains=2, random_seed=seed, progressbar=False
    )
    true = model_of(likelihood, n_factors, lambda factors: pmf.response(storeys(factors), record), data)
    draws = to_unconstrained(copy, idata["posterior"].to_dataset()).reshape(-1, n_factors + 1)
    point = Unconstrained(true).point
    exact, own = (population_logp(m, point, {})(draws)[1] for m in (true, copy))
    stated = idata["emulation"].attrs["largest_error"]
    return runner.runs, largest_change(draws, exact - own), np.std(exact - own), stated


def run(quick=False, names=("3", "5")):
    """Print the table; names are numbers of factors."""
    print("\n## Emulated posteriors of ten storeys: errors of quantiles, % of the 5-95 % width\n")
    strong = pmf.datasets.el_centro()
    strong = pmf.Record(strong.acceleration[:400], strong.dt)
    rows = []
    for n_factors in map(int, names):
        exact = pmf.simulate(storeys(np.ones(n_factors)), strong)
        noise = np.random.default_rng(0).standard_normal(exact.shape)
        data = exact.values + paper.noise_scale(exact)[:, None] * noise
        for likelihood in LIKELIHOODS[: 1 if quick else None]:
            results = [
                emulated(likelihood, n_factors, seed, strong, data) for seed in SEEDS[: 1 if quick else None]
            ]
            runs, error, nats, stated = np.max(results, axis=0)
            name = f"{n_factors} factors, {likelihood}, {len(results)} seeds"
            rows.append(
                [name, f"{runs:.0f}", f"{100 * error:.2g}", significant(nats, 2), significant(stated, 2)]
            )
    headers = ["worst of all seeds", "runs", "error: %", "of ln L: nats", "stated: sd"]
    print(table(headers, rows), flush=True)
