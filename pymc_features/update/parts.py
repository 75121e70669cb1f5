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
import xarray as xr

from pymc_features.exceptions import ConfigError, UncalibratedError
from pymc_features.smc import open_workers
from pymc_features.storage import SUMMED, PartStore, held, moved_aside, settings_in
from pymc_features.update import sampling
from pymc_features.update.config.messages import with_keys
from pymc_features.update.config.sections import ERRORS
from pymc_features.update.kinds import KINDS
from pymc_features.update.kinds.model import declare, frequencies, names_for
from pymc_features.update.problem import Problem
from pymc_features.update.sampling import Running, calibrated, method_of, seed_of

LOG = logging.getLogger("pymc_features")
PRIOR_DRAWS = 4000
GROUPS = ("posterior", "sample_stats", "particles", "modes", "calibration", "sequence", "emulation")


class RunSettings(NamedTuple):
    """How an update runs; nothing of it changes a draw. See `run_update`."""

    out: Any = None
    cores: int | None = None
    executor: int | str | Executor | None = None
    progress: Callable[[str, int, int], None] | None = None
    progressbar: bool = True


class Parts(NamedTuple):
    """What is sampled.

    Attributes
    ----------
    found : dict
        Likelihoods to what was sampled and predicted.
    failed : dict
        Calibrated likelihoods to the reason why they could not be had.
    """

    found: dict[str, xr.DataTree]
    failed: dict[str, str]


def run_parts(problem: Problem, settings: RunSettings) -> Parts:
    """Sample every likelihood that is not finished in the folder."""
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
                running = Running(settings.cores, workers, settings.progressbar, settings.out, of_part)
                try:
                    part = run_part(problem, kind, own, base, running)
                except UncalibratedError as error:
                    failed[kind] = str(error)
                    continue
                store.save(kind, part)
            parts[kind] = part
    tell("report", len(kinds), len(kinds))
    return Parts(parts, failed)


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
    """Sample one posterior and predict with it; warnings on the way are part of the result.

    `own` is what the part is recognised by besides, such as the tolerance of ABC; `base` is the part that
    is calibrated, if the likelihood is one that is made from another.
    """
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        model = declare(problem, kind, own["epsilon"])
        if base is None:
            sampled = problem.first.sample(problem, kind, model, seed_of(problem, kind), running)
            idata, model = sampled or (sampling.sample(problem, kind, model, running), model)
        else:
            idata = calibrated(problem, kind, base, model, running)
        part = {name: idata[name].to_dataset() for name in GROUPS if name in idata.children}
        part["prior"] = prior_draws(problem, kind)
        for data in problem.data:
            part |= data.predict(problem, kind, model, idata)
        if problem.structure.has_modes:
            part["modal"] = frequencies(problem, part["posterior"])
    tree = xr.DataTree.from_dict(part)
    messages = list(dict.fromkeys(with_keys(str(w.message)) for w in caught if is_ours(w.category)))
    tree.attrs = {
        "kind": kind,
        "method": method_of(problem, kind),
        "seconds": time.perf_counter() - start,
        "warnings": json.dumps(messages),
    }
    if "calibration" in part:
        tree.attrs["calibration"] = idata.attrs["calibration"]
    tree.attrs |= {name: value for name, value in own.items() if value is not None}
    return tree


def is_ours(category) -> bool:
    """Warnings of this package; others speak of machinery."""
    return category.__module__.split(".")[0] == "pymc_features"


def prior_draws(problem, kind) -> xr.Dataset:
    """Draws of the priors, to compare with."""
    names = names_for(problem, kind)
    columns = {
        name: (("chain", "draw"), problem.priors[name].draw(PRIOR_DRAWS, k)[None])
        for k, name in enumerate(names)
    }
    return xr.Dataset(columns, coords={"chain": [0], "draw": np.arange(PRIOR_DRAWS)})
