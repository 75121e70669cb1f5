"""Structures and their damping. A new structure is one file here and one line below."""

from pymc_features.structures.affine import AffineStructure
from pymc_features.structures.base import Matrices, Modes, Structure
from pymc_features.structures.chain import SpringMassChain
from pymc_features.structures.damping import Damping, ModalDamping, RayleighDamping
from pymc_features.structures.duffing import DuffingChain
from pymc_features.structures.hysteretic import HystereticChain
from pymc_features.structures.inputs import Input, Kind
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
