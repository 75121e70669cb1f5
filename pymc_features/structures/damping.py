"""Classical damping: Rayleigh, Eq. (19), or a ratio for each mode."""

from abc import ABC, abstractmethod
from typing import Annotated, Self

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.graph.basic import Variable

from pymc_features._checks import message, shown
from pymc_features.structures.base import (
    NOT_NEGATIVE,
    Described,
    Values,
    as_vector,
    check_length,
    described,
    holds_variables,
    scalar,
    spread,
    unpacked,
    vector,
)

RATIO = "Pass values in fractions of critical damping."


class Damping(Described, ABC):
    """Classical damping: zeta_r = alpha / (2 omega_r) + beta omega_r / 2 + ratio_r."""

    @abstractmethod
    def coefficients(self, n: int) -> tuple:
        """Return the Rayleigh pair (2,) [1/s, s] and the added modal ratios (n,) [-]."""


@described
class RayleighDamping(Damping):
    """Rayleigh damping C = alpha M + beta K, Eq. (19).

    Parameters
    ----------
    alpha : float or TensorVariable
        Mass-proportional coefficient [1/s], not negative.
    beta : float or TensorVariable
        Stiffness-proportional coefficient [s], not negative.

    Examples
    --------
    >>> damping = RayleighDamping.from_ratios((0.02, 0.02), (1.0, 4.0))
    >>> print(f"{damping.alpha:.6f} {damping.beta:.6f}")
    0.201062 0.001273
    """

    alpha: Annotated[float | Variable, scalar("1/s", NOT_NEGATIVE)]
    beta: Annotated[float | Variable, scalar("s", NOT_NEGATIVE)]

    def __repr__(self):
        return f"RayleighDamping(alpha={self.alpha}, beta={self.beta})"

    @classmethod
    def from_ratios(cls, ratios: ArrayLike, natural_frequencies: ArrayLike) -> Self:
        """Rayleigh damping with given ratios at two frequencies.

        Solves zeta_i = alpha / (2 omega_i) + beta omega_i / 2 (Chopra, Dynamics of Structures, sec. 11.4).

        Parameters
        ----------
        ratios : float or array_like (2,)
            Damping ratios [-]; one value stands for both.
        natural_frequencies : array_like (2,)
            Two different frequencies [Hz].

        Raises
        ------
        ValueError, TypeError
            If the frequencies coincide, or a coefficient would be negative, which would feed energy
            into modes outside the two; if a ratio is random, for then this cannot be checked.
        """
        values = unpacked(ratios), unpacked(natural_frequencies)
        if holds_variables(values) or any(map(holds_variables, values)):
            raise TypeError(
                "`ratios` and `natural_frequencies` must be numbers, got PyTensor variables. For a random "
                "ratio zeta pass RayleighDamping(zeta * unit.alpha, zeta * unit.beta), with "
                "unit = RayleighDamping.from_ratios(1.0, natural_frequencies)."
            )
        advice = "Pass two frequencies in Hz."
        frequencies = as_vector(natural_frequencies, "natural_frequencies", advice)
        if frequencies.shape != (2,) or np.ptp(frequencies) == 0:
            got = shown(natural_frequencies)
            raise ValueError(message("natural_frequencies", "two different positive values", got, advice))
        zeta = as_vector(ratios, "ratios", RATIO, NOT_NEGATIVE)
        if zeta.shape not in ((), (1,), (2,)):
            raise ValueError(f"`ratios` must be one value or one for each frequency, got {zeta.size}.")
        zeta = np.broadcast_to(zeta, 2)
        omega = 2.0 * np.pi * frequencies
        alpha, beta = np.linalg.solve(0.5 * np.stack([1.0 / omega, omega], axis=1), zeta)
        if min(alpha, beta) < -1e-12 * max(alpha, beta):
            raise ValueError(
                f"`ratios` must allow non-negative coefficients, got alpha = {alpha:.4g} 1/s and "
                f"beta = {beta:.4g} s. Bring the two ratios closer together or use `ModalDamping`."
            )
        return cls(max(float(alpha), 0.0), max(float(beta), 0.0))

    def coefficients(self, n: int) -> tuple:
        if isinstance(self.alpha, Variable) or isinstance(self.beta, Variable):
            pair = pt.stack([pt.as_tensor_variable(c, dtype="float64") for c in (self.alpha, self.beta)])
        else:
            pair = np.array([self.alpha, self.beta])
        return pair, np.zeros(n)


@described
class ModalDamping(Damping):
    """A damping ratio for each mode.

    Parameters
    ----------
    ratios : float, array_like (n,) or TensorVariable
        zeta_r [-], not negative, in ascending order of frequency; one value stands for all modes.
    """

    ratios: Annotated[Values, vector("-", NOT_NEGATIVE, RATIO)]

    def __repr__(self):
        return f"ModalDamping({self.ratios})"

    def coefficients(self, n: int) -> tuple:
        check_length(self.ratios, "ratios", n, "modes")
        return np.zeros(2), spread(self.ratios, n)
