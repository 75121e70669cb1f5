"""Sampling the posterior of one likelihood."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pymc as pm
import xarray as xr
from pymc.sampling.parallel import ParallelSamplingError

from pymc_features import inference, smc
from pymc_features.calibration import calibrate
from pymc_features.exceptions import ConfigError, ToleranceNotReachedError, UncalibratedError
from pymc_features.smc import Workers, sample_smc
from pymc_features.update.chains import without_lost_chains
from pymc_features.update.kinds import KINDS


class Running(NamedTuple):
    """How a likelihood is run; nothing of it changes a draw.

    Attributes
    ----------
    cores : int or None
        Processes.
    workers : Workers or None
        Where populations are evaluated.
    progressbar : bool
        Whether to show PyMC's own.
    out : path or None
        Folder of the update.
    tell : callable (str)
        Called with what is in work.
    """

    cores: int | None
    workers: Workers | None
    progressbar: bool
    out: object
    tell: Callable[[str], None]


def seed_of(problem, kind) -> int:
    """Seed of one likelihood."""
    key = [problem.config.sampler.random_seed, list(KINDS).index(kind)]
    return int(np.random.SeedSequence(key).generate_state(1)[0])


def calibrated(problem, kind, base, model, running: Running) -> xr.DataTree:
    """The posterior whose width the residuals decide, from the part of another likelihood."""
    asked = problem.config.sampler
    try:
        idata = calibrate(
            base,
            model=model,
            draws=asked.draws,
            chains=asked.chains,
            cores=running.cores or asked.cores,
            executor=running.workers,
            random_seed=seed_of(problem, kind),
            progressbar=running.progressbar,
        )
    except ValueError as error:
        raise UncalibratedError(
            f"`likelihood.kinds` must have {kind} only where residuals can tell a width: {error}"
        ) from error
    found = idata["calibration"].to_dataset()
    sensors = problem.first.channels["sensor"].values
    idata["calibration"] = xr.DataTree(found.assign_coords(sensor=sensors))
    return idata


def sample(problem, kind, model, running: Running) -> xr.DataTree:
    """The posterior by the sampler of the configuration, without chains that were lost."""
    idata = by_sampler(problem, kind, model, running)
    if is_cut_short(problem, kind, idata["posterior"].sizes):
        raise KeyboardInterrupt
    return idata if KINDS[kind].is_likelihood_free else without_lost_chains(idata, model)


def by_sampler(problem, kind, model, running: Running) -> xr.DataTree:
    """The posterior by the sampler of the configuration, as it comes."""
    asked = problem.config.sampler
    method = method_of(problem, kind)
    common = {"model": model, "random_seed": seed_of(problem, kind)}
    cores, progressbar = running.cores or asked.cores, running.progressbar
    settings = {"cores": cores, "executor": running.workers, "progressbar": progressbar}
    try:
        if method == "Laplace":
            return inference.laplace(asked.draws, **common)
        if method == "NUTS":
            first = {**settings, "draws": max(500, asked.draws // 2), "chains": asked.chains}
            workers = {} if cores is None else {"cores": cores}
            return inference.sample_nuts(
                asked.draws,
                tune=asked.tune,
                chains=asked.chains,
                sample_settings=first,
                progressbar=progressbar,
                **workers,
                **common,
            )
        settings |= {"chains": asked.chains}
        if method == "sample":
            return inference.sample(asked.draws, **settings, **common)
        settings |= {"compute_convergence_checks": False}
        return sample_smc(asked.draws, getattr(smc, method), **settings, **common)
    except ToleranceNotReachedError as error:
        raise ConfigError(
            f"`likelihood.epsilon` must be within reach of the model: {error} Or leave ABC out of "
            "`likelihood.kinds`; what is finished is kept."
        ) from error
    except (ParallelSamplingError, pm.exceptions.SamplingError, ValueError) as error:
        reason = error.__cause__ if isinstance(error, ParallelSamplingError) else error
        raise ConfigError(f"`priors` must lead to a posterior that {method} can sample: {reason}") from error


def is_cut_short(problem, kind, sizes) -> bool:
    """Whether draws or chains are missing: PyMC's NUTS returns what it has when it is stopped."""
    asked = problem.config.sampler
    chains = 1 if method_of(problem, kind) == "Laplace" else asked.chains
    return sizes["draw"] < asked.draws or sizes["chain"] < chains


def method_of(problem, kind) -> str:
    """How a likelihood is sampled."""
    sampler = problem.config.sampler
    if KINDS[kind].calibrates:
        return "calibrate"
    if KINDS[kind].is_likelihood_free:
        return "SubsetSimulation"
    if problem.config.external is not None and problem.config.external.emulate is not None:
        return "emulate"
    return {"auto": "sample", "smc": sampler.kernel, "nuts": "NUTS", "laplace": "Laplace"}[sampler.method]
