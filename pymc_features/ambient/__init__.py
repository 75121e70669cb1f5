"""Responses to forces that nobody measured: their likelihood in the frequency domain, and modes."""

from pymc_features.ambient.identify import identify_modes, propose_bands
from pymc_features.ambient.response import AmbientResponse, SpectralResponse, spectral_response
from pymc_features.ambient.subspace import subspace_poles

__all__ = [
    "AmbientResponse",
    "SpectralResponse",
    "identify_modes",
    "propose_bands",
    "spectral_response",
    "subspace_poles",
]
__dir__ = __all__.copy
