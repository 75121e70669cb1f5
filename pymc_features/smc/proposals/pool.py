"""Weights and evidences of samples from several densities, all used together.

Points theta_i were drawn from densities p_s / Z_s, n_s of them from each: the reference p_0 (the prior, or a
better guess), tempered ones p_s = p_0 L^beta_s, where L is the posterior density over the reference, and
proposals whose Z_s is known. Taken as one sample from the mixture sum_s (n_s / n) p_s / Z_s, they represent
any temperature beta with the weights

    w_i(beta) = p_0 L^beta / sum_s (n_s / n) p_s / Z_s,      Z(beta) = (1/n) sum_i w_i(beta)

(deterministic mixture, balance heuristic; Owen & Zhou, JASA 95, 2000). The evidences of the temperatures are
those that satisfy Z_s = Z(beta_s) for all s: the multistate Bennett acceptance ratio (Shirts & Chodera, J.
Chem. Phys. 129, 124105, 2008), which has the smallest variance of all estimators that use these points. Only
ratios of densities enter, and a constant added to the log-likelihood changes no weight.

Points carry masses m_i: what a Markov chain visits twice has mass two; of a step that is accepted with
probability a, the proposal gets a and the state it started from 1 - a, so that rejected proposals count as
well. All masses of a chain are divided by the number of its steps that make one independent draw.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import softmax

from pymc_features.smc.proposals.proposal import log_sum

SMALLEST_BETA = 1e-300
TOLERANCE = 1e-7  # of the log evidences
MAX_ITERATIONS = 50


def pareto_tail(excesses) -> tuple[float, float]:
    """Shape and scale of a generalised Pareto distribution of sorted values (n,).

    Zhang & Stephens, Technometrics 51 (2009), with the prior of Vehtari et al. (2024), worth ten points at a
    shape of one half. Both are zero where fewer than five are positive, as where all large weights are equal.
    """
    x = excesses[excesses > 0.0]
    n = len(x)
    if n < 5:
        return 0.0, 0.0
    m = 30 + int(np.sqrt(n))
    b = (1.0 - np.sqrt(m / (np.arange(1, m + 1) - 0.5))) / (3.0 * x[int(n / 4 + 0.5) - 1]) + 1.0 / x[-1]
    k = np.log1p(-b[:, None] * x).mean(axis=1)
    profile = n * (np.log(-b / k) - k - 1.0)
    best = (b * softmax(profile)).sum()
    shape = np.log1p(-best * x).mean()
    return float((n * shape + 5.0) / (n + 10.0)), float(-shape / best)


def largest_weights(log_weights) -> tuple[np.ndarray, np.ndarray, float]:
    """Positions of the largest of weights (n,), ascending, their excesses over the next one, and that.

    In units of the largest. No positions where they would be fewer than five, or all weights are zero.
    """
    n = len(log_weights)
    n_tail = int(min(0.2 * n, 3.0 * np.sqrt(n)))
    if n_tail < 5 or not log_weights.max() > -np.inf:
        return np.empty(0, dtype=int), np.empty(0), 0.0
    tail = np.argpartition(log_weights, n - n_tail - 1)[n - n_tail - 1 :]
    tail = tail[np.argsort(log_weights[tail])]
    weights = np.exp(log_weights[tail] - log_weights[tail[-1]])
    return tail[1:], weights[1:] - weights[0], float(weights[0])


def pareto_k(log_weights) -> float:
    """Shape of the largest of weights (n,); above 0.7 they mislead. Infinite where they are fewer than five.

    Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance sampling, JMLR 25 (2024).
    """
    tail, excesses, _ = largest_weights(log_weights)
    return pareto_tail(excesses)[0] if len(tail) else np.inf


def pareto_smoothed(log_weights) -> np.ndarray:
    """Log weights (n,), the largest of which are replaced by what the distribution fitted to them expects.

    Heavy draws that happen to be there count for less then, and stand for those that are not (Vehtari et al.,
    2024). No weight becomes larger than the largest. Weights whose distribution has no mean stay as they are.
    """
    tail, excesses, least = largest_weights(log_weights)
    shape, scale = pareto_tail(excesses)
    if not (scale > 0.0 and shape < 1.0):
        return log_weights
    tail = tail[excesses > 0.0]
    levels = (np.arange(len(tail)) + 0.5) / len(tail)
    expected = least + scale * np.expm1(-shape * np.log1p(-levels)) / shape
    smoothed = np.array(log_weights)
    smoothed[tail] = log_weights[tail[-1]] + np.log(np.minimum(expected, 1.0))
    return smoothed


def log_mean(log_weights) -> tuple[float, float]:
    """Log mean of weights (n,), and its standard error; some weight is positive."""
    weights = np.exp(log_weights - log_weights.max())
    mean = weights.mean()
    return log_weights.max() + np.log(mean), weights.std() / mean / np.sqrt(len(weights))


def origins(terms, log_z, counts):
    """Probabilities (s, n) that a point comes from each density, and ln sum_s n_s p_s / Z_s (n,)."""
    terms = terms + (np.log(counts) - log_z)[:, None]
    top = terms.max(axis=0)
    p = np.exp(terms - top)
    total = p.sum(axis=0)
    return p / total, top + np.log(total)


def newton_step(p, mass, counts, free):
    """Step of the log evidences (s,), of those that are not known."""
    step = np.zeros(len(counts))
    if free.any():
        weighted = p[free] * mass
        expected = weighted.sum(axis=1)
        hessian = np.diag(expected) - weighted @ p[free].T
        step[free] = np.linalg.lstsq(hessian, counts[free] - expected, rcond=1e-12)[0]
    return step


def bennett(terms, log_z, counts, mass, free) -> np.ndarray:
    """Self-consistent log evidences (s,) from a first guess, those known left as they are; see the module.

    Newton's method on the convex function sum_i m_i ln sum_s n_s p_s(i) / Z_s + sum_s n_s ln Z_s.
    """
    log_z = np.array(log_z, dtype=float)
    p, log_total = origins(terms, log_z, counts)
    value = mass @ log_total + counts @ log_z
    for _ in range(MAX_ITERATIONS):
        step = newton_step(p, mass, counts, free)
        while True:  # a shorter step where the full one overshoots
            trial = log_z - step
            p, log_total = origins(terms, trial, counts)
            trial_value = mass @ log_total + counts @ trial
            if trial_value <= value + 1e-9 * abs(value) or np.abs(step).max() < TOLERANCE:
                break
            step *= 0.5
        log_z, value = trial, trial_value
        if np.abs(step).max() < TOLERANCE:
            break
    return log_z


def equal_draws(weights, n: int, rng: np.random.Generator) -> np.ndarray:
    """Positions (n,) of equally weighted draws, in random order: systematic resampling."""
    uniform = (rng.random() + np.arange(n)) / n
    chosen = np.searchsorted(np.cumsum(weights), uniform).clip(max=len(weights) - 1)
    rng.shuffle(chosen)
    return chosen


def next_beta(pool, beta: float, target: float) -> float:
    """Largest temperature up to 1 whose weights keep the effective number `target`, found on a log scale.

    Where even a vanishing increase leaves fewer, as with likelihoods that are zero over most of the prior,
    nine tenths of what is left are kept; a likelihood that is constant where it is not zero leads to 1 at
    once.
    """
    log_mixture = pool.log_mixture()

    def effective(b):
        return pool.effective(pool.log_weights(b, log_mixture))

    target = min(target, 0.9 * effective(max(beta, SMALLEST_BETA)))
    if effective(1.0) >= target:
        return 1.0
    spread = np.ptp(pool.log_ratio)
    if spread == 0.0:
        return 1.0
    low = np.log(1e-3 / spread)  # increases smaller than this change no weight by more than 0.1 %
    high = np.log1p(-beta) if beta > 0 else 0.0
    if effective(beta + np.exp(low)) < target:
        return beta + np.exp(low)
    increase = brentq(lambda x: effective(beta + np.exp(x)) - target, low, high, xtol=1e-3)
    return float(beta + np.exp(increase))


QUANTILES = np.array([0.05, 0.5, 0.95])
LARGEST_K = 0.7  # Pareto shape of weights that can be trusted
LARGEST_SHARE = 0.005  # of one draw, which moves a tail quantile by about 1.5 % of the width
GROUPS = 20  # of the jackknife; numbers of draws and chains are multiples of it, so that all are equal


class Pool:
    """Everything evaluated so far, and the densities that it was drawn from.

    All densities are relative to one that is normalised, the reference: the prior, or a better guess of the
    posterior. The tempered ones are reference^(1 - beta) posterior^beta; proposals with a known density may
    have been drawn from as well, and count with that.

    Attributes
    ----------
    particles : array (n, d)
    log_reference, log_ratio, visits, inflation, group, source : array (n,)
        Points with finite log-density. `log_ratio`: log prior plus log-likelihood less log reference, which
        is the log-likelihood where the prior is the reference. `visits`: steps that count for the point.
        `inflation`: how many of them count for one independent draw. `group`: points of one Markov chain
        share it, modulo `GROUPS`. `source`: number of the density it comes from.
    betas, log_z : list
        Of each density; a beta of NaN stands for a proposal, whose log_z is zero.
    impossible : list of array (GROUPS,)
        Draws of each density at which the posterior is zero, by group.
    """

    def __init__(self, particles, log_reference, log_ratio):
        self._size, self._columns = 0, [None] * 7
        self.betas, self.log_z, self.impossible = [], [], []
        self.proposals, self._over_reference, self._before = {}, {}, {}
        self.add_density(0.0, 0.0)
        self.add_draws(particles, log_reference, log_ratio)

    def add_density(self, beta: float, log_z: float) -> int:
        """Begin a tempered density, with its log evidence as far as it is known; return its number."""
        self.betas.append(beta)
        self.log_z.append(log_z)
        self.impossible.append(np.zeros(GROUPS))
        return len(self.betas) - 1

    def add_proposal(self, proposal) -> int:
        """Begin a density that is known: something with a `log_density`; return its number."""
        source = self.add_density(np.nan, 0.0)
        self.proposals[source] = proposal
        self._before[source] = self.mark()
        self._over_reference[source] = proposal.log_density(self.particles) - self.log_reference
        return source

    def add_draws(self, particles, log_reference, log_ratio, source=0) -> None:
        """Take in independent draws of the density with number `source`."""
        possible = log_reference + log_ratio > -np.inf
        group = np.arange(len(particles)) % GROUPS
        self.impossible[source] += np.bincount(group[~possible], minlength=GROUPS)
        rows = (particles, log_reference, log_ratio, np.ones(len(particles)), group)
        self.add(*(row[possible] for row in rows), source)

    def add(self, particles, log_reference, log_ratio, visits, group, source) -> np.ndarray:
        """Take in points of a density, `source` its number; return their positions."""
        first, self._size = self._size, self._size + len(visits)
        ones = np.ones(len(visits))
        rows = (particles, log_reference, log_ratio, visits, ones, group, np.full(len(visits), source))
        for i, row in enumerate(rows):
            column = self._columns[i]
            if column is None or len(column) < self._size:  # by half: additions cost no more than their sum
                grown = np.empty((self._size + self._size // 2, *row.shape[1:]), dtype=row.dtype)
                if column is not None:
                    grown[:first] = column[:first]
                self._columns[i] = column = grown
            column[first : self._size] = row
        for known, proposal in self.proposals.items():
            more = proposal.log_density(particles) - log_reference
            self._over_reference[known] = np.append(self._over_reference[known], more)
        return np.arange(first, self._size)

    particles, log_reference, log_ratio, visits, inflation, group, source = (
        property(lambda self, i=i: self._columns[i][: self._size]) for i in range(7)
    )

    @property
    def mass(self) -> np.ndarray:
        """Independent draws that each point counts for (n,)."""
        return self.visits / self.inflation

    @property
    def counts(self) -> np.ndarray:
        """Independent draws from each density (s,), impossible ones included."""
        possible = np.bincount(self.source, self.mass, minlength=len(self.betas))
        return possible + np.sum(self.impossible, axis=1)

    def known(self, since: int = 1) -> np.ndarray:
        """Numbers of the densities whose evidence is known: the reference, and proposals from `since` on."""
        return np.array([0, *(source for source in self.proposals if source >= since)])

    def mark(self) -> tuple[int, np.ndarray]:
        """How far the pool has come: its points, and the impossible draws of each density."""
        return self._size, np.array(self.impossible)

    def independent(self, numbers: np.ndarray, mark=None, of=None) -> "Pool":
        """The independent draws alone, of the densities with these `numbers`, as of `known`.

        Their evidence is known. Markov chains that have not been everywhere yet make the weights of points
        where they should have been too small, and so do draws of proposals to which later ones are fitted.
        With a `mark`, no draws from before it; if numbers `of` some densities are given, none of these.
        """
        rows, impossible = np.isin(self.source, numbers), np.array(self.impossible)
        if mark is not None:
            size, before = mark
            late = numbers if of is None else np.intersect1d(of, numbers)
            rows[:size] &= ~np.isin(self.source[:size], late)
            impossible[late] -= before[late]
        part = object.__new__(Pool)
        part._size, part._columns = int(rows.sum()), [column[: self._size][rows] for column in self._columns]
        part._columns[6] = np.searchsorted(numbers, part._columns[6])
        part.betas, part.log_z = [self.betas[s] for s in numbers], [0.0] * len(numbers)
        part.impossible = list(impossible[numbers])
        known = {new: s for new, s in enumerate(numbers) if s in self.proposals}
        part.proposals = {new: self.proposals[s] for new, s in known.items()}
        part._over_reference = {new: self._over_reference[s][rows] for new, s in known.items()}
        return part

    def unseen(self, numbers: np.ndarray) -> "Pool":
        """The independent draws alone but for those of the reference that the last proposal was fitted to.

        A fit has the more mass where they were heavy, so that their weights are too small: with them the log
        evidence of a bent posterior can be low by two standard errors.
        """
        return self.independent(numbers, self._before.get(max(numbers)), of=[0])

    def efficiency(self, source: int, beta: float = 1.0) -> float:
        """Effective share of the draws of a known density at a temperature, as if there were no others."""
        rows = self.source == source
        log_weights = (beta * self.log_ratio - self.term(source))[rows]
        if not len(log_weights):
            return 0.0
        w = np.exp(log_weights - log_weights.max())
        return float(w.sum() ** 2 / (w @ w) / (len(w) + self.impossible[source].sum()))

    def term(self, source: int) -> np.ndarray:
        """Log of a density over the reference, not normalised, at all points (n,)."""
        known = source in self.proposals
        return self._over_reference[source] if known else self.betas[source] * self.log_ratio

    def terms(self) -> np.ndarray:
        """That of each density (s, n)."""
        return np.array([self.term(source) for source in range(len(self.betas))])

    def log_mixture(self) -> np.ndarray:
        """ln sum_s (n_s / n) p_s / Z_s over the reference, shape (n,)."""
        counts = self.counts
        used = counts > 0
        offsets = np.log(counts[used] / counts.sum()) - np.array(self.log_z)[used]
        return log_sum(self.terms()[used] + offsets[:, None])

    def log_weights(self, beta: float, log_mixture=None) -> np.ndarray:
        """ln w_i(beta), shape (n,)."""
        return beta * self.log_ratio - (self.log_mixture() if log_mixture is None else log_mixture)

    @property
    def is_independent(self) -> bool:
        """Whether all points are independent draws."""
        return bool((self.mass == 1.0).all())

    def posterior_log_weights(self) -> np.ndarray:
        """ln w_i(1), shape (n,), Pareto smoothed where all points are independent draws."""
        log_weights = self.log_weights(1.0)
        return pareto_smoothed(log_weights) if self.is_independent else log_weights

    def scaled(self, log_weights) -> tuple[np.ndarray, float]:
        """Weights (n,) over the largest of a point that counts, and the logarithm of that."""
        top = float(log_weights[self.visits > 0.0].max())
        return np.exp(np.minimum(log_weights - top, 0.0)), top  # those without mass may be infinite

    def shares(self, beta: float) -> np.ndarray:
        """Share of each point (n,) in a temperature."""
        return self.normalised(self.log_weights(beta))

    def normalised(self, log_weights) -> np.ndarray:
        """Share of each point (n,) in a temperature: mass times weight."""
        shares = self.mass * self.scaled(log_weights)[0]
        return shares / shares.sum()

    def log_evidence(self, log_weights) -> float:
        """ln Z from the weights of a temperature."""
        # not SciPy's logsumexp: where ArviZ is loaded and JAX installed, it imports JAX
        w, top = self.scaled(log_weights)
        return float(top + np.log(self.mass @ w) - np.log(self.counts.sum()))

    def effective(self, log_weights) -> float:
        """Effective number of independent points behind weights (Kish), serial correlation included."""
        w, mass = self.scaled(log_weights)[0], self.mass
        return float((mass @ w) ** 2 / (mass * np.maximum(mass, 1.0) @ w**2))

    def effective_of_quantiles(self, log_weights) -> np.ndarray:
        """Effective number (d,) of points behind the 5, 50 and 95 % quantiles of each parameter."""
        mass, w = self.mass, self.scaled(log_weights)[0]
        total = mass @ w
        shares, squares = mass * w / total, mass * np.maximum(mass, 1.0) * (w / total) ** 2
        numbers = []
        for column in self.particles.T:
            order = np.argsort(column)
            below = np.cumsum(shares[order])
            ranks = np.searchsorted(below, QUANTILES)
            spread = np.cumsum(squares[order])
            upto = spread[ranks.clip(max=len(order) - 1)]
            variances = (1.0 - QUANTILES) ** 2 * upto + QUANTILES**2 * (spread[-1] - upto)
            numbers.append(1.0 / np.mean(variances / (QUANTILES * (1.0 - QUANTILES))))
        return np.array(numbers)

    def worth(self) -> float:
        """Effective number of points behind the quantiles of the worst parameter, at a temperature of one."""
        return float(self.effective_of_quantiles(self.posterior_log_weights()).min())

    def largest_share(self) -> float:
        """Share of the posterior that the heaviest point stands for."""
        return float(self.shares(1.0).max())

    def pareto_k(self) -> float:
        """Shape of the largest weights at a temperature of one, see `pareto_k`."""
        return pareto_k(self.log_weights(1.0)[self.mass > 0.0])

    def solve(self):
        """Make the evidences of all temperatures agree with each other."""
        counts, betas, log_z = self.counts, np.array(self.betas), np.array(self.log_z)
        used = np.flatnonzero(counts > 0)
        free = betas[used] > 0  # of the reference and of proposals the evidence is known
        log_z[used] = bennett(self.terms()[used], log_z[used], counts[used], self.mass, free)
        self.log_z = list(log_z)

    def evidence(self) -> tuple[float, float]:
        """ln Z at a temperature of one, and its standard error.

        Smoothed weights would make it a little too small. Their jackknife and what they change make up the
        error: a jackknife of the weights as they are misses the heavy draws that might have been there.
        """
        log_z = self.log_evidence(self.log_weights(1.0))
        change = self.log_evidence(self.posterior_log_weights()) - log_z
        return log_z, float(np.hypot(self.jackknife(), change))

    def jackknife(self) -> float:
        """Standard error of ln Z at a temperature of one, by leaving out groups of whole Markov chains.

        Independent draws are smoothed anew without each group.
        """
        counts, log_z, mass, terms = self.counts, np.array(self.log_z), self.mass, self.terms()
        used = counts > 0
        free = np.nan_to_num(np.array(self.betas)[used]) > 0
        impossible = np.sum(self.impossible, axis=0)
        p, log_total = origins(terms[used], log_z[used], counts[used])
        values, is_independent = [], self.is_independent
        for group in range(GROUPS):  # without a group, one step of Newton's method away
            kept = self.group % GROUPS != group
            removed = mass[~kept].sum() + impossible[group]
            counts_kept = (1.0 - removed / counts.sum()) * counts[used]
            step = newton_step(p[:, kept], mass[kept], counts_kept, free)
            shift = step @ p[:, kept]  # first-order change of ln sum_s n_s p_s / Z_s
            log_w = self.log_ratio[kept] - log_total[kept] - shift
            log_w = pareto_smoothed(log_w) if is_independent else log_w
            top = log_w.max()
            values.append(
                top + np.log(mass[kept] @ np.exp(log_w - top)) - np.log(1.0 - removed / counts.sum())
            )
        return float(np.sqrt((GROUPS - 1) * np.var(values)))
