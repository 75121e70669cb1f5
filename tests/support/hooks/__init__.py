"""What is expected of each private hook of docs/private_hooks.md: a function for each, by its name.

A check looks its hook up when it is called, and raises anything at all if it is not what the package needs.
"""

from support.hooks import of_numba, of_pymc, of_pytensor  # noqa: F401  each keeps its checks
from support.hooks.checks import CHECKS

__all__ = ["CHECKS"]
