"""Quadrature of structural posteriors of up to four factors and one sigma.

Given sigma, ln L of NORM, TN and EXP is affine in one function S of the factors. So ln L is evaluated on a
grid of factors at one sigma, and

    ln L(theta, sigma) = ln L(theta_0, sigma) + c(sigma) [ln L(theta, sigma_0) - ln L(theta_0, sigma_0)]

gives the others, with c from two points theta; this is checked at points of the posterior. Coordinates: the
prior's probability where it is uniform, its normal score elsewhere; midpoints of even cells. The error stated
is the difference to a coarser grid.
"""

import numpy as np
from scipy import special
from scipy.interpolate import CubicSpline

from benchmarks.known.answer import PROBABILITIES
from benchmarks.known.exact.scores import Uniform

CELLS = {1: 2000, 2: 300, 3: 100, 4: 48}  # of each factor, by their number
CELLS_SIGMA = 200
COARSER = 0.7
MARGIN = 0.5  # of the range of the particles, on each side; doubled where density is cut off
CUT_OFF = 1e-6  # largest density at an end of the grid, over the largest of all
CHUNK = 20_000


class Axis:
    """Even cells of one parameter around its particles z (n,)."""

    def __init__(self, prior, z, cells, margin):
        self.uniform = isinstance(prior, Uniform)
        self.prior = prior
        t = special.ndtr(z) if self.uniform else z
        widened = np.array([t.min(), t.max()]) + margin * np.ptp(t) * np.array([-1.0, 1.0])
        self.low, self.high = np.clip(widened, *((0.0, 1.0) if self.uniform else (-8.0, 8.0)))
        edges = np.linspace(self.low, self.high, cells + 1)
        self.nodes, self.cell = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
        self.z = special.ndtri(self.nodes) if self.uniform else self.nodes
        density = np.ones(cells) if self.uniform else np.exp(-0.5 * self.nodes**2) / np.sqrt(2.0 * np.pi)
        self.mass = density * self.cell  # of the prior

    def quantiles(self, mass):
        """5, 50 and 95 % quantiles (3,) of the parameter, from the posterior's masses at the nodes."""
        fine = np.linspace(self.low, self.high, 20_001)
        cumulative = CubicSpline(self.nodes, mass).antiderivative()(fine)
        cumulative = np.maximum.accumulate(cumulative - cumulative[0])
        t = np.interp(PROBABILITIES * cumulative[-1], cumulative, fine)
        return self.prior.parameter(special.ndtri(t) if self.uniform else t)

    def cut_off(self, mass):
        """Density at ends of the cells that are not ends of the prior, over the largest."""
        ends = [
            mass[i] for i, end in ((0, self.low), (-1, self.high)) if not (self.uniform and end in (0.0, 1.0))
        ]
        return max(ends, default=0.0) / mass.max()


class AffineInSigma:
    """ln L at any sigma from that at sigma_0, learnt from the particles z (n, d), sigma last."""

    def __init__(self, target, z, axis):
        self.target, self.reference = target, z[:, -1].mean()
        at = np.column_stack([z[:, :-1], np.full(len(z), self.reference)])
        value = target.log_likelihood(at)
        best, worst = z[value.argmax(), :-1], z[value.argmin(), :-1]
        self.best = value.max()
        at_best, at_worst = self.along(best, axis.z), self.along(worst, axis.z)
        self.constant, self.slope = at_best, (at_worst - at_best) / (value.min() - self.best)
        self.check(z[:50], axis)

    def along(self, theta, z_sigma):
        """ln L of one theta at all sigmas."""
        return self.target.log_likelihood(np.column_stack([np.tile(theta, (len(z_sigma), 1)), z_sigma]))

    def __call__(self, value):
        """ln L (n, sigma) from values (n,) at the reference."""
        return self.constant + self.slope * (value[:, None] - self.best)

    def check(self, z, axis):
        """Compare with the model at points of the posterior and every tenth sigma."""
        some = slice(None, None, 10)
        for theta in z[:, :-1]:
            value = self.target.log_likelihood(np.append(theta, self.reference)[None])
            expected = self.along(theta, axis.z[some])
            np.testing.assert_allclose(self(value)[0, some], expected, rtol=1e-7, atol=1e-6)


def integrate(target, z, cells, cells_sigma, margins):
    """Quantiles (3, d), log evidence, and the density cut off at the ends of each axis (d,)."""
    n_cells = [cells] * (target.d - 1) + [cells_sigma]
    axes = [Axis(*each) for each in zip(target.priors, z.T, n_cells, margins, strict=True)]
    affine = AffineInSigma(target, z, axes[-1])
    shape = tuple(len(axis.z) for axis in axes[:-1])
    of_theta, of_sigma, top = np.empty(np.prod(shape)), np.zeros(cells_sigma), None
    for first in range(0, len(of_theta), CHUNK):
        index = np.unravel_index(np.arange(first, min(first + CHUNK, len(of_theta))), shape)
        columns = [axis.z[i] for axis, i in zip(axes, index, strict=False)]
        prior = np.prod([axis.mass[i] for axis, i in zip(axes, index, strict=False)], axis=0)
        value = target.log_likelihood(np.column_stack([*columns, np.full(len(prior), affine.reference)]))
        log_likelihood = affine(value)
        top = affine.constant.max() if top is None else top
        mass = np.exp(log_likelihood - top) * axes[-1].mass * prior[:, None]
        of_theta[first : first + CHUNK] = mass.sum(axis=1)
        of_sigma += mass.sum(axis=0)
    of_theta = of_theta.reshape(shape)
    every = range(len(shape))
    marginals = [of_theta.sum(axis=tuple(j for j in every if j != i)) for i in every] + [of_sigma]
    quantiles = np.column_stack([axis.quantiles(m) for axis, m in zip(axes, marginals, strict=True)])
    cut_off = np.array([axis.cut_off(m) for axis, m in zip(axes, marginals, strict=True)])
    return quantiles, float(np.log(of_theta.sum()) + top), cut_off


def answer(target, z):
    """Entry of `answers.json` from particles z (n, d) of the posterior that mark where it lies."""
    cells, margins = CELLS[target.d - 1], np.full(target.d, MARGIN)
    for _ in range(6):
        coarse = integrate(target, z, round(COARSER * cells), round(COARSER * CELLS_SIGMA), margins)
        if (coarse[2] < CUT_OFF).all():
            break
        margins = np.where(coarse[2] < CUT_OFF, margins, 2.0 * margins)
    fine = integrate(target, z, cells, CELLS_SIGMA, margins)
    cut_off = fine[2].max()
    note = "" if cut_off < CUT_OFF else f"Density at an end of the grid: {cut_off:.1e} of the largest."
    return {
        "labels": target.labels,
        "method": f"quadrature, {cells} cells for each factor, {CELLS_SIGMA} for sigma",
        "quantiles_5_50_95": fine[0].tolist(),
        "quantile_se": np.abs(fine[0] - coarse[0]).tolist(),
        "log_evidence": fine[1],
        "log_evidence_se": abs(fine[1] - coarse[1]),
        "note": note,
    }
