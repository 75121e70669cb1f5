"""`sample`: one entry for posterior, evidence, and how far both can be trusted."""

import os
import warnings
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pymc as pm
import xarray as xr
from pymc.util import RandomState
from scipy.special import softmax

from pymc_features._checks import check_choice, check_mapping, check_model, check_path, check_seed
from pymc_features.exceptions import ChainsDisagreeWarning, NoSpreadError, SamplingWarning
from pymc_features.external.workers.calls import one_thread_each
from pymc_features.inference.cross_check import affordable, cross_check
from pymc_features.inference.parameters import Unconstrained, coordinate_names, some_draws, to_unconstrained
from pymc_features.smc import (
    PersistentSMC,
    Reference,
    check_run,
    check_workers,
    find_reference,
    open_workers,
    population_logp,
    prior_points,
    processors,
    sample_smc,
)
from pymc_features.smc.kernels.chains import GRADIENT_COST
from pymc_features.smc.kernels.checkpoint import Journal, model_fingerprint, remembered
from pymc_features.smc.proposals.pool import LARGEST_K, LARGEST_SHARE, QUANTILES
from pymc_features.smc.proposals.reference import Density

AGREEMENT = 1.01  # largest R-hat of runs that agree
# modes, and the share of climbs that each end alone, above which there are others that none has found
FEW_MODES, MANY_SINGLE = 4, 0.3
APART = 5.0  # standard errors between log evidences of runs that disagree
RESTARTS = 4, 4, None  # by how much stages grow where one fell on a point; then the error is told
MOST_REPEATS = 2  # of a run, each with what the check of the one before has found
N_POSTERIOR = 2000  # draws of all chains that are compared with the prior, with the modes, and cross-checked


def sample(
    draws: int = 1000,
    *,
    chains: int | None = None,
    cores: int | None = None,
    model: pm.Model | None = None,
    random_seed: RandomState = None,
    checkpoint: str | os.PathLike | None = None,
    executor: int | str | Executor | None = None,
    check: str | None = "standard",
    progressbar: bool = True,
    **settings,
) -> xr.DataTree:
    """Posterior and evidence of any PyMC model with up to about a hundred parameters.

    Where the model has gradients, climbs from draws of the prior find the modes, and maps fitted to gradients
    follow the posterior's bends where Gaussians at the modes are poor. Gaussians and Student-t distributions
    at the modes, behind these maps, with a share of the prior, are drawn from and weighed. If that is good
    enough, it is the answer. Else sequential Monte Carlo leads from there, or from the prior, to the
    posterior; fits to its points, behind a map that unbends the posterior, are drawn from at the end. See
    `PersistentSMC`. After that a search that shares nothing with the run looks for parts of the posterior
    that it has missed; with what it finds, the run is repeated.

    Parameters
    ----------
    draws : int
        Equally weighted draws of each chain, and the independent draws that the quantiles of its worst
        parameter are worth.
    chains : int, optional
        Independent runs; as many as processors, and at least two, by default.
    cores : int, optional
        Runs at the same time; as many as there are processors by default.
    model : pymc.Model, optional
        The model of the context by default.
    random_seed : int or sequence of int, optional
        For the same draws each time.
    checkpoint : path-like, optional
        Folder that keeps every evaluation, by which a run that was killed goes on. See `sample_smc`.
    executor : int, str, dask Client or Executor, optional
        Where populations, those of climbs and gradients included, are evaluated: number of local processes,
        address of a Dask scheduler, or any object with `submit`. See `sample_smc`.
    check : {"standard", "thorough"} or None
        How much is spent on the search for what was missed: up to 30,000 evaluations and 1,000 climbs, of
        which "standard" does as much as costs some two fifths of the run, or about a second where a value
        costs microseconds; a twentieth of the run where a value runs a program. None: no search. It sees no
        part that less than one in 10,000 draws from a wider fit and one in 1,000 climbs from the prior lead
        to.
    progressbar : bool
        Whether to show progress.
    **settings
        Of `sample_smc` and `PersistentSMC`, such as `compile_kwargs`, a dict for `pytensor.function`.

    Returns
    -------
    DataTree
        `posterior`; `modes` (mode, or posterior_mode where the model has a dimension mode), if climbs found
        any: parameters, `log_evidence` of Laplace's approximation at each, `n_climbs` that ended there (one
        that stops on a slope, as in the neck of a funnel whose density grows without bound, found none);
        `sample_stats` as from `sample_smc`, with for each chain `log_marginal_likelihood` and its standard
        error `log_marginal_likelihood_se`, `ess` (independent draws that the quantiles of the worst parameter
        are worth), `pareto_k`, and `largest_share` (of the posterior, that one weighted draw stands for).
        Their attributes sum up: `max_r_hat`, `log_evidence` and `log_evidence_se` of all chains together,
        `ess` of all, the largest `pareto_k`, `heavy_share` (the largest share of one draw in chains whose
        `pareto_k` is above 0.7; 0 without such a chain), `n_modes`, `single_climbs` (share of the climbs that
        ended at a mode that no other found), `reference_efficiency` (effective share of the first guess's
        draws: one if the posterior is a mixture of Gaussians),
        `search_evaluations` and `search_gradients` (of climbs and maps), `no_gradient` (why there were none),
        `laplace_error` (how far the 5, 50 and 95 % quantiles of Gaussians at the modes are from those of the
        posterior, over its 5-95 % width, at worst, on the sampled scale; NaN without modes) and
        `close_to_laplace` (that in words), `undetermined` (parameters, or combinations of them, that the data
        leave where the prior put them), `check` (what was looked for after the run, and found),
        `check_evaluations`, `check_gradients`, `check_repeats` (how often the run was repeated with what was
        found), `missed_share` (weight of what the draws still lack), and
        `advice`, empty where nothing is wrong.

    Warns
    -----
    SamplingWarning
        What is wrong, and what to do.

    Examples
    --------
    >>> with pm.Model():
    ...     x = pm.Normal("x")
    ...     y = pm.Normal("y", x, 1.0, observed=[1.0])
    ...     idata = sample(500, cores=1, random_seed=1, progressbar=False)
    >>> round(idata.sample_stats.attrs["log_evidence"], 1)
    -1.5
    """
    check_run(draws, chains, cores, check_seed(random_seed), progressbar)
    check_workers(executor)
    if check is not None:
        check_choice(check, "check", ("standard", "thorough"))
    model = check_model(model)
    compile_kwargs = settings.pop("compile_kwargs", None)
    compile_kwargs = check_mapping(compile_kwargs, "compile_kwargs", "a dict for `pytensor.function`")
    if checkpoint is not None:
        check_path(checkpoint, "checkpoint")
        random_seed, chains = remembered(checkpoint, random_seed, chains, max(2, cores or processors()))
    of_search, of_check = map(np.random.default_rng, np.random.SeedSequence(random_seed).spawn(2))
    space = Unconstrained(model)
    logp = population_logp(model, space.point, compile_kwargs)
    settings |= {"draws": draws, "chains": chains, "cores": cores, "random_seed": random_seed}
    settings |= {"progressbar": progressbar, "compile_kwargs": compile_kwargs, "checkpoint": checkpoint}
    with open_workers(executor) as workers, one_thread_each():
        if workers is not None:
            logp = workers.run().of(logp)
        settings["executor"] = workers
        found = search(model, logp, draws, of_search, journal_in(checkpoint, "modes", model))
        idata = sample_from(found, model, space, **settings)
        if check is not None:
            idata = cross_checked(idata, found, model, space, logp, check == "thorough", of_check, settings)
    if advice := idata["sample_stats"].attrs["advice"]:
        warnings.warn(advice, SamplingWarning, stacklevel=2)
    return idata


def sample_from(found: "Search", model, space, **settings) -> xr.DataTree:
    """Runs that begin with what climbs have found, and a summary of them; see `sample`."""
    settings = {"compute_convergence_checks": False, "gradients": not found.no_gradient} | settings
    settings = {"kernel": PersistentSMC, "reference": found.reference} | settings
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "PersistentSMC ended", SamplingWarning)  # `advice` says it
        idata = sample_again(space, model=model, **settings)
    modes = [] if found.reference is None else found.reference.modes
    is_maximum = np.array([mode.is_maximum for mode in modes], dtype=bool)
    if is_maximum.any():
        maxima = [mode for mode in modes if mode.is_maximum]
        summary = {"log_evidence": found.reference.log_evidences[is_maximum]}
        summary |= {"n_climbs": [m.n_climbs for m in maxima]}
        idata["modes"] = xr.DataTree(space.modes(model, found.reference.peaks[is_maximum], **summary))
    summary = found._asdict() | summarise(model, space, idata, found.reference)
    del summary["reference"]
    idata["sample_stats"].attrs |= summary
    return idata


def sample_again(space, *, draws, stage_draws=None, **settings) -> xr.DataTree:
    """`sample_smc`; where all particles of a stage fell on one point, again with larger stages."""
    for more in RESTARTS:
        try:
            return sample_smc(draws, stage_draws=stage_draws, **settings)
        except NoSpreadError:
            if more is None or settings.get("checkpoint") is not None:
                raise
            least = max(int(0.4 * draws), 50 * space.join(space.point).size, 200)  # as PersistentSMC has it
            stage_draws = more * (stage_draws or least)


class Search(NamedTuple):
    """What climbs from draws of the prior have found, and their cost; `no_gradient`: why there were none."""

    reference: Reference | None
    search_evaluations: int
    search_gradients: int
    no_gradient: str


def journal_in(checkpoint, name: str, model) -> Journal | None:
    """Record of the evaluations of a part of a run, in the folder of a checkpoint; None without one."""
    if checkpoint is None:
        return None
    Path(checkpoint).mkdir(parents=True, exist_ok=True)
    return Journal(Path(checkpoint) / f"{name}.record", model_fingerprint(model))


def search(model, logp, draws, rng, journal) -> Search:
    """Find the modes and their bends, if there are gradients; the journal remembers what was evaluated."""
    if not logp.has_gradient:
        return Search(None, 0, 0, logp.why_no_gradient)
    logp.compile_gradient()
    density = Density(logp, lambda n: prior_points(model, n, rng), journal)
    reference = find_reference(density, draws // 2)
    if reference is not None:
        reference = reference.bent(density, rng)
    if journal:
        journal.close()
    return Search(reference, density.n_values, density.n_gradients, "")


def cross_checked(idata, found, model, space, logp, thorough, rng, settings) -> xr.DataTree:
    """A run in which nothing was missed, or the one that was repeated with what was; see `cross_check`.

    Attributes of its `sample_stats` tell what was looked for and what was found.
    """
    checkpoint = settings["checkpoint"]
    why_not = "random numbers are drawn inside" if logp.draws_random_numbers else ""
    if any(not rv.dtype.startswith("float") for rv in model.free_RVs):
        why_not = "the model has discrete parameters"
    if why_not:
        idata["sample_stats"].attrs["check"] = f"not done: {why_not}"
        return idata
    journal = journal_in(checkpoint, "check", model)
    density = Density(logp, lambda n: prior_points(model, n, rng), journal)
    n_data = sum(value.size.eval() for value in map(model.rvs_to_values.get, model.observed_RVs))
    n_differences = 0 if logp.has_gradient else len(space.join(space.point)) + 1
    rare = False
    for n_repeats in range(MOST_REPEATS + 1):
        stats, draws = idata["sample_stats"], compared_draws(model, idata["posterior"])
        spent = GRADIENT_COST * (stats["gradients"].sum().item() + found.search_gradients)
        spent += stats["evaluations"].sum().item() + found.search_evaluations
        size = idata["posterior"].sizes["chain"] * idata["posterior"].sizes["draw"]
        dear = logp.is_expensive or not logp.batched
        effort = affordable(thorough, size, spent, n_data, dear, n_differences)
        of_run = stats.attrs["log_evidence"], stats.attrs["log_evidence_se"]
        check = cross_check(density, draws, *of_run, effort, rng, found.reference)
        rare |= check.rare
        if n_repeats == MOST_REPEATS or not check.missed:
            break
        found = found._replace(reference=check.reference(found.reference))
        again = {"random_seed": int(rng.integers(2**31))}
        if checkpoint is not None:
            again["checkpoint"] = Path(checkpoint) / f"again_{n_repeats + 1}"
        idata = sample_from(found, model, space, **settings | again)
    if journal:
        journal.close()
    attributes = idata["sample_stats"].attrs
    attributes |= {
        "check": check.sentence(),
        "check_evaluations": density.n_values,
        "check_gradients": density.n_gradients,
        "check_repeats": n_repeats,
        "missed_share": check.share if check.missed else 0.0,
    }
    attributes["advice"] = check.advice(rare) or attributes["advice"]
    return idata


def summarise(model, space, idata, reference) -> dict:
    """Attributes of `sample_stats`, see `sample`."""
    import arviz as az  # slow to import

    stats = idata["sample_stats"].to_dataset()
    names = [rv.name for rv in model.free_RVs]
    r_hats = az.rhat(idata["posterior"].to_dataset()[names])
    evidences, errors = (stats[f"log_marginal_likelihood{end}"].values for end in ("", "_se"))
    weights = np.exp(evidences - evidences.max())
    mean = weights.mean()
    climbs = idata["modes"]["n_climbs"].values if "modes" in idata.children else np.zeros(0)
    summary = {
        "max_r_hat": float(max(r_hats[name].max() for name in names)),
        "log_evidence": float(evidences.max() + np.log(mean)),
        "log_evidence_se": float(np.sqrt(((weights * errors) ** 2).sum()) / len(weights) / mean),
        "ess": float(stats["ess"].sum()),
        "pareto_k": float(stats["pareto_k"].max()),
        "heavy_share": float(stats["largest_share"].where(stats["pareto_k"] > LARGEST_K, 0.0).max()),
        "n_modes": len(climbs),
        "single_climbs": float(np.sum(climbs == 1) / max(1, np.sum(climbs))),
        "reference_efficiency": float(stats["reference_efficiency"].min()),
    }
    coordinates = coordinate_names(model, space)
    flat = compared_draws(model, idata["posterior"])
    summary["undetermined"] = ", ".join([] if flat is None else undetermined(model, flat, coordinates))
    worst, error = distance_to_modes(reference, flat)
    summary["laplace_error"] = error
    summary["close_to_laplace"] = (
        "" if worst is None else closeness(coordinates[worst], error, summary["reference_efficiency"])
    )
    return summary | {"advice": advice(summary, evidences, errors, idata)}


def advice(summary, evidences, errors, idata) -> str:
    """One sentence on what is wrong and what to do; empty if nothing is."""
    draws, n_chains = (idata["posterior"].sizes[dim] for dim in ("draw", "chain"))
    apart = np.ptp(evidences) / np.sqrt(np.mean(errors**2) + 1e-12)
    if summary["ess"] < 0.9 * draws * n_chains:
        return (
            f"the draws are worth {summary['ess']:.0f} of {draws * n_chains} independent ones: increase "
            "`stage_draws`, or give narrower priors to what the data do not determine"
            + (f" ({summary['undetermined']})." if summary["undetermined"] else ".")
        )
    if summary["max_r_hat"] > AGREEMENT + 3.0 / draws:
        return (
            f"independent runs disagree (R-hat {summary['max_r_hat']:.3f}): increase `draws` and "
            "`stage_draws`, and compare the runs in a trace plot."
        )
    if summary["heavy_share"] > LARGEST_SHARE:
        return (
            f"a few draws outweigh the rest (Pareto k {summary['pareto_k']:.2f}): the tails and the evidence "
            "are less certain than their standard errors say. Increase `stage_draws`."
        )
    if summary["n_modes"] > FEW_MODES and summary["single_climbs"] > MANY_SINGLE:
        return (
            f"climbs found {summary['n_modes']} modes, {100 * summary['single_climbs']:.0f} % of them one "
            "that no other found, so that there are more: reparametrise the model, or narrow its priors."
        )
    if apart > APART:
        return (
            f"log evidences of independent runs differ by {np.ptp(evidences):.2f}, more than their standard "
            "errors explain: increase `stage_draws`."
        )
    return ""


def compared_draws(model, posterior):
    """Some draws (n, d) on the sampled scale; None if the model has discrete parameters."""
    if any(not rv.dtype.startswith("float") for rv in model.free_RVs):
        return None
    return some_draws(model, posterior, N_POSTERIOR)


N_PRIOR = 500  # prior draws that say what the data have added
UNDETERMINED = 0.7  # share of its prior variance that such a direction keeps
LOADING = 0.3  # of a parameter in a direction, beside the largest, to be named
N_GAUSSIAN = 20_000  # draws from the Gaussians at the modes; they cost no evaluation
CLOSE, LEAST_EFFICIENCY = 0.1, 0.4  # error of quantiles and share of draws, of a posterior near its Gaussians


def undetermined(model, flat, names) -> list[str]:
    """Directions in which draws (n, d) are nearly as wide as the prior, on the sampled scale."""
    prior = prior_points(model, N_PRIOR, np.random.default_rng(1))
    scale = prior.std(axis=0)
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        return []
    # coordinates in which the prior is a unit sphere: variances beside one
    factor = np.linalg.cholesky(np.cov(prior / scale, rowvar=False).reshape(flat.shape[1], -1))
    shares, axes = np.linalg.eigh(np.atleast_2d(np.cov(np.linalg.solve(factor, (flat / scale).T))))
    found = []
    for share, axis in zip(shares[::-1], axes.T[::-1], strict=True):
        if share < UNDETERMINED:
            break
        loading = np.abs(axis)
        found.append(" with ".join(names[i] for i in np.flatnonzero(loading > LOADING * loading.max())))
    return list(dict.fromkeys(found))


def distance_to_modes(reference, flat):
    """How far the quantiles of Gaussians at the modes are from those of draws (n, d), on the sampled scale.

    Returns
    -------
    worst, error
        The coordinate that is furthest off, and by how much, over the 5-95 % width of its draws; None and NaN
        without modes.
    """
    modes = [] if reference is None else [mode for mode in reference.modes if mode.is_maximum]
    if not modes or flat is None:
        return None, np.nan
    rng = np.random.default_rng(2)
    counts = rng.multinomial(N_GAUSSIAN, softmax([mode.log_evidence for mode in modes]))
    u = [
        mode.x + rng.standard_normal((n, len(mode.x))) @ mode.factor.T
        for mode, n in zip(modes, counts, strict=True)
    ]
    gaussian = np.quantile(reference.centre + reference.scale * np.concatenate(u), QUANTILES, axis=0)
    sampled = np.quantile(flat, QUANTILES, axis=0)
    errors = np.abs(gaussian - sampled).max(axis=0) / (sampled[-1] - sampled[0])
    worst = int(errors.argmax())
    return worst, float(errors[worst])


def closeness(name, error, efficiency) -> str:
    """A sentence on the quantiles of Gaussians at the modes."""
    close = error < CLOSE and efficiency > LEAST_EFFICIENCY
    return (
        f"{'yes' if close else 'no'}: quantiles of Gaussians at the modes are off by at most "
        f"{100 * error:.0f} % of the 5-95 % width ({name})"
    )


FAR = 20.0  # below the best chain, in logarithms: such a mode has a weight of 2e-9
N_DRAWS = 200  # of each chain, to judge it by
MANY = 0.5  # share of lost chains above which the best may be lost, too


def without_lost_chains(idata: xr.DataTree, model) -> xr.DataTree:
    """A result without the chains that are far below another, and a warning that names them.

    A chain is far below another if both its mean log posterior and the log mass of its mode are lower by more
    than 20. The log mass is the mean log posterior plus the entropy of independent Gaussians with the
    variances of the draws, on the sampled scale; so a mode is kept that is low but wide.
    """
    posterior = idata["posterior"].to_dataset()
    names = posterior["chain"].values
    if len(names) < 2:
        return idata
    every = max(1, posterior.sizes["draw"] // N_DRAWS)
    points = to_unconstrained(model, posterior.isel(draw=slice(None, None, every)))
    logp = population_logp(model, model.initial_point(), {})
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.array([np.mean(prior + likelihood) for prior, likelihood, _ in map(logp, points)])
        mass = height + 0.5 * np.log(points.var(axis=1)).sum(axis=1)
        below = np.nanmax(np.fmin(height - height[:, None], mass - mass[:, None]), axis=1)
    lost = below > FAR
    if not lost.any():
        return idata
    told = ", ".join(f"chain {names[i]} by {below[i]:.0f}" for i in np.flatnonzero(lost))
    few = f" Rely on none, for {lost.sum()} of {lost.size} went astray." if lost.mean() > MANY else ""
    warnings.warn(
        "chains are left out that ended in modes without weight, their log posterior being below that of "
        f"chain {names[height.argmax()]}: {told}.{few} Increase `draws`, or narrow the priors, until "
        "all chains find the best mode.",
        ChainsDisagreeWarning,
        stacklevel=2,
    )
    kept = idata.copy()
    for group in {"posterior", "sample_stats"} & set(idata.children):
        dataset = idata[group].to_dataset().sel(chain=names[~lost])
        if "ess" in dataset.attrs:  # a sum over chains
            dataset.attrs = dataset.attrs | {"ess": float(dataset["ess"].sum())}
        kept[group] = xr.DataTree(dataset)
    return kept
