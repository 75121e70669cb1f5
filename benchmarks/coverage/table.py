"""Coverage and widths by kind of error and likelihood."""

import time
from collections import defaultdict

import numpy as np

from benchmarks import truth
from benchmarks.coverage.chain import (
    N_FACTORS,
    N_STOREYS,
    PRIOR_WIDTH,
    RATES,
    declare,
    matrices,
    true_response,
    unconstrained,
)
from benchmarks.coverage.errors import ERRORS, LEVEL, measurements
from benchmarks.coverage.intervals import calibrated, of_density
from benchmarks.coverage.wide import pool_of, sums, wide_intervals
from benchmarks.tables import table
from pymc_features.calibration.residuals import Predictions, events_at
from pymc_features.smc import population_logp

FULL, FULL_TEN, QUICK = 1000, 400, 20  # data sets
POOL = 16_000
KINDS = ("NORM", "CN", "TN", "EXP", "ABC", "CAL")


def run_errors(quick=False, kinds=None):
    """Print how often the intervals of three springs and the damping contain the truth, and their widths."""
    for rate in RATES:
        covariance = covariance_of_tn(Predictions(declare("NORM", rate)), rate)
        pool = pool_of(covariance, POOL // (10 if quick else 1), np.random.default_rng(1))
        run_table(QUICK if quick else FULL, kinds or ERRORS, Problem(rate, N_FACTORS), KINDS, pool)


def run_ten(quick=False):
    """The same of ten factors; the pool of responses behind TN, EXP and ABC would miss their posteriors."""
    for rate in RATES:
        n_sets = QUICK if quick else FULL_TEN
        run_table(n_sets, ERRORS, Problem(rate, N_STOREYS), ("NORM", "CN", "CAL"), None)


class Problem:
    """Models of one sampling rate and so many springs, compiled once."""

    def __init__(self, rate, n_springs):
        self.rate, self.n_springs = rate, n_springs
        self.n_parameters = n_springs + 1  # and the damping
        self.models = {kind: declare(kind, rate, n_springs) for kind in ("NORM", "CN")}
        self.starts = {kind: model.initial_point() for kind, model in self.models.items()}
        self.predictions = Predictions(self.models["NORM"])

    def log_densities(self, data):
        """Functions of flat points (n, d) for log-prior and log-likelihood of data, by model."""
        for model in self.models.values():
            model["measured"].set_value(data)
        return {name: population_logp(m, self.starts[name], {}) for name, m in self.models.items()}


def run_table(n_sets, kinds, problem, likelihoods, pool):
    """Print a row for each kind of error as it is finished, and all of them."""
    print(
        f"\n{problem.rate:g} Hz: 90 % intervals of {problem.n_springs} stiffness factors and that of the "
        f"damping, {n_sets} data sets, errors of {LEVEL:.0%} of the response. How many of 100 contain the "
        "truth (mean of the factors; of CAL also the lowest of a factor), and how wide they are, in % of the "
        "factor.\n"
    )
    rows, fewest = [], dict.fromkeys(likelihoods, np.inf)
    headers = ["errors", *likelihoods, "CAL, lowest", "N_eff"]
    for kind in kinds:
        found, n_eff = coverage(kind, n_sets, problem, pool)
        inside = {k: 100.0 * np.mean([contains(x) for x in found[k]], axis=0) for k in likelihoods}
        widths = {k: np.mean([np.ptp(x.ends, axis=0) for x in found[k]]) for k in likelihoods}
        fewest = {k: min(fewest[k], *(x.effective for x in found[k])) for k in likelihoods}
        cells = [f"{inside[k].mean():.0f} ({100 * widths[k].mean():.2g})" for k in likelihoods]
        lowest = f"{inside['CAL'].min():.1f}"
        rows.append([kind, *cells, lowest, f"{np.median(n_eff):,.0f}"])
        print(table(headers, rows[-1:]), flush=True)
    print("\n" + table(headers, rows))
    n_claimed = true_response(problem.rate).size
    of_kinds = ", ".join(f"{k} {fewest[k]:.0f}" for k in likelihoods)
    print(f"\nNORM claims {n_claimed:,}, EXP 20, TN 10. Fewest effective draws of a posterior: {of_kinds}.")


def contains(x):
    """Whether the interval of each parameter contains one."""
    return (x.ends[0] < 1.0) & (x.ends[1] > 1.0)


def covariance_of_tn(predictions, rate):
    """Of springs and damping, under TN and errors of the level used, by the sensitivities at the truth."""
    size, n = LEVEL * np.sqrt(np.mean(true_response(rate) ** 2)), N_FACTORS + 1
    z = unconstrained(np.ones(n), size)
    event = events_at(predictions, predictions.coordinates, z, np.full(len(z), 1e-4), predictions(z))[0]
    precision = event.information[:n, :n] / true_response(rate).shape[1]
    return np.linalg.inv(precision + np.eye(n) / PRIOR_WIDTH**2)


def coverage(kind, n_sets, problem, pool):
    """Intervals of every data set by likelihood, and N_eff of each."""
    response, dt = true_response(problem.rate), 1.0 / problem.rate
    frequency = truth.modes(matrices().mass, matrices().stiffness)[0][0] / (2.0 * np.pi)
    data = np.stack([measurements(kind, response, dt, frequency, seed) for seed in range(n_sets)])
    s = None if pool is None else sums(pool[0], data, problem.rate)
    found, n_eff, started = defaultdict(list), [], time.perf_counter()
    for i, one in enumerate(data):
        rng = np.random.default_rng([7, i])
        wide = {} if pool is None else wide_intervals(*pool, s[:, i], len(one), rng)
        narrow, n = narrow_intervals(one, problem, rng)
        n_eff.append(n)
        for name, x in {**wide, **narrow}.items():
            found[name].append(x)
    print(f"{kind}: {time.perf_counter() - started:.0f} s", flush=True)
    return found, n_eff


def narrow_intervals(data, problem, rng):
    """Of NORM, CN and CAL, and N_eff."""
    logp, n = problem.log_densities(data), problem.n_parameters
    residual = data - true_response(problem.rate)
    sigma = np.sqrt(np.mean(residual**2))
    correlation = np.mean(residual[:, 1:] * residual[:, :-1]) / sigma**2
    correlation = np.clip(correlation, 0.02, 0.99)
    cal = calibrated(problem.predictions, unconstrained(np.ones(n), sigma), n)
    longer = np.append(cal.point, unconstrained((), sigma, correlation)[-1])
    factor = np.eye(len(longer))
    factor[:-1, :-1] = cal.claimed_factor
    calibrated_density = cal.density(lambda z: logp["NORM"](z)[0], lambda z: logp["NORM"](z)[1])
    result = {
        "NORM": of_density(posterior(logp["NORM"]), cal.point, cal.claimed_factor, n, rng),
        "CN": of_density(posterior(logp["CN"]), longer, factor, n, rng),
        "CAL": of_density(calibrated_density, cal.point, cal.factor, n, rng),
    }
    return result, cal.n_eff


def posterior(logp):
    """Log-density of points (n, d)."""
    return lambda z: np.add(*logp(z)[:2])
