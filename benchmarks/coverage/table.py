"""Coverage and widths by kind of error and likelihood."""

import time
from collections import defaultdict

import numpy as np

from benchmarks.coverage.chain import (
    N_FACTORS,
    N_STOREYS,
    declare,
    record,
    structure,
    true_response,
    unconstrained,
)
from benchmarks.coverage.errors import ERRORS, LEVEL, measurements
from benchmarks.coverage.intervals import calibrated, of_density
from benchmarks.coverage.wide import pool_of, sums, wide_intervals
from benchmarks.tables import table
from pymc_features.calibration.fit import Predictions, events_at
from pymc_features.smc import population_logp

FULL, QUICK = 400, 20  # data sets
POOL = 16_000
KINDS = ("NORM", "CN", "TN", "EXP", "ABC", "CAL")


def run_errors(quick=False, kinds=None):
    """Print how often the intervals of three factors contain the truth, and how wide they are."""
    rng = np.random.default_rng(1)
    pool = pool_of(covariance_of_tn(Predictions(declare("NORM"))), POOL // (10 if quick else 1), rng)
    run_table(quick, kinds or ERRORS, N_FACTORS, KINDS, pool)


def run_ten(quick=False):
    """The same of ten factors; the pool of responses behind TN, EXP and ABC would miss their posteriors."""
    run_table(quick, ERRORS, N_STOREYS, ("NORM", "CN", "CAL"), None)


def run_table(quick, kinds, n_factors, likelihoods, pool):
    """Print a row for each kind of error as it is finished, and all of them."""
    n_sets = QUICK if quick else FULL
    print(
        f"\n90 % intervals of {n_factors} stiffness factors, {n_sets} data sets, errors of {LEVEL:.0%} of "
        "the response. How many of 100 contain the truth (mean of the factors), and how wide they are, in % "
        "of the factor.\n"
    )
    models = {kind: declare(kind, n_factors) for kind in ("NORM", "CN")}
    predictions = Predictions(models["NORM"])
    rows, fewest = [], dict.fromkeys(likelihoods, np.inf)
    headers = ["errors", *likelihoods, "N_eff"]
    for kind in kinds:
        found, n_eff = coverage(kind, n_sets, n_factors, models, predictions, pool)
        inside = {k: np.mean([contains(x) for x in found[k]]) for k in likelihoods}
        widths = {k: np.mean([np.ptp(x.ends, axis=0) for x in found[k]]) for k in likelihoods}
        fewest = {k: min(fewest[k], *(x.effective for x in found[k])) for k in likelihoods}
        cells = [f"{100 * inside[k]:.0f} ({100 * widths[k]:.2g})" for k in likelihoods]
        rows.append([kind, *cells, f"{np.median(n_eff):,.0f}"])
        print(table(headers, rows[-1:]), flush=True)
    print("\n" + table(headers, rows))
    n_claimed = true_response().size
    of_kinds = ", ".join(f"{k} {fewest[k]:.0f}" for k in likelihoods)
    print(f"\nNORM claims {n_claimed:,}, EXP 20, TN 10. Fewest effective draws of a posterior: {of_kinds}.")


def contains(x):
    """Share of the parameters whose interval contains one."""
    return np.mean((x.ends[0] < 1.0) & (x.ends[1] > 1.0))


def covariance_of_tn(predictions):
    """Of the factors, under TN and errors of the level used, by the sensitivities at the truth."""
    size = LEVEL * np.sqrt(np.mean(true_response() ** 2))
    z = unconstrained(np.ones(N_FACTORS), size)
    event = events_at(predictions, z, np.full(len(z), 1e-4), predictions(z))[0]
    information = event.information[:N_FACTORS, :N_FACTORS]
    return np.linalg.inv(information) * true_response().shape[1]


def coverage(kind, n_sets, n_factors, models, predictions, pool):
    """Intervals of every data set by likelihood, and N_eff of each."""
    response, dt = true_response(), record().dt
    frequency = structure(np.ones(N_FACTORS)).modes().natural_frequencies[0]
    data = np.stack([measurements(kind, response, dt, frequency, seed) for seed in range(n_sets)])
    s = None if pool is None else sums(pool[0], data)
    found, n_eff, started = defaultdict(list), [], time.perf_counter()
    for i, one in enumerate(data):
        rng = np.random.default_rng([7, i])
        wide = {} if pool is None else wide_intervals(*pool, s[:, i], len(one), rng)
        narrow, n = narrow_intervals(one, n_factors, models, predictions, rng)
        n_eff.append(n)
        for name, x in {**wide, **narrow}.items():
            found[name].append(x)
    print(f"{kind}: {time.perf_counter() - started:.0f} s", flush=True)
    return found, n_eff


def narrow_intervals(data, n_factors, models, predictions, rng):
    """Of NORM, CN and CAL, and N_eff."""
    for model in models.values():
        model["measured"].set_value(data)
    logp = {name: population_logp(model, model.initial_point(), {}) for name, model in models.items()}
    residual = data - true_response()
    sigma = np.sqrt(np.mean(residual**2))
    correlation = np.mean(residual[:, 1:] * residual[:, :-1]) / sigma**2
    correlation = np.clip(correlation, 0.02, 0.99)
    start = unconstrained(np.ones(n_factors), sigma)
    cal = calibrated(predictions, start, n_factors)
    longer = np.append(cal.point, unconstrained((), sigma, correlation)[-1])
    factor = np.eye(len(longer))
    factor[:-1, :-1] = cal.claimed_factor
    calibrated_density = cal.density(lambda z: logp["NORM"](z)[0], lambda z: logp["NORM"](z)[1])
    result = {
        "NORM": of_density(posterior(logp["NORM"]), cal.point, cal.claimed_factor, n_factors, rng),
        "CN": of_density(posterior(logp["CN"]), longer, factor, n_factors, rng),
        "CAL": of_density(calibrated_density, cal.point, cal.factor, n_factors, rng),
    }
    return result, cal.n_eff


def posterior(logp):
    """Log-density of points (n, d)."""
    return lambda z: np.add(*logp(z)[:2])
