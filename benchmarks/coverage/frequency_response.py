"""Intervals from hammer tests of a cantilever: right models and wrong ones, windows, drifts, record lengths.

Three points of a beam of 20 elements are hit five times each, two sensors listen, 1 % noise. The stiffness of
both halves and the damping are sought. The truth is in closed form: all 40 modes follow blows of cos^4 shape
at any instant, in time, from another assembly of the beam, by Gauss quadrature. Intervals are by quadrature
over the errors of the model, with modes linear in the parameters.
"""

import time
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.stats import norm

import pymc_features as pmf
from benchmarks.tables import table
from pymc_features.modal.frequency_response import (
    SCALES,
    measured_modes,
    misfit_of,
    standardised,
)

RATE, LENGTH, ELEMENTS, FIRST = 8192.0, 1.0, 20, 12.0  # Hz, m, number, Hz of the first mode
HITS, SENSORS, BLOWS = np.array([9, 14, 20]) - 1, np.array([12, 20]) - 1, 5
BEFORE, NOISE, ZETA = 0.01, 0.01, 0.01  # s before a blow, over the rms of the first two seconds, damping
BAND = 4.0, 750.0  # Hz
SPREAD = {"sigma_f": 0.01, "sigma_zeta": 0.1, "sigma_phi": 0.03}  # of errors of modes
N_TESTS, QUICK_TESTS, WIDE = 400, 20, 1.645


def beam(factors=(1.0, 1.0), mass=None, spring=None):
    """Angular frequencies (40,) and deflections (20, 40) of mass-normalised modes, clamped at node 0."""
    h, n = LENGTH / ELEMENTS, 2 * ELEMENTS + 2
    k, m = np.zeros((n, n)), np.zeros((n, n))
    points, weights = np.polynomial.legendre.leggauss(4)
    x, weights = 0.5 * (points + 1.0), 0.5 * h * weights
    shape = [1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2)]
    shape = np.array(shape)
    bend = np.array([12 * x - 6, h * (6 * x - 4), 6 - 12 * x, h * (6 * x - 2)]) / h**2
    rigidity = (2.0 * np.pi * FIRST) ** 2 * LENGTH**4 / 1.8751040687**4
    for e in range(ELEMENTS):
        at = slice(2 * e, 2 * e + 4)
        k[at, at] += factors[int(2 * e >= ELEMENTS)] * rigidity * (bend * weights) @ bend.T
        m[at, at] += (shape * weights) @ shape.T
    for matrix, change in ((m, mass), (k, spring)):
        if change is not None:
            matrix[2 * change[0], 2 * change[0]] += change[1]
    squares, vectors = eigh(k[2:, 2:], m[2:, 2:])
    vectors *= np.sign(vectors[-2])
    return np.sqrt(squares), vectors[::2]


class HammerTest(NamedTuple):
    """Blows and what followed."""

    force: np.ndarray  # (point, blow, time) [N]
    acceleration: np.ndarray  # (point, blow, sensor, time)
    centroids: np.ndarray  # of the blows [s]


def blow(t, start, length, size, pole, rings):
    """Force (time,) of a blow of cos^4 shape, and what modes with such poles, of unit mass, accelerate by.

    The acceleration is the imaginary part of what is returned (mode, time), in closed form; `rings` is
    exp(pole t).
    """
    turn = 2.0 * np.pi / length
    rates = 1j * turn * np.array([0.0, 1.0, -1.0, 2.0, -2.0])
    weights = size * np.array([0.375, -0.25, -0.25, 0.0625, 0.0625])[:, None] / (rates[:, None] - pole)
    first, last = np.searchsorted(t, [start, start + length])
    inside = t[first:last] - start
    force, follows = np.zeros(t.size), np.zeros((pole.size, t.size), complex)
    force[first:last] = size * (0.5 - 0.5 * np.cos(turn * inside)) ** 2
    follows[:, first:last] = np.einsum(
        "pm,pmt->mt",
        weights,
        rates[:, None, None] ** 2 * np.exp(rates[:, None] * inside)[:, None]
        - (pole**2)[:, None] * np.exp(np.outer(pole, inside)),
    )
    ends = np.sum(weights * (np.exp(rates * length)[:, None] - np.exp(pole * length)), axis=0)
    follows[:, last:] = (ends * pole**2 * np.exp(-pole * (start + length)))[:, None] * rings[:, last:]
    return force, follows / pole.imag[:, None]


def hammer_test(modes, ratios, duration, rng, drift=0.0) -> HammerTest:
    """Blows some 2 ms long; each mode follows in closed form, with noise added in time."""
    n = round(duration * RATE)
    t = np.arange(n) / RATE
    force = np.zeros((len(HITS), BLOWS, n))
    acceleration = np.zeros((len(HITS), BLOWS, len(SENSORS), n))
    centroids = np.zeros((len(HITS), BLOWS))
    for r, point in enumerate(HITS):
        w, deflections = modes[0] * np.exp(drift * rng.standard_normal()), modes[1]
        pole = -ratios * w + 1j * w * np.sqrt(1.0 - ratios**2)
        rings = np.exp(np.outer(pole, t))
        for j in range(BLOWS):
            length, start, size = (
                rng.uniform(1.8e-3, 2.2e-3),
                BEFORE + rng.uniform(0.0, 1.0 / RATE),
                rng.uniform(0.5, 1.5),
            )
            force[r, j], follows = blow(t, start, length, size, pole, rings)
            acceleration[r, j] = (deflections[SENSORS] * deflections[point]) @ follows.imag
            centroids[r, j] = start + 0.5 * length
    early = acceleration[..., : round(2.0 * RATE)]
    level = NOISE * np.sqrt(np.mean(early**2, axis=(0, 1, 3)))
    acceleration += level[:, None] * rng.standard_normal(acceleration.shape)
    return HammerTest(force, acceleration, centroids)


def responses(test: HammerTest, decay=0.0, pad=1) -> xr.Dataset:
    """H1 with the variance of its lines."""
    behind = (pad - 1) * test.force.shape[-1]
    records = [np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, behind)]) for x in test[:2]]
    return pmf.signals.frequency_response(*records, dt=1.0 / RATE, band=BAND, decay=decay)


PRIOR = np.array([0.5, 0.5, 0.7])  # of ln of both factors, and of ln of the damping ratio over its truth


def modal(theta, n=10):
    """Frequencies [Hz], damping ratios and shapes at sensors and points of the model."""
    w, deflections = beam(np.exp(theta[:2]))
    shapes = np.concatenate([deflections[SENSORS], deflections[HITS]])[:, :n].T
    return w[:n] / (2.0 * np.pi), np.full(n, ZETA * np.exp(theta[2])), shapes


def intervals(data: xr.Dataset, model_error: bool, grid=(12, 10, 6)):
    """5, 50 and 95 % quantiles (3, 3) of theta, by Laplace's method on a grid of the model's errors."""
    fit = measured_modes(data).fit
    parts = standardised(fit, True)
    scales = np.zeros((1, 3))
    if model_error:
        spans = [
            s * np.geomspace(low, 2.5, m)
            for s, low, m in zip(SCALES.values(), (2e-5, 1e-3, 1e-3), grid, strict=True)
        ]
        scales = np.stack(np.meshgrid(*spans, indexing="ij"), -1).reshape(-1, 3)
    theta = np.zeros(3)
    for _ in range(3):
        points = np.array([theta, *(theta + 1e-4 * np.vstack([np.eye(3), -np.eye(3)]))])
        f, z, shapes = map(np.array, zip(*map(modal, points), strict=True))
        m = misfit_of(f, z, shapes, np.full((7, 3), 0.02), *parts)
        slope, here = (m.z[1:4] - m.z[4:]).T / 2e-4, m.z[0]
        covariance = np.eye(len(here)) + np.tensordot(scales**2, parts[2], 1)
        solved = np.linalg.solve(covariance, np.broadcast_to(np.c_[slope, here], (len(scales), len(here), 4)))
        precision = slope.T @ solved[..., :3] + np.diag(PRIOR**-2.0)
        score = -(solved[..., 3] @ slope) - theta / PRIOR**2
        step = np.linalg.solve(precision, score[..., None])[..., 0]
        logs = -0.5 * (solved[..., 3] @ here) - 0.5 * np.linalg.slogdet(covariance)[1]
        logs += 0.5 * np.sum(step * score, axis=1) - 0.5 * np.linalg.slogdet(precision)[1]
        if model_error:
            logs += np.sum(np.log(scales) - 0.5 * (scales / list(SCALES.values())) ** 2, axis=1)
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        means = theta + step
        theta = weights @ means
    sds = np.sqrt(np.diagonal(np.linalg.inv(precision), axis1=1, axis2=2))
    found = []
    for mean, sd in zip(means.T, sds.T, strict=True):
        ends = (mean - 9 * sd).min(), (mean + 9 * sd).max()
        found.append(
            [
                brentq(lambda x, p=p, mean=mean, sd=sd: weights @ norm.cdf((x - mean) / sd) - p, *ends)
                for p in (0.05, 0.5, 0.95)
            ]
        )
    return np.array(found), fit


def disturbed(modes, rng):
    """Modes with errors of their own, drawn anew: frequencies, shapes; and damping ratios."""
    w, deflections = modes
    n = len(w)
    shapes = deflections + SPREAD["sigma_phi"] * np.sqrt(
        np.mean(deflections**2, axis=0)
    ) * rng.standard_normal(deflections.shape)
    return (w * np.exp(SPREAD["sigma_f"] * rng.standard_normal(n)), shapes), ZETA * np.exp(
        SPREAD["sigma_zeta"] * rng.standard_normal(n)
    )


CASES = {  # how the truth is drawn, record [s], decay [1/s], padding, drift, whether the model has an error
    "right model, lines alone": ("right", 2.0, 0.0, 1, 0.0, False),
    "right model": ("right", 2.0, 0.0, 1, 0.0, True),
    "errors of modes, 2 s": ("modes", 2.0, 0.0, 1, 0.0, True),
    "errors of modes, 4 s": ("modes", 4.0, 0.0, 1, 0.0, True),
    "errors of modes, 8 s": ("modes", 8.0, 0.0, 1, 0.0, True),
    "errors of modes, lines alone": ("modes", 2.0, 0.0, 1, 0.0, False),
    "a mass": ("mass", 2.0, 0.0, 1, 0.0, True),
    "a spring": ("spring", 2.0, 0.0, 1, 0.0, True),
    "window to 5 %, lines alone": ("right", 2.0, 1.5, 1, 0.0, False),
    "padded, lines alone": ("right", 2.0, 0.0, 2, 0.0, False),
    "drift of 3e-5, lines alone": ("right", 2.0, 0.0, 1, 3e-5, False),
}


def one(case, seed):
    """Whether each interval holds the truth (3,), and widths (3,)."""
    kind, duration, decay, pad, drift, has_error = CASES[case]
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    ratios = np.full(2 * ELEMENTS, ZETA)
    change = {}
    if kind in ("mass", "spring"):
        node = int(rng.integers(10, 20))
        size = 0.02 * rng.standard_normal() ** 2
        rigidity = (2.0 * np.pi * FIRST) ** 2 / 1.8751040687**4
        change = {kind: (node, size if kind == "mass" else 5.0 * size * rigidity * 3.0)}
    modes = beam(**change)
    if kind == "modes":
        modes, ratios = disturbed(modes, rng)
    test = hammer_test(modes, ratios, duration, rng, drift)
    found, _ = intervals(responses(test, decay, pad), has_error)
    return (found[:, 0] < 0.0) & (found[:, 2] > 0.0), found[:, 2] - found[:, 0]


def run_frequency_response(quick=False):
    """Print how often 90 % intervals of both stiffness factors and the damping hold the truth."""
    rows = []
    for case in CASES:
        start = time.process_time()
        inside, widths = map(
            np.array,
            zip(*(one(case, seed) for seed in range(QUICK_TESTS if quick else N_TESTS)), strict=True),
        )
        seconds = (time.process_time() - start) / len(inside)
        rows.append(
            [
                case,
                *(f"{100 * x:.0f}" for x in inside.mean(axis=0)),
                *(f"{x:.2g}" for x in np.median(widths, axis=0)),
                f"{seconds:.2g}",
            ]
        )
    print(
        table(["case", "k1 [%]", "k2 [%]", "zeta [%]", "width k1", "width k2", "width zeta", "CPU [s]"], rows)
    )
