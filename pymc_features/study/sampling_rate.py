"""The source's study: posteriors of the same data at seven sampling steps (Figs. 2-4)."""

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features.distributions import FeatureLikelihoodWarning
from pymc_features.records import Record
from pymc_features.simulators import chain_misfit, request, simulate
from pymc_features.smc import PersistentSMC, SubsetSimulation, sample_smc
from pymc_features.study import paper
from pymc_features.study.models import LIKELIHOODS, declare, set_measurements
from pymc_features.study.references import Step
from pymc_features.study.store import PartStore, fingerprint
from pymc_features.study.summary import assemble


@dataclass(frozen=True)
class Study:
    """Settings of a study; see `sampling_rate_study`."""

    record: Record
    stiffness: float
    noise: float
    multipliers: tuple[float, ...]
    likelihoods: tuple[str, ...]
    draws: int
    chains: int
    seed: int
    finest: xr.DataArray = field(repr=False)
    steps: dict[float, Step] = field(default_factory=dict, repr=False)

    def settings(self) -> dict:
        """All that determines the numbers, for the folder they are kept in."""
        return {
            "record": self.record.name,
            "record_sha256": fingerprint(self.record.acceleration),
            "record_dt": self.record.dt,
            "stiffness": self.stiffness,
            "noise": self.noise,
            "multipliers": list(self.multipliers),
            "likelihoods": list(self.likelihoods),
            "draws": self.draws,
            "chains": self.chains,
            "seed": self.seed,
        }

    def data(self, multiplier: float) -> xr.DataArray:
        """Measurements at one sampling step, decimated from the finest history."""
        return paper.decimate(self.finest, self.step(multiplier))

    @cached_property
    def scale(self) -> float:
        """Scale of the noise [m/s^2], the root mean square over the channels: what CN knows."""
        exact = simulate(
            paper.chain(stiffness=self.stiffness), self.record, dt=self.step(min(self.multipliers))
        )
        return float(np.sqrt(np.mean(paper.noise_scale(exact, self.noise) ** 2)))

    def step(self, multiplier: float) -> float:
        """Sampling step [s]."""
        return multiplier * self.record.dt

    def misfit(self, multiplier: float) -> Step:
        """The misfit at one sampling step, for the exact posteriors; the same object each time."""
        if multiplier not in self.steps:
            self.steps[multiplier] = self._misfit(multiplier)
        return self.steps[multiplier]

    def _misfit(self, multiplier):
        measured = self.data(multiplier)
        data = np.ascontiguousarray(measured.values)
        asked = request(paper.N_STOREYS, self.record.dt, dt=self.step(multiplier))

        def sums(theta):
            squares, increments, first, last = chain_misfit(
                *paper.chain(theta, stiffness=self.stiffness).parameters(),
                self.record.acceleration,
                self.record.dt,
                asked.substeps,
                asked.stride,
                asked.sensors,
                asked.n_modes,
                asked.quantity_code,
                data,
            ).T
            return np.array([squares.sum(), increments.sum(), first @ first, last @ last])

        return Step(sums, measured, self.step(multiplier), self.scale)

    def part_seed(self, likelihood: str) -> int:
        """Seed of one part: the same at all sampling steps, which then differ by their data."""
        key = [self.seed, list(LIKELIHOODS).index(likelihood)]
        return int(np.random.SeedSequence(key).generate_state(1)[0])


def sampling_rate_study(
    record: Record,
    *,
    stiffness: float = paper.STIFFNESS,
    noise: float = paper.NOISE,
    multipliers: Sequence[float] = paper.MULTIPLIERS,
    likelihoods: Sequence[str] = tuple(LIKELIHOODS),
    draws: int = 2000,
    chains: int = 4,
    cores: int | None = None,
    random_seed: int = 0,
    out=None,
    progress: Callable[[str, int, int], None] | None = None,
    progressbar: bool = True,
) -> xr.DataTree:
    """Posterior of theta and sigma at several sampling steps, sampled and exact.

    The ten-storey chain of the source is measured once, at the finest step and with noise; coarser data
    are every n-th sample of that history. NORM narrows with the sampling rate; TN, EXP and ABC do not.
    Errors correlated in time (CN) neither, as long as their time and scale are known and not inferred from
    noise that is in truth white.

    Parameters
    ----------
    record : Record
        Ground acceleration.
    stiffness : float
        Nominal spring stiffness [N/m], positive.
    noise : float
        Standard deviation of the noise over the root mean square of each channel [-], positive.
    multipliers : sequence of float
        Sampling steps over the record's step; integers or their reciprocals.
    likelihoods : sequence of {"NORM", "TN", "EXP", "ABC", "CN", "CN-SIGMA", "CN-TAU"}
        The tolerance of ABC follows from the exact posterior of EXP, Eq. (16). CN is `CorrelatedNormal` with
        correlation time and sigma known, CN-SIGMA with sigma inferred, CN-TAU with both inferred.
    draws, chains, cores : int
        Of `sample_smc`, with `SubsetSimulation` for ABC and `PersistentSMC` otherwise; all processors by
        default.
    random_seed : int
        Of noise and samplers.
    out : path, optional
        Folder in which each finished part is kept at once; a second call with the same settings
        continues. In memory only by default.
    progress : callable (str, int, int), optional
        Called with the name of the part in work, the number finished, and the number in all.
    progressbar : bool
        Whether each part shows PyMC's own progress bar.

    Returns
    -------
    DataTree
        `/summary`: maximum, 5, 50 and 95 % quantiles, `sampled` and `exact` by quadrature, both
        (likelihood, multiplier, parameter, statistic); `r_hat`, `ess_bulk`, `seconds`, `log_evidence`;
        `tolerance` of ABC and the ends of the exact `tolerance_interval`. `/<likelihood>/x<multiplier>`:
        posterior and sampler statistics. `/data`: record and finest measurements. Saves with `to_netcdf`.

    Raises
    ------
    ValueError
        If a setting is out of range, or `out` holds another study.
    """
    study = _checked_study(record, stiffness, noise, multipliers, likelihoods, draws, chains, random_seed)
    store = PartStore(out, study.settings())
    names = [(kind, m) for m in study.multipliers for kind in study.likelihoods]
    parts: dict[tuple[str, float], xr.DataTree] = {}
    models: dict[str, pm.Model] = {}
    for done, (kind, multiplier) in enumerate(names):
        label = part_name(kind, multiplier)
        if progress is not None:
            progress(label, done, len(names))
        part = store.load(label)
        if part is None:
            tolerance = study.misfit(multiplier).delta if kind == "ABC" else None
            part = run_part(study, kind, multiplier, tolerance, models, cores, progressbar)
            store.save(label, part)
        parts[kind, multiplier] = part
    if progress is not None:
        progress("exact posteriors", len(names), len(names))
    return assemble(study, parts)


def part_name(kind: str, multiplier: float) -> str:
    """Name of one part in files and messages, such as TN_x0.1."""
    return f"{kind}_x{multiplier:g}"


def run_part(study, kind, multiplier, tolerance, models, cores, progressbar) -> xr.DataTree:
    """Sample one posterior; `models` keeps the model of each likelihood, which is compiled once."""
    data = study.data(multiplier)
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=FeatureLikelihoodWarning)
        if kind not in models:
            models[kind] = declare(
                kind,
                study.record,
                data,
                stiffness=study.stiffness,
                tolerance=tolerance,
                scale=study.scale,
            )
        set_measurements(models[kind], data, tolerance)
        idata = sample_smc(
            study.draws,
            SubsetSimulation if kind == "ABC" else PersistentSMC,
            model=models[kind],
            chains=study.chains,
            cores=cores,
            random_seed=study.part_seed(kind),
            compute_convergence_checks=False,
            progressbar=progressbar,
            # one Op does the work; to compile the few around it takes longer than it saves
            compile_kwargs={"mode": "FAST_COMPILE"},
        )
    part = xr.DataTree.from_dict(
        {"posterior": idata["posterior"].to_dataset(), "sample_stats": idata["sample_stats"].to_dataset()}
    )
    part.attrs = {"seconds": time.perf_counter() - start}
    if tolerance is not None:
        part.attrs["tolerance"] = tolerance
    return part


def _checked_study(record, stiffness, noise, multipliers, likelihoods, draws, chains, seed):
    """Return the settings, checked, with the measurements made."""
    if not isinstance(record, Record):
        raise TypeError(f"`record` must be a Record, got {type(record).__name__}.")
    if not 0.0 < noise < np.inf:
        raise ValueError(
            f"`noise` must be positive, got {noise}. Without noise sigma runs to zero and no posterior "
            "exists; pass 0.05 for 5 %."
        )
    unknown = [kind for kind in likelihoods if kind not in LIKELIHOODS]
    if unknown or not likelihoods:
        raise ValueError(f"`likelihoods` must be among {', '.join(LIKELIHOODS)}, got {likelihoods}.")
    for name, value, least in (
        ("draws", draws, 50),
        ("chains", chains, 1),
        ("random_seed", seed, 0),
    ):
        if isinstance(value, bool) or int(value) != value or value < least:
            raise ValueError(f"`{name}` must be an integer of at least {least}, got {value}.")
    multipliers = tuple(sorted({float(m) for m in multipliers}))
    if not multipliers:
        raise ValueError("`multipliers` must name at least one sampling step, got none.")
    finest = paper.measurements(record, stiffness=stiffness, noise=noise, seed=seed, multipliers=multipliers)
    kinds = tuple(kind for kind in LIKELIHOODS if kind in likelihoods)
    study = Study(
        record,
        float(stiffness),
        float(noise),
        multipliers,
        kinds,
        int(draws),
        int(chains),
        int(seed),
        finest,
    )
    for multiplier in multipliers:
        if study.data(multiplier).sizes["time"] < 10:
            raise ValueError(
                f"`multipliers` must leave at least 10 samples, got {multiplier:g} on a record of "
                f"{record.duration:.4g} s. Use a longer record or smaller steps."
            )
    return study
