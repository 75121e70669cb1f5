"""Coverage and widths by kind of error and likelihood."""

import time

import numpy as np

from benchmarks.coverage.chain import (
    N_FACTORS,
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
    """Print how often the intervals contain the truth, and how wide they are."""
    n_sets = QUICK if quick else FULL
    print(
        f"\n90 % intervals of {N_FACTORS} stiffness factors, {n_sets} data sets, errors of {LEVEL:.0%} of "
        "the response. How many of 100 contain the truth (mean of the factors), and how wide they are, in % "
        "of the factor.\n"
    )
    models = {kind: declare(kind) for kind in ("NORM", "CN")}
    predictions = Predictions(models["NORM"])
    pool = pool_of(covariance_of_tn(predictions), POOL // (10 if quick else 1), np.random.default_rng(1))
    rows, fewest = [], dict.fromkeys(KINDS, np.inf)
    for kind in kinds or ERRORS:
        found, n_eff = coverage(kind, n_sets, models, predictions, pool)
        inside = {k: np.mean([contains(x) for x in v]) for k, v in found.items()}
        widths = {k: np.mean([np.ptp(x.ends, axis=0) for x in v]) for k, v in found.items()}
        fewest = {k: min(fewest[k], *(x.effective for x in v)) for k, v in found.items()}
        cells = [f"{100 * inside[k]:.0f} ({100 * widths[k]:.2g})" for k in KINDS]
        rows.append([kind, *cells, f"{np.median(n_eff):,.0f}"])
        print(table(["errors", *KINDS, "N_eff"], rows[-1:]), flush=True)
    print("\n" + table(["errors", *KINDS, "N_eff"], rows))
    n_claimed = true_response().size
    of_kinds = ", ".join(f"{k} {fewest[k]:.0f}" for k in KINDS)
    print(f"\nNORM claims {n_claimed:,}, EXP 20, TN 10. Fewest effective draws of a posterior: {of_kinds}.")


def contains(x):
    """Share of the parameters whose interval contains one."""
    return np.mean((x.ends[0] < 1.0) & (x.ends[1] > 1.0))


def covariance_of_tn(predictions):
    """Of the factors, under TN and errors of the level used, by the sensitivities at the truth."""
    size = LEVEL * np.sqrt(np.mean(true_response() ** 2))
    z = unconstrained(np.ones(N_FACTORS), size)
    event = events_at(predictions, z, np.full(len(z), 1e-4))[0]
    information = event.information[:N_FACTORS, :N_FACTORS]
    return np.linalg.inv(information) * true_response().shape[1]


def coverage(kind, n_sets, models, predictions, pool):
    """Intervals of every data set by likelihood, and N_eff of each."""
    response, dt = true_response(), record().dt
    frequency = structure(np.ones(N_FACTORS)).modes().natural_frequencies[0]
    data = np.stack([measurements(kind, response, dt, frequency, seed) for seed in range(n_sets)])
    s = sums(pool[0], data)
    found, n_eff, started = {name: [] for name in KINDS}, [], time.perf_counter()
    for i, one in enumerate(data):
        rng = np.random.default_rng([7, i])
        for name, x in wide_intervals(*pool, s[:, i], len(one), rng).items():
            found[name].append(x)
        narrow, n = narrow_intervals(one, models, predictions, rng)
        n_eff.append(n)
        for name, x in narrow.items():
            found[name].append(x)
    print(f"{kind}: {time.perf_counter() - started:.0f} s", flush=True)
    return found, n_eff


def narrow_intervals(data, models, predictions, rng):
    """Of NORM, CN and CAL, and N_eff."""
    for model in models.values():
        model["measured"].set_value(data)
    logp = {name: population_logp(model, model.initial_point(), {}) for name, model in models.items()}
    residual = data - true_response()
    sigma = np.sqrt(np.mean(residual**2))
    correlation = np.mean(residual[:, 1:] * residual[:, :-1]) / sigma**2
    correlation = np.clip(correlation, 0.02, 0.99)
    start = unconstrained(np.ones(N_FACTORS), sigma)
    cal = calibrated(predictions, start, N_FACTORS)
    longer = np.append(cal.point, unconstrained((), sigma, correlation)[-1])
    factor = np.eye(len(longer))
    factor[:-1, :-1] = cal.claimed_factor
    calibrated_density = cal.density(lambda z: logp["NORM"](z)[0], lambda z: logp["NORM"](z)[1])
    result = {
        "NORM": of_density(posterior(logp["NORM"]), cal.point, cal.claimed_factor, N_FACTORS, rng),
        "CN": of_density(posterior(logp["CN"]), longer, factor, N_FACTORS, rng),
        "CAL": of_density(calibrated_density, cal.point, cal.factor, N_FACTORS, rng),
    }
    return result, cal.n_eff


def posterior(logp):
    """Log-density of points (n, d)."""
    return lambda z: np.add(*logp(z)[:2])
