"""A normalised first guess of a posterior: bell curves at its modes, bent where that pays, and the prior."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from pymc_features.smc.proposals.proposal import Mixture, StudentT, log_sum
from pymc_features.smc.proposals.transport import Stretch, Transport, fit_transport
from pymc_features.smc.proposals.unbending import Unbent

MEMORY = 10  # steps that the inverse Hessian is built from
MAX_ITERATIONS = 200
MAX_HALVINGS = 12
LONGEST = 2.0  # of the first step and, times the number of iterations, of others
SMALL_GAIN = 0.03  # in the log-density, over three iterations: a quarter of a standard deviation away
ARMIJO = 1e-4


def climb(
    density: Callable,
    starts: np.ndarray,
    arrived: Callable,
    small_gain: float = SMALL_GAIN,
    iterations: int = MAX_ITERATIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """Climb from all starts together: L-BFGS with backtracking.

    Nocedal & Wright, Numerical Optimization, 2006, section 7.2.

    Parameters
    ----------
    density : callable
        Log-density (n,) and its gradient (n, d) at points (n, d), of coordinates of about unit scale.
    starts : array (n, d)
    arrived : callable
        Whether points (n, d) are where no climb need go on, array (n,).
    small_gain : float
        In the log-density, over three iterations, at which a climb ends.
    iterations : int
        At most.

    Returns
    -------
    x, value : array (n, d) and (n,)
        Where each climb ended; one that starts where the density is zero stays.
    """
    x = starts.copy()
    value, slope = density(x)
    n, d = x.shape
    steps, changes, n_kept = np.zeros((n, MEMORY, d)), np.zeros((n, MEMORY, d)), np.zeros(n, dtype=int)
    going = value > -np.inf
    last = np.full((3, n), -np.inf)
    for iteration in range(iterations):
        rows = np.flatnonzero(going)
        if not len(rows):
            break
        direction = ascent_direction(slope[rows], steps[rows], changes[rows], n_kept[rows])
        longest = LONGEST * (1.0 + iteration)
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        direction *= np.minimum(1.0, longest / np.maximum(length, 1e-300))
        y, new_value, new_slope = line_search(density, x[rows], value[rows], slope[rows], direction)
        s, c = y - x[rows], slope[rows] - new_slope
        useful = (s * c).sum(axis=1) > 1e-10 * np.linalg.norm(s, axis=1) * np.linalg.norm(c, axis=1)
        for history, new in ((steps, s), (changes, c)):  # the newest pair last
            history[rows[useful], :-1] = history[rows[useful], 1:]
            history[rows[useful], -1] = new[useful]
        # from a straight or hollow stretch, begin anew with the gradient
        n_kept[rows] = np.where(useful, np.minimum(n_kept[rows] + 1, MEMORY), 0)
        x[rows], value[rows], slope[rows] = y, new_value, new_slope
        going[rows] = (new_value - last[0, rows] > small_gain) & ~arrived(y)
        last[:, rows] = np.vstack([last[1:, rows], new_value[None]])
    return x, value


def ascent_direction(slope, steps, changes, n_kept):
    """Two-loop recursion for each row: inverse Hessian times gradient (n, d)."""
    q = slope.copy()
    n, memory, _ = steps.shape
    products = (steps * changes).sum(axis=2)
    used = np.arange(memory)[None] >= memory - n_kept[:, None]
    inverse = np.where(used, 1.0 / np.where(used, products, 1.0), 0.0)
    alphas = np.zeros((n, memory))
    for i in reversed(range(memory)):
        alphas[:, i] = inverse[:, i] * (steps[:, i] * q).sum(axis=1)
        q -= alphas[:, i, None] * changes[:, i]
    newest = changes[:, -1]
    scale = np.where(n_kept > 0, products[:, -1] / np.maximum((newest**2).sum(axis=1), 1e-300), 0.0)
    first = 1.0 / np.maximum(np.linalg.norm(slope, axis=1), 1.0)
    q *= np.where(n_kept > 0, scale, first)[:, None]
    for i in range(memory):
        beta = inverse[:, i] * (changes[:, i] * q).sum(axis=1)
        q += (alphas[:, i] - beta)[:, None] * steps[:, i]
    return q


def line_search(density, x, value, slope, direction):
    """Halve each step until it gains enough; rows that find nothing stay."""
    gain = ARMIJO * (slope * direction).sum(axis=1)
    length = np.ones(len(x))
    best, best_value, best_slope = x.copy(), value.copy(), slope.copy()
    open_rows = np.arange(len(x))
    for _ in range(MAX_HALVINGS):
        y = x[open_rows] + length[open_rows, None] * direction[open_rows]
        new_value, new_slope = density(y)
        good = new_value >= value[open_rows] + length[open_rows] * gain[open_rows]
        found = open_rows[good]
        best[found], best_value[found], best_slope[found] = y[good], new_value[good], new_slope[good]
        open_rows = open_rows[~good]
        if not len(open_rows):
            break
        length[open_rows] *= 0.25
    return best, best_value, best_slope


def curvature(density: Callable, x: np.ndarray) -> np.ndarray:
    """Minus the Hessian (d, d) at a point (d,), by central differences of the gradient.

    The steps suit the density: a tenth of each conditional standard deviation, found with small ones.
    """
    steps = np.full(len(x), 1e-4)
    for _ in range(2):
        ends = np.concatenate([x + np.diag(steps), x - np.diag(steps)])
        slopes = density(ends)[1].reshape(2, len(x), len(x))
        hessian = (slopes[1] - slopes[0]) / (2.0 * steps[:, None])
        diagonal = np.diag(hessian)
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.where(diagonal > 0.0, np.clip(0.1 / np.sqrt(diagonal), 1e-7, 0.1), 1e-3)
    return 0.5 * (hessian + hessian.T)


WAVE, CANDIDATES = 8, 10  # climbs at a time, each from the best of so many draws from the prior
CLIMBS_PER_MODE, MORE_CLIMBS, MOST_WAVES = 8, 1.5, 10  # for each mode found; if climbs are cheap, more
WIDEST = 3.0  # prior standard deviations of a mode at most, along each principal axis
NEGLIGIBLE = 12.0  # a mode is left out whose evidence is smaller by this, in logarithms
SAME_MODE = 1.0  # squared distance, in standard deviations of a mode, within which another is the same
LEVEL = 0.1  # standard deviations left to a maximum, by slope and curvature, within which a climb is there
FURTHER, FINER = 50, 1e-3  # iterations of climbs that go on from a slope, and the gain at which they end
PRIOR_SHARE = 0.05
# widths (standard deviations), degrees of freedom and shares of what stands at each mode
WIDTHS, DEGREES, SHARES = (1.05, 1.3, 2.0), (60.0, 8.0, 3.0), (0.7, 0.2, 0.1)
# parameters from which modes are bent: with fewer, tempered points are cheap, and see what no mode shows
MANY = 16
GOOD_FEW, GOOD_MANY = 0.3, 0.08  # see `good_share`
MINOR = 0.02  # share of the modes' evidence below which a mode is not bent


def good_share(n_parameters: int) -> float:
    """Effective share of a reference's draws, or a fit's, above which another fit does not pay."""
    return GOOD_FEW if n_parameters < MANY else GOOD_MANY


class Density:
    """Log posterior density of a model on the unconstrained scale, whose evaluations are counted.

    Parameters
    ----------
    logp : PopulationLogp
    draw_prior : callable
        Draws (n, d) from the prior for a number n.
    journal : Journal, optional
        Remembers each evaluation.
    """

    def __init__(self, logp, draw_prior: Callable, journal=None):
        self.logp, self.draw_prior, self.journal = logp, draw_prior, journal
        self.has_gradient, self.n_values, self.n_gradients = logp.has_gradient, 0, 0

    def values(self, x):
        """Log-density (n,) at points (n, d)."""
        self.n_values += len(x)
        prior, likelihood, _ = self.journal.evaluate(self.logp, x) if self.journal else self.logp(x)
        return prior + likelihood

    def gradients(self, x):
        """Log-density (n,) at points (n, d), and its gradient (n, d)."""
        self.n_gradients += len(x)
        function = self.logp.gradient
        parts = self.journal.evaluate(function, x, 2) if self.journal else function(x)
        prior, likelihood, _, *slopes = parts
        return prior + likelihood, np.add(*slopes)


def in_units(gradients: Callable, centre, scale) -> Callable:
    """Log-density (n,) and its gradient (n, d) by coordinates (x - centre) / scale."""

    def scaled(u):
        value, slope = gradients(centre + scale * u)
        return value, slope * scale

    return scaled


class Mode(NamedTuple):
    """End of climbs, in prior standard deviations from the prior's mean.

    Attributes
    ----------
    x : array (d,)
    factor : array (d, d)
        Lower Cholesky factor of the covariance of Laplace's approximation.
    log_evidence : float
        Of Laplace's approximation, in these units; see `Reference.log_evidences`.
    n_climbs : int
        Climbs that ended here.
    is_maximum : bool
        Whether the density has a maximum here. If not, the climbs have stopped on a slope: along a ridge,
        or in the neck of a funnel, where the density may grow without bound and have no maximum.
    """

    x: np.ndarray
    factor: np.ndarray
    log_evidence: float
    n_climbs: int
    is_maximum: bool = True


class Reference:
    """Mixture of what stands at the modes, with a share of the prior lest a mode be lost.

    Parameters
    ----------
    modes : list of Mode
    centre, scale : array (d,)
        Mean and standard deviation of the prior.
    maps : list of Transport or None, optional
        For each mode a map to the points around it that follows the posterior's bends, or none.
    fit : Mixture, optional
        What was fitted to the draws of a run before, beside the modes.
    shares : array (k,) or (k + 1,), optional
        Of the modes and the fit, of sum one; by default Laplace's approximation gives those of the modes.

    Notes
    -----
    Laplace's approximation with a little more width, mixed with Student-t distributions of the same shape and
    more; all but the widest behind the map, if there is one. The densities of all parts integrate to one, so
    that the evidence relative to the mixture is that of the model.
    """

    def __init__(self, modes, centre, scale, maps=None, fit=None, shares=None):
        self.modes, self.centre, self.scale, self.fit = modes, centre, scale, fit
        self.maps = [None] * len(modes) if maps is None else maps
        components = [part for pair in zip(modes, self.maps, strict=True) for part in self.parts_of(*pair)]
        shares = 0.9 * self.mode_shares() + 0.1 / len(modes) if shares is None else shares
        weights = np.append(np.outer(shares[: len(modes)], SHARES).ravel(), shares[len(modes) :])
        self.mixture = Mixture(components if fit is None else [*components, fit], weights)

    def parts_of(self, mode, bent) -> list:
        """What stands at a mode, in the order of `SHARES`."""
        location, factor = self.centre + self.scale * mode.x, self.scale[:, None] * mode.factor
        kinds = list(zip(WIDTHS, DEGREES, strict=True))
        plain = [StudentT(location, width * factor, degrees) for width, degrees in kinds]
        if bent is None:
            return plain
        d = len(location)
        return [
            *(Unbent(bent, StudentT(np.zeros(d), w * np.eye(d), degrees)) for w, degrees in kinds[:-1]),
            plain[-1],
        ]

    def mode_shares(self) -> np.ndarray:
        """Share (k,) of each mode in the evidence of all, by Laplace's approximation."""
        return softmax([mode.log_evidence for mode in self.modes])

    def bent(self, density: Density, rng: np.random.Generator) -> "Reference":
        """Add maps that follow the posterior's bends, where its modes are no Gaussians.

        With fewer than `MANY` parameters it stays as it is.
        """
        if len(self.centre) < MANY:
            return self
        maps = []
        for mode, share in zip(self.modes, self.mode_shares(), strict=True):
            variances, vectors = np.linalg.eigh(mode.factor @ mode.factor.T)
            axes = (vectors * np.sqrt(np.maximum(variances, 1e-16 * variances[-1])))[:, ::-1]
            start = Transport((Stretch(self.centre + self.scale * mode.x, self.scale[:, None] * axes),))
            end = start
            if share > MINOR:
                end = fit_transport(density.values, density.gradients, start, rng)
            maps.append(None if end is start else end)
        return Reference(self.modes, self.centre, self.scale, maps)

    def log_density(self, x, log_prior) -> np.ndarray:
        """Log-density (n,) at points (n, d) with these log prior densities."""
        return log_sum(self.terms(x, log_prior))

    def terms(self, x, log_prior) -> np.ndarray:
        """Log of share times density of what stands at the modes, and of the prior (2, n)."""
        of_modes = np.log1p(-PRIOR_SHARE) + self.mixture.log_density(x)
        return np.array([of_modes, np.log(PRIOR_SHARE) + log_prior])

    def gradient(self, x, log_prior, grad_prior) -> np.ndarray:
        """Gradient of the log-density (n, d) at points (n, d) with this log prior (n,) and its gradient."""
        terms = self.terms(x, log_prior)
        of_modes, of_prior = np.exp(terms - log_sum(terms))[:, :, None]
        return of_modes * self.mixture.gradient(x) + of_prior * grad_prior

    def draw(self, n: int, draw_prior: Callable, rng: np.random.Generator) -> np.ndarray:
        """Independent draws (n, d); `draw_prior` gives some of the prior for a number."""
        n_prior = rng.binomial(n, PRIOR_SHARE)
        x = self.mixture.draw(n - n_prior, rng)
        x = np.concatenate([x, draw_prior(n_prior)]) if n_prior else x
        return x[rng.permutation(n)]

    @property
    def log_evidences(self) -> np.ndarray:
        """Laplace's approximations (k,) of the evidence at the ends of climbs, in any coordinates."""
        return np.array([mode.log_evidence for mode in self.modes]) + np.log(self.scale).sum()

    @property
    def peaks(self) -> np.ndarray:
        """Return the ends of climbs (k, d) on the sampled scale."""
        return np.array([self.centre + self.scale * mode.x for mode in self.modes])


def find_reference(density: Density, effort: int) -> Reference | None:
    """Climb from draws of the prior to the modes of the posterior; None if there is no proper one.

    Parameters
    ----------
    density : Density
        That has not been evaluated yet.
    effort : int
        Gradients to spend on the search for more modes than the first climbs find.
    """
    candidates = density.draw_prior(WAVE * CANDIDATES)
    centre, scale = candidates.mean(axis=0), candidates.std(axis=0)
    if not (np.isfinite(centre).all() and np.isfinite(scale).all() and (scale > 0).all()):
        return None
    scaled, modes = in_units(density.gradients, centre, scale), []
    for wave in range(1, MOST_WAVES + 1):
        values = density.values(candidates).reshape(WAVE, CANDIDATES)
        best = values.argmax(axis=1) + CANDIDATES * np.arange(WAVE)
        starts = (candidates[best] - centre)[values.max(axis=1) > -np.inf] / scale
        modes = with_ends(modes, scaled, *climb(scaled, starts, partial(are_known, modes)))
        # ends on slopes are no reason to go on for long: there may be any number of them
        n_maxima = sum(mode.is_maximum for mode in modes)
        enough = max(n_maxima, 1) if density.n_gradients > effort else MORE_CLIMBS * (len(modes) + 1)
        if WAVE * wave >= CLIMBS_PER_MODE * enough:
            break
        candidates = density.draw_prior(WAVE * CANDIDATES)
    modes = with_maxima(modes, scaled)
    top = max((mode.log_evidence for mode in modes), default=0.0)
    modes = [mode for mode in modes if mode.log_evidence > top - NEGLIGIBLE]
    return Reference(modes, centre, scale) if modes else None


def are_known(modes: list[Mode], x) -> np.ndarray:
    """Whether points (n, d) belong to a mode that has been found (n,)."""
    return nearest(modes, x) >= 0


def nearest(modes: list[Mode], x) -> np.ndarray:
    """Number of the mode that each point (n, d) belongs to (n,); -1 where it is away from all."""
    found = np.full(len(x), -1)
    for i, mode in enumerate(modes):
        distance = (np.linalg.solve(mode.factor, (x - mode.x).T) ** 2).sum(axis=0)
        found[(found < 0) & (distance < SAME_MODE * x.shape[1])] = i
    return found


def with_ends(modes: list[Mode], density: Callable, x, values) -> list[Mode]:
    """The modes known and those at the ends of more climbs (n, d), the highest end first."""
    modes = list(modes)
    top = max((mode.log_evidence for mode in modes), default=-np.inf)
    for i in np.argsort(-values):
        known = int(nearest(modes, x[i][None])[0])
        if known >= 0:
            modes[known] = modes[known]._replace(n_climbs=modes[known].n_climbs + 1)
        elif values[i] > -np.inf and (mode := laplace_mode(density, x[i])) is not None:
            if mode.log_evidence < top - NEGLIGIBLE:
                break  # those below are further away still
            modes.append(mode)
            top = max(top, mode.log_evidence)
    return modes


def with_maxima(modes: list[Mode], density: Callable) -> list[Mode]:
    """Add the maxima that climbs which stopped on a slope lead to, with the climbs counted there."""
    maxima = [mode for mode in modes if mode.is_maximum]
    on_slopes = [mode for mode in modes if not mode.is_maximum]
    if not on_slopes:
        return modes
    starts = np.array([mode.x for mode in on_slopes])
    x, values = climb(density, starts, partial(are_known, maxima), FINER, FURTHER)
    apart = []
    for i in np.argsort(-values):
        end, known = on_slopes[i], int(nearest(maxima, x[i][None])[0])
        if known >= 0:
            maxima[known] = maxima[known]._replace(n_climbs=maxima[known].n_climbs + end.n_climbs)
        elif (mode := laplace_mode(density, x[i])) is not None and mode.is_maximum:
            maxima.append(mode._replace(n_climbs=end.n_climbs))
            if nearest([end], mode.x[None])[0] == 0:
                continue  # the maximum takes its place
        apart.append(end)
    return maxima + apart


def laplace_mode(density: Callable, x) -> Mode | None:
    """Laplace's approximation at the end of a climb (d,), after a step of Newton's method.

    No wider than `WIDEST` along any principal axis; None if it is not finite.
    """
    hessian = curvature(density, x)
    if not np.isfinite(hessian).all():
        return None
    eigenvalues, vectors = np.linalg.eigh(hessian)
    variances = 1.0 / np.maximum(eigenvalues, 1.0 / WIDEST**2)
    # the Cholesky factor, by QR: that of the covariance itself fails where widths are 1e8 apart
    factor = np.linalg.qr((vectors * np.sqrt(variances)).T, mode="r").T
    factor *= np.where(np.diag(factor) < 0.0, -1.0, 1.0)
    before, slope = density(x[None])
    step = factor @ (factor.T @ slope[0])
    after, slope_after = density((x + step)[None])
    better = after[0] >= before[0]
    value, slope = (after[0], slope_after[0]) if better else (before[0], slope[0])
    is_maximum = bool(np.linalg.norm(factor.T @ slope) < LEVEL and is_definite(hessian))
    log_evidence = value + 0.5 * (len(x) * np.log(2.0 * np.pi) + np.log(variances).sum())
    return Mode(x + step if better else x, factor, float(log_evidence), 1, is_maximum)


def is_definite(hessian) -> bool:
    """Whether a matrix (d, d) is positive definite by more than rounding, whatever the units of its axes."""
    diagonal = np.diag(hessian)
    if not (diagonal > 0.0).all():
        return False
    least = np.linalg.eigvalsh(hessian / np.sqrt(np.outer(diagonal, diagonal)))[0]
    return bool(least > 10.0 * len(diagonal) * np.finfo(float).eps)
