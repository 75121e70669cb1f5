"""Ways to compare response and measurements: the catalogue that `update`, the study and the figures share.

They take everything they know of a likelihood from its entry: how it is declared, what it means, which
parameters it takes, its colour, and where it depends on the sum S of the mean squares alone, its exponents.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pymc as pm
import pytensor.tensor as pt

from pymc_features.likelihoods.abc import DiscrepancySimulator
from pymc_features.likelihoods.correlated import CorrelatedNormal
from pymc_features.likelihoods.mean_square import ExpFeature, GammaFeature, TruncNormalFeature

DIMS = ("sensor", "time")


@dataclass(frozen=True)
class Comparison:
    """Response, measurements and parameters of a comparison; those that a likelihood does not take are None.

    Attributes
    ----------
    mu : TensorVariable (sensor, time)
        Response [m/s^2].
    observed : array or TensorVariable (sensor, time)
        Measurements [m/s^2]; NaN in an array are gaps, for a likelihood that takes them.
    sigma, correlation_time : TensorVariable () or (sensor,)
        Scale [m/s^2] and correlation time [s] of the errors.
    m : TensorVariable () or (sensor,)
        Independent observations of each sensor [-].
    epsilon : float or TensorVariable
        Tolerance of ABC [m^2/s^4].
    dt : TensorVariable, optional
        Step of the measurements [s], where it is not the fixed output step of the response.
    density : {"feature", "data"}
        Of the feature likelihoods.
    """

    mu: pt.TensorVariable
    observed: object
    sigma: pt.TensorVariable | None = None
    correlation_time: pt.TensorVariable | None = None
    m: pt.TensorVariable | None = None
    epsilon: object = None
    dt: pt.TensorVariable | None = None
    density: str = "feature"


class Exponents(NamedTuple):
    """m, c and constant in ln L = constant - m ln(sigma) - c S / (2 sigma^2), over all sensors."""

    m: float
    c: float
    constant: float


@dataclass(frozen=True)
class Likelihood:
    """One way to compare response and measurements.

    Attributes
    ----------
    name : str
        In files, tables and figures.
    meaning : str
        What it takes for the error, in a few words, with its equation in the source.
    colour : str
        In figures.
    declare : callable, optional
        Adds the observed variable `y` with the dimensions `DIMS` to the model of the context, from a
        `Comparison`. None where no response is compared in time.
    exponents : callable, optional
        From the numbers of sensors and samples to the `Exponents` of a likelihood of S(theta), whose exact
        posterior the study then knows.
    takes : tuple of str
        Which of sigma, correlation_time, m and epsilon it needs.
    known, inferred : tuple of str
        Those of them that must be numbers, and those that must have a prior; others may be either.
    reasons : dict
        Why the interval of a parameter "narrows" or "widens" with the sampling rate, where it does so on a
        record of some length.
    takes_gaps : bool
        Whether data may have gaps, whose samples are left out.
    calibrates : str
        Name of the likelihood from whose posterior this one follows by `calibrate`; it declares the same
        model. Empty for one that is sampled by itself.
    """

    name: str
    meaning: str
    colour: str
    declare: Callable[[Comparison], object] | None = None
    exponents: Callable[[int, int], Exponents] | None = None
    takes: tuple[str, ...] = ("sigma",)
    known: tuple[str, ...] = ()
    inferred: tuple[str, ...] = ()
    reasons: dict[str, str] = field(default_factory=dict)
    takes_gaps: bool = True
    calibrates: str = ""

    @property
    def is_likelihood_free(self) -> bool:
        """Return whether the likelihood has a tolerance in place of a density."""
        return "epsilon" in self.takes

    def claimed(self, samples: np.ndarray, m: float | np.ndarray | None = None) -> float | None:
        """Independent observations that it counts; None if it counts none, or allows for their correlation.

        `samples` (sensor,) are the numbers of those measured; `m`, one number or one for each sensor, is that
        of a likelihood that takes it.
        """
        if "m" in self.takes:
            return float(np.sum(np.broadcast_to(m, len(samples))))
        return None if self.exponents is None else float(self.exponents(len(samples), np.mean(samples)).m)


def declare_norm(given):
    """Add independent Gaussian samples, Eq. (2).

    Of data with gaps, NaN in an array, by the same density of the samples measured: e_j over sigma_j^2 / N_j
    is chi-square with N_j degrees of freedom.
    """
    if isinstance(given.observed, np.ndarray) and np.isnan(given.observed).any():
        n = (~np.isnan(given.observed)).sum(axis=-1).astype(np.float64)
        sigma = given.sigma / np.sqrt(n)
        GammaFeature("y", given.mu, sigma, m=n, density="data", observed=given.observed, dims=DIMS)
        return
    sigma = given.sigma[:, None] if given.sigma.ndim else given.sigma
    pm.Normal("y", mu=given.mu, sigma=sigma, observed=given.observed, dims=DIMS)


def declare_feature(likelihood, *names):
    """A function that adds a feature likelihood, with parameters of these names besides sigma."""

    def declare(given):
        more = {name: getattr(given, name) for name in names}
        settings = {"density": given.density, "observed": given.observed, "dims": DIMS}
        likelihood("y", mu=given.mu, sigma=given.sigma, **more, **settings)

    return declare


def declare_correlated(given):
    """Add Gaussian errors correlated in time."""
    CorrelatedNormal(
        "y", given.mu, given.sigma, given.correlation_time, given.dt, observed=given.observed, dims=DIMS
    )


def norm_exponents(n_sensors: int, n_times: int) -> Exponents:
    """Eq. (2) in powers of sigma and S."""
    n = n_sensors * n_times
    return Exponents(n, n_times, -0.5 * n * np.log(2.0 * np.pi))


NORM = Likelihood(
    "NORM",
    "every sample an independent Gaussian observation, Eq. (2)",
    "#0072B2",
    declare_norm,
    norm_exponents,
    reasons={"narrows": "sampling faster is taken for new information"},
)
TN = Likelihood(
    "TN",
    "half-normal on the root mean square of each sensor, Eq. (7)",
    "#E69F00",
    declare_feature(TruncNormalFeature),
    lambda n_sensors, n_times: Exponents(n_sensors, 1.0, 0.5 * n_sensors * np.log(2.0 / np.pi)),
)
EXP = Likelihood(
    "EXP",
    "exponential on the mean square of each sensor, Eq. (9)",
    "#009E73",
    declare_feature(ExpFeature),
    lambda n_sensors, n_times: Exponents(2 * n_sensors, 1.0, -n_sensors * np.log(2.0)),
)
ABC = Likelihood(
    "ABC",
    "likelihood-free: sum of the mean squares within a tolerance, Eqs. (14)-(15)",
    "#CC79A7",
    lambda given: DiscrepancySimulator(
        "y", given.mu, epsilon=given.epsilon, observed=given.observed, dims=DIMS
    ),
    takes=("epsilon",),
)
CN = Likelihood(
    "CN",
    "errors correlated in time; tau and sigma known",
    "#D55E00",
    declare_correlated,
    takes=("sigma", "correlation_time"),
    known=("sigma", "correlation_time"),
    takes_gaps=False,
)
CN_SIGMA = Likelihood(
    "CN-SIGMA",
    "errors correlated in time; tau known, sigma inferred",
    "#56B4E9",
    declare_correlated,
    takes=("sigma", "correlation_time"),
    known=("correlation_time",),
    inferred=("sigma",),
    takes_gaps=False,
    reasons={"widens": "the errors do not have the correlation assumed, and sigma grows for it"},
)
CN_TAU = Likelihood(
    "CN-TAU",
    "errors correlated in time; tau and sigma inferred",
    "#882255",
    declare_correlated,
    takes=("sigma", "correlation_time"),
    inferred=("sigma", "correlation_time"),
    takes_gaps=False,
    reasons={"narrows": "white noise is found, and sampling it faster is taken for new information"},
)
GAMMA = Likelihood(
    "GAMMA",
    "chi-square on the mean square of each sensor, with m degrees of freedom",
    "#4B0000",
    declare_feature(GammaFeature, "m"),
    takes=("sigma", "m"),
    known=("m",),
)
CAL = Likelihood(
    "CAL",
    "the posterior of NORM, made as wide as the residuals of its fit support",
    "black",
    declare_norm,
    reasons={"narrows": "residuals that are white at every step do tell more where there are more of them"},
    calibrates="NORM",
)

#: By name. The place of a likelihood is part of its seed: new ones go to the end.
LIKELIHOODS = {entry.name: entry for entry in (NORM, TN, EXP, ABC, CN, CN_SIGMA, CN_TAU, GAMMA, CAL)}
