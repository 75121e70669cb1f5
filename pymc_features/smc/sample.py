"""`sample_smc`: PyMC's function with a better default kernel and a result that can be saved."""

import os

import pymc as pm
import xarray as xr
from pymc.sampling.parallel import ParallelSamplingError

from pymc_features.smc.levels import ToleranceNotReachedError
from pymc_features.smc.persistent import PersistentSMC
from pymc_features.smc.results import savable


def sample_smc(
    draws: int = 2000, kernel=PersistentSMC, *, cores: int | None = None, **settings
) -> xr.DataTree:
    """`pm.sample_smc` with `PersistentSMC` by default and a result that saves to netCDF and Zarr.

    Parameters
    ----------
    draws : int
        Draws of each chain.
    kernel : type
        Any kernel of `pm.sample_smc`.
    cores : int, optional
        Chains in parallel; as many as there are processors by default. Where JAX has been used, pass
        mp_ctx="forkserver": a fork may hang.
    **settings
        Of `pm.sample_smc` (`model`, `chains`, `random_seed`, `progressbar`, `mp_ctx`, ...) and of the kernel.

    Returns
    -------
    DataTree
        As from `pm.sample_smc`, but `sample_stats` holds float arrays (chain, stage), padded with NaN, and
        `log_marginal_likelihood` (chain,).

    Raises
    ------
    ToleranceNotReachedError
        From `SubsetSimulation`.

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
    if settings.pop("return_inferencedata", True) is not True:
        raise ValueError(
            "`return_inferencedata` must be True, got False. Use pm.sample_smc() for a MultiTrace."
        )
    try:
        return savable(pm.sample_smc(draws, kernel, cores=cores or processors(), **settings))
    except ParallelSamplingError as error:
        if isinstance(error.__cause__, ToleranceNotReachedError):  # the same with one process and with many
            raise error.__cause__ from None
        raise


def processors() -> int:
    """Number of processors that this process may use."""
    return os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()
