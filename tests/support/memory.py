"""Peak memory of a process; for scripts that measure it in a process of their own."""

import resource
import sys

import numpy as np


def peak():
    """Largest resident memory so far [bytes]."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size if sys.platform == "darwin" else 1024 * size


def growth(function):
    """Bytes by which the peak grows in a call, and what the call returns."""
    ballast, start = [], peak()
    while peak() < start + 2_000_000:  # until the peak is what is in use now
        ballast.append(np.ones(50_000))
    before = peak()
    result = function()
    return peak() - before, result
