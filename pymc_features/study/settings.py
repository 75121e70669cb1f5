"""What determines the numbers of a study: settings, checked, and the measurements made with them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
import xarray as xr

from pymc_features._checks import check_integer, check_positive, check_seed, check_texts, message, shown
from pymc_features.likelihoods import LIKELIHOODS, WITH_REFERENCE
from pymc_features.likelihoods.exact.step import Priors, Step
from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.storage import fingerprint
from pymc_features.structures import Structure
from pymc_features.study import paper
from pymc_features.study.misfits import SharedResponses, computed_sums
from pymc_features.study.structures import DEFAULT, StudyStructure, find_structure

WHITE = "Pass 0 for white noise."
WITHOUT_NOISE = "Without noise sigma runs to zero and no posterior exists; pass 0.05 for 5 %."


@dataclass(frozen=True)
class Study:
    """Settings of a study, checked; see `sampling_rate_study`. None stands for the structure's default."""

    record: Record
    structure: str | StudyStructure = DEFAULT
    noise: float = paper.NOISE
    multipliers: Sequence[float] = paper.MULTIPLIERS
    likelihoods: Sequence[str] | None = None
    draws: int | None = None
    chains: int | None = None
    random_seed: int | None = None
    noise_time: float = 0.0
    steps: dict[float, Step] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self):
        if not isinstance(self.record, Record):
            raise TypeError(f"`record` must be a Record, got {type(self.record).__name__}.")
        self._set("record", paper.with_straight_lines(self.record))
        if not isinstance(self.structure, StudyStructure):
            self._set("structure", find_structure(self.structure))
        for name in ("likelihoods", "draws", "chains"):
            if getattr(self, name) is None:
                self._set(name, getattr(self.structure, name))
        if self.random_seed is None:
            self._set("random_seed", int(np.random.SeedSequence().generate_state(1)[0]))
        what = f"among {', '.join(WITH_REFERENCE)}"
        named = check_texts(self.likelihoods, "likelihoods", what)
        if not named or not set(named) <= set(WITH_REFERENCE):
            raise ValueError(message("likelihoods", what, shown(self.likelihoods)))
        self._set("likelihoods", tuple(kind for kind in WITH_REFERENCE if kind in named))
        self._set("noise", check_positive(self.noise, "noise", WITHOUT_NOISE))
        self._set("noise_time", check_positive(self.noise_time, "noise_time", WHITE, allow_zero=True))
        self._set("draws", check_integer(self.draws, "draws", least=50))
        self._set("chains", check_integer(self.chains, "chains"))
        self._set("random_seed", check_seed(self.random_seed, several=False))
        self._set("multipliers", tuple(paper.checked_multipliers(self.multipliers).tolist()))
        check_measurements(self)

    def _set(self, name, value):
        object.__setattr__(self, name, value)

    @cached_property
    def finest(self) -> xr.DataArray:
        """Measurements at the smallest step (sensor, time) [m/s^2]."""
        return paper.measurements(
            self.record,
            stiffness=self.structure.stiffness,
            noise=self.noise,
            noise_time=self.noise_time,
            random_seed=self.random_seed,
            multipliers=self.multipliers,
            structure=self.structure.chain,
        )

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
        # folders of the linear chain with white noise are older than the choice
        chosen = {"structure": self.structure.name, "noise_time": self.noise_time}
        defaults = {"structure": DEFAULT, "noise_time": 0.0}
        return {name: value for name, value in chosen.items() if value != defaults[name]} | settings

    @property
    def title(self) -> str:
        """For figures: the structure, and the noise where it is not white."""
        noise = f", noise correlated over {self.noise_time:g} s" if self.noise_time else ""
        return f"{self.structure.title}{noise}"

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
            known = paper.CORRELATION_TIME, self.scale
            priors = Priors(paper.THETA_RANGE, paper.SIGMA_RANGE, paper.TAU_RANGE, *known)
            response = partial(self.response, dt=dt)
            self.steps[multiplier] = Step(sums, data, dt, priors, response, self.frequencies)
        return self.steps[multiplier]

    def response(self, theta: float, dt: float) -> np.ndarray:
        """Absolute accelerations at one sampling step [s], (sensor, time) [m/s^2]."""
        return simulate(self.at(theta), self.record, dt=dt).values

    def frequencies(self, theta: float) -> np.ndarray:
        """Natural frequencies of small motions [Hz]."""
        return self.at(theta).modes().natural_frequencies

    @cached_property
    def shared(self) -> SharedResponses:
        """Responses that serve all sampling steps, of a structure that must be integrated."""
        finest = self.multipliers[0]
        return SharedResponses(
            partial(self.response, dt=self.step(finest)),
            self.finest.values,
            {m: round(m / finest) for m in self.multipliers},
        )

    def part_seed(self, likelihood: str) -> int:
        """Seed of one part: the same at all sampling steps, which then differ by their data."""
        key = [self.random_seed, list(LIKELIHOODS).index(likelihood)]
        return int(np.random.SeedSequence(key).generate_state(1)[0])


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
