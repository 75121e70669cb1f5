"""The end of `PersistentSMC`: independent draws, from the reference or from fits, until there are enough."""

import warnings
from typing import NamedTuple

import numpy as np

from pymc_features.exceptions import SamplingWarning
from pymc_features.smc.proposals.fitted import fit_twice_to
from pymc_features.smc.proposals.mixture import equal_draws
from pymc_features.smc.proposals.pool import LARGEST_K, LARGEST_SHARE, Pool
from pymc_features.smc.proposals.reference import MANY, good_share

FIT_POINTS, FIRST_DRAWS = 350, 200  # of a fit, and from the first fit of the last stage, for each parameter
MAX_EVALUATIONS = 500  # of the last stage, for each draw
FOR_TAILS = 8  # and of more fits where a few draws outweigh the rest
HEAVY_K = 0.3  # Pareto shape of weights above which draws do not decide themselves how many are enough
TRIAL = 0.25  # worth, of `draws`, of those that decide then
MOST_TRIALS, BETTER = 5, 1.5  # of fits that follow each other, each better than the one before by this factor
MARGIN, ADDITION = 1.1, 0.2  # numbers that are drawn and, if they are worth too little, added: over the need
REFIT = 0.2  # worth, of `draws`, of what has been drawn, below which another fit follows
TOO_FEW = "PersistentSMC ended with draws worth {:.0f} of {}. Increase `stage_draws`, or narrow the priors."


class Trial(NamedTuple):
    """What draws of a fit have shown, with those of the reference.

    Attributes
    ----------
    rate : float
        What the draws are worth, over their number.
    fit : int
        Number of the density.
    of_reference : float
        Share of the reference in them.
    """

    rate: float
    fit: int
    of_reference: float


class LastDraws:
    """What `PersistentSMC` does at a temperature of one, with its pool, reference and random numbers."""

    def fitting_points(self) -> np.ndarray:
        """Equally weighted points of the pool (n, d) for a fit."""
        n = min(max(FIT_POINTS * self.n_parameters, 2 * self.stage_draws), len(self.weights))
        return self.pool.particles[equal_draws(self.weights, n, self.rng)]

    def complete(self) -> None:
        """Draw from the reference, or fits that follow each other, until that is worth `draws`.

        Only draws count that have shaped no fit: of the last one. If few show that more is missing than
        were drawn in all, it draws as many, and another one follows. So it does where a few draws outweigh
        the rest. A good reference that is bent stands in for the fit.
        Where weights are heavy, draws of a fit are a trial only: other fits follow, to these draws as well,
        as long as they become better; then see `drawn_anew`.
        """
        pool, used, limit, drawn, before_tails, trials = self.pool, 0, 0, 0, None, []
        source = self.last_stage if self.last_stage in pool.proposals else 0  # drawn from in place of chains
        first, most = max(FIRST_DRAWS * self.n_parameters, self.draws // 4), MAX_EVALUATIONS * self.draws
        while True:
            sample = pool.independent(pool.known(max(source, self.last_stage)))
            n_sample, worth, k = sample.counts.sum(), sample.worth(), sample.pareto_k()
            heavy, again = bool(sample.proposals) and k > HEAVY_K, False
            missing = max((TRIAL if heavy else 1.0) * self.draws - worth, 0.0)
            if not missing and before_tails is None:
                before_tails = used
            refit = not missing and used - before_tails + n_sample < FOR_TAILS * self.draws
            refit = refit and k > LARGEST_K and sample.largest_share() > LARGEST_SHARE
            if not (missing or refit) and heavy and used < most:
                trials.append(Trial(worth / n_sample, pool.known()[-1], sample.counts[0] / n_sample))
                again = self.pays_to_fit_again(trials)
                if not again:
                    sample, n = self.drawn_anew(trials)
                    used, worth, trials = used + n, sample.worth(), []
                    refit = worth < REFIT * self.draws
            refit = refit or again
            if not (missing or refit) or used >= most:
                break
            n = 1.1 * missing * max(1.0, n_sample / max(worth, 1.0))
            poor = worth < good_share(self.n_parameters) * n_sample
            if refit or (poor and n > max(used, first)):
                n = 0 if refit else limit - drawn
                if n <= 0:
                    source, n, limit, drawn = self.fit_again(), first, max(used, first), 0
            n = int(np.clip(n, 0.1 * self.draws, 2.0 * self.draws + used))
            self.draw_more(n, source)
            used, drawn = used + n, drawn + n
        if worth < self.draws:
            warnings.warn(TOO_FEW.format(worth, self.draws), SamplingWarning, stacklevel=2)
            whole = pool.worth()
            sample = pool if self.hamiltonian_share > 0.0 and whole > worth else sample  # chains got about
        self.ess = worth
        self.finish(sample)

    def pays_to_fit_again(self, trials: list[Trial]) -> bool:
        """Whether another fit is likely to be better than the last one, which is not a good one."""
        *before, last = trials
        better = not before or last.rate > BETTER * before[-1].rate
        return better and last.rate < good_share(self.n_parameters) and len(trials) < MOST_TRIALS

    def fit_again(self) -> int:
        """Fit to the whole pool; the number of the fit."""
        pool = self.pool
        self.weights = pool.normalised(pool.log_weights(1.0))
        points = self.fitting_points()
        # draws in many dimensions, a few of them heavy, are too few for a fit to be as good
        bent = not self.needs_fit and self.n_parameters >= MANY
        pool.add_proposal(self.reference.mixture if bent else fit_twice_to(points, self.rng, self.bounded))
        return len(pool.betas) - 1

    def drawn_anew(self, trials: list[Trial]) -> tuple[Pool, int]:
        """Draws of the two best fits and the reference, alone, as many as the trials show to be enough.

        Draws seem enough the sooner, and a fit the better, the fewer of them have fallen where weights are
        heavy. Draws that decide make tails too light: of the deviation between eight schools the 95 %
        quantile was too small by 4 % of the 5-95 % width.

        Returns the draws and their number. They are worth less than `draws` where there are `MAX_EVALUATIONS`
        of them for each, and less than `REFIT` of it where the trials were wrong.
        """
        pool, mark, used, best = self.pool, self.pool.mark(), 0, sorted(trials)[-2:]
        numbers = np.array([0, *sorted(trial.fit for trial in best)])
        rate, _, of_reference = np.mean(best, axis=0)
        shares = np.append(of_reference, np.full(len(best), (1.0 - of_reference) / len(best)))
        n = min(MARGIN / rate, MAX_EVALUATIONS) * self.draws
        counts = first = np.ceil(n * shares).astype(int)
        while True:
            for source, n in zip(numbers, counts, strict=True):
                if n:
                    self.draw_more(n, source)
            used += int(counts.sum())
            anew = pool.independent(numbers, mark)
            worth = anew.worth()
            enough = worth >= self.draws or worth < REFIT * self.draws
            if enough or used >= MAX_EVALUATIONS * self.draws:
                return anew, used
            counts = np.ceil(ADDITION * first).astype(int)

    def draw_more(self, n: int, source: int) -> None:
        """Independent draws from the reference or prior, or from a fit."""
        x = self.pool.proposals[source].draw(n, self.rng) if source else self.draw_reference(n)
        self.pool.add_draws(x, *self.weigh(x), source)
        self.pool.solve()

    def finish(self, sample: Pool) -> None:
        """Draw equally weighted points from the independent draws; evidence and its standard error.

        Where these are all there is, the evidence is that of the draws that have shaped no fit.
        """
        unseen = sample if sample is self.pool else sample.unseen()
        self.log_marginal_likelihood, self.standard_error = unseen.evidence()
        self.pareto_k, self.largest_share = sample.pareto_k(), sample.largest_share()
        weights = sample.normalised(sample.posterior_log_weights())
        chosen = equal_draws(weights, self.draws, self.rng)
        self.tempered_posterior = sample.particles[chosen]
