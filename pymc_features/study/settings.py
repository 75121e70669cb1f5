"""What determines the numbers of a study: settings, checked, and the measurements made with them."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import xarray as xr

from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.storage import fingerprint
from pymc_features.structures import Structure
from pymc_features.study import paper
from pymc_features.study.misfits import SharedResponses, computed_sums
from pymc_features.study.models import LIKELIHOODS
from pymc_features.study.references import Step
from pymc_features.study.structures import DEFAULT, StudyStructure, find_structure


@dataclass(frozen=True)
class Study:
    """Settings of a study; see `sampling_rate_study`."""

    record: Record
    structure: StudyStructure
    noise: float
    multipliers: tuple[float, ...]
    likelihoods: tuple[str, ...]
    draws: int
    chains: int
    random_seed: int
    finest: xr.DataArray = field(repr=False)
    steps: dict[float, Step] = field(default_factory=dict, repr=False)

    def settings(self) -> dict:
        """All that determines the numbers, for the folder they are kept in."""
        settings = {
            "record": self.record.name,
            "record_sha256": fingerprint(self.record.acceleration),
            "record_dt": self.record.dt,
            "stiffness": self.structure.stiffness,
            "noise": self.noise,
            "multipliers": list(self.multipliers),
            "likelihoods": list(self.likelihoods),
            "draws": self.draws,
            "chains": self.chains,
            "random_seed": self.random_seed,
        }
        # folders of the linear chain are older than the choice
        name = self.structure.name
        return settings if name == DEFAULT else {"structure": name} | settings

    def at(self, theta=1.0) -> Structure:
        """The structure with this factor, by default the true one."""
        return self.structure.at(theta)

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
            self.steps[multiplier] = Step(sums, data, dt, self.scale)
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
        key = [self.random_seed, list(LIKELIHOODS).index(likelihood)]
        return int(np.random.SeedSequence(key).generate_state(1)[0])


def checked_study(
    record,
    *,
    structure=DEFAULT,
    noise=paper.NOISE,
    multipliers=paper.MULTIPLIERS,
    likelihoods=None,
    draws=None,
    chains=None,
    random_seed=None,
) -> Study:
    """Return the settings, checked, with the measurements made; None stands for the structure's default."""
    if not isinstance(record, Record):
        raise TypeError(f"`record` must be a Record, got {type(record).__name__}.")
    structure = structure if isinstance(structure, StudyStructure) else find_structure(structure)
    likelihoods = structure.likelihoods if likelihoods is None else likelihoods
    draws = structure.draws if draws is None else draws
    chains = structure.chains if chains is None else chains
    if random_seed is None:
        random_seed = int(np.random.SeedSequence().generate_state(1)[0])
    if not 0.0 < noise < np.inf:
        raise ValueError(
            f"`noise` must be positive, got {noise}. Without noise sigma runs to zero and no posterior "
            "exists; pass 0.05 for 5 %."
        )
    unknown = [kind for kind in likelihoods if kind not in LIKELIHOODS]
    if unknown or not likelihoods:
        raise ValueError(f"`likelihoods` must be among {', '.join(LIKELIHOODS)}, got {likelihoods}.")
    for name, value, least in (("draws", draws, 50), ("chains", chains, 1), ("random_seed", random_seed, 0)):
        if isinstance(value, bool) or int(value) != value or value < least:
            raise ValueError(f"`{name}` must be an integer of at least {least}, got {value}.")
    multipliers = tuple(sorted({float(m) for m in multipliers}))
    if not multipliers:
        raise ValueError("`multipliers` must name at least one sampling step, got none.")
    study = Study(
        record,
        structure,
        float(noise),
        multipliers,
        tuple(kind for kind in LIKELIHOODS if kind in likelihoods),
        int(draws),
        int(chains),
        int(random_seed),
        paper.measurements(
            record,
            stiffness=structure.stiffness,
            noise=noise,
            random_seed=random_seed,
            multipliers=multipliers,
            structure=structure.chain,
        ),
    )
    check_measurements(study)
    return study


def check_measurements(study: Study):
    """Refuse a response that failed, and sampling steps that leave too little of it."""
    if not np.isfinite(study.finest).all():
        raise ValueError(
            f"`record` must give the {study.structure.title} a finite response, got NaN. Check its units."
        )
    for multiplier in study.multipliers:
        if study.data(multiplier).sizes["time"] < 10:
            raise ValueError(
                f"`multipliers` must leave at least 10 samples, got {multiplier:g} on a record of "
                f"{study.record.duration:.4g} s. Use a longer record or smaller steps."
            )
