"""Matrices without structures: affine sums, factorisations and natural modes, dense or sparse."""

from pymc_features.algebra.affine import AffineMatrix, assemble, common_pattern, to_dense
from pymc_features.algebra.eigen import natural_modes
from pymc_features.algebra.factorisation import definite_factor, is_definite, shifted_factor, spectral_shift
from pymc_features.algebra.massless import (
    Massless,
    always_massless,
    condense,
    massless_motions,
    softest_motion,
)

__all__ = [
    "AffineMatrix",
    "Massless",
    "always_massless",
    "assemble",
    "common_pattern",
    "condense",
    "definite_factor",
    "is_definite",
    "massless_motions",
    "natural_modes",
    "shifted_factor",
    "softest_motion",
    "spectral_shift",
    "to_dense",
]
