"""Responses to forces that nobody measured: likelihood in the frequency domain."""

from pymc_features.ambient import numba_dispatch
from pymc_features.ambient.response import AmbientResponse
from pymc_features.ambient.spectral import SpectralResponse, spectral_response

OPS = numba_dispatch.OPS

__all__ = [
    "OPS",
    "AmbientResponse",
    "SpectralResponse",
    "spectral_response",
]
