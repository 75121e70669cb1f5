"""Kernels for `pm.sample_smc`, and results that can be saved. Nothing here knows of structures."""

from pymc_features.smc.relative_imh import RelativeIMH
from pymc_features.smc.results import savable

KERNELS = (RelativeIMH,)

__all__ = ["KERNELS", "RelativeIMH", "savable"]
