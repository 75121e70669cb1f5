"""The source's study: posteriors of the same data at seven sampling steps (Figs. 2-4)."""

import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from os import PathLike
from pathlib import Path
from typing import TypedDict, Unpack

import pymc as pm
import xarray as xr

from pymc_features._checks import check_callable, check_flag, check_integer, check_keywords, check_path
from pymc_features.calibration import calibrate
from pymc_features.exceptions import FeatureLikelihoodWarning
from pymc_features.inference import sample
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.records import Record
from pymc_features.smc import SubsetSimulation, check_workers, open_workers, sample_smc
from pymc_features.storage import PartStore, settings_in
from pymc_features.study import paper
from pymc_features.study.exact import exact_tolerance
from pymc_features.study.results import assemble
from pymc_features.study.settings import Study, declare, set_measurements
from pymc_features.study.structures import DEFAULT, StudyStructure

GROUPS = ("posterior", "sample_stats", "calibration")


class SamplingOptions(TypedDict, total=False):
    """Arguments of `sample` and `sample_smc` that hold for every part of the study."""

    draws: int | None
    chains: int | None
    cores: int | None
    executor: int | str | Executor | None
    progressbar: bool


class StudyOptions(SamplingOptions, total=False):
    """Options of a study: those of samplers, and what the noise is."""

    noise_time: float


def sampling_rate_study(
    record: Record,
    *,
    structure: str | StudyStructure = DEFAULT,
    noise: float = paper.NOISE,
    multipliers: Sequence[float] = paper.MULTIPLIERS,
    likelihoods: Sequence[str] | None = None,
    random_seed: int | None = None,
    out: str | PathLike | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    **kwargs: Unpack[StudyOptions],
) -> xr.DataTree:
    """Posterior of theta and sigma at several sampling steps, sampled and exact.

    A ten-storey chain, that of the source or one that yields, is measured once, at the finest step and with
    noise; coarser data are every n-th sample of that history. NORM narrows with the sampling rate; TN, EXP
    and ABC do not. Errors correlated in time (CN) neither, as long as their time and scale are known and not
    inferred from noise that is in truth white. CAL takes its width from the residuals: with the white noise
    of the source, of which every further sample is new, it is nearly that of NORM; with noise that persists
    for longer than a step (`noise_time`) it does not depend on the sampling rate.

    Parameters
    ----------
    record : Record
        Ground acceleration, taken as linear between its samples, as in the source.
    structure : {"linear", "bouc-wen"} or StudyStructure
        The chain of the source, or the same with springs that yield (study/structures.py); with another
        nominal stiffness of the springs, `study.find_structure("linear", stiffness=1000.0)`.
    noise : float
        Standard deviation of the noise over the root mean square of each channel [-], positive.
    multipliers : sequence of float
        Sampling steps over the record's step; integers or their reciprocals.
    likelihoods : sequence of {"NORM", "TN", "EXP", "ABC", "CN", "CN-SIGMA", "CN-TAU", "CAL"}
        The tolerance of ABC follows from the exact posterior of EXP, Eq. (16). CN is `CorrelatedNormal` with
        correlation time and sigma known, CN-SIGMA with sigma inferred, CN-TAU with both inferred. CAL is
        `calibrate` of the posterior of NORM, which is sampled for it if it is not listed. By default all
        eight of the linear chain, the first four of the other.
    random_seed : int, optional
        Of noise and samplers; by default another one each time, or that of the study in `out`.
    out : path, optional
        Folder in which each finished part is kept at once; a second call with the same settings
        continues. In memory only by default.
    progress : callable (str, int, int), optional
        Called with the name of the part in work, the number finished, and the number in all: the posteriors
        sampled, and the exact ones of each sampling step.
    **kwargs
        `draws`, `chains`, `cores`, `executor` and `progressbar` of `sample_smc`, which samples ABC with
        `SubsetSimulation`, and of `sample`, which samples the others. By default four chains of 2000 draws of
        the linear chain, two of 1000 of the other, whose response takes longer. `noise_time`: correlation
        time of the noise [s], 0 by default, white.

    Returns
    -------
    DataTree
        `/summary`: maximum, 5, 50 and 95 % quantiles, `sampled` and `exact` by quadrature, both
        (likelihood, multiplier, parameter, statistic); `r_hat`, `ess_bulk`, `seconds`, `log_evidence`; the
        tolerance `epsilon` of ABC and the ends of the exact `epsilon_interval`.
        `/<likelihood>/x<multiplier>`: posterior and sampler statistics; of CAL what `effective_samples`
        returns besides, in `calibration`. `/data`: record and finest
        measurements. `/loops`, of springs that can yield: their force and drift (spring, time) at the true
        theta, and where they yield. Saves with `to_netcdf`.

    Raises
    ------
    ValueError
        If a setting is out of range, or `out` holds another study.
    """
    check_keywords(kwargs, StudyOptions.__annotations__, "sampling_rate_study")
    cores, progressbar = kwargs.pop("cores", None), kwargs.pop("progressbar", True)
    executor = kwargs.pop("executor", None)
    check_workers(executor)
    if cores is not None:
        check_integer(cores, "cores")
    check_flag(progressbar, "progressbar")
    if out is not None:
        out = check_path(out, "out")
    if progress is not None:
        check_callable(progress, "progress")
    study = Study(
        record,
        structure=structure,
        noise=noise,
        multipliers=multipliers,
        likelihoods=likelihoods,
        random_seed=seed_in(out) if random_seed is None else random_seed,
        **kwargs,
    )
    store = PartStore(out, study.settings())
    names = [(kind, m) for m in study.multipliers for kind in study.likelihoods]
    total = len(names) + len(study.multipliers)

    def shown(part, done):
        if progress is not None:
            progress(part, done, total)

    models: dict[str, pm.Model] = {}

    def finished(kind, multiplier):
        """A part that is kept, or is sampled now, after the one that it follows from."""
        label = part_name(kind, multiplier)
        part = store.load(label)
        if part is None:
            base = LIKELIHOODS[kind].calibrates
            base = finished(base, multiplier) if base else None
            part = run_part(study, kind, multiplier, base, models, common)
            store.save(label, part)
        return part

    parts: dict[tuple[str, float], xr.DataTree] = {}
    with open_workers(executor) as workers:
        common = {"cores": cores, "executor": workers, "progressbar": progressbar}
        for done, (kind, multiplier) in enumerate(names):
            shown(part_name(kind, multiplier), done)
            parts[kind, multiplier] = finished(kind, multiplier)
    return assemble(study, parts, shown)


def seed_in(out) -> int | None:
    """The seed of the study that a folder holds, if it holds one."""
    found = None if out is None else settings_in(Path(out), "study")
    seed = (found or {}).get("random_seed")
    return seed if isinstance(seed, int) and seed >= 0 else None


def part_name(kind: str, multiplier: float) -> str:
    """Name of one part in files and messages, such as TN_x0.1."""
    return f"{kind}_x{multiplier:g}"


def run_part(study, kind, multiplier, base, models, common) -> xr.DataTree:
    """Sample one posterior; `models` keeps the model of each likelihood, which is compiled once.

    `common` are the settings of all samplers.
    `base` is the part that is calibrated, if the likelihood is one that is made from another.
    """
    data, entry = study.data(multiplier), LIKELIHOODS[kind]
    tolerance = exact_tolerance(study.misfit(multiplier)) if entry.is_likelihood_free else None
    name = entry.calibrates or kind
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=FeatureLikelihoodWarning)
        if name not in models:
            models[name] = declare(
                kind,
                study.record,
                data,
                structure=study.at,
                tolerance=tolerance,
                scale=study.scale,
            )
        set_measurements(models[name], data, tolerance)
        settings = {
            "model": models[name],
            "draws": study.draws,
            "chains": study.chains,
            "random_seed": study.part_seed(kind),
            **common,
        }
        if base is not None:
            idata = calibrate(base, model_error=None, **settings)  # the model is the structure
        elif entry.is_likelihood_free:
            idata = sample_smc(kernel=SubsetSimulation, compute_convergence_checks=False, **settings)
        else:
            idata = sample(**settings)
    part = xr.DataTree.from_dict(
        {name: idata[name].to_dataset() for name in GROUPS if name in idata.children}
    )
    part.attrs = {"seconds": time.perf_counter() - start}
    if tolerance is not None:
        part.attrs["epsilon"] = tolerance
    return part
