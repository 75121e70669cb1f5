"""Settings of a study, and the measurements, misfits and PyMC models that follow from them.

Of the misfit between response and measurements at one sampling step, four sums over the sensors are all that
the likelihoods need: of its squares, of those of its increments, and of the first and last square.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from scipy.interpolate import CubicSpline

from pymc_features._checks import check_integer, check_positive, check_seed, check_texts, message, shown
from pymc_features.likelihoods import DIMS, LIKELIHOODS, Comparison
from pymc_features.ops import response
from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.storage import fingerprint
from pymc_features.structures import Structure
from pymc_features.study import paper
from pymc_features.study.exact import WITH_REFERENCE, DiscrepancyCurve, Step
from pymc_features.study.structures import DEFAULT, StudyStructure, find_structure

WHITE = "Pass 0 for white noise."
N_NODES = 601  # of theta, at which responses are computed
WITHOUT_NOISE = "Without noise sigma runs to zero and no posterior exists; pass 0.05 for 5 %."


@dataclass(eq=False)
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
        self.record = paper.with_straight_lines(self.record)
        if not isinstance(self.structure, StudyStructure):
            self.structure = find_structure(self.structure)
        for name in ("likelihoods", "draws", "chains"):
            if getattr(self, name) is None:
                setattr(self, name, getattr(self.structure, name))
        if self.random_seed is None:
            self.random_seed = int(np.random.SeedSequence().generate_state(1)[0])
        what = f"among {', '.join(WITH_REFERENCE)}"
        named = check_texts(self.likelihoods, "likelihoods", what)
        if not named or not set(named) <= set(WITH_REFERENCE):
            raise ValueError(message("likelihoods", what, shown(self.likelihoods)))
        self.likelihoods = tuple(kind for kind in WITH_REFERENCE if kind in named)
        self.noise = check_positive(self.noise, "noise", WITHOUT_NOISE)
        self.noise_time = check_positive(self.noise_time, "noise_time", WHITE, allow_zero=True)
        self.draws = check_integer(self.draws, "draws", least=50)
        self.chains = check_integer(self.chains, "chains")
        self.random_seed = check_seed(self.random_seed, several=False)
        self.multipliers = tuple(paper.checked_multipliers(self.multipliers).tolist())
        check_measurements(self)

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
            self.steps[multiplier] = Step(self, multiplier)
        return self.steps[multiplier]

    def response(self, theta: float, dt: float) -> np.ndarray:
        """Absolute accelerations at one sampling step [s], (sensor, time) [m/s^2]."""
        return simulate(self.at(theta), self.record, dt=dt).values

    @cached_property
    def sums(self) -> Callable:
        """The four sums of the misfit at every sampling step, see `shared_sums`."""
        finest = self.multipliers[0]
        strides = [round(m / finest) for m in self.multipliers]
        return shared_sums(partial(self.response, dt=self.step(finest)), self.finest.values, strides)

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


def shared_sums(respond: Callable, data: np.ndarray, strides: Sequence[int]) -> Callable:
    """The four sums at all sampling steps from one response for each theta: theta -> (..., step, 4).

    The response at a coarser step is every n-th sample of that at the finest, n of `strides`, the first 1:
    `respond(theta)` (s, u) [m/s^2], as `data` are. It is computed at nodes of theta that resolve the
    narrowest posterior and cover the prior, about a thousand; between them the sums are cubic splines, right
    to 1e-6 where the posteriors are (tests/study/test_study_exact.py). No response is kept.
    """

    @cache
    def at(theta):
        misfit = data - respond(theta)
        return np.array([sums_of(misfit[:, ::n]) for n in strides])

    curve = DiscrepancyCurve(
        lambda theta: float(at(theta)[0, 0]) / data.shape[1], paper.THETA_RANGE, data.size, N_NODES
    )
    splines = CubicSpline(curve.grid.u, np.array([at(theta) for theta in curve.grid.nodes]))
    return lambda theta: splines(curve.grid_variable(theta))


def sums_of(misfit: np.ndarray) -> np.ndarray:
    """The four sums (4,) of a misfit (s, u)."""
    parts = misfit, np.diff(misfit, axis=1), misfit[:, 0], misfit[:, -1]
    return np.array([(part**2).sum() for part in parts])


def declare(
    kind: str,
    record: Record,
    data: xr.DataArray,
    *,
    structure: Callable[[pt.TensorVariable], Structure] = paper.chain,
    tolerance: float | None = None,
    scale: float | None = None,
) -> pm.Model:
    """Return the model of one structure, ``theta -> structure``, under one of the `LIKELIHOODS`.

    It has `theta`, `sigma` and `tau` where they are inferred, and `y`: floor accelerations (sensor, time)
    [m/s^2]. ABC has the `tolerance` delta [m^2/s^4], and CN knows the `scale` of the noise [m/s^2].
    Measurements, their step and the tolerance are data of the model: `set_measurements` changes them without
    compiling anything anew.
    """
    likelihood, times = LIKELIHOODS[kind], data["time"].values
    coords = {"sensor": data["sensor"].values, "time": times}
    with pm.Model(coords=coords) as model:
        theta = pm.Uniform("theta", *paper.THETA_RANGE)
        step = pm.Data("step", times[1] - times[0])
        measured = pm.Data("measured", data.values, dims=DIMS)
        delta = None if tolerance is None else pm.Data("tolerance", tolerance)
        mu = response(structure(theta), record, dt=step)
        tau, sigma = correlation_time(likelihood), noise_scale(likelihood, scale)
        likelihood.declare(Comparison(mu, measured, sigma, tau, epsilon=delta, dt=step))
    return model


def noise_scale(likelihood, scale):
    """sigma [m/s^2]: `scale` where it is known, else a variable."""
    if "sigma" not in likelihood.takes:
        return None
    known = "sigma" in likelihood.known
    return pt.as_tensor_variable(scale) if known else pm.Uniform("sigma", *paper.SIGMA_RANGE)


def correlation_time(likelihood):
    """tau [s]: that of the noise where it is known, else a variable."""
    if "correlation_time" not in likelihood.takes:
        return None
    if "correlation_time" in likelihood.known:
        return pt.as_tensor_variable(paper.CORRELATION_TIME)
    return pm.Deterministic("tau", pt.exp(pm.Uniform("log_tau", *np.log(paper.TAU_RANGE))))


def set_measurements(model: pm.Model, data: xr.DataArray, tolerance: float | None = None):
    """Give a model of `declare` other measurements, at another step."""
    times = data["time"].values
    with model:
        pm.set_data({"measured": data.values, "step": times[1] - times[0]}, coords={"time": times})
        if tolerance is not None:
            pm.set_data({"tolerance": tolerance})
