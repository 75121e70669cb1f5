"""Intervals of a chain from measured samples of a band-limited motion contain the truth as often as they say.

Data by `benchmarks.truth`, errors by `benchmarks.coverage.errors`.
"""

import functools

import numpy as np
import pymc as pm
import pytest

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.errors import LEVEL, measurements
from benchmarks.coverage.intervals import calibrated
from pymc_features.calibration.fit import Predictions

ALARMING = ("growing with the response", "narrow-band")  # about which frequency bands disagree
DURATION = 11.98  # s: 600 samples at 50 Hz, whose transforms are quick
MASS, SPRINGS = np.ones(3), np.full(3, 1200.0)  # up to 9.9 Hz
CHAIN = truth.chain_matrices(MASS, SPRINGS, (0.3, 5e-4))


@functools.cache
def exact(rate):
    """Motion of the base, which is on its way at both ends, and floor accelerations (sensor, time)."""
    moved = truth.motion(rate, DURATION, 1, ends="moving")
    return moved, truth.response(CHAIN, moved)["absolute_acceleration"]


def declare(rate, **settings):
    """NORM with ln of three stiffness factors and of one of the damping, and the data `measured`."""
    moved, response = exact(rate)
    record = pmf.Record(moved.values()[0], 1.0 / rate, **settings)
    with pm.Model() as model:
        theta = pm.Normal("theta", 1.0, 0.25, shape=4)
        sigma = pm.LogNormal("sigma", 0.0, 2.0)
        damping = pmf.RayleighDamping(0.3 * theta[3], 5e-4 * theta[3])
        mu = pmf.response(pmf.SpringMassChain(MASS, SPRINGS * theta[:3], damping), record, dt=1.0 / rate)
        pm.Normal("y", mu, sigma, observed=pm.Data("measured", response))
    return model


def coverage(model, kind, rate, n_sets, model_error="bands"):
    """Share of the intervals of 90 % by CAL that contain the truth, by parameter (4,)."""
    response, predictions, hits = exact(rate)[1], Predictions(model), []
    frequency = truth.modes(CHAIN.mass, CHAIN.stiffness)[0][0] / (2.0 * np.pi)
    start = np.array([1.0, 1.0, 1.0, 1.0, np.log(LEVEL * np.sqrt(np.mean(response**2)))])
    for seed in range(n_sets):
        model["measured"].set_value(measurements(kind, response, 1.0 / rate, frequency, seed))
        cal = calibrated(predictions, start, 4, model_error)
        hits.append(np.abs(cal.point[:4] - 1.0) < 1.645 * np.sqrt(np.sum(cal.factor**2, axis=1)[:4]))
    return np.mean(hits, axis=0)


@pytest.mark.statistical
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "lowest"), [("white", 0.82), ("AR(1), 0.05 s", 0.82), ("narrow-band", 0.78)]
)
def test_coverage_of_a_chain(kind, lowest):
    """Mean of three springs and the damping, of 100 data sets; other kinds of errors are in `test_spectrum`.

    It scatters by 1.5 (parameters independent) to 3 % (all alike) from seed to seed, so that a false alarm is
    one in 100 or less where 90 % are right, and intervals a fifth too narrow, which contain 81 %, are seen in
    six of ten; seeds are fixed. Where bands disagree about the parameters although the model is right,
    intervals are wider than need be.
    """
    found = coverage(declare(50.0), kind, 50.0, 100).mean()
    assert lowest < found < (0.97 if kind not in ALARMING else 1.0)


@pytest.mark.statistical
@pytest.mark.slow
def test_straight_lines_exclude_the_truth():
    """Control: where they join the samples, the damping is never within its interval, springs are seldom."""
    found = coverage(declare(50.0, interpolation="linear"), "white", 50.0, 20, None)
    assert found[3] < 0.1 and found.mean() < 0.7
