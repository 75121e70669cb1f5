"""Modes, mass and stiffness that the priors expect: every draw, without anything compiled."""

import contextlib
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

DRAWS, DRAWS_OF_LARGE = 200, 24
LARGE = 300  # degrees of freedom
GRAVITY = 9.81  # [m/s^2]


class PriorModes(NamedTuple):
    """What draws of the priors have in common, d draws and m modes."""

    values: dict[str, np.ndarray]  # names of the parameters to their draws (d,)
    frequencies: np.ndarray  # (d, m) natural frequencies [Hz] and damping ratios [-]
    ratios: np.ndarray  # (d, m)
    # (d, n, m) displacement of each degree of freedom under a unit displacement of the base, mode by mode [-]
    shares: np.ndarray
    mass: float  # that the base moves, at the medians [kg]
    deflection: float  # largest displacement under an acceleration of 1 g across the base, at the medians [m]
    is_linear: bool  # whether springs keep their stiffness
    quantity: str = "relative_displacement"  # that the shares are of

    @property
    def first(self) -> float:
        """Median of the first natural frequency [Hz]."""
        return float(np.median(self.frequencies[:, 0]))

    def few(self, n: int) -> "PriorModes":
        """At most n of the draws, evenly spaced."""
        size = len(self.frequencies)
        some = np.linspace(0, size - 1, min(n, size)).astype(int)
        rows = {name: getattr(self, name)[some] for name in ("frequencies", "ratios", "shares")}
        return self._replace(values={name: draws[some] for name, draws in self.values.items()}, **rows)

    def range_of(self, mode: int) -> tuple[float, float]:
        """5 and 95 % of a natural frequency [Hz], mode 0 the first."""
        low, high = np.quantile(self.frequencies[:, mode], [0.05, 0.95])
        return float(low), float(high)

    def at_sensors(self, dofs, quantity) -> "PriorModes":
        """Modes with their shares (d, s, m) in a quantity at some degrees of freedom."""
        below = np.pad(self.shares, ((0, 0), (1, 0), (0, 0)))[:, :-1] * (quantity == "inter_storey_drift")
        return self._replace(shares=(self.shares - below)[:, dofs], quantity=quantity)

    def exponents(self, of: np.ndarray | None = None) -> dict[str, float]:
        """d ln f_1 / d ln(parameter) over the draws of positive parameters, or of other numbers (d,)."""
        of = self.frequencies[:, 0] if of is None else np.maximum(of, 1e-12)
        names = [name for name, draws in self.values.items() if (draws > 0.0).all() and np.ptp(draws) > 0.0]
        columns = [np.log(self.values[name]) for name in names]
        terms = np.column_stack([np.ones(len(self.frequencies)), *columns])
        found = np.linalg.lstsq(terms, np.log(of), rcond=None)[0]
        return dict(zip(names, found[1:].tolist(), strict=True))


def prior_modes(
    structure: Callable, draws: Mapping[str, Callable], at_medians, modes_of: Callable
) -> PriorModes:
    """Modes of structures whose parameters are drawn, by functions of n and seed, but of impossible ones."""
    n = DRAWS if at_medians.n_dof <= LARGE else DRAWS_OF_LARGE
    columns = {name: draw(n, k) for k, (name, draw) in enumerate(draws.items())}
    with np.errstate(all="ignore"):  # the inverse of a tiny mass is no number
        of_medians = modes_of(at_medians)
        modes = {k: one for k, one in possible_modes(structure, columns, modes_of) if is_structure(one)}
    for is_there, where in ((is_structure(of_medians), "the medians"), (modes, "draws")):
        if not is_there:
            raise ValueError(
                f"masses and stiffnesses must have a natural frequency at {where} of the priors, got none. "
                "Check their units."
            )
    kept, found = list(modes), list(modes.values())
    n_modes = min(one.natural_frequencies.size for one in found)
    shares = shares_of(of_medians)
    with np.errstate(divide="ignore"):
        deflection = np.abs((shares / of_medians.angular_frequencies**2).sum(axis=-1)).max() * GRAVITY
    return PriorModes(
        {name: column[kept] for name, column in columns.items()},
        np.array([one.natural_frequencies[:n_modes] for one in found]),
        np.array([one.damping_ratios[:n_modes] for one in found]),
        np.array([shares_of(one)[:, :n_modes] for one in found]),
        moved_mass(at_medians),
        float(deflection),
        at_medians.is_linear,
    )


def possible_modes(structure: Callable, columns, modes_of: Callable):
    """Number and modes of each draw, values by name, but of those at which there is no structure."""
    for k in range(len(next(iter(columns.values()), [0]))):
        with contextlib.suppress(ValueError, ArithmeticError, np.linalg.LinAlgError):
            yield k, modes_of(structure(**{name: float(column[k]) for name, column in columns.items()}))


def is_structure(modes) -> bool:
    """Whether there are modes, and all of them have a frequency."""
    return bool(modes.natural_frequencies.size and np.isfinite(modes.natural_frequencies).all())


def shares_of(modes) -> np.ndarray:
    """Shape times participation factor (n, m), summed over supports that move together."""
    factors = modes.participation_factors
    return modes.mode_shapes * (factors if factors.ndim == 1 else factors.sum(axis=1))


def moved_mass(structure) -> float:
    """Mass that the base moves [kg]."""
    influence = getattr(structure, "influence", None)
    return float(np.sum(structure.mass if influence is None else influence * (structure.mass @ influence)))
