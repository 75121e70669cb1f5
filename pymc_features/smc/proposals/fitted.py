"""Proposals fitted to weighted points: a Student-t mixture, behind an unbending map where that is better."""

from functools import partial
from typing import NamedTuple

import numpy as np

from pymc_features.smc.proposals.polynomials import POWERS
from pymc_features.smc.proposals.proposal import Mixture, StudentMixture, StudentT, distinct, fit_mixture
from pymc_features.smc.proposals.transport import Transport
from pymc_features.smc.proposals.unbending import UnbendingMap

HEAVIEST = 6.0  # degrees of freedom at most, so that a proposal's tails do not end before the target's
WIDER = 1.1  # what is drawn from, over a mixture fitted behind a map, and the safeguard
SAFEGUARD = 0.2  # its share
SHARES_OF_TWO = 0.45, 0.4, 0.15  # of two maps, and of the safeguard beside them
HELD_OUT = 0.25  # share of the points that decide between the kinds
SMALLEST = -300.0  # log-density that a held-out point has at least in that decision


class Unbent(NamedTuple):
    """A Student-t distribution, or a mixture of them, of the coordinates of a map.

    Attributes
    ----------
    map : UnbendingMap or Transport
    mixture : StudentT or StudentMixture
    """

    map: UnbendingMap | Transport
    mixture: StudentT | StudentMixture

    def log_density(self, x):
        """Log-density (n,) at points (n, d)."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            z, log_jacobian = self.map.forward(x)
            density = self.mixture.log_density(z) + log_jacobian
        return np.where(np.isfinite(density), density, -np.inf)

    def gradient(self, x):
        """Gradient of the log-density (n, d) at points (n, d), behind a `Transport`."""
        z, _ = self.map.forward(x)
        return self.map.push(self.mixture.gradient(z), z)

    def draw(self, n: int, rng):
        """Independent draws (n, d) from a mixture behind the map."""
        return self.map.inverse(self.mixture.draw(n, rng))

    def move(self, x, scale: float, rng):
        """Move as `Mixture.move` does, in the unbent coordinates.

        Points without a finite image stay; independent draws are infinite there, and hence impossible.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            moved = self.map.inverse(self.mixture.move(self.map.forward(x)[0], scale, rng))
        stay = ~np.isfinite(moved).all(axis=1) & (scale < 1.0)
        return np.where(stay[:, None], x, moved)


def fit_unbent(x, weights, rng, rotated=True, bounded=None, powers=True) -> Unbent:
    """Fit a map as of `UnbendingMap`, and a mixture behind it, to points as of `fit_mixture`."""
    unbending = UnbendingMap(x, weights, rotated, bounded, powers)
    return Unbent(unbending, fit_mixture(unbending.forward(x)[0], weights, rng))


class FittedProposal(Mixture):
    """A `StudentMixture`, or one `Unbent`, first; and a safeguard, last."""

    @property
    def map(self) -> UnbendingMap | None:
        """The unbending map, if one is used."""
        return getattr(self.components[0], "map", None)


def heavy_tailed(mixture: StudentMixture, wider: float = 1.0) -> StudentMixture:
    """Make the mixture wider by a factor, with at most `HEAVIEST` degrees of freedom."""
    components = [
        StudentT(c.location, wider * c.factor, min(c.degrees, HEAVIEST)) for c in mixture.components
    ]
    return StudentMixture(components, mixture.weights)


def held_out_scores(kinds, x, weights, order, rng) -> tuple[np.ndarray, float]:
    """Log-density (kind,) of each kind of fit at the first points of `order`, to which it was not fitted.

    Summed by the weights of these points, which are the second result.
    """
    held, rest = np.split(order, [int(HELD_OUT * len(x))])

    def score(kind):
        try:
            density = kind(x[rest], weights[rest], rng).log_density(x[held])
        except (np.linalg.LinAlgError, ValueError):
            return -np.inf
        return weights[held] @ np.maximum(density, SMALLEST)

    return np.array([score(kind) for kind in kinds]), weights[held].sum()


def fit_proposal(x, weights, rng: np.random.Generator, bounded=None) -> FittedProposal:
    """Fit to distinct points (n, d) with weights (n,): how often each counts.

    Of those parameters that are `bounded`, flags (d,), the logits are given; none by default.
    Of a plain mixture and two behind unbending maps, along the principal axes and along the parameters, that
    with the highest density at points that it was not fitted to. A safeguard of the plain mixture, wider and
    with heavy tails, has a fifth of the draws.
    """
    weights = np.asarray(weights, dtype=float)
    order = rng.permutation(len(x))
    plain = fit_mixture(x, weights, rng)
    bent = [partial(fit_unbent, bounded=bounded, rotated=rotated) for rotated in (True, False)]
    kinds = [fit_mixture, *bent]
    scores, _ = held_out_scores(kinds, x, weights, order, rng)
    best = kinds[int(scores.argmax())]
    first = plain if best is fit_mixture else best(x, weights, rng)
    if first is not plain:
        first = first._replace(mixture=heavy_tailed(first.mixture, WIDER))
    return FittedProposal([first, heavy_tailed(plain, WIDER)], np.array([1.0 - SAFEGUARD, SAFEGUARD]))


def fit_to(points, rng: np.random.Generator, bounded=None) -> FittedProposal:
    """Fit to equally weighted points (n, d), which may hold the same one many times."""
    return fit_proposal(*distinct(points), rng, bounded)


def fit_twice_to(points, rng: np.random.Generator, bounded=None) -> FittedProposal:
    """Fit as `fit_to`, and where the map has cubes and fourth powers a second one beside it that has none.

    Where one of them has too few draws the other seldom has. Ten springs under EXP with wide priors need a
    seventh fewer evaluations.
    """
    x, weights = distinct(points)
    fit = fit_proposal(x, weights, rng, bounded)
    if fit.map is None or all(axis.kind != POWERS for axis in fit.map.axes[1:]):  # the first follows none
        return fit
    first, safeguard = fit.components
    try:
        other = fit_unbent(x, weights, rng, fit.map.rotated, bounded, powers=False)
    except (np.linalg.LinAlgError, ValueError):
        return fit
    other = other._replace(mixture=heavy_tailed(other.mixture, WIDER))
    return FittedProposal([first, other, safeguard], np.array(SHARES_OF_TWO))
