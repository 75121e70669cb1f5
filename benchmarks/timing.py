"""Timing of competitors side by side, and the machine's own speed."""

import time

import numpy as np
from numba import njit

from pymc_features.simulators.numbers.compiled_numbers import highest
from pymc_features.simulators.numbers.vectors import LANES, splat


def best_of_rounds(competitors, rounds, at_least=0.02):
    """Return the least seconds of one call of each competitor.

    The competitors take turns within each round, so that a busy machine is unfair to all alike; short
    calls are repeated until a turn lasts `at_least` seconds.

    Parameters
    ----------
    competitors : dict of str to callable
        Called without arguments; the first call, which may compile, is not timed.
    rounds : int
        Turns of each competitor.
    """
    repeats = {}
    for name, call in competitors.items():
        call()
        repeats[name] = max(1, int(np.ceil(at_least / max(_seconds(call, 1), 1e-7))))
    best = dict.fromkeys(competitors, np.inf)
    for _ in range(rounds):
        for name, call in competitors.items():
            best[name] = min(best[name], _seconds(call, repeats[name]))
    return best


def _seconds(call, repeats):
    """Mean seconds of `repeats` calls."""
    start = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - start) / repeats


def matrix_product(size=1000):
    """Return a call that multiplies two square matrices, and its floating-point operations."""
    a, b = np.random.default_rng(0).standard_normal((2, size, size))
    out = np.empty((size, size))
    return (lambda: np.dot(a, b, out=out)), 2.0 * size**3


def fused_products(count=100_000):
    """Return a call that keeps the units for fused products busy from registers alone, and its operations.

    No program has more floating-point operations a second than this, that of the processor.
    """

    @njit
    def spin(count, start):
        a, b = splat(start), splat(1e-6)
        x0, x1, x2, x3 = splat(0.1), splat(0.2), splat(0.3), splat(0.4)
        y0, y1, y2, y3 = splat(0.5), splat(0.6), splat(0.7), splat(0.8)
        z0, z1, z2, z3 = splat(0.9), splat(1.1), splat(1.2), splat(1.3)
        for _ in range(count):
            x0, x1, x2, x3 = x0 * a + b, x1 * a + b, x2 * a + b, x3 * a + b
            y0, y1, y2, y3 = y0 * a + b, y1 * a + b, y2 * a + b, y3 * a + b
            z0, z1, z2, z3 = z0 * a + b, z1 * a + b, z2 * a + b, z3 * a + b
        return highest(x0 + x1 + x2 + x3 + y0 + y1 + y2 + y3 + z0 + z1 + z2 + z3)

    return (lambda: spin(count, 0.999)), 2.0 * 12 * LANES * count


def fitted_exponent(sizes, costs):
    """Least-squares slope of log cost against log size."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])
