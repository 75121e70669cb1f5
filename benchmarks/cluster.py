"""Populations on several processes or a cluster: what a message costs, what two processes gain, and on paper
what 10, 100 and 1,000 workers would.

Overheads are measured with a model that costs nearly nothing: the time of one part, of many parts in flight,
and of many particles in a part. The paper simulation takes these, the sizes of the populations of a real run,
and the time that the run spends beside its evaluations; then it lets parts queue for workers.
"""

import heapq
import os
import time
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import pymc as pm

import pymc_features as pmf
from benchmarks.structures import N_MODES, frame
from benchmarks.tables import significant, table
from pymc_features.smc import open_workers, population_logp
from pymc_features.smc import workers as spreading
from pymc_features.smc.kernels.base import PopulationKernel
from pymc_features.smc.workers import parts_of

WORKERS = (1, 2, 10, 100, 1000)
UNIT, MANY, LARGE = 8, 64, 8192  # particles of a part; parts in flight; particles of a large part
COSTS = {"2,000 sparse degrees of freedom": 20e-3, "structures of a second": 1.0}  # of a particle [s]


class Overhead(NamedTuple):
    """What it costs to have a population evaluated elsewhere.

    Attributes
    ----------
    answer : float
        From sending one part until its result is there [s].
    part : float
        Of each further part, while others are under way [s]: the sender's time.
    particle : float
        Of each particle in a part [s].
    """

    answer: float
    part: float
    particle: float


def model_of(build, record, sensors=None, n_modes=None):
    """Stiffness factors of a structure and the scale of the errors, with data of its own."""
    history = {"sensors": sensors, "n_modes": n_modes}
    data = pmf.simulate(build(np.ones(2)), record, **history).values
    data = data + 0.1 * data.std() * np.random.default_rng(1).standard_normal(data.shape)
    with pm.Model() as model:
        x, sigma = pm.LogNormal("x", 0.0, 0.2, shape=2), pm.HalfNormal("sigma", 1.0)
        pmf.ExpFeature("y", mu=pmf.response(build(x), record, **history), sigma=sigma, observed=data)
    return model


def storeys(x):
    """Ten storeys, linear."""
    return pmf.SpringMassChain(np.ones(10), 1800.0, pmf.ModalDamping(0.02)).scale_stiffness(x, [0, 1])


def yielding(x):
    """Ten storeys that yield."""
    springs = {"yield_displacement": 0.02, "post_yield_ratio": 0.1}
    chain = pmf.HystereticChain(np.ones(10), 1800.0 * np.ones(10), pmf.ModalDamping(0.02), **springs)
    return chain.scale_stiffness(x, [0, 1])


def cheap():
    """A model of a few microseconds a particle."""
    return model_of(storeys, pmf.Record(np.random.default_rng(0).standard_normal(100), 0.02))


def heavy():
    """Models of a millisecond and more, and a number of particles."""
    ground = pmf.Record(np.random.default_rng(0).standard_normal(1500), 0.02)
    grid = frame(20, 100)
    sensors = np.linspace(499, 1999, 4).astype(int)
    yield "2,000 sparse degrees of freedom", model_of(grid.with_parameters, ground, sensors, N_MODES), 256
    yield "ten storeys that yield, El Centro", model_of(yielding, pmf.datasets.el_centro()), 1024


@contextmanager
def cut_into(parts):
    """Let every population be spread, in given parts (first, end)."""
    known = spreading.parts_of, spreading.Run.some_are_ready
    spreading.parts_of = parts
    spreading.Run.some_are_ready = lambda self, work: True
    try:
        yield
    finally:
        spreading.parts_of, spreading.Run.some_are_ready = known


def equal_parts(size):
    """Parts of `size` particles, two at least."""
    return lambda n, *rest: [(i, i + size) for i in range(0, n, size)]


def seconds_of(evaluate, n, d, size, rounds):
    """Least seconds of a population of n particles in parts of `size`."""
    particles, best = np.random.default_rng(0).normal(0.0, 0.2, (n, d)), np.inf
    with cut_into(equal_parts(size)):
        for _ in range(rounds):
            start = time.perf_counter()
            evaluate(particles)
            best = min(best, time.perf_counter() - start)
    return best


def overhead(executor, rounds) -> Overhead:
    """Measured with a cheap model; its own time is left out."""
    model = cheap()
    logp = population_logp(model, model.initial_point(), {})
    d = logp.start.shape[1]
    with open_workers(executor) as workers:
        evaluate = workers.run().of(logp)
        seconds_of(evaluate, MANY * UNIT, d, UNIT, 3)  # loads the model everywhere
        few = seconds_of(evaluate, 2 * UNIT, d, UNIT, rounds)  # side by side
        many = seconds_of(evaluate, MANY * UNIT, d, UNIT, rounds)
        large = seconds_of(evaluate, 2 * LARGE, d, LARGE, rounds)
    particles, here = np.random.default_rng(0).normal(0.0, 0.2, (LARGE, d)), np.inf
    for _ in range(rounds):
        start = time.perf_counter()
        logp(particles)
        here = min(here, time.perf_counter() - start)
    return Overhead(few, (many - few) / (MANY - 2), max(large - few - here, 0.0) / (2 * LARGE))


@contextmanager
def dask_cluster():
    """Two workers on this machine, and the address of their scheduler."""
    from distributed import LocalCluster

    with LocalCluster(2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        yield cluster.scheduler_address


def gain(model, n, rounds):
    """Least seconds of a population here, by one process and by two; whether all are the same."""
    logp = population_logp(model, model.initial_point(), {})
    particles = np.random.default_rng(0).normal(0.0, 0.2, (n, logp.start.shape[1]))
    best, results = np.full(3, np.inf), [None] * 3
    with open_workers(1) as one, open_workers(2) as two:
        routes = [logp, *(workers.run().of(logp) for workers in (one, two))]
        for route in routes[1:]:
            with cut_into(equal_parts(UNIT)):
                route(particles)  # loads the model everywhere
        for _ in range(rounds):
            for k, route in enumerate(routes):
                start = time.perf_counter()
                results[k] = route(particles)
                best[k] = min(best[k], time.perf_counter() - start)
    same = all(
        np.array_equal(a, b) for result in results[1:] for a, b in zip(result, results[0], strict=True)
    )
    return best, same


# --------------------------------------------------------------------------- on paper


def populations(draws, chains=2):
    """Sizes of the populations of some real chains, and what these compute between two of them [s]."""
    sizes, evaluate, spent = [], PopulationKernel.evaluate, 0.0

    def noted(kernel, particles):
        nonlocal spent
        sizes[-1].append(len(particles))
        start = time.thread_time()
        result = evaluate(kernel, particles)
        spent += time.thread_time() - start
        return result

    PopulationKernel.evaluate = noted
    start = time.thread_time()
    try:
        for k in range(chains):
            sizes.append([])
            pmf.sample_smc(draws, model=cheap(), chains=1, cores=1, random_seed=k, progressbar=False)
    finally:
        PopulationKernel.evaluate = evaluate
    return sizes, (time.thread_time() - start - spent) / sum(map(len, sizes))


def simulated(sizes, between, seconds, workers, cost: Overhead) -> float:
    """Seconds of a run on paper.

    One process sends all parts, one after another, and does the algebra of all chains; a part takes the time
    of its particles, and is back after the time of an answer. Chains wait for their populations only.
    """
    free = [0.0] * workers
    sender, chains = 0.0, [(0.0, k, 0) for k in range(len(sizes))]
    heapq.heapify(chains)
    end = 0.0
    while chains:
        ready, k, done = heapq.heappop(chains)
        if done == len(sizes[k]):
            end = max(end, ready)
            continue
        sender = max(sender, ready) + between
        finished = sender
        least = int(min(0.05 / seconds, sizes[k][done])) + 1
        for first, last in parts_of(sizes[k][done], UNIT, least, workers):
            sender += cost.part
            begin = max(heapq.heappop(free), sender)
            own = (last - first) * (seconds + cost.particle)
            heapq.heappush(free, begin + own)
            finished = max(finished, begin + own + cost.answer)
        heapq.heappush(chains, (finished, k, done + 1))
    return end


def on_paper(cost, draws):
    """Rows of the table: for each model and number of workers, hours and the gain over one process."""
    rows, (known, between) = [], populations(draws)
    for chains in (4, 16):
        sizes = [known[k % len(known)] for k in range(chains)]
        total = sum(map(sum, sizes))
        for name, seconds in COSTS.items():
            alone = total * seconds + between * sum(map(len, sizes))
            gains = [alone / simulated(sizes, between, seconds, n, cost) for n in WORKERS]
            rows.append([f"{name}, {draws} draws, {chains} chains", significant(alone / 3600.0)])
            rows[-1] += [significant(value) for value in gains]
    return rows


def run(quick=False):
    """Print overheads, what two processes gain, and the paper simulation."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, range(os.cpu_count()))  # several processes are to be seen at work
    rounds = 5 if quick else 30
    with dask_cluster() as address:
        costs = {"two local processes": overhead(2, rounds), "Dask, two workers": overhead(address, rounds)}
    print("\n## What it costs to evaluate a population elsewhere\n")
    headers = ["executor", "answer: ms", "each further part: ms", "each particle: us"]
    scales = (1e3, 1e3, 1e6)
    rows = [
        [name, *(significant(x * scale) for x, scale in zip(cost, scales, strict=True))]
        for name, cost in costs.items()
    ]
    print(table(headers, rows), flush=True)
    print("\n## One process and two: seconds of a population\n")
    rows = []
    for name, model, n in heavy():
        (here, one, two), same = gain(model, n // 4 if quick else n, 2 if quick else 5)
        cells = map(significant, (here, one, two, here / two, one / two))
        rows.append([name, *cells, "yes" if same else "NO"])
    headers = ["model", "here", "one", "two", "here / two", "one / two", "same bits"]
    print(table(headers, rows), flush=True)
    print("\n## On paper: times as fast as one process, with the overheads of Dask\n")
    headers = ["run", "one process: h", *(f"{n:,} workers" for n in WORKERS)]
    rows = [row for draws in (1000, 4000) for row in on_paper(costs["Dask, two workers"], draws)]
    print(table(headers, rows), flush=True)
