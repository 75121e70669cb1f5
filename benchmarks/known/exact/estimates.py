"""Quantiles and their standard errors, from chains and from weighted points, and what tells good from bad."""

import numpy as np

from benchmarks.known.answer import PROBABILITIES


def spread(quantile, share_se):
    """Standard error of quantiles (3, d) from that of the shares below them (3, d).

    Half of the way between the quantiles of one standard error less and more, without a density.
    """
    sides = [np.clip(PROBABILITIES[:, None] + s * share_se, 1e-4, 1.0 - 1e-4) for s in (-1, 1)]
    return 0.5 * (quantile(sides[1]) - quantile(sides[0]))


def of_chains(x):
    """Quantiles, standard errors and effective draws, each (3, d), of independent chains (chain, draw, d)."""
    flat = np.sort(x.reshape(-1, x.shape[-1]), axis=0)
    columns = np.arange(x.shape[-1])

    def quantile(p):
        return flat[np.clip((p * len(flat)).astype(int), 0, len(flat) - 1), columns]

    p = np.broadcast_to(PROBABILITIES[:, None], (3, x.shape[-1]))
    found = quantile(p)
    below = np.array([(x <= row).mean(axis=1) for row in found])  # (3, chain, d)
    share_se = below.std(axis=1, ddof=1) / np.sqrt(len(x))
    return found, spread(quantile, share_se), p * (1.0 - p) / share_se**2


def of_weighted(x, weights):
    """Quantiles and standard errors (3, d) of independent points (n, d) with weights (n,)."""
    w = weights / weights.sum()
    found, errors = np.empty((3, x.shape[1])), np.empty((3, x.shape[1]))
    for i, column in enumerate(x.T):
        order = np.argsort(column)
        values, below = column[order], np.cumsum(w[order])

        def quantile(p, values=values, below=below):
            return values[np.searchsorted(below, p).clip(max=len(values) - 1)]

        found[:, i] = quantile(PROBABILITIES)
        inside = (column[None] <= found[:, i, None]) - PROBABILITIES[:, None]
        share_se = np.sqrt((w**2 * inside**2).sum(axis=1))
        ends = [np.clip(PROBABILITIES + sign * share_se, 1e-4, 1.0 - 1e-4) for sign in (-1, 1)]
        errors[:, i] = 0.5 * (quantile(ends[1]) - quantile(ends[0]))
    return found, errors


def r_hat(x):
    """Largest R-hat of the parameters, from chains (chain, draw, d) cut in halves."""
    half = x.shape[1] // 2
    halves = np.concatenate([x[:, :half], x[:, half : 2 * half]])
    within = halves.var(axis=1, ddof=1).mean(axis=0)
    between = halves.mean(axis=1).var(axis=0, ddof=1)
    return float(np.sqrt((half - 1) / half + between / within).max())


def memory(x):
    """Largest correlation between means of the first and the last third of chains (chain, draw, d).

    Near zero, within 0.2 or so by chance, unless the chains stay where they start: in one of several modes.
    """
    third = max(1, x.shape[1] // 3)
    first, last = x[:, :third].mean(axis=1), x[:, -third:].mean(axis=1)
    together = ((first - first.mean(axis=0)) * (last - last.mean(axis=0))).mean(axis=0)
    return float((together / (first.std(axis=0) * last.std(axis=0))).max())


def pareto_shape(log_weights):
    """Shape of a Pareto law fitted to the largest weights: from 0.5 on their variance is infinite.

    Zhang & Stephens (Technometrics 51, 2009), with the prior of Vehtari et al. (JMLR 25, 2024).
    """
    tail = int(min(0.2 * len(log_weights), 3.0 * np.sqrt(len(log_weights))))
    top = np.sort(log_weights)[-tail - 1 :]
    excess = np.exp(top[1:] - top[-1]) - np.exp(top[0] - top[-1])
    n = len(excess)
    grid = np.arange(1, 31 + int(np.sqrt(n)))
    b = 1.0 / excess[-1] + (1.0 - np.sqrt(len(grid) / (grid - 0.5))) / (3.0 * excess[int(n / 4 + 0.5) - 1])
    k = np.log1p(-b[:, None] * excess).mean(axis=1)
    profile = n * (np.log(-b / k) - k - 1.0)
    weights = np.exp(profile - profile.max())
    best = (weights * b).sum() / weights.sum()
    shape = np.log1p(-best * excess).mean()
    return float((n * shape + 5.0) / (n + 10.0))
