"""Bounded parameters, sampled as logits, as normal scores: what the data leave alone is then normal."""

import numpy as np
from scipy.special import log_expit, log_ndtr, ndtri_exp

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
