"""The end of `PersistentSMC`: independent draws, from the reference or from fits, until there are enough."""

import warnings

import numpy as np

from pymc_features.exceptions import SamplingWarning
from pymc_features.smc.proposals.fitted import fit_to
from pymc_features.smc.proposals.mixture import equal_draws
from pymc_features.smc.proposals.patches import patched
from pymc_features.smc.proposals.pool import LARGEST_K, LARGEST_SHARE, Pool
from pymc_features.smc.proposals.reference import MANY, good_share

FIT_POINTS = FIRST_DRAWS = 200  # of a fit, and from the first fit of the last stage, for each parameter
MAX_EVALUATIONS = 500  # of the last stage, for each draw
FOR_TAILS = 8  # and of more fits where a few draws outweigh the rest
TOO_FEW = "PersistentSMC ended with draws worth {:.0f} of {}. Increase `stage_draws`, or narrow the priors."


class LastDraws:
    """What `PersistentSMC` does at a temperature of one, with its pool, reference and random numbers."""

    def fitting_points(self) -> np.ndarray:
        """Equally weighted points of the pool (n, d) for a fit."""
        n = min(max(FIT_POINTS * self.n_parameters, 2 * self.stage_draws), len(self.weights))
        return self.pool.particles[equal_draws(self.weights, n, self.rng)]

    def complete(self) -> None:
        """Draw from the reference, or fits that follow each other, until that is worth `draws`.

        Only draws of the last fit count, which no draws have shaped. If few show that more is missing than
        were drawn in all, it draws as many, and another one follows. So it does where a few draws outweigh
        the rest, with a part around each of these. A good reference that is bent stands in for the fit.
        """
        pool, used, limit, drawn, before_tails = self.pool, 0, 0, 0, None
        source = self.last_stage if self.last_stage in pool.proposals else 0  # drawn from in place of chains
        first = max(FIRST_DRAWS * self.n_parameters, self.draws // 4)
        while True:
            sample = pool.independent(max(source, self.last_stage))
            n_sample = sample.counts.sum()
            worth = float(sample.effective_of_quantiles(sample.log_weights(1.0)).min())
            missing = max(self.draws - worth, 0.0)
            if not missing and before_tails is None:
                before_tails = used
            for_tails = not missing and used - before_tails + n_sample < FOR_TAILS * self.draws
            for_tails = for_tails and sample.pareto_k() > LARGEST_K and sample.largest_share() > LARGEST_SHARE
            if not (missing or for_tails) or used >= MAX_EVALUATIONS * self.draws:
                break
            n = 1.1 * missing * max(1.0, n_sample / max(worth, 1.0))
            poor = worth < good_share(self.n_parameters) * n_sample
            if for_tails or (poor and n > max(used, first)):
                n = 0 if for_tails else limit - drawn
                if n <= 0:
                    self.weights = pool.normalised(pool.log_weights(1.0))
                    points, shares = self.fitting_points(), sample.normalised(sample.log_weights(1.0))
                    # draws in many dimensions, a few of them heavy, are too few for a fit to be as good
                    bent = not self.needs_fit and self.n_parameters >= MANY
                    fit = self.reference.mixture if bent else fit_to(points, self.rng, self.bounded)
                    pool.add_proposal(patched(fit, points, sample.particles, shares))
                    source, n, limit, drawn = len(pool.betas) - 1, first, max(used, first), 0
            n = int(np.clip(n, 0.1 * self.draws, 2.0 * self.draws + used))
            self.draw_more(n, source)
            used, drawn = used + n, drawn + n
        if worth < self.draws:
            warnings.warn(TOO_FEW.format(worth, self.draws), SamplingWarning, stacklevel=2)
            whole = float(pool.effective_of_quantiles(pool.log_weights(1.0)).min())
            sample = pool if self.hamiltonian_share > 0.0 and whole > worth else sample  # chains got about
        self.ess = worth
        self.finish(sample)

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
        self.log_marginal_likelihood = unseen.log_evidence(unseen.log_weights(1.0))
        self.standard_error, self.pareto_k = unseen.standard_error(), sample.pareto_k()
        self.largest_share = sample.largest_share()
        log_weights = sample.log_weights(1.0)
        chosen = equal_draws(sample.normalised(log_weights), self.draws, self.rng)
        self.tempered_posterior = sample.particles[chosen]
