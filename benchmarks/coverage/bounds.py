"""Intervals of a stiffness factor whose prior ends at the truth, beside it, or before it.

Three storeys with persistent errors, truth by `benchmarks.truth`. The calibrated likelihood is normal in the
factor near its bound, so that intervals come from a normal distribution that the bound cuts off;
tests/calibration/test_bounds.py holds `calibrate` to the same distribution.
"""

import functools
import time
from typing import NamedTuple

import numpy as np
import pymc as pm
from scipy.special import expit, logit
from scipy.stats import truncnorm

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.errors import LEVEL, measurements
from benchmarks.tables import table
from pymc_features.calibration.events import SHORT, interval
from pymc_features.calibration.maxima import climb_likelihood
from pymc_features.calibration.residuals import Predictions
from pymc_features.calibration.sandwich import Peak

FULL, QUICK = 1000, 20  # data sets
RATE, DURATION, KIND = 50.0, 12.0, "AR(1), 0.05 s"  # Hz, s
MASS, SPRINGS = np.ones(3), np.full(3, 1200.0)  # up to 9.9 Hz
CHAIN = truth.chain_matrices(MASS, SPRINGS, (0.3, 5e-4))
LOWEST = 0.5
PLACES = {
    "at it": 0.0,
    "1 sd within": 1.0,
    "2 sds within": 2.0,
    "0 to 4 sds within": None,
    "3 sds beyond": -3.0,
}


@functools.cache
def exact():
    """Motion of the base and floor accelerations (sensor, time)."""
    moved = truth.motion(RATE, DURATION, 1, ends="moving")
    return moved, truth.response(CHAIN, moved)["absolute_acceleration"]


@functools.cache
def declare():
    """NORM with three stiffness factors, the first uniform up to the data `upper`; and data."""
    moved, response = exact()
    record = pmf.Record(moved.values()[0], 1.0 / RATE)
    with pm.Model() as model:
        first = pm.Uniform("first", LOWEST, pm.Data("upper", 2.0))
        theta = pm.math.stack([first, *pm.Normal("others", 1.0, 0.25, shape=2)])
        damping = pmf.RayleighDamping(0.3, 5e-4)
        mu = pmf.response(pmf.SpringMassChain(MASS, SPRINGS * theta, damping), record)
        pm.Normal("y", mu, pm.LogNormal("sigma", 0.0, 2.0), observed=pm.Data("measured", response))
    return model, Predictions(model)


class Bounded(NamedTuple):
    """Draws (n,) of the first factor by CAL and NORM, its interval by CAL, and the free maximum."""

    cal: np.ndarray
    norm: np.ndarray
    interval: tuple[float, float]
    free: float


def fitted(seed, upper) -> Peak:
    """The maximum and its sandwich for one data set."""
    model, predictions = declare()
    response = exact()[1]
    model["measured"].set_value(measurements(KIND, response, 1.0 / RATE, 1.0, seed))
    model["upper"].set_value(upper)
    inside = (min(1.0, upper - 1e-3) - LOWEST) / (upper - LOWEST)
    start = np.array([logit(inside), 1.0, 1.0, np.log(LEVEL * np.sqrt(np.mean(response**2)))])
    fit = climb_likelihood(predictions, start)
    return Peak.at(fit.measured_from_bounds(Peak.at(fit).near_bounds()))


def bounded(seed, upper) -> Bounded:
    """What is known of the first factor from one data set."""
    peak = fitted(seed, upper)
    rng, size, z = np.random.default_rng([5, seed]), upper - LOWEST, peak.fit.z
    ratio = 1.0 if peak.fit.coordinates.near[0] else expit(z[0]) * expit(-z[0])
    scale = size * ratio
    free = LOWEST + size * expit(z[0]) + scale * (peak.free - peak.fit.w)[0]

    def draws(sd):
        low, high = (np.array([LOWEST, upper]) - free) / sd
        return truncnorm.rvs(low, high, free, sd, size=2000, random_state=rng)

    sd = scale * peak.deviations[0]
    cal = draws(sd)
    bound = upper if upper - free < SHORT * sd else None
    return Bounded(cal, draws(scale * np.sqrt(peak.claims[0, 0])), interval(cal, bound=bound), free)


@functools.cache
def true_sd(n=100):
    """Standard deviation of the maximum without a bound, over data sets that are not used again."""
    return float(np.std([bounded(10_000 + seed, 2.0).free for seed in range(n)]))


def coverage(place, n_sets):
    """Whether CAL's intervals contain the truth (set,), and their widths over those of NORM."""
    inside, wider = [], []
    for seed in range(n_sets):
        distance = np.random.default_rng([6, seed]).uniform(0.0, 4.0) if place is None else place
        upper = 1.0 + distance * true_sd()
        found = bounded(seed, upper)
        low, high = found.interval
        inside.append(low <= 1.0 <= high + 1e-9)
        wider.append((high - low) / np.ptp(interval(found.norm, bound=upper if distance < SHORT else None)))
    return np.array(inside), np.array(wider)


def run_bounds(quick=False):
    """Print how often intervals contain the truth, by where the prior ends."""
    n, start, rows = QUICK if quick else FULL, time.perf_counter(), []
    for name, place in PLACES.items():
        inside, wider = coverage(place, n)
        share = "-" if place is not None and place < 0 else f"{100 * inside.mean():.1f}"
        rows.append([name, share, f"{np.median(wider):.2f}"])
    seconds = time.perf_counter() - start
    print(
        f"\n## At the bound of a prior: 90 % intervals of a stiffness factor, {n} data sets, {seconds:.0f} s"
        f"\n\nStandard deviation of its maximum: {true_sd():.4f}.\n"
    )
    print(table(("truth and bound", "CAL contains the truth [%]", "width over NORM"), rows))
