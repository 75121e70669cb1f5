"""Modes identified from channels alone, whole lists: every mode once, no other, and what intervals contain.

Records of structures of four channels in four kinds: two of four plain, one with a drift and a machine beside
a mode, one with two close modes. The simulator is discrete-time state space of each mode, by the matrix
exponential, and shares nothing with the package.
"""

import time
import warnings
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import linalg, signal

import pymc_features as pmf
from benchmarks.tables import table

RUNS, QUICK_RUNS, REPORTED = 2000, 40, 100
KINDS = ("plain", "drift and machine", "plain", "close")
DURATION, DT, FINER = 1200.0, 0.04, 4  # s, s, steps of the simulation in one sample
RATIO, NOISE = 0.01, 0.1  # damping; rms of the noise over that of the signal, in each channel
WIDE = 1.645  # standard deviations of 90 %


class Simulation(NamedTuple):
    """Channels (sensor, time), and the frequencies [Hz] and shapes (mode, sensor) behind them."""

    channels: xr.DataArray
    frequencies: np.ndarray
    shapes: np.ndarray


def structure(kind, rng) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and shapes (mode, sensor): of four unequal storeys, or two close modes and two."""
    if kind == "close":
        while True:
            shapes = np.linalg.qr(rng.normal(size=(4, 4)))[0]
            shapes[1] += rng.uniform(-0.6, 0.6) * shapes[0]
            shapes /= np.linalg.norm(shapes, axis=1, keepdims=True)
            if (shapes[0] @ shapes[1]) ** 2 < 0.5:
                return np.array([1.0, 1.04, rng.uniform(2.3, 2.8), rng.uniform(3.8, 4.6)]), shapes
    k = rng.uniform(0.7, 1.3, 4)
    stiffness = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    squares, vectors = np.linalg.eigh(stiffness)
    return rng.uniform(0.8, 1.3) * np.sqrt(squares / squares[0]), vectors.T


def accelerations(f, forces, dt):
    """Of one mode (n,) of unit mass and `RATIO` under forces (n,) that are constant in each step."""
    omega = 2.0 * np.pi * f
    augmented = np.zeros((3, 3))
    augmented[0, 1], augmented[1] = 1.0, [-(omega**2), -2.0 * RATIO * omega, 1.0]
    step = linalg.expm(augmented * dt)
    b, a = signal.ss2tf(step[:2, :2], step[:2, 2:], augmented[1:2, :2], np.ones((1, 1)))
    return signal.lfilter(b[0], a, forces)


def simulated(kind, seed) -> Simulation:
    """One record: white forces on every storey, white noise; perhaps a drift and a machine."""
    rng, n = np.random.default_rng([11, seed]), int(DURATION / DT)
    frequencies, shapes = structure(kind, rng)
    start, fine = int(60.0 / DT), DT / FINER
    forces = shapes @ rng.standard_normal((4, (n + start) * FINER))
    moving = [accelerations(f, force, fine) for f, force in zip(frequencies, forces, strict=True)]
    values = shapes.T @ signal.decimate(np.array(moving), FINER, ftype="fir", axis=1)[:, start:]
    rms = values.std(axis=1, keepdims=True)
    t = DT * np.arange(n)
    if kind == "drift and machine":
        walk = np.cumsum(rng.standard_normal((4, n)), axis=1)
        walk = rng.uniform(0.5, 3.0) * walk / walk.std(axis=1, keepdims=True)
        beside = frequencies[rng.integers(4)] * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.1))
        tone = (
            np.sqrt(2.0) * rng.uniform(0.1, 0.5) * np.sin(2.0 * np.pi * beside * t + rng.uniform(0.0, 6.28))
        )
        values = values + rms * walk + rms.mean() * rng.normal(size=(4, 1)) * tone
    values = values + NOISE * rms * rng.standard_normal(values.shape)
    coords = {"sensor": [f"s{i}" for i in range(4)], "time": t}
    return Simulation(xr.DataArray(values, coords, ("sensor", "time")), frequencies, shapes)


class Outcome(NamedTuple):
    """Modes missed and too many, and deviations (mode, 2) of f and ln zeta over standard deviations."""

    missed: int
    too_many: int
    deviations: np.ndarray


def outcome(kind, seed) -> Outcome:
    """What `identify_modes` makes of one record; a mode is found by one within five deviations, or 1 %."""
    record = simulated(kind, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = pmf.identify_modes(record.channels)
    macs = pmf.modal.mac(found.shapes, record.shapes)
    near = np.abs(found.frequencies[:, None] - record.frequencies)
    near = near < np.maximum(5.0 * found.frequency_sd[:, None], 0.01 * record.frequencies)
    score, free, pairs = np.where(near, macs, -1.0), np.ones(len(found), dtype=bool), []
    for mode in range(4):
        best = int(np.where(free, score[:, mode], -1.0).argmax())
        if free[best] and score[best, mode] > 0.5:
            free[best] = False
            pairs.append((best, mode))
    own, true = np.array(pairs, dtype=int).reshape(-1, 2).T
    off = found.frequencies[own] - record.frequencies[true]
    ratios = found.damping_ratios[own]
    relative = np.log(ratios / RATIO) * ratios / found.damping_sd[own]
    return Outcome(
        4 - len(pairs), int(free.sum()), np.column_stack([off / found.frequency_sd[own], relative])
    )


def run_modes(quick=False):
    """Print misses, modes too many and coverage by kind."""
    n, start, rows, outcomes = QUICK_RUNS if quick else RUNS, time.perf_counter(), [], []
    for seed in range(n):
        outcomes.append((KINDS[seed % 4], outcome(KINDS[seed % 4], seed)))
        if len(outcomes) % REPORTED == 0:
            counts = [sum(getattr(one, name) > 0 for _, one in outcomes) for name in ("missed", "too_many")]
            print(
                f"{len(outcomes)} records: {counts[0]} with a mode missed, {counts[1]} with one too many",
                flush=True,
            )
    seconds = time.perf_counter() - start
    print(f"## Lists of modes from {DURATION / 60:g} minutes: {n} records, {seconds:.0f} s\n")
    for kind in (*dict.fromkeys(KINDS), "all"):
        some = [one for name, one in outcomes if kind in (name, "all")]
        inside = 100.0 * (np.abs(np.vstack([one.deviations for one in some])) < WIDE).mean(axis=0)
        counts = [sum(one.missed > 0 for one in some), sum(one.too_many > 0 for one in some)]
        rows.append([kind, f"{len(some)}", *map(str, counts), *(f"{share:.1f}" for share in inside)])
    names = "kind", "records", "a mode missed", "one too many", "frequencies in 90 % [%]", "damping [%]"
    print(table(names, rows))
