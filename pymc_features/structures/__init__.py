"""Structures and their damping. A new structure is a class here and one line below."""

from pymc_features.structures.affine import AffineStructure
from pymc_features.structures.base import Input, Kind, Matrices, Modes, Structure
from pymc_features.structures.chains import DuffingChain, HystereticChain, SpringMassChain
from pymc_features.structures.damping import Damping, ModalDamping, RayleighDamping
from pymc_features.structures.linear import LinearStructure

STRUCTURES = (SpringMassChain, LinearStructure, AffineStructure, HystereticChain, DuffingChain)
DAMPINGS = (RayleighDamping, ModalDamping)

__all__ = [
    "DAMPINGS",
    "STRUCTURES",
    "AffineStructure",
    "Damping",
    "DuffingChain",
    "HystereticChain",
    "Input",
    "Kind",
    "LinearStructure",
    "Matrices",
    "ModalDamping",
    "Modes",
    "RayleighDamping",
    "SpringMassChain",
    "Structure",
]
