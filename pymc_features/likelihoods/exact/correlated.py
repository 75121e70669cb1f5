"""Exact posteriors under errors correlated in time, for the study.

With phi = exp(-dt / tau) common to all sensors the log-density of `CorrelatedNormal` depends on theta through

    W(theta, tau) = sum_j [ r_0^2 + Q_j / (1 - phi^2) ],

which is a combination of four sums over the sensors. With tau known the posterior of theta and sigma has the
form of `quadrature.py` with W for S; with tau inferred sigma is integrated in closed form, and theta and
ln(tau) on a grid.
"""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import gammaincc, gammaln

from pymc_features.likelihoods.exact.quadrature import DiscrepancyCurve, Exponents, Marginal

NEGLIGIBLE = 1e-12
N_COARSE, N_THETA, N_TAU, N_SIGMA = 601, 201, 401, 401


def weighted_square(sums, dt: float, tau):
    """W of errors with correlation time tau [s].

    Parameters
    ----------
    sums : array (4, ...)
        Over the sensors: squares S, squared increments D, first and last squared misfit.
    dt : float
        Sampling step [s].
    tau : array (...)
    """
    squares, increments, first, last = sums
    phi, rest = np.exp(-dt / tau), -np.expm1(-dt / tau)
    form = phi * increments + rest * (last - first + rest * (squares - last))
    return first - form / np.expm1(-2.0 * dt / tau)


def log_determinant(n_sensors: int, n_times: int, dt: float, tau):
    """Half the log-determinant of all correlation matrices."""
    return 0.5 * n_sensors * (n_times - 1) * np.log(-np.expm1(-2.0 * dt / tau))


def correlated_exponents(n_sensors: int, n_times: int, dt: float, tau: float) -> Exponents:
    """Exponents in W of the likelihood with tau known, and its constant."""
    n = n_sensors * n_times
    constant = -0.5 * n * np.log(2.0 * np.pi) - log_determinant(n_sensors, n_times, dt, tau)
    return Exponents(n, 1.0, constant)


def known_scale_posterior(curve: DiscrepancyCurve, exponents: Exponents, sigma: float):
    """Marginal of theta and log evidence with sigma known; `curve` is that of W."""
    log_weights = -0.5 * (curve.values - curve.minimum) / sigma**2
    mass = np.exp(log_weights) * curve.slope
    marginal = Marginal.on_grid(curve.theta, mass, curve.u)
    low, high = curve.bounds
    evidence = np.trapezoid(mass, curve.u) / (high - low)
    top = -exponents.m * np.log(sigma) - 0.5 * curve.minimum / sigma**2 + exponents.constant
    return marginal, float(np.log(evidence) + top)


def unknown_time_posterior(curve, sums, shape, dt, sigma_bounds, tau_bounds):
    """Integrate the posterior under uniform priors of theta, sigma and ln(tau).

    Parameters
    ----------
    curve : DiscrepancyCurve
        Of S, for its nodes.
    sums : array (4, n)
        At the nodes of `curve`; see `weighted_square`.
    shape : tuple of int
        Sensors and samples.
    dt : float
        Sampling step [s].
    sigma_bounds, tau_bounds : tuple of float
        Of the priors; that of sigma begins at zero.

    Returns
    -------
    marginals : dict
        Of theta, sigma and tau.
    best : tuple of float
        theta, sigma and tau of the highest density.
    log_evidence : float
    """
    half = 0.5 * (np.prod(shape) - 1.0)
    top_sigma, log_bounds = sigma_bounds[1], np.log(tau_bounds)
    spline = CubicSpline(curve.u, sums, axis=1)

    def log_posterior(u, log_tau):
        tau = np.exp(log_tau)
        weighted = weighted_square(spline(u)[:, :, None], dt, tau)
        log_p = -half * np.log(0.5 * weighted) - log_determinant(*shape, dt, tau)
        with np.errstate(divide="ignore"):
            log_p += np.log(gammaincc(half, 0.5 * weighted / top_sigma**2))
        return weighted, log_p

    def masses(u, log_tau):
        weighted, log_p = log_posterior(u, log_tau)
        slope = np.interp(u, curve.u, curve.slope)
        return weighted, log_p, log_p + np.log(slope)[:, None]

    u, log_tau = curve.u[::6], np.linspace(*log_bounds, N_COARSE)
    *_, log_mass = masses(u, log_tau)
    matters = log_mass > log_mass.max() + np.log(NEGLIGIBLE)
    u = spread(u, matters.any(axis=1), N_THETA)
    log_tau = spread(log_tau, matters.any(axis=0), N_TAU)
    weighted, log_p, log_mass = masses(u, log_tau)
    top = log_mass.max()
    mass = np.exp(log_mass - top)
    over_theta = np.trapezoid(mass, u, axis=0)
    theta = np.interp(u, curve.u, curve.theta)
    marginals = {
        "theta": Marginal.on_grid(theta, np.trapezoid(mass, log_tau, axis=1), u),
        "sigma": scale_marginal(weighted[::4, ::4], mass[::4, ::4], half, top_sigma),
        "tau": Marginal.on_grid(np.exp(log_tau), over_theta, log_tau),
    }
    i, j = np.unravel_index(log_p.argmax(), log_p.shape)
    best = float(theta[i]), float(np.sqrt(weighted[i, j] / np.prod(shape))), float(np.exp(log_tau[j]))
    volume = (curve.bounds[1] - curve.bounds[0]) * top_sigma * (log_bounds[1] - log_bounds[0])
    evidence = np.log(np.trapezoid(over_theta, log_tau)) + top - np.log(volume)
    constant = gammaln(half) - np.log(2.0) - 0.5 * np.prod(shape) * np.log(2.0 * np.pi)
    return marginals, best, float(evidence + constant)


def spread(nodes, matters, n):
    """An even grid over the part of `nodes` that matters, one step further on each side."""
    where = np.flatnonzero(matters)
    first, last = max(where[0] - 1, 0), min(where[-1] + 1, len(nodes) - 1)
    return np.linspace(nodes[first], nodes[last], n)


def scale_marginal(weighted, mass, half, top_sigma):
    """Marginal of sigma: W / (2 sigma^2) is a gamma variable given theta and tau."""
    matters = mass > NEGLIGIBLE
    weighted, mass = weighted[matters], mass[matters] / mass[matters].sum()
    best, width = np.sqrt(0.5 * weighted / half), 8.0 / np.sqrt(4.0 * half)
    sigma = np.linspace(best.min() * (1.0 - width), min(best.max() * (1.0 + width), top_sigma), N_SIGMA)
    below = np.array([mass @ gammaincc(half, 0.5 * weighted / s**2) for s in sigma])
    return Marginal(sigma, np.gradient(below, sigma), below / below[-1])
