"""Modes identified from channels alone: what the intervals of two close modes contain."""

import time
import warnings

import numpy as np
import xarray as xr
from scipy import signal

import pymc_features as pmf
from benchmarks.tables import table
from pymc_features.ambient.identify import of_band, transformed

RUNS, QUICK_RUNS = 400, 40
FREQUENCIES, RATIOS = np.array([1.0, 1.04]), np.array([0.01, 0.015])
SHAPES = np.array([[1.0, 2.0, 3.0, 2.0], [1.0, 1.0, -1.0, 0.5]])
BAND = [0.85, 1.2]  # Hz
DURATION, DT, NOISE = 600.0, 0.1, 0.5  # s, s, m/s^2
WIDE = 1.645  # standard deviations of 90 %
DRAWS = 2000
FINER = 4  # steps of the simulation in one sample


def simulated(seed):
    """Accelerations of two oscillators under white forces, and white noise."""
    rng, n = np.random.default_rng(seed), int(DURATION / DT)
    values = NOISE * rng.standard_normal((SHAPES.shape[1], n))
    for f, zeta, shape in zip(FREQUENCIES, RATIOS, SHAPES, strict=True):
        omega = 2.0 * np.pi * f
        matrix = np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]])
        system = matrix, np.array([[0.0], [1.0]]), matrix[1:], np.ones((1, 1))
        b, a = signal.ss2tf(*signal.cont2discrete(system, DT / FINER)[:4])
        force = rng.standard_normal(FINER * (n + 5000))
        values += shape[:, None] * signal.decimate(signal.lfilter(b[0], a, force), FINER, ftype="fir")[5000:]
    return xr.DataArray(values, {"time": DT * np.arange(n)}, ("sensor", "time"))


def covered(seed):
    """Whether the intervals of frequencies, damping ratios and the MAC of both shapes hold the truth."""
    [data] = transformed(simulated(seed), [BAND], "acceleration")
    posterior = of_band(data, 2)
    modes, order = posterior.centre, np.argsort(posterior.centre.natural)
    frequency_sd, damping_sd, _ = posterior.standard_deviations()
    inside = [
        *(np.abs(modes.natural - FREQUENCIES[np.argsort(order)]) < WIDE * frequency_sd)[order],
        *(np.abs(modes.ratios - RATIOS[np.argsort(order)]) < WIDE * damping_sd)[order],
    ]
    rng = np.random.default_rng(seed)
    x = rng.multivariate_normal(np.zeros(posterior.size), posterior.covariance, DRAWS)
    shapes = posterior.parameters(x).shapes
    shapes /= np.linalg.norm(shapes, axis=2, keepdims=True)
    low, high = np.quantile((shapes[:, 0] * shapes[:, 1]).sum(axis=1) ** 2, [0.05, 0.95])
    return [*inside, low < float(pmf.modal.mac(*SHAPES[:, None])[0, 0]) < high]


def run_identified(quick=False):
    """Print how often 90 % intervals contain the truth."""
    n, start = QUICK_RUNS if quick else RUNS, time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        shares = 100.0 * np.mean([covered(seed) for seed in range(n)], axis=0)
    names = "f1", "f2", "damping 1", "damping 2", "MAC of both"
    print(
        f"## Two modes at 1.00 and 1.04 Hz from {DURATION:g} s: coverage of 90 % intervals [%]\n\n{n} "
        f"simulations, +- {100.0 * np.sqrt(0.09 / n):.1f}, {time.perf_counter() - start:.0f} s\n"
    )
    print(table(names, [[f"{share:.1f}" for share in shares]]))
