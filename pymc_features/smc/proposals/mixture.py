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

SMALLEST_BETA = 1e-300
TOLERANCE = 1e-7  # of the log evidences
MAX_ITERATIONS = 50


def log_sum(terms: np.ndarray) -> np.ndarray:
    """ln sum exp over the first axis, without SciPy's overhead."""
    top = terms.max(axis=0)
    return top + np.log(np.exp(terms - top).sum(axis=0))


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
