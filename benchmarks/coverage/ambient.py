"""Unknown forces: coverage of three stiffness factors, and their widths by sampling rate.

The chain of the other parts under white forces on all storeys, measured on three of them for ten minutes.
"""

import time
import warnings

import numpy as np
import pymc as pm
from scipy import signal

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.chain import N_FACTORS, N_STOREYS, matrices, structure
from benchmarks.tables import table

RUNS, QUICK_RUNS = 200, 10
SENSORS = [2, 5, 9]
DURATION, FINEST = 600.0, 0.005  # s
RATES = {"50 Hz": 4, "100 Hz": 2, "200 Hz": 1}  # samples of the finest record to one
FORCE, ERROR = 1.0, 1e-4  # spectral densities, N^2/Hz and (m/s^2)^2/Hz
MODES, HALF_WIDTH = 3, 0.15  # bands f (1 +- 0.15) around the lowest modes
LEVELS = [0.05, 0.95]


def simulated(seed):
    """Accelerations (sensor, time) at the finest step."""
    rng, n = np.random.default_rng(seed), N_STOREYS
    forces = truth.motion(
        1.0 / FINEST, DURATION - FINEST, seed, top=0.5, ends="moving", rolloff=np.inf, n_inputs=n
    )
    size = np.sqrt(0.5 * FORCE / FINEST) / forces.values().std(axis=1, keepdims=True)
    forces = forces._replace(coefficients=forces.coefficients * size)
    values = truth.response(matrices()._replace(places=np.eye(n)), forces)["absolute_acceleration"][SENSORS]
    return values + np.sqrt(0.5 * ERROR / FINEST) * rng.standard_normal(values.shape)


def bands():
    """Around the lowest modes [Hz]."""
    f = structure(np.ones(N_FACTORS)).modes().natural_frequencies[:MODES]
    return np.column_stack([f * (1.0 - HALF_WIDTH), f * (1.0 + HALF_WIDTH)])


def intervals(values, every, seed):
    """5 and 95 % quantiles (2, factor) from every so many samples, by Laplace's approximation."""
    if every > 1:
        values = signal.decimate(values, every, ftype="fir")
    with pm.Model() as model, warnings.catch_warnings():
        warnings.simplefilter("ignore", pmf.exceptions.AmbientWarning)
        factors = pm.LogNormal("factors", 0.0, 0.2, shape=N_FACTORS)
        force, error = pm.LogNormal("force", 0.0, 2.0), pm.LogNormal("error", np.log(ERROR), 2.0)
        response = pmf.ambient.spectral_response(structure(factors), force, sensors=SENSORS)
        dt = every * FINEST
        pmf.AmbientResponse("y", response, error=error, bands=bands(), dt=dt, observed=values)
    found = pmf.laplace(4000, model=model, random_seed=seed, compile_kwargs={"mode": "FAST_COMPILE"})
    return found.posterior["factors"].quantile(LEVELS, dim=("chain", "draw")).values


def run_ambient(quick=False):
    """Print coverage at the lowest sampling rate, and the widths at all of them."""
    n, start = QUICK_RUNS if quick else RUNS, time.perf_counter()
    inside = []
    for seed in range(n):
        low, high = intervals(simulated(seed), RATES["50 Hz"], seed)
        inside.append((low < 1.0) & (high > 1.0))
    shares = 100.0 * np.mean(inside, axis=0)
    print(
        f"## Three stiffness factors from ambient vibration, ten minutes at 50 Hz\n\n{n} simulations, "
        f"{time.perf_counter() - start:.0f} s: 90 % intervals hold the truth in "
        f"{', '.join(f'{share:.1f}' for share in shares)} %, in all in {shares.mean():.1f} %\n"
    )
    values = simulated(0)
    widths = {name: np.diff(intervals(values, every, 0), axis=0)[0] for name, every in RATES.items()}
    rows = [[name, *(f"{100.0 * width:.2f}" for width in row)] for name, row in widths.items()]
    print(table(["widths [%]", *(f"factor {i + 1}" for i in range(N_FACTORS))], rows))
