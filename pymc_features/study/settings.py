"""What determines the numbers of a study: settings, checked, and the measurements made with them."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import xarray as xr

from pymc_features._checks import check_integer, check_positive
from pymc_features.likelihoods import LIKELIHOODS, WITH_REFERENCE
from pymc_features.likelihoods.exact.step import Priors, Step
from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.storage import fingerprint
from pymc_features.structures import Structure
from pymc_features.study import paper
from pymc_features.study.misfits import SharedResponses, computed_sums
from pymc_features.study.structures import DEFAULT, StudyStructure, find_structure


@dataclass(frozen=True)
class Study:
    """Settings of a study; see `sampling_rate_study`."""

    record: Record
    structure: str
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
        settings = {
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
        # folders of the linear chain are older than the choice
        return settings if self.structure == DEFAULT else {"structure": self.structure} | settings

    @property
    def described(self) -> StudyStructure:
        """The entry of the catalogue."""
        return find_structure(self.structure)

    def at(self, theta=1.0) -> Structure:
        """The structure with this factor, by default the true one."""
        return self.described.chain(theta, stiffness=self.stiffness)

    def data(self, multiplier: float) -> xr.DataArray:
        """Measurements at one sampling step, decimated from the finest history."""
        return paper.decimate(self.finest, self.step(multiplier))

    @cached_property
    def scale(self) -> float:
        """Scale of the noise [m/s^2], the root mean square over the channels: what CN knows."""
        exact = simulate(self.at(), self.record, dt=self.step(min(self.multipliers)))
        return float(np.sqrt(np.mean(paper.noise_scale(exact, self.noise) ** 2)))

    def step(self, multiplier: float) -> float:
        """Sampling step [s]."""
        return multiplier * self.record.dt

    def misfit(self, multiplier: float) -> Step:
        """The misfit at one sampling step, for the exact posteriors; the same object each time."""
        if multiplier not in self.steps:
            data, dt = self.data(multiplier), self.step(multiplier)
            if self.at().is_linear:
                sums = computed_sums(self.at, self.record, data.values, dt)
            else:
                sums = self.shared.sums(multiplier)
            known = paper.CORRELATION_TIME, self.scale
            priors = Priors(paper.THETA_RANGE, paper.SIGMA_RANGE, paper.TAU_RANGE, *known)
            self.steps[multiplier] = Step(sums, data, dt, priors)
        return self.steps[multiplier]

    @cached_property
    def shared(self) -> SharedResponses:
        """Responses that serve all sampling steps, of a structure that must be integrated."""
        finest = self.multipliers[0]
        return SharedResponses(
            lambda theta: simulate(self.at(theta), self.record, dt=self.step(finest)).values,
            self.finest.values,
            {m: round(m / finest) for m in self.multipliers},
        )

    def part_seed(self, likelihood: str) -> int:
        """Seed of one part: the same at all sampling steps, which then differ by their data."""
        key = [self.seed, list(LIKELIHOODS).index(likelihood)]
        return int(np.random.SeedSequence(key).generate_state(1)[0])


def checked_study(
    record,
    *,
    structure=DEFAULT,
    stiffness=paper.STIFFNESS,
    noise=paper.NOISE,
    multipliers=paper.MULTIPLIERS,
    likelihoods=None,
    draws=None,
    chains=None,
    seed=0,
) -> Study:
    """Return the settings, checked, with the measurements made; None stands for the structure's default."""
    if not isinstance(record, Record):
        raise TypeError(f"`record` must be a Record, got {type(record).__name__}.")
    described = find_structure(structure)
    likelihoods = described.likelihoods if likelihoods is None else likelihoods
    draws = described.draws if draws is None else draws
    chains = described.chains if chains is None else chains
    advice = "Without noise sigma runs to zero and no posterior exists; pass 0.05 for 5 %."
    noise = check_positive(noise, "noise", advice)
    unknown = [kind for kind in likelihoods if kind not in WITH_REFERENCE]
    if unknown or not likelihoods:
        raise ValueError(f"`likelihoods` must be among {', '.join(WITH_REFERENCE)}, got {likelihoods}.")
    for name, value, least in (("draws", draws, 50), ("chains", chains, 1), ("random_seed", seed, 0)):
        check_integer(value, name, least=least)
    multipliers = tuple(sorted({float(m) for m in multipliers}))
    if not multipliers:
        raise ValueError("`multipliers` must name at least one sampling step, got none.")
    study = Study(
        record,
        structure,
        float(stiffness),
        float(noise),
        multipliers,
        tuple(kind for kind in WITH_REFERENCE if kind in likelihoods),
        int(draws),
        int(chains),
        int(seed),
        paper.measurements(
            *(record,),
            stiffness=stiffness,
            noise=noise,
            seed=seed,
            multipliers=multipliers,
            structure=described.chain,
        ),
    )
    check_measurements(study)
    return study


def check_measurements(study: Study):
    """Refuse a response that failed, and sampling steps that leave too little of it."""
    if not np.isfinite(study.finest).all():
        raise ValueError(
            f"`record` must give the {study.described.title} a finite response, got NaN. Check its units."
        )
    for multiplier in study.multipliers:
        if study.data(multiplier).sizes["time"] < 10:
            raise ValueError(
                f"`multipliers` must leave at least 10 samples, got {multiplier:g} on a record of "
                f"{study.record.duration:.4g} s. Use a longer record or smaller steps."
            )
