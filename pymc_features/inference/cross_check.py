r"""Search for parts of a posterior that a run of `sample` has missed.

No sampler knows what it has not met, and independent runs that share a search agree on the same mistake. This
search shares nothing with the run but the model:

1. A mixture q_0 of Student-t distributions, fitted to the run's draws and widened, is drawn from. A narrow
   part inside a wide one, or next to it, shows as draws of great weight.
2. L-BFGS climbs start at the heaviest of these draws, and at plain draws of the prior, of which those end
   early that come to where the posterior is known. A climb that ends elsewhere has found a mode; a Student-t
   distribution q_k with the curvature there is drawn from as well.
3. All draws together are weighed by the deterministic mixture (Owen & Zhou, JASA 95, 2000),

       w_i = p(theta_i) L(theta_i) / sum_k (n_k / n) q_k(theta_i),       Z = (1/n) sum_i w_i .

The run has missed something if ln Z exceeds its log evidence by more than 0.1 and four standard errors of the
difference. Its tails are too light if a parameter's weight beyond the run's 5 or 95 % quantile is more than
0.05 by 0.03 and 4.5 standard errors; which is asked only where the weights can tell (Pareto's k below 0.7 and
more than a hundred effective draws).

What less than one in 10,000 draws of q_0 and one in a thousand climbs from the prior lead to is not found. So
a part that very few of all climbs have led to, those of the run and these, is a reason to expect others, and
a warning, whether the run has found it or the search.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pymc_features.smc.kernels.chains import GRADIENT_COST
from pymc_features.smc.proposals.pool import LARGEST_K, log_mean, pareto_k, pareto_smoothed
from pymc_features.smc.proposals.proposal import Mixture, StudentT, distinct, fit_mixture, log_sum
from pymc_features.smc.proposals.reference import (
    WIDEST,
    Density,
    Mode,
    Reference,
    climb,
    in_units,
    laplace_mode,
    nearest,
)
from pymc_features.smc.proposals.unbending import heavy_tailed

WIDTHS, WIDE_SHARES = (1.05, 1.6), (0.85, 0.15)  # of the fit to the run's draws, over it, and their shares
HEAVIEST = 16  # draws of the fit from which climbs start, at most, and no more than from the prior
OF_A_MODE, DEGREES = 300, 5.0  # draws of what stands at a new mode, and its degrees of freedom
MOST_MODES = 12
LEAST_EVIDENCE = 7.0  # a mode is left out whose Laplace evidence is below the run's by this, in nats
KNOWN = 0.01  # quantile of the fit's density over the run's draws, above which a point is known
MUCH_DENSER = 3.0  # density of what stands at a new mode over the fit's, in nats, where a draw is new
LEAST_RISE, STANDARD_ERRORS = 0.1, 4.0  # of the log evidence, above which something was missed
# share of climbs that leaves doubt whether there are more parts, if no draw has led to one with that weight
FEW_CLIMBS, MUCH = 0.02, 0.01
HEAVY = 0.1  # share of the evidence of a mode that the run knows, which leaves the same doubt
LEAST_TAIL, TAIL_ERRORS, LEAST_EFFECTIVE = 0.03, 4.5, 100.0
LEAST_OF_FIT, OF_MODES = 0.1, 0.2  # of what the run knew, in the reference of the next; of its modes in that
DIFFERENCE = 1e-5  # step of difference quotients, in prior standard deviations, of models without gradients
LEAST_PRIOR, LEAST_DRAWS = 100, 16  # draws of the prior, for its scale, and of the fit
THOROUGH = 30_000, 1000  # draws of the fit, and climbs from the prior
OF_A_CLIMB = 75  # evaluations, on structural posteriors with wide priors
FULL_RUN = 2000  # draws of a run that is checked in full
OF_RUN, OF_DEAR_RUN = 0.4, 0.05  # evaluations of the check over those of the run, at most
OF_A_SECOND = 1e8  # observed numbers that a population of linear structures compares in a second


class Effort(NamedTuple):
    """Draws of the widened fit, and climbs from plain draws of the prior."""

    draws: int
    climbs: int


class CrossCheck(NamedTuple):
    """What was found beside a run.

    Attributes
    ----------
    effort : Effort
    rise, limit : float
        Log evidence of all draws of the check less that of the run, and how much may be chance.
    shares : array (k,)
        Weight of each of the modes where no draw of the run stands for it, between 0 and 1.
    light_tails : bool or None
        Whether the run's tails are too light; None where the weights cannot tell.
    modes : list of Mode
        Ends of climbs away from the run's draws.
    centre, scale : array (d,)
        In whose units the modes are.
    fit : Mixture
        The widened fit to the run's draws.
    rare : bool
        Whether so few climbs led to a part of some weight, known or new, that there may well be others.
    """

    effort: Effort
    rise: float
    limit: float
    shares: np.ndarray
    light_tails: bool | None
    modes: list[Mode]
    centre: np.ndarray
    scale: np.ndarray
    fit: Mixture
    rare: bool

    @property
    def share(self) -> float:
        """Weight of all that no draw of the run stands for."""
        return float(self.shares.sum())

    @property
    def missed(self) -> bool:
        """Whether the run has missed a part of the posterior."""
        return bool(self.rise > self.limit)

    def reference(self, before: Reference | None) -> Reference:
        """Start of a new run: a fit to the draws of this one, its modes `before`, and those it lacked."""
        modes, maps = ([], []) if before is None else (before.modes, before.maps)
        new = np.flatnonzero(self.shares)
        of_new = self.shares[new]
        rest = max(1.0 - of_new.sum(), LEAST_OF_FIT)
        of_old = rest * OF_MODES * before.mode_shares() if modes else np.zeros(0)
        shares = np.concatenate([of_old, of_new, [rest - of_old.sum()]])
        maps, modes = [*maps, *(None for _ in new)], [*modes, *(self.modes[i] for i in new)]
        return Reference(modes, self.centre, self.scale, maps, self.fit, shares / shares.sum())

    def sentence(self) -> str:
        """Say what was looked for, and what was found."""
        looked = f"{self.effort.draws} draws of a wider fit and {self.effort.climbs} climbs from the prior"
        if self.missed:
            return f"{looked} found a part with {100 * self.share:.0f} % of the posterior's weight"
        tails = {True: "too light", False: "right", None: "not checked"}[self.light_tails]
        return f"{looked} found no other part of the posterior; tails {tails}"

    def advice(self, rare: bool) -> str:
        """Say what is wrong and what to do; empty if nothing is. `rare` is that of what was found before."""
        if self.missed:
            return (
                f"a part of the posterior with about {100 * self.share:.0f} % of its weight was found after "
                "sampling: increase `draws` and `stage_draws`, or sample its parts by priors that part them."
            )
        if rare:
            return (
                f"less than {100 * FEW_CLIMBS:.0f} % of climbs from the prior led to a part of the "
                "posterior, so that there may be others that none has found: narrow the priors, or "
                "reparametrise the model."
            )
        if self.light_tails:
            return "the tails of the draws are too light: increase `draws` and `stage_draws`."
        return ""


def affordable(
    thorough: bool, n_draws: int, spent: int, n_data: int, dear: bool, n_differences: int
) -> Effort:
    """Size of a check that costs less than half of the run, or a second where a value costs microseconds.

    It follows from numbers that the run and the model state, never from a clock, for results that depend on
    the seed alone.

    Parameters
    ----------
    thorough : bool
        Whether to do all, whatever it costs.
    n_draws : int
        Draws of the run, of all chains.
    spent : int
        What the run has cost, in evaluations.
    n_data : int
        Observed numbers that one evaluation compares: its cost, where it is not dear.
    dear : bool
        Whether an evaluation runs a program, or Python for each point.
    n_differences : int
        Evaluations of a difference quotient; 0 where there are gradients.
    """
    draws, climbs = THOROUGH
    if thorough:
        return Effort(draws, climbs)
    size = min(1.0, n_draws / FULL_RUN)
    draws, climbs = draws * size, climbs * size
    of_a_climb = OF_A_CLIMB * max(1.0, n_differences / GRADIENT_COST)
    budget = spent * OF_DEAR_RUN if dear else max(spent * OF_RUN, OF_A_SECOND / max(n_data, 1))
    part = min(1.0, budget / (draws + climbs * of_a_climb))
    return Effort(max(int(part * draws), LEAST_DRAWS), int(part * climbs))


def cross_check(
    density: Density, draws, log_evidence: float, standard_error: float, effort: Effort, rng, reference=None
) -> CrossCheck:
    """Look for parts of a posterior that are missing among its draws; see the head of this module.

    Parameters
    ----------
    density : Density
    draws : array (n, d)
        Of the run, on the unconstrained scale.
    log_evidence, standard_error : float
        Of the run.
    effort : Effort
    rng : numpy.random.Generator
    reference : Reference, optional
        Whose scales of the prior are used.
    """
    from_prior = density.draw_prior(max(effort.climbs, LEAST_PRIOR))
    if reference is None:
        centre, scale = from_prior.mean(axis=0), from_prior.std(axis=0)
        if not (np.isfinite(centre + scale).all() and scale.all()):  # of a prior without moments
            centre, scale = draws.mean(axis=0), draws.std(axis=0)
    else:
        centre, scale = reference.centre, reference.scale
    slopes = density.gradients if density.has_gradient else by_differences(density.values, scale)
    scaled = in_units(slopes, centre, scale)
    distinct_draws, counts = distinct(draws)
    plain = fit_mixture(distinct_draws, counts.astype(float), rng)
    fit = Mixture([heavy_tailed(plain, width) for width in WIDTHS], np.array(WIDE_SHARES))
    x = fit.draw(effort.draws, rng)
    value = density.values(x)
    log_weights = value - fit.log_density(x)
    known_from = np.quantile(fit.log_density(draws), KNOWN)
    least_evidence = log_evidence - LEAST_EVIDENCE - np.log(scale).sum()
    # at the top of a mode that is as wide as Laplace's approximation may be
    least_value = least_evidence - len(scale) * np.log(np.sqrt(2.0 * np.pi) * WIDEST)
    modes: list[Mode] = []

    def is_known(u):
        known = fit.log_density(centre + scale * u) > known_from
        return known | (nearest(modes, u) >= 0)

    def add(ends, values):
        negligible: list[Mode] = []
        for i in np.argsort(-values):
            if len(modes) == MOST_MODES or values[i] < least_value:
                break
            if (at := nearest(modes, ends[i][None])[0]) >= 0:
                modes[at] = modes[at]._replace(n_climbs=modes[at].n_climbs + 1)
            elif nearest(negligible, ends[i][None])[0] < 0 and (mode := laplace_mode(scaled, ends[i])):
                (modes if mode.log_evidence > least_evidence else negligible).append(mode)

    heaviest = np.argsort(-log_weights)[: min(HEAVIEST, effort.climbs)]
    heaviest = heaviest[log_weights[heaviest] > -np.inf]
    if len(heaviest):
        add(*climb(scaled, (x[heaviest] - centre) / scale, lambda u: np.zeros(len(u), dtype=bool)))
    n_heavy, rare = len(modes), False
    if effort.climbs:
        ends, values = climb(scaled, (from_prior[: effort.climbs] - centre) / scale, is_known)
        new = fit.log_density(centre + scale * ends) < known_from
        add(ends[new], values[new])
        rare = reference is not None and was_found_by_chance(reference, ends)

    sources, points, values = [fit], [x], [value]
    for mode in modes:
        sources.append(StudentT(centre + scale * mode.x, WIDTHS[0] * scale[:, None] * mode.factor, DEGREES))
        points.append(Mixture(sources[-1:], np.ones(1)).draw(OF_A_MODE, rng))
        values.append(density.values(points[-1]))
    counts, x = np.array([len(p) for p in points]), np.concatenate(points)
    terms = np.array([source.log_density(x) for source in sources])
    log_weights = np.concatenate(values) - log_sum(terms + np.log(counts / counts.sum())[:, None])
    rise, error = log_mean(log_weights)
    limit = max(LEAST_RISE, STANDARD_ERRORS * np.hypot(error, standard_error))
    weights, light_tails = np.exp(log_weights - log_weights.max()), tails_are_light(log_weights, x, draws)
    densest = np.where((terms[1:] > terms[0] + MUCH_DENSER).any(axis=0), terms.argmax(axis=0), 0)
    shares = np.bincount(densest, weights, len(sources))[1:] / weights.sum()
    n_climbs = np.array([mode.n_climbs for mode in modes[n_heavy:]])
    rise = rise - log_evidence
    if rise > limit:
        rare |= bool(((shares[n_heavy:] > MUCH) & (n_climbs < FEW_CLIMBS * effort.climbs)).any())
    of_modes = shares, light_tails, modes, centre, scale
    return CrossCheck(effort, float(rise), float(limit), *of_modes, fit, rare)


def was_found_by_chance(reference: Reference, ends) -> bool:
    """Whether few of the climbs that a run began with, and of those with ends (n, d), led to a heavy mode.

    An end belongs to the mode whose normal distribution, times its evidence, is densest there. Modes that
    draws of a check have led to leave no such doubt.
    """
    if not reference.modes or reference.fit is not None:
        return False
    logs = [
        mode.log_evidence
        - np.log(np.diag(mode.factor)).sum()
        - 0.5 * (np.linalg.solve(mode.factor, (ends - mode.x).T) ** 2).sum(axis=0)
        for mode in reference.modes
    ]
    counts = np.bincount(np.argmax(logs, axis=0), minlength=len(logs))
    counts += [mode.n_climbs for mode in reference.modes]
    return bool(((reference.mode_shares() > HEAVY) & (counts < FEW_CLIMBS * counts.sum())).any())


def tails_are_light(log_weights, x, draws) -> bool | None:
    """Whether weighted points (n, d) have more beyond the 5 and 95 % quantiles of draws (m, d) than these.

    None where the weights cannot tell.
    """
    possible = log_weights > -np.inf
    log_weights, x = log_weights[possible], x[possible]
    weights = np.exp(pareto_smoothed(log_weights) - log_weights.max())
    weights /= weights.sum()
    effective = 1.0 / (weights @ weights)
    if pareto_k(log_weights) > LARGEST_K or effective < LEAST_EFFECTIVE:
        return None
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    beyond = max((weights @ (x < low)).max(), (weights @ (x > high)).max()) - 0.05
    error = np.sqrt(0.05 * 0.95 * (1.0 / effective + 1.0 / len(draws)))
    return bool(beyond > max(LEAST_TAIL, TAIL_ERRORS * error))


def by_differences(values: Callable, scale) -> Callable:
    """Log-density and its gradient by forward differences, at d + 1 points for each (n, d)."""
    steps = DIFFERENCE * np.diag(scale)

    def slopes(x):
        value = values(x)
        shifted = values((x[:, None] + steps).reshape(-1, x.shape[1])).reshape(x.shape)
        with np.errstate(invalid="ignore"):
            slope = (shifted - value[:, None]) / np.diag(steps)
        return value, np.where(np.isfinite(slope), slope, 0.0)

    return slopes
