"""Targets with known answers, from correlated Gaussians to separated modes, by samplers of any PyMC model."""

from benchmarks.comparison import compare_all
from benchmarks.known import TARGET_NAMES

# most runs; seconds for each sampler after its first run; seconds above which it has no second
FULL = (20, 120.0, 120.0)
QUICK = (3, 5.0, 15.0)
QUICK_NAMES = ("banana-2", "modes_19-2", "ridge-2", "schools-10")


def run(quick=False, names=None):
    """Print the rows of every target, or of those named."""
    names = names or (QUICK_NAMES if quick else TARGET_NAMES)
    compare_all("Targets with known answers", names, QUICK if quick else FULL)
