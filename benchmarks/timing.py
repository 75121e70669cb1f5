"""Timing of competitors side by side, and the machine's own speed."""

import time

import numpy as np


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


def fitted_exponent(sizes, costs):
    """Least-squares slope of log cost against log size."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])
