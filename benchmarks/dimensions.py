"""Structural posteriors of 2 to 41 parameters by samplers of any PyMC model, judged by exact answers."""

from benchmarks.comparison import compare_all
from benchmarks.known import STRUCTURAL_NAMES

# most runs; seconds for each sampler after its first run; seconds above which it has no second
FULL = (10, 300.0, 300.0)
QUICK = (3, 10.0, 30.0)
QUICK_NAMES = ("TN-2-wide", "EXP-4-wide")


def run(quick=False, names=None):
    """Print the rows of every problem, or of those named."""
    names = names or (QUICK_NAMES if quick else STRUCTURAL_NAMES)
    compare_all("Structural posteriors by dimension", names, QUICK if quick else FULL)
