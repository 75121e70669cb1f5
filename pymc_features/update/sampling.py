"""Sampling every likelihood of a problem; what is finished is kept."""

import contextlib
import json
import logging
import time
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pymc as pm
import xarray as xr
from pymc.sampling.parallel import ParallelSamplingError

from pymc_features import inference, smc
from pymc_features.calibration import calibrate
from pymc_features.exceptions import ConfigError, ToleranceNotReachedError, UncalibratedError
from pymc_features.inference.sample import without_lost_chains
from pymc_features.smc import Workers, open_workers, sample_smc
from pymc_features.storage import SUMMED, PartStore, held, moved_aside, settings_in
from pymc_features.update.config.keys import with_keys
from pymc_features.update.config.sections import ERRORS
from pymc_features.update.kinds import KINDS
from pymc_features.update.kinds.base import declare, draws_of_priors, frequencies, names_for
from pymc_features.update.problem import Problem

LOG = logging.getLogger("pymc_features")
PRIOR_DRAWS = 4000
GROUPS = ("posterior", "sample_stats", "particles", "modes", "calibration", "sequence", "emulation")


class Running(NamedTuple):
    """How an update runs, see `run_update`; of one likelihood `progress` takes a sentence."""

    out: Any = None
    cores: int | None = None
    executor: int | str | Executor | Workers | None = None
    progress: Callable | None = None
    progressbar: bool = False

    def of_sampler(self, asked) -> dict:
        """Arguments that samplers share, with the section [sampler]."""
        sizes = {"draws": asked.draws, "chains": asked.chains, "cores": self.cores or asked.cores}
        return sizes | {"executor": self.executor, "progressbar": self.progressbar}


def run_parts(problem: Problem, settings: Running) -> tuple[dict[str, xr.DataTree], dict[str, str]]:
    """Likelihoods to what was sampled, now or before, and calibrated ones to why they could not be had."""
    if settings.executor is not None and problem.config.sampler.method == "laplace":
        raise ConfigError("`sampler.method` must be one with populations for an executor, got laplace.")
    kinds, parts, failed = problem.kinds, {}, {}
    tell = settings.progress or (lambda part, done, total: None)
    kept = {} if settings.out is None else kept_parts(problem, Path(settings.out))
    alone = contextlib.nullcontext() if settings.out is None else held(settings.out, "update")
    with alone, open_workers(settings.executor) as workers:
        store = PartStore(settings.out, problem.settings(), "update")
        for kind, part in kept.items():
            store.save(kind, part)
        for done, kind in enumerate(kinds):
            tell(kind, done, len(kinds))
            tolerance = problem.first.tolerance(parts) if kind == "ABC" else None
            own = {"epsilon": tolerance, "events": problem.first.identity or None}
            part = store.load(kind)
            if part is None or any(part.attrs.get(name) != value for name, value in own.items()):
                base = parts.get(KINDS[kind].calibrates)
                of_part = partial(tell, done=done, total=len(kinds))
                running = settings._replace(executor=workers, progress=of_part)
                try:
                    part = run_part(problem, kind, own, base, running)
                except UncalibratedError as error:
                    failed[kind] = str(error)
                    continue
                store.save(kind, part)
            parts[kind] = part
    tell("report", len(kinds), len(kinds))
    return parts, failed


def kept_parts(problem: Problem, out: Path) -> dict[str, xr.DataTree]:
    """Finished likelihoods that changed settings do not touch, where a folder has others; it is renamed."""
    with held(out, "update"):
        known, wanted = settings_in(out, "update"), problem.settings()
        if known is None or (known := {k: v for k, v in known.items() if k != SUMMED}) == wanted:
            return {}
        store = PartStore(out, known, "update")
        same = [k for k in problem.kinds if settings_of(problem, k, known) == settings_of(problem, k, wanted)]
        parts = {kind: part for kind in same if (part := store.load(kind)) is not None}
    changed = sorted(key for key in known | wanted if known.get(key) != wanted.get(key))
    LOG.info(
        "`%s` changed: the result of before is kept in %s%s.",
        "`, `".join(changed[:3]) + ("`, ..." if len(changed) > 3 else ""),
        moved_aside(out),
        f", and {', '.join(parts)} stays as it is" if parts else "",
    )
    return parts


def settings_of(problem: Problem, kind: str, flat: dict) -> dict:
    """Choose the settings that one likelihood depends on."""
    sources = list(filter(None, (kind, KINDS[kind].calibrates)))
    names = {name for source in sources for name in names_for(problem, source)}
    taken = {name for source in sources for name in KINDS[source].takes}

    def is_of(key):
        section, name = [*key.split("."), ""][:2]
        return {"priors": name in names, "likelihood": name not in ERRORS or name in taken}.get(section, True)

    return {key: value for key, value in flat.items() if is_of(key)}


def run_part(problem, kind, own, base, running: Running) -> xr.DataTree:
    """Sample one posterior, or calibrate `base`, and predict with it; warnings are part of the result."""
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        model = declare(problem, kind, own["epsilon"])
        if base is None:
            sampled = problem.first.sample(problem, kind, model, seed_of(problem, kind), running)
            idata, model = sampled or (sample(problem, kind, model, running), model)
        else:
            idata = calibrated(problem, kind, base, model, running)
        part = {name: idata[name].to_dataset() for name in GROUPS if name in idata.children}
        part["prior"] = draws_of_priors(problem, names_for(problem, kind), PRIOR_DRAWS)
        for data in problem.shown:
            part |= data.predict(problem, kind, model, idata)
        if problem.structure.has_modes:
            part["modal"] = frequencies(problem, part["posterior"])
    ours = [w for w in caught if w.category.__module__.startswith("pymc_features")]  # others: of machinery
    messages = list(dict.fromkeys(with_keys(str(warning.message)) for warning in ours))
    tree = xr.DataTree.from_dict(part)
    tree.attrs = {"kind": kind, "method": method_of(problem, kind), "seconds": time.perf_counter() - start}
    tree.attrs |= {"warnings": json.dumps(messages)}
    tree.attrs |= {name: idata.attrs[name] for name in ("calibration",) if name in part}
    tree.attrs |= {name: value for name, value in own.items() if value is not None}
    return tree


def seed_of(problem, kind) -> int:
    key = [problem.config.sampler.random_seed, list(KINDS).index(kind)]
    return int(np.random.SeedSequence(key).generate_state(1)[0])


def method_of(problem, kind) -> str:
    sampler = problem.config.sampler
    if KINDS[kind].calibrates:
        return "calibrate"
    if KINDS[kind].is_likelihood_free:
        return "SubsetSimulation"
    if problem.config.external is not None and problem.config.external.emulate is not None:
        return "emulate"
    return {"auto": "sample", "smc": sampler.kernel, "nuts": "NUTS", "laplace": "Laplace"}[sampler.method]


def calibrated(problem, kind, base, model, running: Running) -> xr.DataTree:
    """The posterior whose width the residuals decide, from the part of another likelihood."""
    settings = running.of_sampler(problem.config.sampler)
    try:
        idata = calibrate(base, model=model, random_seed=seed_of(problem, kind), **settings)
    except ValueError as error:
        raise UncalibratedError(
            f"`likelihood.kinds` must have {kind} only where residuals can tell a width: {error}"
        ) from error
    found, sensors = idata["calibration"].to_dataset(), problem.first.channels["sensor"].values
    idata["calibration"] = xr.DataTree(found.assign_coords(sensor=sensors))
    return idata


def sample(problem, kind, model, running: Running) -> xr.DataTree:
    """The posterior by the sampler of the configuration, without chains that were lost."""
    asked, method = problem.config.sampler, method_of(problem, kind)
    settings, given = running.of_sampler(asked), {"model": model, "random_seed": seed_of(problem, kind)}
    try:
        if method == "Laplace":
            idata, settings["chains"] = inference.laplace(asked.draws, **given), 1
        elif method == "NUTS":
            given |= {name: settings[name] for name in ("chains", "progressbar")}
            given |= {"cores": settings["cores"]} if settings["cores"] else {}
            before = settings | {"draws": max(500, asked.draws // 2)}
            idata = inference.sample_nuts(asked.draws, tune=asked.tune, sample_settings=before, **given)
        elif method == "sample":
            idata = inference.sample(**settings, **given)
        else:
            kernel = getattr(smc, method)
            idata = sample_smc(kernel=kernel, compute_convergence_checks=False, **settings, **given)
    except ToleranceNotReachedError as error:
        raise ConfigError(
            f"`likelihood.epsilon` must be within reach of the model: {error} Or leave ABC out of "
            "`likelihood.kinds`; what is finished is kept."
        ) from error
    except (ParallelSamplingError, pm.exceptions.SamplingError, ValueError) as error:
        reason = error.__cause__ if isinstance(error, ParallelSamplingError) else error
        raise ConfigError(f"`priors` must lead to a posterior that {method} can sample: {reason}") from error
    sizes = idata["posterior"].sizes
    if sizes["draw"] < asked.draws or sizes["chain"] < settings["chains"]:
        raise KeyboardInterrupt  # PyMC's NUTS returns what it has when it is stopped
    return idata if KINDS[kind].is_likelihood_free else without_lost_chains(idata, model)
