"""What a sampler has evaluated, from whichever density, weighed for any temperature; see `mixture.py`."""

import numpy as np

from pymc_features.smc.proposals.mixture import (
    bennett,
    log_sum,
    newton_step,
    origins,
    pareto_k,
    pareto_smoothed,
)

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

    def add_density(self, beta: float, log_z: float) -> None:
        """Begin a tempered density, with its log evidence as far as it is known."""
        self.betas.append(beta)
        self.log_z.append(log_z)
        self.impossible.append(np.zeros(GROUPS))

    def add_proposal(self, proposal) -> None:
        """Begin a density that is known: something with a `log_density`."""
        self.add_density(np.nan, 0.0)
        source = len(self.betas) - 1
        self.proposals[source] = proposal
        self._before[source] = self._size, self.impossible[0].copy()
        self._over_reference[source] = proposal.log_density(self.particles) - self.log_reference

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
        known = np.isnan(self.betas) & (np.arange(len(self.betas)) >= since)
        known[0] = True
        return np.flatnonzero(known)

    def mark(self) -> tuple[int, list]:
        """How far the pool has come: its points, and the impossible draws of each density."""
        return self._size, [impossible.copy() for impossible in self.impossible]

    def independent(self, numbers: np.ndarray, mark: tuple[int, list] | None = None) -> "Pool":
        """The independent draws alone, of the densities with these `numbers`, as of `known`.

        Their evidence is known. Markov chains that have not been everywhere yet make the weights of points
        where they should have been too small, and so do draws of proposals to which later ones are fitted.
        With a `mark`, no draws from before it.
        """
        rows = np.isin(self.source, numbers)
        if mark is None:
            return self.part(numbers, rows)
        size, before = mark
        part = self.part(numbers, rows & (np.arange(self._size) >= size))
        part.impossible = [self.impossible[s] - before[s] for s in numbers]
        part._before = {new: (0, np.zeros(GROUPS)) for new in part.proposals}
        return part

    def unseen(self) -> "Pool":
        """Leave out draws of the reference that the last proposal was fitted to.

        A fit has the more mass where they were heavy, so that their weights are too small: with them the log
        evidence of a bent posterior can be low by two standard errors.
        """
        if not self.proposals:
            return self
        size, impossible = self._before[max(self.proposals)]
        later = np.arange(self._size) >= size
        part = self.part(np.arange(len(self.betas)), later | (self.source > 0))
        part.impossible[0] = self.impossible[0] - impossible
        return part

    def part(self, numbers: np.ndarray, rows: np.ndarray) -> "Pool":
        """Some densities, whose evidence is known, and some of their points (n,), as flags."""
        part = object.__new__(Pool)
        part._size, part._columns = int(rows.sum()), [column[: self._size][rows] for column in self._columns]
        part._columns[6] = np.searchsorted(numbers, part._columns[6])
        part.betas, part.log_z = [self.betas[s] for s in numbers], [0.0] * len(numbers)
        part.impossible = [self.impossible[s] for s in numbers]
        part.proposals = {new: self.proposals[s] for new, s in enumerate(numbers) if s in self.proposals}
        part._over_reference = {
            new: self._over_reference[s][rows] for new, s in enumerate(numbers) if s in self.proposals
        }
        before = {new: self._before[s] for new, s in enumerate(numbers) if s in self.proposals}
        part._before = {new: (int(rows[:size].sum()), failed) for new, (size, failed) in before.items()}
        return part

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
        return float(self.normalised(self.log_weights(1.0)).max())

    def pareto_k(self) -> float:
        """Shape of the largest weights at a temperature of one, see `mixture.pareto_k`."""
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
