"""Persistent sampling: a kernel that throws no evaluation away."""

import warnings

import numpy as np

from pymc_features.smc.mixture import GROUPS, Pool, next_beta
from pymc_features.smc.population import PopulationKernel
from pymc_features.smc.proposal import fit_mixture

TARGET_ACCEPTANCE = 0.35
LOCAL_INFLATION = 3.0  # local steps that count for one independent point, roughly
# What a fitted mixture misses grows with the dimension: from two to eleven parameters the share of local
# proposals rises, and the expected correlation with its first points falls below which a stage may end
LOCAL_SHARES = (0.2, 0.5)
FORGOTTEN = (0.1, 0.001)
MAX_STEPS = 500
MORE_PRIOR = 50  # the prior is drawn from at most this many times, in search of possible points


class PersistentSMC(PopulationKernel):
    """Sequential Monte Carlo in which every evaluation of every stage counts in the result.

    All points ever evaluated, prior draws and rejected proposals included, stay in a pool that is
    reweighted to each new temperature (persistent sampling, Karamanis & Seljak 2025; `mixture.py`). A stage
    starts a few chains from points of the pool and keeps all their states (waste-free SMC, Dau & Chopin
    2022). The last stage goes on until the pool is worth `draws` independent draws from the posterior; as
    many equally weighted ones are returned.

    Parameters
    ----------
    draws : int
        Equally weighted draws to return, and the effective number of points to reach.
    stage_draws : int, optional
        Evaluations of a stage: two fifths of `draws`, and not less than 50 for each parameter and 200 in all,
        by default. The prior is evaluated at twice as many.
    threshold : float
        Effective number of points that a new temperature keeps, over `stage_draws`.
    **settings
        Of `PopulationKernel`.

    Notes
    -----
    Proposals come from a mixture of Student-t distributions fitted to the weighted pool: independent of the
    present point where many are accepted, shortened towards it (t-preconditioned Crank-Nicolson) where few
    are. A fifth of them are steps of differential evolution.

    `sample_stats` has besides those of `PopulationKernel`: `accept_rate`, `scale` (1: independent proposals),
    `effective` (points behind the stage's weights) and, at the end, `log_marginal_likelihood_se`: its
    standard error, by a jackknife over chains. A constant added to the log-likelihood changes nothing but
    the evidence. Cost and accuracy beside other samplers: benchmarks/.

    References
    ----------
    Karamanis & Seljak, Persistent sampling, Statistics and Computing 35 (2025). Dau & Chopin, Waste-free
    sequential Monte Carlo, J. R. Stat. Soc. B 84 (2022).
    """

    starts_from_prior = True
    stats_dtypes_shapes = {
        **PopulationKernel.stats_dtypes_shapes,
        "accept_rate": (float, []),
        "scale": (float, []),
        "effective": (float, []),
        "log_marginal_likelihood_se": (float, []),
    }

    def __init__(self, draws=2000, *, stage_draws=None, **settings):
        super().__init__(draws, **settings)
        n_parameters = sum(size for _, size in self.var_info.values())
        if stage_draws is None:
            stage_draws = max(2 * self.draws // 5, 50 * n_parameters, 200)
        if isinstance(stage_draws, bool) or int(stage_draws) != stage_draws or stage_draws < 20:
            raise ValueError(f"`stage_draws` must be an integer of at least 20, got {stage_draws}.")
        self.stage_draws = GROUPS * -(-int(stage_draws) // GROUPS)
        rise = float(np.clip((n_parameters - 2) / 9.0, 0.0, 1.0))
        self.local_share = LOCAL_SHARES[0] + rise * (LOCAL_SHARES[1] - LOCAL_SHARES[0])
        self.forgotten = FORGOTTEN[0] * (FORGOTTEN[1] / FORGOTTEN[0]) ** rise

    def _initialize_kernel(self):
        """Evaluate draws from the prior until enough of them are possible."""
        wanted = max(20, 4 * sum(size for _, size in self.var_info.values()))
        self.scale, self.standard_error, self.pool = 1.0, np.nan, None
        for _ in range(1 if self.start else MORE_PRIOR):
            particles = self.initial_particles(2 * self.stage_draws)
            more = Pool(particles, *self.evaluate(particles))
            if self.pool is None:
                self.pool = more
            else:
                self.pool.add_prior(more)
            if len(self.pool.mass) >= wanted:
                break
        if not len(self.pool.mass):
            self.refuse_impossible_model()

    def update_beta_and_weights(self):
        """Choose the next temperature and weigh the pool for it."""
        self.iteration += 1
        self.beta = next_beta(self.pool, self.beta, self.threshold * self.stage_draws)
        log_weights = self.pool.log_weights(self.beta)
        self.weights = self.pool.normalised(log_weights)
        self.pool.add_temperature(self.beta, self.pool.log_evidence(log_weights))

    def resample(self):
        """Choose the points at which the chains of the stage start."""
        n_chains = GROUPS * max(1, self.stage_draws // (5 * GROUPS))
        self.position = equal_draws(self.weights, n_chains, self.rng)

    def tune(self):
        """Fit the proposal to the weighted pool."""
        self.reference = equal_draws(self.weights, 2 * self.stage_draws, self.rng)
        distinct, counts = np.unique(self.reference, return_counts=True)
        self.proposal = fit_mixture(self.pool.particles[distinct], counts, self.rng)

    def mutate(self):
        """Advance all chains until the stage is done, keeping every state and every proposal."""
        pool, position = self.pool, self.position
        x, prior = pool.particles[position], pool.log_prior[position]
        likelihood, density = pool.log_likelihood[position], self.proposal.log_density(x)
        group = np.arange(len(x))
        self.n_steps, self.memory, acceptances = 0, 1.0, []
        while not self.stage_is_done(len(x)):
            proposal, local = self.propose_from(x)
            new_prior, new_likelihood = self.evaluate(proposal)
            new_density = self.proposal.log_density(proposal)
            log_ratio = new_prior - prior + self.beta * (new_likelihood - likelihood)
            log_ratio += np.where(local, 0.0, density - new_density)
            probability = np.exp(np.minimum(log_ratio, 0.0))
            kept = np.sqrt(1.0 - self.scale**2)  # of the distance to the centre of the proposal
            possible = probability > 0
            np.add.at(pool.mass, position, 1.0 - probability)  # chains may share a point
            ahead = position.copy()
            ahead[possible] = pool.add(
                *(a[possible] for a in (proposal, new_prior, new_likelihood, probability)),
                np.where(local, LOCAL_INFLATION, (1.0 + kept) / (1.0 - kept))[possible],
                group[possible],
            )
            pool.counts[-1] += len(x)
            moved = self.rng.random(len(x)) < probability
            x = np.where(moved[:, None], proposal, x)
            prior, likelihood, density, position = (
                np.where(moved, new, old)
                for new, old in (
                    *((new_prior, prior), (new_likelihood, likelihood)),
                    *((new_density, density), (ahead, position)),
                )
            )
            self.n_steps += 1
            acceptances.append(probability.mean())
            self.memory *= 1.0 - (1.0 - self.local_share) * acceptances[-1] * (1.0 - kept)
            self.adapt(acceptances[-1])
        self.accept_rate = float(np.mean(acceptances))
        pool.solve()
        if self.beta == 1.0:
            self.finish()

    def propose_from(self, x):
        """Proposals (n, d), and which of them are local.

        Most are moves of the fitted mixture. Some are steps along the difference of two points of the pool
        (differential evolution, ter Braak 2006): symmetric, and of the right size even in a corner of the
        posterior that holds too few points for the mixture to see it.
        """
        n, d = x.shape
        proposal = self.proposal.move(x, self.scale, self.rng)
        a, b = self.rng.choice(self.reference, size=(2, n))
        local = (self.rng.random(n) < self.local_share) & (a != b)
        length = 2.38 / np.sqrt(2.0 * d) * np.exp(0.7 * self.rng.standard_normal(n))
        step = length[:, None] * (self.pool.particles[a] - self.pool.particles[b])
        return np.where(local[:, None], x + step, proposal), local

    def adapt(self, acceptance):
        """Shorten proposals that are rarely accepted, lengthen them towards independence otherwise."""
        gain = 1.0 / np.sqrt(1.0 + 0.1 * self.n_steps)
        self.scale = float(np.clip(self.scale * np.exp(gain * (acceptance - TARGET_ACCEPTANCE)), 1e-3, 1.0))

    def stage_is_done(self, n_chains):
        """Whether the chains are long and mixed enough and, at the end, the pool is worth `draws`."""
        if self.n_steps * n_chains < self.stage_draws:
            return False
        if self.n_steps >= MAX_STEPS:
            warnings.warn(
                f"a stage of PersistentSMC ended after {MAX_STEPS} steps before it was worth its draws. "
                "Increase `stage_draws`, or look for parameters that the data do not determine.",
                stacklevel=2,
            )
            return True
        if self.memory > self.forgotten:
            return False
        if self.beta < 1.0:
            return True
        # to weigh the pool takes as long as a few steps: in a long stage, not after each
        if self.n_steps % max(1, self.n_steps // 10):
            return False
        return self.pool.effective(self.pool.log_weights(1.0)) >= self.draws

    def finish(self):
        """Draw equally weighted points from the pool; evidence and its standard error."""
        pool = self.pool
        self.log_marginal_likelihood = pool.log_z[-1]
        self.standard_error = pool.standard_error()
        self.weights = pool.normalised(pool.log_weights(1.0))
        chosen = equal_draws(self.weights, self.draws, self.rng)
        self.tempered_posterior = pool.particles[chosen]
        self.prior_logp, self.likelihood_logp = pool.log_prior[chosen], pool.log_likelihood[chosen]

    def sample_stats(self):
        """Statistics of the stage just finished."""
        return {
            **super().sample_stats(),
            "accept_rate": self.accept_rate,
            "scale": self.scale,
            "effective": self.pool.effective(self.pool.log_weights(self.beta)),
            "log_marginal_likelihood_se": self.standard_error,
        }

    def sample_settings(self):
        """Settings, saved as attributes of `sample_stats`."""
        return {"_n_draws": self.draws, "threshold": self.threshold, "stage_draws": self.stage_draws}


def equal_draws(weights, n: int, rng: np.random.Generator) -> np.ndarray:
    """Positions (n,) of equally weighted draws, in random order: systematic resampling."""
    uniform = (rng.random() + np.arange(n)) / n
    chosen = np.searchsorted(np.cumsum(weights), uniform).clip(max=len(weights) - 1)
    rng.shuffle(chosen)
    return chosen
