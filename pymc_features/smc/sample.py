"""`sample_smc`: PyMC's function with a better default kernel and a result that can be saved."""

import os
from concurrent.futures import Executor

import numpy as np
import pymc as pm
import xarray as xr
from pymc.sampling.parallel import ParallelSamplingError
from pymc.smc.kernels import SMC_KERNEL
from pymc.util import RandomState
from pytensor.graph.traversal import ancestors

from pymc_features._checks import (
    check_flag,
    check_integer,
    check_model,
    check_path,
    check_seed,
    message,
    shown,
)
from pymc_features.exceptions import CheckpointError, NoSpreadError, ToleranceNotReachedError
from pymc_features.external.workers.calls import one_thread_each
from pymc_features.smc.kernels.base import PopulationKernel
from pymc_features.smc.kernels.checkpoint import remembered
from pymc_features.smc.kernels.persistent import PersistentSMC
from pymc_features.smc.results import likelihood_kinds, savable
from pymc_features.smc.trace import all_draws_at_once
from pymc_features.smc.workers.chains import chains_on
from pymc_features.smc.workers.workers import check_workers, open_workers

MOST_RUNS = 10_000  # chains, or processes


def sample_smc(
    draws: int = 2000,
    kernel: type[SMC_KERNEL] = PersistentSMC,
    *,
    chains: int | None = None,
    cores: int | None = None,
    random_seed: RandomState = None,
    checkpoint: str | os.PathLike | None = None,
    executor: int | str | Executor | None = None,
    **settings,
) -> xr.DataTree:
    """`pm.sample_smc` with `PersistentSMC` by default and a result that saves to netCDF and Zarr.

    Parameters
    ----------
    draws : int
        Draws of each chain.
    kernel : type
        Any kernel of `pm.sample_smc`.
    chains : int, optional
        As many as processors, and at least two, by default.
    cores : int, optional
        Chains in parallel; as many as there are processors by default, and one for a model with an
        `ExternalSimulator`, which is parallel by itself. Where JAX has been used, pass
        mp_ctx="forkserver": a fork may hang.
    random_seed : int or sequence of int, optional
        For the same particles each time.
    checkpoint : path-like, optional
        Folder that keeps every evaluation, for the kernels of this package. A run that was killed at any
        moment and is started again goes on from there, with the same seed, and ends with the particles that
        it would have had. Remove the folder when it is done.
    executor : int, str, dask Client or Executor, optional
        Where populations are evaluated, for the kernels of this package: number of local processes, address
        of a Dask scheduler, or any object with `submit` as of `concurrent.futures`. The chains share it, all
        at once or `cores` of them; the particles are those of one process, bit for bit, on processors of one
        kind. By default each chain is evaluated in its own process.
    **settings
        Of `pm.sample_smc` (`model`, `progressbar`, `mp_ctx`, ...) and of the kernel.

    Returns
    -------
    DataTree
        As from `pm.sample_smc`, but `sample_stats` holds float arrays (chain, stage), padded with NaN, and
        `log_marginal_likelihood` (chain,). The attribute `likelihoods` says what each is a density of.

    Raises
    ------
    ToleranceNotReachedError
        From `SubsetSimulation`.
    CheckpointError
        If the checkpoint is damaged, in use, or of another run.
    RuntimeError
        If a process dies that samples a chain.
    NoWorkersError
        If an executor runs nothing any more, or its processes die again and again with the same particles.

    Examples
    --------
    >>> import pymc as pm
    >>> with pm.Model():
    ...     x = pm.Normal("x")
    ...     y = pm.Normal("y", x, 1.0, observed=[1.0])
    ...     idata = sample_smc(200, chains=2, cores=1, random_seed=1, progressbar=False)
    >>> idata.sample_stats["log_marginal_likelihood"].dims
    ('chain',)
    """
    check_run(draws, chains, cores, random_seed, settings.get("progressbar", True))
    check_kernel(kernel)
    check_workers(executor)
    model = check_model(settings.get("model"))
    if settings.pop("return_inferencedata", True) is not True:
        raise ValueError(
            "`return_inferencedata` must be True, got False. Use pm.sample_smc() for a MultiTrace."
        )
    default_chains = max(2, cores or processors())
    for name, given in (("checkpoint", checkpoint), ("executor", executor)):
        if given is not None and not issubclass(kernel, PopulationKernel):
            raise TypeError(
                f"`{name}` must be left out for {kernel.__name__}, which has none. Use a kernel of "
                "pymc_features."
            )
    if checkpoint is not None:
        check_path(checkpoint, "checkpoint")
        random_seed, chains = remembered(checkpoint, random_seed, chains, default_chains)
        settings["checkpoint"] = checkpoint
    if chains is None:
        chains = default_chains
    at_once = min(cores or chains, chains)
    if executor is not None:
        cores = 1  # process; chains in threads
    elif cores is None:
        cores = 1 if is_parallel_by_itself(model) else processors()
    try:
        with (
            open_workers(executor) as workers,
            chains_on(workers, at_once),
            all_draws_at_once(),
            one_thread_each(),
        ):
            found = pm.sample_smc(
                draws, kernel, chains=chains, cores=cores, random_seed=random_seed, **settings
            )
        idata = savable(found)
    except ParallelSamplingError as error:
        # the same with one process and with many
        if isinstance(error.__cause__, ToleranceNotReachedError | CheckpointError | NoSpreadError):
            raise error.__cause__ from None
        raise
    except (EOFError, ConnectionResetError) as error:
        raise RuntimeError(
            "a process that sampled a chain died: killed, or out of memory. Sample with fewer `cores` or "
            "`draws`; with `checkpoint` the next run goes on from there."
        ) from error
    idata["sample_stats"].attrs["likelihoods"] = likelihood_kinds(model)
    return idata


def check_run(draws, chains, cores, random_seed, progressbar) -> None:
    """Refuse sizes of a run that are no sizes."""
    check_integer(draws, "draws", least=2)
    for name, value in (("chains", chains), ("cores", cores)):
        if value is not None:
            check_integer(value, name, most=MOST_RUNS)
    n = max(2, cores or processors()) if chains is None else chains
    if np.ndim(check_seed(random_seed, states=True)) and len(random_seed) != n:
        wanted = f"one integer, or one for each of the {n} chains"
        raise ValueError(message("random_seed", wanted, f"{len(random_seed)} integers"))
    check_flag(progressbar, "progressbar")


def check_kernel(kernel) -> None:
    """Refuse what is no class of kernels."""
    if not (isinstance(kernel, type) and issubclass(kernel, SMC_KERNEL)):
        advice = "Pass the class, for example PersistentSMC."
        raise TypeError(message("kernel", "a kernel of `pm.sample_smc`", shown(kernel), advice))


def is_parallel_by_itself(model) -> bool:
    """Whether something in the model takes many processors for one chain."""
    for v in ancestors([*model.basic_RVs, *model.potentials]):
        op = getattr(v.owner, "op", None)
        fn = getattr(op, "fn", None)  # of a simulator node; with noise there is another inside
        inner = getattr(getattr(fn, "simulator", fn), "op", None)
        if getattr(op, "expensive", False) or getattr(inner, "expensive", False):
            return True
    return False


def processors() -> int:
    """Number of processors that this process may use."""
    return os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()
