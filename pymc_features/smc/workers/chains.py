"""Chains that share workers: each in a thread that waits for its populations."""

import copy
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue

import pymc.smc.sampling
from pymc.progress_bar import SMCProgressBarManager
from pymc.smc.sampling import _sample_smc_sequentially as one_after_another

from pymc_features.smc.workers.workers import Workers

LOOK_SECONDS = 1.0


@contextmanager
def chains_on(workers: Workers | None, most: int) -> Iterator[None]:
    """Let `pm.sample_smc`, asked for chains one after another, run up to `most` at once on workers.

    Each chain has a kernel and random numbers of its own, so that its draws do not depend on the others.
    Without workers nothing changes.
    """

    def side_by_side(*, kernel, chains, rngs, start_points, model, traces, **rest):
        for own in run_chains(kernel, start_points, rngs, most, workers, rest):
            build = pymc.smc.sampling._build_trace_from_kernel_state
            given = own.kernel.tempered_posterior, own.kernel.var_info, own.kernel.variables
            traces.append(build(*given, own.number, model))
            rest["sample_stats"].append(own.stats)
            rest["sample_settings"].append(own.kernel.sample_settings())

    if workers is not None:
        pymc.smc.sampling._sample_smc_sequentially = side_by_side
    try:
        yield
    finally:
        pymc.smc.sampling._sample_smc_sequentially = one_after_another


class Chain:
    """One chain, run by `run` as PyMC runs it.

    Parameters
    ----------
    number : int
    kernel : PopulationKernel
        Of its own.
    start : dict or None
    rng : Generator
    """

    def __init__(self, number, kernel, start, rng):
        self.number, self.kernel, self.start, self.rng = number, kernel, start, rng
        self.stats = {name: [] for name in kernel.stats_dtypes_shapes}

    def run(self, told: SimpleQueue):
        """Advance to the posterior; what the progress bar shows goes to `told`."""
        kernel, stage = self.kernel, 0
        kernel.initialize(self.start, self.rng)
        while kernel.beta < 1:
            before = kernel.beta
            kernel.update_beta_and_weights()
            told.put({"stage": stage, "beta": kernel.beta, "old_beta": before, "chain_idx": self.number})
            for name, value in kernel.step().items():
                self.stats[name].append(value)
            stage += 1
        last = {"stage": stage, "beta": kernel.beta, "old_beta": kernel.beta, "is_last": True}
        told.put({**last, "chain_idx": self.number})


def run_chains(kernel, start_points, rngs, most, workers, bars) -> list[Chain]:
    """All chains, when they are over; the first error, or Ctrl-C, ends them all."""
    run, chains, told = workers.run(), [], SimpleQueue()
    for number, (start, rng) in enumerate(zip(start_points, rngs, strict=True)):
        own = copy.copy(kernel)
        own.evaluate_by(run.of)
        chains.append(Chain(number, own, start, rng))
    settings = {name: bars[name] for name in ("progressbar", "progressbar_theme")}
    with (
        SMCProgressBarManager(kernel=kernel, chains=len(chains), **settings) as shown,
        ThreadPoolExecutor(most, thread_name_prefix="chain") as pool,
    ):
        try:
            futures = [pool.submit(chain.run, told) for chain in chains]
            for future in futures:
                future.add_done_callback(told.put)
            left = len(futures)
            while left:  # woken up now and then, for Ctrl-C
                with suppress(Empty):
                    news = told.get(timeout=LOOK_SECONDS)
                    if isinstance(news, dict):
                        shown.update(**news)
                    else:
                        news.result()
                        left -= 1
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            run.stop()
            raise
    return chains
