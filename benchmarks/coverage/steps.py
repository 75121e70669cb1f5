"""Widths at the seven sampling steps of the study: coarser data are every n-th sample of the finest."""

import numpy as np

from benchmarks import truth
from benchmarks.coverage.chain import N_FACTORS, RATES, matrices, moved, record
from benchmarks.coverage.errors import LEVEL, first_order
from benchmarks.coverage.simulated import Predictions, start_of
from benchmarks.tables import table
from pymc_features.calibration.maxima import climb_likelihood
from pymc_features.calibration.sandwich import Peak
from pymc_features.calibration.stretched import curved
from pymc_features.study.paper import MULTIPLIERS

RATE = RATES[0]  # of the record [Hz]
SETS, QUICK_SETS = 20, 3
TIME_CONSTANT = 0.2  # s


def smooth(rng, shape, dt):
    """Errors of second order in time: the first-order process, averaged by the same filter once more."""
    from scipy.signal import lfilter

    phi = np.exp(-dt / TIME_CONSTANT)
    long = first_order(rng, (shape[0], shape[1] + 2000), dt, TIME_CONSTANT)
    signal = lfilter([1.0 - phi], [1.0, -phi], long, axis=1)[:, 2000:]
    return signal / np.sqrt((1 - phi) ** 2 * (1 + phi**2) / (1 - phi**2) ** 2)


KINDS = {
    "coloured": smooth,
    "white at the finest step": lambda rng, shape, dt: rng.standard_normal(shape),
}


def run_steps(quick=False):
    """Print the standard deviations of a factor by NORM and CAL at each step, over those at the record's."""
    finest = min(MULTIPLIERS) / RATE
    fine = round(1.0 / min(MULTIPLIERS))
    response = truth.response(matrices(), moved(RATE), fine=fine)["absolute_acceleration"]
    size = LEVEL * np.sqrt(np.mean(response**2))
    print("\nStandard deviation over that of NORM at the record's step, mean of the factors and data sets.\n")
    rows = []
    for kind, errors in KINDS.items():
        found = np.zeros((2, len(MULTIPLIERS)))
        for seed in range(QUICK_SETS if quick else SETS):
            data = response + size * errors(np.random.default_rng([3, seed]), response.shape, finest)
            found += np.transpose([widths(data, finest, multiplier) for multiplier in MULTIPLIERS])
        found /= found[0, list(MULTIPLIERS).index(1.0)]
        for name, row in zip(("NORM", "CAL"), found, strict=True):
            rows.append([f"{name}, {kind}", *(f"{x:.3f}" for x in row)])
    steps = [f"{m / RATE:g} s" for m in MULTIPLIERS]
    print(table(["errors", *steps], rows), flush=True)


def widths(data, finest, multiplier):
    """Mean standard deviation of the factors by NORM and by CAL, from every n-th sample."""
    stride = round(multiplier / min(MULTIPLIERS))
    dt = finest * stride
    some = np.ascontiguousarray(data[:, ::stride])
    predictions = Predictions(record(RATE), some, dt)
    fit = climb_likelihood(predictions, start_of(record(RATE), some, dt))
    peak, _ = curved(predictions, Peak.at(fit))
    matrices = peak.claims, peak.covariance
    return [np.sqrt(np.diag(m)[:N_FACTORS]).mean() for m in matrices]
