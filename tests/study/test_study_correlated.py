"""Errors correlated in time in the study: exact references against other routes, findings in words."""

import numpy as np
import pytest
from scipy import integrate, linalg, stats

from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.study.exact import (
    OWN_POSTERIORS,
    DiscrepancyCurve,
    correlated_exponents,
    known_scale_posterior,
    log_determinant,
    reference,
    unknown_time_posterior,
    weighted_square,
)
from pymc_features.study.results import verdict
from pymc_features.study.settings import Study
from support.straight import Record

pytestmark = pytest.mark.slow

DT, N_TIMES, N_SENSORS = 0.02, 40, 3


def sums_of(misfit):
    """S, D, first and last square of a misfit (sensor, time)."""
    return np.array(
        [
            np.sum(misfit**2),
            np.sum(np.diff(misfit, axis=1) ** 2),
            np.sum(misfit[:, 0] ** 2),
            np.sum(misfit[:, -1] ** 2),
        ]
    )


@pytest.mark.parametrize("tau", [1e-4, 0.01, 0.3, 20.0])
def test_weighted_square_and_determinant_are_those_of_the_dense_matrix(tau):
    misfit = np.random.default_rng(0).normal(size=(N_SENSORS, N_TIMES))
    lags = DT * np.arange(N_TIMES)
    correlation = np.exp(-np.abs(np.subtract.outer(lags, lags)) / tau)
    expected = np.sum(misfit * linalg.solve(correlation, misfit.T, assume_a="pos").T)
    assert weighted_square(sums_of(misfit), DT, tau) == pytest.approx(expected, rel=1e-9)
    half = 0.5 * N_SENSORS * np.linalg.slogdet(correlation)[1]
    assert log_determinant(N_SENSORS, N_TIMES, DT, tau) == pytest.approx(half, rel=1e-9, abs=1e-12)
    log_p = stats.multivariate_normal(cov=0.49 * correlation).logpdf(misfit).sum()
    it = correlated_exponents(N_SENSORS, N_TIMES, DT, tau)
    got = it.constant - it.m * np.log(0.7) - it.c * expected / (2 * 0.49)
    assert got == pytest.approx(log_p, rel=1e-9)


def parabola(theta):
    """Misfit of a linear model with a little noise."""
    rng = np.random.default_rng(4)
    slope, noise = rng.normal(size=(2, N_SENSORS, N_TIMES))
    return 0.1 * noise + (theta - 1.02) * slope


def test_known_scale_posterior_is_the_normal_of_the_linear_model():
    """Misfit linear in theta: the posterior is Gaussian, and so is the evidence."""
    tau, sigma = 0.05, 0.1

    def total(theta):
        return float(weighted_square(sums_of(parabola(theta)), DT, tau))

    curve = DiscrepancyCurve(total, (0.5, 1.5), N_SENSORS * N_TIMES)
    marginal, log_evidence = known_scale_posterior(
        curve, correlated_exponents(N_SENSORS, N_TIMES, DT, tau), sigma
    )
    at = np.array([total(t) for t in (0.0, 1.0, 2.0)])
    curvature = 0.5 * (at[0] - 2 * at[1] + at[2])
    centre = 1.0 - (at[2] - at[0]) / (4 * curvature)
    normal = stats.norm(centre, sigma / np.sqrt(curvature))
    q = np.array([0.01, 0.05, 0.5, 0.95, 0.99])
    np.testing.assert_allclose(marginal.quantile(q), normal.ppf(q), atol=1e-4 * normal.std())
    it = correlated_exponents(N_SENSORS, N_TIMES, DT, tau)
    top = it.constant - it.m * np.log(sigma) - total(centre) / (2 * sigma**2)
    expected = top + 0.5 * np.log(2 * np.pi) + np.log(normal.std())
    assert log_evidence == pytest.approx(expected, abs=1e-6)


def test_unknown_time_posterior_against_gaussian_quadrature():
    """Gauss and Legendre's over theta and ln(sigma), Simpson's over ln(tau): marginals and evidence."""
    bounds, sigma_bounds, tau_bounds = (0.5, 1.5), (0.0, 2.0), (1e-3, 0.5)

    def total(theta):
        return float(sums_of(parabola(theta))[0]) / N_TIMES

    curve = DiscrepancyCurve(total, bounds, N_SENSORS * N_TIMES)
    sums = np.array([sums_of(parabola(t)) for t in curve.theta]).T
    marginals, best, log_evidence = unknown_time_posterior(
        curve, sums, (N_SENSORS, N_TIMES), DT, sigma_bounds, tau_bounds
    )
    n = N_SENSORS * N_TIMES
    constant = -0.5 * n * np.log(2 * np.pi)
    three = np.array([sums_of(parabola(t)) for t in (0.0, 1.0, 2.0)])  # the sums are parabolas in theta
    a, b, c = 0.5 * (three[0] - 2 * three[1] + three[2]), 0.5 * (three[2] - three[0]), three[1]

    def log_density(theta, log_sigma, log_tau):
        x = theta - 1.0
        sums = np.multiply.outer(a, x**2) + np.multiply.outer(b, x) + np.add.outer(c, 0.0 * x)
        weighted = weighted_square(sums, DT, np.exp(log_tau))
        determinant = log_determinant(N_SENSORS, N_TIMES, DT, np.exp(log_tau))
        return (
            constant - n * log_sigma - determinant - 0.5 * weighted * np.exp(-2 * log_sigma)
        ) + log_sigma  # d sigma

    peak = log_density(best[0], np.log(best[1]), np.log(best[2]))
    ends = [(best[0] - 0.15, best[0] + 0.15), (np.log(best[1]) - 0.7, np.log(best[1]) + 0.7)]

    x, weights = np.polynomial.legendre.leggauss(100)
    theta, log_sigma = (0.5 * (low + high + (high - low) * x) for low, high in ends)
    area = 0.25 * np.ptp(ends[0]) * np.ptp(ends[1])

    def over_theta_and_sigma(log_tau):
        density = np.exp(log_density(theta[:, None], log_sigma, log_tau) - peak)
        return area * weights @ density @ weights

    log_ends = np.log(tau_bounds)
    nodes = np.linspace(*log_ends, 81)
    of_tau = np.array([over_theta_and_sigma(v) for v in nodes])
    whole = integrate.simpson(of_tau, nodes)
    volume = (bounds[1] - bounds[0]) * sigma_bounds[1] * (log_ends[1] - log_ends[0])
    assert log_evidence == pytest.approx(np.log(whole) + peak - np.log(volume), abs=1e-3)
    below = integrate.cumulative_simpson(of_tau, x=nodes, initial=0) / whole
    for p in (0.05, 0.5, 0.95):
        expected = np.interp(p, below, nodes)
        assert np.log(marginals["tau"].quantile(p)) == pytest.approx(expected, abs=0.02)
    # marginal of sigma: a scaled inverse chi at each tau
    log_tau = np.interp(np.linspace(0.0005, 0.9995, 1000), below, nodes)
    grid = np.linspace(best[0] - 0.15, best[0] + 0.15, 301) - 1.0
    theta_draws, weighted_draws = [], []
    rng = np.random.default_rng(0)
    for v in log_tau:
        sums_on_grid = np.outer(a, grid**2) + np.outer(b, grid) + c[:, None]
        weighted = weighted_square(sums_on_grid, DT, np.exp(v))
        p = np.exp(-0.5 * (n - 1) * (np.log(weighted) - np.log(weighted.min())))
        i = rng.choice(len(grid), p=p / p.sum())
        theta_draws.append(grid[i] + 1.0)
        weighted_draws.append(weighted[i])
    sigma = np.sqrt(np.array(weighted_draws) / (2 * rng.gamma(0.5 * (n - 1), size=1000)))
    # 1000 draws: standard error of a quantile 5 % at most of the 5-95 % width; four of them
    for name, draws in (("theta", np.array(theta_draws)), ("sigma", sigma)):
        exact = marginals[name].quantile(np.array([0.05, 0.5, 0.95]))
        np.testing.assert_allclose(
            np.quantile(draws, [0.05, 0.5, 0.95]), exact, atol=0.1 * (exact[2] - exact[0])
        )


@pytest.fixture(scope="module")
def widths(record):
    """Exact 5-95 % width of theta under the three models of correlated errors, at two steps."""
    multipliers = (0.1, 0.2)
    short = Record(record.acceleration[:501], record.dt)
    study = Study(short, random_seed=0, multipliers=multipliers)
    found = {}
    for kind in ("CN", "CN-SIGMA", "CN-TAU", "NORM"):
        rows = [reference(kind, study.misfit(m)).statistics[0] for m in multipliers]
        found[kind] = np.array([row[3] - row[1] for row in rows])
    return found


def test_with_time_and_scale_known_the_width_converges(widths):
    """0.1 against 0.2 of the record's step within 5 %; NORM, which does not converge, is the control."""
    assert widths["CN"][0] == pytest.approx(widths["CN"][1], rel=0.05)
    assert widths["NORM"][0] < 0.8 * widths["NORM"][1]


def test_with_the_scale_inferred_from_white_noise_it_grows(widths):
    """sigma^2 grows like tau / dt, and the width with its root."""
    assert widths["CN-SIGMA"][0] / widths["CN-SIGMA"][1] == pytest.approx(np.sqrt(2.0), rel=0.05)


def test_with_the_time_inferred_white_noise_is_found(widths):
    np.testing.assert_allclose(widths["CN-TAU"], widths["NORM"], rtol=0.02)


@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_entries_of_the_catalogue(kind):
    """What every likelihood must state."""
    entry = LIKELIHOODS[kind]
    others = [other for name, other in LIKELIHOODS.items() if name != kind]
    assert entry.name == kind
    assert entry.meaning not in [other.meaning for other in others]
    assert entry.colour not in [other.colour for other in others]
    assert set(entry.takes) <= {"sigma", "correlation_time", "m", "epsilon"}
    assert not entry.calibrates or LIKELIHOODS[entry.calibrates].takes == entry.takes
    assert set(entry.known) | set(entry.inferred) <= set(entry.takes)
    assert not set(entry.known) & set(entry.inferred)
    assert entry.exponents is None or kind not in OWN_POSTERIORS
    assert set(entry.reasons) <= {"narrows", "widens"}


@pytest.mark.parametrize(
    ("kind", "width", "words"),
    [
        (
            "NORM",
            [1.0, 2**0.5, 4.0],
            "narrows as the step shrinks, like its power 0.5: sampling faster is taken",
        ),
        (
            "CN-SIGMA",
            [2**0.5, 1.0, 4.0],
            "widens as the step shrinks, like its power -0.5: the errors do not",
        ),
        ("CN", [1.0, 1.01, 4.0], "settles: 0.99% between the two smallest steps"),
        ("CN", [1.0], "one sampling step only"),
    ],
)
def test_verdicts_in_words(kind, width, words):
    assert verdict(kind, [0.1, 0.2, 1.0][: len(width)], width).startswith(words)
