"""An invertible map that makes a bent posterior nearly Gaussian, fitted in closed form.

Three steps, each with an explicit inverse and Jacobian, after bounded parameters have become `NormalScores`:

1. every coordinate by itself, u = sinh(delta asinh((x - m) / s) - epsilon): skewness and tails (Jones &
   Pewsey, Biometrika 96, 2009), matched to quantiles;
2. whitening: the principal axes of u, the widest first;
3. each axis t_k less a polynomial of the wider ones, over a scale whose logarithm is another one,
   z_k = [t_k - p_k(t_1 .. t_k-1)] exp(-s_k(t_1 .. t_k-1)): bananas, ridges and funnels.

The last step is a triangular transport map (Marzouk, Moselhy, Parno & Spantini, 2016) with the least number
of coefficients that follows those shapes; they come from weighted ridge regressions.
"""

from contextlib import suppress
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import log_expit, log_ndtr, ndtri_exp
from scipy.stats import norm

from pymc_features.smc.proposals.proposal import Mixture, StudentMixture, StudentT, distinct, fit_mixture
from pymc_features.smc.proposals.transport import Transport

LINEAR, SQUARES, PRODUCTS, POWERS = "linear", "squares", "products", "powers"  # kinds
CLIP = 4.0  # standard deviations beyond which polynomials stay as they are
MAX_LOG_SCALE = 6.0
TERMS_PER_POINT = 0.25  # a polynomial has at most this many coefficients for each effective point


def monomials(t, kind: str):
    """Terms (n, terms) of a polynomial of coordinates (n, k), which count within `CLIP`.

    1 and t_i if it is `LINEAR`; besides, t_i^2 with `SQUARES`, all t_i t_j with `PRODUCTS`, and these and
    t_i^3, t_i^4 with `POWERS`: a parabola of parameters is none of the logarithms or logits that are sampled.
    """
    t = np.clip(t, -CLIP, CLIP)
    columns = [np.ones((len(t), 1)), t]
    if kind == SQUARES:
        columns.append(t**2)
    elif kind != LINEAR:
        i, j = np.triu_indices(t.shape[1])
        columns.append(t[:, i] * t[:, j])
    if kind == POWERS:
        columns += [t**3, t**4]
    return np.hstack(columns)


def affordable(k: int, n_points: float, powers: bool = True) -> str:
    """Polynomial of k coordinates with as many terms as so many effective points can tell.

    No `POWERS` unless these are wanted.
    """
    n_products = (k + 1) * (k + 2) // 2
    for kind, n_terms in ((POWERS, n_products + 2 * k), (PRODUCTS, n_products), (SQUARES, 2 * k + 1)):
        if n_terms <= TERMS_PER_POINT * n_points and (powers or kind != POWERS):
            return kind
    return LINEAR


class Axis(NamedTuple):
    """Coefficients of one axis: those of its place (of a kind) and log scale, and a constant."""

    kind: str
    shift: np.ndarray
    slope: np.ndarray
    level: float


class Polynomials:
    """The polynomials of all axes of a map, as two matrices of coefficients.

    Points come as columns, a few hundred at a time, so that their monomials stay in a processor's cache. What
    the first k axes give comes before what the others add.

    Parameters
    ----------
    axes : list of Axis
    """

    def __init__(self, axes):
        kinds = [axis.kind for axis in axes]
        self.products = PRODUCTS in kinds or POWERS in kinds
        self.powers = POWERS in kinds
        d = len(axes)
        size = [(k + 1 if self.products else 1) + 1 + 2 * self.powers for k in range(d)]
        self.ends = 1 + np.cumsum(size)
        self.shift, self.slope = np.zeros((2, d, self.ends[-1]))
        for k, axis in enumerate(axes):
            self.shift[k, self.places(k, axis.kind)] = axis.shift
            self.slope[k, self.places(k, SQUARES)] = axis.slope
        self.levels = np.array([axis.level for axis in axes])

    def places(self, k: int, kind: str) -> list[int]:
        """Rows of the monomials of the first k axes, in the order of `monomials`."""
        firsts = [1, *self.ends]
        linear = [firsts[i] for i in range(k)]
        squares = [firsts[i] + 1 + (i if self.products else 0) for i in range(k)]
        if kind == LINEAR:
            return [0, *linear]
        if kind == SQUARES:
            return [0, *linear, *squares]
        places = [0, *linear, *(firsts[j] + 1 + i for i in range(k) for j in range(i, k))]
        if kind == POWERS:
            places += [row + 1 for row in squares] + [row + 2 for row in squares]
        return places

    def begin(self, n: int) -> np.ndarray:
        """Room for the monomials (rows, n) of n points."""
        rows = np.empty((self.ends[-1], n))
        rows[0] = 1.0
        return rows

    def add(self, rows, t, k: int) -> None:
        """Put in what axis k adds to the axes before it, from clipped coordinates (d, n)."""
        first = 1 if k == 0 else self.ends[k - 1]
        rows[first] = t[k]
        last = first + 1 + (k if self.products else 0)
        np.multiply(t[k if not self.products else 0 : k + 1], t[k], out=rows[first + 1 : last + 1])
        if self.powers:
            np.multiply(rows[last], t[k], out=rows[last + 1])
            np.multiply(rows[last], rows[last], out=rows[last + 2])

    def of_all(self, t):
        """Places and log scales, each (d, n), at points (d, n)."""
        clipped, rows = np.clip(t, -CLIP, CLIP), self.begin(t.shape[1])
        for k in range(len(t)):
            self.add(rows, clipped, k)
        log_scale = np.clip(self.slope @ rows, -MAX_LOG_SCALE, MAX_LOG_SCALE)
        return self.shift @ rows, log_scale + self.levels[:, None]

    def solved(self, z):
        """The points (d, n) that have these coordinates z (d, n)."""
        t, clipped, rows = np.empty_like(z), np.empty_like(z), self.begin(z.shape[1])
        for k, end in enumerate((1, *self.ends[:-1])):
            slope, shift = self.slope[k, :end] @ rows[:end], self.shift[k, :end] @ rows[:end]
            log_scale = np.clip(slope, -MAX_LOG_SCALE, MAX_LOG_SCALE) + self.levels[k]
            t[k] = z[k] * np.exp(log_scale) + shift
            np.clip(t[k], -CLIP, CLIP, out=clipped[k])
            self.add(rows, clipped, k)
        return t


LOG_ROOT = 0.5 * np.log(2.0 * np.pi)


class NormalScores:
    """u = Phi^-1(1 / (1 + exp(-x))) of some coordinates, and u = x of the others.

    The density of a logit falls as exp(-|x|) towards a bound where the likelihood does not: there a normal
    distribution has no draws, however well it fits in the middle. A uniform prior makes u standard normal.

    Parameters
    ----------
    bounded : array of bool (d,)
    """

    def __init__(self, bounded):
        self.bounded = np.flatnonzero(bounded)

    def forward(self, x):
        """u (n, d), and ln |du/dx| (n,)."""
        if not len(self.bounded):
            return x, 0.0
        logits, u = x[:, self.bounded], np.array(x)
        size = np.abs(logits)
        below = log_expit(-size)
        score = -ndtri_exp(below)
        u[:, self.bounded] = np.copysign(score, logits)
        slopes = below + log_expit(size) + 0.5 * score**2 + LOG_ROOT
        return u, slopes.sum(axis=1)

    def inverse(self, u):
        """x (n, d)."""
        if not len(self.bounded):
            return u
        x, scores = np.array(u), u[:, self.bounded]
        x[:, self.bounded] = log_ndtr(scores) - log_ndtr(-scores)
        return x


BATCH = 256  # points whose monomials are taken at a time
LEAST_VARIANCE = 1e-12  # of a principal axis, over the largest
SMALLEST_SQUARE = 1e-6  # beside the mean square, where a logarithm is taken
ENOUGH = 1000  # points to tell which coordinates others follow
CHANCE = 5.0  # nats times points that a fit gains by chance
LEVELS = np.array([0.005, 0.02, 0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95, 0.98, 0.995])
NORMAL_LEVELS = norm.ppf(LEVELS)


class Margins(NamedTuple):
    """Coefficients of step 1, each (d,)."""

    delta: np.ndarray
    epsilon: np.ndarray
    location: np.ndarray
    scale: np.ndarray

    def forward(self, x):
        """u (n, d), and ln |du/dx| (n,)."""
        v = (x - self.location) / self.scale
        u = np.sinh(self.delta * np.arcsinh(v) - self.epsilon)
        slopes = 0.5 * (np.log1p(u**2) - np.log1p(v**2))  # cosh(asinh(u)) over cosh(asinh(v))
        return u, slopes.sum(axis=1) + np.log(self.delta / self.scale).sum()

    def inverse(self, u):
        """x (n, d)."""
        return self.location + self.scale * np.sinh((np.arcsinh(u) + self.epsilon) / self.delta)


class UnbendingMap:
    """Map between points x (n, d) and coordinates z (n, d) that are about standard normal.

    Parameters
    ----------
    x : array (n, d)
        Distinct points.
    weights : array (n,)
        How often each counts; their sum is taken as the number of points that they are worth.
    rotated : bool
        Whether step 2 turns to the principal axes. Without, the parameters stay as they are, without step 1
        as well, and those come first on which scale and place of others depend.
    bounded : array of bool (d,), optional
        Parameters that are sampled as logits; none by default.
    powers : bool
        Whether the polynomials of step 3 may be of the kind `POWERS`.
    """

    def __init__(self, x, weights, rotated=True, bounded=None, powers=True):
        n_points, self.rotated = weights.sum(), rotated
        w = weights / n_points
        self.scores = NormalScores(np.zeros(x.shape[1], dtype=bool) if bounded is None else bounded)
        x, _ = self.scores.forward(x)
        one, zero = np.ones(x.shape[1]), np.zeros(x.shape[1])
        self.margins = fit_margins(x, w, n_points) if rotated else Margins(one, zero, zero, one)
        u, _ = self.margins.forward(x)
        self.mean = w @ u
        centred = u - self.mean
        scatter = (w[:, None] * centred).T @ centred
        if rotated:
            variances, vectors = np.linalg.eigh(scatter + 1e-10 * np.diag(np.diag(scatter)))
            variances = np.maximum(
                variances, LEAST_VARIANCE * variances[-1]
            )  # rounding can make them negative
            self.vectors, self.deviations = vectors[:, ::-1], np.sqrt(variances[::-1])
        else:
            order = np.argsort(-influence(centred / np.sqrt(np.diag(scatter)), w, n_points))
            self.vectors, self.deviations = np.eye(len(order))[:, order], np.sqrt(np.diag(scatter))[order]
        t = centred @ self.vectors / self.deviations
        kinds = [affordable(k, n_points, powers) for k in range(x.shape[1])]
        self.axes = [fit_axis(t[:, :k], t[:, k], w, n_points, kind) for k, kind in enumerate(kinds)]
        self.polynomials = Polynomials(self.axes)

    def forward(self, x):
        """z (n, d), and ln |dz/dx| (n,)."""
        z, log_jacobian = np.empty_like(x), np.empty(len(x))
        for rows in batches(len(x)):
            scores, of_scores = self.scores.forward(x[rows])
            u, slopes = self.margins.forward(scores)
            t = ((u - self.mean) @ self.vectors / self.deviations).T
            shift, log_scale = self.polynomials.of_all(t)
            z[rows] = ((t - shift) * np.exp(-log_scale)).T
            log_jacobian[rows] = of_scores + slopes - log_scale.sum(axis=0)
        return z, log_jacobian - np.log(self.deviations).sum()

    def inverse(self, z):
        """x (n, d); infinite where a point is too far out."""
        x = np.empty_like(z)
        with np.errstate(over="ignore"):
            for rows in batches(len(z)):
                t = self.polynomials.solved(np.ascontiguousarray(z[rows].T)).T
                u = self.mean + (t * self.deviations) @ self.vectors.T
                x[rows] = self.scores.inverse(self.margins.inverse(u))
        return x


def batches(n: int) -> list[slice]:
    """Parts of n points that stay in a processor's cache."""
    return [slice(first, first + BATCH) for first in range(0, n, BATCH)]


def influence(t, w, n_points) -> np.ndarray:
    """How much better others are known with each coordinate (n, d) than it is with them, in nats (d,).

    Fewer nats than chance gives do not count. Some of many points are enough to tell.
    """
    every = max(1, len(t) // ENOUGH)
    t, w, n_points = t[::every], w[::every] / w[::every].sum(), n_points / every
    known = np.array([entropies(t[:, [i]], t, w, n_points) for i in range(t.shape[1])])
    gain = np.maximum(-known - CHANCE / n_points, 0.0)  # (i, j): of j, with i
    np.fill_diagonal(gain, 0.0)
    return gain.sum(axis=1) - gain.sum(axis=0)


def entropies(wider, t, w, n_points) -> np.ndarray:
    """Entropy of each coordinate (n, k) given the wider ones, less that of a standard normal one (k,)."""
    rest, log_scale = conditional(wider, t, w, n_points, PRODUCTS)[2:]
    return 0.5 * np.log(w @ (rest * np.exp(-log_scale)) ** 2) + w @ log_scale


def fit_axis(wider, t, w, n_points, kind) -> Axis:
    """Regress one axis (n,) on the wider ones (n, k); weights w sum up to one."""
    shift, slope, rest, log_scale = conditional(wider, t[:, None], w, n_points, kind)
    level = 0.5 * np.log(w @ (rest * np.exp(-log_scale)) ** 2)
    return Axis(kind, shift[:, 0], slope[:, 0], float(level[0]))


def conditional(wider, t, w, n_points, kind) -> tuple[np.ndarray, ...]:
    """Coefficients of place and log scale of axes (n, m) given wider ones; what is left, and log scales."""
    terms, linear = monomials(wider, kind), monomials(wider, SQUARES)
    shift = ridge(terms, t, w, 0.1 * terms.shape[1] / n_points + 1e-6)
    rest = t - terms @ shift
    size = np.log((rest / np.sqrt(w @ rest**2)) ** 2 + SMALLEST_SQUARE)
    slope = ridge(linear, 0.5 * size, w, 0.5 * linear.shape[1] / n_points + 1e-3)
    return shift, slope, rest, np.clip(linear @ slope, -MAX_LOG_SCALE, MAX_LOG_SCALE)


def ridge(terms, values, w, penalty):
    """Weighted least squares with a penalty relative to each column's size."""
    weighted = w[:, None] * terms
    gram = weighted.T @ terms
    sizes = np.sqrt(np.diag(gram))[:, None] + 1e-12
    scaled = gram / (sizes * sizes.T) + penalty * np.eye(len(gram))
    return np.linalg.solve(scaled, weighted.T @ values / sizes) / sizes


def fit_margins(x, w, n_points) -> Margins:
    """Match quantiles of each coordinate to a normal one's, drawn towards no change where points are few."""
    columns = [fit_margin(column, w, 30.0 / n_points) for column in x.T]
    return Margins(*np.array(columns).T)


def fit_margin(x, w, penalty):
    """delta, epsilon, location and scale of one coordinate (n,)."""
    order = np.argsort(x)
    quantiles = np.interp(LEVELS, np.cumsum(w[order]) - 0.5 * w[order], x[order])
    middle = quantiles[5]
    spread = max((quantiles[7] - quantiles[3]) / (NORMAL_LEVELS[7] - NORMAL_LEVELS[3]), 1e-300)
    wanted = 1.0 / np.sqrt(1.0 + NORMAL_LEVELS**2)  # the outermost quantiles are the least certain
    scaled = (quantiles - middle) / spread

    def misfit(p):
        a = np.exp(p[0]) * np.arcsinh((scaled - p[2]) * np.exp(-p[3])) - p[1]
        return np.concatenate(
            [(np.sinh(np.clip(a, -8, 8)) - NORMAL_LEVELS) * wanted, np.sqrt(penalty) * p[:2]]
        )

    limits = np.array([1.2, 2.0, 2.0, 2.0])
    p = least_squares(misfit, np.zeros(4), max_nfev=60, bounds=(-limits, limits)).x
    return np.exp(p[0]), p[1], middle + spread * p[2], spread * np.exp(p[3])


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


def fit_to(points, rng: np.random.Generator, bounded=None, twice: bool = False) -> FittedProposal:
    """Fit to equally weighted points (n, d), which may hold the same one many times.

    Of those parameters that are `bounded`, flags (d,), the logits are given; none by default.
    Of a plain mixture and two behind unbending maps, along the principal axes and along the parameters, that
    with the highest density at points that it was not fitted to. A safeguard of the plain mixture, wider and
    with heavy tails, has a fifth of the draws.

    `twice`, a second map without cubes and fourth powers stands beside one that has them: where one of them
    has too few draws the other seldom has. Ten springs under EXP with wide priors need a seventh fewer
    evaluations.
    """
    x, counts = distinct(points)
    weights = counts.astype(float)
    order = rng.permutation(len(x))
    plain = fit_mixture(x, weights, rng)
    bent = [partial(fit_unbent, bounded=bounded, rotated=rotated) for rotated in (True, False)]
    kinds = [fit_mixture, *bent]
    scores, _ = held_out_scores(kinds, x, weights, order, rng)
    best = kinds[int(scores.argmax())]
    safeguard = heavy_tailed(plain, WIDER)
    if best is fit_mixture:
        return FittedProposal([plain, safeguard], np.array([1.0 - SAFEGUARD, SAFEGUARD]))
    first = best(x, weights, rng)
    found = [first]
    if twice and any(axis.kind == POWERS for axis in first.map.axes[1:]):  # the first follows none
        with suppress(np.linalg.LinAlgError, ValueError):
            found.append(fit_unbent(x, weights, rng, first.map.rotated, bounded, powers=False))
    wider = [unbent._replace(mixture=heavy_tailed(unbent.mixture, WIDER)) for unbent in found]
    shares = SHARES_OF_TWO if len(found) > 1 else (1.0 - SAFEGUARD, SAFEGUARD)
    return FittedProposal([*wider, safeguard], np.array(shares))
