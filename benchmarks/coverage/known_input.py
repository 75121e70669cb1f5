"""Modes from channels and their excitation: how far off they are, in units of the deviations that are said.

Four floors under an earthquake; close modes, 1.00 and 1.02 Hz, under two forces; a free beam under three
blows. The truth is in closed form: transfer functions, exact steps 32 times finer, modes in time.
"""

import time

import numpy as np
import xarray as xr
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.signal import lfilter, resample, ss2tf

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.frequency_response import blow
from benchmarks.tables import table

RUNS, QUICK_RUNS = 400, 20
FLOORS, RATE = truth.chain_matrices(np.ones(4), np.full(4, 1200.0), (0.1, 0.0008)), 50.0
CLOSE, SHAPES = np.array([1.0, 1.02]), np.array([[1.0, 0.6, -0.3], [0.4, -0.8, 1.0]])
INPUTS = np.array([[1.0, 0.3], [-0.5, 1.0]])  # participation of these two
N_MODES, FIRST, RATIO = 9, 60.0, 0.005  # of the beam: number, Hz, damping
SENSORS, HIT = np.array([0.0, 0.17, 0.61, 1.0]), 1  # places over the length, and which of them is hit
BANDS = {  # Hz; modes at 1.9, 5.5, 8.4 and 10.4; 1.00 and 1.02; 60, 165, 324 and 536 Hz
    "earthquake": [(1.0, 3.7), (3.8, 6.9), (7.0, 9.4), (9.5, 12.0)],
    "close modes, shakers": [(0.8, 1.25)],
    "free beam, hammer": [(40.0, 100.0), (120.0, 220.0), (260.0, 400.0), (450.0, 640.0)],
}


def channels(values, names, rate):
    """As `read_channels` returns them."""
    coords = {"sensor": list(names), "time": np.arange(np.shape(values)[1]) / rate}
    return xr.DataArray(values, coords, ("sensor", "time"))


def earthquake(seed, ends="quiet"):
    """Floors and base under a motion, by transfer functions of modes; 2 % noise."""
    motion = truth.motion(RATE, 60.0, seed, ends=ends)
    y = truth.response(FLOORS, motion)["absolute_acceleration"]
    y = y + 0.02 * y.std() * np.random.default_rng(seed).standard_normal(y.shape)
    return channels(y, "abcd", RATE), channels(motion.values(), "g", RATE)


def floors():
    """Frequencies [Hz], damping ratios, shapes (mode, floor) and participation (mode, 1)."""
    w, shapes = truth.modes(FLOORS.mass, FLOORS.stiffness)[:2]
    w, shapes = np.ravel(w), np.reshape(shapes, (4, 4)).T
    masses = np.sum(shapes @ FLOORS.mass * shapes, axis=1, keepdims=True)
    parts = -(shapes @ FLOORS.mass).sum(axis=1, keepdims=True) / masses
    return w / (2.0 * np.pi), 0.5 * (0.1 / w + 0.0008 * w), shapes, parts


def shaken(seed, n=6000, dt=0.05, fine=32):
    """Displacements and two band-limited forces, in steps of dt / 32; 5 % noise."""
    rng = np.random.default_rng(seed)
    forces = resample(rng.standard_normal((2, n // 2)), n, axis=1)
    y = np.zeros((3, n))
    for f, shape, part in zip(CLOSE, SHAPES, INPUTS, strict=True):
        w = 2.0 * np.pi * f
        whole = np.zeros((3, 3))
        whole[0, 1], whole[1] = 1.0, [-(w**2), -0.02 * w, 1.0]
        step = expm(whole * dt / fine)
        b, a = ss2tf(step[:2, :2], step[:2, 2:], np.eye(2)[:1], np.zeros((1, 1)))
        force = resample(part @ forces, n * fine)
        y += shape[:, None] * lfilter(b[0], a, 0.5 * (force + np.roll(force, -1)))[::fine]
    y += 0.05 * y.std() * rng.standard_normal(y.shape)
    return channels(y, "abc", 1.0 / dt), channels(forces, "uv", 1.0 / dt)


def beam():
    """Frequencies [Hz], damping ratios, deflections at sensors and at the hit of a free beam.

    Their mean square over the beam is one.
    """
    middles = (np.arange(N_MODES) + 1.5) * np.pi
    roots = np.array([brentq(lambda b: np.cos(b) - 1.0 / np.cosh(b), x - 0.5, x + 0.5) for x in middles])
    b, x = roots[:, None], SENSORS[None]
    ratio = (np.cosh(b) - np.cos(b)) / (np.sinh(b) - np.sin(b))
    shapes = np.cosh(b * x) + np.cos(b * x) - ratio * (np.sinh(b * x) + np.sin(b * x))
    return FIRST * (roots / roots[0]) ** 2, np.full(N_MODES, RATIO), shapes, shapes[:, HIT : HIT + 1]


def hammered(seed, rate=4096.0, duration=6.0):
    """Accelerations and the force of three blows on a free beam of 1 kg; it flies besides; 1 % noise."""
    rng, t = np.random.default_rng(seed), np.arange(round(duration * rate)) / rate
    f, zeta, shapes, at_hit = beam()
    pole = 2.0 * np.pi * f * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    force, y, rings = np.zeros(t.size), np.zeros((len(SENSORS), t.size)), np.exp(np.outer(pole, t))
    for start in rng.uniform(0.1, 0.5 * duration, 3):
        length, size = rng.uniform(2.4e-3, 3.0e-3), rng.uniform(0.5, 1.5)
        acted, follows = blow(t, start, length, size, pole, rings)
        flies = 1.0 + 12.0 * (SENSORS - 0.5) * (SENSORS[HIT] - 0.5)
        y += (shapes * at_hit).T @ follows.imag + flies[:, None] * acted
        force += acted
    y += 0.01 * y.std() * rng.standard_normal(y.shape)
    names = [f"p{i}" for i in range(len(SENSORS))]
    return channels(y, names, rate), channels(force[None], names[HIT : HIT + 1], rate)


CASES = {
    "earthquake": (earthquake, floors, "acceleration"),
    "close modes, shakers": (shaken, lambda: (CLOSE, np.full(2, 0.01), SHAPES, INPUTS), "displacement"),
    "free beam, hammer": (hammered, beam, "acceleration"),
}


def scores(case, seed, bands=None):
    """z-scores of frequencies and damping ratios (mode,), shapes (mode, s) and participation (mode, r).

    None if modes are missed or too many.
    """
    simulated, expected, quantity = CASES[case]
    bands = BANDS[case] if bands is None else bands
    y, x = simulated(seed)
    found = pmf.identify_modes(y, bands, quantity=quantity, excitation=x)
    expected = expected()
    inside = [any(low < f < high for low, high in bands) for f in expected[0]]
    f, zeta, shapes, parts = (values[inside] for values in expected)
    if len(found) != len(f):
        return None
    length = np.linalg.norm(shapes, axis=1, keepdims=True)
    sense = np.sign(np.sum(found.shapes * shapes, axis=1, keepdims=True))
    return (
        (found.frequencies - f) / found.frequency_sd,
        (found.damping_ratios - zeta) / found.damping_sd,
        (sense * found.shapes - shapes / length) / found.shape_sd,
        (sense * found.participation - parts * length) / found.participation_sd,
    )


def run_known_input(quick=False):
    """Print means and standard deviations of z-scores, from the smallest to the largest of all modes."""
    runs, rows = QUICK_RUNS if quick else RUNS, []
    for case in CASES:
        start = time.process_time()
        found = [scores(case, seed) for seed in range(1, 1 + runs)]
        right = [x for x in found if x is not None]
        seconds = (time.process_time() - start) / runs
        for what, z in zip(("f", "zeta", "shapes", "participation"), zip(*right, strict=True), strict=True):
            ends = [f"{x.min():.2f} to {x.max():.2f}" for x in (np.mean(z, axis=0), np.std(z, axis=0))]
            rows.append([case, what, *ends, f"{runs - len(right)}", f"{seconds:.2g}"])
    print(f"## Modes with known input: {runs} records of each kind\n")
    print(table(["case", "of", "mean of z", "sd of z", "wrong numbers of modes", "CPU [s]"], rows))
