"""What the study, `update` and the figures need to know of a likelihood."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytensor.tensor as pt

from pymc_features.likelihoods.exact.quadrature import Exponents
from pymc_features.likelihoods.exact.step import Reference, Step, posterior_of_curve

DIMS = ("sensor", "time")


@dataclass(frozen=True)
class Comparison:
    """What is compared, and with which parameters; those that a likelihood does not take are None.

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
    declare : callable
        Adds the observed variable `y` with the dimensions `DIMS` to the model of the context, from a
        `Comparison`.
    exponents : callable, optional
        From the numbers of sensors and samples to the `Exponents` of a likelihood of S(theta).
    posterior : callable, optional
        From a `Step` of the study to the exact posterior, of any other likelihood. One that has neither
        cannot be named in the study.
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
    declare: Callable[[Comparison], object]
    exponents: Callable[[int, int], Exponents] | None = None
    posterior: Callable[[Step], Reference] | None = None
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

    @property
    def has_reference(self) -> bool:
        """Whether its exact posterior is known, so that the study can judge draws by it."""
        return self.exponents is not None or self.posterior is not None

    def claimed(self, samples, m=None) -> float | None:
        """Independent observations that it counts; None if it counts none, or allows for their correlation.

        `samples` (sensor,) are the numbers of those measured; `m`, one number or one for each sensor, is that
        of a likelihood that takes it.
        """
        if "m" in self.takes:
            return float(np.sum(np.broadcast_to(m, len(samples))))
        return None if self.exponents is None else float(self.exponents(len(samples), np.mean(samples)).m)

    def reference(self, step: Step) -> Reference:
        """The exact posterior at one sampling step of the study."""
        if self.posterior is not None:
            return self.posterior(step)
        return posterior_of_curve(step.curve, self.exponents(*step.shape), step.priors.sigma)
