"""Matrices without structures: affine sums, factorisations and natural modes, dense or sparse."""

from pymc_features.algebra.affine import AffineMatrix, assemble, common_pattern, to_dense
from pymc_features.algebra.eigen import natural_modes
from pymc_features.algebra.factorisation import definite_factor, is_definite, shifted_factor, spectral_shift

__all__ = [
    "AffineMatrix",
    "assemble",
    "common_pattern",
    "definite_factor",
    "is_definite",
    "natural_modes",
    "shifted_factor",
    "spectral_shift",
    "to_dense",
]
