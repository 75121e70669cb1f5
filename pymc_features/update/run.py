"""Sampling every likelihood of a problem; what is finished is kept."""

import json
import time
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial

import numpy as np
import pymc as pm
import xarray as xr
from pymc.sampling.parallel import ParallelSamplingError

from pymc_features import inference, smc
from pymc_features.calibration import calibrate
from pymc_features.exceptions import ConfigError, ToleranceNotReachedError, UncalibratedError
from pymc_features.likelihood_free import abc_tolerance
from pymc_features.smc import open_workers, sample_smc
from pymc_features.storage import PartStore
from pymc_features.update.chains import without_lost_chains
from pymc_features.update.config.entries import Parameter
from pymc_features.update.predict import bands, frequencies, measured_gain
from pymc_features.update.predict_modes import identified_modes, matched, shapes
from pymc_features.update.predict_spectra import fitted_spectra
from pymc_features.update.problem.kinds import KINDS
from pymc_features.update.problem.model import declare, names_for, request_of
from pymc_features.update.problem.read import Problem
from pymc_features.update.sequence import Running, sample_events

PRIOR_DRAWS = 4000
GROUPS = ("posterior", "sample_stats", "particles", "modes", "calibration", "sequence")


def run_update(
    problem: Problem,
    *,
    out=None,
    cores: int | None = None,
    executor: int | str | Executor | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    progressbar: bool = True,
) -> xr.DataTree:
    """Sample the posterior of every likelihood, and predict with it.

    Parameters
    ----------
    problem : Problem
        From `read_problem`.
    out : path, optional
        Folder in which each finished likelihood is kept at once; a second call with the same problem
        continues. Other likelihoods, another tolerance, report or `cores` are no other problem.
    cores : int, optional
        Processes; as the configuration says, or all processors.
    executor : int, str, dask Client or Executor, optional
        Where populations are evaluated, as of `sample_smc`; `cores` then says how many chains run at once.
    progress : callable (str, int, int), optional
        Called with the name of the likelihood in work, the number finished, and the number in all.
    progressbar : bool
        Whether each likelihood shows PyMC's own progress bar.

    Returns
    -------
    DataTree
        For each likelihood `/<kind>/`, CAL first: posterior, prior, sample_stats, observed_data, bands,
        modal, and of CAL calibration, what `effective_samples` returns. And `/data`: motion of the base,
        measured responses and their gain; of a cyclic test force and displacement, and no modal. Of
        identified modes `/identified`, and in each likelihood `matched`, which mode each is matched with, and
        `shapes` of draws; without responses the only likelihood is MODAL, and there are neither data nor
        bands. Of ambient vibration the likelihood is AMBIENT, with `spectra`, see `fitted_spectra`, and with
        the modes that the channels have. Of several events `sequence`, and all else is the state after the
        last of them. The attribute `failed` says in JSON which calibrated posterior could not be had, and
        why; if it was the only one asked for, that which it is made from is in its place.

    Raises
    ------
    ConfigError
        If `out` holds another problem, or the tolerance of ABC is out of reach; everything else is kept.
    """
    if executor is not None and problem.config.sampler.method == "laplace":
        raise ConfigError("`sampler.method` must be one with populations for an executor, got laplace.")
    store = PartStore(out, problem.settings(), "update")
    kinds, parts, failed = problem.kinds, {}, {}
    tell = progress or (lambda part, done, total: None)
    with open_workers(executor) as workers:
        for done, kind in enumerate(kinds):
            tell(kind, done, len(kinds))
            part, tolerance = store.load(kind), tolerance_of(problem, parts) if kind == "ABC" else None
            if not is_of(part, problem, tolerance):
                base = parts.get(KINDS[kind].calibrates)
                running = Running(
                    cores, workers, progressbar, out, partial(tell, done=done, total=len(kinds))
                )
                try:
                    part = run_part(problem, kind, tolerance, base, running)
                except UncalibratedError as error:
                    failed[kind] = str(error)
                    continue
                store.save(kind, part)
            parts[kind] = part
    tell("report", len(kinds), len(kinds))
    reported = [kind for kind in problem.reported if kind in parts] or list(parts)
    shown = {kind: parts[kind].copy() for kind in reported}
    title = problem.config.report.title.replace("/", "-")  # which would be a path in the tree
    if problem.measured is not None:
        shown["data"] = data_of(problem)
    if problem.modal is not None:
        for kind in reported:  # not kept: other nodes are no other draws
            shown[kind]["shapes"] = xr.DataTree(shapes(problem, shown[kind]["posterior"].to_dataset()))
        shown["identified"] = identified_modes(problem)
    result = xr.DataTree.from_dict(shown, name=title)
    result.attrs["failed"] = json.dumps(failed)
    return result


def is_of(part, problem, tolerance) -> bool:
    """Whether a part is there, and of the same tolerance and events."""
    if part is None:
        return False
    return part.attrs.get("epsilon") == tolerance and part.attrs.get("events", "") == problem.events_sha256


def run_part(problem, kind, tolerance, base, running: Running) -> xr.DataTree:
    """Sample one posterior and predict with it; warnings on the way are part of the result.

    `base` is the part that is calibrated, if the likelihood is one that is made from another.
    """
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        model = declare(problem, kind, tolerance)
        if problem.events:
            idata = sample_events(problem, kind, seed_of(problem, kind), running)
        elif base is None:
            idata = sample(problem, kind, model, running)
        else:
            idata = calibrated(problem, kind, base, model, running)
        if is_cut_short(problem, kind, idata["posterior"].sizes):
            raise KeyboardInterrupt
        if base is None and not problem.events and not KINDS[kind].is_likelihood_free:
            idata = without_lost_chains(idata, model)
        part = {name: idata[name].to_dataset() for name in GROUPS if name in idata.children}
        part["prior"] = prior_draws(problem, kind)
        if problem.measured is not None:
            part["observed_data"] = xr.Dataset(
                {"y": problem.measured.channels.drop_attrs().assign_attrs(units=problem.measured.units)}
            )
            part["bands"] = bands(problem, kind, model, idata)
        if problem.ambient is not None:
            part["spectra"] = fitted_spectra(problem, model, idata["posterior"].to_dataset())
        if not problem.is_cyclic:
            part["modal"] = frequencies(problem, idata)
        if problem.modal is not None:
            part["matched"] = matched(problem, idata["posterior"].to_dataset())
    tree = xr.DataTree.from_dict(part)
    messages = list(dict.fromkeys(str(w.message) for w in caught if is_ours(w.category)))
    tree.attrs = {
        "kind": kind,
        "method": method_of(problem, kind),
        "seconds": time.perf_counter() - start,
        "warnings": json.dumps(messages),
    }
    if "calibration" in part:
        tree.attrs["calibration"] = idata.attrs["calibration"]
    if tolerance is not None:
        tree.attrs["epsilon"] = tolerance
    if problem.events:
        tree.attrs["events"] = problem.events_sha256
    return tree


def is_cut_short(problem, kind, sizes) -> bool:
    """Whether draws or chains are missing: PyMC's NUTS returns what it has when it is stopped."""
    asked = problem.config.sampler
    chains = 1 if method_of(problem, kind) == "Laplace" else asked.chains
    return sizes["draw"] < asked.draws or sizes["chain"] < chains


def is_ours(category) -> bool:
    """Warnings of this package; others speak of machinery."""
    return category.__module__.split(".")[0] == "pymc_features"


def method_of(problem, kind) -> str:
    """How a likelihood is sampled."""
    sampler = problem.config.sampler
    if KINDS[kind].calibrates:
        return "calibrate"
    if KINDS[kind].is_likelihood_free:
        return "SubsetSimulation"
    return {"auto": "sample", "smc": sampler.kernel, "nuts": "NUTS", "laplace": "Laplace"}[sampler.method]


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
    idata["calibration"] = xr.DataTree(found.assign_coords(sensor=problem.measured.channels["sensor"].values))
    return idata


def sample(problem, kind, model, running: Running) -> xr.DataTree:
    """The posterior by the sampler of the configuration."""
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


def tolerance_of(problem, parts) -> float:
    """delta of ABC: as the configuration says, or Eq. (16) with the posterior of EXP."""
    likelihood, n_sensors = problem.config.likelihood, len(problem.dofs)
    if likelihood.epsilon is not None:
        return likelihood.epsilon
    if not isinstance(likelihood.sigma, Parameter):
        return abc_tolerance(likelihood.sigma, n_sensors)
    sigma = likelihood.sigma.times * parts["EXP"]["posterior"][likelihood.sigma.prior]
    return abc_tolerance(sigma, n_sensors)


def prior_draws(problem, kind) -> xr.Dataset:
    """Draws of the priors, to compare with."""
    names = names_for(problem, kind)
    columns = {
        name: (("chain", "draw"), problem.priors[name].draw(PRIOR_DRAWS, k)[None])
        for k, name in enumerate(names)
    }
    return xr.Dataset(columns, coords={"chain": [0], "draw": np.arange(PRIOR_DRAWS)})


def data_of(problem) -> xr.Dataset:
    """What was measured, as figures take it."""
    measured = problem.measured
    if problem.is_cyclic:
        displacement = ("time", measured.record.displacement, {"units": "m"})
        channels = measured.channels.drop_attrs().assign_attrs(units="N")
        return xr.Dataset({"measured": channels}, {"displacement": displacement}, {"source": measured.source})
    gain, peaks = measured_gain(problem)
    given = problem.config.report.natural_frequencies
    if given is None and problem.modal is not None:
        given = problem.modal.data.frequencies
    data = xr.Dataset(
        {
            "ground_acceleration": ("record_time", measured.record.acceleration, {"units": "m/s^2"}),
            "measured": measured.channels.drop_attrs().assign_attrs(units=measured.units),
            "gain": gain,
            "peak_frequency": ("peak", peaks, {"units": "Hz"}),
        },
        coords={"record_time": measured.record.time},
        attrs={
            "record": measured.record.name,
            "source": measured.source,
            "interpolation": measured.record.interpolation,
            "refinement": request_of(problem)[0].factor,
        },
    )
    if given is not None:
        data["given_frequency"] = ("given", np.array(given, dtype=np.float64), {"units": "Hz"})
    return data
